//! What an NMT reset leaves, and what it brings back.

use canopen::{Frame, NmtCommand};
use protocol::{Address, Fault, Value, address as at, cob};

use super::world::World;
use crate::state::State;

const ERROR_REGISTER: Address = Address::new(0x1001, 0);
/// Set with every error (CiA 301, 7.5.2.2).
const GENERIC: u32 = 1 << 0;

fn register(world: &mut World) -> u32 {
    world.read(2, ERROR_REGISTER).unwrap() & 0xFF
}

/// A robot that stands with its emergency stop pressed since the last start.
fn stopped() -> World {
    let mut world = World::started(&[2]);
    world.robots[0].inputs.emergency_stop = true;
    world.run(50);
    let state = world.robots[0].bus.state();
    assert_eq!(state, State::Faulted(Fault::EmergencyStop));
    assert_eq!(world.emergencies(2), [Fault::EmergencyStop.code()]);
    world
}

/// CiA 301, 7.2.7.1: an error that is present is said in 0x1001, whatever has been reset.
#[test]
fn a_fault_is_said_again_after_an_nmt_reset() {
    for command in [NmtCommand::ResetNode, NmtCommand::ResetCommunication] {
        let mut world = stopped();
        world.nmt(command, 2);
        world.run(50);
        let codes = [Fault::EmergencyStop.code(); 2];
        assert_eq!(world.emergencies(2), codes, "{command:?}");
        let last = |is: fn(&Frame) -> bool| world.log.iter().rposition(|(_, frame)| is(frame));
        let boot_up = last(|frame| frame.id() == cob::heartbeat(2) && frame.data() == [0]);
        assert!(boot_up.is_some());
        assert!(last(|frame| frame.id() == cob::emergency(2)) > boot_up);
        assert_ne!(register(&mut world) & GENERIC, 0);
        // Reset node has brought back the parameters, of which none were saved.
        world.configure();
        // The next start is refused, and 0x1001 still says so; once is enough.
        world.start();
        world.run(50);
        let state = world.robots[0].bus.state();
        assert_eq!(state, State::Faulted(Fault::EmergencyStop));
        assert_ne!(register(&mut world) & GENERIC, 0);
        assert_eq!(world.emergencies(2), codes);
        // It is taken back with the start that succeeds.
        world.robots[0].inputs.emergency_stop = false;
        world.run(5);
        world.start();
        world.run(50);
        assert_eq!(world.robots[0].bus.state(), State::Armed);
        assert_eq!(world.emergencies(2).last(), Some(&0));
        assert_eq!(register(&mut world), 0);
    }
}

/// CiA 301, 7.3.2.2.1: reset node sets the application's objects to their power-on values.
#[test]
fn a_node_reset_sets_what_an_identification_may_do_to_its_defaults() {
    let settings = [
        (at::IDENTIFY_RATE, Value::F32(8.0)),
        (at::IDENTIFY_TRAVEL, Value::F32(20.0)),
        (at::IDENTIFY_BANDWIDTH, Value::F32(7.0)),
        (at::IDENTIFY_DAMPING, Value::F32(0.7)),
        (at::IDENTIFY_WHEELS, Value::U8(3)),
        (at::BLINK, Value::U8(200)),
    ];
    let mut world = World::started(&[2]);
    let read = |world: &mut World| settings.map(|(address, _)| world.read(2, address).unwrap());
    let defaults = read(&mut world);
    for (address, value) in settings {
        world.write(2, address, value).unwrap();
    }
    let written = read(&mut world);
    for (before, after) in defaults.iter().zip(&written) {
        assert_ne!(before, after);
    }
    world.nmt(NmtCommand::ResetCommunication, 2);
    world.run(50);
    assert_eq!(read(&mut world)[..5], written[..5]);
    assert!(world.robots[0].bus.blinks());
    world.nmt(NmtCommand::ResetNode, 2);
    world.run(50);
    assert_eq!(read(&mut world), defaults);
    assert!(!world.robots[0].bus.blinks());
}
