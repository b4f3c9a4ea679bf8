//! docs/operating.md, run literally: every console line of it, in its order, against the simulator
//! that it tells people to start.
//!
//! A block of lines that cannot run here has a marker in front: `<!-- not run: REASON -->`. Time in
//! the served world waits for the master and passes as fast as it can, so nothing here depends on
//! how busy this machine is.

mod common;

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use common::{Served, programs, root};

/// A line of the page.
struct Line {
    number: usize,
    text: String,
}

/// The lines of all console blocks that are to run.
fn lines(page: &str) -> Vec<Line> {
    let mut out: Vec<Line> = Vec::new();
    let (mut runs, mut inside) = (true, false);
    let mut open: Option<Line> = None;
    for (number, text) in (1..).zip(page.lines()) {
        match (inside, text) {
            (false, "```sh") => inside = true,
            (false, text) => {
                if let Some(reason) = text.strip_prefix("<!-- not run: ") {
                    assert!(reason.len() > " -->".len(), "line {number}: no reason");
                    runs = false;
                }
            }
            (true, "```") => (inside, runs) = (false, true),
            (true, text) => {
                let line = open.get_or_insert_with(|| Line {
                    number,
                    text: String::new(),
                });
                line.text += text.strip_suffix('\\').unwrap_or(text);
                if !text.ends_with('\\') {
                    out.extend(open.take().filter(|_| runs));
                }
            }
        }
    }
    out
}

/// A folder with what the page's commands find in the repository.
fn folder() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("operating");
    let _ = std::fs::remove_dir_all(&folder);
    for name in ["groups", "examples"] {
        std::fs::create_dir_all(folder.join(name)).unwrap();
        for file in std::fs::read_dir(root().join(name)).unwrap() {
            let file = file.unwrap();
            if file.file_type().unwrap().is_file() {
                std::fs::copy(file.path(), folder.join(name).join(file.file_name())).unwrap();
            }
        }
    }
    folder
}

#[test]
fn every_line_of_the_page_runs_in_its_order() {
    let page = std::fs::read_to_string(root().join("docs/operating.md")).unwrap();
    let (folder, programs) = (folder(), programs());
    let path = std::env::join_paths(
        std::iter::once(programs.to_owned())
            .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    )
    .unwrap();
    let mut served = None;
    let mut bus = None;
    let mut ran = 0;
    for line in lines(&page) {
        if let Some(value) = line.text.strip_prefix("export OMNIBUS_BUS=") {
            bus = Some(value.trim().to_owned());
            continue;
        }
        let mut command = Command::new("bash");
        command
            .args(["-c", &format!("exec {}", line.text)])
            .current_dir(&folder)
            .env("PATH", &path)
            .env("OMNIBUS_SIM_SPEED", "max")
            .env_remove("OMNIBUS_BUS")
            .envs(bus.as_ref().map(|bus| ("OMNIBUS_BUS", bus)))
            .stdin(Stdio::null());
        if line.text.starts_with("omnibus-sim serve") {
            let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
            let lines = BufReader::new(child.stdout.take().unwrap()).lines();
            let ready = lines
                .map_while(Result::ok)
                .any(|line| line.starts_with("serving"));
            served = Some(Served(child));
            assert!(
                ready,
                "docs/operating.md:{}: it does not serve",
                line.number
            );
            continue;
        }
        let began = std::time::Instant::now();
        let output = command.output().unwrap();
        println!("{:6.1} s  {}", began.elapsed().as_secs_f32(), line.text);
        assert_eq!(
            output.status.code(),
            Some(0),
            "docs/operating.md:{}: {}\n{}{}",
            line.number,
            line.text,
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr)
        );
        ran += 1;
    }
    assert!(served.is_some(), "the page starts the simulator");
    assert!(ran > 30, "{ran} lines of the page were run");
}
