//! Level 3: curves on the floor, before and after calibration, beside the simulator's prediction.
//!
//! The caller drives ([`Floor::drive`]) and measures, by poses or with a tape; this chooses the
//! curves and compares. *Before* is a drive without compensation, *after* one with what the group
//! file says. The prediction is the same drive with native robots on the floor that the group file
//! describes; where a build has no simulator there is none.

use acceptance::promise::{self, ACCEPTANCE};
use acceptance::{Bound, Check};

use super::{AcceptError, Step, not_tried};
use crate::path::curve::Curve;
use crate::report::figures::percent;
use crate::run::DriveError;

/// The curves, with what is measured of each.
pub const CURVES: [(Curve, &str, &[Figure]); 4] = [
    (Curve::Forward, "straight", &[Figure::Ahead]),
    (Curve::Lateral, "strafe", &[Figure::Aside]),
    (Curve::Turn, "turn", &[Figure::Turned]),
    (
        Curve::FigureEight,
        "figure_eight",
        &[Figure::Ahead, Figure::Aside],
    ),
];

/// What is measured of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Figure {
    /// Relative error of the way ahead.
    Ahead,
    /// Relative error of the way aside.
    Aside,
    /// Relative error of the turned angle.
    Turned,
}

impl Figure {
    /// Its name in checks.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ahead => "ahead",
            Self::Aside => "aside",
            Self::Turned => "turned",
        }
    }
}

/// What a drive came to, per cent of what was asked; none where it was not measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// Way ahead.
    pub ahead: Option<f64>,
    /// Way aside.
    pub aside: Option<f64>,
    /// Turned angle.
    pub turned: Option<f64>,
}

impl Errors {
    /// Those of a drive that was seen from outside.
    #[must_use]
    pub fn of(run: &crate::report::Run) -> Self {
        Self {
            ahead: Some(run.errors.y_percent),
            aside: Some(run.errors.x_percent),
            turned: Some(run.evenness.turn_percent),
        }
    }

    fn figure(&self, figure: Figure) -> Option<f64> {
        match figure {
            Figure::Ahead => self.ahead,
            Figure::Aside => self.aside,
            Figure::Turned => self.turned,
        }
    }
}

/// Who drives and measures, and who predicts.
pub trait Floor {
    /// Drives a curve with or without compensation and measures.
    ///
    /// # Errors
    /// When the drive fails; the group stands then.
    fn drive(&mut self, curve: Curve, compensation: bool) -> Result<Errors, DriveError>;

    /// What the simulator says of the same drive; `None` where there is none.
    ///
    /// # Errors
    /// When it fails.
    fn predict(&mut self, curve: Curve, compensation: bool) -> Result<Option<Errors>, DriveError>;
}

/// The name of a check.
pub(super) fn name(curve: &str, figure: Figure) -> String {
    format!("floor.{curve}.{}", figure.name())
}

/// Level 3.
///
/// # Errors
/// When a drive fails.
pub fn level_three(
    floor: &mut dyn Floor,
    skip: &[String],
    show: &mut dyn FnMut(Step<'_>),
) -> Result<Vec<Check>, AcceptError> {
    let promise = promise::number(ACCEPTANCE, "turned angle are within", "% of what was asked")?;
    let mut checks = Vec::new();
    for (curve, name, figures) in CURVES {
        let names: Vec<_> = figures
            .iter()
            .map(|figure| (*figure, self::name(name, *figure)))
            .collect();
        let bound = Bound::Near(0.0, promise.value);
        let left_out = |wanted: &str| skip.iter().any(|skip| wanted.starts_with(skip.as_str()));
        if names.iter().all(|(_, name)| left_out(name)) {
            for (_, name) in names {
                let reason = "left out by --skip".to_owned();
                let source = promise.source.clone();
                checks.push(not_tried(name, bound, "%", source, reason));
            }
            continue;
        }
        let mut both = [(Errors::default(), None); 2];
        for (result, compensation) in both.iter_mut().zip([false, true]) {
            let how = if compensation { "with" } else { "without" };
            show(Step::Begins(&format!("{name}, {how} compensation")));
            let predicted = floor.predict(curve, compensation)?;
            *result = (floor.drive(curve, compensation)?, predicted);
        }
        for (figure, name) in names {
            checks.push(check(name, figure, bound, &promise.source, &both));
        }
        show(Step::Found(&checks));
    }
    // What was left out last as well.
    show(Step::Found(&checks));
    Ok(checks)
}

/// One figure of one curve.
fn check(
    name: String,
    figure: Figure,
    bound: Bound,
    source: &str,
    [before, after]: &[(Errors, Option<Errors>); 2],
) -> Check {
    let predicted = |of: &Option<Errors>| of.as_ref().and_then(|errors| errors.figure(figure));
    let Some(measured) = after.0.figure(figure) else {
        let reason = "it was not measured".to_owned();
        return not_tried(name, bound, "%", source.to_owned(), reason);
    };
    let text = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), percent);
    Check {
        name,
        promised: bound,
        measured: Some(measured),
        unit: "%",
        tried: true,
        expected: predicted(&after.1),
        source: source.to_owned(),
        procedure: "error with the compensation of the group file",
        note: format!(
            "without compensation {}, predicted {}; with it predicted {}",
            text(before.0.figure(figure)),
            text(predicted(&before.1)),
            text(predicted(&after.1))
        ),
    }
}
