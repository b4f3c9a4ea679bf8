//! `omnibus vda5050`: the group is one vehicle of a fleet control.

use std::path::PathBuf;
use std::sync::Arc;

use ::vda5050::message::Identity;
use ::vda5050::{Configuration, Version};
use anyhow::{Context as _, anyhow};
use kinematics::Pose;
use omnibus::bus::address::BusAddress;
use omnibus::path::steering::Law;
use omnibus::run::Source;
use omnibus::source::pose::PoseStream;
use omnibus::vda5050::broker::{Access, Address, Broker};
use omnibus::vda5050::driver::Localised;
use omnibus::vda5050::{VehicleError, operate, physics};

use super::follow::place;
use super::{Target, Usage, input, print_note};

const EXAMPLES: &str = "Examples:
  omnibus vda5050 --broker mqtt://127.0.0.1 --at 0,0 --bus sim:groups/tcc-3.toml
  omnibus vda5050 --broker mqtts://fleet.example:8883 --ca ca.pem --user tcc-3 --password-file secret.txt --pose tcp://127.0.0.1:7705 --bus socketcan:can0 --group my-group.toml
  omnibus vda5050 --broker mqtt://10.0.0.5 --serial west --map-id hall --protocol 2.1 --bus sim:groups/tcc-2.toml

docs/vda5050.md goes from zero to an order that is driven, and lists what is implemented.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// The broker: mqtt://HOST[:PORT], or mqtts://HOST[:PORT] for TLS.
    #[arg(long, value_name = "ADDRESS")]
    broker: Address,
    /// Certificate of who signed the broker's own, PEM; needed for mqtts://.
    #[arg(long, value_name = "FILE.pem")]
    ca: Option<PathBuf>,
    /// User name for the broker.
    #[arg(long, value_name = "NAME", requires = "password_file")]
    user: Option<String>,
    /// File with the password for the broker.
    #[arg(long, value_name = "FILE", requires = "user")]
    password_file: Option<PathBuf>,
    /// Version of VDA 5050: 2.0, 2.1 or 3.0.
    #[arg(long, value_name = "VERSION", default_value = "2.0")]
    protocol: Version,
    /// First level of the topics.
    #[arg(long, value_name = "NAME", default_value = "uagv")]
    interface: String,
    /// Manufacturer, as the fleet control knows it.
    #[arg(long, value_name = "NAME", default_value = "Omnibus")]
    manufacturer: String,
    /// Serial number, as the fleet control knows it; by default the name in the group file.
    #[arg(long, value_name = "NUMBER")]
    serial: Option<String>,
    /// Map on which the group is.
    #[arg(long, value_name = "ID", default_value = "map")]
    map_id: String,
    /// Source of poses: odometry, or tcp://HOST:PORT (JSON lines).
    #[arg(long, value_name = "SOURCE", default_value = "odometry")]
    pose: Source,
    /// With odometry, where the group stands on the map; otherwise where the frame of the poses
    /// lies on it: metres, metres, degrees. Without it odometry waits for initPosition.
    #[arg(long, value_name = "X,Y[,DEGREES]", value_parser = place, allow_hyphen_values = true)]
    at: Option<Pose<f64>>,
    /// How far from a node the group may stand when an order begins there, where the node does not
    /// say, m.
    #[arg(long, value_name = "METRES", default_value_t = 0.1)]
    tolerance: f64,
    /// Height of the group with its load, m.
    #[arg(long, value_name = "METRES", default_value_t = 1.0)]
    height: f64,
    /// Longest time between two states, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    state_interval: f64,
    /// Time between two messages with the position, s; 0 for none.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.5)]
    visualization_interval: f64,
}

impl Arguments {
    fn configuration(&self, group: &group::GroupFile) -> anyhow::Result<Configuration> {
        let picture = self.visualization_interval;
        // In whole milliseconds, of which 0 means none.
        let shortest = if picture == 0.0 { 0.0 } else { 0.001 };
        for (option, value, low, high) in [
            ("--tolerance", self.tolerance, 0.001, 10.0),
            ("--height", self.height, 0.0, 100.0),
            ("--state-interval", self.state_interval, 0.1, 30.0),
            ("--visualization-interval", picture, shortest, 60.0),
        ] {
            if !(low..=high).contains(&value) {
                usage!("{option}: {value} is not between {low} and {high}");
            }
        }
        if self.map_id.is_empty() {
            usage!("--map-id is empty; give the name of the map that orders have");
        }
        let identity = Identity {
            version: self.protocol,
            interface: self.interface.clone(),
            manufacturer: self.manufacturer.clone(),
            serial: self.serial.clone().unwrap_or_else(|| group.name.clone()),
        };
        identity.check().map_err(Usage)?;
        #[expect(clippy::cast_possible_truncation, reason = "at most a minute")]
        #[expect(clippy::cast_sign_loss, reason = "checked above")]
        let ms = |seconds: f64| (seconds * 1e3).round() as u64;
        Ok(Configuration {
            identity,
            map: self.map_id.clone(),
            physics: physics::of(group),
            height: self.height,
            tolerance: self.tolerance,
            state_interval_ms: ms(self.state_interval),
            visualization_interval_ms: ms(picture),
        })
    }

    fn access(&self) -> anyhow::Result<Access> {
        let read = |option: &str, path: &PathBuf| {
            input::bytes(path, &format!("{option} a file that this user may read"))
        };
        let user = match (&self.user, &self.password_file) {
            (Some(user), Some(path)) => {
                let text = String::from_utf8(read("--password-file", path)?);
                let text = text.with_context(|| {
                    format!("--password-file {}: the file is not text", path.display())
                })?;
                Some((user.clone(), text.trim_end_matches(['\r', '\n']).to_owned()))
            }
            _ => None,
        };
        Ok(Access {
            address: self.broker.clone(),
            authority: self
                .ca
                .as_ref()
                .map(|path| read("--ca", path))
                .transpose()?,
            user,
        })
    }

    fn localised(&self) -> anyhow::Result<Localised> {
        let simulated = matches!(self.target.bus, BusAddress::Sim(_));
        let poses = match &self.pose {
            Source::Odometry => None,
            Source::Truth => usage!(
                "--pose truth: the true poses of a simulation come from omnibus-sim serve with \
                 --slcan-tcp and --pose-tcp HOST:PORT; give odometry or tcp://HOST:PORT"
            ),
            Source::Stream(_) if simulated => usage!(
                "--pose tcp://: a simulated bus in this process has no other program's poses; use \
                 omnibus-sim serve with --slcan-tcp and --pose-tcp"
            ),
            Source::Stream(address) => Some(PoseStream::connect(address).with_context(|| {
                format!("--pose tcp://{address}: no poses; start the program that sends them")
            })?),
        };
        Ok(Localised {
            poses,
            offset: self.at,
            law: Law::default(),
        })
    }
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = target.group()?;
    let configuration = arguments.configuration(&group)?;
    let access = arguments.access()?;
    let localised = arguments.localised()?;
    let identity = configuration.identity.clone();
    let broker = Broker::connect(&access, &identity).map_err(Usage)?;
    let abort = super::abort_on_ctrl_c()?;
    let pilot = Arc::new(target.pilot(&group)?);
    print_note(format_args!(
        "{} is the vehicle {} {}, VDA 5050 {}; orders come on {}",
        group.name,
        identity.manufacturer,
        identity.serial,
        identity.version,
        identity.topic("order")
    ));
    if access.user.is_some() && !access.address.tls {
        print_note(
            "mqtt:// sends name and password unencrypted: others on the network can read them; \
             give mqtts:// and --ca where that matters",
        );
    }
    let report = |text: &str| print_note(text);
    let result = operate(
        pilot,
        &group,
        configuration,
        broker,
        localised,
        &abort,
        &report,
    );
    result.map_err(|error| match error {
        // By itself, because exit codes look for it.
        VehicleError::Drive(error) => anyhow!(error),
        other @ VehicleError::Broker(_) => anyhow!(other),
    })
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    #[derive(clap::Parser)]
    struct Command {
        #[command(flatten)]
        arguments: Arguments,
    }

    #[test]
    fn an_interval_that_would_be_rounded_to_none_is_refused() {
        let group = group::GroupFile::load("../groups/tcc-2.toml").unwrap();
        let milliseconds = |interval: &str| {
            let interval = format!("--visualization-interval={interval}");
            let rest = ["--broker=mqtt://127.0.0.1", "--bus=sim:tcc-2.toml"];
            let words = ["vda5050", rest[0], rest[1], &interval];
            let arguments = Command::try_parse_from(words).unwrap().arguments;
            let configuration = arguments.configuration(&group);
            configuration.map(|it| it.visualization_interval_ms)
        };
        assert_eq!(milliseconds("0").unwrap(), 0);
        assert_eq!(milliseconds("0.001").unwrap(), 1);
        assert_eq!(
            milliseconds("0.0004").unwrap_err().to_string(),
            "--visualization-interval: 0.0004 is not between 0.001 and 60"
        );
    }
}
