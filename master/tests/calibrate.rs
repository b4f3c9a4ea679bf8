//! Calibration on simulated floors, and what it is worth on the curves of the paper: every axis of circle and
//! figure-eight within 0.5 %.

use group::{GroupFile, Plant, Tables};
use kinematics::Pose;
use omnibus::abort::Abort;
use omnibus::calibrate::manoeuvre::Settings;
use omnibus::calibrate::measure::Witness;
use omnibus::calibrate::{Calibration, calibrate};
use omnibus::course::Course;
use omnibus::curve::Curve;
use omnibus::drive::{Drive, simulated, world};
use omnibus::session::Group;
use omnibus::sim_link::SimLink;
use omnibus::trial;

/// The bound of every axis, per cent.
const BOUND: f64 = 0.5;

fn group(name: &str) -> GroupFile {
    let path = format!("{}/../groups/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    GroupFile::load(path).unwrap()
}

fn settings() -> Settings {
    Settings {
        speeds: vec![0.1, 0.5, 1.0],
        rates: vec![0.5],
        repeats: 1,
        ..Settings::default()
    }
}

fn calibrated(file: &GroupFile) -> Calibration {
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
    let mut witness = Witness::Poses(&mut poses);
    calibrate(&mut session, &settings(), 1, &mut witness, &mut |_, _| {}).unwrap()
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
    };
    let run = simulated(&drive, &mut |_, _| {}).unwrap();
    [run.errors.x_percent, run.errors.y_percent]
}

fn holds(file: &GroupFile) {
    let calibration = calibrated(file);
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
            before[0].abs() > 2.0,
            "there is something to mend: {before:?}"
        );
        for error in after {
            assert!(error.abs() < BOUND, "{curve}: {after:?}");
        }
    }
}

/// The paper's physical robot, Tables 7 and 8.
#[test]
fn a_calibration_on_the_measured_floor_holds_on_the_curves() {
    let mut file = group("tcc-3");
    file.simulation.plant = Plant::Table(Tables::Physical);
    holds(&file);
}

/// Rollers of random phase, as mounted.
#[test]
fn a_calibration_on_the_contact_plant_holds_on_the_curves() {
    holds(&trial::on_contact(&group("tcc-2"), 8));
}
