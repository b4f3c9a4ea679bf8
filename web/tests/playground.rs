//! The world of the page on this machine: every choice opens, a metre is a metre, faults stop.

use group::GroupFile;
use omnibus::abort::Abort;
use omnibus::simulation::contact;
use serde_json::Value;
use web::choice::{Calibrated, Choice, Floor, GROUPS, MEAN, PHASED, ROLLERS, Robots};
use web::playground::Playground;
use web::scenario;

fn choice(group: &str, floor: Floor) -> Choice {
    Choice {
        group: group.into(),
        floor,
        compensation: true,
        phases: floor == Floor::Contact,
        robots: Robots::Native,
    }
}

/// Everything that the page has been told until the group is in this phase.
fn until_phase(playground: &mut Playground, phase: &str) -> Vec<Value> {
    let mut messages = Vec::new();
    for _ in 0..200 {
        let now = playground.now_ms();
        playground.advance(now + 50);
        let Value::Array(new) = playground.news()["messages"].take() else {
            panic!("news without messages");
        };
        messages.extend(new);
        if messages.last().is_some_and(|last| last["phase"] == phase) {
            return messages;
        }
    }
    panic!("no {phase} within ten seconds: {messages:?}");
}

fn started(group: &str) -> Playground {
    let mut playground = Playground::new(&choice(group, Floor::Table), None).unwrap();
    playground.receive(r#"{"type":"take"}"#);
    playground.receive(r#"{"type":"start"}"#);
    until_phase(&mut playground, "running");
    playground
}

#[test]
fn every_group_starts_on_every_floor() {
    for (name, ..) in GROUPS {
        for floor in [Floor::Table, Floor::Contact] {
            let mut playground = Playground::new(&choice(name, floor), None).unwrap();
            playground.receive(r#"{"type":"take"}"#);
            playground.receive(r#"{"type":"start"}"#);
            until_phase(&mut playground, "running");
        }
    }
    let unknown = Choice {
        group: "tcc-9".into(),
        ..choice("single", Floor::Table)
    };
    let error = Playground::new(&unknown, None).err().unwrap();
    assert!(
        error.contains("tcc-9") && error.contains("tcc-3"),
        "{error}"
    );
}

/// The last sample is of a group at rest. On the paper's tables compensation is within some parts
/// in a thousand; the way goes on for the ramp after the metre, which from 0.5 m/s at 2.4 m/s2 is
/// 52 mm and 25 mm more for each of the periods that the release takes to reach the robots.
#[test]
fn a_metre_is_a_metre_and_the_same_every_time() {
    let text = scenario::run(&choice("tcc-3", Floor::Table), None).unwrap();
    let outcome: Value = serde_json::from_str(&text).unwrap();
    let samples = outcome["samples"].as_array().unwrap();
    let end = &samples.last().unwrap()["pose"];
    let way = end[0].as_f64().unwrap();
    assert!((1.0..1.15).contains(&way), "{way}");
    assert!(end[1].as_f64().unwrap().abs() < 0.01, "{end}");
    let driving = &samples[samples.len() / 2]["robots"][0]["duties"];
    assert!(driving[0].as_f64().unwrap() > 0.05, "{driving}");
    assert!(outcome["log"].as_str().unwrap().lines().count() > 1_000);
    assert_eq!(
        text,
        scenario::run(&choice("tcc-3", Floor::Table), None).unwrap()
    );
}

#[test]
fn faults_stop_the_group_and_say_why() {
    for (fault, text) in [
        ("node=3:bus-cut", "node 3"),
        ("node=2:emergency-stop", "EmergencyStop"),
    ] {
        let mut playground = started("tcc-2");
        playground.inject(fault).unwrap();
        let messages = until_phase(&mut playground, "idle");
        let is_named = |message: &Value| {
            message["level"] == "error" && message["text"].as_str().unwrap().contains(text)
        };
        assert!(messages.iter().any(is_named), "{fault}: {messages:?}");
    }
    let error = started("tcc-2").inject("node=9:bus-cut").unwrap_err();
    assert!(error.contains("9 is not in the group"), "{error}");
}

/// What is written in `choice.rs` is what a calibration on that floor gives for the paper's robot.
#[test]
fn coefficients_of_the_contact_floor_are_those_of_a_calibration() {
    let single = include_str!("../../groups/single.toml");
    let single = GroupFile::parse("single", single).unwrap();
    let mean = contact::on_contact(&single, ROLLERS);
    let phased = contact::with_phases(&mean);
    for (file, written) in [(mean, MEAN), (phased, PHASED)] {
        let file = contact::calibrated(&file, &Abort::default()).unwrap();
        let robot = &file.robots[0];
        let rollers = robot.rollers.as_ref();
        let found = rollers.map_or(robot.compensation, |rollers| rollers.compensation);
        let found = Calibrated {
            coefficients: [found.longitudinal(), found.lateral(), found.yaw()],
            hand_over_loss: file.hand_over_loss,
            lag: [
                file.contact_lag.longitudinal,
                file.contact_lag.lateral,
                file.contact_lag.yaw,
            ],
        };
        let near = |a: f32, b: f32, by: f32| assert!((a - b).abs() <= by, "{found:?} {written:?}");
        for (a, b) in found.coefficients.iter().zip(written.coefficients) {
            near(*a, b, 5e-4);
        }
        near(found.hand_over_loss, written.hand_over_loss, 5e-4);
        for (a, b) in found.lag.iter().zip(written.lag) {
            near(*a, b, 5e-4);
        }
    }
}
