//! Bad input to the `omnibus` command: it exits with 1, or with 2 where a call is wrong, names file
//! and field, and nothing moves.

use std::path::PathBuf;
use std::process::{Command, Output};

fn omnibus(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .args(arguments)
        .output()
        .unwrap()
}

/// A copy of the default group file with one piece of text replaced.
fn spoilt(name: &str, from: &str, to: &str) -> PathBuf {
    let good = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
    let text = std::fs::read_to_string(good).unwrap();
    assert!(text.contains(from), "the group file has no {from}");
    let path = std::env::temp_dir().join(format!("omnibus-{}-{name}.toml", std::process::id()));
    std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
    path
}

/// Tries to drive with a spoilt file; returns the message.
fn refusal(name: &str, from: &str, to: &str) -> String {
    let path = spoilt(name, from, to);
    let log = path.with_extension("log");
    let bus = format!("sim:{}", path.display());
    let log_name = log.to_string_lossy().into_owned();
    let output = omnibus(&[
        "follow",
        "figure-eight",
        "--quick",
        "--bus",
        &bus,
        "--candump",
        &log_name,
    ]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(output.stdout.is_empty(), "figures from a refused file");
    assert!(!log.exists(), "frames were sent for a refused file");
    let file = path.file_name().unwrap().to_string_lossy();
    assert!(message.contains(&*file), "{file} in {message}");
    std::fs::remove_file(path).unwrap();
    message
}

#[test]
fn an_unknown_key_is_named() {
    let message = refusal("unknown", "wheel_radius =", "wheel_radios =");
    assert!(message.contains("wheel_radios"), "{message}");
    assert!(message.contains("did you mean `wheel_radius`"), "{message}");
}

#[test]
fn a_zero_radius_is_named() {
    let message = refusal("radius", "wheel_radius = 0.1524", "wheel_radius = 0.0");
    assert!(message.contains("wheel_radius"), "{message}");
}

#[test]
fn two_robots_with_one_node_id_are_named() {
    let message = refusal("node", "node = 3", "node = 2");
    assert!(message.contains("node"), "{message}");
}

#[test]
fn a_nan_is_named() {
    let message = refusal("nan", "half_track = 0.370", "half_track = nan");
    assert!(message.contains("half_track"), "{message}");
}

#[test]
fn a_curve_too_fast_for_the_group_names_the_limit() {
    let path = spoilt("fast", "linear_speed = 2.0", "linear_speed = 1.0");
    let bus = format!("sim:{}", path.display());
    let output = omnibus(&["follow", "figure-eight", "--bus", &bus]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("limits.linear_speed"), "{message}");
    std::fs::remove_file(path).unwrap();
}

#[test]
fn a_bus_that_does_not_exist_says_what_to_check() {
    let group = "groups/tcc-3.toml";
    let arguments = [
        "scan",
        "--bus",
        "slcan:/dev/no-such-adapter",
        "--group",
        group,
    ];
    let output = omnibus(&arguments);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(message.contains("/dev/no-such-adapter"), "{message}");
    assert!(message.contains("dialout"), "{message}");
}

#[test]
fn usage_errors_exit_with_2() {
    for arguments in [
        &["follow", "hexagon", "--bus", "sim:groups/tcc-3.toml"][..],
        &["follow", "circle", "--bus", "can0"],
        &["follow", "circle"],
        &[
            "record",
            "none.mcap",
            "--for",
            "0",
            "--bus",
            "sim:groups/tcc-3.toml",
        ],
        &["drive", "--for", "0", "--bus", "sim:groups/tcc-3.toml"],
        // What is to be left out, misspelt, must not be tried instead.
        &[
            "accept",
            "--wheels-free",
            "--skip",
            "falt.14",
            "--bus",
            "sim:groups/tcc-3.toml",
        ],
        &[
            "accept",
            "--wheels-free",
            "--skip",
            "",
            "--bus",
            "sim:groups/tcc-3.toml",
        ],
        &["calibrate", "--save", "--bus", "sim:groups/tcc-3.toml"],
    ] {
        assert_eq!(omnibus(arguments).status.code(), Some(2), "{arguments:?}");
    }
}

/// A value that no bus and no group makes right is wrong usage, wherever it is looked at.
#[test]
fn values_out_of_range_are_usage_errors_too() {
    let bus = ["--bus", "sim:groups/tcc-2.toml"];
    let nowhere = ["--bus", "slcan:/dev/no-such-adapter"];
    for (option, arguments) in [
        ("--scale", &["follow", "circle", "--scale", "0"][..]),
        ("--speed", &["follow", "circle", "--speed", "-1"]),
        ("--ramp", &["follow", "circle", "--ramp", "0"]),
        ("--heading", &["follow", "circle", "--heading", "4000"]),
        ("--repeats", &["follow", "circle", "--repeats", "0"]),
        ("--rollers", &["calibrate", "--phase", "--rollers", "2"]),
        ("--without", &["calibrate", "--without", "0"]),
        ("--speed", &["watch", "--speed", "0"]),
        ("--turn", &["teleop", "--turn", "0"]),
        ("--http", &["serve", "--http", "nowhere"]),
        ("--speed", &["accept", "--wheels-free", "--speed", "0"]),
        ("lss", &["lss", "set", "1"]),
        ("--serial", &["lss", "set", "2", "--serial", "xyz"]),
        ("9999:1", &["param", "get", "9999:1", "--node", "2"]),
        ("2010:1", &["param", "set", "2010:1", "-1", "--node", "2"]),
        ("2010:1", &["param", "set", "2010:1", "x", "--node", "2"]),
        ("2001:1", &["param", "set", "2001:1", "1", "--node", "2"]),
    ] {
        let is_alone = ["lss", "param"].contains(&arguments[0]);
        let output = omnibus(&[arguments, if is_alone { &nowhere } else { &bus }].concat());
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        let named = option == "lss" || message.contains(option);
        assert!(named, "{arguments:?}: {message}");
    }
}

/// `nan` passes every comparison that it should fail, so each option has to refuse it by itself.
#[test]
fn an_option_that_is_no_number_is_named() {
    let commands: [(&[&str], &[&str]); 9] = [
        (&["drive", "--for", "1"], &["--vx", "--vy", "--omega"]),
        (&["drive", "--vx", "0.1"], &["--for"]),
        (
            &["follow", "circle", "--pose", "odometry"],
            &[
                "--ramp",
                "--scale",
                "--speed",
                "--heading",
                "--at",
                "--gain",
            ],
        ),
        (
            &["identify-motors", "--node", "2", "--wheels-free"],
            &["--rate", "--travel", "--bandwidth", "--damping"],
        ),
        (&["calibrate"], &["--speeds", "--rates", "--distance"]),
        (&["watch"], &["--speed", "--turn", "--for"]),
        (&["teleop"], &["--speed", "--turn", "--for"]),
        (&["bridge"], &["--rate"]),
        (&["record", "never-written.mcap"], &["--for"]),
    ];
    let bus = ["--bus", "sim:groups/tcc-2.toml"];
    for (command, options) in commands {
        for (option, value) in options
            .iter()
            .flat_map(|option| ["nan", "inf", "1e999", "1e300", "x"].map(|value| (*option, value)))
        {
            let text = match option {
                "--at" => format!("0,{value}"),
                _ => value.to_owned(),
            };
            let output = omnibus(&[command, &[option, &text], &bus].concat());
            let message = String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(2), "{option}: {message}");
            assert!(message.contains(option), "{option}: {message}");
            let says = match (option, value) {
                ("--at", _) => "give X,Y",
                (_, "1e999" | "1e300") => "is too large a number",
                _ => "is not a number",
            };
            assert!(message.contains(says), "{message}");
        }
    }
    assert!(!std::path::Path::new("never-written.mcap").exists());
}

/// Poses are f32: this far out they cannot say a millimetre.
#[test]
fn a_curve_too_far_from_zero_is_refused() {
    let bus = ["--bus", "sim:groups/tcc-2.toml"];
    let output = omnibus(&[&["follow", "circle", "--at", "0,20000"], &bus[..]].concat());
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(
        message.contains("--at") && message.contains("10000 m"),
        "{message}"
    );
}

#[test]
fn what_the_identification_would_refuse_is_refused_before_the_robot_is_asked() {
    let output = omnibus(&[
        "identify-motors",
        "--node",
        "2",
        "--wheels-free",
        "--rate",
        "1000",
        "--bus",
        "slcan:/dev/no-such-adapter",
        "--group",
        "groups/tcc-2.toml",
    ]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(
        message.contains("--rate: 1000 is not between 0.5 and 50 rad/s"),
        "{message}"
    );
}

/// An adapter on whose bus another master sends SYNC; returns what was sent to it.
fn bus_with_a_master() -> (String, std::thread::JoinHandle<Vec<u8>>) {
    use std::io::{Read as _, Write as _};
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.set_nonblocking(true).unwrap();
        let mut received = Vec::new();
        let mut counter = 0_u8;
        loop {
            let mut bytes = [0; 256];
            match stream.read(&mut bytes) {
                Ok(0) => return received,
                Ok(count) => {
                    received.extend(&bytes[..count]);
                    // Commands that an adapter acknowledges.
                    let ends = bytes[..count].iter().filter(|b| **b == b'\r').count();
                    if stream.write_all(&vec![b'\r'; ends]).is_err() {
                        return received;
                    }
                }
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {}
                Err(_) => return received,
            }
            counter = counter % 240 + 1;
            let _ = stream.write_all(format!("t0801{counter:02X}\r").as_bytes());
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    });
    (format!("slcan-tcp://{address}"), server)
}

/// Every command that takes robots refuses a bus that another master commands, and sends nothing.
#[test]
fn no_command_takes_robots_from_another_master() {
    let folder = folder_with_recording("another-master");
    let recording = folder.join("run.mcap");
    let recording = recording.to_str().unwrap();
    for command in [
        &["drive", "--vx", "0.1", "--for", "1"][..],
        &["follow", "circle"],
        &["group", "apply"],
        &["wheel-test", "--node", "2", "--wheels-free"],
        &["identify-motors", "--node", "2", "--wheels-free"],
        &["calibrate", "--tape"],
        &["lss", "set", "9", "--now", "3", "--reset"],
        &["replay", recording, "--drive"],
    ] {
        let (bus, server) = bus_with_a_master();
        let group = ["--bus", &bus, "--group", "groups/single.toml"];
        let output = omnibus(&[command, &group[..]].concat());
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(4), "{command:?}: {message}");
        assert!(
            message.contains("another master is on the bus (received: SYNC)"),
            "{message}"
        );
        let received = String::from_utf8(server.join().unwrap()).unwrap();
        assert!(
            !received.contains(['t', 'T']),
            "{command:?} sent {received:?}"
        );
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// A folder with a recording of half a second, `run.mcap`, and the group file of it, `group.toml`.
fn folder_with_recording(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("omnibus-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    let group = folder.join("group.toml");
    let of = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-2.toml");
    std::fs::copy(of, &group).unwrap();
    let bus = format!("sim:{}", group.display());
    let file = folder.join("run.mcap");
    let record = ["--record", file.to_str().unwrap(), "--bus", &bus];
    let output = omnibus(&[&["drive", "--vx", "0.1", "--for", "0.5"][..], &record].concat());
    assert!(output.status.success(), "{output:?}");
    folder
}

/// Files that a command reads stay as they are, whatever name they are given as an output.
#[test]
fn no_output_replaces_an_input() {
    let folder = folder_with_recording("outputs");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let (run, group) = (path("run.mcap"), path("group.toml"));
    let picture = path("run.svg");
    std::fs::copy(&run, &picture).unwrap();
    let bus = format!("sim:{group}");
    let dotted = format!("{}/./group.toml", folder.display());
    let linked = path("link");
    #[cfg(unix)]
    std::os::unix::fs::symlink(&group, &linked).unwrap();
    #[cfg(not(unix))]
    std::fs::hard_link(&dotted, &linked).unwrap();
    let drive = ["drive", "--vx", "0.1", "--for", "0.5", "--record"];
    let curve = ["follow", "circle", "--quick", "--bus", &bus];
    let before = [&run, &group, &picture].map(|file| std::fs::read(file).unwrap());
    for (option, arguments) in [
        (
            "--output",
            vec!["convert", &run, "--to", "csv", "--output", &run],
        ),
        (
            "--output",
            vec![
                "convert", &run, "--to", "csv", "--group", &group, "--output", &group,
            ],
        ),
        ("--output", vec!["report", &run, "--output", &run]),
        ("--output", vec!["plot", &picture]),
        ("--record", [&drive[..], &[&group, "--bus", &bus]].concat()),
        ("--record", [&drive[..], &[&dotted, "--bus", &bus]].concat()),
        ("--record", [&drive[..], &[&linked, "--bus", &bus]].concat()),
        ("--record", [&curve[..], &["--record", &group]].concat()),
        ("--report", [&curve[..], &["--report", &group]].concat()),
        ("FILE", vec!["record", &group, "--for", "1", "--bus", &bus]),
        (
            "--output",
            vec![
                "param", "dump", "--node", "2", "--output", &group, "--bus", &bus,
            ],
        ),
    ] {
        let output = omnibus(&arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        let expected = message.starts_with(&format!("error: {option} "))
            && message.contains("which would be replaced; give another file");
        assert!(expected, "{arguments:?}: {message}");
    }
    let after = [&run, &group, &picture].map(|file| std::fs::read(file).unwrap());
    assert!(before == after);
    std::fs::remove_dir_all(folder).unwrap();
}

/// A file without an end is refused before it fills the memory.
#[test]
#[cfg(target_os = "linux")]
fn a_file_without_an_end_is_refused() {
    const BUS: [&str; 2] = ["--bus", "sim:groups/tcc-2.toml"];
    for (call, rest, code, size) in [
        ("group check", &[][..], 6, "16 MiB"),
        ("group show", &[], 1, "16 MiB"),
        ("param load --node 2", &BUS, 1, "16 MiB"),
        ("unlock --key", &BUS, 1, "64 MiB"),
        ("update", &BUS, 1, "64 MiB"),
    ] {
        let arguments: Vec<&str> = call.split(' ').chain(["/dev/zero"]).collect();
        let output = omnibus(&[&arguments[..], rest].concat());
        let text = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        assert_eq!(output.status.code(), Some(code), "{call}: {text}");
        assert!(text.contains("/dev/zero"), "{call}: {text}");
        let expected = format!("(it is larger than {size}); give ");
        assert!(text.contains(&expected), "{call}: {text}");
    }
}

/// A script that cannot be written is an error, and a reader that has gone is none.
#[test]
#[cfg(target_os = "linux")]
fn completions_that_cannot_be_written_do_not_panic() {
    let run = |out: std::process::Stdio| {
        let output = Command::new(env!("CARGO_BIN_EXE_omnibus"))
            .args(["completions", "bash"])
            .stdout(out)
            .output()
            .unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        (output.status.code(), message)
    };
    let full = std::fs::File::options().write(true).open("/dev/full");
    let (code, message) = run(full.unwrap().into());
    assert_eq!(code, Some(1), "{message}");
    assert!(message.starts_with("error: No space left"), "{message}");
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    assert_eq!(run(writer.into()), (Some(0), String::new()));
}

/// The exit code is that of the error though nothing reads its message.
#[test]
fn an_error_without_a_reader_does_not_panic() {
    let nothing = ["group", "check", "no.toml"];
    for (arguments, code) in [(&nothing[..], 6), (&["status", "--bus", "nonsense"], 2)] {
        for form in [&[][..], &["--json"]] {
            let (reader, writer) = std::io::pipe().unwrap();
            drop(reader);
            let ended = Command::new(env!("CARGO_BIN_EXE_omnibus"))
                .args([arguments, form].concat())
                .stderr(writer)
                .status();
            assert_eq!(ended.unwrap().code(), Some(code), "{arguments:?} {form:?}");
        }
    }
}

#[test]
fn a_refusal_names_what_was_given_and_what_helps() {
    let key = std::env::temp_dir().join(format!("omnibus-{}.key", std::process::id()));
    std::fs::write(&key, [7; 32]).unwrap();
    let lock = [
        "lock",
        "--new",
        "--bus",
        "sim:groups/tcc-2.toml",
        "--set-key",
    ];
    for (arguments, code, part) in [
        (
            [&lock[..], &[key.to_str().unwrap()]].concat(),
            1,
            "(File exists (os error 17)); without --new this key is set",
        ),
        (
            vec!["group", "new", "never-written.toml", "--group-id", "300"],
            2,
            "300 is not in 1..=255",
        ),
        (vec!["plot", "."], 1, "error: .: cannot be read"),
    ] {
        let output = omnibus(&arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(message.contains(part), "{arguments:?}: {message}");
    }
    assert_eq!(std::fs::read(&key).unwrap(), [7; 32]);
    std::fs::remove_file(key).unwrap();
}

/// Every command that reads a file names the one that is not there, and says what to give.
#[test]
fn a_file_that_is_not_there_is_named_with_what_to_give_instead() {
    const BUS: [&str; 2] = ["--bus", "sim:groups/tcc-2.toml"];
    // The last word before the bus is the file.
    for (call, give) in [
        ("update", "cargo xtask release --out FILE"),
        ("lock --set-key", "omnibus lock --set-key FILE --new"),
        ("unlock --key", "omnibus lock --set-key FILE --new"),
        ("param load --node 2", "omnibus param dump"),
        ("serve --token-file", "a file with at least"),
        ("replay", "omnibus record"),
        ("follow", "a .csv file or the name of a curve"),
    ] {
        refuses_missing(call, &BUS, give);
    }
    for (call, give) in [
        ("plot", "omnibus record"),
        ("report", "omnibus record"),
        ("convert --to csv", "omnibus record"),
        ("group show", "the path of a group file"),
        ("group draw", "the path of a group file"),
        ("status --bus", "the path of a group file"),
    ] {
        refuses_missing(call, &[], give);
    }
}

fn refuses_missing(call: &str, rest: &[&str], give: &str) {
    let file = match call {
        "follow" => "nowhere/missing.csv",
        "status --bus" => "sim:nowhere/missing",
        _ => "nowhere/missing",
    };
    let arguments: Vec<&str> = call.split(' ').chain([file]).collect();
    let output = omnibus(&[&arguments[..], rest].concat());
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{call}: {message}");
    let file = file.trim_start_matches("sim:");
    assert!(message.contains(file), "{call}: {message}");
    let remedy = message.split_once("; give ").map(|(_, remedy)| remedy);
    assert!(
        remedy.is_some_and(|one| one.contains(give)),
        "{call}: {message}"
    );
}

/// And one that is there, but is no such file.
#[test]
fn a_file_of_another_kind_is_named_with_what_to_give_instead() {
    const BUS: [&str; 2] = ["--bus", "sim:groups/tcc-2.toml"];
    const RECORD: &str = "a file that `omnibus record` wrote";
    for (call, rest, code, give) in [
        ("update", &BUS[..], 1, "`cargo xtask release --out FILE`"),
        (
            "lock --set-key",
            &BUS,
            2,
            "`omnibus lock --set-key FILE --new`",
        ),
        (
            "unlock --key",
            &BUS,
            2,
            "`omnibus lock --set-key FILE --new`",
        ),
        ("param load --node 2", &BUS, 1, "`omnibus param dump`"),
        ("replay", &BUS, 1, RECORD),
        ("plot", &[], 1, RECORD),
        ("report", &[], 1, RECORD),
        ("convert --to csv", &[], 1, RECORD),
        ("group show", &[], 1, "fix the TOML here"),
    ] {
        let arguments: Vec<&str> = call.split(' ').chain(["README.md"]).collect();
        let output = omnibus(&[&arguments[..], rest].concat());
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{call}: {message}");
        assert!(
            message.starts_with("error: README.md:"),
            "{call}: {message}"
        );
        assert!(message.contains(give), "{call}: {message}");
    }
}

#[test]
fn the_usual_group_file_is_named_by_the_environment() {
    let run = |bus: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_omnibus"))
            .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
            .env("OMNIBUS_GROUP", "groups/none.toml")
            .args(["status", "--bus", bus])
            .output()
            .unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let (code, message) = run("slcan-tcp://127.0.0.1:9");
    assert!(
        code == Some(1) && message.contains("groups/none.toml"),
        "{message}"
    );
    let (code, message) = run("sim:groups/single.toml");
    assert_eq!(code, Some(0), "a simulated bus names its own: {message}");
}
