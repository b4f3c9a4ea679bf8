//! `diagnostics`: the group, its commands and each robot, in words.

use group::GroupFile;
use protocol::{Code, Fault, MemberState};
use ros::message::{
    DiagnosticArray, DiagnosticLevel as Level, DiagnosticStatus, Header, KeyValue, Time,
};

use super::commands::{Commands, Tally};
use crate::monitor::telemetry::{MemberSample, SessionState, Snapshot};

/// What a robot was asked for besides what it sends by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Asked {
    /// Supply voltage, V.
    pub supply: Option<f32>,
    /// Current of its motors, A.
    pub current: Option<f32>,
}

/// What the node itself knows.
#[derive(Clone, Debug, Default)]
pub struct Own {
    /// Messages for which there was no room.
    pub dropped: u64,
    /// The last failure of the session.
    pub failed: Option<String>,
}

fn value(key: &str, value: impl ToString) -> KeyValue {
    KeyValue {
        key: key.into(),
        value: value.to_string(),
    }
}

fn known(value: Option<impl ToString>) -> String {
    value.map_or_else(|| "unknown".into(), |value| value.to_string())
}

/// All of them.
pub fn diagnostics(
    stamp: &Time,
    group: &GroupFile,
    now: &Snapshot,
    asked: &[Asked],
    commands: &mut Commands,
    own: &Own,
) -> DiagnosticArray {
    let mut status = vec![whole(group, now, commands, own), velocities(commands)];
    for (member, asked) in now.members.iter().zip(asked) {
        status.push(robot(group, member, asked, now));
    }
    DiagnosticArray {
        header: Header {
            stamp: stamp.clone(),
            frame_id: String::new(),
        },
        status,
    }
}

fn whole(group: &GroupFile, now: &Snapshot, commands: &Commands, own: &Own) -> DiagnosticStatus {
    let running = now.phase == SessionState::Running;
    let (level, message) = if commands.is_latched() {
        (Level::Error, "emergency stop; call e_stop_reset".into())
    } else if now.foreign_master {
        (Level::Error, "another master commands the robots".into())
    } else if let (false, Some(why)) = (running, &own.failed) {
        (Level::Error, format!("stopped: {why}"))
    } else if now.phase == SessionState::Idle {
        (Level::Ok, "switched off; call start".into())
    } else if running {
        (Level::Ok, "following commands".into())
    } else {
        (Level::Ok, now.phase.name().into())
    };
    let percent = |share: f32| format!("{:.0} %", 100.0 * share);
    let limits = &group.limits;
    DiagnosticStatus {
        level,
        name: format!("omnibus: {}", group.name),
        message,
        hardware_id: format!("group {}", group.group_id),
        values: vec![
            value("phase", now.phase.name()),
            value("driver", commands.driver().unwrap_or_else(|| "none".into())),
            value("scale", known(now.scale.map(percent))),
            value("bus load", known(now.bus_load.map(percent))),
            value("limit of the speed, m/s", limits.linear_speed),
            value("limit of the yaw rate, rad/s", limits.yaw_rate),
            value(
                "limit of the acceleration, m/s2",
                limits.linear_acceleration,
            ),
            value("messages left out", own.dropped),
        ],
    }
}

fn velocities(commands: &mut Commands) -> DiagnosticStatus {
    let tally = commands.report();
    let (level, message) = match (commands.others().first(), &tally) {
        (Some((name, of)), _) => (
            Level::Warn,
            format!("{name} publishes {of} on cmd_vel; see --stamped"),
        ),
        (
            None,
            Tally {
                note: Some(note), ..
            },
        ) => (Level::Warn, note.clone()),
        (None, Tally { why: Some(why), .. }) => (Level::Warn, format!("refused: {why}")),
        (
            None,
            Tally {
                factor: Some(factor),
                ..
            },
        ) => (
            Level::Warn,
            format!(
                "more than the limits: slowed down to {:.0} %",
                100.0 * factor
            ),
        ),
        (
            None,
            Tally {
                displaced: Some((before, after)),
                ..
            },
        ) => (Level::Ok, format!("{after} drives in place of {before}")),
        (None, Tally { taken: 0, .. }) => (Level::Ok, "none".into()),
        (None, _) => (Level::Ok, "followed".into()),
    };
    let displaced = tally.displaced.as_ref().map(|(before, _)| before.clone());
    DiagnosticStatus {
        level,
        name: "omnibus: cmd_vel".into(),
        message,
        hardware_id: String::new(),
        values: vec![
            value("taken", tally.taken),
            value("refused", tally.refused),
            value("slowed down", tally.slowed),
            value("displaced", displaced.unwrap_or_else(|| "none".into())),
        ],
    }
}

fn robot(
    group: &GroupFile,
    member: &MemberSample,
    asked: &Asked,
    now: &Snapshot,
) -> DiagnosticStatus {
    let (level, message) = match (member.code, member.state, &member.past) {
        (_, None, Some(past)) => (Level::Stale, format!("silent; {past}")),
        (_, None, None) if member.nmt.is_none() => (Level::Stale, "silent".into()),
        (Code::Fault(_), ..) => (Level::Error, member.code.to_string()),
        (Code::Limit(_), ..) => (Level::Warn, member.code.to_string()),
        (Code::None, Some(state), _) => (Level::Ok, in_words(state).into()),
        (Code::None, None, None) => (Level::Ok, "switched off".into()),
    };
    let minimum = group.robots.iter().find(|robot| robot.node == member.node);
    let nominal = minimum.map(|robot| robot.motor.supply);
    DiagnosticStatus {
        level,
        name: format!("omnibus: robot {}", member.node),
        message,
        hardware_id: format!("node {}", member.node),
        values: vec![
            value("state", known(member.state.map(in_words))),
            value("NMT", known(member.nmt.map(|nmt| format!("{nmt:?}")))),
            value("code", format!("{:#06x}", member.code.code())),
            value("supply, V", known(asked.supply)),
            value("nominal supply, V", known(nominal)),
            value("motor current, A", known(asked.current)),
            value("permitted scale", known(member.permitted_scale)),
            value("slip residual, rad/s", known(member.slip_residual)),
            value("SYNCs without status", member.silent_syncs),
            value("bus load", known(now.bus_load)),
        ],
    }
}

const fn in_words(state: MemberState) -> &'static str {
    match state {
        MemberState::Unconfigured => "not configured; outputs off",
        MemberState::Ready => "ready; outputs off",
        MemberState::Armed => "armed; standing",
        MemberState::Moving => "following",
        MemberState::Alone => "moving alone",
        MemberState::Ramping => "ramping down",
        MemberState::Faulted => "at rest with a fault",
    }
}

/// Whether a robot's emergency stop is open.
#[must_use]
pub fn has_emergency_stop(now: &Snapshot) -> bool {
    let stopped = Code::Fault(Fault::EmergencyStop);
    now.members.iter().any(|member| {
        member.code == stopped || member.past.is_some_and(|past| past.code == stopped)
    })
}
