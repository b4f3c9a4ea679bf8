//! Test programs, run side by side.
//!
//! `cargo test` runs one test program after the other, and what is slow in most of them is a single
//! test: a core would stand idle. Here each core has a program of its own, which runs its tests one
//! by one and stays on that core with all that it starts: a master and a simulator that wait for
//! each other take a third less of a core's time than if each had one to itself. Tests with
//! third-party software, many of them in real time, run in rows instead. A program's output is
//! printed when it has ended, so that two never mix.

use std::collections::VecDeque;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::time::Instant;

use anyhow::{Context as _, bail, ensure};

/// Programs that take longest, the longest first: begun last, one of them would run alone.
const LONGEST: [&str; 10] = [
    "update_bus",
    "kit",
    "documented_calibration",
    "emulated",
    "gateway",
    "operating",
    "gyro",
    "level_one",
    "calibrate",
    "omnibus_robot",
];

/// Programs that mostly wait: in a row of their own, they leave a core to the others.
const WAITING: [&str; 3] = ["ros", "bridge", "vda5050"];

/// A command that tests something.
pub struct Program {
    name: String,
    command: Command,
}

impl Program {
    /// Any command.
    pub fn new(name: impl Into<String>, command: Command) -> Self {
        let name = name.into();
        Self { name, command }
    }

    /// The last word of its name.
    fn target(&self) -> &str {
        self.name.rsplit(' ').next().unwrap_or_default()
    }

    /// Runs it to its end: its output, and whether it succeeded.
    fn run(&mut self) -> anyhow::Result<(String, bool)> {
        let (mut reader, writer) = std::io::pipe()?;
        self.command
            .stdin(Stdio::null())
            .stdout(writer.try_clone()?)
            .stderr(writer);
        let mut child = self.command.spawn()?;
        // Let go of the writing side, so that the pipe ends when the program has.
        self.command.stdout(Stdio::null()).stderr(Stdio::null());
        let mut output = Vec::new();
        reader.read_to_end(&mut output)?;
        let succeeded = child.wait()?.success();
        Ok((String::from_utf8_lossy(&output).into_owned(), succeeded))
    }
}

/// Builds what a `cargo test` command would run, and returns it.
pub fn build(command: &mut Command) -> anyhow::Result<Vec<Program>> {
    let output = command
        .args(["--no-run", "--message-format=json-render-diagnostics"])
        .stderr(Stdio::inherit())
        .output()
        .context("cannot start cargo")?;
    ensure!(
        output.status.success(),
        "the tests do not build; the compiler's messages are above"
    );
    let messages = String::from_utf8_lossy(&output.stdout);
    let programs: Vec<Program> = messages.lines().filter_map(program).collect();
    ensure!(!programs.is_empty(), "cargo has named no test program");
    Ok(programs)
}

/// The test program that a message of cargo names.
fn program(message: &str) -> Option<Program> {
    let message: serde_json::Value = serde_json::from_str(message).ok()?;
    if message["profile"]["test"] != true {
        return None;
    }
    let executable = PathBuf::from(message["executable"].as_str()?);
    // Where cargo starts it.
    let package = Path::new(message["manifest_path"].as_str()?).parent()?;
    let folder = package.file_name()?.to_string_lossy();
    let target = message["target"]["name"].as_str()?;
    let is_test = message["target"]["kind"][0] == "test";
    let name = if is_test {
        format!("{folder}: {target}")
    } else {
        format!("{folder}: units of {target}")
    };
    let mut command = Command::new(executable);
    command.current_dir(package);
    if std::env::var_os("RUST_TEST_THREADS").is_none() {
        command.env("RUST_TEST_THREADS", "1");
    }
    Some(Program { name, command })
}

/// Runs all of them, each in this environment: as many at a time as there are cores, and beside
/// them what waits.
pub fn on_all_cores(
    mut programs: Vec<Program>,
    environment: &[(&str, PathBuf)],
) -> anyhow::Result<()> {
    for program in &mut programs {
        program.command.envs(environment.iter().cloned());
    }
    let (waiting, others): (Vec<_>, Vec<_>) = programs
        .into_iter()
        .partition(|program| WAITING.contains(&program.target()));
    let (cores, all) = (cores()?, waiting.len() + others.len());
    let waiting = Mutex::new(waiting.into());
    let others = Mutex::new(longest_first(others).into());
    let each = (0..cores).map(|core| (&others, Some(core)));
    run(each.chain([(&waiting, None)]), all)
}

/// Runs rows of programs side by side, each program after those before it in its row; and beside
/// them the others, as many at a time as there are cores.
pub fn in_rows<const N: usize>(
    rows: [Vec<Program>; N],
    others: Vec<Program>,
) -> anyhow::Result<()> {
    let all = rows.iter().map(Vec::len).sum::<usize>() + others.len();
    let rows = rows.map(|row| Mutex::new(row.into()));
    let others = Mutex::new(others.into());
    let queues = std::iter::repeat_n(&others, cores()?).chain(&rows);
    run(queues.map(|queue| (queue, None)), all)
}

fn cores() -> anyhow::Result<usize> {
    Ok(std::thread::available_parallelism()?.get())
}

/// Takes programs, `all` in number, from these queues, one at a time from each, until they are
/// empty; with a queue comes the core that its programs stay on, if any. One that fails does not
/// hide the others.
fn run<'a>(
    queues: impl Iterator<Item = (&'a Mutex<VecDeque<Program>>, Option<usize>)>,
    all: usize,
) -> anyhow::Result<()> {
    let failed = Mutex::new(Vec::new());
    let ended = Mutex::new(0);
    std::thread::scope(|scope| {
        for (queue, core) in queues {
            let (failed, ended) = (&failed, &ended);
            scope.spawn(move || {
                if let Some(core) = core {
                    stay_on(core);
                }
                while let Some(mut program) = next(queue) {
                    let begin = Instant::now();
                    let outcome = program.run();
                    let seconds = begin.elapsed().as_secs_f64();
                    let (output, succeeded) =
                        outcome.unwrap_or_else(|error| (format!("{error:#}\n"), false));
                    let name = program.name;
                    let mut ended = lock(ended);
                    *ended += 1;
                    println!("-- {name}: {seconds:.1} s ({ended} of {all})\n{output}");
                    drop(ended);
                    if !succeeded {
                        lock(failed).push(name);
                    }
                }
            });
        }
    });
    let failed = lock(&failed);
    if !failed.is_empty() {
        bail!("failed: {}", failed.join("; "));
    }
    Ok(())
}

/// Keeps this thread, and what it starts from now on, on one of the cores that it may use, where it
/// may use all of their time. One that has only a part of it (a container's quota) is not to choose
/// among the cores, as another may have chosen the same.
fn stay_on(number: usize) {
    #[cfg(target_os = "linux")]
    {
        use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
        let Ok(usable) = sched_getaffinity(None) else {
            return;
        };
        let all = (0..CpuSet::MAX_CPU).filter(|core| usable.is_set(*core));
        let all: Vec<usize> = all.collect();
        let has_all = cores().is_ok_and(|cores| cores == all.len());
        if let Some(core) = all.get(number).filter(|_| has_all) {
            let mut one = CpuSet::new();
            one.set(*core);
            let _ = sched_setaffinity(None, &one);
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = number;
}

/// The longest first, the others as they come.
fn longest_first(mut programs: Vec<Program>) -> Vec<Program> {
    let place = |program: &Program| {
        let target = program.target();
        let place = LONGEST.iter().position(|name| *name == target);
        place.unwrap_or(LONGEST.len())
    };
    programs.sort_by_key(place);
    programs
}

fn next(waiting: &Mutex<VecDeque<Program>>) -> Option<Program> {
    lock(waiting).pop_front()
}

/// Nothing that holds one of these mutexes panics but at a closed standard output.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_program_stays_on_the_core_of_its_row() {
        let count = || {
            Program::new("cores", Command::new("nproc"))
                .run()
                .unwrap()
                .0
        };
        let all = count();
        let has_all = all == format!("{}\n", cores().unwrap());
        std::thread::scope(|scope| {
            scope.spawn(|| {
                stay_on(0);
                assert_eq!(count(), if has_all { "1\n" } else { &all });
            });
        });
        assert_eq!(count(), all);
    }
}
