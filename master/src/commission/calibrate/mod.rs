//! Measures the constants that robots need, from motions and a source of poses.
//!
//! [`calibrate`] finds the compensation for wheel slip. First the straight motions are driven
//! without compensation and give the tables ahead, sideways and oblique. With these in force the
//! turns are driven, because robots bolted far from the middle turn the group mostly by moving
//! sideways; the coefficient of turns is corrected until the turn is right. Finally every axis is
//! driven once more with all coefficients in force. The remaining error is reported, and a
//! calibration with a large one is rejected. [`roller_phase`] finds the roller phases.
//!
//! Robots with known rollers are given constants. The loss that grows with speed there is that of
//! roller transitions. It is separated and becomes a number of the group
//! ([`crate::path::roller_transition`]), in force from the turns on.

pub mod chart;
mod error;
pub mod fit;
pub mod group_file;
pub mod journal;
mod lag;
pub mod manoeuvre;
pub mod measure;
pub mod recorded_motions;
pub mod rollers;
pub mod undo;

pub use error::CalibrateError;

use group::{ContactLag, GroupFile};
use kinematics::Twist;

use crate::bus::link::Link;
use crate::error::MasterError;
use crate::session::Group;
use fit::{Found, Row};
use journal::Journal;
use manoeuvre::{Manoeuvre, Settings, Way, straight, turns};
use measure::{Body, Instrument, Observation, observe};

/// How often the turns are driven at most, and how often they usually are.
const ROUNDS: usize = 5;
const LIKELY_ROUNDS: usize = 2;
/// A turn this exact is good enough, relative.
const EXACT: f64 = 1e-3;
/// A calibration that leaves more than this is refused, relative; of a group whose robots face
/// differently also one that turns it more than this on a straight way, rad/m.
const HOLDS: f64 = 0.01;

/// What is left of one motion with the calibration in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Left {
    /// The motion.
    pub way: Way,
    /// Its speed, m/s or rad/s.
    pub speed: f64,
    /// Ratio of measured to asked, less 1; the worst of both ways.
    pub error: f64,
}

/// What was found of one subject.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Its nodes.
    pub nodes: Vec<u8>,
    /// The coefficients.
    pub found: Found,
    /// What is left.
    pub left: Vec<Left>,
    /// Motions that were left out.
    pub missed: usize,
}

/// A calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Of every subject.
    pub outcomes: Vec<Outcome>,
    /// The group with the coefficients in it.
    pub file: GroupFile,
    /// Version of the set.
    pub version: u32,
}

/// Calibrates the compensation of a connected group. The group stands afterwards and its robots
/// hold the new coefficients, unsaved.
///
/// # Errors
/// When driving or measuring fails, and when the data do not determine the coefficients or the
/// result does not hold.
pub fn calibrate<L: Link>(
    group: &mut Group<L>,
    settings: &Settings,
    version: u32,
    instrument: &mut Instrument<'_, L>,
    journal: &mut Journal<'_>,
) -> Result<Calibration, CalibrateError> {
    let mut bare = group.config().clone();
    bare.hand_over_loss = 0.0;
    group.set_config(bare.clone());
    let bodies = Body::all(&bare);
    if settings.speeds.is_empty() || settings.rates.is_empty() {
        return Err(CalibrateError::NoSpeeds);
    }
    group.configure(false)?;
    group.find_rollers(&mut |search| journal.announce(search))?;
    let mut motions = straight(&bare, settings);
    if bodies.iter().any(Body::is_mixed) {
        // What is oblique to one robot is not to another.
        motions.retain(|motion| motion.way != Way::Oblique);
    }
    let turning = turns(&bare, settings);
    let checking = checks(&bare, settings);
    // A tape measures no lag.
    let lagging = if settings.lag && matches!(instrument, Instrument::Poses(_)) {
        lag::motions(&bare, settings)
    } else {
        Vec::new()
    };
    let ahead = |rounds: usize| {
        let turns = (0..rounds).flat_map(|_| &turning).chain(&lagging);
        turns.chain(&checking).map(Manoeuvre::lasts)
    };
    journal.ahead(
        motions
            .iter()
            .map(Manoeuvre::lasts)
            .chain(ahead(LIKELY_ROUNDS)),
    );
    let seen = drive(group, &bodies, &motions, instrument, journal)?;
    let mut outcomes = Vec::new();
    for (body, seen) in bodies.iter().zip(&seen) {
        let mut found = Found::straight(seen)?;
        if body.is_mixed() {
            found = found.separated(body.alignment);
        }
        outcomes.push(Outcome {
            nodes: body.nodes(&bare),
            found,
            left: Vec::new(),
            missed: motions.len() - seen.len(),
        });
    }

    let mut sensitivity: Vec<f64> = bodies.iter().map(|body| body.turning).collect();
    let mut before: Vec<Vec<f64>> = vec![Vec::new(); bodies.len()];
    for round in 0..ROUNDS {
        let file = filled(&bare, &bodies, &outcomes, version)?;
        group.set_config(file);
        group.configure(true)?;
        journal.ahead(ahead(LIKELY_ROUNDS.saturating_sub(round).max(1)));
        journal.depends();
        let seen = drive(group, &bodies, &turning, instrument, journal)?;
        let mut exact = true;
        for (n, outcome) in outcomes.iter_mut().enumerate() {
            let (rows, errors) = turned(&outcome.found.yaw, &seen[n], settings, sensitivity[n])?;
            let worst = errors.iter().map(|e| e.abs()).fold(0.0, f64::max);
            exact &= worst < EXACT;
            // How much the last correction really did, where it was one worth judging by.
            if let (Some(old), Some(new)) = (before[n].first(), errors.first())
                && old.abs() > 2.0 * EXACT
            {
                let done = ((old - new) / old).clamp(0.2, 3.0);
                sensitivity[n] = (sensitivity[n] * done).clamp(0.05, 1.5);
            }
            before[n] = errors;
            if worst >= EXACT || round == 0 {
                outcome.found.yaw = rows;
            }
        }
        if exact {
            break;
        }
    }

    let mut file = filled(&bare, &bodies, &outcomes, version)?;
    if settings.lag {
        file.contact_lag = ContactLag::default();
        group.set_config(file.clone());
        group.configure(true)?;
        journal.ahead(ahead(0));
        journal.depends();
        if let Some(lag) = lag::find(group, &bodies, &lagging, instrument, journal)? {
            file.contact_lag = lag;
            file = group_file::rounded(file)?;
        }
    }
    group.set_config(file.clone());
    group.configure(true)?;
    journal.ahead(checking.iter().map(Manoeuvre::lasts));
    journal.depends();
    let seen = drive(group, &bodies, &checking, instrument, journal)?;
    for ((outcome, seen), body) in outcomes.iter_mut().zip(&seen).zip(&bodies) {
        outcome.left = left(seen);
        if body.is_mixed() {
            turns_nothing(seen)?;
        }
        if let Some(bad) = outcome.left.iter().find(|left| left.error.abs() > HOLDS) {
            return Err(CalibrateError::DoesNotHold {
                motion: bad.way.name(),
                percent: bad.error * 100.0,
            });
        }
    }
    Ok(Calibration {
        outcomes,
        file,
        version,
    })
}

/// Drives motions, starting the group before the first that has to be driven and stopping it after
/// the last; what was seen of every subject.
fn drive<L: Link>(
    group: &mut Group<L>,
    bodies: &[Body],
    motions: &[Manoeuvre],
    instrument: &mut Instrument<'_, L>,
    journal: &mut Journal<'_>,
) -> Result<Vec<Vec<Observation>>, CalibrateError> {
    let mut seen = vec![Vec::new(); bodies.len()];
    let mut started = false;
    let all = motions.iter().try_for_each(|motion| {
        let name = format!(
            "{} at {} {}",
            motion.way.name(),
            motion.speed,
            motion.way.unit()
        );
        let each = journal.motion(&name, &mut || {
            attempt(group, &mut started, |group, _| {
                observe(group, bodies, motion, instrument)
            })
        })?;
        let more = more(group, bodies, motion);
        for (seen, one) in seen.iter_mut().zip(each.unwrap_or_default()) {
            seen.extend(one.map(|one| one.without(more)));
        }
        Ok(())
    });
    if started {
        group.stop()?;
    }
    all.map(|()| seen)
}

/// Drives one of several motions. The group is started where it is not, of which `motion` is
/// informed, and stopped after an error.
fn attempt<L: Link, T>(
    group: &mut Group<L>,
    started: &mut bool,
    motion: impl FnOnce(&mut Group<L>, bool) -> Result<T, MasterError>,
) -> Result<T, MasterError> {
    let first = !*started;
    if first {
        group.start_measuring()?;
        *started = true;
    }
    let seen = motion(group, first);
    if seen.is_err() {
        *started = false;
        group.stop()?;
    }
    // The boot-up of a robot that was missing comes while the group stops.
    seen.map_err(|error| group.explained(error))
}

/// Coefficients of the turns corrected by what was seen with those in force, and the errors seen.
/// `sensitivity` says how much of a change of the coefficient shows in the turn.
fn turned(
    rows: &[Row],
    seen: &[Observation],
    settings: &Settings,
    sensitivity: f64,
) -> Result<(Vec<Row>, Vec<f64>), CalibrateError> {
    let mut out = Vec::new();
    let mut errors = Vec::new();
    for (n, rate) in settings.rates.iter().enumerate() {
        let here = seen.iter().filter(|o| o.speed.total_cmp(rate).is_eq());
        let ratios = here.map(|o| o.measured[2] / o.believed[2]);
        let mut row = fit::row(Way::Turn, *rate, ratios)?;
        let seen = row.fit.coefficient;
        errors.push(1.0 / seen - 1.0);
        let factor = seen.powf(1.0 / sensitivity).clamp(0.8, 1.25);
        let coefficient = rows.get(n).map_or(1.0, |row| row.fit.coefficient) * factor;
        let wide = |end: f64| coefficient * (1.0 + (end / seen - 1.0) / sensitivity);
        row.fit.interval = (wide(row.fit.interval.0), wide(row.fit.interval.1));
        row.fit.coefficient = coefficient;
        out.push(row);
    }
    fit::widen(Way::Turn, &mut out.iter_mut().collect::<Vec<_>>());
    Ok((out, errors))
}

/// What of a motion is asked for because of the rollers' hand-over, along x, along y and about z of
/// the robots: shares of its own twist.
fn more<L: Link>(group: &Group<L>, bodies: &[Body], motion: &Manoeuvre) -> [f64; 3] {
    #[expect(clippy::cast_possible_truncation, reason = "a robot holds f32")]
    let heading = bodies.first().map_or(0.0, Body::heading) as f32;
    let Twist { vx, vy, omega } = motion.twist;
    let twist = Twist::new(vx as f32, vy as f32, omega as f32);
    let lost = group.lost_by_hand_over(twist.to_world(heading));
    let lost = lost.to_body(heading);
    let share = |lost: f32, of: f32| if of == 0.0 { 0.0 } else { f64::from(lost / of) };
    [
        share(lost.vx, twist.vx),
        share(lost.vy, twist.vy),
        share(lost.omega, twist.omega),
    ]
}

/// The group with what was found in it.
fn filled(
    bare: &GroupFile,
    bodies: &[Body],
    outcomes: &[Outcome],
    version: u32,
) -> Result<GroupFile, CalibrateError> {
    let mut file = bare.clone();
    if bare.robots.iter().any(|robot| robot.rollers.is_some()) {
        let losses = outcomes
            .iter()
            .map(|outcome| outcome.found.hand_over_loss());
        file.hand_over_loss = losses.sum::<f32>() / outcomes.len() as f32;
    }
    for (body, outcome) in bodies.iter().zip(outcomes) {
        outcome.found.check()?;
        let constant = outcome.found.constant(file.hand_over_loss)?;
        let mine = |n: &usize| body.robots.contains(n);
        let robots = file.robots.iter_mut().enumerate();
        for (_, robot) in robots.filter(|(n, _)| mine(n)) {
            match &mut robot.rollers {
                // With the angle of the rollers known, constants are what is left.
                Some(rollers) => rollers.compensation = constant,
                None => {
                    robot.compensation = constant;
                    robot.compensation_table = outcome.found.table(version);
                }
            }
        }
    }
    group_file::rounded(file)
}

/// One motion of each kind, both ways, at a middle speed.
fn checks(file: &GroupFile, settings: &Settings) -> Vec<Manoeuvre> {
    let middle = |all: &[f64]| all.get(all.len() / 2).copied().into_iter().collect();
    let few = Settings {
        speeds: middle(&settings.speeds),
        rates: middle(&settings.rates),
        repeats: 1,
        ..settings.clone()
    };
    let mut out = straight(file, &few);
    out.extend(turns(file, &few));
    out
}

/// Refuses straight motions that turn a group whose robots face differently.
fn turns_nothing(seen: &[Observation]) -> Result<(), CalibrateError> {
    for o in seen.iter().filter(|o| o.way != Way::Turn) {
        let a_metre = o.measured[2] / o.believed[0].hypot(o.believed[1]);
        if a_metre.abs() > HOLDS {
            return Err(CalibrateError::NotToldApart {
                motion: o.way.name(),
                degrees: a_metre.to_degrees(),
            });
        }
    }
    Ok(())
}

/// The worst of each kind.
fn left(seen: &[Observation]) -> Vec<Left> {
    let mut out: Vec<Left> = Vec::new();
    for o in seen {
        let ([bx, by, bt], [mx, my, mt]) = (o.believed, o.measured);
        let ratio = match o.way {
            Way::Turn => mt / bt,
            _ => (bx * mx + by * my) / (bx * bx + by * by),
        };
        let one = Left {
            way: o.way,
            speed: o.speed,
            error: ratio - 1.0,
        };
        match out.iter_mut().find(|left| left.way == o.way) {
            Some(worst) if worst.error.abs() < one.error.abs() => *worst = one,
            Some(_) => {}
            None => out.push(one),
        }
    }
    out.sort_by_key(|left| left.way);
    out
}
