//! `cargo xtask interop`: third-party software communicates with our robots and reads our logs.
//!
//! The tests are Python and lie in `tests/interop` (robots, native and emulated) and
//! `canopen/interop` (the CANopen crate alone). They run in a virtual environment under `target/`,
//! built from the pinned `tests/interop/requirements.txt` and rebuilt when that file changes.
//! The packages of Node.js lie there too, from the pinned `tests/interop/package-lock.json`.
//! tshark, chromium, gdb, Node.js, openssl, mosquitto, Fast DDS and a C++ compiler must be on the
//! system; otherwise this task reports them and fails, because a test that is skipped silently
//! proves nothing.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::{Context as _, bail};
use omnibus::report::Scalar;

use crate::programs::{self, Program};
use crate::{cargo, firmware, release};

/// Options of `cargo xtask interop`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Backend of the robots; by default both, one after the other.
    #[arg(long, value_parser = ["native", "emulator"])]
    backend: Option<String>,
    /// Builds and installs what the tests need, and runs none.
    #[arg(long, conflicts_with = "backend")]
    prepare: bool,
}

/// What drives robots of a backend.
const ROBOT_TESTS: [&str; 5] = [
    "test_robot",
    "test_dictionary",
    "test_endpoints",
    "test_master",
    "test_lock",
];

/// Updates and the emulator's own ways in.
const UPDATE_TESTS: [&str; 3] = ["test_emulate", "test_update", "test_update_command"];

/// What computes. The longest is last: it alone takes all cores, so none stands idle in the end.
const COMPUTING_TESTS: [&str; 4] = [
    "test_mujoco.PhasesByPoses",
    "test_mujoco.PhasesByGyro",
    "test_mujoco.Paths",
    "test_mujoco.Intervals",
];

/// What drives a master with simulated robots in real time: its page and files, fleets.
const MASTER_TESTS: [&str; 5] = [
    "test_page",
    "test_live",
    "test_recording",
    "test_foreign",
    "test_vda5050",
];

/// The same with ROS 2.
const ROS_TESTS: [&str; 2] = ["test_ros", "test_ros_fast"];

/// Builds everything, then runs every test. In three rows masters drive robots in real time, and in
/// a fourth devices answer, which mostly waits. The others have no time but their own, and yield to
/// these. A test that fails does not hide the others.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let tests = cargo::root().join("tests/interop");
    system_packages()?;
    let python = python()?;
    let modules = node_modules(&tests)?;
    cargo::run(cargo::tested("build").args(["--bin=omnibus", "--bin=omnibus-sim", "--examples"]))?;
    let built = cargo::target_folder().join("debug");
    let fast_peer = fast_peer(&tests)?;
    let elf = firmware::build(Scalar::F32)?;
    let logs = cargo::target_folder().join("interop/logs");
    if logs.exists() {
        std::fs::remove_dir_all(&logs).with_context(|| format!("{}", logs.display()))?;
    }
    std::fs::create_dir_all(&logs).with_context(|| format!("{}", logs.display()))?;

    let image = cargo::target_folder().join("interop/omnibus.image");
    release::development(image.clone())?;
    if arguments.prepare {
        return Ok(());
    }

    let _one_queue = OneQueue::new(&python)?;
    let yielding = || {
        let mut command = Command::new("nice");
        command.args(["-n", "15"]).arg(&python);
        command
    };
    let python_tests = |mut command: Command, files: &[&str], backend: &str| {
        command
            .current_dir(&tests)
            .args(["-B", "-m", "unittest"])
            .args(files)
            .env("OMNIBUS_SIM", built.join("omnibus-sim"))
            .env("OMNIBUS", built.join("omnibus"))
            .env("OMNIBUS_FAST_PEER", &fast_peer)
            .env("OMNIBUS_EXAMPLES", built.join("examples"))
            .env("NODE_PATH", &modules)
            .env("OMNIBUS_ELF", &elf)
            .env("OMNIBUS_IMAGE", &image)
            .env("OMNIBUS_BACKEND", backend)
            .env("OMNIBUS_LOGS", &logs);
        command
    };
    let batch = |files: &[&str], backend: &str, cable: bool| {
        let at_the_cable = if cable { ", at the robot's cable" } else { "" };
        let in_real_time = Command::new(&python);
        let mut command = python_tests(in_real_time, files, backend);
        if cable {
            command.env("OMNIBUS_CABLE", "1");
        }
        let name = format!("{backend}{at_the_cable}: {}", files.join(", "));
        Program::new(name, command)
    };
    let mut robots = Vec::new();
    for backend in ["native", "emulator"] {
        if arguments
            .backend
            .as_deref()
            .is_none_or(|one| one == backend)
        {
            robots.push(batch(&ROBOT_TESTS, backend, false));
        }
    }
    if arguments.backend.as_deref() != Some("native") {
        robots.push(batch(&["test_robot", "test_dictionary"], "emulator", true));
    }
    // Reads what those before it have logged.
    robots.push(batch(&["test_log", "test_real_time"], "logs", false));
    let patient = |files: &[&str], backend: &str| {
        let name = format!("{backend}: {}", files.join(", "));
        Program::new(name, python_tests(yielding(), files, backend))
    };
    let masters = MASTER_TESTS.map(|file| batch(&[file], "native", false));
    let ros = ROS_TESTS.map(|file| batch(&[file], "native", false));
    let mut others = vec![patient(&UPDATE_TESTS, "emulator")];
    others.extend(COMPUTING_TESTS.map(|test| patient(&[test], "native")));
    let devices = [("test_device.py", "interop"), ("test_client.py", "sdo")];
    let devices = devices.map(|(file, example)| {
        let mut command = Command::new(&python);
        command
            .current_dir(cargo::root())
            .arg("-B")
            .arg(Path::new("canopen/interop").join(file))
            .arg(built.join("examples").join(example));
        Program::new(format!("canopen: {file}"), command)
    });
    let rows = [robots, masters.into(), ros.into(), devices.into()];
    programs::in_rows(rows, others)
}

/// Has a multi-body simulation say how many of a calibration's intervals hold.
pub fn coverage(robots: u32, first: u32) -> anyhow::Result<()> {
    let python = python()?;
    cargo::run(cargo::tested("build").arg("--bin=omnibus"))?;
    for what in ["phases", "coefficients"] {
        let mut asks = Command::new(&python);
        asks.current_dir(cargo::root().join("tests/interop"))
            .args(["-B", "multi_body.py", "--what", what])
            .args(["--first", &first.to_string()])
            .args(["--robots", &robots.to_string()])
            .env("OMNIBUS", cargo::target_folder().join("debug/omnibus"));
        cargo::run(&mut asks)?;
    }
    Ok(())
}

/// Builds the peer that has Fast DDS; its types are made at run time, so no generator is needed.
fn fast_peer(tests: &Path) -> anyhow::Result<PathBuf> {
    let program = cargo::target_folder().join("interop/fast_peer");
    let mut compile = Command::new("c++");
    compile.args(["-std=c++17", "-O1", "-Wall", "-Wextra", "-o"]);
    compile.arg(&program).arg(tests.join("fast_peer.cpp"));
    cargo::run(compile.args(["-lfastrtps", "-lfastcdr"]))
        .context("tests/interop/fast_peer.cpp needs Fast DDS 2 (Debian: libfastrtps-dev)")?;
    Ok(program)
}

/// One queue of all programs for each processor, where Linux has one for each session, until the
/// process that began it ends, however that ends. Needs root, and does nothing otherwise.
///
/// Beside tests that wake each other many thousand times a second, programs of other sessions and
/// threads of the kernel (which carry what is written into a pseudo terminal) waited for up to 2.4
/// s with Linux 6.18, and for 11 ms without that grouping; a real-time thread for 8 ms.
struct OneQueue(Child);

/// Ends with its standard input.
const ONE_QUEUE: &str = "import sys
setting = '/proc/sys/kernel/sched_autogroup_enabled'
try:
    with open(setting) as file:
        before = file.read()
    with open(setting, 'w') as file:
        file.write('0')
except OSError:
    sys.exit()
try:
    sys.stdin.read()
finally:
    with open(setting, 'w') as file:
        file.write(before)
";

impl OneQueue {
    fn new(python: &Path) -> anyhow::Result<Self> {
        let mut command = Command::new(python);
        command.args(["-c", ONE_QUEUE]).stdin(Stdio::piped());
        let child = command.spawn();
        let child = child.with_context(|| python.display().to_string())?;
        Ok(Self(child))
    }
}

impl Drop for OneQueue {
    fn drop(&mut self) {
        drop(self.0.stdin.take());
        // It has nothing to say.
        self.0.wait().ok();
    }
}

/// Names what the system lacks.
fn system_packages() -> anyhow::Result<()> {
    let starts = |program: &str, arguments: &[&str]| {
        Command::new(program)
            .args(arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
            // One of them knows no option that ends well.
            .is_ok_and(|status| status.success() || arguments.is_empty())
    };
    let missing: Vec<&str> = [
        ("python3", &["-c", "import venv, ensurepip"][..]),
        ("tshark", &["--version"][..]),
        ("chromium", &["--version"][..]),
        ("gdb-multiarch", &["--version"][..]),
        ("c++", &["--version"][..]),
        ("ip", &["-V"][..]),
        ("node", &["--version"][..]),
        ("npm", &["--version"][..]),
        ("openssl", &["version"][..]),
        ("mosquitto_passwd", &[][..]),
        ("mosquitto_pub", &[][..]),
    ]
    .into_iter()
    .filter(|(program, arguments)| !starts(program, arguments))
    .map(|(program, _)| program)
    .collect();
    if missing.is_empty() {
        return Ok(());
    }
    bail!(
        "missing: {}. Debian and Ubuntu: apt-get install --no-install-recommends python3 \
         python3-venv tshark chromium gdb-multiarch nodejs npm openssl mosquitto \
         mosquitto-clients g++ libfastrtps-dev iproute2",
        missing.join(", ")
    )
}

/// The interpreter that has the tests' packages.
pub fn python() -> anyhow::Result<PathBuf> {
    environment(&cargo::root().join("tests/interop/requirements.txt"))
}

/// The folder with the packages of Node.js, made from the lock file.
fn node_modules(tests: &Path) -> anyhow::Result<PathBuf> {
    let folder = cargo::target_folder().join("interop/node");
    let modules = folder.join("node_modules");
    let lock = tests.join("package-lock.json");
    let wanted = std::fs::read(&lock).with_context(|| format!("cannot read {}", lock.display()))?;
    let made_from = folder.join("made-from.json");
    if std::fs::read(&made_from).is_ok_and(|made| made == wanted) {
        return Ok(modules);
    }
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    for file in ["package.json", "package-lock.json"] {
        std::fs::copy(tests.join(file), folder.join(file)).context(file)?;
    }
    let mut install = Command::new("npm");
    install.args([
        "ci",
        "--ignore-scripts",
        "--silent",
        "--no-audit",
        "--no-fund",
    ]);
    cargo::run(install.current_dir(&folder))
        .context("the packages of Node.js could not be installed")?;
    std::fs::write(&made_from, wanted).with_context(|| made_from.display().to_string())?;
    Ok(modules)
}

/// The interpreter of the virtual environment, made from the requirements.
fn environment(requirements: &Path) -> anyhow::Result<PathBuf> {
    let folder = cargo::target_folder().join("interop/python");
    let python = folder.join("bin/python");
    let wanted = std::fs::read(requirements)
        .with_context(|| format!("cannot read {}", requirements.display()))?;
    // Written last, so an environment that was interrupted in the making is made again.
    let made_from = folder.join("made-from.txt");
    if std::fs::read(&made_from).is_ok_and(|made| made == wanted) {
        return Ok(python);
    }
    let arguments: [OsString; 4] = ["-m".into(), "venv".into(), "--clear".into(), folder.into()];
    cargo::run(Command::new("python3").args(arguments))?;
    let mut install = Command::new(&python);
    install.args(["-m", "pip", "install", "--quiet", "--no-deps"]);
    install.args(["--disable-pip-version-check", "--requirement"]);
    cargo::run(install.arg(requirements)).context("the Python packages could not be installed")?;
    std::fs::write(&made_from, wanted).with_context(|| made_from.display().to_string())?;
    Ok(python)
}
