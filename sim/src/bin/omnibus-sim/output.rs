//! What the commands write: files, and lines of text on standard output and standard error. Unlike
//! `println!` and `eprintln!`, these do not panic when the reader has gone (`omnibus-sim emulate
//! IMAGE | head`, a terminal that was closed). Without a reader of its output the command ends as
//! after Ctrl-C, with its files complete; without one of its notes it goes on.

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

/// Writes one line to standard error.
pub fn print_note(line: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Creates the files of options; `used` are those that the command has for something else, each
/// with what it is. Where one is refused, none has replaced anything.
///
/// # Errors
/// One is among the `used`, or two are the same, or one cannot be written.
pub fn create<'a, const N: usize>(
    options: [(&str, Option<&'a Path>); N],
    mut used: Vec<(&'a Path, &str)>,
) -> anyhow::Result<[Option<File>; N]> {
    let mut files = [const { None }; N];
    for ((option, path), file) in options.into_iter().zip(&mut files) {
        let Some(path) = path else { continue };
        let shown = path.display();
        let opened = File::options()
            .write(true)
            .create(true)
            .truncate(false)
            .open(path);
        let opened = opened.with_context(|| format!("{option} {shown}: cannot be written"))?;
        for (other, what) in &used {
            // A terminal is in and out; only an ordinary file would be lost.
            if path.is_file() && path.canonicalize()? == other.canonicalize()? {
                bail!(
                    "{option} {shown}: this is {what}, which would be replaced; give another file"
                );
            }
        }
        used.push((path, "another output"));
        *file = Some(opened);
    }
    for file in files.iter().flatten() {
        if file.metadata()?.is_file() {
            file.set_len(0)?;
        }
    }
    Ok(files)
}
