//! The extra wheel motion that is needed because rollers meet the floor at rest.
//!
//! A roller in the air hardly turns. When it comes down, the floor brings it up to the speed `c`
//! across its axle, and what that takes, `m c` for a roller whose inertia counts as `m` at the
//! floor, the robot loses. It happens `n |rate| / (2 pi)` times a second at every wheel, so the
//! mean force of a wheel is in proportion to `|rate| c`, across its roller's axle. Rubber creeps in
//! proportion to force: the group moves slower by the velocity at which the creep along all axles
//! makes up for it. That grows with the square of the speed, and on slanting ways, where the wheels
//! of one diagonal turn faster than those of the other, it pushes the group ahead. Constant
//! coefficients cannot say either.
//!
//! One number tells how large it is: the share of its speed that a robot loses sideways, over that
//! speed ([`group::GroupFile::hand_over_loss`], s/m).

use group::GroupFile;
use kinematics::Twist;
use nalgebra::{Matrix3, Vector3};

/// Wheels of a robot: ahead, left, and the hand of its rollers, +1 on the diagonal front left to
/// rear right.
const CORNERS: [(f64, f64, f64); 4] = [
    (1.0, 1.0, 1.0),
    (1.0, -1.0, -1.0),
    (-1.0, 1.0, -1.0),
    (-1.0, -1.0, 1.0),
];

/// What has to be asked for beside a twist so that a group moves with it, group frame; zero where
/// the file says that nothing is lost.
#[must_use]
pub fn lost(file: &GroupFile, twist: Twist) -> Twist {
    if file.hand_over_loss == 0.0 {
        return Twist::ZERO;
    }
    let loss = f64::from(file.hand_over_loss);
    let [vx, vy, omega] = [twist.vx, twist.vy, twist.omega].map(f64::from);
    let mut creep = Matrix3::zeros();
    let mut force = Vector3::zeros();
    for robot in &file.robots {
        let geometry = &robot.geometry;
        let (half_track, half_wheelbase) = (
            f64::from(geometry.half_track()),
            f64::from(geometry.half_wheelbase()),
        );
        let (along_x, along_y) = libm::sincos(f64::from(geometry.roller_angle()));
        let (sin, cos) = libm::sincos(f64::from(robot.mount.heading));
        let (mount_x, mount_y) = (f64::from(robot.mount.x), f64::from(robot.mount.y));
        for (ahead, left, hand) in CORNERS {
            let (ahead, left) = (ahead * half_wheelbase, left * half_track);
            let x = mount_x + cos * ahead - sin * left;
            let y = mount_y + sin * ahead + cos * left;
            // A direction of the robot, and its moment arm.
            let row = |ahead: f64, left: f64| {
                let (dx, dy) = (cos * ahead - sin * left, sin * ahead + cos * left);
                Vector3::new(dx, dy, x * dy - y * dx)
            };
            let along = row(along_x, -hand * along_y);
            let across = row(hand * along_y, along_x);
            let (dx, dy) = (vx - omega * y, vy + omega * x);
            let (ahead, left) = (cos * dx + sin * dy, cos * dy - sin * dx);
            // The wheel rolls such that nothing slips along the axle.
            let surface = ahead - hand * left * along_y / along_x;
            let spin = left / along_x;
            // The product is the robot's own sideways loss at 1 m/s, where all four wheels do the
            // same.
            let strength = loss * along_x * along_y;
            creep += along * along.transpose();
            force += across * (strength * surface.abs() * spin);
        }
    }
    let Some(solved) = creep.cholesky().map(|creep| creep.solve(&force)) else {
        return Twist::ZERO;
    };
    #[expect(
        clippy::cast_possible_truncation,
        reason = "thousandths of a twist, which is f32"
    )]
    Twist::new(solved.x as f32, solved.y as f32, solved.z as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(loss: f32) -> GroupFile {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
        let mut file = GroupFile::load(path).unwrap();
        file.hand_over_loss = loss;
        file
    }

    fn near(a: f32, b: f32) -> bool {
        (a - b).abs() < 1e-6
    }

    /// By definition: at 0.5 m/s sideways 0.002 s/m are 0.001 of 0.5 m/s. Ahead no roller turns.
    #[test]
    fn sideways_it_is_what_the_number_says() {
        let more = lost(&group(0.002), Twist::new(0.0, -0.5, 0.0));
        assert!(near(more.vy, -0.0005) && near(more.vx, 0.0) && near(more.omega, 0.0));
        assert_eq!(lost(&group(0.002), Twist::new(0.5, 0.0, 0.0)), Twist::ZERO);
        assert_eq!(lost(&group(0.0), Twist::new(0.1, 0.5, 0.2)), Twist::ZERO);
    }

    /// At 45 degrees to the left the wheels of one diagonal turn with twice `v` and those of the
    /// other stand. With `c = sqrt(2) v` and both axles at 45 degrees, `v^2` times the number are
    /// lost sideways and won ahead.
    #[test]
    fn on_a_slant_it_pushes_ahead() {
        let v = 0.3;
        let more = lost(&group(0.002), Twist::new(v, v, 0.0));
        let square = 0.002 * v * v;
        assert!(near(more.vy, square), "{more:?}");
        assert!(near(more.vx, -square), "{more:?}");
    }

    /// Nothing depends on where the group frame lies: the same robots seen from a quarter turn.
    #[test]
    fn it_turns_with_the_group() {
        let file = group(0.002);
        let mut turned = file.clone();
        for robot in &mut turned.robots {
            let mount = robot.mount;
            robot.mount.x = -mount.y;
            robot.mount.y = mount.x;
            robot.mount.heading += std::f32::consts::FRAC_PI_2;
        }
        let a = lost(&file, Twist::new(0.2, 0.3, 0.4));
        let b = lost(&turned, Twist::new(-0.3, 0.2, 0.4));
        assert!(near(a.vx, b.vy) && near(a.vy, -b.vx) && near(a.omega, b.omega));
        assert!(a.vy > 1e-5, "{a:?}");
    }
}
