//! The faults of a run: those of the command line, and those that come as lines on standard input.
//!
//! A line is what `--fault` takes; without `t=` it happens at once. A line that cannot be meant is
//! answered on standard error and changes nothing. A thread waits for lines, because reading them
//! blocks; it ends with standard input or with the program.

use std::io::BufRead as _;
use std::sync::mpsc::{Receiver, channel};

use anyhow::anyhow;
use group::GroupFile;
use omnibus_sim::fault::{FaultSpec, Schedule};
use omnibus_sim::{SimError, World};

use crate::output::print_note;

/// Stands for standard input.
const FROM_INPUT: &str = "-";

/// Faults to come.
pub struct Faults<'a> {
    group: &'a GroupFile,
    has_processor: bool,
    schedule: Schedule,
    lines: Option<Receiver<String>>,
}

impl<'a> Faults<'a> {
    /// The faults of the command line, `-` among them for those of standard input.
    pub fn new(
        group: &'a GroupFile,
        has_processor: bool,
        specs: &[String],
    ) -> anyhow::Result<Self> {
        let mut schedule = Schedule::default();
        let mut lines = None;
        for spec in specs {
            if spec == FROM_INPUT {
                lines.get_or_insert_with(read_lines);
            } else {
                let fault = FaultSpec::parse(spec, group, has_processor)
                    .map_err(|error| anyhow!("--fault {spec}: {error}"))?;
                schedule.add(&fault, 0);
            }
        }
        Ok(Self {
            group,
            has_processor,
            schedule,
            lines,
        })
    }

    /// Takes in what has been typed meanwhile.
    pub fn listen(&mut self, now_ns: u64) {
        for line in self.lines.iter().flat_map(Receiver::try_iter) {
            let line = line.trim();
            if line.is_empty() {
                continue;
            }
            match FaultSpec::parse(line, self.group, self.has_processor) {
                Ok(fault) => self.schedule.add(&fault, now_ns),
                Err(error) => print_note(format_args!("{line}: {error}")),
            }
        }
    }

    /// Lets the world's time pass to `until_ns`; every fault comes at its own time.
    pub fn run(&mut self, world: &mut World, until_ns: u64) -> Result<(), SimError> {
        self.schedule
            .run_until(world, until_ns, &mut |at_ns, what| {
                let seconds = at_ns as f64 * 1e-9;
                print_note(format_args!("fault at {seconds:.6} s: {what}"));
            })
    }
}

fn read_lines() -> Receiver<String> {
    let (sender, lines) = channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                break;
            }
        }
    });
    lines
}
