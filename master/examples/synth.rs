use omnibus::{metrics::*, record::*, report::*};
use kinematics::*;
fn main(){
 let mk=|comp:bool|{
  let k=if comp {0.998}else{0.967};
  let truth:Vec<TruthRow>=(0..2200).map(|i|{let t=i as f64*0.01;let w=std::f64::consts::PI/10.0;
   let (x,y)=(2.5*(w*t).cos(),2.5*(2.0*w*t).sin());
   let theory=Pose{x:x as f32,y:-y as f32,heading:0.0};
   let group=Pose{x:(2.5+(x-2.5)*0.998) as f32,y:(-y*k) as f32,heading:0.0};
   let r=(10.0*(w*t).sin()) as f32;
   TruthRow{t,theory,theory_twist:Twist{vx:(-2.5*w*(w*t).sin()) as f32,vy:(-5.0*w*(2.0*w*t).cos()) as f32,omega:0.0},group,shape_error_mm:0.1*t.sin().abs(),bus_load:0.2,
    robots:vec![RobotTruth{pose:group,wheel_rates:WheelRates{front_left:r,front_right:-r,rear_left:0.5*r,rear_right:0.1*r}};3]}}).collect();
  let path:Vec<_>=truth.iter().map(|r|PathPoint{t:r.t,theory:r.theory,actual:r.group}).collect();
  Run{compensation:comp,errors:path_errors(&path).unwrap(),shape_error_mm:0.2,bus_load_percent:21.3,realtime_factor:1.2,truth,rows:vec![]}
 };
 let robots=[-1.3f32,0.0,1.3].iter().enumerate().map(|(i,x)|Outline{node:2+i as u8,mount:Pose{x:*x,y:0.0,heading:0.0},half_track:0.37,half_wheelbase:0.35}).collect();
 let r=Report{backend:BackendName::Native,config:"tcc-3".into(),trajectory:"figure-eight".into(),robots,runs:vec![mk(false),mk(true)]};
 println!("{}",table::to_table(&r));println!("{}",json::to_json(&r));
 std::fs::write("/tmp/mas-report.html",html::to_html(&r).unwrap()).unwrap();
}
