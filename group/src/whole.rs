//! Rules about the group as a whole: what robots would refuse once everything is worked out, robots
//! that stand in each other's way, and what the file allows and can hardly mean.

use kinematics::Twist;
use protocol::address::{self, Address, motor};
use protocol::timing::{BIT_RATE, votes_known_us};
use robot::configuration::{RAMP_GRACE, of_values};
use robot::{ConfigurationError, Hardware};
use toml::de::{DeTable, DeValue};

use crate::check::Checker;
use crate::declaration::real;
use crate::model::{Board, GroupFile, Robot, Wheel};
use crate::number::rounded;
use crate::parameters::{ROOM, agreement_delay_us, parameters};

/// Angles in degrees up to this many times an eighth of a turn in radians are checked.
const EIGHTHS: i32 = 8;

/// Largest acceleration feedforward of a robot in fixed point, V s^2/rad: 8, which has no number
/// itself, less one step of an `f32` (docs/numbers.md).
const FIXED_POINT_FEEDFORWARD: f64 = 7.999_999_5;

/// Where a key stands in the tree; the start of the file if it is left out.
pub(crate) fn place(tree: &DeTable<'_>, path: &[&str]) -> usize {
    let mut table = tree;
    for (n, key) in path.iter().enumerate() {
        let Some(value) = table.get(*key) else {
            return 0;
        };
        match value.get_ref() {
            DeValue::Table(inner) if n + 1 < path.len() => table = inner,
            _ => return value.span().start,
        }
    }
    0
}

pub(crate) fn entry(tree: &DeTable<'_>, index: usize) -> usize {
    let list = tree
        .get("robots")
        .and_then(|value| value.get_ref().as_array());
    let entry = list.and_then(|list| list.get(index));
    entry.map_or(0, |entry| entry.span().start)
}

impl Checker<'_> {
    /// Reports what is worked out of several keys, such as a motor's volts per speed, where a robot
    /// would refuse it. Keys of the file have been checked already.
    pub fn parameters_in_limits(&self, group: &GroupFile, tree: &DeTable<'_>) {
        for (index, robot) in group.robots.iter().enumerate() {
            for (address, value) in parameters(group, robot, true) {
                let Some(object) = protocol::OBJECTS.iter().find(|o| o.address == address) else {
                    continue;
                };
                let is_allowed = value.check(object.min, object.max).is_ok();
                let (Some(value), Some(min), Some(max)) =
                    (real(value), real(object.min), real(object.max))
                else {
                    continue;
                };
                let of =
                    |parameter: fn(u16) -> Address| (0..4).any(|wheel| parameter(wheel) == address);
                let max = if robot.board == Board::KitF103rc && of(motor::acceleration) {
                    FIXED_POINT_FEEDFORWARD
                } else {
                    max
                };
                if is_allowed && value <= max {
                    continue;
                }
                let (field, remedy) = if of(motor::acceleration) {
                    (
                        "motor.inertia",
                        "lower it or `motor.resistance`, or fix `motor.constant`",
                    )
                } else if of(motor::proportional) {
                    (
                        "control.proportional",
                        "lower it: it counts times `motor.supply`",
                    )
                } else if of(motor::integral) {
                    (
                        "control.integral",
                        "lower it: it counts times `motor.supply`",
                    )
                } else if of(motor::speed) || of(motor::static_friction) {
                    ("motor", "fix the values of `motor`")
                } else {
                    ("wheels", "fix this entry")
                };
                let problem = format!(
                    "gives {} ({address}) = {}, which {} from {min} to {} {}",
                    object.name,
                    rounded(value),
                    if is_allowed {
                        "a `kit-f103rc` accepts"
                    } else {
                        "robots accept"
                    },
                    rounded(max),
                    object.unit,
                );
                let field = format!("robots[{index}].{field}");
                self.report(entry(tree, index), &field, problem.trim_end(), remedy);
            }
        }
    }

    /// Reports a period in which the robots have no time to agree.
    pub fn votes_fit(&self, group: &GroupFile, tree: &DeTable<'_>) {
        if agreement_delay_us(group) > 0 {
            return;
        }
        let highest = group.robots.iter().map(|robot| robot.node).max();
        let known = votes_known_us(highest.unwrap_or_default().into(), BIT_RATE);
        let problem = format!(
            "is {} ms, but the votes of robots up to node {} take {:.2} ms after SYNC",
            group.sync_period_us / 1_000,
            highest.unwrap_or_default(),
            f64::from(known) * 1e-3,
        );
        let remedy = "give a longer period, or the robots lower nodes";
        let at = place(tree, &["sync_period_ms"]);
        self.report(at, "sync_period_ms", &problem, remedy);
    }

    /// Reports robots that stand on the same floor.
    pub fn overlaps(&self, group: &GroupFile, tree: &DeTable<'_>) {
        for (index, robot) in group.robots.iter().enumerate() {
            let other = group
                .robots
                .iter()
                .take(index)
                .position(|other| overlap(robot, other));
            if let Some(other) = other {
                let distance = (robot.mount.x - group.robots[other].mount.x)
                    .hypot(robot.mount.y - group.robots[other].mount.y);
                let problem =
                    format!("its wheels overlap those of robots[{other}], {distance:.3} m away",);
                let remedy = "fix x, y and heading_deg, or the dimensions";
                self.report(
                    entry(tree, index),
                    &format!("robots[{index}]"),
                    &problem,
                    remedy,
                );
            }
        }
    }

    /// Reports what a robot would refuse when it has everything, by the robot's own rule, and
    /// mentions speeds that its wheels cannot give.
    pub fn robots_accept(&self, group: &GroupFile, tree: &DeTable<'_>) {
        let mut slowest = Slowest::NONE;
        for (index, robot) in group.robots.iter().enumerate() {
            // What an identified robot keeps is not in the file. It accepted that, so the file's
            // own motors stand for it.
            let mut whole = robot.clone();
            whole.control.identified = false;
            let hardware = Hardware {
                // Which drives a board can have is checked with its keys.
                output_stages: u8::MAX,
                ..robot.board.hardware()
            };
            match of_values(parameters(group, &whole, true), robot.node, hardware) {
                Ok(configuration) => {
                    let fastest = |unit| configuration.drivetrain.fastest(unit).into();
                    slowest.add(robot, fastest);
                }
                Err(error) => self.refused(error, group, index, tree),
            }
        }
        let limits = &group.limits;
        let (linear, yaw) = (limits.linear_speed, limits.yaw_rate);
        for (key, limit, (reached, node), unit, moves) in [
            (
                "linear_speed",
                linear,
                slowest.linear,
                "m/s in every direction",
                "moves",
            ),
            ("yaw_rate", yaw, slowest.turning, "rad/s", "turns"),
        ] {
            if limit > reached {
                let own = unit.split(' ').next().unwrap_or_default();
                let problem = format!(
                    "is {limit} {own}, but the wheels of node {node} reach only {reached:.2} {unit}"
                );
                let remedy = format!("lower it, or the group {moves} slower than commanded");
                let at = place(tree, &["limits", key]);
                self.warn(at, &format!("limits.{key}"), &problem, &remedy);
            }
        }
    }

    /// Reports what a robot refuses.
    fn refused(
        &self,
        error: ConfigurationError,
        group: &GroupFile,
        index: usize,
        tree: &DeTable<'_>,
    ) {
        let node = group.robots[index].node;
        let address = match error {
            ConfigurationError::Missing(address) | ConfigurationError::Inconsistent(address) => {
                address
            }
        };
        let limits = &group.limits;
        let (key, value, speed) = match address {
            address::DECELERATION => (
                "linear_acceleration",
                limits.linear_acceleration,
                "linear_speed",
            ),
            address::DECELERATION_YAW => ("yaw_acceleration", limits.yaw_acceleration, "yaw_rate"),
            _ => {
                let object = protocol::OBJECTS.iter().find(|o| o.address == address);
                let name = object.map_or("an object", |object| object.name);
                let values = parameters(group, &group.robots[index], true);
                let value = values.iter().find(|(written, _)| *written == address);
                let value = value.and_then(|(_, value)| real(*value));
                let value =
                    value.map_or_else(String::new, |value| format!(" = {}", rounded(value)));
                let problem = format!(
                    "gives {name} ({address}){value}, which robots refuse beside the rest of it"
                );
                let remedy = format!("docs/can-protocol.md says at {address} what it has to fit");
                self.report(
                    entry(tree, index),
                    &format!("robots[{index}]"),
                    &problem,
                    &remedy,
                );
                return;
            }
        };
        let problem = format!(
            "is {value}: node {node} would not stand within {RAMP_GRACE} s from the fastest that \
             its wheels and {ROOM} times limits.{speed} allow"
        );
        let remedy = format!("raise it, or lower limits.{speed}");
        let at = place(tree, &["limits", key]);
        self.report(at, &format!("limits.{key}"), &problem, &remedy);
    }

    /// Mentions headings in degrees that would be a round number of eighths of a turn in radians.
    pub fn suspicious_angles(&self, tree: &DeTable<'_>) {
        let list = tree
            .get("robots")
            .and_then(|value| value.get_ref().as_array());
        for (index, entry) in list.into_iter().flatten().enumerate() {
            let heading = entry
                .get_ref()
                .as_table()
                .and_then(|t| t.get("heading_deg"));
            let Some((value, heading)) = heading.and_then(|raw| {
                let number = raw.get_ref().as_float()?.as_str().parse::<f64>().ok()?;
                Some((number, raw))
            }) else {
                continue;
            };
            let eighths = value / std::f64::consts::FRAC_PI_4;
            let whole = eighths.round();
            if whole != 0.0 && whole.abs() <= f64::from(EIGHTHS) && (eighths - whole).abs() < 2e-3 {
                let problem = format!("is {value} degrees");
                let remedy = format!(
                    "if the value is in radians, write {}",
                    rounded(45.0 * whole)
                );
                let field = format!("robots[{index}].heading_deg");
                self.warn(heading.span().start, &field, &problem, &remedy);
            }
        }
    }
}

/// What the slowest robot of a group can do, and which that is.
struct Slowest {
    /// m/s, in every direction.
    linear: (f32, u8),
    /// rad/s about the group's origin.
    turning: (f32, u8),
}

impl Slowest {
    /// Of no robot.
    const NONE: Self = Self {
        linear: (f32::INFINITY, 0),
        turning: (f32::INFINITY, 0),
    };

    /// One more robot, whose wheels turn at most this fast for a twist, rad/s.
    fn add(&mut self, robot: &Robot, fastest: impl Fn(Twist) -> [f32; 4]) {
        let ahead = fastest(Twist::new(1.0, 0.0, 0.0));
        let left = fastest(Twist::new(0.0, 1.0, 0.0));
        let turn = fastest(Twist::new(0.0, 0.0, 1.0));
        let keep = |known: &mut (f32, u8), rates: [f32; 4]| {
            let fastest = rates.into_iter().map(f32::abs).fold(0.0, f32::max);
            let reached = robot.max_wheel_rate / fastest;
            if reached < known.0 {
                *known = (reached, robot.node);
            }
        };
        // Each wheel in the direction in which it turns fastest.
        let along = [0, 1, 2, 3].map(|wheel: usize| ahead[wheel].hypot(left[wheel]));
        keep(&mut self.linear, along);
        keep(&mut self.turning, turn);
    }
}

/// The corners of the rectangle that the wheels of a robot stand on, in the group frame: from hub
/// to hub aside, and ahead by a radius more.
fn corners(robot: &Robot) -> [(f32, f32); 4] {
    let wheels = robot.each_wheel();
    let low = |of: fn(&Wheel) -> f32| wheels.iter().map(of).fold(f32::INFINITY, f32::min);
    let (behind, ahead) = (low(|w| w.x - w.radius), -low(|w| -w.x - w.radius));
    let (right, left) = (low(|w| w.y), -low(|w| -w.y));
    let (sin, cos) = robot.mount.heading.sin_cos();
    [
        (ahead, left),
        (ahead, right),
        (behind, right),
        (behind, left),
    ]
    .map(|(x, y)| {
        (
            robot.mount.x + x * cos - y * sin,
            robot.mount.y + x * sin + y * cos,
        )
    })
}

/// Whether two rectangles have an area in common: there is no side of either that parts them.
fn overlap(a: &Robot, b: &Robot) -> bool {
    let headings = [a.mount.heading, b.mount.heading];
    let axes = headings.map(|h| [(h.cos(), h.sin()), (-h.sin(), h.cos())]);
    let (a, b) = (corners(a), corners(b));
    axes.iter().flatten().all(|(x, y)| {
        let span = |corners: &[(f32, f32); 4]| {
            let along = corners.map(|(px, py)| px * x + py * y);
            let low = along.iter().copied().fold(f32::INFINITY, f32::min);
            (low, along.iter().copied().fold(f32::NEG_INFINITY, f32::max))
        };
        let (a, b) = (span(&a), span(&b));
        // Robots that touch do not overlap.
        a.0 + 1e-4 < b.1 && b.0 + 1e-4 < a.1
    })
}
