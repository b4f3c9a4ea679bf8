//! Hands: what a person does to a robot on request, or a simulator in the person's place.

use canopen::Micros;

use crate::bus::link::Link;
use crate::error::MasterError;
use crate::session::Group;

/// Something to be done to a robot, and to be undone afterwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Task {
    /// Pulls the plug of a wheel's encoder.
    UnplugEncoder {
        /// Node of the robot.
        node: u8,
        /// The wheel, 0 front left.
        wheel: usize,
    },
    /// Pulls the CAN connector.
    UnplugBus {
        /// Node of the robot.
        node: u8,
    },
    /// Presses the emergency stop.
    PressStop {
        /// Node of the robot.
        node: u8,
    },
    /// Pulls the fault line of the motor drivers to ground.
    DriverFault {
        /// Node of the robot.
        node: u8,
    },
    /// Opens the contact of the protective stop.
    OpenProtectiveStop {
        /// Node of the robot.
        node: u8,
    },
    /// Lowers the supply below the minimum of object 0x2025:2.
    LowerSupply {
        /// Node of the robot.
        node: u8,
        /// This minimum, V.
        minimum_v: f32,
    },
    /// Raises the supply above object 0x2025:3, which is little more than nominal meanwhile.
    RaiseSupply {
        /// Node of the robot.
        node: u8,
        /// This maximum, V.
        maximum_v: f32,
    },
}

impl Task {
    /// The robot that it is done to.
    #[must_use]
    pub const fn node(self) -> u8 {
        match self {
            Self::UnplugEncoder { node, .. }
            | Self::UnplugBus { node }
            | Self::PressStop { node }
            | Self::DriverFault { node }
            | Self::OpenProtectiveStop { node }
            | Self::LowerSupply { node, .. }
            | Self::RaiseSupply { node, .. } => node,
        }
    }

    /// What a person is asked to do.
    #[must_use]
    pub fn request(self) -> String {
        match self {
            Self::UnplugEncoder { node, wheel } => {
                let wheel = crate::commission::motors::WHEELS.get(wheel);
                let wheel = wheel.copied().unwrap_or("first");
                format!("pull the plug of the {wheel} wheel's encoder of node {node}")
            }
            Self::UnplugBus { node } => format!("pull the CAN connector of node {node}"),
            Self::PressStop { node } => format!("press the emergency stop of node {node}"),
            Self::DriverFault { node } => format!(
                "connect the motor drivers' fault line of node {node} with ground \
                 (docs/bring-up.md, Wiring)"
            ),
            Self::OpenProtectiveStop { node } => {
                format!("open the protective stop of node {node}")
            }
            Self::LowerSupply { node, minimum_v } => format!(
                "turn the motors' supply of node {node} down, below {minimum_v} V (object 0x2025:2)"
            ),
            Self::RaiseSupply { node, maximum_v } => format!(
                "turn the motors' supply of node {node} up, just above {maximum_v:.1} V and no \
                 farther (object 0x2025:3, changed for this)"
            ),
        }
    }

    /// How it is undone.
    #[must_use]
    pub const fn undoing(self) -> &'static str {
        match self {
            Self::UnplugEncoder { .. } | Self::UnplugBus { .. } => "put the plug in again",
            Self::PressStop { .. } => "release the emergency stop",
            Self::DriverFault { .. } => "take the wire off again",
            Self::OpenProtectiveStop { .. } => "close the protective stop",
            Self::LowerSupply { .. } => "turn the supply up again",
            Self::RaiseSupply { .. } => "turn the supply down again",
        }
    }
}

/// Whether a task can begin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Prepared {
    /// It can.
    Ready,
    /// It is left out, for this reason.
    Skip(String),
}

/// A person, or a simulator in the person's place.
pub trait Hand<L: Link> {
    /// Gets ready, while the group stands.
    ///
    /// # Errors
    /// When the link fails, or the whole is to be stopped.
    fn prepare(&mut self, group: &mut Group<L>, task: Task) -> Result<Prepared, MasterError>;

    /// Does it, or asks for it, while the group drives; returns when it was done, where that is
    /// known. It must not wait.
    fn act(&mut self, group: &mut Group<L>, task: Task) -> Option<Micros>;

    /// Undoes it, while the group stands.
    ///
    /// # Errors
    /// When the link fails, or the whole is to be stopped.
    fn undo(&mut self, group: &mut Group<L>, task: Task) -> Result<(), MasterError>;

    /// How long it may take from [`Hand::act`] to the deed, µs.
    fn patience_us(&self) -> u64;
}
