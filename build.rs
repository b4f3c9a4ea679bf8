//! Linker arguments of the firmware.
//!
//! They are here and not in `.cargo/config.toml`, because an environment `RUSTFLAGS` replaces the
//! flags from there without a word and leaves an image without a vector table. They apply to the
//! robot's target only: the same package also compiles on the host, where the firmware is an empty
//! program.

use std::{env, fs, path::PathBuf};

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=memory.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }

    // `link.x` includes `memory.x` from the search path.
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy("memory.x", out.join("memory.x")).expect("memory.x can be copied to OUT_DIR");
    println!("cargo::rustc-link-search={}", out.display());

    // `--nmagic`: sections are not padded to pages. `link.x`: vector table and start-up of
    // cortex-m-rt. `defmt.x`: the table of log strings, which stays in the ELF file.
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}
