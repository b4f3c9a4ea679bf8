//! NMT, heartbeat and SYNC.

use super::*;

#[test]
fn boots_with_one_frame_into_pre_operational() {
    let mut bench = Bench::cold(CONFIG);
    assert_eq!(bench.device.state(), NmtState::Initialising);
    assert_eq!(bench.device.next_deadline(), Some(Micros::ZERO));
    bench.receive(0, [1, 0]); // Not on the bus yet.
    bench.poll();
    assert_eq!(bench.frames(), [Frame::of(0x705, [0])]);
    assert_eq!(bench.device.state(), NmtState::PreOperational);
    assert_eq!(
        bench.events(),
        [Event::NmtChanged {
            from: NmtState::Initialising,
            to: NmtState::PreOperational
        }]
    );
}

#[test]
fn without_a_node_id_nothing_is_sent_or_obeyed() {
    let mut bench = Bench::cold(Config {
        node: None,
        ..CONFIG
    });
    bench.pass(1_000);
    bench.receive(0, [1, 0]);
    bench.receive(0x80, []);
    bench.pass(1_000);
    assert_eq!(bench.frames(), []);
    assert_eq!(bench.device.state(), NmtState::Initialising);
}

#[test]
fn every_nmt_command_leads_to_its_state_from_every_state() {
    use NmtState::*;
    for first in [1, 2, 128] {
        for (command, state) in [(1, Operational), (2, Stopped), (128, PreOperational)] {
            for node in [0, 5] {
                let mut bench = Bench::booted(CONFIG);
                bench.receive(0, [first, 0]);
                bench.receive(0, [command, node]);
                assert_eq!(bench.device.state(), state);
            }
        }
        for (command, scope) in [
            (129, ResetScope::Application),
            (130, ResetScope::Communication),
        ] {
            let mut bench = Bench::booted(CONFIG);
            bench.receive(0, [first, 0]);
            bench.poll();
            bench.frames();
            bench.receive(0, [command, 5]);
            bench.poll();
            assert_eq!(bench.device.state(), PreOperational);
            assert_eq!(bench.frames(), [Frame::of(0x705, [0])]);
            assert_eq!(bench.app.resets, [scope]);
        }
    }
}

#[test]
fn commands_for_others_and_malformed_ones_are_ignored() {
    let mut bench = Bench::booted(CONFIG);
    bench.receive(0, [1, 6]);
    bench.receive(0, [1]);
    bench.receive(0, [1, 5, 0]);
    bench.receive(0, [7, 5]);
    assert_eq!(bench.device.state(), NmtState::PreOperational);
    assert_eq!(bench.events(), []);
}

#[test]
fn a_repeated_start_is_reported_though_nothing_changes() {
    let mut bench = Bench::operational(CONFIG);
    bench.receive(0, [1, 5]);
    assert_eq!(bench.events(), [Event::NmtCommand(NmtCommand::Start)]);
}

#[test]
fn reset_communication_brings_its_objects_back() {
    let mut bench = Bench::booted(CONFIG);
    bench.write(0x1017, 0, &[0x10, 0x27]).unwrap();
    bench.write(0x1400, 2, &[255]).unwrap();
    bench.receive(0, [130, 0]);
    bench.poll();
    bench.frames();
    assert_eq!(bench.read(0x1017, 0), Ok(std::vec![100, 0]));
    assert_eq!(bench.read(0x1400, 2), Ok(std::vec![1]));
}

fn with_serial(serial: u32) -> Config {
    let identity = crate::Identity {
        serial,
        ..CONFIG.identity
    };
    Config { identity, ..CONFIG }
}

/// Two devices with one node-ID that boot together must receive each other's heartbeats:
/// neighbouring serial numbers send their first heartbeats far apart, in the second half of the
/// period.
#[test]
fn the_first_heartbeat_depends_on_the_serial_number() {
    let firsts = [1, 2, 3, 4, 5, 0x1234_5678, u32::MAX].map(|serial| {
        let mut bench = Bench::booted(with_serial(serial));
        let mut millis = 0_u32;
        while bench.frames().is_empty() {
            bench.pass(1);
            millis += 1;
        }
        bench.pass(99);
        assert!(bench.frames().is_empty());
        bench.pass(1);
        assert_eq!(bench.frames().len(), 1, "the second a whole period later");
        millis
    });
    for (n, first) in firsts.iter().enumerate() {
        assert!((50..=100).contains(first), "{firsts:?}");
        let apart = |other: &u32| first.abs_diff(*other) >= 2;
        assert!(firsts[..n].iter().all(apart), "{firsts:?}");
    }
}

#[test]
fn heartbeats_come_in_step_with_their_period_and_carry_the_state() {
    // Booted at 1 ms, period 100 ms, a serial number that does not shorten the first.
    let mut bench = Bench::booted(with_serial(0));
    bench.pass(99);
    assert_eq!(bench.frames(), []);
    bench.pass(1);
    assert_eq!(bench.frames(), [Frame::of(0x705, [0x7F])]);
    bench.receive(0, [1, 0]);
    bench.pass(100);
    assert_eq!(bench.frames(), [Frame::of(0x705, [5])]);
    bench.receive(0, [2, 0]);
    bench.pass(1_000);
    assert_eq!(bench.frames(), [Frame::of(0x705, [4]); 10]);
}

#[test]
fn a_new_heartbeat_period_counts_from_its_writing() {
    let mut bench = Bench::booted(CONFIG);
    bench.pass(50);
    bench.write(0x1017, 0, &[20, 0]).unwrap();
    bench.pass(20);
    assert_eq!(bench.frames(), [Frame::of(0x705, [0x7F])]);
    bench.write(0x1017, 0, &[0, 0]).unwrap();
    bench.pass(1_000);
    assert_eq!(bench.frames(), []);
}

#[test]
fn a_late_poll_does_not_send_the_heartbeats_it_missed() {
    let mut bench = Bench::booted(CONFIG);
    bench.now = bench.now + Micros::from_millis(1_050);
    bench.poll();
    bench.poll();
    assert_eq!(bench.frames(), [Frame::of(0x705, [0x7F])]);
}

#[test]
fn a_consumer_waits_for_the_first_heartbeat_then_misses_it_once() {
    let node = NodeId::MIN;
    let mut bench = Bench::booted(CONFIG);
    bench.pass(1_000);
    assert_eq!(bench.events(), []);
    bench.receive(0x701, [5]);
    bench.pass(249);
    bench.receive(0x701, [5]);
    bench.pass(249);
    let state = NmtState::Operational;
    assert_eq!(bench.events(), [Event::HeartbeatStarted { node, state }]);
    bench.pass(1);
    assert_eq!(bench.events(), [Event::HeartbeatLost { node }]);
    bench.pass(1_000);
    assert_eq!(bench.events(), []);
    bench.receive(0x701, [0]);
    let state = NmtState::Initialising;
    assert_eq!(bench.events(), [Event::HeartbeatStarted { node, state }]);
    assert_eq!(bench.device.counters().heartbeats_lost, 1);
}

/// More is lost in one poll than events can wait: that the device has left OPERATIONAL is among
/// those that wait.
#[test]
fn the_state_that_follows_from_many_lost_heartbeats_is_reported() {
    let mut bench = Bench::booted(Config {
        error_behaviour: 0,
        consumers: &[],
        ..CONFIG
    });
    for node in 1..=17u8 {
        let sender = 0x20 + node;
        bench
            .write(0x1016, node, &[100, 0, sender, 0])
            .unwrap_or_else(|code| panic!("{node}: {code:#x}"));
    }
    bench.receive(0, [1, 5]);
    for node in 1..=17 {
        bench.receive(0x720 + node, [5]);
    }
    bench.events();
    bench.now = bench.now + Micros::from_millis(100);
    bench.poll();
    let changed = Event::NmtChanged {
        from: NmtState::Operational,
        to: NmtState::PreOperational,
    };
    assert_eq!(bench.device.state(), NmtState::PreOperational);
    assert!(bench.events().contains(&changed));
}

#[test]
fn a_heartbeat_is_still_heard_when_stopped() {
    let mut bench = Bench::booted(CONFIG);
    bench.receive(0, [2, 0]);
    bench.receive(0x701, [5]);
    bench.pass(250);
    assert!(
        bench
            .events()
            .contains(&Event::HeartbeatLost { node: NodeId::MIN })
    );
}

#[test]
fn one_node_can_be_monitored_once_only() {
    let mut bench = Bench::booted(CONFIG);
    let node_1 = [100, 0, 1, 0];
    assert_eq!(bench.write(0x1016, 2, &node_1), Err(0x0604_0043));
    assert_eq!(bench.write(0x1016, 1, &node_1), Ok(()));
    assert_eq!(bench.write(0x1016, 2, &[0, 0, 1, 0]), Ok(()));
    assert_eq!(bench.write(0x1016, 18, &node_1), Err(0x0609_0011));
    bench.receive(0x701, [5]);
    bench.pass(100);
    assert!(
        bench
            .events()
            .contains(&Event::HeartbeatLost { node: NodeId::MIN })
    );
}

#[test]
fn sync_is_reported_with_counter_and_time() {
    let mut bench = Bench::booted(CONFIG);
    bench.receive(0x80, []);
    bench.receive(0x80, [7]);
    let sync = |counter| ReceivedSync {
        counter,
        at: Micros(1_000),
        applied: RpdoSet::default(),
    };
    let both = [sync(None), sync(Some(7))];
    assert_eq!(bench.app.syncs, both);
    bench.receive(0x80, [7, 0]);
    assert_eq!(bench.app.syncs, both);
    bench.receive(0, [2, 0]);
    bench.receive(0x80, []);
    assert_eq!(bench.app.syncs, both);
}

#[test]
fn frames_for_no_service_and_heartbeats_reach_the_application_once() {
    let mut bench = Bench::operational(CONFIG);
    let status = Frame::of(0x186, [1, 2]);
    let malformed = Frame::of(0x706, [5, 5]);
    for frame in [
        status,
        malformed,
        Frame::of(0x706, [5]),
        Frame::of(0x80, []),
        Frame::of(0x605, [0x40, 0, 0x10, 0, 0, 0, 0, 0]),
        Frame::of(0x7E4, [0; 8]),
        Frame::of(0x7E5, [0; 8]),
        Frame::of(0, [2, 0]),
        status,
    ] {
        bench.device.on_frame(bench.now, &frame, &mut bench.app);
    }
    let operational = NmtState::Operational;
    let others = [status, malformed].map(|frame| (frame, operational));
    let [first, second] = others;
    assert_eq!(
        bench.app.others,
        [first, second, (status, NmtState::Stopped)]
    );
    let six = NodeId::new(6).unwrap();
    assert_eq!(bench.app.heartbeats, [(six, operational)]);
    assert_eq!(bench.app.syncs.len(), 1);
}

#[test]
fn a_gap_in_the_counter_is_seen_and_its_turn_over_is_not_one() {
    let gaps = |config: Config, counters: &[u8]| {
        let mut bench = Bench::booted(config);
        let mut gaps = Vec::new();
        for counter in counters {
            bench.receive(0x80, [*counter]);
            gaps.extend(bench.events().into_iter().filter_map(|event| match event {
                Event::SyncGap { expected, received } => Some((expected, received)),
                _ => None,
            }));
        }
        assert_eq!(bench.device.counters().sync_gaps, gaps.len() as u32);
        gaps
    };
    let config = Config {
        sync_overflow: 10,
        ..CONFIG
    };
    assert_eq!(gaps(config, &[8, 9, 10, 1, 2]), []);
    assert_eq!(gaps(config, &[1, 2, 4, 5]), [(3, 4)]);
    assert_eq!(gaps(config, &[10, 2]), [(1, 2)]);
    assert_eq!(gaps(config, &[3, 3]), [(4, 3)]);
    assert_eq!(gaps(CONFIG, &[239, 240, 1]), []);
}

#[test]
fn sync_follows_its_identifier() {
    let mut bench = Bench::booted(CONFIG);
    assert_eq!(bench.write(0x1005, 0, &[0x01, 6, 0, 0]), Err(0x0609_0030));
    assert_eq!(
        bench.write(0x1005, 0, &[0x80, 0, 0, 0x20]),
        Err(0x0609_0030)
    );
    bench.write(0x1005, 0, &[0x90, 0, 0, 0]).unwrap();
    bench.receive(0x80, []);
    assert_eq!(bench.app.syncs, []);
    bench.receive(0x90, []);
    assert_eq!(bench.app.syncs.len(), 1);
}

/// CiA 301, 7.5.2.5: "do not care".
#[test]
fn bit_31_of_the_sync_identifier_means_nothing() {
    let mut bench = Bench::booted(CONFIG);
    bench.write(0x1005, 0, &[0x90, 0, 0, 0x80]).unwrap();
    assert_eq!(bench.read(0x1005, 0), Ok(std::vec![0x90, 0, 0, 0]));
    bench.receive(0x90, []);
    assert_eq!(bench.app.syncs.len(), 1);
    bench.write(0x1006, 0, &10_000u32.to_le_bytes()).unwrap();
    bench.write(0x1005, 0, &[0x90, 0, 0, 0xC0]).unwrap();
    bench.pass(10);
    assert!(bench.frames().contains(&Frame::of(0x90, [])));
    // With it or without it, the identifier of a producer stays.
    assert_eq!(bench.write(0x1005, 0, &[0x90, 0, 0, 0x40]), Ok(()));
    assert_eq!(
        bench.write(0x1005, 0, &[0x80, 0, 0, 0xC0]),
        Err(0x0609_0030)
    );
}

#[test]
fn a_producer_sends_sync_and_takes_its_own() {
    let mut bench = Bench::booted(Config {
        heartbeat_ms: 0,
        ..CONFIG
    });
    bench.write(0x1019, 0, &[3]).unwrap();
    bench.write(0x1006, 0, &10_000u32.to_le_bytes()).unwrap();
    assert_eq!(bench.write(0x1019, 0, &[0]), Err(0x0800_0022));
    bench.write(0x1005, 0, &[0x80, 0, 0, 0x40]).unwrap();
    // While it produces its identifier stays.
    assert_eq!(
        bench.write(0x1005, 0, &[0x90, 0, 0, 0x40]),
        Err(0x0609_0030)
    );
    bench.receive(0, [1, 0]);
    bench.receive(0x181, [7, 0]);
    bench.events();
    bench.pass(50);
    let frames = bench.frames();
    let syncs: Vec<_> = frames.iter().filter(|frame| frame.id() == 0x80).collect();
    assert_eq!(
        syncs
            .iter()
            .map(|frame| frame.data()[0])
            .collect::<Vec<_>>(),
        [1, 2, 3, 1, 2]
    );
    assert_eq!(frames.len(), 10, "a TPDO for each: {frames:?}");
    assert_eq!(bench.app.setpoint, 7);
    bench.receive(0, [2, 0]);
    bench.pass(50);
    assert_eq!(bench.frames(), []);
    bench.receive(0, [1, 0]);
    bench.pass(10);
    assert_eq!(bench.frames()[0], Frame::of(0x80, [1]));
}

#[test]
fn a_device_may_start_itself() {
    let mut bench = Bench::cold(Config {
        startup: 0,
        ..CONFIG
    });
    bench.poll();
    assert_eq!(bench.frames()[0], Frame::of(0x705, [0]));
    assert_eq!(bench.device.state(), NmtState::Operational);
    assert_eq!(bench.write(0x1F80, 0, &[1, 0, 0, 0]), Err(0x0609_0030));
    assert_eq!(bench.write(0x1F80, 0, &[4, 0, 0, 0]), Ok(()));
}
