//! The report as one self-contained HTML page: no fonts, no network; it can be mailed. Its charts
//! are zoomed by a script of its own.
//!
//! Text that came from a file (names of groups and curves) is escaped; charts are inline SVG.

use std::fmt::Write as _;

use super::figures::{load, percent};
use super::{BackendName, Report, Scalar, charts, figures, motion};
use chart::ChartError;
pub use chart::page::escape;
use chart::page::{begin, end, figure};

/// The figures beside the paper's.
fn table(report: &Report) -> String {
    let rows = figures::rows(report);
    let has_paper = figures::has_paper(&rows);
    let mut out = String::from("<table><thead><tr><th></th>");
    for run in &report.runs {
        let _ = write!(out, "<th>{}</th>", report.heading(run));
    }
    if has_paper {
        out.push_str("<th class=\"paper\">paper, off (Table 6)</th>");
    }
    out.push_str("</tr></thead><tbody>");
    for row in rows {
        let _ = write!(out, "<tr><td>{}</td>", row.name);
        for value in row.values {
            let _ = write!(out, "<td>{value}</td>");
        }
        if has_paper {
            let paper = row.paper.unwrap_or_else(|| "&ndash;".to_owned());
            let _ = write!(out, "<td class=\"paper\">{paper}</td>");
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table>");
    out
}

/// The page.
///
/// # Errors
/// When a chart cannot be drawn.
pub fn to_html(report: &Report) -> Result<String, ChartError> {
    let robots = report.robots.len();
    let title = escape(&report.title());
    let mut out = begin(&format!("Omnibus: {title}"), &title);
    let _ = write!(
        out,
        "<p class=\"lead\">Group <code>{}</code> on the <code>{}</code> backend{}.</p>",
        escape(&report.config),
        report.backend.word(),
        match report.scalar {
            Some(Scalar::Fixed) => ", kinematics in fixed point",
            Some(Scalar::F32) | None => "",
        },
    );
    if let (Some(reason), Some(run)) = (&report.stopped, report.runs.last()) {
        let seconds = run.truth.last().map_or(0.0, |row| row.t);
        let _ = write!(
            out,
            "<p class=\"lead\"><strong>Ended after {seconds:.1} s, before the end of the curve: \
             {}.</strong> What was driven until then is shown.</p>",
            escape(reason.trim_end_matches('.'))
        );
    }
    out.push_str("<div class=\"cards\">");
    let mut card = |value: String, text: &str| {
        let _ = write!(
            out,
            "<div class=\"card\"><b>{value}</b><span>{text}</span></div>"
        );
    };
    for run in &report.runs {
        let (error, name) = if report.turns() {
            (run.evenness.turn_percent, "turned angle")
        } else {
            (run.errors.x_percent, "lateral error")
        };
        let text = format!("{name}, {}", report.heading(run));
        card(percent(error), &text);
    }
    let shape = report.runs.iter().map(|run| run.shape_error_mm);
    card(
        format!("{:.2} mm", shape.fold(0.0, f64::max)),
        "largest shape error",
    );
    card(load(report.bus_load_percent()), "largest bus load");
    if report.backend == BackendName::Emulator {
        card(
            format!("{:.2}", report.realtime_factor()),
            "robots' time / real time",
        );
    }
    out.push_str("</div>");

    out.push_str(&motion::animation(report));
    figure(&mut out, "map", &charts::map(report))?;
    out.push_str("<h2>Figures</h2>");
    out.push_str(&table(report));
    out.push_str(
        "<p>The errors of x and y are relative errors as in the paper's Table 6: half of the \
         path's extent over half of the curve's, minus one. The tracking error is the distance to \
         where the curve is at the same instant; the setpoints make up for the known delay of \
         their pipeline. The lag is the part of that error that is proportional to the velocity, \
         without the parts due to gain and start. The ripple is the standard deviation of the \
         speed where the curve is fastest, over the commanded speed. The shape error is the \
         largest distance of a robot from its place in the group. The paper's robot was one \
         virtual prototype; it printed no numbers for its compensated curves.</p>",
    );
    out.push_str("<h2>Displacement</h2><div class=\"pair\">");
    for chart in charts::displacements(report) {
        figure(&mut out, "", &chart)?;
    }
    out.push_str("</div><h2>Velocity</h2><div class=\"pair\">");
    for chart in charts::velocities(report) {
        figure(&mut out, "", &chart)?;
    }
    out.push_str("</div><h2>Tracking and shape</h2>");
    figure(&mut out, "", &charts::tracking(report))?;
    figure(&mut out, "", &charts::heading(report))?;
    figure(&mut out, "", &charts::shape(report))?;
    out.push_str(
        "<h2>Wheel rates</h2><p>Rate of the wheels' hubs, positive rolls the base forward. While \
         the group does not turn, the wheels on one diagonal turn alike and their lines \
         coincide.</p>",
    );
    for robot in 0..robots {
        out.push_str("<div class=\"pair\">");
        for run in &report.runs {
            figure(&mut out, "", &charts::wheel_rates(report, run, robot))?;
        }
        out.push_str("</div>");
    }
    out.push_str(provenance(report));
    end(&mut out);
    Ok(out)
}

/// Where the numbers come from, said for the backend that made them.
fn provenance(report: &Report) -> &'static str {
    match report.backend {
        BackendName::Emulator => {
            "<h2>Where this comes from</h2><p>Every robot is an emulated STM32F446 that runs the \
             release image of the firmware unmodified. The master sends group twists and SYNC as \
             CAN frames over a virtual bus; the emulated timers' PWM registers drive motor \
             models; the wheels' motion comes back through the encoder counters and, through the \
             simulated floor (tables of the paper, or rollers with friction), becomes the path \
             drawn here. Nothing of this has run on hardware.</p>"
        }
        super::BackendName::Robots => {
            "<h2>Where this comes from</h2><p>The path drawn here is the mean of the members' \
             odometry, measured by their own wheels. It does not show slip that the compensation \
             does not cover. The shape error is measured by the wheels, too: how far each robot's \
             wheels took it from its place.</p>"
        }
        super::BackendName::Native => {
            "<h2>Where this comes from</h2><p>Every robot is the firmware's control code compiled \
             for this machine. The master sends group twists and SYNC as CAN frames over a virtual \
             bus; the duty cycles drive motor models; the wheels' motion comes back as encoder \
             counts and, through the simulated floor (tables of the paper, or rollers with \
             friction), becomes the path drawn here. Nothing of this has run on hardware.</p>"
        }
    }
}
