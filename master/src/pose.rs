//! Poses from another program: JSON lines over TCP, as `omnibus-sim --pose-tcp` and motion-capture bridges
//! send them.
//!
//! A line is an object with the group's pose under `group`, or the pose itself: `{"t": 1.25, "group": {"x": 0.1,
//! "y": 0.0, "heading": 0.0}}` or `{"x": 0.1, "y": 0.0, "heading": 0.0}`, in m and rad, any fixed frame with
//! counter-clockwise headings. Everything else in it is passed over, its time too: that is of another clock, so
//! a pose counts from when its line arrived. A thread reads; the latest pose wins.

use std::io::{self, BufRead as _, BufReader};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use canopen::Micros;
use kinematics::Pose;
use serde::Deserialize;

/// How long connecting and the first pose may take.
const PATIENCE: Duration = Duration::from_secs(3);

#[derive(Deserialize)]
struct Flat {
    x: f32,
    y: f32,
    heading: f32,
}

#[derive(Deserialize)]
struct Grouped {
    group: Flat,
}

/// The pose on a line.
#[must_use]
pub fn parse(line: &str) -> Option<Pose> {
    // serde would take a list for the fields in their order.
    if !line.trim_start().starts_with('{') {
        return None;
    }
    let flat = serde_json::from_str::<Grouped>(line)
        .map(|line| line.group)
        .or_else(|_| serde_json::from_str::<Flat>(line))
        .ok()?;
    let finite = flat.x.is_finite() && flat.y.is_finite() && flat.heading.is_finite();
    finite.then(|| Pose::new(flat.x, flat.y, flat.heading))
}

/// The latest pose, and when it arrived.
type Latest = Arc<Mutex<Option<(Instant, Pose)>>>;

/// A connection to a program that sends poses.
pub struct PoseStream {
    latest: Latest,
}

impl PoseStream {
    /// Connects and waits for the first pose.
    ///
    /// # Errors
    /// When there is no connection, or what comes first is no pose.
    pub fn connect(address: &str) -> io::Result<Self> {
        let address = address
            .to_socket_addrs()?
            .next()
            .ok_or_else(|| io::Error::other("the host has no address"))?;
        let stream = TcpStream::connect_timeout(&address, PATIENCE)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        let mut lines = BufReader::new(stream.try_clone()?).lines();
        let first = lines
            .next()
            .ok_or_else(|| io::Error::other("the server hung up before the first pose"))??;
        let pose = parse(&first)
            .ok_or_else(|| io::Error::other(format!("the first line is no pose: {first}")))?;
        stream.set_read_timeout(None)?;
        let latest: Latest = Arc::new(Mutex::new(Some((Instant::now(), pose))));
        let newest = Arc::clone(&latest);
        std::thread::spawn(move || {
            for line in lines {
                // Whoever reads sees how old the latest is; nobody is left once the stream is dropped.
                let Ok(line) = line else { return };
                if Arc::strong_count(&newest) == 1 {
                    return;
                }
                if let Some(pose) = parse(&line) {
                    let now = Some((Instant::now(), pose));
                    *newest.lock().unwrap_or_else(PoisonError::into_inner) = now;
                }
            }
        });
        Ok(Self { latest })
    }

    /// The latest pose and when it arrived, on a clock that now shows `now`.
    #[must_use]
    pub fn latest(&self, now: Micros) -> Option<(Micros, Pose)> {
        let (at, pose) = (*self.latest.lock().unwrap_or_else(PoisonError::into_inner))?;
        let age = u64::try_from(at.elapsed().as_micros()).unwrap_or(u64::MAX);
        Some((Micros(now.0.saturating_sub(age)), pose))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    #[test]
    fn both_spellings_are_poses_and_nothing_else_is() {
        let pose = Pose::new(0.5, -1.0, 2.0);
        let grouped = r#"{"t":1.25,"group":{"x":0.5,"y":-1.0,"heading":2.0},"robots":[]}"#;
        assert_eq!(parse(grouped), Some(pose));
        assert_eq!(parse(r#"{"x":0.5,"y":-1,"heading":2}"#), Some(pose));
        for line in [
            "",
            "{}",
            "[1,2,3]",
            r#"{"x":1,"y":2}"#,
            r#"{"x":1e99,"y":0,"heading":0}"#,
        ] {
            assert_eq!(parse(line), None, "{line}");
        }
    }

    #[test]
    fn the_first_line_decides_whether_the_server_is_right() {
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        let served = std::thread::spawn(move || {
            let (mut one, _) = server.accept().unwrap();
            one.write_all(b"hello\n").unwrap();
            let (mut two, _) = server.accept().unwrap();
            two.write_all(b"{\"x\":1,\"y\":2,\"heading\":0}\n").unwrap();
            (one, two)
        });
        let error = PoseStream::connect(&address).err().unwrap().to_string();
        assert!(error.contains("hello"), "{error}");
        let stream = PoseStream::connect(&address).unwrap();
        let (_, pose) = stream.latest(Micros(1_000_000)).unwrap();
        assert_eq!(pose, Pose::new(1.0, 2.0, 0.0));
        drop(served.join().unwrap());
    }
}
