//! The network settings in the environment of a ROS 2 program: the domain, the range of discovery,
//! static peers, and the middleware that the others use.
//!
//! The library reads none of these variables. An unusable value is refused with its name, because a
//! robot that is silently in another domain is hard to find.

use std::net::{IpAddr, ToSocketAddrs as _};

/// How far discovery reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// This computer.
    Localhost,
    /// The networks this computer is in.
    Subnet,
}

/// How requests and replies of services are told apart; topics do not differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Services {
    /// As `rmw_fastrtps` does: in the metadata of the message.
    FastDds,
    /// As `rmw_cyclonedds` does: in front of the message.
    Cyclone,
}

/// The network as the environment describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Environment {
    /// `ROS_DOMAIN_ID`.
    pub domain: u16,
    /// `ROS_AUTOMATIC_DISCOVERY_RANGE`, or `ROS_LOCALHOST_ONLY` of older distributions.
    pub reach: Reach,
    /// `ROS_STATIC_PEERS`.
    pub peers: Vec<IpAddr>,
    /// `RMW_IMPLEMENTATION`.
    pub services: Services,
}

/// The highest domain whose ports exist.
const LAST_DOMAIN: u16 = 232;

impl Environment {
    /// Reads the variables by `lookup`.
    ///
    /// # Errors
    /// With the variable, what is wrong with it, and what it may be.
    pub fn read(lookup: impl Fn(&str) -> Option<String>) -> Result<Self, String> {
        let value = |name: &str| lookup(name).filter(|value| !value.is_empty());
        let domain = match value("ROS_DOMAIN_ID") {
            None => 0,
            Some(text) => text
                .trim()
                .parse()
                .ok()
                .filter(|domain| *domain <= LAST_DOMAIN)
                .ok_or_else(|| {
                    format!("ROS_DOMAIN_ID={text}: give a number from 0 to {LAST_DOMAIN}")
                })?,
        };
        let services = match value("RMW_IMPLEMENTATION").as_deref() {
            None | Some("rmw_fastrtps_cpp" | "rmw_fastrtps_dynamic_cpp") => Services::FastDds,
            Some("rmw_cyclonedds_cpp") => Services::Cyclone,
            Some(other) => {
                return Err(format!(
                    "RMW_IMPLEMENTATION={other}: this node speaks DDS to rmw_fastrtps_cpp and \
                     rmw_cyclonedds_cpp; rmw_zenoh_cpp is reached through zenoh-bridge-ros2dds"
                ));
            }
        };
        Ok(Self {
            domain,
            reach: reach(&value)?,
            peers: peers(value("ROS_STATIC_PEERS").as_deref().unwrap_or(""))?,
            services,
        })
    }
}

fn reach(value: &impl Fn(&str) -> Option<String>) -> Result<Reach, String> {
    match value("ROS_LOCALHOST_ONLY").as_deref() {
        // As in ROS: the older variable goes before the newer one.
        Some("1") => return Ok(Reach::Localhost),
        None | Some("0") => {}
        Some(other) => return Err(format!("ROS_LOCALHOST_ONLY={other}: give 0 or 1")),
    }
    match value("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() {
        None | Some("SUBNET" | "SYSTEM_DEFAULT") => Ok(Reach::Subnet),
        Some("LOCALHOST") => Ok(Reach::Localhost),
        Some(other) => Err(format!(
            "ROS_AUTOMATIC_DISCOVERY_RANGE={other}: give SUBNET or LOCALHOST; this node cannot do \
             without discovery"
        )),
    }
}

/// Addresses or names of computers between semicolons.
fn peers(text: &str) -> Result<Vec<IpAddr>, String> {
    let mut peers = Vec::new();
    for one in text.split(';').map(str::trim).filter(|one| !one.is_empty()) {
        let found = match one.parse::<IpAddr>() {
            Ok(address) => Some(address),
            Err(_) => (one, 0)
                .to_socket_addrs()
                .ok()
                .and_then(|mut all| all.find(std::net::SocketAddr::is_ipv4))
                .map(|address| address.ip()),
        };
        peers.push(found.ok_or_else(|| {
            format!("ROS_STATIC_PEERS: there is no computer {one}; give addresses or names between semicolons")
        })?);
    }
    Ok(peers)
}
