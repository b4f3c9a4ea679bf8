//! Commissioning that is stopped in the middle leaves a robot at rest and a member of its group.

use group::GroupFile;
use kinematics::Pose;
use omnibus::commission::motors::{Settings, identify_motors};
use omnibus::commission::wheel_test::test_wheels;
use omnibus::error::MasterError;
use omnibus::session::Group;
use omnibus::simulation::{link::SimLink, run::world};
use protocol::{Fault, Kind, MemberState, address};

/// A configured group on a simulated bus.
fn session() -> Group<SimLink> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-2.toml");
    let file = GroupFile::load(path).unwrap();
    let world = world(&file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
    let mut session = Group::connect(SimLink::new(world, "sim"), &file).unwrap();
    session.configure(true).unwrap();
    session
}

/// Stops after so many seconds.
fn stop_at(limit: f64) -> impl FnMut(f64) -> Result<(), MasterError> {
    move |t| {
        if t < limit {
            Ok(())
        } else {
            Err(MasterError::Aborted)
        }
    }
}

fn assert_at_rest(session: &mut Group<SimLink>, members: u32) {
    let wire = session.wire();
    let mut read = |at, kind| wire.read(2, at, kind).unwrap().to_bits();
    assert_eq!(read(address::MEMBERS, Kind::U32), members);
    assert_eq!(read(address::COMMISSIONING, Kind::U8), 0);
    // Not armed, not moving, no fault: as it was after it had been configured.
    let state = u8::try_from(read(address::STATE, Kind::U8)).unwrap();
    assert_eq!(MemberState::try_from(state), Ok(MemberState::Ready));
    let code = u16::try_from(read(address::STATUS_CODE, Kind::U16)).unwrap();
    assert_eq!(Fault::from_code(code), None, "code {code:#06x}");
}

#[test]
fn an_identification() {
    let mut session = session();
    let period = session.period_us();
    let wire = session.wire();
    let stopped = identify_motors(wire, 2, period, &Settings::default(), &mut stop_at(1.0));
    assert_eq!(stopped, Err(MasterError::Aborted));
    assert_at_rest(&mut session, 0b1100);
}

#[test]
fn a_wheel_test() {
    let mut session = session();
    let period = session.period_us();
    let mut look = |_| Ok(None);
    let stopped = test_wheels(session.wire(), 2, period, &mut look, &mut stop_at(0.3));
    assert_eq!(stopped.unwrap_err(), MasterError::Aborted);
    assert_at_rest(&mut session, 0b1100);
}
