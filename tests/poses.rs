//! Poses of members share a frame: a robot that has lost its power starts again at zero, and the
//! group is driven and judged all the same.

mod common;

use canopen::Micros;
use kinematics::{Pose, Twist};
use omnibus::abort::Abort;
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::path::steering::Law;
use omnibus::run::{Drive, Feedback, Source, measured};
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use omnibus::simulation::run::world;

/// Turns the group by a right angle and takes the power from node 3 for a moment.
fn turned_and_reset() -> (group::GroupFile, SimLink) {
    let file = common::group("tcc-2");
    let world = world(&file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut session = Group::connect(&mut link, &file).unwrap();
    session.start().unwrap();
    session.set_twist(Twist::new(0.0, 0.0, 0.5)).unwrap();
    session.run(std::f64::consts::PI).unwrap();
    session.stop().unwrap();
    drop(session);
    let now = link.world.now().0;
    link.world.set_power(1, false);
    link.world.run_until(Micros(now + 100_000)).unwrap();
    link.world.set_power(1, true);
    link.world.run_until(Micros(now + 1_000_000)).unwrap();
    (file, link)
}

/// The circle ends where it began. Before members' poses shared a frame, the group ended 0.58 m
/// away with feedback.
#[test]
fn a_member_that_began_anew_misleads_nobody() {
    for corrects in [true, false] {
        let (file, mut link) = turned_and_reset();
        let before = link.world.truth().group;
        let drive = Drive {
            group: &file,
            course: Course::of(Curve::Circle),
            feedback: Some(Feedback {
                source: Source::Odometry,
                law: Law::default(),
                corrects,
            }),
            compensation: true,
            elf: None,
            candump: None,
            log: None,
            abort: Abort::default(),
            record: None,
            index_search: Some(&|_| {}),
        };
        let (run, _) = measured(&mut link, &drive, &mut |_, _| {}).unwrap();
        let after = link.world.truth().group;
        let off = (after.x - before.x).hypot(after.y - before.y);
        println!(
            "corrects {corrects}: {:.1} mm off, reported {:?}",
            off * 1e3,
            run.errors
        );
        // The lossy plant with its compensation comes back within a centimetre.
        assert!(off < 0.010, "{off}");
        assert!(run.errors.rms_mm < 10.0, "{:?}", run.errors);
        assert!(run.errors.x_percent.abs() < 1.0 && run.errors.y_percent.abs() < 1.0);
    }
}
