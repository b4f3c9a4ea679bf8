//! Closed loops on floors and rollers that differ from what was calibrated: `follow --pose` stays
//! within 10 mm rms of the figure-eight.

use std::cell::Cell;
use std::rc::Rc;

use canopen::Micros;
use group::GroupFile;
use kinematics::{FourWheelGeometry, Pose};
use omnibus::abort::Abort;
use omnibus::bus::link::Link as _;
use omnibus::monitor::metrics::{PathPoint, path_errors};
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::path::steering::{Law, PoseInput, Steering};
use omnibus::session::Group;
use omnibus::simulation::contact;
use omnibus::simulation::link::SimLink;
use sim::plant::contact::{Contact, ContactPlant};
use sim::{Backend, Options, World};

/// Where a closed loop stays.
const WITHIN_MM: f64 = 10.0;

/// Root mean square distance from the figure-eight, mm, of a group whose plant is another one.
#[expect(clippy::cast_possible_truncation, reason = "metrics go by f32")]
fn figure_eight(file: &GroupFile, plant: &GroupFile, feedback: bool) -> f64 {
    let plan = Course::of(Curve::FigureEight).plan().unwrap();
    let contact = Contact::of(plant, 8);
    let start = plan.start();
    let plant = Box::new(ContactPlant::new(plant, contact, start).unwrap());
    let nodes = file.robots.iter().map(|robot| robot.node);
    let robots = nodes.map(|node| Backend::Native.build(node, 0.0).unwrap());
    let options = Options {
        start,
        ..Options::default()
    };
    let world = World::with_parts(file, robots.collect(), plant, options).unwrap();
    let mut group = Group::connect(SimLink::new(world, "sim"), file).unwrap();
    group.configure(true).unwrap();
    let seen: Rc<Cell<Option<(Micros, Pose)>>> = Rc::default();
    let input = PoseInput::Observer(Rc::clone(&seen));
    let mut steering = Steering::new(Law::default(), input, plan.at(0.0).0, feedback);
    let mut path = Vec::new();
    group.start().unwrap();
    let mut observe = |link: &mut SimLink, instant: &omnibus::path::curve::Instant| {
        let Pose { x, y, heading } = link.world.truth().group;
        let [x, y, heading] = [x, y, heading].map(|v| v as f32);
        let actual = Pose::new(x, y, heading);
        seen.set(Some((link.now(), actual)));
        path.push(PathPoint {
            t: instant.t,
            theory: instant.pose,
            actual,
        });
    };
    group
        .follow_with(&plan, Some(&mut steering), &mut observe)
        .unwrap();
    println!("{:?}", steering.adaptation);
    path_errors(&path).unwrap().rms_mm
}

/// A robot whose calibration says nothing of slip and lag.
fn robot() -> GroupFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single.toml");
    contact::on_contact(&GroupFile::load(path).unwrap(), 8)
}

fn compare(what: &str, file: &GroupFile, plant: &GroupFile) -> f64 {
    let [open, closed] = [false, true].map(|feedback| figure_eight(file, plant, feedback));
    println!("{what}: {open:.1} mm open, {closed:.1} mm closed");
    assert!(closed < open / 2.0);
    closed
}

/// Without learning it is 23 mm.
#[test]
fn on_a_smooth_floor() {
    let mut plant = robot();
    plant.simulation.contact.friction = Some(0.2);
    assert!(compare("friction 0.2", &robot(), &plant) < WITHIN_MM);
}

#[test]
fn with_rollers_that_stand_at_46_degrees() {
    let mut plant = robot();
    for robot in &mut plant.robots {
        let g = robot.geometry;
        robot.geometry = FourWheelGeometry::new(
            g.half_track(),
            g.half_wheelbase(),
            g.wheel_radius(),
            46_f32.to_radians(),
        )
        .unwrap();
    }
    assert!(compare("rollers at 46 degrees", &robot(), &plant) < WITHIN_MM);
}

/// No worse where hardly anything is to be learnt.
#[test]
fn where_it_was_calibrated() {
    let file = contact::calibrated(&robot(), &Abort::default()).unwrap();
    assert!(compare("as calibrated", &file, &file) < 0.3 * WITHIN_MM);
}
