//! What is sent, in each version, and what may arrive.

mod common;

use std::sync::LazyLock;

use common::{act, act_under, configuration, driving, last_state, order, send, vehicle};
use omnibus_vda5050::message::{Connection, factsheet};
use omnibus_vda5050::{Topic, Vehicle, Version, time};
use proptest::prelude::*;
use serde_json::{Value, json};

const ALL: [Version; 3] = [Version::V2_0, Version::V2_1, Version::V3_0];

#[test]
fn time_stamps_are_those_of_the_calendar() {
    for (ms, text) in [
        (0, "1970-01-01T00:00:00.000Z"),
        (951_782_399_999, "2000-02-28T23:59:59.999Z"),
        (951_782_400_000, "2000-02-29T00:00:00.000Z"),
        (951_868_800_000, "2000-03-01T00:00:00.000Z"),
        (1_709_164_800_000, "2024-02-29T00:00:00.000Z"),
        (4_107_542_400_000, "2100-03-01T00:00:00.000Z"),
        (1_492_256_403_120, "2017-04-15T11:40:03.120Z"),
    ] {
        assert_eq!(time::stamp(ms), text);
    }
}

#[test]
fn topics_are_those_of_chapter_6_3_and_bad_levels_are_refused() {
    let mut identity = configuration(Version::V2_0).identity;
    assert_eq!(identity.topic("order"), "uagv/v2/Omnibus/tcc-3/order");
    assert_eq!(identity.check(), Ok(()));
    identity.version = Version::V3_0;
    assert_eq!(identity.topic("state"), "uagv/v3/Omnibus/tcc-3/state");
    identity.serial = "a/b".into();
    assert!(identity.check().unwrap_err().contains("--serial"));
    identity.serial = "a".into();
    identity.manufacturer = "a#".into();
    assert!(identity.check().unwrap_err().contains("--manufacturer"));
}

/// Required fields by the tables of chapter 6.10.6 (2.0, 2.1) and 7.7 (3.0).
#[test]
fn a_state_has_every_required_field_of_its_version() {
    let common = [
        "headerId",
        "timestamp",
        "version",
        "manufacturer",
        "serialNumber",
        "orderId",
        "orderUpdateId",
        "lastNodeId",
        "lastNodeSequenceId",
        "nodeStates",
        "edgeStates",
        "driving",
        "actionStates",
        "operatingMode",
        "errors",
        "safetyState",
    ];
    for version in ALL {
        let mut vehicle = vehicle(version);
        send(&mut vehicle, &order("a", 0, 0, 3, 2));
        let state = last_state(&mut vehicle);
        let own: &[&str] = if version == Version::V3_0 {
            &["instantActionStates", "powerSupply", "mobileRobotPosition"]
        } else {
            &["batteryState", "agvPosition"]
        };
        for key in common.iter().chain(own) {
            assert!(!state[key].is_null(), "{version}: {key}");
        }
        assert_eq!(state["version"], version.number());
        let (place, flag, stop) = if version == Version::V3_0 {
            ("mobileRobotPosition", "localized", "activeEmergencyStop")
        } else {
            ("agvPosition", "positionInitialized", "eStop")
        };
        assert_eq!(state[place][flag], true);
        assert_eq!(
            state["safetyState"],
            json!({stop: "NONE", "fieldViolation": false})
        );
    }
}

#[test]
fn headers_count_on_topic_by_topic_and_the_will_has_the_name_of_its_version() {
    let mut vehicle = vehicle(Version::V2_0);
    act(&mut vehicle, "s", "stateRequest");
    let first = last_state(&mut vehicle)["headerId"].as_u64().unwrap();
    act(&mut vehicle, "t", "stateRequest");
    assert_eq!(last_state(&mut vehicle)["headerId"], first + 1);
    for (version, name) in [
        (ALL[0], "CONNECTIONBROKEN"),
        (ALL[1], "CONNECTIONBROKEN"),
        (ALL[2], "CONNECTION_BROKEN"),
    ] {
        let will = configuration(version)
            .identity
            .connection(0, 0, Connection::Broken);
        assert_eq!(will["connectionState"], name);
    }
}

#[test]
fn the_factsheet_tells_the_groups_limits_and_outline() {
    let old = Value::Object(factsheet::body(&configuration(Version::V2_0)));
    assert_eq!(old["typeSpecification"]["agvKinematic"], "OMNI");
    assert_eq!(old["physicalParameters"]["speedMax"], 2.0);
    assert_eq!(old["physicalParameters"]["length"], 2.0);
    assert_eq!(old["physicalParameters"]["width"], 1.0);
    assert_eq!(old["agvGeometry"]["wheelDefinitions"][0]["type"], "MECANUM");
    let new = Value::Object(factsheet::body(&configuration(Version::V3_0)));
    assert_eq!(
        new["typeSpecification"]["mobileRobotKinematics"],
        "OMNIDIRECTIONAL"
    );
    assert_eq!(new["physicalParameters"]["maximumSpeed"], 2.0);
    assert_eq!(
        new["mobileRobotGeometry"]["envelopes2d"][0]["vertices"][0],
        json!({"x": 1.0, "y": 0.5})
    );
}

/// 3.0 renames fields of orders; both names are read in all versions.
#[test]
fn orders_of_3_0_are_read() {
    let mut vehicle = vehicle(Version::V3_0);
    let mut new = order("a", 0, 0, 2, 2);
    let edge = new["edges"][0].as_object_mut().unwrap();
    edge.remove("startNodeId");
    edge.remove("endNodeId");
    edge.insert("maximumSpeed".into(), json!(0.25));
    edge.insert("maximumRotationSpeed".into(), json!(0.5));
    edge.insert(
        "corridor".into(),
        json!({"leftWidth": 1.0, "rightWidth": 1.0}),
    );
    send(&mut vehicle, &new);
    let requests = vehicle.requests();
    let [omnibus_vda5050::Request::Drive { legs, .. }] = requests.as_slice() else {
        panic!("{requests:?}: {}", last_state(&mut vehicle));
    };
    assert_eq!(
        (legs[0].max_speed, legs[0].max_turn),
        (Some(0.25), Some(0.5))
    );
}

/// Texts of this pattern, which is parsed once.
fn text(pattern: &str) -> BoxedStrategy<String> {
    prop::string::string_regex(pattern).unwrap().boxed()
}

/// Any JSON.
fn any_json() -> impl Strategy<Value = Value> {
    let name = text("[a-zA-Z]{1,12}");
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        text("[a-z0-9é/#]{0,8}").prop_map(Value::from),
    ];
    leaf.prop_recursive(3, 24, 5, move |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..5).prop_map(Value::from),
            prop::collection::hash_map(name.clone(), inner, 0..5)
                .prop_map(|map| Value::Object(map.into_iter().collect())),
        ]
    })
}

/// The values in a value, itself among them.
fn count(value: &Value) -> usize {
    let inside: usize = match value {
        Value::Array(items) => items.iter().map(count).sum(),
        Value::Object(fields) => fields.values().map(count).sum(),
        _ => 0,
    };
    1 + inside
}

/// One of those, by its number from 0; past the last one what is left of the number.
fn place_mut(value: &mut Value, mut number: usize) -> Result<&mut Value, usize> {
    if number == 0 {
        return Ok(value);
    }
    number -= 1;
    let inside: Box<dyn Iterator<Item = &mut Value>> = match value {
        Value::Array(items) => Box::new(items.iter_mut()),
        Value::Object(fields) => Box::new(fields.values_mut()),
        _ => return Err(number),
    };
    for item in inside {
        match place_mut(item, number) {
            Err(left) => number = left,
            found => return found,
        }
    }
    Err(number)
}

/// Vehicles of each version that stand and that drive, their messages taken.
static STANDING_AND_DRIVING: LazyLock<[[Vehicle; 2]; 3]> = LazyLock::new(|| {
    ALL.map(|version| {
        [false, true].map(|busy| {
            let mut vehicle = vehicle(version);
            if busy {
                send(&mut vehicle, &order("a", 1, 0, 3, 2));
                vehicle.requests();
                vehicle.see(driving(), 1_000);
            }
            vehicle.outgoing();
            vehicle
        })
    })
});

/// Valid orders with these numbers of their update, with everything that an order can have.
static UPDATES: LazyLock<[Value; 3]> = LazyLock::new(|| {
    [0, 1, 2].map(|update| {
        let mut message = order("a", update, 1, 3, 2);
        message["edges"][0]["trajectory"] = json!({
            "degree": 2,
            "knotVector": [0, 0, 0, 1, 1, 1],
            "controlPoints": [{"x": 1, "y": 0}, {"x": 1.5, "y": 1, "weight": 2}, {"x": 2, "y": 0}],
        });
        message["edges"][0]["orientation"] = json!(0.5);
        message["actions"] = json!([{
            "actionId": "i",
            "actionType": "initPosition",
            "blockingType": "NONE",
            "actionParameters": [{"key": "x", "value": 1}],
        }]);
        message
    })
});

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 100_000,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// A valid order of which up to three places hold any JSON is accepted or refused, whatever
    /// the vehicle is doing, and what it then sends is a state.
    #[test]
    fn no_order_brings_the_vehicle_down(
        places in prop::collection::vec((any::<prop::sample::Index>(), any_json()), 1..4),
        version in 0_usize..3, busy in any::<bool>(), update in 0_usize..3,
        instant in any::<bool>(),
    ) {
        let mut vehicle = STANDING_AND_DRIVING[version][usize::from(busy)].clone();
        let mut message = UPDATES[update].clone();
        for (place, value) in places {
            let number = place.index(count(&message));
            *place_mut(&mut message, number).unwrap() = value;
        }
        let topic = if instant { Topic::InstantActions } else { Topic::Order };
        vehicle.receive(topic, message.to_string().as_bytes(), 2_000);
        vehicle.see(common::standing(), 3_000);
        act_under(&mut vehicle, "actions", "last", "stateRequest", json!([]));
        let state = last_state(&mut vehicle);
        prop_assert!(state["errors"].is_array());
        for request in vehicle.requests() {
            if let omnibus_vda5050::Request::Drive { legs, .. } = request {
                for pose in legs.iter().flat_map(|leg| &leg.poses) {
                    let all = [pose.x, pose.y, pose.heading];
                    prop_assert!(all.iter().all(|value| value.is_finite()));
                }
            }
        }
    }

    /// Any bytes.
    #[test]
    fn no_bytes_bring_the_vehicle_down(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
        let mut vehicle = vehicle(ALL[0]);
        vehicle.receive(Topic::Order, &bytes, 1_000);
        vehicle.receive(Topic::InstantActions, &bytes, 1_000);
        prop_assert!(!vehicle.is_busy());
    }
}
