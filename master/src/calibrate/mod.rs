//! Working out what a robot has to be told about itself, from motions and a source of poses.

pub mod drive;
pub mod phase;
