//! Poses from another program: JSON lines over TCP, as `omnibus-sim serve --pose-tcp` and
//! motion-capture bridges send them.
//!
//! ```json
//! {"t":1.25,"group":{"x":0.1,"y":0,"heading":0},"robots":[{"node":2,"x":1.3,"y":0,"heading":0}]}
//! {"t":1.25,"x":1.3,"y":0,"heading":0}
//! ```
//!
//! The second form is of one body: the group, or the only robot that is asked for. m and rad, any
//! fixed frame with counter-clockwise headings. Everything else on a line is passed over, its time
//! too: that is of another clock, so a pose counts from when its line arrived, but not from before
//! the bus's clock at the previous look: on a bus whose time waits the clock on the wall says
//! nothing about age. A thread reads; the latest line wins, and a line that holds no pose counts as
//! none.

use std::cell::Cell;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use canopen::Micros;
use kinematics::Pose;
use serde::Deserialize;

use crate::error::MasterError;
use crate::source::json_lines;

/// A line older than this says nothing about where robots are.
const STALE: Duration = Duration::from_secs(1);

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

/// The latest line, and when it arrived.
type Latest = Arc<Mutex<(Instant, Line)>>;

/// A connection to a program that sends poses.
pub struct PoseStream {
    address: String,
    latest: Latest,
    latest_read: Cell<Option<LatestRead>>,
}

/// The last look at the latest line.
#[derive(Clone, Copy)]
struct LatestRead {
    arrived: Instant,
    /// When that was on the bus's clock.
    at: Micros,
    read_at: Micros,
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
        let latest: Latest = Arc::new(Mutex::new((Instant::now(), line)));
        let newest = Arc::clone(&latest);
        std::thread::spawn(move || {
            for text in lines {
                // A reader sees how old the latest is; nobody is left once the stream is dropped.
                let Ok(text) = text else { return };
                if Arc::strong_count(&newest) == 1 {
                    return;
                }
                if let Some(line) = Line::parse(&text) {
                    let now = (Instant::now(), line);
                    *newest.lock().unwrap_or_else(PoisonError::into_inner) = now;
                }
            }
        });
        Ok(Self {
            address: address.to_owned(),
            latest,
            latest_read: Cell::new(None),
        })
    }

    fn read(&self) -> (Instant, Line) {
        let latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        latest.clone()
    }

    /// The latest pose of the group and when it arrived, on a clock that now shows `now`.
    #[must_use]
    pub fn latest(&self, now: Micros) -> Option<(Micros, Pose)> {
        let (arrived, line) = self.read();
        let [x, y, heading] = line.group()?;
        let at = match self.latest_read.get() {
            Some(latest_read) if latest_read.arrived == arrived => latest_read.at,
            before => {
                let age = u64::try_from(arrived.elapsed().as_micros()).unwrap_or(u64::MAX);
                let earliest = before.map_or(0, |before| before.read_at.0);
                Micros(now.0.saturating_sub(age).max(earliest).min(now.0))
            }
        };
        self.latest_read.set(Some(LatestRead {
            arrived,
            at,
            read_at: now,
        }));
        #[expect(clippy::cast_possible_truncation, reason = "setpoints are f32")]
        let pose = Pose::new(x as f32, y as f32, heading as f32);
        Some((at, pose))
    }

    /// The latest pose of the group: m, m, rad.
    ///
    /// # Errors
    /// When the latest line is old, or does not have it.
    pub fn group(&self) -> Result<[f64; 3], MasterError> {
        self.fresh()?
            .group()
            .ok_or_else(|| self.bad("has no pose of the group"))
    }

    /// The latest poses of these robots: m, m, rad.
    ///
    /// # Errors
    /// When the latest line is old, or leaves a robot out.
    pub fn robots(&self, nodes: &[u8]) -> Result<Vec<[f64; 3]>, MasterError> {
        let line = self.fresh()?;
        let place = |node: &u8| {
            line.robot(*node, nodes.len() == 1)
                .ok_or_else(|| self.bad(&format!("has no pose of node {node}")))
        };
        nodes.iter().map(place).collect()
    }

    fn fresh(&self) -> Result<Line, MasterError> {
        let (at, line) = self.read();
        if at.elapsed() > STALE {
            return Err(self.bad("has sent no pose for a second"));
        }
        Ok(line)
    }

    fn bad(&self, problem: &str) -> MasterError {
        MasterError::PoseSource {
            address: format!("tcp://{}", self.address),
            problem: problem.to_owned(),
        }
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

    /// The clock on the wall goes on for 50 ms, that of the bus for 10: the pose is 10 ms old, and
    /// not
    /// 50. A new one that came meanwhile is not older than the look before it.
    #[test]
    fn a_pose_ages_with_the_clock_of_the_bus() {
        let (more, wait) = std::sync::mpsc::channel::<()>();
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            stream
                .write_all(b"{\"x\":1,\"y\":0,\"heading\":0}\n")
                .unwrap();
            wait.recv().unwrap();
            stream
                .write_all(b"{\"x\":2,\"y\":0,\"heading\":0}\n")
                .unwrap();
            let _ = wait.recv();
        });
        let stream = PoseStream::connect(&address).unwrap();
        let (first, _) = stream.latest(Micros(5_000_000)).unwrap();
        std::thread::sleep(Duration::from_millis(50));
        assert_eq!(stream.latest(Micros(5_010_000)).unwrap().0, first);
        more.send(()).unwrap();
        while stream.read().1.group().unwrap()[0] < 2.0 {
            std::thread::yield_now();
        }
        std::thread::sleep(Duration::from_millis(50));
        let (second, pose) = stream.latest(Micros(5_020_000)).unwrap();
        assert_eq!((second, pose.x), (Micros(5_010_000), 2.0));
    }

    #[test]
    fn robots_are_found_by_node_and_one_alone_without() {
        let both = served(
            "{\"t\":1,\"group\":{\"x\":0,\"y\":0,\"heading\":0},\"robots\":[{\"node\":3,\"x\":1.5,\"y\":-1,\"heading\":0.5}]}\n",
        )
        .unwrap();
        assert_eq!(both.robots(&[3]).unwrap(), [[1.5, -1.0, 0.5]]);
        assert_eq!(both.group().unwrap(), [0.0; 3]);
        let missing = both.robots(&[2]).unwrap_err().to_string();
        assert!(missing.contains("no pose of node 2"), "{missing}");
        let one = served("{\"t\":1,\"x\":2,\"y\":3,\"heading\":-4}\n").unwrap();
        assert_eq!(one.robots(&[2]).unwrap(), [[2.0, 3.0, -4.0]]);
        assert!(one.robots(&[2, 3]).is_err(), "which of the two is it?");
    }
}
