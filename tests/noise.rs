//! Wires that pick up what they should not, with the release image on an emulated board; and the
//! bench image, which must not drive.

mod common;

use canopen::NmtCommand;
use group::GroupFile;
use omnibus::session::Group;
use omnibus::simulation::contact;
use omnibus::simulation::link::SimLink;
use protocol::MemberState;
use sim::test_master::TestMaster;
use sim::{Backend, Options, World};

/// The pins of the encoders' indexes.
const INDEX_PINS: [(emulator::Port, u8); 4] = [
    (emulator::Port::B, 10),
    (emulator::Port::A, 12),
    (emulator::Port::B, 14),
    (emulator::Port::B, 15),
];

/// An emulated robot with this group file that holds still.
fn armed(file: &GroupFile) -> TestMaster {
    let master = started(file, "OMNIBUS_ELF");
    assert!(master.all_are(MemberState::Armed) || master.all_are(MemberState::Moving));
    master
}

/// An emulated robot with this group file and the image that a variable names, configured and told
/// to start.
fn started(file: &GroupFile, variable: &str) -> TestMaster {
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let world = World::new(file, Backend::Emulator(common::image(variable)), options).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut session = Group::connect(&mut link, file).unwrap();
    session.configure(true).unwrap();
    let mut master = TestMaster::new(link.world, file);
    master.run(60).unwrap();
    master.command(NmtCommand::Start, None);
    master.run(100).unwrap();
    master
}

/// Share of the time for which the core did not sleep since `before`.
fn load(board: &emulator::Board, before: (u64, u64)) -> f64 {
    let (cycles, slept) = board.cycles();
    1.0 - (slept - before.1) as f64 / (cycles - before.0) as f64
}

/// The load of 100 ms in per cent of the processor, with a million edges a second on every index
/// input or with none. The master is silent meanwhile.
fn load_with(file: &GroupFile, chatter: bool) -> f64 {
    let mut master = armed(file);
    let board = master.world.board(file.robots[0].node).unwrap();
    let (before, begin) = (board.cycles(), board.now_ns());
    for half in 1..=200_000_u64 {
        for (port, pin) in INDEX_PINS {
            board.set_input(port, pin, chatter && half % 2 == 1);
        }
        board.run_until(begin + half * 500).unwrap();
        while board.can().begin().is_some() {
            board.can().transmitted();
        }
        assert_eq!(board.resets(), 0, "after {} us", half / 2);
    }
    100.0 * load(board, before)
}

/// What the edges add to the load.
fn load_of_chatter(file: &GroupFile) -> f64 {
    load_with(file, true) - load_with(file, false)
}

#[test]
fn noise_on_an_index_that_is_not_used_costs_nothing() {
    let added = load_of_chatter(&common::group("single"));
    println!("1 MHz on four index inputs that are not used: {added:.2} % more load");
    assert!(added < 0.1, "{added} %");
}

#[test]
fn noise_on_an_index_that_is_used_leaves_the_control_tick_its_time() {
    let file = contact::with_phases(&contact::on_contact(&common::group("single"), 8));
    let added = load_of_chatter(&file);
    println!("1 MHz on four index inputs that are used: {added:.2} % more load");
    assert!(added < 1.0, "{added} %");
}

#[test]
fn a_bench_image_refuses_to_start_because_of_its_drivers() {
    let file = common::group("single");
    let node = file.robots[0].node;
    let master = started(&file, "OMNIBUS_ELF_BENCH");
    assert!(!master.all_are(MemberState::Armed) && !master.all_are(MemberState::Moving));
    let codes: Vec<u16> = master.emergencies(node).map(|(_, code)| code).collect();
    assert_eq!(codes, [protocol::Fault::DriverFault.code()]);
}
