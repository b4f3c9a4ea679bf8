//! The bridge: what clients may do, and the client in examples/.

mod common;

use std::io::{BufRead as _, BufReader, Lines, Write as _};
use std::net::TcpStream;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, Stdio};

use common::root;
use serde_json::{Value, json};

const BUS: &str = "sim:groups/tcc-2.toml";

/// No test's group is driven for longer, in s.
const LONGEST: f64 = 30.0;

fn bridge(arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .args(["bridge", "--bus", BUS])
        .args(arguments)
        .current_dir(root())
        .env_remove("OMNIBUS_BUS")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// A bridge on standard input and output.
struct Pipes {
    child: Child,
    input: ChildStdin,
    output: Lines<BufReader<ChildStdout>>,
}

impl Pipes {
    fn open(arguments: &[&str]) -> Self {
        let mut child = bridge(arguments);
        Self {
            input: child.stdin.take().unwrap(),
            output: BufReader::new(child.stdout.take().unwrap()).lines(),
            child,
        }
    }

    fn send(&mut self, message: &Value) {
        writeln!(self.input, "{message}").unwrap();
    }

    /// The next message for which `wanted` holds.
    fn until(&mut self, wanted: impl Fn(&Value) -> bool) -> Value {
        loop {
            let text = self.output.next().expect("the bridge has ended").unwrap();
            let message: Value = serde_json::from_str(&text).unwrap();
            let late = message["t"].as_f64().is_some_and(|t| t > LONGEST);
            assert!(
                !late && message["type"] != "refused" || wanted(&message),
                "{text}"
            );
            if wanted(&message) {
                return message;
            }
        }
    }

    fn refusal(&mut self) -> String {
        let refused = self.until(|m| m["type"] == "refused");
        refused["reason"].as_str().unwrap().to_owned()
    }
}

/// A bridge at a TCP port, and that port.
fn listening() -> (Child, String, BufReader<ChildStderr>) {
    let mut child = bridge(&["--listen", "tcp://127.0.0.1:0"]);
    let mut notes = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    notes.read_line(&mut line).unwrap();
    let address = line.trim().strip_prefix("the bridge is at tcp://").unwrap();
    (child, address.to_owned(), notes)
}

fn end(mut child: Child) {
    let id = child.id().to_string();
    let killed = Command::new("kill").args(["-INT", &id]).status().unwrap();
    assert!(killed.success());
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_velocity_is_followed_until_it_expires() {
    let mut pipes = Pipes::open(&[]);
    let welcome = pipes.until(|_| true);
    assert_eq!(welcome["type"], "welcome");
    assert_eq!(welcome["group"], "tcc-2");
    assert_eq!(welcome["robots"].as_array().unwrap().len(), 2);
    // Before the robots are ready nothing moves.
    pipes.send(&json!({"type": "twist", "vx": 0.2}));
    assert_eq!(pipes.refusal(), "send `start` first");
    pipes.send(&json!({"type": "start"}));
    pipes.until(|m| m["type"] == "state" && m["running"] == true);
    pipes.send(&json!({"type": "twist", "vx": 0.2, "vy": 0.1, "timeout": 0.5}));
    let vx = |m: &Value| m["group"]["command"]["vx"].as_f64().unwrap_or(-1.0);
    let first = pipes.until(|m| vx(m) > 0.0);
    assert!((vx(&first) - 0.2).abs() < 1e-6);
    let after = pipes.until(|m| vx(m) == 0.0);
    let lasted = after["t"].as_f64().unwrap() - first["t"].as_f64().unwrap();
    assert!(
        (lasted - 0.5).abs() < 0.011,
        "{lasted} s; one period more or less"
    );
    // The ramp's end: all of them stand and stay started.
    let still = pipes.until(|m| {
        let measured = &m["group"]["measured"];
        measured["vx"].as_f64().is_some_and(|vx| vx.abs() < 1e-3)
    });
    assert_eq!(still["running"], true);
    assert_eq!(still["robots"][0]["node"], 2);
    // Beyond the limits: refused, and what was asked before is over, too.
    pipes.send(&json!({"type": "twist", "vx": 0.2, "timeout": 1}));
    pipes.send(&json!({"type": "twist", "vx": 99}));
    assert!(pipes.refusal().contains("vx and vy ask for 99 m/s"));
    // The end of the input is the end.
    drop(pipes.input);
    assert!(pipes.child.wait().unwrap().success());
}

#[test]
fn what_is_no_message_ends_the_connection() {
    let (child, address, _notes) = listening();
    let long = format!("{{\"type\":\"{}\"}}", "x".repeat(2000));
    for (bad, why) in [
        ("GET / HTTP/1.1", ""),
        ("{}", "the field `type` is missing"),
        ("[1]", "a message is a JSON object"),
        (r#"{"type":"jump"}"#, "`type` is start, stop or twist"),
        (r#"{"type":"twist","vx":"0.1"}"#, "is not a number"),
        (
            r#"{"type":"twist","omega":null}"#,
            "omega: null is not a number",
        ),
        (
            r#"{"type":"twist","vx":1e300}"#,
            "vx: the number is too large",
        ),
        (
            r#"{"type":"twist","vx":0.1,"speed":1}"#,
            "unknown field `speed`",
        ),
        (r#"{"type":"stop","now":true}"#, "unknown field `now`"),
        (long.as_str(), "more than 1024 bytes"),
    ] {
        let mut stream = TcpStream::connect(&address).unwrap();
        writeln!(stream, "{bad}").unwrap();
        let lines: Vec<_> = BufReader::new(stream)
            .lines()
            .map_while(Result::ok)
            .collect();
        assert!(
            lines
                .iter()
                .any(|line| line.contains("not understood") && line.contains(why)),
            "{bad}: {lines:?}"
        );
    }
    end(child);
}

#[test]
fn one_client_drives_and_its_end_is_a_stop() {
    let (child, address, _notes) = listening();
    let connect = || {
        let stream = TcpStream::connect(&address).unwrap();
        let lines = BufReader::new(stream.try_clone().unwrap()).lines();
        (
            stream,
            lines.map(|line| serde_json::from_str::<Value>(&line.unwrap()).unwrap()),
        )
    };
    let (mut first, mut heard) = connect();
    writeln!(first, r#"{{"type":"start"}}"#).unwrap();
    assert!(heard.any(|m| m["running"] == true));
    let (mut second, mut seen) = connect();
    writeln!(second, r#"{{"type":"start"}}"#).unwrap();
    let refused = seen.find(|m| m["type"] == "refused").unwrap();
    assert_eq!(refused["reason"], "another client drives");
    drop((first, heard));
    assert!(seen.any(|m| m["type"] == "state" && m["running"] == false));
    end(child);
}

/// The example drives a metre and a little: 0.25 m/s for as long as its last velocity is good
/// (0.2 s) and it lags behind the states (half a second on a busy machine), and the ramp.
#[test]
fn the_example_drives_a_metre() {
    let (child, address, _notes) = listening();
    let output = Command::new("python3")
        .args(["examples/bridge_client.py", &address])
        .current_dir(root())
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let way: f64 = text.trim().strip_suffix(" m").unwrap().parse().unwrap();
    assert!((1.0..1.2).contains(&way), "{way}");
    end(child);
}

#[test]
#[cfg(unix)]
fn a_unix_socket_is_this_users_and_goes_with_the_bridge() {
    use std::os::unix::fs::PermissionsExt as _;
    use std::os::unix::net::UnixStream;
    let path = std::env::temp_dir().join(format!("omnibus-bridge-{}", std::process::id()));
    let mut child = bridge(&["--listen", &format!("unix:{}", path.display())]);
    let mut line = String::new();
    BufReader::new(child.stderr.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    assert!(line.contains("unix:"), "{line}");
    let stream = UnixStream::connect(&path).unwrap();
    let welcome = BufReader::new(stream).lines().next().unwrap().unwrap();
    assert!(welcome.contains("welcome"), "{welcome}");
    assert_eq!(
        std::fs::metadata(&path).unwrap().permissions().mode() & 0o777,
        0o600
    );
    end(child);
    assert!(!path.exists());
}

#[test]
fn other_machines_cannot_reach_it() {
    let refused = bridge(&["--listen", "tcp://0.0.0.0:0"])
        .wait_with_output()
        .unwrap();
    let error = String::from_utf8(refused.stderr).unwrap();
    assert!(error.contains("SSH tunnel"), "{error}");
    assert_eq!(refused.status.code(), Some(1));
}
