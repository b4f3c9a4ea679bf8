//! `cargo xtask size --canopen`: the size of the CANopen device, as the difference of two images.
//!
//! One is the firmware. The other has a stub in place of the device (`canopen/src/stub.rs`), which
//! keeps every other function of the program alive; it has no other use.

use anyhow::{Context as _, bail};
use object::{Object as _, ObjectSection as _, SectionFlags, elf::SHF_ALLOC};
use omnibus::report::Scalar;

use crate::{cargo, firmware};

/// Most flash and RAM that the device with every service on may take, bytes. It took 16 056 bytes
/// before LSS learnt not to make two devices one node, and communication objects were fixed while
/// OPERATIONAL, 16 964 before values longer than its buffer went into a sink: 18 288.
const FLASH_MAX: u64 = 18 * 1024;
const RAM_MAX: u64 = 3 * 1024;

/// The feature that puts the stub in.
const WITHOUT: &str = "without-canopen";

/// Start of the RAM (RM0390 rev 6, 2.4).
const RAM_ORIGIN: u64 = 0x2000_0000;

/// Builds both, prints both and the difference, and fails if that is too much.
pub fn run() -> anyhow::Result<()> {
    let with = size(&firmware::build(Scalar::F32)?)?;
    let mut command = cargo::command();
    command
        .args(["build", "--quiet", "--release", "--bin", "omnibus-firmware"])
        .args(["--target", cargo::TARGET, "--features", WITHOUT]);
    cargo::run(cargo::variant(&mut command, WITHOUT))?;
    let elf = cargo::variant_folder(WITHOUT)
        .join(cargo::TARGET)
        .join("release/omnibus-firmware");
    let without = size(&elf)?;
    let costs = [0, 1].map(|of| with[of].saturating_sub(without[of]));
    println!("{:<24} {:>8} {:>8}", "bytes", "flash", "RAM");
    for (name, [flash, ram]) in [
        ("with the device", with),
        ("with a stub", without),
        ("the device", costs),
        ("at most", [FLASH_MAX, RAM_MAX]),
    ] {
        println!("{name:<24} {flash:>8} {ram:>8}");
    }
    if costs[0] > FLASH_MAX || costs[1] > RAM_MAX {
        bail!("the CANopen device exceeds its budget");
    }
    Ok(())
}

/// Bytes of flash, and of RAM without the stack.
fn size(elf: &std::path::Path) -> anyhow::Result<[u64; 2]> {
    let bytes = std::fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
    let file = object::File::parse(&*bytes).context("not an ELF file")?;
    let (mut flash, mut ram) = (0, 0);
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags, .. } = section.flags() else {
            continue;
        };
        if sh_flags.0 & SHF_ALLOC.0 == 0 {
            continue;
        }
        let is_ram = section.address() >= RAM_ORIGIN;
        if is_ram {
            ram += section.size();
        }
        // Initial values lie in flash, too.
        if !is_ram || section.name() == Ok(".data") {
            flash += section.size();
        }
    }
    Ok([flash, ram])
}
