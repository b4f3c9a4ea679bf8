//! The errors that keep a simulation from starting or continuing.

use std::fmt;

/// An error of the simulated world. Its time has stopped; nothing moves any more.
#[derive(Debug, Clone, PartialEq)]
pub enum SimError {
    /// A robot of the group cannot be built.
    Robot {
        /// Its node.
        node: u8,
        /// Why.
        problem: String,
    },
    /// The emulated processor of a robot stopped: it touched something that is not modelled, or
    /// locked up.
    Stopped {
        /// The robot's node.
        node: u8,
        /// Virtual time, ns.
        time_ns: u64,
        /// Address, source line and reason, as the emulator says them.
        problem: String,
    },
    /// The plant cannot be built or has gone.
    Plant {
        /// Why, with the remedy.
        problem: String,
    },
}

impl SimError {
    pub(crate) fn geometry(node: u8, error: impl fmt::Debug) -> Self {
        Self::Robot {
            node,
            problem: format!("its geometry is not usable: {error:?}"),
        }
    }

    pub(crate) fn wheels(error: impl fmt::Debug) -> Self {
        Self::Plant {
            problem: format!("a robot's wheels have no kinematics: {error:?}"),
        }
    }
}

impl fmt::Display for SimError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Robot { node, problem } => write!(f, "robot with node {node}: {problem}"),
            Self::Stopped {
                node,
                time_ns,
                problem,
            } => {
                write!(
                    f,
                    "robot with node {node} stopped at {:.6} s: {problem}",
                    *time_ns as f64 * 1e-9
                )
            }
            Self::Plant { problem } => write!(f, "plant: {problem}"),
        }
    }
}

impl std::error::Error for SimError {}
