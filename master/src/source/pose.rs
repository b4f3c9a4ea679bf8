//! Poses from another program: JSON lines over TCP, as `omnibus-sim serve --pose-tcp` and
//! motion-capture bridges send them.
//!
//! ```json
//! {"t":1.25,"group":{"x":0.1,"y":0,"heading":0},"robots":[{"node":2,"x":1.3,"y":0,"heading":0}]}
//! {"t":1.25,"x":1.3,"y":0,"heading":0}
//! ```
//!
//! The second form is for one body: the group, or a single robot. m and rad, any fixed frame with
//! counter-clockwise headings. Everything else on a line is ignored, its time too: that is of
//! another clock, so a pose has the time at which its line arrived. A thread reads; the latest line
//! counts, and a line without a pose is skipped.
//!
//! On a bus whose time waits ([`PoseStream::on_waiting_bus`]) the clock on the wall says nothing
//! about age. There `t` is the bus's time in s, and a look waits for the line of its moment.

use std::io;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use canopen::Micros;
use kinematics::Pose;
use serde::Deserialize;

use crate::error::MasterError;
use crate::source::json_lines;

/// A line older than this says nothing about where robots are.
const STALE: Duration = Duration::from_secs(1);
/// Between the first line and the second on such a bus, at most, s.
const LONGEST_INTERVAL: f64 = 0.1;
/// How long a line of the present may take on a bus whose time waits.
const PATIENCE: Duration = Duration::from_secs(10);

#[derive(Clone, Copy, Deserialize)]
struct Place {
    x: f64,
    y: f64,
    heading: f64,
}

#[derive(Clone, Copy, Deserialize)]
struct Robot {
    node: u8,
    x: f64,
    y: f64,
    heading: f64,
}

/// What one line says.
#[derive(Clone, Deserialize)]
struct Line {
    t: Option<f64>,
    group: Option<Place>,
    #[serde(default)]
    robots: Vec<Robot>,
    x: Option<f64>,
    y: Option<f64>,
    heading: Option<f64>,
}

impl Line {
    /// The poses on a line; `None` when there are none.
    fn parse(text: &str) -> Option<Self> {
        // serde would take a list for the fields in their order.
        if !text.trim_start().starts_with('{') {
            return None;
        }
        let line: Self = serde_json::from_str(text).ok()?;
        let robots = line
            .robots
            .iter()
            .map(|robot| [robot.x, robot.y, robot.heading]);
        let mut places = robots.chain(line.group()).peekable();
        places.peek()?;
        // 1e30 is where an f32 ends, near enough.
        let finite = |place: [f64; 3]| place.iter().all(|v| v.abs() < 1e30);
        places.all(finite).then_some(line)
    }

    fn body(&self) -> Option<[f64; 3]> {
        Some([self.x?, self.y?, self.heading?])
    }

    fn group(&self) -> Option<[f64; 3]> {
        let group = self.group.map(|place| [place.x, place.y, place.heading]);
        group.or_else(|| self.body())
    }

    fn robot(&self, node: u8, only: bool) -> Option<[f64; 3]> {
        let named = self.robots.iter().find(|robot| robot.node == node);
        let named = named.map(|robot| [robot.x, robot.y, robot.heading]);
        named.or_else(|| self.body().filter(|_| only))
    }
}

/// The latest line, when it arrived, and the time on the line before it, s.
struct Latest {
    arrived: Instant,
    /// The same on the bus's clock, from the first look on.
    at: Option<Micros>,
    line: Line,
    before: Option<f64>,
}

impl Latest {
    /// Whether a later line has been sent, or will be, by when the bus's clock shows `now`: lines
    /// come at equal intervals.
    fn is_to_come(&self, now: Micros) -> bool {
        let Some(t) = self.line.t else { return false };
        let interval = self.before.map_or(LONGEST_INTERVAL, |before| t - before);
        // Half a microsecond: a clock in whole ones.
        t + interval.max(0.0) <= now.0 as f64 * 1e-6 + 5e-7
    }
}

/// What the thread that reads leaves for others.
type Shared = Arc<(Mutex<Latest>, Condvar)>;

/// A connection to a program that sends poses. A clone is the same connection.
#[derive(Clone)]
pub struct PoseStream {
    address: String,
    shared: Shared,
    waits: bool,
}

impl PoseStream {
    /// Connects to `HOST:PORT` and waits for the first pose.
    ///
    /// # Errors
    /// When there is no connection, or what comes first is no pose.
    pub fn connect(address: &str) -> io::Result<Self> {
        let (first, lines) = json_lines::connect(address, "pose")?;
        let line = Line::parse(&first)
            .ok_or_else(|| io::Error::other(format!("the first line is not a pose: {first}")))?;
        let latest = Latest {
            arrived: Instant::now(),
            at: None,
            line,
            before: None,
        };
        let shared: Shared = Arc::new((Mutex::new(latest), Condvar::new()));
        let newest = Arc::clone(&shared);
        std::thread::spawn(move || {
            for text in lines {
                // A reader sees how old the latest is; nobody is left once the stream is dropped.
                let Ok(text) = text else { return };
                if Arc::strong_count(&newest) == 1 {
                    return;
                }
                if let Some(line) = Line::parse(&text) {
                    let mut latest = newest.0.lock().unwrap_or_else(PoisonError::into_inner);
                    let before = latest.line.t;
                    *latest = Latest {
                        arrived: Instant::now(),
                        at: None,
                        line,
                        before,
                    };
                    newest.1.notify_all();
                }
            }
        });
        Ok(Self {
            address: address.to_owned(),
            shared,
            waits: false,
        })
    }

    /// Says whether the bus's time waits for this end, and passes with `t` of the lines.
    #[must_use]
    pub fn on_waiting_bus(mut self, waits: bool) -> Self {
        self.waits = waits;
        self
    }

    /// The latest line when the bus's clock shows `now`, and since when that holds; an error when
    /// it is too old to say anything.
    fn read(&self, now: Micros) -> Result<(Micros, Line), MasterError> {
        let (mutex, arrival) = &*self.shared;
        let mut latest = mutex.lock().unwrap_or_else(PoisonError::into_inner);
        if self.waits && latest.line.t.is_some() {
            let deadline = Instant::now() + PATIENCE;
            while latest.is_to_come(now) {
                let left = deadline.saturating_duration_since(Instant::now());
                if left.is_zero() {
                    return Err(self.bad("has sent no pose for this time of the bus"));
                }
                let waited = arrival.wait_timeout(latest, left);
                latest = waited.unwrap_or_else(PoisonError::into_inner).0;
            }
            let at = latest.line.t.map_or(now, |t| Micros((t * 1e6) as u64));
            return Ok((Micros(at.0.min(now.0)), latest.line.clone()));
        }
        let age = latest.arrived.elapsed();
        if age > STALE {
            return Err(self.bad("has sent no pose for a second"));
        }
        let age = u64::try_from(age.as_micros()).unwrap_or(u64::MAX);
        let arrived = Micros(now.0.saturating_sub(age));
        let at = *latest.at.get_or_insert(arrived);
        Ok((at, latest.line.clone()))
    }

    /// The latest pose of the group and since when it holds, on a clock that now shows `now`.
    #[must_use]
    pub fn latest(&self, now: Micros) -> Option<(Micros, Pose)> {
        let (at, line) = self.read(now).ok()?;
        let [x, y, heading] = line.group()?;
        #[expect(clippy::cast_possible_truncation, reason = "setpoints are f32")]
        let pose = Pose::new(x as f32, y as f32, heading as f32);
        Some((at, pose))
    }

    /// The pose of the group (m, m, rad) when the bus's clock shows `now`.
    ///
    /// # Errors
    /// When the latest line is old, or does not have it.
    pub fn group(&self, now: Micros) -> Result<[f64; 3], MasterError> {
        let (_, line) = self.read(now)?;
        line.group()
            .ok_or_else(|| self.bad("has no pose of the group"))
    }

    /// The poses of these robots (m, m, rad) when the bus's clock shows `now`.
    ///
    /// # Errors
    /// When the latest line is old, or leaves a robot out.
    pub fn robots(&self, nodes: &[u8], now: Micros) -> Result<Vec<[f64; 3]>, MasterError> {
        let (_, line) = self.read(now)?;
        let place = |node: &u8| {
            line.robot(*node, nodes.len() == 1)
                .ok_or_else(|| self.bad(&format!("has no pose of node {node}")))
        };
        nodes.iter().map(place).collect()
    }

    fn bad(&self, problem: &str) -> MasterError {
        MasterError::PoseSource {
            address: format!("tcp://{}", self.address),
            problem: problem.to_owned(),
        }
    }
}

impl PartialEq for PoseStream {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.shared, &other.shared)
    }
}

impl std::fmt::Debug for PoseStream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("PoseStream").field(&self.address).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    fn served(text: &'static str) -> io::Result<PoseStream> {
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            stream.write_all(text.as_bytes()).unwrap();
            // Stays open until the reader has gone.
            let _ = std::io::Read::read(&mut stream, &mut [0]);
        });
        PoseStream::connect(&address)
    }

    #[test]
    fn both_spellings_are_poses_and_nothing_else_is() {
        let pose = [0.5, -1.0, 2.0];
        let grouped = r#"{"t":1.25,"group":{"x":0.5,"y":-1.0,"heading":2.0},"robots":[]}"#;
        assert_eq!(Line::parse(grouped).unwrap().group(), Some(pose));
        let flat = Line::parse(r#"{"x":0.5,"y":-1,"heading":2}"#).unwrap();
        assert_eq!(flat.group(), Some(pose));
        for line in [
            "",
            "{}",
            "[1,2,3]",
            r#"{"x":1,"y":2}"#,
            r#"{"x":1e99,"y":0,"heading":0}"#,
        ] {
            assert!(Line::parse(line).is_none(), "{line}");
        }
    }

    #[test]
    fn the_first_line_decides_whether_the_server_is_right() {
        let error = served("hello\n").err().unwrap().to_string();
        assert!(error.contains("hello"), "{error}");
        let stream = served("{\"x\":1,\"y\":2,\"heading\":0}\n").unwrap();
        let (_, pose) = stream.latest(Micros(1_000_000)).unwrap();
        assert_eq!(pose, Pose::new(1.0, 2.0, 0.0));
    }

    /// A line that is on its way when the bus has stopped for this end is waited for; the pose is
    /// of its time, not of when it was read.
    #[test]
    fn on_a_bus_that_waits_a_pose_is_of_the_time_that_the_bus_shows() {
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        let (more, wait) = std::sync::mpsc::channel::<u32>();
        std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            let mut send = |step: u32| {
                let t = f64::from(step) * 0.01;
                writeln!(stream, "{{\"t\":{t},\"x\":{step},\"y\":0,\"heading\":0}}").unwrap();
            };
            (100..=101).for_each(&mut send);
            while let Ok(step) = wait.recv() {
                std::thread::sleep(Duration::from_millis(50));
                send(step);
            }
        });
        let stream = PoseStream::connect(&address).unwrap().on_waiting_bus(true);
        // Two lines tell how far apart they are.
        while stream.shared.0.lock().unwrap().before.is_none() {
            std::thread::yield_now();
        }
        for step in 102..106 {
            more.send(step).unwrap();
            let now = Micros(u64::from(step) * 10_000 + 3_000);
            let (at, pose) = stream.latest(now).unwrap();
            assert_eq!(pose.x, step as f32);
            assert!(at.0.abs_diff(u64::from(step) * 10_000) <= 1, "{at:?}");
        }
        drop(more);
    }

    #[test]
    fn robots_are_found_by_node_and_one_alone_without() {
        let both = served(
            "{\"t\":1,\"group\":{\"x\":0,\"y\":0,\"heading\":0},\"robots\":[{\"node\":3,\"x\":1.5,\"y\":-1,\"heading\":0.5}]}\n",
        )
        .unwrap();
        assert_eq!(both.robots(&[3], Micros(0)).unwrap(), [[1.5, -1.0, 0.5]]);
        assert_eq!(both.group(Micros(0)).unwrap(), [0.0; 3]);
        let missing = both.robots(&[2], Micros(0)).unwrap_err().to_string();
        assert!(missing.contains("no pose of node 2"), "{missing}");
        let one = served("{\"t\":1,\"x\":2,\"y\":3,\"heading\":-4}\n").unwrap();
        assert_eq!(one.robots(&[2], Micros(0)).unwrap(), [[2.0, 3.0, -4.0]]);
        assert!(
            one.robots(&[2, 3], Micros(0)).is_err(),
            "which of the two is it?"
        );
    }
}
