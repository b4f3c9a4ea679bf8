//! Orders: acceptance, updates, rejections, cancellation, horizon. Chapters of VDA 5050 2.0.0.

mod common;

use common::{
    act, act_under, driving, errors, is_refused, last_state, node_ids, order, send, standing,
    states, vehicle,
};
use kinematics::Pose;
use omnibus_vda5050::message::state::OperatingMode;
use omnibus_vda5050::vehicle::MOST_WAITING;
use omnibus_vda5050::{Request, Seen, Topic, Vehicle, Version};
use serde_json::{Value, json};

const V2: Version = Version::V2_0;
const V3: Version = Version::V3_0;

fn drives(vehicle: &mut Vehicle) -> Vec<(usize, bool)> {
    let requests = vehicle.requests().into_iter();
    let drives = requests.filter_map(|request| match request {
        Request::Drive { legs, fresh } => Some((legs.len(), fresh)),
        _ => None,
    });
    drives.collect()
}

/// An accepted order of three released nodes and one in the horizon, on the way.
fn under_way(version: Version) -> Vehicle {
    let mut vehicle = vehicle(version);
    send(&mut vehicle, &order("a", 0, 0, 4, 3));
    assert_eq!(drives(&mut vehicle), [(2, true)]);
    vehicle.see(driving(), 1_000);
    vehicle.outgoing();
    vehicle
}

/// VDA5050#341: the vehicle stands on the first node, so it is not ahead of it.
#[test]
fn the_first_node_is_the_last_one_reached_and_not_among_those_ahead() {
    let mut vehicle = vehicle(V2);
    send(&mut vehicle, &order("a", 0, 0, 4, 3));
    let state = last_state(&mut vehicle);
    assert_eq!(node_ids(&state), ["n1", "n2", "n3"]);
    assert_eq!(state["lastNodeId"], "n0");
    assert_eq!(state["lastNodeSequenceId"], 0);
    assert_eq!(state["edgeStates"].as_array().unwrap().len(), 3);
    assert_eq!(state["orderId"], "a");
    assert_eq!(state["nodeStates"][2]["released"], false);
    // The base ends at n2: the horizon is not driven.
    let requests = vehicle.requests();
    let [Request::Drive { legs, fresh: true }] = requests.as_slice() else {
        panic!("{requests:?}");
    };
    let end = legs.last().unwrap().end().unwrap();
    assert_eq!((end.x, end.y), (2.0, 0.0));
    assert_eq!(legs.last().unwrap().arrives, Some(4));
}

/// openTCS#185: each node in a state of its own.
#[test]
fn nodes_and_edges_leave_the_state_one_by_one() {
    let mut vehicle = under_way(V2);
    vehicle.passed(2, 2_000);
    vehicle.passed(4, 2_000);
    let states = states(&mut vehicle);
    let seen: Vec<_> = states
        .iter()
        .map(|s| {
            (
                node_ids(s),
                s["edgeStates"].as_array().unwrap().len(),
                s["lastNodeId"].clone(),
            )
        })
        .collect();
    let nodes = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
    assert_eq!(
        seen,
        [
            (nodes(&["n2", "n3"]), 2, json!("n1")),
            (nodes(&["n3"]), 1, json!("n2"))
        ]
    );
    assert_eq!(states[1]["newBaseRequest"], true);
    vehicle.passed(2, 2_000);
    assert!(vehicle.outgoing().is_empty(), "a node is passed once");
}

#[test]
fn an_update_goes_on_at_the_last_released_node_and_replaces_the_horizon() {
    let mut vehicle = under_way(V2);
    send(&mut vehicle, &order("a", 1, 2, 4, 3));
    assert_eq!(drives(&mut vehicle), [(2, false)]);
    let state = last_state(&mut vehicle);
    assert_eq!(node_ids(&state), ["n1", "n2", "n3", "n4", "n5"]);
    assert_eq!(state["orderUpdateId"], 1);
    assert_eq!(state["nodeStates"][4]["released"], false);
    // The horizon is dropped by an update that has none.
    send(&mut vehicle, &order("a", 2, 4, 1, 1));
    assert_eq!(drives(&mut vehicle), []);
    assert_eq!(
        node_ids(&last_state(&mut vehicle)),
        ["n1", "n2", "n3", "n4"]
    );
}

/// Step 8 of figure 8: after the whole base has been driven.
#[test]
fn an_update_of_a_completed_order_goes_on_where_it_ended() {
    let mut vehicle = vehicle(V2);
    send(&mut vehicle, &order("a", 0, 0, 2, 2));
    vehicle.requests();
    vehicle.passed(2, 1_500);
    vehicle.see(standing(), 2_000);
    send(&mut vehicle, &order("a", 1, 1, 2, 2));
    assert_eq!(drives(&mut vehicle), [(1, false)]);
    assert_eq!(node_ids(&last_state(&mut vehicle)), ["n2"]);
}

#[test]
fn an_update_that_does_not_continue_is_refused_and_the_order_goes_on() {
    let mut vehicle = under_way(V2);
    send(&mut vehicle, &order("a", 1, 1, 3, 3));
    is_refused(&mut vehicle, "orderUpdateError", "begins at node n1");
    send(&mut vehicle, &order("a", 1, 2, 3, 3));
    let state = last_state(&mut vehicle);
    assert!(
        errors(&state).is_empty(),
        "an accepted order ends the warning"
    );
    assert_eq!(drives(&mut vehicle), [(2, false)]);
}

/// VDA5050#342 and 6.6.4.3.
#[test]
fn the_same_update_twice_is_ignored_and_an_older_one_refused() {
    let mut vehicle = under_way(V2);
    send(&mut vehicle, &order("a", 0, 0, 4, 3));
    assert!(vehicle.outgoing().is_empty() && vehicle.requests().is_empty());
    // In 2.0 that holds whatever it says.
    send(&mut vehicle, &order("a", 0, 0, 5, 3));
    assert!(vehicle.outgoing().is_empty() && vehicle.requests().is_empty());
    send(&mut vehicle, &order("a", 2, 2, 3, 3));
    vehicle.requests();
    vehicle.outgoing();
    send(&mut vehicle, &order("a", 1, 2, 3, 3));
    is_refused(&mut vehicle, "orderUpdateError", "older than update 2");
}

#[test]
fn in_3_0_the_same_update_with_other_content_is_an_error() {
    let mut vehicle = under_way(V3);
    send(&mut vehicle, &order("a", 0, 0, 4, 3));
    assert!(vehicle.outgoing().is_empty() && vehicle.requests().is_empty());
    send(&mut vehicle, &order("a", 0, 0, 5, 3));
    is_refused(&mut vehicle, "SAME_ORDER_UPDATE_ID", "other content");
}

#[test]
fn another_order_waits_for_the_end_of_the_first() {
    for (version, kind) in [(V2, "orderError"), (V3, "OTHER_ORDER_ACTIVE")] {
        let mut vehicle = under_way(version);
        send(&mut vehicle, &order("b", 0, 0, 2, 2));
        is_refused(&mut vehicle, kind, "order a is being executed");
    }
}

#[test]
fn an_order_begins_where_the_vehicle_stands() {
    for (version, kind) in [(V2, "noRouteError"), (V3, "START_NODE_OUT_OF_RANGE")] {
        let mut vehicle = vehicle(version);
        send(&mut vehicle, &order("a", 0, 3, 2, 2));
        is_refused(&mut vehicle, kind, "3.00 m from node n3");
        // 6.6.3.1: a deviation that is large enough.
        let mut far = order("a", 0, 3, 2, 2);
        far["nodes"][0]["nodePosition"]["allowedDeviationXY"] = json!(3.5);
        send(&mut vehicle, &far);
        assert_eq!(drives(&mut vehicle), [(1, true)]);
    }
    let mut lost = common::vehicle(V2);
    lost.see(Seen::default(), 500);
    send(&mut lost, &order("a", 0, 0, 2, 2));
    is_refused(&mut lost, "noRouteError", "send initPosition");
}

#[test]
fn an_ellipse_is_a_deviation_in_3_0() {
    let mut vehicle = vehicle(V3);
    let mut beside = order("a", 0, 1, 2, 2);
    // 1 m behind the node: within the ellipse along x, not within the one along y.
    beside["nodes"][0]["nodePosition"]["allowedDeviationXY"] =
        json!({"a": 1.2, "b": 0.2, "theta": std::f64::consts::FRAC_PI_2});
    send(&mut vehicle, &beside);
    is_refused(&mut vehicle, "START_NODE_OUT_OF_RANGE", "1.00 m");
    beside["nodes"][0]["nodePosition"]["allowedDeviationXY"]["theta"] = json!(0.0);
    send(&mut vehicle, &beside);
    assert_eq!(drives(&mut vehicle), [(1, true)]);
}

#[test]
fn what_is_malformed_is_refused_with_its_field() {
    let cases: [(&str, Value, &str); 14] = [
        ("/nodes", json!([]), "at least one node"),
        ("/edges", json!([]), "one edge fewer"),
        ("/nodes/0/released", json!(false), "is not released"),
        ("/nodes/1/released", json!(false), "one of its nodes is not"),
        ("/edges/0/released", json!(false), "the edge to it is not"),
        (
            "/nodes/1/sequenceId",
            json!(7),
            "node n1 has 7 where 2 follows",
        ),
        (
            "/edges/1/sequenceId",
            json!(1),
            "edge e1 has 1 where 3 follows",
        ),
        ("/edges/0/endNodeId", json!("n7"), "names n7"),
        ("/edges/0/startNodeId", Value::Null, "startNodeId"),
        (
            "/nodes/1/nodePosition/x",
            json!("one"),
            "nodes[1].nodePosition.x",
        ),
        ("/nodes/1/nodePosition/x", json!(1e300), "1000 km"),
        (
            "/nodes/1/nodePosition/mapId",
            Value::Null,
            "nodes[1].nodePosition",
        ),
        ("/orderUpdateId", json!(-1), "orderUpdateId"),
        ("/serialNumber", json!("other"), "is for Omnibus other"),
    ];
    for (pointer, value, word) in cases {
        let mut vehicle = vehicle(V2);
        let mut bad = order("a", 0, 0, 3, 3);
        *bad.pointer_mut(pointer).unwrap() = value;
        send(&mut vehicle, &bad);
        is_refused(&mut vehicle, "validationError", word);
    }
    for text in [&b""[..], b"{", b"[]", b"\xff", b"null", b"{} {}"] {
        let mut vehicle = vehicle(V2);
        vehicle.receive(Topic::Order, text, 1_000);
        let state = last_state(&mut vehicle);
        assert_eq!(errors(&state)[0].0, "validationError", "{text:?}");
    }
}

#[test]
fn what_the_vehicle_cannot_do_is_refused_with_its_field() {
    let action = json!([{"actionId": "p1", "actionType": "pick", "blockingType": "HARD"}]);
    let cases: [(&str, &str, Value, [&str; 2], &str); 8] = [
        (
            "/nodes/1",
            "actions",
            action.clone(),
            ["orderError", "INVALID_ORDER_ACTION"],
            "action pick",
        ),
        (
            "/edges/0",
            "actions",
            action,
            ["orderError", "INVALID_ORDER_ACTION"],
            "action pick",
        ),
        (
            "",
            "zoneSetId",
            json!("z"),
            ["orderError", "UNSUPPORTED_PARAMETER"],
            "knows no zones",
        ),
        (
            "/edges/1",
            "direction",
            json!("left"),
            ["orderError", "UNSUPPORTED_PARAMETER"],
            "left",
        ),
        (
            "/edges/1",
            "maxHeight",
            json!(0.5),
            ["orderError", "UNSUPPORTED_PARAMETER"],
            "0.5 m",
        ),
        (
            "/edges/1",
            "maxSpeed",
            json!(0),
            ["noRouteError", "NO_ROUTE_TO_TARGET"],
            "maxSpeed",
        ),
        (
            "/nodes/1/nodePosition",
            "mapId",
            json!("cellar"),
            ["noRouteError", "UNKNOWN_MAP_ID"],
            "cellar",
        ),
        (
            "/edges/0",
            "trajectory",
            json!({"degree": 1, "knotVector": [0, 0, 1, 1],
                "controlPoints": [{"x": 0, "y": 0}, {"x": 1, "y": 1}]}),
            ["noRouteError", "NO_ROUTE_TO_TARGET"],
            "1.000 m from its node",
        ),
    ];
    for (pointer, key, value, kinds, word) in cases {
        for (version, kind) in [V2, V3].into_iter().zip(kinds) {
            let mut vehicle = vehicle(version);
            let mut bad = order("a", 0, 0, 3, 3);
            bad.pointer_mut(pointer).unwrap()[key] = value.clone();
            send(&mut vehicle, &bad);
            is_refused(&mut vehicle, kind, word);
            assert!(!vehicle.is_busy());
        }
    }
}

/// opentcs-commadapter#2 and #12, 6.6.3.
#[test]
fn cancel_stops_clears_the_horizon_and_then_says_finished() {
    let mut vehicle = under_way(V2);
    act(&mut vehicle, "c", "cancelOrder");
    assert_eq!(vehicle.requests(), [Request::Stop]);
    let state = last_state(&mut vehicle);
    assert_eq!(state["actionStates"][0]["actionStatus"], "RUNNING");
    assert_eq!(node_ids(&state).len(), 3);
    // Another order, an update, and another cancel are answered on the way.
    send(&mut vehicle, &order("b", 0, 0, 2, 2));
    is_refused(&mut vehicle, "orderError", "order a");
    vehicle.see(
        Seen {
            pose: Some(Pose::new(0.4, 0.0, 0.0)),
            ..standing()
        },
        3_000,
    );
    let state = last_state(&mut vehicle);
    assert_eq!(state["actionStates"][0]["actionStatus"], "FINISHED");
    assert!(node_ids(&state).is_empty());
    assert!(state["edgeStates"].as_array().unwrap().is_empty());
    assert_eq!(state["orderId"], "a", "the order's name is kept");
    send(&mut vehicle, &order("a", 1, 2, 2, 2));
    let state = last_state(&mut vehicle);
    assert!(
        errors(&state)
            .iter()
            .any(|(kind, s)| kind == "orderUpdateError" && s.contains("cancelled"))
    );
    // 6.6.3.1: the next order begins at a node of its own, or at the last one with a deviation.
    let mut next = order("b", 0, 0, 2, 2);
    next["nodes"][0]["nodePosition"]["allowedDeviationXY"] = json!(0.5);
    send(&mut vehicle, &next);
    assert_eq!(drives(&mut vehicle), [(1, true)]);
    assert!(errors(&last_state(&mut vehicle)).is_empty());
}

#[test]
fn cancel_without_an_order_or_of_another_one_fails_and_is_answered() {
    for (version, kind) in [(V2, "noOrderToCancel"), (V3, "NO_ORDER_TO_CANCEL")] {
        let mut vehicle = vehicle(version);
        act(&mut vehicle, "c", "cancelOrder");
        let state = last_state(&mut vehicle);
        let list = if version == V3 {
            "instantActionStates"
        } else {
            "actionStates"
        };
        assert_eq!(state[list][0]["actionStatus"], "FAILED");
        assert_eq!(errors(&state)[0].0, kind);
        let references = &state["errors"][0]["errorReferences"];
        assert_eq!(
            references[0],
            json!({"referenceKey": "actionId", "referenceValue": "c"})
        );
        let mut busy = under_way(version);
        let named = json!([{"key": "orderId", "value": "z"}]);
        act_under(&mut busy, "actions", "d", "cancelOrder", named);
        assert!(busy.requests().is_empty());
        assert_eq!(errors(&last_state(&mut busy))[0].0, kind);
    }
}

#[test]
fn pause_is_finished_when_the_vehicle_stands_and_both_spellings_are_read() {
    let mut vehicle = under_way(V2);
    act_under(&mut vehicle, "instantActions", "p", "startPause", json!([]));
    assert_eq!(vehicle.requests(), [Request::Pause]);
    let state = last_state(&mut vehicle);
    assert_eq!(
        (&state["paused"], &state["actionStates"][0]["actionStatus"]),
        (&json!(true), &json!("RUNNING"))
    );
    vehicle.see(standing(), 2_000);
    assert_eq!(
        last_state(&mut vehicle)["actionStates"][0]["actionStatus"],
        "FINISHED"
    );
    act(&mut vehicle, "q", "stopPause");
    assert_eq!(vehicle.requests(), [Request::Resume]);
    let state = last_state(&mut vehicle);
    assert_eq!(
        (&state["paused"], &state["actionStates"][1]["actionStatus"]),
        (&json!(false), &json!("FINISHED"))
    );
    // The same message again, as MQTT may deliver it.
    act(&mut vehicle, "q", "stopPause");
    assert!(vehicle.requests().is_empty());
}

#[test]
fn init_position_sets_place_and_map_of_a_standing_vehicle() {
    let place = json!([{"key": "x", "value": 3.0}, {"key": "y", "value": -1.0},
        {"key": "theta", "value": 0.5}, {"key": "mapId", "value": "cellar"},
        {"key": "lastNodeId", "value": "n7"}]);
    let mut vehicle = vehicle(V2);
    act_under(&mut vehicle, "actions", "i", "initPosition", place.clone());
    assert_eq!(
        vehicle.requests(),
        [Request::SetPosition(Pose::new(3.0, -1.0, 0.5))]
    );
    let state = last_state(&mut vehicle);
    assert_eq!(state["agvPosition"]["mapId"], "cellar");
    assert_eq!(state["agvPosition"]["x"], 3.0);
    assert_eq!(state["lastNodeId"], "n7");
    assert_eq!(state["actionStates"][0]["actionStatus"], "FINISHED");
    for (index, word) in [
        "x is missing",
        "y is missing",
        "theta is missing",
        "mapId is missing",
    ]
    .into_iter()
    .enumerate()
    {
        let mut less = place.clone();
        less.as_array_mut().unwrap().remove(index);
        act_under(&mut vehicle, "actions", word, "initPosition", less);
        let state = last_state(&mut vehicle);
        assert!(
            errors(&state)
                .iter()
                .any(|(kind, s)| kind == "instantActionError" && s.contains(word))
        );
    }
    let mut busy = under_way(V2);
    act_under(&mut busy, "actions", "i", "initPosition", place);
    is_refused(&mut busy, "instantActionError", "cancel it first");
}

#[test]
fn unknown_instant_actions_fail_and_requests_are_answered() {
    let mut vehicle = vehicle(V2);
    act(&mut vehicle, "x", "startCharging");
    let state = last_state(&mut vehicle);
    assert_eq!(state["actionStates"][0]["actionStatus"], "FAILED");
    assert!(errors(&state)[0].1.contains("startCharging"));
    act(&mut vehicle, "s", "stateRequest");
    assert_eq!(
        last_state(&mut vehicle)["actionStates"][1]["actionStatus"],
        "FINISHED"
    );
    act(&mut vehicle, "f", "factsheetRequest");
    let topics: Vec<_> = vehicle.outgoing().iter().map(|sent| sent.topic).collect();
    assert_eq!(topics, [Topic::Factsheet, Topic::State]);
    vehicle.receive(Topic::InstantActions, b"{\"actions\": 3}", 1_000);
    assert!(
        errors(&last_state(&mut vehicle))
            .iter()
            .any(|(kind, _)| kind == "validationError")
    );
}

#[test]
fn a_vehicle_that_is_driven_by_hand_drops_its_order_and_takes_none() {
    for (version, kind) in [(V2, "orderError"), (V3, "MOBILE_ROBOT_NOT_AVAILABLE")] {
        let mut vehicle = under_way(version);
        let by_hand = Seen {
            mode: OperatingMode::Manual,
            ..driving()
        };
        vehicle.see(by_hand, 2_000);
        assert_eq!(vehicle.requests(), [Request::Stop]);
        let state = last_state(&mut vehicle);
        assert_eq!(state["operatingMode"], "MANUAL");
        assert!(node_ids(&state).is_empty());
        send(&mut vehicle, &order("b", 0, 0, 2, 2));
        is_refused(&mut vehicle, kind, "by hand");
    }
}

#[test]
fn without_a_connection_states_wait_in_order_and_the_drive_goes_on() {
    let mut vehicle = under_way(V2);
    vehicle.disconnect();
    vehicle.passed(2, 2_000);
    vehicle.passed(4, 3_000);
    assert!(vehicle.requests().is_empty(), "nothing stops the drive");
    assert!(vehicle.outgoing().is_empty());
    vehicle.connect(4_000);
    let sent = vehicle.outgoing();
    assert_eq!(sent[0].topic, Topic::Connection);
    assert_eq!(sent[0].message["connectionState"], "ONLINE");
    let nodes: Vec<_> = sent
        .iter()
        .filter(|s| s.topic == Topic::State)
        .map(|s| node_ids(&s.message).len())
        .collect();
    assert_eq!(nodes, [2, 1, 1]);
    vehicle.disconnect();
    for n in 0..2 * MOST_WAITING as u64 {
        vehicle.see(if n % 2 == 0 { driving() } else { standing() }, 5_000 + n);
    }
    vehicle.connect(9_000_000);
    assert!(
        vehicle.outgoing().len() <= MOST_WAITING + 2,
        "and no more than that"
    );
}

/// The vehicle is not where the base ends, so nothing is put behind the base.
#[test]
fn after_an_interrupted_drive_the_order_is_cancelled_and_not_extended() {
    let mut vehicle = under_way(V2);
    let stopped = Seen {
        interrupted: true,
        ..standing()
    };
    vehicle.see(stopped.clone(), 2_000);
    send(&mut vehicle, &order("a", 1, 2, 3, 3));
    is_refused(&mut vehicle, "orderError", "was interrupted");
    act(&mut vehicle, "c", "cancelOrder");
    vehicle.requests();
    vehicle.see(stopped, 2_500);
    assert!(node_ids(&last_state(&mut vehicle)).is_empty());
    send(&mut vehicle, &order("b", 0, 0, 2, 2));
    assert_eq!(drives(&mut vehicle), [(1, true)]);
}

#[test]
fn a_state_comes_at_least_every_interval() {
    let mut vehicle = vehicle(V2);
    vehicle.see(standing(), 29_999);
    assert!(vehicle.outgoing().is_empty());
    vehicle.see(standing(), 30_000);
    assert_eq!(states(&mut vehicle).len(), 1);
}
