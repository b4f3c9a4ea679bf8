//! True poses as lines of JSON over TCP, as a motion-capture system streams what its cameras see.
//!
//! One line a sample, at whole multiples of the period of virtual time:
//!
//! ```json
//! {"t":1.25,"group":{"x":0.1,"y":0,"heading":0},"robots":[{"node":2,"x":1.3,"y":0,"heading":0}]}
//! ```
//!
//! `t` in seconds of virtual time; positions in metres and headings in radians, unwrapped, in the world
//! frame (x forward, y left, counter-clockwise positive). `group` is the group frame: of the body when the
//! robots are connected, of the formation that fits them best when they are not. `robots` in the order of
//! the group file. Poses have the noise that the group file's `[simulation.pose_noise]` gives them; by
//! default none. Any number of clients; what they send is ignored.
//!
//! A client gets every sample from its connection on. One that does not read loses samples once
//! [`WAITING`] bytes wait for it, whole lines only; `t` shows the gap.

use std::io;
use std::net::{SocketAddr, TcpStream};

use kinematics::Pose;
use serde::Serialize;

use super::Endpoint;
use super::stream::{Listener, Pipe};
use crate::truth::TruthSample;
use crate::world::World;

/// Bytes that may wait for a client: some seconds of a large group.
pub const WAITING: usize = 256 * 1024;

#[derive(Serialize)]
struct Line {
    t: f64,
    group: Place,
    robots: Vec<Member>,
}

#[derive(Serialize)]
struct Place {
    x: f64,
    y: f64,
    heading: f64,
}

#[derive(Serialize)]
struct Member {
    node: u8,
    #[serde(flatten)]
    place: Place,
}

impl From<Pose<f64>> for Place {
    fn from(pose: Pose<f64>) -> Self {
        Self {
            x: pose.x,
            y: pose.y,
            heading: pose.heading,
        }
    }
}

/// The line of a sample, with its end.
fn line(sample: &TruthSample) -> String {
    let line = Line {
        t: sample.time_ns as f64 * 1e-9,
        group: sample.group.into(),
        robots: sample
            .robots
            .iter()
            .map(|robot| Member {
                node: robot.node,
                place: robot.pose.into(),
            })
            .collect(),
    };
    // Numbers and fixed names: a line cannot fail. A pose that is not finite would be `null`.
    let mut text = serde_json::to_string(&line).unwrap_or_default();
    text.push('\n');
    text
}

/// A listening endpoint and its clients.
#[derive(Debug)]
pub struct PoseServer {
    listener: Listener,
    address: SocketAddr,
    clients: Vec<Pipe<TcpStream>>,
}

impl PoseServer {
    /// Listens; port 0 picks a free one. It takes the world's truth samples, so the world must keep some
    /// (`Options::truth_period_ns`) and nobody else may take them.
    ///
    /// # Errors
    /// When the address cannot be had.
    pub fn bind(address: &str) -> io::Result<Self> {
        let listener = Listener::bind(address)?;
        Ok(Self {
            address: listener.address()?,
            listener,
            clients: Vec::new(),
        })
    }
}

impl Endpoint for PoseServer {
    fn announce(&self) -> String {
        format!("pose-tcp {}", self.address)
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        while let Some(pipe) = self.listener.accept() {
            self.clients.push(pipe);
        }
        let samples = world.take_seen();
        if self.clients.is_empty() {
            return Ok(());
        }
        let lines: Vec<String> = samples.iter().map(line).collect();
        self.clients.retain_mut(|pipe| {
            let came = pipe.fill();
            pipe.input.clear();
            for line in &lines {
                if pipe.output.len() + line.len() <= WAITING {
                    pipe.output.extend_from_slice(line.as_bytes());
                }
            }
            came.and_then(|()| pipe.flush()).is_ok()
        });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::RobotTruth;
    use kinematics::WheelRates;

    #[test]
    fn a_line_is_what_the_documentation_says() {
        let pose = |x, y, heading| Pose { x, y, heading };
        let sample = TruthSample {
            time_ns: 1_250_000_000,
            group: pose(0.5, -0.25, 6.5),
            shape_error_mm: 0.0,
            bus_load: 0.0,
            robots: vec![RobotTruth {
                node: 2,
                pose: pose(1.5, 0.0, 0.125),
                wheel_angles: [0.0; 4],
                wheel_rates: WheelRates::from([0.0; 4]),
                duties: [0.0; 4],
                drivers_enabled: false,
                brake_released: false,
            }],
        };
        assert_eq!(
            line(&sample),
            "{\"t\":1.25,\"group\":{\"x\":0.5,\"y\":-0.25,\"heading\":6.5},\
             \"robots\":[{\"node\":2,\"x\":1.5,\"y\":0.0,\"heading\":0.125}]}\n"
        );
    }
}
