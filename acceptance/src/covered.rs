//! For every figure of docs/performance.md that has a ceiling: the check that measures it on
//! hardware, or why none does. `master/src/accept/faults/cases.rs` has the same list for the causes
//! of docs/safety.md.

/// What is done about a figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Covered {
    /// A check with this name.
    By(&'static str),
    /// None, for this reason.
    Not(&'static str),
}

use Covered::{By, Not};

const COUNTED: &str = "instructions are a property of the image, counted in the emulator";
const LINKED: &str = "the linker measures it, whatever board there is";
const WHEN_DRIVING: &str = "a bare board cannot drive, and a group has no wire to its outputs";
const CABLE: &str = "the cable is what the check would be made through";

/// The figures by how their names begin; the first that fits counts.
pub const FIGURES: &[(&str, Covered)] = &[
    ("inverse", Not(COUNTED)),
    ("forward", Not(COUNTED)),
    ("secants", Not(COUNTED)),
    ("wheel_loop", Not(COUNTED)),
    ("compensation", Not(COUNTED)),
    ("sincos", Not(COUNTED)),
    ("tick.mean", Not(COUNTED)),
    ("tick_", Not(COUNTED)),
    ("load", By("load.driving")),
    ("tick.jitter", Not(WHEN_DRIVING)),
    (
        "tick.rate",
        Not("it needs images of its own that tick faster"),
    ),
    ("memory.stack.high_water", By("stack.high_water")),
    ("memory.", Not(LINKED)),
    ("ready", By("start.first_frame")),
    ("sync_to_pwm", Not(WHEN_DRIVING)),
    ("call_to_pwm", Not(WHEN_DRIVING)),
    ("8_robots.sync_to_pwm", Not(WHEN_DRIVING)),
    ("gateway.", Not(CABLE)),
    (
        "update.",
        Not("no report updates a robot; `omnibus update` shows how long it takes"),
    ),
    (
        "bus.",
        Not("it is the length of frames, which no board changes"),
    ),
    ("f103.", Not("no self-test image is for its board")),
    ("accuracy.", Not("it is arithmetic, the same on every core")),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::promise::PERFORMANCE;

    /// Figures of the page with a ceiling: name, value, unit, budget, ceiling.
    fn with_a_ceiling() -> Vec<&'static str> {
        let rows = PERFORMANCE.text.lines().filter_map(|line| {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            let name = cells.get(1)?.strip_prefix('`')?.strip_suffix('`')?;
            let ceiling: &str = cells.get(5)?;
            ceiling.parse::<f64>().ok().map(|_| name)
        });
        rows.collect()
    }

    #[test]
    fn every_figure_with_a_ceiling_has_a_check_or_a_reason() {
        let figures = with_a_ceiling();
        assert!(figures.len() > 20, "{figures:?}");
        let mut used = vec![false; FIGURES.len()];
        for figure in figures {
            let place = FIGURES.iter().position(|row| figure.starts_with(row.0));
            used[place.unwrap_or_else(|| panic!("{figure} has neither"))] = true;
        }
        for (row, used) in FIGURES.iter().zip(used) {
            // Some kernels have no ceiling today.
            let kernel = row.1 == Not(COUNTED);
            assert!(used || kernel, "{} fits no figure of the page", row.0);
        }
    }

    #[test]
    fn the_checks_are_made() {
        let emulated = include_str!("../emulated/level-1.json");
        for (figure, covered) in FIGURES {
            if let By(check) = covered {
                let name = format!("\"name\": \"{check}\"");
                assert!(emulated.contains(&name), "{figure}: no check {check}");
            }
        }
    }
}
