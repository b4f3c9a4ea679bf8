//! Whether the library still works.
//!
//! It waits for the network in two threads. In a process that was stopped and continued (Ctrl-Z and
//! `fg`, a debugger, a computer that slept) the kernel ends such waits with EINTR, though no signal
//! has a handler (signal(7)). For `RustDDS` 0.15.1 that is the end: its threads return, and nothing
//! is received any more, without an error anywhere.
//!
//! Limits: threads are found by their names, in `/proc`. Without it they are taken to run.

/// The names of the threads, cut by the kernel to fifteen bytes.
const NAMES: [&str; 2] = ["RustDDS discove", "RustDDS Partici"];

/// Whether all threads of the library run.
pub(super) fn run() -> bool {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else {
        return true;
    };
    let names: Vec<String> = tasks
        .flatten()
        .filter_map(|task| std::fs::read_to_string(task.path().join("comm")).ok())
        .collect();
    NAMES
        .iter()
        .all(|wanted| names.iter().any(|name| name.trim_end() == *wanted))
}
