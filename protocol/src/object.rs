//! What an object of the dictionary is: type, access, limits, and the checks they imply.
//!
//! An [`Object`] is written once, in [`crate::table`], with everything a person or a tool wants to
//! know about it. An [`Entry`](crate::Entry) is the part of it that a robot needs at run time: it is made from
//! the object by the compiler and holds no text, so that the descriptions stay out of the flash.

use crate::address::Address;

/// Data type of an object; the number is that of CiA 301, table 44.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub enum Kind {
    /// INTEGER16.
    I16 = 0x03,
    /// UNSIGNED8.
    U8 = 0x05,
    /// UNSIGNED16.
    U16 = 0x06,
    /// UNSIGNED32.
    U32 = 0x07,
    /// REAL32, IEEE 754.
    F32 = 0x08,
    /// DOMAIN: a block of bytes of any length, which is no [`Value`].
    Domain = 0x0F,
    /// INTEGER24.
    I24 = 0x10,
}

impl Kind {
    /// Length on the wire; 0 for a DOMAIN, which has none of its own.
    #[must_use]
    pub const fn bytes(self) -> u8 {
        match self {
            Self::Domain => 0,
            Self::U8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::I24 => 3,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// Name in CiA 301.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::I16 => "INTEGER16",
            Self::U8 => "UNSIGNED8",
            Self::U16 => "UNSIGNED16",
            Self::U32 => "UNSIGNED32",
            Self::F32 => "REAL32",
            Self::Domain => "DOMAIN",
            Self::I24 => "INTEGER24",
        }
    }
}

/// The value of an object.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Value {
    /// INTEGER16.
    I16(i16),
    /// UNSIGNED8.
    U8(u8),
    /// UNSIGNED16.
    U16(u16),
    /// UNSIGNED32.
    U32(u32),
    /// REAL32.
    F32(f32),
    /// INTEGER24, sign-extended.
    I24(i32),
    /// A DOMAIN, whose bytes travel by themselves.
    Domain,
}

/// Why a value is refused; nothing has changed then.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ValueError {
    /// Fewer bytes than the type has.
    TooShort,
    /// More bytes than the type has.
    TooLong,
    /// Not a number, or no value this object knows.
    Invalid,
    /// Above the upper limit.
    TooHigh,
    /// Below the lower limit.
    TooLow,
}

impl core::fmt::Display for ValueError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::TooShort => "too few bytes for the type",
            Self::TooLong => "too many bytes for the type",
            Self::Invalid => "not a valid value",
            Self::TooHigh => "above the upper limit",
            Self::TooLow => "below the lower limit",
        })
    }
}

impl core::error::Error for ValueError {}

impl Value {
    /// Type of this value.
    #[must_use]
    pub const fn kind(self) -> Kind {
        match self {
            Self::I16(_) => Kind::I16,
            Self::U8(_) => Kind::U8,
            Self::U16(_) => Kind::U16,
            Self::U32(_) => Kind::U32,
            Self::F32(_) => Kind::F32,
            Self::I24(_) => Kind::I24,
            Self::Domain => Kind::Domain,
        }
    }

    /// Little-endian bytes, of which the first [`Kind::bytes`] count.
    #[must_use]
    pub const fn to_bytes(self) -> [u8; 4] {
        self.to_bits().to_le_bytes()
    }

    /// The same in one word, the way parameters are kept.
    #[must_use]
    pub const fn to_bits(self) -> u32 {
        match self {
            Self::I16(value) => value.cast_unsigned() as u32,
            Self::U8(value) => value as u32,
            Self::U16(value) => value as u32,
            Self::U32(value) => value,
            Self::F32(value) => value.to_bits(),
            Self::I24(value) => value.cast_unsigned() & 0x00FF_FFFF,
            Self::Domain => 0,
        }
    }

    /// The value of this type in a word made by [`Value::to_bits`].
    #[must_use]
    pub const fn from_bits(kind: Kind, bits: u32) -> Self {
        let [a, b, c, _] = bits.to_le_bytes();
        match kind {
            Kind::I16 => Self::I16(i16::from_le_bytes([a, b])),
            Kind::U8 => Self::U8(a),
            Kind::U16 => Self::U16(u16::from_le_bytes([a, b])),
            Kind::U32 => Self::U32(bits),
            Kind::F32 => Self::F32(f32::from_bits(bits)),
            Kind::I24 => Self::I24(crate::scaling::i24_from_bytes([a, b, c])),
            Kind::Domain => Self::Domain,
        }
    }

    /// The value of this type in exactly its number of little-endian bytes.
    ///
    /// # Errors
    /// [`ValueError::TooShort`] or [`ValueError::TooLong`].
    pub fn from_bytes(kind: Kind, data: &[u8]) -> Result<Self, ValueError> {
        let length = usize::from(kind.bytes());
        if data.len() < length {
            return Err(ValueError::TooShort);
        }
        if data.len() > length {
            return Err(ValueError::TooLong);
        }
        let mut word = [0; 4];
        for (to, from) in word.iter_mut().zip(data) {
            *to = *from;
        }
        Ok(Self::from_bits(kind, u32::from_le_bytes(word)))
    }

    /// Checks this value against limits of the same type. A REAL32 must be finite.
    ///
    /// # Errors
    /// [`ValueError::Invalid`], [`ValueError::TooLow`] or [`ValueError::TooHigh`].
    pub fn check(self, min: Self, max: Self) -> Result<(), ValueError> {
        let order = match (self, min, max) {
            (Self::F32(value), Self::F32(min), Self::F32(max)) => {
                if !value.is_finite() {
                    return Err(ValueError::Invalid);
                }
                (value < min, value > max)
            }
            (Self::I16(value), Self::I16(min), Self::I16(max)) => (value < min, value > max),
            (Self::I24(value), Self::I24(min), Self::I24(max)) => (value < min, value > max),
            // The unsigned ones compare as words.
            _ => (
                self.to_bits() < min.to_bits(),
                self.to_bits() > max.to_bits(),
            ),
        };
        match order {
            (true, _) => Err(ValueError::TooLow),
            (_, true) => Err(ValueError::TooHigh),
            (false, false) => Ok(()),
        }
    }
}

/// Who may do what with an object, and when.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Access {
    /// Never changes.
    Const,
    /// Read by the bus, written by the robot.
    ReadOnly,
    /// Written by the bus at any time, and cannot be read.
    WriteOnly,
    /// Written by the bus at any time.
    ReadWrite,
    /// Written by the bus, but not while OPERATIONAL (abort 0x08000022).
    Parameter,
}

impl Access {
    /// The word the EDS uses.
    #[must_use]
    pub const fn eds(self) -> &'static str {
        match self {
            Self::Const => "const",
            Self::ReadOnly => "ro",
            Self::WriteOnly => "wo",
            Self::ReadWrite | Self::Parameter => "rw",
        }
    }
}

/// One object, with all there is to say about it.
#[derive(Clone, Copy, Debug)]
pub struct Object {
    /// Index and sub-index.
    pub address: Address,
    /// Its name, without the record's.
    pub name: &'static str,
    /// Type on the wire; that of `min`, `max` and `default` too.
    pub kind: Kind,
    /// Who may write it.
    pub access: Access,
    /// Unit of the value as transferred; empty for a plain number.
    pub unit: &'static str,
    /// Lowest value accepted.
    pub min: Value,
    /// Highest value accepted.
    pub max: Value,
    /// Value after a reset to defaults.
    pub default: Value,
    /// Kept in flash when the parameters are stored.
    pub persistent: bool,
    /// May be mapped into a PDO.
    pub mappable: bool,
    /// Must have been written (or loaded) before the drivers can be enabled.
    pub required: bool,
    /// Refused while the robot is locked (abort 0x08000021).
    pub guarded: bool,
    /// What it is, for people.
    pub text: &'static str,
}

impl Object {
    const fn new(
        address: Address,
        name: &'static str,
        unit: &'static str,
        [min, max, default]: [Value; 3],
        access: Access,
        text: &'static str,
    ) -> Self {
        Self {
            address,
            name,
            kind: default.kind(),
            access,
            unit,
            min,
            max,
            default,
            persistent: false,
            mappable: false,
            required: false,
            guarded: matches!(access, Access::Parameter),
            text,
        }
    }

    /// A parameter the robot cannot do without.
    #[must_use]
    pub(crate) const fn required(
        address: Address,
        name: &'static str,
        unit: &'static str,
        range: [Value; 3],
        text: &'static str,
    ) -> Self {
        let mut object = Self::new(address, name, unit, range, Access::Parameter, text);
        object.persistent = true;
        object.required = true;
        object
    }

    /// A parameter with a default that works.
    #[must_use]
    pub(crate) const fn parameter(
        address: Address,
        name: &'static str,
        unit: &'static str,
        range: [Value; 3],
        text: &'static str,
    ) -> Self {
        let mut object = Self::new(address, name, unit, range, Access::Parameter, text);
        object.persistent = true;
        object
    }

    /// A block of bytes that is a parameter as a whole.
    #[must_use]
    pub(crate) const fn block(address: Address, name: &'static str, text: &'static str) -> Self {
        let range = [Value::Domain; 3];
        Self::parameter(address, name, "", range, text)
    }

    /// A block of bytes of any length that is written and not kept.
    #[must_use]
    pub(crate) const fn download(address: Address, name: &'static str, text: &'static str) -> Self {
        let range = [Value::Domain; 3];
        Self::new(address, name, "", range, Access::WriteOnly, text)
    }

    /// The same, refused while the robot is locked.
    #[must_use]
    pub(crate) const fn guarded_download(
        address: Address,
        name: &'static str,
        text: &'static str,
    ) -> Self {
        Self::download(address, name, text).guarded()
    }

    /// Something the robot tells.
    #[must_use]
    pub(crate) const fn state(
        address: Address,
        name: &'static str,
        unit: &'static str,
        kind: Kind,
        text: &'static str,
    ) -> Self {
        Self::new(
            address,
            name,
            unit,
            full_range(kind),
            Access::ReadOnly,
            text,
        )
    }

    /// Something that never changes.
    #[must_use]
    pub(crate) const fn constant(
        address: Address,
        name: &'static str,
        value: Value,
        text: &'static str,
    ) -> Self {
        Self::new(address, name, "", [value; 3], Access::Const, text)
    }

    /// Something the robot counts.
    #[must_use]
    pub(crate) const fn counter(address: Address, name: &'static str, text: &'static str) -> Self {
        Self::state(address, name, "", Kind::U32, text)
    }

    const fn in_pdos(mut self) -> Self {
        self.mappable = true;
        self
    }

    /// Something the robot reports in a PDO.
    #[must_use]
    pub(crate) const fn process(
        address: Address,
        name: &'static str,
        unit: &'static str,
        kind: Kind,
        text: &'static str,
    ) -> Self {
        Self::state(address, name, unit, kind, text).in_pdos()
    }

    /// A value that the robot receives in a PDO.
    #[must_use]
    pub(crate) const fn received(
        address: Address,
        name: &'static str,
        unit: &'static str,
        kind: Kind,
        text: &'static str,
    ) -> Self {
        Self::command(address, name, unit, kind, text).in_pdos()
    }

    /// Something that may be written at any time and is not kept.
    #[must_use]
    pub(crate) const fn command(
        address: Address,
        name: &'static str,
        unit: &'static str,
        kind: Kind,
        text: &'static str,
    ) -> Self {
        Self::new(
            address,
            name,
            unit,
            full_range(kind),
            Access::ReadWrite,
            text,
        )
    }

    /// Something that may be written at any time within limits, and is not kept.
    #[must_use]
    pub(crate) const fn setting(
        address: Address,
        name: &'static str,
        unit: &'static str,
        range: [Value; 3],
        text: &'static str,
    ) -> Self {
        Self::new(address, name, unit, range, Access::ReadWrite, text)
    }

    /// The same, refused while the robot is locked.
    #[must_use]
    pub(crate) const fn guarded_setting(
        address: Address,
        name: &'static str,
        unit: &'static str,
        range: [Value; 3],
        text: &'static str,
    ) -> Self {
        Self::setting(address, name, unit, range, text).guarded()
    }

    const fn guarded(mut self) -> Self {
        self.guarded = true;
        self
    }

    /// Lowest and highest value and default, as words.
    pub(crate) const fn range(&self) -> [u32; 3] {
        [
            self.min.to_bits(),
            self.max.to_bits(),
            self.default.to_bits(),
        ]
    }
}

/// Every value of its kind, and zero for a default.
const fn full_range(kind: Kind) -> [Value; 3] {
    let (min, max) = match kind {
        Kind::I16 => (Value::I16(i16::MIN), Value::I16(i16::MAX)),
        Kind::U8 => (Value::U8(0), Value::U8(u8::MAX)),
        Kind::U16 => (Value::U16(0), Value::U16(u16::MAX)),
        Kind::U32 => (Value::U32(0), Value::U32(u32::MAX)),
        Kind::F32 => (Value::F32(f32::MIN), Value::F32(f32::MAX)),
        Kind::I24 => (Value::I24(-0x80_0000), Value::I24(0x7F_FFFF)),
        Kind::Domain => (Value::Domain, Value::Domain),
    };
    [min, max, Value::from_bits(kind, 0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_of_every_type_come_back() {
        for value in [
            Value::I16(-2),
            Value::U8(200),
            Value::U16(65_000),
            Value::U32(0xDEAD_BEEF),
            Value::F32(-1.002),
            Value::I24(-8_388_608),
            Value::I24(8_388_607),
        ] {
            let kind = value.kind();
            let bytes = value.to_bytes();
            let used = &bytes[..usize::from(kind.bytes())];
            assert_eq!(Value::from_bytes(kind, used), Ok(value));
            assert_eq!(Value::from_bits(kind, value.to_bits()), value);
        }
    }

    #[test]
    fn wrong_length_is_refused() {
        assert_eq!(
            Value::from_bytes(Kind::F32, &[0; 3]),
            Err(ValueError::TooShort)
        );
        assert_eq!(
            Value::from_bytes(Kind::U8, &[0; 2]),
            Err(ValueError::TooLong)
        );
    }

    #[test]
    fn limits_are_inclusive_on_both_sides() {
        let check = |value: f32| Value::F32(value).check(Value::F32(0.1), Value::F32(2.0));
        assert_eq!(check(0.1), Ok(()));
        assert_eq!(check(2.0), Ok(()));
        assert_eq!(check(0.099_999), Err(ValueError::TooLow));
        assert_eq!(check(2.000_001), Err(ValueError::TooHigh));
        assert_eq!(check(f32::NAN), Err(ValueError::Invalid));
        assert_eq!(check(f32::INFINITY), Err(ValueError::Invalid));
        let check = |value: i16| Value::I16(value).check(Value::I16(-5), Value::I16(5));
        assert_eq!(check(-5), Ok(()));
        assert_eq!(check(-6), Err(ValueError::TooLow));
        assert_eq!(check(6), Err(ValueError::TooHigh));
    }
}
