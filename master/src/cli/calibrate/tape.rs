//! `omnibus calibrate --tape`: a person measures every motion.

use std::io::BufRead as _;
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
    let (asked, wanted) = match motion.way {
        Way::Ahead => (format!("{x:+.3} m ahead"), "m ahead"),
        Way::Aside => (format!("{y:+.3} m to the left"), "m to the left"),
        Way::Oblique => (
            format!("{x:+.3} m ahead and {y:+.3} m to the left"),
            "m ahead, m to the left",
        ),
        Way::Turn => (
            format!("{:+.1} degrees to the left", turn.to_degrees()),
            "degrees to the left",
        ),
    };
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
        if line.trim().is_empty() {
            return Ok(None);
        }
        let numbers = line.split([' ', ',', '\t']).filter(|part| !part.is_empty());
        let numbers: Result<Vec<f64>, _> = numbers.map(str::parse).collect();
        match (motion.way, numbers.as_deref()) {
            (Way::Ahead, Ok([x])) => return Ok(Some([*x, 0.0, 0.0])),
            (Way::Aside, Ok([y])) => return Ok(Some([0.0, *y, 0.0])),
            (Way::Oblique, Ok([x, y])) => return Ok(Some([*x, *y, 0.0])),
            (Way::Turn, Ok([degrees])) => return Ok(Some([0.0, 0.0, degrees.to_radians()])),
            _ => print_note(format!(
                "'{}' is not a measurement; type one number for each of: {wanted}",
                line.trim()
            )),
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
}
