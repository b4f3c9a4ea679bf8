//! `cargo xtask accept`: level 1 of the acceptance of a board, on an emulated one.
//!
//! The procedure and its checks are the crate `acceptance`; this builds the two images, puts the
//! board together and writes the report. It exits with 6 when a promise is not kept, so that a
//! script can tell this from a procedure that could not be run.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use acceptance::emulated::mutation::MUTATIONS;
use acceptance::emulated::{EmulatedBench, Images, Mutation, NODE};
use acceptance::level_one::{self, Options};
use acceptance::report::{self, Count, Subject};
use anyhow::{Context as _, bail};
use canopen::NodeId;
use emulator::Firmware;
use omnibus::report::Scalar;

use crate::firmware;

/// What an emulated board without defects measures, for comparison.
const EMULATED: &str = include_str!("../../acceptance/emulated/level-1.json");

/// A promise was not kept.
const BROKEN: u8 = 6;

/// Options of `cargo xtask accept`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Tries an emulated board with virtual wires.
    #[arg(long, required = true)]
    emulated: bool,
    /// Gives the board the defect with this name; `list` prints all of them.
    #[arg(long, value_name = "NAME")]
    mutate: Option<String>,
    /// Where to write the report as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Where to write the report as a page.
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    /// Image as shipped; by default it is built.
    #[arg(long, value_name = "PATH")]
    image: Option<PathBuf>,
    /// Self-test image; by default it is built.
    #[arg(long, value_name = "PATH")]
    self_test: Option<PathBuf>,
}

/// Builds, tries, reports.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitCode> {
    if arguments.mutate.as_deref() == Some("list") {
        for mutation in MUTATIONS {
            println!(
                "{:<20} {}: caught by {}",
                mutation.name, mutation.what, mutation.caught_by
            );
        }
        return Ok(ExitCode::SUCCESS);
    }
    let mutation = mutation(arguments.mutate.as_deref())?;
    let images = images(arguments)?;
    let mut bench = EmulatedBench::new(&images, mutation);
    let node = NodeId::new(NODE).context("the board has no node-ID")?;
    let mut checks = level_one::run(&mut bench, node, &Options::SHORT)?;
    let emulated = serde_json::from_str(EMULATED).context("the emulated figures")?;
    report::expect(&mut checks, &emulated);

    for check in &checks {
        println!("{}", report::line(check));
    }
    let count = Count::of(&checks);
    println!("\n{count}");
    let subject = Subject {
        level: 1,
        board: "NUCLEO-F446RE, emulated".to_owned(),
        chip: "STM32F446RE, emulated, revision A".to_owned(),
        versions: env!("CARGO_PKG_VERSION").to_owned(),
        date: report::today(),
        hardware: false,
        mutation: mutation.map(|mutation| mutation.name.to_owned()),
    };
    if let Some(path) = &arguments.json {
        let text = serde_json::to_string_pretty(&report::json(&subject, &checks))? + "\n";
        write(path, &text)?;
    }
    if let Some(path) = &arguments.html {
        write(path, &report::html(&subject, &checks))?;
    }
    Ok(if count.missed > 0 {
        ExitCode::from(BROKEN)
    } else {
        ExitCode::SUCCESS
    })
}

fn mutation(name: Option<&str>) -> anyhow::Result<Option<&'static Mutation>> {
    let Some(name) = name else { return Ok(None) };
    match Mutation::find(name) {
        Some(mutation) => Ok(Some(mutation)),
        None => bail!("there is no mutation '{name}'; `--mutate list` names all"),
    }
}

fn images(arguments: &Arguments) -> anyhow::Result<Images> {
    let load = |path: &Option<PathBuf>, build: &dyn Fn() -> anyhow::Result<PathBuf>| {
        let path = match path {
            Some(path) => path.clone(),
            None => build()?,
        };
        Firmware::load(&path).with_context(|| format!("cannot use {}", path.display()))
    };
    Ok(Images {
        self_test: load(&arguments.self_test, &firmware::build_self_test)?,
        shipped: load(&arguments.image, &|| firmware::build(Scalar::F32))?,
    })
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
    }
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}
