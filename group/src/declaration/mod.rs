//! Every key of a group file: what it is called, what it holds, its unit, range and default.
//!
//! This is the one declaration. [`crate::structure`] checks a file against it, and
//! [`crate::reference`] makes the page `docs/group-files.md` and the JSON Schema of it. Where a key
//! becomes a parameter of the robot, its range is that of the robot's object, so a file that passes
//! is a file that robots accept. Rules that involve more than one key are in `check`, `member` and
//! `check_simulation`.
//!
//! A test compares the keys here with those that [`crate::schema`] reads.

use protocol::Address;

mod file;
mod robot;
mod simulation;

pub use file::FILE;

/// A key.
#[derive(Clone, Copy)]
pub struct Field {
    /// As in the file.
    pub key: &'static str,
    /// Its name in older files, still read.
    pub formerly: Option<&'static str>,
    /// What it holds.
    pub kind: Kind,
    /// Unit of a number; empty for none.
    pub unit: &'static str,
    /// What holds without it.
    pub without: Without,
    /// The parameter that it becomes.
    pub object: Option<Object>,
    /// What it means.
    pub text: &'static str,
}

/// The parameter that a key becomes.
#[derive(Clone, Copy)]
pub struct Object {
    /// Where the robot has it.
    pub address: Address,
    /// The robot's value over the file's.
    pub factor: f64,
}

/// What a key holds.
#[derive(Clone, Copy)]
pub enum Kind {
    /// A number in a range.
    Number(Range),
    /// A whole number, from and to.
    Whole(i64, i64),
    /// `true` or `false`.
    Flag,
    /// Text.
    Text,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// A list of numbers: of so many, or of any length.
    Numbers(Option<usize>),
    /// A list of rows of so many numbers.
    Rows(usize),
    /// A table with these keys.
    Table(&'static [&'static [Field]]),
    /// A list of tables with these keys.
    Tables(&'static [&'static [Field]]),
}

/// The numbers that a key may have; a robot's object may narrow it.
#[derive(Clone, Copy)]
pub struct Range {
    /// Lowest, in the unit of the key.
    pub min: f64,
    /// Whether the lowest itself is outside.
    pub above_min: bool,
    /// Highest, in the unit of the key.
    pub max: f64,
}

/// What holds where a key is left out.
#[derive(Clone, Copy)]
pub enum Without {
    /// The file is refused.
    Required,
    /// The file is refused, by a rule that knows more than this declaration.
    Needed,
    /// It must stand in the robot's entry or in `[robot]`.
    NeededSomewhere,
    /// A number.
    Default(f64),
    /// This.
    Otherwise(&'static str),
}

const ANY: Range = Range {
    min: f64::MIN,
    above_min: false,
    max: f64::MAX,
};
const POSITIVE: Range = Range {
    min: 0.0,
    above_min: true,
    max: f64::MAX,
};
const NOT_NEGATIVE: Range = Range {
    min: 0.0,
    above_min: false,
    max: f64::MAX,
};

/// Above 0, and at most this.
const fn up_to(max: f64) -> Range {
    Range { max, ..POSITIVE }
}

const fn to(min: f64, max: f64) -> Range {
    Range {
        min,
        above_min: false,
        max,
    }
}

const fn field(key: &'static str, kind: Kind, text: &'static str) -> Field {
    Field {
        key,
        formerly: None,
        kind,
        unit: "",
        without: Without::Otherwise("-"),
        object: None,
        text,
    }
}

const fn number(key: &'static str, unit: &'static str, range: Range, text: &'static str) -> Field {
    let mut out = field(key, Kind::Number(range), text);
    out.unit = unit;
    out
}

impl Field {
    const fn required(mut self) -> Self {
        self.without = Without::Required;
        self
    }

    const fn needed(mut self) -> Self {
        self.without = Without::Needed;
        self
    }

    const fn somewhere(mut self) -> Self {
        self.without = Without::NeededSomewhere;
        self
    }

    const fn or(mut self, default: f64) -> Self {
        self.without = Without::Default(default);
        self
    }

    const fn otherwise(mut self, what: &'static str) -> Self {
        self.without = Without::Otherwise(what);
        self
    }

    const fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// The robot holds `factor` times the file's number at `address`.
    const fn object(mut self, address: Address, factor: f64) -> Self {
        self.object = Some(Object { address, factor });
        self
    }

    const fn formerly(mut self, key: &'static str) -> Self {
        self.formerly = Some(key);
        self
    }
}

/// Degrees to radians, milliseconds to microseconds.
const DEGREE: f64 = std::f64::consts::PI / 180.0;
const MILLISECOND: f64 = 1e3;

impl Field {
    /// The keys of the table or tables that it holds.
    pub fn inner(&self) -> impl Iterator<Item = &'static Field> + use<> {
        let parts: &[&[Field]] = match self.kind {
            Kind::Table(parts) | Kind::Tables(parts) => parts,
            _ => &[],
        };
        parts.iter().flat_map(|part| part.iter())
    }

    /// The range of a number in the file's unit, with what the robot's object allows; `None` for a
    /// value that is not a number.
    #[must_use]
    pub fn range(&self) -> Option<Range> {
        let own = match self.kind {
            Kind::Number(range) => range,
            Kind::Whole(min, max) => to(min as f64, max as f64),
            _ => return None,
        };
        let Some(object) = self.object else {
            return Some(own);
        };
        let entry = protocol::entry(object.address)?;
        let (min, max) = (real(entry.min())?, real(entry.max())?);
        let (min, max) = (min / object.factor, max / object.factor);
        Some(Range {
            // 0 to the robot is "my own value", which a file says by leaving the key out.
            min: own.min.max(min),
            above_min: own.above_min && own.min >= min,
            max: own.max.min(max),
        })
    }
}

/// A value of a robot as a number.
pub(crate) fn real(value: protocol::Value) -> Option<f64> {
    use protocol::Value;
    Some(match value {
        Value::U8(v) => f64::from(v),
        Value::U16(v) => f64::from(v),
        Value::U32(v) => f64::from(v),
        Value::I16(v) => f64::from(v),
        Value::I24(v) => f64::from(v),
        // The shortest decimal that a robot reads as this: 0.1, not 0.10000000149.
        Value::F32(v) => v.to_string().parse().ok()?,
        Value::Domain => return None,
    })
}
