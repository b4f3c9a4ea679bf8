//! The external plant: another simulator over TCP, in lockstep, one JSON object per line.
//!
//! # Messages
//!
//! This side connects. Its first line describes the robots, in the order of the group file:
//!
//! ```json
//! {"omnibus_plant": 1, "robots": [{"x": 1.2, "y": 0.0, "heading": 0.0, "half_track": 0.37,
//!   "half_wheelbase": 0.35, "wheel_radius": 0.1524, "roller_angle": 0.785,
//!   "rigid_group": 0}, ...]}
//! ```
//!
//! Poses are where the robots stand in the world at the beginning; robots with the same
//! `rigid_group` are bolted together. The plant does not answer this line. Then, for every step
//! from `t` to `t + dt`,
//!
//! ```json
//! {"t": 0.0, "dt": 0.001, "wheel_rate": [[fl, fr, rl, rr], ...]}
//! ```
//!
//! with the mean rates to which the motors turned the wheels (rad/s), and the plant answers
//!
//! ```json
//! {"wheel_angle": [[fl, fr, rl, rr], ...], "pose": [[x, y, heading], ...]}
//! ```
//!
//! in rad and m, world frame, unwrapped heading. The encoders follow `wheel_angle`, so a plant may
//! turn wheels itself (a push on a coasting robot); one that only moves bodies integrates the
//! rates.
//!
//! # A plant with forces
//!
//! A plant that computes forces adds two fields to every answer:
//!
//! ```json
//! {"wheel_angle": .., "pose": .., "wheel_inertia": 0.02, "floor_torque": [[fl, fr, rl, rr], ...]}
//! ```
//!
//! `wheel_inertia` is what turns with each wheel, kg m², without the robot's mass, and
//! `floor_torque` what the floor did to the wheels in this step, N·m, positive rolls the base
//! forward. From then on the motors turn the wheels against it, so mass, load and slopes matter,
//! and every step also has `wheel_torque`, what the motors did to the wheels, in the form of
//! `wheel_rate`.
//!
//! # Errors
//!
//! A plant that cannot continue answers `{"error": "why"}`, and the reason is shown. It has
//! [`PATIENCE`] for every answer. If it closes the connection, answers late or answers something
//! else, the world stops with an error that says which of these happened.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use group::GroupFile;
use kinematics::Pose;
use serde::{Deserialize, Serialize};

use super::Plant;
use super::formation::Formation;
use super::table::members;
use crate::error::SimError;

/// How long an answer may take.
pub const PATIENCE: Duration = Duration::from_secs(30);
/// Version of the protocol, the value of `omnibus_plant`.
pub const VERSION: u32 = 1;

#[derive(Serialize)]
struct Hello {
    omnibus_plant: u32,
    robots: Vec<HelloRobot>,
}

#[derive(Serialize)]
struct HelloRobot {
    x: f64,
    y: f64,
    heading: f64,
    half_track: f64,
    half_wheelbase: f64,
    wheel_radius: f64,
    roller_angle: f64,
    rigid_group: usize,
}

#[derive(Serialize)]
struct Step<'a> {
    t: f64,
    dt: f64,
    wheel_rate: &'a [[f64; 4]],
    #[serde(skip_serializing_if = "Option::is_none")]
    wheel_torque: Option<&'a [[f64; 4]]>,
}

#[derive(Deserialize)]
struct Answer {
    wheel_angle: Vec<[f64; 4]>,
    pose: Vec<[f64; 3]>,
    wheel_inertia: Option<f64>,
    floor_torque: Option<Vec<[f64; 4]>>,
}

/// What a plant says that cannot go on.
#[derive(Deserialize)]
struct Refusal {
    error: String,
}

/// See the [module](self).
#[derive(Debug)]
pub struct ExternalPlant {
    address: String,
    send: TcpStream,
    receive: BufReader<TcpStream>,
    formation: Formation,
    group: Pose<f64>,
    poses: Vec<Pose<f64>>,
    angles: Vec<[f64; 4]>,
    rates: Vec<[f64; 4]>,
    /// What turns with a wheel, from a plant with forces.
    inertia: Option<f64>,
    floor: Vec<[f64; 4]>,
    driven: Vec<[f64; 4]>,
    steps: u64,
    time_s: f64,
}

impl ExternalPlant {
    /// Connects to `host:port` and introduces the robots, the group frame at `start`.
    ///
    /// # Errors
    /// When no program listens there, a robot's geometry has no solution, or its wheels differ.
    pub fn connect(group: &GroupFile, address: &str, start: Pose<f64>) -> Result<Self, SimError> {
        if let Some(robot) = group.robots.iter().find(|robot| robot.wheels.is_some()) {
            return Err(SimError::Plant {
                problem: format!(
                    "robot.wheels of node {}: a plant outside is told of four equal wheels only; \
                     leave it out, or take a plant of tables or rollers",
                    robot.node
                ),
            });
        }
        let formation = Formation::new(&members(group)?);
        let poses: Vec<_> = formation.places(start).collect();
        let usual = group.robots.iter().map(|robot| &robot.geometry);
        let robots = usual.zip(&poses).enumerate();
        let robots = robots.map(|(n, (wheels, pose))| HelloRobot {
            x: pose.x,
            y: pose.y,
            heading: pose.heading,
            half_track: wheels.half_track().into(),
            half_wheelbase: wheels.half_wheelbase().into(),
            wheel_radius: wheels.wheel_radius().into(),
            roller_angle: wheels.roller_angle().into(),
            rigid_group: if group.simulation.rigid { 0 } else { n },
        });
        let hello = Hello {
            omnibus_plant: VERSION,
            robots: robots.collect(),
        };
        let fail = |problem: String| SimError::Plant {
            problem: format!("{address}: {problem}; start the other simulator there first"),
        };
        let stream = address
            .to_socket_addrs()
            .and_then(|mut all| {
                all.next()
                    .ok_or_else(|| std::io::ErrorKind::NotFound.into())
            })
            .and_then(|socket| TcpStream::connect_timeout(&socket, PATIENCE))
            .map_err(|error| fail(format!("no program answers there ({error})")))?;
        let set_up = |stream: &TcpStream| {
            stream.set_nodelay(true)?;
            stream.set_read_timeout(Some(PATIENCE))?;
            stream.try_clone()
        };
        let reader = set_up(&stream).map_err(|error| fail(error.to_string()))?;
        let mut plant = Self {
            address: address.to_owned(),
            send: stream,
            receive: BufReader::new(reader),
            formation,
            group: start,
            angles: vec![[0.0; 4]; poses.len()],
            rates: vec![[0.0; 4]; poses.len()],
            inertia: None,
            floor: vec![[0.0; 4]; poses.len()],
            driven: vec![[0.0; 4]; poses.len()],
            poses,
            steps: 0,
            time_s: 0.0,
        };
        plant.send(&hello)?;
        Ok(plant)
    }

    fn send(&mut self, line: &impl Serialize) -> Result<(), SimError> {
        let mut text = serde_json::to_vec(line).map_err(|error| self.fail(&error.to_string()))?;
        text.push(b'\n');
        self.send
            .write_all(&text)
            .map_err(|error| self.fail(&format!("gone ({error})")))
    }

    fn receive(&mut self) -> Result<Answer, SimError> {
        let mut line = String::new();
        match self.receive.read_line(&mut line) {
            Ok(0) => return Err(self.fail("closed the connection")),
            Ok(_) => {}
            Err(error) => return Err(self.fail(&format!("no answer ({error})"))),
        }
        if let Ok(Refusal { error }) = serde_json::from_str(&line) {
            return Err(self.fail(&format!("it says: {error}")));
        }
        let answer: Answer = serde_json::from_str(&line)
            .map_err(|error| self.fail(&format!("answer not understood: {error}")))?;
        let robots = self.poses.len();
        if answer.pose.len() != robots || answer.wheel_angle.len() != robots {
            let problem = format!(
                "{} poses and {} rows of wheel angles for {robots} robots",
                answer.pose.len(),
                answer.wheel_angle.len()
            );
            return Err(self.fail(&problem));
        }
        let numbers = answer
            .pose
            .iter()
            .flatten()
            .chain(answer.wheel_angle.iter().flatten());
        if numbers.into_iter().any(|number| !number.is_finite()) {
            return Err(self.fail("an answer that is not a finite number"));
        }
        self.check_forces(&answer)?;
        Ok(answer)
    }

    /// Inertia and torques come together, one row a robot.
    fn check_forces(&self, answer: &Answer) -> Result<(), SimError> {
        let (inertia, floor) = match (answer.wheel_inertia, &answer.floor_torque) {
            (None, None) if self.inertia.is_none() => return Ok(()),
            (Some(inertia), Some(floor)) => (inertia, floor),
            _ => return Err(self.fail("wheel_inertia and floor_torque belong together, always")),
        };
        if !(inertia.is_finite() && inertia > 0.0) {
            return Err(self.fail("wheel_inertia is not above 0"));
        }
        let finite = floor.iter().flatten().all(|torque| torque.is_finite());
        if floor.len() != self.poses.len() || !finite {
            let robots = self.poses.len();
            return Err(self.fail(&format!(
                "floor_torque does not have 4 numbers for each of {robots} robots"
            )));
        }
        Ok(())
    }

    fn fail(&self, problem: &str) -> SimError {
        SimError::Plant {
            problem: format!("{} after {} steps: {problem}", self.address, self.steps),
        }
    }
}

impl Plant for ExternalPlant {
    fn step(&mut self, dt: f64, turned: &[[f64; 4]]) -> Result<(), SimError> {
        let mut rates = std::mem::take(&mut self.rates);
        let driven = std::mem::take(&mut self.driven);
        for (rates, turned) in rates.iter_mut().zip(turned) {
            *rates = turned.map(|angle| angle / dt);
        }
        self.send(&Step {
            t: self.time_s,
            dt,
            wheel_rate: &rates,
            wheel_torque: self.inertia.map(|_| &driven[..]),
        })?;
        (self.rates, self.driven) = (rates, driven);
        let answer = self.receive()?;
        for (pose, [x, y, heading]) in self.poses.iter_mut().zip(answer.pose) {
            *pose = Pose::new(x, y, heading);
        }
        self.angles = answer.wheel_angle;
        self.inertia = answer.wheel_inertia;
        self.floor = answer.floor_torque.unwrap_or_default();
        self.group = self.formation.fit_poses(&self.poses);
        self.steps += 1;
        self.time_s += dt;
        Ok(())
    }

    fn poses(&self) -> &[Pose<f64>] {
        &self.poses
    }

    fn group(&self) -> Pose<f64> {
        self.group
    }

    fn shape_error_mm(&self) -> f64 {
        self.formation.shape_error_mm(self.group, &self.poses)
    }

    fn wheel_angles(&self, robot: usize) -> Option<[f64; 4]> {
        self.angles.get(robot).copied()
    }

    fn wheel_inertia(&self) -> Option<f64> {
        self.inertia
    }

    fn floor_torques(&self, robot: usize) -> [f64; 4] {
        self.floor.get(robot).copied().unwrap_or_default()
    }

    fn drive(&mut self, robot: usize, torques: [f64; 4]) {
        if let Some(driven) = self.driven.get_mut(robot) {
            *driven = torques;
        }
    }

    fn period_ns(&self) -> u64 {
        1_000_000
    }
}
