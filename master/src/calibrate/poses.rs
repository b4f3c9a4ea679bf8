//! Poses from outside, as JSON lines over TCP: a motion-capture system, or the simulator's `--pose-tcp`.
//!
//! ```json
//! {"t":1.25,"group":{"x":0.1,"y":0,"heading":0},"robots":[{"node":2,"x":1.3,"y":0,"heading":0}]}
//! {"t":1.25,"x":1.3,"y":0,"heading":0}
//! ```
//!
//! The second form is of one robot alone. A thread reads; the latest line wins. Lines that are no poses are refused by
//! name when the next pose is asked for.

use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::Deserialize;

use crate::error::MasterError;

/// How long the first line may take.
const PATIENCE: Duration = Duration::from_secs(3);

#[derive(Clone, Deserialize)]
struct Line {
    #[serde(default)]
    robots: Vec<Place>,
    x: Option<f64>,
    y: Option<f64>,
    heading: Option<f64>,
}

#[derive(Clone, Deserialize)]
struct Place {
    node: u8,
    x: f64,
    y: f64,
    heading: f64,
}

/// A connected source.
pub struct Source {
    address: String,
    latest: Arc<Mutex<Option<Result<Line, String>>>>,
}

impl Source {
    /// Connects to `tcp://HOST:PORT`.
    ///
    /// # Errors
    /// When the address is none, or nobody answers.
    pub fn connect(address: &str) -> Result<Self, MasterError> {
        let bad = |problem: String| MasterError::PoseSource {
            address: address.to_owned(),
            problem,
        };
        let host = address
            .strip_prefix("tcp://")
            .ok_or_else(|| bad("is not tcp://HOST:PORT".into()))?;
        let stream = TcpStream::connect(host).map_err(|error| bad(error.to_string()))?;
        let latest = Arc::new(Mutex::new(None));
        let shared = Arc::clone(&latest);
        std::thread::spawn(move || {
            for line in BufReader::new(stream).lines() {
                let parsed = line.map_err(|error| error.to_string()).and_then(|text| {
                    serde_json::from_str(&text).map_err(|error| format!("{error}: {text}"))
                });
                *shared.lock().unwrap_or_else(PoisonError::into_inner) = Some(parsed);
            }
            *shared.lock().unwrap_or_else(PoisonError::into_inner) =
                Some(Err("the source has gone".into()));
        });
        Ok(Self {
            address: address.to_owned(),
            latest,
        })
    }

    /// The latest poses of these robots: m, m, rad.
    ///
    /// # Errors
    /// When nothing comes, the source has gone, sends something else, or leaves a robot out.
    pub fn latest(&self, nodes: &[u8]) -> Result<Vec<[f64; 3]>, MasterError> {
        let bad = |problem: String| MasterError::PoseSource {
            address: self.address.clone(),
            problem,
        };
        let began = Instant::now();
        let line = loop {
            let latest = self
                .latest
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .clone();
            match latest {
                Some(line) => break line.map_err(bad)?,
                None if began.elapsed() > PATIENCE => return Err(bad("sends nothing".into())),
                None => std::thread::sleep(Duration::from_millis(5)),
            }
        };
        nodes
            .iter()
            .map(|node| {
                if let Some(robot) = line.robots.iter().find(|robot| robot.node == *node) {
                    return Ok([robot.x, robot.y, robot.heading]);
                }
                match (line.x, line.y, line.heading) {
                    (Some(x), Some(y), Some(heading)) if nodes.len() == 1 => Ok([x, y, heading]),
                    _ => Err(bad(format!("has no pose of node {node}"))),
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    fn served(text: &'static str) -> Source {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("tcp://{}", listener.local_addr().unwrap());
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream.write_all(text.as_bytes()).unwrap();
            // Stays open until the reader has gone.
            let _ = std::io::Read::read(&mut stream, &mut [0]);
        });
        Source::connect(&address).unwrap()
    }

    #[test]
    fn reads_both_forms() {
        let both = served(
            "{\"t\":1,\"group\":{\"x\":0,\"y\":0,\"heading\":0},\"robots\":[{\"node\":3,\"x\":1.5,\"y\":-1,\"heading\":0.5}]}\n",
        );
        assert_eq!(both.latest(&[3]).unwrap(), [[1.5, -1.0, 0.5]]);
        let missing = both.latest(&[2]).unwrap_err().to_string();
        assert!(missing.contains("no pose of node 2"), "{missing}");
        let one = served("{\"t\":1,\"x\":2,\"y\":3,\"heading\":-4}\n");
        assert_eq!(one.latest(&[2]).unwrap(), [[2.0, 3.0, -4.0]]);
    }

    #[test]
    fn refuses_what_is_no_pose() {
        let error = served("hello\n").latest(&[2]).unwrap_err().to_string();
        assert!(error.contains("hello"), "{error}");
        assert!(Source::connect("udp://1").is_err());
    }
}
