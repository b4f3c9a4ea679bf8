//! The contact plant against closed form, and against the paper's tables.

#![expect(
    clippy::approx_constant,
    reason = "the paper prints 15, 30 and 45 degrees like this"
)]

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use group::GroupFile;
use kinematics::Pose;
use omnibus_sim::plant::Plant;
use omnibus_sim::plant::contact::{Contact, ContactPlant, mean_lateral_ratio};

const DT: f64 = 250e-6;
const W: f64 = 0.37;
const H: f64 = 0.35;
const R: f64 = 0.1524;
const GRAVITY: f64 = 9.81;
const START: Pose<f64> = Pose {
    x: 0.0,
    y: 0.0,
    heading: 0.0,
};

const FORWARD: [f64; 4] = [1.0; 4];
const LEFT: [f64; 4] = [-1.0, 1.0, 1.0, -1.0];
const TURN: [f64; 4] = [-1.0, 1.0, -1.0, 1.0];

/// No losses but geometry.
fn clean() -> Contact {
    Contact {
        creep: 0.0,
        settling: 0.0,
        roller_friction: 0.0,
        ..Contact::default()
    }
}

fn plant(name: &str, contact: Contact) -> ContactPlant {
    let path = format!("{}/../groups/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    ContactPlant::new(&GroupFile::load(path).unwrap(), contact, START).unwrap()
}

/// Steps with all robots' wheels at `rate` times `pattern`.
fn drive(plant: &mut ContactPlant, pattern: [f64; 4], rate: f64, seconds: f64) {
    let turned = vec![pattern.map(|p| p * rate * DT); plant.poses().len()];
    for _ in 0..(seconds / DT).round() as u64 {
        plant.step(DT, &turned).unwrap();
    }
}

/// Mean velocity over whole roller passages, after a second and a half to get up to speed.
fn steady(name: &str, contact: Contact, pattern: [f64; 4], rate: f64) -> Pose<f64> {
    let mut plant = plant(name, contact);
    drive(&mut plant, pattern, rate, 1.5);
    let before = plant.group();
    let passage = TAU / f64::from(contact.rollers) / rate;
    let seconds = (10.0 / passage).ceil() * passage;
    drive(&mut plant, pattern, rate, seconds);
    let seconds = (seconds / DT).round() * DT;
    let after = plant.group();
    Pose::new(
        (after.x - before.x) / seconds,
        (after.y - before.y) / seconds,
        (after.heading - before.heading) / seconds,
    )
}

/// Wheels that suddenly turn fast push as hard as friction allows: along each roller's axle, of which
/// the sine of the roller angle points ahead. 0.35 * 9.81 * sin 45 = 2.428 m/s2.
#[test]
fn acceleration_ends_at_the_friction_limit() {
    let mut plant = plant(
        "single",
        Contact {
            rollers: 64,
            roller_radius: R,
            ..clean()
        },
    );
    drive(&mut plant, FORWARD, 100.0, 0.5);
    let speed = plant.velocity(0).unwrap()[0];
    let expected = 0.35 * GRAVITY * FRAC_1_SQRT_2 * 0.5;
    // With 64 rollers the axle tilts by 2.8 degrees at most: sin g cos phi changes by 0.06 %.
    assert!((speed / expected - 1.0).abs() < 1e-3, "{speed} {expected}");
}

/// Wheels held, the robot slides ahead: the same force the other way, and it stops for good.
#[test]
fn slides_to_a_stop_on_held_wheels() {
    let mut plant = plant("single", clean());
    plant.set_velocity(0, [1.0, 0.0, 0.0]);
    drive(&mut plant, FORWARD, 0.0, 1.0);
    let deceleration = 0.35 * GRAVITY * FRAC_1_SQRT_2;
    let distance = 0.5 / deceleration;
    assert!(
        (plant.group().x - distance).abs() < DT,
        "{:?} {distance}",
        plant.group()
    );
    assert!(plant.velocity(0).unwrap().iter().all(|v| v.abs() < 1e-9));
}

/// Wheels that go along with the robot's motion do not touch it: it coasts.
#[test]
fn coasts_when_the_wheels_go_along() {
    let mut plant = plant("tcc-3", clean());
    plant.set_velocity(0, [0.5, 0.0, 0.0]);
    drive(&mut plant, FORWARD, 0.5 / f64::from(0.1524f32), 2.0);
    assert!((plant.group().x - 1.0).abs() < 1e-9, "{:?}", plant.group());
}

#[test]
fn longitudinal_motion_loses_nothing_but_settling() {
    let v = steady("single", clean(), FORWARD, 2.0);
    assert!((v.x / (2.0 * R) - 1.0).abs() < 1e-6, "{v:?}");
    let settled = Contact {
        settling: 0.0022,
        ..clean()
    };
    let v = steady("single", settled, FORWARD, 2.0);
    assert!((v.x / (2.0 * R) - (1.0 - 0.0022)).abs() < 1e-6, "{v:?}");
}

/// sin(pi/n) / (pi/n), to 0.1 %, for several n.
#[test]
fn mean_lateral_loss_is_geometry() {
    for rollers in [6, 8, 9, 12] {
        let v = steady("single", Contact { rollers, ..clean() }, LEFT, 1.0);
        let half = PI / f64::from(rollers);
        assert!(
            (v.y / R - half.sin() / half).abs() < 1e-3,
            "{rollers}: {v:?}"
        );
        assert!((v.x.abs() + v.heading.abs()) < 1e-9, "{v:?}");
    }
    assert!((mean_lateral_ratio(8) - 0.9745).abs() < 5e-5);
}

/// Lateral velocity swings between cos(pi/n) and 1, once a roller: n times a wheel's turn.
#[test]
fn lateral_ripple_has_the_amplitude_and_period_of_the_rollers() {
    let mut plant = plant("single", clean());
    let rate = 1.0;
    drive(&mut plant, LEFT, rate, 1.5);
    let (mut low, mut high) = (f64::MAX, f64::MIN);
    let mut peaks: Vec<f64> = Vec::new();
    let mut last = [0.0; 2];
    let steps = (TAU / rate / DT).round() as u32;
    for step in 0..steps {
        drive(&mut plant, LEFT, rate, DT);
        let ratio = plant.velocity(0).unwrap()[1] / (rate * R);
        (low, high) = (low.min(ratio), high.max(ratio));
        if last[1] < last[0] && ratio > last[1] {
            peaks.push(f64::from(step) * DT);
        }
        last = [last[1], ratio];
    }
    assert!((low - (PI / 8.0).cos()).abs() < 1e-3, "{low}");
    assert!((high - 1.0).abs() < 1e-3, "{high}");
    assert_eq!(peaks.len(), 8, "{peaks:?}");
    let period = TAU / 8.0 / rate;
    for pair in peaks.windows(2) {
        assert!((pair[1] - pair[0] - period).abs() < 3.0 * DT, "{peaks:?}");
    }
}

/// On the spot with the contact in the wheel's middle: at roller phase phi the four contacts agree on
/// `w = rate r cos(phi) / (H + W cos(phi))`; its mean over a roller by Simpson's rule.
#[test]
fn pure_spin_is_the_mean_over_a_roller() {
    let contact = Contact {
        roller_radius: R,
        ..clean()
    };
    let v = steady("single", contact, TURN, 1.0);
    let value = |phi: f64| R * phi.cos() / (H + W * phi.cos());
    let (n, half) = (200, PI / 8.0);
    let weight = |k: u32| match k {
        0 | 200 => 1.0,
        k if k % 2 == 1 => 4.0,
        _ => 2.0,
    };
    let sum: f64 = (0..=n)
        .map(|k| weight(k) * value(-half + 2.0 * half * f64::from(k) / f64::from(n)))
        .sum();
    let mean = sum / (3.0 * f64::from(n));
    assert!((v.heading / mean - 1.0).abs() < 1e-3, "{v:?} {mean}");
}

/// Connected robots are one body: as fast as one alone, and every robot in its place.
#[test]
fn a_rigid_group_moves_as_one_of_its_members() {
    let one = steady("single", clean(), LEFT, 1.0);
    let three = steady("tcc-3", clean(), LEFT, 1.0);
    assert!((three.y / one.y - 1.0).abs() < 1e-6, "{one:?} {three:?}");
    let mut group = plant("tcc-3", clean());
    drive(&mut group, LEFT, 1.0, 2.0);
    assert!(group.shape_error_mm() < 1e-3, "{}", group.shape_error_mm());
}

/// Free robots with rollers in different phase drift apart; with equal phases they never would.
#[test]
fn free_robots_drift_apart_when_their_rollers_differ() {
    let path = format!("{}/../groups/tcc-2.toml", env!("CARGO_MANIFEST_DIR"));
    let mut group = GroupFile::load(path).unwrap();
    group.simulation.rigid = false;
    let error = |scattered| {
        let contact = Contact {
            scattered,
            ..Contact::default()
        };
        let mut plant = ContactPlant::new(&group, contact, START).unwrap();
        drive(&mut plant, LEFT, 2.0, 30.0);
        let [a, b] = [plant.poses()[0], plant.poses()[1]];
        (a.x - b.x).hypot(a.y - b.y) - 1.2
    };
    assert!(error(false).abs() < 1e-6, "{}", error(false));
    assert!(error(true).abs() > 1e-3, "{}", error(true));
}

/// Tables 3 and 5 to half a point of per cent.
#[test]
fn the_papers_tables_within_half_a_point() {
    let contact = Contact::default();
    for (pattern, asked, measured) in [
        (FORWARD, 0.1, -0.233),
        (FORWARD, 0.5, -0.219),
        (LEFT, 0.1, -3.072),
        (LEFT, 0.3, -3.165),
        (LEFT, 0.5, -3.36),
    ] {
        let v = steady("single", contact, pattern, asked / R);
        let error = ((v.x + v.y) / asked - 1.0) * 100.0;
        println!("{asked} m/s: {error:.3} %, paper {measured} %");
        assert!(
            (error - measured).abs() < 0.5,
            "{asked} m/s: {error} %, paper {measured} %"
        );
    }
    for (asked, measured) in [(0.261799, -1.753), (0.523599, -1.920), (0.785398, -2.182)] {
        let v = steady("single", contact, TURN, asked * (W + H) / R);
        let error = (v.heading / asked - 1.0) * 100.0;
        println!("{asked} rad/s: {error:.3} %, paper {measured} %");
        assert!(
            (error - measured).abs() < 0.5,
            "{asked} rad/s: {error} %, paper {measured} %"
        );
    }
}
