//! `omnibus record FILE.mcap`: listens to a bus and records every frame.
//!
//! It sends nothing and claims nothing, so it can run beside any master.

use std::path::PathBuf;

use anyhow::bail;
use canopen::Micros;
use indicatif::{ProgressBar, ProgressStyle};
use omnibus::abort::Abort;
use omnibus::bus::address::BusAddress;
use omnibus::bus::link::Link;
use omnibus::bus::tap::Tap;
use omnibus::recording::{Recorder, Summary};
use serde_json::json;

use super::recorder::Rotate;
use super::{Target, print_line};

/// Time between two looks at whether to stop, in µs.
const SLICE_US: u64 = 100_000;

const EXAMPLES: &str = "Examples:
  omnibus record drive.mcap --bus socketcan:can0 --group groups/tcc-2.toml
  omnibus record minute.mcap --for 60 --bus slcan:/dev/ttyACM0

It only listens. `follow` and `drive` record their own drive with --record FILE.mcap.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The file to write; one that exists is replaced.
    file: PathBuf,
    #[command(flatten)]
    rotate: Rotate,
    #[command(flatten)]
    target: Target,
    /// Duration, s; by default until Ctrl-C.
    #[arg(long = "for", value_name = "SECONDS", value_parser = super::real::<f64>)]
    seconds: Option<f64>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if let Some(seconds) = arguments.seconds
        && !(seconds > 0.0 && seconds <= 1e6)
    {
        usage!("--for: {seconds} s; give more than 0 and at most 1000000 s");
    }
    if matches!(arguments.target.bus, BusAddress::Sim(_)) && arguments.seconds.is_none() {
        usage!(
            "--for SECONDS is missing: {} is a new simulated bus, on which nothing moves; to record a \
             simulated drive use `omnibus follow CURVE --record FILE.mcap`",
            arguments.target.bus
        );
    }
    arguments.target.check_output("FILE", &arguments.file)?;
    let link = arguments.target.link_alone()?;
    let abort = super::abort_on_ctrl_c()?;
    let recorder =
        arguments
            .rotate
            .begin(&arguments.file, &arguments.target, "record", link.now())?;
    let mut link = Tap::new(link, [recorder.sink()]);
    let listened = listen(&mut link, arguments, &abort, &recorder);
    // However it ended, what was heard is kept.
    let summary = recorder.finish()?;
    listened?;
    if summary.frames == 0 {
        bail!(
            "{}: no frames were received; check that the robots are switched on, the bit rate (1 Mbit/s), and \
             that another node is on the bus to acknowledge frames",
            arguments.target.bus
        );
    }
    if super::json() {
        return super::print_json(&show(arguments, &summary));
    }
    if !super::quiet() {
        print_line(format_args!(
            "{}: {} frames in {:.3} s, {} messages",
            arguments.file.display(),
            summary.frames,
            summary.seconds,
            summary.messages
        ))?;
    }
    Ok(())
}

fn show(arguments: &Arguments, summary: &Summary) -> serde_json::Value {
    json!({"file": arguments.file.display().to_string(), "frames": summary.frames,
           "messages": summary.messages, "seconds": summary.seconds})
}

fn listen(
    link: &mut impl Link,
    arguments: &Arguments,
    abort: &Abort,
    recorder: &Recorder,
) -> anyhow::Result<()> {
    let bar = if super::quiet() || super::json() {
        ProgressBar::hidden()
    } else {
        ProgressBar::new_spinner()
    };
    let style = ProgressStyle::with_template("recording {elapsed}  {pos} frames  (Ctrl-C ends it)");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and 1e12"
    )]
    let duration = arguments.seconds.map(|seconds| (seconds * 1e6) as u64);
    let end = duration.map(|duration| link.now().0 + duration);
    while !abort.is_asked() && !recorder.is_over() {
        let slice = link.now().0 + SLICE_US;
        let until = end.map_or(slice, |end| end.min(slice));
        while link.receive(Micros(until))?.is_some() {
            bar.inc(1);
        }
        if end.is_some_and(|end| link.now().0 >= end) {
            break;
        }
    }
    bar.finish_and_clear();
    Ok(())
}
