//! The figures of a report as a table for the terminal, the paper's values beside the measured.

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};

use super::{Report, figures};

/// The report as a table, without a final newline.
#[must_use]
pub fn to_table(report: &Report) -> String {
    let mut table = Table::new();
    table
        .load_style(presets::UTF8_FULL_CONDENSED)
        .set_content_arrangement(ContentArrangement::Disabled);
    let rows = figures::rows(report);
    let has_paper = figures::has_paper(&rows);
    let mut header = vec![String::new()];
    let runs = report.runs.iter();
    header.extend(runs.map(|run| report.heading(run)));
    header.extend(has_paper.then(|| "paper, off (Table 6)".into()));
    table.set_header(header);
    for row in rows {
        let mut cells = vec![row.name.to_owned()];
        cells.extend(row.values);
        cells.extend(has_paper.then(|| row.paper.unwrap_or_else(|| "-".into())));
        table.add_row(cells);
    }
    for index in 1..=report.runs.len() + 1 {
        if let Some(column) = table.column_mut(index) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table.to_string()
}
