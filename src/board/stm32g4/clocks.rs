//! The clocks of an STM32G4, which the HAL sets up.

use embassy_stm32::rcc::{Hse, HseMode, Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, pac};

use crate::board::WIRING;

/// Clocks: `hse_hz` / `divide_by` x `multiply_by` / 2 for the core and all buses and timers.
pub struct Clocks {
    /// Frequency of the clock from outside.
    pub hse_hz: u32,
    /// Whether it is a clock already (bypass) or a crystal.
    pub hse_is_clock: bool,
    /// PLLM.
    pub divide_by: u8,
    /// PLLN.
    pub multiply_by: u8,
}

impl Clocks {
    /// The core's, which the PLL and the voltage (range 1 with boost) permit.
    pub const fn core_hz(&self) -> u32 {
        let input_hz = self.hse_hz / self.divide_by as u32;
        assert!(
            input_hz * self.divide_by as u32 == self.hse_hz
                && input_hz >= 2_660_000
                && input_hz <= 16_000_000,
            "no clock for the PLL"
        );
        let hz = input_hz * self.multiply_by as u32 / 2;
        assert!(hz > 150_000_000 && hz <= 170_000_000, "boost is for these");
        hz
    }

    /// That of APB1, and so of FDCAN.
    pub const fn apb1_hz(&self) -> u32 {
        self.core_hz()
    }

    /// Core cycles in a microsecond.
    pub const fn cycles_per_us(&self) -> u32 {
        self.core_hz() / 1_000_000
    }

    /// The same for the HAL.
    fn config(&self) -> Config {
        let mut config = Config::default();
        config.rcc.hse = Some(Hse {
            freq: Hertz(self.hse_hz),
            mode: if self.hse_is_clock {
                HseMode::Bypass
            } else {
                HseMode::Oscillator
            },
        });
        config.rcc.hsi48 = None;
        config.rcc.pll = Some(Pll {
            source: PllSource::HSE,
            prediv: PllPreDiv::from_bits(self.divide_by - 1),
            mul: PllMul::from_bits(self.multiply_by),
            divp: None,
            divq: None,
            divr: Some(PllRDiv::DIV2),
        });
        config.rcc.sys = Sysclk::PLL1_R;
        config.rcc.boost = true;
        config
    }
}

/// Starts them. Resets the ports and PWR: both are to be set up again in the next statements. Also
/// takes the pull-downs of USB-C away, which PB4 and PB6 have after reset.
pub fn start() {
    const {
        assert!(
            WIRING.clocks.apb1_hz().is_multiple_of(1_000_000),
            "the clock of APB1 gives no 1 Mbit/s"
        );
    }
    let _ = embassy_stm32::init(WIRING.clocks.config());
    pac::FLASH.acr().modify(|w| {
        w.set_prften(true);
        w.set_icen(true);
        w.set_dcen(true);
    });
}

/// Whether the clock security system has found that HSE stands.
pub fn hse_has_stopped() -> bool {
    pac::RCC.cifr().read().cssf()
}
