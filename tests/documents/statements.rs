//! Sentences of the documents that state a number, each beside the constant that it comes from.
//!
//! When a constant changes, its test names the sentence that has become false.

use super::{files, nothing, paragraphs, read};

/// A part of a sentence, and a line of code that makes it true.
struct Statement {
    page: &'static str,
    words: &'static str,
    source: &'static str,
    code: &'static str,
}

const fn says(
    page: &'static str,
    words: &'static str,
    source: &'static str,
    code: &'static str,
) -> Statement {
    Statement {
        page,
        words,
        source,
        code,
    }
}

const BUS_OFF: &str = "canopen/src/device/bus_off.rs";
const ALONE: &str = "robot/src/application/alone.rs";
const SILENCE: &str = "control/src/silence.rs";
const MEMORY: &str = "robot/src/fault_memory.rs";
const ADAPTATION: &str = "master/src/path/adaptation.rs";
const TELEMETRY: &str = "master/src/monitor/telemetry/mod.rs";
const OUTBOX: &str = "canopen/src/device/outbox.rs";
const SDO: &str = "canopen/src/device/sdo/mod.rs";
const DEVICE: &str = "docs/adr/0004-canopen-device.md";
const CLOCK: &str = "docs/adr/0007-one-clock-for-the-group.md";
const PAGE: &str = "docs/adr/0017-page.md";
const WHEELS: &str = "docs/adr/0024-wheel-protection.md";
const BUS: &str = "docs/adr/0025-who-else-is-on-the-bus.md";
const PAST: &str = "docs/adr/0033-what-was-is-not-what-is.md";
const SHARES: &str = "docs/adr/0038-steering-learns-shares.md";
const SAFETY: &str = "docs/safety.md";
const LIBRARY: &str = "canopen/README.md";

const STATEMENTS: &[Statement] = &[
    says(
        "docs/can-protocol.md",
        "objects 0x1005 to 0x1007, 0x1014 to 0x1017, 0x1019, 0x1029, 0x1400 to 0x1BFF and 0x1F80",
        "canopen/src/device/objects.rs",
        "0x1005..=0x1007 | 0x1014..=0x1017 | 0x1019 | 0x1029 | 0x1400..=0x1BFF | 0x1F80",
    ),
    says(
        DEVICE,
        "recovery after 100 ms,",
        BUS_OFF,
        "FIRST_PAUSE: Micros = Micros::from_millis(100)",
    ),
    says(
        DEVICE,
        "up to 3.2 s,",
        BUS_OFF,
        "LONGEST_PAUSE: Micros = Micros::from_millis(3_200)",
    ),
    says(
        DEVICE,
        "after ten good seconds",
        BUS_OFF,
        "GOOD: Micros = Micros::from_millis(10_000)",
    ),
    says(
        DEVICE,
        "one buffer of 511 bytes",
        SDO,
        "MAX_SDO: usize = 511",
    ),
    says(
        DEVICE,
        "blocks SDO for one second",
        SDO,
        "TIMEOUT: Micros = Micros::from_millis(1_000)",
    ),
    says(
        DEVICE,
        "(4 in,",
        "canopen/src/device/rpdo.rs",
        "MAX_RPDO: usize = 4",
    ),
    says(
        DEVICE,
        "8 out)",
        "canopen/src/device/tpdo.rs",
        "MAX_TPDO: usize = 8",
    ),
    says(
        LIBRARY,
        "values up to 511 bytes",
        SDO,
        "MAX_SDO: usize = 511",
    ),
    says(
        LIBRARY,
        "17 consumers",
        "canopen/src/device/heartbeat.rs",
        "MAX_CONSUMERS: usize = 17",
    ),
    says(
        LIBRARY,
        "recovery after 100 ms, doubling",
        BUS_OFF,
        "FIRST_PAUSE: Micros = Micros::from_millis(100)",
    ),
    says(LIBRARY, "queue (16 frames)", OUTBOX, "FRAMES: usize = 16"),
    says(LIBRARY, "queue (16 events)", OUTBOX, "EVENTS: usize = 16"),
    says(
        CLOCK,
        "at most 2 % towards",
        "control/src/clock.rs",
        "{ TICK_US / 50 }",
    ),
    says(
        "docs/adr/0014-roller-phase.md",
        "over in 64 ticks",
        "control/src/rollers/tracked.rs",
        "BLEND: u16 = 64",
    ),
    says(
        "docs/adr/0016-sync-from-its-own-thread.md",
        "until 0.3 ms before",
        "master/src/bus/adapter/pace.rs",
        "SPIN: Duration = Duration::from_micros(300)",
    ),
    says(
        "docs/adr/0012-stops-without-the-processor-or-the-bus-side.md",
        "as silent after 25 ms",
        "control/src/tick/judge.rs",
        "BUS_SILENT_US: u32 = 25_000",
    ),
    says(
        PAGE,
        "At most 24 connections",
        "master/src/serve/server.rs",
        "MOST: usize = 24",
    ),
    says(
        PAGE,
        "valid for 250 ms",
        "master/src/controls/arbiter.rs",
        "STALE_MS: u64 = 250",
    ),
    says(
        "docs/adr/0018-tick-timer-and-one-bell.md",
        "runs every 5 ms",
        "src/bus_task.rs",
        "LONGEST_WAIT: Micros = Micros(5_000)",
    ),
    says(
        WHEELS,
        "missed 15 ms and 0.05 rad",
        SILENCE,
        "DEAD_TIME: Time = Time::new(0.015)",
    ),
    says(
        WHEELS,
        "15 ms and 0.05 rad of motion",
        SILENCE,
        "DEAD_ANGLE: f32 = 0.05",
    ),
    says(
        WHEELS,
        "after 10 ms and three missing counts",
        SILENCE,
        "SUSPECTED_TIME: Time = Time::new(0.010)",
    ),
    says(
        WHEELS,
        "after 10 ms and three missing counts",
        SILENCE,
        "SUSPECTED_COUNTS: f32 = 3.0",
    ),
    says(
        SAFETY,
        "15 ms and 0.05 rad (7.6 mm",
        SILENCE,
        "DEAD_ANGLE: f32 = 0.05",
    ),
    says(
        SAFETY,
        "after 10 ms and three counts",
        SILENCE,
        "SUSPECTED_COUNTS: f32 = 3.0",
    ),
    says(
        BUS,
        "ends after 60 s",
        ALONE,
        "PERMISSION_US: u64 = 60_000_000",
    ),
    says(BUS, "up to 0.25 m/s", ALONE, "SPEED: f32 = 0.25"),
    says(BUS, "and 0.5 rad/s", ALONE, "YAW_RATE: f32 = 0.5"),
    says(
        BUS,
        "a second (ten heartbeats)",
        "robot/src/application/others.rs",
        "HEARTBEAT_MS as u64 * 10_000",
    ),
    says(PAST, "older than 100 ms", TELEMETRY, "PRESENT: f64 = 0.1"),
    says(
        PAST,
        "older than a second",
        TELEMETRY,
        "PRESENT_NMT: f64 = 1.0",
    ),
    says(
        SHARES,
        "bounded by a tenth",
        ADAPTATION,
        "LARGEST_SHARE: f32 = 0.1",
    ),
    says(SHARES, "and 30 ms,", ADAPTATION, "LARGEST_LAG: f32 = 0.03"),
    says(
        SAFETY,
        "been off for 0.5 s",
        MEMORY,
        "REST_US: u64 = 500_000",
    ),
    says(
        SAFETY,
        "first second after power-on",
        MEMORY,
        "FIRST_US: u64 = 1_000_000",
    ),
    says(
        SAFETY,
        "eight every 10 s",
        MEMORY,
        "PAUSE_US: u64 = 10_000_000",
    ),
    says(
        SAFETY,
        "for 3 s at most",
        "src/watchdog.rs",
        "GRACE_TICKS: u32 = 3_000_000 / TICK_US",
    ),
];

#[test]
fn numbers_in_the_documents_are_those_of_the_sources() {
    let mut complaints = Vec::new();
    for statement in STATEMENTS {
        let Statement {
            page,
            words,
            source,
            code,
        } = statement;
        if !paragraphs(&read(page)).join("\n").contains(words) {
            complaints.push(format!("{page} does not say '{words}' any more"));
        }
        if !read(source).contains(code) {
            complaints.push(format!(
                "{page} says '{words}', but {source} has no '{code}'"
            ));
        }
    }
    nothing(&complaints);
}

/// First cells of the table that the demo prints, in their order.
#[test]
fn the_sample_of_the_demo_has_the_rows_of_a_report() {
    let page = read("README.md");
    let rows = page.lines().filter_map(|line| line.strip_prefix("│ "));
    let cells = rows.map(|row| row.split('┆').next().unwrap_or_default().trim());
    let sample: Vec<&str> = cells.filter(|cell| !cell.is_empty()).collect();
    let group = group::GroupFile::load(super::root().join("groups/tcc-3.toml")).expect("tcc-3");
    let curve = omnibus::path::curve::Curve::FigureEight.name();
    let backend = omnibus::report::BackendName::Emulator;
    let report = omnibus::run::report(&group, curve, backend, Vec::new());
    let printed = omnibus::report::figures::rows(&report);
    let names: Vec<&str> = printed.iter().map(|row| row.name).collect();
    assert_eq!(sample, names, "README.md shows another table than the demo");
}

/// Log lines of the firmware, each up to its first value.
#[test]
fn every_line_of_the_log_is_explained() {
    let page = read("docs/bring-up.md");
    let (mut complaints, mut lines) = (Vec::new(), 0);
    let firmware = files("rs")
        .into_iter()
        .filter(|path| path.starts_with("src"));
    for path in firmware {
        let text = read(&path);
        for call in ["defmt::info!(", "defmt::warn!(", "defmt::error!("] {
            for rest in text.split(call).skip(1) {
                let Some(literal) = rest.trim_start().strip_prefix('"') else {
                    continue;
                };
                let line = literal.split(['{', '"']).next().unwrap_or_default().trim();
                lines += 1;
                if !page.contains(line) {
                    complaints.push(format!("{}: '{line}' is not explained", path.display()));
                }
            }
        }
    }
    assert!(lines > 15, "only {lines} lines found");
    nothing(&complaints);
}
