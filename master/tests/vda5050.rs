//! A group as a vehicle of VDA 5050, without a broker: orders in, motion of simulated robots and
//! states out.
//!
//! The world runs in the pilot's thread. Nothing waits for a time; a test goes on until what must
//! happen has happened.

mod common;

use std::sync::Arc;
use std::time::Duration;

use common::root;
use group::GroupFile;
use kinematics::Pose;
use omnibus::controls::Controls;
use omnibus::monitor::telemetry::{Snapshot, Subscription, Telemetry};
use omnibus::path::steering::Law;
use omnibus::pilot::Pilot;
use omnibus::vda5050::driver::{Driver, Localised};
use omnibus::vda5050::physics;
use serde_json::{Value, json};
use vda5050::message::Identity;
use vda5050::{Configuration, Topic, Vehicle, Version};

/// How long nothing may happen.
const PATIENCE: Duration = Duration::from_secs(60);

struct Group {
    pilot: Arc<Pilot>,
    stream: Subscription,
    controls: Controls,
    file: GroupFile,
}

impl Group {
    /// `paced`: time passes no faster than the clock on the wall.
    fn new(name: &str, paced: bool) -> Self {
        let file = GroupFile::load(root().join("groups").join(name)).unwrap();
        let world = file.clone();
        let open = move || {
            let link = omnibus::simulation::open(&world, None, "sim")?;
            Ok(if paced { link.in_real_time() } else { link })
        };
        let pilot = Arc::new(Pilot::launch(open, file.clone()));
        let stream = pilot.telemetry();
        let controls = Controls::of(&pilot, &file.limits);
        Self {
            pilot,
            stream,
            controls,
            file,
        }
    }

    fn vehicle(&self) -> Vehicle {
        let mut vehicle = Vehicle::new(Configuration {
            identity: Identity {
                version: Version::V2_0,
                interface: "uagv".into(),
                manufacturer: "Omnibus".into(),
                serial: "group".into(),
            },
            map: "hall".into(),
            physics: physics::of(&self.file),
            height: 1.0,
            tolerance: 0.1,
            state_interval_ms: 30_000,
            visualization_interval_ms: 0,
        });
        vehicle.connect(0);
        vehicle
    }

    fn driver(&self) -> Driver<'_> {
        let localised = Localised {
            poses: None,
            offset: Some(Pose::new(0.0, 0.0, 0.0)),
            law: Law::default(),
        };
        Driver::new(&self.file, &self.controls, localised)
    }

    /// One item of telemetry through driver and vehicle; the states that came of it.
    fn step(&self, driver: &mut Driver<'_>, vehicle: &mut Vehicle) -> Vec<Value> {
        let item = self
            .stream
            .next_within(PATIENCE)
            .expect("the pilot goes on");
        self.controls.on_telemetry(&item);
        driver.on_telemetry(&item);
        if let Telemetry::Snapshot(snapshot) = &item {
            within_limits(snapshot, &self.file);
        }
        for mark in driver.passed() {
            vehicle.passed(mark, 1_000);
        }
        vehicle.see(driver.seen(), 1_000);
        driver.serve(vehicle.requests());
        let sent = vehicle.outgoing().into_iter();
        sent.filter(|sent| sent.topic == Topic::State)
            .map(|sent| sent.message)
            .collect()
    }

    /// Goes on until a state is the one; gives all states.
    fn until(
        &self,
        driver: &mut Driver<'_>,
        vehicle: &mut Vehicle,
        found: impl Fn(&Value) -> bool,
    ) -> Vec<Value> {
        let mut states = Vec::new();
        while !states.iter().any(&found) {
            states.extend(self.step(driver, vehicle));
        }
        states
    }
}

fn within_limits(snapshot: &Snapshot, file: &GroupFile) {
    let command = snapshot.command;
    assert!(
        command.vx.hypot(command.vy) <= file.limits.linear_speed * 1.001,
        "{command:?}"
    );
    assert!(
        command.omega.abs() <= file.limits.yaw_rate * 1.001,
        "{command:?}"
    );
}

fn order(id: &str, update: u32, first: u32, places: &[[f64; 2]]) -> Value {
    let nodes: Vec<Value> = (first..)
        .zip(places)
        .map(|(n, [x, y])| {
            json!({"nodeId": format!("n{n}"), "sequenceId": 2 * n, "released": true, "actions": [],
            "nodePosition": {"x": x, "y": y, "mapId": "hall"}})
        })
        .collect();
    let edges: Vec<Value> = (first..)
        .zip(&places[1..])
        .map(|(n, _)| {
            json!({"edgeId": format!("e{n}"), "sequenceId": 2 * n + 1, "released": true,
            "startNodeId": format!("n{n}"), "endNodeId": format!("n{}", n + 1), "actions": []})
        })
        .collect();
    json!({"headerId": 1, "timestamp": "2026-11-23T12:00:00.000Z", "version": "2.0.0",
        "manufacturer": "Omnibus", "serialNumber": "group", "orderId": id, "orderUpdateId": update,
        "nodes": nodes, "edges": edges})
}

fn instant(vehicle: &mut Vehicle, id: &str, kind: &str) {
    let message = json!({"headerId": 1, "timestamp": "2026-11-23T12:00:00.000Z",
        "version": "2.0.0", "manufacturer": "Omnibus", "serialNumber": "group",
        "actions": [{"actionId": id, "actionType": kind, "blockingType": "NONE"}]});
    vehicle.receive(Topic::InstantActions, message.to_string().as_bytes(), 1_000);
}

fn send(vehicle: &mut Vehicle, driver: &mut Driver<'_>, order: &Value) {
    vehicle.receive(Topic::Order, order.to_string().as_bytes(), 1_000);
    driver.serve(vehicle.requests());
}

fn idle(state: &Value) -> bool {
    state["nodeStates"].as_array().unwrap().is_empty() && state["driving"] == false
}

fn is_at(state: &Value, x: f64, y: f64, theta: f64) {
    let at = &state["agvPosition"];
    let get = |key: &str| at[key].as_f64().unwrap();
    assert!((get("x") - x).hypot(get("y") - y) < 0.02, "{at}");
    assert!((get("theta") - theta).abs() < 0.02, "{at}");
}

/// A quarter of a circle of 1 m about (0, 1), the front ahead, then straight on sideways.
#[test]
fn three_robots_drive_an_order_over_a_curve_and_an_update_without_a_stop() {
    let group = Group::new("tcc-3.toml", false);
    let (mut vehicle, mut driver) = (group.vehicle(), group.driver());
    group.until(&mut driver, &mut vehicle, |s| {
        s["agvPosition"]["positionInitialized"] == true
    });
    let mut curve = order("a", 0, 0, &[[0.0, 0.0], [1.0, 1.0]]);
    curve["edges"][0]["orientation"] = json!(0.0);
    curve["edges"][0]["trajectory"] = json!({"degree": 2, "knotVector": [0, 0, 0, 1, 1, 1],
        "controlPoints": [{"x": 0, "y": 0}, {"x": 1, "y": 0, "weight": 0.5_f64.sqrt()}, {"x": 1, "y": 1}]});
    send(&mut vehicle, &mut driver, &curve);
    group.until(&mut driver, &mut vehicle, |s| s["driving"] == true);
    send(
        &mut vehicle,
        &mut driver,
        &order("a", 1, 1, &[[1.0, 1.0], [1.0, 2.0], [2.0, 2.0]]),
    );
    let states = group.until(&mut driver, &mut vehicle, idle);
    let last = states.last().unwrap();
    is_at(last, 2.0, 2.0, std::f64::consts::FRAC_PI_2);
    assert_eq!(last["errors"], json!([]));
    let mut ahead: Vec<usize> = Vec::new();
    for state in states.iter().filter(|state| state["orderUpdateId"] == 1) {
        let count = state["nodeStates"].as_array().unwrap().len();
        if ahead.last() != Some(&count) {
            ahead.push(count);
        }
    }
    assert_eq!(ahead, [3, 2, 1, 0], "one by one");
    driver.leave();
}

#[test]
fn pause_stands_and_goes_on_cancel_stands_and_forgets() {
    let group = Group::new("single.toml", true);
    let (mut vehicle, mut driver) = (group.vehicle(), group.driver());
    group.until(&mut driver, &mut vehicle, |s| {
        s["agvPosition"]["positionInitialized"] == true
    });
    send(
        &mut vehicle,
        &mut driver,
        &order("a", 0, 0, &[[0.0, 0.0], [3.0, 0.0]]),
    );
    group.until(&mut driver, &mut vehicle, |s| s["driving"] == true);
    instant(&mut vehicle, "p", "startPause");
    driver.serve(vehicle.requests());
    let finished = |id: &'static str| {
        move |s: &Value| {
            let actions = s["actionStates"].as_array().unwrap();
            actions
                .iter()
                .any(|a| a["actionId"] == id && a["actionStatus"] == "FINISHED")
        }
    };
    let states = group.until(&mut driver, &mut vehicle, finished("p"));
    assert_eq!(states.last().unwrap()["driving"], false);
    assert_eq!(
        states.last().unwrap()["nodeStates"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
    instant(&mut vehicle, "q", "stopPause");
    driver.serve(vehicle.requests());
    group.until(&mut driver, &mut vehicle, |s| s["driving"] == true);
    instant(&mut vehicle, "c", "cancelOrder");
    driver.serve(vehicle.requests());
    let states = group.until(&mut driver, &mut vehicle, finished("c"));
    let stands = states.last().unwrap();
    assert!(idle(stands), "{stands}");
    // The next order begins where the group stands.
    let at = &stands["agvPosition"];
    let here = [at["x"].as_f64().unwrap(), at["y"].as_f64().unwrap()];
    let there = [here[0], here[1] + 0.5];
    send(&mut vehicle, &mut driver, &order("b", 0, 0, &[here, there]));
    let states = group.until(&mut driver, &mut vehicle, |s| {
        s["orderId"] == "b" && idle(s)
    });
    is_at(states.last().unwrap(), there[0], there[1], 0.0);
    assert!(!group.pilot.is_over());
    driver.leave();
}
