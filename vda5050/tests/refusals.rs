//! The table of refusals in docs/vda5050.md: every row is brought about under every version, and
//! what the state then says is what the page says (chapter 6.6.4 of 2.0, 6.1.4 of 3.0).

mod common;

use common::{act, driving, errors, last_state, order, send, standing, vehicle};
use omnibus_vda5050::message::state::OperatingMode;
use omnibus_vda5050::{Request, Seen, Topic, Vehicle, Version};
use serde_json::{Value, json};

/// A vehicle that drives order `a`: n0 to n3, of which n3 is the horizon.
fn under_way(version: Version) -> Vehicle {
    let mut vehicle = vehicle(version);
    send(&mut vehicle, &order("a", 0, 0, 4, 3));
    vehicle.see(driving(), 1_000);
    vehicle.requests();
    vehicle.outgoing();
    vehicle
}

/// A standing vehicle that was sent an order of three nodes with one value changed.
fn sent_with(version: Version, pointer: &str, key: &str, value: Value) -> Vehicle {
    let mut vehicle = vehicle(version);
    let mut changed = order("a", 0, 0, 3, 3);
    changed.pointer_mut(pointer).unwrap()[key] = value;
    send(&mut vehicle, &changed);
    vehicle
}

/// Brings about one row.
type Cause = fn(Version) -> Vehicle;

/// In the order of the page, each with words of its row.
const CAUSES: [(&str, Cause); 14] = [
    ("not JSON", |version| {
        let mut vehicle = vehicle(version);
        vehicle.receive(Topic::Order, b"{", 1_000);
        vehicle
    }),
    ("`zoneSetId`", |version| {
        sent_with(version, "", "zoneSetId", json!("z"))
    }),
    ("actions on nodes or edges", |version| {
        let pick = json!([{"actionId": "p", "actionType": "pick", "blockingType": "HARD"}]);
        sent_with(version, "/nodes/1", "actions", pick)
    }),
    ("another order", |version| {
        let mut vehicle = under_way(version);
        send(&mut vehicle, &order("b", 0, 0, 2, 2));
        vehicle
    }),
    ("by hand or by another program", |version| {
        let mut vehicle = vehicle(version);
        let mode = OperatingMode::Service;
        vehicle.see(Seen { mode, ..standing() }, 500);
        send(&mut vehicle, &order("a", 0, 0, 2, 2));
        vehicle
    }),
    ("an older update", |version| {
        let mut vehicle = under_way(version);
        send(&mut vehicle, &order("a", 2, 2, 3, 3));
        vehicle.requests();
        send(&mut vehicle, &order("a", 1, 2, 3, 3));
        vehicle
    }),
    ("the same update with other content", |version| {
        let mut vehicle = under_way(version);
        send(&mut vehicle, &order("a", 0, 0, 5, 3));
        // Where it is ignored there is no state to be looked at.
        vehicle.see(standing(), 2_000);
        vehicle
    }),
    ("does not begin at the last released node", |version| {
        let mut vehicle = under_way(version);
        send(&mut vehicle, &order("a", 1, 1, 3, 3));
        vehicle
    }),
    ("an update of a cancelled order", |version| {
        let mut vehicle = under_way(version);
        act(&mut vehicle, "c", "cancelOrder");
        vehicle.requests();
        send(&mut vehicle, &order("a", 1, 2, 3, 3));
        vehicle
    }),
    ("not on the first node", |version| {
        let mut vehicle = vehicle(version);
        send(&mut vehicle, &order("a", 0, 5, 2, 2));
        vehicle
    }),
    ("a curve that does not begin or end", |version| {
        let points = json!([{"x": 0, "y": 0}, {"x": 1, "y": 1}]);
        let curve = json!({"degree": 1, "knotVector": [0, 0, 1, 1], "controlPoints": points});
        sent_with(version, "/edges/0", "trajectory", curve)
    }),
    ("a node on another map", |version| {
        sent_with(version, "/nodes/1/nodePosition", "mapId", json!("cellar"))
    }),
    ("`cancelOrder` without an order", |version| {
        let mut vehicle = vehicle(version);
        act(&mut vehicle, "c", "cancelOrder");
        vehicle
    }),
    ("an instant action that a group does not have", |version| {
        let mut vehicle = vehicle(version);
        act(&mut vehicle, "c", "startCharging");
        vehicle
    }),
];

/// What the page says: why, and the error in 2.0 and 2.1, and in 3.0.
fn page() -> Vec<[String; 3]> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/vda5050.md");
    let text = std::fs::read_to_string(path).unwrap();
    let (_, section) = text.split_once("\n## Orders that are refused\n").unwrap();
    let (section, _) = section.split_once("\n## ").unwrap();
    let rows = section.lines().filter(|line| line.starts_with('|')).skip(2);
    rows.map(|row| {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let [why, two, three] = cells[..] else {
            panic!("{row}");
        };
        [why, two.trim_matches('`'), three.trim_matches('`')].map(str::to_owned)
    })
    .collect()
}

#[test]
fn every_row_of_the_page_is_what_a_vehicle_says_under_every_version() {
    let rows = page();
    assert_eq!(rows.len(), CAUSES.len());
    for ([why, two, three], (words, cause)) in rows.iter().zip(CAUSES) {
        assert!(why.contains(words), "{why:?} is not about {words:?}");
        for (version, wanted) in [
            (Version::V2_0, two),
            (Version::V2_1, two),
            (Version::V3_0, three),
        ] {
            let mut vehicle = cause(version);
            let drives = |request: &Request| matches!(request, Request::Drive { .. });
            assert!(!vehicle.requests().iter().any(drives), "{why}: it moves");
            let reported = errors(&last_state(&mut vehicle));
            let kinds: Vec<&str> = reported.iter().map(|(kind, _)| kind.as_str()).collect();
            match wanted.as_str() {
                "ignored" => assert!(kinds.is_empty(), "{why}, {version}: {kinds:?}"),
                wanted => assert_eq!(kinds, [wanted], "{why}, {version}"),
            }
            for (_, sentence) in reported {
                assert!(sentence.contains(' ') && sentence.len() > 20, "{sentence}");
            }
        }
    }
}
