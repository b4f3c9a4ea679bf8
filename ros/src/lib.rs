//! A group of robots as one holonomic robot to ROS 2.
//!
//! | module | what is in it |
//! |---|---|
//! | [`message`] | the messages that are used, with their definitions and their CDR encoding |
//! | [`names`] | names of namespace, frames and joints |
//! | [`urdf`], [`nav2`], [`localization`] | files made from a group file: the robot's model, parameters of Nav2 and of `robot_localization` |
//! | `node` | the node on DDS; the cargo feature of that name |
//!
//! The program that drives the group (`omnibus ros`) converts between these messages and the group.
//! Nothing here decides whether the group moves.

pub mod localization;
pub mod message;
pub mod names;
pub mod nav2;
#[cfg(feature = "node")]
pub mod node;
pub mod urdf;
