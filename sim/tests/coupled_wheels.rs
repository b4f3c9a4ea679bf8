//! Wheels that are coupled through the load: the contact plant with a wheel inertia, against closed
//! form.
//!
//! One robot with motors that are off and brakes that are open, so that a torque at a wheel is what
//! turns it.

use canopen::{Frame, Micros};
use group::GroupFile;
use omnibus_sim::motor::Bridge;
use omnibus_sim::plant::contact::{Contact, ContactPlant};
use omnibus_sim::robot::{Robot, Wake};
use omnibus_sim::{Options, SimError, World};

const MASS: f64 = 60.0;
const WHEEL: f64 = 0.05;
const FRICTION: f64 = 0.35;
const R: f64 = 0.1524;
const GRAVITY: f64 = 9.81;

/// Its bridges are off; its brake is as it is told.
struct Idle {
    brake_released: bool,
}

impl Robot for Idle {
    fn run_until(&mut self, _: u64) -> Result<(), SimError> {
        Ok(())
    }
    fn wake(&self) -> Wake {
        Wake::Never
    }
    fn pending(&self) -> Option<Frame> {
        None
    }
    fn transmitted(&mut self) {}
    fn lost_arbitration(&mut self) {}
    fn receive(&mut self, _: &Frame) {}
    fn drives(&self) -> [Bridge; 4] {
        [Bridge {
            duty: 0.0,
            enabled: false,
            brake_released: self.brake_released,
        }; 4]
    }
    fn turn_encoders(&mut self, _: [i32; 4]) {}
    fn set_emergency_stop(&mut self, _: bool) {}
    fn set_driver_fault(&mut self, _: bool) {}
    fn set_power(&mut self, _: bool) {}
}

fn world(brake_released: bool) -> World {
    let path = format!("{}/../groups/single.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).unwrap();
    let lines = format!(
        "[simulation]\nwheel_inertia = {WHEEL}\nrobot_mass = {MASS}\nfriction = {FRICTION}"
    );
    let text = text
        .replace("[simulation]", &lines)
        .replace("plant = \"table\"", "plant = \"contact\"")
        .replace("tables = \"virtual\"", "")
        .replace("friction = 1.0", "friction = 0.0")
        .replace("viscous = 0.02", "viscous = 0.0");
    let group = GroupFile::parse("single", &text).unwrap();
    // Rollers that cost nothing to turn, so that only friction along their axles is left.
    let contact = Contact {
        roller_density: 0.0,
        roller_damping: 0.0,
        ..Contact::of(&group, 8)
    };
    let start = Options::default().start;
    let plant = Box::new(ContactPlant::new(&group, contact, start).unwrap());
    let robot = Box::new(Idle { brake_released });
    World::with_parts(&group, vec![robot], plant, Options::default()).unwrap()
}

fn speed(world: &mut World, from_us: u64, to_us: u64) -> f64 {
    world.run_until(Micros(from_us)).unwrap();
    let from = world.truth().group.x;
    world.run_until(Micros(to_us)).unwrap();
    (world.truth().group.x - from) / ((to_us - from_us) as f64 * 1e-6)
}

/// 2 N m at each wheel: `a = 4 M / r / (m + 4 J / r^2)`, 0.77 m/s^2 and not the 1.22 that motors of
/// 0.4 kg m^2 make alone.
#[test]
fn torque_at_the_wheels_accelerates_body_and_wheels() {
    let mut world = world(true);
    (0..4).for_each(|wheel| world.set_wheel_push(0, wheel, 2.0));
    let before = speed(&mut world, 500_000, 510_000);
    let after = speed(&mut world, 1_500_000, 1_510_000);
    let expected = 4.0 * 2.0 / R / (MASS + 4.0 * WHEEL / (R * R));
    let found = after - before;
    assert!((found / expected - 1.0).abs() < 0.01, "{found} {expected}");
}

/// A wheel with more torque than friction carries runs away, and all that the body feels of it is
/// the friction along its roller, `mu N` at 45 degrees: on the wheel `mu N r / sqrt 2`. So the
/// wheel gains `(M - mu N r / sqrt 2) / J`, and the body drags the other wheels along.
#[test]
fn a_wheel_that_runs_away_pushes_the_body_by_friction() {
    let mut world = world(true);
    world.set_wheel_push(0, 0, 12.0);
    let rate = |world: &World| world.truth().robots[0].wheel_rates.front_left;
    world.run_until(Micros(100_000)).unwrap();
    let before = rate(&world);
    world.run_until(Micros(200_000)).unwrap();
    let gained = (rate(&world) - before) / 0.1;
    let grip = FRICTION * MASS * GRAVITY / 4.0 * std::f64::consts::FRAC_1_SQRT_2;
    let expected = (12.0 - grip * R) / WHEEL;
    assert!(
        (gained / expected - 1.0).abs() < 0.03,
        "{gained} {expected}"
    );
    // The force points ahead and to the right, and turns the body clockwise: the left wheel goes
    // ahead, the right ones go back.
    let rates = world.truth().robots[0].wheel_rates;
    assert!(rates.rear_left > 1.0, "{rates:?}");
    assert!(
        rates.front_right < -1.0 && rates.rear_right < -1.0,
        "{rates:?}"
    );
}

/// Brakes that hold keep a robot on which something pulls at a wheel; brakes that hold less than
/// the floor give way: 12 N m at one wheel against brakes of 2 N m move it.
#[test]
fn brakes_hold_the_body_through_the_floor() {
    let mut held = world(false);
    held.set_wheel_push(0, 0, 12.0);
    held.run_until(Micros(500_000)).unwrap();
    assert!(
        held.truth().group.x.abs() < 1e-6,
        "{:?}",
        held.truth().group
    );
    let mut weak = world(false);
    let brake = weak.brake(0);
    weak.set_brake(
        0,
        omnibus_sim::motor::Brake {
            torque: 2.0,
            ..brake
        },
    );
    weak.set_wheel_push(0, 0, 12.0);
    weak.run_until(Micros(500_000)).unwrap();
    assert!(weak.truth().group.x > 1e-3, "{:?}", weak.truth().group);
}
