//! The samples of the robots' gyros as lines of JSON over TCP, as a bridge to real ones would
//! stream them.
//!
//! One line a sample, as often as the group file's `[simulation.gyro]` says:
//!
//! ```json
//! {"t":1.254,"robots":[{"node":2,"yaw_rate":0.031},{"node":3,"yaw_rate":-0.007}]}
//! ```
//!
//! `t` is when the sample came, in seconds of virtual time; `yaw_rate` in rad/s about the axis that
//! points up, counter-clockwise positive, with the noise, bias, drift and delay of the file.
//! `robots` in the order of the file. The gyros run from the first exchange on, even without
//! clients.

use std::io;

use serde::Serialize;

use super::json_lines::{JsonLines, line};
use super::{Endpoint, Listener};
use crate::gyro::GyroSample;
use crate::world::World;

#[derive(Serialize)]
struct Line {
    t: f64,
    robots: Vec<Member>,
}

#[derive(Serialize)]
struct Member {
    node: u8,
    yaw_rate: f64,
}

fn sample_line(sample: &GyroSample, nodes: &[u8]) -> String {
    line(&Line {
        t: sample.time_ns as f64 / 1e9,
        robots: nodes
            .iter()
            .zip(&sample.rates)
            .map(|(node, yaw_rate)| Member {
                node: *node,
                yaw_rate: *yaw_rate,
            })
            .collect(),
    })
}

/// A listening endpoint and its clients.
#[derive(Debug)]
pub struct GyroServer {
    lines: JsonLines,
    nodes: Vec<u8>,
}

impl GyroServer {
    /// Listens; port 0 picks a free one. `nodes` are the robots', in the order of the group file.
    /// It takes the world's gyro samples, so nothing else may take them.
    ///
    /// # Errors
    /// When the address cannot be had.
    pub fn bind(address: &str, nodes: Vec<u8>) -> io::Result<Self> {
        Ok(Self {
            lines: JsonLines::bind(address)?,
            nodes,
        })
    }
}

impl Endpoint for GyroServer {
    fn announce(&self) -> String {
        format!("gyro-tcp {}", self.lines.address())
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        let samples = world.take_gyros();
        self.lines.send(
            samples.iter().map(|one| sample_line(one, &self.nodes)),
            world.now(),
        );
        Ok(())
    }

    fn listener(&self) -> Option<&Listener> {
        Some(self.lines.listener())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_what_the_documentation_says() {
        let sample = GyroSample {
            time_ns: 1_254_000_000,
            rates: vec![0.031, -0.007],
        };
        assert_eq!(
            sample_line(&sample, &[2, 3]),
            "{\"t\":1.254,\"robots\":[{\"node\":2,\"yaw_rate\":0.031},{\"node\":3,\"yaw_rate\":-0.007}]}\n"
        );
    }
}
