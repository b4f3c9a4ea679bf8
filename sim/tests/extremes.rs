//! Every number of a group file that a simulated world computes with, at its extremes: the file is
//! refused with the name of the key, or the world runs for a second.
//!
//! Each case is one file of which one number is replaced. Keys that only robots compute with have
//! tests of their own (`group/tests/refusals.rs`).

use std::panic::{AssertUnwindSafe, catch_unwind};

use canopen::NmtCommand;
use group::GroupFile;
use kinematics::Twist;
use omnibus_sim::configure::configure;
use omnibus_sim::test_master::TestMaster;
use omnibus_sim::{Backend, Options, World};

/// What each number becomes.
const EXTREMES: [&str; 22] = [
    "5e-324", "1e-300", "1e-45", "1e-30", "1e-12", "1e-9", "1e-6", "1e-4", "1e-2", "0", "1", "1e2",
    "1e4", "1e6", "1e9", "1e13", "1e20", "1e30", "1e300", "-1", "inf", "nan",
];

/// Keys whose value is a list; their numbers have tables of their own in the base file.
const LISTS: [&str; 2] = ["directions", "crystal_ppm"];

const ROBOT: &str = "
name = \"extreme\"
group_id = 1

[robot]
half_track = 0.37
half_wheelbase = 0.35
wheel_radius = 0.1524
roller_angle_deg = 45.0
max_wheel_rate = 15.0

[robot.encoder]
counts_per_revolution = 4000
gear_ratio = 10.0

[robot.motor]
supply = 24.0
constant = 0.8
resistance = 0.3
inductance = 0.0003
inertia = 0.4
friction = 1.0
viscous = 0.02

[[robots]]
node = 2

[simulation]
backlash_deg = 0.5
";

const CONTACT: &str = "
plant = \"contact\"
rollers = 8
seed = 3
friction = 0.5
robot_mass = 60.0
wheel_inertia = 0.05

[simulation.payload]
mass = 30.0
x = 0.01
y = 0.02

[[simulation.floor]]
x = [0.5, 2.0]
y = [-1.5, 1.5]
friction = 0.4
";

const INSTRUMENTS: &str = "
[simulation.battery]
resistance = 0.05
capacity_ah = 20.0
charge = 0.9

[simulation.encoder]
lost = 0.01
extra_per_s = 10.0

[[simulation.encoder_faults]]
node = 2
wheel = \"front-left\"
kind = \"one-channel\"
at = 0.9

[simulation.pose_noise]
position_mm = 1.0
heading_mrad = 2.0

[simulation.gyro]
rate_hz = 200
noise_dps_rthz = 0.005
bias_dps = 0.5
drift_dps_rts = 3e-4
delay_ms = 4.0
";

/// One second of driving in every direction, in a world that can be built.
fn run(group: &GroupFile) {
    let mut world = match World::new(group, Backend::Native, Options::default()) {
        Ok(world) => world,
        // Whether a load lifts a wheel is known once the plant stands.
        Err(error) => return assert!(error.to_string().contains("payload"), "{error}"),
    };
    configure(&mut world, group, true).unwrap();
    let mut master = TestMaster::new(world, group);
    master.run(60).unwrap();
    master.command(NmtCommand::Start, None);
    master.run(100).unwrap();
    master.twist = Some(Twist::new(0.3, 0.2, 0.3));
    master.run(840).unwrap();
    let pose = master.world.truth().group;
    assert!(pose.x.is_finite() && pose.y.is_finite() && pose.heading.is_finite());
}

/// What else than its key names a number.
fn other_names(key: &str) -> &'static str {
    match key {
        "counts_per_revolution" => "counts per revolution",
        "roller_angle_deg" => "RollerAngle",
        "resistance" | "constant" | "viscous" => "time constant",
        _ => "max_wheel_rate",
    }
}

/// What is wrong with one file; `None` if nothing.
fn complaint(text: &str, key: &str, value: &str) -> Option<String> {
    match GroupFile::parse("extreme.toml", text) {
        Err(error) => {
            let message = error.to_string();
            let names = message.contains(key)
                || message.contains(other_names(key))
                || message.contains("max_wheel_rate");
            (!names).then(|| format!("{key} = {value}: refused as {message}"))
        }
        Ok(group) => catch_unwind(AssertUnwindSafe(|| run(&group)))
            .err()
            .map(|_| format!("{key} = {value}: panics")),
    }
}

/// The lines of a text with a number, and the same with another number.
fn variants(text: &str) -> impl Iterator<Item = (String, &'static str, String)> {
    let lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let numbers: Vec<(usize, String)> = lines
        .iter()
        .enumerate()
        .filter_map(|(n, line)| {
            let (key, value) = line.split_once(" = ")?;
            value.parse::<f64>().ok()?;
            Some((n, key.to_owned()))
        })
        .filter(|(_, key)| !["group_id", "node", "seed"].contains(&key.as_str()))
        .collect();
    numbers.into_iter().flat_map(move |(n, key)| {
        let lines = lines.clone();
        EXTREMES.into_iter().map(move |value| {
            let mut lines = lines.clone();
            lines[n] = format!("{key} = {value}");
            (key.clone(), value, lines.join("\n"))
        })
    })
}

fn none_panics(text: &str) {
    run(&GroupFile::parse("extreme.toml", text).unwrap());
    let complaints: Vec<String> = variants(text)
        .filter_map(|(key, value, text)| complaint(&text, &key, value))
        .collect();
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
}

#[test]
fn on_the_table_plant_extremes_are_refused_or_run() {
    none_panics(&format!("{ROBOT}{INSTRUMENTS}"));
}

#[test]
fn on_the_contact_plant_extremes_are_refused_or_run() {
    none_panics(&format!("{ROBOT}{CONTACT}{INSTRUMENTS}"));
}

/// A key that is added to the file gets its case here.
#[test]
fn no_number_of_a_simulation_is_missing_here() {
    let schema: serde_json::Value = serde_json::from_str(&group::reference::schema()).unwrap();
    let text = format!("{ROBOT}{CONTACT}{INSTRUMENTS}");
    let file = &schema["properties"];
    let motor = &file["robot"]["properties"]["motor"]["properties"];
    let simulated = [
        "supply",
        "constant",
        "resistance",
        "inductance",
        "inertia",
        "friction",
        "viscous",
    ];
    for key in simulated {
        assert_eq!(motor[key]["type"], "number", "{key}");
        assert!(text.contains(&format!("\n{key} = ")), "{key}");
    }
    let mut open = vec![&file["simulation"]];
    while let Some(table) = open.pop() {
        for (key, field) in table["properties"].as_object().unwrap() {
            let inner = if field["type"] == "array" {
                &field["items"]
            } else {
                field
            };
            if inner["properties"].is_object() {
                open.push(inner);
            }
            let number = ["number", "integer"].contains(&inner["type"].as_str().unwrap_or(""));
            let listed = LISTS.contains(&key.as_str());
            assert!(
                !number || listed || text.contains(&format!("\n{key} = ")),
                "{key}"
            );
        }
    }
}
