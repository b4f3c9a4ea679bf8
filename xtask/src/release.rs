//! `cargo xtask release` and `cargo xtask keys`: signed image files, and the keys for them.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use boot::header::{Board, Header, Link};
use boot::{Crypto as _, Slot, Software, key, release};

use crate::firmware::{self, Wheels};

/// Options of `cargo xtask release`.
#[derive(clap::Args)]
pub struct Arguments {
    /// File to write. FILE.slot-a and FILE.slot-b, which robots are sent, are written beside it.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// File of the private key; its public half has to be the one that OMNIBUS_PUBLIC_KEY names.
    #[arg(long, value_name = "FILE", required_unless_present = "development")]
    key: Option<PathBuf>,
    /// Signs with the development key, which is public, for robots that were built without
    /// OMNIBUS_PUBLIC_KEY.
    #[arg(long, conflicts_with = "key")]
    development: bool,
    /// Board of the robots.
    #[arg(long, value_enum, default_value_t)]
    board: firmware::Board,
    /// For robots with smart drives; implied by a board that has no other drivers.
    #[arg(long)]
    smart_drives: bool,
    /// For robots with two PWMs per wheel.
    #[arg(long, conflicts_with = "smart_drives")]
    two_pwms: bool,
}

/// Robots that take the same image.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Robots {
    board: firmware::Board,
    wheels: Wheels,
}

impl Robots {
    /// As the header has them.
    const fn in_header(self) -> Board {
        match (self.board, self.wheels) {
            (firmware::Board::NucleoF446re, Wheels::Bridges) => Board::NUCLEO_F446RE,
            (firmware::Board::NucleoF446re, Wheels::TwoPwms) => Board::NUCLEO_F446RE_TWO_PWMS,
            (firmware::Board::NucleoF446re, Wheels::SmartDrives) => Board::NUCLEO_F446RE_C620,
            (firmware::Board::RobomasterC, _) => Board::ROBOMASTER_C,
            // Refused when its image for the second slot is to be built.
            (firmware::Board::KitF103rc, _) => Board::KIT_F103RC,
        }
    }
}

/// Options of `cargo xtask keys`.
#[derive(clap::Args)]
pub struct KeysArguments {
    /// File to write the private key to, outside of the repository; the public one goes to
    /// FILE.pub.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Builds both images and signs them.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let private = match &arguments.key {
        Some(path) => private_key(path)?,
        None => key::DEVELOPMENT_PRIVATE,
    };
    check_pair(&private, arguments.development)?;
    let robots = Robots {
        board: arguments.board,
        wheels: match arguments.board {
            _ if arguments.two_pwms => Wheels::TwoPwms,
            firmware::Board::NucleoF446re if !arguments.smart_drives => Wheels::Bridges,
            // Board C has smart drives anyway.
            _ => Wheels::SmartDrives,
        },
    };
    let slot_a = firmware::build_with(robots.board, robots.wheels)?;
    let Release {
        header,
        signed,
        a,
        b,
    } = sign(&private, robots, &slot_a)?;
    let out = &arguments.out;
    write(out, &[&signed, &a, &b])?;
    write(&beside(out, "slot-a"), &[&signed, &a])?;
    write(&beside(out, "slot-b"), &[&signed, &b])?;
    println!(
        "{}: {}, hardware revision {}, version {:#010x}, wire version {}, security counter {}, \
         {} and {} bytes{}",
        out.display(),
        header.board.name(),
        header.hardware,
        header.version,
        header.wire_version,
        header.security_counter,
        a.len(),
        b.len(),
        if arguments.development {
            ", signed with the development key: anyone can make such a file"
        } else {
            ""
        }
    );
    Ok(())
}

/// The parts of a file.
struct Release {
    header: Header,
    signed: Vec<u8>,
    a: Vec<u8>,
    b: Vec<u8>,
}

/// Builds the image for slot B and signs it with that for slot A.
fn sign(private: &[u8; 32], robots: Robots, slot_a: &Path) -> anyhow::Result<Release> {
    let a = image(slot_a, Slot::A)?;
    let slot_b = firmware::build_slot_b(robots.board, robots.wheels)?;
    let b = image(&slot_b, Slot::B)?;
    let header = header(robots, &a, &b);
    let message = header.to_bytes();
    let signed = [&message[..], &boot::sign(private, &message)].concat();
    // What a robot will say of it.
    Header::parse(&signed).context("the header that was made cannot be read")?;
    ensure!(
        Header::is_signed(&signed, &Software::default()),
        "the signature is wrong"
    );
    Ok(Release {
        header,
        signed,
        a,
        b,
    })
}

/// The bytes of a file with this image for slot A, for reference boards with bridges that believe
/// the development key.
pub fn development_file(slot_a: &Path) -> anyhow::Result<Vec<u8>> {
    check_pair(&key::DEVELOPMENT_PRIVATE, true)?;
    let Release { signed, a, b, .. } = sign(&key::DEVELOPMENT_PRIVATE, Robots::default(), slot_a)?;
    Ok([signed, a, b].concat())
}

/// Makes a file for robots that believe the development key.
pub fn development(out: PathBuf) -> anyhow::Result<()> {
    run(&Arguments {
        out,
        key: None,
        development: true,
        board: firmware::Board::default(),
        smart_drives: false,
        two_pwms: false,
    })
}

/// Makes a pair of keys.
pub fn keys(arguments: &KeysArguments) -> anyhow::Result<()> {
    let out = std::path::absolute(&arguments.out)?;
    if out.starts_with(crate::cargo::root()) {
        bail!(
            "{} is in the repository; a private key must not be",
            out.display()
        );
    }
    let public = beside(&out, "pub");
    if public.exists() {
        bail!("{} is there already: give another name", public.display());
    }
    let mut private = [0; 32];
    getrandom::fill(&mut private).context("the system has no random numbers")?;
    let mut options = std::fs::OpenOptions::new();
    // Never over another key.
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options
        .open(&out)
        .with_context(|| format!("cannot create {}", out.display()))?;
    writeln!(file, "{}", hex(&private))?;
    file.sync_all()?;
    write(
        &public,
        &[format!("{}\n", hex(&boot::public_key(&private))).as_bytes()],
    )?;
    println!(
        "private key: {}; keep it secret, and a copy of it",
        out.display()
    );
    println!(
        "public key: {}; build robots with OMNIBUS_PUBLIC_KEY={}",
        public.display(),
        public.display()
    );
    Ok(())
}

/// Robots that were built as this program was have to believe the signature.
fn check_pair(private: &[u8; 32], development: bool) -> anyhow::Result<()> {
    let public = boot::public_key(private);
    if public == key::DEVELOPMENT && !development {
        bail!("this is the development key, which protects nothing; give --development to use it");
    }
    if public != key::PUBLIC {
        bail!(
            "the robots of this build check images with the public key {}, not with {}: set \
             OMNIBUS_PUBLIC_KEY to the file of the public half{}",
            hex(&key::PUBLIC),
            hex(&public),
            if key::is_development() {
                "; now it is the development key"
            } else {
                ""
            }
        );
    }
    Ok(())
}

fn header(robots: Robots, a: &[u8], b: &[u8]) -> Header {
    Header {
        board: robots.in_header(),
        hardware: release::HARDWARE_REVISION,
        wire_version: protocol::WIRE_VERSION,
        version: robot::Identity::FIRMWARE,
        security_counter: release::SECURITY_COUNTER,
        a: link(a),
        b: link(b),
    }
}

fn link(image: &[u8]) -> Link {
    let software = Software::default();
    let mut hash = software.begin();
    software.update(&mut hash, image);
    Link {
        length: image.len() as u32,
        hash: software.finish(hash),
    }
}

/// The bytes of a slot in an ELF file, filled up to a word.
fn image(elf: &Path, slot: Slot) -> anyhow::Result<Vec<u8>> {
    let bytes = std::fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
    let mut image = Vec::new();
    for (address, part) in emulator::programmed(&bytes)? {
        if !slot.range().contains(&address) {
            continue;
        }
        let start = (address - slot.address()) as usize;
        let end = start + part.len();
        image.resize(image.len().max(end.next_multiple_of(4)), 0xFF);
        image[start..end].copy_from_slice(&part);
    }
    ensure!(
        slot.holds(image.len() as u32),
        "{}: {} bytes for slot {slot:?}, which holds {}",
        elf.display(),
        image.len(),
        slot.longest_image()
    );
    Ok(image)
}

/// Reads a private key.
fn private_key(path: &Path) -> anyhow::Result<[u8; 32]> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read the private key {}", path.display()))?;
    unhex(text.trim()).with_context(|| {
        format!(
            "{} does not have 64 hexadecimal digits; `cargo xtask keys` makes one",
            path.display()
        )
    })
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(digits: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    if digits.len() != 64 || !digits.is_ascii() {
        return None;
    }
    for (nth, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&digits[2 * nth..2 * nth + 2], 16).ok()?;
    }
    Some(bytes)
}

/// `path` with something behind its whole name.
fn beside(path: &Path, extension: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(extension);
    name.into()
}

fn write(path: &Path, parts: &[&[u8]]) -> anyhow::Result<()> {
    std::fs::write(path, parts.concat()).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_development_key_is_refused_unless_it_is_asked_for() {
        assert!(check_pair(&key::DEVELOPMENT_PRIVATE, false).is_err());
        let foreign = check_pair(&[1; 32], false).unwrap_err().to_string();
        assert!(foreign.contains("OMNIBUS_PUBLIC_KEY"), "{foreign}");
        assert_eq!(
            check_pair(&key::DEVELOPMENT_PRIVATE, true).is_ok(),
            key::is_development()
        );
    }

    #[test]
    fn keys_are_read_as_they_are_written() {
        assert_eq!(unhex(&hex(&[0xA5; 32])), Some([0xA5; 32]));
        for wrong in ["", "a5", &"g".repeat(64), &"a5".repeat(33)] {
            assert_eq!(unhex(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_key_in_the_repository_is_not_made() {
        let out = crate::cargo::root().join("target/secret.key");
        let error = keys(&KeysArguments { out }).unwrap_err().to_string();
        assert!(error.contains("must not be"), "{error}");
    }
    #[test]
    fn neither_half_of_another_key_is_replaced() {
        let name = format!("omnibus-keys-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir(&folder).unwrap();
        let halves = ["release.key", "release.key.pub"].map(|name| folder.join(name));
        for there in &halves {
            std::fs::write(there, "another").unwrap();
            let out = halves[0].clone();
            assert!(keys(&KeysArguments { out }).is_err());
            assert_eq!(std::fs::read_to_string(there).unwrap(), "another");
            assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
            std::fs::remove_file(there).unwrap();
        }
        std::fs::remove_dir(folder).unwrap();
    }
}
