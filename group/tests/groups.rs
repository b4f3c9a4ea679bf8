//! The group files that come with the workspace, and what a file's values become.

use std::f32::consts::{FRAC_PI_4, PI};

use omnibus_group::{GroupFile, Plant, Tables};
use protocol::Value;
use protocol::compensation::Row;

fn load(name: &str) -> GroupFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/");
    GroupFile::load(format!("{path}{name}.toml")).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn tcc_3_is_the_papers_virtual_robot_three_times() {
    let group = load("tcc-3");
    assert_eq!(group.name, "tcc-3");
    assert_eq!(group.sync_period_us, 10_000);
    let nodes: Vec<u8> = group.robots.iter().map(|r| r.node).collect();
    assert_eq!(nodes, [2, 3, 4]);
    let along: Vec<f32> = group.robots.iter().map(|r| r.mount.x).collect();
    assert_eq!(along, [1.2, 0.0, -1.2]);
    for robot in &group.robots {
        assert_eq!((robot.mount.y, robot.mount.heading), (0.0, 0.0));
        assert_eq!(robot.geometry.half_track(), 0.370);
        assert_eq!(robot.geometry.half_wheelbase(), 0.350);
        assert_eq!(robot.geometry.wheel_radius(), 0.1524);
        assert_eq!(robot.geometry.roller_angle(), FRAC_PI_4);
        assert_eq!(robot.compensation.longitudinal(), 1.002);
        assert_eq!(robot.compensation.lateral(), 1.033);
        assert_eq!(robot.compensation.yaw(), 1.0195);
    }
    assert!(group.simulation.rigid);
    assert_eq!(group.simulation.plant, Plant::Table(Tables::Virtual));
    assert_eq!(group.simulation.crystal_ppm, [-30.0, 5.0, 40.0]);
}

#[test]
fn every_group_file_of_the_workspace_is_valid() {
    for name in ["tcc-3", "tcc-2", "scc-2", "acc-2", "single"] {
        assert_eq!(load(name).name, name);
    }
    let turned = load("acc-2").robots[1].mount.heading;
    assert!((turned - PI / 6.0).abs() < 1e-6, "{turned}");
}

#[test]
fn an_entry_overrides_the_robot_table_field_by_field() {
    let text =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-2.toml"))
            .unwrap();
    let text = text.replace(
        "node = 3",
        "node = 3\nwheel_radius = 0.15\ncompensation = { lateral = 1.1 }",
    );
    let group = GroupFile::parse("tcc-2.toml", &text).unwrap();
    assert_eq!(group.robots[0].geometry.wheel_radius(), 0.1524);
    assert_eq!(group.robots[1].geometry.wheel_radius(), 0.15);
    assert_eq!(group.robots[1].geometry.half_track(), 0.370);
    assert_eq!(group.robots[1].compensation.lateral(), 1.1);
    assert_eq!(group.robots[1].compensation.longitudinal(), 1.002);
}

/// The feedforward of tcc-3's motor by hand: 0.3 ohm, 0.8 V s/rad, 24 V.
#[test]
fn an_identified_robot_keeps_its_motors_gains_and_wiring() {
    let mut file = load("tcc-3");
    assert!(
        !file.robots[1].control.identified,
        "unless the file says so"
    );
    let written = |file: &GroupFile| omnibus_group::parameters(file, &file.robots[1], true);
    let whole = written(&file);
    file.robots[1].control.identified = true;
    let parsed: Vec<u16> = whole
        .iter()
        .filter(|parameter| !written(&file).contains(parameter))
        .map(|(address, _)| address.index)
        .collect();
    // Two of 0x2020, five of each motor.
    let mut expected = vec![0x2020; 2];
    for index in 0x2021..=0x2024 {
        expected.extend([index; 5]);
    }
    assert_eq!(parsed, expected);
}

/// 0x202A:2; a robot keeps the tolerance it has when the file gives none.
#[test]
fn an_index_tolerance_is_written_when_it_is_given() {
    let text = "node = 2\nrollers = { count = 8, index_tolerance = 80 }\n";
    for (entry, expected) in [(text, Some(Value::U16(80))), ("node = 2\n", None)] {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single.toml");
        let file = std::fs::read_to_string(path)
            .unwrap()
            .replace("node = 2\n", entry);
        let file = GroupFile::parse("single.toml", &file).unwrap();
        let written = omnibus_group::parameters(&file, &file.robots[0], true)
            .into_iter()
            .find(|(at, _)| (at.index, at.sub) == (0x202A, 2));
        assert_eq!(written.map(|(_, value)| value), expected);
    }
}

#[test]
fn the_loss_at_the_hand_over_of_rollers_is_the_groups() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let text = text.replace("node = 2\n", "node = 2\nrollers = { count = 8 }\n");
    // The second name is that of version 0.1.
    for name in ["roller_transition", "hand_over"] {
        let table = format!("[{name}]\nloss_s_per_m = 0.0019\n\n[limits]");
        let file = GroupFile::parse("single.toml", &text.replace("[limits]", &table)).unwrap();
        assert_eq!(file.hand_over_loss, 0.0019);
    }
    assert_eq!(load("single").hand_over_loss, 0.0);
}

#[test]
fn feedforward_follows_from_the_motor() {
    let f = load("single").robots[0].motor.feedforward();
    // Torque of 1 N m takes 0.3 / 0.8 = 0.375 V, 0.015625 of 24 V.
    assert!((f.duty_static - 0.015_625).abs() < 1e-7, "{f:?}");
    assert!(
        (f.duty_per_rate - (0.8 / 24.0 + 0.02 * 0.015_625)).abs() < 1e-7,
        "{f:?}"
    );
    assert!(
        (f.duty_per_acceleration - 0.4 * 0.015_625).abs() < 1e-7,
        "{f:?}"
    );
    // (24 - 0.375) / (0.8 + 0.02 * 0.375) = 29.257 rad/s.
    let top = load("single").robots[0].motor.no_load_rate();
    assert!((top - 29.257).abs() < 1e-3, "{top}");
}

#[test]
fn a_compensation_table_is_the_robots_own_or_the_shared_one() {
    let text =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml"))
            .unwrap();
    let shared = text.replace(
        "yaw = 1.0195",
        "yaw = 1.0195\n[robot.compensation.table]\nversion = 20261121\nlateral = [[0.1, 1.141], [0.5, 1.157]]",
    );
    let own = shared.replace(
        "node = 3",
        "node = 3\ncompensation.table = { version = 7, oblique = [[0.3, 1.017, 1.0175]] }",
    );
    let group = GroupFile::parse("tcc-3.toml", &own).unwrap();
    let [first, second, _] = &group.robots[..] else {
        panic!("three robots");
    };
    assert_eq!(first.compensation_table.version, 20_261_121);
    assert_eq!(
        first.compensation_table.lateral,
        [Row::new(0.1, 1.141), Row::new(0.5, 1.157)]
    );
    assert_eq!(second.compensation_table.version, 7);
    assert!(second.compensation_table.lateral.is_empty());
    let [oblique] = second.compensation_table.oblique[..] else {
        panic!("one row");
    };
    assert_eq!(oblique.along(), Row::new(0.3, 1.017));
    assert_eq!(oblique.across(), Row::new(0.3, 1.0175));
    // What the tables do not have stays.
    assert_eq!(second.compensation.lateral(), 1.033);
    let plain = GroupFile::parse("tcc-3.toml", &text).unwrap();
    assert_eq!(plain.robots[0].compensation_table.version, 0);
}

/// What a robot writes of these objects, by index and sub-index.
fn written(file: &GroupFile, robot: usize, index: u16, sub: u8) -> Option<Value> {
    let all = omnibus_group::parameters(file, &file.robots[robot], true);
    let mut found = all
        .iter()
        .filter(|(at, _)| (at.index, at.sub) == (index, sub));
    found.next().map(|(_, value)| *value)
}

/// A robot that had another kind of motor driver before forgets it, too.
#[test]
fn the_kind_of_motor_driver_is_written_with_its_default() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let with = |keys: &str| {
        let text = text.replacen("largest_current = 40.0", "largest_current = 10.0", 1);
        // What a smart drive reports.
        let counts = match keys.contains("c6") {
            true => "counts_per_revolution = 8192",
            false => "counts_per_revolution = 40000",
        };
        let text = text.replacen("counts_per_revolution = 40000", counts, 1);
        text.replacen("largest_current", &format!("{keys}\nlargest_current"), 1)
    };
    for (keys, kind, wired) in [
        ("", 0, 0),
        ("enable_wired = true", 0, 1),
        ("output_stage = \"in-in-slow\"\nenable_wired = true", 1, 1),
        ("output_stage = \"in-in-fast\"", 2, 0),
        ("output_stage = \"in-in-brake\"", 6, 0),
        (
            "output_stage = \"locked-antiphase\"\nenable_wired = true",
            3,
            1,
        ),
        ("output_stage = \"c620\"", 4, 0),
        ("output_stage = \"c610\"", 5, 0),
    ] {
        let file = GroupFile::parse("single.toml", &with(keys)).unwrap();
        assert_eq!(
            written(&file, 0, 0x2027, 6),
            Some(Value::U8(kind)),
            "{keys}"
        );
        assert_eq!(
            written(&file, 0, 0x2027, 7),
            Some(Value::U8(wired)),
            "{keys}"
        );
    }
}

/// Identifiers of smart drives are those of the wheels in their order, each once; a robot with
/// bridges is not told any.
#[test]
fn the_identifiers_of_smart_drives_are_written() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/c620.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let with = |keys: &str| {
        let text = text.replacen("largest_current", &format!("{keys}\nlargest_current"), 1);
        GroupFile::parse("c620.toml", &text)
    };
    for (keys, identifiers) in [
        ("", [1, 2, 3, 4]),
        ("drive_identifiers = [3, 1, 4, 2]", [3, 1, 4, 2]),
    ] {
        let file = with(keys).unwrap();
        for (sub, identifier) in (1..).zip(identifiers) {
            let wanted = Some(Value::U8(identifier));
            assert_eq!(written(&file, 0, 0x202C, sub), wanted, "{keys}");
        }
    }
    for wrong in [
        "[1, 2, 3, 3]",
        "[0, 1, 2, 3]",
        "[1, 2, 3, 5]",
        "[1.5, 2, 3, 4]",
    ] {
        let refused = with(&format!("drive_identifiers = {wrong}")).unwrap_err();
        let refused = refused.to_string();
        assert!(refused.contains("each of 1, 2, 3 and 4 once"), "{refused}");
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single.toml");
    assert_eq!(written(&GroupFile::load(path).unwrap(), 0, 0x202C, 1), None);
}

/// What is mounted the other way round is the file's to say; a robot with identified motors keeps
/// its own bits where the file does not.
#[test]
fn directions_of_motors_and_encoders_are_written() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let bits = |keys: &str| {
        let text = text.replacen("[[robots]]", &format!("[[robots]]\n{keys}"), 1);
        let file = GroupFile::parse("single.toml", &text).map_err(|error| error.to_string())?;
        let byte = |sub| match written(&file, 0, 0x2020, sub) {
            Some(Value::U8(byte)) => Some(byte),
            _ => None,
        };
        Ok::<_, String>([byte(2), byte(3)])
    };
    assert_eq!(bits("").unwrap(), [Some(0), Some(0)]);
    let turned = "encoder.directions = [1, -1, 1, -1]\nmotor.directions = [1, 1, -1, 1]";
    assert_eq!(bits(turned).unwrap(), [Some(0b1010), Some(0b0100)]);
    assert_eq!(bits("control.identified = true").unwrap(), [None, None]);
    let both = format!("control.identified = true\n{turned}");
    assert_eq!(bits(&both).unwrap(), [Some(0b1010), Some(0b0100)]);
    for wrong in ["[1, 0, 1, 1]", "[1, -2, 1, 1]"] {
        let refused = bits(&format!("motor.directions = {wrong}")).unwrap_err();
        assert!(refused.contains("give 1 or -1"), "{refused}");
    }
}

/// A robot that had a sensor, a pause or another frequency before forgets it.
#[test]
fn sensors_and_frequencies_are_written_with_their_defaults() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let keys = "direction_pause = true\npwm_frequency = 16000\ncurrent_scale = 160\n\
                current_offset = 1.65\ncurrent_inputs = 2\nlargest_current";
    let given = text.replacen("largest_current", keys, 1);
    for (text, scale, offset, inputs, pause, hertz) in [
        (&given, 160.0, 1.65, 2, 1, 16_000),
        (&text, 0.0, 0.0, 1, 0, 20_000),
    ] {
        let file = GroupFile::parse("single.toml", text).unwrap();
        let written = |index, sub| written(&file, 0, index, sub);
        assert_eq!(written(0x2026, 3), Some(Value::F32(scale)));
        assert_eq!(written(0x2026, 4), Some(Value::F32(offset)));
        assert_eq!(written(0x2026, 5), Some(Value::U8(inputs)));
        assert_eq!(written(0x2027, 2), Some(Value::U8(pause)));
        assert_eq!(written(0x2027, 5), Some(Value::U16(hertz)));
    }
}

/// Otherwise the one with the quicker brake would begin to pull before the others.
#[test]
fn all_members_wait_for_the_slowest_brake() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let text = text.replacen("node = 3", "node = 3\nmotor.brake_release_ms = 80", 1);
    let file = GroupFile::parse("tcc-3.toml", &text).unwrap();
    for robot in 0..3 {
        assert_eq!(written(&file, robot, 0x2027, 3), Some(Value::U16(80)));
    }
}

/// 0x2026 and 0x2027: both halves of the torque bound or none, so that a robot that had one before
/// forgets it.
#[test]
fn the_output_stage_is_written_whole() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let start = text.find("largest_current").unwrap();
    let end = start + text[start..].find('\n').unwrap();
    let stage = "largest_duty = 0.95\nbrake_release_ms = 80\nbrake_engage_ms = 120";
    for (given, bound) in [(&text[start..end], (0.3, 40.0)), ("", (0.0, 0.0))] {
        let text = text.replace(&text[start..end], &format!("{given}\n{stage}"));
        let file = GroupFile::parse("single.toml", &text).unwrap();
        let all = omnibus_group::parameters(&file, &file.robots[0], true);
        let written = |index, sub| {
            let found = all
                .iter()
                .find(|(at, _)| (at.index, at.sub) == (index, sub));
            found.map(|(_, value)| *value)
        };
        assert_eq!(written(0x2026, 1), Some(Value::F32(bound.0)));
        assert_eq!(written(0x2026, 2), Some(Value::F32(bound.1)));
        assert_eq!(written(0x2027, 1), Some(Value::F32(0.95)));
        assert_eq!(written(0x2027, 3), Some(Value::U16(80)));
        assert_eq!(written(0x2027, 4), Some(Value::U16(120)));
    }
}
