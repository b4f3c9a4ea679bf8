//! The release image in a driving group: instructions, load, times. All of it is emulated, so two
//! runs are equal.

use anyhow::{Context as _, ensure};
use canopen::{Frame, Micros, NodeId};
use emulator::profile::Call;
use emulator::{Change, Firmware};
use group::GroupFile;
use protocol::cob;
use sim::Options;

use super::driving::Driving;
use super::figure::Figure;

/// Time of driving that is measured, ms.
const MEASURED_MS: u64 = 1_000;
/// Time of driving until the robots' clocks are in step, ms: the time constant is 64 SYNCs.
const SETTLE_MS: u64 = 5_000;
/// Name of the rate of the tick at which no time would be left.
pub const CALCULATED_RATE: &str = "tick.rate.calculated";
/// The control tick.
pub const TICK: &str = "ControlSide::tick";
/// Core clock, cycles in a microsecond.
pub const CYCLES_PER_US: f64 = 180.0;

/// Address of the function whose name has this in it.
pub fn function(firmware: &Firmware, name: &str) -> anyhow::Result<u32> {
    let found = firmware
        .functions()
        .iter()
        .find(|symbol| symbol.name.contains(name));
    found
        .map(|symbol| symbol.address)
        .with_context(|| format!("the image has no function {name}: has it been inlined?"))
}

/// Least, mean and most of a count.
fn spread(name: &str, calls: &[Call]) -> anyhow::Result<[Figure; 3]> {
    ensure!(!calls.is_empty(), "{name}: no call was counted");
    let counts = calls.iter().map(|call| call.instructions);
    let sum: u64 = counts.clone().sum();
    let unit = "instructions";
    Ok([
        Figure::new(
            format!("{name}.min"),
            counts.clone().min().unwrap_or_default() as f64,
            unit,
        ),
        Figure::new(
            format!("{name}.mean"),
            (sum as f64 / calls.len() as f64 * 10.0).round() / 10.0,
            unit,
        ),
        Figure::new(
            format!("{name}.max"),
            counts.max().unwrap_or_default() as f64,
            unit,
        ),
    ])
}

/// Drives a group and measures.
pub fn figures(group: &GroupFile, firmware: &Firmware) -> anyhow::Result<Vec<Figure>> {
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let tick = function(firmware, TICK)?;
    let handle = function(firmware, "canopen::device::Device::handle")?;
    let mut driving = Driving::new(group, firmware, options)?;
    driving.drive(SETTLE_MS)?;
    let node = group.robots.first().context("no robots")?.node;
    let robot = driving.first()?.clone();
    robot.start_profile(&[tick, handle]);
    for watched in &driving.robots {
        watched.board(emulator::Board::start_trace);
    }
    let before = robot.board(|board| board.cycles());
    let received_before = robot.received().len();
    driving.drive(MEASURED_MS / 2)?;
    // One request, as a master asks for a parameter while the group drives.
    let server = NodeId::new(node).context("no node")?;
    driving.master.world.send(request(server)?);
    driving.drive(MEASURED_MS / 2)?;
    let after = robot.board(|board| board.cycles());
    // Poses and wheel rates of other robots end in the interrupt.
    let mut received = robot.received().split_off(received_before);
    let code = |id: u16| id >> 7;
    received.retain(|frame| {
        ![cob::pose(0), cob::wheel_rates(0)]
            .map(code)
            .contains(&code(frame.id))
    });
    let profile = robot.take_profile()?;

    let ticks = profile.calls(tick);
    let [least, mean, most] = spread("tick", ticks)?;
    let mut figures = vec![
        least,
        mean.budget(1_400.0)
            .ceiling(1_400.0)
            .peer(6_000.0, "linorobot2"),
        most,
    ];
    // The device handles every frame, in the order in which they come; the first may be one that
    // had come before.
    let first_at = received.first().map_or(0, |frame| frame.at);
    let handled = profile.calls(handle);
    let early = handled.partition_point(|call| call.began < first_at);
    let handled = &handled[early..];
    ensure!(
        handled.len().abs_diff(received.len()) <= 1,
        "{} frames received, {} handled",
        received.len(),
        handled.len()
    );
    for (name, id) in [("sync", cob::SYNC), ("sdo_request", cob::sdo_request(node))] {
        let of_it: Vec<Call> = handled
            .iter()
            .zip(&received)
            .filter(|(_, received)| received.id == id)
            .map(|(call, _)| *call)
            .collect();
        figures.extend(spread(name, &of_it)?);
    }

    let span = (after.0 - before.0) as f64;
    let busy = span - (after.1 - before.1) as f64;
    let thread = profile.handlers().get(&0).map_or(0, |usage| usage.cycles);
    let control: u64 = profile
        .handlers()
        .iter()
        .filter(|(exception, _)| **exception == CONTROL_EXCEPTION)
        .map(|(_, usage)| usage.cycles)
        .sum();
    let per_cent = |cycles: f64| 100.0 * cycles / span;
    figures.extend([
        Figure::new("load", per_cent(busy), "%")
            .budget(4.0)
            .ceiling(4.0),
        Figure::new("load.bus_side", per_cent(thread as f64), "%"),
        Figure::new("load.control_side", per_cent(control as f64), "%"),
    ]);
    // The control side is what must be done every tick; the rest keeps its share of the time.
    let rest_us = (busy - control as f64) / span * 1e3;
    let own_us = control as f64 / (MEASURED_MS as f64) / CYCLES_PER_US;
    figures.push(Figure {
        better: super::figure::Better::Higher,
        ..Figure::new(CALCULATED_RATE, ((1e3 - rest_us) / own_us).floor(), "kHz")
    });

    let begins: Vec<f64> = ticks.iter().map(|call| call.began as f64).collect();
    let periods = begins.windows(2).filter_map(|pair| match pair {
        [a, b] => Some((b - a) / CYCLES_PER_US - 1e3),
        _ => None,
    });
    let jitter = periods.fold(0.0f64, |most, period| most.max(period.abs()));
    figures.push(Figure::new("tick.jitter", jitter, "us").ceiling(60.0));
    figures.push(skew(&driving)?);

    let lowest = |exception| profile.lowest_stack().get(&exception).copied();
    let top = firmware
        .variable("_stack_start")
        .context("the image has no symbol _stack_start")?
        .address;
    let all = profile.lowest_stack().values().min().copied();
    for (name, sp) in [
        ("memory.stack.bus_side", lowest(0)),
        ("memory.stack.driving", all),
    ] {
        if let Some(sp) = sp {
            figures.push(Figure::new(name, f64::from(top - sp), "bytes"));
        }
    }
    let (used, reserved) = high_water(&robot, firmware)?;
    // The deepest chain of calls is deeper than what one run meets by less than what it meets.
    figures.push(
        Figure::new("memory.stack.high_water", f64::from(used), "bytes")
            .ceiling(f64::from(reserved / 2)),
    );
    Ok(figures)
}

/// TIM7 (interrupt 55) is the control tick.
const CONTROL_EXCEPTION: u16 = 16 + 55;

/// An upload of the wheel radius.
fn request(server: NodeId) -> anyhow::Result<Frame> {
    const UPLOAD: u8 = 0x40;
    let address = protocol::address::WHEEL_RADIUS;
    let [low, high] = address.index.to_le_bytes();
    let data = [UPLOAD, low, high, address.sub, 0, 0, 0, 0];
    Frame::new(cob::sdo_request(server.get()), &data).context("eight bytes fit")
}

/// The farthest that two robots' changes of the PWM are apart in one tick.
fn skew(driving: &Driving) -> anyhow::Result<Figure> {
    let changes: Vec<Vec<u64>> = driving
        .robots
        .iter()
        .map(|robot| {
            let trace = robot.board(emulator::Board::take_trace);
            let mut times: Vec<u64> = trace
                .iter()
                .filter(|traced| {
                    matches!(
                        traced.change,
                        Change::Pwm {
                            timer: 1,
                            channel: 1,
                            ..
                        }
                    )
                })
                .map(|traced| traced.t_ns)
                .collect();
            times.dedup();
            times
        })
        .collect();
    let (first, others) = changes.split_first().context("no robots")?;
    // At a thousand ticks; at this acceleration every other one changes the duty by less than its
    // step.
    ensure!(
        changes.iter().all(|changes| changes.len() > 250),
        "the PWM changes too rarely to measure its times"
    );
    let mut worst = 0;
    for other in others {
        for at in first.iter().skip(10).take(first.len() - 20) {
            let place = other.partition_point(|t| t < at);
            let near = [place.checked_sub(1), Some(place)]
                .into_iter()
                .flatten()
                .filter_map(|n| other.get(n))
                .map(|t| t.abs_diff(*at))
                .min();
            // A tick in which a duty stays the same shows no change.
            worst = worst.max(near.filter(|near| *near < 400_000).unwrap_or(0));
        }
    }
    Ok(Figure::new("skew.worst", worst as f64 * 1e-3, "us").budget(5.0))
}

/// How deep the stack has been since start-up: what has lost the paint of start-up. And how much is
/// reserved.
fn high_water(robot: &super::watched::Watched, firmware: &Firmware) -> anyhow::Result<(u32, u32)> {
    const PAINT: u32 = 0xCCCC_CCCC;
    let address = |name| {
        let symbol = firmware.variable(name);
        symbol
            .map(|symbol| symbol.address)
            .context("the image has no symbols of its stack")
    };
    let (end, start) = (address("_stack_end")?, address("_stack_start")?);
    let mut word = end;
    while word < start && robot.board(|board| board.read_word(word)) == Some(PAINT) {
        word += 4;
    }
    Ok((start - word, start - end))
}

/// The whole control tick of an image that is not the one that ships.
pub fn tick(group: &GroupFile, firmware: &Firmware, name: &str) -> anyhow::Result<[Figure; 3]> {
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let tick = function(firmware, TICK)?;
    let mut driving = Driving::new(group, firmware, options)?;
    let robot = driving.first()?.clone();
    robot.start_profile(&[tick]);
    driving.drive(MEASURED_MS)?;
    let profile = robot.take_profile()?;
    spread(name, profile.calls(tick))
}

/// Tick, load and stack of an image for another board.
pub fn of_board(
    group: &GroupFile,
    firmware: &Firmware,
    name: &str,
    load_ceiling: f64,
) -> anyhow::Result<Vec<Figure>> {
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let tick = function(firmware, TICK)?;
    let mut driving = Driving::new(group, firmware, options)?;
    driving.drive(SETTLE_MS)?;
    let robot = driving.first()?.clone();
    robot.start_profile(&[tick]);
    let before = robot.board(|board| board.cycles());
    driving.drive(MEASURED_MS)?;
    let after = robot.board(|board| board.cycles());
    let profile = robot.take_profile()?;
    let [least, mean, most] = spread(&format!("{name}.tick"), profile.calls(tick))?;
    let asleep = (after.1 - before.1) as f64 / (after.0 - before.0) as f64;
    let (used, reserved) = high_water(&robot, firmware)?;
    Ok(vec![
        least,
        mean.budget(4_000.0),
        most,
        Figure::new(format!("{name}.load"), 100.0 * (1.0 - asleep), "%")
            .budget(15.0)
            .ceiling(load_ceiling),
        Figure::new(
            format!("{name}.memory.stack.high_water"),
            f64::from(used),
            "bytes",
        )
        .ceiling(f64::from(reserved / 2)),
    ])
}

/// From power-on to the boot-up message of the last robot of a group.
pub fn ready(group: &GroupFile, firmware: &Firmware) -> anyhow::Result<Figure> {
    let backend = sim::Backend::Emulator(firmware.clone());
    let mut world = sim::World::new(group, backend, Options::default())?;
    let mut missing: Vec<u16> = group
        .robots
        .iter()
        .map(|robot| cob::heartbeat(robot.node))
        .collect();
    const LIMIT: Micros = Micros(2_000_000);
    while let Some((at, frame)) = world.receive(LIMIT)? {
        missing.retain(|id| *id != frame.id());
        if missing.is_empty() {
            return Ok(Figure::new("ready", at.0 as f64 * 1e-3, "ms").ceiling(100.0));
        }
    }
    anyhow::bail!("not all robots have sent their boot-up message within 2 s")
}
