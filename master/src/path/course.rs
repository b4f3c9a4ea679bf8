//! A drive as the user requests it: a curve of the paper or a file, how often, how fast, facing
//! where.
//!
//! A [`Course`] becomes a [`Plan`] in this order: the path; repeated; stretched in time; given its
//! heading; ramped at both ends. So ramps are of the whole drive, and a repeated curve is passed in
//! full motion from one round to the next, which only closed paths can be.

use std::path::PathBuf;

use kinematics::trajectory::{Heading, Trajectory};
use kinematics::{Pose, Twist};

use crate::path::curve::{Beginning, Curve, Motion, Plan, RAMP};
use crate::path::file;

/// Ends of a closed path may be this far apart: m, rad, m/s.
const CLOSED: f64 = 1e-3;
/// Slower than this a path has no direction of travel, in m/s.
const CRAWL: f64 = 0.01;
/// Step at which a path is checked beforehand, in s.
const STEP: f64 = 0.01;

/// The longest drive, in s: a row a period is remembered of it, some 0.3 GB an hour for two robots.
pub const LONGEST: f64 = 3600.0;

/// Where the path comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A curve of the paper.
    Named(Curve),
    /// A CSV file of poses over time.
    File(PathBuf),
}

/// What the heading is measured against.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Frame {
    /// The heading is the path's own plus the offset, in the frame of the path: circles do not turn
    /// the group.
    #[default]
    World,
    /// The heading is the direction of travel plus the offset: the group drives like a car.
    Body,
}

/// A drive as a user says it.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// The path.
    pub shape: Shape,
    /// Time over which it is entered and left, in s.
    pub ramp: f64,
    /// How often.
    pub repeats: u32,
    /// How large, as a multiple of the path's own size.
    pub scale: f64,
    /// Where it begins and which way it is turned, in the frame of the results and of an external
    /// source of poses: m, m, rad. As the path itself says otherwise.
    pub from: Option<Pose<f64>>,
    /// How fast, as a multiple of the path's own speed.
    pub speed: f64,
    /// Heading offset, counter-clockwise, in rad.
    pub heading: f64,
    /// What the heading is measured against.
    pub frame: Frame,
    /// Only the first seconds.
    pub quick: bool,
}

impl Course {
    /// A curve the way the paper drives it.
    #[must_use]
    pub fn of(curve: Curve) -> Self {
        Self {
            shape: Shape::Named(curve),
            ramp: RAMP,
            repeats: 1,
            scale: 1.0,
            from: None,
            speed: 1.0,
            heading: 0.0,
            frame: Frame::World,
            quick: false,
        }
    }

    /// Its name in reports.
    #[must_use]
    pub fn name(&self) -> String {
        match &self.shape {
            Shape::Named(curve) => curve.name().into(),
            Shape::File(path) => {
                let stem = path.file_stem().unwrap_or_default();
                stem.to_string_lossy().into_owned()
            }
        }
    }

    /// Checks the numbers, for which no file has to be read.
    ///
    /// # Errors
    /// When one of them is out of its range.
    pub fn check(&self) -> Result<(), CourseError> {
        for (name, value, low, high) in [
            ("--ramp", self.ramp, 0.1, 60.0),
            ("--scale", self.scale, 0.01, 100.0),
            ("--speed", self.speed, 0.01, 10.0),
            ("--heading", self.heading.to_degrees(), -3600.0, 3600.0),
            ("--repeats", f64::from(self.repeats), 1.0, 1000.0),
        ] {
            if !(low..=high).contains(&value) {
                return Err(CourseError::Number {
                    name,
                    value,
                    low,
                    high,
                });
            }
        }
        Ok(())
    }

    /// The motion from rest to rest.
    ///
    /// # Errors
    /// When a number makes no sense, the file cannot be read, a path that is not closed is to be
    /// repeated, all of it takes longer than [`LONGEST`], or the heading follows a direction of
    /// travel that is not there.
    pub fn plan(&self) -> Result<Plan, CourseError> {
        self.check()?;
        let path: Motion = match &self.shape {
            Shape::Named(curve) => Motion(Box::new(curve.motion())),
            Shape::File(path) => Motion(Box::new(file::read(path)?)),
        };
        let (scale, from) = (self.scale, self.from);
        let path = Motion(Box::new(Placed { path, scale, from }));
        let (name, times) = (self.name(), self.repeats);
        let path = if times > 1 {
            Motion(Box::new(
                Repeated::new(path, times)
                    .ok_or_else(|| CourseError::Open { name: name.clone() })?,
            ))
        } else {
            path
        };
        let rate = self.speed;
        let path = Motion(Box::new(Stretched { path, rate }));
        let seconds = path.duration();
        if seconds > LONGEST {
            return Err(CourseError::Long { name, seconds });
        }
        let offset = self.heading;
        let path = match self.frame {
            Frame::World => Motion(Box::new(Heading {
                path,
                offset,
                rate: 0.0,
            })),
            Frame::Body => {
                if let Some(t) = standstill(&path) {
                    return Err(CourseError::NoDirection { name, t });
                }
                Motion(Box::new(Facing { path, offset }))
            }
        };
        let path = if self.quick {
            Motion(Box::new(Beginning(path)))
        } else {
            path
        };
        Ok(Plan::new(name, path, self.ramp))
    }
}

/// Why a course cannot be driven.
#[derive(Debug, thiserror::Error)]
pub enum CourseError {
    /// A number out of range.
    #[error("{name}: {value} is not between {low} and {high}")]
    Number {
        /// The option.
        name: &'static str,
        /// What it was given.
        value: f64,
        /// Lowest value.
        low: f64,
        /// Highest value.
        high: f64,
    },
    /// The path does not come back to where it began.
    #[error(
        "{name} does not end where and as it begins (within 1 mm, 1 mrad, 1 mm/s), so it cannot \
         be repeated; drive it once"
    )]
    Open {
        /// Name of the path.
        name: String,
    },
    /// It takes too long.
    #[error(
        "{name} takes {seconds:.0} s, and a drive {LONGEST} s at most; give fewer --repeats, a \
         higher --speed, or a path with less time between its rows"
    )]
    Long {
        /// Name of the path.
        name: String,
        /// How long it takes, in s.
        seconds: f64,
    },
    /// There is no direction of travel.
    #[error(
        "{name} stands still at {t:.2} s, so it has no direction of travel there; use --frame \
         world"
    )]
    NoDirection {
        /// Name of the path.
        name: String,
        /// When, in s.
        t: f64,
    },
    /// The file.
    #[error(transparent)]
    File(#[from] file::PathFileError),
}

/// A path in another size, from another place on.
struct Placed {
    path: Motion,
    scale: f64,
    from: Option<Pose<f64>>,
}

impl Trajectory<f64> for Placed {
    fn at(&self, time: f64) -> (Pose<f64>, Twist<f64>) {
        let (pose, twist) = self.path.at(time);
        let scaled =
            |pose: Pose<f64>| Pose::new(self.scale * pose.x, self.scale * pose.y, pose.heading);
        let (pose, twist) = (
            scaled(pose),
            Twist::new(self.scale * twist.vx, self.scale * twist.vy, twist.omega),
        );
        let Some(from) = self.from else {
            return (pose, twist);
        };
        let first = scaled(self.path.at(0.0).0);
        let (sin, cos) = libm::sincos(from.heading);
        let (x, y) = (pose.x - first.x, pose.y - first.y);
        let placed = Pose::new(
            from.x + cos * x - sin * y,
            from.y + sin * x + cos * y,
            from.heading + pose.heading,
        );
        (placed, twist.to_world(from.heading))
    }

    fn duration(&self) -> f64 {
        self.path.duration()
    }
}

/// A closed path, several times.
struct Repeated {
    path: Motion,
    times: u32,
    /// How much the heading gains in one round.
    turn: f64,
}

impl Repeated {
    /// `None` when the path is not closed.
    fn new(path: Motion, times: u32) -> Option<Self> {
        let (from, leaving) = path.at(0.0);
        let (to, arriving) = path.at(path.duration());
        let turn = to.heading - from.heading;
        let off = (turn / std::f64::consts::TAU - (turn / std::f64::consts::TAU).round()).abs();
        let gaps = [
            (to.x - from.x).hypot(to.y - from.y),
            off * std::f64::consts::TAU,
            (arriving.vx - leaving.vx).hypot(arriving.vy - leaving.vy),
            (arriving.omega - leaving.omega).abs(),
        ];
        gaps.iter()
            .all(|gap| *gap < CLOSED)
            .then_some(Self { path, times, turn })
    }
}

impl Trajectory<f64> for Repeated {
    fn at(&self, time: f64) -> (Pose<f64>, Twist<f64>) {
        let once = self.path.duration();
        let round = (time / once).floor().clamp(0.0, f64::from(self.times - 1));
        let (pose, twist) = self.path.at(time - round * once);
        let heading = pose.heading + round * self.turn;
        (Pose::new(pose.x, pose.y, heading), twist)
    }

    fn duration(&self) -> f64 {
        self.path.duration() * f64::from(self.times)
    }
}

/// The same path at another speed.
struct Stretched {
    path: Motion,
    rate: f64,
}

impl Trajectory<f64> for Stretched {
    fn at(&self, time: f64) -> (Pose<f64>, Twist<f64>) {
        let (pose, twist) = self.path.at(time * self.rate);
        (pose, twist * self.rate)
    }

    fn duration(&self) -> f64 {
        self.path.duration() / self.rate
    }
}

/// When a path stands still, if it does.
fn standstill(path: &Motion) -> Option<f64> {
    let mut t = 0.0;
    while t <= path.duration() {
        let (_, twist) = path.at(t);
        if twist.vx.hypot(twist.vy) < CRAWL {
            return Some(t);
        }
        t += STEP;
    }
    None
}

/// The same path, facing the direction of travel.
struct Facing {
    path: Motion,
    offset: f64,
}

impl Trajectory<f64> for Facing {
    fn at(&self, time: f64) -> (Pose<f64>, Twist<f64>) {
        let (pose, twist) = self.path.at(time);
        let along = self.path.acceleration(time);
        let square = twist.vx * twist.vx + twist.vy * twist.vy;
        let omega = (twist.vx * along.ay - twist.vy * along.ax) / square;
        let heading = libm::atan2(twist.vy, twist.vx) + self.offset;
        (
            Pose::new(pose.x, pose.y, heading),
            Twist::new(twist.vx, twist.vy, omega),
        )
    }

    fn duration(&self) -> f64 {
        self.path.duration()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use group::GroupFile;
    use std::f64::consts::{FRAC_PI_2, PI, TAU};

    fn course(curve: Curve) -> Course {
        Course::of(curve)
    }

    #[test]
    fn a_path_of_another_size_and_place_is_the_same_path() {
        let plan = |scale, from| {
            let course = Course {
                scale,
                from,
                ..Course::of(Curve::Circle)
            };
            course.plan().unwrap()
        };
        let from = Pose::new(3.0, -2.0, std::f64::consts::FRAC_PI_2);
        let (whole, small) = (plan(1.0, None), plan(0.2, Some(from)));
        assert_eq!(small.duration(), whole.duration());
        let (first, start) = (whole.start(), small.start());
        assert!((start.x - 3.0).hypot(start.y + 2.0) < 1e-12);
        for t in [2.0, 5.0, 11.0] {
            let (a, b) = (whole.at(t), small.at(t));
            // A fifth of the way, turned left by a right angle.
            let (x, y) = (a.0.x - first.x as f32, a.0.y - first.y as f32);
            assert!((b.0.x - 3.0 + 0.2 * y).abs() < 1e-5);
            assert!((b.0.y + 2.0 - 0.2 * x).abs() < 1e-5);
            assert!((b.1.vx + 0.2 * a.1.vy).abs() < 1e-6 && (b.1.vy - 0.2 * a.1.vx).abs() < 1e-6);
        }
        // A robot of 0.5 m/s drives a circle of its size.
        let slow = GroupFile::load(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../groups/single.toml"
        ));
        let mut limits = slow.unwrap().limits;
        limits.linear_speed = 0.5;
        assert!(whole.check(&limits).is_err());
        small.check(&limits).unwrap();
    }

    #[test]
    fn a_circle_three_times_is_three_times_as_long_without_a_stop() {
        let plan = Course {
            repeats: 3,
            ..course(Curve::Circle)
        };
        let plan = plan.plan().unwrap();
        // 20 s a round, and half of each 2 s ramp on top.
        assert!((plan.duration() - 62.0).abs() < 1e-9);
        // 1 s into the ramp's end, then two whole rounds later: the same place and speed.
        let ((a, v), (b, w)) = (plan.at(5.0), plan.at(45.0));
        assert!((a.x - b.x).abs() < 1e-5 && (a.y - b.y).abs() < 1e-5);
        assert!((v.vx - w.vx).abs() < 1e-5 && (v.vy - w.vy).abs() < 1e-5);
    }

    #[test]
    fn an_open_path_is_not_repeated() {
        let harmonic = Course {
            repeats: 2,
            ..course(Curve::Harmonic)
        };
        let text = harmonic.plan().err().unwrap().to_string();
        assert!(
            text.contains("harmonic") && text.contains("drive it once"),
            "{text}"
        );
    }

    /// 180 circles of 20 s take an hour, one at a hundredth of its speed 2000 s. Refused at once:
    /// nothing looks for the speed of a path of years.
    #[test]
    fn what_takes_longer_than_an_hour_is_refused() {
        let circles = |repeats, speed| Course {
            repeats,
            speed,
            ..course(Curve::Circle)
        };
        assert!(circles(180, 1.0).plan().is_ok() && circles(1, 0.01).plan().is_ok());
        let text = circles(181, 1.0).plan().unwrap_err().to_string();
        assert!(text.starts_with("circle takes 3620 s, and"), "{text}");
        assert!(circles(2, 0.01).plan().is_err());
        for frame in [Frame::World, Frame::Body] {
            let years = Course {
                frame,
                ..circles(1000, 0.01)
            };
            assert!(matches!(years.plan(), Err(CourseError::Long { .. })));
        }
    }

    #[test]
    fn half_the_speed_takes_twice_the_time() {
        let slow = Course {
            speed: 0.5,
            ..course(Curve::Circle)
        };
        let slow = slow.plan().unwrap();
        assert!((slow.duration() - 42.0).abs() < 1e-9);
        let (_, twist) = slow.at(20.0);
        let speed = twist.vx.hypot(twist.vy);
        // 2.5 m at pi/10 rad/s, halved.
        assert!((f64::from(speed) - 2.5 * PI / 20.0).abs() < 1e-6);
    }

    #[test]
    fn in_the_body_frame_the_group_faces_where_it_goes() {
        let car = Course {
            frame: Frame::Body,
            ..course(Curve::Circle)
        };
        let car = car.plan().unwrap();
        for t in [3.0, 8.0, 15.5] {
            let body = car.setpoint(t);
            assert!(
                (body.vx - 2.5 * std::f32::consts::PI / 10.0).abs() < 1e-5,
                "{body:?}"
            );
            assert!(body.vy.abs() < 1e-5, "{body:?}");
            // Clockwise once in 20 s.
            assert!(
                (body.omega + std::f32::consts::TAU / 20.0).abs() < 1e-4,
                "{body:?}"
            );
        }
        let crab = Course {
            frame: Frame::Body,
            heading: FRAC_PI_2,
            ..course(Curve::Circle)
        };
        assert!(crab.plan().unwrap().setpoint(5.0).vx.abs() < 1e-5);
        let turn = Course {
            frame: Frame::Body,
            ..course(Curve::Turn)
        };
        assert!(turn.plan().is_err(), "turning on the spot goes nowhere");
    }

    #[test]
    fn an_offset_in_the_world_turns_the_setpoint_and_not_the_path() {
        let turned = Course {
            heading: FRAC_PI_2,
            ..course(Curve::Forward)
        };
        let plan = turned.plan().unwrap();
        let (pose, twist) = plan.at(6.0);
        assert!((pose.heading - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
        assert!((twist.vx - 0.5).abs() < 1e-6 && twist.vy.abs() < 1e-6);
        let body = plan.setpoint(6.0);
        assert!(
            body.vx.abs() < 1e-6 && (body.vy + 0.5).abs() < 1e-6,
            "{body:?}"
        );
    }

    #[test]
    fn the_centripetal_circle_winds_on_when_repeated() {
        let twice = Course {
            repeats: 2,
            ..course(Curve::Centripetal)
        };
        let plan = twice.plan().unwrap();
        let (end, _) = plan.at(plan.duration());
        assert!((f64::from(end.heading) + 2.0 * TAU).abs() < 1e-5, "{end:?}");
    }

    #[test]
    fn numbers_out_of_range_are_named() {
        let wrong = Course {
            speed: f64::NAN,
            ..course(Curve::Circle)
        };
        assert!(wrong.plan().err().unwrap().to_string().contains("--speed"));
        // Beyond 8192 rad a sine is no number.
        let wrong = Course {
            heading: 1e4,
            ..course(Curve::Circle)
        };
        assert!(
            wrong
                .plan()
                .err()
                .unwrap()
                .to_string()
                .contains("--heading")
        );
    }
}
