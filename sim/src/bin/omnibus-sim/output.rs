//! What the commands write: files, and lines of text on standard output. Unlike `println!`, these
//! do not panic when the reader has gone (`omnibus-sim emulate IMAGE | head`): the command ends as
//! after Ctrl-C, with its files complete.

use std::fmt::Display;
use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::path::Path;

use anyhow::{Context as _, bail};

/// The reader of standard output has gone. Not an I/O error, so that a lost endpoint or file is
/// never taken for it.
#[derive(Debug, thiserror::Error)]
#[error("standard output has no reader")]
pub struct ReaderGone;

/// Writes one line, at once: programs wait for it.
///
/// # Errors
/// `ReaderGone`, or standard output cannot be written.
pub fn print_line(line: impl Display) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    match writeln!(stdout, "{line}").and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Err(ReaderGone.into()),
        result => Ok(result?),
    }
}

/// Creates the file of an option, unless the command has it for something else: a file with what
/// it is.
///
/// # Errors
/// It is one of those, or cannot be written.
pub fn create(option: &str, path: &Path, others: &[(&Path, &str)]) -> anyhow::Result<File> {
    let shown = path.display();
    for (other, what) in others {
        // A terminal is in and out; only an ordinary file would be lost.
        if path.is_file() && path.canonicalize()? == other.canonicalize()? {
            bail!("{option} {shown}: this is {what}, which would be replaced; give another file");
        }
    }
    File::create(path).with_context(|| format!("{option} {shown}: cannot be written"))
}
