//! Each command against the simulator, and what it prints. The simulated bus is the same to the
//! byte every time, so the texts in `snapshots/` are what a user sees.

mod common;

use common::{check, omnibus, root, transcript};
use serde_json::Value;

#[path = "commands/commissioning.rs"]
mod commissioning;

const BUS: &str = "sim:groups/tcc-2.toml";

/// A text without its digits: what was measured is the simulator's affair, and other tests'.
/// Outside of tables, which stay aligned, it does not matter how many there are.
fn masked(text: &str) -> String {
    let digit = |c: char| if c.is_ascii_digit() { '#' } else { c };
    let line = |line: &str| {
        if line.starts_with("exit code") {
            return format!("{line}\n");
        }
        let mut line: String = line.chars().map(digit).collect();
        while !line.starts_with('│') && line.contains("##") {
            line = line.replace("##", "#");
        }
        line.replace("+#", "±#").replace("-#", "±#") + "\n"
    };
    text.lines().map(line).collect()
}

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
    let robot = &json(&["status", "--json", "--bus", BUS])["robots"][0];
    assert_eq!(robot["state"], "Unconfigured");
    // No divider is no 0 V.
    assert_eq!(robot["supply_v"], Value::Null);
    // Drives that have not been told otherwise report 30 degrees; bridges report none.
    for (bus, degrees) in [("sim:groups/c620.toml", 30.into()), (BUS, Value::Null)] {
        let found = json(&["status", "--json", "--bus", bus]);
        assert_eq!(found["robots"][0]["motor_temperature_c"], degrees, "{bus}");
    }
    let arguments = ["status", "--history", "--bus", BUS];
    check("status-history", &transcript(&arguments));
    let found = json(&[&arguments[..], &["--json"]].concat());
    let history = &found["robots"][1]["history"];
    assert_eq!(*history, serde_json::json!({"start": 1, "faults": []}));
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
        &["param", "get", "1005", "--node", "2", "--bus", BUS],
        &["param", "get", "1017", "--node", "2", "--bus", BUS],
        &["param", "get", "0x1008", "--node", "2", "--bus", BUS],
        &["param", "get", "1018:2", "--node", "2", "--bus", BUS],
        &["param", "get", "1FFF", "--node", "2", "--bus", BUS],
        &["param", "set", "1017", "50", "--node", "2", "--bus", BUS],
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
        text.contains("\"2041:2\" = 0  # SYNC timeout, ms"),
        "{text}"
    );
    let same = omnibus(&["param", "diff", &name, "--bus", BUS]);
    assert_eq!(same.status.code(), Some(0));
    std::fs::write(&file, text.replace("\"2041:2\" = 0 ", "\"2041:2\" = 70 ")).unwrap();
    let other = omnibus(&["param", "diff", &name, "--bus", BUS]);
    assert_eq!(other.status.code(), Some(6));
    let output = String::from_utf8(other.stdout).unwrap();
    assert!(
        output.contains("SYNC timeout (2041:2) is 0, the file has 70 ms\n"),
        "{output}"
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

/// From a ruler and a data sheet to a file that drives.
#[test]
fn a_group_of_ones_own() {
    let folder = std::env::temp_dir().join(format!("omnibus-own-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let (file, svg) = (path("own.toml"), path("own.svg"));
    let data = [
        "--robot=0.3,0",
        "--robot=-0.3,0,180",
        "--track",
        "0.30m",
        "--wheelbase",
        "260mm",
        "--wheel-diameter",
        "100mm",
        "--mass",
        "8kg",
        "--supply",
        "12V",
        "--no-load-speed",
        "330rpm",
        "--no-load-current",
        "0.2A",
        "--stall-torque",
        "14kg.cm",
        "--stall-current",
        "5.5A",
        "--counts",
        "64",
        "--gear-ratio",
        "30",
    ];
    let new = [&["group", "new", &file][..], &data].concat();
    let mut text = transcript(&["group", "new", &file]);
    text += &transcript(&new);
    text += &transcript(&new);
    text += &transcript(&["group", "check", &file]);
    text += &transcript(&["group", "draw", &file, "--output", &svg]);
    text += &transcript(&["group", "draw", &file, "--output", &path("own.png")]);
    let written = std::fs::read_to_string(&file).unwrap();
    text += &written;
    check(
        "group-new",
        &text.replace(&*folder.to_string_lossy(), "FOLDER"),
    );
    let drawn = json(&["group", "draw", &file, "--output", &svg, "--json"]);
    assert_eq!(drawn, serde_json::json!({"file": svg}));
    let drawing = std::fs::read_to_string(&svg).unwrap();
    assert_eq!(
        drawing.matches(" rotate(-180").count(),
        1,
        "node 3 faces back"
    );
    assert_eq!(drawing.matches("#475569").count(), 8, "wheels");
    // It drives, and as fast as its file says.
    let bus = format!("sim:{file}");
    let found = json(&[
        "drive", "--vx", "0.5", "--for", "2", "--json", "--bus", &bus,
    ]);
    let moved = found["moved"]["x"].as_f64().unwrap();
    assert!((moved - 1.0).abs() < 0.03, "{moved}");
    // And all that can be wrong with it is said at once.
    let broken = written
        .replace("half_track = 0.15", "half_track = 150")
        .replace("roller_angle_deg = 45", "roller_angle_deg = 0.785")
        .replace("linear_speed = ", "linear_speed = 5")
        .replace("node = 3", "node = 2")
        .replace("gear_ratio", "gear_ration");
    std::fs::write(&file, broken).unwrap();
    let output = transcript(&["group", "check", &file]);
    check(
        "group-check",
        &output.replace(&*folder.to_string_lossy(), "FOLDER"),
    );
    let checked = omnibus(&["group", "check", &file, "--json"]);
    let found: Value = serde_json::from_slice(&checked.stdout).unwrap();
    assert_eq!(found["problems"].as_array().unwrap().len(), 5);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_group_that_no_simulated_bus_takes_is_not_good() {
    let folder = std::env::temp_dir().join(format!("omnibus-tips-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("tips.toml").display().to_string();
    let text = std::fs::read_to_string(root().join("groups/single.toml")).unwrap();
    let text = text.replace("plant = \"table\"\ntables", "plant = \"contact\" #");
    assert!(text.contains("plant = \"contact\""), "{text}");
    let payload = |y: f64| format!("{text}\n[simulation.payload]\nmass = 400\ny = {y}\n");
    std::fs::write(&file, payload(0.8)).unwrap();
    let checked = omnibus(&["group", "check", &file, "--json"]);
    assert_eq!(checked.status.code(), Some(6));
    let found: Value = serde_json::from_slice(&checked.stdout).unwrap();
    let problem = found["problems"][0]["problem"].as_str().unwrap();
    assert!(
        problem.contains("simulation.payload: tips the group over"),
        "{problem}"
    );
    std::fs::write(&file, payload(0.2)).unwrap();
    assert_eq!(omnibus(&["group", "check", &file]).status.code(), Some(0));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn the_schema_of_group_files_is_printed() {
    let schema = omnibus(&["group", "schema"]);
    let schema: Value = serde_json::from_slice(&schema.stdout).unwrap();
    assert_eq!(schema["properties"]["group_id"]["maximum"], 255);
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
    // Without the commands that only some builds have.
    let help = transcript(&["--help"]);
    let usual = |line: &&str| {
        !["  vda5050 ", "  ros "]
            .iter()
            .any(|name| line.starts_with(name))
    };
    let usual: Vec<&str> = help.lines().filter(usual).collect();
    check("help", &usual.join("\n"));
    for command in [
        "scan",
        "status",
        "drive",
        "follow",
        "param",
        "group",
        "bus-load",
        "calibrate",
        "wheel-test",
        "blink",
        "identify-motors",
        "lss",
        "record",
        "convert",
        "replay",
        "plot",
        "report",
        "serve",
        "watch",
        "teleop",
        "completions",
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

/// A copy of a group file that a test may write to.
fn own_group(name: &str) -> (std::path::PathBuf, String) {
    let file = format!("omnibus-{name}-{}.toml", std::process::id());
    let path = std::env::temp_dir().join(file);
    std::fs::copy(common::root().join("groups/tcc-2.toml"), &path).unwrap();
    let bus = format!("sim:{}", path.display());
    (path, bus)
}

/// An end of the standard input is no Ctrl-C.
#[test]
fn a_question_that_nobody_can_answer_says_so() {
    for command in [
        &["calibrate", "--tape"][..],
        &["wheel-test", "--node", "2", "--wheels-free", "--ask"],
    ] {
        let output = omnibus(&[command, &["--bus", BUS]].concat());
        assert_eq!(output.status.code(), Some(1), "{command:?}");
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(text.contains("standard input ended"), "{text}");
    }
}

/// Tables fit a terminal of 80 columns, and none of their headings is broken for it; longer
/// sentences are the terminal's to wrap.
#[test]
fn every_table_fits_80_columns() {
    let folder = common::root().join("master/tests/snapshots");
    let mut tables = 0;
    for file in std::fs::read_dir(folder).unwrap() {
        let path = file.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        for line in text
            .lines()
            .filter(|line| line.starts_with(['┌', '│', '╞', '└']))
        {
            tables += 1;
            let width = line.chars().count();
            assert!(width <= 80, "{}: {width} columns: {line}", path.display());
        }
        for table in text.split('┌').skip(1) {
            let heading = table.lines().skip(1);
            let lines = heading.take_while(|line| !line.starts_with('╞')).count();
            assert_eq!(lines, 1, "{}:\n{table}", path.display());
        }
    }
    assert!(tables > 50);
    for arguments in [
        &["param", "list"][..],
        &["group", "show", "groups/tcc-3.toml"],
        &["status", "--history", "--bus", BUS],
    ] {
        let text = transcript(arguments);
        let widest = text.lines().skip(1).map(|line| line.chars().count()).max();
        assert!(widest.unwrap() <= 80, "{text}");
    }
}

#[test]
fn follow() {
    let arguments = ["follow", "circle", "--quick", "--bus", BUS];
    let text = transcript(&arguments);
    // How fast this machine is does not belong there.
    let fixed = |line: &&str| !line.contains("real time");
    let lines: Vec<_> = text.lines().filter(fixed).collect();
    check("follow", &masked(&(lines.join("\n") + "\n")));
    let mut text = transcript(&["follow", "square", "--bus", BUS]);
    text += &transcript(&["follow", "circle", "--speed", "3", "--bus", BUS]);
    text += &transcript(&["follow", "harmonic", "--repeats", "2", "--bus", BUS]);
    text += &transcript(&["follow", "turn", "--frame", "body", "--bus", BUS]);
    text += &transcript(&["follow", "missing.csv", "--bus", BUS]);
    text += &transcript(&["follow", "circle", "--bus", "sim:missing.toml"]);
    text += &transcript(&["follow", "circle", "--bus", "can0"]);
    let unreachable = ["follow", "circle", "--bus", "slcan-tcp://127.0.0.1:1"];
    for unused in [&[][..], &["--backend", "native"], &["--elf", "no.elf"]] {
        text += &transcript(&[&unreachable[..], unused].concat());
    }
    text += &transcript(&["follow", "circle", "--elf", "no.elf", "--bus", BUS]);
    check("follow-refused", &text);
    for quiet in [
        &["follow", "circle", "--quick", "--quiet", "--bus", BUS][..],
        &[
            "drive", "--vx", "0.1", "--for", "0.5", "--quiet", "--bus", BUS,
        ],
    ] {
        let output = omnibus(quiet);
        assert!(output.status.success() && output.stdout.is_empty() && output.stderr.is_empty());
    }
}

/// From a drive to a picture: what each step says.
#[test]
fn recordings() {
    let folder = std::env::temp_dir().join(format!("omnibus-said-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let (run, log, csv) = (file("run.mcap"), file("run.log"), file("run.csv"));
    let mut text = String::new();
    for arguments in [
        &[
            "drive", "--vx", "0.2", "--for", "0.5", "--record", &run, "--bus", BUS,
        ][..],
        &["convert", &run, "--to", "csv", "--output", &csv],
        &["convert", &run, "--to", "candump", "--output", &log],
        &["plot", &run],
        &["report", &run],
        &["plot", &run, "--output", "picture.pdf"],
        &["replay", &run, "--bus", BUS],
        &["replay", &run, "--drive", "--bus", BUS],
        &["record", &run, "--for", "0.5", "--bus", BUS],
        &["record", &run, "--bus", BUS],
        &["report", "missing.mcap"],
    ] {
        text += &transcript(arguments);
    }
    let text = text.replace(&*folder.to_string_lossy(), "FOLDER");
    check("recordings", &masked(&text));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn live_views_and_servers_say_what_they_need() {
    let mut text = transcript(&["watch", "--bus", BUS]);
    text += &transcript(&["teleop", "--bus", BUS]);
    text += &transcript(&["teleop", "--speed", "9", "--bus", BUS]);
    text += &transcript(&["watch"]);
    text += &transcript(&["serve", "--http", "0.0.0.0:0", "--bus", BUS]);
    text += &transcript(&["serve", "--http", "nowhere", "--bus", BUS]);
    text += &transcript(&["group", "show", "groups/missing.toml"]);
    check("live-refused", &text);
}

/// Limits that the wheels cannot follow, as in a file that was written for other motors.
#[test]
fn a_group_that_cannot_keep_up_says_so() {
    let (path, bus) = own_group("slow");
    let text = std::fs::read_to_string(&path).unwrap();
    let text = text.replace("max_wheel_rate = 22.0", "max_wheel_rate = 3.0");
    std::fs::write(&path, text).unwrap();
    let drive = ["drive", "--vx", "0.9", "--for", "2", "--bus", &bus];
    let output = transcript(&drive);
    // 3 rad/s x 0.1524 m = 0.457 m/s of 0.9 m/s; the compensation takes 0.2 %.
    assert!(
        output.contains("The group was slowed down to 51 % of the commanded velocity: "),
        "{output}"
    );
    let found = json(&[&drive[..], &["--json"]].concat());
    let scale = found["smallest_scale"].as_f64().unwrap();
    assert!((scale - 0.457 / 0.9).abs() < 0.01, "{scale}");
    let ahead = found["moved"]["x"].as_f64().unwrap();
    assert!(ahead > 0.7 && ahead < 1.0, "{ahead}");
    std::fs::remove_file(path).unwrap();
}

#[test]
fn a_dump_is_written_also_where_json_is_asked_for() {
    let path = std::env::temp_dir().join(format!("omnibus-dump-{}.toml", std::process::id()));
    let file = path.to_str().unwrap();
    json(&[
        "param", "dump", "--node", "2", "--output", file, "--json", "--bus", BUS,
    ]);
    assert!(std::fs::read_to_string(&path).unwrap().contains("node = 2"));
    std::fs::remove_file(path).unwrap();
}

/// What is wrong with the arguments, also when only a command can know, is exit code 2, and JSON
/// where JSON is asked for.
#[test]
fn wrong_usage_is_exit_code_2_and_json_where_asked_for() {
    let real = "slcan-tcp://127.0.0.1:1";
    let cases: [(&[&str], &str); 9] = [
        (&["drive", "--bus", BUS], "--for <SECONDS>"),
        (
            &["drive", "--vx", "0.1", "--for", "-1", "--bus", BUS],
            "give more than 0",
        ),
        (
            &["drive", "--vx", "0.1", "--for", "1", "--bus", real],
            "--group GROUP.toml is missing",
        ),
        (
            &["wheel-test", "--node", "2", "--bus", BUS],
            "--wheels-free",
        ),
        (&["bus-load", "--robots", "200"], "between 1 and 16"),
        (&["bus-load", "--robots", "1", "--gyros", "2"], "1 robots"),
        (&["reset", "--node", "1", "--bus", BUS], "2 to 17"),
        (&["reset", "--bus", BUS], "<--node <NODE>|--all>"),
        (&["update", "--bus", BUS], "<FILE|--rollback>"),
    ];
    for (arguments, part) in cases {
        let refused = |more: &[&str]| {
            let output = omnibus(&[arguments, more].concat());
            assert_eq!(output.status.code(), Some(2), "{arguments:?}");
            String::from_utf8(output.stderr).unwrap()
        };
        let text = refused(&[]);
        assert!(text.contains(part), "{text}");
        let object: Value = serde_json::from_str(&refused(&["--json"])).unwrap();
        let text = object["error"].as_str().unwrap();
        assert!(text.contains(part), "{text}");
        assert_eq!(object["exit_code"], 2);
    }
}

#[test]
fn objects_are_told_with_what_their_numbers_mean() {
    let get = |object: &str| omnibus(&["param", "get", object, "--node", "2", "--bus", BUS]);
    let text = String::from_utf8(get("2110:1").stdout).unwrap();
    assert_eq!(text, "State (2110:1) = 0 (Unconfigured)\n");
    let text = String::from_utf8(get("2122:1").stdout).unwrap();
    assert_eq!(text, "Newest (2122:1) = 0 (none)\n");
    let text = String::from_utf8(get("2010").stderr).unwrap();
    for part in ["2010:1 (Half track)", "2010:5"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    let set = ["param", "set", "2031:6", "a", "--node", "2", "--bus", BUS];
    let text = String::from_utf8(omnibus(&set).stderr).unwrap();
    assert!(text.contains("'a' is not a whole number"), "{text}");
}

#[test]
fn reset_names_the_robots_that_started_anew() {
    let refused = omnibus(&["reset", "--all", "--bus", BUS]);
    let text = String::from_utf8(refused.stdout).unwrap();
    assert_eq!(text, "nodes 2, 3 have restarted\n");
    let one = json(&["reset", "--node", "3", "--bus", BUS, "--json"]);
    assert_eq!(one["reset"], serde_json::json!([3]));
    let none = omnibus(&["reset", "--node", "9", "--bus", BUS]);
    assert_eq!(none.status.code(), Some(4));
}
