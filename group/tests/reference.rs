//! The declaration of keys against what reads them, and what is generated from it.

use std::collections::BTreeMap;
use std::path::Path;

use omnibus_group::{Examination, reference};

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// OMNIBUS_WRITE_DOCS=1 writes the page.
#[test]
fn the_page_is_the_generated_one() {
    let path = root().join("docs/group-files.md");
    if std::env::var_os("OMNIBUS_WRITE_DOCS").is_some() {
        std::fs::write(&path, reference::page()).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap();
    assert!(
        committed == reference::page(),
        "docs/group-files.md is not what the declaration says; OMNIBUS_WRITE_DOCS=1 writes it"
    );
}

/// Keys of an object of the schema and of all objects within, as `path -> keys`.
fn keys(of: &serde_json::Value, path: &str, out: &mut BTreeMap<String, Vec<String>>) {
    let Some(properties) = of["properties"].as_object() else {
        return;
    };
    let mut names = Vec::new();
    for (name, property) in properties {
        if property["deprecated"] == true {
            continue;
        }
        names.push(name.clone());
        let inner = if property["type"] == "array" {
            &property["items"]
        } else {
            property
        };
        keys(inner, &format!("{path}{name}."), out);
    }
    names.sort();
    out.insert(path.to_owned(), names);
}

/// Every key that the reader's structures have is declared, and the other way round.
#[test]
fn the_reader_and_the_declaration_have_the_same_keys() {
    let source = std::fs::read_to_string(root().join("group/src/schema.rs")).unwrap();
    let mut structs: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    let mut current = "";
    for line in source.lines() {
        if let Some(rest) = line.strip_prefix("pub struct ") {
            current = rest.split([' ', '<']).next().unwrap();
        } else if let Some(rest) = line.strip_prefix("    pub ")
            && let Some((key, _)) = rest.split_once(':')
        {
            structs.entry(current).or_default().push(key.to_owned());
        }
    }
    structs.values_mut().for_each(|keys| keys.sort());
    let schema: serde_json::Value = serde_json::from_str(&reference::schema()).unwrap();
    let mut declared = BTreeMap::new();
    keys(&schema, "", &mut declared);
    for (path, name) in [
        ("", "File"),
        ("limits.", "Limits"),
        ("contact_lag.", "ContactLag"),
        ("roller_transition.", "RollerTransition"),
        ("robot.", "Defaults"),
        ("robots.", "Entry"),
        ("robot.wheels.", "Wheels"),
        ("robot.wheels.rear_left.", "Wheel"),
        ("robot.rollers.", "Rollers"),
        ("robot.compensation.", "Compensation"),
        ("robot.compensation.table.", "CompensationTable"),
        ("robot.encoder.", "Encoder"),
        ("robot.motor.", "Motor"),
        ("robot.control.", "Control"),
        ("simulation.", "Simulation"),
        ("simulation.battery.", "Battery"),
        ("simulation.encoder.", "EncoderNoise"),
        ("simulation.encoder_faults.", "EncoderFault"),
        ("simulation.pose_noise.", "PoseNoise"),
        ("simulation.gyro.", "Gyro"),
        ("simulation.payload.", "Payload"),
        ("simulation.floor.", "Patch"),
    ] {
        assert_eq!(
            structs.remove(name),
            declared.get(path).cloned(),
            "{name}, {path}"
        );
    }
    assert!(structs.is_empty(), "not compared: {structs:?}");
}

#[test]
fn every_default_of_the_schema_is_what_a_file_without_the_key_gets() {
    let text = std::fs::read_to_string(root().join("groups/single.toml")).unwrap();
    let bare: String = text
        .lines()
        .take_while(|line| *line != "[simulation]")
        .filter(|line| !line.starts_with("linear_") && !line.starts_with("yaw_"))
        .map(|line| format!("{line}\n"))
        .collect();
    let group = Examination::of("bare", &bare).group.unwrap();
    let schema: serde_json::Value = serde_json::from_str(&reference::schema()).unwrap();
    let limits = &schema["properties"]["limits"]["properties"];
    for (key, value) in [
        ("linear_speed", group.limits.linear_speed),
        ("yaw_rate", group.limits.yaw_rate),
        ("linear_acceleration", group.limits.linear_acceleration),
        ("yaw_acceleration", group.limits.yaw_acceleration),
        ("linear_jerk", group.limits.linear_jerk),
        ("yaw_jerk", group.limits.yaw_jerk),
    ] {
        let default = limits[key]["default"].as_f64().unwrap();
        assert!((default - f64::from(value)).abs() < 1e-6, "{key}");
    }
    let gyro = &schema["properties"]["simulation"]["properties"]["gyro"]["properties"];
    assert_eq!(gyro["rate_hz"]["default"], group.simulation.gyro.rate_hz);
    let bias = gyro["bias_dps"]["default"].as_f64().unwrap();
    assert!((bias.to_radians() - group.simulation.gyro.bias).abs() < 1e-9);
}
