//! Files that are never incomplete: written under another name, then renamed.
//!
//! [`replace`] writes a whole content at once; [`Beside`] is for what grows, such as a recording.
//! Both write to `NAME.part` in the same folder and give it its name only when everything is on
//! the disk. When the disk is full or the program dies, the old file is still whole. A program
//! that is killed leaves `NAME.part` behind.
//!
//! What is not an ordinary file (`/dev/stdout`, a pipe) cannot be renamed and is written in place.
//! A symbolic link is followed, and the permissions of the file that is replaced are kept.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes a file whole, or leaves the old one as it is.
///
/// # Errors
/// When it cannot be written.
pub fn replace(path: &Path, content: impl AsRef<[u8]>) -> io::Result<()> {
    let mut file = Beside::create(path)?;
    file.write_all(content.as_ref())?;
    file.commit()
}

/// A file in the making. Dropping it without [`commit`](Self::commit) takes it away again.
pub struct Beside {
    out: BufWriter<File>,
    /// Where it lies until it is complete, and its name then; `None` for what is written in place.
    names: Option<(PathBuf, PathBuf)>,
}

impl Beside {
    /// Begins a file that will be called `path`.
    ///
    /// # Errors
    /// When it cannot be created.
    pub fn create(path: &Path) -> io::Result<Self> {
        let old = fs::metadata(path).ok();
        if old.as_ref().is_some_and(|old| !old.is_file()) {
            return Ok(Self {
                out: BufWriter::new(File::options().write(true).open(path)?),
                names: None,
            });
        }
        let path = fs::canonicalize(path).unwrap_or_else(|_| path.into());
        let mut beside = OsString::from(&path);
        beside.push(".part");
        let beside = PathBuf::from(beside);
        let file = File::create(&beside)?;
        if let Some(old) = old {
            file.set_permissions(old.permissions())?;
        }
        Ok(Self {
            out: BufWriter::new(file),
            names: Some((beside, path)),
        })
    }

    /// Everything is written: gives the file its name.
    ///
    /// # Errors
    /// When the rest cannot be written; the old file is then still there.
    pub fn commit(mut self) -> io::Result<()> {
        self.out.flush()?;
        if self.names.is_some() {
            self.out.get_ref().sync_all()?;
        }
        self.name()
    }

    /// Gives the file its name though not everything could be written: a recording is worth having
    /// up to where the disk was full.
    ///
    /// # Errors
    /// When it cannot be renamed.
    pub fn keep(mut self) -> io::Result<()> {
        let _ = self.out.flush();
        self.name()
    }

    fn name(&mut self) -> io::Result<()> {
        self.names
            .take()
            .map_or(Ok(()), |(beside, path)| fs::rename(beside, path))
    }
}

impl Write for Beside {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        if let Some((beside, _)) = &self.names {
            let _ = fs::remove_file(beside);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder of its own with a file that says "old".
    fn old(name: &str) -> (PathBuf, PathBuf) {
        let folder = std::env::temp_dir().join(format!("omnibus-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        let file = folder.join("file");
        fs::write(&file, "old").unwrap();
        (folder, file)
    }

    fn written(file: &Path) -> Beside {
        let mut beside = Beside::create(file).unwrap();
        beside.write_all(b"new").unwrap();
        beside.flush().unwrap();
        beside
    }

    #[test]
    fn a_file_has_its_name_when_it_is_complete() {
        let (folder, file) = old("complete");
        let beside = written(&file);
        assert_eq!(fs::read_to_string(&file).unwrap(), "old");
        beside.commit().unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_file_that_is_given_up_leaves_the_old_one() {
        let (folder, file) = old("given-up");
        drop(written(&file));
        assert_eq!(fs::read_to_string(&file).unwrap(), "old");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        fs::remove_dir_all(folder).unwrap();
    }
}
