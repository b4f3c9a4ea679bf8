//! Each command against the simulator, and what it prints. The simulated bus is the same to the byte every
//! time, so the texts in `snapshots/` are what a user sees.

mod common;

use common::{check, omnibus, transcript};
use serde_json::Value;

const BUS: &str = "sim:groups/tcc-2.toml";

/// Runs, expects success, and reads the JSON.
fn json(arguments: &[&str]) -> Value {
    let output = omnibus(arguments);
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{errors}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn scan() {
    check("scan", &transcript(&["scan", "--bus", BUS]));
    let found = json(&["scan", "--bus", BUS, "--json"]);
    assert_eq!(found["nodes"][1]["node"], 3);
    assert_eq!(found["conflicts"], serde_json::json!([]));
}

#[test]
fn status() {
    check("status", &transcript(&["status", "--bus", BUS]));
    assert_eq!(
        json(&["status", "--json", "--bus", BUS])["robots"][0]["state"],
        "Unconfigured"
    );
}

#[test]
fn drive() {
    let arguments = ["drive", "--vx", "0.2", "--for", "1", "--bus", BUS];
    check("drive", &transcript(&arguments));
    // 1 s at 0.2 m/s, and what the ramps at both ends make of it: they cancel.
    let found = json(&[&arguments[..], &["--json"]].concat());
    let x = found["robots"][0]["x"].as_f64().unwrap();
    assert!((x - 0.2).abs() < 0.002, "{x}");
}

#[test]
fn drive_beyond_the_limits() {
    let arguments = ["drive", "--vx", "3", "--for", "1", "--bus", BUS];
    check("drive-too-fast", &transcript(&arguments));
}

#[test]
fn param_list() {
    check("param-list", &transcript(&["param", "list", "slip"]));
    assert!(
        json(&["param", "list", "--json"])["objects"]
            .as_array()
            .unwrap()
            .len()
            > 50
    );
}

#[test]
fn param_get_and_set() {
    let mut text = String::new();
    for arguments in [
        &["param", "get", "2000", "--node", "2", "--bus", BUS][..],
        &["param", "get", "sync timeout", "--node", "2", "--bus", BUS],
        &["param", "set", "2041:2", "60", "--node", "2", "--bus", BUS],
        &[
            "param", "set", "2041:2", "6000", "--node", "2", "--bus", BUS,
        ],
        &["param", "set", "2110:1", "1", "--node", "2", "--bus", BUS],
        &["param", "get", "2010:9", "--node", "2", "--bus", BUS],
        &["param", "get", "2000", "--node", "9", "--bus", BUS],
        &["param", "save", "--node", "2", "--bus", BUS],
        &["param", "restore", "--node", "2", "--bus", BUS],
    ] {
        text += &transcript(arguments);
    }
    check("param-get-set", &text);
}

/// A file goes out of a robot, compares with it, and into another.
#[test]
fn param_dump_diff_and_load() {
    let file = std::env::temp_dir().join(format!("omnibus-dump-{}.toml", std::process::id()));
    let name = file.to_string_lossy().into_owned();
    let output = omnibus(&[
        "param", "dump", "--node", "2", "--output", &name, "--bus", BUS,
    ]);
    assert!(output.status.success());
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(
        text.contains("\"2041:2\" = 50  # SYNC timeout, ms"),
        "{text}"
    );
    let same = omnibus(&["param", "diff", &name, "--bus", BUS]);
    assert_eq!(same.status.code(), Some(0));
    std::fs::write(&file, text.replace("\"2041:2\" = 50", "\"2041:2\" = 70")).unwrap();
    let other = omnibus(&["param", "diff", &name, "--bus", BUS]);
    assert_eq!(other.status.code(), Some(6));
    let said = String::from_utf8(other.stdout).unwrap();
    assert!(
        said.contains("SYNC timeout (2041:2) is 50, the file has 70"),
        "{said}"
    );
    let loaded = json(&[
        "param", "load", &name, "--node", "3", "--bus", BUS, "--json",
    ]);
    assert_eq!(
        loaded["written"],
        text.lines().filter(|l| l.starts_with('"')).count()
    );
    std::fs::remove_file(file).unwrap();
}

#[test]
fn group_commands() {
    let mut text = transcript(&["group", "check", "groups/tcc-2.toml"]);
    text += &transcript(&["group", "apply", "--bus", BUS, "--save"]);
    check("group", &text);
    let differ = omnibus(&["param", "diff", "--bus", BUS, "--node", "2"]);
    assert_eq!(
        differ.status.code(),
        Some(6),
        "freshly booted robots hold defaults"
    );
}

#[test]
fn lss() {
    let mut text = transcript(&["lss", "scan", "--bus", BUS]);
    for arguments in [
        &["lss", "set", "3", "--now", "2", "--bus", BUS][..],
        &["lss", "set", "40", "--now", "2", "--bus", BUS],
        &["lss", "set", "5", "--bus", BUS],
        &[
            "lss", "set", "5", "--now", "2", "--store", "--reset", "--bus", BUS,
        ],
    ] {
        text += &transcript(arguments);
    }
    check("lss", &text);
}

#[test]
fn bus_load() {
    check("bus-load", &transcript(&["bus-load", "--robots", "8"]));
    check(
        "bus-load-full",
        &transcript(&["bus-load", "--robots", "16", "--rate", "250"]),
    );
}

#[test]
fn completions_and_help() {
    let bash = omnibus(&["completions", "bash"]);
    let text = String::from_utf8(bash.stdout).unwrap();
    assert!(text.contains("bus-load") && text.contains("complete -F"));
    check("help", &transcript(&["--help"]));
    for command in [
        "scan", "status", "drive", "follow", "param", "group", "bus-load",
    ] {
        let help = String::from_utf8(omnibus(&[command, "--help"]).stdout).unwrap();
        assert!(help.contains("Example"), "{command} --help has no example");
    }
}

#[test]
fn quiet_says_nothing_and_json_errors_are_json() {
    let output = omnibus(&["scan", "--quiet", "--bus", BUS]);
    assert!(output.status.success() && output.stdout.is_empty() && output.stderr.is_empty());
    let output = omnibus(&[
        "param", "get", "2000", "--node", "9", "--bus", BUS, "--json",
    ]);
    let error: Value = serde_json::from_slice(&output.stderr).unwrap();
    assert_eq!(error["exit_code"], 4);
    assert!(error["error"].as_str().unwrap().contains("node 9"));
    assert_eq!(output.status.code(), Some(4));
}
