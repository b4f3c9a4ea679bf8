//! Calibration on simulated floors, and what it is worth on the curves of the paper: every axis of
//! circle and figure-eight within 0.5 %, within 0.15 % where the robots know their rollers.

use group::{GroupFile, Plant, Tables};
use kinematics::Pose;
use omnibus::abort::Abort;
use omnibus::commission::calibrate::journal::Journal;
use omnibus::commission::calibrate::manoeuvre::Settings;
use omnibus::commission::calibrate::measure::Instrument;
use omnibus::commission::calibrate::{CalibrateError, Calibration, calibrate};
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::run::Drive;
use omnibus::session::Group;
use omnibus::simulation::contact;
use omnibus::simulation::link::SimLink;
use omnibus::simulation::run::{simulated, world};

/// Per cent: the least error without calibration, and the bound of every axis with
/// it.
#[derive(Clone, Copy)]
struct Bounds {
    before: f64,
    after: f64,
}

const BOUNDS: Bounds = Bounds {
    before: 2.0,
    after: 0.5,
};
/// With rollers that are known.
const ROLLING: Bounds = Bounds {
    before: 0.4,
    after: 0.15,
};

/// Of two robots 30 degrees apart, whose axes are not the group's.
const MIXED: Bounds = Bounds {
    before: 1.5,
    after: 0.5,
};

/// m/s.
const SPEEDS: [f64; 3] = [0.1, 0.5, 1.0];

fn group(name: &str) -> GroupFile {
    let path = format!("{}/../groups/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    GroupFile::load(path).unwrap()
}

fn settings(speeds: &[f64]) -> Settings {
    Settings {
        speeds: speeds.to_vec(),
        rates: vec![0.5],
        repeats: 1,
        ..Settings::default()
    }
}

fn calibrated(file: &GroupFile, speeds: &[f64]) -> Calibration {
    attempt(file, speeds).unwrap()
}

fn attempt(file: &GroupFile, speeds: &[f64]) -> Result<Calibration, CalibrateError> {
    let world = world(file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
    let mut session = Group::connect(SimLink::new(world, "sim"), file).unwrap();
    let rigid = file.simulation.rigid;
    let mut poses = |link: &mut SimLink| {
        let truth = link.world.truth();
        let robots = truth.robots.iter().map(|robot| robot.pose);
        let poses: Vec<_> = if rigid {
            vec![truth.group]
        } else {
            robots.collect()
        };
        Ok(poses.iter().map(|p| [p.x, p.y, p.heading]).collect())
    };
    let mut instrument = Instrument::Poses(&mut poses);
    let settings = settings(speeds);
    calibrate(
        &mut session,
        &settings,
        1,
        &mut instrument,
        &mut Journal::new(|_| {}),
    )
}

/// Errors of a curve, lateral and longitudinal, per cent.
fn errors(file: &GroupFile, curve: Curve, compensation: bool) -> [f64; 2] {
    let drive = Drive {
        group: file,
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
    let run = simulated(&drive, &mut |_, _| {}).unwrap();
    [run.errors.x_percent, run.errors.y_percent]
}

fn holds(file: &GroupFile, speeds: &[f64], bounds: Bounds) -> GroupFile {
    let calibration = calibrated(file, speeds);
    for outcome in &calibration.outcomes {
        for left in &outcome.left {
            println!("{:?} {} {:+.3} %", left.way, left.speed, left.error * 100.0);
        }
        println!("{:#?}", outcome.found.table(1));
    }
    for curve in [Curve::Circle, Curve::FigureEight] {
        let before = errors(file, curve, false);
        let after = errors(&calibration.file, curve, true);
        println!("{curve}: {before:+.2?} -> {after:+.3?}");
        assert!(
            before[0].abs() > bounds.before,
            "there is something to mend: {before:?}"
        );
        for error in after {
            assert!(error.abs() < bounds.after, "{curve}: {after:?}");
        }
    }
    calibration.file
}

/// The paper's physical robot, Tables 7 and 8.
#[test]
fn a_calibration_on_the_measured_floor_holds_on_the_curves() {
    let mut file = group("tcc-3");
    file.simulation.plant = Plant::Table(Tables::Physical);
    holds(&file, &SPEEDS, BOUNDS);
}

/// Rollers of random phase, as mounted.
#[test]
fn a_calibration_on_the_contact_plant_holds_on_the_curves() {
    holds(&contact::on_contact(&group("tcc-2"), 8), &SPEEDS, BOUNDS);
}

/// Two robots 30 degrees apart, bolted together (the paper's figure 19f). Each loses what Table 3
/// says along its own axes: the coefficients at 0.5 m/s are 1.0022 and 1.0345.
#[test]
fn robots_that_face_differently_are_calibrated_bolted_together() {
    let file = holds(&group("acc-2"), &SPEEDS, MIXED);
    let table = &file.robots[1].compensation_table;
    for (rows, expected) in [(&table.longitudinal, 1.0022), (&table.lateral, 1.0345)] {
        let row = rows[1];
        assert!((row.speed * row.coefficient - 0.5).abs() < 1e-3);
        assert!((row.coefficient - expected).abs() < 5e-4, "{rows:?}");
    }
    holds(&contact::on_contact(&group("acc-2"), 8), &SPEEDS, MIXED);
}

/// Robots that all face sideways in their group: poses are the group's, motions the robots'.
#[test]
fn robots_that_all_face_left_are_calibrated_too() {
    let mut file = group("scc-2");
    for robot in &mut file.robots {
        robot.mount.heading = std::f32::consts::FRAC_PI_2;
    }
    let found = calibrated(&file, &[0.5]).file.robots[0].compensation;
    assert!((found.longitudinal() - 1.0022).abs() < 5e-4, "{found:?}");
    assert!((found.lateral() - 1.0345).abs() < 5e-4, "{found:?}");
}

/// A quarter turn apart, side by side: the sum of what both lose ahead and sideways is all that
/// translation shows, and the group turns by their difference, 0.0145 rad/m.
#[test]
fn robots_a_quarter_turn_apart_are_refused_where_it_turns_their_group() {
    let mut file = group("acc-2");
    file.robots[1].mount.heading = std::f32::consts::FRAC_PI_2;
    let error = attempt(&file, &[0.5]).unwrap_err().to_string();
    assert!(error.contains("simulation.rigid = false"), "{error}");
}

/// The hand-over of the contact plant's eight rollers costs 0.00127 s/m: the momentum of
/// `sim/tests/contact_rollers.rs`, 0.0636 % at 0.5 m/s. A row is known to a ten-thousandth or so,
/// and the rows end 0.2 m/s apart: 0.0005 s/m.
#[test]
fn a_calibration_with_known_rollers_tells_their_hand_over_apart() {
    let file = contact::with_phases(&contact::on_contact(&group("single"), 8));
    let found = holds(&file, &[0.1, 0.2, 0.3], ROLLING);
    println!(
        "{} s/m, {:?}",
        found.hand_over_loss, found.robots[0].rollers
    );
    let expected = 0.00127;
    assert!((found.hand_over_loss - expected).abs() < 0.0005);
}
