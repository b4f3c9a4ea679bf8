//! What the tests of the group rules begin with.

use std::mem::{Discriminant, discriminant};
use std::sync::Mutex;

use canopen::NmtCommand;
use group::GroupFile;
use kinematics::Twist;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::{Address, MemberState, Value};
use sim::test_master::TestMaster;
use sim::{Backend, Options, World};

use super::{NODES, common};

/// The group whose robots are tried. With images for each kind of robot they are Board Cs with C620
/// drives, and lighter: these drives give 20 A.
pub fn tcc_3(backend: &Backend) -> GroupFile {
    let mut file = common::group("tcc-3");
    if matches!(backend, Backend::Images(_)) {
        for robot in &mut file.robots {
            robot.board = group::Board::RobomasterC;
            robot.output.kind = group::StageKind::C620;
            robot.output.largest_current = Some(20.0);
            robot.motor.inertia = 0.2;
            robot.encoder.counts_per_revolution = 8192.0;
            robot.encoder.gear_ratio = 3591.0 / 187.0;
        }
    }
    file
}

/// A group of three with this file and these values.
pub fn configured(backend: &Backend, file: &GroupFile, more: &[(Address, f32)]) -> TestMaster {
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let world = World::new(file, backend.clone(), options).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut session = Group::connect(&mut link, file).unwrap();
    session.configure(false).unwrap();
    for node in NODES {
        for (address, value) in more {
            let wire = session.wire();
            wire.write(node, *address, Value::F32(*value)).unwrap();
        }
    }
    TestMaster::new(link.world, file)
}

/// Starts a group and gives it a setpoint.
pub fn start(master: &mut TestMaster, twist: Twist, millis: u64) {
    master.run(60).unwrap();
    master.command(NmtCommand::Start, None);
    master.run(60).unwrap();
    assert!(master.all_are(MemberState::Moving));
    master.twist = Some(twist);
    master.run(millis).unwrap();
}

/// A kind of robots, and their twist unless they wait for their start.
type Beginning = (Discriminant<Backend>, Option<Twist>);
/// What tests have begun with so far.
static BEGUN: Mutex<Vec<(Beginning, TestMaster)>> = Mutex::new(Vec::new());

/// A copy of the group as its file has it. It begins once for all tests.
fn begun(backend: &Backend, twist: Option<Twist>) -> TestMaster {
    let wanted = (discriminant(backend), twist);
    for (beginning, master) in BEGUN.lock().unwrap().iter() {
        if *beginning == wanted {
            return master.try_clone().unwrap();
        }
    }
    let master = match twist {
        None => configured(backend, &tcc_3(backend), &[]),
        Some(twist) => {
            let mut master = waiting(backend);
            start(&mut master, twist, 600);
            assert!(master.all_are(MemberState::Moving));
            master
        }
    };
    let copy = master.try_clone().unwrap();
    BEGUN.lock().unwrap().push((wanted, copy));
    master
}

pub fn waiting(backend: &Backend) -> TestMaster {
    begun(backend, None)
}

pub fn moving(backend: &Backend, twist: Twist) -> TestMaster {
    begun(backend, Some(twist))
}
