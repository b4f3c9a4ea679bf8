//! `omnibus calibrate --tape`: a person measures every motion.

use std::io::BufRead as _;
use std::ops::RangeInclusive;
use std::sync::mpsc;
use std::time::Duration;

use canopen::Micros;
use omnibus::bus::link::Link;
use omnibus::commission::calibrate::manoeuvre::{Manoeuvre, Way};
use omnibus::error::MasterError;
use omnibus::session::Group;

use crate::cli::print_note;

/// Answers to questions, line by line from the standard input.
pub fn answers() -> mpsc::Receiver<String> {
    read(|| std::io::stdin().lock().lines())
}

/// Lines from a thread of its own, which reads one ahead: an input without end must not fill the
/// memory.
fn read<I: Iterator<Item = std::io::Result<String>>>(
    lines: impl FnOnce() -> I + Send + 'static,
) -> mpsc::Receiver<String> {
    let (send, answers) = mpsc::sync_channel(0);
    std::thread::spawn(move || {
        for line in lines() {
            let Ok(line) = line else { return };
            if send.send(line).is_err() {
                return;
            }
        }
    });
    answers
}

/// What a measurement is of what was commanded; typed with the wrong sign or unit it is not.
const LIKELY: RangeInclusive<f64> = 0.5..=1.5;

/// What a person is asked after a motion.
pub struct Question {
    /// In the units of the answer.
    commanded: Vec<f64>,
    wanted: &'static str,
    /// The last answer, if that was unlikely.
    doubted: Option<Vec<f64>>,
}

impl Question {
    /// Asks for one number for each that was commanded; `wanted` are their units and directions.
    pub fn new(commanded: Vec<f64>, wanted: &'static str) -> Self {
        Self {
            commanded,
            wanted,
            doubted: None,
        }
    }

    /// The numbers of an answer, none for a motion that is skipped. What is unlikely counts when it
    /// is typed twice.
    ///
    /// # Errors
    /// Why to ask again.
    pub fn take(&mut self, line: &str) -> Result<Option<Vec<f64>>, String> {
        let (line, wanted) = (line.trim(), self.wanted);
        if line.is_empty() {
            return Ok(None);
        }
        let numbers = line.split([' ', ',', '\t']).filter(|part| !part.is_empty());
        let numbers: Result<Vec<f64>, _> = numbers.map(str::parse).collect();
        let numbers = numbers.ok().filter(|numbers| {
            numbers.len() == self.commanded.len() && numbers.iter().all(|it| it.is_finite())
        });
        let Some(numbers) = numbers else {
            return Err(format!(
                "'{line}' is not a measurement; type one number for each of: {wanted}"
            ));
        };
        let mut pairs = numbers.iter().zip(&self.commanded);
        if pairs.all(|(measured, commanded)| LIKELY.contains(&(measured / commanded)))
            || self.doubted.as_ref() == Some(&numbers)
        {
            return Ok(Some(numbers));
        }
        self.doubted = Some(numbers);
        Err(format!(
            "'{line}' is far from what was commanded; type the measurement with its sign ({wanted}), or \
             this once more if it is right"
        ))
    }
}

/// Asks how far the group has come, with its robots switched off.
///
/// # Errors
/// When the link fails, or there are no more answers.
pub fn ask<L: Link>(
    group: &mut Group<L>,
    motion: &Manoeuvre,
    answers: &mpsc::Receiver<String>,
) -> Result<Option<[f64; 3]>, MasterError> {
    // People must not approach robots that could move.
    group.stop()?;
    let measured = question(group, motion, answers)?;
    group.start()?;
    Ok(measured)
}

/// Asks until the answer makes sense.
fn question<L: Link>(
    group: &mut Group<L>,
    motion: &Manoeuvre,
    answers: &mpsc::Receiver<String>,
) -> Result<Option<[f64; 3]>, MasterError> {
    let [x, y, turn] = motion.displacement();
    let degrees = turn.to_degrees();
    let (asked, commanded, wanted) = match motion.way {
        Way::Ahead => (format!("{x:+.3} m ahead"), vec![x], "m ahead"),
        Way::Aside => (format!("{y:+.3} m to the left"), vec![y], "m to the left"),
        Way::Oblique => (
            format!("{x:+.3} m ahead and {y:+.3} m to the left"),
            vec![x, y],
            "m ahead, m to the left",
        ),
        Way::Turn => (
            format!("{degrees:+.1} degrees to the left"),
            vec![degrees],
            "degrees to the left",
        ),
    };
    let mut question = Question::new(commanded, wanted);
    loop {
        print_note(format!(
            "commanded {asked}; measured ({wanted}; Enter skips this motion): "
        ));
        let line = loop {
            match answers.recv_timeout(Duration::from_millis(20)) {
                Ok(line) => break line,
                Err(mpsc::RecvTimeoutError::Timeout) => {
                    let until = Micros(group.wire().now().0 + 50_000);
                    group.listen(until)?;
                }
                Err(mpsc::RecvTimeoutError::Disconnected) => return Err(MasterError::NoAnswer),
            }
            if group.abort().is_asked() {
                return Err(MasterError::Aborted);
            }
        };
        match (motion.way, question.take(&line)) {
            (_, Ok(None)) => return Ok(None),
            (Way::Ahead, Ok(Some(it))) => return Ok(Some([it[0], 0.0, 0.0])),
            (Way::Aside, Ok(Some(it))) => return Ok(Some([0.0, it[0], 0.0])),
            (Way::Oblique, Ok(Some(it))) => return Ok(Some([it[0], it[1], 0.0])),
            (Way::Turn, Ok(Some(it))) => return Ok(Some([0.0, 0.0, it[0].to_radians()])),
            (_, Err(why)) => print_note(why),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn an_input_without_end_is_read_as_far_as_it_is_asked_for() {
        let count = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&count);
        let lines = read(move || {
            std::iter::from_fn(move || {
                counted.fetch_add(1, Ordering::SeqCst);
                Some(Ok("0.9".to_owned()))
            })
        });
        for _ in 0..3 {
            assert_eq!(lines.recv().unwrap(), "0.9");
        }
        std::thread::sleep(Duration::from_millis(20));
        assert!(count.load(Ordering::SeqCst) <= 4);
    }

    /// Of 1 m back and 0.5 m to the left.
    #[test]
    fn an_unlikely_measurement_counts_when_it_is_typed_twice() {
        let mut question = Question::new(vec![-1.0, 0.5], "m ahead, m to the left");
        for line in ["1", "1 2 3", "-1 m", "-1 nan", "-inf 0.5", "-1;0.5"] {
            let why = question.take(line).unwrap_err();
            assert!(why.contains("is not a measurement"), "{why}");
        }
        // The sign, and millimetres.
        for line in ["0.98 0.47", "-980 470", "-0.98 470", "-0.98 -0.47"] {
            let why = question.take(line).unwrap_err();
            assert!(why.contains("far from what was commanded"), "{why}");
        }
        assert_eq!(question.take("-0.98, -0.47"), Ok(Some(vec![-0.98, -0.47])));
        assert_eq!(question.take(" -0.98\t0.47 "), Ok(Some(vec![-0.98, 0.47])));
        assert_eq!(question.take(" "), Ok(None));
    }
}
