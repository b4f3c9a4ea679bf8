//! What tests of the command share: running it, and comparing what it prints with a committed text.
#![allow(dead_code, reason = "every test uses its part")]

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::LazyLock;

/// The root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Runs the command from the root of the repository.
pub fn omnibus(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .args(arguments)
        .current_dir(root())
        .env_remove("OMNIBUS_BUS")
        .env_remove("OMNIBUS_GROUP")
        .output()
        .unwrap()
}

/// What a run printed, as one text with its exit code.
pub fn transcript(arguments: &[&str]) -> String {
    let output = omnibus(arguments);
    let mut text = format!("$ omnibus {}\n", arguments.join(" "));
    text += &String::from_utf8(output.stdout).unwrap();
    let errors = String::from_utf8(output.stderr).unwrap();
    for line in errors.lines() {
        text += &format!("2> {line}\n");
    }
    text + &format!("exit code {}\n", output.status.code().unwrap())
}

/// Compares with `tests/snapshots/NAME.txt`. OMNIBUS_WRITE_SNAPSHOTS=1 writes the files instead:
/// read them before committing.
pub fn check(name: &str, found: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/snapshots")
        .join(format!("{name}.txt"));
    if std::env::var_os("OMNIBUS_WRITE_SNAPSHOTS").is_some() {
        std::fs::write(&path, found).unwrap();
        return;
    }
    let wanted = std::fs::read_to_string(&path).unwrap_or_else(|_| {
        panic!(
            "{} is missing; OMNIBUS_WRITE_SNAPSHOTS=1 writes it",
            path.display()
        )
    });
    for (n, (wanted, found)) in wanted.lines().zip(found.lines()).enumerate() {
        assert_eq!(found, wanted, "{name}, line {}", n + 1);
    }
    assert_eq!(
        found.lines().count(),
        wanted.lines().count(),
        "{name}: number of lines\n{found}"
    );
}

/// The programs' folder, once the simulator is built, which is another package's. As a part of all
/// that is tested: alone, it would have fewer features of the libraries it shares, and these would
/// be built once more.
static PROGRAMS: LazyLock<PathBuf> = LazyLock::new(|| {
    let omnibus = Path::new(env!("CARGO_BIN_EXE_omnibus"));
    let built = Command::new(env!("CARGO"))
        .args(["build", "--workspace", "--bin", "omnibus-sim"])
        .args(["--features", include_str!("../../../xtask/tested.features")])
        .current_dir(root())
        .status()
        .unwrap();
    assert!(built.success());
    omnibus.parent().unwrap().to_owned()
});

/// The programs' folder, with the simulator in it.
pub fn programs() -> &'static Path {
    &PROGRAMS
}

/// The simulator, which ends with the test.
pub struct Served(pub Child);

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A simulator of two robots whose time waits for its client, with these faults (values of
/// `--fault`), and the address at which it serves.
pub fn serve(faults: &[&str]) -> (Served, String) {
    let faults: Vec<&str> = faults.iter().flat_map(|it| ["--fault", it]).collect();
    let (served, address) = serve_in(&root(), &faults);
    let bus = address("lockstep");
    (served, bus)
}

/// The same in a folder with a copy of the group file, with more options; the address is that of an
/// endpoint.
pub fn serve_in(folder: &Path, options: &[&str]) -> (Served, impl Fn(&str) -> String + use<>) {
    let child = Command::new(programs().join("omnibus-sim"))
        .args(["serve", "groups/tcc-2.toml", "--lockstep", "127.0.0.1:0"])
        .args(options)
        .current_dir(folder)
        .env("OMNIBUS_SIM_SPEED", "max")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn();
    let mut served = Served(child.unwrap());
    let lines = BufReader::new(served.0.stdout.take().unwrap()).lines();
    // To the last line that it prints: it must not find its output closed.
    let printed: Vec<String> = lines
        .map_while(Result::ok)
        .take_while(|line| !line.starts_with("serving"))
        .collect();
    let address = move |endpoint: &str| {
        let mut addresses = printed.iter().filter_map(|line| line.split_once(' '));
        let found = addresses.find(|(name, _)| *name == endpoint);
        found.expect("an address").1.to_owned()
    };
    (served, address)
}

/// A folder with the group file of two robots, which will be written to.
pub fn copied_group(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(folder.join("groups")).unwrap();
    let group = "groups/tcc-2.toml";
    std::fs::copy(root().join(group), folder.join(group)).unwrap();
    folder
}
