//! Charts as stand-alone pictures: SVG with the legend inside, and PNG.
//!
//! A PNG is drawn as large as an SVG and then averaged down to twice the nominal size, which
//! smooths its lines. Its font is embedded, so it is the same on every machine.

use std::sync::Once;

use plotters::prelude::*;
#[cfg(not(target_arch = "wasm32"))]
use plotters::style::{FontStyle, register_font};

use crate::bitmap::Bitmap;
use crate::{Chart, ChartError, SCALE};

/// Pixels of a PNG per nominal pixel.
const ZOOM: u32 = 2;
/// Each pixel of a PNG is the mean of a square of so many drawn.
const BLOCK: u32 = SCALE / ZOOM;

/// Makes the embedded font known to the drawing library; it measures text with it.
pub(crate) fn prepare_font() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // A font that cannot be read shows as an error of the first chart. The library has no fonts
        // of its own in a browser.
        #[cfg(not(target_arch = "wasm32"))]
        let _ = register_font(
            "sans-serif",
            FontStyle::Normal,
            epaint_default_fonts::UBUNTU_LIGHT,
        );
    });
}

/// A chart at a place of a sheet: that of its upper left corner, in nominal pixels.
#[derive(Clone, Debug)]
pub struct Placed {
    /// From the left edge.
    pub left: u32,
    /// From the upper edge.
    pub top: u32,
    /// The chart.
    pub chart: Chart,
}

/// Charts side by side and above each other in one picture.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    /// The charts.
    pub charts: Vec<Placed>,
}

impl Sheet {
    /// Width and height in nominal pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        let ends = self
            .charts
            .iter()
            .map(|at| (at.left + at.chart.size.0, at.top + at.chart.size.1));
        ends.fold((1, 1), |(w, h), (x, y)| (w.max(x), h.max(y)))
    }

    /// The sheet as SVG.
    ///
    /// # Errors
    /// When a chart cannot be drawn.
    pub fn to_svg(&self) -> Result<String, ChartError> {
        let (width, height) = self.size();
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
        );
        for Placed { left, top, chart } in &self.charts {
            let (svg, _) = chart.svg(true)?;
            out.push_str(&svg.replacen("<svg ", &format!("<svg x=\"{left}\" y=\"{top}\" "), 1));
        }
        out.push_str("</svg>\n");
        Ok(out)
    }

    /// The sheet as a PNG, [`ZOOM`] times as large.
    ///
    /// # Errors
    /// When a chart cannot be drawn.
    pub fn to_png(&self) -> Result<Vec<u8>, ChartError> {
        let (width, height) = self.size();
        let (width, height) = (width * ZOOM, height * ZOOM);
        let mut sheet = vec![255; width as usize * height as usize * 3];
        for Placed { left, top, chart } in &self.charts {
            let pixels = chart.pixels()?;
            let row = (chart.size.0 * ZOOM) as usize * 3;
            for (n, line) in pixels.chunks_exact(row).enumerate() {
                let at =
                    ((top * ZOOM) as usize + n) * width as usize * 3 + (left * ZOOM) as usize * 3;
                if let Some(place) = sheet.get_mut(at..at + row) {
                    place.copy_from_slice(line);
                }
            }
        }
        let failed = |reason: png::EncodingError| ChartError {
            title: "PNG".into(),
            reason: reason.to_string(),
        };
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(failed)?;
        writer.write_image_data(&sheet).map_err(failed)?;
        writer.finish().map_err(failed)?;
        Ok(out)
    }
}

impl Chart {
    /// Rows of red, green, blue; [`ZOOM`] times the nominal size.
    fn pixels(&self) -> Result<Vec<u8>, ChartError> {
        let drawn = (self.size.0 * SCALE, self.size.1 * SCALE);
        let mut buffer = vec![255; drawn.0 as usize * drawn.1 as usize * 3];
        {
            let area = Bitmap::new(&mut buffer, drawn).into_drawing_area();
            self.draw(&area, true)
                .map_err(|reason| self.failed(&reason))?;
        }
        let (width, block) = (drawn.0 as usize, BLOCK as usize);
        let mut out = Vec::with_capacity(buffer.len() / (block * block));
        for rows in buffer.chunks_exact(width * 3 * block) {
            for column in 0..width / block {
                let mut sums = [0; 3];
                for row in rows.chunks_exact(width * 3) {
                    let from = column * block * 3;
                    for pixel in row[from..from + block * 3].chunks_exact(3) {
                        for (sum, value) in sums.iter_mut().zip(pixel) {
                            *sum += u32::from(*value);
                        }
                    }
                }
                // A mean of bytes is a byte.
                out.extend(sums.map(|sum| u8::try_from(sum / (BLOCK * BLOCK)).unwrap_or(u8::MAX)));
            }
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PALETTE, Series, Stroke};

    fn sheet() -> Sheet {
        let chart = Chart {
            title: "title".into(),
            x_label: "t / s".into(),
            y_label: "x / m".into(),
            size: (200, 150),
            equal_axes: false,
            series: vec![Series {
                label: "line".into(),
                color: Some(PALETTE[1]),
                stroke: Stroke::Line,
                points: vec![(0.0, 0.0), (1.0, 1.0)],
            }],
            outlines: vec![],
        };
        Sheet {
            charts: vec![
                Placed {
                    left: 0,
                    top: 0,
                    chart: chart.clone(),
                },
                Placed {
                    left: 200,
                    top: 10,
                    chart,
                },
            ],
        }
    }

    #[test]
    fn a_line_that_turns_back_has_no_spike_beyond_its_data() {
        let mut chart = sheet().charts.remove(0).chart;
        // Back and forth within a pixel or two.
        let noise = (0..100).map(|n| (0.4 + 2e-3 * f64::from(n), f64::from(n * 37 % 11) / 22.0));
        chart.series[0].points = [(0.0, 0.0)].into_iter().chain(noise).collect();
        chart.series[0].points.extend([(0.9, 0.0), (1.0, 1.0)]);
        let (_, (across, down)) = chart.svg(true).unwrap();
        let pixels = chart.pixels().unwrap();
        let width = (chart.size.0 * ZOOM) as usize;
        let zoomed = |drawn: i32| drawn as usize / BLOCK as usize;
        // Up to half of the plot's height at half of its width; a quarter of the width around.
        let (left, right) = (zoomed(across.start), zoomed(across.end));
        let columns = left + (right - left) * 3 / 8..left + (right - left) * 5 / 8;
        let top = zoomed(down.start) + (zoomed(down.end) - zoomed(down.start)) / 3;
        let RGBColor(r, _, b) = PALETTE[1];
        assert!(r > b, "orange");
        for (n, pixel) in pixels.chunks_exact(3).enumerate() {
            let (row, column) = (n / width, n % width);
            let outside = row < top || row > zoomed(down.end) + 4;
            if outside && columns.contains(&column) {
                let is_orange = i16::from(pixel[0]) > i16::from(pixel[2]) + 8;
                assert!(!is_orange, "{column}, {row}: {pixel:?}");
            }
        }
    }

    #[test]
    fn a_sheet_holds_its_charts() {
        assert_eq!(sheet().size(), (400, 160));
        let svg = sheet().to_svg().unwrap();
        assert_eq!(svg.matches("<svg ").count(), 3);
        assert!(svg.contains("x=\"200\" y=\"10\""));
    }

    #[test]
    fn a_png_has_the_line_in_its_colour_and_both_charts() {
        let png = sheet().to_png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&png))
            .read_info()
            .unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height), (800, 320));
        let orange = |x: usize| {
            let RGBColor(r, g, b) = PALETTE[1];
            let near = |a: u8, b: u8| a.abs_diff(b) < 8;
            pixels
                .chunks_exact(3)
                .enumerate()
                .any(|(n, p)| n % 800 / 400 == x && near(p[0], r) && near(p[1], g) && near(p[2], b))
        };
        assert!(orange(0) && orange(1));
    }
}
