//! Building and inspecting the firmware image.
//!
//! An image without its linker arguments still builds, but has neither boot code nor vector table
//! and does not start.
//! Every build is therefore checked before it is used.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, bail, ensure};
use boot::slots::{self, Slot};
use object::{Object as _, ObjectSection as _, SectionFlags, elf::SHF_ALLOC};

use omnibus::report::Scalar;

use crate::cargo;

/// Start of the flash, where the core reads the boot code's vectors (RM0390 rev 6, 2.4).
const FLASH_ORIGIN: u64 = slots::BOOT as u64;
/// End of the longest flash, the STM32F407IG's 1 MiB.
const FLASH_END: u64 = FLASH_ORIGIN + 1024 * 1024;
/// Name of the firmware's binary.
const BINARY: &str = "omnibus-firmware";

/// A board.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, clap::ValueEnum)]
pub enum Board {
    /// NUCLEO-F446RE, the reference board.
    #[default]
    NucleoF446re,
    /// RoboMaster Development Board C.
    RobomasterC,
    /// A kit's controller with an STM32F103RC.
    KitF103rc,
}

impl Board {
    /// All, the reference board first.
    const ALL: [Self; 3] = [Self::NucleoF446re, Self::RobomasterC, Self::KitF103rc];

    /// Its cargo feature.
    const fn feature(self) -> &'static str {
        match self {
            Self::NucleoF446re => "board-nucleo-f446re",
            Self::RobomasterC => "board-robomaster-c",
            Self::KitF103rc => "board-kit-f103rc",
        }
    }

    /// Its chip, as probe-rs names it.
    pub const fn chip(self) -> &'static str {
        match self {
            Self::NucleoF446re => "STM32F446RETx",
            Self::RobomasterC => "STM32F407IGHx",
            Self::KitF103rc => "STM32F103RC",
        }
    }

    /// The compiler's target of its processor.
    const fn target(self) -> &'static str {
        match self {
            Self::NucleoF446re | Self::RobomasterC => cargo::TARGET,
            Self::KitF103rc => "thumbv7m-none-eabi",
        }
    }
}

impl From<group::Board> for Board {
    fn from(board: group::Board) -> Self {
        match board {
            group::Board::NucleoF446re => Self::NucleoF446re,
            group::Board::RobomasterC => Self::RobomasterC,
            group::Board::KitF103rc => Self::KitF103rc,
        }
    }
}

/// What turns the wheels, as far as it takes an image of its own.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Wheels {
    /// Bridges with one PWM a wheel.
    #[default]
    Bridges,
    /// Bridges with two PWMs a wheel.
    TwoPwms,
    /// Smart drives.
    SmartDrives,
}

impl Wheels {
    /// Feature that a board needs beside its own.
    fn feature(self, board: Board) -> anyhow::Result<Option<&'static str>> {
        Ok(match (board, self) {
            (Board::NucleoF446re, Self::Bridges)
            | (Board::RobomasterC, Self::SmartDrives)
            | (Board::KitF103rc, Self::TwoPwms) => None,
            (Board::NucleoF446re, Self::TwoPwms) => Some("two-pwms"),
            (Board::NucleoF446re, Self::SmartDrives) => Some("drives-c620"),
            (Board::RobomasterC, _) => bail!("a robomaster-c drives by smart drives only"),
            (Board::KitF103rc, _) => {
                bail!("a kit-f103rc drives by two PWMs a wheel only: in-in-brake or in-in-fast")
            }
        })
    }
}

impl From<group::StageKind> for Wheels {
    fn from(kind: group::StageKind) -> Self {
        if kind.drive_current().is_some() {
            Self::SmartDrives
        } else if kind.has_two_pwms() {
            Self::TwoPwms
        } else {
            Self::Bridges
        }
    }
}

/// Builds the release image for the board and returns its path.
pub fn build(scalar: Scalar) -> anyhow::Result<PathBuf> {
    match scalar {
        Scalar::F32 => build_as(Board::NucleoF446re, |_| ()),
        Scalar::Fixed => build_variant(Board::NucleoF446re, "fixed-point", |command| {
            command.args(["--features", "fixed-point"]);
        }),
    }
}

/// Builds the bench image for use with a debugger, which never drives.
pub fn build_bench() -> anyhow::Result<PathBuf> {
    build_variant(Board::NucleoF446re, "bench", |command| {
        command.args(["--features", "bench"]);
    })
}

/// Builds the self-test image for bare boards, which is no robot.
pub fn build_self_test() -> anyhow::Result<PathBuf> {
    build_variant(Board::NucleoF446re, "self-test", |command| {
        command.args(["--features", "self-test"]);
    })
}

/// Builds the image for the second slot, which has no boot code.
pub fn build_slot_b(board: Board, wheels: Wheels) -> anyhow::Result<PathBuf> {
    ensure!(
        board != Board::KitF103rc,
        "a kit-f103rc has no second slot: it takes no update over the bus"
    );
    let features: Vec<&str> = [board.feature(), "slot-b"]
        .into_iter()
        .chain(wheels.feature(board)?)
        .collect();
    build_variant(board, &features.join("-"), |command| {
        command.args(["--no-default-features", "--features", &features.join(",")]);
    })
}

/// Builds an image whose control tick has a period other than a millisecond, for measurements.
pub fn build_with_tick(period_us: u32) -> anyhow::Result<PathBuf> {
    let name = format!("tick-{period_us}-us");
    build_variant(Board::NucleoF446re, &name, |command| {
        command.env("OMNIBUS_TICK_US", period_us.to_string());
    })
}

/// Builds the release image for a board.
pub fn build_for(board: Board) -> anyhow::Result<PathBuf> {
    match board {
        Board::NucleoF446re => build(Scalar::F32),
        other => build_variant(other, other.feature(), |command| {
            command.args(["--no-default-features", "--features", other.feature()]);
        }),
    }
}

impl From<Board> for group::Board {
    fn from(board: Board) -> Self {
        match board {
            Board::NucleoF446re => Self::NucleoF446re,
            Board::RobomasterC => Self::RobomasterC,
            Board::KitF103rc => Self::KitF103rc,
        }
    }
}

/// A board that is not finished and drives nothing: no [`Board`], so it can be neither flashed nor
/// tested from here, but it has to build.
const SKETCH: &str = "board-nucleo-g474re";

/// Builds the image of the sketch and checks that the core starts it and the emulator, which has
/// robots, does not.
fn build_sketch() -> anyhow::Result<()> {
    let elf = compile(cargo::TARGET, |command| {
        cargo::variant(command, "sketch")
            .args(["--no-default-features", "--features", SKETCH])
            .args(["--features", "sketch"]);
    })?;
    let bytes = std::fs::read(&elf).with_context(|| format!("cannot read {}", elf.display()))?;
    is_at(&bytes, ".vector_table", FLASH_ORIGIN)?;
    let loaded = emulator::Firmware::from_elf(bytes);
    ensure!(
        matches!(loaded, Err(emulator::LoadError::UnknownChip(_))),
        "the emulator takes the image of a sketch for that of a robot"
    );
    Ok(())
}

/// Builds the release image for every board, which checks it.
pub fn build_all_boards() -> anyhow::Result<()> {
    for board in Board::ALL {
        build_for(board)?;
    }
    for wheels in [Wheels::TwoPwms, Wheels::SmartDrives] {
        build_with(Board::NucleoF446re, wheels)?;
    }
    build_sketch()?;
    let unfinished = ["--no-default-features", "--features", SKETCH];
    refuse("FDCAN is not implemented", &unfinished)?;
    refuse("sketch is an image of its own", &["--features", "sketch"])?;
    let two = ["--features", Board::RobomasterC.feature()];
    refuse("two boards are selected", &two)?;
    refuse("self-test is an image", &["--features", "self-test,bench"])?;
    refuse(
        "two-pwms is for bridges",
        &["--features", "two-pwms,drives-c620"],
    )?;
    let none = ["--no-default-features", "--target", cargo::TARGET];
    refuse("0 boards are selected", &none)?;
    println!(
        "images that start: {}; and of {SKETCH}, which is a sketch and never drives",
        Board::ALL.map(Board::feature).join(", ")
    );
    Ok(())
}

/// Checks that a choice of features ends in an error of the firmware's own, which lists the boards
/// where it is about them. On the host, where there is no HAL that could refuse two chips before.
fn refuse(error: &str, features: &[&str]) -> anyhow::Result<()> {
    let output = cargo::command()
        .args(["check", "--release", "--package", BINARY, "--bin", BINARY])
        .args(features)
        .output()
        .context("cannot start cargo")?;
    let messages = String::from_utf8_lossy(&output.stderr);
    let listed = Board::ALL
        .iter()
        .all(|board| messages.contains(board.feature()));
    ensure!(
        !output.status.success()
            && messages.contains(error)
            && (listed || !error.contains("boards")),
        "{features:?} does not end in the firmware's error \"{error}\", but with: {messages}"
    );
    Ok(())
}

/// Builds the release image for a board and what turns the wheels.
pub fn build_with(board: Board, wheels: Wheels) -> anyhow::Result<PathBuf> {
    match wheels.feature(board)? {
        Some(feature) => build_variant(board, feature, |command| {
            command.args(["--features", feature]);
        }),
        None => build_for(board),
    }
}

/// Builds an image for each kind of robot in a group and puts them into a folder, which holds
/// nothing else.
pub fn build_for_group(group: &group::GroupFile, folder: &Path) -> anyhow::Result<()> {
    if folder.exists() {
        std::fs::remove_dir_all(folder)
            .with_context(|| format!("cannot remove {}", folder.display()))?;
    }
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot create {}", folder.display()))?;
    for robot in &group.robots {
        let board = Board::from(robot.board);
        let wheels = Wheels::from(robot.output.kind);
        let name = match wheels {
            Wheels::Bridges => "bridges",
            Wheels::TwoPwms => "two-pwms",
            Wheels::SmartDrives => "drives",
        };
        let to = folder.join(format!("{}-{name}.elf", board.feature()));
        if to.exists() {
            continue;
        }
        let elf = build_with(board, wheels).with_context(|| format!("node {}", robot.node))?;
        std::fs::copy(&elf, &to).with_context(|| format!("cannot write {}", to.display()))?;
    }
    Ok(())
}

/// An image other than the shipped one, for which its name stands.
fn build_variant(
    board: Board,
    name: &str,
    change: impl FnOnce(&mut Command),
) -> anyhow::Result<PathBuf> {
    build_as(board, |command| {
        change(cargo::variant(command, name));
    })
}

fn build_as(board: Board, change: impl FnOnce(&mut Command)) -> anyhow::Result<PathBuf> {
    let elf = compile(board.target(), change)?;
    check(board, &elf)?;
    Ok(elf)
}

/// Builds an image, which is not checked yet.
fn compile(target: &str, change: impl FnOnce(&mut Command)) -> anyhow::Result<PathBuf> {
    cargo::ensure_target(target)?;
    let mut command = cargo::command();
    command
        .args(["build", "--release", "--package", BINARY, "--bin", BINARY])
        .args(["--target", target])
        .arg("--message-format=json-render-diagnostics")
        .env_remove("OMNIBUS_TICK_US");
    change(&mut command);
    let output = command
        .stderr(Stdio::inherit())
        .output()
        .context("cannot start cargo")?;
    if !output.status.success() {
        bail!("the firmware does not build; the compiler's messages are above");
    }
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter(|message| message["target"]["name"] == BINARY)
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
        .context("cargo built the firmware but named no executable")
}

/// Checks that the boot code is where the core starts, and the vector table of the image where the
/// boot code starts it; without boot code, where the core starts.
fn check(board: Board, elf: &Path) -> anyhow::Result<()> {
    let bytes = std::fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
    let places = |slot: Slot| (".vector_table", u64::from(slot.address()));
    let for_cable = [
        (".boot", FLASH_ORIGIN),
        (".boot_mark", slots::MARK.into()),
        places(Slot::A),
    ];
    // The image for slot B comes over the bus, to a robot that has boot code.
    let has_boot_code = is_at(&bytes, ".boot", FLASH_ORIGIN);
    let result = if board == Board::KitF103rc {
        ensure!(
            has_boot_code.is_err(),
            "boot code where there is room for one program"
        );
        is_at(&bytes, ".vector_table", FLASH_ORIGIN)
    } else if is_at(&bytes, ".vector_table", Slot::B.address().into()).is_ok() {
        ensure!(has_boot_code.is_err(), "boot code in an image for slot B");
        Ok(())
    } else {
        for_cable
            .into_iter()
            .try_for_each(|(name, address)| is_at(&bytes, name, address))
    };
    result.with_context(|| elf.display().to_string())
}

/// Checks that a section of an ELF file is at an address, and not empty.
fn is_at(bytes: &[u8], name: &str, wanted: u64) -> anyhow::Result<()> {
    let file = object::File::parse(bytes).context("not an ELF file")?;
    let section = file.section_by_name(name).with_context(|| {
        format!("no {name}: the linker script was not used (build.rs, memory.x)")
    })?;
    let (address, size) = (section.address(), section.size());
    if address != wanted || size == 0 {
        bail!("{name} is at 0x{address:08x} with {size} bytes, not at 0x{wanted:08x}");
    }
    Ok(())
}

/// Prints the use of flash and RAM.
pub fn print_size(elf: &Path) -> anyhow::Result<()> {
    let bytes = std::fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
    let file = object::File::parse(&*bytes).context("not an ELF file")?;
    let (mut flash, mut ram) = (0, 0);
    println!("{:<16} {:>10} {:>9}", "section", "address", "bytes");
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags, .. } = section.flags() else {
            continue;
        };
        if sh_flags.0 & SHF_ALLOC.0 == 0 || section.size() == 0 {
            continue;
        }
        let (name, address) = (section.name().unwrap_or("?"), section.address());
        println!("{name:<16} 0x{address:08x} {:>9}", section.size());
        let in_flash = (FLASH_ORIGIN..FLASH_END).contains(&address);
        // Initialised data lives in RAM and takes its initial value's room in flash as well.
        if in_flash || name == ".data" {
            flash += section.size();
        }
        if !in_flash {
            ram += section.size();
        }
    }
    println!("flash {flash} bytes, static RAM {ram} bytes");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_what_is_no_elf() {
        assert!(is_at(b"no elf", ".vector_table", 0).is_err());
    }

    #[test]
    fn refuses_an_elf_without_vector_table() {
        // This test program is a host executable: an ELF on Linux, never with a vector table.
        let me = std::fs::read(std::env::current_exe().unwrap()).unwrap();
        assert!(is_at(&me, ".vector_table", 0).is_err());
    }
}
