//! The legend of a chart: samples of its lines with their names.

use plotters::coord::Shift;
use plotters::element::DashedPathElement;
use plotters::prelude::*;

use crate::{LABEL_AREA, MARGIN, SCALE, Series, line_style, scaled_dashes, text};

/// Length of a sample, the gap behind it and the gap behind a name, in pixels as drawn.
const SAMPLE: i32 = 30 * SCALE as i32;
const GAP: i32 = 6 * SCALE as i32;
const BETWEEN: i32 = 18 * SCALE as i32;
/// Height of a row, as drawn.
const ROW: i32 = 20 * SCALE as i32;
/// Height of the names, in pixels.
const TEXT: i32 = 13;

/// A name and where it begins, its sample in front of it.
struct Entry<'a> {
    series: &'a Series,
    x: i32,
    row: i32,
}

/// A piece of a line as the legend shows it, from this point to the right.
fn sample(
    series: &Series,
    (x, y): (i32, i32),
) -> DashedPathElement<std::vec::IntoIter<(i32, i32)>, i32> {
    let (dash, gap) = scaled_dashes(series).unwrap_or((SAMPLE, 1));
    let ends = vec![(x, y), (x + SAMPLE, y)];
    DashedPathElement::new(ends, dash, gap, line_style(series, 0))
}

/// Draws the legend in rows at the lower edge, as many as it takes, and returns the area above.
pub fn below<B: DrawingBackend>(
    root: &DrawingArea<B, Shift>,
    series: &[Series],
) -> Result<DrawingArea<B, Shift>, Box<dyn std::error::Error>>
where
    B::ErrorType: 'static,
{
    let left = (LABEL_AREA.1 + MARGIN) * SCALE;
    let (left, (width, height)) = (i32::try_from(left)?, root.dim_in_pixel());
    let (mut x, mut row) = (left, 0);
    let mut entries = Vec::new();
    for series in series.iter().filter(|series| !series.label.is_empty()) {
        let (name, _) = root.estimate_text_size(&series.label, &text(TEXT))?;
        let end = x + SAMPLE + GAP + i32::try_from(name)?;
        if end > i32::try_from(width)? && x > left {
            (x, row) = (left, row + 1);
        }
        entries.push(Entry { series, x, row });
        x += SAMPLE + GAP + i32::try_from(name)? + BETWEEN;
    }
    if entries.is_empty() {
        return Ok(root.clone());
    }
    let (above, rows) = root.split_vertically(i32::try_from(height)? - (row + 1) * ROW);
    for Entry { series, x, row } in entries {
        let y = row * ROW + ROW / 2 - SCALE as i32 * 2;
        rows.draw(&sample(series, (x, y)))?;
        let at = (x + SAMPLE + GAP, y - TEXT / 2 * SCALE as i32);
        rows.draw(&Text::new(series.label.as_str(), at, text(TEXT)))?;
    }
    Ok(above)
}
