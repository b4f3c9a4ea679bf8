//! The journal of a calibration: progress, motions to leave out, and a record of finished motions,
//! from which a calibration that ended early continues.
//!
//! A calibration drives some thirty motions in ten minutes. Each has a number. When one is
//! finished, its observations are appended to a file of JSON lines, so no finished motion is lost
//! when the bus, the source of poses or the program fails. A later run with the same group and
//! settings reads the file and drives only what is missing. The first line is a fingerprint of
//! both. A file with another fingerprint is refused, because its observations belong to other
//! motions.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead as _, BufReader, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::CalibrateError;
use crate::error::MasterError;
use crate::session::roller_index::IndexSearch;

/// How often a motion is driven again after a passing failure.
const TRIES: u32 = 3;

/// One step of a calibration, as a user sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Its number; motions count from 1.
    pub number: usize,
    /// Motions of the whole calibration, as far as known: turns are driven until they are exact.
    pub of: usize,
    /// What is driven.
    pub name: String,
    /// Time that the rest takes, s, this motion included.
    pub seconds_left: f64,
    /// What happens to it.
    pub what: What,
}

/// What happens to a motion.
#[derive(Clone, Debug, PartialEq)]
pub enum What {
    /// Before the first motion the group searches for its wheels' indexes.
    Searches(IndexSearch),
    /// It is driven.
    Begins,
    /// It is driven again, for this reason.
    Again(String),
    /// An earlier run has driven it.
    Kept,
    /// The user leaves it out.
    LeftOut,
    /// It is finished; what was observed, as the record holds it.
    Finished(Value),
}

/// A finished motion, as a line of the file.
#[derive(Serialize, Deserialize)]
struct Line {
    number: usize,
    name: String,
    /// Nothing where it was left out.
    observed: Option<Value>,
}

/// Where finished motions are kept.
pub struct Record {
    path: PathBuf,
    /// What the file begins with: the fingerprint and what an earlier run has driven.
    begins: String,
    /// Opened for the first motion that is kept.
    file: Option<File>,
    resumes: bool,
}

impl Record {
    /// The result is written: the motions have done their service.
    pub fn remove(self) {
        // A record that stays is only in the way.
        let _ = std::fs::remove_file(self.path);
    }

    fn write(&mut self, line: &str) -> std::io::Result<()> {
        let file = match &mut self.file {
            Some(file) => file,
            None => {
                // Replaced whole, so that half a line of an earlier run does not stay.
                crate::file::replace(&self.path, &self.begins)?;
                let file = File::options().append(true).open(&self.path)?;
                self.file.insert(file)
            }
        };
        writeln!(file, "{line}")
    }
}

/// Progress and record of one calibration.
pub struct Journal<'a> {
    saved: VecDeque<Line>,
    file: Option<Record>,
    left_out: Vec<usize>,
    number: usize,
    /// Something was driven or left out that an earlier run has otherwise.
    changed: bool,
    left: VecDeque<f64>,
    report: Box<dyn FnMut(&Step) + 'a>,
}

impl<'a> Journal<'a> {
    /// Reports every step; keeps nothing.
    pub fn new(report: impl FnMut(&Step) + 'a) -> Self {
        Self {
            saved: VecDeque::new(),
            file: None,
            left_out: Vec::new(),
            number: 0,
            changed: false,
            left: VecDeque::new(),
            report: Box::new(report),
        }
    }

    /// Leaves out the motions with these numbers.
    #[must_use]
    pub fn without(mut self, numbers: &[u16]) -> Self {
        self.left_out = numbers.iter().copied().map(usize::from).collect();
        self
    }

    /// The first number to leave out that no motion has had, and that of the last motion.
    #[must_use]
    pub fn unknown(&self) -> Option<(usize, usize)> {
        let mut numbers = self.left_out.iter();
        let unknown = numbers.find(|number| **number > self.number)?;
        Some((*unknown, self.number))
    }

    /// Keeps finished motions in a file, and goes on from those that are in it where `resume` is
    /// asked for.
    ///
    /// # Errors
    /// When the file could not be written or cannot be read, or belongs to another calibration.
    pub fn backed_by(
        mut self,
        path: &Path,
        fingerprint: u32,
        resume: bool,
    ) -> Result<Self, CalibrateError> {
        let problem = |problem: String| CalibrateError::File {
            path: path.display().to_string(),
            problem,
        };
        crate::file::check(path).map_err(|error| {
            problem(format!(
                "{error}; finished motions are kept in this file; make it possible to write it"
            ))
        })?;
        if resume {
            let saved = saved(path, fingerprint).map_err(|error| {
                problem(match error.kind() {
                    ErrorKind::NotFound => {
                        "there is no calibration to resume; run it without --resume".into()
                    }
                    ErrorKind::InvalidData => {
                        format!("{error}, so it has no motions; calibrate without --resume")
                    }
                    _ => format!("{error}; make it possible to read it"),
                })
            })?;
            self.saved = saved.ok_or_else(|| {
                problem(
                    "belongs to another group file or to other options; give the same ones, or \
                     calibrate without --resume"
                        .into(),
                )
            })?;
        }
        let mut begins = head(fingerprint) + "\n";
        for line in &self.saved {
            begins += &serde_json::to_string(line).map_err(|e| problem(e.to_string()))?;
            begins += "\n";
        }
        self.file = Some(Record {
            path: path.into(),
            begins,
            file: None,
            resumes: resume,
        });
        Ok(self)
    }

    /// What is kept in a file, when the last motion is driven.
    #[must_use]
    pub fn into_record(self) -> Option<Record> {
        self.file
            .filter(|record| record.resumes || record.file.is_some())
    }

    /// Says how long the motions that follow take, s each. Replaces what was said before.
    pub(super) fn ahead(&mut self, seconds: impl IntoIterator<Item = f64>) {
        self.left = seconds.into_iter().collect();
    }

    /// The motions that follow are driven with what was found so far. Those of an earlier run only
    /// count where that is the same.
    pub(super) fn depends(&mut self) {
        if self.changed {
            self.saved.clear();
        }
    }

    /// Reports a search for indexes that is about to begin.
    pub(super) fn announce(&mut self, search: &IndexSearch) {
        self.emit("index search", What::Searches(*search));
    }

    /// Drives a motion, or takes it from an earlier run; `None` where it is left out. `drive` is
    /// called again after a failure that passes.
    ///
    /// # Errors
    /// Those of `drive`, and when the record cannot be written.
    pub(super) fn motion<T: Serialize + DeserializeOwned>(
        &mut self,
        name: &str,
        drive: &mut dyn FnMut() -> Result<T, MasterError>,
    ) -> Result<Option<T>, CalibrateError> {
        self.number += 1;
        let number = self.number;
        let saved = self
            .saved
            .pop_front_if(|line| line.number == number && line.name == name);
        let observed = if self.left_out.contains(&number) {
            self.emit(name, What::LeftOut);
            if saved.is_none_or(|line| line.observed.is_some()) {
                self.changed = true;
                self.keep(name, None)?;
            }
            None
        } else if let Some(saved) = saved.and_then(|line| line.observed)
            && let Ok(observed) = serde_json::from_value(saved)
        {
            self.emit(name, What::Kept);
            Some(observed)
        } else {
            self.changed = true;
            let observed = self.drive(name, drive)?;
            let value = serde_json::to_value(&observed).map_err(|e| self.problem(&e))?;
            self.keep(name, Some(value.clone()))?;
            self.emit(name, What::Finished(value));
            Some(observed)
        };
        self.left.pop_front();
        Ok(observed)
    }

    fn drive<T>(
        &mut self,
        name: &str,
        drive: &mut dyn FnMut() -> Result<T, MasterError>,
    ) -> Result<T, MasterError> {
        self.emit(name, What::Begins);
        for _ in 1..TRIES {
            match drive() {
                Err(error) if passes(&error) => self.emit(name, What::Again(error.to_string())),
                done => return done,
            }
        }
        drive()
    }

    fn keep(&mut self, name: &str, observed: Option<Value>) -> Result<(), CalibrateError> {
        let Some(record) = &mut self.file else {
            return Ok(());
        };
        let line = Line {
            number: self.number,
            name: name.into(),
            observed,
        };
        let written = serde_json::to_string(&line)
            .map_err(std::io::Error::from)
            .and_then(|line| record.write(&line));
        written.map_err(|error| self.problem(&error))
    }

    fn problem(&self, error: &dyn std::error::Error) -> CalibrateError {
        let path = self
            .file
            .as_ref()
            .map(|record| record.path.display().to_string());
        CalibrateError::File {
            path: path.unwrap_or_default(),
            problem: format!("{error}; make room or mend this, then continue with --resume"),
        }
    }

    fn emit(&mut self, name: &str, what: What) {
        let step = Step {
            number: self.number,
            of: (self.number + self.left.len().max(1)).saturating_sub(1),
            name: name.into(),
            seconds_left: self.left.iter().sum(),
            what,
        };
        (self.report)(&step);
    }
}

/// How many motions an earlier run of the same calibration has left in a file.
#[must_use]
pub fn saved_motions(path: &Path, fingerprint: u32) -> Option<usize> {
    let saved = saved(path, fingerprint).ok().flatten()?;
    (!saved.is_empty()).then_some(saved.len())
}

/// The motions in a file; `None` where they are of another calibration.
fn saved(path: &Path, fingerprint: u32) -> std::io::Result<Option<VecDeque<Line>>> {
    let mut lines = BufReader::new(File::open(path)?).lines();
    if lines.next().transpose()? != Some(head(fingerprint)) {
        return Ok(None);
    }
    let mut saved = VecDeque::new();
    for line in lines {
        // The last line of a run that was cut off may be half a line.
        let Ok(line) = serde_json::from_str(&line?) else {
            break;
        };
        saved.push_back(line);
    }
    Ok(Some(saved))
}

fn head(fingerprint: u32) -> String {
    format!("{{\"calibration\":\"{fingerprint:08x}\"}}")
}

/// Whether the same motion may well succeed when it is driven again: the master or the source of
/// poses was late, and nothing is broken, or a robot restarted and is configured again.
fn passes(error: &MasterError) -> bool {
    use protocol::Fault;
    match error.cause() {
        MasterError::MemberFault { fault, .. } => matches!(
            fault,
            Fault::SyncLost | Fault::SetpointOverdue | Fault::MasterSilent | Fault::MemberSilent
        ),
        MasterError::MemberMissing { .. }
        | MasterError::MembersMissing { .. }
        | MasterError::MemberRestarted { .. }
        | MasterError::PoseLost => true,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("omnibus-{name}-{}.jsonl", std::process::id()))
    }

    #[test]
    fn a_calibration_goes_on_where_it_ended() {
        let path = path("resume");
        let mut driven = Vec::new();
        let mut run =
            |resume: bool, broken: usize, fingerprint: u32| {
                let mut steps = Vec::new();
                let mut journal = Journal::new(|step: &Step| steps.push(step.what.clone()))
                    .backed_by(&path, fingerprint, resume)?;
                let mut out = Vec::new();
                for n in 1..=4_usize {
                    out.extend(journal.motion("ahead", &mut || {
                        driven.push(n);
                        if n == broken {
                            Err(MasterError::Aborted)
                        } else {
                            Ok(n * 10)
                        }
                    })?);
                }
                drop(journal);
                Ok::<_, CalibrateError>((out, steps))
            };
        assert!(run(false, 3, 7).is_err());
        // Half a line, as a cut leaves it.
        let text = std::fs::read_to_string(&path).unwrap() + "{\"number\":3,";
        std::fs::write(&path, text).unwrap();
        assert!(matches!(run(true, 0, 8), Err(CalibrateError::File { .. })));
        assert_eq!([7, 8].map(|of| saved_motions(&path, of)), [Some(2), None]);
        let (out, steps) = run(true, 0, 7).unwrap();
        assert_eq!(out, [10, 20, 30, 40]);
        assert_eq!(steps[..2], [What::Kept, What::Kept]);
        assert_eq!(driven, [1, 2, 3, 3, 4]);
        std::fs::remove_file(&path).unwrap();
        assert_eq!(saved_motions(&path, 7), None);
    }

    #[test]
    fn a_passing_failure_is_driven_again_and_a_motion_can_be_left_out() {
        let mut left = 2;
        let mut again = 0;
        let mut journal = Journal::new(|step: &Step| {
            again += usize::from(matches!(step.what, What::Again(_)));
        })
        .without(&[2, 90]);
        let late = || MasterError::MemberFault {
            node: 3,
            fault: protocol::Fault::SyncLost,
        };
        let first = journal.motion("ahead", &mut || {
            left -= 1;
            if left == 0 { Ok(1) } else { Err(late()) }
        });
        assert_eq!(first.unwrap(), Some(1));
        let second = journal.motion("ahead", &mut || -> Result<i32, MasterError> {
            unreachable!()
        });
        assert_eq!(second.unwrap(), None);
        let never = journal.motion("ahead", &mut || Err::<i32, _>(late()));
        assert!(never.is_err());
        assert_eq!(journal.unknown(), Some((90, 3)));
        drop(journal);
        assert_eq!(again, 1 + 2);
    }
}
