//! The results of scenarios, as text and as one HTML page.

use std::fmt::Write as _;

use chart::page::{begin, end, escape, figure};
use chart::{Chart, ChartError, PALETTE, Series, Stroke};
use kinematics::Pose;

use super::drive::{Point, in_paper};
use super::{Findings, Row};

/// A map of paths in the paper's axes, over the motion they follow.
pub(super) fn map<'a>(title: &str, paths: impl Iterator<Item = (String, &'a [Point])>) -> Chart {
    let metres = |pose: &Pose<f64>| {
        let (x, y) = in_paper(pose);
        (x * 1e-3, y * 1e-3)
    };
    let mut series: Vec<Series> = Vec::new();
    for (n, (label, points)) in paths.enumerate() {
        if n == 0 {
            series.push(Series {
                label: "theory".into(),
                color: None,
                stroke: Stroke::Band,
                points: points.iter().map(|p| metres(&p.theory)).collect(),
            });
        }
        series.push(Series {
            label,
            color: Some(PALETTE[n % PALETTE.len()]),
            stroke: Stroke::Line,
            points: points.iter().map(|p| metres(&p.group)).collect(),
        });
    }
    Chart {
        title: title.into(),
        x_label: "x, to the right / m".into(),
        y_label: "y, forward / m".into(),
        size: (520, 460),
        equal_axes: true,
        series,
        outlines: vec![],
    }
}

/// The cells of a row: what, paper, then ours and, where the paper has a number, the difference, a
/// column.
fn cells(row: &Row) -> Vec<String> {
    let digits = if row.unit == "mm" { 1 } else { 2 };
    let mut cells = vec![
        row.what.clone(),
        row.paper
            .map_or_else(|| "-".to_owned(), |p| format!("{p:.3} {}", row.unit)),
    ];
    for ours in &row.ours {
        cells.push(format!("{ours:.digits$} {}", row.unit));
        cells.push(
            row.paper
                .map_or_else(|| "-".to_owned(), |paper| format!("{:+.2}", ours - paper)),
        );
    }
    cells
}

fn header(findings: &Findings) -> Vec<String> {
    let mut header = vec![String::new(), "paper".to_owned()];
    for column in &findings.columns {
        header.push(column.clone());
        header.push("difference".to_owned());
    }
    header
}

/// The findings as a table for a terminal.
#[must_use]
pub fn to_text(findings: &Findings) -> String {
    let mut table = comfy_table::Table::new();
    table.load_style(comfy_table::presets::UTF8_FULL_CONDENSED);
    table.set_content_arrangement(comfy_table::ContentArrangement::Disabled);
    table.set_header(header(findings));
    for row in &findings.rows {
        table.add_row(cells(row));
    }
    for index in 1..=1 + 2 * findings.columns.len() {
        if let Some(column) = table.column_mut(index) {
            column.set_cell_alignment(comfy_table::CellAlignment::Right);
        }
    }
    let mut out = format!("{}: {}\n{table}\n", findings.name, findings.text);
    for note in &findings.notes {
        let _ = writeln!(out, "  {note}");
    }
    out
}

/// The findings of some scenarios as one page.
///
/// # Errors
/// When a chart cannot be drawn.
pub fn to_html(all: &[Findings], backend: &str) -> Result<String, ChartError> {
    let mut out = begin(
        "Omnibus: the paper's experiments, simulated",
        "The paper's experiments, simulated",
    );
    let _ = write!(
        out,
        "<p class=\"lead\">Every table beside the one of <i>Kinematic Modeling of a Combined \
         System of Multiple Mecanum-Wheeled Robots with Velocity Compensation</i>, on the \
         <code>{}</code> backend. Axes are the paper's: x to the right, y forward. A difference \
         is ours less the paper's, in the row's unit (for per cent: points). Nothing here has run \
         on hardware.</p><ul>",
        escape(backend)
    );
    for findings in all {
        let _ = write!(
            out,
            "<li><a href=\"#{0}\">{0}</a>: {1}</li>",
            findings.name,
            escape(findings.text)
        );
    }
    out.push_str("</ul>");
    for findings in all {
        let _ = write!(
            out,
            "<h2 id=\"{0}\">{0}: {1}</h2><table><thead><tr>",
            findings.name,
            escape(findings.text)
        );
        for cell in header(findings) {
            let _ = write!(out, "<th>{}</th>", escape(&cell));
        }
        out.push_str("</tr></thead><tbody>");
        for row in &findings.rows {
            out.push_str("<tr>");
            for cell in cells(row) {
                let _ = write!(out, "<td>{}</td>", escape(&cell));
            }
            out.push_str("</tr>");
        }
        out.push_str("</tbody></table>");
        for note in &findings.notes {
            let _ = write!(out, "<p>{}</p>", escape(note));
        }
        out.push_str("<div class=\"pair\">");
        for chart in &findings.charts {
            figure(&mut out, "", chart)?;
        }
        out.push_str("</div>");
    }
    end(&mut out);
    Ok(out)
}
