//! `cargo xtask web`: a folder of static files with which Omnibus is tried in a browser.
//!
//! The folder has the page of `omnibus serve` with another `backend.js`, the module that is the
//! group (`omnibus-web` as WebAssembly), the firmware's release image for emulated robots, and the
//! documents ([`book`]). It needs no server of its own: `--serve` shows it on this computer, any
//! other server does as well. The module and the image are compressed and lie in scripts, as text,
//! because that is all that browsers load for a page that was opened as a file.
//!
//! `--check` drives a metre in a headless browser and on this machine ([`check`]).

mod book;
mod check;
mod image;
mod module;
mod serve;

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use omnibus::report::Scalar;

use crate::{cargo, firmware};

const TARGET: &str = "wasm32-unknown-unknown";
const PROFILE: &str = "browser";
/// What a browser loads at most before everything can be tried, in bytes as a server sends them
/// that compresses.
const MOST_BYTES: usize = 1_000_000;
/// Before which the page's own backend stands.
const BACKEND: &str = "<script src=\"backend.js\"></script>";
const STYLE: &str = "<link rel=\"stylesheet\" href=\"page.css\">";

/// The files of the page: those of `omnibus serve` and those of here.
const PAGE: [(&str, &str); 6] = [
    ("master/src/serve/page/page.css", "page.css"),
    ("master/src/serve/page/page.js", "page.js"),
    ("web/page/backend.js", "backend.js"),
    ("web/page/worker.js", "worker.js"),
    ("web/page/panes.js", "panes.js"),
    ("web/page/panes.css", "panes.css"),
];

/// Options of `cargo xtask web`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Shows the folder on this computer until Ctrl-C; port 0 picks a free one.
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:8000")]
    serve: Option<std::net::SocketAddr>,
    /// Drives a metre in a headless browser and compares it with the same drive on this machine.
    #[arg(long, conflicts_with = "serve")]
    check: bool,
}

/// Builds the folder, then serves or checks it.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let elf = firmware::build(Scalar::F32)?;
    let folder = build(&elf)?;
    if arguments.check {
        return check::run(&folder, &elf);
    }
    match arguments.serve {
        Some(address) => serve::serve(address, &folder),
        None => {
            println!("open {}", folder.join("index.html").display());
            Ok(())
        }
    }
}

/// Builds everything and returns the folder.
fn build(elf: &Path) -> anyhow::Result<PathBuf> {
    cargo::ensure_target(TARGET)?;
    // Of the library's two types the one alone: with the other beside it nothing is optimised at
    // link time.
    cargo::run(cargo::command().args([
        "rustc",
        "--package=omnibus-web",
        "--lib",
        "--crate-type=cdylib",
        "--target",
        TARGET,
        "--profile",
        PROFILE,
    ]))?;
    let folder = cargo::target_folder().join("web");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
    }
    let module = cargo::target_folder()
        .join(TARGET)
        .join(PROFILE)
        .join("web.wasm");
    let index = index(&read(
        &cargo::root().join("master/src/serve/page/index.html"),
    )?)?;
    let mut sizes = vec![(String::from("index.html"), zip(index.as_bytes())?.len())];
    write(&folder.join("index.html"), index.as_bytes())?;
    for (from, to) in PAGE {
        let text = read(&cargo::root().join(from))?;
        sizes.push((to.into(), zip(text.as_bytes())?.len()));
        write(&folder.join(to), text.as_bytes())?;
    }
    let module = std::fs::read(&module).with_context(|| module.display().to_string())?;
    let module = module::without_custom_sections(&module)?;
    let image = std::fs::read(elf).with_context(|| elf.display().to_string())?;
    for (bytes, to) in [
        (module, "module.js"),
        (image::without_debug(image)?, "image.js"),
    ] {
        let script = format!(
            "omnibusLoaded(\"{}\");\n",
            STANDARD.encode(squeeze(&bytes)?)
        );
        sizes.push((to.into(), zip(script.as_bytes())?.len()));
        write(&folder.join(to), script.as_bytes())?;
    }
    check_sizes(&sizes)?;
    let pages = book::write(&folder)?;
    println!(
        "{pages} pages of documents in {}",
        folder.join("docs").display()
    );
    Ok(folder)
}

/// The page with the panes of a group in the browser.
fn index(page: &str) -> anyhow::Result<String> {
    for mark in [BACKEND, STYLE] {
        if page.matches(mark).count() != 1 {
            bail!("master/src/serve/page/index.html no longer has one line {mark}");
        }
    }
    let scripts = "<script src=\"worker.js\"></script>\n<script src=\"panes.js\"></script>\n";
    let style = "\n<link rel=\"stylesheet\" href=\"panes.css\">";
    Ok(page
        .replace(BACKEND, &format!("{scripts}{BACKEND}"))
        .replace(STYLE, &format!("{STYLE}{style}")))
}

fn zip(bytes: &[u8]) -> anyhow::Result<Vec<u8>> {
    let mut out = GzEncoder::new(Vec::new(), Compression::best());
    out.write_all(bytes)?;
    Ok(out.finish()?)
}

/// The same format, as small as it gets; takes seconds for a megabyte.
fn squeeze(bytes: &[u8]) -> anyhow::Result<Vec<u8>> {
    let options = zopfli::Options {
        iteration_count: const { std::num::NonZeroU64::new(5).unwrap() },
        ..zopfli::Options::default()
    };
    let mut out = Vec::new();
    zopfli::compress(options, zopfli::Format::Gzip, bytes, &mut out)?;
    Ok(out)
}

/// Prints what a browser loads, compressed, and refuses more than [`MOST_BYTES`].
fn check_sizes(sizes: &[(String, usize)]) -> anyhow::Result<()> {
    for (name, size) in sizes {
        println!("{name:<12} {size:>8} bytes");
    }
    let sum: usize = sizes.iter().map(|(_, size)| size).sum();
    println!("{:<12} {sum:>8} bytes of {MOST_BYTES}", "all");
    if sum > MOST_BYTES {
        bail!("the page loads {sum} bytes; {MOST_BYTES} is the most (xtask/src/web/mod.rs)");
    }
    Ok(())
}

fn read(path: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).with_context(|| path.display().to_string())
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    std::fs::write(path, bytes).with_context(|| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_gets_its_panes_before_its_backend() {
        let page = index(include_str!("../../../master/src/serve/page/index.html")).unwrap();
        let at = |text: &str| page.find(text).unwrap();
        assert!(at("worker.js") < at("backend.js") && at("panes.js") < at("backend.js"));
        assert!(at("page.css") < at("panes.css") && at("backend.js") < at("page.js"));
        assert!(index("<html>").is_err());
    }

    #[test]
    fn too_much_to_load_is_refused() {
        assert!(check_sizes(&[("a".into(), MOST_BYTES)]).is_ok());
        assert!(check_sizes(&[("a".into(), MOST_BYTES), ("b".into(), 1)]).is_err());
    }
}
