//! One test per equation of the paper, named for it.
//!
//! The expected values are the paper's own forms, or numbers computed from them by hand, in its own
//! frame; the crate's are computed in REP-103 and brought over. W differs from H, and roller angles
//! other than 45 degrees are always among the cases: at 45 degrees the two ways of measuring a
//! roller angle cannot be distinguished.

use kinematics::paper::{self, PaperTwist, PaperWheel};
use kinematics::{
    FourWheelGeometry, MemberKinematics, Mount, Platform, Pose, Twist, VelocityCompensation, Wheel,
    WheelRates, roller_angle_correction,
};
use mecanum_kinematics as kinematics;

mod group;
mod robot;
mod roller_angle;

/// Rounding of a few operations on numbers up to ten, f64.
const F64: f64 = 1e-12;
/// The same in f32.
const F32: f32 = 1e-5;

const ANGLES_DEG: [f64; 4] = [45.0, 30.0, 60.0, 38.5];

const TWISTS: [PaperTwist<f64>; 6] = [
    PaperTwist {
        x: 0.5,
        y: 0.0,
        theta: 0.0,
    },
    PaperTwist {
        x: 0.0,
        y: 0.5,
        theta: 0.0,
    },
    PaperTwist {
        x: 0.0,
        y: 0.0,
        theta: 0.7,
    },
    PaperTwist {
        x: 0.3,
        y: -0.4,
        theta: 0.0,
    },
    PaperTwist {
        x: -0.2,
        y: 0.1,
        theta: 0.9,
    },
    PaperTwist {
        x: 0.25,
        y: 0.35,
        theta: -0.6,
    },
];

fn virtual_robot(angle_deg: f64) -> FourWheelGeometry<f64> {
    FourWheelGeometry::new(0.370, 0.350, 0.1524, angle_deg.to_radians()).unwrap()
}

/// The four wheels as the paper's Figure 1 describes them: alpha + beta = 0.
fn paper_wheels(geometry: &FourWheelGeometry<f64>) -> [PaperWheel<f64>; 4] {
    let (w, h) = (geometry.half_track(), geometry.half_wheelbase());
    let g = geometry.roller_angle();
    [(w, h, -g), (-w, h, g), (-w, -h, -g), (w, -h, g)].map(|(x, y, gamma): (f64, f64, f64)| {
        let alpha = y.atan2(x);
        PaperWheel {
            l: x.hypot(y),
            alpha,
            beta: -alpha,
            gamma,
            radius: geometry.wheel_radius(),
        }
    })
}

/// The same wheel in this crate's terms: x forward is the paper's y.
fn wheel_of(p: PaperWheel<f64>) -> Wheel<f64> {
    let (x, y) = (p.l * p.alpha.cos(), p.l * p.alpha.sin());
    Wheel::new(y, -x, p.alpha + p.beta, p.gamma, p.radius).unwrap()
}

fn rate(wheel: &Wheel<f64>, twist: Twist<f64>) -> f64 {
    let [x, y, w] = wheel.jacobian_row();
    x * twist.vx + y * twist.vy + w * twist.omega
}

fn no_compensation() -> VelocityCompensation<f64> {
    VelocityCompensation::new(1.0, 1.0, 1.0).unwrap()
}

fn alone() -> Mount<f64> {
    Mount::new(Pose::new(0.0, 0.0, 0.0)).unwrap()
}

fn close(got: f64, want: f64, what: &str) {
    assert!((got - want).abs() <= F64, "{what}: got {got}, want {want}");
}

fn close_all(got: [f64; 4], want: [f64; 4], what: &str) {
    for (i, (got, want)) in got.into_iter().zip(want).enumerate() {
        close(got, want, &format!("{what}, wheel {}", i + 1));
    }
}

/// Wheels anywhere, at any attitude.
fn odd_wheels() -> Vec<PaperWheel<f64>> {
    let mut wheels = Vec::new();
    for alpha in [0.3, 1.9, -2.4] {
        for beta in [0.0, -0.3, 1.1] {
            for gamma in [std::f64::consts::FRAC_PI_4, -0.6, 1.2] {
                wheels.push(PaperWheel {
                    l: 0.61,
                    alpha,
                    beta,
                    gamma,
                    radius: 0.09,
                });
            }
        }
    }
    wheels
}
