//! One frame for the poses of all members.
//!
//! Every member reports the pose of the *group*, added up from its own wheels since it was
//! configured. A robot that lost its power starts again at zero while the others go on, so the mean
//! of what they report is no place at all. Here each member's poses are taken relative to its own
//! first one and set on a common place: that of the first member, and when the group is started
//! again the mean of where its members were. From then on they agree but for their slip.
//!
//! A pose that is further from the one before than a robot can go in the time between them is a
//! jump: the robot was reset. Its poses go on from where it was, and the caller is notified.

use kinematics::Pose;

use super::average::mean_pose;

/// Faster than this goes no robot, m/s and rad/s. A jump is beyond it by at least [`LEAST`].
const FASTEST: f32 = 10.0;
/// m and rad.
const LEAST: f32 = 0.1;

/// One member in the common frame.
#[derive(Clone, Copy, Debug)]
struct Member {
    /// The member's own frame, seen from the common one.
    frame: Pose,
    /// Its last pose, common frame.
    last: Pose,
    /// When it reported that, s.
    t: f64,
}

/// The common frame of the members of a group.
#[derive(Clone, Debug, Default)]
pub(crate) struct CommonFrame {
    members: Vec<Option<Member>>,
    /// Where members are set whose first pose comes.
    place: Option<Pose>,
}

/// A pose in the common frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placed {
    /// m, m, rad.
    pub pose: Pose,
    /// The member's own pose does not follow from its last one.
    pub jumped: bool,
}

impl CommonFrame {
    /// Sets all members on one place again, the mean of where they are.
    pub fn gather(&mut self) {
        let last = self.members.iter().flatten().map(|member| member.last);
        self.place = mean_pose(last).or(self.place);
        self.members.clear();
    }

    /// Takes in what member number `index` reported at `t` s.
    pub fn place(&mut self, index: usize, t: f64, own: Pose) -> Placed {
        if self.members.len() <= index {
            self.members.resize(index + 1, None);
        }
        let known = self.members.get(index).copied().flatten();
        let placed = known.map(|member| (member, member.frame.compose(own)));
        let follows = |(member, pose): (Member, Pose)| {
            let (sin, cos) = (pose.heading - member.last.heading).sin_cos();
            let turned = sin.atan2(cos).abs();
            let way = (pose.x - member.last.x).hypot(pose.y - member.last.y);
            let most = LEAST + FASTEST * (t - member.t).max(0.0) as f32;
            way <= most && turned <= most
        };
        let (frame, pose, jumped) = match placed {
            Some(placed) if follows(placed) => (placed.0.frame, placed.1, false),
            _ => {
                // The first pose of all is where its robot says it is.
                let place = *self.place.get_or_insert(own);
                let at = known.map_or(place, |member| member.last);
                (at.compose(inverse(own)), at, known.is_some())
            }
        };
        let member = Member {
            frame,
            last: pose,
            t,
        };
        if let Some(slot) = self.members.get_mut(index) {
            *slot = Some(member);
        }
        Placed { pose, jumped }
    }
}

/// The origin as seen from a pose.
fn inverse(pose: Pose) -> Pose {
    let (sin, cos) = pose.heading.sin_cos();
    Pose {
        x: -cos * pose.x - sin * pose.y,
        y: sin * pose.x - cos * pose.y,
        heading: -pose.heading,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::FRAC_PI_2;

    fn near(a: Pose, b: Pose) {
        let far = (a.x - b.x).hypot(a.y - b.y) + (a.heading - b.heading).abs();
        assert!(far < 1e-5, "{a:?} {b:?}");
    }

    /// One robot has turned by a right angle since it was configured, the other starts again: ahead
    /// of the group is +y for the first and +x for the second.
    #[test]
    fn members_agree_after_one_of_them_began_anew() {
        let mut frame = CommonFrame::default();
        frame.place(0, 0.0, Pose::new(2.0, 1.0, FRAC_PI_2));
        frame.place(1, 0.0, Pose::new(0.0, 0.0, 0.0));
        let first = frame.place(0, 1.0, Pose::new(2.0, 1.5, FRAC_PI_2));
        let second = frame.place(1, 1.0, Pose::new(0.5, 0.0, 0.0));
        assert!(!first.jumped && !second.jumped);
        near(first.pose, Pose::new(2.0, 1.5, FRAC_PI_2));
        near(second.pose, first.pose);
    }

    #[test]
    fn a_reset_is_a_jump_and_the_way_goes_on() {
        let mut frame = CommonFrame::default();
        frame.place(0, 0.0, Pose::new(0.0, 0.0, 0.0));
        frame.place(0, 1.0, Pose::new(3.0, 0.0, 0.2));
        let reset = frame.place(0, 1.01, Pose::new(0.0, 0.0, 0.0));
        assert!(reset.jumped);
        near(reset.pose, Pose::new(3.0, 0.0, 0.2));
        let on = frame.place(0, 1.02, Pose::new(0.01, 0.0, 0.0));
        assert!(!on.jumped);
        near(
            on.pose,
            Pose::new(3.0 + 0.01 * 0.2_f32.cos(), 0.01 * 0.2_f32.sin(), 0.2),
        );
    }

    #[test]
    fn gathered_members_stand_where_their_mean_was() {
        let mut frame = CommonFrame::default();
        for (index, x) in [1.0, 1.2].into_iter().enumerate() {
            frame.place(index, 0.0, Pose::new(0.0, 0.0, 0.0));
            frame.place(index, 1.0, Pose::new(x, 0.0, 0.0));
        }
        frame.gather();
        for index in 0..2 {
            near(
                frame.place(index, 2.0, Pose::new(7.0, 7.0, 1.0)).pose,
                Pose::new(1.1, 0.0, 0.0),
            );
        }
    }
}
