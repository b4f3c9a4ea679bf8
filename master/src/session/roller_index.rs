//! Lets a group find the angles of its wheels: ahead and back by a little more than a turn, so that
//! every encoder's index comes by.
//!
//! A command that follows a curve is not expected to make this motion, so it is slow, and its
//! caller learns beforehand how much room it needs ([`IndexSearch`]). The group ends where it
//! began, as far as its wheels know.

use kinematics::WheelRates;
use protocol::{Kind, Value, address};

use crate::bus::link::Link;
use crate::error::MasterError;
use crate::path::curve::Plan;
use crate::session::Group;

/// State of a wheel that computes with the angle of its rollers (object 0x2114).
pub const KNOWN: u8 = 2;

/// How much further than one turn.
const MARGIN: f64 = 1.08;
/// Slow enough to step aside, m/s.
const SPEED: f64 = 0.2;

/// Wheels as people name them, in the order of the objects.
const WHEELS: [&str; 4] = ["front left", "front right", "rear left", "rear right"];

/// The motion that brings every index by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndexSearch {
    /// How far the group goes ahead, and back, m.
    pub distance: f64,
    /// How fast at most, m/s.
    pub speed: f64,
    /// How long it takes, s.
    pub seconds: f64,
}

impl std::fmt::Display for IndexSearch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            distance,
            speed,
            seconds,
        } = self;
        write!(
            f,
            "Index search first: the group drives {distance:.2} m ahead and back, {speed:.2} m/s at \
             most, in {seconds:.0} s; keep {distance:.2} m free in front of it."
        )
    }
}

/// Is told of an index search before anything moves.
pub type Announce<'a> = &'a mut dyn FnMut(&IndexSearch);

impl<L: Link> Group<L> {
    /// Starts the group, drives it ahead and back, and checks that every wheel of a robot with
    /// rollers has seen its index. The group stands afterwards and is in PRE-OPERATIONAL. Does
    /// nothing, and announces nothing, when all have already.
    ///
    /// # Errors
    /// [`MasterError::NoIndex`] naming the first wheel that has not, and whatever driving fails
    /// with.
    pub fn find_rollers(&mut self, announce: Announce<'_>) -> Result<(), MasterError> {
        if self.unreferenced_wheel()?.is_none() {
            return Ok(());
        }
        let radii = self
            .config()
            .robots
            .iter()
            .map(|r| r.geometry.wheel_radius());
        let radius = radii.fold(0.0, f32::max);
        let distance = MARGIN * std::f64::consts::TAU * f64::from(radius);
        let plan = Plan::there_and_back(distance, SPEED, &self.config().limits);
        announce(&IndexSearch {
            distance,
            speed: plan.fastest(),
            seconds: plan.duration(),
        });
        self.start()?;
        self.follow(&plan, &mut |_, _| {})?;
        match self.unreferenced_wheel()? {
            None => Ok(()),
            Some((node, wheel, state)) => Err(MasterError::NoIndex {
                node,
                wheel: WHEELS[usize::from(wheel)],
                state,
            }),
        }
    }

    /// The first wheel of a robot with rollers that does not know its angle, and its state.
    ///
    /// # Errors
    /// When a robot does not answer.
    pub fn unreferenced_wheel(&mut self) -> Result<Option<(u8, u8, u8)>, MasterError> {
        let robots: Vec<u8> = self
            .config()
            .robots
            .iter()
            .filter(|robot| robot.rollers.is_some())
            .map(|robot| robot.node)
            .collect();
        for node in robots {
            for wheel in 0..4 {
                let state = self
                    .wire()
                    .read(node, address::rollers::state(wheel), Kind::U8)?;
                if state != Value::U8(KNOWN) {
                    return Ok(Some((node, wheel, state.to_bits().to_le_bytes()[0])));
                }
            }
        }
        Ok(None)
    }

    /// Roller angles of a robot's wheels now, rad.
    ///
    /// # Errors
    /// When the robot does not answer.
    pub fn roller_angles(&mut self, node: u8) -> Result<WheelRates, MasterError> {
        let mut angles = [0.0; 4];
        for (wheel, angle) in (0..).zip(&mut angles) {
            let value = self
                .wire()
                .read(node, address::rollers::sweep(wheel), Kind::F32)?;
            if let Value::F32(value) = value {
                *angle = value;
            }
        }
        Ok(WheelRates::from(angles))
    }
}
