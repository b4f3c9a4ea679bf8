//! The compensation set: tables over speed and direction as one object, 0x2013:1.
//!
//! One set is one value of type DOMAIN, so SDO transfers it whole or not at all. Its CRC shows that
//! it is whole, and its writer chooses a version (for example a date such as 20261121).
//!
//! # Layout
//!
//! All numbers are little-endian.
//!
//! | bytes | |
//! |---|---|
//! | 4 | CRC-32 (IEEE 802.3) of all that follows |
//! | 4 | version |
//! | 1 | format, 1 |
//! | 4 | rows of the longitudinal, lateral, oblique and yaw table, 0 to 8 each |
//! | 4 a row | longitudinal, lateral: speed, coefficient |
//! | 6 a row | oblique: speed, longitudinal coefficient, lateral coefficient |
//! | 4 a row | yaw: rate, coefficient |
//!
//! # Values
//!
//! A speed is an UNSIGNED16 in 0.1 mm/s or 0.1 mrad/s, the achieved one, rising from row to row and
//! above zero. A coefficient is an UNSIGNED16 in 1/32768, commanded over achieved velocity, at
//! least 0.5; 0 is refused like everything below that. An axis without rows has the constant of
//! 0x2012. With oblique rows, longitudinal and lateral go by the speed of the whole motion and the
//! coefficient at 45 degrees stands between them; without, each axis goes by its own speed.

use crate::crc::{crc32, crc32_of};

/// The most rows of one table.
pub const ROWS: usize = 8;

/// Bytes before the rows.
const HEADER: usize = 13;

/// Bytes the CRC takes.
const CRC: usize = 4;

/// The longest set, bytes.
pub const LENGTH_MAX: usize = HEADER + ROWS * (3 * 4 + 6);

const FORMAT: u8 = 1;

/// Steps of a speed in one m/s or rad/s.
pub const SPEED_STEPS: f32 = 10_000.0;

/// Steps of a coefficient in 1.
pub const COEFFICIENT_STEPS: f32 = 32_768.0;

/// The smallest coefficient, in its steps: 0.5.
const COEFFICIENT_MIN: u16 = 16_384;

/// The set of a robot that has none: no rows, version 0.
pub const EMPTY: [u8; HEADER] = {
    let content = [0, 0, 0, 0, FORMAT, 0, 0, 0, 0];
    let [a, b, c, d] = crc32_of(&content).to_le_bytes();
    [a, b, c, d, 0, 0, 0, 0, FORMAT, 0, 0, 0, 0]
};

/// What is wrong with a set.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SetError {
    /// Shorter than its header or its rows.
    TooShort,
    /// Longer than its rows, or than any set may be.
    TooLong,
    /// The CRC does not fit the content.
    Crc,
    /// A format this program does not know.
    Format,
    /// More than eight rows in a table.
    TooManyRows,
    /// A speed that is zero, or not larger than the one before.
    Speed,
    /// A coefficient below 0.5.
    CoefficientTooLow,
    /// A coefficient of 2 or more, or a speed of 6.5 m/s or rad/s or more.
    OutOfRange,
}

impl core::fmt::Display for SetError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::TooShort => "the set is shorter than its rows",
            Self::TooLong => "the set is longer than its rows",
            Self::Crc => "the CRC does not fit the set",
            Self::Format => "the set has a format this program does not know",
            Self::TooManyRows => "a table has more than 8 rows",
            Self::Speed => "speeds must be above zero and rise from row to row",
            Self::CoefficientTooLow => "a coefficient is below 0.5 (1 is no compensation)",
            Self::OutOfRange => "a coefficient is 2 or more, or a speed 6.5 or more",
        })
    }
}

impl core::error::Error for SetError {}

/// A row of a table over one axis.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Row {
    /// Achieved speed, m/s or rad/s.
    pub speed: f32,
    /// Coefficient there.
    pub coefficient: f32,
}

impl Row {
    /// A row.
    #[must_use]
    pub const fn new(speed: f32, coefficient: f32) -> Self {
        Self { speed, coefficient }
    }

    /// As [`kinematics::AxisTable`] takes it.
    #[must_use]
    pub const fn pair(self) -> (f32, f32) {
        (self.speed, self.coefficient)
    }
}

/// A row of the table at 45 degrees.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ObliqueRow {
    /// Achieved speed, m/s.
    pub speed: f32,
    /// Longitudinal coefficient there.
    pub longitudinal: f32,
    /// Lateral coefficient there.
    pub lateral: f32,
}

impl ObliqueRow {
    /// Its longitudinal part.
    #[must_use]
    pub const fn along(self) -> Row {
        Row::new(self.speed, self.longitudinal)
    }

    /// Its lateral part.
    #[must_use]
    pub const fn across(self) -> Row {
        Row::new(self.speed, self.lateral)
    }
}

/// A set in its bytes, checked.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CompensationSet<'a> {
    /// Chosen by the writer.
    pub version: u32,
    /// CRC of the set.
    pub crc: u32,
    longitudinal: &'a [[u8; 4]],
    lateral: &'a [[u8; 4]],
    oblique: &'a [[u8; 6]],
    yaw: &'a [[u8; 4]],
}

impl<'a> CompensationSet<'a> {
    /// Reads and checks a set.
    ///
    /// # Errors
    /// The first thing that is wrong with it.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, SetError> {
        let (header, rest) = bytes
            .split_first_chunk::<HEADER>()
            .ok_or(SetError::TooShort)?;
        let [a, b, c, d, e, f, g, h, format, rows @ ..] = *header;
        if bytes.len() > LENGTH_MAX {
            return Err(SetError::TooLong);
        }
        let crc = u32::from_le_bytes([a, b, c, d]);
        let content = bytes.iter().skip(CRC).copied();
        if crc != crc32(content) {
            return Err(SetError::Crc);
        }
        if format != FORMAT {
            return Err(SetError::Format);
        }
        if rows.iter().any(|rows| usize::from(*rows) > ROWS) {
            return Err(SetError::TooManyRows);
        }
        let [longitudinal, lateral, oblique, yaw] = rows.map(usize::from);
        let (longitudinal, rest) = split(rest, longitudinal)?;
        let (lateral, rest) = split(rest, lateral)?;
        let (oblique, rest) = split(rest, oblique)?;
        let (yaw, rest) = split(rest, yaw)?;
        if !rest.is_empty() {
            return Err(SetError::TooLong);
        }
        let set = Self {
            version: u32::from_le_bytes([e, f, g, h]),
            crc,
            longitudinal,
            lateral,
            oblique,
            yaw,
        };
        for table in [longitudinal, lateral, yaw] {
            check(table.iter().map(|[a, b, c, d]| ([*a, *b], [*c, *d])))?;
        }
        check(oblique.iter().map(|[a, b, c, d, ..]| ([*a, *b], [*c, *d])))?;
        check(
            oblique
                .iter()
                .map(|[a, b, _, _, e, f]| ([*a, *b], [*e, *f])),
        )?;
        Ok(set)
    }

    /// Rows of the longitudinal table: speed in m/s, coefficient.
    pub fn longitudinal(&self) -> impl Iterator<Item = Row> + use<'a> {
        plain(self.longitudinal)
    }

    /// Rows of the lateral table.
    pub fn lateral(&self) -> impl Iterator<Item = Row> + use<'a> {
        plain(self.lateral)
    }

    /// Rows at 45 degrees: speed in m/s, longitudinal and lateral coefficient.
    pub fn oblique(&self) -> impl Iterator<Item = ObliqueRow> + use<'a> {
        self.oblique.iter().map(|[a, b, c, d, e, f]| ObliqueRow {
            speed: speed([*a, *b]),
            longitudinal: coefficient([*c, *d]),
            lateral: coefficient([*e, *f]),
        })
    }

    /// Rows of the yaw table: rad/s, coefficient.
    pub fn yaw(&self) -> impl Iterator<Item = Row> + use<'a> {
        plain(self.yaw)
    }

    /// Whether it has no rows at all.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.longitudinal.is_empty()
            && self.lateral.is_empty()
            && self.oblique.is_empty()
            && self.yaw.is_empty()
    }
}

/// Tables to be made a set of.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Tables<'a> {
    /// Chosen by the writer.
    pub version: u32,
    /// Achieved speed in m/s, coefficient.
    pub longitudinal: &'a [Row],
    /// Achieved speed in m/s, coefficient.
    pub lateral: &'a [Row],
    /// Achieved speed in m/s, longitudinal and lateral coefficient at 45 degrees.
    pub oblique: &'a [ObliqueRow],
    /// Achieved rate in rad/s, coefficient.
    pub yaw: &'a [Row],
}

impl Tables<'_> {
    /// Writes the set and returns its length.
    ///
    /// # Errors
    /// [`SetError`] when it is none.
    pub fn encode(&self, out: &mut [u8; LENGTH_MAX]) -> Result<usize, SetError> {
        let rows = [
            self.longitudinal.len(),
            self.lateral.len(),
            self.oblique.len(),
            self.yaw.len(),
        ];
        let mut length = CRC;
        let mut put = |bytes: &[u8]| {
            if let Some(to) = out.get_mut(length..length + bytes.len()) {
                to.copy_from_slice(bytes);
                length += bytes.len();
            }
        };
        put(&self.version.to_le_bytes());
        put(&[FORMAT]);
        for rows in rows {
            let rows = u8::try_from(rows).ok().filter(|n| usize::from(*n) <= ROWS);
            put(&[rows.ok_or(SetError::TooManyRows)?]);
        }
        for table in [self.longitudinal, self.lateral] {
            for row in table {
                put(&steps(row.speed, SPEED_STEPS)?);
                put(&steps(row.coefficient, COEFFICIENT_STEPS)?);
            }
        }
        for row in self.oblique {
            put(&steps(row.speed, SPEED_STEPS)?);
            put(&steps(row.longitudinal, COEFFICIENT_STEPS)?);
            put(&steps(row.lateral, COEFFICIENT_STEPS)?);
        }
        for row in self.yaw {
            put(&steps(row.speed, SPEED_STEPS)?);
            put(&steps(row.coefficient, COEFFICIENT_STEPS)?);
        }
        let crc = crc32(out.iter().take(length).skip(CRC).copied());
        if let Some(to) = out.first_chunk_mut() {
            *to = crc.to_le_bytes();
        }
        CompensationSet::decode(out.get(..length).unwrap_or(&[]))?;
        Ok(length)
    }
}

/// The first `rows` rows of the rest.
fn split<const N: usize>(rest: &[u8], rows: usize) -> Result<(&[[u8; N]], &[u8]), SetError> {
    let (table, rest) = rest.split_at_checked(rows * N).ok_or(SetError::TooShort)?;
    Ok((table.as_chunks().0, rest))
}

fn check(rows: impl Iterator<Item = ([u8; 2], [u8; 2])>) -> Result<(), SetError> {
    let mut before = 0;
    for (speed, coefficient) in rows {
        let speed = u16::from_le_bytes(speed);
        if speed <= before {
            return Err(SetError::Speed);
        }
        before = speed;
        if u16::from_le_bytes(coefficient) < COEFFICIENT_MIN {
            return Err(SetError::CoefficientTooLow);
        }
    }
    Ok(())
}

fn plain(table: &[[u8; 4]]) -> impl Iterator<Item = Row> + use<'_> {
    table
        .iter()
        .map(|[a, b, c, d]| Row::new(speed([*a, *b]), coefficient([*c, *d])))
}

fn speed(bytes: [u8; 2]) -> f32 {
    f32::from(u16::from_le_bytes(bytes)) / SPEED_STEPS
}

fn coefficient(bytes: [u8; 2]) -> f32 {
    f32::from(u16::from_le_bytes(bytes)) / COEFFICIENT_STEPS
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "within the range of the type"
)]
fn steps(value: f32, steps: f32) -> Result<[u8; 2], SetError> {
    let scaled = value * steps + 0.5;
    if scaled.is_nan() || scaled >= 65_536.0 {
        return Err(SetError::OutOfRange);
    }
    // Negative ones become 0, which is refused as too low.
    Ok((scaled as u16).to_le_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const TABLES: Tables<'_> = Tables {
        version: 20_261_121,
        longitudinal: &[Row::new(0.1, 1.022), Row::new(0.5, 1.027)],
        lateral: &[
            Row::new(0.1, 1.141),
            Row::new(0.3, 1.151),
            Row::new(0.5, 1.157),
        ],
        oblique: &[oblique(0.3, 1.017, 1.0175)],
        yaw: &[],
    };

    const fn oblique(speed: f32, longitudinal: f32, lateral: f32) -> ObliqueRow {
        ObliqueRow {
            speed,
            longitudinal,
            lateral,
        }
    }

    fn encoded(tables: &Tables<'_>) -> Vec<u8> {
        let mut out = [0; LENGTH_MAX];
        let length = tables.encode(&mut out).unwrap();
        out[..length].to_vec()
    }

    /// `bytes` with a CRC that fits.
    fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
        let crc = crc32(bytes.iter().skip(4).copied());
        bytes[..4].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    #[test]
    fn what_is_written_is_read() {
        let bytes = encoded(&TABLES);
        assert_eq!(bytes.len(), 13 + 5 * 4 + 6);
        let set = CompensationSet::decode(&bytes).unwrap();
        assert_eq!(set.version, 20_261_121);
        // Half a step of a speed and of a coefficient.
        let near = |found: Row, want: Row| {
            (found.speed - want.speed).abs() <= 0.5e-4
                && (found.coefficient - want.coefficient).abs() <= 0.5 / 32_768.0
        };
        for (found, want) in set.longitudinal().zip(TABLES.longitudinal) {
            assert!(near(found, *want), "{found:?}");
        }
        assert_eq!(set.lateral().count(), 3);
        let row = set.oblique().next().unwrap();
        assert!(near(row.along(), Row::new(0.3, 1.017)));
        assert!(near(row.across(), Row::new(0.3, 1.0175)));
        assert_eq!(set.yaw().count(), 0);
        assert!(!set.is_empty());
    }

    #[test]
    fn golden_bytes() {
        let bytes = encoded(&Tables {
            version: 0x0403_0201,
            yaw: &[Row::new(0.5, 1.0)],
            ..Tables::default()
        });
        // 0.5 rad/s are 5000 steps, 1 is 0x8000. The CRC was worked out with Python's zlib.crc32.
        assert_eq!(
            bytes[4..],
            [1, 2, 3, 4, 1, 0, 0, 0, 1, 0x88, 0x13, 0x00, 0x80]
        );
        assert_eq!(bytes[..4], 0x5FFE_FACD_u32.to_le_bytes());
    }

    #[test]
    fn the_empty_set_is_a_set() {
        let set = CompensationSet::decode(&EMPTY).unwrap();
        assert!(set.is_empty());
        assert_eq!(set.version, 0);
        assert_eq!(encoded(&Tables::default()), EMPTY);
    }

    #[test]
    fn any_flipped_bit_is_found() {
        let bytes = encoded(&TABLES);
        for bit in 0..bytes.len() * 8 {
            let mut harmed = bytes.clone();
            harmed[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(
                CompensationSet::decode(&harmed),
                Err(SetError::Crc),
                "{bit}"
            );
        }
    }

    #[test]
    fn bad_sets_are_refused_for_what_is_wrong() {
        let good = encoded(&TABLES);
        let with = |at: usize, value: u8| {
            let mut bytes = good.clone();
            bytes[at] = value;
            sealed(bytes)
        };
        let refused = |bytes: &[u8]| CompensationSet::decode(bytes).unwrap_err();
        assert_eq!(refused(&[]), SetError::TooShort);
        assert_eq!(refused(&good[..12]), SetError::TooShort);
        assert_eq!(
            refused(&sealed(good[..good.len() - 1].to_vec())),
            SetError::TooShort
        );
        let mut long = good.clone();
        long.push(0);
        assert_eq!(refused(&sealed(long)), SetError::TooLong);
        assert_eq!(
            refused(&sealed([0; LENGTH_MAX + 1].to_vec())),
            SetError::TooLong
        );
        assert_eq!(refused(&with(8, 2)), SetError::Format);
        assert_eq!(refused(&with(9, 9)), SetError::TooManyRows);
        // The second longitudinal speed becomes that of the first.
        let mut same = good.clone();
        same.copy_within(13..15, 17);
        assert_eq!(refused(&sealed(same)), SetError::Speed);
        let mut zero = good.clone();
        zero[15..17].fill(0);
        assert_eq!(refused(&sealed(zero)), SetError::CoefficientTooLow);
    }

    #[test]
    fn tables_that_make_no_set_are_refused() {
        let refused = |lateral: &[Row]| {
            let tables = Tables {
                lateral,
                ..Tables::default()
            };
            tables.encode(&mut [0; LENGTH_MAX]).unwrap_err()
        };
        assert_eq!(refused(&[Row::new(0.1, 0.0)]), SetError::CoefficientTooLow);
        assert_eq!(refused(&[Row::new(0.1, -1.0)]), SetError::CoefficientTooLow);
        assert_eq!(refused(&[Row::new(0.1, 2.0)]), SetError::OutOfRange);
        assert_eq!(refused(&[Row::new(0.1, f32::NAN)]), SetError::OutOfRange);
        assert_eq!(refused(&[Row::new(7.0, 1.0)]), SetError::OutOfRange);
        assert_eq!(refused(&[Row::new(0.0, 1.0)]), SetError::Speed);
        assert_eq!(
            refused(&[Row::new(0.2, 1.0), Row::new(0.2, 1.1)]),
            SetError::Speed
        );
        assert_eq!(refused(&[Row::new(0.1, 1.0); 9]), SetError::TooManyRows);
    }

    #[test]
    fn the_longest_set_has_the_stated_length() {
        let row = |i: u8| Row::new(f32::from(i + 1) * 0.1, 1.1);
        let rows: Vec<Row> = (0..8).map(row).collect();
        let oblique = |row: &Row| oblique(row.speed, row.coefficient, row.coefficient);
        let oblique: Vec<ObliqueRow> = rows.iter().map(oblique).collect();
        let bytes = encoded(&Tables {
            version: u32::MAX,
            longitudinal: &rows,
            lateral: &rows,
            oblique: &oblique,
            yaw: &rows,
        });
        assert_eq!(bytes.len(), LENGTH_MAX);
    }
}
