//! The address map and the connection between the core and the peripherals.
//!
//! The core reads flash and RAM directly. Everything else comes through [`Window`], which asks the
//! peripherals under one lock (never contended: a board is run by one thread) at the cycle the run
//! loop has published, and then hands changed interrupt lines to the core. For the same reason the
//! atomics here are only loaded and stored: a read-modify-write takes the host some 20 cycles.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};

use rsemu::core::BusError;
use rsemu::core::space::{
    AccessConstraints, AddressSpace, DispatchPolicy, Mapping, MemAttrs, MemOps, MemResult, Perms,
    RamStore, Region, RomStore, RomWrite,
};
use rsemu::core::value::Width;
use rsemu::cpu::arm::v7m::ArmV7m;

use crate::chip::{Chip, SystemMemory};
use crate::memory_map::{FLASH_BASE, RAM_BASE};
use crate::ram::Ram;
use crate::soc::{DBGMCU, IrqLines, Soc};
use crate::system::adc::VREFINT_CALIBRATION;

/// What the core and the peripherals share.
#[derive(Debug)]
pub(crate) struct Shared {
    soc: Mutex<Soc>,
    /// Cycle of the instruction under way.
    pub(crate) now: AtomicU64,
    /// Copy of [`Soc::next_event`].
    pub(crate) next_event: AtomicU64,
    /// The run loop has to look: a stop, a reset, an earlier event, another clock.
    pub(crate) attention: AtomicBool,
    /// An interrupt line has changed since the core last looked.
    pub(crate) lines_changed: AtomicBool,
    /// Copy of `Flash::changes`: changes with the content of the flash.
    pub(crate) flash_version: AtomicU64,
    /// What reading the flash costs: FLASH_ACR, or 0 where it is to cost nothing.
    pub(crate) flash_acr: AtomicU32,
    /// The flash is being erased or programmed.
    pub(crate) flash_busy: AtomicBool,
    /// It has been read meanwhile, so the core waits for it.
    pub(crate) flash_awaited: AtomicBool,
    flash_waits: bool,
    cpu: OnceLock<Weak<ArmV7m>>,
    nmi: AtomicBool,
    lines: [AtomicU32; 4],
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic elsewhere has already ended this board; its state is still worth looking at.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    pub(crate) fn new(soc: Soc, flash_waits: bool) -> Self {
        Self {
            soc: Mutex::new(soc),
            now: AtomicU64::new(0),
            next_event: AtomicU64::new(u64::MAX),
            attention: AtomicBool::new(false),
            lines_changed: AtomicBool::new(false),
            flash_version: AtomicU64::new(0),
            flash_acr: AtomicU32::new(0),
            flash_busy: AtomicBool::new(false),
            flash_awaited: AtomicBool::new(false),
            flash_waits,
            cpu: OnceLock::new(),
            nmi: AtomicBool::new(false),
            lines: Default::default(),
        }
    }

    /// The same peripherals with other memory, for a core that is still to be attached.
    pub(crate) fn with_memory(&self, flash: &Arc<RamStore>, ram: &Arc<Ram>) -> Arc<Self> {
        let flag = |flag: &AtomicBool| AtomicBool::new(flag.load(Relaxed));
        let number = |number: &AtomicU64| AtomicU64::new(number.load(Relaxed));
        let word = |word: &AtomicU32| AtomicU32::new(word.load(Relaxed));
        Arc::new(Self {
            soc: Mutex::new(lock(&self.soc).with_memory(flash, ram)),
            now: number(&self.now),
            next_event: number(&self.next_event),
            attention: flag(&self.attention),
            lines_changed: flag(&self.lines_changed),
            flash_version: number(&self.flash_version),
            flash_acr: word(&self.flash_acr),
            flash_busy: flag(&self.flash_busy),
            flash_awaited: flag(&self.flash_awaited),
            flash_waits: self.flash_waits,
            cpu: OnceLock::new(),
            nmi: flag(&self.nmi),
            lines: self.lines.each_ref().map(word),
        })
    }

    pub(crate) fn attach(&self, cpu: &Arc<ArmV7m>) {
        // Set once, by the board that owns both.
        let _ = self.cpu.set(Arc::downgrade(cpu));
    }

    /// The interrupt lines as the core sees them.
    pub(crate) fn lines(&self) -> IrqLines {
        self.lines.each_ref().map(|word| word.load(Relaxed))
    }

    /// Does something with the peripherals at the present cycle, without consequences.
    pub(crate) fn look<T>(&self, f: impl FnOnce(&mut Soc) -> T) -> T {
        let mut soc = lock(&self.soc);
        soc.now = self.now.load(Relaxed);
        f(&mut soc)
    }

    /// Runs a function on the peripherals and passes on the result.
    pub(crate) fn with<T>(&self, f: impl FnOnce(&mut Soc) -> T) -> T {
        let mut soc = lock(&self.soc);
        soc.now = self.now.load(Relaxed);
        let (hz, requests) = (soc.clock.hz(), soc.can.requests());
        let result = f(&mut soc);
        let is_busy = soc.flash.busy_until().is_some();
        self.flash_busy.store(is_busy, Relaxed);
        if !is_busy {
            self.flash_awaited.store(false, Relaxed);
        }
        self.flash_version.store(soc.flash.changes(), Relaxed);
        if self.flash_waits {
            self.flash_acr.store(soc.flash_access(), Relaxed);
        }
        let before = self.next_event.load(Relaxed);
        self.next_event.store(soc.next_event, Relaxed);
        if soc.next_event < before
            || soc.clock.hz() != hz
            || soc.can.requests() != requests
            || soc.stop.is_some()
            || soc.reset_request != 0
            || is_busy
        {
            self.attention.store(true, Relaxed);
        }
        if soc.rcc.nmi() != self.nmi.load(Relaxed)
            && let Some(cpu) = self.cpu.get().and_then(Weak::upgrade)
        {
            self.nmi.store(soc.rcc.nmi(), Relaxed);
            cpu.set_nmi(soc.rcc.nmi());
            self.lines_changed.store(true, Relaxed);
        }
        if self.lines() != soc.irq
            && let Some(cpu) = self.cpu.get().and_then(Weak::upgrade)
        {
            for (word, (line, new)) in self.lines.iter().zip(soc.irq).enumerate() {
                let mut changed = line.load(Relaxed) ^ new;
                line.store(new, Relaxed);
                while changed != 0 {
                    let bit = changed.trailing_zeros();
                    changed &= changed - 1;
                    cpu.set_irq((32 * word as u32 + bit) as u16, new >> bit & 1 != 0);
                }
            }
            self.lines_changed.store(true, Relaxed);
        }
        result
    }
}

/// A range of addresses behind which peripherals are.
#[derive(Debug)]
struct Window {
    base: u32,
    shared: Arc<Shared>,
}

impl MemOps for Window {
    fn read(&self, offset: u64, dst: &mut [u8], attrs: MemAttrs) -> MemResult {
        if attrs.debug {
            dst.fill(0);
            return Ok(());
        }
        let address = self.base.wrapping_add(offset as u32);
        let word = self.shared.with(|soc| soc.read(address, dst.len() as u32));
        dst.copy_from_slice(&word.to_le_bytes()[..dst.len().min(4)]);
        Ok(())
    }

    fn write(&self, offset: u64, src: &[u8], _: MemAttrs) -> MemResult {
        let mut word = [0; 4];
        word[..src.len().min(4)].copy_from_slice(&src[..src.len().min(4)]);
        let address = self.base.wrapping_add(offset as u32);
        self.shared
            .with(|soc| soc.write(address, src.len() as u32, u32::from_le_bytes(word)));
        Ok(())
    }

    fn constraints(&self) -> AccessConstraints {
        AccessConstraints::IO
            .with_widths(Width::U8, Width::U32)
            .with_natural_alignment(true)
    }
}

/// Reads of the flash array by the reference core: instructions, vectors, constants.
#[derive(Debug)]
struct FlashReads {
    array: Arc<RamStore>,
    shared: Arc<Shared>,
}

impl MemOps for FlashReads {
    fn read(&self, offset: u64, dst: &mut [u8], attrs: MemAttrs) -> MemResult {
        if !attrs.debug && self.shared.flash_busy.load(Relaxed) {
            self.shared.flash_awaited.store(true, Relaxed);
        }
        self.array.read_at(offset, dst)
    }

    fn write(&self, _: u64, _: &[u8], _: MemAttrs) -> MemResult {
        // The mapping is for reading: stores go to `FlashWrites`.
        Err(BusError::BadAccess)
    }

    fn constraints(&self) -> AccessConstraints {
        AccessConstraints::ANY
    }
}

/// Stores to the flash array.
#[derive(Debug)]
struct FlashWrites {
    shared: Arc<Shared>,
}

impl MemOps for FlashWrites {
    fn read(&self, _: u64, dst: &mut [u8], _: MemAttrs) -> MemResult {
        dst.fill(0xFF);
        Ok(())
    }

    fn write(&self, offset: u64, src: &[u8], _: MemAttrs) -> MemResult {
        if self.shared.with(|soc| soc.program_flash(offset, src)) {
            Ok(())
        } else {
            Err(BusError::BadAccess)
        }
    }
}

/// Builds the address space of one board (RM0390 section 2.2.2, RM0090 section 2.3).
pub(crate) fn address_space(
    chip: &Chip,
    shared: &Arc<Shared>,
    flash: &Arc<RamStore>,
    ram: &Arc<Ram>,
    uid: [u8; 12],
) -> Result<AddressSpace, rsemu::core::Error> {
    // Nearly every access is to flash or RAM: a table of 64 KiB pages finds it without a search.
    let dispatch = DispatchPolicy::Dense {
        page_bits: 16,
        cover: 0x5000_0000,
    };
    let space = AddressSpace::new("stm32", 32).with_dispatch(dispatch);
    let mut map = space.topology();
    // At 0 the flash appears again: the chip boots from it (section 2.3).
    for base in [0, FLASH_BASE] {
        let reads = FlashReads {
            array: Arc::clone(flash),
            shared: Arc::clone(shared),
        };
        let region = Region::io("flash", flash.len(), Arc::new(reads));
        map.map_with(
            Mapping::new(region, u64::from(base))
                .with_perms(Perms::RX)
                .with_priority(1),
        )?;
    }
    let writes = Region::io(
        "flash programming",
        flash.len(),
        Arc::new(FlashWrites {
            shared: Arc::clone(shared),
        }),
    );
    map.map_with(Mapping::new(writes, u64::from(FLASH_BASE)).with_perms(Perms::WRITE))?;
    let ram_region = Region::io(
        "ram",
        u64::from(ram.size()),
        Arc::clone(ram) as Arc<dyn MemOps>,
    );
    map.map(ram_region, u64::from(RAM_BASE))?;

    let SystemMemory {
        base,
        length,
        uid: at_uid,
        flash_kib: at_flash_kib,
        vrefin_cal,
    } = chip.system_memory;
    let mut system = vec![0xFF; length];
    // A chip has a few MiB at most.
    let flash_kib = (flash.len() / 1024) as u16;
    system[at_uid..at_uid + 12].copy_from_slice(&uid);
    system[at_flash_kib..at_flash_kib + 2].copy_from_slice(&flash_kib.to_le_bytes());
    if let Some(at) = vrefin_cal {
        system[at..at + 2].copy_from_slice(&VREFINT_CALIBRATION.to_le_bytes());
    }
    let system = Region::rom(
        "system memory",
        Arc::new(RomStore::new(system)),
        RomWrite::Fault,
    );
    map.map(system, u64::from(base))?;

    for (name, base, length) in [
        ("APB and AHB1", 0x4000_0000, 0x0200_0000),
        ("AHB2", 0x5000_0000, 0x0010_0000),
        ("AHB3", 0xA000_0000, 0x0000_2000),
        ("DBGMCU", DBGMCU, 0x400),
    ] {
        let window = Window {
            base,
            shared: Arc::clone(shared),
        };
        map.map(Region::io(name, length, Arc::new(window)), u64::from(base))?;
    }
    drop(map);
    Ok(space)
}
