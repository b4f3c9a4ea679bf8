//! docs/first-robot.md, run literally: every console line of it, in its order, on an emulated
//! NUCLEO with the release image; and what the page says one should see.
//!
//! A block of lines that cannot run here has a marker in front: `<!-- not run: REASON -->`. In the
//! others `--bus auto`, which looks for a USB device, becomes the address of the emulated robot's
//! port. Commands that read go through the pseudo terminal of the port, and are repeated while this
//! machine is too busy for the robot to be heard. Those that drive go through the same port in
//! lockstep, so that nothing here depends on how fast this machine is. `OMNIBUS_ELF` names the
//! image.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use common::{programs, root};

mod common;

/// How often a command that reads is repeated until the robot is heard.
const TRIES: usize = 20;

/// The commands of the page, each with its line.
fn commands(page: &str) -> Vec<(usize, String)> {
    let (mut runs, mut inside) = (true, false);
    let mut out = Vec::new();
    for (number, text) in (1..).zip(page.lines()) {
        match (inside, text) {
            (false, "```sh") => inside = true,
            (false, text) if text.starts_with("<!-- not run: ") => runs = false,
            (false, _) => {}
            (true, "```") => (inside, runs) = (false, true),
            (true, text) if runs => out.push((number, text.to_owned())),
            (true, _) => {}
        }
    }
    out
}

/// The simulator with an emulated robot, which ends with the test.
struct Nucleo {
    process: Child,
    /// What it says of its endpoint.
    endpoint: String,
}

impl Nucleo {
    fn serve(programs: &Path, endpoint: &[&str]) -> Self {
        let elf = std::env::var("OMNIBUS_ELF").expect("OMNIBUS_ELF names the firmware's image");
        let mut process = Command::new(programs.join("omnibus-sim"))
            .args(["serve", "groups/single.toml", "--backend", "emulator"])
            .args(["--elf", &elf, "--fault", "-"])
            .args(endpoint)
            .current_dir(root())
            .env_remove("OMNIBUS_SIM_SPEED")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let endpoint = lines.next().unwrap().unwrap();
        let nucleo = Self { process, endpoint };
        assert!(lines.any(|line| line.unwrap().starts_with("serving")));
        nucleo
    }

    fn inject(&mut self, fault: &str) {
        let input = self.process.stdin.as_mut().unwrap();
        writeln!(input, "node=2:{fault}").unwrap();
    }
}

impl Drop for Nucleo {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// A folder with what the page's commands find, and its programs.
struct Desk {
    folder: PathBuf,
    programs: &'static Path,
}

impl Desk {
    fn new(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(folder.join("groups")).unwrap();
        let group = root().join("groups/single.toml");
        std::fs::copy(&group, folder.join("groups/single.toml")).unwrap();
        // "Copy `groups/single.toml` and enter your motor's data": those of the emulated motors.
        std::fs::copy(&group, folder.join("my-robot.toml")).unwrap();
        Self {
            folder,
            programs: programs(),
        }
    }

    fn command(&self, line: &str, bus: &str) -> Command {
        let path = std::env::join_paths(
            std::iter::once(self.programs.to_owned())
                .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
        );
        let mut command = Command::new("bash");
        command
            .args(["-c", &format!("exec {line}")])
            .current_dir(&self.folder)
            .env("PATH", path.unwrap())
            .env("OMNIBUS_BUS", bus)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    fn run(&self, line: &str, bus: &str, input: &str) -> Output {
        let mut child = self.command(line, bus).spawn().unwrap();
        // A command that does not ask may have ended.
        let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
        child.wait_with_output().unwrap()
    }

    /// Runs a line until what it says has all of these words.
    fn run_until(&self, line: &str, bus: &str, words: &[&str]) -> String {
        let mut text = String::new();
        for _ in 0..TRIES {
            text = text_of(&self.run(line, bus, ""));
            if words.iter().all(|word| text.contains(word)) {
                return text;
            }
        }
        panic!("{line}: not {words:?} in {TRIES} tries:\n{text}")
    }
}

fn text_of(output: &Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    format!("{}{errors}", String::from_utf8_lossy(&output.stdout))
}

/// The address of the robot's port on a pseudo terminal.
fn terminal(folder: &Path) -> (String, String) {
    let path = folder.join("ttyACM0").display().to_string();
    (format!("slcan:{path}"), path)
}

#[test]
fn every_line_of_the_page_runs_in_its_order() {
    let page = std::fs::read_to_string(root().join("docs/first-robot.md")).unwrap();
    let desk = Desk::new("first-robot");
    let (bus, path) = terminal(&desk.folder);
    let mut at_terminal = Nucleo::serve(desk.programs, &["--cable", &path]);
    let in_lockstep = Nucleo::serve(
        desk.programs,
        &["--lockstep", "127.0.0.1:0@2", "--speed", "max"],
    );
    let address = in_lockstep.endpoint.strip_prefix("lockstep ").unwrap();
    let lockstep = format!("lockstep://{address}");
    let mut ran = Vec::new();
    for (number, line) in commands(&page) {
        let line = line.replace("--bus auto", &format!("--bus {bus}"));
        let what = line
            .split_whitespace()
            .nth(1)
            .unwrap_or_default()
            .to_owned();
        println!("docs/first-robot.md:{number}: {line}");
        match &*what {
            "scan" => _ = desk.run_until(&line, &bus, &["│ 2 ", "PRE-OP", " ms"]),
            "status" => {
                desk.run_until(&line, &bus, &["Unconfigured", "none"]);
                // "Pull the wire from PB12 and look again".
                at_terminal.inject("emergency-stop");
                desk.run_until(&line, &bus, &["EmergencyStop"]);
            }
            "wheel-test" | "drive" => {
                // Every wheel was seen to turn forward first.
                let output = desk.run(&line, &lockstep, "f\nf\nf\nf\n");
                let text = text_of(&output);
                assert_eq!(output.status.code(), Some(0), "{line}:\n{text}");
                if what == "wheel-test" {
                    assert!(text.contains("front left: what turned first?"), "{text}");
                    assert!(text.contains("in the right direction"), "{text}");
                }
            }
            _ => panic!("docs/first-robot.md:{number}: this test does not know what to expect"),
        }
        ran.push(what);
    }
    assert_eq!(ran, ["scan", "status", "wheel-test", "drive"]);
}

/// The page's last promise: a program whose cable is pulled says so and ends with 3; plugged in
/// again, the next one works.
#[test]
fn a_program_says_that_its_cable_is_gone() {
    let desk = Desk::new("cable-gone");
    let (bus, path) = terminal(&desk.folder);
    let mut nucleo = Nucleo::serve(desk.programs, &["--cable", &path]);
    let scan = "omnibus scan";
    desk.run_until(scan, &bus, &["│ 2 "]);
    for pulled in ["cable-cut", "cable-cut=open"] {
        let watch = "omnibus watch --json --group groups/single.toml";
        let mut child = desk.command(watch, &bus).spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        assert!(lines.next().is_some(), "it listens");
        nucleo.inject(pulled);
        // It has to be read, or the program waits for its reader.
        lines.for_each(drop);
        let output = child.wait_with_output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(errors.contains("the cable is gone"), "{pulled}: {errors}");
        assert_eq!(output.status.code(), Some(3), "{pulled}: {errors}");

        let output = desk.run(scan, &bus, "");
        assert_eq!(output.status.code(), Some(3), "{}", text_of(&output));
        nucleo.inject("cable-cut=off");
        desk.run_until(scan, &bus, &["│ 2 "]);
    }
}
