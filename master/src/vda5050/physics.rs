//! The values of the factsheet, from the group file.

use ::vda5050::configuration::{Physics, Wheel};
use group::GroupFile;

/// Width of a wheel as a share of its diameter: group files do not have it. Wheels of this kind are
/// between a quarter and a half as wide as they are high.
const WIDTH_SHARE: f64 = 0.4;

/// The group as the factsheet has it. The outline is the smallest rectangle along the axes of the
/// group that holds every wheel with its tread; what stands out further has to be added by those
/// who plan the traffic.
#[must_use]
pub fn of(group: &GroupFile) -> Physics {
    let mut wheels = Vec::new();
    for robot in &group.robots {
        let mount = robot.mount;
        for wheel in robot.each_wheel() {
            let (x, y) = (f64::from(wheel.x), f64::from(wheel.y));
            let radius = f64::from(wheel.radius);
            let (sin, cos) = f64::from(mount.heading).sin_cos();
            wheels.push(Wheel {
                x: f64::from(mount.x) + cos * x - sin * y,
                y: f64::from(mount.y) + sin * x + cos * y,
                theta: f64::from(mount.heading),
                diameter: 2.0 * radius,
                width: 2.0 * radius * WIDTH_SHARE,
            });
        }
    }
    let limits = &group.limits;
    Physics {
        series: group.name.clone(),
        speed: f64::from(limits.linear_speed),
        turn: f64::from(limits.yaw_rate),
        acceleration: f64::from(limits.linear_acceleration),
        outline: outline(&wheels),
        wheels,
    }
}

fn outline(wheels: &[Wheel]) -> Vec<[f64; 2]> {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for wheel in wheels {
        let (sin, cos) = wheel.theta.sin_cos();
        let (along, across) = (0.5 * wheel.diameter, 0.5 * wheel.width);
        let half = [
            (cos * along).abs() + (sin * across).abs(),
            (sin * along).abs() + (cos * across).abs(),
        ];
        for (axis, place) in [wheel.x, wheel.y].into_iter().enumerate() {
            low[axis] = low[axis].min(place - half[axis]);
            high[axis] = high[axis].max(place + half[axis]);
        }
    }
    vec![high, [low[0], high[1]], low, [high[0], low[1]]]
}
