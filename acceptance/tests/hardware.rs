//! Reports in `docs/hardware/`, and the table of README that is made from them.

use std::path::Path;

use acceptance::hardware::{check, rows};
use serde_json::{Value, json};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

fn read(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap();
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// All reports, by name.
fn reports() -> Vec<(String, Value)> {
    let folder = Path::new(ROOT).join("docs/hardware");
    let mut reports = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name == "README.md" {
            continue;
        }
        assert!(name.ends_with(".json"), "{name} is no report");
        reports.push((name, read(&path)));
    }
    reports.sort_by(|a, b| a.0.cmp(&b.0));
    reports
}

fn emulated() -> Vec<(u8, Value)> {
    let path = |level| Path::new(ROOT).join(format!("acceptance/emulated/level-{level}.json"));
    [1, 2, 3].map(|level| (level, read(&path(level)))).to_vec()
}

fn good() -> Value {
    json!({"format": 2, "level": 1, "board": "NUCLEO-F446RE", "chip": "STM32F446RE, revision A",
           "versions": "0.1.0", "date": "2026-12-01", "hardware": true, "mutation": null,
           "kept": 1, "missed": 0, "not_tried": 0,
           "checks": [{"name": "stop.pwm", "promised": 1.0, "measured": 0.001, "unit": "ms",
                       "within": true}]})
}

#[test]
fn every_report_of_hardware_has_the_format() {
    for (name, report) in reports() {
        check(&report).unwrap_or_else(|error| panic!("{name}: {error}"));
    }
    check(&good()).unwrap();
}

#[test]
fn what_is_no_report_of_hardware_is_refused() {
    for (field, value) in [
        ("format", json!(1)),
        ("level", json!(4)),
        ("board", json!("")),
        ("chip", json!(null)),
        ("date", json!(20)),
        ("hardware", json!(false)),
        ("mutation", json!("pwm-half")),
        ("checks", json!([])),
        (
            "checks",
            json!([{"name": "a", "unit": "ms", "promised": "1"}]),
        ),
        (
            "checks",
            json!([{"name": "a", "unit": "ms", "promised": 1, "within": "yes"}]),
        ),
    ] {
        let mut report = good();
        report[field] = value;
        let error = check(&report).unwrap_err().to_string();
        let named = error.contains(field) || field == "checks" && error.starts_with("a:");
        assert!(named, "{field}: {error}");
    }
    for (level, report) in emulated() {
        assert!(check(&report).is_err(), "level {level} is emulated");
        assert_eq!(report["hardware"], false);
        assert_eq!(report["missed"], 0);
        assert_eq!(report["level"], level);
    }
}

#[test]
fn a_report_appears_in_the_table() {
    let reports = [("2026-12-01-nucleo-level1.json".to_owned(), good())];
    let rows = rows(&[], &reports);
    assert!(rows.contains(
        "on hardware, [NUCLEO-F446RE, 2026-12-01](docs/hardware/2026-12-01-nucleo-level1.json): 1 \
         promises kept, 0 missed, 0 not tried"
    ));
    assert_eq!(rows.matches("not run on hardware").count(), 2);
}

const BEGIN: &str = "<!-- acceptance -->\n";
const END: &str = "<!-- end of acceptance -->\n";

#[test]
fn readme_says_what_has_run_on_hardware() {
    let path = Path::new(ROOT).join("README.md");
    let readme = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = readme.split_once(BEGIN).expect("README.md has the mark");
    let (_, after) = rest.split_once(END).expect("README.md has the end mark");
    let head = "| | status |\n|---|---|\n";
    let table = rows(&emulated(), &reports());
    let wanted = format!("{before}{BEGIN}{head}{table}{END}{after}");
    if std::env::var_os("OMNIBUS_WRITE_DOCS").is_some() {
        std::fs::write(&path, &wanted).unwrap();
        return;
    }
    assert_eq!(readme, wanted, "write it with OMNIBUS_WRITE_DOCS=1");
}
