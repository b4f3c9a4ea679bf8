//! A group live in Foxglove: a client of its WebSocket protocol finds the channels and schemas of a
//! recording, and gets messages on them.

mod common;

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::process::{Command, Stdio};

use common::root;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

type Socket = WebSocket<tungstenite::stream::MaybeTlsStream<TcpStream>>;

/// The next text message as JSON.
fn line(socket: &mut Socket) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            return serde_json::from_str(text.as_str()).unwrap();
        }
    }
}

#[test]
fn foxglove_gets_the_channels_of_a_recording() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .args(["bridge", "--bus", "sim:groups/tcc-2.toml"])
        .args(["--foxglove", "127.0.0.1:0"])
        .current_dir(root())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut announced = String::new();
    let mut notes = BufReader::new(child.stderr.take().unwrap());
    notes.read_line(&mut announced).unwrap();
    let url = announced.trim().rsplit(' ').next().unwrap();
    let mut request = url.into_client_request().unwrap();
    let protocol = HeaderValue::from_static("foxglove.sdk.v1");
    request
        .headers_mut()
        .insert("Sec-WebSocket-Protocol", protocol);
    let (mut socket, _) = tungstenite::connect(request).unwrap();
    assert_eq!(line(&mut socket)["op"], "serverInfo");
    // Robots send heartbeats and are listened to: the group's channels come with their frames.
    let mut channels = BTreeMap::new();
    while !(channels.contains_key("/can") && channels.contains_key("/events")) {
        let message = line(&mut socket);
        if message["op"] != "advertise" {
            continue;
        }
        for channel in message["channels"].as_array().unwrap() {
            let topic = channel["topic"].as_str().unwrap().to_owned();
            channels.insert(topic, channel.clone());
        }
    }
    let can = &channels["/can"];
    assert_eq!(can["schemaName"], "omnibus.CanFrame");
    assert_eq!(can["encoding"], "json");
    assert_eq!(channels["/events"]["schemaName"], "foxglove.Log");
    let subscribe =
        json!({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": can["id"]}]});
    socket.send(Message::text(subscribe.to_string())).unwrap();
    // Opcode 1, subscription, time in ns, then the message.
    let frame = loop {
        if let Message::Binary(bytes) = socket.read().unwrap() {
            break bytes;
        }
    };
    assert_eq!(frame[..5], [1, 7, 0, 0, 0]);
    let frame: Value = serde_json::from_slice(&frame[13..]).unwrap();
    assert!(
        frame["name"].as_str().unwrap().starts_with("heartbeat"),
        "{frame}"
    );
    drop(child.stdin.take());
    child.wait().unwrap();
}
