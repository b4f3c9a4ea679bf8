//! One self-contained page, without fonts or network access, so that it can be mailed. Its one
//! script zooms charts; without it they show the same.
//!
//! The caller has to [`escape`] text from files; charts become inline SVG.

use std::fmt::Write as _;

use crate::{Chart, ChartError};

const STYLE: &str = "
:root{color-scheme:light}
body{font:16px/1.55 system-ui,-apple-system,'Segoe UI',Roboto,sans-serif;color:#2d343e;
background:#f4f6f8;margin:0}
main{max-width:1100px;margin:0 auto;padding:32px 20px 64px}
h1{font-size:30px;line-height:1.2;margin:0 0 6px}
h2{font-size:20px;margin:44px 0 10px}
p{max-width:72ch}
.lead{color:#5b6673;margin:0 0 24px}
.cards{display:flex;flex-wrap:wrap;gap:12px;margin:22px 0}
.card{background:#fff;border:1px solid #e1e6eb;border-radius:8px;padding:12px 18px;flex:1 1 150px}
.card b{display:block;font-size:23px;font-variant-numeric:tabular-nums}
.card span{color:#5b6673;font-size:14px}
table{border-collapse:collapse;background:#fff;border:1px solid #e1e6eb;
font-variant-numeric:tabular-nums}
th,td{padding:8px 16px;text-align:right;border-bottom:1px solid #e9edf1}
th:first-child,td:first-child{text-align:left}
thead th{font-weight:600;border-bottom:2px solid #cfd6dd}
td.paper,th.paper{color:#5b6673}
figure{background:#fff;border:1px solid #e1e6eb;border-radius:8px;margin:12px 0;padding:6px}
figure svg{display:block;width:100%;height:auto;max-width:1040px;margin:0 auto}
figure.map svg{max-width:760px}
figcaption{display:flex;flex-wrap:wrap;gap:4px 20px;justify-content:center;font-size:14px;
color:#5b6673;padding:0 0 8px}
figcaption i{display:inline-block;width:22px;margin-right:7px;vertical-align:middle}
figure[data-plot]{position:relative}
figure[data-plot] svg{cursor:crosshair}
svg.zoomed polyline{vector-effect:non-scaling-stroke;stroke-width:2px}
.ticks,.box{position:absolute;pointer-events:none;font-size:12px}
.ticks span{position:absolute;background:rgb(255 255 255 / .8);padding:0 3px}
.box{border:1px solid #005fa0;background:rgb(0 95 160 / .1)}
.box[hidden]{display:none}
.pair{display:grid;grid-template-columns:1fr 1fr;gap:12px}
.pair figure{margin:0 0 12px}
@media (max-width:760px){.pair{grid-template-columns:1fr}}
code{background:#e9edf1;border-radius:4px;padding:1px 5px;font-size:90%}
";

/// Zooms charts.
const ZOOM: &str = include_str!("zoom.js");

/// Text made safe between tags.
#[must_use]
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Appends a chart, with its legend under it. `class` is `map` or nothing.
///
/// # Errors
/// When the chart cannot be drawn.
pub fn figure(out: &mut String, class: &str, chart: &Chart) -> Result<(), ChartError> {
    let (svg, plot) = chart.to_svg_with_plot()?;
    let _ = write!(out, "<figure class=\"{class}\" data-plot=\"{plot}\">{svg}");
    out.push_str("<figcaption>");
    for series in chart
        .series
        .iter()
        .filter(|series| !series.label.is_empty())
    {
        let _ = write!(
            out,
            "<span><i style=\"border-top:{}\"></i>{}</span>",
            Chart::css_line(series),
            escape(&series.label),
        );
    }
    out.push_str("</figcaption></figure>");
    Ok(())
}

/// The beginning of a page, up to its heading. Both texts are escaped already.
#[must_use]
pub fn begin(title: &str, heading: &str) -> String {
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
         <title>{title}</title><style>{STYLE}</style></head><body><main>\
         <h1>{heading}</h1>"
    )
}

/// Ends what [`begin`] began.
pub fn end(out: &mut String) {
    let _ = write!(out, "</main><script>\n{ZOOM}</script></body></html>\n");
}
