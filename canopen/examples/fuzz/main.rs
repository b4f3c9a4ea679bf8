//! Frame streams at a device: `fuzz [--frames N] [--seed N]`.
//!
//! The same seed gives the same frames, and the digest at the end says whether the device answered
//! the same. What is done to the device and what must hold is in [`harness`].

mod harness;

use std::time::Instant;

use harness::{CALLS, EVENTS, Source, Totals, life};

/// Codes of SDO aborts that a million frames bring about.
const ABORTS: usize = 20;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let option = |name: &str, default: u64| {
        let at = arguments.iter().position(|argument| argument == name);
        at.and_then(|at| arguments.get(at + 1)?.parse().ok())
            .unwrap_or(default)
    };
    let (frames, seed) = (option("--frames", 1_000_000), option("--seed", 1));
    let mut random = Source::Seed(seed);
    let mut totals = Totals::NONE;
    let start = Instant::now();
    let mut left = frames;
    while left > 0 {
        let now = left.min(5_000);
        life(&mut random, now, &mut totals);
        left -= now;
    }
    println!(
        "{frames} frames in, {} out, no panic, digest {:016x}, {:.1} s",
        totals.answers,
        totals.digest,
        start.elapsed().as_secs_f64()
    );
    println!(
        "{} of {EVENTS} kinds of events, {} SDO abort codes, {} whole transfers",
        totals.events.len(),
        totals.aborts.len(),
        totals.transfers
    );
    // What a stream never reaches, it does not test.
    let everywhere = totals.events.len() == EVENTS && totals.calls == CALLS;
    assert!(
        frames < 1_000_000 || everywhere && totals.aborts.len() >= ABORTS,
        "the frames do not get everywhere"
    );
}
