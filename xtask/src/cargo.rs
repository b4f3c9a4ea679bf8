//! Running `cargo` and `rustup`, always from the root of the workspace.
//!
//! The toolchain is the one `rust-toolchain.toml` pins, because that is what the `cargo` that
//! started this program uses; it passes its own path in `CARGO`.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, bail};

use crate::environment::without_package;

/// The target of the firmware.
pub const TARGET: &str = "thumbv7em-none-eabihf";

/// Root folder of the workspace.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here).to_owned()
}

/// Folder of build results, as `cargo` has it.
pub fn target_folder() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// A `cargo` command in the root of the workspace.
pub fn command() -> Command {
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(program);
    command.current_dir(root());
    without_package(&mut command);
    command
}

/// The features that the tests need: each of the tool's, and those that switch on tests of the
/// image. What is built with them for one task is not built again for the next.
pub const TESTED: &str = include_str!("../tested.features");

/// A `cargo` command for the whole workspace, with what is tested. `--workspace` counts even where
/// one program is built: without it `cargo` would choose fewer features of shared libraries.
pub fn tested(subcommand: &str) -> Command {
    let mut command = command();
    command.args([subcommand, "--workspace", "--features", TESTED]);
    command
}

/// Folder of an image other than the shipped one: each has its own, so that none is mistaken for
/// another or replaces it.
pub fn variant_folder(name: &str) -> PathBuf {
    target_folder().join("variants").join(name)
}

/// Has a command put its results there. What it compiles on the way lies where everything does, so
/// that variants share their libraries.
pub fn variant<'a>(command: &'a mut Command, name: &str) -> &'a mut Command {
    command
        .env("CARGO_BUILD_BUILD_DIR", target_folder())
        .arg("--target-dir")
        .arg(variant_folder(name))
}

/// Runs a command to its end.
pub fn run(command: &mut Command) -> anyhow::Result<()> {
    let name = command.get_program().to_string_lossy().into_owned();
    let status = command
        .status()
        .with_context(|| format!("cannot start {name}: is it installed and on the PATH?"))?;
    if !status.success() {
        bail!("{name} failed ({status}); its messages are above");
    }
    Ok(())
}

/// Adds a target to the toolchain when it is missing.
pub fn ensure_target(target: &str) -> anyhow::Result<()> {
    // The compiler knows best whether it has the target's core library, rustup or not.
    let sysroot = Command::new("rustc")
        .current_dir(root())
        .args(["--print", "sysroot"])
        .output()
        .context("cannot start rustc: install Rust from https://rustup.rs")?;
    let sysroot = PathBuf::from(String::from_utf8_lossy(&sysroot.stdout).trim());
    if sysroot
        .join("lib/rustlib")
        .join(target)
        .join("lib")
        .is_dir()
    {
        return Ok(());
    }
    eprintln!("adding the {target} target with rustup");
    let mut rustup = Command::new("rustup");
    rustup
        .current_dir(root())
        .args(["target", "add", target])
        .stdout(Stdio::inherit());
    run(&mut rustup).with_context(|| {
        format!("the {target} target is missing and could not be added: rustup target add {target}")
    })
}

/// Runs the long tests of a calibration's intervals, which print every robot's.
pub fn coverage(robots: u32) -> anyhow::Result<()> {
    let mut command = command();
    command
        .args(["test", "--package", "omnibus-master", "--test", "coverage"])
        .args(["--", "--ignored", "--nocapture"])
        .env("OMNIBUS_COVERAGE_ROBOTS", robots.to_string());
    run(&mut command)
}

/// Runs the CANopen device's fuzzer, which prints its figure. In the profile with all checks on.
pub fn fuzz(frames: u64, seed: u64) -> anyhow::Result<()> {
    run(tested("build").args(["--quiet", "--example", "fuzz"]))?;
    let mut fuzz = Command::new(target_folder().join("debug/examples/fuzz"));
    fuzz.args(["--frames", &frames.to_string(), "--seed", &seed.to_string()]);
    run(&mut fuzz)
}

/// What the compiler has to put in for libFuzzer. No sanitizer: those need a nightly compiler, and
/// the crate has no `unsafe`.
const COVERAGE: &str = "-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
     -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
     -Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1 --cfg fuzzing";

/// Builds the libFuzzer target in `canopen/fuzz` with the toolchain there is and runs it for so
/// long. What it finds is written to `target/fuzz/`, and fails.
pub fn fuzz_guided(seconds: u64) -> anyhow::Result<()> {
    let folder = target_folder().join("fuzz");
    let corpus = folder.join("corpus");
    std::fs::create_dir_all(&corpus).with_context(|| corpus.display().to_string())?;
    let host = host()?;
    let mut build = command();
    build
        .env("RUSTFLAGS", COVERAGE)
        .args([
            "build",
            "--quiet",
            "--release",
            "--locked",
            "--target",
            &host,
        ])
        .args(["--manifest-path", "canopen/fuzz/Cargo.toml", "--target-dir"])
        .arg(&folder);
    run(&mut build)
        .context("libFuzzer needs a C++ compiler; on Debian and Ubuntu install the package g++")?;
    let program = folder.join(host).join("release/frames");
    let mut fuzz = Command::new(program);
    fuzz.current_dir(&folder)
        .args([format!("-max_total_time={seconds}"), "-max_len=4096".into()])
        .args(["-timeout=10", "-print_final_stats=1"])
        .arg(&corpus);
    run(&mut fuzz)
}

/// The target triple of this machine.
fn host() -> anyhow::Result<String> {
    let output = Command::new("rustc").arg("-vV").output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let host = text.lines().find_map(|line| line.strip_prefix("host: "));
    host.map(ToOwned::to_owned)
        .context("`rustc -vV` does not name its host")
}
