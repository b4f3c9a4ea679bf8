//! True poses as lines of JSON over TCP, as a motion-capture system streams what its cameras see.
//!
//! One line a sample, at whole multiples of the period of virtual time:
//!
//! ```json
//! {"t":1.25,"group":{"x":0.1,"y":0,"heading":0},"robots":[{"node":2,"x":1.3,"y":0,"heading":0}]}
//! ```
//!
//! `t` in seconds of virtual time; positions in metres and headings in radians, unwrapped, in the
//! world frame (x forward, y left, counter-clockwise positive). `group` is the group frame: of the
//! body when the robots are connected, of the formation that fits them best when they are not.
//! `robots` in the order of the group file. Poses have the noise that the group file's
//! `[simulation.pose_noise]` gives them; by default none.
//!
//! A client that does not read loses samples ([`WAITING`](super::json_lines::WAITING)); `t` shows
//! the gap.

use std::io;

use kinematics::Pose;
use serde::Serialize;

use super::json_lines::{JsonLines, line};
use super::{Endpoint, Listener};
use crate::truth::TruthSample;
use crate::world::World;

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

fn sample_line(sample: &TruthSample) -> String {
    line(&Line {
        t: sample.time_ns as f64 / 1e9,
        group: sample.group.into(),
        robots: sample
            .robots
            .iter()
            .map(|robot| Member {
                node: robot.node,
                place: robot.pose.into(),
            })
            .collect(),
    })
}

/// A listening endpoint and its clients.
#[derive(Debug)]
pub struct PoseServer(JsonLines);

impl PoseServer {
    /// Listens; port 0 picks a free one. It takes the world's truth samples, so the world must keep
    /// some (`Options::truth_period_ns`) and nothing else may take them.
    ///
    /// # Errors
    /// When the address cannot be had.
    pub fn bind(address: &str) -> io::Result<Self> {
        JsonLines::bind(address).map(Self)
    }
}

impl Endpoint for PoseServer {
    fn announce(&self) -> String {
        format!("pose-tcp {}", self.0.address())
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        let samples = world.take_observed();
        self.0.send(samples.iter().map(sample_line), world.now());
        Ok(())
    }

    fn listener(&self) -> Option<&Listener> {
        Some(self.0.listener())
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
                currents: [0.0; 4],
                supply: 24.0,
                brake_holds: false,
                brake_released: false,
            }],
        };
        assert_eq!(
            sample_line(&sample),
            "{\"t\":1.25,\"group\":{\"x\":0.5,\"y\":-0.25,\"heading\":6.5},\
             \"robots\":[{\"node\":2,\"x\":1.5,\"y\":0.0,\"heading\":0.125}]}\n"
        );
    }
}
