//! The drivers that all boards share: for STM32 chips with bxCAN and the timers TIM1 to TIM8.
//! [`wiring`] defines what a board declares.
//!
//! No driver contains a pin or a clock; each reads them from the selected board's [`WIRING`]. What
//! differs between two families of chips is in [`family`](super::family): the registers of pins,
//! clocks, flash, supply and converter, names of interrupts, the local time. The drivers make no
//! decisions about a robot.

use control::time::Micros;
use embassy_stm32::{pac, uid};

pub mod can;
pub mod encoders;
pub mod executors;
pub mod index;
pub mod iwdg;
pub mod outputs;
#[cfg_attr(stm32f1, expect(dead_code, reason = "AFIO assigns pins there"))]
pub mod pin;
pub mod power;
mod safe_state;
pub mod tick;
#[cfg_attr(
    stm32f1,
    expect(dead_code, reason = "no smart drives, cable or gyro there")
)]
pub mod wiring;

use self::can::Can;
use self::encoders::Encoders;
use self::index::Indexes;
use self::iwdg::Watchdog;
use self::outputs::Outputs;
use self::pin::{Pin, Pull, Role, all_differ};
use self::tick::TickTimer;
use super::family::drives::Drives;
use super::family::flash::ParameterFlash;
use super::family::gyro::Gyro;
use super::family::meters::Meters;
use super::family::serial::Serial;
use super::family::{clocks, supply};
use super::{ResetCause, WIRING};

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
    /// Kinds of bridges that the outputs can drive.
    pub output_stages: u8,
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

/// The LED.
pub struct Led(());

impl Led {
    /// Switches it on or off.
    pub fn set(&mut self, on: bool) {
        WIRING.led.set(on);
    }
}

impl Board {
    /// Sets up clocks, pins and peripherals. Outputs are safe since the first instructions; the
    /// watchdog runs before clock and supply are waited for. To be called once.
    pub fn new() -> Self {
        let watchdog = Watchdog::start();
        let clock_wait_ms = power::wait();
        clocks::start();
        for output in SAFE_OUTPUTS {
            output.become_a(Role::Output);
        }
        power::watch();
        #[cfg(feature = "bench")]
        super::family::freeze::in_debug_halt();

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
            clock_wait_ms: u16::try_from(clock_wait_ms).unwrap_or(u16::MAX),
            output_stages: outputs::STAGES,
            brown_out_level: supply::brown_out_level(),
            serial: fold(&uid::uid()),
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

/// Outputs that are low from the first instructions on.
pub const SAFE_OUTPUTS: [Pin; if WIRING.inverse.is_some() { 15 } else { 11 }] = {
    let mut outputs = [WIRING.led; _];
    outputs[1] = WIRING.driver_enable;
    outputs[2] = WIRING.brake_release;
    let second = match (WIRING.second_pwm, WIRING.direction) {
        (Some(second), None) | (None, Some(second)) => second,
        _ => panic!("a wheel has a direction or a second PWM"),
    };
    let mut at = 0;
    while at < 4 {
        outputs[3 + at] = WIRING.pwm[at];
        outputs[7 + at] = second[at];
        if let Some(inverse) = WIRING.inverse {
            outputs[11 + at] = inverse[at];
        }
        at += 1;
    }
    assert!(all_differ(&outputs), "a pin has two functions");
    outputs
};

/// FNV-1a over the 96 bits (wafer, lot, position): different chips give different numbers, but for
/// one pair in 4e9.
fn fold(uid: &[u8; 12]) -> u32 {
    uid.iter().fold(0x811C_9DC5, |hash: u32, byte| {
        (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193)
    })
}

/// Local time since start.
pub fn now() -> Micros {
    Micros(super::family::time::now_us())
}

/// Resets the chip.
pub fn reset() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
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
