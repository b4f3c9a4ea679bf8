//! Robots that are bolted to one load, and how far they strain it.
//!
//! Each member would move by its own twist. A rigid body can only follow one: the one that comes
//! closest, in the least-squares sense, to the velocities of all wheels' centres. It is found in
//! closed form: with the members' places `p_j`, their velocities `v_j` and yaw rates `w_j` in the
//! group frame and `q_j^2` the mean square of its wheels' distances from its centre,
//! `w = sum((p_j - c) x v_j + q_j^2 w_j) / sum(|p_j - c|^2 + q_j^2)`, and the centre `c` of the
//! members moves with their mean velocity. For wheels of a robot that are not around its centre the
//! weights are as if they were.
//!
//! Strain is measured as a distance: every member's own wheels are also integrated alone, from the
//! pose it started in, and the shape error is how far that has come from the member's place in the
//! body. The body itself never bends.

use kinematics::{Pose, Twist, Wheel};

/// Members and their places.
#[derive(Debug, Clone)]
pub struct Formation {
    members: Vec<Member>,
    /// Mean of the members' places in the group frame.
    centre: (f64, f64),
}

#[derive(Debug, Clone)]
struct Member {
    place: Pose<f64>,
    /// Mean square of the wheels' distances from the member's centre, m².
    spread: f64,
}

impl Formation {
    /// A formation of members with these places in the group frame and these wheels.
    #[must_use]
    pub fn new(members: &[(Pose<f64>, [Wheel<f64>; 4])]) -> Self {
        let count = members.len().max(1) as f64;
        let sum = members
            .iter()
            .fold((0.0, 0.0), |(x, y), (p, _)| (x + p.x, y + p.y));
        Self {
            members: members
                .iter()
                .map(|(place, wheels)| {
                    let square = |wheel: Wheel<f64>| wheel.x().powi(2) + wheel.y().powi(2);
                    let [a, b, c, d] = wheels.map(square);
                    Member {
                        place: *place,
                        spread: ((a + b) + (c + d)) / 4.0,
                    }
                })
                .collect(),
            centre: (sum.0 / count, sum.1 / count),
        }
    }

    /// The members' poses in the world when the group frame has this pose.
    pub fn places(&self, group: Pose<f64>) -> impl Iterator<Item = Pose<f64>> {
        // `Pose::compose`, with one sine and cosine for all of them.
        let (sin, cos) = libm::sincos(group.heading);
        self.members.iter().map(move |Member { place, .. }| Pose {
            x: group.x + cos * place.x - sin * place.y,
            y: group.y + sin * place.x + cos * place.y,
            heading: group.heading + place.heading,
        })
    }

    /// The body's twist, group frame, that fits the members' own twists (each in its own frame)
    /// best.
    #[must_use]
    pub fn fit(&self, twists: &[Twist<f64>]) -> Twist<f64> {
        let mut mean = (0.0, 0.0);
        let (mut moment, mut inertia) = (0.0, 0.0);
        for (member, twist) in self.members.iter().zip(twists) {
            let v = twist.to_world(member.place.heading);
            let (x, y) = (
                member.place.x - self.centre.0,
                member.place.y - self.centre.1,
            );
            mean = (mean.0 + v.vx, mean.1 + v.vy);
            moment += x * v.vy - y * v.vx + member.spread * v.omega;
            inertia += x * x + y * y + member.spread;
        }
        let count = self.members.len().max(1) as f64;
        let omega = if inertia > 0.0 { moment / inertia } else { 0.0 };
        Twist {
            vx: mean.0 / count + omega * self.centre.1,
            vy: mean.1 / count - omega * self.centre.0,
            omega,
        }
    }

    /// The pose of the group frame that fits these poses of the members in the world best.
    #[must_use]
    pub fn fit_poses(&self, poses: &[Pose<f64>]) -> Pose<f64> {
        let count = self.members.len().max(1) as f64;
        let sum = poses
            .iter()
            .fold((0.0, 0.0), |(x, y), p| (x + p.x, y + p.y));
        let centre = (sum.0 / count, sum.1 / count);
        // The mean heading keeps the turns; the fit below only corrects it by less than half a
        // turn.
        let turns = self
            .members
            .iter()
            .zip(poses)
            .map(|(m, p)| p.heading - m.place.heading);
        let guess = turns.sum::<f64>() / count;
        let (mut sine, mut cosine) = (0.0, 0.0);
        for (member, pose) in self.members.iter().zip(poses) {
            let (x, y) = (
                member.place.x - self.centre.0,
                member.place.y - self.centre.1,
            );
            let (u, v) = (pose.x - centre.0, pose.y - centre.1);
            let own = pose.heading - member.place.heading;
            sine += x * v - y * u + member.spread * libm::sin(own);
            cosine += x * u + y * v + member.spread * libm::cos(own);
        }
        let correction = (libm::atan2(sine, cosine) - guess + std::f64::consts::PI)
            .rem_euclid(std::f64::consts::TAU)
            - std::f64::consts::PI;
        let heading = guess + correction;
        let (sin, cos) = libm::sincos(heading);
        Pose {
            x: centre.0 - cos * self.centre.0 + sin * self.centre.1,
            y: centre.1 - sin * self.centre.0 - cos * self.centre.1,
            heading,
        }
    }

    /// Distance of the member that is farthest from its place, mm.
    #[must_use]
    pub fn shape_error_mm(&self, group: Pose<f64>, poses: &[Pose<f64>]) -> f64 {
        let (mut largest, mut square) = (0.0, 0.0);
        for (place, pose) in self.places(group).zip(poses) {
            let (x, y) = (pose.x - place.x, pose.y - place.y);
            // Most are not the largest, which their squares show without a root.
            if x * x + y * y >= square * (1.0 - 1e-9) {
                square = f64::max(square, x * x + y * y);
                largest = f64::max(largest, libm::hypot(x, y) * 1e3);
            }
        }
        largest
    }
}

/// Moves a pose by a twist in its own frame for `dt` (s): an arc, exact while the twist is
/// constant. The heading is not wrapped, so that turns can be counted.
#[must_use]
pub fn advance(pose: Pose<f64>, twist: Twist<f64>, dt: f64) -> Pose<f64> {
    // The chord of an arc points along the heading at its middle and is shorter than it by
    // sin(half) / half; below 1e-4 rad that factor is 1 - half^2/6 to the last bit.
    let half = 0.5 * twist.omega * dt;
    let chord = if half.abs() < 1e-4 {
        1.0 - half * half / 6.0
    } else {
        libm::sin(half) / half
    };
    let moved = twist.to_world(pose.heading + half);
    Pose {
        x: pose.x + moved.vx * dt * chord,
        y: pose.y + moved.vy * dt * chord,
        heading: pose.heading + twist.omega * dt,
    }
}

#[cfg(test)]
mod tests {
    use kinematics::FourWheelGeometry;

    use super::*;

    const NEAR: f64 = 1e-12;

    fn tandem() -> Formation {
        let wheels =
            FourWheelGeometry::new(0.37, 0.35, 0.1524, std::f64::consts::FRAC_PI_4).unwrap();
        let wheels = wheels.wheels().unwrap();
        Formation::new(&[
            (Pose::new(2.0, 0.5, 0.0), wheels),
            (Pose::new(0.0, 0.5, std::f64::consts::FRAC_PI_2), wheels),
        ])
    }

    /// What a rigid body does to its members, computed member by member: velocity of the place plus
    /// yaw.
    fn members_of(body: Twist<f64>, formation: &Formation) -> Vec<Twist<f64>> {
        formation
            .members
            .iter()
            .map(|m| {
                let at_place = Twist {
                    vx: body.vx - body.omega * m.place.y,
                    vy: body.vy + body.omega * m.place.x,
                    omega: body.omega,
                };
                at_place.to_body(m.place.heading)
            })
            .collect()
    }

    #[test]
    fn a_rigid_motion_is_fitted_exactly() {
        let formation = tandem();
        let body = Twist::new(0.3, -0.2, 0.7);
        let fit = formation.fit(&members_of(body, &formation));
        for (a, b) in [
            (fit.vx, body.vx),
            (fit.vy, body.vy),
            (fit.omega, body.omega),
        ] {
            assert!((a - b).abs() < NEAR, "{fit:?}");
        }
    }

    /// Two members 2 m apart; the front one alone goes left at 1 m/s. The mean goes 0.5 m/s, and
    /// with q^2 = 0.37^2 + 0.35^2 the yaw rate is 1 * 1 / (2 * (1 + q^2)).
    #[test]
    fn a_member_that_disagrees_turns_the_body() {
        let fit = tandem().fit(&[Twist::new(0.0, 1.0, 0.0), Twist::new(0.0, 0.0, 0.0)]);
        let omega = 1.0 / (2.0 * (1.0 + 0.37f64.powi(2) + 0.35f64.powi(2)));
        assert!((fit.omega - omega).abs() < NEAR);
        assert!((fit.vy - (0.5 - omega * 1.0)).abs() < NEAR);
        assert!((fit.vx - omega * 0.5).abs() < NEAR);
    }

    #[test]
    fn poses_of_a_rigid_body_give_its_pose_back_turns_included() {
        let formation = tandem();
        let group = Pose::new(1.0, -3.0, 7.5);
        let poses: Vec<_> = formation.places(group).collect();
        let fit = formation.fit_poses(&poses);
        assert!((fit.x - group.x).abs() < NEAR && (fit.y - group.y).abs() < NEAR);
        assert!((fit.heading - group.heading).abs() < NEAR, "{fit:?}");
        assert!(formation.shape_error_mm(fit, &poses) < 1e-9);
    }

    /// Whichever of the two is off by 3 mm and 4 mm, it is 5 mm; the other is off by less, or by
    /// nearly as much.
    #[test]
    fn the_shape_error_is_the_largest() {
        let formation = tandem();
        let group = Pose::new(1.0, -3.0, 0.7);
        for (first, other) in [
            (1.0, 0.5),
            (0.5, 1.0),
            (1.0, 1.0 - 1e-12),
            (1.0 - 1e-12, 1.0),
        ] {
            let off = [first, other].map(|part| (part * 3e-3, part * -4e-3));
            let places = formation.places(group).zip(off);
            let poses: Vec<_> = places
                .map(|(place, (x, y))| Pose::new(place.x + x, place.y + y, place.heading))
                .collect();
            let error = formation.shape_error_mm(group, &poses);
            assert!((error - 5.0).abs() < 1e-9, "{error}");
        }
    }

    /// A quarter turn about a point 1 m to the left.
    #[test]
    fn an_arc_is_exact() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let pose = advance(Pose::new(0.0, 0.0, 0.0), Twist::new(1.0, 0.0, 1.0), quarter);
        assert!(
            (pose.x - 1.0).abs() < NEAR && (pose.y - 1.0).abs() < NEAR,
            "{pose:?}"
        );
        assert!((pose.heading - quarter).abs() < NEAR);
    }
}
