//! The messages, as JSON has them.
//!
//! [`order`] and [`action`] are read, in the spellings of all three versions; [`state`] and
//! [`factsheet`] are written, for one version at a time.

pub mod action;
pub mod factsheet;
pub mod order;
pub mod state;

use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

use crate::error::{ErrorKind, Refusal};
use crate::{Version, time};

/// Whose messages these are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Version that is spoken.
    pub version: Version,
    /// First level of the topics, `uagv` by the standard's suggestion.
    pub interface: String,
    /// Manufacturer of the vehicle.
    pub manufacturer: String,
    /// Serial number of the vehicle.
    pub serial: String,
}

impl Identity {
    /// Checks the parts of the topics (6.3).
    ///
    /// # Errors
    /// With the option to correct.
    pub fn check(&self) -> Result<(), String> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "_.:-".contains(c);
        if self.serial.is_empty() || !self.serial.chars().all(plain) {
            return Err(format!(
                "--serial {:?}: use letters, digits and _ . : - only (VDA 5050, 6.3)",
                self.serial
            ));
        }
        for (option, text) in [
            ("--manufacturer", &self.manufacturer),
            ("--interface", &self.interface),
        ] {
            if text.is_empty() || text.contains(['/', '+', '#', '$']) || text.contains('\0') {
                return Err(format!(
                    "{option} {text:?}: it is a level of the topics, so it must not be empty nor \
                     contain / + # or $ (VDA 5050, 6.3)"
                ));
            }
        }
        Ok(())
    }

    /// A topic of this vehicle.
    #[must_use]
    pub fn topic(&self, last: &str) -> String {
        let Self {
            version,
            interface,
            manufacturer,
            serial,
        } = self;
        let level = version.topic_level();
        format!("{interface}/{level}/{manufacturer}/{serial}/{last}")
    }

    /// A message with its header (6.4).
    #[must_use]
    pub fn message(&self, header_id: u32, unix_ms: u64, body: Map<String, Value>) -> Value {
        let mut message = Map::new();
        message.insert("headerId".into(), json!(header_id));
        message.insert("timestamp".into(), json!(time::stamp(unix_ms)));
        message.insert("version".into(), json!(self.version.number()));
        message.insert("manufacturer".into(), json!(self.manufacturer));
        message.insert("serialNumber".into(), json!(self.serial));
        message.extend(body);
        Value::Object(message)
    }

    /// The message `connection` (6.14).
    #[must_use]
    pub fn connection(&self, header_id: u32, unix_ms: u64, state: Connection) -> Value {
        let mut body = Map::new();
        body.insert("connectionState".into(), json!(state.name(self.version)));
        self.message(header_id, unix_ms, body)
    }
}

/// What the message `connection` says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Connection {
    /// Connected.
    Online,
    /// Disconnected on purpose.
    Offline,
    /// The last will.
    Broken,
}

impl Connection {
    const fn name(self, version: Version) -> &'static str {
        match (self, version) {
            (Self::Online, _) => "ONLINE",
            (Self::Offline, _) => "OFFLINE",
            (Self::Broken, Version::V3_0) => "CONNECTION_BROKEN",
            (Self::Broken, _) => "CONNECTIONBROKEN",
        }
    }
}

/// Longest message that is read, in bytes.
pub const LONGEST: usize = 1_000_000;

/// Reads a message, or says which field is wrong.
pub(crate) fn read<T: DeserializeOwned>(text: &[u8], kind: ErrorKind) -> Result<T, Refusal> {
    if text.len() > LONGEST {
        let sentence = format!(
            "the message has {} bytes; at most {LONGEST} are read",
            text.len()
        );
        return Err(Refusal::new(kind, sentence));
    }
    let mut json = serde_json::Deserializer::from_slice(text);
    let read: T = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let path = error.path().to_string();
        let problem = error.inner().to_string();
        Refusal::new(kind, format!("{path}: {problem}")).about("field", path)
    })?;
    json.end()
        .map_err(|error| Refusal::new(kind, format!("something follows the message: {error}")))?;
    Ok(read)
}
