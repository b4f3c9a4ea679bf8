//! `omnibus plot FILE` and `omnibus report FILE`: pictures and a page of a recording.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use omnibus::recording::{Recording, charts, page};
use protocol::cob;
use serde_json::json;

use super::convert::load;
use super::output::Progress;
use super::{print_line, print_note, refuse_input};

const PLOT_EXAMPLES: &str = "Examples:
  omnibus plot drive.mcap
  omnibus plot drive.mcap --output drive.png";

#[derive(clap::Args)]
#[command(after_help = PLOT_EXAMPLES)]
pub struct Plot {
    /// A recording, or a candump log whose name ends in .log.
    file: PathBuf,
    /// The picture: .svg or .png; by default both, beside the recording. Existing files are
    /// replaced.
    #[arg(long, short, value_name = "FILE")]
    output: Vec<PathBuf>,
}

const REPORT_EXAMPLES: &str = "Example:
  omnibus report drive.mcap --output drive.html";

#[derive(clap::Args)]
#[command(after_help = REPORT_EXAMPLES)]
pub struct Report {
    /// A recording, or a candump log whose name ends in .log.
    file: PathBuf,
    /// The page; by default beside the recording. An existing file is replaced.
    #[arg(long, short, value_name = "FILE.html")]
    output: Option<PathBuf>,
}

fn write(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    omnibus::file::replace(path, content)
        .with_context(|| format!("cannot write {}", path.display()))
}

fn refuse_recording(output: &Path, recording: &Path) -> anyhow::Result<()> {
    refuse_input("--output", output, recording, "the recording itself")
}

/// A recording with something to draw. What the group did is told by SYNC and what follows it.
fn drawable(file: &Path) -> anyhow::Result<Recording> {
    let recording = load(file, super::quiet())?;
    let mut frames = recording.frames.iter();
    if frames.len() == 0 {
        bail!(
            "{}: has no frames, so there is nothing to draw; give a recording of a bus with robots",
            file.display()
        );
    }
    if !frames.any(|recorded| recorded.frame.id() == cob::SYNC) && !super::quiet() {
        print_note(format_args!(
            "{}: no master has sent SYNC in it, so charts of the group's motion are empty",
            file.display()
        ));
    }
    Ok(recording)
}

/// What a picture's name asks for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Form {
    Svg,
    Png,
}

/// The form of a picture by its name, if it is one's.
pub fn form_of(path: &Path) -> Option<Form> {
    let extension = path.extension()?.to_str()?;
    match extension.to_ascii_lowercase().as_str() {
        "svg" => Some(Form::Svg),
        "png" => Some(Form::Png),
        _ => None,
    }
}

/// The form of a picture by its name; `option` is what gave it.
fn form(path: &Path, option: &str) -> anyhow::Result<Form> {
    let Some(form) = form_of(path) else {
        let path = path.display();
        usage!("{option} {path}: the name must end in .svg or .png");
    };
    Ok(form)
}

/// Writes charts in the form that the name asks for.
pub fn write_sheet(path: &Path, sheet: &chart::Sheet) -> anyhow::Result<()> {
    match form(path, "picture")? {
        Form::Png => write(path, &sheet.to_png()?),
        Form::Svg => write(path, sheet.to_svg()?.as_bytes()),
    }
}

/// `omnibus plot`.
pub fn plot(arguments: &Plot) -> anyhow::Result<()> {
    let mut outputs = arguments.output.clone();
    if outputs.is_empty() {
        outputs = ["svg", "png"]
            .map(|form| arguments.file.with_extension(form))
            .into();
    }
    // Of a name that was not given, only the recording can be blamed.
    for path in &arguments.output {
        form(path, "--output")?;
    }
    for path in &outputs {
        refuse_recording(path, &arguments.file)?;
    }
    let recording = drawable(&arguments.file)?;
    let progress = Progress::endless("drawing");
    let sheet = charts::sheet(&recording);
    for path in &outputs {
        write_sheet(path, &sheet)?;
    }
    drop(progress);
    for path in &outputs {
        if !super::quiet() && !super::json() {
            print_line(path.display())?;
        }
    }
    if super::json() {
        let (width, height) = sheet.size();
        let names: Vec<_> = outputs.iter().map(|p| p.display().to_string()).collect();
        return super::print_json(&json!({"files": names, "width": width, "height": height}));
    }
    Ok(())
}

/// `omnibus report`.
pub fn report(arguments: &Report) -> anyhow::Result<()> {
    let path = arguments.output.clone();
    let path = path.unwrap_or_else(|| arguments.file.with_extension("html"));
    refuse_recording(&path, &arguments.file)?;
    let recording = drawable(&arguments.file)?;
    let progress = Progress::endless("drawing");
    write(&path, page::to_html(&recording)?.as_bytes())?;
    drop(progress);
    if super::json() {
        return super::print_json(&serde_json::to_value(page::figures(&recording))?);
    }
    if !super::quiet() {
        print_line(path.display())?;
    }
    Ok(())
}
