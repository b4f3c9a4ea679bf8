//! A participant whose ports belong together.
//!
//! A participant has a port for discovery and one for data, which follow from its number (RTPS 2.5,
//! 9.6.2.3). The library takes the first number whose port for discovery is free. If another
//! program has the port for data of that number, the library listens at any free port and announces
//! that one for readers, but for writers it still announces the port of the number
//! (`DiscoveredWriterData::new` in RustDDS 0.15.1). The answers of a reliable reader to a writer
//! then go to the other program, and Fast DDS receives nothing from the writer. This happens when
//! programs start together, because Fast DDS looks for a free port for discovery and for a free
//! port for data separately.
//!
//! [`participant`] therefore checks the ports of this process. If they do not belong together, it
//! occupies that port for discovery, so that the library takes another number, and creates the
//! participant again.
//!
//! Limits: ports are looked up in `/proc`. Without it, the first participant is used unchecked.

use std::collections::HashMap;
use std::fs;
use std::io;
use std::net::{Ipv4Addr, UdpSocket};

use ros2_client::dds::rustdds::{DomainParticipant, DomainParticipantBuilder};

use super::environment::{Environment, Reach};
use super::{NodeError, refused};

/// Participants that a computer may have in one domain (RTPS 2.5, 9.6.2.3).
const PARTICIPANTS: u16 = 120;

/// Port of announcements to the group (RTPS 2.5, 9.6.2.3).
pub(super) const fn announcements(domain: u16) -> u16 {
    7400 + 250 * domain
}

/// Port for discovery of the participant with that number.
pub(super) const fn discovery(domain: u16, number: u16) -> u16 {
    announcements(domain) + 10 + 2 * number
}

/// Port for data of the participant with that number.
const fn data(domain: u16, number: u16) -> u16 {
    announcements(domain) + 11 + 2 * number
}

/// Whether a port is one of that domain.
#[cfg(target_os = "linux")]
pub(super) const fn is_of(domain: u16, port: u16) -> bool {
    port >= announcements(domain) && port - announcements(domain) < 250
}

/// Makes a participant.
///
/// # Errors
/// When the network refuses it, or no participant has both its ports free.
pub(super) fn participant(environment: &Environment) -> Result<DomainParticipant, NodeError> {
    let refused = refused("the network");
    let domain = environment.domain;
    // Until the participant has its ports.
    let mut occupied = Vec::new();
    for _ in 0..PARTICIPANTS {
        let participant = build(environment)?;
        let number = participant.participant_id();
        match own() {
            Ok(own) if own.iter().all(|(_, port)| *port != data(domain, number)) => {}
            Ok(_) | Err(_) => return Ok(participant),
        }
        drop(participant);
        // Where someone else was faster, the library takes another number, too.
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, discovery(domain, number)));
        occupied.extend(socket);
    }
    Err(refused(&format_args!(
        "no participant of domain {domain} has both its ports free, {} and above",
        discovery(domain, 0)
    )))
}

fn build(environment: &Environment) -> Result<DomainParticipant, NodeError> {
    let mut builder = DomainParticipantBuilder::new(environment.domain);
    if environment.reach == Reach::Localhost {
        builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
    }
    builder
        .build()
        .map_err(|error| refused("the network")(&format_args!("{error:?}")))
}

/// The UDP sockets of this process: descriptor and port.
pub(super) fn own() -> io::Result<Vec<(i32, u16)>> {
    let table = fs::read_to_string("/proc/self/net/udp")?;
    let of_line = |line: &str| {
        // The local address comes second, in hexadecimal digits, the inode tenth (proc(5)).
        let mut fields = line.split_whitespace();
        let (_, port) = fields.nth(1)?.split_once(':')?;
        let inode = fields.nth(7)?;
        let port = u16::from_str_radix(port, 16).ok()?;
        Some((format!("socket:[{inode}]"), port))
    };
    let ports: HashMap<String, u16> = table.lines().skip(1).filter_map(of_line).collect();
    let mut own = Vec::new();
    for descriptor in fs::read_dir("/proc/self/fd")? {
        let descriptor = descriptor?;
        // One that was closed meanwhile is none of ours.
        let Ok(target) = fs::read_link(descriptor.path()) else {
            continue;
        };
        let number = descriptor.file_name().to_string_lossy().parse();
        let port = ports.get(target.to_string_lossy().as_ref());
        if let (Ok(number), Some(port)) = (number, port) {
            own.push((number, *port));
        }
    }
    Ok(own)
}
