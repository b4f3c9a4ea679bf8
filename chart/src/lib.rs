//! One chart as an SVG string or a picture: axes, grid, lines, a legend. `plotters` draws it and
//! measures text with an embedded font, so only Rust is needed.
//!
//! A chart is plain data ([`Chart`]); this file defines only its appearance. [`page`] builds a page
//! of charts and tables. The reports of the master and of the simulator use both. Lines are reduced
//! to the resolution of a screen, keeping the first and the last point, so a report of a minute at
//! 1 kHz takes only a few hundred kilobytes.

#![forbid(unsafe_code)]

mod bitmap;
mod legend;
pub mod page;
mod picture;

pub use picture::{Placed, Sheet};
use plotters::coord::Shift;
use plotters::data::float::FloatPrettyPrinter;
pub use plotters::style::RGBColor;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Ink of axes, text and the theory's line.
const INK: RGBColor = RGBColor(45, 52, 62);
/// Grid lines.
const GRID: RGBColor = RGBColor(228, 232, 237);
/// Lines are thinned to at most this many points, and their ends.
const MAX_POINTS: usize = 900;
/// Space around the plot for the labels of the axes, in pixels.
const LABEL_AREA: (u32, u32) = (46, 62);
/// Space around everything, in pixels.
const MARGIN: u32 = 14;
/// Height of the title line, in pixels.
const TITLE_HEIGHT: u32 = 30;
/// Everything is drawn this much larger than it is shown, because the drawing library rounds to
/// whole pixels and curves would show steps.
const SCALE: u32 = 8;
/// Width of a line and of a band, in pixels.
const LINE_WIDTH: u32 = 2;
const BAND_WIDTH: u32 = 7;
/// Width of the front of an outline, in pixels.
const FRONT_WIDTH: u32 = 4;
/// By how much a line is broader than the one above it, as drawn, and how many steps there are.
const BROADER: u32 = 6;
const MOST_BROADENED: usize = 3;
/// How much of its colour a band has.
const BAND_OPACITY: f64 = 0.22;

/// Line colours, in the order series use them. Distinguishable without red-green vision.
pub const PALETTE: [RGBColor; 6] = [
    RGBColor(0, 95, 160),
    RGBColor(214, 95, 0),
    RGBColor(0, 140, 110),
    RGBColor(170, 70, 140),
    RGBColor(120, 120, 40),
    RGBColor(90, 100, 115),
];

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stroke {
    /// A line.
    Line,
    /// A broad pale band, for what other lines are to be compared with.
    Band,
}

/// Dashes and gaps of the lines of [`PALETTE`]'s colours, in pixels, and how CSS calls that, so
/// that lines can be told apart without their colours too; `None` for a line without gaps.
const DASHES: [Option<(i32, i32, &str)>; 6] = [
    None,
    Some((9, 5, "dashed")),
    Some((2, 4, "dotted")),
    Some((18, 5, "dashed")),
    Some((5, 9, "dashed")),
    None,
];

/// The dashes of a series.
fn dashes(series: &Series) -> Option<(i32, i32, &'static str)> {
    let of = |color| PALETTE.iter().position(|known| *known == color);
    match series.stroke {
        Stroke::Line => DASHES[of(series.color?)?],
        Stroke::Band => None,
    }
}

/// One line of a chart.
#[derive(Clone, Debug)]
pub struct Series {
    /// Text in the legend; empty for none.
    pub label: String,
    /// Colour of the line; `None` for the ink of the axes.
    pub color: Option<RGBColor>,
    /// How the line is drawn.
    pub stroke: Stroke,
    /// Points in the units of the axes.
    pub points: Vec<(f64, f64)>,
}

/// A closed outline with its name in the middle. Its first side is the front, drawn thicker.
#[derive(Clone, Debug)]
pub struct Outline {
    /// Colour of its lines, and paler of its inside.
    pub color: RGBColor,
    /// Name.
    pub label: String,
    /// Corners in the units of the axes.
    pub corners: Vec<(f64, f64)>,
}

impl Outline {
    /// Its middle.
    fn middle(&self) -> (f64, f64) {
        let count = self.corners.len().max(1) as f64;
        let corners = self.corners.iter();
        let (x, y) = corners.fold((0.0, 0.0), |(x, y), corner| (x + corner.0, y + corner.1));
        (x / count, y / count)
    }
}

/// A chart as data.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Title above the plot.
    pub title: String,
    /// Description of the horizontal axis, with its unit.
    pub x_label: String,
    /// Description of the vertical axis, with its unit.
    pub y_label: String,
    /// Size in pixels.
    pub size: (u32, u32),
    /// Whether a unit is equally long on both axes, as on a map.
    pub equal_axes: bool,
    /// Lines, drawn in order.
    pub series: Vec<Series>,
    /// Outlines drawn under the lines.
    pub outlines: Vec<Outline>,
}

/// Stretches of a picture across and down, in its units.
type Pixels = (std::ops::Range<i32>, std::ops::Range<i32>);

/// Why a chart could not be drawn.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("chart '{title}': {reason}")]
pub struct ChartError {
    /// The chart's title.
    pub title: String,
    /// What the drawing library said.
    pub reason: String,
}

/// What varies by less than this is shown as a straight line: the labels of its axis would all be
/// the same.
const FLAT: f64 = 1e-4;

/// Smallest interval holding all finite `values`, widened by 6 % and never empty.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
    if low > high {
        return (0.0, 1.0);
    }
    if high - low < FLAT {
        let middle = f64::midpoint(low, high);
        let half = 0.05 * middle.abs().max(1.0);
        return (middle - half, middle + half);
    }
    let margin = ((high - low) * 0.06).max(high.abs().max(low.abs()).max(1e-3) * 1e-3);
    (low - margin, high + margin)
}

/// The axis of a value that does not change: with zero on it, for there is no change to give it a
/// scale.
fn from_zero(value: f64) -> (f64, f64) {
    if value.abs() < FLAT {
        return (-1.0, 1.0);
    }
    let end = 1.1 * value;
    (end.min(0.0), end.max(0.0))
}

/// A line of at most [`MAX_POINTS`] points and both ends: of as many stretches as are needed, the
/// lowest and the highest point in their order, so a peak of one sample stays as high as it is.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= MAX_POINTS {
        return points.to_vec();
    }
    let mut out = Vec::with_capacity(MAX_POINTS + 2);
    out.extend(points.first());
    for stretch in points.chunks(points.len().div_ceil(MAX_POINTS / 2)) {
        let finite = stretch.iter().enumerate().filter(|(_, p)| p.1.is_finite());
        let lowest = finite.clone().min_by(|(_, a), (_, b)| a.1.total_cmp(&b.1));
        let highest = finite.max_by(|(_, a), (_, b)| a.1.total_cmp(&b.1));
        if let (Some(lowest), Some(highest)) = (lowest, highest) {
            let later = lowest.0.max(highest.0);
            let earlier = lowest.0.min(highest.0);
            out.extend([stretch[earlier], stretch[later]]);
        }
    }
    out.extend(points.last());
    out.dedup();
    out
}

impl Chart {
    /// The line of a series as the value of CSS `border-top`.
    #[must_use]
    pub fn css_line(series: &Series) -> String {
        let RGBColor(r, g, b) = series.color.unwrap_or(INK);
        let (width, opacity) = match series.stroke {
            Stroke::Line => (LINE_WIDTH + 1, 1.0),
            Stroke::Band => (BAND_WIDTH, BAND_OPACITY),
        };
        let style = dashes(series).map_or("solid", |(_, _, style)| style);
        format!("{width}px {style} rgb({r} {g} {b} / {opacity})")
    }

    /// Draws the chart as a picture of its own, with its legend in it.
    ///
    /// # Errors
    /// When the drawing library refuses; it names the chart.
    pub fn to_svg(&self) -> Result<String, ChartError> {
        Ok(self.svg(true)?.0)
    }

    /// The chart for a page that shows the legend, and where the plot is in it: left, right, top
    /// and bottom in the picture's units, then the ends of the x axis and of the y axis.
    fn to_svg_with_plot(&self) -> Result<(String, String), ChartError> {
        let (svg, (across, down)) = self.svg(false)?;
        let ((x0, x1), (y0, y1)) = self.ranges(self.size.1);
        let plot = format!(
            "{} {} {} {} {x0} {x1} {y0} {y1}",
            across.start, across.end, down.start, down.end
        );
        Ok((svg, plot))
    }

    fn failed(&self, reason: &dyn std::fmt::Display) -> ChartError {
        ChartError {
            title: self.title.clone(),
            reason: reason.to_string(),
        }
    }

    fn svg(&self, alone: bool) -> Result<(String, Pixels), ChartError> {
        let (width, height) = self.size;
        let drawn = (width * SCALE, height * SCALE);
        let mut svg = String::new();
        let area = SVGBackend::with_string(&mut svg, drawn).into_drawing_area();
        let plot = self
            .draw(&area, alone)
            .map_err(|reason| self.failed(&reason))?;
        drop(area);
        // The view box keeps the size drawn; only the size shown changes.
        let svg = svg.replacen(
            &format!("width=\"{}\" height=\"{}\"", drawn.0, drawn.1),
            &format!("width=\"{width}\" height=\"{height}\""),
            1,
        );
        Ok((svg, plot))
    }

    /// Ranges of both axes in a picture of that height: time axes fit tightly, maps keep one scale.
    fn ranges(&self, height: u32) -> ((f64, f64), (f64, f64)) {
        let all = || {
            let lines = self.series.iter().flat_map(|s| s.points.iter());
            lines.chain(self.outlines.iter().flat_map(|outline| &outline.corners))
        };
        let (mut x, mut y) = (range(all().map(|p| p.0)), range(all().map(|p| p.1)));
        if self.equal_axes {
            let inner = (
                f64::from(self.size.0 - LABEL_AREA.1 - 2 * MARGIN),
                f64::from(height - LABEL_AREA.0 - 2 * MARGIN - TITLE_HEIGHT),
            );
            let unit = ((x.1 - x.0) / inner.0).max((y.1 - y.0) / inner.1);
            let widen = |(low, high): (f64, f64), to: f64| {
                let spare = (to - (high - low)) / 2.0;
                (low - spare, high + spare)
            };
            (x, y) = (widen(x, unit * inner.0), widen(y, unit * inner.1));
        } else {
            let low = all().map(|p| p.0).fold(f64::INFINITY, f64::min);
            let high = all().map(|p| p.0).fold(f64::NEG_INFINITY, f64::max);
            if high > low {
                x = (low, high);
            }
            let low = all().map(|p| p.1).fold(f64::INFINITY, f64::min);
            let high = all().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
            if high - low < FLAT && low <= high {
                y = from_zero(f64::midpoint(low, high));
            }
        }
        (x, y)
    }

    /// Draws it; `alone` when no page around it shows the legend. Returns where the plot is.
    fn draw<B: DrawingBackend>(
        &self,
        root: &DrawingArea<B, Shift>,
        alone: bool,
    ) -> Result<Pixels, Box<dyn std::error::Error>>
    where
        B::ErrorType: 'static,
    {
        picture::prepare_font();
        root.fill(&WHITE)?;
        // Within the plot a legend would hide lines.
        let area = if alone {
            legend::below(root, &self.series)?
        } else {
            root.clone()
        };
        let ((x0, x1), (y0, y1)) = self.ranges(area.dim_in_pixel().1 / SCALE);
        let mut chart = ChartBuilder::on(&area)
            .caption(&self.title, text(17))
            .margin(MARGIN * SCALE)
            .x_label_area_size(LABEL_AREA.0 * SCALE)
            .y_label_area_size(LABEL_AREA.1 * SCALE)
            .build_cartesian_2d(x0..x1, y0..y1)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID.stroke_width(SCALE))
            .axis_style(INK.mix(0.5).stroke_width(SCALE))
            .set_all_tick_mark_size(5 * SCALE)
            .label_style(text(13))
            .axis_desc_style(text(14))
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_labels(8)
            .y_labels(7)
            .x_label_formatter(&|x| tick(*x, x1 - x0))
            .y_label_formatter(&|y| tick(*y, y1 - y0))
            .draw()?;
        for outline in &self.outlines {
            let Outline {
                color,
                label,
                corners,
            } = outline;
            chart.draw_series([Polygon::new(corners.clone(), color.mix(0.12).filled())])?;
            let closed = corners.iter().chain(corners.first()).copied();
            chart.draw_series(LineSeries::new(closed, color.mix(0.7).stroke_width(SCALE)))?;
            let front = corners.iter().take(2).copied();
            chart.draw_series(LineSeries::new(
                front,
                color.stroke_width(FRONT_WIDTH * SCALE),
            ))?;
            let centred = text(15).pos(Pos::new(HPos::Center, VPos::Center));
            chart.draw_series([Text::new(label.clone(), outline.middle(), centred)])?;
        }
        for (n, series) in self.series.iter().enumerate() {
            let after = self.series.iter().skip(n + 1);
            let named = after.filter(|series| !series.label.is_empty());
            let style = line_style(series, named.count());
            let points = thinned(&series.points);
            match scaled_dashes(series) {
                Some((dash, gap)) => {
                    chart.draw_series(DashedLineSeries::new(points, dash, gap, style))?;
                }
                None => {
                    chart.draw_series(LineSeries::new(points, style))?;
                }
            }
        }
        let plot = chart.plotting_area().get_pixel_range();
        root.present()?;
        Ok(plot)
    }
}

/// Text of so many pixels.
fn text(size: i32) -> TextStyle<'static> {
    ("sans-serif", size * SCALE as i32).into_font().color(&INK)
}

/// How a line is drawn over which `above` others are: broader, so that lines which coincide with it
/// do not hide it.
fn line_style(series: &Series, above: usize) -> ShapeStyle {
    let color = series.color.unwrap_or(INK);
    let above = u32::try_from(above.min(MOST_BROADENED)).unwrap_or(0);
    match series.stroke {
        Stroke::Line => color.stroke_width(LINE_WIDTH * SCALE + above * BROADER),
        Stroke::Band => color.mix(BAND_OPACITY).stroke_width(BAND_WIDTH * SCALE),
    }
}

/// Dashes and gaps of a series as they are drawn.
fn scaled_dashes(series: &Series) -> Option<(i32, i32)> {
    let scaled = |pixels: i32| pixels * SCALE as i32;
    dashes(series).map(|(dash, gap, _)| (scaled(dash), scaled(gap)))
}

/// A number at an axis that spans so much. What is left of zero after adding up steps is zero,
/// without a sign.
fn tick(value: f64, span: f64) -> String {
    let value = if value.abs() < 1e-9 * span {
        0.0
    } else {
        value
    };
    FloatPrettyPrinter {
        allow_scientific: false,
        min_decimal: 1,
        max_decimal: 5,
    }
    .print(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<(f64, f64)>) -> Chart {
        Chart {
            title: "a & b".into(),
            x_label: "t / s".into(),
            y_label: "x / m".into(),
            size: (400, 300),
            equal_axes: false,
            series: vec![Series {
                label: "line".into(),
                color: Some(PALETTE[0]),
                stroke: Stroke::Line,
                points,
            }],
            outlines: vec![],
        }
    }

    #[test]
    fn an_empty_chart_is_still_a_chart() {
        let svg = chart(vec![]).to_svg().unwrap();
        assert!(svg.starts_with("<svg"));
        assert!(svg.trim_end().ends_with("</svg>"));
    }

    #[test]
    fn text_is_escaped() {
        let svg = chart(vec![(0.0, 0.0), (1.0, 1.0)]).to_svg().unwrap();
        assert!(svg.contains("a &amp; b"));
    }

    #[test]
    fn zero_has_no_sign() {
        for (value, expected) in [
            (-2.8e-17, "0.0"),
            (-0.0, "0.0"),
            (-0.4, "-0.4"),
            (25.0, "25.0"),
        ] {
            assert_eq!(tick(value, 1.0), expected);
        }
        assert_eq!(tick(-2e-5, 1e-4), "-0.00002");
    }

    #[test]
    fn what_does_not_change_is_shown_against_zero() {
        let axis = |value: f64| {
            chart(vec![(0.0, value), (10.0, value + 1e-6)])
                .ranges(300)
                .1
        };
        assert_eq!(axis(0.0), (-1.0, 1.0));
        let (low, high) = axis(2.0);
        assert!(low == 0.0 && (high - 2.2).abs() < 1e-4, "{low} {high}");
        assert_eq!(axis(-2.0).1, 0.0);
    }

    /// A chart of wheels, whose lines coincide.
    fn wheels() -> Chart {
        let mut chart = chart(vec![]);
        let names = ["front left", "front right", "rear left", "rear right"];
        let series = names.iter().zip(PALETTE).map(|(name, color)| Series {
            label: (*name).into(),
            color: Some(color),
            stroke: Stroke::Line,
            points: vec![(0.0, 0.0), (1.0, 1.0)],
        });
        chart.series = series.collect();
        chart
    }

    #[test]
    fn a_legend_stands_below_the_plot_and_within_the_picture() {
        let chart = wheels();
        let (svg, (across, down)) = chart.svg(true).unwrap();
        assert_eq!(svg, chart.to_svg().unwrap());
        for (n, series) in chart.series.iter().enumerate() {
            let before = svg.split(&series.label).next().unwrap();
            let element = &before[before.rfind("<text").unwrap()..];
            let number = |name: &str| {
                let from = element.find(&format!(" {name}=\"")).unwrap() + name.len() + 3;
                let digits = element[from..].split('"').next().unwrap();
                digits.parse::<i32>().unwrap()
            };
            let (x, y) = (number("x"), number("y"));
            assert!(y > down.end && y < 300 * SCALE as i32, "{}", series.label);
            // Four of them do not fit beside each other here.
            assert_eq!(
                n == 3,
                x < across.start + 100 * SCALE as i32 && n > 0,
                "{x}"
            );
        }
        assert!(!chart.svg(false).unwrap().0.contains("front left"));
    }

    #[test]
    fn lines_that_coincide_differ_in_width() {
        let chart = wheels();
        let widths = (0..4).map(|n| line_style(&chart.series[n], 3 - n).stroke_width);
        let widths: Vec<u32> = widths.collect();
        assert!(widths.is_sorted_by(|a, b| a > b), "{widths:?}");
        let svg = chart.to_svg().unwrap();
        for width in widths {
            assert!(
                svg.contains(&format!("stroke-width=\"{width}\"")),
                "{width}"
            );
        }
    }

    #[test]
    fn thinning_keeps_both_ends() {
        let points: Vec<_> = (0..10_000).map(|i| (f64::from(i), 0.0)).collect();
        let thin = thinned(&points);
        assert!(thin.len() <= MAX_POINTS + 2);
        assert_eq!((thin[0].0, thin[thin.len() - 1].0), (0.0, 9999.0));
    }

    /// Strain of one sample, as it would vanish if every n-th point was drawn.
    #[test]
    fn thinning_keeps_peaks_of_one_sample() {
        let mut points: Vec<_> = (0..10_000).map(|i| (f64::from(i), 0.0)).collect();
        for (at, peak) in [(4_321, 7.0), (4_322, -5.0), (9_998, 3.0)] {
            points[at].1 = peak;
        }
        let thin = thinned(&points);
        assert!(thin.is_sorted_by(|a, b| a.0 < b.0));
        let peaks: Vec<_> = thin.into_iter().filter(|p| p.1 != 0.0).collect();
        assert_eq!(peaks, [(4_321.0, 7.0), (4_322.0, -5.0), (9_998.0, 3.0)]);
    }

    #[test]
    fn a_map_has_one_scale() {
        let mut map = chart(vec![(0.0, 0.0), (1.0, 10.0)]);
        map.equal_axes = true;
        let ((x0, x1), (y0, y1)) = map.ranges(300);
        let inner = (400.0 - 62.0 - 28.0, 300.0 - 46.0 - 28.0 - 30.0);
        assert!(((x1 - x0) / inner.0 - (y1 - y0) / inner.1).abs() < 1e-9);
    }
}
