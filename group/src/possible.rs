//! Rules about numbers that may each be right, and together make no machine: an inertia without
//! weight behind its motor, an encoder that does not count, wheels inside each other.
//!
//! A simulated world computes with them as they are, in steps of at most 1 ms, so it would diverge
//! or divide by zero. Ranges of single numbers are in [`crate::declaration`].

use toml::de::DeTable;

use crate::check::Checker;
use crate::model::{GroupFile, Robot, Wheel};
use crate::number::rounded;
use crate::whole::{entry, place};

/// Shortest mechanical time constant, s. A wheel with a quarter of its robot has a hundred times
/// that, and `omnibus_sim::motor` is stable down to half of its step, which is at most 1 ms.
const SHORTEST: f64 = 1e-3;

/// Least counts in a turn of a wheel: one line of an encoder.
const LEAST_COUNTS: f32 = 4.0;

/// The wheels in their order.
const NAMES: [&str; 4] = ["front left", "front right", "rear left", "rear right"];

/// Wheels whose centres are closer than this aside are one behind the other, m.
const ASIDE: f32 = 1e-3;

impl Checker<'_> {
    /// Reports robots that cannot be.
    pub fn robots_can_be(&self, group: &GroupFile, tree: &DeTable<'_>) {
        for (index, robot) in group.robots.iter().enumerate() {
            let at = entry(tree, index);
            let least = least_inertia(robot);
            let inertia = f64::from(robot.motor.inertia);
            if inertia < least {
                let (problem, remedy) = too_light(inertia, least);
                self.report(
                    at,
                    &format!("robots[{index}].motor.inertia"),
                    &problem,
                    &remedy,
                );
            }
            for (wheel, own) in NAMES.iter().zip(robot.each_wheel()) {
                let counts = own
                    .counts_per_revolution
                    .unwrap_or(robot.encoder.counts_per_revolution)
                    * robot.encoder.gear_ratio;
                if counts < LEAST_COUNTS {
                    let problem = format!(
                        "with its gear makes {} counts a turn of the {wheel} wheel",
                        rounded(counts.into())
                    );
                    let remedy = format!("give at least {LEAST_COUNTS}, or fix `gear_ratio`");
                    let field = format!("robots[{index}].encoder.counts_per_revolution");
                    self.report(at, &field, &problem, &remedy);
                    break;
                }
            }
            if let Some((one, other)) = inside_each_other(&robot.each_wheel()) {
                let problem = format!("the {one} and the {other} wheel are inside each other");
                let remedy = "fix half_wheelbase and wheel_radius, or the wheels' places: between \
                              the centres of two wheels in line are at least both radii";
                self.report(at, &format!("robots[{index}]"), &problem, remedy);
            }
        }
        let least = group.robots.iter().map(least_inertia).fold(0.0, f64::max);
        if let Some(inertia) = group.simulation.contact.wheel_inertia
            && inertia < least
        {
            let (problem, remedy) = too_light(inertia, least);
            let at = place(tree, &["simulation", "wheel_inertia"]);
            self.report(at, "simulation.wheel_inertia", &problem, &remedy);
        }
    }
}

fn too_light(inertia: f64, least: f64) -> (String, String) {
    let problem = format!(
        "is {} kg m2: with the rest of the motor a time constant below 1 ms",
        rounded(inertia)
    );
    // More than what rounding may take away.
    let enough = rounded(1.1 * least);
    let remedy = format!("give {enough} kg m2 or more, or fix `motor`");
    (problem, remedy)
}

/// The inertia with which back EMF and viscous friction brake a wheel with [`SHORTEST`], kg m2.
fn least_inertia(robot: &Robot) -> f64 {
    let motor = &robot.motor;
    let (constant, resistance) = (f64::from(motor.constant), f64::from(motor.resistance));
    SHORTEST * (constant * constant / resistance + f64::from(motor.viscous))
}

/// Two wheels in line that are closer than their radii.
fn inside_each_other(wheels: &[Wheel; 4]) -> Option<(&'static str, &'static str)> {
    let named = || NAMES.into_iter().zip(wheels);
    let pairs = (1..4).flat_map(|n| named().zip(named().skip(n)));
    let mut inside = pairs.filter(|((_, one), (_, other))| {
        (one.y - other.y).abs() < ASIDE && (one.x - other.x).abs() < one.radius + other.radius
    });
    inside.next().map(|((one, _), (other, _))| (one, other))
}
