//! `cargo xtask test`: all tests, those that run the image included.

use std::path::PathBuf;

use omnibus::report::Scalar;

use crate::firmware::{Board, Wheels};
use crate::programs::{self, Program};
use crate::{cargo, firmware};

/// The libraries whose own tests are run once more as a kit has them: in fixed point, and without
/// updates. With the libraries that have been compiled for the others.
const KIT_LIBRARIES: [&str; 8] = [
    "test",
    "--package=omnibus-control",
    "--package=omnibus-robot",
    "--package=xtask-features",
    "--no-default-features",
    "--features",
    "omnibus-robot/fixed-point",
    "--lib",
];

/// Runs the tests of a board: all of the workspace for the reference board.
pub fn run(board: Board, rest: &[String]) -> anyhow::Result<()> {
    match board {
        Board::NucleoF446re => run_all(rest),
        Board::RobomasterC => {
            let [elf, slot_b] = board_c()?;
            let images = [
                ("OMNIBUS_ELF_BOARD_C", elf),
                ("OMNIBUS_ELF_BOARD_C_SLOT_B", slot_b),
            ];
            run_system(&BOARD_C_TESTS, "board_c::", images, rest)
        }
        Board::KitF103rc => {
            // One load is on it and on reference boards.
            let reference = firmware::build(Scalar::F32)?;
            let images = [("OMNIBUS_ELF", reference), ("OMNIBUS_ELF_KIT", kit()?)];
            run_system(&KIT_TESTS, "kit::", images, rest)
        }
    }
}

/// The tests of whole robots that have a part for the kit.
const KIT_TESTS: [&str; 3] = ["emulated", "storage", "without_fpu"];

/// The tests of whole robots that have a part for Board C.
const BOARD_C_TESTS: [&str; 7] = [
    "emulated",
    "smart_drives",
    "gyro",
    "index",
    "group_rules",
    "storage",
    "update_bus",
];

/// Runs the parts of the system tests that are for a board, with its images.
fn run_system<const N: usize>(
    tests: &[&str],
    part: &str,
    images: [(&str, PathBuf); N],
    rest: &[String],
) -> anyhow::Result<()> {
    let mut command = cargo::command();
    command.args(["test", "--no-fail-fast", "--features", "emulated"]);
    for test in tests {
        command.args(["--test", test]);
    }
    command.args(["--", part]).args(rest).envs(images);
    cargo::run(&mut command)
}

/// The kit's image.
fn kit() -> anyhow::Result<PathBuf> {
    firmware::build_for(Board::KitF103rc)
}

/// Board C's images for slot A and slot B.
fn board_c() -> anyhow::Result<[PathBuf; 2]> {
    Ok([
        firmware::build_for(Board::RobomasterC)?,
        firmware::build_slot_b(Board::RobomasterC, Wheels::SmartDrives)?,
    ])
}

/// Builds the firmware for both scalars, then runs all tests of the workspace with their paths at
/// hand, and those of the control side as a kit has them. With arguments for `cargo test`, that
/// runs what they select.
fn run_all(rest: &[String]) -> anyhow::Result<()> {
    if !rest.is_empty() {
        let mut command = cargo::tested("test");
        command.arg("--no-fail-fast").args(rest).envs(images()?);
        return cargo::run(&mut command);
    }
    // The last parts of an image's build use one core: the tests are built beside.
    let tests = std::thread::spawn(tests);
    let images = images()?;
    let tests = tests.join().map_err(std::panic::resume_unwind)?;
    programs::on_all_cores(tests?, &images)
}

/// All test programs, built, and the tests that build on one core what they run: those in documents
/// and those of a kit's libraries.
fn tests() -> anyhow::Result<Vec<Program>> {
    let mut all = programs::build(&mut cargo::tested("test"))?;
    let mut documents = cargo::tested("test");
    documents.arg("--doc");
    all.push(Program::new("documents", documents));
    let mut libraries = cargo::command();
    libraries.args(KIT_LIBRARIES);
    all.push(Program::new("libraries of a kit", libraries));
    Ok(all)
}

/// Builds the images that tests run, and returns their paths with the names that tests ask for.
fn images() -> anyhow::Result<Vec<(&'static str, PathBuf)>> {
    let board = Board::NucleoF446re;
    let [board_c, board_c_slot_b] = board_c()?;
    Ok(vec![
        ("OMNIBUS_ELF", firmware::build(Scalar::F32)?),
        ("OMNIBUS_ELF_FIXED", firmware::build(Scalar::Fixed)?),
        ("OMNIBUS_ELF_BENCH", firmware::build_bench()?),
        (
            "OMNIBUS_ELF_DRIVES",
            firmware::build_with(board, Wheels::SmartDrives)?,
        ),
        (
            "OMNIBUS_ELF_TWO_PWMS",
            firmware::build_with(board, Wheels::TwoPwms)?,
        ),
        ("OMNIBUS_ELF_BOARD_C", board_c),
        ("OMNIBUS_ELF_KIT", kit()?),
        ("OMNIBUS_ELF_BOARD_C_SLOT_B", board_c_slot_b),
        ("OMNIBUS_ELF_SELF_TEST", firmware::build_self_test()?),
        (
            "OMNIBUS_ELF_SLOT_B",
            firmware::build_slot_b(board, Wheels::Bridges)?,
        ),
    ])
}
