//! Memory layout and linker arguments of the firmware, and which board it is for.
//!
//! The arguments are here and not in `.cargo/config.toml`, because an environment `RUSTFLAGS`
//! replaces the flags from there without a word and leaves an image without a vector table. They
//! apply to the robot's target only: the same package also compiles on the host, where the firmware
//! is an empty program for no board.

use std::{env, fs, path::PathBuf};

/// The boards: feature, and memory layout. The reference board's is at the top.
const BOARDS: [(&str, &str); 2] = [
    ("board-nucleo-f446re", "memory.x"),
    ("board-robomaster-c", "memory/robomaster_c.x"),
];

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let selected = |feature: &str| {
        let name = feature.to_uppercase().replace('-', "_");
        env::var_os(format!("CARGO_FEATURE_{name}")).is_some()
    };
    let boards: Vec<_> = BOARDS.iter().filter(|(name, _)| selected(name)).collect();
    let [(_, memory)] = boards[..] else {
        let names = BOARDS.map(|(name, _)| name).join(", ");
        println!(
            "cargo::error={} boards are selected: the firmware is built for one, with \
             --no-default-features --features and one of {names}",
            boards.len()
        );
        return;
    };
    println!("cargo::rerun-if-changed={memory}");

    // `link.x` includes `memory.x` from the search path.
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy(memory, out.join("memory.x")).expect("the layout can be copied to OUT_DIR");
    println!("cargo::rustc-link-search={}", out.display());

    // `--nmagic`: sections are not padded to pages. `link.x`: vector table and start-up of
    // cortex-m-rt. `defmt.x`: the table of log strings, which stays in the ELF file.
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}
