//! A simulated world in this process: [`link`] makes a bus of it, [`run`] drives in it and measures
//! what happened, [`contact`] prepares groups for its contact plant, [`hand`] lays hands on its
//! robots. All of it needs the cargo feature `simulation`.

use std::path::Path;

use group::GroupFile;
use kinematics::Pose;

use crate::run::DriveError;
use link::SimLink;

pub mod contact;
pub mod hand;
pub mod link;
pub mod run;

/// A bus with freshly booted robots of `group`, which stands at the origin: native ones, or
/// emulated ones that run the image at `elf`, or of the images in that folder the one for their
/// board and drives. `name` is what errors call the bus.
///
/// # Errors
/// When the image cannot be loaded or the world cannot be built.
pub fn open(
    group: &GroupFile,
    elf: Option<&Path>,
    name: impl Into<String>,
) -> Result<SimLink, DriveError> {
    let origin = Pose::new(0.0, 0.0, 0.0);
    // Samples of the truth would not be read, and would accumulate.
    Ok(SimLink::new(run::build(group, elf, origin, 0)?, name))
}
