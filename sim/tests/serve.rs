//! The `serve` command as a program beside it sees it: a TCP socket that speaks slcan.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// A running command; it ends with the test, however that ends.
struct Served(Child);

impl Drop for Served {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The command with these arguments, and the address it prints for slcan.
fn serve(arguments: &[&str]) -> (Served, String) {
    let group = format!("{}/../groups/tcc-2.toml", env!("CARGO_MANIFEST_DIR"));
    let mut served = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
        .args(["serve", &group, "--slcan-tcp", "127.0.0.1:0"])
        .args(arguments)
        .stdout(Stdio::piped())
        .spawn()
        .map(Served)
        .unwrap();
    let mut lines = BufReader::new(served.0.stdout.take().unwrap()).lines();
    let address = lines.next().unwrap().unwrap();
    assert_eq!(lines.next().unwrap().unwrap(), "serving tcc-2");
    let address = address.strip_prefix("slcan-tcp ").unwrap().to_owned();
    (served, address)
}

fn connect(address: &str) -> BufReader<TcpStream> {
    let stream = TcpStream::connect(address).unwrap();
    // Only so that a failure ends; nothing depends on how long anything takes.
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    BufReader::new(stream)
}

/// The next answer or frame, without its carriage return.
fn line(stream: &mut BufReader<TcpStream>) -> String {
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

#[test]
fn two_programs_and_two_robots_on_one_bus() {
    let (_served, address) = serve(&["--speed", "real"]);
    let (mut master, mut listener) = (connect(&address), connect(&address));
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
    // NMT: reset all nodes. The listener hears that, then both robots' boot-up.
    master.get_mut().write_all(b"O\rt00028100\r").unwrap();
    // Before that it may have heard them boot at power-on.
    while line(&mut listener) != "t00028100" {}
    let mut heard = Vec::new();
    while heard.len() < 2 {
        let frame = line(&mut listener);
        if ["t702100", "t703100"].contains(&frame.as_str()) {
            heard.push(frame);
        }
    }
    assert_eq!(heard, ["t702100", "t703100"]);
}

#[test]
fn bad_input_is_named() {
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
            .args(arguments)
            .output()
            .unwrap();
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let group = format!("{}/../groups/tcc-2.toml", env!("CARGO_MANIFEST_DIR"));
    assert_eq!(
        run(&["serve", &group, "--plant", "ice"]),
        "error: --plant ice: give table, contact or tcp://HOST:PORT\n"
    );
    assert!(run(&["serve", "no.toml"]).starts_with("error: no.toml: cannot be read ("));
}
