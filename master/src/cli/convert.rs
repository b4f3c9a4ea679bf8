//! `omnibus convert FILE --to csv|candump|mcap|ros2`: recordings in other forms, without a bus.

use std::io::{self, BufWriter, Write};
use std::path::PathBuf;

use anyhow::Context as _;
use canopen::Micros;
use omnibus::file::Beside;
use omnibus::recording::{self, Recorder, Recording, Settings, candump, csv, rosbag};
use serde_json::json;

use super::output::Progress;

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Form {
    /// A table: one row per SYNC, one column per value.
    Csv,
    /// A candump log of all frames.
    Candump,
    /// A recording, from a candump log.
    Mcap,
    /// odom, tf and joint_states in a file that `ros2 bag play` reads.
    Ros2,
}

const EXAMPLES: &str = "Examples:
  omnibus convert drive.mcap --to csv --output drive.csv
  omnibus convert drive.mcap --to candump --output drive.log
  omnibus convert drive.mcap --to ros2 --output drive-ros2.mcap
  omnibus convert drive.log --to mcap --group groups/tcc-2.toml --output again.mcap";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// A recording, or a candump log whose name ends in .log.
    file: PathBuf,
    /// Output format.
    #[arg(long, value_enum)]
    to: Form,
    /// File to write; an existing one is replaced. By default standard output (not for mcap and
    /// ros2).
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Group file for a log without one; it gives the robots and their mounts.
    #[arg(long, value_name = "GROUP.toml")]
    group: Option<PathBuf>,
}

/// Reads a recording and says on standard error when it is not whole.
pub fn load(file: &std::path::Path, quiet: bool) -> anyhow::Result<Recording> {
    let progress = Progress::new("reading");
    let recording = recording::read_with(file, &mut |share| progress.share(share, ""))?;
    drop(progress);
    if let Some(damage) = &recording.damage
        && !quiet
    {
        super::print_note(format!("warning: {}: {damage}", file.display()));
    }
    Ok(recording)
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if let Some(path) = &arguments.output {
        super::refuse_input("--output", path, &arguments.file, "the recording itself")?;
        if let Some(group) = &arguments.group {
            super::refuse_input("--output", path, group, "the group file in use")?;
        }
    }
    let mut recording = load(&arguments.file, super::quiet())?;
    if let Some(path) = &arguments.group {
        recording.header.group = Some(super::input::text(path, "the path of a group file")?);
        recording.group()?;
    }
    let progress = Progress::endless("converting");
    match (arguments.to, &arguments.output) {
        (Form::Mcap | Form::Ros2, None) => usage!(
            "--output FILE.mcap is missing: a recording is binary and cannot go to standard output"
        ),
        (Form::Mcap, Some(path)) => {
            let recorder = Recorder::create(
                path,
                &recording.header,
                Settings {
                    waits: true,
                    ..Settings::default()
                },
            )?;
            let sink = recorder.sink();
            for recorded in &recording.frames {
                sink(
                    Micros(recorded.t_ns / 1_000),
                    &recorded.frame,
                    recorded.sent,
                );
            }
            recorder.finish()?;
        }
        (Form::Ros2, Some(path)) => {
            let group = recording.group()?.context(
                "the recording has no group file, which says where its wheels are; give --group",
            )?;
            // In memory first, because the file's index is written by seeking.
            let mut whole = io::Cursor::new(Vec::new());
            let written = rosbag::write(&recording, &group, &mut whole)
                .and_then(|_| Beside::create(path))
                .and_then(|mut file| {
                    file.write_all(whole.get_ref())?;
                    file.commit()
                });
            written.with_context(|| format!("cannot write {}", path.display()))?;
        }
        (form, Some(path)) => {
            let written = Beside::create(path).and_then(|mut file| {
                write(form, &recording, &mut file)?;
                file.commit()
            });
            written.with_context(|| format!("cannot write {}", path.display()))?;
        }
        (form, None) => {
            // The lines themselves show how far it has come.
            drop(progress);
            return write(form, &recording, &mut BufWriter::new(io::stdout().lock()))
                .map_err(Into::into);
        }
    }
    drop(progress);
    // On the standard output is the recording itself, unless it went into a file.
    if super::json() && arguments.output.is_some() {
        return super::print_json(&json!({
            "file": arguments.output.as_ref().map(|p| p.display().to_string()),
            "frames": recording.frames.len(),
            "seconds": recording.seconds(), "damage": recording.damage,
        }));
    }
    match &arguments.output {
        Some(path) => super::print_line(path.display()),
        None => Ok(()),
    }
}

fn write(form: Form, recording: &Recording, out: &mut impl Write) -> io::Result<()> {
    match form {
        Form::Csv => csv::write(recording, out),
        Form::Candump | Form::Mcap | Form::Ros2 => candump::write(recording, out),
    }
}
