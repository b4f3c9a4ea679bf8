//! The deviation of `f32` and fixed point from `f64`, worst case over a grid of motions.

use kinematics::{
    FixedMember, FourWheelGeometry, MemberKinematics, Mount, Pose, Twist, VelocityCompensation,
};

use super::figure::Figure;

/// The robot of `groups/tcc-3.toml`, off the centre and turned.
const GEOMETRY: [f64; 4] = [0.370, 0.350, 0.1524, std::f64::consts::FRAC_PI_4];
const MOUNT: [f64; 3] = [1.2, -0.4, 0.3];
const COMPENSATION: [f64; 3] = [1.002, 1.033, 1.0195];
/// Steps from standstill to 2 m/s and 1 rad/s either way.
const STEPS: i32 = 12;

/// Largest differences.
pub fn figures() -> anyhow::Result<Vec<Figure>> {
    let [track, base, radius, angle] = GEOMETRY;
    let [x, y, heading] = MOUNT;
    let [cx, cy, cw] = COMPENSATION;
    let exact = MemberKinematics::<f64>::new(
        &FourWheelGeometry::new(track, base, radius, angle)?,
        &Mount::new(Pose::new(x, y, heading))?,
        &VelocityCompensation::new(cx, cy, cw)?,
    )?;
    let geometry = FourWheelGeometry::new(track as f32, base as f32, radius as f32, angle as f32)?;
    let mount = Mount::new(Pose::new(x as f32, y as f32, heading as f32))?;
    let compensation = VelocityCompensation::new(cx as f32, cy as f32, cw as f32)?;
    let single = MemberKinematics::<f32>::new(&geometry, &mount, &compensation)?;
    let fixed = FixedMember::new(&geometry, &mount, &compensation)?;

    let (mut f32_rate, mut fixed_rate, mut f32_twist, mut fixed_twist) = (0.0, 0.0, 0.0, 0.0);
    let steps = || (-STEPS..=STEPS).map(|n| n as f32 / STEPS as f32);
    for vx in steps() {
        for vy in steps() {
            for omega in steps() {
                let twist = Twist::new(2.0 * vx, 2.0 * vy, omega);
                let wide = Twist::new(
                    f64::from(twist.vx),
                    f64::from(twist.vy),
                    f64::from(twist.omega),
                );
                let want: [f64; 4] = exact.inverse(wide).into();
                let rates = [single.inverse(twist), fixed.inverse(twist)];
                let worst = [&mut f32_rate, &mut fixed_rate];
                for (rates, worst) in rates.iter().zip(worst) {
                    let found: [f32; 4] = (*rates).into();
                    *worst = want.iter().zip(found).fold(*worst, |worst: f64, (w, f)| {
                        worst.max((w - f64::from(f)).abs())
                    });
                }
                let back = [single.forward(&rates[0]), fixed.forward(&rates[1])];
                for (back, worst) in back.iter().zip([&mut f32_twist, &mut fixed_twist]) {
                    *worst = [
                        f64::from(back.vx) - wide.vx,
                        f64::from(back.vy) - wide.vy,
                        f64::from(back.omega) - wide.omega,
                    ]
                    .iter()
                    .fold(*worst, |worst: f64, off| worst.max(off.abs()));
                }
            }
        }
    }
    // Six digits of the fastest wheel's 30 rad/s. In fixed point an input is off by half a step of
    // 2^-16, which the row of this robot's matrix that is largest in sum, 29.3, makes 2.24e-4;
    // rounding the result adds 1.5e-5. Back: an LSB of the bus is 1e-4.
    Ok(vec![
        Figure::new("accuracy.inverse.f32", f32_rate, "rad/s").ceiling(3e-5),
        Figure::new("accuracy.inverse.fixed", fixed_rate, "rad/s").ceiling(2.5e-4),
        Figure::new("accuracy.round_trip.f32", f32_twist, "m/s, rad/s").ceiling(1e-5),
        Figure::new("accuracy.round_trip.fixed", fixed_twist, "m/s, rad/s").ceiling(1e-4),
    ])
}
