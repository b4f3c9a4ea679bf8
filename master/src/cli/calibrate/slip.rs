//! `omnibus calibrate`: the compensation for wheel slip, from a source of poses or a tape measure.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use canopen::NmtCommand;
use group::GroupFile;
use omnibus::bus::address::BusAddress;
use omnibus::bus::link::Link;
use omnibus::commission::calibrate::journal::{Journal, saved_motions};
use omnibus::commission::calibrate::manoeuvre::{Manoeuvre, Settings};
use omnibus::commission::calibrate::measure::{Body, Instrument};
use omnibus::commission::calibrate::recorded_motions::Source;
use omnibus::commission::calibrate::rollers::{self, RobotPhases};
use omnibus::commission::calibrate::undo::{Held, UndoRecord};
use omnibus::commission::calibrate::{Calibration, calibrate, chart, group_file};
use omnibus::error::MasterError;
use omnibus::session::Group;
#[cfg(feature = "simulation")]
use omnibus::simulation::link::SimLink;
use serde_json::{Value, json};

use super::progress::{self, Progress};
use super::{Arguments, found, phase, tape};
use crate::cli::{abort_on_ctrl_c, check_writable, json, print_json, print_line, print_note, real};

/// Options of how the motions are driven and measured.
#[derive(clap::Args)]
pub struct Slip {
    /// Finds everything in one run: the phases of the rollers, if the group file has rollers, then
    /// slip, the loss at roller transitions, and the lag of the contacts.
    #[arg(long, conflicts_with_all = ["phase", "tape", "undo"])]
    pub all: bool,
    /// Asks after every motion how far the group has moved, instead of using a source of poses.
    #[arg(long, conflicts_with_all = ["pose", "phase"])]
    tape: bool,
    /// Speeds of the straight motions, m/s.
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "M/S,...",
        value_parser = real::<f64>,
        conflicts_with_all = ["phase", "undo"]
    )]
    speeds: Vec<f64>,
    /// Rates of the turns, rad/s.
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "RAD/S,...",
        value_parser = real::<f64>,
        conflicts_with_all = ["phase", "undo"]
    )]
    rates: Vec<f64>,
    /// Shortest distance of each motion, m; in turns, the distance that a wheel rolls.
    #[arg(
        long,
        default_value_t = Settings::default().distance,
        value_name = "METRES",
        value_parser = real::<f64>,
        conflicts_with_all = ["phase", "undo"]
    )]
    distance: f64,
    /// How often each motion is driven each way: 2, or 1 with --tape.
    #[arg(long, conflicts_with = "undo")]
    repeats: Option<u32>,
    /// Also saves the written values to flash.
    #[arg(long, conflicts_with = "phase")]
    save: bool,
    /// Undoes the last --write, in the robots and in the group file.
    #[arg(long, conflicts_with_all = ["write", "phase", "tape", "pose"])]
    undo: bool,
    /// File in which --write saves the previous values for --undo; by default beside the group
    /// file.
    #[arg(long, value_name = "FILE.json", conflicts_with = "phase")]
    kept: Option<PathBuf>,
    /// Draws the coefficients over speed after every motion; an existing file is replaced. A page
    /// reloads itself.
    #[arg(
        long,
        value_name = "FILE.svg|FILE.png|FILE.html",
        conflicts_with_all = ["phase", "undo"]
    )]
    plot: Option<PathBuf>,
    /// Continues a calibration that ended early; completed motions are not driven again.
    #[arg(long, conflicts_with_all = ["undo", "phase"])]
    resume: bool,
    /// Skips the motions with these numbers.
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "NUMBER,...",
        value_parser = clap::value_parser!(u16).range(1..),
        conflicts_with_all = ["undo", "phase"]
    )]
    without: Vec<u16>,
}

impl Slip {
    /// How often each motion is driven.
    pub fn repeats(&self) -> anyhow::Result<u32> {
        let usual = if self.tape {
            1
        } else {
            Settings::default().repeats
        };
        let repeats = self.repeats.unwrap_or(usual);
        if !(1..=20).contains(&repeats) {
            usage!("--repeats: {repeats} is not between 1 and 20");
        }
        Ok(repeats)
    }

    fn settings(&self, group: &GroupFile, rollers: u8) -> anyhow::Result<Settings> {
        let usual = Settings::default();
        let sorted = |asked: &[f64], name: &str, usual: Vec<f64>| -> anyhow::Result<Vec<f64>> {
            if asked.is_empty() {
                return Ok(usual);
            }
            if let Some(bad) = asked.iter().find(|v| !(0.02..=6.0).contains(*v)) {
                usage!("{name}: {bad} is not between 0.02 and 6");
            }
            let mut all = asked.to_vec();
            all.sort_by(f64::total_cmp);
            all.dedup();
            if all.len() > protocol::compensation::ROWS {
                usage!("{name}: give at most {}", protocol::compensation::ROWS);
            }
            Ok(all)
        };
        if !(0.1..=20.0).contains(&self.distance) {
            usage!("--distance: {} is not between 0.1 and 20 m", self.distance);
        }
        let repeats = self.repeats()?;
        let few = |all: Vec<f64>, one: f64| if self.tape { vec![one] } else { all };
        let settings = Settings {
            speeds: sorted(&self.speeds, "--speeds", few(usual.speeds, 0.25))?,
            rates: sorted(&self.rates, "--rates", few(usual.rates, 0.5))?,
            distance: self.distance,
            repeats,
            rollers,
            lag: self.all,
        };
        Ok(settings.within(&group.limits))
    }
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = target.group()?;
    let slip = &arguments.slip;
    if slip.undo {
        return undo(arguments, &group);
    }
    if slip.save && !arguments.write {
        usage!("--save saves the values that --write writes; add --write");
    }
    if slip.kept.is_some() && !arguments.write {
        usage!("--kept is the file of --write and --undo; add one of them");
    }
    if let Some(path) = &slip.plot {
        progress::form(path)?;
        target.check_output("--plot", path)?;
    }
    if let Some(path) = &slip.kept {
        target.check_output("--kept", path)?;
    }
    if arguments.write {
        let path = target.group_path()?;
        check_writable("--write", path)?;
        check_writable("--write", &undo_path(arguments, path))?;
    }
    let settings = slip.settings(&group, arguments.rollers())?;
    let bodies = Body::all(&group);
    if slip.tape && bodies.len() > 1 {
        bail!(
            "--tape measures one body, but the {} robots of {} are not bolted together; calibrate \
             them one by one",
            bodies.len(),
            group.name
        );
    }
    let rigid = group.simulation.rigid;
    match (&target.bus, &arguments.pose) {
        (BusAddress::Sim(_), Some(_)) => usage!("--pose is not needed on a simulated bus"),
        #[cfg(feature = "simulation")]
        (BusAddress::Sim(_), None) => {
            let link = target.simulated(&group)?;
            let mut poses = |link: &mut SimLink| {
                let truth = link.world.truth();
                let place = |p: &kinematics::Pose<f64>| [p.x, p.y, p.heading];
                Ok(if rigid {
                    vec![place(&truth.group)]
                } else {
                    truth
                        .robots
                        .iter()
                        .map(|robot| place(&robot.pose))
                        .collect()
                })
            };
            if slip.tape {
                return by_tape(arguments, &group, &settings, link);
            }
            let instrument = &mut Instrument::Poses(&mut poses);
            let mut gyros = phase::simulated_gyros;
            let gyro = match arguments.gyro.as_deref() {
                Some(phase::BOARD) => Some(Source::Board),
                Some(gyro) => {
                    phase::is_simulated(gyro)?;
                    Some(Source::Gyro(&mut gyros))
                }
                None => None,
            };
            work(arguments, &group, &settings, link, instrument, gyro)
        }
        (_, None) if slip.tape => by_tape(arguments, &group, &settings, target.command(&group)?),
        (_, None) => usage!(
            "no source of measurements: give --pose tcp://HOST:PORT (JSON lines), or --tape to \
             type in every measurement"
        ),
        (_, Some(source)) => {
            let stream = super::pose_stream(source)?;
            let nodes: Vec<u8> = group.robots.iter().map(|robot| robot.node).collect();
            let link = target.command(&group)?;
            let stream = stream.on_waiting_bus(link.time_waits());
            let mut poses = |link: &mut Box<dyn Link>| {
                if rigid {
                    Ok(vec![stream.group(link.now())?])
                } else {
                    stream.robots(&nodes, link.now())
                }
            };
            let instrument = &mut Instrument::Poses(&mut poses);
            let gyro = arguments.gyro.as_deref();
            if gyro == Some(phase::BOARD) {
                let gyro = Some(Source::Board);
                return work(arguments, &group, &settings, link, instrument, gyro);
            }
            let stream = gyro.map(phase::gyro_stream).transpose()?;
            let mut rates = stream.map(|stream| {
                let nodes = &nodes;
                move |link: &mut Box<dyn Link>| stream.take(nodes, link.now())
            });
            let gyro = rates.as_mut().map(|rates| Source::Gyro(rates));
            work(arguments, &group, &settings, link, instrument, gyro)
        }
    }
}

fn by_tape<L: Link>(
    arguments: &Arguments,
    file: &GroupFile,
    settings: &Settings,
    link: L,
) -> anyhow::Result<()> {
    let heading = Body::all(file).first().map_or(0.0, Body::heading);
    if heading != 0.0 {
        print_note(format!(
            "Ahead is {:+.1} degrees from the group's x axis (left is positive), the robots' mean \
             direction.",
            heading.to_degrees()
        ));
    }
    let answers = tape::answers();
    let mut ask = |group: &mut Group<L>, motion: &Manoeuvre| tape::ask(group, motion, &answers);
    let instrument = &mut Instrument::Tape(&mut ask);
    work(arguments, file, settings, link, instrument, None)
}

fn work<L: Link>(
    arguments: &Arguments,
    file: &GroupFile,
    settings: &Settings,
    link: L,
    instrument: &mut Instrument<'_, L>,
    gyro: Option<Source<'_, L>>,
) -> anyhow::Result<()> {
    let slip = &arguments.slip;
    let mut progress = Progress::new(slip.plot.clone());
    let mut journal = Journal::new(|step| progress.show(step)).without(&slip.without);
    match (&arguments.target.bus, arguments.target.group_path()) {
        (BusAddress::Sim(_), _) if slip.resume => {
            usage!(
                "--resume: a simulated bus starts from the beginning with every command, so there is nothing to continue"
            )
        }
        (BusAddress::Sim(_), _) => {}
        (_, path) => {
            let record = path?.with_extension("calibration.jsonl");
            let of = format!("{file:?} {settings:?} {} {}", slip.tape, gyro.is_some());
            let of = protocol::crc32(of.bytes());
            if let Some(motions) = (!slip.resume).then(|| saved_motions(&record, of)).flatten() {
                let record = record.display();
                print_note(format!(
                    "{record} has {motions} motions of a calibration that ended early, which the \
                     first motion of this one replaces; --resume continues from them."
                ));
            }
            journal = journal.backed_by(&record, of, slip.resume)?;
        }
    }
    let mut group = Group::connect(link, file)?;
    group.set_abort(abort_on_ctrl_c()?);
    group.command(NmtCommand::EnterPreOperational)?;
    let before = held(&mut group, file)?;
    let newest = file.robots.iter().map(|r| r.compensation_table.version);
    let newest = newest.chain(before.iter().map(Held::version)).max();
    let version = newest.unwrap_or(0).saturating_add(1);
    let done = find(
        arguments,
        &mut group,
        (settings, version),
        instrument,
        gyro,
        &mut journal,
    );
    let unknown = journal.unknown();
    let record = journal.into_record();
    drop(progress);
    if let (Ok(_), Some((number, last))) = (&done, unknown) {
        print_note(format!(
            "--without {number}: there was no such motion; the last one had number {last}"
        ));
    }
    let done = done.and_then(|done| {
        if !json() {
            for found in &done.0 {
                phase::show(found)?;
            }
            found::show(&done.1)?;
        }
        let write = || write(arguments, &done.1, &before);
        let rewritten = arguments.write.then(write).transpose()?;
        Ok((done, rewritten))
    });
    // The robots end as they were, whatever happened, unless the result is written.
    let restored = match done {
        Ok((_, Some(_))) => Ok(()),
        _ => restore(&mut group, &before),
    };
    let ((phases, calibration), rewritten) = match done {
        Ok(done) => done,
        Err(error) => {
            if let Err(problem) = restored {
                print_note(problem);
            }
            if record.is_some() {
                print_note("The completed motions are saved; --resume continues from there.");
            }
            return Err(error);
        }
    };
    restored?;
    if let Some(record) = record {
        record.remove();
    }
    if slip.save {
        group.command(NmtCommand::EnterPreOperational)?;
        save(&mut group, &calibration.file).context(
            "the robots and the group file hold the calibration, but not every robot has saved \
             it; `omnibus param save` does",
        )?;
    }
    show_end(arguments, version, &phases, &calibration, rewritten)?;
    if let Some(path) = &slip.plot {
        progress::write(path, &chart::sheet(&calibration), false)?;
    }
    Ok(())
}

/// The whole result in JSON, or what became of it: `rewritten` says whether the group file was,
/// where the result was to be written.
fn show_end(
    arguments: &Arguments,
    version: u32,
    phases: &[RobotPhases],
    calibration: &Calibration,
    rewritten: Option<bool>,
) -> anyhow::Result<()> {
    if json() {
        let outcomes: Vec<Value> = calibration
            .outcomes
            .iter()
            .map(found::outcome_json)
            .collect();
        let phases: Vec<Value> = phases.iter().map(phase::to_json).collect();
        let lag = &calibration.file.contact_lag;
        return print_json(&json!({
            "version": version, "outcomes": outcomes, "phases": phases,
            "constants": found::constants_json(calibration),
            "hand_over_loss_s_per_m": calibration.file.hand_over_loss,
            "contact_lag_ms": {
                "longitudinal": f64::from(lag.longitudinal) * 1e3,
                "lateral": f64::from(lag.lateral) * 1e3,
                "yaw": f64::from(lag.yaw) * 1e3,
            },
            "written": rewritten.is_some(), "saved": arguments.slip.save,
            "group_file": rewritten.unwrap_or(false),
        }));
    }
    print_line(match rewritten {
        None => {
            "The robots still have their previous values; --write writes the result into them \
             and into the group file."
        }
        Some(true) => {
            "Written into the robots and the group file; --undo restores the previous values."
        }
        Some(false) => {
            "Written into the robots. Copy the lines above into the group file, or the next \
             `group apply` overwrites them."
        }
    })
}

/// Everything that is asked for: with --all phases, too, where the group file has rollers.
fn find<L: Link>(
    arguments: &Arguments,
    group: &mut Group<L>,
    (settings, version): (&Settings, u32),
    instrument: &mut Instrument<'_, L>,
    gyro: Option<Source<'_, L>>,
    journal: &mut Journal<'_>,
) -> anyhow::Result<(Vec<RobotPhases>, Calibration)> {
    let file = group.config();
    let has_rollers = file.robots.iter().any(|robot| robot.rollers.is_some());
    let mut phases = Vec::new();
    if arguments.slip.all && has_rollers {
        if rollers::is_bolted(file) {
            print_note(format!(
                "The robots of {} are bolted to one load, which hides the ripple of each, so their \
                 phases are not measured; those of the group file remain.",
                file.name
            ));
        } else {
            phases = match (gyro, &mut *instrument) {
                (Some(mut gyro), _) => rollers::learn(group, settings, &mut gyro, journal)?,
                (None, Instrument::Poses(poses)) => {
                    rollers::learn(group, settings, &mut Source::Poses(*poses), journal)?
                }
                (None, Instrument::Tape(_)) => usage!("--all needs a source of poses"),
            };
        }
    }
    let calibration = calibrate(group, settings, version, instrument, journal)?;
    Ok((phases, calibration))
}

fn held<L: Link>(group: &mut Group<L>, file: &GroupFile) -> Result<Vec<Held>, MasterError> {
    let nodes = file.robots.iter().map(|robot| robot.node);
    nodes.map(|node| Held::read(group.wire(), node)).collect()
}

/// Gives the robots back what they held.
fn restore<L: Link>(group: &mut Group<L>, before: &[Held]) -> anyhow::Result<()> {
    group.command(NmtCommand::EnterPreOperational)?;
    for held in before {
        held.write(group.wire())?;
    }
    Ok(())
}

/// Writes a calibration to the group file and saves the previous values; true if the group file was
/// rewritten. The robots hold the calibration already: the last motions were driven with it.
fn write(
    arguments: &Arguments,
    calibration: &Calibration,
    before: &[Held],
) -> anyhow::Result<bool> {
    let path = arguments.target.group_path()?;
    let new = match group_file::rewrite(path, &calibration.file) {
        Ok(text) => Some(text),
        Err(error) => {
            print_note(error);
            None
        }
    };
    let old = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let record = UndoRecord {
        robots: before.to_vec(),
        group_file: new.is_some().then_some(old),
    };
    // The previous values first, because they would be lost.
    record.save(&undo_path(arguments, path))?;
    if let Some(text) = &new {
        omnibus::file::replace(path, text)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(new.is_some())
}

fn save<L: Link>(group: &mut Group<L>, file: &GroupFile) -> anyhow::Result<()> {
    for robot in &file.robots {
        group.wire().save(robot.node)?;
    }
    Ok(())
}

fn undo_path(arguments: &Arguments, group: &Path) -> PathBuf {
    let path = arguments.slip.kept.clone();
    path.unwrap_or_else(|| group.with_extension("calibration.json"))
}

fn undo(arguments: &Arguments, file: &GroupFile) -> anyhow::Result<()> {
    let path = arguments.target.group_path()?;
    let from = undo_path(arguments, path);
    let record = UndoRecord::load(&from)?;
    let mut group = Group::connect(arguments.target.command(file)?, file)?;
    // Ctrl-C does not end it from here on.
    let _ = abort_on_ctrl_c()?;
    group.command(NmtCommand::EnterPreOperational)?;
    for held in &record.robots {
        held.write(group.wire())?;
    }
    if arguments.slip.save {
        save(&mut group, file)?;
    }
    if let Some(text) = &record.group_file {
        omnibus::file::replace(path, text)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    std::fs::remove_file(&from).with_context(|| format!("cannot remove {}", from.display()))?;
    if json() {
        let robots: Vec<Value> = record
            .robots
            .iter()
            .map(|held| json!({"node": held.node, "version": held.version()}))
            .collect();
        return print_json(&json!({"robots": robots, "group_file": record.group_file.is_some()}));
    }
    for held in &record.robots {
        print_line(format!(
            "node {}: version {} restored",
            held.node,
            held.version()
        ))?;
    }
    if record.group_file.is_some() {
        print_line(format!("{}: previous content restored", path.display()))?;
    }
    Ok(())
}
