//! A measured figure with its budget and the best public peer's, and its output.

use serde_json::{Value, json};

/// Which way is better.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Better {
    /// Less is better: the budget is a ceiling.
    Lower,
    /// More is better: the budget is a floor.
    Higher,
}

/// One figure.
pub struct Figure {
    /// Stable name.
    pub name: String,
    /// What was measured, in the unit.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// What is aimed at, in the unit, if anything is.
    pub budget: Option<f64>,
    /// Which way is better.
    pub better: Better,
    /// The best public peer's, measured the same way.
    pub peer: Option<(f64, &'static str)>,
    /// What it must not get worse than, in the unit: recorded when it was last better, above the
    /// budget where that is missed.
    pub ceiling: Option<f64>,
}

impl Figure {
    /// A figure of which less is better.
    pub fn new(name: impl Into<String>, value: f64, unit: &'static str) -> Self {
        Self {
            name: name.into(),
            value,
            unit,
            budget: None,
            better: Better::Lower,
            peer: None,
            ceiling: None,
        }
    }

    /// With what is aimed at.
    pub fn budget(self, budget: f64) -> Self {
        Self {
            budget: Some(budget),
            ..self
        }
    }

    /// With the peer's figure.
    pub fn peer(self, value: f64, name: &'static str) -> Self {
        Self {
            peer: Some((value, name)),
            ..self
        }
    }

    /// With what it must not get worse than.
    pub fn ceiling(self, ceiling: f64) -> Self {
        Self {
            ceiling: Some(ceiling),
            ..self
        }
    }

    /// Whether it keeps its budget; `None` without one.
    pub fn keeps_budget(&self) -> Option<bool> {
        self.budget.map(|budget| self.is_within(budget))
    }

    /// What is wrong with it, for `--check`.
    pub fn regression(&self) -> Option<String> {
        let bound = self.ceiling.or(self.budget)?;
        (!self.is_within(bound)).then(|| {
            format!(
                "{} is {:.2} {}, past {bound}",
                self.name, self.value, self.unit
            )
        })
    }

    fn is_within(&self, bound: f64) -> bool {
        match self.better {
            Better::Lower => self.value <= bound,
            Better::Higher => self.value >= bound,
        }
    }

    /// As an object of the JSON file.
    pub fn json(&self) -> Value {
        json!({
            "name": self.name,
            "value": self.value,
            "unit": self.unit,
            "budget": self.budget,
            "better": match self.better {
                Better::Lower => "lower",
                Better::Higher => "higher",
            },
            "peer": self.peer.map(|(value, _)| value),
            "peer_name": self.peer.map(|(_, name)| name),
        })
    }

    /// As a row of the table in the documentation.
    pub fn row(&self) -> String {
        let budget = match (self.budget, self.keeps_budget()) {
            (Some(budget), Some(true)) => format!("{budget}"),
            (Some(budget), _) => format!("{budget}, **missed**"),
            (None, _) => String::new(),
        };
        let ceiling = self.ceiling.map(|ceiling| format!("{ceiling}"));
        let peer = self.peer.map(|(value, name)| format!("{value} ({name})"));
        format!(
            "| `{}` | {} | {} | {budget} | {} | {} |",
            self.name,
            number(self.value),
            self.unit,
            ceiling.unwrap_or_default(),
            peer.unwrap_or_default(),
        )
    }
}

/// Whole numbers as they are, others to four digits or so.
fn number(value: f64) -> String {
    if value == value.round() {
        format!("{value:.0}")
    } else if value.abs() < 1e-3 {
        format!("{value:.2e}")
    } else {
        format!("{value:.2}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_past_its_ceiling_or_its_budget_is_a_regression() {
        let figure = |value| Figure::new("x", value, "instructions");
        assert!(figure(37.0).regression().is_none(), "no bound");
        assert!(figure(36.0).budget(36.0).regression().is_none());
        assert!(figure(37.0).budget(36.0).regression().is_some());
        // A missed budget that is known about: the recorded value counts.
        assert!(
            figure(37.0)
                .budget(36.0)
                .ceiling(40.0)
                .regression()
                .is_none()
        );
        assert!(
            figure(41.0)
                .budget(36.0)
                .ceiling(40.0)
                .regression()
                .is_some()
        );
    }

    #[test]
    fn more_can_be_better() {
        let speed = Figure {
            better: Better::Higher,
            ..Figure::new("x", 2.0, "times real time").budget(3.0)
        };
        assert_eq!(speed.keeps_budget(), Some(false));
    }
}
