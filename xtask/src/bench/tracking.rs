//! The tracking errors of native robots on both plants, with and without compensation and roller
//! phase.

use group::GroupFile;
use omnibus::abort::Abort;
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::report::Run;
use omnibus::run::Drive;
use omnibus::simulation::contact;
use omnibus::simulation::run::simulated;

use super::figure::Figure;

/// Rollers of a wheel on the contact plant.
const ROLLERS: u8 = 8;

fn drive(group: &GroupFile, curve: Curve, compensation: bool) -> anyhow::Result<Run> {
    let drive = Drive {
        group,
        course: Course::of(curve),
        feedback: None,
        compensation,
        elf: None,
        candump: None,
        log: None,
        abort: Abort::default(),
        record: None,
        index_search: Some(&|_| {}),
    };
    Ok(simulated(&drive, &mut |_, _| {})?)
}

/// Tracking error on the figure-eight on each plant; on the contact plant mean error and ripple
/// sideways and heading error in oblique motion as well.
pub fn figures(group: &GroupFile) -> anyhow::Result<Vec<Figure>> {
    let none = Abort::default();
    let plain = contact::on_contact(group, ROLLERS);
    let constant = contact::calibrated(&plain, &none)?;
    let phase = contact::calibrated(&contact::with_phases(&plain), &none)?;
    let mut figures = Vec::new();
    for (plant, group, compensation, word) in [
        ("table", group, false, "off"),
        ("table", group, true, "on"),
        ("contact", &constant, false, "off"),
        ("contact", &constant, true, "on"),
        ("contact", &phase, false, "phase"),
        ("contact", &phase, true, "phase_on"),
    ] {
        let name = |what: &str| format!("{what}.{plant}.{word}");
        let rms = drive(group, Curve::FigureEight, compensation)?
            .errors
            .rms_mm;
        figures.push(Figure::new(name("tracking"), rms, "mm"));
        if plant == "table" {
            continue;
        }
        let aside = drive(group, Curve::Lateral, compensation)?;
        let oblique = drive(group, Curve::Oblique, compensation)?;
        let figure = |what, value: f64, unit, bound| {
            let figure = Figure::new(name(what), value, unit);
            // What the project asks of roller phase with compensation.
            if word == "phase_on" {
                figure.budget(bound)
            } else {
                figure
            }
        };
        figures.extend([
            figure("lateral_error", aside.errors.x_percent.abs(), "%", 0.15),
            figure("ripple", aside.evenness.ripple_percent, "%", 0.6),
            figure(
                "heading_error",
                oblique.evenness.heading_error_deg.abs(),
                "deg",
                0.1,
            ),
        ]);
    }
    Ok(figures)
}
