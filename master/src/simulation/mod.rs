//! A simulated world in this process: [`link`] makes a bus of it, [`run`] drives in it and measures
//! what happened, [`contact`] prepares groups for its contact plant, [`hand`] lays hands on its
//! robots. All of it needs the cargo feature `simulation`.

use std::path::Path;

use group::{GroupError, GroupFile, Plant};
use kinematics::Pose;
use sim::{Backend, Options, World};

use crate::run::DriveError;
use link::SimLink;

pub mod contact;
pub mod hand;
pub mod link;
pub mod run;

/// Why no simulated world takes a group of this file, though robots would: a load that tips it,
/// for example. A plant in another program is not asked.
#[must_use]
pub fn refusal(group: &GroupFile, file: &Path) -> Option<GroupError> {
    if matches!(group.simulation.plant, Plant::External { .. }) {
        return None;
    }
    let error = World::new(group, Backend::Native, Options::default()).err()?;
    Some(GroupError {
        file: file.display().to_string(),
        line: None,
        field: String::new(),
        problem: error.to_string(),
        remedy: "a simulated bus refuses the group for this".into(),
    })
}

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
