//! `omnibus accept`: whether a group of robots keeps what the documents promise.
//!
//! Level 2 is for wheels off the floor, level 3 for the floor; level 1, a bare board, is `cargo
//! xtask accept`. Robots on a real bus have a person for their hands, who is asked and may skip;
//! simulated ones have the simulator's fault injection.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use acceptance::Check;
use acceptance::report::{self, Count, Subject};
use anyhow::{Context as _, bail};
use canopen::Micros;
use group::GroupFile;
use omnibus::abort::Abort;
use omnibus::accept::floor::{Errors, Floor, level_three};
use omnibus::accept::hand::{Hand, Prepared, Task};
use omnibus::accept::identities::Identities;
use omnibus::accept::{self, Step, level_two};
use omnibus::bus::address::BusAddress;
use omnibus::bus::link::Link;
use omnibus::bus::wire::Wire;
use omnibus::error::MasterError;
use omnibus::file;
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::run::{self, Drive, DriveError, Feedback, Source};
use omnibus::session::Group;

use super::calibrate::tape::{self, Question};
use super::output::{Found, Progress, exit_code};
use super::{Target, print_line, print_note};

const EXAMPLES: &str = "Examples:
  omnibus accept --level 2 --wheels-free --bus sim:groups/tcc-2.toml
  omnibus accept --level 2 --wheels-free --skip fault.14 --report target/accept --bus socketcan:can0 --group my-group.toml
  omnibus accept --level 3 --bus sim:groups/tcc-2.toml
  omnibus accept --level 3 --tape --bus socketcan:can0 --group my-group.toml

Level 1, a bare board, is `cargo xtask accept`. docs/acceptance.md describes the whole procedure. Exits with code 6 if a
promise was missed.";

/// How long a question waits between two looks at the bus and at Ctrl-C.
const LOOK: Duration = Duration::from_millis(20);
/// How long a bus is listened to meanwhile, µs.
const LISTEN_US: u64 = 50_000;

/// Speed of the group at level 2, m/s.
const SPEED: f32 = 0.3;
/// Time allowed for what a person is asked to do, s.
const PATIENCE: u16 = 60;

/// Steps in which the yaw rate of a turn is added up.
const STEPS: f64 = 10_000.0;

/// What emulated robots measure at level 2: `docs/acceptance.md` tells how it is made.
const EMULATED: &str = include_str!("../../../acceptance/emulated/level-2.json");

/// What a report says that does not come from the end of its trial.
const NOT_LISTED: &str = "what is not listed was not tried";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// 2: wheels off the floor; 3: on the floor.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(2..=3))]
    level: u8,
    /// Confirms that the wheels of all robots are off the floor (level 2).
    #[arg(long)]
    wheels_free: bool,
    /// Robot whose plugs and switches a person operates at level 2; by default the first of the
    /// group file.
    #[arg(long, value_parser = super::robot)]
    node: Option<u8>,
    /// Speed of the group at level 2, m/s; 0.3 by default.
    #[arg(long, value_parser = super::real::<f32>)]
    speed: Option<f32>,
    /// Leaves out checks whose names begin like this, such as fault.14, wheels or motors.3; it may
    /// be given several times.
    #[arg(long, value_name = "NAME")]
    skip: Vec<String>,
    /// Time allowed at level 2 for each thing that a person is asked to do, s; 60 by default.
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u16).range(5..=600))]
    patience: Option<u16>,
    /// Source of poses at level 3: tcp://HOST:PORT (JSON lines). A simulated bus has its own.
    #[arg(long, value_name = "SOURCE", conflicts_with = "tape")]
    pose: Option<Source>,
    /// Asks for measurements by tape measure at level 3.
    #[arg(long)]
    tape: bool,
    /// Folder for report.html and report.json.
    #[arg(long, value_name = "FOLDER")]
    report: Option<PathBuf>,
    #[command(flatten)]
    target: Target,
}

impl Arguments {
    /// Refuses options of the other level, which would do nothing: at level 3 the group drives
    /// curves on the floor, each at a speed of its own.
    fn check_level(&self) -> anyhow::Result<()> {
        let given = [
            (2, "--wheels-free", self.wheels_free),
            (2, "--node", self.node.is_some()),
            (2, "--speed", self.speed.is_some()),
            (2, "--patience", self.patience.is_some()),
            (3, "--pose", self.pose.is_some()),
            (3, "--tape", self.tape),
        ];
        for (level, option, is_given) in given {
            if is_given && level != self.level {
                usage!(
                    "{option} is for level {level} only; at level {} {}",
                    self.level,
                    match self.level {
                        2 => "the wheels are off the floor",
                        _ => "the group drives on the floor, at speeds of its own",
                    }
                );
            }
        }
        Ok(())
    }
}

/// `omnibus accept`.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.check_level()?;
    let group = arguments.target.group()?;
    let mut findings = Findings {
        arguments,
        subject: subject(arguments, &group),
        checks: Vec::new(),
    };
    let nodes: Vec<u8> = group.robots.iter().map(|robot| robot.node).collect();
    let names = accept::names(arguments.level, &nodes);
    let mut skips = arguments.skip.iter();
    // Every name begins with nothing.
    let is_known = |skip: &String| !skip.is_empty() && names.iter().any(|n| n.starts_with(skip));
    if let Some(skip) = skips.find(|skip| !is_known(skip)) {
        usage!(
            "--skip {skip}: no check begins like that; there are {}",
            names.join(", ")
        );
    }
    findings.check_folder()?;
    let done = match arguments.level {
        2 => on_stands(arguments, &group, &mut findings),
        _ => on_the_floor(arguments, &group, &mut findings),
    };
    if let Err(error) = done {
        if !findings.checks.is_empty() {
            findings.subject.limits.insert(0, ended_early(&error));
            // The error that ended it is the one to be told at the end, and to exit with.
            for failed in [findings.write(), findings.print()] {
                if let Err(failed) = failed {
                    print_note(format!("{failed:#}"));
                }
            }
        }
        return Err(error);
    }
    findings.write()?;
    findings.print()?;
    let count = Count::of(&findings.checks);
    if count.missed > 0 {
        return Err(Found(format!("{}: {count}", group.name)).into());
    }
    Ok(())
}

/// What a report says whose trial has not come to its end.
fn ended_early(error: &anyhow::Error) -> String {
    match exit_code(error) {
        130 => format!("stopped by the user: {NOT_LISTED}"),
        _ => format!("ended early, because {error:#}: {NOT_LISTED}"),
    }
}

/// What was found so far, in memory and, with `--report`, in the folder.
struct Findings<'a> {
    arguments: &'a Arguments,
    subject: Subject,
    checks: Vec<Check>,
}

impl Findings<'_> {
    /// Asks the robots what they are.
    fn ask<L: Link>(&mut self, wire: &mut Wire<L>, group: &GroupFile) -> Result<(), MasterError> {
        let nodes = group.robots.iter().map(|robot| robot.node);
        let found = Identities::read(wire, nodes, !self.subject.hardware)?;
        self.subject.chip = found.chip;
        self.subject.versions = versions(&found.firmware);
        Ok(())
    }

    /// Takes in what was found so far; a report that cannot be written is said and does not end
    /// the trial.
    fn so_far(&mut self, checks: &[Check]) {
        self.checks = checks.to_vec();
        if self.arguments.level == 2
            && let Ok(emulated) = serde_json::from_str(EMULATED)
        {
            report::expect(&mut self.checks, &emulated);
        }
        let mut subject = self.subject.clone();
        let unfinished = format!("the trial ended early: {NOT_LISTED}");
        subject.limits.insert(0, unfinished);
        if let Err(error) = self.write_as(&subject) {
            print_note(format!("{error:#}"));
        }
    }

    /// Makes the folder of the report, and finds out whether a report can be written there, before
    /// any wheel turns. A report that is there stays as it is.
    fn check_folder(&self) -> anyhow::Result<()> {
        let Some(folder) = &self.arguments.report else {
            return Ok(());
        };
        std::fs::create_dir_all(folder)
            .and_then(|()| file::Beside::create(&folder.join("report.json")).map(drop))
            .with_context(|| format!("--report {}: cannot be written", folder.display()))
    }

    fn write(&self) -> anyhow::Result<()> {
        self.write_as(&self.subject)
    }

    fn write_as(&self, subject: &Subject) -> anyhow::Result<()> {
        let Some(folder) = &self.arguments.report else {
            return Ok(());
        };
        let named = |name: &str| folder.join(name);
        let text = serde_json::to_string_pretty(&report::json(subject, &self.checks))? + "\n";
        for (path, text) in [
            (named("report.json"), text),
            (named("report.html"), report::html(subject, &self.checks)),
        ] {
            file::replace(&path, text)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    fn print(&self) -> anyhow::Result<()> {
        if super::json() {
            return super::print_json(&report::json(&self.subject, &self.checks));
        }
        for check in &self.checks {
            print_line(report::line(check))?;
        }
        print_line(format_args!("\n{}", Count::of(&self.checks)))?;
        for limit in &self.subject.limits {
            print_line(format_args!("  {limit}"))?;
        }
        Ok(())
    }
}

/// The versions of this program and of the robots' firmware.
fn versions(firmware: &str) -> String {
    format!("omnibus {}, {firmware}", env!("CARGO_PKG_VERSION"))
}

/// What was tried.
fn subject(arguments: &Arguments, group: &GroupFile) -> Subject {
    let simulated = arguments.target.bus.waits();
    let robots = group.robots.len();
    Subject {
        level: arguments.level,
        board: format!("{}, {robots} robots", group.name),
        chip: "not read".to_owned(),
        versions: versions("firmware not read"),
        date: report::today(),
        hardware: !simulated,
        mutation: None,
        limits: match simulated {
            true => vec![
                "the robots and the floor were a simulator's, and no adapter was used".to_owned(),
            ],
            false => Vec::new(),
        },
    }
}

/// Level 2.
fn on_stands(
    arguments: &Arguments,
    group: &GroupFile,
    findings: &mut Findings<'_>,
) -> anyhow::Result<()> {
    let first = group.robots.first().map_or(0, |robot| robot.node);
    let watched = arguments.node.unwrap_or(first);
    if !group.robots.iter().any(|robot| robot.node == watched) {
        bail!("--node {watched}: group '{}' has no such robot", group.name);
    }
    let limit = group.limits.linear_speed;
    let speed = arguments.speed.unwrap_or(SPEED);
    if speed < 0.1 {
        usage!("--speed: {speed} m/s is not 0.1 m/s or more");
    }
    if !(speed >= 0.1 && speed <= limit) {
        bail!(
            "--speed: {speed} m/s is not between 0.1 and the group's limits.linear_speed, {limit} m/s"
        );
    }
    if !arguments.wheels_free {
        usage!(
            "the wheels of all robots of group '{}' will turn; lift them off the floor, then add \
             --wheels-free",
            group.name
        );
    }
    let options = accept::Options {
        watched,
        speed,
        skip: arguments.skip.clone(),
    };
    let abort = super::abort_on_ctrl_c()?;
    match &arguments.target.bus {
        #[cfg(feature = "simulation")]
        BusAddress::Sim(_) => {
            let link = arguments.target.simulated(group)?;
            let mut hand = omnibus::simulation::hand::Injection;
            let session = Group::connect(link, group)?;
            stand_by(session, &mut hand, &options, abort, findings)
        }
        _ => {
            let link = arguments.target.command(group)?;
            let mut person = Person {
                answers: tape::answers(),
                abort: abort.clone(),
                patience_us: u64::from(arguments.patience.unwrap_or(PATIENCE)) * 1_000_000,
            };
            let session = Group::connect(link, group)?;
            stand_by(session, &mut person, &options, abort, findings)
        }
    }
}

fn stand_by<L: Link, H: Hand<L>>(
    mut group: Group<L>,
    hand: &mut H,
    options: &accept::Options,
    abort: Abort,
    findings: &mut Findings<'_>,
) -> anyhow::Result<()> {
    group.set_abort(abort);
    let file = group.config().clone();
    findings.ask(group.wire(), &file)?;
    let progress = Progress::endless("level 2");
    let mut show = |step: Step<'_>| match step {
        Step::Begins(text) => progress.aside(|| print_note(text)),
        Step::Found(checks) => findings.so_far(checks),
    };
    level_two(&mut group, hand, options, &mut show)?;
    Ok(())
}

/// A person, who is asked in the terminal.
struct Person {
    answers: Receiver<String>,
    abort: Abort,
    patience_us: u64,
}

impl Person {
    /// A line from the terminal, while the bus goes on.
    fn ask<L: Link>(&self, group: &mut Group<L>, question: &str) -> Result<String, MasterError> {
        print_note(question);
        loop {
            match self.answers.recv_timeout(LOOK) {
                Ok(line) => return Ok(line.trim().to_owned()),
                Err(RecvTimeoutError::Timeout) => {
                    let until = Micros(group.wire().now().0 + LISTEN_US);
                    group.listen(until)?;
                }
                Err(RecvTimeoutError::Disconnected) => return Err(MasterError::NoAnswer),
            }
            self.abort.check()?;
        }
    }
}

impl<L: Link> Hand<L> for Person {
    fn prepare(&mut self, group: &mut Group<L>, task: Task) -> Result<Prepared, MasterError> {
        let question = format!(
            "Soon you will be asked to {}. Enter: the wheels begin to turn; s: skip this",
            task.request()
        );
        Ok(match self.ask(group, &question)?.as_str() {
            "s" => Prepared::Skip("skipped by the person at the robot".to_owned()),
            _ => Prepared::Ready,
        })
    }

    fn act(&mut self, _: &mut Group<L>, task: Task) -> Option<Micros> {
        let seconds = self.patience_us / 1_000_000;
        print_note(format!("NOW, within {seconds} s: {}", task.request()));
        None
    }

    fn undo(&mut self, group: &mut Group<L>, task: Task) -> Result<(), MasterError> {
        let question = format!("The wheels stand. Please {}, then Enter", task.undoing());
        self.ask(group, &question).map(drop)
    }

    fn patience_us(&self) -> u64 {
        self.patience_us
    }
}

/// Level 3.
fn on_the_floor(
    arguments: &Arguments,
    group: &GroupFile,
    findings: &mut Findings<'_>,
) -> anyhow::Result<()> {
    let simulated = matches!(arguments.target.bus, BusAddress::Sim(_));
    if !simulated && !arguments.tape && !matches!(arguments.pose, Some(Source::Stream(_))) {
        usage!(
            "on a real floor give --tape or --pose tcp://HOST:PORT; the robots' own wheels do not \
             see their slip"
        );
    }
    if simulated && (arguments.tape || arguments.pose.is_some()) {
        usage!("a simulated floor is measured by the simulator; leave out --tape and --pose");
    }
    // Refuses a bus that another master commands.
    let link = arguments.target.command(group)?;
    findings.ask(&mut Wire::visiting(link), group)?;
    let mut floor = Driver {
        arguments,
        group,
        abort: super::abort_on_ctrl_c()?,
        answers: arguments.tape.then(tape::answers),
    };
    let mut show = |step: Step<'_>| match step {
        Step::Begins(text) => print_note(text),
        Step::Found(checks) => findings.so_far(checks),
    };
    level_three(&mut floor, &arguments.skip, &mut show)?;
    Ok(())
}

/// Drives curves on the floor, and measures.
struct Driver<'a> {
    arguments: &'a Arguments,
    group: &'a GroupFile,
    abort: Abort,
    answers: Option<Receiver<String>>,
}

impl Driver<'_> {
    fn plan(&self, curve: Curve, compensation: bool) -> Drive<'_> {
        let source = self.arguments.pose.clone();
        Drive {
            group: self.group,
            course: Course::of(curve),
            feedback: source.map(|source| Feedback {
                source,
                law: omnibus::path::steering::Law::default(),
                corrects: false,
            }),
            compensation,
            elf: None,
            candump: None,
            log: None,
            abort: self.abort.clone(),
            record: None,
            index_search: None,
        }
    }

    /// Asks how far the group has come along a curve that ends elsewhere than it begins.
    fn tape(&self, curve: Curve, answers: &Receiver<String>) -> Result<Errors, DriveError> {
        let course = Course::of(curve);
        let plan = course.plan()?;
        let (from, to) = (plan.at(0.0).0, plan.at(plan.duration()).0);
        let (asked, what) = match curve {
            Curve::Forward => (f64::from(to.x - from.x), "m ahead"),
            Curve::Lateral => (f64::from(to.y - from.y), "m to the left"),
            Curve::Turn => {
                let step = plan.duration() / STEPS;
                let times = (0..STEPS as u32).map(|n| (f64::from(n) + 0.5) * step);
                let radians: f64 = times.map(|t| f64::from(plan.at(t).1.omega) * step).sum();
                (radians.to_degrees(), "degrees to the left")
            }
            _ => return Ok(Errors::default()),
        };
        print_note(format!(
            "asked {asked:+.3} {what}; measured (Enter skips it):"
        ));
        let mut question = Question::new(vec![asked], what);
        let percent = loop {
            let line = loop {
                match answers.recv_timeout(LOOK) {
                    Ok(line) => break line,
                    Err(RecvTimeoutError::Timeout) => self.abort.check()?,
                    Err(RecvTimeoutError::Disconnected) => {
                        return Err(MasterError::NoAnswer.into());
                    }
                }
            };
            match question.take(&line) {
                Ok(measured) => break measured.map(|it| 100.0 * (it[0] / asked - 1.0)),
                Err(why) => print_note(why),
            }
        };
        let mut errors = Errors::default();
        match curve {
            Curve::Forward => errors.ahead = percent,
            Curve::Lateral => errors.aside = percent,
            _ => errors.turned = percent,
        }
        Ok(errors)
    }
}

impl Floor for Driver<'_> {
    fn drive(&mut self, curve: Curve, compensation: bool) -> Result<Errors, DriveError> {
        let mut drive = self.plan(curve, compensation);
        let progress = Progress::new(&drive.course.name());
        let report = &mut |share: f64, phase| progress.share(share, phase);
        #[cfg(feature = "simulation")]
        if let BusAddress::Sim(_) = &self.arguments.target.bus {
            drive.elf = self.arguments.target.elf().ok().flatten();
            let run = omnibus::simulation::run::simulated(&drive, report)?;
            return Ok(Errors::of(&run));
        }
        drive.elf = None;
        let link = omnibus::bus::open(&self.arguments.target.bus, self.group)?;
        let (run, _) = run::measured(link, &drive, report)?;
        drop(progress);
        match &self.answers {
            Some(answers) => self.tape(curve, answers),
            None => Ok(Errors::of(&run)),
        }
    }

    fn predict(&mut self, curve: Curve, compensation: bool) -> Result<Option<Errors>, DriveError> {
        #[cfg(feature = "simulation")]
        {
            let drive = Drive {
                feedback: None,
                ..self.plan(curve, compensation)
            };
            let run = omnibus::simulation::run::simulated(&drive, &mut |_, _| {})?;
            Ok(Some(Errors::of(&run)))
        }
        #[cfg(not(feature = "simulation"))]
        {
            let _ = (curve, compensation);
            Ok(None)
        }
    }
}
