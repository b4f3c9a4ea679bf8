//! The time between the changes of the motor voltage of two robots.
//!
//! Two emulated robots with crystals [`CRYSTALS_PPM`] apart follow a twist that always changes.
//! SYNC comes from a master whose clock is exact on average and deviates by up to [`JITTER_US`]
//! each time. Every change of a compare value of the PWM timer, which acts at once, is recorded
//! with its time. The result is the time from each change of one robot to the nearest change of the
//! other, worst case over [`SECONDS`].

use anyhow::{Context as _, ensure};
use canopen::{Micros, NmtCommand, NmtState, NmtTarget, NodeId, client};
use emulator::Firmware;
use group::GroupFile;
use kinematics::Twist;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::{GroupTwist, cob};
use sim::{Backend, Options, World};

/// Errors of the crystals.
pub const CRYSTALS_PPM: [f64; 2] = [50.0, -50.0];
/// Largest deviation of a SYNC from its time.
pub const JITTER_US: u64 = 1_500;
/// Emulated time of the measurement.
pub const SECONDS: u64 = 60;
/// What is promised.
pub const LIMIT_US: f64 = 5.0;

const PERIOD_US: u64 = 10_000;
/// SYNCs at standstill, the start among them.
const STANDS: u64 = 30;
/// SYNCs until the clocks have learnt the crystals' difference and the ticks, which move by 20 us
/// at most, have followed.
const SETTLE: u64 = 100;
/// A setpoint goes out this long before its SYNC is due; the earliest comes 2.5 ms after it.
const LEAD_US: u64 = 4_000;
/// Half of a control tick: farther apart, two changes do not belong together.
const SAME_TICK_NS: u64 = 500_000;

/// What was measured.
#[derive(Clone, Copy, Debug)]
pub struct Skew {
    /// Worst case, µs.
    pub worst_us: f64,
    /// Changes compared.
    pub changes: usize,
}

/// Measures with the first two robots of this group.
pub fn measure(group: &GroupFile, firmware: &Firmware) -> anyhow::Result<Skew> {
    let mut group = group.clone();
    group.robots.truncate(2);
    group.simulation.crystal_ppm = CRYSTALS_PPM.to_vec();
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let world = World::new(&group, Backend::Emulator(firmware.clone()), options)?;
    let mut link = SimLink::new(world, "skew");
    Group::connect(&mut link, &group)?.configure(true)?;
    let mut world = link.world;
    let master = NodeId::new(protocol::MASTER).context("the master is a node")?;
    let begin = world.now().0.next_multiple_of(PERIOD_US) + PERIOD_US;
    let mut random = 1_u64;
    let mut all = [Vec::new(), Vec::new()];
    for k in 0..SETTLE + SECONDS * 1_000_000 / PERIOD_US {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let jitter = (random >> 33) % (2 * JITTER_US + 1);
        let due = begin + (k + 1) * PERIOD_US;
        world.run_until(Micros(due - LEAD_US))?;
        if k % 10 == 0 {
            world.send(client::heartbeat(master, NmtState::Operational));
        }
        if k == 10 {
            world.send(client::nmt(NmtCommand::Start, NmtTarget::All));
        }
        if k == SETTLE {
            world.start_trace();
        }
        // Standstill until the robots follow.
        let t = k.saturating_sub(STANDS) as f32 * 0.01;
        let setpoint = GroupTwist {
            twist: Twist::new(0.5 * t.sin(), 0.4 * (1.3 * t).sin(), 0.0),
            sequence: (k % 256) as u8,
            group: group.group_id,
        };
        world.send(canopen::Frame::of(cob::GROUP_TWIST, setpoint.encode()));
        world.run_until(Micros(due - JITTER_US + jitter))?;
        world.send(client::sync(Some((k % 240) as u8 + 1)));
        if k >= SETTLE {
            for (robot, changes) in all.iter_mut().enumerate() {
                changes.extend(world.take_duty_changes(robot));
            }
        }
        while world.take_received(sim::MASTER).is_some() {}
    }
    let moving = world
        .truth()
        .robots
        .iter()
        .all(|robot| robot.drivers_enabled);
    ensure!(moving, "the robots did not keep driving");
    compare(&all)
}

/// The worst distance of a change of the first robot to the nearest of the second.
fn compare([first, second]: &[Vec<u64>; 2]) -> anyhow::Result<Skew> {
    let mut worst = 0;
    let mut changes = 0;
    for at in first {
        let next = second.partition_point(|other| other < at);
        let near = [next.checked_sub(1), Some(next)].into_iter().flatten();
        let distances = near
            .filter_map(|n| second.get(n))
            .map(|other| other.abs_diff(*at));
        // A duty that stays the same from one tick to the next is no change.
        if let Some(distance) = distances.min().filter(|distance| *distance < SAME_TICK_NS) {
            worst = worst.max(distance);
            changes += 1;
        }
    }
    let ticks = usize::try_from(SECONDS * 1_000)?;
    ensure!(
        changes > ticks / 2,
        "{changes} changes in {ticks} ticks are too few"
    );
    Ok(Skew {
        worst_us: worst as f64 / 1e3,
        changes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_change_is_compared_with_the_nearest() {
        let ticks: Vec<u64> = (0..60_000).map(|n| n * 1_000_000).collect();
        let mut late: Vec<u64> = ticks.iter().map(|at| at + 7_000).collect();
        late[30_000] += 20_000;
        let skew = compare(&[ticks, late]).unwrap();
        assert_eq!((skew.worst_us, skew.changes), (27.0, 60_000));
    }
}
