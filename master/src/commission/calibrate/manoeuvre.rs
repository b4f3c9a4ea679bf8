//! The motions that show the loss by slip: along each axis, obliquely and turning, there and back,
//! at several speeds.
//!
//! Each goes from rest to rest over whole passages of a roller of every wheel, so that the ripple
//! of the rollers does not count as loss. Oblique motions are at atan(3/5) to an axis, where the
//! slow wheels turn a quarter as fast as the others. At 45 degrees two wheels would stand, and the
//! loss would depend on the points of their rollers on which they stand.
//!
//! A robot whose contacts reach their limit in a ramp loses some millimetres there, independently
//! of the distance. So ramps are gentle, and the distance at full speed is at least that of both
//! ramps; fast motions therefore need more room than slow ones.

use std::f64::consts::TAU;

use group::{GroupFile, Robot};
use kinematics::trajectory::{Line, Turn};
use kinematics::{MemberKinematics, Mount, Pose, Twist, VelocityCompensation, Wheel, WheelRates};

use serde::{Deserialize, Serialize};

use crate::path::curve::Motion;
use crate::path::curve::Plan;

/// Shortest ramp, s.
const RAMP: f64 = 0.5;
/// How long the group stands before poses are read, s.
pub(super) const SETTLE: f64 = 0.3;
/// How long they are averaged, s.
pub(super) const AVERAGE: f64 = 0.3;
/// Share of the acceleration limit that ramps use on average; at their steepest it is half as much
/// again.
const ACCELERATION: f64 = 0.25;
/// Least length of a motion, in ramps; one of them is spent on both ramps together.
const RAMPS: f64 = 2.0;
/// Slower than this share of the fastest a wheel counts as standing.
const STANDING: f64 = 0.01;

/// What a motion shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Way {
    /// Longitudinal.
    Ahead,
    /// Lateral.
    Aside,
    /// Both at once.
    Oblique,
    /// On the spot.
    Turn,
}

impl Way {
    /// What people call it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ahead => "ahead",
            Self::Aside => "sideways",
            Self::Oblique => "oblique",
            Self::Turn => "turning",
        }
    }

    /// Unit of its speed.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Turn => "rad/s",
            _ => "m/s",
        }
    }
}

/// Which motions.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Speeds, rising, m/s.
    pub speeds: Vec<f64>,
    /// Yaw rates, rising, rad/s.
    pub rates: Vec<f64>,
    /// How far at least, m; a wheel's way on the floor where the group turns.
    pub distance: f64,
    /// How often each is driven each way.
    pub repeats: u32,
    /// Number of rollers of a wheel; needed if the group file does not give it.
    pub rollers: u8,
    /// Whether the lag of the contacts is measured, too.
    pub lag: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            speeds: vec![0.1, 0.25, 0.5],
            rates: vec![0.25, 0.5],
            distance: 1.0,
            repeats: 2,
            rollers: 8,
            lag: false,
        }
    }
}

impl Settings {
    /// Without what is beyond the limits of a group.
    #[must_use]
    pub fn within(mut self, limits: &group::Limits) -> Self {
        self.speeds.retain(|v| *v <= f64::from(limits.linear_speed));
        self.rates.retain(|w| *w <= f64::from(limits.yaw_rate));
        self
    }
}

/// One motion, in the frame of the robots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Manoeuvre {
    /// What it shows.
    pub way: Way,
    /// How fast, m/s or rad/s.
    pub speed: f64,
    /// Its twist at full speed.
    pub twist: Twist<f64>,
    /// How long each of its ramps takes, s.
    ramp: f64,
    /// How long it would take without ramps, s.
    pub seconds: f64,
}

impl Manoeuvre {
    fn new(way: Way, speed: f64, twist: Twist<f64>, file: &GroupFile, settings: &Settings) -> Self {
        let mut lever = 1.0;
        let mut passage = f64::INFINITY;
        if let Some(robot) = file.robots.first() {
            if way == Way::Turn {
                let corner = |wheel: group::Wheel| f64::from(wheel.x.abs() + wheel.y.abs());
                lever = robot.each_wheel().map(corner).into_iter().sum::<f64>() / 4.0;
            }
            let count = robot.rollers.map_or(settings.rollers, |r| r.count).max(1);
            if let Some(slowest) = slowest(robot, twist) {
                passage = TAU / f64::from(count) / slowest;
            }
        }
        let least = settings.distance / (speed * lever);
        let least = least.max(RAMPS * ramp(way, speed, file));
        let seconds = if passage.is_finite() {
            (least / passage).ceil() * passage
        } else {
            least
        };
        Self {
            way,
            speed,
            twist,
            ramp: ramp(way, speed, file),
            seconds,
        }
    }

    /// How long it takes with its ramps and the rest before and after, s.
    #[must_use]
    pub fn lasts(&self) -> f64 {
        self.seconds + self.ramp + 2.0 * (SETTLE + AVERAGE)
    }

    /// Where it leads, in the frame of the robots: m, m, rad.
    #[must_use]
    pub fn displacement(&self) -> [f64; 3] {
        [self.twist.vx, self.twist.vy, self.twist.omega].map(|v| v * self.seconds)
    }

    /// The motion of a group in whose frame the robots face `heading`.
    #[must_use]
    pub fn plan(&self, heading: f64) -> Plan {
        let Twist { vx, vy, omega } = self.twist;
        let duration = self.seconds;
        let motion = if self.way == Way::Turn {
            Motion(Box::new(Turn { omega, duration }))
        } else {
            let (sin, cos) = heading.sin_cos();
            let (vx, vy) = (cos * vx - sin * vy, sin * vx + cos * vy);
            Motion(Box::new(Line { vx, vy, duration }))
        };
        Plan::new(
            format!("calibration {}", self.way.name()),
            motion,
            self.ramp,
        )
    }
}

/// How long a ramp to this speed takes, s.
fn ramp(way: Way, speed: f64, file: &GroupFile) -> f64 {
    let steepest = match way {
        Way::Turn => file.limits.yaw_acceleration,
        _ => file.limits.linear_acceleration,
    };
    (speed / (ACCELERATION * f64::from(steepest))).max(RAMP)
}

/// Rate of the slowest wheel that turns, rad/s.
fn slowest(robot: &Robot, twist: Twist<f64>) -> Option<f64> {
    let one = |wheel: group::Wheel| {
        let angle = f64::from(wheel.roller_angle);
        let wheel = Wheel::new(
            wheel.x.into(),
            wheel.y.into(),
            0.0,
            angle,
            wheel.radius.into(),
        );
        wheel.ok()
    };
    let [a, b, c, d] = robot.each_wheel();
    let wheels = [one(a)?, one(b)?, one(c)?, one(d)?];
    let here = Mount::new(Pose::new(0.0, 0.0, 0.0)).ok()?;
    let none = VelocityCompensation::new(1.0, 1.0, 1.0).ok()?;
    let wheels = MemberKinematics::from_wheels(&wheels, &here, &none).ok()?;
    let rates: [f64; 4] = WheelRates::into(wheels.inverse(twist));
    let rates = rates.map(f64::abs);
    let fastest = rates.iter().copied().fold(0.0, f64::max);
    let turning = rates.into_iter().filter(|rate| *rate > STANDING * fastest);
    turning.min_by(f64::total_cmp)
}

/// The straight motions: every speed along the axes, the slowest and the fastest obliquely.
#[must_use]
pub fn straight(file: &GroupFile, settings: &Settings) -> Vec<Manoeuvre> {
    let mut out = Vec::new();
    let ends = [settings.speeds.first(), settings.speeds.last()];
    let slope = 0.6_f64.atan();
    for speed in &settings.speeds {
        for (way, angle) in [(Way::Ahead, 0.0), (Way::Aside, TAU / 4.0)] {
            both_ways(&mut out, file, settings, (way, *speed, angle));
        }
        if ends.contains(&Some(speed)) {
            for angle in [slope, TAU / 4.0 - slope, TAU / 4.0 + slope, -slope] {
                both_ways(&mut out, file, settings, (Way::Oblique, *speed, angle));
            }
        }
    }
    out
}

fn both_ways(
    out: &mut Vec<Manoeuvre>,
    file: &GroupFile,
    settings: &Settings,
    (way, speed, angle): (Way, f64, f64),
) {
    // Exactly along the axes, whatever the sine of a right angle is.
    let round = |v: f64| if v.abs() < 1e-12 { 0.0 } else { v };
    let (sin, cos) = angle.sin_cos();
    let twist = Twist::new(round(cos), round(sin), 0.0) * speed;
    for _ in 0..settings.repeats {
        for sign in [1.0, -1.0] {
            out.push(Manoeuvre::new(way, speed, twist * sign, file, settings));
        }
    }
}

/// The turns, every rate both ways.
#[must_use]
pub fn turns(file: &GroupFile, settings: &Settings) -> Vec<Manoeuvre> {
    let mut out = Vec::new();
    for rate in &settings.rates {
        for _ in 0..settings.repeats {
            for omega in [*rate, -rate] {
                let twist = Twist::new(0.0, 0.0, omega);
                out.push(Manoeuvre::new(Way::Turn, *rate, twist, file, settings));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_motion_is_whole_passages_of_every_wheel() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-2.toml");
        let file = GroupFile::load(path).unwrap();
        let settings = Settings::default();
        let radius = f64::from(file.robots[0].geometry.wheel_radius());
        let arms = f64::from(file.robots[0].geometry.half_track())
            + f64::from(file.robots[0].geometry.half_wheelbase());
        let mut all = straight(&file, &settings);
        all.extend(turns(&file, &settings));
        // Three speeds and two of them in four oblique directions, two rates; twice, both ways.
        assert_eq!(all.len(), (3 * 2 + 2 * 4 + 2) * 4);
        for manoeuvre in all {
            let [x, y, turn] = manoeuvre.displacement();
            // Equation of a wheel with rollers at 45 degrees: (x -+ y -+ (l + w) turn) / r.
            for way in [
                x - y - arms * turn,
                x + y + arms * turn,
                x + y - arms * turn,
                x - y + arms * turn,
            ] {
                let passages = way / radius / (TAU / 8.0);
                let off = (passages - passages.round()).abs();
                assert!(off < 1e-4, "{manoeuvre:?}: {passages} passages");
            }
            assert!(x.hypot(y).max(arms * turn.abs()) >= 0.999 * settings.distance);
        }
    }
}
