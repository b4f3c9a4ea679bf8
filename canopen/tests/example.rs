//! The device of the README does what the README says, reached as its reader would: over slcan on
//! TCP.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use canopen::client::{Outcome, SdoClient, SdoError};
use canopen::{AbortCode, Frame, Micros, NodeId};

/// How long anything may take on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

struct Example(Child);

impl Drop for Example {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts the example on a free port, and connects.
fn start() -> (Example, TcpStream) {
    let free = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = free.local_addr().expect("its address");
    drop(free);
    // Beside this test's folder, where cargo puts examples.
    let mut program = std::env::current_exe().expect("this test");
    program.pop();
    program.pop();
    let child = Command::new(program.join("examples/device"))
        .arg(address.to_string())
        .stdout(Stdio::piped())
        .spawn()
        .expect("cargo test builds the examples");
    let example = Example(child);
    let begin = Instant::now();
    loop {
        match TcpStream::connect(address) {
            Ok(stream) => return (example, stream),
            Err(error) if begin.elapsed() > PATIENCE => panic!("{error}"),
            Err(_) => std::thread::sleep(Duration::from_millis(10)),
        }
    }
}

/// The next frame, among the acknowledgements of those that were sent.
fn receive(stream: &mut TcpStream) -> Frame {
    loop {
        let mut line = Vec::new();
        let mut byte = [0];
        while byte != *b"\r" {
            stream.read_exact(&mut byte).expect("a byte in time");
            line.push(byte[0]);
        }
        let text = std::str::from_utf8(&line).expect("text").trim();
        if let Some(digits) = text.strip_prefix('t') {
            let id = u16::from_str_radix(&digits[..3], 16).expect("an identifier");
            let data: Vec<u8> = (4..digits.len())
                .step_by(2)
                .map(|at| u8::from_str_radix(&digits[at..at + 2], 16).expect("a byte"))
                .collect();
            return Frame::new(id, &data).expect("a frame");
        }
    }
}

/// Sends what the client asks until the transfer has ended.
fn finish(stream: &mut TcpStream, client: &mut SdoClient) -> Outcome {
    loop {
        while let Some(frame) = client.pop_frame() {
            let bytes: String = frame.data().iter().map(|b| format!("{b:02X}")).collect();
            let line = format!("t{:03X}{}{bytes}\r", frame.id(), frame.len());
            stream.write_all(line.as_bytes()).expect("the device reads");
        }
        if let Some(outcome) = client.on_frame(Micros::ZERO, &receive(stream)) {
            return outcome;
        }
    }
}

#[test]
fn the_lamp_obeys_and_refuses() {
    let (mut example, mut stream) = start();
    stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    let mut printed = BufReader::new(example.0.stdout.take().expect("its output"));
    let node = NodeId::new(5).expect("a node-ID");
    let mut client = SdoClient::new(node, Micros::MAX);
    let mut write = |value: &[u8]| {
        client
            .download(Micros::ZERO, 0x2000, 0, value)
            .expect("idle");
        finish(&mut stream, &mut client)
    };
    assert_eq!(write(&[50]), Outcome::Downloaded);
    let mut line = String::new();
    printed.read_line(&mut line).expect("a line");
    assert_eq!(line, "50 %\n");

    let refused = SdoError::Aborted(AbortCode::InvalidValue.code());
    assert_eq!(write(&[101]), Outcome::Failed(refused));

    client.upload(Micros::ZERO, 0x2000, 0).expect("idle");
    assert_eq!(finish(&mut stream, &mut client), Outcome::Uploaded);
    assert_eq!(client.data(), [50]);
}
