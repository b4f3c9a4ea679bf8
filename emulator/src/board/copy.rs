//! A copy of a board: the same state at the same time, which goes on by itself.
//!
//! Flash and RAM are copied, and so is the reference core, by way of its own saved state. Pages
//! that have been decoded are shared with the copy until its flash changes.

use std::sync::Arc;

use rsemu::core::Result;
use rsemu::core::device::Device as _;
use rsemu::core::space::RamStore;
use rsemu::core::state::{MachineShape, Migrations, StateReader, StateWriter};
use rsemu::cpu::arm::v7m::ArmV7m;

use super::{Board, core};
use crate::ram::Ram;

impl Clone for Board {
    /// A second board in this state. With the same input from now on both do the same, to the
    /// cycle.
    fn clone(&self) -> Self {
        let chip = self.chip();
        let flash = Arc::new(RamStore::new(chip.flash_size()));
        flash
            .write_at(0, &self.flash())
            .expect("the flash has this size");
        let ram = Arc::new(Ram::clone(&self.ram));
        let shared = self.shared.with_memory(&flash, &ram);
        let cpu = core(chip, &shared, &flash, &ram, self.config.uid);
        copy_state(&self.cpu, &cpu).expect("a core loads what one of its kind has saved");
        Self {
            firmware: self.firmware.clone(),
            config: self.config.clone(),
            log: self.log.with_ram(&ram),
            cpu,
            shared,
            ram,
            flash,
            fast: self.fast.clone(),
            profile: self.profile.clone(),
            debugger: self.debugger.clone(),
            follow: self.follow.clone(),
            ..*self
        }
    }
}

/// Registers, pending exceptions, system block and floating-point unit.
fn copy_state(from: &ArmV7m, to: &ArmV7m) -> Result<()> {
    const CORE: (&str, &str, u32) = ("core", "core", 1);
    let (path, class, version) = CORE;
    let mut saved = StateWriter::new(MachineShape::new());
    from.save(&mut saved.chunk(path, class, version)?)?;
    let saved = saved.to_vec()?;
    let saved = StateReader::new(&saved)?;
    let saved = saved.load(path, class, version, &Migrations::new())?;
    to.load(&mut saved.reader())
}
