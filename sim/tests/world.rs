//! The world with robots that do one simple thing: bus order and times, wheels and encoders, truth.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use canopen::{Frame, Micros};
use group::GroupFile;
use omnibus_sim::motor::Bridge;
use omnibus_sim::robot::{Robot, Wake};
use omnibus_sim::{Options, SimError, World, plant};

/// What a [`Puppet`] saw and what it shall do.
#[derive(Default)]
struct Strings {
    send: VecDeque<Frame>,
    received: Vec<(u64, Frame)>,
    counts: [i64; 4],
    duty: f64,
    lost: u32,
    driver_fault: bool,
}

/// A robot on strings: sends what it is given, drives all wheels at one duty.
struct Puppet {
    strings: Arc<Mutex<Strings>>,
    now_ns: u64,
}

impl Robot for Puppet {
    fn run_until(&mut self, time_ns: u64) -> Result<(), SimError> {
        assert!(time_ns > self.now_ns, "time only goes forward");
        self.now_ns = time_ns;
        Ok(())
    }
    fn wake(&self) -> Wake {
        Wake::Never
    }
    fn pending(&self) -> Option<Frame> {
        self.strings.lock().unwrap().send.front().copied()
    }
    fn transmitted(&mut self) {
        self.strings.lock().unwrap().send.pop_front();
    }
    fn lost_arbitration(&mut self) {
        self.strings.lock().unwrap().lost += 1;
    }
    fn receive(&mut self, frame: &Frame) {
        self.strings
            .lock()
            .unwrap()
            .received
            .push((self.now_ns, *frame));
    }
    fn drives(&self) -> [Bridge; 4] {
        let duty = self.strings.lock().unwrap().duty;
        [Bridge {
            duty,
            enabled: true,
            brake_released: true,
        }; 4]
    }
    fn turn_encoders(&mut self, counts: [i32; 4]) {
        let mut strings = self.strings.lock().unwrap();
        for (sum, count) in strings.counts.iter_mut().zip(counts) {
            *sum += i64::from(count);
        }
    }
    fn set_emergency_stop(&mut self, _: bool) {}
    fn set_driver_fault(&mut self, fault: bool) {
        self.strings.lock().unwrap().driver_fault = fault;
    }
    fn set_power(&mut self, _: bool) {}
}

fn world(name: &str) -> (World, Vec<Arc<Mutex<Strings>>>) {
    simulated(name, "")
}

/// With more lines in the `[simulation]` table.
fn simulated(name: &str, lines: &str) -> (World, Vec<Arc<Mutex<Strings>>>) {
    let path = format!("{}/../groups/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).unwrap();
    let text = text.replace("[simulation]\n", &format!("[simulation]\n{lines}\n"));
    let group = GroupFile::parse(name, &text).unwrap();
    let strings: Vec<_> = group.robots.iter().map(|_| Arc::default()).collect();
    let robots = strings.iter().map(|strings: &Arc<Mutex<Strings>>| {
        Box::new(Puppet {
            strings: strings.clone(),
            now_ns: 0,
        }) as Box<dyn Robot>
    });
    let robots = robots.collect();
    let options = Options::default();
    let plant = plant::build(&group, options.start).unwrap();
    (
        World::with_parts(&group, robots, plant, options).unwrap(),
        strings,
    )
}

fn frame(id: u16) -> Frame {
    Frame::new(id, &[]).unwrap()
}

/// Three frames wait at time 0. They go out by identifier; 0 takes 50 bits and 3 of intermission,
/// the others 0x555's length of 45 and 0x556's, which differs only in its CRC.
#[test]
fn frames_go_out_by_identifier_and_take_their_bits() {
    let (mut world, strings) = world("tcc-2");
    strings[0].lock().unwrap().send.push_back(frame(0x555));
    strings[1].lock().unwrap().send.push_back(frame(0));
    world.send(frame(0x556));
    assert_eq!(
        world.receive(Micros(1_000)),
        Ok(Some((Micros(50), frame(0))))
    );
    assert_eq!(
        world.receive(Micros(1_000)),
        Ok(Some((Micros(50 + 3 + 45), frame(0x555))))
    );
    assert_eq!(world.receive(Micros(1_000)), Ok(None));
    assert_eq!(world.now(), Micros(1_000));
    let first = strings[0].lock().unwrap();
    let received: Vec<_> = first.received.iter().map(|(at, f)| (*at, f.id())).collect();
    assert_eq!(received[0], (50_000, 0));
    assert_eq!(received[1].1, 0x556);
    assert_eq!(received.len(), 2);
    assert_eq!(first.lost, 1);
    assert_eq!(world.frames(), 3);
}

#[test]
fn the_masters_frames_keep_their_order() {
    let (mut world, strings) = world("single");
    for id in [0x700, 0x100, 0x300] {
        world.send(frame(id));
    }
    world.run_until(Micros(1_000)).unwrap();
    let received: Vec<_> = strings[0]
        .lock()
        .unwrap()
        .received
        .iter()
        .map(|(_, f)| f.id())
        .collect();
    assert_eq!(received, [0x700, 0x100, 0x300]);
}

#[test]
fn a_pulled_connector_neither_hears_nor_speaks() {
    let (mut world, strings) = world("tcc-2");
    world.set_connected(0, false);
    strings[0].lock().unwrap().send.push_back(frame(1));
    world.send(frame(2));
    world.run_until(Micros(1_000)).unwrap();
    assert!(strings[0].lock().unwrap().received.is_empty());
    assert_eq!(strings[1].lock().unwrap().received.len(), 1);
    world.set_connected(0, true);
    world.run_until(Micros(2_000)).unwrap();
    assert_eq!(strings[1].lock().unwrap().received.len(), 2);
}

/// A robot's frame of 44 bits is on the wire when another program joins at 20 us: it stays the
/// robot's own. One that receives its own frame takes it for another robot's.
#[test]
fn a_program_that_joins_within_a_frame_does_not_change_whose_it_is() {
    let (mut world, strings) = world("tcc-2");
    strings[1].lock().unwrap().send.push_back(frame(0x183));
    world.run_until(Micros(20)).unwrap();
    let port = world.add_port();
    world.run_until(Micros(1_000)).unwrap();
    let received = |robot: usize| strings[robot].lock().unwrap().received.len();
    assert_eq!((received(0), received(1)), (1, 0));
    assert!(strings[1].lock().unwrap().send.is_empty());
    assert_eq!(world.take_received(port).unwrap().1, frame(0x183));
    assert_eq!(world.take_received(port), None);
}

/// A duty that ends at 10 rad/s: after 4 s the rate is there, the encoders agree with the wheels to
/// a count, and the robots have gone forward by wheel angle times radius times Table 3's ratio.
#[test]
fn duty_turns_wheels_and_wheels_move_the_group() {
    let (mut world, strings) = world("tcc-3");
    // tcc-3's motor: static 0.015625, per rad/s 0.8/24 + 0.02 * 0.015625.
    for strings in &strings {
        strings.lock().unwrap().duty = 0.015_625 + 10.0 * (0.8 / 24.0 + 0.02 * 0.015_625);
    }
    world.run_until(Micros(4_000_000)).unwrap();
    let truth = world.truth();
    for (robot, strings) in truth.robots.iter().zip(&strings) {
        for (rate, (angle, counts)) in <[f64; 4]>::from(robot.wheel_rates).into_iter().zip(
            robot
                .wheel_angles
                .into_iter()
                .zip(strings.lock().unwrap().counts),
        ) {
            assert!((rate - 10.0).abs() < 1e-4, "{rate}");
            assert_eq!(
                counts,
                (angle * 40_000.0 / std::f64::consts::TAU).floor() as i64
            );
        }
    }
    // 10 rad/s is 1.524 m/s, past the table's last row.
    let samples = world.take_truth();
    assert_eq!(samples.len(), 400);
    let (a, b) = (&samples[299], &samples[399]);
    assert_eq!((a.time_ns, b.time_ns), (3_000_000_000, 4_000_000_000));
    let speed = b.group.x - a.group.x;
    assert!((speed - 1.524 * 498.905 / 500.0).abs() < 1e-4, "{speed}");
    assert!(world.worst_shape_error_mm() < 1e-6);
}

/// A frame a millisecond of 48 bits and intermission: 4.8 %.
#[test]
fn load_is_the_bits_that_were_sent() {
    let (mut world, _) = world("single");
    for millisecond in 0..100 {
        world.send(frame(0x555));
        world.run_until(Micros((millisecond + 1) * 1_000)).unwrap();
    }
    let load = world.bus_load();
    assert!((load.mean - 0.048).abs() < 1e-12, "{load:?}");
    assert!((load.largest - 0.048).abs() < 1e-12, "{load:?}");
    assert!(
        (world.truth().bus_load - 0.0).abs() < 1e-12,
        "a sample was just taken"
    );
}

#[test]
fn equal_runs_have_equal_digests() {
    let run = |id| {
        let (mut world, strings) = world("tcc-2");
        strings[0].lock().unwrap().send.push_back(frame(id));
        world.run_until(Micros(10_000)).unwrap();
        world.digest()
    };
    assert_eq!(run(5), run(5));
    assert_ne!(run(5), run(6));
}

#[test]
fn the_log_is_candumps() {
    #[derive(Clone, Default)]
    struct Shared(Arc<Mutex<Vec<u8>>>);
    impl std::io::Write for Shared {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let (mut world, _) = world("single");
    let log = Shared::default();
    world.log_candump(Box::new(log.clone()));
    world.send(Frame::new(0x080, &[1]).unwrap());
    world.run_until(Micros(1_000)).unwrap();
    world.finish_candump().unwrap();
    // 56 bits, counted in the bus's own tests.
    assert_eq!(
        String::from_utf8(log.0.lock().unwrap().clone()).unwrap(),
        "(0.000056) can0 080#01\n"
    );
}

/// The duty that holds 10 rad/s from 24 V (static 0.015625, per rad/s 0.8/24 + 0.02 * 0.015625)
/// draws `i = (1 + 0.02 * 10) / 0.8 = 1.5 A` a motor. From a battery of 1 ohm the rate is where
/// motor and sag agree: `d U = 0.8 w + 0.3 i`, `U = 24 - 4 d i`, `i = (1 + 0.02 w) / 0.8`.
#[test]
fn a_battery_sags_under_its_motors() {
    let (mut world, strings) = simulated("single", "battery = { resistance = 1 }");
    let duty = 0.015_625 + 10.0 * (0.8 / 24.0 + 0.02 * 0.015_625);
    strings[0].lock().unwrap().duty = duty;
    world.run_until(Micros(6_000_000)).unwrap();
    let rate = world.truth().robots[0].wheel_rates.front_left;
    // Linear in w: i = i0 + i1 w.
    let (i0, i1) = (1.0 / 0.8, 0.02 / 0.8);
    let expected =
        (24.0 * duty - (0.3 + 4.0 * duty * duty) * i0) / (0.8 + (0.3 + 4.0 * duty * duty) * i1);
    assert!(expected < 9.5, "{expected}");
    assert!((rate - expected).abs() < 1e-3, "{rate} {expected}");
}

/// 2 degrees of play: a wheel that is driven lags half of it behind its motor, which the encoder is
/// on.
#[test]
fn play_lies_between_encoder_and_wheel() {
    let (mut world, strings) = simulated("single", "backlash_deg = 2.0");
    strings[0].lock().unwrap().duty = 0.3;
    world.run_until(Micros(1_000_000)).unwrap();
    let lag = |world: &World| {
        let truth = &world.truth().robots[0];
        let count = std::f64::consts::TAU / 40_000.0;
        strings[0].lock().unwrap().counts[2] as f64 * count - truth.wheel_angles[2]
    };
    let half = 1.0f64.to_radians();
    let count = std::f64::consts::TAU / 40_000.0;
    assert!((lag(&world) - half).abs() < count, "{}", lag(&world));
    strings[0].lock().unwrap().duty = -0.3;
    world.run_until(Micros(4_000_000)).unwrap();
    assert!((lag(&world) + half).abs() < count, "{}", lag(&world));
}

/// The front right encoder of node 3 breaks after half a second, its rear left one loses a channel;
/// no other's do.
#[test]
fn encoders_break_at_their_time() {
    let (mut world, strings) = simulated(
        "tcc-2",
        "encoder_faults = [\
         { node = 3, wheel = \"front-right\", kind = \"dead\", at = 0.5 }, \
         { node = 3, wheel = \"rear-left\", kind = \"one-channel\", at = 0.5 }]",
    );
    for strings in &strings {
        strings.lock().unwrap().duty = 0.3;
    }
    world.run_until(Micros(500_000)).unwrap();
    let at_half = strings[1].lock().unwrap().counts;
    assert!(
        at_half.iter().all(|n| *n == at_half[0] && *n > 100),
        "{at_half:?}"
    );
    world.run_until(Micros(1_000_000)).unwrap();
    let (whole, broken) = (
        strings[0].lock().unwrap().counts,
        strings[1].lock().unwrap().counts,
    );
    assert!(whole.iter().all(|n| *n > 2 * at_half[0]), "{whole:?}");
    assert_eq!(broken[0], whole[0]);
    assert_eq!(broken[1], at_half[1]);
    assert!(
        (broken[2] - at_half[2]).abs() <= 1,
        "{broken:?} {at_half:?}"
    );
}

/// Noise has a seed: equal seeds, equal counts; another seed, other counts.
#[test]
fn noise_comes_from_the_seed() {
    let counts = |seed: u32| {
        let lines = "encoder = { lost = 0.01, extra_per_s = 50 }";
        let path = format!("{}/../groups/single.toml", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(path).unwrap();
        assert!(text.contains("seed = 1"));
        let text = text
            .replace("[simulation]\n", &format!("[simulation]\n{lines}\n"))
            .replace("seed = 1", &format!("seed = {seed}"));
        let group = GroupFile::parse("single", &text).unwrap();
        let strings: Arc<Mutex<Strings>> = Arc::default();
        strings.lock().unwrap().duty = 0.3;
        let robot = Box::new(Puppet {
            strings: strings.clone(),
            now_ns: 0,
        });
        let options = Options::default();
        let plant = plant::build(&group, options.start).unwrap();
        let mut world = World::with_parts(&group, vec![robot], plant, options).unwrap();
        world.run_until(Micros(1_000_000)).unwrap();
        strings.lock().unwrap().counts
    };
    assert_eq!(counts(5), counts(5));
    assert_ne!(counts(5), counts(6));
    let four = counts(5);
    assert!(four.iter().any(|n| *n != four[0]), "{four:?}");
}

/// The same wheel, driven for a second, as a robot counts it whose encoder has noise on its wires.
/// Pulses on driven wires leave the count where it is but for four a pulse that lies across an
/// edge: of 1000 a second, 60 ns long, with some 10 000 edges a second that is one or two. Strikes
/// on open wires are a count each: 1000 within 4 sqrt(1000), so their sum lies within 4 sqrt(1000)
/// of nothing.
#[test]
fn noise_on_the_wires_of_an_encoder_counts_only_where_they_are_open() {
    let (mut world, strings) = world("single");
    strings[0].lock().unwrap().duty = 0.3;
    for wheel in [0, 1] {
        world.set_encoder_noise(0, wheel, 1_000.0);
    }
    world.set_encoder(0, 1, omnibus_sim::EncoderState::Dead);
    world.run_until(Micros(1_000_000)).unwrap();
    let [noisy, open, whole, _] = strings[0].lock().unwrap().counts;
    assert!(whole > 5_000, "{whole}");
    assert!((noisy - whole).abs() <= 40, "{noisy} {whole}");
    assert!(open != 0 && open.abs() < 130, "{open}");
}

/// A driver that trips at 60 A: a wheel that is held draws (24 V - 0) 0.9 / 0.3 ohm = 72 A with 1
/// ms of winding, so after R/L t = -ln(1 - 60/72) = 1.8 ms the bridges are off.
#[test]
fn a_driver_trips_at_its_current() {
    let (mut world, strings) = world("single");
    world.set_wheel_drag(0, 0, 1e3);
    world.set_driver_trip(0, Some(60.0));
    strings[0].lock().unwrap().duty = 0.9;
    let current = |world: &World| world.truth().robots[0].currents[0];
    world.run_until(Micros(1_700)).unwrap();
    let before = current(&world);
    assert!((50.0..60.0).contains(&before), "{before}");
    world.run_until(Micros(2_100)).unwrap();
    assert_eq!(world.truth().robots[0].currents, [0.0; 4]);
    assert!(strings[0].lock().unwrap().driver_fault);
    world.set_driver_trip(0, None);
    assert!(!strings[0].lock().unwrap().driver_fault);
    world.run_until(Micros(100_000)).unwrap();
    assert!((current(&world) - 72.0).abs() < 0.1, "{}", current(&world));
}

/// A cable broken before the second of three: frames of both halves go at the same time and stay in
/// their half. Repaired, all receive all.
#[test]
fn a_parted_bus_is_two() {
    let (mut world, strings) = world("tcc-3");
    let send = |place: usize, id: u16| strings[place].lock().unwrap().send.push_back(frame(id));
    let received = |place: usize| -> Vec<(u64, u16)> {
        let received = std::mem::take(&mut strings[place].lock().unwrap().received);
        received.iter().map(|(at, f)| (*at, f.id())).collect()
    };
    world.set_partition(Some(1));
    send(0, 0x555);
    send(1, 0x555);
    world.run_until(Micros(1_000)).unwrap();
    // 45 bits, see above, on both at once.
    let (master, _) = world.take_received(omnibus_sim::MASTER).unwrap();
    assert_eq!(master, Micros(45));
    assert_eq!(world.take_received(omnibus_sim::MASTER), None);
    assert_eq!(
        (received(0), received(1), received(2)),
        (vec![], vec![], vec![(45_000, 0x555)])
    );
    assert_eq!(world.frames(), 2);
    world.set_partition(None);
    send(2, 0x556);
    world.run_until(Micros(2_000)).unwrap();
    assert_eq!(
        (received(0).len(), received(1).len(), received(2).len()),
        (1, 1, 0)
    );
}

/// Alone in its half a robot gets no acknowledge and sends for ever; what was on the wire when the
/// cable broke is an error frame for those who heard it.
#[test]
fn a_robot_alone_behind_a_broken_cable_is_not_heard() {
    let (mut world, strings) = world("tcc-2");
    strings[1].lock().unwrap().send.push_back(frame(0x555));
    world.run_until(Micros(20)).unwrap();
    world.set_partition(Some(1));
    world.run_until(Micros(3_000)).unwrap();
    assert_eq!(world.take_received(omnibus_sim::MASTER), None);
    assert_eq!(strings[0].lock().unwrap().received, []);
    assert_eq!(strings[1].lock().unwrap().send.len(), 1);
    assert!(world.error_frames() > 10, "{}", world.error_frames());
    world.set_partition(None);
    world.run_until(Micros(4_000)).unwrap();
    assert!(world.take_received(omnibus_sim::MASTER).is_some());
    assert_eq!(strings[1].lock().unwrap().send.len(), 0);
}
