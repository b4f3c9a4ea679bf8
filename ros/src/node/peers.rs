//! Static peers (`ROS_STATIC_PEERS`), for networks without multicast.
//!
//! The DDS library announces itself to multicast groups and to this computer. For a peer elsewhere
//! this relay sends copies of those announcements to the ports at which a participant waits for
//! them. It receives them as any participant does, by the multicast group, and recognises its own
//! by the first twelve bytes of its identifier. A peer that has received one answers the library
//! directly. The group is joined on the interfaces by which the peers are reached, so no default
//! route is needed.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use ros2_client::Context;
use socket2::{Domain, Protocol, Socket, Type};

use super::environment::{Environment, Reach};
use super::{NodeError, ports, refused};

/// Group of announcements (RTPS 2.5, 9.6.1.4).
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
/// Participants of one computer that are announced to.
const PARTICIPANTS: u16 = 10;
/// How often the relay looks whether it is to end.
const PATIENCE: Duration = Duration::from_millis(200);

/// Relays announcements until it is dropped.
pub(super) struct Relay {
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Relay {
    pub(super) fn start(
        environment: &Environment,
        context: &Context,
    ) -> Result<Option<Self>, NodeError> {
        if environment.peers.is_empty() {
            return Ok(None);
        }
        let refused = refused("ROS_STATIC_PEERS");
        let domain = environment.domain;
        let socket =
            listen(ports::announcements(domain), environment).map_err(|error| refused(&error))?;
        let guid = ros2_client::Gid::from(ros2_client::dds::rustdds::RTPSEntity::guid(
            &context.domain_participant(),
        ));
        let mut own = [0; 12];
        own.copy_from_slice(&guid.to_bytes16()[..12]);
        let targets = targets(&environment.peers, domain);
        let over = Arc::new(AtomicBool::new(false));
        let its_over = Arc::clone(&over);
        let thread = std::thread::spawn(move || relay(&socket, own, &targets, &its_over));
        Ok(Some(Self {
            over,
            thread: Some(thread),
        }))
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn targets(peers: &[IpAddr], domain: u16) -> Vec<SocketAddr> {
    let of = |peer: &IpAddr| {
        let peer = *peer;
        (0..PARTICIPANTS).map(move |number| SocketAddr::new(peer, ports::discovery(domain, number)))
    };
    peers.iter().flat_map(of).collect()
}

fn listen(port: u16, environment: &Environment) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    #[cfg(unix)]
    socket.set_reuse_port(true)?;
    socket.bind(&SocketAddr::from((GROUP, port)).into())?;
    let mut interfaces = match environment.reach {
        Reach::Localhost => vec![Ipv4Addr::LOCALHOST],
        Reach::Subnet => environment
            .peers
            .iter()
            .map(towards)
            .collect::<Result<_, _>>()?,
    };
    interfaces.sort();
    interfaces.dedup();
    for interface in interfaces {
        socket.join_multicast_v4(&GROUP, &interface)?;
    }
    socket.set_read_timeout(Some(PATIENCE))?;
    Ok(socket.into())
}

/// The address of this computer from which a peer is reached. Nothing is sent.
fn towards(peer: &IpAddr) -> io::Result<Ipv4Addr> {
    let no_way =
        |error: io::Error| io::Error::new(error.kind(), format!("no route to {peer}: {error}"));
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.connect((*peer, 9)).map_err(no_way)?;
    match socket.local_addr()?.ip() {
        IpAddr::V4(own) => Ok(own),
        IpAddr::V6(_) => Err(io::Error::other(format!("{peer}: give an IPv4 address"))),
    }
}

fn relay(socket: &UdpSocket, own: [u8; 12], targets: &[SocketAddr], over: &AtomicBool) {
    let mut datagram = [0; 65_536];
    while !over.load(Ordering::Relaxed) {
        let Ok(size) = socket.recv(&mut datagram) else {
            continue;
        };
        let datagram = &datagram[..size];
        // A message of RTPS begins with its name, version and vendor; then comes who sends it.
        if datagram.get(8..20) == Some(&own) {
            for target in targets {
                let _ = socket.send_to(datagram, target);
            }
        }
    }
}
