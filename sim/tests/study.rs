//! Studies: many groups without a bus.

use std::process::Command;

use group::{GroupFile, Plant, Tables};
use kinematics::trajectory::{Circle, Ramped, Trajectory as _};
use kinematics::{Pose, Twist};
use omnibus_sim::study::{Study, StudyGroup, StudyOptions};

const START: Pose<f64> = Pose {
    x: 0.0,
    y: 0.0,
    heading: 0.0,
};

fn file(plant: Plant) -> GroupFile {
    let path = format!("{}/../groups/tcc-3.toml", env!("CARGO_MANIFEST_DIR"));
    let mut file = GroupFile::load(path).unwrap();
    file.simulation.plant = plant;
    file
}

/// From rest to 0.24 m/s at 2.4 m/s2 takes ten periods of 10 ms: 0.24 s on (the first period ends
/// at 0.024 m/s) the way is 0.24 (0.01 (1 + 2 + ... + 10) / 10 + 0.9) = 0.2292 m after a second.
/// The robots do not compensate and lose nothing.
#[test]
fn a_group_accelerates_within_its_limits() {
    let options = StudyOptions {
        compensation: false,
        ..StudyOptions::default()
    };
    let mut study = Study::copies(&file(Plant::Table(Tables::Ideal)), 1, START, options).unwrap();
    study
        .run(100, 1, &|_, _| Twist::new(0.24, 0.0, 0.0))
        .unwrap();
    let group = &study.groups()[0];
    assert!((group.time() - 1.0).abs() < 1e-12);
    assert!((group.pose().x - 0.2292).abs() < 1e-6, "{:?}", group.pose());
    assert!(group.worst_shape_error_mm() < 1e-6);
}

/// 22 rad/s at 0.1524 m are 3.3528 m/s: no group goes faster, and it keeps its direction.
#[test]
fn the_slowest_wheel_sets_the_pace() {
    let options = StudyOptions {
        compensation: false,
        ..StudyOptions::default()
    };
    let mut study = Study::copies(&file(Plant::Table(Tables::Ideal)), 1, START, options).unwrap();
    study
        .run(400, 1, &|_, _| Twist::new(4.0, 4.0, 0.0))
        .unwrap();
    let before = study.groups()[0].pose();
    study
        .run(100, 1, &|_, _| Twist::new(4.0, 4.0, 0.0))
        .unwrap();
    let after = study.groups()[0].pose();
    // Ahead and left at once: the front right wheel turns at (vx + vy) / r.
    let (dx, dy) = (after.x - before.x, after.y - before.y);
    assert!((dx + dy - 22.0 * 0.1524).abs() < 1e-5, "{dx} {dy}");
    // Wheel rates are single precision.
    assert!((dx - dy).abs() < 1e-6, "{dx} {dy}");
}

/// Every group has its own seed and its own command, and does the same on one thread and on three.
#[test]
fn threads_change_nothing() {
    let mut file = file(Plant::Contact { rollers: 8 });
    file.simulation.contact.scattered = true;
    file.simulation.rigid = false;
    let run = |threads| {
        let mut study = Study::copies(&file, 7, START, StudyOptions::default()).unwrap();
        let command =
            |n: usize, _: &_| Twist::new(0.0, 0.1 * f64::from(u8::try_from(n).unwrap()), 0.0);
        study.run(100, threads, &command).unwrap();
        let poses: Vec<_> = study.groups().iter().map(|g| g.robots().to_vec()).collect();
        poses
    };
    let one = run(1);
    assert_eq!(one, run(3));
    // Group 0 stands; the faster, the farther.
    assert!(one[0].iter().all(|pose| pose.y.abs() < 1e-9), "{one:?}");
    assert!(one.windows(2).all(|pair| pair[0][0].y < pair[1][0].y));
}

#[test]
fn a_study_waits_for_nobody() {
    let file = file(Plant::External {
        address: "127.0.0.1:1".to_owned(),
    });
    let error = Study::copies(&file, 1, START, StudyOptions::default())
        .err()
        .unwrap();
    assert_eq!(
        error.to_string(),
        "plant: simulation.plant: a study cannot wait for another program; use table or contact"
    );
}

/// `omnibus-sim study GROUP | head`, with the reader gone before the first line.
#[test]
fn a_command_without_a_reader_ends_without_a_word() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let ended = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
        .args([
            "study",
            concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml"),
        ])
        .args(["--groups", "1"])
        .stdout(writer)
        .stderr(std::process::Stdio::piped())
        .spawn()
        .and_then(std::process::Child::wait_with_output)
        .unwrap();
    let errors = String::from_utf8_lossy(&ended.stderr);
    assert!(
        ended.status.success() && errors.is_empty(),
        "{} {errors}",
        ended.status
    );
}

/// The command drives a few groups at a time; each has the seed of its place all the same. The
/// distances of 70 groups, of which 64 come first, are those of a study of all of them.
#[test]
fn a_command_drives_every_group_once() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single-rollers.toml");
    let file = GroupFile::load(path).unwrap();
    let motion = Ramped::new(Circle::paper(), 2.0);
    let period = f64::from(file.sync_period_us) * 1e-6;
    let periods = (motion.duration() / period).ceil() as u32;
    let mut study = Study::copies(&file, 70, motion.at(0.0).0, StudyOptions::default()).unwrap();
    let command = |_: usize, group: &StudyGroup| {
        let (pose, twist) = motion.at(group.time() + 0.5 * period);
        twist.to_body(pose.heading)
    };
    study.run(periods, 2, &command).unwrap();
    let end = motion.at(motion.duration()).0;
    let away = |pose: Pose<f64>| (pose.x - end.x).hypot(pose.y - end.y) * 1e3;
    let mut all: Vec<f64> = study.groups().iter().map(|g| away(g.pose())).collect();
    all.sort_by(f64::total_cmp);
    let expected = format!("median {:.1} mm, largest {:.1} mm", all[35], all[69]);

    let output = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
        .args(["study", "--groups", "70", "--threads", "1", "--motion"])
        .args(["circle", path])
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.starts_with("70 groups, 70 robots"), "{text}");
    assert!(text.contains(&expected), "{expected} in {text}");
}
