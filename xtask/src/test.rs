//! `cargo xtask test`: all tests, those that run the image included.

use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use anyhow::Context as _;
use omnibus::report::Scalar;

use crate::firmware::{Board, Wheels};
use crate::{cargo, firmware};

/// The libraries whose tests are run once more in fixed point.
const FIXED_TESTS: [&str; 6] = [
    "--package=omnibus-control",
    "--package=omnibus-robot",
    "--features",
    "omnibus-robot/fixed-point",
    "--lib",
    "--tests",
];

/// Starts the build of all tests. It runs beside the builds of the images, whose last parts use one
/// core, and says nothing: the tests' own run repeats it and reports what does not compile.
fn start_build() -> Option<Child> {
    cargo::tested("test")
        .args(["--quiet", "--no-run"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .ok()
}

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
    copy(&firmware::build_for(Board::KitF103rc)?, "kit")
}

/// Board C's images for slot A and slot B.
fn board_c() -> anyhow::Result<[PathBuf; 2]> {
    let a = copy(&firmware::build_for(Board::RobomasterC)?, "board-c")?;
    let b = firmware::build_slot_b(Board::RobomasterC, Wheels::SmartDrives)?;
    Ok([a, copy(&b, "board-c-slot-b")?])
}

/// A copy of an image that stays: each variant replaces the one before it in the same folder.
fn copy(elf: &Path, extension: &str) -> anyhow::Result<PathBuf> {
    let to = elf.with_extension(extension);
    std::fs::copy(elf, &to).with_context(|| format!("cannot write {}", to.display()))?;
    Ok(to)
}

/// Builds the firmware for both scalars, then runs all tests of the workspace with their paths at
/// hand, and those of the control side in fixed point.
fn run_all(rest: &[String]) -> anyhow::Result<()> {
    let tests = rest.is_empty().then(start_build).flatten();
    let elf = firmware::build(Scalar::F32)?;
    let bench = copy(&firmware::build_bench()?, "bench")?;
    let self_test = copy(&firmware::build_self_test()?, "self-test")?;
    let board = Board::NucleoF446re;
    let slot_b = firmware::build_slot_b(board, Wheels::Bridges)?;
    let slot_b = copy(&slot_b, "slot-b")?;
    let drives = firmware::build_with(board, Wheels::SmartDrives)?;
    let drives = copy(&drives, "drives")?;
    let two_pwms = firmware::build_with(board, Wheels::TwoPwms)?;
    let two_pwms = copy(&two_pwms, "two-pwms")?;
    let [board_c, board_c_slot_b] = board_c()?;
    let kit = kit()?;
    let fixed = firmware::build(Scalar::Fixed)?;
    if let Some(mut build) = tests {
        build.wait().context("the build of the tests")?;
    }
    let mut command = cargo::tested("test");
    command
        .arg("--no-fail-fast")
        .args(rest)
        .env("OMNIBUS_ELF", elf)
        .env("OMNIBUS_ELF_FIXED", fixed)
        .env("OMNIBUS_ELF_BENCH", bench)
        .env("OMNIBUS_ELF_DRIVES", drives)
        .env("OMNIBUS_ELF_TWO_PWMS", two_pwms)
        .env("OMNIBUS_ELF_BOARD_C", board_c)
        .env("OMNIBUS_ELF_KIT", kit)
        .env("OMNIBUS_ELF_BOARD_C_SLOT_B", board_c_slot_b)
        .env("OMNIBUS_ELF_SELF_TEST", self_test)
        .env("OMNIBUS_ELF_SLOT_B", slot_b);
    cargo::run(&mut command)?;
    if rest.is_empty() {
        cargo::run(cargo::command().args(["test", "--quiet"]).args(FIXED_TESTS))?;
    }
    Ok(())
}
