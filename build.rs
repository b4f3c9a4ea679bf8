//! Memory layout, boot code and linker arguments of the firmware, and which board it is for.
//!
//! The arguments are here and not in `.cargo/config.toml`, because an environment `RUSTFLAGS`
//! replaces the flags from there without a word and leaves an image without a vector table. They
//! apply to the robot's target only: the same package also compiles on the host, where the firmware
//! is an empty program for no board.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use boot::slots::{self, Slot};

// Said by the compiler: the HAL's own build script refuses two chips, too, and cargo runs it while
// this one is compiled. With fewer than three jobs at once only the HAL's error is seen.
#[cfg(any(
    all(
        feature = "board-nucleo-f446re",
        any(
            feature = "board-robomaster-c",
            feature = "board-kit-f103rc",
            feature = "board-nucleo-g474re"
        )
    ),
    all(
        feature = "board-robomaster-c",
        any(feature = "board-kit-f103rc", feature = "board-nucleo-g474re")
    ),
    all(feature = "board-kit-f103rc", feature = "board-nucleo-g474re"),
))]
compile_error!(
    "two boards are selected, and an image is for one: with --no-default-features --features, \
     select board-nucleo-f446re, board-robomaster-c or board-kit-f103rc; board-nucleo-g474re is a \
     sketch, which drives nothing"
);
// A board that is not finished builds only for who says that he knows it.
#[cfg(all(feature = "board-nucleo-g474re", not(feature = "sketch")))]
compile_error!(
    "board-nucleo-g474re is a sketch: FDCAN is not implemented, so nothing can command a robot with \
     it, and no output is ever switched on: --features board-nucleo-g474re,sketch builds it as that"
);
#[cfg(all(
    feature = "sketch",
    any(
        not(feature = "board-nucleo-g474re"),
        feature = "bench",
        feature = "self-test",
        feature = "slot-b",
        feature = "update",
        feature = "drives-c620",
        feature = "two-pwms",
        feature = "fixed-point"
    )
))]
compile_error!(
    "sketch is an image of its own for a board that is not finished, board-nucleo-g474re: it goes \
     with no other feature"
);
#[cfg(all(feature = "two-pwms", feature = "drives-c620"))]
compile_error!(
    "two-pwms is for bridges on board-nucleo-f446re, and drives-c620 or board-robomaster-c for \
     smart drives: an image has one or the other"
);
#[cfg(all(
    feature = "self-test",
    any(
        feature = "bench",
        feature = "slot-b",
        feature = "drives-c620",
        feature = "two-pwms",
        feature = "fixed-point"
    )
))]
compile_error!(
    "self-test is an image of its own for the reference board, without a robot: it goes with none \
     of bench, slot-b, drives-c620, two-pwms, fixed-point"
);

/// The boards: feature, memory layout and the chip's family; the reference board first.
const BOARDS: [(&str, &str, &str); 4] = [
    ("board-nucleo-f446re", "memory/nucleo_f446re.x", "stm32f4"),
    ("board-robomaster-c", "memory/robomaster_c.x", "stm32f4"),
    ("board-kit-f103rc", "memory/kit_f103rc.x", "stm32f1"),
    ("board-nucleo-g474re", "memory/nucleo_g474re.x", "stm32g4"),
];

/// Package and program of the boot code, and the profile it is built with.
const BOOT: &str = "omnibus-boot";
const BOOT_PROFILE: &str = "boot";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // The chip's family, whether the flash has two slots for programs, and whether the image is a
    // robot's.
    println!("cargo::rustc-check-cfg=cfg(stm32f1, stm32f4, stm32g4, slots, robot)");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let boards: Vec<_> = BOARDS.iter().filter(|(name, ..)| selected(name)).collect();
    let [(_, memory, family)] = boards[..] else {
        let names = BOARDS.map(|(name, ..)| name).join(", ");
        println!(
            "cargo::error={} boards are selected: the firmware is built for one, with \
             --no-default-features --features and one of {names}",
            boards.len()
        );
        return;
    };
    println!("cargo::rerun-if-changed={memory}");

    // `link.x` includes `memory.x`, and that includes `board.x` from the search path.
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy(memory, out.join("board.x")).expect("the layout can be copied to OUT_DIR");
    println!("cargo::rustc-link-search={}", out.display());

    println!("cargo::rustc-cfg={family}");
    if selected("sketch") {
        println!("cargo::warning=a sketch: FDCAN is not implemented, and this image never drives");
    } else {
        println!("cargo::rustc-cfg=robot");
    }
    let slot = if selected("slot-b") { Slot::B } else { Slot::A };
    let has_slots = *family == "stm32f4";
    let regions = if has_slots {
        println!("cargo::rustc-cfg=slots");
        regions(slot)
    } else {
        String::new()
    };
    fs::write(out.join("slots.x"), regions + &symbols()).expect("OUT_DIR can be written");
    if has_slots && slot == Slot::A {
        boot_code(&out);
    }

    // `--nmagic`: sections are not padded to pages. `link.x`: vector table and start-up of
    // cortex-m-rt. `defmt.x`: the table of log strings, which stays in the ELF file.
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}

/// Whether a feature is selected.
fn selected(feature: &str) -> bool {
    let name = feature.to_uppercase().replace('-', "_");
    env::var_os(format!("CARGO_FEATURE_{name}")).is_some()
}

/// Whether the wheels are turned by smart drives or by two PWMs each, for what reads an image.
fn symbols() -> String {
    format!(
        "_smart_drives = {};\n_two_pwms = {};\n",
        u8::from(selected("drives-c620")),
        u8::from(selected("two-pwms")),
    )
}

/// The regions of flash that an image has a part in, and where the boot code is put.
fn regions(slot: Slot) -> String {
    format!(
        "MEMORY
{{
  BOOT  : ORIGIN = {:#x}, LENGTH = {:#x}
  MARK  : ORIGIN = {:#x}, LENGTH = 4
  FLASH : ORIGIN = {:#x}, LENGTH = {:#x}
}}
SECTIONS
{{
  .boot : {{ KEEP(*(.boot)) }} > BOOT
  .boot_mark : {{ KEEP(*(.boot_mark)) }} > MARK
}}
",
        slots::BOOT,
        slots::BOOT_LENGTH,
        slots::MARK,
        slot.address(),
        slot.longest_image(),
    )
}

/// Builds the boot code, a program of its own for the same processor, as `boot.bin`.
///
/// It is built in another folder, because this build holds the lock on its own, and with its own
/// flags: what wraps or changes this build (clippy, coverage) is not for it.
fn boot_code(out: &Path) {
    for path in ["boot", "Cargo.lock", "src/board/memory.rs"] {
        println!("cargo::rerun-if-changed={path}");
    }
    println!("cargo::rerun-if-env-changed=OMNIBUS_PUBLIC_KEY");
    let folder = boot_folder(out);
    let target = env::var("TARGET").expect("cargo sets TARGET");
    let mut cargo = Command::new(env::var_os("CARGO").expect("cargo sets CARGO"));
    cargo
        .args(["build", "--quiet", "--package", BOOT, "--bin", BOOT])
        .args(["--features", "code", "--profile", BOOT_PROFILE])
        .args(["--target", &target, "--target-dir"])
        .arg(&folder);
    for variable in [
        "RUSTFLAGS",
        "CARGO_ENCODED_RUSTFLAGS",
        "RUSTC_WRAPPER",
        "RUSTC_WORKSPACE_WRAPPER",
        "CARGO_BUILD_BUILD_DIR",
    ] {
        cargo.env_remove(variable);
    }
    let built = cargo.status();
    if !built.as_ref().is_ok_and(std::process::ExitStatus::success) {
        println!("cargo::error=the boot code does not build ({built:?}); its messages are above");
        return;
    }
    let code = folder.join(target).join(BOOT_PROFILE).join(BOOT);
    fs::copy(code, out.join("boot.bin")).expect("the boot code can be copied to OUT_DIR");
}

/// Where the boot code is built: one folder for the images of all boards, beside the results of
/// this build, so that it is compiled once. With another public key each image has a folder, where
/// no other build can replace the result before it is copied.
fn boot_folder(out: &Path) -> PathBuf {
    let has_key = env::var_os("OMNIBUS_PUBLIC_KEY").is_some();
    // The file that cargo marks the folder of its results with.
    let results = out.ancestors().find(|at| at.join("CACHEDIR.TAG").is_file());
    match results {
        Some(results) if !has_key => results.join("boot-code"),
        _ => out.join("boot"),
    }
}
