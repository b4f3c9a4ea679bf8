//! `status --history` after an incident: a robot stops, and its battery is taken out.
//!
//! Time in the served world waits for the master, so nothing here depends on how busy this machine
//! is.

mod common;

use common::{omnibus, serve};

/// Robot 3 is stopped at 3 s and loses its power at 6 s.
const FAULTS: [&str; 2] = [
    "t=3:node=3:emergency-stop:for=0.5",
    "t=6:node=3:power-cycle",
];

/// What each robot remembers, by the order of the group file.
fn history(bus: &str) -> [serde_json::Value; 2] {
    let output = omnibus(&["status", "--history", "--json", "--bus", bus]);
    let text = String::from_utf8_lossy(&output.stdout);
    let found: serde_json::Value = serde_json::from_str(&text).expect(&text);
    [0, 1].map(|robot| found["robots"][robot]["history"].clone())
}

#[test]
fn a_fault_is_told_after_its_robot_was_without_power() {
    let (_served, bus) = serve(&FAULTS);
    let bus = format!("lockstep://{bus}");
    let group = "groups/tcc-2.toml";
    let drive = [
        "drive", "--vx", "0.2", "--for", "20", "--group", group, "--bus", &bus,
    ];
    let drive = omnibus(&drive);
    assert_eq!(drive.status.code(), Some(5), "robot 3 is stopped");
    // Every look takes some tenths of a second there.
    let [other, stopped] = (0..200)
        .map(|_| history(&bus))
        .find(|[_, stopped]| stopped["start"] == 2)
        .expect("robot 3 starts a second time");
    let newest = &stopped["faults"][0];
    assert_eq!(newest["name"], "EmergencyStop", "{stopped}");
    assert_eq!(
        (&newest["start"], &newest["starts_ago"]),
        (&1.into(), &1.into())
    );
    // 0.2 m/s at wheels of 152 mm are 1.3 rad/s.
    let rates = newest["wheel_rates_rad_s"].as_array().expect("four rates");
    for rate in rates {
        assert!((rate.as_f64().unwrap() - 1.3).abs() < 0.1, "{stopped}");
    }
    assert_eq!(other["start"], 1);
    assert_eq!(other["faults"][0]["name"], "MemberStopped", "{other}");

    let text = omnibus(&["status", "--history", "--bus", &bus]);
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    let line = text.lines().find(|line| line.contains("EmergencyStop"));
    assert!(
        line.is_some_and(|line| line.contains("the last one")),
        "{text}"
    );
}
