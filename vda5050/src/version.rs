//! The version of VDA 5050 in use.

use std::fmt;
use std::str::FromStr;

/// A version of VDA 5050. What the vehicle does is the same in all; names of fields, of errors and
/// of states differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Version {
    /// 2.0.0: what most fleet controls speak.
    #[default]
    V2_0,
    /// 2.1.0: maps and corridors are added.
    V2_1,
    /// 3.0.0: another topic, and new names.
    V3_0,
}

impl Version {
    /// The field `version` of every message.
    #[must_use]
    pub const fn number(self) -> &'static str {
        match self {
            Self::V2_0 => "2.0.0",
            Self::V2_1 => "2.1.0",
            Self::V3_0 => "3.0.0",
        }
    }

    /// The level of every topic that tells the major version.
    #[must_use]
    pub const fn topic_level(self) -> &'static str {
        match self {
            Self::V2_0 | Self::V2_1 => "v2",
            Self::V3_0 => "v3",
        }
    }
}

impl FromStr for Version {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "2.0" | "2.0.0" => Ok(Self::V2_0),
            "2.1" | "2.1.0" => Ok(Self::V2_1),
            "3.0" | "3.0.0" => Ok(Self::V3_0),
            _ => Err("give 2.0, 2.1 or 3.0".into()),
        }
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.number())
    }
}
