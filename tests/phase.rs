//! Roller-phase kinematics on the contact plant with random phases: what is asked of the emulated
//! firmware, and the same of native robots.
//!
//! The bounds are those the project set itself before anything was built; every figure is printed.

mod common;

use std::path::PathBuf;

use group::GroupFile;
use omnibus::abort::Abort;
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::report::Run;
use omnibus::run::Drive;
use omnibus::simulation::contact;
use omnibus::simulation::run::simulated;

/// Mean error per axis, per cent.
const MEAN: f64 = 0.15;
/// Standard deviation of the lateral speed, per cent.
const RIPPLE: f64 = 0.6;
/// Heading error after eight seconds of oblique motion, degrees.
const HEADING: f64 = 0.1;
/// Share of the rms tracking error with constant C that phase + C may reach on the figure-eight.
/// Both lead by the lag of the contacts, so that it is not the lag that is compared.
const TRACKING: f64 = 1.0 / 3.0;

/// The groups: constant C, and phase + C, both calibrated on their plant.
fn groups(name: &str, rollers: u8, seed: u64) -> (GroupFile, GroupFile) {
    let mut group = common::group(name);
    group.simulation.seed = seed;
    let plain = contact::on_contact(&group, rollers);
    let phase = contact::with_phases(&plain);
    let abort = Abort::default();
    (
        contact::calibrated(&plain, &abort).unwrap(),
        contact::calibrated(&phase, &abort).unwrap(),
    )
}

fn drive(group: &GroupFile, elf: Option<&PathBuf>, curve: Curve, compensation: bool) -> Run {
    let drive = Drive {
        group,
        course: Course::of(curve),
        feedback: None,
        compensation,
        elf: elf.map(PathBuf::as_path),
        candump: None,
        log: None,
        abort: Abort::default(),
        record: None,
        index_search: Some(&|_| {}),
    };
    let run = simulated(&drive, &mut |_, _| {}).unwrap();
    println!(
        "{:>12} {:>8}: x {:+.3} % y {:+.3} % turn {:+.3} % rms {:.2} mm ripple {:.3} % heading \
         {:+.3} deg",
        curve.name(),
        run.compensation_word(),
        run.errors.x_percent,
        run.errors.y_percent,
        run.evenness.turn_percent,
        run.errors.rms_mm,
        run.evenness.ripple_percent,
        run.evenness.heading_error_deg
    );
    run
}

/// All of it, on one kind of robots.
fn keeps_its_bounds(name: &str, (rollers, seed): (u8, u64), elf: Option<&PathBuf>) {
    let (constant, phase) = groups(name, rollers, seed);
    let comp = phase.robots[0].rollers.unwrap().compensation;
    println!(
        "{name}, {rollers} rollers, seed {seed}; phase: {comp:?} {:?}; constant: {:?}",
        phase.contact_lag, constant.robots[0].compensation
    );
    let lateral = drive(&phase, elf, Curve::Lateral, true);
    assert!(lateral.errors.x_percent.abs() <= MEAN);
    assert!(lateral.evenness.ripple_percent <= RIPPLE);
    let oblique = drive(&phase, elf, Curve::Oblique, true);
    assert!(oblique.errors.x_percent.abs() <= MEAN);
    assert!(oblique.errors.y_percent.abs() <= MEAN);
    assert!(oblique.evenness.heading_error_deg.abs() <= HEADING);
    let turn = drive(&phase, elf, Curve::Turn, true);
    assert!(turn.evenness.turn_percent.abs() <= MEAN);
    let before = drive(&constant, elf, Curve::FigureEight, true);
    let after = drive(&phase, elf, Curve::FigureEight, true);
    assert!(after.errors.x_percent.abs() <= MEAN);
    assert!(after.errors.y_percent.abs() <= MEAN);
    assert!(after.errors.rms_mm <= TRACKING * before.errors.rms_mm);
}

#[test]
fn native_robots_keep_the_bounds() {
    for rollers in [8, 10, 12] {
        for seed in [1, 2, 3] {
            keeps_its_bounds("single", (rollers, seed), None);
        }
    }
}

/// The release image that `OMNIBUS_ELF` names (`cargo xtask test` builds it).
#[cfg(feature = "emulated")]
#[test]
fn emulated_robots_keep_the_bounds() {
    let elf =
        PathBuf::from(std::env::var("OMNIBUS_ELF").expect("OMNIBUS_ELF names a release image"));
    keeps_its_bounds("single", (8, 1), Some(&elf));
}
