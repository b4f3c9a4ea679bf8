//! Runs one image alone for some time and prints its log, its speed and where its instructions go.
//!
//! `cargo run -p omnibus-emulator --example boot -- ELF [SECONDS] [--profile]`

use std::time::Instant;

use emulator::{Board, BoardConfig, Firmware, Port};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments
        .next()
        .ok_or("the path of an ELF file is missing")?;
    let seconds: f64 = arguments.next().map_or(Ok(1.0), |text| text.parse())?;
    let profile = arguments.next().is_some();

    let firmware = Firmware::load(path)?;
    let mut board = Board::new(&firmware, BoardConfig::default());
    board.set_input(Port::B, 12, false);
    if profile {
        board.start_profile();
    }
    let end = (seconds * 1e9) as u64;
    let started = Instant::now();
    let mut t = 0;
    while t < end {
        t = (t + 1_000_000).min(end);
        let result = board.run_until(t);
        for line in board.take_log() {
            println!("{line}");
        }
        result?;
        let mut can = board.can();
        while let Some(frame) = can.begin() {
            println!("{t:>12} ns {frame:x?}");
            can.transmitted();
        }
    }
    let wall = started.elapsed().as_secs_f64();
    let (cycles, slept) = board.cycles();
    println!(
        "{:.1} x real time; {} instructions, {:.1} million per second of wall time; load {:.2} %; \
         {} resets",
        seconds / wall,
        board.instructions(),
        board.instructions() as f64 / wall * 1e-6,
        100.0 * (cycles - slept) as f64 / cycles as f64,
        board.resets(),
    );
    for channel in 1..=4 {
        println!("TIM1 channel {channel}: {:?}", board.pwm(1, channel));
    }
    println!("CAN {:?} bit/s", board.can().bit_rate());
    if let Some(profile) = board.take_profile() {
        for (name, usage) in profile.functions(&firmware).into_iter().take(30) {
            println!(
                "{:>10} instructions {:>8} calls  {name}",
                usage.instructions, usage.calls
            );
        }
        println!("{:?}", profile.exceptions());
    }
    Ok(())
}
