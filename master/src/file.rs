//! Files that are never incomplete: written under another name, then renamed.
//!
//! [`replace`] writes a whole content at once; [`Beside`] is for what grows, such as a recording.
//! Both write to `NAME.part` in the same folder and give it its name only when everything is on
//! the disk. When the disk is full or the program dies, the old file is still whole.
//!
//! `NAME.part` is locked while it is written, so a second program cannot write to it. A program
//! that is killed leaves it behind; the next one that writes to the same name renames it to
//! `NAME.part.1`, or to the next number that is free, and notifies the function given to
//! [`on_leftover`]. File systems without locks do not protect against a second program.
//!
//! What is not an ordinary file (`/dev/stdout`, a pipe) cannot be renamed and is written in place.
//! A symbolic link is followed, and the permissions of the file that is replaced are kept.

use std::ffi::OsString;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Notified of an incomplete file that was found, and of its new name.
type OnLeftover = fn(&Path, &Path);

static ON_LEFTOVER: OnceLock<OnLeftover> = OnceLock::new();

/// Sets what is notified when an incomplete file of an earlier program is renamed; the first call
/// counts. The arguments are its old and its new name.
pub fn on_leftover(notify: OnLeftover) {
    let _ = ON_LEFTOVER.set(notify);
}

/// Writes a file whole, or leaves the old one as it is.
///
/// # Errors
/// When it cannot be written.
pub fn replace(path: &Path, content: impl AsRef<[u8]>) -> io::Result<()> {
    let mut file = Beside::create(path)?;
    file.write_all(content.as_ref())?;
    file.commit()
}

/// Finds out whether [`replace`] and [`Beside`] could write this file; everything stays as it is.
///
/// # Errors
/// Those of [`Beside::create`].
pub fn check(path: &Path) -> io::Result<()> {
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
        // The reader of a pipe would take being opened and closed for its end.
        Ok(found) if !found.is_file() => Ok(()),
        _ => Beside::create(path).map(drop),
    }
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
    /// When it cannot be created, or another program is writing a file of this name.
    pub fn create(path: &Path) -> io::Result<Self> {
        let old = fs::metadata(path).ok();
        if old.as_ref().is_some_and(|old| !old.is_file()) {
            return Ok(Self {
                out: BufWriter::new(File::options().write(true).open(path)?),
                names: None,
            });
        }
        let path = fs::canonicalize(path).unwrap_or_else(|_| path.into());
        let beside = with_suffix(&path, ".part");
        let file = own(&beside)?;
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

/// A path with something added to its name.
fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}

/// Creates an empty file and locks it until it is closed. What an earlier program left under this
/// name gets another one.
fn own(path: &Path) -> io::Result<File> {
    loop {
        let mut options = File::options();
        // Truncating would destroy what another program has written before the lock is asked for.
        let file = options
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(io::Error::new(
                    io::ErrorKind::ResourceBusy,
                    format!(
                        "{} is being written by another omnibus; give another name",
                        path.display()
                    ),
                ));
            }
            // Not every file system has locks.
            Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => {}
            Err(TryLockError::Error(error)) => return Err(error),
        }
        // Between opening and locking, its owner may have completed or removed it.
        if !has_name(&file, path)? {
            continue;
        }
        if file.metadata()?.len() == 0 {
            return Ok(file);
        }
        let free = (1_u32..).map(|number| with_suffix(path, &format!(".{number}")));
        let mut free = free.filter(|name| fs::symlink_metadata(name).is_err());
        let aside = free.next().ok_or(io::ErrorKind::AlreadyExists)?;
        fs::rename(path, &aside)?;
        if let Some(notify) = ON_LEFTOVER.get() {
            notify(path, &aside);
        }
    }
}

/// Whether an open file is the one that has this name now.
#[cfg(unix)]
fn has_name(file: &File, path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::MetadataExt as _;
    let opened = file.metadata()?;
    match fs::metadata(path) {
        Ok(named) => Ok((named.dev(), named.ino()) == (opened.dev(), opened.ino())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

/// Elsewhere an open file cannot be replaced.
#[cfg(not(unix))]
fn has_name(_: &File, _: &Path) -> io::Result<bool> {
    Ok(true)
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

    /// Locks belong to open files, so two in one program are as two programs.
    #[test]
    fn a_file_that_is_being_written_is_refused_and_stays_whole() {
        let (folder, file) = old("twice");
        let first = written(&file);
        let refused = Beside::create(&file).err().unwrap();
        let expected = "part is being written by another omnibus; give another name";
        assert!(refused.to_string().contains(expected), "{refused}");
        first.commit().unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
        written(&file).commit().unwrap();
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_a_killed_program_wrote_gets_another_name() {
        let (folder, file) = old("killed");
        for content in ["first", "second"] {
            fs::write(folder.join("file.part"), content).unwrap();
            written(&file).commit().unwrap();
        }
        let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
        assert_eq!(read("file.part.1"), "first");
        assert_eq!(read("file.part.2"), "second");
        assert_eq!(read("file"), "new");
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
