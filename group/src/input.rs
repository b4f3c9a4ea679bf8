//! Reading files up to a largest size, so that a file without an end (`/dev/zero`, a pipe that is
//! never closed) is an error before it fills the memory.
//!
//! Group files are read with [`text`]; the commands of the master read their other files with it as
//! well. Recordings are not: they may be of any size.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Bytes of the largest text that is read: a group file of sixteen robots has some ten thousand.
pub const LARGEST_TEXT: u64 = 16 << 20;

/// Reads everything, but not more than `most` bytes.
///
/// # Errors
/// When there is more, or reading fails.
pub fn limited(from: impl Read, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let problem = format!("it is larger than {} MiB", most >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, problem));
    }
    Ok(bytes)
}

/// What some programs, spreadsheets among them, write before a text in UTF-8.
const BYTE_ORDER_MARK: &str = "\u{FEFF}";

/// Reads a text of at most [`LARGEST_TEXT`] bytes, without the byte order mark before it, if any.
///
/// # Errors
/// When the file is larger, is not UTF-8, or cannot be read.
pub fn text(path: &Path) -> io::Result<String> {
    let bytes = limited(File::open(path)?, LARGEST_TEXT)?;
    let refused = |_| io::Error::new(io::ErrorKind::InvalidData, "it is not valid UTF-8 text");
    let mut text = String::from_utf8(bytes).map_err(refused)?;
    if text.starts_with(BYTE_ORDER_MARK) {
        text.drain(..BYTE_ORDER_MARK.len());
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_end_is_refused() {
        assert_eq!(limited(&[7; 2][..], 2).unwrap(), [7; 2]);
        let error = limited(io::repeat(0), 1 << 20).unwrap_err();
        assert_eq!(error.to_string(), "it is larger than 1 MiB");
    }
}
