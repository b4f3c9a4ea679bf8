//! The clocks of an STM32F4, which the HAL sets up.

use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllSource, Sysclk,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, pac};

use crate::board::WIRING;

/// Clocks: `hse_hz` / `divide_by` x `multiply_by` / 2 for the core, a quarter of that for APB1 and
/// half of it for APB2. Timers of a divided bus run at twice its clock.
pub struct Clocks {
    /// Frequency of the clock from outside.
    pub hse_hz: u32,
    /// Whether it is a clock already (bypass) or a crystal.
    pub hse_is_clock: bool,
    /// PLLM.
    pub divide_by: u8,
    /// PLLN.
    pub multiply_by: u16,
}

impl Clocks {
    /// The core's.
    pub const fn core_hz(&self) -> u32 {
        self.hse_hz / self.divide_by as u32 * self.multiply_by as u32 / 2
    }

    /// That of APB1 and its peripherals: CAN1, for one.
    pub const fn apb1_hz(&self) -> u32 {
        self.core_hz() / 4
    }

    /// That of the timers of APB1: TIM2 to TIM7.
    pub const fn apb1_timers_hz(&self) -> u32 {
        self.core_hz() / 2
    }

    /// That of APB2 and its peripherals: the converters.
    pub const fn apb2_hz(&self) -> u32 {
        self.core_hz() / 2
    }

    /// That of the timers of APB2: TIM1, TIM8 and TIM9.
    pub const fn apb2_timers_hz(&self) -> u32 {
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
        config.rcc.pll_src = PllSource::HSE;
        config.rcc.pll = Some(Pll {
            prediv: PllPreDiv::from_bits(self.divide_by),
            mul: PllMul::from_bits(self.multiply_by),
            divp: Some(PllPDiv::DIV2),
            divq: None,
            divr: None,
        });
        config.rcc.sys = Sysclk::PLL1_P;
        config.rcc.ahb_pre = AHBPrescaler::DIV1;
        config.rcc.apb1_pre = APBPrescaler::DIV4;
        config.rcc.apb2_pre = APBPrescaler::DIV2;
        config
    }
}

/// Starts them. Resets the ports and PWR: both are to be set up again in the next statements, a
/// millisecond later.
pub fn start() {
    let _ = embassy_stm32::init(WIRING.clocks.config());
    // The HAL leaves the flash caches off. RM0390 3.4.2: at 5 wait states a jump without them
    // costs 5 cycles.
    pac::FLASH.acr().modify(|w| {
        w.set_prften(true);
        w.set_icen(true);
        w.set_dcen(true);
    });
}

/// Whether the clock security system has found that HSE stands.
pub fn hse_has_stopped() -> bool {
    pac::RCC.cir().read().cssf()
}
