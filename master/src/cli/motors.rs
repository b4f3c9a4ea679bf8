//! `omnibus identify-motors`: lets one robot measure its motors, and shows the result.

use anyhow::bail;
use omnibus::commission::motors::{self, Settings, WHEELS};
use omnibus::session::sdo;
use protocol::{Address, OBJECTS, Value, address};
use serde_json::json;

use super::output::{self, Progress};
use super::{Target, print_line};

const EXAMPLES: &str = "Examples:
  omnibus identify-motors --node 2 --wheels-free --bus sim:groups/tcc-2.toml
  omnibus identify-motors --node 2 --wheels-free --accept --save --bus socketcan:can0 --group my-group.toml";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Node of the robot.
    #[arg(long, value_parser = super::robot)]
    node: u8,
    /// Confirms that this robot may move: its wheels are off the floor, or the floor around it is
    /// clear.
    #[arg(long)]
    wheels_free: bool,
    /// Fastest wheel rate, rad/s.
    #[arg(long, default_value_t = Settings::default().rate, value_parser = super::real::<f32>)]
    rate: f32,
    /// Largest angle by which a wheel may turn, rad.
    #[arg(long, default_value_t = Settings::default().travel, value_parser = super::real::<f32>)]
    travel: f32,
    /// Wanted bandwidth of the wheel loops, rad/s.
    #[arg(long, default_value_t = Settings::default().bandwidth, value_parser = super::real::<f32>)]
    bandwidth: f32,
    /// Wanted damping of the wheel loops; 1 is critical.
    #[arg(long, default_value_t = Settings::default().damping, value_parser = super::real::<f32>)]
    damping: f32,
    /// Writes the result into the robot.
    #[arg(long)]
    accept: bool,
    /// Also saves the result to the robot's flash.
    #[arg(long, requires = "accept")]
    save: bool,
    #[command(flatten)]
    target: Target,
}

/// Refuses what the robot would, before the bus is opened.
fn check(option: &str, address: Address, value: f32) -> anyhow::Result<()> {
    let object = OBJECTS.iter().find(|object| object.address == address);
    if let Some(object) = object
        && Value::F32(value).check(object.min, object.max).is_err()
    {
        let (low, high) = (sdo::show(object.min), sdo::show(object.max));
        let message = format!(
            "{option}: {value} is not between {low} and {high} {}",
            object.unit
        );
        usage!("{}", message.trim_end());
    }
    Ok(())
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let group = arguments.target.group()?;
    let node = arguments.node;
    let Some(robot) = group.robots.iter().find(|robot| robot.node == node) else {
        bail!("--node {node}: group '{}' has no such robot", group.name);
    };
    if !arguments.wheels_free {
        usage!(
            "the wheels of node {node} will turn by up to {} rad ({:.2} m on the floor) in both \
             directions; lift them or clear the area, then add --wheels-free",
            arguments.travel,
            arguments.travel * robot.geometry.wheel_radius()
        );
    }
    for (option, address, value) in [
        ("--rate", address::IDENTIFY_RATE, arguments.rate),
        ("--travel", address::IDENTIFY_TRAVEL, arguments.travel),
        (
            "--bandwidth",
            address::IDENTIFY_BANDWIDTH,
            arguments.bandwidth,
        ),
        ("--damping", address::IDENTIFY_DAMPING, arguments.damping),
    ] {
        check(option, address, value)?;
    }
    let settings = Settings {
        rate: arguments.rate,
        travel: arguments.travel,
        bandwidth: arguments.bandwidth,
        damping: arguments.damping,
        ..Settings::default()
    };
    let (mut session, abort) = super::configured(&arguments.target, &group)?;
    let period_us = session.period_us();
    let progress = Progress::endless(&format!("identifying the motors of node {node}"));
    let wire = session.wire();
    let found = motors::identify_motors(wire, node, period_us, &settings, &mut |_| abort.check());
    drop(progress);
    super::note_punctuality(&session);
    let motors = found?;
    let wire = session.wire();
    let mut written = Ok(());
    if arguments.accept {
        written = motors::accept(wire, node, &motors);
    }
    let accepted = arguments.accept && written.is_ok();
    if arguments.save && accepted {
        written = wire.save(node);
    }
    let saved = arguments.save && written.is_ok();
    // What was measured is shown even where it could not be written.
    if super::json() {
        let rows = motors.iter().zip(WHEELS).map(|(motor, wheel)| {
            json!({"wheel": wheel, "static_friction_v": motor.static_friction, "speed_v_s_per_rad": motor.speed,
                   "acceleration_v_s2_per_rad": motor.acceleration, "proportional_v_s_per_rad": motor.proportional,
                   "integral_v_per_rad": motor.integral, "misfit_v": motor.misfit})
        });
        let wheels: Vec<_> = rows.collect();
        super::print_json(&json!({"node": node, "accepted": accepted, "saved": saved,
                                  "wheels": wheels}))?;
        return Ok(written?);
    }
    let mut table = output::table(["wheel", "kS", "kV", "kA", "kP", "kI", "misfit"]);
    for (motor, wheel) in motors.iter().zip(WHEELS) {
        let values = [
            motor.static_friction,
            motor.speed,
            motor.acceleration,
            motor.proportional,
            motor.integral,
            motor.misfit,
        ];
        let cells = values.map(|value| format!("{value:.4}"));
        table.add_row(std::iter::once(wheel.to_owned()).chain(cells));
    }
    print_line(&table)?;
    print_line("kS and misfit in V, kV and kP in V s/rad, kA in V s2/rad, kI in V/rad.")?;
    written?;
    print_line(match (accepted, saved) {
        (false, _) => "The robot still has its previous values; --accept writes these into it.",
        (true, false) => {
            "These take effect at the next start, until a group file is written or the power is \
             switched off; --save saves them."
        }
        (true, true) => {
            "Saved. Add `identified = true` under [robot.control] in the group file, or the next \
             `group apply` overwrites them."
        }
    })
}
