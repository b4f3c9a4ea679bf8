//! One cause, from driving to standstill, with a group of three emulated robots.
//!
//! The group drives straight ahead at the speed of the case. The cause appears 1 ms after a SYNC
//! and the heartbeat: the worst moment for a timeout. From then on the outputs of the watched
//! robot are sampled every [`STEP_US`]. A cut is the moment at which the bridges are off; a ramp is
//! the moment at which the mean duty of three wheels falls by [`VISIBLE`] below its minimum over
//! the preceding [`BEFORE_MS`]. (For some causes the fourth wheel is the one that fails.) The robot
//! must then come to rest with drivers off and brake engaged, announce the cause, and stay at rest
//! until the end.

use std::sync::{Mutex, PoisonError};

use anyhow::{Context as _, bail, ensure};
use canopen::NmtCommand;
use emulator::Firmware;
use group::GroupFile;
use kinematics::Twist;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::{Fault, MemberState, Reaction, Value, address as at};
use sim::robot::Robot;
use sim::test_master::{STEP_US, TestMaster};
use sim::{Backend, Options, RobotTruth, SimError, World};

use super::causes::{Case, WATCHED};
use super::measured::Measured;

/// Configured limits of the robots' supply of 24 V, V.
const SUPPLY_MINIMUM: f32 = 18.0;
const SUPPLY_MAXIMUM: f32 = 30.0;
/// Time to get ready after the start, and to reach the speed and settle, ms.
const READY_MS: u64 = 60;
const SETTLE_MS: u64 = 600;
/// Time before the cause over which the duty is evaluated, ms.
const BEFORE_MS: u64 = 100;
/// A fall of the duty that is no noise. A ramp with the groups' jerk of 100 m/s^3 has taken this
/// off by feedforward alone after 0.4 ms: J R / K / U * j / r * t = 0.00625 * 656 * t.
const VISIBLE: f64 = 0.0015;
/// Longest wait for a reaction, and for rest and the announcement after it, ms.
const REACTION_MS: u64 = 1_000;
const REST_MS: u64 = 800;

/// What the robots of a trial are.
#[derive(Clone, Copy)]
pub enum Robots<'a> {
    /// The crate `robot`, all of them.
    Native,
    /// The image, all of them.
    Emulated(&'a Firmware),
    /// The image is the watched one, the others are native.
    WatchedEmulated(&'a Firmware),
}

impl Robots<'_> {
    fn build(self, group: &GroupFile) -> Result<Vec<Box<dyn Robot>>, SimError> {
        let crystals = &group.simulation.crystal_ppm;
        let robots = group.robots.iter().zip(crystals).enumerate();
        let built = robots.map(|(place, (robot, ppm))| {
            let image = match self {
                Self::Emulated(image) => Some(image),
                Self::WatchedEmulated(image) if place == WATCHED => Some(image),
                Self::WatchedEmulated(_) | Self::Native => None,
            };
            let backend = image.map_or(Backend::Native, |image| Backend::Emulator(image.clone()));
            backend.build(robot.node, *ppm)
        });
        built.collect()
    }
}

/// Measures one cause, whose reaction must be that of the announced fault.
///
/// A brake that engages slows wheels with smart drives before their current is gone, so a fall of
/// their duty says nothing of a cut.
pub fn measure(
    driving: &Driving<'_>,
    case: &Case,
    announced: Fault,
    smart: bool,
) -> anyhow::Result<Measured> {
    let group = driving.group;
    let node = group.robots.get(WATCHED).context("no robots")?.node;
    let mut master = driving.start(case.speed, &[case])?;
    let mut before = f64::INFINITY;
    for _ in 0..BEFORE_MS * 1_000 / STEP_US {
        master.step()?;
        before = before.min(effort(&watched(&master)?));
    }
    let (asked, from) = (fastest(&master), master.world.truth().group);
    let mut wheel_rate: f64 = 0.0;
    let announced_before = master.emergencies(node).count();
    case.procedure.appear(&mut master)?;
    let began = master.world.now().0;
    let cuts = announced.reaction() == Reaction::Cut;
    if cuts && (smart || case.settles_ms > 0) {
        // A cut is seen whatever the duty does.
        before = f64::NEG_INFINITY;
    } else if case.settles_ms > 0 {
        master.run(case.settles_ms)?;
        before = effort(&watched(&master)?);
    }
    let since = |master: &TestMaster| (master.world.now().0 - began) as f64 / 1e3;

    let two_pwms = group.robots.iter().all(|r| r.output.kind.has_two_pwms());
    let (mut reaction, mut rest) = (None, None);
    while rest.is_none() || since(&master) < reaction.unwrap_or(0.0) + REST_MS as f64 {
        let robot = watched(&master)?;
        // With two PWMs the timers make both inputs low before the program takes the enable back.
        let off = !robot.drivers_enabled || two_pwms && robot.duties == [0.0; 4];
        if reaction.is_none() && (off || effort(&robot) < before - VISIBLE) {
            ensure!(
                off || !cuts,
                "the drivers are still on while the duty falls"
            );
            ensure!(!off || cuts, "the drivers are off without a ramp");
            reaction = Some(since(&master));
        }
        let at_rest = !robot.drivers_enabled && !robot.brake_released;
        ensure!(
            rest.is_none() || at_rest,
            "the outputs came on again without a start"
        );
        if rest.is_none() && at_rest {
            rest = Some(since(&master));
        }
        if since(&master) > (REACTION_MS + REST_MS) as f64 {
            bail!(
                "the group is not at rest within {} ms",
                REACTION_MS + REST_MS
            );
        }
        master.step()?;
        wheel_rate = wheel_rate.max(fastest(&master) / asked);
    }
    let to = master.world.truth().group;
    let emergency = master.emergencies(node).nth(announced_before);
    let (announced_at, code) = emergency.context("announces nothing")?;
    ensure!(code == announced.code(), "announces 0x{code:04X}");
    Ok(Measured {
        reaction_ms: reaction.context("no reaction")?,
        emergency_ms: announced_at.0.saturating_sub(began) as f64 / 1e3,
        rest_ms: rest.context("no rest")?,
        wheel_rate: Some(wheel_rate),
        way: Some((to.x - from.x).hypot(to.y - from.y)),
    })
}

/// Groups at speed, which trials begin with. All that begin alike get copies of one.
pub struct Driving<'a> {
    pub group: &'a GroupFile,
    robots: Robots<'a>,
    known: Mutex<Vec<(Start, TestMaster)>>,
}

/// What distinguishes a start: the speed, and the cases that are prepared, by number and variant.
#[derive(PartialEq)]
struct Start {
    speed: f32,
    prepared: Vec<(u8, &'static str)>,
}

impl<'a> Driving<'a> {
    pub fn new(group: &'a GroupFile, robots: Robots<'a>) -> Self {
        Self {
            group,
            robots,
            known: Mutex::default(),
        }
    }

    /// The group at a speed and 1 ms after a SYNC and the heartbeat, prepared for what is going to
    /// happen.
    pub fn start(&self, speed: f32, cases: &[&Case]) -> anyhow::Result<TestMaster> {
        let mut cases: Vec<_> = cases.iter().filter(|case| case.prepare.is_some()).collect();
        cases.sort_by_key(|case| case.number);
        let start = Start {
            speed,
            prepared: cases.iter().map(|c| (c.number, c.variant)).collect(),
        };
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let master = match known.iter().position(|(known, _)| *known == start) {
            Some(place) => &known[place].1,
            None => {
                let mut master = self.configured()?;
                for prepare in cases.iter().filter_map(|case| case.prepare) {
                    prepare(&mut master);
                }
                bring_to_speed(&mut master, speed)?;
                known.push((start, master));
                &known[known.len() - 1].1
            }
        };
        master.try_clone().context("the robots cannot be copied")
    }

    /// Boots and configures the group.
    fn configured(&self) -> anyhow::Result<TestMaster> {
        let options = Options {
            truth_period_ns: 0,
            ..Options::default()
        };
        let group = self.group;
        let plant = sim::plant::build(group, options.start)?;
        let world = World::with_parts(group, self.robots.build(group)?, plant, options)?;
        let mut link = SimLink::new(world, "faults");
        let mut session = Group::connect(&mut link, group)?;
        session.configure(true)?;
        for robot in &group.robots {
            for (address, volts) in [
                (at::SUPPLY_MINIMUM, SUPPLY_MINIMUM),
                (at::SUPPLY_MAXIMUM, SUPPLY_MAXIMUM),
            ] {
                let volts = Value::F32(volts);
                session.wire().write(robot.node, address, volts)?;
            }
        }
        drop(session);
        Ok(TestMaster::new(link.world, group))
    }
}

fn bring_to_speed(master: &mut TestMaster, speed: f32) -> anyhow::Result<()> {
    master.run(READY_MS)?;
    master.command(NmtCommand::Start, None);
    master.run(READY_MS)?;
    master.twist = Some(Twist::new(speed, 0.0, 0.0));
    master.run(SETTLE_MS)?;
    ensure!(
        master.all_are(MemberState::Moving),
        "the group does not drive"
    );
    master.run_to_phase(100, 1)?;
    Ok(())
}

fn watched(master: &TestMaster) -> anyhow::Result<RobotTruth> {
    let truth = master.world.truth();
    truth.robots.get(WATCHED).copied().context("no robots")
}

/// The largest rate of any wheel of the group, rad/s, either way.
fn fastest(master: &TestMaster) -> f64 {
    let robots = master.world.truth().robots;
    let rates = robots
        .iter()
        .flat_map(|robot| <[f64; 4]>::from(robot.wheel_rates));
    rates.fold(0.0, |most, rate| most.max(rate.abs()))
}

/// Mean duty of the wheels that do not fail.
fn effort(robot: &RobotTruth) -> f64 {
    let [_, front_right, rear_left, rear_right] = robot.duties;
    (front_right + rear_left + rear_right) / 3.0
}
