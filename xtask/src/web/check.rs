//! The folder in a headless browser: `tests/interop/test_web.py` opens it, drives as a hand would,
//! and drives the metre of `web::scenario`, whose result must equal this machine's to the byte:
//! poses, duties and the log of the bus.

use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, anyhow};
use emulator::Firmware;
use web::choice::{Choice, Floor, Robots};
use web::scenario;

use crate::{cargo, interop};

/// What is driven: name of the file, group, floor, robots.
const DRIVES: [(&str, &str, Floor, Robots); 3] = [
    ("table", "tcc-3", Floor::Table, Robots::Native),
    ("contact", "sizes", Floor::Contact, Robots::Native),
    ("emulated", "single", Floor::Table, Robots::Emulated),
];

/// Drives on this machine, then in the browser.
pub fn run(folder: &Path, elf: &Path) -> anyhow::Result<()> {
    let python = interop::python()?;
    let image = Firmware::load(elf).map_err(|error| anyhow!("{error}"))?;
    let native = cargo::target_folder().join("web-check");
    std::fs::create_dir_all(&native).with_context(|| native.display().to_string())?;
    for (name, group, floor, robots) in DRIVES {
        let choice = Choice {
            group: group.into(),
            floor,
            compensation: true,
            phases: floor == Floor::Contact,
            robots,
        };
        let outcome = scenario::run(&choice, Some(&image)).map_err(|error| anyhow!(error))?;
        let path = native.join(name).with_extension("json");
        std::fs::write(&path, outcome).with_context(|| path.display().to_string())?;
    }
    let mut tests = Command::new(python);
    tests
        .current_dir(cargo::root().join("tests/interop"))
        .args(["-B", "-m", "unittest", "test_web"])
        .env("OMNIBUS_WEB", folder)
        .env("OMNIBUS_WEB_NATIVE", native);
    cargo::run(&mut tests)
}
