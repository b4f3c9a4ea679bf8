//! Files that a command is given. An error names the file and what to give instead.

use std::fs::File;
use std::io;
use std::path::Path;

/// Bytes of the largest file that is read: an image of firmware has at most two million.
pub const LARGEST: u64 = 64 << 20;

/// Reads a file whole; `give` says which file the command wants.
pub fn bytes(path: &Path, give: &str) -> anyhow::Result<Vec<u8>> {
    let read = File::open(path).and_then(|file| ::group::input::limited(file, LARGEST));
    named(read, path, give)
}

/// The same for a file of text.
pub fn text(path: &Path, give: &str) -> anyhow::Result<String> {
    named(::group::input::text(path), path, give)
}

/// What was read from a file, or an error that names it.
pub fn named<T>(read: io::Result<T>, path: &Path, give: &str) -> anyhow::Result<T> {
    let path = path.display();
    read.map_err(|error| anyhow::anyhow!("{path}: cannot be read ({error}); give {give}"))
}
