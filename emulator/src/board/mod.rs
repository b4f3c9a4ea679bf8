//! One board: the core, the chip around it, and the loop that runs them.
//!
//! The loop steps the core until the next event that a peripheral has announced, processes the
//! event, and continues. While the core sleeps it advances the clock in one step instead. An
//! instruction that changes peripherals (an earlier event, another clock) raises a flag that ends
//! the inner loop.
//!
//! Between two runs the world may set pins, turn encoders and deliver frames, as of the last's end.

mod can;
mod copy;
mod debug;
mod follow;
mod outputs;
mod run;
mod serial;
mod step;

pub use debug::CoreRegisters;
pub use outputs::Outputs;
pub use serial::SerialPort;

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use rsemu::core::device::{Device, ResetKind};
use rsemu::core::space::{AddressSpace, RamStore};
use rsemu::cpu::arm::v7m::ArmV7m;

use crate::address_space::{Shared, address_space};
use crate::bmi088::Bmi088;
use crate::can::port::Which;
use crate::can::{Can, CanPort};
use crate::chip::Chip;
use crate::defect::{Defect, Defects};
use crate::fast::Fast;
use crate::firmware::Firmware;
use crate::memory_map::{FLASH_BASE, RAM_BASE};
use crate::profile::Profile;
use crate::ram::Ram;
use crate::rtt::{Log, LogLine};
use crate::soc::Soc;
use crate::stop::{Stop, StopKind};
use crate::system::flash::FlashOperations;
use crate::system::gpio::Port;
use crate::system::{flash, rcc};
use crate::trace::{Trace, Traced};

/// The settings that differ between boards.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardConfig {
    /// Error of the crystal in parts per million, positive when it runs fast.
    pub crystal_ppm: f64,
    /// The chip's unique number (RM0390 section 34.1).
    pub uid: [u8; 12],
    /// Frequency at the HSE input, 0 for none. The NUCLEO gets 8 MHz from its ST-LINK.
    pub hse_hz: u64,
    /// Frequency of the watchdog's oscillator; the data sheet allows 17 to 47 kHz.
    pub lsi_hz: u64,
    /// Ends the run when the processor takes a HardFault, instead of letting the firmware's handler
    /// deal with it.
    pub stop_on_hard_fault: bool,
    /// Executes every instruction on the reference core. The result is the same and takes several
    /// times as long.
    pub reference_core: bool,
    /// Makes the flash as fast as RAM: wait states take no time.
    pub ideal_flash: bool,
    /// The option bytes at power-on, in the places of FLASH_OPTCR.
    pub option_bytes: u32,
    /// What does not work.
    pub defects: Vec<Defect>,
}

impl Default for BoardConfig {
    fn default() -> Self {
        Self {
            crystal_ppm: 0.0,
            uid: *b"OMNIBUS-0001",
            hse_hz: 8_000_000,
            lsi_hz: 32_000,
            stop_on_hard_fault: false,
            reference_core: false,
            ideal_flash: false,
            option_bytes: flash::OPTIONS_ON_A_ROBOT,
            defects: Vec::new(),
        }
    }
}

/// Why the chip was last reset, by RCC_CSR.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResetCause {
    /// Power-on.
    Power,
    /// Reset pin.
    Pin,
    /// SYSRESETREQ.
    Software,
    /// Independent watchdog.
    Watchdog,
    /// The chip's supply was too low.
    BrownOut,
}

/// Core cycles between two reads of the log buffer: 1 ms at 180 MHz.
const LOG_CYCLES: u64 = 180_000;

/// An emulated board.
#[derive(Debug)]
pub struct Board {
    firmware: Firmware,
    config: BoardConfig,
    cpu: Arc<ArmV7m>,
    shared: Arc<Shared>,
    ram: Arc<Ram>,
    flash: Arc<RamStore>,
    log: Log,
    fast: Fast,
    now: u64,
    asleep: bool,
    halted: bool,
    /// Held in reset by the brown-out detector.
    browned_out: bool,
    next_log: u64,
    instructions: u64,
    slept: u64,
    resets: u32,
    last_cause: ResetCause,
    profile: Option<Profile>,
    debugger: debug::Debugger,
    follow: Option<follow::Follow>,
}

/// A core that reaches all this, as after power-on.
fn core(
    chip: &Chip,
    shared: &Arc<Shared>,
    flash: &Arc<RamStore>,
    ram: &Arc<Ram>,
    uid: [u8; 12],
) -> Arc<ArmV7m> {
    let space = address_space(chip, shared, flash, ram, uid).expect("the address map is valid");
    // 16 priority levels (RM0390 section 10.1.1).
    let cpu = Arc::new(ArmV7m::new(chip.core.with_priority_bits(4)));
    cpu.attach_space(Arc::new(space));
    shared.attach(&cpu);
    cpu
}

impl Board {
    /// A board with the firmware flashed, at the moment of power-on, world time 0.
    ///
    /// # Panics
    /// Never: the address map is fixed and valid.
    #[must_use]
    pub fn new(firmware: &Firmware, config: BoardConfig) -> Self {
        Self::with_flash(firmware, config, firmware.flash())
    }

    /// A board with this content of the flash, usually [`Board::flash`] of another run, at the
    /// moment of power-on, world time 0. `firmware` provides symbols, source lines and log messages
    /// for the content.
    ///
    /// # Panics
    /// When there is more than the flash can hold.
    #[must_use]
    pub fn with_flash(firmware: &Firmware, config: BoardConfig, content: &[u8]) -> Self {
        let chip = firmware.chip();
        let flash = Arc::new(RamStore::new(chip.flash_size()));
        flash
            .write_at(0, content)
            .expect("the content fits into the flash");
        let ram = Arc::new(Ram::new(chip));
        let soc = Soc::new(chip, Arc::clone(&flash), Arc::clone(&ram), &config);
        let shared = Arc::new(Shared::new(soc, !config.ideal_flash));
        let cpu = core(chip, &shared, &flash, &ram, config.uid);
        let log = Log::new(Arc::clone(&ram), firmware);
        Self {
            firmware: firmware.clone(),
            fast: Fast::new(Arc::clone(firmware.code()), &Defects::new(&config.defects)),
            config,
            cpu,
            shared,
            ram,
            flash,
            log,
            now: 0,
            asleep: false,
            halted: false,
            browned_out: false,
            next_log: 0,
            instructions: 0,
            slept: 0,
            resets: 0,
            last_cause: ResetCause::Power,
            profile: None,
            debugger: debug::Debugger::default(),
            follow: None,
        }
    }

    /// The chip on the board: the one that its firmware is for.
    #[must_use]
    pub fn chip(&self) -> &'static Chip {
        self.firmware.chip()
    }

    /// Runs until world time `t_ns`.
    ///
    /// # Errors
    /// [`Stop`] when the firmware does something that cannot be emulated. The board can still be
    /// inspected, but not run further.
    pub fn run_until(&mut self, t_ns: u64) -> Result<(), Stop> {
        self.run(t_ns, None).map(|_| ())
    }

    /// Runs until world time `t_ns`, or until the firmware has asked for a frame to be sent that
    /// was not pending before. Returns the time reached.
    ///
    /// # Errors
    /// As [`Board::run_until`].
    pub fn run_until_request(&mut self, t_ns: u64) -> Result<u64, Stop> {
        let seen = self.see_can(Which::First, Can::requests);
        self.run(t_ns, Some(seen))?;
        Ok(self.world_ns(self.now).min(t_ns))
    }

    fn system_reset(&mut self, causes: u32) {
        self.drain_log();
        self.shared.with(|soc| soc.system_reset(causes));
        self.cpu.reset(ResetKind::Cold);
        self.fast.forget_floats();
        self.log.reset();
        if let Some(follow) = &mut self.follow {
            follow.reset();
        }
        self.asleep = false;
        self.halted = false;
        self.resets += 1;
        self.last_cause = match causes {
            rcc::cause::IWDG => ResetCause::Watchdog,
            rcc::cause::SOFTWARE => ResetCause::Software,
            rcc::cause::BOR => ResetCause::BrownOut,
            _ => ResetCause::Pin,
        };
        self.shared.attention.store(true, Relaxed);
    }

    fn stop(&self, kind: StopKind, pc: u32) -> Stop {
        Stop {
            kind,
            pc,
            location: self.firmware.location(pc),
            t_ns: self.world_ns(self.now),
        }
    }

    fn drain_log(&mut self) {
        self.next_log = self.now + LOG_CYCLES;
        let (shared, now) = (&self.shared, self.now);
        // A control block that is not initialised yet gives no lines, which is not an error.
        let _ = self.log.drain(&self.firmware, || {
            shared.look(|soc| soc.clock.world_ns(now)) / 1000
        });
    }

    /// World time in ns of a cycle.
    pub(crate) fn world_ns(&self, cycle: u64) -> u64 {
        self.shared.look(|soc| soc.clock.world_ns(cycle))
    }

    /// World time in ns that the board has reached; up to one instruction beyond what it was run
    /// to.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.world_ns(self.now)
    }

    /// World time in ns of the next event when the core sleeps or is halted, `None` without one;
    /// the present when the core runs.
    #[must_use]
    pub fn next_event_ns(&self) -> Option<u64> {
        let next = self.shared.next_event.load(Relaxed);
        if self.halted || self.debugger.stopped {
            return (next != u64::MAX).then(|| self.world_ns(next));
        }
        if !self.asleep || self.shared.lines_changed.load(Relaxed) {
            return Some(self.now_ns());
        }
        let systick = self
            .cpu
            .with_sys(|sys| (sys.syst_csr & 3 == 3).then_some(u64::from(sys.syst_cvr) + 1));
        let next = systick.map_or(next, |left| next.min(self.now + left));
        (next != u64::MAX).then(|| self.world_ns(next))
    }

    /// Whether the core sleeps or is halted.
    #[must_use]
    pub fn is_asleep(&self) -> bool {
        self.asleep || self.halted || self.debugger.stopped
    }

    /// Connects a pin to a level outside. Until this is called, a pin is open.
    pub fn set_input(&mut self, port: Port, pin: u8, high: bool) {
        self.shared.with(|soc| soc.set_input(port, pin & 15, high));
    }

    /// Connects two pins of this board with a wire.
    pub fn connect(&mut self, one: (Port, u8), other: (Port, u8)) {
        self.shared.with(|soc| soc.connect(one, other));
    }

    /// Stops or restarts the clock at the HSE input. It runs from power-on until this is called.
    pub fn set_hse(&mut self, runs: bool) {
        self.shared.with(|soc| soc.set_hse(runs));
    }

    /// Sets the supply of the chip, and with it the converter's reference, in V; 3.3 until this is
    /// called. Below the level of the brown-out reset, which the option bytes set, the chip is held
    /// in reset. Above that level, but below the voltage that its clock needs, the run ends.
    pub fn set_vdd(&mut self, volts: f64) {
        let (falls, rises) = self.shared.look(|soc| soc.flash.brown_out());
        if self.browned_out {
            self.browned_out = volts < rises;
            self.halted = self.browned_out;
        } else if volts < falls {
            self.system_reset(rcc::cause::BOR);
            self.browned_out = true;
            self.halted = true;
        }
        self.shared.with(|soc| soc.set_vdd(volts));
    }

    /// The option bytes as they are now, in the places of FLASH_OPTCR.
    #[must_use]
    pub fn option_bytes(&self) -> u32 {
        self.shared.look(|soc| soc.flash.options())
    }

    /// Connects a pin that the converters can measure to a voltage, from 0 V.
    pub fn set_analog(&mut self, port: Port, pin: u8, volts: f64) {
        self.shared.look(|soc| soc.set_analog(port, pin, volts));
    }

    /// Puts a gyro on SPI1, selected by a pin; it has just been switched on.
    pub fn connect_gyro(&mut self, select: (Port, u8)) {
        self.shared.look(|soc| soc.connect_gyro(select));
    }

    /// The gyro, if there is one.
    pub fn with_gyro<T>(&mut self, f: impl FnOnce(&mut Bmi088) -> T) -> Option<T> {
        self.shared.look(|soc| soc.gyro().map(f))
    }

    /// Turns the encoder that is wired to channels 1 and 2 of a timer by a number of quadrature
    /// edges, positive when channel 1 leads. Counted only in encoder mode and with the pins
    /// switched to the timer, later by the delay of the inputs' filters, for which every edge is
    /// assumed to last. For edges with their bounce there is [`Board::set_input`].
    pub fn encoder_add(&mut self, timer: usize, edges: i32) {
        self.encoders_add([(timer, edges)]);
    }

    /// The same of several encoders: timers and edges.
    pub fn encoders_add(&mut self, turned: impl IntoIterator<Item = (usize, i32)>) {
        self.shared.with(|soc| {
            for (timer, edges) in turned {
                soc.encoder_add(timer, edges);
            }
            soc.settle();
        });
    }

    /// The connector of CAN1.
    pub fn can(&mut self) -> CanPort<'_> {
        CanPort {
            board: self,
            which: Which::First,
        }
    }

    /// The connector of CAN2.
    pub fn can2(&mut self) -> CanPort<'_> {
        CanPort {
            board: self,
            which: Which::Second,
        }
    }

    /// The line of USART2.
    pub fn serial(&mut self) -> SerialPort<'_> {
        SerialPort { board: self }
    }

    pub(crate) fn look<T>(&self, f: impl FnOnce(&mut Soc) -> T) -> T {
        self.shared.look(f)
    }

    /// Log lines decoded since the last call.
    pub fn take_log(&mut self) -> Vec<LogLine> {
        self.log.take(&self.firmware)
    }

    /// Instructions executed since power-on.
    #[must_use]
    pub fn instructions(&self) -> u64 {
        self.instructions
    }

    /// Core clock cycles since power-on, and how many of them the core slept.
    #[must_use]
    pub fn cycles(&self) -> (u64, u64) {
        (self.now, self.slept)
    }

    /// Core clock in Hz by the board's own crystal.
    #[must_use]
    pub fn hclk_hz(&self) -> u64 {
        self.shared.look(|soc| soc.clock.hz())
    }

    /// Why the chip was last reset.
    #[must_use]
    pub fn reset_cause(&self) -> ResetCause {
        self.last_cause
    }

    /// How often the chip has been reset since power-on.
    #[must_use]
    pub fn resets(&self) -> u32 {
        self.resets
    }

    /// Pulls the reset pin for a moment.
    pub fn press_reset(&mut self) {
        self.system_reset(rcc::cause::PIN);
    }

    /// Halts or resumes the core, as a debugger does that freezes no peripheral (DBGMCU at its
    /// reset value): timers, CAN and the independent watchdog keep running. Any reset resumes the
    /// core.
    pub fn halt(&mut self, halted: bool) {
        self.halted = halted;
    }

    /// Makes the core jump to an address, as a corrupt return address does. A core that sleeps
    /// jumps when it wakes.
    pub fn jump(&mut self, address: u32) {
        self.cpu.set_pc(address);
    }

    /// Writes a register of the core as the code that runs next sees it, 0..=15, as a debugger
    /// would.
    pub fn set_register(&mut self, register: u8, value: u32) {
        self.cpu.set_reg(register & 15, value);
    }

    /// Reads a word of RAM or flash, as a debugger would.
    #[must_use]
    pub fn read_word(&self, address: u32) -> Option<u32> {
        let mut word = [0; 4];
        self.read_memory(address, &mut word)?;
        Some(u32::from_le_bytes(word))
    }

    /// Reads RAM or flash, as a debugger would.
    pub fn read_memory(&self, address: u32, to: &mut [u8]) -> Option<()> {
        match address {
            RAM_BASE.. => self.ram.read_at(u64::from(address - RAM_BASE), to),
            FLASH_BASE.. => self.flash.read_at(u64::from(address - FLASH_BASE), to),
            _ => self.flash.read_at(u64::from(address), to),
        }
        .ok()
    }

    /// Content of the whole flash, which survives a power cycle.
    ///
    /// # Panics
    /// Never: the flash has this size.
    #[must_use]
    pub fn flash(&self) -> Vec<u8> {
        let mut content = vec![0; self.flash.len() as usize];
        self.flash
            .read_at(0, &mut content)
            .expect("the flash has this size");
        content
    }

    /// Flash operations begun since power-on.
    #[must_use]
    pub fn flash_operations(&self) -> FlashOperations {
        self.shared.look(|soc| soc.flash.operations())
    }

    /// Makes the power fail in the middle of a flash operation, counted from power-on, the first
    /// being 1: the run ends with [`StopKind::PowerCut`], and [`Board::flash`] is the content at
    /// the next power-on.
    pub fn cut_power_at_flash_operation(&mut self, operation: u64) {
        self.shared.look(|soc| soc.flash.cut_power_at(operation));
    }

    /// Begins to record, for each further flash operation, the value of [`Board::flash`] after a
    /// power failure in the middle of it.
    pub fn record_power_cuts(&mut self) {
        self.shared.look(|soc| soc.flash.record_cuts());
    }

    /// The recorded contents, half a megabyte per operation; ends the recording.
    pub fn take_power_cuts(&mut self) -> Vec<Vec<u8>> {
        self.shared.look(|soc| soc.flash.take_cuts())
    }

    /// Begins to record changes of the outputs, starting from the present state.
    pub fn start_trace(&mut self) {
        self.shared.with(|soc| {
            soc.trace = Some(Box::default());
            soc.settle();
            if let Some(trace) = &mut soc.trace {
                trace.changes.clear();
            }
        });
    }

    /// The same, with the exceptions and tasks of the program; several times slower.
    pub fn start_trace_of_program(&mut self) {
        self.start_trace();
        self.follow = Some(follow::Follow::new(&self.firmware));
    }

    /// Changes recorded since the last call, in order.
    pub fn take_trace(&mut self) -> Vec<Traced> {
        self.shared.look(|soc| {
            let changes = soc
                .trace
                .as_mut()
                .map(|trace: &mut Box<Trace>| std::mem::take(&mut trace.changes));
            let clock = &soc.clock;
            changes
                .into_iter()
                .flatten()
                .map(|(cycle, change)| Traced {
                    t_ns: clock.world_ns(cycle),
                    change,
                })
                .collect()
        })
    }

    /// Begins to count instructions per function; slower by about half.
    pub fn start_profile(&mut self) {
        self.profile = Some(Profile::default());
    }

    /// The counts so far, to read them or to watch functions.
    pub fn profile(&mut self) -> Option<&mut Profile> {
        self.profile.as_mut()
    }

    /// Ends counting and returns the counts.
    pub fn take_profile(&mut self) -> Option<Profile> {
        self.profile.take()
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        // Core and address space refer to the peripherals; letting go of the space frees them all.
        self.cpu
            .attach_space(Arc::new(AddressSpace::new("none", 32)));
    }
}
