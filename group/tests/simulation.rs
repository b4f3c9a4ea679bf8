//! The `[simulation]` table: what its values become, and what it is refused for.

#[macro_use]
mod common;

use omnibus_group::{
    Battery, EncoderFault, EncoderFaultKind, EncoderNoise, GroupFile, Gyro, Patch, Payload,
    PoseNoise, WheelName,
};

const ROBOTS: &str = concat!(
    "name = \"pair\"\ngroup_id = 7\n",
    robot!(),
    members!(),
    "[simulation]\n"
);

fn parsed(simulation: &str) -> GroupFile {
    GroupFile::parse("pair.toml", &format!("{ROBOTS}{simulation}"))
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Without the name of the file; the table's first line is 18.
fn refusal(simulation: &str) -> String {
    GroupFile::parse("pair.toml", &format!("{ROBOTS}{simulation}"))
        .expect_err("must be refused")
        .to_string()
}

#[test]
fn an_empty_table_is_a_perfect_robot() {
    let simulation = parsed("").simulation;
    assert_eq!(simulation.battery, None);
    assert_eq!(simulation.backlash, 0.0);
    assert_eq!(simulation.encoder_noise, EncoderNoise::default());
    assert_eq!(simulation.encoder_faults, []);
    assert_eq!(simulation.pose_noise, PoseNoise::default());
    assert_eq!(simulation.gyro, Gyro::default());
    assert_eq!(simulation.contact, omnibus_group::Contact::default());
}

#[test]
fn every_value_arrives_in_si_units() {
    let simulation = parsed(
        r#"plant = "contact"
backlash_deg = 0.9
friction = 0.5
robot_mass = 150
wheel_inertia = 0.05
scattered_rollers = true
battery = { resistance = 0.05, capacity_ah = 20, charge = 0.5, curve = [[0, 21], [1, 25.2]] }
encoder = { lost = 0.01, extra_per_s = 3 }
pose_noise = { position_mm = 2, heading_mrad = 0.5 }
gyro = { rate_hz = 100, noise_dps_rthz = 180, bias_dps = -90, drift_dps_rts = 45, delay_ms = 2 }
payload = { mass = 80, x = 0.1, y = -0.2 }
[[simulation.encoder_faults]]
node = 3
wheel = "rear-left"
kind = "one-channel"
at = 1.5
[[simulation.floor]]
x = [1, 2]
y = [-0.5, 0.5]
friction = 0.1
"#,
    )
    .simulation;
    assert_eq!(
        simulation.battery,
        Some(Battery {
            resistance: 0.05,
            capacity_ah: Some(20.0),
            charge: 0.5,
            curve: vec![(0.0, 21.0), (1.0, 25.2)],
        })
    );
    // A hundredth of a quarter turn.
    assert!((simulation.backlash - std::f64::consts::FRAC_PI_2 / 100.0).abs() < 1e-15);
    assert_eq!(
        simulation.encoder_noise,
        EncoderNoise {
            lost: 0.01,
            extra_per_s: 3.0
        }
    );
    assert_eq!(
        simulation.encoder_faults,
        [EncoderFault {
            robot: 1,
            wheel: WheelName::RearLeft,
            kind: EncoderFaultKind::OneChannel,
            at: 1.5,
        }]
    );
    assert_eq!(
        simulation.pose_noise,
        PoseNoise {
            position: 0.002,
            heading: 0.0005
        }
    );
    assert_eq!(
        simulation.gyro,
        Gyro {
            rate_hz: 100,
            noise: std::f64::consts::PI,
            bias: -std::f64::consts::FRAC_PI_2,
            drift: std::f64::consts::FRAC_PI_4,
            delay: 0.002,
        }
    );
    let contact = simulation.contact;
    assert_eq!(
        (contact.friction, contact.robot_mass, contact.wheel_inertia),
        (Some(0.5), Some(150.0), Some(0.05))
    );
    assert!(contact.scattered);
    assert_eq!(
        contact.payload,
        Some(Payload {
            mass: 80.0,
            x: 0.1,
            y: -0.2
        })
    );
    assert_eq!(
        contact.floor,
        [Patch {
            x: (1.0, 2.0),
            y: (-0.5, 0.5),
            friction: 0.1
        }]
    );
}

#[test]
fn numbers_out_of_range_are_refused_by_name() {
    for (text, expected) in [
        (
            "battery = { resistance = -1 }",
            "simulation.battery.resistance: is -1; give 0 or a positive number",
        ),
        (
            "battery = { resistance = 0, capacity_ah = 0 }",
            "simulation.battery.capacity_ah: is 0; give a number greater than 0",
        ),
        (
            "battery = { resistance = 0, charge = 1.5 }",
            "simulation.battery.charge: is 1.5; give a number from 0 to 1",
        ),
        (
            "battery = { resistance = 0, curve = [[0, 21], [0, 22]] }",
            "simulation.battery.curve: has the row [0, 22]; give the rows in order of rising \
             charge",
        ),
        (
            "battery = { resistance = 0, curve = [[2, 21]] }",
            "simulation.battery.curve: has the row [2, 21]; give rows [charge 0 to 1, volts above \
             0 up to 1000]",
        ),
        (
            "backlash_deg = 45",
            "simulation.backlash_deg: is 45; give a number from 0 to 10",
        ),
        (
            "encoder = { lost = 2 }",
            "simulation.encoder.lost: is 2; give a number from 0 to 1",
        ),
        (
            "encoder = { extra_per_s = nan }",
            "simulation.encoder.extra_per_s: is nan; give 0 or a positive number",
        ),
        (
            "gyro = { rate_hz = 150 }",
            "simulation.gyro.rate_hz: is 150; give a divisor of 4000, for example 100 or 200",
        ),
        (
            "gyro = { noise_dps_rthz = -1 }",
            "simulation.gyro.noise_dps_rthz: is -1; give 0 or a positive number",
        ),
        (
            "pose_noise = { position_mm = -1 }",
            "simulation.pose_noise.position_mm: is -1; give 0 or a positive number",
        ),
        (
            "encoder_faults = [{ node = 9, wheel = \"rear-left\", kind = \"dead\" }]",
            "simulation.encoder_faults[0].node: is 9, which no robot has; give the node of a \
             robot in this file",
        ),
    ] {
        assert_eq!(refusal(text), format!("pair.toml:20: {expected}"));
    }
}

#[test]
fn only_the_contact_plant_knows_floors_and_loads() {
    assert_eq!(
        refusal("friction = 0.5"),
        "pair.toml:20: simulation.friction: has no effect on this plant; set plant = \"contact\", \
         or remove it"
    );
    assert_eq!(
        refusal("plant = \"contact\"\nfriction = 0"),
        "pair.toml:21: simulation.friction: is 0; give a number greater than 0"
    );
    assert_eq!(
        refusal("plant = \"contact\"\nfloor = [{ x = [2, 1], y = [0, 1], friction = 0.1 }]"),
        "pair.toml:21: simulation.floor[0].x: is [2, 1]; give [from, to] in metres, the smaller \
         first, from -1e6 to 1e6"
    );
    assert_eq!(
        refusal("plant = \"contact\"\nrigid = false\npayload = { mass = 50 }"),
        "pair.toml:22: simulation.payload: lies on robots that are not connected; set rigid = \
         true, or remove it"
    );
}

/// A motor of 0.8 V s/rad and 0.3 ohm brakes with 2.133 N m s/rad.
#[test]
fn robots_that_cannot_be_are_refused() {
    let refusal = |from: &str, to: &str| {
        assert_eq!(ROBOTS.matches(from).count(), 1, "{from:?} must occur once");
        GroupFile::parse("pair.toml", &ROBOTS.replace(from, to))
            .expect_err("must be refused")
            .to_string()
    };
    for (from, to, expected) in [
        (
            "inertia = 0.4",
            "inertia = 1e-6",
            "robots[0].motor.inertia: is 1e-6 kg m2: with the rest of the motor a time constant \
             below 1 ms; give 0.0023 kg m2 or more, or fix `motor`",
        ),
        (
            "half_wheelbase = 0.35",
            "half_wheelbase = 0.15",
            "robots[0]: the front left and the rear left wheel are inside each other; fix \
             half_wheelbase and wheel_radius, or the wheels' places: between the centres of two \
             wheels in line are at least both radii",
        ),
    ] {
        let found = refusal(from, to);
        assert!(found.ends_with(expected), "{found}");
    }
}
