//! The output of commands: text for people, JSON for scripts, little or nothing on request, and
//! exit codes.
//!
//! What a command has to say goes to the standard output, everything about how it gets on to the
//! standard error. `--json` replaces the text by one JSON document, and errors and notes by one
//! JSON object each. `--quiet` leaves out the text and what is said on the way; an asked-for JSON
//! document and errors are still written. Colours are only used on a terminal, and never when
//! NO_COLOR is set.

use std::io::{IsTerminal as _, Write as _};
use std::sync::OnceLock;
use std::time::Duration;

use anyhow::Context as _;
use comfy_table::{ContentArrangement, Table, presets};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use omnibus::accept::AcceptError;
use omnibus::bus::link::LinkError;
use omnibus::commission::calibrate::CalibrateError;
use omnibus::error::MasterError;
use omnibus::run::DriveError;
use serde_json::json;

/// What the help says about exit codes.
pub const EXIT_CODES: &str = "Exit codes:
  0    done
  1    failed for a reason not listed below: a file, a value, a limit
  2    wrong usage
  3    the bus could not be opened, or failed
  4    a robot did not answer, refused a request, or did not get ready; or another master
       commands the bus
  5    a robot faulted or was lost while moving; the group was ramped down
  6    a comparison or a check found differences or errors
  130  stopped on request (Ctrl-C); the group was ramped down";

/// How to speak.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub struct Output {
    /// Prints JSON instead of text.
    #[arg(long, global = true, help_heading = "Output")]
    pub json: bool,
    /// Prints no text and no progress, only errors (and JSON with --json).
    #[arg(long, short, global = true, help_heading = "Output")]
    pub quiet: bool,
}

static OUTPUT: OnceLock<Output> = OnceLock::new();

/// Sets how this process speaks; the first one counts.
pub fn set(output: Output) {
    let _ = OUTPUT.set(output);
}

fn mode() -> Output {
    OUTPUT.get().copied().unwrap_or_default()
}

/// Whether JSON is asked for.
pub fn json() -> bool {
    mode().json
}

/// Whether as little as possible is to be said.
pub fn quiet() -> bool {
    mode().quiet
}

/// Whether text is wanted.
pub fn prints_text() -> bool {
    !mode().quiet && !mode().json
}

/// Prints a line of text. Unlike `println!` it does not panic when the reader has gone (`omnibus
/// ... | head`).
pub fn print_line(line: impl std::fmt::Display) -> anyhow::Result<()> {
    if prints_text() {
        writeln!(std::io::stdout().lock(), "{line}")?;
    }
    Ok(())
}

/// Tells people how it goes, on the standard error; with `--json` as one JSON object a note.
pub fn print_note(line: impl std::fmt::Display) {
    if mode().quiet {
        return;
    }
    if mode().json {
        to_errors(json!({"note": line.to_string()}));
    } else {
        to_errors(line);
    }
}

/// Says that an incomplete file of an earlier call was found.
pub fn print_leftover(found: &std::path::Path, aside: &std::path::Path) {
    let (found, aside) = (found.display(), aside.display());
    print_note(format_args!(
        "{found} is from a call that did not end; it is now {aside}"
    ));
}

/// Prints a value as JSON, whatever was asked for.
pub fn print_json(value: &serde_json::Value) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(value).context("cannot write JSON")?;
    writeln!(std::io::stdout().lock(), "{text}")?;
    Ok(())
}

/// Prints a value as one line of JSON, whatever was asked for.
pub fn print_json_line(value: &serde_json::Value) -> anyhow::Result<()> {
    writeln!(std::io::stdout().lock(), "{value}")?;
    Ok(())
}

/// Columns of a terminal that says nothing else, and of everything that is no terminal.
const COLUMNS: u16 = 80;

/// An empty table, as wide as the terminal at most: longer cells go on in the next line.
pub fn table<'a>(header: impl IntoIterator<Item = &'a str>) -> Table {
    let columns = ratatui::crossterm::terminal::size()
        .ok()
        .filter(|(columns, _)| std::io::stdout().is_terminal() && *columns >= COLUMNS)
        .map_or(COLUMNS, |(columns, _)| columns);
    let mut table = Table::new();
    table
        .load_style(presets::UTF8_FULL_CONDENSED)
        .set_content_arrangement(ContentArrangement::Dynamic)
        .set_width(columns)
        .set_header(header);
    table
}

/// Steps of a bar that shows a share.
const STEPS: f64 = 1000.0;

/// How far something has come, on a terminal: a bar where its end is known, its time otherwise.
pub struct Progress(ProgressBar);

impl Progress {
    /// A bar for [`Progress::share`].
    pub fn new(name: &str) -> Self {
        Self::with(
            name,
            ProgressBar::new(STEPS as u64),
            "{prefix} [{bar:40}] {percent:>3} %  {elapsed} {msg}",
        )
    }

    /// For work of unknown length.
    pub fn endless(name: &str) -> Self {
        let progress = Self::with(
            name,
            ProgressBar::new_spinner(),
            "{spinner} {prefix}  {elapsed} {msg}",
        );
        progress.0.enable_steady_tick(Duration::from_millis(100));
        progress
    }

    fn with(name: &str, bar: ProgressBar, template: &str) -> Self {
        if !prints_text() {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_prefix(name.to_owned());
        Self(bar)
    }

    /// Shows a share, 0 to 1, and what is going on.
    pub fn share(&self, share: f64, what: &'static str) {
        self.0.set_position((share * STEPS) as u64);
        self.0.set_message(what);
    }

    /// Takes the bar away for a line of text or a question.
    pub fn aside<T>(&self, what: impl FnOnce() -> T) -> T {
        self.0.suspend(what)
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// Something was a comparison or a check found differences or errors; everything about it has been
/// printed.
#[derive(Debug)]
pub struct Found(pub String);

impl std::fmt::Display for Found {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Found {}

/// The command was called wrongly, which its arguments alone do not show.
#[derive(Debug)]
pub struct Usage(pub String);

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Usage {}

/// Prints what is wrong with the arguments, which were asked to produce JSON or not; `--help` and
/// `--version` come this way, too.
pub fn print_usage(error: &clap::Error) -> u8 {
    let wrong = error.use_stderr();
    if wrong && std::env::args_os().any(|argument| argument == "--json") {
        let text = error.render().to_string();
        let first = text.split("\n\n").next().unwrap_or_default();
        let first = first.trim_start_matches("error: ");
        to_errors(json!({"error": first, "exit_code": 2}));
    } else {
        let _ = error.print();
    }
    if wrong { 2 } else { 0 }
}

/// Prints an error.
pub fn print_error(error: &anyhow::Error) {
    if json() {
        let value = json!({"error": format!("{error:#}"), "exit_code": exit_code(error)});
        return to_errors(value);
    }
    let coloured = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    let (red, plain) = if coloured {
        ("\x1b[1;31m", "\x1b[0m")
    } else {
        ("", "")
    };
    to_errors(format_args!("{red}error:{plain} {error:#}"));
}

/// A line for people or programs that may have gone.
fn to_errors(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// The master's error that an error is. Those that hold it do not have it in their chains.
fn master_error<'a>(error: &'a (dyn std::error::Error + 'static)) -> Option<&'a MasterError> {
    if let Some(drive) = error.downcast_ref::<DriveError>() {
        drive.master()
    } else if let Some(CalibrateError::Master(inner)) = error.downcast_ref() {
        Some(inner)
    } else if let Some(accept) = error.downcast_ref::<AcceptError>() {
        match accept {
            AcceptError::Master(inner) => Some(inner),
            AcceptError::Drive(drive) => drive.master(),
            _ => None,
        }
    } else {
        error.downcast_ref()
    }
}

/// The exit code that an error stands for, see [`EXIT_CODES`].
pub fn exit_code(error: &anyhow::Error) -> u8 {
    let master = error.chain().find_map(master_error);
    if error.downcast_ref::<Found>().is_some() {
        return 6;
    }
    if error.downcast_ref::<Usage>().is_some() {
        return 2;
    }
    if error.chain().any(|cause| cause.is::<LinkError>()) {
        return 3;
    }
    match master.map(MasterError::cause) {
        Some(MasterError::Link(_)) => 3,
        Some(
            MasterError::NodeSilent { .. }
            | MasterError::BusDiagnosis { .. }
            | MasterError::WireVersion { .. }
            | MasterError::Refused { .. }
            | MasterError::WrongKey { .. }
            | MasterError::Barred { .. }
            | MasterError::Answer { .. }
            | MasterError::ReadBack { .. }
            | MasterError::Configuration { .. }
            | MasterError::NotReady { .. }
            | MasterError::Identification { .. }
            | MasterError::Update { .. }
            | MasterError::BoardGyro { .. }
            | MasterError::NoIndex { .. }
            | MasterError::RollersLost { .. }
            | MasterError::AnotherMaster(_)
            | MasterError::Lss(_),
        ) => 4,
        Some(
            MasterError::MemberFault { .. }
            | MasterError::MemberMissing { .. }
            | MasterError::MembersMissing { .. }
            | MasterError::MemberRestarted { .. }
            | MasterError::MemberLeft { .. }
            | MasterError::PoseJumped { .. }
            | MasterError::Displaced(_),
        ) => 5,
        Some(MasterError::Aborted) => 130,
        Some(
            MasterError::TooFast { .. }
            | MasterError::Busy { .. }
            | MasterError::NotStarted
            | MasterError::PoseLost
            | MasterError::NoAnswer
            | MasterError::PoseSource { .. }
            | MasterError::GyroSource { .. },
        )
        | None => 1,
    }
}

/// Whether a command only failed because the reader of its output has gone.
pub fn reader_gone(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<std::io::Error>()
        .is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
}
