//! `--bus auto`: the one serial adapter that is plugged in and answers.
//!
//! Ports are known by their USB identity: the ST-LINK of a NUCLEO, behind which a robot is its own
//! adapter, and adapters that speak slcan. Only these are asked, with a line that is no command and
//! then for their version, so no other device gets bytes it does not expect. One that answers is
//! taken; with none, or several, the error says what there is and what to type.

use std::fmt::Write as _;

use crate::bus::address::BusAddress;
use crate::bus::link::LinkError;

/// What is known by its identity: vendor, product, and what to call it.
const KNOWN: [(u16, u16, &str); 10] = [
    (0x0483, 0x374B, "ST-LINK, a robot"),
    (0x0483, 0x374A, "ST-LINK, a robot"),
    (0x0483, 0x3752, "ST-LINK, a robot"),
    (0x0483, 0x3753, "ST-LINK, a robot"),
    (0x0483, 0x374E, "ST-LINK, a robot"),
    (0x0483, 0x374F, "ST-LINK, a robot"),
    (0xAD50, 0x60C4, "CANable"),
    (0x16D0, 0x117E, "CANable"),
    (0x1D50, 0x606F, "CANable"),
    (0x0403, 0xFFA8, "LAWICEL CANUSB"),
];

/// A serial port of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SerialPort {
    /// What to open: `/dev/ttyACM0`, `COM3`.
    pub name: String,
    /// Vendor and product of a USB device.
    pub usb: Option<(u16, u16)>,
}

impl SerialPort {
    /// What it is, if it is known.
    fn kind(&self) -> Option<&'static str> {
        let usb = self.usb?;
        let mut known = KNOWN.iter();
        known
            .find(|(vendor, product, _)| (*vendor, *product) == usb)
            .map(|(.., kind)| *kind)
    }

    fn describe(&self) -> String {
        match (self.kind(), self.usb) {
            (Some(kind), _) => kind.into(),
            (None, Some((vendor, product))) => format!("USB {vendor:04x}:{product:04x}"),
            (None, None) => "no USB device".into(),
        }
    }
}

/// Chooses among the ports; `answers` asks one of them.
///
/// # Errors
/// When none of them answers, or several do.
pub fn choose(
    ports: &[SerialPort],
    mut answers: impl FnMut(&str) -> bool,
) -> Result<BusAddress, LinkError> {
    let known: Vec<_> = ports.iter().filter(|port| port.kind().is_some()).collect();
    let answering: Vec<_> = known.iter().filter(|port| answers(&port.name)).collect();
    if let [only] = answering.as_slice() {
        return Ok(BusAddress::Slcan((&only.name).into()));
    }
    let problem = match (known.len(), answering.len()) {
        (0, _) => "no ST-LINK and no known adapter is plugged in",
        (_, 0) => "no ST-LINK and no adapter answers",
        _ => "several adapters answer",
    };
    let mut remedy = match (ports, answering.is_empty()) {
        ([], _) => "plug the robot's USB cable in (one that carries data)".to_owned(),
        (_, true) => "check the plug, that the robot's firmware is flashed, and that nothing else \
                      has the port open; or give one of:"
            .to_owned(),
        (_, false) => "give one of:".to_owned(),
    };
    for port in ports {
        // Writing into a string cannot fail.
        let _ = write!(
            remedy,
            "\n  --bus slcan:{}  ({})",
            port.name,
            port.describe()
        );
    }
    Err(LinkError {
        bus: "auto".into(),
        problem: problem.into(),
        remedy,
    })
}

/// Chooses among the ports of this machine.
///
/// # Errors
/// As [`choose`].
#[cfg(feature = "adapters")]
pub fn find() -> Result<BusAddress, LinkError> {
    use serialport::SerialPortType;
    let listed = serialport::available_ports().unwrap_or_default();
    let ports: Vec<SerialPort> = listed
        .into_iter()
        // macOS names each port twice; opening the other one waits for a carrier.
        .filter(|port| !port.port_name.starts_with("/dev/tty."))
        .map(|port| SerialPort {
            usb: match port.port_type {
                SerialPortType::UsbPort(usb) => Some((usb.vid, usb.pid)),
                _ => None,
            },
            name: port.port_name,
        })
        .collect();
    choose(&ports, crate::bus::adapter::slcan::answers)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROBOT: (u16, u16) = (0x0483, 0x374B);
    const MODEM: (u16, u16) = (0x12D1, 0x1001);

    fn port(name: &str, usb: Option<(u16, u16)>) -> SerialPort {
        SerialPort {
            name: name.into(),
            usb,
        }
    }

    #[test]
    fn the_only_one_that_answers_is_taken_and_no_stranger_is_asked() {
        let ports = [
            port("/dev/ttyS0", None),
            port("/dev/ttyACM0", Some(MODEM)),
            port("/dev/ttyACM1", Some(ROBOT)),
            port("/dev/ttyACM2", Some(ROBOT)),
        ];
        let mut asked = Vec::new();
        let found = choose(&ports, |name| {
            asked.push(name.to_owned());
            name == "/dev/ttyACM2"
        });
        assert_eq!(found, Ok(BusAddress::Slcan("/dev/ttyACM2".into())));
        assert_eq!(asked, ["/dev/ttyACM1", "/dev/ttyACM2"]);
    }

    #[test]
    fn with_none_or_several_it_says_what_to_type() {
        let ports = [port("COM3", Some(ROBOT)), port("COM4", Some(ROBOT))];
        for (answers, problem) in [(true, "several"), (false, "no adapter answers")] {
            let error = choose(&ports, |_| answers).unwrap_err().to_string();
            assert!(error.contains(problem), "{error}");
            assert!(
                error.contains("--bus slcan:COM4  (ST-LINK, a robot)"),
                "{error}"
            );
        }
        let error = choose(&[port("COM1", Some(MODEM))], |_| true).unwrap_err();
        assert!(error.problem.contains("no known adapter"), "{error}");
        assert!(error.remedy.contains("COM1  (USB 12d1:1001)"), "{error}");
        let error = choose(&[], |_| true).unwrap_err().to_string();
        assert!(error.contains("USB cable"), "{error}");
    }
}
