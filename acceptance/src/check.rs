//! One figure beside its promise.

use serde_json::{Value, json};

/// What a figure has to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// At most this.
    AtMost(f64),
    /// At least this.
    AtLeast(f64),
    /// This, as closely as the second number says.
    Near(f64, f64),
    /// No figure is promised.
    Open,
}

impl Bound {
    /// Whether a figure is as promised.
    #[must_use]
    pub fn holds(self, measured: f64) -> bool {
        match self {
            Self::AtMost(most) => measured <= most,
            Self::AtLeast(least) => measured >= least,
            Self::Near(value, by) => (measured - value).abs() <= by,
            Self::Open => false,
        }
    }

    /// The promised number.
    #[must_use]
    pub const fn value(self) -> Option<f64> {
        match self {
            Self::AtMost(value) | Self::AtLeast(value) | Self::Near(value, _) => Some(value),
            Self::Open => None,
        }
    }
}

impl std::fmt::Display for Bound {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::AtMost(value) => write!(f, "at most {value}"),
            Self::AtLeast(value) => write!(f, "at least {value}"),
            Self::Near(value, by) if *by == 0.0 => write!(f, "{value}"),
            Self::Near(value, by) => write!(f, "{value} +- {by}"),
            Self::Open => write!(f, "no figure"),
        }
    }
}

/// What became of a promise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The figure is as promised.
    Kept,
    /// It is not, or could not be measured.
    Missed,
    /// It was left out; the note says why.
    NotTried,
}

impl Outcome {
    /// The word in reports.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Kept => "kept",
            Self::Missed => "missed",
            Self::NotTried => "not tried",
        }
    }
}

/// A promise and what became of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// Name, its area first: `pwm.front_left.frequency`.
    pub name: String,
    /// What the figure has to be.
    pub promised: Bound,
    /// What it is; none if it could not be measured.
    pub measured: Option<f64>,
    /// Unit of both.
    pub unit: &'static str,
    /// Whether it was measured at all.
    pub tried: bool,
    /// What the emulator, or the simulator, gives; none where that is not known.
    pub expected: Option<f64>,
    /// Where the promise is made.
    pub source: String,
    /// What was done.
    pub procedure: &'static str,
    /// What to do about it, or what was seen.
    pub note: String,
}

impl Check {
    /// Whether the promise was kept. What could not be measured is not.
    #[must_use]
    pub fn within(&self) -> bool {
        self.measured
            .is_some_and(|measured| self.promised.holds(measured))
    }

    /// What became of it.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        match (self.tried, self.within()) {
            (false, _) => Outcome::NotTried,
            (true, true) => Outcome::Kept,
            (true, false) => Outcome::Missed,
        }
    }

    /// The check as JSON; `within` is null for what was not tried.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "name": self.name,
            "promised": self.promised.value(),
            "bound": self.promised.to_string(),
            "measured": self.measured,
            "unit": self.unit,
            "within": self.tried.then(|| self.within()),
            "outcome": self.outcome().word(),
            "expected": self.expected,
            "source": self.source,
            "procedure": self.procedure,
            "note": self.note,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_measured_is_not_within() {
        let mut check = Check {
            name: "stop.pwm".into(),
            promised: Bound::AtMost(1.0),
            measured: None,
            unit: "ms",
            tried: true,
            expected: None,
            source: String::new(),
            procedure: "",
            note: String::new(),
        };
        assert!(!check.within());
        check.measured = Some(1.0);
        assert!(check.within());
        check.measured = Some(1.01);
        assert!(!check.within());
        assert_eq!(check.json()["within"], false);
        assert_eq!(check.outcome(), Outcome::Missed);
    }

    #[test]
    fn what_was_not_tried_is_neither_kept_nor_missed() {
        let check = Check {
            name: "fault.13".into(),
            promised: Bound::AtMost(300.0),
            measured: None,
            unit: "ms",
            tried: false,
            expected: None,
            source: String::new(),
            procedure: "",
            note: "left out".into(),
        };
        assert_eq!(check.outcome(), Outcome::NotTried);
        assert!(check.json()["within"].is_null());
        assert_eq!(check.json()["outcome"], "not tried");
    }

    #[test]
    fn bounds_hold_at_their_ends() {
        assert!(Bound::Near(20_000.0, 20.0).holds(19_980.0));
        assert!(!Bound::Near(20_000.0, 20.0).holds(19_979.0));
        assert!(Bound::AtLeast(3.0).holds(3.0));
        assert!(!Bound::AtLeast(3.0).holds(2.9));
        assert!(!Bound::AtMost(1.0).holds(f64::NAN));
    }
}
