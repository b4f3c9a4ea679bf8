//! `omnibus calibrate --all --write --save` as the guide prints it, by the library: what it found
//! stands in the group file, in the robots, and in their flash, the same to the last bit, and the
//! figure-eight is better for it.

mod common;

use std::path::Path;

use canopen::Micros;
use group::{GroupFile, compensation_set, parameters};
use kinematics::Pose;
use omnibus::abort::Abort;
use omnibus::commission::calibrate::journal::Journal;
use omnibus::commission::calibrate::manoeuvre::Settings;
use omnibus::commission::calibrate::measure::Instrument;
use omnibus::commission::calibrate::recorded_motions::Source;
use omnibus::commission::calibrate::{calibrate, group_file, rollers};
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::run::Drive;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use omnibus::simulation::run::{simulated, world};
use protocol::address;

/// rms of the figure-eight, mm.
fn tracking(group: &GroupFile, elf: Option<&Path>) -> f64 {
    let drive = Drive {
        group,
        course: Course::of(Curve::FigureEight),
        feedback: None,
        compensation: true,
        elf,
        candump: None,
        log: None,
        abort: Abort::default(),
        record: None,
        index_search: Some(&|_| {}),
    };
    simulated(&drive, &mut |_, _| {}).unwrap().errors.rms_mm
}

/// Calibrates a group of one robot that has everything to find, and returns its new file.
fn whole_calibration(name: &str, elf: Option<&Path>) -> GroupFile {
    let path = std::env::temp_dir().join(format!("omnibus-{name}-{}.toml", std::process::id()));
    let source = format!("{}/groups/single-rollers.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(source).unwrap();
    let text = text.replace("node = 2\n", "node = 2\nrollers = { count = 8 }\n");
    std::fs::write(&path, text).unwrap();
    let file = GroupFile::load(&path).unwrap();

    let world = world(&file, elf, Pose::new(0.0, 0.0, 0.0)).unwrap();
    let mut session = Group::connect(SimLink::new(world, "test"), &file).unwrap();
    let mut poses = |link: &mut SimLink| {
        let pose = link.world.truth().group;
        Ok(vec![[pose.x, pose.y, pose.heading]])
    };
    let settings = Settings {
        speeds: vec![0.25, 0.5, 1.0],
        rates: vec![0.5],
        repeats: 1,
        lag: true,
        ..Settings::default()
    };
    let journal = &mut Journal::new(|_| {});
    let source = &mut Source::Poses(&mut poses);
    rollers::learn(&mut session, &settings, source, journal).unwrap();
    let instrument = &mut Instrument::Poses(&mut poses);
    let found = calibrate(&mut session, &settings, 1, instrument, journal).unwrap();
    session.wire().save(2).unwrap();

    let text = group_file::rewrite(&path, &found.file).unwrap();
    std::fs::write(&path, text).unwrap();
    let written = GroupFile::load(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(written, found.file);
    println!("{:?} {:?}", written.contact_lag, written.robots[0].rollers);

    // What flash has is what a robot comes back with.
    let link = session.link();
    link.world.set_power(0, false);
    let off = link.world.now().0;
    link.world.run_until(Micros(off + 100_000)).unwrap();
    link.world.set_power(0, true);
    link.world.run_until(Micros(off + 1_000_000)).unwrap();
    for robot in &written.robots {
        for (at, value) in parameters(&written, robot, true) {
            let held = session.wire().read(robot.node, at, value.kind()).unwrap();
            assert_eq!(held, value, "{at}");
        }
        let set = session
            .wire()
            .read_block(robot.node, address::COMPENSATION_SET)
            .unwrap();
        assert_eq!(set, compensation_set(robot, true).unwrap());
    }
    written
}

/// Bounds from before anything was driven: with phases, slip and lag known, figure-eights of the
/// contact plant stay within 3 mm rms (2.5 times what the best robot of `tests/phase.rs` reaches);
/// without, rollers of random phase and 9 ms of lag leave more than 10 mm.
fn is_worth_it(name: &str, elf: Option<&Path>) {
    let calibrated = whole_calibration(name, elf);
    let mut before = calibrated.clone();
    before.contact_lag = group::ContactLag::default();
    before.hand_over_loss = 0.0;
    before.robots[0].rollers = None;
    let (before, after) = (tracking(&before, elf), tracking(&calibrated, elf));
    println!("figure-eight: {before:.2} mm -> {after:.2} mm rms");
    assert!(before > 10.0 && after < 3.0, "{before} {after}");
}

#[test]
fn a_whole_calibration_of_a_native_robot() {
    is_worth_it("whole-native", None);
}

/// The release image that `OMNIBUS_ELF` names (`cargo xtask test` builds it).
#[cfg(feature = "emulated")]
#[test]
fn a_whole_calibration_of_an_emulated_robot() {
    let elf = std::env::var("OMNIBUS_ELF").expect("OMNIBUS_ELF names a release image");
    is_worth_it("whole-emulated", Some(Path::new(&elf)));
}
