//! The endpoints that the command line asks for.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use clap::builder::NonEmptyStringValueParser;
use group::GroupFile;
use omnibus_sim::endpoint::Endpoint;
use omnibus_sim::endpoint::gyro::GyroServer;
use omnibus_sim::endpoint::lockstep::LockstepServer;
use omnibus_sim::endpoint::pose::PoseServer;
use omnibus_sim::endpoint::replay::Replay;
use omnibus_sim::endpoint::slcan_tcp::SlcanServer;
use omnibus_sim::endpoint::socketcand::SocketcandServer;

/// Where programs find the bus, the poses and the gyros. In an address, port 0 picks a free one.
#[derive(Args)]
pub struct Endpoints {
    /// Serves the bus in lockstep here, for `omnibus --bus lockstep://ADDR`. Time waits for the
    /// clients, so nothing is late, however busy this computer is. With @NODE clients connect to
    /// the cable of this emulated robot instead of the bus, as in 127.0.0.1:7701@2.
    #[arg(long, value_name = "ADDR[@NODE]")]
    lockstep: Option<String>,
    /// Serves slcan over TCP here, for example 127.0.0.1:7701.
    #[arg(long, value_name = "ADDR")]
    slcan_tcp: Option<String>,
    /// Serves the raw mode of socketcand here, for example 127.0.0.1:29536.
    #[arg(long, value_name = "ADDR")]
    socketcand: Option<String>,
    /// Serves slcan on a pseudo terminal and links this path to it.
    #[arg(long, value_name = "PATH")]
    pty: Option<PathBuf>,
    /// Serves the serial port of an emulated robot on a pseudo terminal and links this path to it:
    /// of the first robot, or of another node, as in /tmp/robot@3. May be repeated.
    #[arg(long, value_name = "PATH[@NODE]")]
    cable: Vec<String>,
    /// Connects the bus to this CAN interface (Linux), for example vcan0.
    #[arg(long, value_name = "IFACE", value_parser = NonEmptyStringValueParser::new())]
    socketcan: Option<String>,
    /// Plays a candump log onto the bus, beginning at time 0.
    #[arg(long, value_name = "FILE")]
    replay: Option<PathBuf>,
    /// Streams the true poses here as lines of JSON.
    #[arg(long, value_name = "ADDR")]
    pose_tcp: Option<String>,
    /// Pose samples per second: a divisor of 4000.
    #[arg(long, value_name = "HZ", default_value_t = 100, requires = "pose_tcp")]
    pose_rate: u32,
    /// Streams the samples of the robots' gyros here as lines of JSON.
    #[arg(long, value_name = "ADDR")]
    gyro_tcp: Option<String>,
}

impl Endpoints {
    /// Period of the pose samples, ns; 0 without an endpoint for them.
    pub fn pose_period_ns(&self) -> anyhow::Result<u64> {
        // The plant moves the robots every 250 us.
        const STEPS: u32 = 4_000;
        if self.pose_rate == 0 || !STEPS.is_multiple_of(self.pose_rate) {
            bail!(
                "--pose-rate {}: give a divisor of {STEPS}, for example 100 or 250",
                self.pose_rate
            );
        }
        let wanted = self.pose_tcp.is_some();
        Ok(if wanted {
            1_000_000_000 / u64::from(self.pose_rate)
        } else {
            0
        })
    }

    /// Whether some need the robots' processors.
    pub fn need_processors(&self) -> bool {
        let at_cable = |at: &String| at.contains('@');
        !self.cable.is_empty() || self.lockstep.as_ref().is_some_and(at_cable)
    }

    /// The robot at whose cable the clients of `--lockstep` are, if they are at one.
    pub fn adapter(&self, group: &GroupFile) -> anyhow::Result<Option<u8>> {
        let Some((_, node)) = self.lockstep.as_ref().and_then(|at| at.split_once('@')) else {
            return Ok(None);
        };
        let nodes: Vec<u8> = group.robots.iter().map(|robot| robot.node).collect();
        match node.parse().ok().filter(|node| nodes.contains(node)) {
            Some(node) => Ok(Some(node)),
            None => bail!(
                "--lockstep @{node}: no robot of the group has this node; its nodes are {nodes:?}"
            ),
        }
    }

    /// The files that they read, and what each is.
    pub fn inputs(&self) -> impl Iterator<Item = (&Path, &'static str)> {
        let replay = self.replay.as_deref();
        replay.map(|path| (path, "the log to replay")).into_iter()
    }

    /// Opens them all, for the robots of this group.
    pub fn open(&self, group: &GroupFile) -> anyhow::Result<Vec<Box<dyn Endpoint>>> {
        let listen = |address: &str| {
            format!("cannot listen on {address}; give a HOST:PORT of this computer that is free")
        };
        let mut open: Vec<Box<dyn Endpoint>> = Vec::new();
        if let Some(at) = &self.lockstep {
            let at = at.split_once('@').map_or(at.as_str(), |(at, _)| at);
            let server = LockstepServer::bind(at).with_context(|| listen(at))?;
            open.push(Box::new(server));
        }
        if let Some(at) = &self.slcan_tcp {
            open.push(Box::new(SlcanServer::bind(at).with_context(|| listen(at))?));
        }
        if let Some(at) = &self.socketcand {
            let server = SocketcandServer::bind(at).with_context(|| listen(at))?;
            open.push(Box::new(server));
        }
        if let Some(path) = &self.pty {
            open.push(pty(path)?);
        }
        for text in &self.cable {
            open.push(cable(text, group)?);
        }
        if let Some(interface) = &self.socketcan {
            open.push(socket_can(interface)?);
        }
        if let Some(path) = &self.replay {
            let name = path.display().to_string();
            let text = std::fs::read_to_string(path)
                .with_context(|| format!("--replay {name}: cannot be read; give a candump log"))?;
            let replay = Replay::new(&name, &text)
                .map_err(|problem| anyhow::anyhow!("--replay {name}: {problem}"))?;
            open.push(Box::new(replay));
        }
        if let Some(at) = &self.pose_tcp {
            open.push(Box::new(PoseServer::bind(at).with_context(|| listen(at))?));
        }
        if let Some(at) = &self.gyro_tcp {
            let nodes = group.robots.iter().map(|robot| robot.node).collect();
            let server = GyroServer::bind(at, nodes).with_context(|| listen(at))?;
            open.push(Box::new(server));
        }
        Ok(open)
    }
}

#[cfg(unix)]
fn pty(path: &Path) -> anyhow::Result<Box<dyn Endpoint>> {
    let pty = omnibus_sim::endpoint::pty::Pty::open(path).with_context(|| {
        let path = path.display();
        format!("--pty {path}: cannot make the link; give a path that does not exist yet")
    })?;
    Ok(Box::new(pty))
}

#[cfg(not(unix))]
fn pty(_: &Path) -> anyhow::Result<Box<dyn Endpoint>> {
    bail!("--pty: this system has no pseudo terminals; use --slcan-tcp")
}

/// `PATH`, or `PATH@NODE` for another robot than the first.
#[cfg(unix)]
fn cable(text: &str, group: &GroupFile) -> anyhow::Result<Box<dyn Endpoint>> {
    let nodes: Vec<u8> = group.robots.iter().map(|robot| robot.node).collect();
    let (path, node) = match text.rsplit_once('@') {
        Some((path, node)) => (path, node.parse().ok()),
        None => (text, nodes.first().copied()),
    };
    let Some(node) = node.filter(|node| nodes.contains(node)) else {
        bail!("--cable {text}: no robot of the group has this node; its nodes are {nodes:?}");
    };
    let cable = omnibus_sim::endpoint::cable::Cable::open(Path::new(path), node);
    Ok(Box::new(cable.with_context(|| {
        format!("--cable {path}: cannot make the link; give a path that does not exist yet")
    })?))
}

#[cfg(not(unix))]
fn cable(_: &str, _: &GroupFile) -> anyhow::Result<Box<dyn Endpoint>> {
    bail!("--cable: this system has no pseudo terminals")
}

#[cfg(target_os = "linux")]
fn socket_can(interface: &str) -> anyhow::Result<Box<dyn Endpoint>> {
    let endpoint =
        omnibus_sim::endpoint::socket_can::SocketCan::open(interface).with_context(|| {
            format!(
                "--socketcan {interface}: cannot be opened; create it with: modprobe vcan; \
             ip link add {interface} type vcan; ip link set {interface} up"
            )
        })?;
    Ok(Box::new(endpoint))
}

#[cfg(not(target_os = "linux"))]
fn socket_can(_: &str) -> anyhow::Result<Box<dyn Endpoint>> {
    bail!("--socketcan: only Linux has SocketCAN; use --slcan-tcp or --socketcand")
}
