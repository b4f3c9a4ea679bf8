//! The drivers that all boards share: for STM32 chips with bxCAN and the timers TIM1 to TIM8.
//! [`wiring`] defines what a board declares.
//!
//! No driver contains a pin or a clock; each reads them from the selected board's [`WIRING`]. What
//! differs between two families of chips is in [`family`](super::family): the registers of pins,
//! clocks, flash, supply and converter, names of interrupts, the local time. The drivers make no
//! decisions about a robot. A board whose drivers are not all written is a `sketch` until they are.

use control::time::Micros;
use embassy_stm32::{pac, uid};

#[cfg(not(feature = "sketch"))]
mod board;
#[cfg(not(feature = "sketch"))]
pub mod can;
#[cfg(not(feature = "sketch"))]
pub mod encoders;
#[cfg(not(feature = "sketch"))]
pub mod executors;
#[cfg(not(feature = "sketch"))]
pub mod index;
pub mod iwdg;
#[cfg(any(stm32f4, stm32g4))]
pub mod moder;
#[cfg(not(feature = "sketch"))]
pub mod outputs;
#[cfg_attr(stm32f1, expect(dead_code, reason = "AFIO assigns pins there"))]
pub mod pin;
pub mod power;
pub mod safe_state;
#[cfg(feature = "sketch")]
pub mod sketch;
#[cfg(not(feature = "sketch"))]
pub mod tick;
#[cfg_attr(
    stm32f1,
    expect(dead_code, reason = "no smart drives, cable or gyro there")
)]
pub mod wiring;

#[cfg(not(feature = "sketch"))]
pub use self::board::{Board, Lines};

use self::iwdg::Watchdog;
use self::pin::{Pin, Role, all_differ};
use super::WIRING;
use super::family::clocks;

/// The LED.
pub struct Led(());

impl Led {
    /// Switches it on or off.
    pub fn set(&mut self, on: bool) {
        WIRING.led.set(on);
    }
}

/// What every image has first.
struct Begun {
    /// Watchdog, running.
    watchdog: Watchdog,
    /// How long the start waited for clock and supply, ms.
    clock_wait_ms: u16,
}

/// Starts watchdog, clocks and the watch over clock and supply. Outputs are safe since the first
/// instructions; the watchdog runs before clock and supply are waited for.
fn begin() -> Begun {
    let watchdog = Watchdog::start();
    let clock_wait_ms = power::wait();
    clocks::start();
    for output in SAFE_OUTPUTS {
        output.become_a(Role::Output);
    }
    power::watch();
    Begun {
        watchdog,
        clock_wait_ms: u16::try_from(clock_wait_ms).unwrap_or(u16::MAX),
    }
}

/// Outputs that are low from the first instructions on.
pub const SAFE_OUTPUTS: [Pin; match (WIRING.pwm, WIRING.inverse) {
    (None, _) => 3,
    (Some(_), None) => 11,
    (Some(_), Some(_)) => 15,
}] = {
    let mut outputs = [WIRING.led; _];
    outputs[1] = WIRING.driver_enable;
    outputs[2] = WIRING.brake_release;
    let second = match (WIRING.pwm, WIRING.second_pwm, WIRING.direction) {
        (Some(_), Some(second), None) | (Some(_), None, Some(second)) => Some(second),
        (None, None, None) => None,
        _ => panic!("a wheel with PWM has a direction or a second PWM"),
    };
    let groups = [WIRING.pwm, second, WIRING.inverse];
    let mut at = 3;
    while at < outputs.len() {
        if let Some(pins) = groups[(at - 3) / 4] {
            outputs[at] = pins[(at - 3) % 4];
        }
        at += 1;
    }
    assert!(all_differ(&outputs), "a pin has two functions");
    outputs
};

/// The chip's unique number, folded to 32 bits.
fn serial() -> u32 {
    fold(&uid::uid())
}

/// FNV-1a over the 96 bits (wafer, lot, position): different chips give different numbers, but for
/// one pair in 4e9.
fn fold(uid: &[u8; 12]) -> u32 {
    uid.iter().fold(0x811C_9DC5, |hash: u32, byte| {
        (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193)
    })
}

/// The chip's device number, and its revision from bit 16 on (RM0390 33.6.1, RM0090 38.6.1, RM0008
/// 31.6.1). An STM32F103 of some revisions tells its program nothing without a debugger: 0.
pub fn chip() -> u32 {
    pac::DBGMCU.idcode().read().0
}

/// Local time since start.
pub fn now() -> Micros {
    Micros(super::family::time::now_us())
}

/// Resets the chip.
pub fn reset() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}
