//! The calibration that docs/operating.md prints, word by word, on emulated robots: written, saved,
//! compared, and taken back. The page's own test (`operating.rs`) has native ones.
//!
//! Options that make it short are added, because two emulated robots take five minutes for the ten
//! of the whole calibration. Time in the served world
//! waits for the master, and poses carry that time, so nothing here depends on how busy this
//! machine is.

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;

use common::{Served, copied_group, root, serve_in};

/// What makes it short.
const SHORT: &str = " --speeds 0.25 --rates 0.5 --repeats 1 --distance 0.25";

/// The line of the page, its continuation joined.
fn documented() -> String {
    let page = std::fs::read_to_string(root().join("docs/operating.md")).unwrap();
    let page = page.replace("\\\n", "");
    let is_it = |line: &&str| {
        line.starts_with("omnibus calibrate --all") && line.contains("--write --save")
    };
    let line = page.lines().find(is_it).expect("the page has it");
    line.to_owned()
}

fn group(folder: &Path) -> PathBuf {
    folder.join("groups/tcc-2.toml")
}

/// Emulated robots in this folder, and the addresses of their bus and of their poses.
fn serve(folder: &Path) -> (Served, String, String) {
    let elf = std::env::var("OMNIBUS_ELF").expect("OMNIBUS_ELF names a release image");
    let robots = ["--backend", "emulator", "--elf", &elf];
    let poses = ["--pose-tcp", "127.0.0.1:0"];
    let (served, address) = serve_in(folder, &[&robots[..], &poses].concat());
    let bus = format!("lockstep://{}", address("lockstep"));
    (served, bus, address("pose-tcp"))
}

/// Runs a line and returns what it printed.
fn run(folder: &Path, bus: &str, line: &str) -> String {
    let began = std::time::Instant::now();
    let output = Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .args(line.split_whitespace().skip(1))
        .current_dir(folder)
        .env("OMNIBUS_BUS", bus)
        .output()
        .unwrap();
    println!("{:6.1} s  {line}", began.elapsed().as_secs_f32());
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{line}\n{printed}\n{errors}");
    printed
}

#[test]
fn the_documented_calibration_of_emulated_robots_is_written_and_saved() {
    let folder = copied_group("documented-calibration");
    let (_served, bus, poses) = serve(&folder);
    let original = std::fs::read_to_string(group(&folder)).unwrap();
    let line = documented().replace("127.0.0.1:7702", &poses);
    let printed = run(&folder, &bus, &(line + SHORT));
    assert!(
        printed.contains("--undo restores the previous values"),
        "{printed}"
    );
    let text = std::fs::read_to_string(group(&folder)).unwrap();
    assert!(text.contains("# From `omnibus calibrate`."), "{text}");
    assert!(folder.join("fit.html").exists());
    run(
        &folder,
        &bus,
        "omnibus param diff --group groups/tcc-2.toml",
    );
    // Robots that are switched off and on still hold it: it was saved.
    run(&folder, &bus, "omnibus reset --all");
    run(
        &folder,
        &bus,
        "omnibus param diff --group groups/tcc-2.toml",
    );
    // They held nothing before, and the file is as it was.
    run(
        &folder,
        &bus,
        "omnibus calibrate --undo --save --group groups/tcc-2.toml",
    );
    let undone = std::fs::read_to_string(group(&folder)).unwrap();
    assert_eq!(undone, original);
}
