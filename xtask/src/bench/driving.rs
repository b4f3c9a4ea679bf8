//! A group of emulated robots on the bus, driven along a figure that uses everything: forward,
//! sideways and turning, always accelerating.

use anyhow::{Context as _, ensure};
use canopen::NmtCommand;
use emulator::Firmware;
use group::GroupFile;
use kinematics::Twist;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::MemberState;
use sim::robot::Robot;
use sim::test_master::TestMaster;
use sim::{Options, World, plant};

use super::watched::Watched;

/// Time to get ready after the start, ms.
const READY_MS: u64 = 60;

/// A driving group.
pub struct Driving {
    /// The master and the world.
    pub master: TestMaster,
    /// Its robots, in the order of the group file.
    pub robots: Vec<Watched>,
    period_ms: u64,
}

impl Driving {
    /// Boots and configures the robots of a group, starts them, and drives for a moment.
    pub fn new(group: &GroupFile, firmware: &Firmware, options: Options) -> anyhow::Result<Self> {
        let mut driving = Self::ready(group, firmware, options)?;
        driving.start()?;
        driving.drive(300)?;
        driving.ensure_moving()?;
        Ok(driving)
    }

    /// Boots and configures the robots of a group.
    pub fn ready(group: &GroupFile, firmware: &Firmware, options: Options) -> anyhow::Result<Self> {
        let robots = group
            .robots
            .iter()
            .zip(&group.simulation.crystal_ppm)
            .map(|(robot, ppm)| Watched::new(firmware, robot.node, *ppm))
            .collect::<Result<Vec<_>, _>>()?;
        let boxed = robots
            .iter()
            .map(|robot| Box::new(robot.clone()) as Box<dyn Robot>)
            .collect();
        let floor = plant::build(group, options.start)?;
        let world = World::with_parts(group, boxed, floor, options)?;
        let mut link = SimLink::new(world, "bench");
        Group::connect(&mut link, group)?.configure(true)?;
        let mut master = TestMaster::new(link.world, group);
        master.run(READY_MS)?;
        Ok(Self {
            master,
            robots,
            period_ms: u64::from(group.sync_period_us) / 1_000,
        })
    }

    /// Puts the master at the cable of the first robot instead of on the bus.
    pub fn plug_in(&mut self) -> anyhow::Result<()> {
        let node = self
            .master
            .world
            .truth()
            .robots
            .first()
            .context("no robots")?
            .node;
        self.master.plug_in(node);
        self.master.run(READY_MS)?;
        Ok(())
    }

    /// Says so if the group does not drive.
    pub fn ensure_moving(&self) -> anyhow::Result<()> {
        ensure!(
            self.master.all_are(MemberState::Moving),
            "the group does not drive"
        );
        Ok(())
    }

    /// Switches the drivers on.
    pub fn start(&mut self) -> anyhow::Result<()> {
        self.master.command(NmtCommand::Start, None);
        self.master.run(READY_MS)?;
        Ok(())
    }

    /// Drives on for this many milliseconds.
    pub fn drive(&mut self, millis: u64) -> anyhow::Result<()> {
        let end = self.master.world.now().0 / 1_000 + millis;
        loop {
            let now = self.master.world.now().0 / 1_000;
            if now >= end {
                return Ok(());
            }
            self.master.twist = Some(figure(now as f32 * 1e-3));
            self.master.run(self.period_ms.min(end - now))?;
        }
    }

    /// The first robot.
    pub fn first(&self) -> anyhow::Result<&Watched> {
        self.robots.first().context("the group has no robots")
    }
}

/// The setpoint at a time, s: within the limits of every group file.
fn figure(time: f32) -> Twist {
    Twist::new(
        0.4 * (1.1 * time).sin(),
        0.3 * (0.7 * time).sin(),
        0.2 * (0.9 * time).sin(),
    )
}
