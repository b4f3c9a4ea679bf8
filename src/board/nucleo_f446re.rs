//! NUCLEO-F446RE (STM32F446RET6, LQFP64): clocks, pins, peripherals.
//!
//! | function | peripheral | pins |
//! |---|---|---|
//! | PWM front left, front right, rear left, rear right | TIM1 CH1..4 | PA8 PA9 PA10 PA11 |
//! | direction, same order; high rolls the base forward | GPIO | PC0 PC1 PC2 PC3 |
//! | encoders, same order; count up when the base rolls forward | TIM2 TIM3 TIM4 TIM5 | PA15/PB3 PC6/PC7 PB6/PB7 PA0/PA1 |
//! | encoder index, same order; a rising edge once a turn | EXTI lines 10 12 14 15 | PB10 PA12 PB14 PB15 |
//! | CAN | CAN1 | PB8 receive, PB9 transmit |
//! | driver enable, high is enabled | TIM8 CH2N | PB0 |
//! | holding brake, high is released | TIM8 CH3N | PB1 |
//! | emergency stop, normally closed to ground; high stops | TIM1 BKIN, TIM8 BKIN | PB12 and PA6, wired together |
//! | supply voltage, divided by 11 | ADC1 IN4 | PA4 |
//! | motor current, optional, up to three sensors | ADC1 IN7 IN14 IN15 | PA7 PC4 PC5 |
//! | driver fault, low is a fault | GPIO | PB13 |
//! | protective stop, normally closed to ground; high asks for standstill | GPIO | PC12 |
//! | node id switches, closed to ground is 1 | GPIO | PC8 (bit 0) PC9 PC10 PC11 |
//! | LED LD2 | GPIO | PA5 |
//! | user button | GPIO | PC13 |
//!
//! Sources: UM1724 rev 15 (board), RM0390 rev 6 (chip), DS10693 rev 10 (alternate functions).

#![expect(
    unsafe_code,
    reason = "the first instructions after reset are assembly"
)]

use control::time::Micros;
use embassy_stm32::adc::Adc;
use embassy_stm32::gpio::{Flex, Input, Level, Output, Pull, Speed};
use embassy_stm32::pac::adc::vals::SampleTime;
use embassy_stm32::pac::timer::vals::FilterValue;
use embassy_stm32::peripherals::{ADC1, TIM2, TIM3, TIM4, TIM5};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllSource, Sysclk,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::qei::{self, Qei};
use embassy_stm32::{Config, Peri, pac, uid};
use embassy_time::Instant;

use super::can::Can;
use super::executors;
use super::flash::ParameterFlash;
use super::index::Indexes;
use super::iwdg::Watchdog;
use super::outputs::{Outputs, Pins};
use super::power;
use super::tick::TickTimer;

/// Bit of port B that enables the motor drivers.
pub const DRIVER_ENABLE_PB: usize = 0;
/// Bit of port B that releases the holding brake.
pub const BRAKE_RELEASE_PB: usize = 1;
/// First of the four bits of port C that say which way the wheels turn.
pub const FIRST_DIRECTION_PC: usize = 0;

/// Filter of the encoder channels until there is a configuration, the same as its default.
const ENCODER_FILTER: u8 = 3;

/// Bit of port A with the LED.
pub const LED_PA: usize = 5;

/// Inputs that the control tick reads as levels.
pub struct Lines {
    /// Low when a motor driver reports a fault.
    pub driver_fault: Input<'static>,
    /// High when the protective stop is open.
    pub protective_stop: Input<'static>,
}

/// Everything the tasks use.
pub struct Board {
    /// CAN controller.
    pub can: Can,
    /// Motor outputs and brake.
    pub outputs: Outputs,
    /// Encoder counters.
    pub encoders: Encoders,
    /// Encoder index inputs.
    pub indexes: Indexes,
    /// Inputs whose level counts.
    pub lines: Lines,
    /// Supply voltage and motor current.
    pub meters: Meters,
    /// LED LD2.
    pub led: Output<'static>,
    /// Timer of the control tick.
    pub tick: TickTimer,
    /// Watchdog, running.
    pub watchdog: Watchdog,
    /// Where the parameters are.
    pub flash: ParameterFlash,
    /// Value of the four switches, 0..=15.
    pub node_switches: u8,
    /// How long the start waited for clock and supply, ms.
    pub clock_wait_ms: u16,
    /// Level of the brown-out reset, 0 (off) to 3.
    pub brown_out_level: u8,
    /// The chip's unique number, folded to 32 bits.
    pub serial: u32,
    /// Why the chip was reset.
    pub reset_cause: ResetCause,
}

/// Why the chip was reset (RCC_CSR, RM0390 6.3.21), with the numbers of the object "reset cause".
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
#[repr(u8)]
pub enum ResetCause {
    /// Power-on.
    Power = 0,
    /// The reset pin alone: button or debugger.
    Pin = 1,
    /// Reset by software.
    Software = 2,
    /// The independent watchdog: a task made no progress, or the program failed.
    Watchdog = 3,
    /// The window watchdog, which the firmware does not use.
    WindowWatchdog = 4,
    /// A low-power mode entered by mistake.
    LowPower = 5,
    /// The supply sagged.
    BrownOut = 6,
}

/// The four encoder counters.
pub struct Encoders {
    front_left: Qei<'static, TIM2>,
    front_right: Qei<'static, TIM3>,
    rear_left: Qei<'static, TIM4>,
    rear_right: Qei<'static, TIM5>,
}

impl Encoders {
    /// Sets the digital filter of all channels, 0 to 15: ICxF of RM0390 18.4.7, at the timers' 90
    /// MHz. The HAL leaves it off, and then every glitch of 11 ns is an edge.
    pub fn set_filter(&self, filter: u8) {
        let filter = FilterValue::from_bits(filter);
        for channels in [
            pac::TIM2.ccmr_input(0),
            pac::TIM3.ccmr_input(0),
            pac::TIM4.ccmr_input(0),
            pac::TIM5.ccmr_input(0),
        ] {
            channels.modify(|w| {
                w.set_icf(0, filter);
                w.set_icf(1, filter);
            });
        }
    }

    /// Returns the counts front left, front right, rear left, rear right; they wrap at 16 bits and
    /// go up when the wheel rolls the base forward.
    pub fn counts(&self) -> [u16; 4] {
        [
            self.front_left.count(),
            self.front_right.count(),
            self.rear_left.count(),
            self.rear_right.count(),
        ]
    }
}

/// The supply voltage, behind a divider, and the current sensors' outputs; the configuration knows
/// both.
///
/// ADC1 converts its four channels over and over, every 87.5 us, and nobody waits for it: reading
/// takes the last result. The sensors' are injected channels, which have result registers of their
/// own (RM0390 13.3.9, auto-injection).
pub struct Meters {
    /// Kept: it is switched off when dropped.
    _adc: Adc<'static, ADC1>,
}

impl Meters {
    /// The board's analog reference, V, and steps of the converter.
    const REFERENCE: f32 = 3.3;
    const STEPS: f32 = 4096.0;
    /// PA4 is ADC12_IN4 (DS10693 rev 10, table 10).
    const CHANNEL: u8 = 4;
    /// PA7, PC4 and PC5 are ADC12_IN7, IN14 and IN15 (the same table).
    const CURRENT_CHANNELS: [u8; 3] = [7, 14, 15];

    fn new(adc: Peri<'static, ADC1>, pins: [Flex<'static>; 4]) -> Self {
        for mut pin in pins {
            pin.set_as_analog();
            // Stays analog.
            core::mem::forget(pin);
        }
        let adc = Adc::new(adc);
        // The source has 9.1 kOhm. RM0390 13.5, DS10693 table 78: with 480 clocks of 22.5 MHz it
        // may have 500 kOhm.
        let [first, second, third] = Self::CURRENT_CHANNELS;
        pac::ADC1.smpr2().write(|w| {
            w.set_smp(Self::CHANNEL.into(), SampleTime::CYCLES480);
            w.set_smp(first.into(), SampleTime::CYCLES480);
        });
        pac::ADC1.smpr1().write(|w| {
            w.set_smp(usize::from(second) - 10, SampleTime::CYCLES480);
            w.set_smp(usize::from(third) - 10, SampleTime::CYCLES480);
        });
        pac::ADC1.sqr3().write(|w| w.set_sq(0, Self::CHANNEL));
        // RM0390 13.13.12: a sequence of three begins with JSQ2.
        pac::ADC1.jsqr().write(|w| {
            w.set_jl(2);
            w.set_jsq(1, first);
            w.set_jsq(2, second);
            w.set_jsq(3, third);
        });
        pac::ADC1.cr1().modify(|w| {
            w.set_scan(true);
            w.set_jauto(true);
        });
        pac::ADC1.cr2().modify(|w| w.set_cont(true));
        pac::ADC1.cr2().modify(|w| w.set_swstart(true));
        Self { _adc: adc }
    }

    /// Volts at the supply's pin at the last conversion.
    pub fn supply(&self) -> f32 {
        Self::volts(pac::ADC1.dr().read().data())
    }

    /// Volts at the current sensors' pins at their last conversions.
    pub fn currents(&self) -> [f32; 3] {
        [0, 1, 2].map(|n| Self::volts(pac::ADC1.jdr(n).read().jdata()))
    }

    fn volts(steps: u16) -> f32 {
        f32::from(steps) * (Self::REFERENCE / Self::STEPS)
    }
}

impl Board {
    /// Sets up clocks, pins and peripherals. Outputs are safe since the first instructions; the
    /// watchdog runs before clock and supply are waited for. To be called once.
    pub fn new() -> Self {
        let watchdog = Watchdog::start();
        let clock_wait_ms = power::wait();
        // Resets the ports; they are safe again in the next statements, a millisecond later.
        let p = embassy_stm32::init(clocks());
        let gate = [Flex::new(p.PB0), Flex::new(p.PB1)].map(|mut pin| {
            pin.set_low();
            pin.set_as_output(Speed::Low);
            pin
        });
        let direction = [
            Output::new(p.PC0, Level::High, Speed::Low),
            Output::new(p.PC1, Level::High, Speed::Low),
            Output::new(p.PC2, Level::High, Speed::Low),
            Output::new(p.PC3, Level::High, Speed::Low),
        ];
        power::watch();
        #[cfg(feature = "bench")]
        super::freeze::in_debug_halt();

        // The HAL leaves the flash caches off. RM0390 3.4.2: at 5 wait states a jump without them
        // costs 5 cycles.
        pac::FLASH.acr().modify(|w| {
            w.set_prften(true);
            w.set_icen(true);
            w.set_dcen(true);
        });

        let pwm = [
            Flex::new(p.PA8),
            Flex::new(p.PA9),
            Flex::new(p.PA10),
            Flex::new(p.PA11),
        ];
        let stop = [Flex::new(p.PB12), Flex::new(p.PA6)];
        let pins = Pins {
            pwm,
            stop,
            direction,
            gate,
        };
        let outputs = Outputs::new(p.TIM1, p.TIM8, pins);

        let encoder = qei::Config {
            ch1_pull: Pull::Up,
            ch2_pull: Pull::Up,
            ..qei::Config::default()
        };
        let encoders = Encoders {
            front_left: Qei::new(p.TIM2, p.PA15, p.PB3, encoder),
            front_right: Qei::new(p.TIM3, p.PC6, p.PC7, encoder),
            rear_left: Qei::new(p.TIM4, p.PB6, p.PB7, encoder),
            rear_right: Qei::new(p.TIM5, p.PA0, p.PA1, encoder),
        };

        encoders.set_filter(ENCODER_FILTER);

        let indexes = Indexes::new(p.PB10, p.PA12, p.PB14, p.PB15);

        let switches = [
            Input::new(p.PC8, Pull::Up),
            Input::new(p.PC9, Pull::Up),
            Input::new(p.PC10, Pull::Up),
            Input::new(p.PC11, Pull::Up),
        ];
        // The pull-ups are about 40 kOhm; 20 us charge 100 pF of wiring five times over.
        cortex_m::asm::delay(20 * 180);
        let node_switches = switches
            .iter()
            .rev()
            .fold(0, |value, switch| value << 1 | u8::from(switch.is_low()));

        let analog = [
            Flex::new(p.PA4),
            Flex::new(p.PA7),
            Flex::new(p.PC4),
            Flex::new(p.PC5),
        ];
        let lines = Lines {
            driver_fault: Input::new(p.PB13, Pull::Up),
            protective_stop: Input::new(p.PC12, Pull::Up),
        };
        let led = Output::new(p.PA5, Level::Low, Speed::Low);
        power::program_brown_out();
        executors::set_priorities();
        let can = Can::new(p.CAN1, p.PB8, p.PB9);

        Self {
            can,
            outputs,
            encoders,
            indexes,
            lines,
            meters: Meters::new(p.ADC1, analog),
            led,
            tick: TickTimer::new(p.TIM7),
            watchdog,
            flash: ParameterFlash::new(p.FLASH),
            node_switches,
            clock_wait_ms: u16::try_from(clock_wait_ms).unwrap_or(u16::MAX),
            brown_out_level: power::brown_out_level(),
            serial: fold(&uid::uid()),
            reset_cause: reset_cause(),
        }
    }
}

/// The first instructions after reset: PWM, driver enable and brake release become outputs, which
/// are low. Painting the stack and setting up the variables takes milliseconds on the internal
/// oscillator, waiting for clock and supply longer. In assembly, because there are no variables
/// yet.
#[unsafe(naked)]
#[unsafe(export_name = "__pre_init")]
extern "C" fn make_outputs_safe() {
    core::arch::naked_asm!(
        "ldr r0, ={ahb1enr}",
        "ldr r1, [r0]",
        "orr r1, r1, #{ports}",
        "str r1, [r0]",
        // RM0390 6.2.14: two cycles until the ports have their clock; this reads back.
        "ldr r1, [r0]",
        "ldr r0, ={gpioa}",
        "ldr r1, [r0]",
        "ldr r2, ={outputs_a}",
        "orr r1, r1, r2",
        "str r1, [r0]",
        "ldr r0, ={gpiob}",
        "ldr r1, [r0]",
        "ldr r2, ={outputs_b}",
        "orr r1, r1, r2",
        "str r1, [r0]",
        "bx lr",
        ahb1enr = const 0x4002_3830_u32,
        ports = const 3,
        // MODER is the first register of a port; what it sets is 0 after reset, and so are the
        // outputs.
        gpioa = const 0x4002_0000_u32,
        outputs_a = const outputs(&[LED_PA, 8, 9, 10, 11]),
        gpiob = const 0x4002_0400_u32,
        outputs_b = const outputs(&[DRIVER_ENABLE_PB, BRAKE_RELEASE_PB]),
    )
}

/// MODER with these pins as outputs.
const fn outputs(pins: &[usize]) -> u32 {
    let (mut word, mut at) = (0, 0);
    while at < pins.len() {
        word |= 1 << (2 * pins[at]);
        at += 1;
    }
    word
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

/// 180 MHz from the 8 MHz that the ST-LINK feeds into the HSE input: 8 / 4 x 180 / 2. APB1 45 MHz,
/// APB2 90 MHz.
fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(Hse {
        freq: Hertz(8_000_000),
        mode: HseMode::Bypass,
    });
    config.rcc.pll_src = PllSource::HSE;
    config.rcc.pll = Some(Pll {
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL180,
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

/// Reads why the chip was reset and clears the flags. The pin flag is set by every reset, the
/// brown-out flag by power-on too, so the order matters.
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
