//! Only `src/board/` knows the chip, only a board's file knows its pins; and a command that drives
//! watches for signals.
//!
//! A check reads the sources as text, comments left out.

use std::fs;
use std::path::{Path, PathBuf};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// The folder of the boards.
const BOARD: &str = "src/board";

/// What only the board may name. The processor's crates too, but for the mark on the entry.
const OF_THE_CHIP: [&str; 6] = [
    "embassy_stm32",
    "pac::",
    "cortex_m::",
    "unsafe",
    "asm!",
    "interrupt::",
];

/// Files below a folder, relative to the root.
fn sources(folder: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![PathBuf::from(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(Path::new(ROOT).join(&folder)).expect("a folder of the package") {
            let entry = entry.expect("an entry");
            let path = folder.join(entry.file_name());
            if entry.path().is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    found
}

/// Lines of code with their numbers.
fn code(path: &Path) -> Vec<(usize, String)> {
    let text = fs::read_to_string(Path::new(ROOT).join(path)).expect("a source");
    let lines = text.lines().zip(1..);
    lines
        .filter(|(line, _)| !line.trim_start().starts_with("//"))
        .map(|(line, number)| (number, line.split(" // ").next().unwrap_or(line).to_owned()))
        .collect()
}

/// Whether a word is the name of a pin: P, a port, a number.
fn is_pin(word: &str) -> bool {
    let mut letters = word.chars();
    letters.next() == Some('P')
        && letters
            .next()
            .is_some_and(|port| ('A'..='I').contains(&port))
        && !letters.as_str().is_empty()
        && letters.all(|letter| letter.is_ascii_digit())
}

fn has_pin(line: &str) -> bool {
    line.split(|letter: char| !letter.is_ascii_alphanumeric())
        .any(is_pin)
}

/// Fails with all complaints at once.
fn nothing(complaints: &[String]) {
    assert!(complaints.is_empty(), "\n{}", complaints.join("\n"));
}

#[test]
fn only_the_board_knows_the_chip() {
    let mut complaints = Vec::new();
    for path in sources("src") {
        if path.starts_with(BOARD) {
            continue;
        }
        // There has to be one place that tells the robot's target from the host.
        let switch = path == Path::new("src/main.rs");
        for (number, line) in code(&path) {
            let known = OF_THE_CHIP.iter().find(|word| line.contains(**word));
            let target = line.contains("target_os") && !switch;
            if known.is_some() || target || has_pin(&line) {
                complaints.push(format!("{}:{number}: {line}", path.display()));
            }
        }
    }
    nothing(&complaints);
}

#[test]
fn a_chip_family_names_no_pin_and_no_board() {
    let mut complaints = Vec::new();
    let boards = boards();
    for path in sources(BOARD) {
        if path.parent() == Some(Path::new(BOARD)) {
            continue;
        }
        for (number, line) in code(&path) {
            let board = boards.iter().any(|board| line.contains(board.as_str()));
            if board || has_pin(&line) {
                complaints.push(format!("{}:{number}: {line}", path.display()));
            }
        }
    }
    nothing(&complaints);
}

/// Names of the boards: the files with a `WIRING` of their own.
fn boards() -> Vec<String> {
    let declares = |path: &PathBuf| {
        code(path)
            .iter()
            .any(|(_, line)| line.starts_with("pub const WIRING"))
    };
    let paths = sources(BOARD).into_iter().filter(declares);
    let names = paths.filter_map(|path| path.file_stem()?.to_str().map(str::to_owned));
    names.collect()
}

#[test]
fn every_board_is_built_and_described() {
    let boards = boards();
    assert!(boards.len() >= 2, "{boards:?}");
    let mut complaints = Vec::new();
    for board in boards {
        let feature = format!("board-{}", board.replace('_', "-"));
        for (file, text) in [
            ("Cargo.toml", format!("\n{feature} = [")),
            ("build.rs", format!("(\"{feature}\", ")),
            ("src/board/mod.rs", format!("feature = \"{feature}\"")),
            ("docs/boards.md", format!("`{feature}`")),
            ("xtask/src/firmware.rs", format!("\"{feature}\"")),
        ] {
            let there = fs::read_to_string(Path::new(ROOT).join(file)).expect("a file");
            if !there.contains(&text) {
                complaints.push(format!("{file} lacks {text:?}"));
            }
        }
    }
    nothing(&complaints);
}

/// The folder of a program or library that a section of a manifest declares to be without tests.
fn untested(package: &str, section: &str) -> Option<PathBuf> {
    let is_target = section.starts_with("lib]") || section.starts_with("[bin]]");
    if !is_target || !section.contains("\ntest = false\n") {
        return None;
    }
    let path = section.split("\npath = \"").nth(1);
    let path = path.and_then(|rest| rest.split('"').next());
    let path = Path::new(package).join(path.unwrap_or("src/lib.rs"));
    path.parent().map(Path::to_path_buf)
}

/// A target that no test program is built of has no tests in its sources, which nothing would run.
#[test]
fn no_test_lies_where_none_is_run() {
    let manifest = |package: &str| {
        let path = Path::new(ROOT).join(package).join("Cargo.toml");
        fs::read_to_string(path).expect("a manifest")
    };
    let workspace = manifest(".");
    let members = workspace.split("members = [").nth(1).expect("members");
    let members = members.split(']').next().expect("their end");
    let packages = members.split('"').skip(1).step_by(2);
    let folders: Vec<PathBuf> = packages
        .flat_map(|package| {
            let manifest = manifest(package);
            let sections = manifest.split("\n[");
            let folders = sections.filter_map(|section| untested(package, section));
            folders.collect::<Vec<_>>()
        })
        .collect();
    assert!(
        folders.contains(&PathBuf::from("vda5050/src")),
        "{folders:?}"
    );
    let mut complaints = Vec::new();
    for folder in &folders {
        for path in sources(&folder.to_string_lossy()) {
            let lines = code(&path).into_iter();
            let tests =
                lines.filter(|(_, line)| line.contains("#[test]") || line.contains("cfg(test"));
            complaints.extend(tests.map(|(number, _)| {
                format!("{}:{number}: its target has `test = false`", path.display())
            }));
        }
    }
    nothing(&complaints);
}

/// A command that drives a group ends at Ctrl-C, SIGTERM and a closed terminal with the robots
/// ramped down: it asks for that before it takes the bus.
#[test]
fn what_drives_watches_for_signals() {
    let mut complaints = Vec::new();
    let mut drives = 0;
    for path in sources("master/src/cli") {
        let lines = code(&path);
        let has = |parts: &[&str]| {
            lines
                .iter()
                .any(|(_, line)| parts.iter().any(|part| line.contains(part)))
        };
        if has(&[".pilot(", ".command(&", "Group::connect("]) {
            drives += 1;
            if !has(&["abort_on_ctrl_c(", "configured("]) {
                complaints.push(format!(
                    "{}: drives, and is killed by a signal",
                    path.display()
                ));
            }
        }
    }
    nothing(&complaints);
    assert!(drives >= 10, "{drives}");
}
