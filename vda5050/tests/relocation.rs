//! The action `initPosition` on nodes of an order (6.8.1).

mod common;

use common::{act, driving, is_refused, last_state, node_ids, order, send, standing, vehicle};
use kinematics::Pose;
use omnibus_vda5050::{Request, Vehicle, Version};
use serde_json::{Value, json};

const V2: Version = Version::V2_0;
const V3: Version = Version::V3_0;

fn relocation(x: f64, map: &str) -> Value {
    json!([{"actionId": "lift", "actionType": "initPosition", "blockingType": "HARD",
        "actionParameters": [{"key": "x", "value": x}, {"key": "y", "value": 5.0},
            {"key": "theta", "value": 0.0}, {"key": "mapId", "value": map}]}])
}

fn status(vehicle: &mut Vehicle) -> Value {
    last_state(vehicle)["actionStates"][0]["actionStatus"].clone()
}

/// 6.8.1: `initPosition` on a node, as behind the door of a lift. n1 is at (1, 0) in the hall and
/// at (10, 5) in the cellar; n2 is given on that map.
#[test]
fn init_position_on_a_node_is_done_at_rest_and_the_drive_goes_on_from_there() {
    let mut vehicle = vehicle(V2);
    let mut with_lift = order("a", 0, 0, 3, 3);
    with_lift["nodes"][1]["actions"] = relocation(10.0, "cellar");
    with_lift["nodes"][2]["nodePosition"] = json!({"x": 11.0, "y": 5.0, "mapId": "cellar"});
    send(&mut vehicle, &with_lift);
    let requests = vehicle.requests();
    let [Request::Drive { legs, fresh: true }] = requests.as_slice() else {
        panic!("{requests:?}");
    };
    let end = legs.last().unwrap().end().unwrap();
    assert_eq!((end.x, end.y), (1.0, 0.0), "the drive ends at the node");
    assert_eq!(status(&mut vehicle), "WAITING");
    vehicle.see(driving(), 1_000);
    vehicle.passed(2, 2_000);
    assert_eq!(status(&mut vehicle), "WAITING");
    assert!(vehicle.requests().is_empty(), "it still moves");
    vehicle.see(standing(), 3_000);
    let requests = vehicle.requests();
    let [
        Request::SetPosition(place),
        Request::Drive { legs, fresh: false },
    ] = requests.as_slice()
    else {
        panic!("{requests:?}");
    };
    assert_eq!(*place, Pose::new(10.0, 5.0, 0.0));
    let (start, end) = (legs[0].poses[0], legs.last().unwrap().end().unwrap());
    assert_eq!((start.x, start.y), (10.0, 5.0));
    assert_eq!((end.x, end.y), (11.0, 5.0));
    let state = last_state(&mut vehicle);
    assert_eq!(state["actionStates"][0]["actionStatus"], "FINISHED");
    assert_eq!(state["agvPosition"]["mapId"], "cellar");
    assert_eq!(state["agvPosition"]["x"], 10.0);
    assert_eq!(node_ids(&state), ["n2"]);
    // Once.
    vehicle.see(driving(), 4_000);
    vehicle.see(standing(), 5_000);
    assert!(vehicle.requests().is_empty());
}

/// An update behind it goes on in the coordinates of the other map, before and after it is done.
#[test]
fn an_update_behind_init_position_is_on_its_map() {
    for done in [false, true] {
        let mut vehicle = vehicle(V2);
        let mut with_lift = order("a", 0, 0, 2, 2);
        with_lift["nodes"][1]["actions"] = relocation(10.0, "cellar");
        send(&mut vehicle, &with_lift);
        vehicle.requests();
        if done {
            vehicle.see(driving(), 1_000);
            vehicle.passed(2, 2_000);
            vehicle.see(standing(), 3_000);
            assert_eq!(vehicle.requests().len(), 1, "the position alone");
        }
        let mut more = order("a", 1, 1, 2, 2);
        more["nodes"][0]["actions"] = relocation(10.0, "cellar");
        let mut wrong = more.clone();
        send(&mut vehicle, &{
            wrong["nodes"][1]["nodePosition"]["mapId"] = json!("hall");
            wrong
        });
        is_refused(&mut vehicle, "noRouteError", "hall");
        more["nodes"][1]["nodePosition"] = json!({"x": 12.0, "y": 5.0, "mapId": "cellar"});
        send(&mut vehicle, &more);
        if !done {
            assert!(vehicle.requests().is_empty(), "first the node");
            vehicle.see(driving(), 1_000);
            vehicle.passed(2, 2_000);
            vehicle.see(standing(), 3_000);
        }
        let requests = vehicle.requests();
        let Some(Request::Drive { legs, fresh: false }) = requests.last() else {
            panic!("{requests:?}");
        };
        let (start, end) = (legs[0].poses[0], legs.last().unwrap().end().unwrap());
        assert_eq!((start.x, start.y, end.x, end.y), (10.0, 5.0, 12.0, 5.0));
    }
}

#[test]
fn init_position_on_the_first_node_comes_before_the_drive_and_a_cancelled_one_fails() {
    let mut first = vehicle(V3);
    let mut begins = order("a", 0, 0, 2, 2);
    begins["nodes"][0]["actions"] = relocation(10.0, "cellar");
    begins["nodes"][1]["nodePosition"] = json!({"x": 11.0, "y": 5.0, "mapId": "cellar"});
    send(&mut first, &begins);
    let requests = first.requests();
    assert!(
        matches!(
            requests.as_slice(),
            [Request::SetPosition(_), Request::Drive { fresh: true, .. }]
        ),
        "{requests:?}"
    );
    let state = last_state(&mut first);
    assert_eq!(state["actionStates"][0]["actionStatus"], "FINISHED");
    assert_eq!(state["instantActionStates"], json!([]));

    let mut vehicle = vehicle(V2);
    let mut ahead = order("a", 0, 0, 2, 2);
    ahead["nodes"][1]["actions"] = relocation(10.0, "cellar");
    send(&mut vehicle, &ahead);
    vehicle.requests();
    vehicle.see(driving(), 1_000);
    act(&mut vehicle, "c", "cancelOrder");
    vehicle.requests();
    vehicle.see(standing(), 2_000);
    assert_eq!(status(&mut vehicle), "FAILED");
    assert!(vehicle.requests().is_empty());
}

#[test]
fn unusable_init_position_on_a_node_is_refused() {
    for (key, value, word) in [
        ("/0/actionParameters/0/value", json!("far"), "x is missing"),
        (
            "/0/actionParameters/2/value",
            json!(4.0),
            "between -pi and pi",
        ),
        ("/0/actionParameters/3/value", json!(""), "mapId is missing"),
    ] {
        let mut vehicle = vehicle(V2);
        let mut bad = order("a", 0, 0, 2, 2);
        let mut action = relocation(10.0, "cellar");
        *action.pointer_mut(key).unwrap() = value;
        bad["nodes"][1]["actions"] = action;
        send(&mut vehicle, &bad);
        is_refused(&mut vehicle, "orderError", word);
        assert!(!vehicle.is_busy());
    }
}
