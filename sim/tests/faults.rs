//! Faults as text, and at their times in a world.

use group::GroupFile;
use omnibus_sim::fault::{FaultSpec, Schedule};
use omnibus_sim::{Backend, MASTER, Options, World};

fn group() -> GroupFile {
    GroupFile::load("../groups/tcc-3.toml").unwrap()
}

fn parse(text: &str) -> Result<FaultSpec, String> {
    FaultSpec::parse(text, &group(), false).map_err(|error| error.to_string())
}

#[test]
fn what_is_read_can_be_read_again() {
    for text in [
        "power-cycle",
        "power-off",
        "power-on",
        "emergency-stop",
        "emergency-stop=off",
        "driver-fault",
        "protective-stop",
        "bus-cut=off",
        "bus-parts",
        "bus-off",
        "overrun",
        "misses=0x181",
        "misses=off",
        "encoder-reversed:wheel=front-right",
        "encoder-floats:wheel=front-left",
        "encoder-noise=250:wheel=front-left",
        "encoder-slow-edges=20:wheel=rear-left",
        "wheel-drag=32.5:wheel=rear-right",
        "wheel-push=-7.5:wheel=front-left",
        "brake-torque=20",
        "brake-release=50",
        "brake-engage=80",
        "driver-trip=40",
        "driver-trip=off",
        "supply=17.5",
        "no-regeneration=2000",
        "no-regeneration=off",
        "corrupt=0.25",
        "corrupt=0.5:id=0x181",
        "babble=0x001",
        "delay=0.002",
        "delay=0.03",
        "delay=off",
    ] {
        let fault = parse(&format!("node=4:{text}")).unwrap();
        assert_eq!(fault.action.to_string(), format!("node 4: {text}"));
    }
    for text in [
        "corrupt=0.01",
        "corrupt=off",
        "lost-acknowledge=1:id=0x702",
        "babble=0x7FF",
        "babble=off",
    ] {
        assert_eq!(
            parse(text).unwrap().action.to_string(),
            format!("bus: {text}")
        );
    }
    let slow = parse("node=1:delay=0.5").unwrap();
    assert_eq!(slow.action.to_string(), "node 1: delay=0.5");
}

#[test]
fn what_cannot_be_meant_names_the_part_and_the_remedy() {
    for (text, wanted) in [
        ("", "action: is missing; give one of power-cycle"),
        (
            "node=9:overrun",
            "node: 9 is not in the group; give one of 2, 3, 4",
        ),
        ("overrun", "node: is missing; give one of 2, 3, 4"),
        (
            "t=-1:node=2:overrun",
            "t: -1 is not a time; give seconds, 0 to 86400",
        ),
        ("t=nan:node=2:overrun", "t: nan is not a time"),
        ("t=1:t=2:node=2:overrun", "t: appears twice; give it once"),
        ("t:node=2:overrun", "t: has no value; write t=VALUE"),
        (
            "node=2:explode",
            "explode: is not an action; give one of power-cycle",
        ),
        (
            "node=2:overrun:bus-off",
            "bus-off: a fault has one action, and this one already has `overrun`",
        ),
        ("node=2:overrun=3", "overrun: takes no value; write overrun"),
        (
            "node=2:overrun:for=1",
            "for: does not apply to overrun, which has no duration",
        ),
        (
            "node=2:overrun:wheel=front-left",
            "wheel: does not apply to overrun",
        ),
        (
            "node=2:encoder-dead",
            "wheel: is missing; give wheel=NAME, one of front-left",
        ),
        ("node=2:encoder-dead:wheel=5", "wheel: 5 is not a wheel"),
        (
            "node=2:emergency-stop=1",
            "emergency-stop: 1 is neither on nor off",
        ),
        (
            "node=2:misses=0x800",
            "misses: 0x800 is not an identifier; write misses=0x181",
        ),
        (
            "node=2:wheel-drag:wheel=rear-left",
            "wheel-drag: has no value",
        ),
        (
            "node=2:wheel-drag=-1:wheel=rear-left",
            "wheel-drag: -1 is not a value",
        ),
        (
            "node=2:encoder-noise=1e300:wheel=rear-left",
            "encoder-noise: 1e300 is not a value; write encoder-noise=VALUE, pulses per second, 0 \
             to 1e7",
        ),
        (
            "node=2:wheel-push=-1.1e7:wheel=rear-left",
            "wheel-push: 1.1e7 is not a value",
        ),
        (
            "node=2:halt",
            "halt: native robots have no processor; serve with --backend emulator",
        ),
    ] {
        let error = parse(text).unwrap_err();
        assert!(error.starts_with(wanted), "{text}: {error}");
    }
}

#[test]
fn faults_begin_and_end_at_their_time() {
    let group = group();
    let mut world = World::new(&group, Backend::Native, Options::default()).unwrap();
    let mut schedule = Schedule::default();
    for text in [
        "t=0.02:node=3:power-cycle",
        "t=0.0100004:node=2:emergency-stop:for=0.005",
        "node=4:overrun",
    ] {
        schedule.add(&parse(text).unwrap(), 1_000_000);
    }
    let mut seen = Vec::new();
    schedule
        .run_until(&mut world, 200_000_000, &mut |at, what| {
            seen.push((at, what.to_string()));
        })
        .unwrap();
    let wanted = [
        (1_000_000, "node 4: overrun"),
        // The first whole microsecond that is not earlier.
        (10_001_000, "node 2: emergency-stop"),
        (15_001_000, "node 2: emergency-stop=off"),
        (20_000_000, "node 3: power-cycle"),
        (120_000_000, "node 3: power-on"),
    ];
    assert_eq!(seen, wanted.map(|(at, what)| (at, what.to_owned())));
    assert_eq!(world.now_ns(), 200_000_000);
}

/// A robot that boots says so with its heartbeat's first byte 0, at power-on and after a power
/// cycle.
#[test]
fn a_power_cycle_boots_the_robot_again() {
    let group = group();
    let mut world = World::new(&group, Backend::Native, Options::default()).unwrap();
    let mut schedule = Schedule::default();
    schedule.add(&parse("t=0.5:node=3:power-cycle:for=0.25").unwrap(), 0);
    schedule
        .run_until(&mut world, 1_000_000_000, &mut |_, _| {})
        .unwrap();
    let mut received = Vec::new();
    while let Some((at, frame)) = world.take_received(MASTER) {
        if frame.id() == 0x703 {
            received.push((at.0, frame.data()[0]));
        }
    }
    let boots: Vec<u64> = received
        .iter()
        .filter(|(_, s)| *s == 0)
        .map(|(at, _)| *at)
        .collect();
    // 3 ms from power to the first instruction, and the frame's own time, which two others may
    // delay.
    assert_eq!(boots.len(), 2, "{boots:?}");
    assert!((3_000..3_500).contains(&boots[0]), "{boots:?}");
    assert!((753_000..753_500).contains(&boots[1]), "{boots:?}");
    let silent = |(at, _): &&(u64, u8)| (500_000..753_000).contains(at);
    assert_eq!(received.iter().find(silent), None);
}
