//! The `serve` command as a program beside it sees it: sockets, a terminal, signals.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::time::Duration;

/// A running command; it ends with the test, however that ends.
struct Served {
    child: Child,
    /// What it has printed before `serving`, by its first word.
    endpoints: Vec<(String, String)>,
    errors: BufReader<ChildStderr>,
    /// What it has said on standard error, as far as it was read.
    output: String,
}

impl Drop for Served {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn group() -> String {
    format!("{}/../groups/tcc-2.toml", env!("CARGO_MANIFEST_DIR"))
}

/// A name for a file of one test.
fn scratch(name: &str) -> String {
    format!("{}/{name}", env!("CARGO_TARGET_TMPDIR"))
}

impl Served {
    fn new(arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
            .args(["serve", &group()])
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let lines = lines.map(|line| line.unwrap());
        let endpoints = lines
            .take_while(|line| line != "serving tcc-2")
            .map(|line| {
                let (kind, place) = line.split_once(' ').unwrap();
                (kind.to_owned(), place.to_owned())
            })
            .collect();
        let errors = BufReader::new(child.stderr.take().unwrap());
        Self {
            child,
            endpoints,
            errors,
            output: String::new(),
        }
    }

    fn place(&self, kind: &str) -> &str {
        &self.endpoints.iter().find(|(k, _)| k == kind).unwrap().1
    }

    fn connect(&self, kind: &str) -> BufReader<TcpStream> {
        let stream = TcpStream::connect(self.place(kind)).unwrap();
        // Only so that a failure ends; nothing depends on how long anything takes.
        let patience = Some(Duration::from_secs(20));
        stream.set_read_timeout(patience).unwrap();
        BufReader::new(stream)
    }

    /// Ends it with this signal; what it has said on standard error.
    fn end(mut self, signal: &str) -> String {
        let pid = self.child.id().to_string();
        let sent = Command::new("kill").args([signal, &pid]).status().unwrap();
        assert!(sent.success());
        assert!(self.child.wait().unwrap().success());
        self.errors.read_to_string(&mut self.output).unwrap();
        std::mem::take(&mut self.output)
    }

    /// Waits until it says this on standard error.
    fn wait_for(&mut self, what: &str) {
        while !self.output.contains(what) {
            assert_ne!(
                self.errors.read_line(&mut self.output).unwrap(),
                0,
                "{what}"
            );
        }
    }
}

/// The next slcan answer or frame, without its carriage return.
fn line(stream: &mut impl Read) -> String {
    let mut line = String::new();
    let mut byte = [0];
    loop {
        stream.read_exact(&mut byte).unwrap();
        match byte[0] {
            b'\r' => return line,
            7 => return line + "\u{7}",
            other => line.push(char::from(other)),
        }
    }
}

/// The next of socketcand's texts.
fn bracket(stream: &mut impl BufRead) -> String {
    let mut text = Vec::new();
    stream.read_until(b'>', &mut text).unwrap();
    String::from_utf8(text).unwrap()
}

#[test]
fn two_programs_and_two_robots_on_one_bus() {
    let served = Served::new(&["--slcan-tcp", "127.0.0.1:0"]);
    let mut master = served.connect("slcan-tcp");
    let mut listener = served.connect("slcan-tcp");
    listener.get_mut().write_all(b"S8\rO\r").unwrap();
    assert_eq!(
        (line(&mut listener), line(&mut listener)),
        (String::new(), String::new())
    );
    master.get_mut().write_all(b"V\rt0002").unwrap();
    assert_eq!(line(&mut master), "V1013");
    // The channel is not open yet.
    master.get_mut().write_all(b"8100\r").unwrap();
    assert_eq!(line(&mut master), "\u{7}");
    // A heartbeat comes after the boot-up at power-on, so that one is over when both have said they
    // are pre-operational.
    for heartbeat in ["t70217F", "t70317F"] {
        while line(&mut listener) != heartbeat {}
    }
    // NMT: reset all nodes. The listener hears that, then both robots' boot-up.
    master.get_mut().write_all(b"O\rt00028100\r").unwrap();
    while line(&mut listener) != "t00028100" {}
    let mut received = Vec::new();
    while received.len() < 2 {
        let frame = line(&mut listener);
        if ["t702100", "t703100"].contains(&frame.as_str()) {
            received.push(frame);
        }
    }
    // Which of the two is first is a matter of their crystals.
    received.sort();
    assert_eq!(received, ["t702100", "t703100"]);
}

/// LAWICEL's `L` and `Z1`: what comes is heard, with its time in four digits; nothing can be sent.
#[test]
fn a_channel_that_only_listens_hears_with_time_stamps() {
    let served = Served::new(&["--slcan-tcp", "127.0.0.1:0"]);
    let mut client = served.connect("slcan-tcp");
    client.get_mut().write_all(b"S6\rZ1\rL\rt7E10\r").unwrap();
    // 500 kbit/s is not this bus's rate.
    assert_eq!(line(&mut client), "\u{7}");
    assert_eq!((line(&mut client), line(&mut client)), Default::default());
    let mut refused = false;
    let mut received = Vec::new();
    while received.len() < 2 || !refused {
        let text = line(&mut client);
        refused |= text == "\u{7}";
        if let Some(stamp) = text.strip_prefix("t70217F") {
            received.push(u16::from_str_radix(stamp, 16).unwrap());
            assert_eq!(stamp.len(), 4);
        }
    }
    // The heartbeat of a robot comes every 100 ms; its crystal may be off by less than 1 %.
    let between = (received[1] + 60_000 - received[0]) % 60_000;
    assert!((99..=101).contains(&between), "{received:?}");
}

#[test]
fn socketcand_and_slcan_share_the_bus() {
    let served = Served::new(&["--slcan-tcp", "127.0.0.1:0", "--socketcand", "127.0.0.1:0"]);
    let mut raw = served.connect("socketcand");
    assert_eq!(bracket(&mut raw), "< hi >");
    let mut send = |text: &str, wanted: &str| {
        raw.get_mut().write_all(text.as_bytes()).unwrap();
        assert_eq!(bracket(&mut raw), wanted, "{text}");
    };
    send("< rawmode >", "< error open a bus first >");
    send("< open can0 >", "< ok >");
    send("< add 1 0 123 1 00 >", "< error unknown command >");
    send("< echo >", "< echo >");
    send("< rawmode >", "< ok >");
    let mut slcan = served.connect("slcan-tcp");
    slcan.get_mut().write_all(b"O\r").unwrap();
    assert_eq!(line(&mut slcan), "");
    // An extended frame is no error of the bus: nothing is said about it.
    raw.get_mut().write_all(b"< send 000007EF 0 >").unwrap();
    let (sent, wanted) = (b"< send 7EF 2 e8 3 >", "t7EF2E803");
    raw.get_mut().write_all(sent).unwrap();
    while line(&mut slcan) != wanted {}
    slcan.get_mut().write_all(b"t7EE0\rt7EE1AB\r").unwrap();
    let mut received = Vec::new();
    while received.len() < 2 {
        let text = bracket(&mut raw);
        let words: Vec<&str> = text.split(' ').collect();
        assert_eq!((words[0], words[1]), ("<", "frame"), "{text}");
        // No client receives its own frames.
        assert_ne!(words[2], "7EF", "{text}");
        if words[2] == "7EE" {
            received.push(words[4..].join(" "));
        }
    }
    assert_eq!(received, [" >", "AB >"]);
}

#[test]
#[cfg(unix)]
fn a_terminal_speaks_slcan_until_the_end() {
    let (path, log) = (scratch("serve-pty"), scratch("serve-pty.log"));
    let served = Served::new(&["--pty", &path, "--log", &log]);
    assert_eq!(served.place("pty"), path);
    let open = || File::options().read(true).write(true).open(&path).unwrap();
    let mut first = open();
    first.write_all(b"t7E1000\r").unwrap();
    assert_eq!(line(&mut first), "\u{7}");
    drop(first);
    for name in ["7E1", "7E2"] {
        // Programs for adapters begin like this. What the one before has not read may come first.
        let mut terminal = open();
        terminal.write_all(b"C\rS8\rO\r").unwrap();
        let frame = format!("t{name}3010D7F\r");
        terminal.write_all(frame.as_bytes()).unwrap();
        while line(&mut terminal) != "z" {}
        // Nothing is echoed, so what comes is the robots'.
        assert!(line(&mut terminal).starts_with("t70"));
    }
    served.end("-INT");
    assert!(
        std::fs::symlink_metadata(&path).is_err(),
        "the link is gone"
    );
    let log = std::fs::read_to_string(log).unwrap();
    assert!(log.ends_with('\n'));
    for frame in ["7E1#010D7F", "7E2#010D7F"] {
        assert_eq!(log.matches(frame).count(), 1, "{frame}");
    }
}

/// The next five lines of a stream, and the milliseconds from each to the next.
fn samples(client: &mut impl BufRead) -> (Vec<serde_json::Value>, Vec<u64>) {
    let mut lines = Vec::new();
    let mut times: Vec<u64> = Vec::new();
    for _ in 0..5 {
        let mut text = String::new();
        client.read_line(&mut text).unwrap();
        let line: serde_json::Value = serde_json::from_str(&text).unwrap();
        times.push((line["t"].as_f64().unwrap() * 1e3).round() as u64);
        lines.push(line);
    }
    let steps = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    (lines, steps)
}

#[test]
fn poses_come_as_lines_of_json() {
    let served = Served::new(&["--pose-tcp", "127.0.0.1:0", "--pose-rate", "250"]);
    let mut clients = [served.connect("pose-tcp"), served.connect("pose-tcp")];
    for client in &mut clients {
        let (lines, steps) = samples(client);
        for line in lines {
            assert_eq!(line["group"]["x"], 0.0);
            assert_eq!(line["robots"][0]["node"], 2);
            // tcc-2: two robots in tandem, 1.2 m apart, the first in front.
            for (robot, x) in [(0, 0.6), (1, -0.6)] {
                let error = line["robots"][robot]["x"].as_f64().unwrap() - x;
                // A group file's numbers are f32.
                assert!(error.abs() < 1e-7, "{line}");
            }
        }
        assert_eq!(steps, [4; 4]);
    }
}

/// The group file has the usual gyro: 200 samples a second, a bias of 0.5 degrees/s and, at that
/// rate, noise of 0.05: six standard deviations are left to it. The robots stand.
#[test]
fn gyro_samples_come_as_lines_of_json() {
    let served = Served::new(&["--gyro-tcp", "127.0.0.1:0"]);
    let mut client = served.connect("gyro-tcp");
    let (lines, steps) = samples(&mut client);
    for line in lines {
        for (robot, node) in [(0, 2), (1, 3)] {
            let sample = &line["robots"][robot];
            assert_eq!(sample["node"], node);
            let error = sample["yaw_rate"].as_f64().unwrap().to_degrees() - 0.5;
            assert!(error.abs() < 0.3, "{line}");
        }
    }
    assert_eq!(steps, [5; 4]);
}

#[test]
fn faults_come_from_the_command_line_and_from_standard_input() {
    let mut served = Served::new(&[
        "--slcan-tcp",
        "127.0.0.1:0",
        "--fault",
        "t=0.05:node=2:power-off",
        "--fault",
        "-",
    ]);
    // By then both robots have booted, and nobody has heard it.
    served.wait_for("fault at 0.050000 s: node 2: power-off\n");
    let mut client = served.connect("slcan-tcp");
    client.get_mut().write_all(b"O\r").unwrap();
    let input = served.child.stdin.as_mut().unwrap();
    input
        .write_all(b"node=4:power-on\nnode=3:power-cycle\n")
        .unwrap();
    // Node 3 boots again; node 2 does when it is told to.
    while line(&mut client) != "t703100" {}
    input.write_all(b"node=2:power-on\n").unwrap();
    while line(&mut client) != "t702100" {}
    let output = served.end("-TERM");
    let lines: Vec<&str> = output.lines().collect();
    assert!(
        lines.contains(&"node=4:power-on: node: 4 is not in the group; give one of 2, 3"),
        "{output}"
    );
    let logged = |what: &str| lines.iter().any(|line| line.ends_with(what));
    assert!(
        logged(" s: node 3: power-cycle") && logged(" s: node 3: power-on"),
        "{output}"
    );
}

/// What one run has logged is played onto the bus of another, which says the same again. The second
/// world's robots are silent: they have no power.
#[test]
fn a_log_is_played_frame_by_frame() {
    let (first, second) = (scratch("serve-first.log"), scratch("serve-second.log"));
    let serve = |arguments: &[&str]| {
        let done = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
            .args(["serve", &group(), "--speed", "max", "--duration", "0.5"])
            .args(arguments)
            .output()
            .unwrap();
        assert!(done.status.success());
        String::from_utf8(done.stdout).unwrap()
    };
    serve(&["--log", &first]);
    let off = ["node=2:power-off", "node=3:power-off"];
    let output = serve(&[
        "--log", &second, "--replay", &first, "--fault", off[0], "--fault", off[1],
    ]);
    assert_eq!(
        output,
        format!("replay {first}: 12 frames\nserving tcc-2\n")
    );
    let [first, second] = [first, second].map(|path| std::fs::read_to_string(path).unwrap());
    let frames = |log: &str| -> Vec<String> {
        let words = log
            .lines()
            .map(|line| line.split(' ').nth(2).unwrap().to_owned());
        words.collect()
    };
    // Boot-up, a first heartbeat after 50 to 100 ms and one every 100 ms, of two robots.
    assert_eq!(frames(&first).len(), 12, "{first}");
    assert_eq!(frames(&first), frames(&second));
}

#[test]
fn bad_input_is_named() {
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
            .args(["serve", &group()])
            .args(arguments)
            .output()
            .unwrap();
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let occupied = scratch("serve-taken");
    std::fs::write(&occupied, "").unwrap();
    let occupied_link = format!(
        "error: --pty {occupied}: cannot make the link; give a path that does not exist yet"
    );
    for (arguments, wanted) in [
        (
            ["--plant", "ice"],
            "error: --plant ice: give table, contact or tcp://HOST:PORT\n",
        ),
        (
            ["--socketcand", "nowhere"],
            "error: cannot listen on nowhere; give a HOST:PORT of this computer that is free",
        ),
        (["--pty", &occupied], &occupied_link),
        (
            ["--socketcan", "no-such-can"],
            "error: --socketcan no-such-can: cannot be opened; create it with:",
        ),
        (
            ["--pose-rate", "250"],
            "error: the following required arguments were not provided:\n  --pose-tcp <ADDR>\n",
        ),
        (
            ["--pose-tcp=127.0.0.1:0", "--pose-rate=60"],
            "error: --pose-rate 60: give a divisor of 4000, for example 100 or 250\n",
        ),
        (
            ["--duration", "0"],
            "error: --duration 0.0: give more than 0 s and less than 1e9 s\n",
        ),
        (
            ["--fault", "node=2:explode"],
            "error: --fault node=2:explode: explode: is not an action; give one of",
        ),
        (
            ["--replay", "no.log"],
            "error: --replay no.log: cannot be read",
        ),
        (
            ["--elf", "no.elf"],
            "error: --elf no.elf: native robots run no image; add --backend emulator\n",
        ),
    ] {
        {
            let output = run(&arguments);
            assert!(output.starts_with(wanted), "{output}");
        }
    }
    let output = run(&["--backend", "emulator", "--elf", "no.elf"]);
    assert_eq!(
        output,
        "error: --elf no.elf: cannot be read (No such file or directory (os error 2)); `cargo \
         xtask size` builds the firmware\n"
    );
    let output = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
        .args(["serve", "no.toml"])
        .output()
        .unwrap();
    let output = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.starts_with("error: no.toml: cannot be read ("),
        "{output}"
    );
}

/// A log that would replace what the command reads is refused, and a command that is refused for
/// anything else has not emptied an older log.
#[test]
fn no_file_is_lost_to_a_log() {
    let [own, older, played] = ["own.toml", "older.log", "played.log"].map(scratch);
    std::fs::copy(group(), &own).unwrap();
    std::fs::write(&older, "older\n").unwrap();
    std::fs::write(&played, "(0.000000) can0 080#\n").unwrap();
    for (arguments, wanted) in [
        (
            ["--log", &own, "--duration", "1"],
            format!("error: --log {own}: this is the group file, which would be replaced;"),
        ),
        (
            ["--log", &played, "--replay", &played],
            format!("error: --log {played}: this is the log to replay, which would be replaced;"),
        ),
        (
            ["--log", &older, "--socketcand", "nowhere"],
            "error: cannot listen on nowhere;".to_owned(),
        ),
    ] {
        let files = [&own, &older, &played];
        let before = files.map(|file| std::fs::read(file).unwrap());
        let output = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
            .args(["serve", &own])
            .args(arguments)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1));
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(message.starts_with(&wanted), "{message}");
        let after = files.map(|file| std::fs::read(file).unwrap());
        assert!(before == after, "{arguments:?}");
    }
}

/// The world goes on though nothing reads what it says of itself.
#[test]
fn a_fault_without_a_reader_does_not_panic() {
    let log = scratch("unread.log");
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let ended = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
        .args(["serve", &group(), "--speed", "max", "--duration", "1"])
        .args(["--fault", "t=0.5:node=3:driver-fault", "--log", &log])
        .stderr(writer)
        .status();
    assert!(ended.unwrap().success());
    let log = std::fs::read_to_string(log).unwrap();
    let (last, _) = log.lines().last().unwrap().split_once(' ').unwrap();
    let last: f64 = last.trim_matches(['(', ')']).parse().unwrap();
    assert!(last > 0.9, "{last}");
}

/// Time goes as far as its only client waits, however long that takes, and stands otherwise.
/// A stopped process is what a busy computer makes of it: it learns of six SYNCs at once.
#[test]
fn frames_that_came_while_the_simulator_was_late_are_not_sent_all_at_once() {
    const PERIOD: Duration = Duration::from_millis(10);
    let log = scratch("late.log");
    let served = Served::new(&["--slcan-tcp", "127.0.0.1:0", "--log", &log]);
    let mut client = served.connect("slcan-tcp");
    client.get_mut().write_all(b"S8\rO\r").unwrap();
    let pid = served.child.id().to_string();
    let signal = |name: &str| Command::new("kill").args([name, &pid]).status().unwrap();
    std::thread::sleep(10 * PERIOD);
    assert!(signal("-STOP").success());
    for _ in 0..6 {
        client.get_mut().write_all(b"t0800\r").unwrap();
        std::thread::sleep(PERIOD);
    }
    assert!(signal("-CONT").success());
    std::thread::sleep(10 * PERIOD);
    served.end("-INT");
    let log = std::fs::read_to_string(log).unwrap();
    let times: Vec<f64> = log
        .lines()
        .filter(|line| line.contains(" 080#"))
        .map(|line| line[1..].split_once(')').unwrap().0.parse().unwrap())
        .collect();
    assert_eq!(times.len(), 6, "{log}");
    // Six in at least 60 ms: 10 ms apart, half of it for the stop itself and the clock's grain.
    for pair in times.windows(2) {
        assert!(pair[1] - pair[0] > 0.005, "{times:?}");
    }
}

#[test]
fn time_waits_for_a_lockstep_client() {
    let served = Served::new(&["--lockstep", "127.0.0.1:0", "--pose-tcp", "127.0.0.1:0"]);
    let mut client = served.connect("lockstep");
    let line = |client: &mut BufReader<TcpStream>| {
        let mut text = String::new();
        client.read_line(&mut text).unwrap();
        text.trim_end().to_owned()
    };
    assert_eq!(line(&mut client), "omnibus-lockstep 1");
    // The robots have booted; nobody has waited yet.
    assert_eq!(line(&mut client), "n100000");
    let mut poses = served.connect("pose-tcp");
    assert!(line(&mut poses).starts_with("{\"t\":0.1,"));
    // Half a second, of which the client hears everything that was said, in order, and its end.
    let (mut received, mut now) = (Vec::new(), 100_000);
    while now < 600_000 {
        client.get_mut().write_all(b"w600000\n").unwrap();
        loop {
            let text = line(&mut client);
            let (kind, rest) = text.split_at(1);
            let time = rest.split(' ').next().unwrap().parse::<u64>().unwrap();
            assert!((now..=600_000).contains(&time), "{text}");
            if kind == "n" {
                now = time;
                break;
            }
            received.push(text);
        }
    }
    assert_eq!(now, 600_000);
    assert!(
        !received.is_empty(),
        "two robots send heartbeats every 100 ms"
    );
    // It stands where it was left, also for another client.
    let mut other = served.connect("lockstep");
    assert_eq!(line(&mut other), "omnibus-lockstep 1");
    assert_eq!(line(&mut other), "n600000");
    // A frame that makes no sense ends the connection.
    other.get_mut().write_all(b"hello\n").unwrap();
    assert_eq!(line(&mut other), "");
    served.end("-INT");
}

/// Robots without an endpoint are a forgotten option.
#[test]
fn a_world_without_a_way_in_is_refused() {
    let done = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
        .args(["serve", &group()])
        .output()
        .unwrap();
    assert_eq!(done.status.code(), Some(1));
    let text = String::from_utf8(done.stderr).unwrap();
    assert!(text.contains("--lockstep"), "{text}");
}
