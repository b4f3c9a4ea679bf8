//! The board of a robot: everything that its tasks use.

use embassy_stm32::pac;
use robot::Hardware;

use super::can::Can;
use super::encoders::Encoders;
use super::index::Indexes;
use super::iwdg::Watchdog;
use super::outputs::{self, Outputs};
use super::pin::{Pull, Role};
use super::tick::TickTimer;
use super::{Begun, Led, begin, executors, serial};
use crate::board::family::drives::Drives;
use crate::board::family::flash::ParameterFlash;
use crate::board::family::gyro::Gyro;
use crate::board::family::meters::Meters;
use crate::board::family::serial::Serial;
use crate::board::family::supply;
use crate::board::{HARDWARE, ResetCause, WIRING};

/// Everything the tasks use.
pub struct Board {
    /// CAN controller.
    pub can: Can,
    /// The serial port of the cable; `None` on a board without.
    pub cable: Option<Serial>,
    /// Motor outputs and brake.
    pub outputs: Outputs,
    /// Encoder counters.
    pub encoders: Encoders,
    /// Smart drives, where they turn the wheels.
    pub drives: Drives,
    /// The gyro, where the board has one.
    pub gyro: Gyro,
    /// Encoder index inputs.
    pub indexes: Indexes,
    /// Inputs whose level counts.
    pub lines: Lines,
    /// Supply voltage and motor current.
    pub meters: Meters,
    /// LED.
    pub led: Led,
    /// Timer of the control tick.
    pub tick: TickTimer,
    /// Watchdog, running.
    pub watchdog: Watchdog,
    /// Where the parameters are.
    pub flash: ParameterFlash,
    /// Value of the switches of the node-ID; 0 on a board without.
    pub node_switches: u8,
    /// How long the start waited for clock and supply, ms.
    pub clock_wait_ms: u16,
    /// What it has, with the kinds of bridges that the outputs of this image can drive.
    pub hardware: Hardware,
    /// A gyro is wired.
    pub has_gyro: bool,
    /// Level of the brown-out reset, 0 (off) to 3.
    pub brown_out_level: u8,
    /// The chip's unique number, folded to 32 bits.
    pub serial: u32,
    /// Why the chip was reset.
    pub reset_cause: ResetCause,
}

/// Inputs that the control tick reads as levels.
pub struct Lines(());

impl Lines {
    fn new() -> Self {
        for pin in [WIRING.driver_fault, WIRING.protective_stop] {
            pin.become_a(Role::Input(Pull::Up));
        }
        Self(())
    }

    /// Whether a motor driver reports a fault.
    pub fn driver_fault(&self) -> bool {
        !WIRING.driver_fault.is_high()
    }

    /// Whether the protective stop is open.
    pub fn protective_stop(&self) -> bool {
        WIRING.protective_stop.is_high()
    }
}

const _: () = assert!(
    WIRING.clocks.apb1_timers_hz() == HARDWARE.encoder_clock_mhz as u32 * 1_000_000,
    "another clock counts the encoders"
);
const _: () = assert!(
    HARDWARE.current_inputs == if WIRING.currents.is_some() { 3 } else { 0 },
    "the board has other inputs for current sensors"
);

impl Board {
    /// Sets up clocks, pins and peripherals. To be called once.
    pub fn new() -> Self {
        let Begun {
            watchdog,
            clock_wait_ms,
        } = begin();
        #[cfg(feature = "bench")]
        crate::board::family::freeze::in_debug_halt();

        let outputs = Outputs::new();
        let encoders = Encoders::new();
        let indexes = Indexes::new();
        let lines = Lines::new();
        let node_switches = node_switches();
        supply::program_brown_out();
        executors::set_priorities();
        let can = Can::new();
        let drives = Drives::new();

        Self {
            can,
            cable: Serial::new(),
            outputs,
            encoders,
            drives,
            gyro: Gyro::new(),
            indexes,
            lines,
            meters: Meters::new(),
            led: Led(()),
            tick: TickTimer::new(),
            watchdog,
            flash: ParameterFlash::new(),
            node_switches,
            clock_wait_ms,
            hardware: Hardware {
                output_stages: outputs::STAGES,
                ..HARDWARE
            },
            has_gyro: WIRING.gyro.is_some(),
            brown_out_level: supply::brown_out_level(),
            serial: serial(),
            reset_cause: reset_cause(),
        }
    }
}

/// Reads the switches.
fn node_switches() -> u8 {
    for switch in WIRING.node_switches {
        switch.become_a(Role::Input(Pull::Up));
    }
    // The pull-ups are about 40 kOhm; 20 us charge 100 pF of wiring five times over.
    cortex_m::asm::delay(20 * WIRING.clocks.cycles_per_us());
    let switches = WIRING.node_switches.iter().rev();
    switches.fold(0, |value, switch| value << 1 | u8::from(!switch.is_high()))
}

/// Reads why the chip was reset (RCC_CSR: RM0390 6.3.21, RM0008 7.3.10) and clears the flags. The
/// pin flag is set by every reset, the brown-out flag by power-on too, so the order matters.
fn reset_cause() -> ResetCause {
    let flags = pac::RCC.csr().read().0;
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    let has = |bit: u32| flags >> bit & 1 == 1;
    if has(29) {
        ResetCause::Watchdog
    } else if has(30) {
        ResetCause::WindowWatchdog
    } else if has(31) {
        ResetCause::LowPower
    } else if has(28) {
        ResetCause::Software
    } else if has(27) {
        ResetCause::Power
    } else if has(25) {
        ResetCause::BrownOut
    } else {
        ResetCause::Pin
    }
}
