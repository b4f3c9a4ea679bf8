//! `cargo xtask socketcan`: the simulator, the master and can-utils on a real SocketCAN interface.
//!
//! The kernel of a build machine seldom has CAN. This task therefore boots Debian's kernel under
//! qemu, without hardware acceleration, so that it runs on any machine. The guest has no disk: an
//! initial RAM disk, which this task builds, holds busybox, the kernel's modules and
//! `tests/socketcan/init`; everything else comes from the host's file system, read-only over 9p. It
//! brings up vcan0 and runs `tests/socketcan/guest.sh`.
//!
//! Beside them it runs the release image on an emulated board: the kernel's own slcan talks to the
//! firmware at a pseudo terminal. A pseudo terminal has no baud rate, so nothing of it is tested
//! here.
//!
//! The kernel comes from Debian's archive by `apt-get download`, which needs no root rights, and is
//! unpacked under `target/`.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};

use omnibus::report::Scalar;

use crate::{cargo, firmware};

/// The package that depends on Debian's present kernel. The one for clouds has neither CAN nor 9p.
const KERNEL: &str = "linux-image-amd64";
/// What must be installed, each with its Debian package.
const PROGRAMS: &[(&str, &str)] = &[
    ("qemu-system-x86_64", "qemu-system-x86"),
    ("candump", "can-utils"),
    ("busybox", "busybox-static"),
    ("dpkg-deb", "dpkg"),
    ("apt-get", "apt"),
];
/// Modules for the RAM disk, without their dependencies' order: `init` has that.
const MODULES: &[&str] = &[
    "virtio",
    "virtio_ring",
    "virtio_pci_legacy_dev",
    "virtio_pci_modern_dev",
    "virtio_pci",
    "netfs",
    "fscache",
    "9pnet",
    "9pnet_virtio",
    "9p",
    "can",
    "can-raw",
    "can-dev",
    "vcan",
    "slcan",
];
/// Longest run. It takes some half a minute on a machine with nothing else to do.
const PATIENCE: Duration = Duration::from_secs(600);
/// What the guest says when the test has held.
const PASSED: &str = "guest: exit 0";

/// Builds what is needed, boots, and judges.
pub fn run() -> anyhow::Result<()> {
    installed()?;
    let folder = cargo::target_folder().join("socketcan");
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let kernel = kernel(&folder)?;
    cargo::run(cargo::tested("build").args(["--bin=omnibus", "--bin=omnibus-sim"]))?;
    let elf = firmware::build(Scalar::F32)?;
    let built = cargo::target_folder().join("debug");
    let tests = cargo::root().join("tests/socketcan");
    let command = [
        PathBuf::from("/bin/sh"),
        tests.join("guest.sh"),
        built.join("omnibus-sim"),
        built.join("omnibus"),
        cargo::root(),
        elf,
    ]
    .iter()
    .map(|part| quoted(part))
    .collect::<anyhow::Result<Vec<_>>>()?
    .join(" ");
    let disk = folder.join("initrd");
    ram_disk(&kernel, &tests.join("init"), &command)
        .and_then(|bytes| Ok(std::fs::write(&disk, bytes)?))
        .with_context(|| format!("cannot make {}", disk.display()))?;
    boot(&kernel, &disk)
}

/// Names what the system lacks.
fn installed() -> anyhow::Result<()> {
    let folders: Vec<PathBuf> = std::env::var_os("PATH")
        .map(|path| std::env::split_paths(&path).collect())
        .unwrap_or_default();
    let missing: Vec<_> = PROGRAMS
        .iter()
        .filter(|(program, _)| !folders.iter().any(|folder| folder.join(program).is_file()))
        .collect();
    if missing.is_empty() {
        return Ok(());
    }
    let programs: Vec<_> = missing.iter().map(|(program, _)| *program).collect();
    let packages: Vec<_> = missing.iter().map(|(_, package)| *package).collect();
    bail!(
        "missing: {}. Debian and Ubuntu: apt-get install --no-install-recommends {}",
        programs.join(", "),
        packages.join(" ")
    )
}

/// The unpacked kernel package, fetched when it is not there yet.
fn kernel(folder: &Path) -> anyhow::Result<PathBuf> {
    let output = Command::new("apt-cache")
        .args(["depends", "--important", KERNEL])
        .output()
        .context("cannot start apt-cache")?;
    let output = String::from_utf8_lossy(&output.stdout).into_owned();
    let name = output
        .lines()
        .filter_map(|line| line.trim().strip_prefix("Depends: "))
        .find(|name| name.starts_with("linux-image-"))
        .with_context(|| format!("apt-cache knows no {KERNEL}: run apt-get update first"))?;
    let kernel = folder.join(name);
    if kernel.join("boot").is_dir() {
        return Ok(kernel);
    }
    println!("fetching {name}");
    cargo::run(
        Command::new("apt-get")
            .current_dir(folder)
            .args(["download", "-qq", name]),
    )?;
    let package = files(folder)?
        .into_iter()
        .find(|path| path.extension().is_some_and(|end| end == "deb"))
        .context("apt-get download has written no package")?;
    let unpacked = folder.join("unpacked");
    cargo::run(
        Command::new("dpkg-deb")
            .arg("-x")
            .args([&package, &unpacked]),
    )?;
    // Last, so that an interrupted run begins again.
    std::fs::rename(&unpacked, &kernel).with_context(|| kernel.display().to_string())?;
    std::fs::remove_file(&package).with_context(|| package.display().to_string())?;
    Ok(kernel)
}

fn files(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let paths = entries.map(|entry| entry.map(|entry| entry.path()));
    Ok(paths.collect::<Result<_, _>>()?)
}

/// Every file below a folder.
fn all_files(folder: &Path, found: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    for path in files(folder)? {
        if path.is_dir() {
            all_files(&path, found)?;
        } else {
            found.push(path);
        }
    }
    Ok(())
}

/// A path for the guest's shell.
fn quoted(path: &Path) -> anyhow::Result<String> {
    let text = path
        .to_str()
        .context("a path of the workspace is not UTF-8")?;
    if text.contains('\'') {
        bail!(
            "{text}: the guest's shell cannot read a path with an apostrophe; move the workspace"
        );
    }
    Ok(format!("'{text}'"))
}

/// The initial RAM disk: a cpio archive in the form that the kernel's documentation calls newc.
fn ram_disk(kernel: &Path, init: &Path, command: &str) -> anyhow::Result<Vec<u8>> {
    const FOLDER: u32 = 0o040_755;
    const PROGRAM: u32 = 0o100_755;
    const FILE: u32 = 0o100_644;
    let mut archive = Archive::default();
    for folder in ["bin", "dev", "proc", "sys", "modules"] {
        archive.add(folder, FOLDER, &[]);
    }
    let busybox = ["/bin/busybox", "/usr/bin/busybox"]
        .iter()
        .find_map(|p| std::fs::read(p).ok());
    archive.add(
        "bin/busybox",
        PROGRAM,
        &busybox.context("this system has no /bin/busybox")?,
    );
    archive.add("init", PROGRAM, &std::fs::read(init)?);
    archive.add("test", FILE, command.as_bytes());
    let mut found = Vec::new();
    all_files(&kernel.join("lib/modules"), &mut found)?;
    for module in MODULES {
        let name = format!("{module}.ko");
        if let Some(path) = found.iter().find(|path| path.ends_with(&name)) {
            archive.add(&format!("modules/{name}"), FILE, &std::fs::read(path)?);
        }
    }
    archive.add("TRAILER!!!", 0, &[]);
    Ok(archive.bytes)
}

#[derive(Default)]
struct Archive {
    bytes: Vec<u8>,
    count: u32,
}

impl Archive {
    fn add(&mut self, name: &str, mode: u32, content: &[u8]) {
        self.count += 1;
        // Magic, inode, mode, owner, group, links, time, size, four device numbers, length of the
        // name, checksum.
        let length = name.len() + 1;
        let fields = [self.count, mode, 0, 0, 1, 0];
        self.bytes.extend_from_slice(b"070701");
        for field in fields {
            self.bytes
                .extend_from_slice(format!("{field:08x}").as_bytes());
        }
        self.bytes
            .extend_from_slice(format!("{:08x}", content.len()).as_bytes());
        self.bytes.extend_from_slice(&[b'0'; 32]);
        self.bytes
            .extend_from_slice(format!("{length:08x}{:08x}", 0).as_bytes());
        self.bytes.extend_from_slice(name.as_bytes());
        self.bytes.push(0);
        self.align();
        self.bytes.extend_from_slice(content);
        self.align();
    }

    fn align(&mut self) {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
    }
}

/// Boots, passes on what the guest says, and judges by its last word.
fn boot(kernel: &Path, disk: &Path) -> anyhow::Result<()> {
    let image = files(&kernel.join("boot"))?
        .into_iter()
        .find(|path| {
            path.file_name()
                .is_some_and(|name| name.to_string_lossy().starts_with("vmlinuz"))
        })
        .context("the kernel package has no vmlinuz")?;
    let mut guest = Command::new("qemu-system-x86_64")
        // The guest's clock counts its instructions, one a nanosecond, and skips what the guest
        // waits for: a host with other work to do, or that stops for a while, makes the test last
        // longer, and nothing in the guest is late for it.
        .args(["-accel", "tcg,thread=single", "-smp", "1", "-m", "512"])
        .args(["-icount", "shift=0,sleep=off", "-rtc", "clock=vm"])
        .args([
            "-nodefaults",
            "-no-user-config",
            "-no-reboot",
            "-display",
            "none",
        ])
        .args(["-append", "console=ttyS0 quiet panic=-1"])
        .args(["-serial", "stdio"])
        .args([
            "-virtfs",
            "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap",
        ])
        .arg("-kernel")
        .arg(&image)
        .arg("-initrd")
        .arg(disk)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot start qemu-system-x86_64")?;
    let console = guest.stdout.take().context("qemu has no console")?;
    let (sender, output) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(console).split(b'\n').map_while(Result::ok) {
            let line = String::from_utf8_lossy(&line).trim_end().to_owned();
            if sender.send(line).is_err() {
                break;
            }
        }
    });
    let began = Instant::now();
    let mut passed = false;
    loop {
        match output.recv_timeout(PATIENCE.saturating_sub(began.elapsed())) {
            Ok(line) => {
                passed |= line == PASSED;
                writeln!(std::io::stdout(), "{line}")?;
            }
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {
                guest.kill()?;
                guest.wait()?;
                bail!("the guest did not finish within {} s", PATIENCE.as_secs());
            }
        }
    }
    guest.wait()?;
    if !passed {
        bail!("the test in the guest failed; its output is above");
    }
    println!(
        "SocketCAN: passed in {:.0} s",
        began.elapsed().as_secs_f64()
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A header has 6 + 13 * 8 = 110 characters; names with their zero and contents end on
    /// multiples of four.
    #[test]
    fn an_archive_is_newc() {
        let mut archive = Archive::default();
        archive.add("test", 0o100_644, b"hello");
        let text = String::from_utf8(archive.bytes).unwrap();
        assert_eq!(text.len(), 116 + 8);
        assert_eq!(&text[..22], "07070100000001000081a4");
        assert_eq!(&text[54..62], "00000005");
        assert_eq!(&text[94..110], "0000000500000000");
        assert_eq!(&text[110..], "test\0\0hello\0\0\0");
    }
}
