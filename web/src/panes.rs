//! The panes beside the group: the frames as they pass, and the inside of one robot.

use std::collections::{BTreeMap, VecDeque};

use canopen::client;
use omnibus::bus::frame_name::frame_name;
use omnibus::monitor::telemetry::BusFrame;
use protocol::{
    GroupTwist, MeasuredTwist, MemberStatus, PoseReport, WheelRateReport, YawRateReport, cob,
};
use serde_json::{Value, json};
use sim::World;
use sim::robot::LogLine;

/// Frames that a page gets at once: more than its pane has lines.
const FRAMES: usize = 40;
/// Lines kept of each robot's log.
const LINES: usize = 200;
/// Timers of the bridges, and their channels.
const BRIDGE_TIMERS: [usize; 2] = [1, 8];
const CHANNELS: std::ops::RangeInclusive<usize> = 1..=4;

/// The newest frames.
#[derive(Default)]
pub struct FramePane {
    newest: VecDeque<BusFrame>,
    count: u64,
    /// Whether the page looks at them.
    pub shown: bool,
}

impl FramePane {
    /// Takes in a frame.
    pub fn push(&mut self, frame: BusFrame) {
        self.count += 1;
        if self.newest.len() == FRAMES {
            self.newest.pop_front();
        }
        self.newest.push_back(frame);
    }

    /// The frames that came since the last call, the last [`FRAMES`] of them, oldest first; null
    /// while the page does not look.
    pub fn take(&mut self) -> Value {
        let newest = std::mem::take(&mut self.newest);
        if !self.shown {
            return Value::Null;
        }
        let lines = newest.iter().map(|BusFrame { t, frame, .. }| {
            let bytes: Vec<_> = frame.data().iter().map(|b| format!("{b:02X}")).collect();
            json!([
                t,
                format!("{:03X}", frame.id()),
                bytes.join(" "),
                frame_name(frame.id()),
                meaning(frame.id(), frame.data())
            ])
        });
        json!({"count": self.count, "lines": lines.collect::<Vec<_>>()})
    }
}

/// What a frame says, in words; empty where its name says it all.
#[must_use]
pub fn meaning(id: u16, data: &[u8]) -> String {
    if id == cob::GROUP_TWIST {
        return GroupTwist::try_from(data).map_or_else(
            |error| error.to_string(),
            |said| format!("{} number {}", twist(said.twist), said.sequence),
        );
    }
    match (cob::sent(id), data) {
        _ if id == cob::SYNC => data
            .first()
            .map_or_else(String::new, |counter| format!("counter {counter}")),
        (Some((cob::Sent::Status, _)), _) => MemberStatus::try_from(data)
            .map_or_else(|error| error.to_string(), |said| status(&said)),
        (Some((cob::Sent::Measured, _)), _) => MeasuredTwist::try_from(data)
            .map_or_else(|error| error.to_string(), |said| twist(said.twist)),
        (Some((cob::Sent::Pose, _)), _) => PoseReport::try_from(data).map_or_else(
            |error| error.to_string(),
            |PoseReport { pose }| {
                let degrees = pose.heading.to_degrees();
                format!("{:.3} m, {:.3} m, {degrees:.1} deg", pose.x, pose.y)
            },
        ),
        (Some((cob::Sent::WheelRates, _)), _) => WheelRateReport::try_from(data).map_or_else(
            |error| error.to_string(),
            |said| {
                let rates: [f32; 4] = said.rates.into();
                let rates = rates.map(|rate| format!("{rate:.2}"));
                format!("{} rad/s", rates.join(", "))
            },
        ),
        (Some((cob::Sent::YawRate, _)), _) => YawRateReport::try_from(data).map_or_else(
            |error| error.to_string(),
            |said| {
                said.yaw_rate
                    .map_or_else(String::new, |rate| format!("{rate:.4} rad/s"))
            },
        ),
        (Some((cob::Sent::Heartbeat, _)), [state]) => heartbeat(id, *state),
        (Some((cob::Sent::Emergency, _)), [low, high, ..]) => {
            format!("code 0x{:04X}", u16::from_le_bytes([*low, *high]))
        }
        (_, [command, low, high, sub, ..]) if matches!(id & 0x780, 0x580 | 0x600) => {
            let index = u16::from_le_bytes([*low, *high]);
            format!("0x{index:04X}:{sub}, command 0x{command:02X}")
        }
        _ => String::new(),
    }
}

fn twist(twist: kinematics::Twist) -> String {
    let kinematics::Twist { vx, vy, omega } = twist;
    format!("{vx:.3} m/s, {vy:.3} m/s, {omega:.3} rad/s")
}

fn status(status: &MemberStatus) -> String {
    let MemberStatus { state, code, .. } = status;
    let percent = status.scale.factor() * 100.0;
    format!("{state:?}, can follow {percent:.0} %, {code}")
}

fn heartbeat(id: u16, state: u8) -> String {
    let frame = canopen::Frame::new(id, &[state]);
    let parsed = frame.and_then(|frame| client::parse_heartbeat(&frame));
    parsed.map_or_else(String::new, |(_, state)| format!("{state:?}"))
}

/// One robot from inside.
#[derive(Default)]
pub struct RobotPane {
    /// Which robot the page looks into.
    pub node: Option<u8>,
    logs: BTreeMap<u8, VecDeque<LogLine>>,
}

impl RobotPane {
    /// Takes over what the robots have logged.
    pub fn take_logs(&mut self, world: &mut World) {
        for (node, line) in world.take_logs() {
            let lines = self.logs.entry(node).or_default();
            if lines.len() == LINES {
                lines.pop_front();
            }
            lines.push_back(line);
        }
    }

    /// Duties and wheel rates, and of an emulated robot its PWM outputs, its core's registers and
    /// its log since the last call; null while the page does not look.
    pub fn show(&mut self, world: &mut World) -> Value {
        let Some(node) = self.node else {
            return Value::Null;
        };
        let truth = world.truth();
        let Some(robot) = truth.robots.iter().find(|robot| robot.node == node) else {
            return Value::Null;
        };
        let rates: [f64; 4] = robot.wheel_rates.into();
        let lines = self.logs.remove(&node).unwrap_or_default();
        let lines = lines
            .iter()
            .map(|line| json!([line.time_us as f64 * 1e-6, line.level, line.text]));
        let mut shown = json!({"node": node, "duties": robot.duties, "rates": rates,
                               "log": lines.collect::<Vec<_>>()});
        if let Some(board) = world.board(node) {
            let mut outputs = Vec::new();
            for timer in BRIDGE_TIMERS {
                for channel in CHANNELS {
                    let pwm = board.pwm(timer, channel);
                    outputs.push(json!([
                        format!("TIM{timer} CH{channel}"),
                        pwm.duty,
                        pwm.period_ns,
                        pwm.active
                    ]));
                }
            }
            let registers = board.registers();
            shown["pwm"] = json!(outputs);
            shown["registers"] = json!(registers.r);
            shown["xpsr"] = json!(registers.xpsr);
            shown["instructions"] = json!(board.instructions());
        }
        shown
    }
}
