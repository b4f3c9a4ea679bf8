//! What `cargo xtask` starts: it builds and runs the tasks, and builds the firmware at the same
//! time for those tasks that need it.
//!
//! The last part of the firmware's build uses one core for half a minute, and so does that of the
//! tasks. On a fresh clone they run beside each other instead of one after the other; the tests
//! have another board's image built meanwhile. The two share no build folder, so neither waits for
//! the other's lock. The tasks' build goes first where both want a core: it has the longer chain of
//! crates that wait for each other, and the firmware's fills the gaps. The firmware's build here
//! says nothing and may fail: the task runs the same build again, finds it done, and reports what
//! went wrong otherwise.

#[path = "../../src/environment.rs"]
mod environment;

use std::env;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, ExitStatus, Stdio};

/// The tasks that begin with the release image of the reference board.
const WITH_IMAGE: [&str; 6] = ["bench", "demo", "faults", "interop", "socketcan", "test"];

/// The tasks that go on to build everything as it is tested.
const WITH_TESTS: [&str; 3] = ["interop", "socketcan", "test"];

/// Those builds' features, as `xtask/src/cargo.rs` has them.
const TESTED: &str = include_str!("../../tested.features");

/// Whether a command line leads to a build of the release image.
fn needs_image(arguments: &[String]) -> bool {
    let asks_for_help = arguments
        .iter()
        .any(|word| word == "--help" || word == "-h");
    let is_native = arguments.iter().any(|word| word.ends_with("native"));
    let task = arguments
        .first()
        .is_some_and(|task| WITH_IMAGE.contains(&task.as_str()));
    task && !asks_for_help && !is_native
}

/// Cargo as this program was started by it, in the workspace and without this package's variables.
fn cargo(root: &Path) -> Command {
    in_workspace(Command::new(cargo_path()), root)
}

/// The same with a lower priority than everything else, where there is a command for that.
fn cargo_behind(root: &Path) -> Command {
    if cfg!(not(unix)) {
        return cargo(root);
    }
    let mut command = Command::new("nice");
    command.args(["-n", "10"]).arg(cargo_path());
    in_workspace(command, root)
}

fn cargo_path() -> OsString {
    env::var_os("CARGO").unwrap_or_else(|| "cargo".into())
}

fn in_workspace(mut command: Command, root: &Path) -> Command {
    command.current_dir(root);
    environment::without_package(&mut command);
    command
}

/// A build of the firmware, as `xtask/src/firmware.rs` runs it.
fn firmware(root: &Path) -> Command {
    let mut command = cargo_behind(root);
    command
        .args([
            "build",
            "--quiet",
            "--release",
            "--target",
            "thumbv7em-none-eabihf",
        ])
        .args(["--package", "omnibus-firmware", "--bin", "omnibus-firmware"])
        .env_remove("OMNIBUS_TICK_US")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command
}

/// Board C's image, which the tests need, too.
fn board_c(root: &Path, target: &Path) -> Command {
    const BOARD: &str = "board-robomaster-c";
    let mut command = firmware(root);
    command
        .args(["--no-default-features", "--features", BOARD])
        .env("CARGO_BUILD_BUILD_DIR", target)
        .arg("--target-dir")
        .arg(target.join("variants").join(BOARD));
    command
}

/// The tasks' own build and start. The demo is a program of its own, with less to compile. Where
/// everything else is built next, the tasks are built as a part of that: alone, they would have
/// fewer features of the tool's library, and this would be built twice.
fn tasks(root: &Path, target: &Path, arguments: &[String]) -> std::io::Result<ExitStatus> {
    let task = arguments.first().map(String::as_str);
    let is_demo = task == Some("demo");
    let name = if is_demo { "xtask-demo" } else { "xtask" };
    let program = format!("{name}{}", env::consts::EXE_SUFFIX);
    let program = target.join("debug").join(program);
    let tested = task.is_some_and(|task| WITH_TESTS.contains(&task));
    let mut build = cargo(root);
    build.arg(if tested { "build" } else { "run" });
    // The first build takes minutes, and shows how far it is.
    if program.exists() {
        build.arg("--quiet");
    }
    if !tested {
        build.args(["--package", "xtask", "--features", "elf"]);
        if is_demo {
            build.arg("--no-default-features");
        }
        build.args(["--bin", name, "--"]);
        return build.args(arguments).status();
    }
    let status = build
        .args(["--workspace", "--features", TESTED, "--bin", "xtask"])
        .status()?;
    if !status.success() {
        return Ok(status);
    }
    Command::new(program)
        .current_dir(root)
        .args(arguments)
        .status()
}

fn main() -> ExitCode {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = here.ancestors().nth(2).unwrap_or(here);
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    let arguments: Vec<String> = env::args().skip(1).collect();

    let mut images = Vec::new();
    if needs_image(&arguments) {
        images.push(firmware(root));
        if arguments == ["test"] {
            images.push(board_c(root, &target));
        }
    }
    let images = images.iter_mut().map(Command::spawn);
    let images: Vec<Child> = images.filter_map(Result::ok).collect();
    let status = tasks(root, &target, &arguments);

    // A task that ended early, say because of a wrong option, does not leave a build behind.
    for mut build in images {
        let _ = build.kill();
        let _ = build.wait();
    }
    match status {
        Ok(status) => {
            let code = status.code().and_then(|code| u8::try_from(code).ok());
            code.map_or(ExitCode::FAILURE, ExitCode::from)
        }
        Err(error) => {
            eprintln!("error: cannot start cargo or the tasks: {error}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asks(line: &str) -> bool {
        needs_image(&line.split(' ').map(String::from).collect::<Vec<_>>())
    }

    #[test]
    fn the_image_is_built_for_the_tasks_that_run_it() {
        assert!(asks("demo") && asks("test") && asks("faults --pairs none"));
        assert!(!asks("flash") && !asks("demo --help") && !asks("demo --backend native"));
    }
}
