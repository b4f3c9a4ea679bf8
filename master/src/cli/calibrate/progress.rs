//! The progress of a calibration: a bar on a terminal, a line for every motion elsewhere, and a
//! picture that is drawn again after every motion.

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use omnibus::commission::calibrate::chart::{self, Measured};
use omnibus::commission::calibrate::journal::{Step, What};
use std::io::IsTerminal as _;

use crate::cli::{output, plot, print_note};

/// What users see while the group is calibrated.
pub struct Progress {
    bar: Option<ProgressBar>,
    plot: Option<PathBuf>,
    seen: Vec<Measured>,
}

impl Progress {
    /// `plot` is the picture or page, checked by [`form`].
    pub fn new(plot: Option<PathBuf>) -> Self {
        let on_a_terminal = output::prints_text() && std::io::stderr().is_terminal();
        let bar = on_a_terminal.then(|| {
            let bar = ProgressBar::new(1);
            let style = ProgressStyle::with_template("[{bar:24}] {pos}/{len}  {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar
        });
        Self {
            bar,
            plot,
            seen: Vec::new(),
        }
    }

    /// Shows a step.
    pub fn show(&mut self, step: &Step) {
        if let What::Searches(search) = &step.what {
            return self.line(search.to_string());
        }
        let left = time(step.seconds_left);
        let name = &step.name;
        if let Some(bar) = &self.bar {
            bar.set_length(step.of as u64);
            bar.set_position(step.number as u64);
            bar.set_message(format!("{name}, {left} to go"));
        }
        let motion = format!("motion {} of about {}: {name}", step.number, step.of);
        match &step.what {
            What::Begins if self.bar.is_none() => print_note(format!("{motion}; {left} to go")),
            What::Begins | What::Searches(_) => {}
            What::Again(reason) => self.line(format!("{motion} is driven again: {reason}")),
            What::Kept => self.line(format!("{motion}: from the earlier run")),
            What::LeftOut => self.line(format!("{motion}: left out")),
            What::Finished(observed) => {
                self.seen.extend(chart::seen(observed));
                self.draw();
            }
        }
    }

    fn line(&self, line: String) {
        match &self.bar {
            Some(bar) => bar.println(line),
            None => print_note(line),
        }
    }

    fn draw(&self) {
        let Some(path) = &self.plot else { return };
        if self.seen.is_empty() {
            return;
        }
        // A picture that cannot be drawn stops no drive; the last one reports it.
        let _ = write(path, &chart::so_far(&self.seen), true);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn time(seconds: f64) -> String {
    let seconds = seconds.round().max(0.0);
    format!("{}:{:02.0} min", (seconds / 60.0).floor(), seconds % 60.0)
}

fn is_page(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str());
    extension.is_some_and(|e| e.eq_ignore_ascii_case("html"))
}

/// Refuses a name that is neither picture nor page.
pub fn form(path: &Path) -> anyhow::Result<()> {
    if !is_page(path) && plot::form_of(path).is_none() {
        let path = path.display();
        usage!("--plot {path}: the name must end in .svg, .png or .html");
    }
    Ok(())
}

/// Writes a picture, or a page that shows it and, while `live`, reloads itself.
pub fn write(path: &Path, sheet: &::chart::Sheet, live: bool) -> anyhow::Result<()> {
    if !is_page(path) {
        return plot::write_sheet(path, sheet);
    }
    let refresh = if live {
        "<meta http-equiv=\"refresh\" content=\"2\">"
    } else {
        ""
    };
    let page = format!(
        "<!doctype html><meta charset=\"utf-8\">{refresh}<title>Calibration</title>\n{}",
        sheet.to_svg()?
    );
    omnibus::file::replace(path, page)?;
    Ok(())
}
