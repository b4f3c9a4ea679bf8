//! Our master's side against a foreign device: `sdo ADDRESS NODE`.
//!
//! Waits for the device's bus (slcan over TCP), then reads commands from standard input, one a
//! line, and answers each with one line: `read INDEX SUB`, `read-block INDEX SUB`, `write INDEX SUB
//! BYTES`, `write-block INDEX SUB BYTES`, all in hexadecimal. The answer is the bytes, `ok` or why
//! not. `nmt COMMAND` (start, stop, pre-operational, reset) sends a NMT command; `state` waits for
//! the next boot-up or heartbeat and answers with it, or with `silent` after ten seconds without
//! one.

mod slcan;

use canopen::client::{self, Outcome, SdoClient};
use canopen::{Micros, NmtCommand, NmtState, NmtTarget, NodeId};

fn bytes_of(text: &str) -> Option<Vec<u8>> {
    let pairs = (0..text.len()).step_by(2);
    pairs
        .map(|at| u8::from_str_radix(text.get(at..at + 2)?, 16).ok())
        .collect()
}

/// Starts what a line asks for; `None` if it makes no sense.
fn start(client: &mut SdoClient, now: Micros, line: &str) -> Option<()> {
    let mut words = line.split_whitespace();
    let command = words.next()?;
    let index = u16::from_str_radix(words.next()?, 16).ok()?;
    let sub = u8::from_str_radix(words.next()?, 16).ok()?;
    let data = bytes_of(words.next().unwrap_or(""))?;
    match command {
        "read" => client.upload(now, index, sub),
        "read-block" => client.upload_block(now, index, sub),
        "write" => client.download(now, index, sub, &data),
        "write-block" => client.download_block(now, index, sub, &data),
        _ => return None,
    }
    .ok()
}

/// Sends a NMT command; `None` if there is none of this name.
fn nmt(bus: &mut slcan::Slcan, node: NodeId, name: &str) -> Option<()> {
    let command = match name {
        "start" => NmtCommand::Start,
        "stop" => NmtCommand::Stop,
        "pre-operational" => NmtCommand::EnterPreOperational,
        "reset" => NmtCommand::ResetNode,
        _ => return None,
    };
    bus.send(&client::nmt(command, NmtTarget::Node(node)));
    Some(())
}

/// Waits for the device to say what state it is in.
fn state(bus: &mut slcan::Slcan, node: NodeId) -> &'static str {
    let end = bus.now() + Micros::from_millis(10_000);
    while bus.now() < end {
        let answer = bus
            .receive()
            .and_then(|frame| client::parse_heartbeat(&frame));
        match answer {
            Some((from, state)) if from == node => {
                return match state {
                    NmtState::Initialising => "boot-up",
                    NmtState::Stopped => "stopped",
                    NmtState::Operational => "operational",
                    NmtState::PreOperational => "pre-operational",
                };
            }
            _ => {}
        }
    }
    "silent"
}

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(2);
    let node = arguments.next().and_then(|node| node.parse().ok());
    let node = node.and_then(NodeId::new).unwrap_or(NodeId::MIN);
    let mut bus = slcan::Slcan::listen("127.0.0.1:29536")?;
    let mut client = SdoClient::new(node, Micros::from_millis(2_000));
    bus.wait_for_client();
    for line in std::io::stdin().lines() {
        let line = line?;
        if line == "state" {
            println!("{}", state(&mut bus, node));
            continue;
        }
        if let Some(name) = line.strip_prefix("nmt ") {
            let sent = nmt(&mut bus, node, name);
            println!("{}", sent.map_or("what?", |()| "ok"));
            continue;
        }
        if start(&mut client, bus.now(), &line).is_none() {
            println!("what?");
            continue;
        }
        let outcome = loop {
            while let Some(frame) = client.pop_frame() {
                bus.send(&frame);
            }
            let received = bus.receive();
            let outcome = received.and_then(|frame| client.on_frame(bus.now(), &frame));
            if let Some(outcome) = outcome.or_else(|| client.poll(bus.now())) {
                break outcome;
            }
        };
        while let Some(frame) = client.pop_frame() {
            bus.send(&frame);
        }
        match outcome {
            Outcome::Uploaded => {
                let digits: Vec<_> = client.data().iter().map(|b| format!("{b:02x}")).collect();
                println!("{}", digits.concat());
            }
            Outcome::Downloaded => println!("ok"),
            Outcome::Failed(error) => println!("{error}"),
        }
    }
    Ok(())
}
