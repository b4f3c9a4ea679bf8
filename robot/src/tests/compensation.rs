//! Compensation tables in a robot: accepted as a whole or not at all, used in the tick, saved.

use std::boxed::Box;
use std::vec::Vec;

use canopen::{NmtCommand, NodeId};
use control::time::Micros;
use kinematics::Twist;
use protocol::address as at;
use protocol::compensation::{EMPTY, LENGTH_MAX, Row, Tables};

use super::world::World;
use crate::{BusSide, IMAGE_MAX, Identity, Stored};

const INVALID: u32 = 0x0609_0030;
const TOO_LOW: u32 = 0x0609_0032;
const TOO_LONG: u32 = 0x0607_0012;
const TOO_SHORT: u32 = 0x0607_0013;
const INCOMPATIBLE: u32 = 0x0604_0043;
const STATE: u32 = 0x0800_0022;

const TABLES: Tables<'_> = Tables {
    version: 20_261_121,
    longitudinal: &[],
    lateral: &[
        Row::new(0.1, 1.141),
        Row::new(0.3, 1.151),
        Row::new(0.5, 1.157),
    ],
    oblique: &[],
    yaw: &[],
};

fn set(tables: &Tables<'_>) -> Vec<u8> {
    let mut bytes = [0; LENGTH_MAX];
    let length = tables.encode(&mut bytes).unwrap();
    bytes[..length].to_vec()
}

#[test]
fn the_tick_uses_the_table_both_ways() {
    let mut world = World::new(&[2]);
    world.configure();
    assert_eq!(
        world.write_block(2, at::COMPENSATION_SET, &set(&TABLES)),
        Ok(())
    );
    world.start();
    world.run(30);
    // Sideways at 45 degrees all wheels turn with the speed that is asked for at the rim. The
    // controller follows to 0.1 %, a coefficient is kept to 1e-4.
    for (speed, coefficient) in [(0.1, 1.141), (0.3, 1.151), (0.5, 1.157), (0.7, 1.157)] {
        world.drive(Twist::new(0.0, speed, 0.0), 1500);
        let report = world.robots[0].control.report();
        let rate = report.rates_ref().front_right;
        let want = speed * coefficient / 0.1524;
        assert!((rate / want - 1.0).abs() < 2e-4, "{speed}: {rate}, {want}");
        // An encoder of 4096 counts shows 0.1 m/s to 1.5 % from tick to tick; the mean is what
        // counts.
        let twist = Twist::new(0.0, speed, 0.0);
        let sum: f32 = (0..100)
            .map(|_| {
                world.drive(twist, 1);
                world.robots[0].control.report().measured().vy
            })
            .sum();
        let measured = sum / 100.0;
        assert!((measured / speed - 1.0).abs() < 5e-3, "{speed}: {measured}");
    }
}

#[test]
fn a_set_is_taken_whole_or_not_at_all() {
    let mut world = World::new(&[2]);
    assert_eq!(world.read_block(2, at::COMPENSATION_SET).unwrap(), EMPTY);
    assert_eq!(world.read(2, at::COMPENSATION_VERSION), Ok(0));
    let empty_crc = world.read(2, at::CONFIGURATION_CRC).unwrap();

    let good = set(&TABLES);
    assert_eq!(world.write_block(2, at::COMPENSATION_SET, &good), Ok(()));
    let there = |world: &mut World| {
        assert_eq!(world.read_block(2, at::COMPENSATION_SET).unwrap(), good);
        assert_eq!(world.read(2, at::COMPENSATION_VERSION), Ok(20_261_121));
        let crc = u32::from_le_bytes(good[..4].try_into().unwrap());
        assert_eq!(world.read(2, at::COMPENSATION_CRC), Ok(crc));
    };
    there(&mut world);
    assert_ne!(world.read(2, at::CONFIGURATION_CRC), Ok(empty_crc));

    let resealed = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = good.clone();
        change(&mut bytes);
        let crc = protocol::crc32(bytes[4..].iter().copied());
        bytes[..4].copy_from_slice(&crc.to_le_bytes());
        bytes
    };
    let mut flipped = good.clone();
    flipped[14] ^= 1;
    let steep = Tables {
        lateral: &[Row::new(0.3, 0.6), Row::new(0.31, 1.9)],
        ..Tables::default()
    };
    let bad = [
        (flipped, INVALID),
        (resealed(&|bytes| bytes[8] = 9), INVALID),
        (resealed(&|bytes| bytes[15..17].fill(0)), TOO_LOW),
        (resealed(&|bytes| bytes.truncate(20)), TOO_SHORT),
        (resealed(&|bytes| bytes.resize(LENGTH_MAX + 1, 0)), TOO_LONG),
        (set(&steep), INCOMPATIBLE),
    ];
    let refused = world.read(2, at::REFUSED_WRITES).unwrap();
    for (count, (bytes, abort)) in bad.iter().enumerate() {
        let result = world.write_block(2, at::COMPENSATION_SET, bytes);
        assert_eq!(result, Err(*abort), "bad set {count}");
        there(&mut world);
    }
    let count = u32::try_from(bad.len()).unwrap();
    assert_eq!(world.read(2, at::REFUSED_WRITES), Ok(refused + count));

    world.nmt(NmtCommand::Start, 2);
    assert_eq!(
        world.write_block(2, at::COMPENSATION_SET, &EMPTY),
        Err(STATE)
    );
    there(&mut world);
    world.nmt(NmtCommand::EnterPreOperational, 2);
    assert_eq!(world.write_block(2, at::COMPENSATION_SET, &EMPTY), Ok(()));
    assert_eq!(world.read(2, at::COMPENSATION_VERSION), Ok(0));
}

#[test]
fn a_set_is_saved_and_comes_back() {
    let mut world = World::new(&[2]);
    let memory = |world: &mut World| {
        world.robots[0].bus.load(
            Micros(1),
            Box::leak(Box::new([0; IMAGE_MAX])),
            Stored::Nothing,
        );
    };
    memory(&mut world);
    world.configure();
    world.run(5);
    assert_eq!(
        world.write_block(2, at::COMPENSATION_SET, &set(&TABLES)),
        Ok(())
    );
    world.send(1, 0x602, &[0x23, 0x10, 0x10, 1, b's', b'a', b'v', b'e']);
    let image = world.robots[0].bus.image_to_store().unwrap().to_vec();

    let identity = Identity {
        storage: true,
        ..Identity::new(NodeId::new(2).unwrap(), 1)
    };
    let mut bus = BusSide::new(identity);
    bus.load(
        Micros(1),
        Box::leak(Box::new([0; IMAGE_MAX])),
        Stored::Image(&image),
    );
    assert_eq!(bus.state(), crate::State::Ready);
    world.robots[0].bus = bus;
    world.run(5);
    assert_eq!(
        world.read_block(2, at::COMPENSATION_SET).unwrap(),
        set(&TABLES)
    );
    assert_eq!(world.read(2, at::COMPENSATION_VERSION), Ok(20_261_121));
    assert_eq!(world.read(2, at::CONFIGURATION_STATUS), Ok(0));
}
