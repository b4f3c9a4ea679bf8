//! The contact plant against closed form. Ripple and rollers: `contact_rollers.rs`; the paper's
//! tables: `paper_tables.rs`.

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
        roller_damping: 0.0,
        roller_density: 0.0,
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

/// Wheels that suddenly turn fast push as hard as friction allows: along each roller's axle, of
/// which the sine of the roller angle points ahead. 0.35 * 9.81 * sin 45 = 2.428 m/s2.
#[test]
fn acceleration_ends_at_the_friction_limit() {
    let mut plant = plant(
        "single",
        Contact {
            rollers: 64,
            roller_ratio: 1.0,
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

/// On the spot with the contact in the wheel's middle: at roller phase phi the four contacts agree
/// on `w = rate r cos(phi) / (H + W cos(phi))`; its mean over a roller by Simpson's rule.
#[test]
fn pure_spin_is_the_mean_over_a_roller() {
    let contact = Contact {
        roller_ratio: 1.0,
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

/// The virtual robot with rollers at another angle.
fn tilted(degrees: f64, contact: Contact) -> ContactPlant {
    let path = format!("{}/../groups/single.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).unwrap();
    let text = text.replace(
        "roller_angle_deg = 45.0",
        &format!("roller_angle_deg = {degrees}"),
    );
    ContactPlant::new(&GroupFile::parse("tilted", &text).unwrap(), contact, START).unwrap()
}

/// Wheels at 1 rad/s push sideways with `r tan(g)`, of which the rollers let `sin(pi/n) / (pi/n)`
/// through: whatever their angle, for n = 8, 10, 12, to 0.1 %.
#[test]
fn lateral_ratio_at_other_roller_angles() {
    for degrees in [30.0, 60.0] {
        for rollers in [8, 10, 12] {
            let mut plant = tilted(degrees, Contact { rollers, ..clean() });
            drive(&mut plant, LEFT, 1.0, 1.5);
            let before = plant.group();
            // Two turns of the wheels: whole roller passages for any n.
            drive(&mut plant, LEFT, 1.0, 2.0 * TAU);
            let seconds = (2.0 * TAU / DT).round() * DT;
            let velocity = (plant.group().y - before.y) / seconds;
            let ideal = R * degrees.to_radians().tan();
            let ratio = mean_lateral_ratio(rollers);
            assert!(
                (velocity / ideal / ratio - 1.0).abs() < 1e-3,
                "{degrees} degrees, {rollers} rollers: {} {ratio}",
                velocity / ideal
            );
        }
    }
}

/// The ripple is `1 - cos(pi/n)` deep, n times a turn, for other wheels too.
#[test]
fn ripple_of_ten_and_twelve_rollers() {
    for rollers in [10, 12] {
        let mut plant = plant("single", Contact { rollers, ..clean() });
        drive(&mut plant, LEFT, 1.0, 1.5);
        let (mut low, mut high, mut valleys) = (f64::MAX, f64::MIN, 0);
        let mut last = [f64::MAX; 2];
        for _ in 0..(TAU / DT).round() as u32 {
            drive(&mut plant, LEFT, 1.0, DT);
            let ratio = plant.velocity(0).unwrap()[1] / R;
            (low, high) = (low.min(ratio), high.max(ratio));
            valleys += u8::from(last[1] < last[0] && ratio > last[1]);
            last = [last[1], ratio];
        }
        let deep = (PI / f64::from(rollers)).cos();
        assert!((low - deep).abs() < 1e-3, "{rollers}: {low} {deep}");
        assert!((high - 1.0).abs() < 1e-3, "{rollers}: {high}");
        // A turn that begins in a valley has it at both ends.
        assert!([rollers, rollers + 1].contains(&valleys), "{valleys}");
    }
}

/// The friction limit along rollers at 30 degrees: half of each roller's push points ahead.
#[test]
fn friction_limit_at_30_degrees() {
    let contact = Contact {
        rollers: 64,
        roller_ratio: 1.0,
        ..clean()
    };
    let mut plant = tilted(30.0, contact);
    drive(&mut plant, FORWARD, 100.0, 0.5);
    let speed = plant.velocity(0).unwrap()[0];
    let expected = 0.35 * GRAVITY * 0.5 * 0.5;
    // 2.8 degrees of tilt change sin(30) cos(phi) / length by 0.09 %.
    assert!(
        (speed / expected - 1.0).abs() < 1.5e-3,
        "{speed} {expected}"
    );
}

/// The group file's values with a table of its own under `[simulation]`.
fn simulated(name: &str, table: &str) -> Result<ContactPlant, omnibus_sim::SimError> {
    let path = format!("{}/../groups/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).unwrap();
    let text = text
        .replace("plant = \"table\"", "plant = \"contact\"")
        .replace("[simulation]\n", &format!("[simulation]\n{table}\n"));
    let group = GroupFile::parse(name, &text).unwrap();
    let contact = Contact {
        rollers: 64,
        roller_ratio: 1.0,
        friction: Contact::of(&group, 8).friction,
        mass: Contact::of(&group, 8).mass,
        ..clean()
    };
    ContactPlant::new(&group, contact, START)
}

/// Held wheels on friction 0.35 until x = 0.5, then on 0.1: with a = 9.81 sin 45 times the
/// friction, 2 m/s are `sqrt(4 - 2 * 0.35 a * 0.5)` at the border and stop `v^2 / (0.2 a)` past it.
/// Between the axles, which are 0.7 m apart, both act; the work of each axle's half of the weight
/// is the same as if the border were met by the centre: the rear axle brakes harder 0.35 m longer,
/// the front axle as much less.
#[test]
fn a_slippery_patch_stops_later() {
    let table = "floor = [{ x = [0.5, 10], y = [-5, 5], friction = 0.1 }]";
    let mut plant = simulated("single", table).unwrap();
    plant.set_velocity(0, [2.0, 0.0, 0.0]);
    drive(&mut plant, FORWARD, 0.0, 4.0);
    let a = GRAVITY * FRAC_1_SQRT_2;
    let at_border = 4.0 - 2.0 * 0.35 * a * 0.5;
    let distance = 0.5 + at_border / (2.0 * 0.1 * a);
    // 64 rollers are off by 0.06 %; a step across the border is 0.5 mm.
    assert!(
        (plant.group().x / distance - 1.0).abs() < 2e-3,
        "{:?} {distance}",
        plant.group()
    );
}

/// 200 kg on three robots of 200 kg, 0.3 m ahead and 0.2 m left: the centre of mass is 0.075 m
/// ahead and 0.05 m left of the twelve wheels' middle, so each carries `c = 0.05 weight / (12 *
/// 0.37^2)` more a metre to the left. Held wheels that slide ahead push aside by their hand as much
/// as ahead; over the corners of a robot that leaves the moment `friction cos 45 * 4 h w c`.
#[test]
fn a_payload_aside_turns_sliding_wheels_as_statics_say() {
    let table = "payload = { mass = 200, x = 0.3, y = 0.2 }";
    let mut plant = simulated("tcc-3", table).unwrap();
    plant.set_velocity(0, [1.0, 0.0, 0.0]);
    drive(&mut plant, FORWARD, 0.0, DT);
    let weight = 800.0 * GRAVITY;
    let c = 0.05 * weight / (12.0 * W * W);
    let moment = 0.35 * FRAC_1_SQRT_2 * 3.0 * 4.0 * H * W * c;
    let robot = |x: f64| 200.0 * ((W * W + H * H) / 3.0 + (x - 0.075).powi(2) + 0.05 * 0.05);
    let inertia: f64 = [1.2, 0.0, -1.2].map(robot).iter().sum();
    let inertia = inertia + 200.0 * (0.225f64.powi(2) + 0.15f64.powi(2));
    let velocity = plant.velocity(0).unwrap();
    let expected = moment / inertia * DT;
    assert!(
        (velocity[2] / expected - 1.0).abs() < 1e-3,
        "{velocity:?} {expected}"
    );
    // Friction goes with weight: it slows down as if it carried nothing.
    let slower = 0.35 * GRAVITY * FRAC_1_SQRT_2 * DT;
    assert!(
        ((1.0 - velocity[0]) / slower - 1.0).abs() < 1e-3,
        "{velocity:?} {slower}"
    );
}

/// 400 kg on a robot of 200 kg, 0.8 m aside: the centre is 0.53 m out, the wheels are at 0.37 m.
#[test]
fn a_payload_beyond_the_wheels_is_refused() {
    let error = simulated("single", "payload = { mass = 400, y = 0.8 }")
        .err()
        .unwrap();
    assert_eq!(
        error.to_string(),
        "plant: simulation.payload: tips the group over; put it between the wheels, or make it \
         lighter"
    );
    assert!(simulated("single", "payload = { mass = 400, y = 0.2 }").is_ok());
}

/// The paper's figure 24b, d: along a circle free robots' distance changes, connected ones' does
/// not. The same two robots, the same rollers, the same wheel rates; only the load between them is
/// missing.
#[test]
fn free_robots_drift_connected_ones_do_not() {
    let path = format!("{}/../groups/tcc-2.toml", env!("CARGO_MANIFEST_DIR"));
    let mut group = GroupFile::load(path).unwrap();
    let contact = Contact {
        scattered: true,
        ..Contact::default()
    };
    let mut change = |rigid| {
        group.simulation.rigid = rigid;
        let mut plant = ContactPlant::new(&group, contact, START).unwrap();
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        // 2.5 m, pi/10 rad/s, one round: ahead and left by turns.
        let rate = 2.5 * PI / 10.0 / R;
        for step in 0..(20.0 / DT) as u32 {
            let (sin, cos) = (PI / 10.0 * f64::from(step) * DT).sin_cos();
            let turned = [cos - sin, cos + sin, cos + sin, cos - sin].map(|p| p * rate * DT);
            plant.step(DT, &[turned; 2]).unwrap();
            let [a, b] = [plant.poses()[0], plant.poses()[1]];
            let distance = (a.x - b.x).hypot(a.y - b.y);
            (low, high) = (low.min(distance), high.max(distance));
        }
        high - low
    };
    let (free, connected) = (change(false), change(true));
    println!(
        "distance changes by {:.1} mm free, {connected:e} m connected",
        free * 1e3
    );
    assert!(connected < 1e-12, "{connected}");
    assert!(free > 5e-3, "{free}");
}
