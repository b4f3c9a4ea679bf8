//! Commands that put a robot into service: calibration, wheel test, motors.

use super::*;

#[test]
fn calibrate_and_undo() {
    let (path, bus) = own_group("calibrate");
    let before = std::fs::read_to_string(&path).unwrap();
    let few = ["--speeds", "0.5", "--rates", "0.5", "--repeats", "1"];
    let shown = [&["calibrate", "--bus", BUS, "--quiet"], &few[..]].concat();
    assert!(transcript(&shown).ends_with("exit code 0\n"), "quiet");
    let shown = [&["calibrate", "--bus", BUS], &few[..]].concat();
    check("calibrate", &masked(&transcript(&shown)));
    let written = [
        &["calibrate", "--bus", &bus, "--write", "--save", "--json"],
        &few[..],
    ]
    .concat();
    let found = json(&written);
    assert_eq!(found["group_file"], true);
    assert_eq!(found["saved"], true);
    assert!(!path.with_extension("calibration.jsonl").exists());
    assert_ne!(std::fs::read_to_string(&path).unwrap(), before);
    // Table 3: 483.2 mm/s of 500.
    let rows = found["outcomes"][0]["coefficients"].as_array().unwrap();
    let lateral = rows.iter().find(|r| r["motion"] == "sideways").unwrap();
    let coefficient = lateral["coefficient"].as_f64().unwrap();
    assert!((coefficient - 500.0 / 483.2).abs() < 1e-3, "{coefficient}");
    json(&["calibrate", "--undo", "--bus", &bus, "--json"]);
    assert_eq!(std::fs::read_to_string(&path).unwrap(), before);
    let mut text = transcript(&["calibrate", "--undo", "--bus", BUS]);
    text += &transcript(&["calibrate", "--save", "--bus", BUS]);
    text += &transcript(&["calibrate", "--speeds", "0", "--bus", BUS]);
    text += &transcript(&["calibrate", "--speeds", "3", "--bus", BUS]);
    text += &transcript(&["calibrate", "--plot", "found.pdf", "--bus", BUS]);
    text += &transcript(&["calibrate", "--bus", "slcan-tcp://127.0.0.1:1"]);
    check("calibrate-refused", &text);
    std::fs::remove_file(path).unwrap();
}

/// A file of parameters of which the end is missing, in the middle of a value.
#[test]
fn a_dump_that_was_cut_short_is_not_taken_for_a_whole_one() {
    let file = std::env::temp_dir().join(format!("omnibus-cut-{}.toml", std::process::id()));
    let name = &*file.to_string_lossy();
    let at = ["--node", "2", "--bus", BUS];
    let dumped = omnibus(&[&["param", "dump"], &at[..]].concat()).stdout;
    let whole = String::from_utf8(dumped).unwrap();
    let all = whole.lines().filter(|line| line.starts_with('"')).count();
    let (cut, _) = whole.split_once("53982  # Roller angle").unwrap();
    for (text, command, lacks, becomes) in [
        (cut, "load", all - 4, "remain as they are"),
        (cut, "diff", all - 4, "are not compared"),
        (&whole, "load", 0, ""),
    ] {
        std::fs::write(&file, text).unwrap();
        let ran = omnibus(&[&["param", command, name], &at[..]].concat());
        let note = format!("{name} lacks {lacks} of a robot's {all} parameters; those {becomes}\n");
        let notes = String::from_utf8(ran.stderr).unwrap();
        assert_eq!(notes.contains(&note), lacks > 0, "{command}: {notes}");
        assert_eq!(notes.contains(" lacks "), lacks > 0, "{command}: {notes}");
    }
    std::fs::remove_file(file).unwrap();
}

/// A person with a tape measure.
fn by_tape(mut answer: impl FnMut(usize, &str) -> String) -> std::process::Output {
    use std::io::{BufRead as _, BufReader, Write as _};
    use std::process::Stdio;
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .args(["calibrate", "--tape", "--bus", BUS, "--json"])
        .current_dir(common::root())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let errors = BufReader::new(child.stderr.take().unwrap());
    let mut asked = 0;
    for line in errors.lines() {
        let value: serde_json::Value = serde_json::from_str(&line.unwrap()).unwrap();
        let note = value["note"].as_str().unwrap_or_default();
        if note.starts_with("commanded") {
            writeln!(stdin, "{}", answer(asked, note)).unwrap();
            asked += 1;
        }
    }
    child.wait_with_output().unwrap()
}

/// What a question says was asked for.
fn asked_for(line: &str) -> Vec<f64> {
    let (asked, _) = line.split_once(';').unwrap();
    let numbers = asked.split(' ').filter(|word| word.starts_with(['+', '-']));
    numbers.map(|word| word.parse().unwrap()).collect()
}

#[test]
fn calibrate_by_tape() {
    // 3 % are lost sideways in the twelve straight motions; with the compensation in force,
    // nothing.
    let output = by_tape(|n, line| {
        let mut numbers = asked_for(line);
        let lateral = line.contains("to the left") && !line.contains("degrees");
        if n < 12 && lateral {
            *numbers.last_mut().unwrap() *= 0.97;
        }
        let words: Vec<_> = numbers.iter().map(f64::to_string).collect();
        words.join(" ")
    });
    assert_eq!(output.status.code(), Some(0));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    for row in found["outcomes"][0]["coefficients"].as_array().unwrap() {
        let want = if row["axis"] == "lateral" {
            1.0 / 0.97
        } else {
            1.0
        };
        let coefficient = row["coefficient"].as_f64().unwrap();
        // A question has the way to a millimetre and a tenth of a degree.
        assert!((coefficient - want).abs() < 3e-3, "{row}");
    }
}

#[test]
fn calibrate_without_an_answer_gives_nothing() {
    let output = by_tape(|_, _| String::new());
    assert_eq!(output.status.code(), Some(1));
    assert!(output.stdout.is_empty());
}

#[test]
fn wheel_test_and_blink() {
    let wheels = ["wheel-test", "--node", "2", "--bus", BUS];
    let mut text = transcript(&wheels);
    text += &transcript(&[&wheels[..], &["--wheels-free"]].concat());
    text += &transcript(&["blink", "--node", "3", "--for", "5", "--bus", BUS]);
    // The name it had before.
    text += &transcript(&["identify", "--node", "9", "--bus", BUS]);
    check("wheel-test", &text);
}

/// Ctrl-C while a question waits: the answer is not needed, the exit code says who wanted it, and
/// what was counted is shown.
#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_wheel_test_that_asks() {
    use std::io::{BufRead as _, BufReader, Read as _};
    use std::process::Stdio;
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .args([
            "wheel-test",
            "--node",
            "2",
            "--wheels-free",
            "--ask",
            "--bus",
            BUS,
        ])
        .current_dir(common::root())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    // To wait for a child closes its input, and the end of the input is another error.
    let input = child.stdin.take();
    let mut line = String::new();
    while !line.contains("what turned first?") {
        line.clear();
        assert_ne!(errors.read_line(&mut line).unwrap(), 0, "it asks");
    }
    let pid = child.id().to_string();
    let killed = std::process::Command::new("kill")
        .args(["-INT", &pid])
        .status();
    assert!(killed.unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    drop(input);
    let mut rest = String::new();
    errors.read_to_string(&mut rest).unwrap();
    assert!(rest.contains("stopped on request"), "{rest}");
    // The wheel that was turned is shown, and only that.
    let mut shown = String::new();
    let mut output = child.stdout.take().unwrap();
    output.read_to_string(&mut shown).unwrap();
    let row = |name: &str| shown.contains(&format!("│ {name}"));
    assert!(row("front left") && !row("front right"), "{shown}");
}

/// Encoders that are reversed, dead, or have lost a channel, found by what they count.
#[test]
fn wheel_test_names_broken_encoders() {
    let (path, bus) = own_group("wheels");
    let file = std::fs::read_to_string(&path).unwrap();
    for (kind, part) in [
        (
            "reversed",
            "backwards: if the wheel rolled the base forward first, swap A and B",
        ),
        ("dead", "no encoder counts"),
        ("one-channel", "no encoder counts"),
    ] {
        let fault = format!(
            "\n[[simulation.encoder_faults]]\nnode = 3\nwheel = \"rear-left\"\nkind = \"{kind}\"\n"
        );
        std::fs::write(&path, format!("{file}{fault}")).unwrap();
        let output = omnibus(&[
            "wheel-test",
            "--node",
            "3",
            "--wheels-free",
            "--json",
            "--bus",
            &bus,
        ]);
        assert_eq!(output.status.code(), Some(6), "{kind}");
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        for (n, wheel) in found["wheels"].as_array().unwrap().iter().enumerate() {
            match wheel["problem"].as_str() {
                Some(problem) => {
                    assert!(n == 2 && problem.contains(part), "{kind}: {problem}");
                }
                None => assert_ne!(n, 2, "{kind}"),
            }
        }
    }
    std::fs::remove_file(path).unwrap();
}

/// Motors and encoders that are mounted the other way round, both of one wheel and one of others.
#[test]
fn a_robot_drives_with_reversed_motors_and_encoders() {
    let (path, bus) = own_group("reversed");
    let file = std::fs::read_to_string(&path).unwrap();
    let directions =
        "[[robots]]\nmotor.directions = [1, -1, -1, 1]\nencoder.directions = [1, -1, 1, -1]\n";
    std::fs::write(&path, file.replacen("[[robots]]\n", directions, 1)).unwrap();
    let drive = ["drive", "--vx", "0.1", "--for", "2", "--bus", &bus];
    assert!(transcript(&drive).contains("moved 0.200 m ahead"));
    let test = ["wheel-test", "--node", "2", "--wheels-free", "--bus", &bus];
    assert!(transcript(&test).contains("All four wheels turn in the right direction"));
    std::fs::remove_file(path).unwrap();
}

#[test]
fn identify_motors() {
    let arguments = ["identify-motors", "--node", "2", "--bus", BUS];
    let mut text = transcript(&arguments);
    text += &transcript(&[&arguments[..], &["--wheels-free", "--accept", "--save"]].concat());
    text += &transcript(&[
        "identify-motors",
        "--node",
        "7",
        "--wheels-free",
        "--bus",
        BUS,
    ]);
    check("identify-motors", &masked(&text));
}

/// The commands under `path` that take `--node`, themselves included.
fn with_node(path: &[String], found: &mut Vec<Vec<String>>) {
    let mut call: Vec<&str> = path.iter().map(String::as_str).collect();
    call.push("--help");
    let help = String::from_utf8(omnibus(&call).stdout).unwrap();
    if help.contains("--node <NODE>") {
        found.push(path.to_vec());
    }
    let commands = help.split("\nCommands:\n").nth(1).unwrap_or_default();
    for line in commands.lines().take_while(|line| !line.is_empty()) {
        let name = line.split_whitespace().next().unwrap_or_default();
        // A line that goes on belongs to the command above it.
        if name != "help" && line.starts_with("  ") && !line.starts_with("   ") {
            with_node(&[path, &[name.to_owned()]].concat(), found);
        }
    }
}

/// No request goes to a node that cannot be a robot's, and no error sends its user to the plugs.
#[test]
fn a_node_that_no_robot_has_is_refused_first() {
    let mut commands = Vec::new();
    with_node(&[], &mut commands);
    assert!(commands.len() >= 15, "{commands:?}");
    for command in commands {
        for node in ["0", "1", "18", "128", "255", "256", "two"] {
            let mut call: Vec<&str> = command.iter().map(String::as_str).collect();
            call.extend(["--node", node]);
            let output = omnibus(&call);
            let text = String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(2), "{call:?}: {text}");
            assert!(
                text.contains("robots are nodes 2 to 17"),
                "{call:?}: {text}"
            );
        }
    }
}

/// Wheels that are said to be free do not make a drive on the floor, nor does a speed slow it.
#[test]
fn options_of_another_procedure_are_refused() {
    let calls = [
        "accept --level 3 --wheels-free",
        "accept --level 3 --speed 0.1",
        "accept --level 3 --node 2",
        "accept --level 3 --patience 9",
        "accept --level 2 --wheels-free --tape",
        "accept --level 2 --wheels-free --pose odometry",
        "calibrate --phase --speeds 0.2",
        "calibrate --phase --rates 0.2",
        "calibrate --phase --distance 0.2",
        "calibrate --phase --plot a.svg",
        "calibrate --phase --kept a.json",
        "calibrate --phase --write --save",
        "calibrate --undo --speeds 0.2",
        "calibrate --undo --plot a.svg",
        "calibrate --all --kept a.json",
    ];
    for call in calls {
        let words = format!("{call} --bus sim:groups/single-rollers.toml");
        let output = omnibus(&words.split(' ').collect::<Vec<_>>());
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{call}: {text}");
        assert!(output.stdout.is_empty(), "{call}");
        let option = call.split(' ').rfind(|word| word.starts_with("--"));
        assert!(text.contains(option.unwrap()), "{call}: {text}");
    }
}
