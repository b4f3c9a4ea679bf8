//! The same of a robot without a floating-point unit: the kit with an STM32F103, whose image drives
//! in the same group. Cycles are those of its 72 MHz.

use anyhow::Context as _;
use emulator::Firmware;
use group::{GroupFile, StageKind};

use super::figure::Figure;
use super::{image, running};
use crate::firmware::{self, Board};

/// A group with kits in place of its robots.
pub fn with_kits(mut group: GroupFile) -> GroupFile {
    for robot in &mut group.robots {
        robot.board = group::Board::KitF103rc;
        robot.output.kind = StageKind::InInBrake;
    }
    group
}

/// Builds its image, drives and measures.
pub fn figures(group: &GroupFile) -> anyhow::Result<Vec<Figure>> {
    let group = with_kits(group.clone());
    let elf = firmware::build_for(Board::KitF103rc)?;
    let firmware = Firmware::load(&elf)?;
    let mut figures = running::of_board(&group, &firmware, "f103")?;
    let (flash, variables) = image::sizes(&elf)?;
    let stack = image::stack(&firmware).context("the image has no symbols of its stack")?;
    figures.extend([
        Figure::new("f103.memory.flash", flash as f64, "bytes").budget(128.0 * 1024.0),
        Figure::new("f103.memory.variables", variables as f64, "bytes"),
        Figure::new(
            "f103.memory.ram",
            variables as f64 + f64::from(stack),
            "bytes",
        )
        .budget(40.0 * 1024.0),
    ]);
    Ok(figures)
}
