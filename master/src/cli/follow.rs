//! `omnibus follow CURVE`: drives a curve and prints the figures.

use std::path::PathBuf;

use anyhow::Context as _;
use canopen::Micros;
use clap::ValueEnum as _;
use group::GroupFile;
use kinematics::Pose;
use omnibus::bus::address::BusAddress;
use omnibus::bus::punctuality::Punctuality;
use omnibus::file;
use omnibus::monitor::rows::slowdown;
use omnibus::path::course::{Course, Frame, Shape};
use omnibus::path::curve::{Curve, RAMP};
use omnibus::path::file::FARTHEST;
use omnibus::path::steering::Law;
use omnibus::report::{self, Report, Run};
use omnibus::run::{self, Drive, DriveError, Feedback, Record, Source, Stopped};
use omnibus::session::roller_index::IndexSearch;
#[cfg(feature = "simulation")]
use omnibus::simulation::run::simulated;
use serde_json::{Value, json};

use super::output::Progress;
use super::recorder::{self, RecordTo};
use super::{
    Target, Usage, json, print_json, print_line, print_note, refuse_input, refuse_shared, sync_json,
};

const EXAMPLES: &str = "Examples:
  omnibus follow figure-eight --bus sim:groups/tcc-3.toml
  omnibus follow circle --repeats 3 --heading 45 --bus sim:groups/tcc-2.toml
  omnibus follow circle --scale 0.2 --bus sim:groups/single.toml
  omnibus follow circle --frame body --speed 0.5 --bus socketcan:can0 --group groups/tcc-2.toml
  omnibus follow my-path.csv --pose tcp://127.0.0.1:7705 --bus slcan:/dev/ttyACM0 --group my-group.toml
  omnibus follow figure-eight --pose truth --compensation off --bus sim:groups/tcc-3.toml

A CSV file has the columns t,x,y or t,x,y,heading (s, m, m, rad). The curve begins where the group stands.
Ctrl-C ramps the group down; pressed again, it takes the robots out of OPERATIONAL at once.";

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Switch {
    On,
    Off,
}

fn shape(text: &str) -> Result<Shape, String> {
    if let Ok(curve) = Curve::from_str(text, true) {
        return Ok(Shape::Named(curve));
    }
    if text.to_ascii_lowercase().ends_with(".csv") {
        return Ok(Shape::File(text.into()));
    }
    let names: Vec<_> = Curve::value_variants().iter().map(|c| c.name()).collect();
    Err(format!("give one of {}, or a .csv file", names.join(", ")))
}

/// A place as X,Y or X,Y,DEGREES.
pub(super) fn place(text: &str) -> Result<Pose<f64>, String> {
    let numbers: Result<Vec<f64>, _> = text
        .split(',')
        .map(|part| super::real(part.trim()))
        .collect();
    match numbers.as_deref() {
        Ok(&[x, y, ..]) if x.abs().max(y.abs()) > FARTHEST => Err(format!(
            "{text} is farther than {FARTHEST} m from zero; choose a frame with a nearer origin"
        )),
        Ok(&[x, y]) => Ok(Pose::new(x, y, 0.0)),
        Ok(&[x, y, degrees]) => Ok(Pose::new(x, y, degrees.to_radians())),
        _ => Err("give X,Y or X,Y,DEGREES".into()),
    }
}

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// figure-eight, circle, harmonic, forward, lateral, oblique, turn, centripetal, or FILE.csv.
    #[arg(value_parser = shape)]
    curve: Shape,
    #[command(flatten)]
    target: Target,
    /// Whether the robots compensate for wheel slip, with the group file's coefficients.
    #[arg(long, value_enum, default_value_t = Switch::On)]
    compensation: Switch,
    /// Duration of the acceleration at the beginning and at the end, s.
    #[arg(
        long,
        default_value_t = RAMP,
        value_name = "SECONDS",
        allow_negative_numbers = true,
        value_parser = super::real::<f64>
    )]
    ramp: f64,
    /// Number of times that a closed curve is driven, without stopping in between.
    #[arg(long, default_value_t = 1)]
    repeats: u32,
    /// Size, as a multiple of the curve's own. The duration stays the same, so a small curve is
    /// slow.
    #[arg(
        long,
        default_value_t = 1.0,
        value_name = "FACTOR",
        allow_negative_numbers = true,
        value_parser = super::real::<f64>
    )]
    scale: f64,
    /// Position and heading at which the curve begins, in the frame of the results and of `--pose
    /// tcp://`: metres, metres, degrees.
    #[arg(long, value_name = "X,Y[,DEGREES]", value_parser = place, allow_hyphen_values = true)]
    at: Option<Pose<f64>>,
    /// Prints the results in the axes of the source paper (x lateral, y longitudinal), beside its
    /// values.
    #[arg(long)]
    paper: bool,
    /// Speed, as a multiple of the curve's own.
    #[arg(
        long,
        default_value_t = 1.0,
        value_name = "FACTOR",
        allow_negative_numbers = true,
        value_parser = super::real::<f64>
    )]
    speed: f64,
    /// Heading offset, degrees counter-clockwise.
    #[arg(
        long,
        default_value_t = 0.0,
        value_name = "DEGREES",
        allow_negative_numbers = true,
        value_parser = super::real::<f64>
    )]
    heading: f64,
    /// Reference of the heading offset: the curve's own heading, or the direction of travel.
    #[arg(long, value_enum, default_value_t = Frame::World)]
    frame: Frame,
    /// Source of poses for feedback: tcp://HOST:PORT (JSON lines), odometry, or truth on a
    /// simulated bus.
    #[arg(long, value_name = "SOURCE")]
    pose: Option<Source>,
    /// Gain of the feedback for position and heading, 1/s.
    #[arg(long, default_value_t = Law::default().gain, value_name = "GAIN", requires = "pose",
          allow_negative_numbers = true, value_parser = super::real::<f32>)]
    gain: f32,
    /// Also drives without feedback first, for comparison; a simulated bus always does.
    #[arg(long, requires = "pose")]
    compare: bool,
    /// Begins with mean roller angles where a wheel has not passed its index, instead of first
    /// driving one turn of the wheels ahead and back. The index is found on the way.
    #[arg(long)]
    no_seek: bool,
    /// Drives only the first seconds of the curve.
    #[arg(long)]
    quick: bool,
    /// Writes an HTML report with charts, also of a drive that ends early; an existing file is
    /// replaced.
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Recorded are the curve and what an observer saw, too.
    #[command(flatten)]
    record: RecordTo,
    /// Writes every frame as a candump log; an existing file is replaced.
    #[arg(long, value_name = "FILE.log")]
    candump: Option<PathBuf>,
    /// Writes the log of the emulated robots' firmware; an existing file is replaced.
    #[arg(long, value_name = "FILE.log")]
    log: Option<PathBuf>,
}

impl Arguments {
    fn course(&self) -> Course {
        Course {
            shape: self.curve.clone(),
            ramp: self.ramp,
            repeats: self.repeats,
            scale: self.scale,
            from: self.at,
            speed: self.speed,
            heading: self.heading.to_radians(),
            frame: self.frame,
            quick: self.quick,
        }
    }

    /// Refuses outputs that would replace what the command reads or each other, or that cannot be
    /// written.
    fn check_outputs(&self) -> anyhow::Result<()> {
        let outputs = [
            ("--record", &self.record.record),
            ("--report", &self.report),
            ("--candump", &self.candump),
            ("--log", &self.log),
        ];
        let given = outputs.map(|(option, path)| Some((option, path.as_deref()?)));
        let given: Vec<_> = given.into_iter().flatten().collect();
        refuse_shared(&given)?;
        for (option, path) in given {
            self.target.check_output(option, path)?;
            if let Shape::File(curve) = &self.curve {
                refuse_input(option, path, curve, "the file of the curve")?;
            }
        }
        Ok(())
    }

    /// What is reported of one drive.
    fn results(&self, group: &GroupFile, run: Run) -> Report {
        let backend = self.target.backend();
        let mut report = run::report(group, &self.course().name(), backend, vec![run]);
        report.paper = self.paper;
        report
    }

    /// Writes the HTML report, if one is asked for.
    fn write_report(&self, report: &Report) -> anyhow::Result<()> {
        let Some(path) = &self.report else {
            return Ok(());
        };
        file::replace(path, report::html::to_html(report)?)
            .with_context(|| format!("cannot write {}", path.display()))
    }

    /// Writes the report of a drive that ended before its curve did, and returns why it ended.
    fn ended(&self, group: &GroupFile, error: anyhow::Error) -> anyhow::Error {
        match error.downcast() {
            Ok(DriveError::Stopped(stopped)) => {
                let Stopped { error, run } = *stopped;
                let mut report = self.results(group, run);
                report.stopped = Some(error.to_string());
                if let Err(problem) = self.write_report(&report) {
                    print_note(format_args!("{problem:#}"));
                }
                error.into()
            }
            Ok(error) => error.into(),
            Err(error) => error,
        }
    }

    /// The feedback of each drive: without first, where that is wanted for comparison.
    fn feedbacks(&self) -> anyhow::Result<Vec<Option<Feedback>>> {
        let Some(source) = &self.pose else {
            return Ok(vec![None]);
        };
        if !(self.gain > 0.0 && self.gain <= 5.0) {
            usage!(
                "--gain: {} 1/s is not between 0 and 5; a higher gain makes the loop oscillate",
                self.gain
            );
        }
        let law = Law {
            gain: self.gain,
            yaw_gain: self.gain,
            ..Law::default()
        };
        let feedback = |corrects| {
            Some(Feedback {
                source: source.clone(),
                law,
                corrects,
            })
        };
        if self.compare || matches!(self.target.bus, BusAddress::Sim(_)) {
            Ok(vec![feedback(false), feedback(true)])
        } else {
            Ok(vec![feedback(true)])
        }
    }
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = target.group()?;
    let course = arguments.course();
    course.check().map_err(|error| Usage(error.to_string()))?;
    let name = course.name();
    let feedbacks = arguments.feedbacks()?;
    let simulated = matches!(target.bus, BusAddress::Sim(_));
    if simulated && matches!(arguments.pose, Some(Source::Stream(_))) {
        usage!(
            "--pose tcp://: a simulated bus in this process has virtual time, which other \
             programs do not share; give --pose truth, or use omnibus-sim serve with --slcan-tcp and --pose-tcp"
        );
    }
    if !simulated && (arguments.candump.is_some() || arguments.log.is_some()) {
        usage!("--candump and --log are for simulated buses; use candump itself");
    }
    arguments.check_outputs()?;
    let abort = super::abort_on_ctrl_c()?;
    let (mut runs, mut syncs, mut recorded) = (Vec::new(), Vec::new(), Ok(()));
    for (n, feedback) in feedbacks.iter().enumerate() {
        // Of two drives the second is the one that counts.
        let recorder = if n + 1 == feedbacks.len() {
            let activity = format!("follow {name}");
            arguments.record.begin(target, &activity, Micros(0))?
        } else {
            None
        };
        let drive = Drive {
            group: &group,
            course: course.clone(),
            feedback: feedback.clone(),
            compensation: arguments.compensation == Switch::On,
            elf: target.elf()?,
            candump: arguments.candump.clone(),
            log: arguments.log.clone(),
            abort: abort.clone(),
            record: recorder.as_ref().map(|recorder| recorder as &dyn Record),
            index_search: (!arguments.no_seek).then_some(&announce),
        };
        let driven = drive_once(target, &group, &drive, &name);
        // What was heard is kept however it ended, and the result is printed whatever became of it.
        recorded = recorder::finish(recorder);
        let (run, sync) = driven.map_err(|error| arguments.ended(&group, error))?;
        runs.push(run);
        syncs.push(sync);
    }
    let rms: Vec<f64> = runs.iter().map(|run| run.errors.rms_mm).collect();
    let last = runs.pop().context("nothing was driven")?;
    let report = arguments.results(&group, last);
    let written = recorded.and(arguments.write_report(&report));
    let law = feedbacks.last().and_then(|f| f.as_ref()).map(|f| f.law);
    if json() {
        let mut document: Value = serde_json::from_str(&report::json::to_json(&report))?;
        if let Some(law) = law {
            document["feedback"] = json!({"gain": law.gain, "limit": law.limit, "yaw_gain": law.yaw_gain,
                "yaw_limit": law.yaw_limit, "rms_mm": rounded(rms.last().copied()),
                "rms_mm_without": rounded((rms.len() > 1).then(|| rms[0]))});
        }
        document["sync"] = json!(syncs.last().and_then(|s| s.as_ref()).map(sync_json));
        print_json(&document)?;
        return written;
    }
    print_line(report::table::to_table(&report))?;
    if arguments.paper {
        print_line("Axes as in the paper: x lateral, y longitudinal.")?;
    }
    let rows = report.runs.last().map(|run| run.rows.as_slice());
    super::print_slowdown(rows.and_then(slowdown), &group);
    if let Some(law) = law {
        print_line(format_args!("{law}"))?;
        match rms[..] {
            [without, with] => print_line(format_args!(
                "rms tracking error: {without:.2} mm without feedback, {with:.2} mm with"
            ))?,
            _ => print_line(
                "see the rms tracking error above; --compare also drives without feedback",
            )?,
        }
    }
    for sync in syncs.iter().flatten() {
        print_note(sync);
    }
    written
}

/// Says what happens before the curve, and how much room it needs.
fn announce(search: &IndexSearch) {
    print_note(search);
    print_note("(--no-seek skips this: the robots then begin with mean roller angles.)");
}

/// Four decimals.
fn rounded(value: Option<f64>) -> Option<f64> {
    value.map(|value| (value * 1e4).round() / 1e4)
}

fn drive_once(
    target: &Target,
    group: &GroupFile,
    drive: &Drive<'_>,
    name: &str,
) -> anyhow::Result<(Run, Option<Punctuality>)> {
    let progress = Progress::new(name);
    let report = &mut |share: f64, phase| progress.share(share, phase);
    Ok(match &target.bus {
        #[cfg(feature = "simulation")]
        BusAddress::Sim(_) => (simulated(drive, report)?, None),
        _ => run::measured(target.command(group)?, drive, report)?,
    })
}
