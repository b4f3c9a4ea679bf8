//! Which bus: the text after `--bus`, and what it means.

use std::path::PathBuf;
use std::str::FromStr;

/// A bus as named on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BusAddress {
    /// `auto`: the only serial adapter that is plugged in and answers.
    Auto,
    /// `sim:GROUP.toml`: a simulated world in this process, with the robots of a group file.
    Sim(PathBuf),
    /// `socketcan:can0`: a Linux CAN interface.
    SocketCan(String),
    /// `slcan:/dev/ttyACM0`: a serial adapter that speaks slcan.
    Slcan(PathBuf),
    /// `slcan-tcp://HOST:PORT`: slcan over a network.
    SlcanTcp(String),
    /// `lockstep://HOST:PORT`: a simulated bus whose time waits for the master.
    Lockstep(String),
    /// `socketcand://HOST:PORT/can0`: a CAN interface that a socketcand server offers.
    Socketcand(String, String),
}

/// Why a text names no bus.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not a bus; give one of auto, sim:GROUP.toml, socketcan:INTERFACE, slcan:DEVICE, \
     slcan-tcp://HOST:PORT, socketcand://HOST:PORT/INTERFACE, lockstep://HOST:PORT (for example \
     sim:groups/tcc-3.toml, \
     socketcan:can0, slcan:/dev/ttyACM0, socketcand://pi.local:29536/can0)"
)]
pub struct NoBus(String);

impl FromStr for BusAddress {
    type Err = NoBus;

    fn from_str(text: &str) -> Result<Self, NoBus> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        match text.split_once(':') {
            Some((_, "")) | None => Err(NoBus(text.into())),
            Some(("sim", _)) if cfg!(not(feature = "simulation")) => Err(NoBus(text.into())),
            Some(("sim", file)) => Ok(Self::Sim(file.into())),
            Some(("socketcan", interface)) => Ok(Self::SocketCan(interface.into())),
            Some(("slcan", device)) => Ok(Self::Slcan(device.into())),
            Some(("slcan-tcp", rest)) => match rest.strip_prefix("//") {
                Some(address) if address.contains(':') => Ok(Self::SlcanTcp(address.into())),
                _ => Err(NoBus(text.into())),
            },
            Some(("lockstep", rest)) => match rest.strip_prefix("//") {
                Some(address) if address.contains(':') => Ok(Self::Lockstep(address.into())),
                _ => Err(NoBus(text.into())),
            },
            Some(("socketcand", rest)) => {
                let parts = rest.strip_prefix("//").and_then(|r| r.split_once('/'));
                match parts {
                    Some((address, interface))
                        if address.contains(':') && !interface.is_empty() =>
                    {
                        Ok(Self::Socketcand(address.into(), interface.into()))
                    }
                    _ => Err(NoBus(text.into())),
                }
            }
            Some(_) => Err(NoBus(text.into())),
        }
    }
}

impl BusAddress {
    /// Whether time on this bus is virtual and waits for the master.
    #[must_use]
    pub const fn waits(&self) -> bool {
        matches!(self, Self::Sim(_) | Self::Lockstep(_))
    }
}

impl std::fmt::Display for BusAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sim(file) => write!(f, "sim:{}", file.display()),
            Self::SocketCan(interface) => write!(f, "socketcan:{interface}"),
            Self::Socketcand(address, interface) => {
                write!(f, "socketcand://{address}/{interface}")
            }
            Self::SlcanTcp(address) => write!(f, "slcan-tcp://{address}"),
            Self::Lockstep(address) => write!(f, "lockstep://{address}"),
            Self::Auto => f.write_str("auto"),
            Self::Slcan(device) => write!(f, "slcan:{}", device.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_and_written_alike() {
        for text in [
            "auto",
            "sim:groups/tcc-3.toml",
            "socketcan:can0",
            "slcan:/dev/ttyACM0",
            "slcan-tcp://localhost:3333",
            "lockstep://localhost:3333",
            "socketcand://pi.local:29536/can0",
        ] {
            assert_eq!(text.parse::<BusAddress>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn anything_else_is_refused_with_examples() {
        for text in [
            "",
            "can0",
            "sim:",
            "usb:1",
            "slcan-tcp://localhost",
            "slcan-tcp:x:1",
            "lockstep:x:1",
            "socketcand://pi.local/can0",
            "socketcand://pi.local:29536",
            "socketcand://pi.local:29536/",
        ] {
            let error = text.parse::<BusAddress>().unwrap_err().to_string();
            assert!(error.contains("socketcan:can0"), "{error}");
        }
    }
}
