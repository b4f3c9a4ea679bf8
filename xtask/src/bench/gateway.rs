//! What the cable costs: load of a robot that is the gateway of its group, bytes on the cable, and
//! the time from a call at the cable to the wheel.

use emulator::Firmware;
use group::GroupFile;
use sim::Options;

use super::bus::in_a_row;
use super::driving::Driving;
use super::figure::Figure;
use super::latency;

/// Time of driving that is measured, ms.
const MEASURED_MS: u64 = 1_000;
/// Bytes that a line of 1 Mbaud carries in a second: ten bits each.
const LINE: f64 = 100_000.0;
/// What the cable may add to a robot's load, per cent of the processor's time.
const BUDGET: f64 = 2.0;

/// Load of the first robot while the group drives, per cent, and bytes of its cable in a second.
fn driven(group: &GroupFile, firmware: &Firmware, at_cable: bool) -> anyhow::Result<(f64, f64)> {
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let mut driving = Driving::ready(group, firmware, options)?;
    if at_cable {
        driving.plug_in()?;
    }
    driving.start()?;
    driving.drive(300)?;
    let robot = driving.first()?.clone();
    let (before, carried) = (
        robot.board(|board| board.cycles()),
        driving.master.carried(),
    );
    driving.drive(MEASURED_MS)?;
    driving.ensure_moving()?;
    let after = robot.board(|board| board.cycles());
    let span = (after.0 - before.0) as f64;
    let busy = span - (after.1 - before.1) as f64;
    let bytes = (driving.master.carried() - carried) as f64 * 1e3 / MEASURED_MS as f64;
    Ok((100.0 * busy / span, bytes))
}

/// Drives groups of one and of eight, with the master on the bus and at the cable.
pub fn figures(group: &GroupFile, firmware: &Firmware) -> anyhow::Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for robots in [1, 8] {
        let group = in_a_row(group, robots);
        let (without, _) = driven(&group, firmware, false)?;
        let (with, bytes) = driven(&group, firmware, true)?;
        let name = |what: &str| format!("gateway.{robots}_robots.{what}");
        figures.push(Figure::new(name("load"), with, "%"));
        let more = Figure::new(name("load.more"), with - without, "%").budget(BUDGET);
        figures.push(more.ceiling(BUDGET));
        figures.push(Figure::new(name("bytes"), bytes, "bytes/s"));
        figures.push(Figure::new(name("line"), 100.0 * bytes / LINE, "%").ceiling(100.0));
    }
    figures.extend(latency::at_cable(group, firmware)?);
    Ok(figures)
}
