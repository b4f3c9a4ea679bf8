//! The same of a robot without a floating-point unit: the kit with an STM32F103, whose image drives
//! in the same group. Cycles are those of its 72 MHz.

use anyhow::Context as _;
use emulator::Firmware;
use group::{CompensationTable, GroupFile, StageKind};
use protocol::compensation::{ObliqueRow, Row};

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

/// What the load is held to, %: what was reached, and a little for where code happens to lie in the
/// flash.
const LOAD_CEILING: f64 = 14.2;
/// With tables: the budget.
const TABLES_LOAD_CEILING: f64 = 15.0;

/// The same robots with every table that a calibration writes: three speeds along the axes, two
/// of them at 45 degrees, two rates, all within what the group drives.
fn with_tables(mut group: GroupFile) -> GroupFile {
    let table = CompensationTable {
        version: 1,
        longitudinal: [(0.0988, 1.0121), (0.2472, 1.0114), (0.4941, 1.0119)]
            .map(row)
            .into(),
        lateral: [(0.0921, 1.0861), (0.2299, 1.0875), (0.4583, 1.091)]
            .map(row)
            .into(),
        oblique: [(0.0954, 1.0482, 1.0493), (0.4755, 1.0517, 1.0529)]
            .map(|(speed, longitudinal, lateral)| ObliqueRow {
                speed,
                longitudinal,
                lateral,
            })
            .into(),
        yaw: [(0.2447, 1.0216), (0.4884, 1.0238)].map(row).into(),
    };
    for robot in &mut group.robots {
        robot.compensation_table = table.clone();
    }
    group
}

const fn row((speed, coefficient): (f32, f32)) -> Row {
    Row::new(speed, coefficient)
}

/// Builds its image, drives and measures.
pub fn figures(group: &GroupFile) -> anyhow::Result<Vec<Figure>> {
    let group = with_kits(group.clone());
    let elf = firmware::build_for(Board::KitF103rc)?;
    let firmware = Firmware::load(&elf)?;
    let mut figures = running::of_board(&group, &firmware, "f103", LOAD_CEILING)?;
    figures.extend(running::of_board(
        &with_tables(group),
        &firmware,
        "f103.tables",
        TABLES_LOAD_CEILING,
    )?);
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
