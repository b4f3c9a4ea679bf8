//! Lines of text on standard output. Unlike `println!`, these do not panic when the reader has gone
//! (`omnibus-sim emulate IMAGE | head`): the command ends as after Ctrl-C, with its files complete.

use std::fmt::Display;
use std::io::{ErrorKind, Write as _};

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
