//! The table of causes in `docs/safety.md`, read so that its values exist only once.

use anyhow::{Context as _, ensure};
use protocol::Fault;

use crate::promise::{self, SAFETY};

/// One row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Promise {
    /// Number of the cause.
    pub number: u8,
    /// The cause in words.
    pub cause: String,
    /// What the robot announces.
    pub fault: Fault,
    /// The reaction in words.
    pub reaction: String,
    /// Longest time to the beginning of the reaction, ms; not every row promises one.
    pub millis: Option<f64>,
    /// The same where smart drives turn the wheels, if that is another time, ms.
    pub smart_millis: Option<f64>,
    /// The same on a kit with an STM32F103, if that is another time, ms.
    pub kit_millis: Option<f64>,
    /// Largest ratio of the rate of any wheel after the cause to what was asked before it.
    pub wheel_rate: Option<f64>,
    /// Longest way of the body from the cause to rest, m.
    pub way: Option<f64>,
}

impl Promise {
    /// Longest time to the beginning of the reaction with or without smart drives, ms.
    #[must_use]
    pub fn millis_with(&self, smart_drives: bool) -> Option<f64> {
        let other = self.smart_millis.filter(|_| smart_drives);
        other.or(self.millis)
    }
}

/// What is promised of a reversed encoder where its wheel is slow already.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slow {
    /// Slower than this, rad/s.
    pub below: f64,
    /// It is off within this, ms,
    pub millis: f64,
    /// and never turns faster than this times the rate that it had.
    pub factor: f64,
}

/// Reads that from the line of a page that says `below N rad/s`.
///
/// # Errors
/// When no line says that.
pub fn slow(page: &str) -> anyhow::Result<Slow> {
    let found = page.lines().find_map(|line| {
        let mut cells = line.split('|').map(str::trim).skip(1);
        let below = cells.next()?.strip_prefix("below ")?;
        let (below, _) = below.split_once(" rad/s")?;
        let millis = cells.next()?.strip_suffix(" ms")?;
        Some(Slow {
            below: below.parse().ok()?,
            millis: millis.parse().ok()?,
            factor: cells.next()?.parse().ok()?,
        })
    });
    found.context("docs/safety.md does not say what is promised for a slow wheel")
}

/// The promises on a page, by number.
///
/// # Errors
/// When the page has no such table, or a row cannot be read.
pub fn read(page: &str) -> anyhow::Result<Vec<Promise>> {
    let cells = |line| str::split(line, '|').map(str::trim).collect::<Vec<_>>();
    let headed = |title: &str| {
        let places = page.lines().filter_map(|line| {
            let mut titles = cells(line).into_iter();
            titles.position(|cell| cell == title)
        });
        places.min()
    };
    let more = (headed("wheel rate at most"), headed("way at most"));
    let rows: Vec<Promise> = page
        .lines()
        .filter_map(|line| {
            let cells = cells(line);
            let number = cells.get(1)?.parse().ok()?;
            let row = row(number, &cells, more);
            Some(row.with_context(|| format!("row {number} of docs/safety.md")))
        })
        .collect::<anyhow::Result<_>>()?;
    ensure!(!rows.is_empty(), "docs/safety.md has no table of causes");
    Ok(rows)
}

/// A row; `more` says in which cells the wheel rate and the way are, where the table has them.
fn row(
    number: u8,
    cells: &[&str],
    more: (Option<usize>, Option<usize>),
) -> anyhow::Result<Promise> {
    let cell = |n: usize| {
        cells
            .get(n)
            .copied()
            .context("a row of the table lacks a cell")
    };
    let code = cell(3)?;
    let (digits, name) = code.split_once(' ').context("a row has no code and name")?;
    let value = u16::from_str_radix(digits.trim_start_matches("0x"), 16)?;
    let fault =
        Fault::from_code(value).context("a row has a code that the protocol does not have")?;
    ensure!(fault.name() == name, "{value:#06x} is {}", fault.name());
    let (mut millis, mut smart_millis, mut kit_millis) = (None, None, None);
    for time in cell(5)?.split("; ") {
        if let Some(number) = time.strip_suffix(" ms with smart drives") {
            smart_millis = Some(number.parse()?);
        } else if let Some(number) = time.strip_suffix(" ms on a kit") {
            kit_millis = Some(number.parse()?);
        } else if let Some(number) = time.strip_suffix(" ms") {
            millis = Some(number.parse()?);
        }
    }
    let with_unit = |place: Option<usize>, unit: &str| -> anyhow::Result<Option<f64>> {
        let text = place.map_or(Ok(""), cell)?;
        let number = text.strip_suffix(unit).filter(|number| !number.is_empty());
        let number = number.map(str::parse).transpose();
        number.with_context(|| format!("{text} is not a number of{unit}"))
    };
    let (wheel_rate, way) = (with_unit(more.0, "")?, with_unit(more.1, " m")?);
    Ok(Promise {
        wheel_rate,
        way,
        number,
        cause: cell(2)?.to_owned(),
        fault,
        reaction: cell(4)?.to_owned(),
        millis,
        smart_millis,
        kit_millis,
    })
}

/// The promise of one cause in `docs/safety.md`.
///
/// # Errors
/// As [`read`], and when the table has no such row.
pub fn of(number: u8) -> anyhow::Result<Promise> {
    let all = read(SAFETY.text)?;
    let found = all.into_iter().find(|promise| promise.number == number);
    found.with_context(|| format!("docs/safety.md has no cause {number}"))
}

/// The time of a cause in the table of docs/safety.md, ms.
///
/// # Errors
/// When the table has no such row or no time in it.
pub fn time(number: u8) -> anyhow::Result<promise::Promise> {
    let row = of(number)?;
    let millis = row.millis;
    let millis =
        millis.with_context(|| format!("cause {number} of {} has no time", SAFETY.path))?;
    Ok(promise::Promise {
        value: millis,
        source: format!("{}: cause {number}, {}", SAFETY.path, row.cause),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_of_the_protocol_has_its_row() {
        let promises = read(include_str!("../../docs/safety.md")).unwrap();
        let faults: Vec<Fault> = promises.iter().map(|promise| promise.fault).collect();
        for fault in Fault::ALL {
            assert!(faults.contains(fault), "{}", fault.name());
        }
        let stop = promises.iter().find(|p| p.number == 15).unwrap();
        assert_eq!((stop.fault, stop.millis), (Fault::EmergencyStop, Some(1.0)));
    }

    #[test]
    fn smart_drives_and_a_kit_may_have_times_of_their_own() {
        let times = |text: &str| {
            let row = format!("| 20 | - | 0xFF14 WatchdogReset | - | {text} | |");
            let promise = &read(&row).unwrap()[0];
            [false, true].map(|smart| promise.millis_with(smart))
        };
        assert_eq!(times("94 ms"), [Some(94.0); 2]);
        assert_eq!(times("2 ms with smart drives"), [None, Some(2.0)]);
        let kit =
            &read("| 20 | - | 0xFF14 WatchdogReset | - | 94 ms; 96 ms on a kit | |").unwrap()[0];
        assert_eq!((kit.millis, kit.kit_millis), (Some(94.0), Some(96.0)));
        let both = times("94 ms; 101 ms with smart drives");
        assert_eq!(both, [Some(94.0), Some(101.0)]);
    }

    #[test]
    fn a_name_that_is_not_its_code_is_refused() {
        assert!(read("| 1 | silence | 0x8130 SyncLost | ramp | 501 ms | |").is_err());
    }

    #[test]
    fn the_emergency_stop_has_its_time() {
        assert_eq!(time(15).unwrap().value, 1.0);
        assert!(time(23).is_err(), "no time is promised");
        assert!(time(250).is_err());
    }
}
