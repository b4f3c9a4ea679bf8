//! A recording as one self-contained HTML page.

use std::fmt::Write as _;

use chart::ChartError;
use chart::page::{begin, end, escape, figure};
use kinematics::Twist;
use protocol::Code;

use super::{Recording, charts};
use crate::monitor::telemetry::{Event, EventKind, Snapshot};

/// Events shown at most; the recording has them all.
const MOST_EVENTS: usize = 200;

/// The figures of a recording, for the page and for scripts.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Figures {
    /// What was done.
    pub activity: String,
    /// The bus.
    pub bus: String,
    /// Name of the group, when the recording has its file.
    pub group: Option<String>,
    /// Robots that were heard.
    pub nodes: Vec<u8>,
    /// Frames.
    pub frames: usize,
    /// From the first to the last frame, s.
    pub seconds: f64,
    /// SYNC periods.
    pub syncs: usize,
    /// Length of the path by the wheels, m.
    pub path_m: f64,
    /// Fastest measured speed, m/s.
    pub fastest_m_s: f32,
    /// Smallest scale, 0..=1, that a robot permitted while the group was commanded to move.
    pub smallest_scale: Option<f32>,
    /// Largest slip residual of a robot, rad/s.
    pub largest_slip_rad_s: Option<f32>,
    /// Largest disagreement of two robots, m/s.
    pub largest_strain_m_s: Option<f32>,
    /// Largest bus load over 100 ms while moving, 0 to 1.
    pub largest_bus_load: Option<f32>,
    /// Root mean square distance between curve and observer (or wheels), mm; where a curve was
    /// driven.
    pub rms_mm: Option<f64>,
    /// Faults that appeared.
    pub faults: usize,
    /// What is wrong with the file.
    pub damage: Option<String>,
}

fn largest(values: impl Iterator<Item = Option<f32>>) -> Option<f32> {
    values.flatten().reduce(f32::max)
}

/// Distance of the observer from the curve at the same instants.
fn rms_mm(recording: &Recording) -> Option<f64> {
    if recording.truth.is_empty() || recording.plan.len() != recording.truth.len() {
        return None;
    }
    let pairs = recording.plan.iter().zip(&recording.truth);
    let squares: f64 = pairs
        .map(|((_, a), (_, b))| f64::from(a.x - b.x).powi(2) + f64::from(a.y - b.y).powi(2))
        .sum();
    Some((squares / recording.plan.len() as f64).sqrt() * 1000.0)
}

/// Works the figures out.
#[must_use]
pub fn figures(recording: &Recording) -> Figures {
    let (rows, events) = recording.decode();
    of(recording, &rows, &events)
}

fn of(recording: &Recording, rows: &[Snapshot], events: &[Event]) -> Figures {
    let poses: Vec<_> = rows.iter().filter_map(|row| row.pose).collect();
    let step = |pair: &[kinematics::Pose]| match pair {
        [a, b] => f64::from((b.x - a.x).hypot(b.y - a.y)),
        _ => 0.0,
    };
    let speed = |twist: Twist| twist.vx.hypot(twist.vy);
    let moving = || rows.iter().filter(|row| row.command != Twist::ZERO);
    let members = || rows.iter().flat_map(|row| &row.members);
    let is_fault = |event: &&Event| matches!(event.what, EventKind::Code(Code::Fault(_)));
    Figures {
        activity: recording.header.activity.clone(),
        bus: recording.header.bus.clone(),
        group: recording.group().ok().flatten().map(|group| group.name),
        nodes: charts::nodes(rows),
        frames: recording.frames.len(),
        seconds: recording.seconds(),
        syncs: rows.len(),
        path_m: poses.windows(2).map(step).sum(),
        fastest_m_s: largest(rows.iter().map(|row| row.measured.map(speed))).unwrap_or(0.0),
        smallest_scale: moving().filter_map(|row| row.scale).reduce(f32::min),
        largest_slip_rad_s: largest(members().map(|m| m.slip_residual.map(f32::abs))),
        largest_strain_m_s: largest(rows.iter().map(|row| row.strain)),
        largest_bus_load: largest(moving().map(|row| row.bus_load)),
        rms_mm: rms_mm(recording),
        faults: events.iter().filter(is_fault).count(),
        damage: recording.damage.clone(),
    }
}

/// The page.
///
/// # Errors
/// When a chart cannot be drawn.
pub fn to_html(recording: &Recording) -> Result<String, ChartError> {
    let (rows, events) = recording.decode();
    let figures = of(recording, &rows, &events);
    let group = figures.group.as_deref().unwrap_or("robots");
    let title = escape(&format!("{group}: {}", figures.activity));
    let mut out = begin(&title, &title);
    let _ = write!(
        out,
        "<p class=\"lead\">Recorded on <code>{}</code>: {} frames in {:.1} s, {} SYNC periods, \
         {}.</p>",
        escape(&figures.bus),
        figures.frames,
        figures.seconds,
        figures.syncs,
        crate::report::nodes(&figures.nodes)
    );
    if let Some(damage) = &figures.damage {
        let _ = write!(
            out,
            "<p><b>This recording is incomplete:</b> {}.</p>",
            escape(damage)
        );
    }
    cards(&mut out, &figures);
    figure(&mut out, "", &charts::map(recording, &rows))?;
    out.push_str(
        "<p>The path by the wheels is the mean of the robots' odometry; it does not show slip that \
         their compensation does not cover.</p><h2>Velocity</h2>",
    );
    for chart in charts::velocities(&rows) {
        figure(&mut out, "", &chart)?;
    }
    out.push_str("<h2>Limits, slip and bus</h2>");
    for chart in charts::health(&rows) {
        figure(&mut out, "", &chart)?;
    }
    out.push_str("<h2>Wheel rates</h2>");
    for node in &figures.nodes {
        figure(&mut out, "", &charts::wheel_rates(&rows, *node))?;
    }
    list(&mut out, &events);
    end(&mut out);
    Ok(out)
}

fn cards(out: &mut String, figures: &Figures) {
    out.push_str("<div class=\"cards\">");
    let mut card = |value: String, text: &str| {
        let _ = write!(
            out,
            "<div class=\"card\"><b>{value}</b><span>{text}</span></div>"
        );
    };
    card(format!("{:.2} m", figures.path_m), "path, by the wheels");
    card(format!("{:.2} m/s", figures.fastest_m_s), "fastest");
    let or_dash = |value: Option<String>| value.unwrap_or_else(|| "-".into());
    card(
        or_dash(figures.smallest_scale.map(|v| format!("{v:.2}"))),
        "smallest scale while moving",
    );
    card(
        or_dash(figures.largest_slip_rad_s.map(|v| format!("{v:.2} rad/s"))),
        "largest slip",
    );
    card(
        or_dash(
            figures
                .largest_bus_load
                .map(|v| format!("{:.1} %", v * 100.0)),
        ),
        "largest bus load while moving",
    );
    if let Some(rms) = figures.rms_mm {
        card(format!("{rms:.2} mm"), "rms distance from the curve");
    }
    card(figures.faults.to_string(), "faults");
    out.push_str("</div>");
}

fn list(out: &mut String, events: &[Event]) {
    out.push_str("<h2>Events</h2><table><thead><tr><th>time</th><th>who</th><th>what</th></tr></thead><tbody>");
    for event in events.iter().take(MOST_EVENTS) {
        let who = event
            .node
            .map_or_else(|| "master".into(), |node| format!("node {node}"));
        let _ = write!(
            out,
            "<tr><td>{:.3} s</td><td>{who}</td><td style=\"text-align:left\">{}</td></tr>",
            event.t,
            escape(&event.what.to_string())
        );
    }
    out.push_str("</tbody></table>");
    if let Some(more) = events.len().checked_sub(MOST_EVENTS + 1) {
        let _ = write!(out, "<p>And {} more.</p>", more + 1);
    }
}
