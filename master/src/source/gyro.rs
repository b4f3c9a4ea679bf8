//! Yaw rates from another program: JSON lines over TCP, as a bridge to the robots' gyros sends
//! them.
//!
//! ```json
//! {"t":1.25,"yaw_rate":0.031}
//! {"t":1.25,"robots":[{"node":2,"yaw_rate":0.031},{"node":3,"yaw_rate":-0.007}]}
//! ```
//!
//! The first form is for a single robot. `t` is the time of the sample, s, on the gyro's own clock;
//! `yaw_rate` is in rad/s about the axis that points up, counter-clockwise positive, raw: a bias
//! does no harm. Everything else on a line is ignored.
//!
//! A thread reads, and every sample is stored until it is taken, some hundred a second. Of poses
//! only the latest counts, but a missing sample would be a missing turn. So a line without a
//! sample, a time that does not increase, silence and a closed connection are errors for the next
//! reader of the samples.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use canopen::Micros;
use serde::Deserialize;

use crate::error::MasterError;
use crate::source::json_lines;

/// Silence for longer than this is an error.
const SILENCE: Duration = Duration::from_millis(500);
/// No robot turns this fast, rad/s.
const FASTEST: f64 = 1000.0;
/// As much of a bad line is shown.
const SHOWN: usize = 80;

/// A sample of one robot's gyro.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateSample {
    /// When it came, s on the link's clock.
    pub arrived: f64,
    /// When it was taken, s on the gyro's clock.
    pub t: f64,
    /// rad/s, counter-clockwise positive.
    pub yaw_rate: f64,
}

#[derive(Clone, Deserialize)]
struct Robot {
    node: u8,
    yaw_rate: f64,
}

/// What one line says.
#[derive(Clone, Deserialize)]
struct Line {
    t: f64,
    #[serde(default)]
    robots: Vec<Robot>,
    yaw_rate: Option<f64>,
}

impl Line {
    fn parse(text: &str) -> Result<Self, String> {
        let shown: String = text.chars().take(SHOWN).collect();
        let bad = |problem: String| format!("{problem} in the line: {shown}");
        // serde would take a list for the fields in their order.
        if !text.trim_start().starts_with('{') {
            return Err(bad("the line has no JSON object".into()));
        }
        let line: Self = serde_json::from_str(text).map_err(|error| bad(error.to_string()))?;
        let mut rates = line
            .robots
            .iter()
            .map(|robot| robot.yaw_rate)
            .chain(line.yaw_rate)
            .peekable();
        if rates.peek().is_none() {
            return Err(bad("the line has no yaw_rate".into()));
        }
        if let Some(rate) = rates.find(|rate| rate.is_nan() || rate.abs() > FASTEST) {
            return Err(bad(format!("yaw_rate {rate} is not a yaw rate in rad/s")));
        }
        Ok(line)
    }

    fn of(&self, node: u8, only: bool) -> Option<f64> {
        let named = self.robots.iter().find(|robot| robot.node == node);
        let named = named.map(|robot| robot.yaw_rate);
        named.or(self.yaw_rate.filter(|_| only))
    }
}

/// What has come and was not taken.
struct Waiting {
    lines: Vec<(Instant, Line)>,
    /// Time of the last line, on both clocks.
    last: (Instant, f64),
    /// Why no more will come.
    ended: Option<String>,
}

/// A connection to a program that sends yaw rates.
pub struct GyroStream {
    address: String,
    waiting: Arc<Mutex<Waiting>>,
}

impl GyroStream {
    /// Connects to `HOST:PORT` and waits for the first sample.
    ///
    /// # Errors
    /// When there is no connection, or what comes first is no sample.
    pub fn connect(address: &str) -> io::Result<Self> {
        let (first, lines) = json_lines::connect(address, "sample")?;
        let first = Line::parse(&first).map_err(io::Error::other)?;
        let now = Instant::now();
        let waiting = Arc::new(Mutex::new(Waiting {
            last: (now, first.t),
            lines: vec![(now, first)],
            ended: None,
        }));
        let shared = Arc::clone(&waiting);
        std::thread::spawn(move || {
            for text in lines {
                if Arc::strong_count(&shared) == 1 || !receive(&shared, text) {
                    return;
                }
            }
            lock(&shared).ended = Some("the connection was closed".into());
        });
        Ok(Self {
            address: address.to_owned(),
            waiting,
        })
    }

    /// The samples of these robots that have come since the last call, on a link whose clock shows
    /// `now`.
    ///
    /// # Errors
    /// When something else than samples has come, nothing for half a second, or nothing of one of
    /// the robots.
    pub fn take(&self, nodes: &[u8], now: Micros) -> Result<Vec<Vec<RateSample>>, MasterError> {
        let mut waiting = lock(&self.waiting);
        if let Some(problem) = &waiting.ended {
            return Err(self.bad(problem));
        }
        if waiting.last.0.elapsed() > SILENCE {
            return Err(self.bad("no sample arrived for half a second"));
        }
        let now = now.0 as f64 * 1e-6;
        let mut out = vec![Vec::with_capacity(waiting.lines.len()); nodes.len()];
        for (at, line) in waiting.lines.drain(..) {
            for (samples, node) in out.iter_mut().zip(nodes) {
                let yaw_rate = line
                    .of(*node, nodes.len() == 1)
                    .ok_or_else(|| self.bad(&format!("a line has no yaw_rate of node {node}")))?;
                samples.push(RateSample {
                    arrived: now - at.elapsed().as_secs_f64(),
                    t: line.t,
                    yaw_rate,
                });
            }
        }
        Ok(out)
    }

    fn bad(&self, problem: &str) -> MasterError {
        MasterError::GyroSource {
            address: format!("tcp://{}", self.address),
            problem: problem.to_owned(),
        }
    }
}

fn lock(waiting: &Mutex<Waiting>) -> std::sync::MutexGuard<'_, Waiting> {
    waiting.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Takes in a line; `false` when it is the last one.
fn receive(waiting: &Mutex<Waiting>, text: io::Result<String>) -> bool {
    let now = Instant::now();
    let line = text
        .map_err(|error| error.to_string())
        .and_then(|text| Line::parse(&text));
    let mut waiting = lock(waiting);
    let line = line.and_then(|line| {
        let before = waiting.last.1;
        if line.t > before {
            Ok(line)
        } else {
            Err(format!("t does not rise: {} after {before}", line.t))
        }
    });
    match line {
        Ok(line) => {
            waiting.last = (now, line.t);
            waiting.lines.push((now, line));
            true
        }
        Err(problem) => {
            waiting.ended = Some(problem);
            false
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    /// A server that sends these texts, one every 20 ms, then hangs up or stays silent.
    fn served(texts: &'static [&'static str], hangs_up: bool) -> io::Result<GyroStream> {
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            for text in texts {
                writeln!(stream, "{text}").unwrap();
                std::thread::sleep(Duration::from_millis(20));
            }
            if !hangs_up {
                // Stays open until the reader has gone.
                let _ = std::io::Read::read(&mut stream, &mut [0]);
            }
        });
        GyroStream::connect(&address)
    }

    fn patiently(stream: &GyroStream, nodes: &[u8]) -> Result<Vec<Vec<RateSample>>, String> {
        std::thread::sleep(Duration::from_millis(200));
        let samples = stream.take(nodes, Micros(10_000_000));
        samples.map_err(|error| error.to_string())
    }

    #[test]
    fn both_spellings_are_samples() {
        let one = served(
            &[
                r#"{"t":1.0,"yaw_rate":0.5}"#,
                r#"{"t":1.01,"yaw_rate":-0.25,"x":1}"#,
            ],
            false,
        )
        .unwrap();
        let samples = patiently(&one, &[2]).unwrap().remove(0);
        let rates: Vec<_> = samples.iter().map(|s| (s.t, s.yaw_rate)).collect();
        assert_eq!(rates, [(1.0, 0.5), (1.01, -0.25)]);
        // It came 20 ms after the first, and both before now.
        assert!(samples[0].arrived < samples[1].arrived && samples[1].arrived < 10.0);
        let two = r#"{"t":1,"robots":[{"node":3,"yaw_rate":0.5},{"node":2,"yaw_rate":1}]}"#;
        let two = Line::parse(two).unwrap();
        assert_eq!((two.of(2, false), two.of(3, false)), (Some(1.0), Some(0.5)));
        assert_eq!(two.of(4, true), None);
    }

    #[test]
    fn what_is_no_sample_is_refused_by_name() {
        for (line, word) in [
            ("hello", "JSON"),
            ("[1, 2]", "JSON"),
            (r#"{"yaw_rate":0.1}"#, "`t`"),
            (r#"{"t":1}"#, "no yaw_rate"),
            (r#"{"t":1,"yaw_rate":NaN}"#, "expected value"),
            (r#"{"t":1,"yaw_rate":null}"#, "no yaw_rate"),
            (r#"{"t":1,"yaw_rate":1e9}"#, "rad/s"),
            (r#"{"t":1,"robots":[{"node":2}]}"#, "yaw_rate"),
        ] {
            let error = Line::parse(line).err().unwrap();
            assert!(error.contains(word) && error.contains(line), "{error}");
        }
        let error = served(&["hello"], false).err().unwrap().to_string();
        assert!(error.contains("hello"), "{error}");
    }

    #[test]
    fn a_stream_that_goes_wrong_is_an_error_from_then_on() {
        const GOOD: &str = r#"{"t":1,"yaw_rate":0.1}"#;
        let silent = served(&[GOOD], false).unwrap();
        assert!(patiently(&silent, &[2]).is_ok());
        std::thread::sleep(SILENCE);
        let error = patiently(&silent, &[2]).unwrap_err();
        assert!(error.contains("half a second"), "{error}");
        let gone = served(&[GOOD], true).unwrap();
        let error = patiently(&gone, &[2]).unwrap_err();
        assert!(error.contains("closed"), "{error}");
        let again = served(&[GOOD, GOOD], false).unwrap();
        let error = patiently(&again, &[2]).unwrap_err();
        assert!(error.contains("does not rise"), "{error}");
        let bad = served(&[GOOD, r#"{"t":2}"#], false).unwrap();
        let error = patiently(&bad, &[2]).unwrap_err();
        assert!(error.contains("no yaw_rate"), "{error}");
        let other = served(&[r#"{"t":1,"robots":[{"node":2,"yaw_rate":1}]}"#], false).unwrap();
        let error = patiently(&other, &[3]).unwrap_err();
        assert!(error.contains("node 3"), "{error}");
    }
}
