//! The paper's experiments, driven over the bus: do the robots do there what the plants do alone?

use std::process::Command;

use omnibus_sim::Backend;
use omnibus_sim::paper::{Findings, OnPlant, SCENARIOS, Setting, find, page};

fn found(name: &str, plants: &[OnPlant]) -> Findings {
    let setting = Setting {
        backend: Backend::Native,
        plants: plants.to_vec(),
    };
    let findings = find(name).unwrap().run(&setting).unwrap();
    print!("{}", page::to_text(&findings));
    findings
}

/// Motors, wheel loops, encoders and the bus's steps of 0.1 mm/s and 0.1 mrad/s in between cost
/// less than a tenth of a point; the rest is the plants'.
const WITHIN: f64 = 0.6;

#[test]
fn turning_and_curves_come_out_over_the_bus() {
    for (name, rows) in [("table-5", 3), ("table-6", 4)] {
        let findings = found(name, &[]);
        assert_eq!((findings.rows.len(), findings.columns.len()), (rows, 2));
        for row in &findings.rows {
            let paper = row.paper.unwrap();
            for ours in &row.ours {
                assert!((ours - paper).abs() < WITHIN, "{name}: {row:?}");
            }
        }
        assert_eq!(findings.charts.len(), if name == "table-5" { 1 } else { 2 });
    }
}

/// C3 takes most of the sideways error away, as in Table 9.
#[test]
fn compensation_improves_the_physical_robots_curves() {
    let findings = found("table-9", &[OnPlant::Table]);
    for curve in ["circle", "figure-eight"] {
        let error = |word: &str| {
            let what = format!("{curve} {word} C3, x");
            let row = findings.rows.iter().find(|row| row.what == what).unwrap();
            row.ours[0].abs()
        };
        let (without, with) = (error("without"), error("with"));
        assert!(without > 12.0 && with < 2.0, "{curve}: {without} {with}");
    }
}

/// What the paper's figures 22 and 24 say in words: the distance of free robots changes, that of
/// connected ones does not.
#[test]
fn free_robots_lose_their_distance() {
    let change = |name: &str| {
        let findings = found(name, &[]);
        let rows = findings
            .rows
            .iter()
            .filter(|row| row.what.contains("distance of the robots"));
        rows.map(|row| row.ours[0]).fold(0.0, f64::max)
    };
    let (connected, free) = (change("scc-2"), change("suc-2"));
    assert!(connected < 1e-6, "{connected}");
    assert!(free > 5.0, "{free}");
}

#[test]
fn every_experiment_has_a_name_of_its_own() {
    let mut names: Vec<_> = SCENARIOS.iter().map(|scenario| scenario.name).collect();
    assert_eq!(names.len(), 7 + 11 + 7);
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 25);
}

#[test]
fn the_command_lists_runs_and_refuses() {
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
            .args(arguments)
            .output()
            .unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (
            output.status.success(),
            text(output.stdout),
            text(output.stderr),
        )
    };
    let (fine, list, _) = run(&["paper", "--list"]);
    assert!(fine && list.lines().count() == 25, "{list}");
    let (fine, _, error) = run(&["paper", "table-2"]);
    assert!(!fine);
    assert_eq!(
        error,
        "error: paper table-2: no experiment has this name; --list prints them all\n"
    );
    let (fine, _, error) = run(&["paper", "table-8", "--elf", "no.elf"]);
    assert!(!fine);
    assert_eq!(
        error,
        "error: --elf no.elf: native robots run no image; add --backend emulator\n"
    );
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("paper");
    let out = folder.to_str().unwrap();
    let (fine, text, error) = run(&["paper", "table-8", "--plant", "table", "--out", out]);
    assert!(fine, "{error}");
    assert!(text.contains("-2.550 %"), "{text}");
    let page = std::fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(page.contains("turning, set 0.5236 rad/s") && page.contains("<svg"));
    let figure = std::fs::read_to_string(folder.join("table-8-1.svg")).unwrap();
    assert!(figure.contains("paper\n") && figure.contains("table plant\n"));
}

/// The reader of the figures has seen enough: what was found by then is on the disk.
#[test]
fn findings_outlive_their_reader() {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("paper-unread");
    let _ = std::fs::remove_dir_all(&folder);
    let mut child = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
        .args(["paper", "table-8", "--plant", "table", "--out"])
        .arg(&folder)
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    child.wait().unwrap();
    assert!(folder.join("report.html").is_file());
    assert!(folder.join("table-8-1.svg").is_file());
}
