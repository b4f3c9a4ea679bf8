//! The drivers that all boards with an STM32F4 share. [`wiring`] defines what a board declares.
//!
//! No driver contains a pin or a clock; each reads them from the selected board's [`WIRING`]. The
//! drivers make no decisions about a robot.

#![expect(
    unsafe_code,
    reason = "the first instructions after reset are assembly"
)]

use control::time::Micros;
use embassy_stm32::{pac, uid};
use embassy_time::Instant;

pub mod can;
pub mod drives;
pub mod encoders;
pub mod executors;
pub mod flash;
#[cfg(feature = "bench")]
mod freeze;
pub mod gyro;
pub mod index;
pub mod iwdg;
pub mod meters;
pub mod outputs;
pub mod pin;
pub mod power;
#[cfg(feature = "self-test")]
pub mod probe;
pub mod program_flash;
mod safe_state;
pub mod serial;
pub mod tick;
pub mod wiring;

use self::can::Can;
use self::drives::Drives;
use self::encoders::Encoders;
use self::flash::ParameterFlash;
use self::gyro::Gyro;
use self::index::Indexes;
use self::iwdg::Watchdog;
use self::meters::Meters;
use self::outputs::Outputs;
use self::pin::{PORTS, Pin, Pull, Role, all_differ, outputs_by_port, ports_of};
use self::serial::Serial;
use self::tick::TickTimer;
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
        // Resets the ports; they are safe again in the next statements, a millisecond later.
        let _ = embassy_stm32::init(WIRING.clocks.config());
        for output in SAFE_OUTPUTS {
            output.become_a(Role::Output);
        }
        power::watch();
        #[cfg(feature = "bench")]
        freeze::in_debug_halt();

        // The HAL leaves the flash caches off. RM0390 3.4.2: at 5 wait states a jump without them
        // costs 5 cycles.
        pac::FLASH.acr().modify(|w| {
            w.set_prften(true);
            w.set_icen(true);
            w.set_dcen(true);
        });

        let outputs = Outputs::new();
        let encoders = Encoders::new();
        let indexes = Indexes::new();
        let lines = Lines::new();
        let node_switches = node_switches();
        power::program_brown_out();
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
            brown_out_level: power::brown_out_level(),
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
const SAFE_OUTPUTS: [Pin; if WIRING.inverse.is_some() { 15 } else { 11 }] = {
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

/// For the first instructions, in flash.
static OUTPUTS_BY_PORT: [u32; 2 * PORTS + 1] = outputs_by_port(&SAFE_OUTPUTS);

/// The first instructions after reset: PWM, directions, driver enable, brake release and LED become
/// outputs, which are low. Painting the stack and setting up the variables takes milliseconds on
/// the internal oscillator, waiting for clock and supply longer. In assembly, because there are no
/// variables yet.
#[unsafe(naked)]
#[unsafe(export_name = "__pre_init")]
extern "C" fn make_outputs_safe() {
    core::arch::naked_asm!(
        "ldr r0, ={ahb1enr}",
        "ldr r1, [r0]",
        "ldr r2, ={ports}",
        "orr r1, r1, r2",
        "str r1, [r0]",
        // RM0390 6.2.14: two cycles until the ports have their clock; this reads back.
        "ldr r1, [r0]",
        "ldr r0, ={outputs}",
        // MODER is the first register of a port: 01 is an output, which is low after reset. Most of
        // these pins are 00 then, but PB4 is 10.
        "1: ldr r1, [r0], #4",
        "cbz r1, 2f",
        "ldr r2, [r0], #4",
        "ldr r3, [r1]",
        "orr r3, r3, r2",
        "bic r3, r3, r2, lsl #1",
        "str r3, [r1]",
        "b 1b",
        "2: bx lr",
        ahb1enr = const 0x4002_3830_u32,
        ports = const ports_of(&SAFE_OUTPUTS),
        outputs = sym OUTPUTS_BY_PORT,
    )
}

/// FNV-1a over the 96 bits (wafer, lot, position): different chips give different numbers, but for
/// one pair in 4e9.
fn fold(uid: &[u8; 12]) -> u32 {
    uid.iter().fold(0x811C_9DC5, |hash: u32, byte| {
        (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193)
    })
}

/// Local time since start.
pub fn now() -> Micros {
    Micros(Instant::now().as_micros())
}

/// Resets the chip.
pub fn reset() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

/// Reads why the chip was reset (RCC_CSR, RM0390 6.3.21) and clears the flags. The pin flag is set
/// by every reset, the brown-out flag by power-on too, so the order matters.
fn reset_cause() -> ResetCause {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    if flags.wdgrstf() {
        ResetCause::Watchdog
    } else if flags.wwdgrstf() {
        ResetCause::WindowWatchdog
    } else if flags.lpwrrstf() {
        ResetCause::LowPower
    } else if flags.sftrstf() {
        ResetCause::Software
    } else if flags.porrstf() {
        ResetCause::Power
    } else if flags.borrstf() {
        ResetCause::BrownOut
    } else {
        ResetCause::Pin
    }
}
