//! The clocks of an STM32F1 (RM0008 rev 21, section 7). Twenty lines, where the HAL's set-up of all
//! that a chip may have takes some kilobytes.

use embassy_stm32::pac;
use embassy_stm32::pac::flash::vals::Latency;
use embassy_stm32::pac::rcc::vals::{Adcpre, Pllmul, Pllsrc, Ppre, Sw};

use crate::board::WIRING;

/// Clocks: `hse_hz` x `multiply_by` for the core and APB2, half of that for APB1, a sixth for the
/// converters. Timers run at the core's clock.
pub struct Clocks {
    /// Frequency of the clock from outside.
    pub hse_hz: u32,
    /// Whether it is a clock already (bypass) or a crystal.
    pub hse_is_clock: bool,
    /// PLLMUL, 2 to 16.
    pub multiply_by: u8,
}

impl Clocks {
    /// The core's.
    pub const fn core_hz(&self) -> u32 {
        let hz = self.hse_hz * self.multiply_by as u32;
        assert!(hz > 48_000_000 && hz <= 72_000_000, "two wait states");
        hz
    }

    /// That of APB1 and its peripherals: CAN, for one.
    pub const fn apb1_hz(&self) -> u32 {
        self.core_hz() / 2
    }

    /// That of the timers of APB1: TIM2 to TIM7.
    pub const fn apb1_timers_hz(&self) -> u32 {
        self.core_hz()
    }

    /// That of the timers of APB2: TIM1 and TIM8.
    pub const fn apb2_timers_hz(&self) -> u32 {
        self.core_hz()
    }

    /// Core cycles in a microsecond.
    pub const fn cycles_per_us(&self) -> u32 {
        self.core_hz() / 1_000_000
    }
}

/// Starts them, from HSE, which runs. Where the PLL does not lock the watchdog ends the wait. Then
/// the pins are given to their peripherals: in one word, because SWJ_CFG cannot be read back.
pub fn start() {
    const { assert!(WIRING.clocks.multiply_by >= 2 && WIRING.clocks.multiply_by <= 16) };
    pac::FLASH.acr().write(|w| {
        w.set_latency(Latency::WS2);
        w.set_prftbe(true);
    });
    let configure = |sw: Sw| {
        pac::RCC.cfgr().write(|w| {
            w.set_ppre1(Ppre::DIV2);
            w.set_adcpre(Adcpre::DIV6);
            w.set_pllsrc(Pllsrc::HSE_DIV_PREDIV);
            w.set_pllmul(Pllmul::from_bits(WIRING.clocks.multiply_by - 2));
            w.set_sw(sw);
        });
    };
    configure(Sw::HSI);
    pac::RCC.cr().modify(|w| w.set_pllon(true));
    while !pac::RCC.cr().read().pllrdy() {}
    configure(Sw::PLL1_P);
    while pac::RCC.cfgr().read().sws() != Sw::PLL1_P {}
    pac::RCC.apb2enr().modify(|w| {
        w.set_afioen(true);
        // GPIOA to GPIOE, bits 2 to 6.
        w.0 |= 0b111_1100;
    });
    pac::AFIO.mapr().write(|w| w.0 = WIRING.remap);
    super::time::start();
}

/// Whether the clock security system has found that HSE stands.
pub fn hse_has_stopped() -> bool {
    pac::RCC.cir().read().cssf()
}
