//! How long an update over the bus takes: the release image for emulated robots that run it, by the
//! client of `omnibus update`.

use std::path::Path;

use anyhow::{Context as _, ensure};
use emulator::Firmware;
use group::GroupFile;
use omnibus::abort::Abort;
use omnibus::bus::wire::Wire;
use omnibus::commission::survey::Survey;
use omnibus::commission::update::{self, Image, Step};
use omnibus::simulation::link::SimLink;
use sim::robot::Robot;
use sim::{Options, World, plant};

use super::bus::in_a_row;
use super::figure::Figure;
use super::watched::Watched;
use crate::release;

/// What the block transfer of one image may take, s of bus time.
const TRANSFER: f64 = 3.0;
/// What the update of eight robots may take, s.
const EIGHT: f64 = 60.0;
const ROBOTS: u8 = 8;

/// Updates eight robots, one after the other as the client does.
pub fn figures(group: &GroupFile, elf: &Path, firmware: &Firmware) -> anyhow::Result<Vec<Figure>> {
    let image = Image::read(release::development_file(elf)?).map_err(anyhow::Error::msg)?;
    let group = in_a_row(group, ROBOTS);
    let robots = group
        .robots
        .iter()
        .map(|robot| Watched::new(firmware, robot.node, 0.0))
        .collect::<Result<Vec<_>, _>>()?;
    let boxed = robots
        .iter()
        .map(|robot| Box::new(robot.clone()) as Box<dyn Robot>)
        .collect();
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let floor = plant::build(&group, options.start)?;
    let world = World::with_parts(&group, boxed, floor, options)?;
    let mut wire = Wire::visiting(SimLink::new(world, "bench"));
    let survey = Survey::take(&mut wire, Some(&group))?;
    let found = survey.found.iter();
    let nodes: Vec<_> = found.map(|robot| (robot.node, robot.nmt)).collect();
    let before = update::survey(&mut wire, &nodes)?;

    let clock = robots.first().context("no robots")?.clone();
    let now = || clock.board(|board| board.now_ns()) as f64 * 1e-9;
    let (begin, mut confirmed) = (now(), 0);
    // Time and bytes at the first acknowledgement of a transfer; the longest of all.
    let (mut first, mut longest, mut bytes) = (None, 0.0_f64, 0);
    update::update(
        &mut wire,
        &image,
        &before,
        &Abort::default(),
        &mut |step| match step {
            Step::Erases(_) => first = None,
            Step::Receives(_, sent, length) => {
                let (since, already) = *first.get_or_insert((now(), sent));
                if sent == length {
                    // What came before the first acknowledgement took its share.
                    let share = length as f64 / (length - already) as f64;
                    longest = longest.max((now() - since) * share);
                    bytes = bytes.max(length);
                }
            }
            Step::Confirmed(_) => confirmed += 1,
            _ => {}
        },
    )?;
    let all = now() - begin;
    ensure!(
        confirmed == ROBOTS,
        "{confirmed} robots have confirmed the image"
    );
    for robot in &robots {
        ensure!(
            robot.board(|board| board.resets()) > 0,
            "a robot has not restarted"
        );
    }
    Ok(vec![
        Figure::new("update.bytes", bytes as f64, "bytes"),
        Figure::new("update.transfer", longest, "s")
            .budget(TRANSFER)
            .ceiling(TRANSFER),
        Figure::new("update.8_robots", all, "s")
            .budget(EIGHT)
            .ceiling(EIGHT),
    ])
}
