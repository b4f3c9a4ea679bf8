//! `omnibus replay FILE --bus ...`: what the master of a recording sent, sent again with its
//! timing.
//!
//! Without `--drive` nothing is sent that could move a robot: the frames are only counted, and the
//! bus is listened to. With it, the bus must be free of another master and of started robots. The
//! SDO requests that configured the robots are among the frames, when they were recorded.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::bail;
use canopen::{Micros, NmtCommand, NmtTarget, client};
use omnibus::abort::Abort;
use omnibus::bus::address::BusAddress;
use omnibus::bus::foreign::Sign;
use omnibus::bus::link::Link;
use omnibus::error::MasterError;
use omnibus::monitor::listener::Listener;
use omnibus::recording::{Recorded, Recording};
use protocol::cob;
use serde_json::json;

use super::convert::load;
use super::output::Progress;
use super::{Target, print_line};

/// How long the bus is listened to before anything is sent, in µs: three heartbeats of a robot and
/// ten of a master.
const LISTEN_US: u64 = 1_000_000;
/// Time after the last frame in which robots come to rest by their own rules, in µs.
const SETTLE_US: u64 = 500_000;

const EXAMPLES: &str = "Examples:
  omnibus replay drive.mcap --bus socketcan:can0
  omnibus replay drive.mcap --drive --bus sim:groups/tcc-2.toml

The first example only counts the frames that it would send.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// A recording, or a candump log whose name ends in .log.
    file: PathBuf,
    #[command(flatten)]
    target: Target,
    /// Sends the frames of the recorded master, so robots on the bus move as they did then.
    #[arg(long)]
    drive: bool,
}

/// Whether a frame is one that a master sends.
fn is_masters(recorded: &Recorded) -> bool {
    let id = recorded.frame.id();
    let to_a_robot = |base: u16| (base + 1..=base + 0x7F).contains(&id);
    matches!(
        id,
        cob::NMT | cob::SYNC | cob::GROUP_TWIST | cob::MASTER_HEARTBEAT
    ) || to_a_robot(0x200)
        || to_a_robot(0x600)
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let recording = load(&arguments.file, super::quiet())?;
    let frames: Vec<_> = recording
        .frames
        .iter()
        .filter(|f| is_masters(f))
        .copied()
        .collect();
    if frames.is_empty() {
        bail!(
            "{}: the recording has no frames of a master, so there is nothing to replay",
            arguments.file.display()
        );
    }
    let abort = super::abort_on_ctrl_c()?;
    let mut link: Box<dyn Link> = arguments.target.link_alone()?;
    let traffic = observe(&mut link)?;
    if arguments.drive && !arguments.target.force {
        refuse_if_live(&traffic, &arguments.target.bus)?;
    }
    let sent = if arguments.drive {
        send(&mut link, &frames, &abort)?
    } else {
        0
    };
    report(arguments, &recording, frames.len(), sent)?;
    if arguments.drive && sent < frames.len() {
        return Err(MasterError::Aborted.into());
    }
    Ok(())
}

/// What is on the bus: the group after listening for a while, and the first sign of another master.
struct Traffic {
    master: Option<Sign>,
    armed: Vec<u8>,
}

fn observe(link: &mut impl Link) -> anyhow::Result<Traffic> {
    let mut listener = Listener::new([]);
    let mut master = None;
    let until = Micros(link.now().0 + LISTEN_US);
    while let Some((at, frame)) = link.receive(until)? {
        master = master.or_else(|| Sign::of(&frame));
        listener.push(at.0 as f64 * 1e-6, &frame);
    }
    let members = listener.now(0.0).members;
    let operational = members
        .iter()
        .filter(|m| m.nmt == Some(canopen::NmtState::Operational));
    Ok(Traffic {
        master,
        armed: operational.map(|member| member.node).collect(),
    })
}

fn refuse_if_live(traffic: &Traffic, bus: &BusAddress) -> anyhow::Result<()> {
    if let Some(sign) = traffic.master {
        return Err(MasterError::AnotherMaster(sign).into());
    }
    if let [first, ..] = traffic.armed[..] {
        bail!(
            "{bus}: node {first} is started (OPERATIONAL) without a master; reset it first \
             (`omnibus reset --node {first}`), or give --force"
        );
    }
    Ok(())
}

/// Sends the frames with their distance in time. However it ends, the robots are commanded to leave
/// OPERATIONAL once they have had time to come to rest.
fn send(link: &mut impl Link, frames: &[Recorded], abort: &Abort) -> anyhow::Result<usize> {
    let first = frames.first().map_or(0, |frame| frame.t_ns) / 1_000;
    let zero = link.now().0 + 10_000;
    let mut sent = 0;
    let mut failed = Ok(());
    let progress = Progress::new("replay");
    for recorded in frames {
        progress.share(sent as f64 / frames.len() as f64, "");
        let due = Micros(zero + recorded.t_ns / 1_000 - first);
        while link.receive(due)?.is_some() {}
        if abort.is_asked() {
            break;
        }
        failed = link.send(&recorded.frame);
        if failed.is_err() {
            break;
        }
        sent += 1;
    }
    drop(progress);
    // Without setpoints and heartbeat robots ramp down by themselves; that is over by then.
    let settled = Micros(link.now().0 + SETTLE_US);
    while link.receive(settled)?.is_some() {}
    link.send(&client::nmt(
        NmtCommand::EnterPreOperational,
        NmtTarget::All,
    ))?;
    failed?;
    Ok(sent)
}

fn report(
    arguments: &Arguments,
    recording: &Recording,
    frames: usize,
    sent: usize,
) -> anyhow::Result<()> {
    let seconds = Duration::from_secs_f64(recording.seconds());
    if super::json() {
        return super::print_json(
            &json!({"file": arguments.file.display().to_string(), "frames": frames, "sent": sent,
                                         "seconds": recording.seconds()}),
        );
    }
    if super::quiet() {
        return Ok(());
    }
    if arguments.drive {
        print_line(format_args!(
            "sent {sent} of {frames} frames of the master, over {:.3} s",
            seconds.as_secs_f64()
        ))
    } else {
        print_line(format_args!(
            "{frames} frames of the master over {:.3} s; nothing was sent: --drive sends them, \
             and robots on {} will move as they did",
            seconds.as_secs_f64(),
            arguments.target.bus
        ))
    }
}
