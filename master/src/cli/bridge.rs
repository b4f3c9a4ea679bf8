//! `omnibus bridge`: setpoints in and telemetry out as lines of JSON, for programs of one's own;
//! and the group live in Foxglove.

use std::io::{BufReader, stdin, stdout};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use omnibus::bridge::server::{Address, Listener};
use omnibus::bridge::{Bridge, operate};

use super::{Target, print_note};

const EXAMPLES: &str = "Examples:
  omnibus bridge --bus sim:groups/tcc-2.toml
  omnibus bridge --listen tcp://127.0.0.1:7710 --bus socketcan:can0 --group my-group.toml
  omnibus bridge --listen unix:/tmp/omnibus.sock --rate 20 --bus slcan:/dev/ttyACM0 --group my-group.toml
  omnibus bridge --foxglove 127.0.0.1:8765 --bus socketcan:can0 --group my-group.toml

A client writes {\"type\":\"start\"}, then {\"type\":\"twist\",\"vx\":0.1} at least every 0.2 s, and
{\"type\":\"stop\"}. docs/bridge.md lists all messages.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Serves clients at tcp://127.0.0.1:PORT or unix:PATH. By default standard input and output
    /// are the only client, and the bridge ends with it.
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<Address>,
    /// Largest number of states per second for a client; by default one for every SYNC.
    #[arg(long, value_name = "HZ", value_parser = super::real::<f64>)]
    rate: Option<f64>,
    /// Shows the group live in Foxglove, which connects to ws://ADDR.
    #[arg(long, value_name = "ADDR")]
    foxglove: Option<String>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = target.group()?;
    let interval = match arguments.rate {
        None => 0.0,
        Some(rate) if rate > 0.0 && rate <= 1000.0 => 1.0 / rate,
        Some(rate) => usage!("--rate: {rate} Hz; give more than 0 and at most 1000 Hz"),
    };
    let listener = match &arguments.listen {
        Some(address) => Some(Listener::bind(address).with_context(|| {
            format!("--listen {}: cannot listen at this address", show(address))
        })?),
        None => None,
    };
    let abort = super::abort_on_ctrl_c()?;
    let pilot = Arc::new(target.pilot(&group)?);
    let bridge = Arc::new(Bridge::new(
        &pilot,
        &group,
        &target.bus.to_string(),
        interval,
    ));
    if let Some(address) = &arguments.foxglove {
        let at = live(address, &pilot.hub(), &group)?;
        print_note(format_args!("Foxglove: open a connection to ws://{at}"));
    }
    let ended = Arc::new(AtomicBool::new(false));
    if let Some(listener) = listener {
        print_note(format_args!("the bridge is at {}", listener.address()));
        let bridge = Arc::clone(&bridge);
        std::thread::spawn(move || listener.serve(&bridge));
    } else {
        let (bridge, ended) = (Arc::clone(&bridge), Arc::clone(&ended));
        std::thread::spawn(move || {
            // A client that has stopped reading has gone, like one that has stopped writing.
            let _ = bridge.serve(BufReader::new(stdin()), stdout());
            ended.store(true, Ordering::Relaxed);
        });
    }
    let operated = operate(pilot, &bridge, &abort, &ended);
    if let Some(Address::Unix(path)) = &arguments.listen {
        let _ = std::fs::remove_file(path);
    }
    Ok(operated?)
}

fn show(address: &Address) -> String {
    match address {
        Address::Tcp(address) => format!("tcp://{address}"),
        Address::Unix(path) => format!("unix:{}", path.display()),
    }
}

#[cfg(feature = "foxglove")]
fn live(
    address: &str,
    hub: &omnibus::monitor::telemetry::Hub,
    group: &group::GroupFile,
) -> anyhow::Result<std::net::SocketAddr> {
    use std::net::ToSocketAddrs as _;
    let context = || {
        format!(
            "--foxglove {address}: cannot listen at this address; give a free ADDRESS:PORT \
                    of this computer"
        )
    };
    let mut addresses = address.to_socket_addrs().with_context(context)?;
    let address = addresses.next().with_context(context)?;
    omnibus::bridge::live::serve(address, hub, group).with_context(context)
}

#[cfg(not(feature = "foxglove"))]
fn live(
    _: &str,
    _: &omnibus::monitor::telemetry::Hub,
    _: &group::GroupFile,
) -> anyhow::Result<std::net::SocketAddr> {
    usage!("--foxglove: this build does not support Foxglove; build it with --features foxglove")
}
