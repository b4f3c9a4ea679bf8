//! A vehicle that stands at the origin of map `hall`, and orders for it.
#![allow(dead_code, reason = "every test file uses a part of it")]

use std::sync::LazyLock;

use kinematics::Pose;
use omnibus_vda5050::configuration::{Physics, Wheel};
use omnibus_vda5050::message::Identity;
use omnibus_vda5050::{Configuration, Outgoing, Request, Seen, Topic, Vehicle, Version};
use serde_json::{Value, json};

pub fn configuration(version: Version) -> Configuration {
    Configuration {
        identity: Identity {
            version,
            interface: "uagv".into(),
            manufacturer: "Omnibus".into(),
            serial: "tcc-3".into(),
        },
        map: "hall".into(),
        physics: Physics {
            series: "tcc-3".into(),
            speed: 2.0,
            turn: 1.0,
            acceleration: 2.4,
            outline: vec![[1.0, 0.5], [-1.0, 0.5], [-1.0, -0.5], [1.0, -0.5]],
            wheels: vec![Wheel {
                x: 0.5,
                y: 0.4,
                theta: 0.0,
                diameter: 0.3,
                width: 0.1,
            }],
        },
        height: 1.0,
        tolerance: 0.1,
        state_interval_ms: 30_000,
        visualization_interval_ms: 0,
    }
}

/// A connected vehicle at the origin, whose first messages have been taken. Property tests have a
/// hundred thousand of them: each is a copy of one that has sent its factsheet.
pub fn vehicle(version: Version) -> Vehicle {
    static CONNECTED: LazyLock<Vec<(Version, Vehicle)>> = LazyLock::new(|| {
        let connected = |version| {
            let mut vehicle = Vehicle::new(configuration(version));
            vehicle.connect(0);
            vehicle.see(standing(), 0);
            vehicle.outgoing();
            (version, vehicle)
        };
        [Version::V2_0, Version::V2_1, Version::V3_0]
            .map(connected)
            .into()
    });
    let mut all = CONNECTED.iter();
    all.find(|(of, _)| *of == version).unwrap().1.clone()
}

pub fn standing() -> Seen {
    Seen {
        pose: Some(Pose::new(0.0, 0.0, 0.0)),
        ..Seen::default()
    }
}

pub fn driving() -> Seen {
    Seen {
        driving: true,
        ..standing()
    }
}

/// Nodes n0, n1, ... along x, one metre apart, the first `released` of `count` released, numbered
/// from `first` on.
pub fn order(id: &str, update: u32, first: u32, count: u32, released: u32) -> Value {
    let nodes: Vec<Value> = (first..first + count)
        .map(|n| {
            json!({"nodeId": format!("n{n}"), "sequenceId": 2 * n, "released": n - first < released,
            "nodePosition": {"x": f64::from(n), "y": 0.0, "mapId": "hall"}, "actions": []})
        })
        .collect();
    let edges: Vec<Value> = (first..first + count - 1)
        .map(|n| {
            json!({"edgeId": format!("e{n}"), "sequenceId": 2 * n + 1,
            "released": n + 1 - first < released, "startNodeId": format!("n{n}"),
            "endNodeId": format!("n{}", n + 1), "actions": []})
        })
        .collect();
    json!({"headerId": 1, "timestamp": "2026-11-23T12:00:00.000Z", "version": "2.0.0",
        "manufacturer": "Omnibus", "serialNumber": "tcc-3", "orderId": id,
        "orderUpdateId": update, "nodes": nodes, "edges": edges})
}

pub fn send(vehicle: &mut Vehicle, order: &Value) {
    vehicle.receive(Topic::Order, order.to_string().as_bytes(), 1_000);
}

pub fn act_under(vehicle: &mut Vehicle, list: &str, id: &str, kind: &str, parameters: Value) {
    let message = json!({"headerId": 1, "timestamp": "2026-11-23T12:00:00.000Z",
        "version": "2.0.0", "manufacturer": "Omnibus", "serialNumber": "tcc-3",
        list: [{"actionId": id, "actionType": kind, "blockingType": "HARD",
            "actionParameters": parameters}]});
    vehicle.receive(Topic::InstantActions, message.to_string().as_bytes(), 1_000);
}

pub fn act(vehicle: &mut Vehicle, id: &str, kind: &str) {
    act_under(vehicle, "actions", id, kind, json!([]));
}

/// The states that were sent, oldest first.
pub fn states(vehicle: &mut Vehicle) -> Vec<Value> {
    let sent = vehicle.outgoing().into_iter();
    let states = sent.filter(|sent| sent.topic == Topic::State);
    states.map(|Outgoing { message, .. }| message).collect()
}

pub fn last_state(vehicle: &mut Vehicle) -> Value {
    states(vehicle).pop().expect("a state was sent")
}

pub fn node_ids(state: &Value) -> Vec<String> {
    let nodes = state["nodeStates"].as_array().unwrap();
    nodes
        .iter()
        .map(|node| node["nodeId"].as_str().unwrap().to_owned())
        .collect()
}

/// Type and sentence of every error.
pub fn errors(state: &Value) -> Vec<(String, String)> {
    let errors = state["errors"].as_array().unwrap();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    errors
        .iter()
        .map(|e| (text(&e["errorType"]), text(&e["errorDescription"])))
        .collect()
}

/// The only error, by type, with a word of its sentence.
pub fn is_refused(vehicle: &mut Vehicle, kind: &str, word: &str) {
    assert!(
        !vehicle
            .requests()
            .iter()
            .any(|request| matches!(request, Request::Drive { .. })),
        "nothing moves"
    );
    let state = last_state(vehicle);
    match errors(&state).as_slice() {
        [(is, sentence)] => {
            assert_eq!(is, kind, "{sentence}");
            assert!(sentence.contains(word), "{sentence}");
        }
        other => panic!("{other:?}"),
    }
}
