//! The instructions of a driving robot by function: `cargo xtask profile`.

use emulator::Firmware;
use emulator::profile::Profile;
use group::GroupFile;
use sim::Options;

use super::driving::Driving;
use crate::{cargo, firmware};

/// Options of `cargo xtask profile`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Firmware image to profile; by default it is built.
    #[arg(long, value_name = "ELF")]
    image: Option<std::path::PathBuf>,
    /// Duration of the drive in milliseconds.
    #[arg(long, default_value_t = 1_000)]
    millis: u64,
    /// Number of functions to print.
    #[arg(long, default_value_t = 50)]
    top: usize,
    /// Counts inlined instructions for the source function that they come from.
    #[arg(long)]
    inlined: bool,
    /// Drives a group of this many robots in a row instead of groups/tcc-3.toml.
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=8))]
    robots: Option<u8>,
    /// Profiles kits with an STM32F103 instead of the robots.
    #[arg(long, conflicts_with = "cable")]
    f103: bool,
    /// Connects the master to the cable of the first robot, which is then the gateway.
    #[arg(long)]
    cable: bool,
}

/// Drives and prints.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let elf = match &arguments.image {
        Some(path) => path.clone(),
        None if arguments.f103 => firmware::build_for(firmware::Board::KitF103rc)?,
        None => firmware::build(omnibus::report::Scalar::F32)?,
    };
    let firmware = Firmware::load(&elf)?;
    let mut group = GroupFile::load(cargo::root().join("groups/tcc-3.toml"))?;
    if let Some(robots) = arguments.robots {
        group = super::bus::in_a_row(&group, robots);
    }
    if arguments.f103 {
        group = super::kit::with_kits(group);
    }
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let mut driving = Driving::ready(&group, &firmware, options)?;
    if arguments.cable {
        driving.plug_in()?;
    }
    driving.start()?;
    driving.drive(300)?;
    driving.ensure_moving()?;
    let robot = driving.first()?.clone();
    robot.start_profile(&[]);
    let (cycles, slept) = robot.board(|board| board.cycles());
    driving.drive(arguments.millis)?;
    let (cycles_after, slept_after) = robot.board(|board| board.cycles());
    let profile = robot.take_profile()?;

    let span = (cycles_after - cycles) as f64;
    let busy = span - (slept_after - slept) as f64;
    let per_ms = |count: u64| count as f64 / arguments.millis as f64;
    println!(
        "load {:.3} %, {:.0} cycles in a millisecond",
        100.0 * busy / span,
        busy / arguments.millis as f64
    );
    let entries = profile.exceptions();
    println!(
        "exception entries: {:.2} in a millisecond, {:.0} cycles",
        per_ms(entries.calls),
        per_ms(entries.cycles)
    );
    println!(
        "\n{:>9} {:>12} {:>9} {:>9} {:>10}",
        "exception", "instructions", "cycles", "waiting", "stack from"
    );
    for (exception, usage) in profile.handlers() {
        let lowest = profile.lowest_stack().get(exception).copied();
        println!(
            "{exception:>9} {:>12.1} {:>9.1} {:>9.1} {:>#10x}",
            per_ms(usage.instructions),
            per_ms(usage.cycles),
            per_ms(usage.waited),
            lowest.unwrap_or_default()
        );
    }
    if arguments.inlined {
        print_inlined(&profile, &firmware, arguments);
        return Ok(());
    }
    println!(
        "\n{:>12} {:>9} {:>9} {:>8}  function (per millisecond, without what it calls)",
        "instructions", "cycles", "waiting", "calls"
    );
    for (name, usage) in profile.functions(&firmware).into_iter().take(arguments.top) {
        println!(
            "{:>12.1} {:>9.1} {:>9.1} {:>8.2}  {name}",
            per_ms(usage.instructions),
            per_ms(usage.cycles),
            per_ms(usage.waited),
            per_ms(usage.calls)
        );
    }
    Ok(())
}

/// Cycles by function of the source.
fn print_inlined(profile: &Profile, firmware: &Firmware, arguments: &Arguments) {
    let per_ms = |count: u64| count as f64 / arguments.millis as f64;
    println!(
        "\n{:>9} {:>9} {:>9}  function (cycles per millisecond: with what is inlined into it, of \
         which waiting, and alone)",
        "cycles", "waiting", "alone"
    );
    let all = profile.inlined(firmware);
    for (name, own, whole) in all.into_iter().take(arguments.top) {
        println!(
            "{:>9.1} {:>9.1} {:>9.1}  {name}",
            per_ms(whole.cycles),
            per_ms(whole.waited),
            per_ms(own.cycles)
        );
    }
}
