//! A long drive: its memory does not grow, and a full disk does not take its result away.
#![cfg(target_os = "linux")]

mod common;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use common::root;

/// A file of this test's own, which does not exist.
fn file(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("long_drives");
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join(name);
    let _ = std::fs::remove_file(&file);
    file
}

/// The largest resident memory of a recorded drive of two robots, in kB.
fn memory(seconds: u32) -> u64 {
    let record = file(&format!("{seconds}.mcap"));
    let mut child = Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .args(["drive", "--omega", "0.2", "--bus", "sim:groups/tcc-2.toml"])
        .args(["--for", &seconds.to_string(), "--record"])
        .arg(record)
        .current_dir(root())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut most = 0;
    while child.try_wait().unwrap().is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let now = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
        most = most.max(now.unwrap_or(0));
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(child.wait().unwrap().success());
    most
}

/// What may come with nine more minutes, in kB: the recording's index, 300 B a second, and noise
/// of the allocator. One row of two robots every 10 ms would be 10 000.
const GROWTH_KB: u64 = 2_000;

#[test]
fn memory_does_not_grow_with_a_drive() {
    let (one, ten) = (memory(60), memory(600));
    println!("1 minute: {one} kB, 10 minutes: {ten} kB");
    assert!(ten < one + GROWTH_KB, "{one} kB, then {ten} kB");
}

/// 200 blocks of 512 bytes is less than the drive's recording.
#[test]
fn a_full_disk_does_not_take_the_result_away() {
    let record = file("full.mcap");
    let script = "trap '' XFSZ; ulimit -f 200; exec \"$0\" \"$@\"";
    let output = Command::new("sh")
        .args(["-c", script, env!("CARGO_BIN_EXE_omnibus")])
        .args(["drive", "--vx", "0.2", "--for", "30"])
        .args(["--bus", "sim:groups/tcc-2.toml", "--record"])
        .arg(&record)
        .current_dir(root())
        .output()
        .unwrap();
    let (out, err) = (
        String::from_utf8(output.stdout).unwrap(),
        String::from_utf8(output.stderr).unwrap(),
    );
    assert!(out.contains("moved 6.000 m ahead"), "{out}{err}");
    assert_eq!(output.status.code(), Some(1));
    // Once when it happens, once as the reason for the exit code.
    assert_eq!(err.matches("File too large").count(), 2, "{err}");
    assert!(err.starts_with("warning: "), "{err}");
    let recording = omnibus::recording::read(&record).unwrap();
    assert!(recording.damage.is_some());
    assert!(recording.frames.len() > 1_000, "{}", recording.frames.len());
}
