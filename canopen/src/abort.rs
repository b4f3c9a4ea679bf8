//! The SDO abort codes of CiA 301, table 22.

/// Why a transfer was refused. The discriminant is the code on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u32)]
pub enum AbortCode {
    /// Toggle bit not alternated.
    ToggleBit = 0x0503_0000,
    /// SDO protocol timed out.
    Timeout = 0x0504_0000,
    /// Client/server command specifier not valid or unknown.
    CommandSpecifier = 0x0504_0001,
    /// Invalid block size.
    BlockSize = 0x0504_0002,
    /// Invalid sequence number.
    SequenceNumber = 0x0504_0003,
    /// CRC error.
    Crc = 0x0504_0004,
    /// Out of memory.
    OutOfMemory = 0x0504_0005,
    /// Unsupported access to an object.
    UnsupportedAccess = 0x0601_0000,
    /// Attempt to read a write-only object.
    WriteOnly = 0x0601_0001,
    /// Attempt to write a read-only object.
    ReadOnly = 0x0601_0002,
    /// Object does not exist in the object dictionary.
    NoObject = 0x0602_0000,
    /// Object cannot be mapped to the PDO.
    NotMappable = 0x0604_0041,
    /// The number and length of the objects to be mapped would exceed the PDO length.
    PdoLength = 0x0604_0042,
    /// General parameter incompatibility.
    ParameterIncompatible = 0x0604_0043,
    /// General internal incompatibility in the device.
    InternalIncompatible = 0x0604_0047,
    /// Access failed due to a hardware error.
    Hardware = 0x0606_0000,
    /// Data type does not match, length of service parameter does not match.
    LengthMismatch = 0x0607_0010,
    /// Data type does not match, length of service parameter too high.
    TooLong = 0x0607_0012,
    /// Data type does not match, length of service parameter too low.
    TooShort = 0x0607_0013,
    /// Sub-index does not exist.
    NoSubIndex = 0x0609_0011,
    /// Invalid value for parameter (download only).
    InvalidValue = 0x0609_0030,
    /// Value of parameter written too high (download only).
    ValueTooHigh = 0x0609_0031,
    /// Value of parameter written too low (download only).
    ValueTooLow = 0x0609_0032,
    /// Maximum value is less than minimum value.
    MaxBelowMin = 0x0609_0036,
    /// Resource not available: SDO connection.
    NoResource = 0x060A_0023,
    /// General error.
    General = 0x0800_0000,
    /// Data cannot be transferred or stored to the application.
    CannotStore = 0x0800_0020,
    /// Data cannot be transferred or stored to the application because of local control.
    LocalControl = 0x0800_0021,
    /// Data cannot be transferred or stored to the application because of the present device state.
    DeviceState = 0x0800_0022,
    /// Object dictionary dynamic generation fails or no object dictionary is present.
    NoDictionary = 0x0800_0023,
    /// No data available.
    NoData = 0x0800_0024,
}

impl AbortCode {
    /// Every code.
    pub const ALL: [Self; 31] = [
        Self::ToggleBit,
        Self::Timeout,
        Self::CommandSpecifier,
        Self::BlockSize,
        Self::SequenceNumber,
        Self::Crc,
        Self::OutOfMemory,
        Self::UnsupportedAccess,
        Self::WriteOnly,
        Self::ReadOnly,
        Self::NoObject,
        Self::NotMappable,
        Self::PdoLength,
        Self::ParameterIncompatible,
        Self::InternalIncompatible,
        Self::Hardware,
        Self::LengthMismatch,
        Self::TooLong,
        Self::TooShort,
        Self::NoSubIndex,
        Self::InvalidValue,
        Self::ValueTooHigh,
        Self::ValueTooLow,
        Self::MaxBelowMin,
        Self::NoResource,
        Self::General,
        Self::CannotStore,
        Self::LocalControl,
        Self::DeviceState,
        Self::NoDictionary,
        Self::NoData,
    ];

    /// The code on the wire.
    #[must_use]
    pub const fn code(self) -> u32 {
        self as u32
    }

    /// The meaning of a code; `None` if CiA 301 does not list it.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|known| known.code() == code)
    }

    /// What the code says, in a few words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::ToggleBit => "toggle bit not alternated",
            Self::Timeout => "SDO protocol timed out",
            Self::CommandSpecifier => "command specifier not valid or unknown",
            Self::BlockSize => "invalid block size",
            Self::SequenceNumber => "invalid sequence number",
            Self::Crc => "CRC error",
            Self::OutOfMemory => "out of memory",
            Self::UnsupportedAccess => "unsupported access to an object",
            Self::WriteOnly => "object is write-only",
            Self::ReadOnly => "object is read-only",
            Self::NoObject => "object does not exist",
            Self::NotMappable => "object cannot be mapped to the PDO",
            Self::PdoLength => "mapped objects exceed the PDO length",
            Self::ParameterIncompatible => "parameters are incompatible",
            Self::InternalIncompatible => "internal incompatibility in the device",
            Self::Hardware => "hardware error",
            Self::LengthMismatch => "length does not match",
            Self::TooLong => "length too high",
            Self::TooShort => "length too low",
            Self::NoSubIndex => "sub-index does not exist",
            Self::InvalidValue => "invalid value",
            Self::ValueTooHigh => "value too high",
            Self::ValueTooLow => "value too low",
            Self::MaxBelowMin => "maximum is less than minimum",
            Self::NoResource => "resource not available",
            Self::General => "general error",
            Self::CannotStore => "data cannot be transferred or stored",
            Self::LocalControl => "not possible because of local control",
            Self::DeviceState => "not possible in the present device state",
            Self::NoDictionary => "no object dictionary",
            Self::NoData => "no data available",
        }
    }
}

impl core::fmt::Display for AbortCode {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "0x{:08X} ({})", self.code(), self.text())
    }
}

impl core::error::Error for AbortCode {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_is_found_by_its_number() {
        for code in AbortCode::ALL {
            assert_eq!(AbortCode::from_code(code.code()), Some(code));
        }
        assert_eq!(AbortCode::from_code(0x0601_0002), Some(AbortCode::ReadOnly));
        assert_eq!(AbortCode::from_code(0), None);
    }
}
