//! Load of the bus: calculated, and measured on the virtual one with native robots.
//!
//! In every period of SYNC: SYNC with its counter, the group's setpoint, and four PDOs of eight
//! bytes from each robot. A frame of n bytes is 47 + 8 n bits with the pause behind it, and up to
//! (34 + 8 n - 1) / 4 stuff bits more, by its content. The calculation leaves out heartbeats, which
//! are below 1 % together.

use canopen::NmtCommand;
use group::GroupFile;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use sim::test_master::TestMaster;
use sim::{Backend, Options, World};

use super::figure::Figure;

const ROBOTS: [u8; 4] = [2, 4, 8, 16];
const RATES_HZ: [u32; 3] = [50, 100, 200];
/// Bits in a second.
const BIT_RATE: f64 = 1e6;

/// Bits of a frame with `bytes` of data, the pause behind it included: without stuff bits, and with
/// the most.
fn bits(bytes: u32) -> (f64, f64) {
    let plain = 47 + 8 * bytes;
    let stuffed = plain + (34 + 8 * bytes - 1) / 4;
    (f64::from(plain), f64::from(stuffed))
}

/// Least and most load, in per cent.
fn calculated(robots: u8, rate_hz: u32) -> (f64, f64) {
    let frames = f64::from(1 + 4 * u32::from(robots));
    let (sync, data) = (bits(1), bits(8));
    let load =
        |sync: f64, data: f64| 100.0 * f64::from(rate_hz) * (sync + frames * data) / BIT_RATE;
    (load(sync.0, data.0), load(sync.1, data.1))
}

/// A group of this many of the first robot, in a row.
pub fn in_a_row(file: &GroupFile, robots: u8) -> GroupFile {
    let mut file = file.clone();
    if let Some(first) = file.robots.first().cloned() {
        file.robots = (0..robots)
            .map(|place| {
                let mut robot = first.clone();
                robot.node = group::FIRST_NODE + place;
                robot.mount.x = 1.2 * (f32::from(robots - 1) / 2.0 - f32::from(place));
                robot
            })
            .collect();
    }
    file.simulation.crystal_ppm = vec![0.0; usize::from(robots)];
    file
}

/// Load of one second of driving, in per cent.
fn measured(file: &GroupFile) -> anyhow::Result<f64> {
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let world = World::new(file, Backend::Native, options)?;
    let mut link = SimLink::new(world, "bench");
    Group::connect(&mut link, file)?.configure(false)?;
    let mut master = TestMaster::new(link.world, file);
    master.run(60)?;
    master.command(NmtCommand::Start, None);
    master.run(240)?;
    let busy_s =
        |master: &TestMaster| master.world.bus_load().mean * master.world.now_ns() as f64 * 1e-9;
    let before = busy_s(&master);
    master.twist = Some(kinematics::Twist::new(0.1, 0.05, 0.02));
    master.run(1_000)?;
    Ok(100.0 * (busy_s(&master) - before))
}

/// All combinations.
pub fn figures(file: &GroupFile) -> anyhow::Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for robots in ROBOTS {
        for rate_hz in RATES_HZ {
            let name = |what: &str| format!("bus.{robots}_robots.{rate_hz}_hz.{what}");
            let (least, most) = calculated(robots, rate_hz);
            figures.push(Figure::new(name("calculated.least"), least, "%"));
            figures.push(Figure::new(name("calculated.most"), most, "%"));
            if most >= 100.0 {
                // There is not room for this on the wire: nothing to measure.
                continue;
            }
            let mut group = in_a_row(file, robots);
            group.sync_period_us = 1_000_000 / rate_hz;
            let figure = Figure::new(name("measured"), measured(&group)?, "%");
            let budgeted = robots == 8 && rate_hz == 100;
            figures.push(if budgeted {
                figure.budget(41.0).ceiling(45.0)
            } else {
                figure
            });
        }
    }
    Ok(figures)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_has_the_bits_of_the_standard() {
        // ISO 11898-1: 44 bits of frame and 3 of pause around the data; 8 bytes: 111, at most 135
        // with stuffing.
        assert_eq!(bits(0), (47.0, 55.0));
        assert_eq!(bits(8), (111.0, 135.0));
    }
}
