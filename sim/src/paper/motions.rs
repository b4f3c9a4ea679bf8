//! The eleven motions of figure 6, each without and with the paper's compensation.
//!
//! C1 (1.033 lateral, 1.002 longitudinal) for those that keep their heading, C2 (1.04, 1.002,
//! 1.0195 for the rotation) for those that turn while they translate; where the paper prints 0 for
//! a rotation it never commands, 1 is meant and used.

use kinematics::Pose;
use kinematics::trajectory::{MotionMode, PaperMotion, Ramped};

use super::drive::{Job, Point, displacement_error, drive_all, rms_mm};
use super::page::map;
use super::tables::{RAMP, columns, forward, right};
use super::{OnPlant, Parts, Row, Setting, robots};
use crate::error::SimError;

/// What the paper prints for a motion without compensation, per cent: x, y, rotation.
const fn printed(mode: MotionMode) -> [Option<f64>; 3] {
    match mode {
        MotionMode::Longitudinal => [None, Some(-0.219), None],
        MotionMode::Lateral => [Some(-3.36), None, None],
        MotionMode::Oblique => [Some(-1.988), Some(-1.967), None],
        MotionMode::Turning => [None, None, Some(-1.920)],
        MotionMode::Circle => [Some(-3.48), Some(-0.14), None],
        MotionMode::FigureEight => [Some(-2.92), Some(-0.28), None],
        MotionMode::Harmonic
        | MotionMode::ObliqueCircle
        | MotionMode::ObliqueFigureEight
        | MotionMode::Centripetal
        | MotionMode::ObliqueCentripetal => [None; 3],
    }
}

const fn turns_on_its_way(mode: MotionMode) -> bool {
    matches!(
        mode,
        MotionMode::Centripetal | MotionMode::ObliqueCentripetal
    )
}

pub(super) fn run(mode: MotionMode, setting: &Setting) -> Result<Parts, SimError> {
    let plants = setting.plants(&[OnPlant::Table, OnPlant::Contact]);
    let lateral = if turns_on_its_way(mode) { 1.04 } else { 1.033 };
    let mut jobs = Vec::new();
    for plant in &plants {
        for compensation in [false, true] {
            let mut file = robots::virtual_robot(*plant)?;
            robots::compensate(&mut file, 1.002, lateral, 1.0195)?;
            let motion: PaperMotion<f64> = mode.motion();
            jobs.push(Job {
                file,
                motion: Box::new(Ramped::new(motion, RAMP)),
                compensation,
            });
        }
    }
    let drives = drive_all(&jobs, &setting.backend)?;
    let mut rows = Vec::new();
    type Axis = fn(&Pose<f64>) -> f64;
    let axes: [(&str, Axis); 3] = [
        ("x", right),
        ("y", forward),
        ("rotation", |pose| pose.heading),
    ];
    for (word, skip) in [("without compensation", 0), ("with compensation", 1)] {
        let drives: Vec<&Vec<Point>> = drives.iter().skip(skip).step_by(2).collect();
        for ((axis, pick), paper) in axes.into_iter().zip(printed(mode)) {
            let errors = drives.iter().map(|points| displacement_error(points, pick));
            if let Some(ours) = errors.collect::<Option<Vec<f64>>>() {
                rows.push(Row {
                    what: format!("{word}, {axis}"),
                    unit: "%",
                    paper: paper.filter(|_| skip == 0),
                    ours,
                });
            }
        }
        rows.push(Row {
            what: format!("{word}, distance to the motion, rms"),
            unit: "mm",
            paper: None,
            ours: drives.iter().map(|points| rms_mm(points)).collect(),
        });
    }
    let paths = plants
        .iter()
        .zip(drives.chunks(2))
        .flat_map(|(plant, pair)| {
            let label = |word: &str| format!("{} plant, {word}", plant.name());
            [
                (label("uncompensated"), pair[0].as_slice()),
                (label("compensated"), pair[1].as_slice()),
            ]
        });
    Ok(Parts {
        notes: vec![],
        columns: columns(&plants),
        rows,
        charts: vec![map("path of the centre", paths)],
    })
}
