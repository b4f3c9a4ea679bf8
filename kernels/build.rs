//! Linker arguments of the counting image, for a bare-metal target only: see the firmware's own
//! build script.

use std::{env, fs, path::PathBuf};

/// The layout of the reference board, which the firmware's `memory.x` includes as `board.x`. The
/// linker finds `memory.x` first, because it runs in the root of the workspace.
const BOARD: &str = "../memory/nucleo_f446re.x";
/// What the layout leaves open, with the whole flash for this image.
const SLOTS: &str = "MEMORY
{
  FLASH : ORIGIN = 0x08000000, LENGTH = 512K
}
";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    println!("cargo::rerun-if-changed={BOARD}");
    fs::copy(BOARD, out.join("board.x")).expect("the layout can be copied to OUT_DIR");
    fs::write(out.join("slots.x"), SLOTS).expect("slots.x can be written to OUT_DIR");
    println!("cargo::rustc-link-search={}", out.display());
    for argument in ["--nmagic", "-Tlink.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}
