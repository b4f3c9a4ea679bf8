//! `omnibus bus-load --robots N --rate HZ`: how full the bus will be, calculated.

use omnibus::bus::load::{BUSY, Stuffing, total, traffic};
use serde_json::json;

use super::{json, output, print_json, print_line};

const EXAMPLES: &str = "Examples:
  omnibus bus-load --robots 8
  omnibus bus-load --robots 8 --gyros 2
  omnibus bus-load --robots 16 --rate 50 --json";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Number of robots on the bus.
    #[arg(long)]
    robots: u8,
    /// Number of robots with a gyro, which send their yaw rate.
    #[arg(long, default_value_t = 0)]
    gyros: u8,
    /// Number of SYNCs per second.
    #[arg(long, default_value_t = 100.0, value_name = "HZ", value_parser = super::real::<f64>)]
    rate: f64,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let (robots, rate) = (arguments.robots, arguments.rate);
    if !(1..=16).contains(&robots) {
        usage!(
            "--robots: {robots} is not between 1 and 16, which is what one bus has node ids for"
        );
    }
    if arguments.gyros > robots {
        usage!(
            "--gyros: {} is more than the {robots} robots",
            arguments.gyros
        );
    }
    if !(10.0..=500.0).contains(&rate) {
        usage!("--rate: {rate} Hz is not between 10 and 500 Hz (object 2041:1)");
    }
    let traffic = traffic(robots, arguments.gyros, rate);
    let total = total(&traffic);
    if json() {
        let lines = traffic.iter().map(|line| {
            let share = line.share();
            json!({"name": line.name, "bytes": line.bytes, "rate_hz": line.rate_hz,
                   "least_percent": percent(share.none), "most_percent": percent(share.most)})
        });
        let lines: Vec<_> = lines.collect();
        return print_json(
            &json!({"robots": robots, "gyros": arguments.gyros, "rate_hz": rate, "frames": lines,
            "least_percent": percent(total.none), "most_percent": percent(total.most)}),
        );
    }
    let mut table = output::table(["frame", "bytes", "per second", "share of 1 Mbit/s"]);
    let range =
        |share: Stuffing<f64>| format!("{:.1} to {:.1} %", share.none * 100.0, share.most * 100.0);
    for line in &traffic {
        table.add_row([
            line.name.to_owned(),
            line.bytes.to_string(),
            format!("{:.0}", line.rate_hz),
            range(line.share()),
        ]);
    }
    table.add_row([
        "together".into(),
        String::new(),
        String::new(),
        range(total),
    ]);
    print_line(&table)?;
    print_line("The load depends on the data: from no stuff bits to the largest possible number.")?;
    if total.most > 1.0 {
        print_line(
            "This exceeds the capacity of the bus. Lower --rate (sync_period_ms in the group file).",
        )?;
    } else if total.most > BUSY {
        print_line(
            "This leaves too little capacity for parameters and node management. Lower --rate.",
        )?;
    }
    Ok(())
}

/// Per cent with two decimals.
fn percent(share: f64) -> f64 {
    (share * 1e4).round() / 1e2
}
