//! A recording as a table for spreadsheets and scripts: one row per SYNC, one column per value.
//!
//! Columns of a robot begin with its node: `node2.slip_residual`. What was not known is an empty
//! cell.

use std::io::{self, Write};

use kinematics::{Pose, Twist};

use super::Recording;
use crate::monitor::telemetry::{MemberSample, Snapshot};

const GROUP_COLUMNS: [&str; 18] = [
    "t_s",
    "phase",
    "sequence",
    "command_vx",
    "command_vy",
    "command_omega",
    "measured_vx",
    "measured_vy",
    "measured_omega",
    "x",
    "y",
    "heading",
    "target_x",
    "target_y",
    "target_heading",
    "scale",
    "strain",
    "bus_load",
];
const ROBOT_COLUMNS: [&str; 15] = [
    "nmt",
    "state",
    "code",
    "permitted_scale",
    "slip_residual",
    "measured_vx",
    "measured_vy",
    "measured_omega",
    "x",
    "y",
    "heading",
    "front_left",
    "front_right",
    "rear_left",
    "rear_right",
];

/// Writes the table.
///
/// # Errors
/// When it cannot be written.
pub fn write(recording: &Recording, out: &mut impl Write) -> io::Result<()> {
    let (snapshots, _) = recording.decode();
    // Without a group file robots turn up as they are heard: the last row knows them all.
    let nodes: Vec<u8> = snapshots.last().map_or_else(Vec::new, |last| {
        last.members.iter().map(|member| member.node).collect()
    });
    let mut header: Vec<String> = GROUP_COLUMNS.map(str::to_owned).to_vec();
    for node in &nodes {
        header.extend(
            ROBOT_COLUMNS
                .iter()
                .map(|column| format!("node{node}.{column}")),
        );
    }
    writeln!(out, "{}", header.join(","))?;
    for snapshot in &snapshots {
        let mut cells = group(snapshot);
        for node in &nodes {
            let member = snapshot.members.iter().find(|member| member.node == *node);
            cells.extend(robot(&member.copied().unwrap_or_default()));
        }
        writeln!(out, "{}", cells.join(","))?;
    }
    out.flush()
}

fn cell(value: Option<impl ToString>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

fn twist(twist: Option<Twist>) -> [String; 3] {
    [
        twist.map(|t| t.vx),
        twist.map(|t| t.vy),
        twist.map(|t| t.omega),
    ]
    .map(cell)
}

fn pose(pose: Option<Pose>) -> [String; 3] {
    [
        pose.map(|p| p.x),
        pose.map(|p| p.y),
        pose.map(|p| p.heading),
    ]
    .map(cell)
}

fn group(snapshot: &Snapshot) -> Vec<String> {
    let mut cells = vec![
        format!("{:.6}", snapshot.t),
        snapshot.phase.name().to_owned(),
        snapshot.sequence.to_string(),
    ];
    cells.extend(twist(Some(snapshot.command)));
    cells.extend(twist(snapshot.measured));
    cells.extend(pose(snapshot.pose));
    cells.extend(pose(snapshot.target));
    cells.extend([snapshot.scale, snapshot.strain, snapshot.bus_load].map(cell));
    cells
}

fn robot(member: &MemberSample) -> Vec<String> {
    let mut cells = vec![
        cell(member.nmt.map(|state| format!("{state:?}"))),
        cell(member.state.map(|state| format!("{state:?}"))),
        member.code.code().to_string(),
        cell(member.permitted_scale),
        cell(member.slip_residual),
    ];
    cells.extend(twist(member.measured));
    cells.extend(pose(member.pose));
    let rates: Option<[f32; 4]> = member.wheel_rates.map(Into::into);
    match rates {
        Some(rates) => cells.extend(rates.map(|rate| rate.to_string())),
        None => cells.extend([const { String::new() }; 4]),
    }
    cells
}
