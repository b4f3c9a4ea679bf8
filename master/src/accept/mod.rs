//! Acceptance of a whole group: level 2 with its wheels off the floor, level 3 on it.
//!
//! # Theory of operation
//!
//! [`Trial`] is one group, one [`Hand`] and the checks so far. Level 2 turns every wheel,
//! identifies the motors, and brings about the causes of docs/safety.md ([`faults`]); all times are
//! those of the robots' own records ([`records`]). Promises are read from the documents
//! (`acceptance::promise`), and every one of them ends as kept, missed or not tried.
//!
//! # Interface
//!
//! `omnibus accept` calls [`level_two`] with a link and a hand: a person who is asked, or the
//! simulator's fault injection. The procedure is the same.
//!
//! # Limits
//!
//! An error of the link, and a wish to stop, end the whole; the group has been told to stand then,
//! and what was found before has been shown. A trial cannot be resumed.

pub mod faults;
pub mod floor;
pub mod hand;
pub mod identities;
pub mod records;

use acceptance::{Bound, Check};

use crate::bus::link::Link;
use crate::commission::motors::{Settings, WHEELS, identify_motors};
use crate::commission::wheel_test::test_wheels;
use crate::error::MasterError;
use crate::session::{Group, STOP_PATIENCE_US};
use hand::Hand;

/// Why there are no results.
#[derive(Debug, thiserror::Error)]
pub enum AcceptError {
    /// The master.
    #[error(transparent)]
    Master(#[from] MasterError),
    /// A drive of level 3.
    #[error(transparent)]
    Drive(#[from] crate::run::DriveError),
    /// A document does not promise what it should.
    #[error("{0:#}")]
    Promise(anyhow::Error),
}

impl From<anyhow::Error> for AcceptError {
    fn from(error: anyhow::Error) -> Self {
        Self::Promise(error)
    }
}

/// How level 2 is to go.
#[derive(Clone, Debug)]
pub struct Options {
    /// The robot that hands are laid on, and whose wheels are tested first.
    pub watched: u8,
    /// Speed of the group, m/s.
    pub speed: f32,
    /// Names of checks that are left out, or how these begin.
    pub skip: Vec<String>,
}

/// What a trial of these robots can leave out, by the names of checks.
#[must_use]
pub fn names(level: u8, nodes: &[u8]) -> Vec<String> {
    if level == 3 {
        return floor::CURVES
            .iter()
            .flat_map(|(_, curve, figures)| figures.iter().map(move |of| floor::name(curve, *of)))
            .collect();
    }
    let of_nodes = |area: &'static str| nodes.iter().map(move |node| format!("{area}.{node}"));
    let faults = faults::cases::CASES.iter().map(|case| faults::name(case.0));
    of_nodes("wheels")
        .chain(of_nodes("motors"))
        .chain(faults)
        .collect()
}

/// A group while it is being tried.
pub struct Trial<'a, L: Link, H> {
    group: &'a mut Group<L>,
    hand: &'a mut H,
    watched: u8,
    speed: f32,
    skip: &'a [String],
    show: &'a mut dyn FnMut(Step<'_>),
    checks: Vec<Check>,
}

/// What a trial shows while it goes on.
pub enum Step<'a> {
    /// What is done now.
    Begins(&'a str),
    /// What was found so far: after every robot and cause at level 2, every curve at level 3. A
    /// trial that ends early leaves that behind.
    Found(&'a [Check]),
}

/// Level 2. The group stands when it returns, however that is.
///
/// # Errors
/// When the group cannot be reached, or the whole is to be stopped.
pub fn level_two<L: Link, H: Hand<L>>(
    group: &mut Group<L>,
    hand: &mut H,
    options: &Options,
    show: &mut dyn FnMut(Step<'_>),
) -> Result<Vec<Check>, AcceptError> {
    let mut trial = Trial {
        group,
        hand,
        watched: options.watched,
        speed: options.speed,
        skip: &options.skip,
        show,
        checks: Vec::new(),
    };
    let done = trial.all();
    if done.is_err() {
        // Whatever it was, nothing goes on turning.
        trial.group.ramp_down(STOP_PATIENCE_US)?;
    }
    done?;
    Ok(trial.checks)
}

impl<L: Link, H: Hand<L>> Trial<'_, L, H> {
    fn all(&mut self) -> Result<(), AcceptError> {
        self.group.configure(true)?;
        self.wheels()?;
        self.motors()?;
        self.faults()?;
        // What was left out last as well.
        self.show_found();
        Ok(())
    }

    /// Shows what was found so far.
    fn show_found(&mut self) {
        (self.show)(Step::Found(&self.checks));
    }

    /// Whether a check is left out.
    fn is_skipped(&self, name: &str) -> bool {
        self.skip.iter().any(|skip| name.starts_with(skip.as_str()))
    }

    /// Turns every wheel of every robot.
    fn wheels(&mut self) -> Result<(), AcceptError> {
        let (period, abort) = (self.group.period_us(), self.group.abort());
        for node in self.nodes() {
            let name = format!("wheels.{node}");
            let bound = Bound::Near(4.0, 0.0);
            let source = "docs/bring-up.md: wheel-test".to_owned();
            if self.is_skipped(&name) {
                let reason = "left out by --skip".to_owned();
                self.checks
                    .push(not_tried(name, bound, "wheels", source, reason));
                continue;
            }
            (self.show)(Step::Begins(&format!("turning the wheels of node {node}")));
            let mut look = |_, _: &_| Ok(None);
            let wire = self.group.wire();
            let found = test_wheels(wire, node, period, &mut look, &mut |_| abort.check());
            match found {
                Ok(findings) => {
                    let wrong: Vec<String> = findings
                        .iter()
                        .filter_map(|finding| {
                            let wheel = WHEELS.get(finding.wheel)?;
                            Some(format!("{wheel}: {}", finding.problem.as_ref()?))
                        })
                        .collect();
                    let right = findings.len() - wrong.len();
                    let procedure = "wheels that turn alone, forwards, and are counted";
                    let check =
                        self.measured(name, bound, "wheels", source, procedure, right as f64);
                    check.note = wrong.join("; ");
                }
                Err(error) => self.gave_up(name, source, error)?,
            }
            self.show_found();
        }
        Ok(())
    }

    /// Identifies the motors of every robot.
    fn motors(&mut self) -> Result<(), AcceptError> {
        let (period, abort) = (self.group.period_us(), self.group.abort());
        for node in self.nodes() {
            let name = format!("motors.{node}");
            let bound = Bound::Near(4.0, 0.0);
            let source = "docs/operating.md: identify-motors".to_owned();
            if self.is_skipped(&name) {
                let reason = "left out by --skip".to_owned();
                self.checks
                    .push(not_tried(name, bound, "motors", source, reason));
                continue;
            }
            (self.show)(Step::Begins(&format!(
                "identifying the motors of node {node}"
            )));
            let (wire, settings) = (self.group.wire(), Settings::default());
            match identify_motors(wire, node, period, &settings, &mut |_| abort.check()) {
                Ok(motors) => {
                    let procedure = "motors whose friction, speed and inertia the robot finds";
                    let check = self.measured(name, bound, "motors", source, procedure, 4.0);
                    let speeds = motors.map(|motor| format!("{:.3}", motor.speed));
                    check.note = format!("kV {} V s/rad", speeds.join(", "));
                }
                Err(error) => self.gave_up(name, source, error)?,
            }
            self.show_found();
        }
        Ok(())
    }

    fn nodes(&self) -> Vec<u8> {
        self.group.members().iter().map(|m| m.node).collect()
    }

    /// A check that an error ended, or the end of the whole.
    fn gave_up(
        &mut self,
        name: String,
        source: String,
        error: MasterError,
    ) -> Result<(), AcceptError> {
        match error {
            MasterError::Aborted | MasterError::Link(_) => Err(error.into()),
            error => {
                self.failed(name, source, error.to_string());
                Ok(())
            }
        }
    }

    fn failed(&mut self, name: String, source: String, note: String) {
        let bound = Bound::Near(1.0, 0.0);
        let check = self.measured(name, bound, "as promised", source, "", 0.0);
        check.measured = None;
        check.note = note;
    }

    fn measured(
        &mut self,
        name: String,
        promised: Bound,
        unit: &'static str,
        source: String,
        procedure: &'static str,
        measured: f64,
    ) -> &mut Check {
        self.checks.push_mut(Check {
            name,
            promised,
            measured: Some(measured),
            unit,
            tried: true,
            expected: None,
            source,
            procedure,
            note: String::new(),
        })
    }
}

/// A promise that was left out, and why.
fn not_tried(
    name: String,
    promised: Bound,
    unit: &'static str,
    source: String,
    reason: String,
) -> Check {
    Check {
        name,
        promised,
        measured: None,
        unit,
        tried: false,
        expected: None,
        source,
        procedure: "",
        note: reason,
    }
}
