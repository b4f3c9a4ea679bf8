//! The chip around the core: all peripherals of one board, how they are reached, and what connects
//! them.
//!
//! An access has an address and returns a value or a reason to stop. After each write the interrupt
//! lines and the time of the next event are recomputed; this is cheap compared with the instruction
//! that wrote, and no change can be missed.

mod bus;
mod events;
mod pins;
mod places;
mod spi;
mod wires;
mod world;

use std::sync::Arc;

use rsemu::core::space::RamStore;

use self::places::Places;
use crate::bmi088::Bmi088;
use crate::board::BoardConfig;
use crate::can::Can;
use crate::chip::Chip;
use crate::clock::Clock;
use crate::defect::{Defect, Defects};
use crate::family::Family;
use crate::ram::Ram;
use crate::stop::StopKind;
use crate::system::adc::Adc;
use crate::system::afio::Afio;
use crate::system::crc::Crc;
use crate::system::dma::Dma;
use crate::system::exti::Exti;
use crate::system::flash::Flash;
use crate::system::gpio::{Gpio, Mode, Port};
use crate::system::iwdg::Iwdg;
use crate::system::map::{Entry, Unit};
use crate::system::pwr::Pwr;
use crate::system::rcc::{Rcc, cause};
use crate::system::spi::Spi;
use crate::system::usart::Usart;
use crate::timer::Timer;
use crate::trace::Trace;

/// First address of the debug unit's registers (RM0390 section 33.16): IDCODE, CR, two freeze
/// registers.
pub(crate) const DBGMCU: u32 = 0xE004_2000;

/// Offset of the filters' registers in CAN1 (RM0390 section 30.9.5).
const FILTERS: u32 = 0x200;

/// Interrupt lines as a bitmap.
pub(crate) type IrqLines = [u32; 4];

/// All peripherals.
#[derive(Debug, Clone)]
pub(crate) struct Soc {
    pub(crate) chip: &'static Chip,
    pub(crate) now: u64,
    pub(crate) clock: Clock,
    pub(crate) rcc: Rcc,
    pwr: Pwr,
    pub(crate) flash: Flash,
    places: Places,
    /// Counts what may give a pin to another signal or stop a timer's clock.
    wiring: u64,
    gpio: [Gpio; Port::ALL.len()],
    exti: Exti,
    afio: Afio,
    iwdg: Iwdg,
    /// ADC1 to ADC3.
    adcs: [Adc; 3],
    /// TIM1..TIM14 at their numbers; index 0 is never addressed.
    timers: [Timer; 15],
    pub(crate) can: Can,
    /// Its filters are `can`'s.
    pub(crate) can2: Can,
    pub(crate) usart2: Usart,
    spi1: Spi,
    /// The gyro on it, and its chip select.
    gyro: Option<(Bmi088, (Port, u8))>,
    dma1: Dma,
    crc: Crc,
    /// What the DMA reads and writes.
    ram: Arc<Ram>,
    dbgmcu: [u32; 4],
    pub(crate) irq: IrqLines,
    pub(crate) next_event: u64,
    pub(crate) stop: Option<StopKind>,
    wires: wires::Wires,
    /// The frame that is on the bus of CAN1.
    on_the_bus: Option<bus::OnTheBus>,
    defects: Defects,
    /// Record of the outputs, while one is made.
    pub(crate) trace: Option<Box<Trace>>,
    /// A reset that a peripheral asks for, as bits of RCC_CSR.
    pub(crate) reset_request: u32,
}

fn on_apb2(timer: usize) -> bool {
    matches!(timer, 1 | 8..=11)
}

impl Soc {
    pub(crate) fn new(
        chip: &'static Chip,
        array: Arc<RamStore>,
        ram: Arc<Ram>,
        config: &BoardConfig,
    ) -> Self {
        let defects = Defects::new(&config.defects);
        let mut flash = Flash::new(chip, array);
        flash.set_options(config.option_bytes);
        flash.set_factors(defects.flash_factor(), defects.program_factor());
        let mut adcs = [1, 2, 3].map(|number| Adc::new(chip.family, number));
        adcs[0].set_internal_reference(defects.reference());
        let mut pwr = Pwr::new(&chip.power);
        if defects.has(Defect::OverDrive) {
            pwr.lose_over_drive();
        }
        let mut can = match chip.family {
            Family::F1 => Can::with_banks(14),
            Family::F4 => Can::default(),
        };
        if defects.has(Defect::ErrorCounter) {
            can.stop_error_counter();
        }
        Self {
            chip,
            now: 0,
            clock: Clock::new(config.crystal_ppm, chip.clocks.hsi_hz),
            rcc: Rcc::new(&chip.clocks, config.hse_hz),
            pwr,
            flash,
            places: Places::new(chip),
            wiring: 0,
            gpio: Port::ALL.map(|port| Gpio::new(chip.family, port)),
            exti: Exti::default(),
            afio: Afio::default(),
            iwdg: Iwdg::new(config.lsi_hz),
            adcs,
            timers: std::array::from_fn(|number| {
                let mut timer = Timer::new(events::timer_kind(chip.family, number));
                if defects.has(Defect::InputFilters) {
                    timer.remove_filters();
                }
                timer
            }),
            can,
            can2: Can::default(),
            usart2: Usart::new(),
            spi1: Spi::default(),
            gyro: None,
            dma1: Dma::default(),
            crc: Crc::default(),
            ram,
            dbgmcu: [defects.id_code(chip.id_code), 0, 0, 0],
            irq: [0; 4],
            next_event: u64::MAX,
            stop: None,
            wires: wires::Wires::default(),
            on_the_bus: None,
            defects,
            trace: None,
            reset_request: 0,
        }
    }

    /// The same peripherals with other memory.
    pub(crate) fn with_memory(&self, array: &Arc<RamStore>, ram: &Arc<Ram>) -> Self {
        let mut copy = self.clone();
        copy.flash.set_array(Arc::clone(array));
        copy.ram = Arc::clone(ram);
        copy
    }

    /// A system reset, for a reason given as bits of RCC_CSR.
    pub(crate) fn system_reset(&mut self, causes: u32) {
        let now = self.now;
        self.rcc.reset(causes | cause::PIN);
        self.pwr.reset();
        self.flash.reset();
        self.gpio.iter_mut().for_each(Gpio::reset);
        self.exti.reset();
        self.exti.reset_syscfg();
        self.afio = Afio::default();
        self.iwdg.reset();
        self.adcs.iter_mut().for_each(Adc::reset);
        self.timers.iter_mut().for_each(|timer| timer.reset(now));
        self.can.reset();
        self.can2.reset();
        self.usart2.reset();
        self.spi1.reset();
        self.dma1.reset();
        self.crc.reset();
        self.reset_request = 0;
        self.wiring += 1;
        self.apply_clocks();
        self.settle();
    }

    fn now_ps(&self) -> u64 {
        self.clock.local_ps(self.now)
    }

    /// Reads `width` bytes.
    pub(crate) fn read(&mut self, address: u32, width: u32) -> u32 {
        let shift = 8 * (address & 3);
        let mask = if width >= 4 {
            u32::MAX
        } else {
            (1 << (8 * width)) - 1
        };
        let aligned = address & !3;
        if aligned & !0x3FF == DBGMCU {
            return (self
                .dbgmcu
                .get((aligned & 0x3FF) as usize / 4)
                .copied()
                .unwrap_or(0)
                >> shift)
                & mask;
        }
        let Some(entry) = self.places.peripheral(self.chip, aligned) else {
            return self.unmodelled("nothing (reserved address)".to_owned(), address, None);
        };
        if let Some(value) = self.unclocked(entry, address, None) {
            return value;
        }
        let offset = aligned - entry.base;
        match self.read_word(entry.unit, offset) {
            Ok(word) => (word >> shift) & mask,
            Err(what) => self.unmodelled(self.describe(entry, offset, what), address, None),
        }
    }

    /// Writes the low `width` bytes of `value`.
    pub(crate) fn write(&mut self, address: u32, width: u32, value: u32) {
        let aligned = address & !3;
        if aligned & !0x3FF == DBGMCU {
            if let Some(register) = self
                .dbgmcu
                .get_mut((aligned & 0x3FF) as usize / 4)
                .filter(|_| aligned & 0x3FF != 0)
            {
                *register = value;
            }
            return;
        }
        let Some(entry) = self.places.peripheral(self.chip, aligned) else {
            self.unmodelled(
                "nothing (reserved address)".to_owned(),
                address,
                Some(value),
            );
            return;
        };
        if self.unclocked(entry, address, Some(value)).is_some() {
            return;
        }
        let offset = aligned - entry.base;
        let word = match width {
            4.. => Ok(value),
            // Section 2.2.1: the APB bridges copy narrow data to the whole word.
            1 if !on_ahb(entry) => Ok((value & 0xFF) * 0x0101_0101),
            2 if !on_ahb(entry) => Ok((value & 0xFFFF) * 0x0001_0001),
            _ => {
                let shift = 8 * (address & 3);
                let mask = ((1 << (8 * width)) - 1) << shift;
                // A set/reset register has no state in its other bytes.
                let keep = matches!(entry.unit, Unit::Gpio(_)) && offset == 0x18;
                let old = if keep {
                    Ok(0)
                } else {
                    self.read_word(entry.unit, offset)
                };
                old.map(|old| (old & !mask) | (value << shift & mask))
            }
        };
        if let Err(what) = word.and_then(|word| self.write_word(entry.unit, offset, word)) {
            self.unmodelled(self.describe(entry, offset, what), address, Some(value));
        }
        if matches!(entry.unit, Unit::Gpio(_) | Unit::Afio | Unit::Rcc) {
            self.wiring += 1;
        }
        self.follow_wires(None);
        self.settle();
    }

    fn unmodelled(&mut self, what: String, address: u32, written: Option<u32>) -> u32 {
        self.stop.get_or_insert(StopKind::Unmodelled {
            what,
            address,
            written,
        });
        0
    }

    /// Records an access to a peripheral that has no clock or is in reset.
    fn unclocked(&mut self, entry: &Entry, address: u32, written: Option<u32>) -> Option<u32> {
        if entry.unit == Unit::Other
            || (self.rcc.enabled(entry.gate) && !self.rcc.in_reset(entry.gate))
        {
            return None;
        }
        let what = self.describe(entry, (address & !3) - entry.base, "");
        self.stop.get_or_insert(StopKind::Unclocked {
            what,
            address,
            written,
        });
        Some(0)
    }

    /// A register by its name.
    fn describe(&self, entry: &Entry, offset: u32, what: &str) -> String {
        let register = match entry.unit {
            Unit::Timer(_) => Timer::register_name(offset),
            Unit::Gpio(port) => self.gpio[port as usize].register_name(offset),
            Unit::Can1 | Unit::Can2 => Can::register_name(offset),
            Unit::Rcc => self.rcc.register_name(offset),
            Unit::Usart2 => Usart::register_name(offset),
            Unit::Spi1 => Spi::register_name(offset),
            Unit::Dma1 => Dma::register_name(offset),
            Unit::Crc => Crc::register_name(offset),
            Unit::Flash => self.flash.register_name(offset),
            _ => "",
        };
        let register = match register {
            "" => format!("+{offset:#x}"),
            name => name.to_owned(),
        };
        if what.is_empty() {
            format!("{}_{register}", entry.name)
        } else {
            format!("{}_{register}: {what}", entry.name)
        }
    }

    fn read_word(&mut self, unit: Unit, offset: u32) -> Result<u32, &'static str> {
        let now = self.now;
        match unit {
            Unit::Timer(number) => self.timers[number]
                .read(now, offset)
                .map_err(|error| error.0),
            Unit::Gpio(port) => {
                let idr = match self.chip.family {
                    Family::F1 => 0x08,
                    Family::F4 => 0x10,
                };
                if offset == idr {
                    self.follow_wires(Some(port));
                }
                let levels = self.gpio[port as usize].read(offset).ok_or("")?;
                Ok(if offset == idr {
                    self.with_the_bus(port, levels)
                } else {
                    levels
                })
            }
            Unit::Can1 => self.can.read(now, offset).ok_or(""),
            Unit::Can2 if offset < FILTERS => self.can2.read(now, offset).ok_or(""),
            Unit::Can2 => Err("the filters are CAN1's"),
            Unit::Usart2 => {
                let word = self.usart2.read(offset).ok_or("")?;
                // Reading the data register clears flags, and with them a request.
                self.settle();
                Ok(word)
            }
            Unit::Spi1 => self.read_spi(offset).ok_or(""),
            Unit::Dma1 => self.dma1.read(offset).ok_or(""),
            Unit::Crc => self.crc.read(offset).ok_or(""),
            Unit::Rcc => {
                self.apply_clocks();
                self.rcc.read(self.now_ps(), offset).ok_or("")
            }
            Unit::Pwr => self.pwr.read(self.now_ps(), offset).ok_or(""),
            Unit::Flash => self.flash.read(self.now_ps(), offset).ok_or(""),
            Unit::Exti => self.exti.read(offset).ok_or(""),
            Unit::Syscfg => self.exti.read_syscfg(offset).ok_or(""),
            Unit::Afio if (8..=0x14).contains(&offset) => self.exti.read_syscfg(offset).ok_or(""),
            Unit::Afio => self.afio.read(offset).ok_or(""),
            Unit::Iwdg => self.iwdg.read(self.now_ps(), offset).ok_or(""),
            Unit::Adc(number) => {
                let adc = &self.adcs[number - 1];
                let analog = adc
                    .pin(offset)
                    .is_some_and(|(port, pin)| self.gpio[port as usize].mode(pin) == Mode::Analog);
                adc.read(self.now_ps(), offset, analog).ok_or("")
            }
            Unit::AdcCommon => self.adcs[0].read_common(offset).ok_or(""),
            Unit::Other => Err(""),
        }
    }

    fn write_word(&mut self, unit: Unit, offset: u32, value: u32) -> Result<(), &'static str> {
        let now = self.now;
        match unit {
            Unit::Timer(number) => self.timers[number]
                .write(now, offset, value)
                .map_err(|error| error.0),
            Unit::Gpio(port) => {
                let before = self.gpio[port as usize].idr();
                self.gpio[port as usize].write(offset, value).ok_or("")?;
                self.select_gyro();
                self.pins_changed(port, before);
                if self.gpio[port as usize].connects(offset) {
                    (0..16).for_each(|pin| self.timer_input(port, pin));
                }
                Ok(())
            }
            Unit::Can1 => self.can.write(now, offset, value).ok_or(""),
            Unit::Can2 if offset < FILTERS => self.can2.write(now, offset, value).ok_or(""),
            Unit::Can2 => Err("the filters are CAN1's"),
            Unit::Usart2 => {
                self.usart2.write(now, offset, value)?;
                self.serve_usart();
                Ok(())
            }
            Unit::Spi1 => self.write_spi(offset, value),
            Unit::Dma1 => {
                self.dma1.write(offset, value)?;
                self.serve_usart();
                Ok(())
            }
            Unit::Rcc => {
                self.rcc
                    .write(self.now_ps(), offset, value, self.pwr.backup_access())
                    .ok_or("")?;
                if self.rcc.resets(offset) {
                    self.apply_resets();
                }
                self.apply_clocks();
                Ok(())
            }
            Unit::Pwr => {
                let before = self.pwr.is_low();
                self.pwr.write(self.now_ps(), offset, value).ok_or("")?;
                self.detected(before);
                Ok(())
            }
            Unit::Flash => {
                self.flash.write(self.now_ps(), offset, value).ok_or("")?;
                self.check_power();
                self.check_clocks();
                Ok(())
            }
            Unit::Exti => self.exti.write(offset, value).ok_or(""),
            Unit::Syscfg => self.exti.write_syscfg(offset, value).ok_or("memory remap"),
            Unit::Afio if (8..=0x14).contains(&offset) => {
                self.exti.write_syscfg(offset, value).ok_or("")
            }
            Unit::Afio => {
                self.afio.write(offset, value).ok_or("")?;
                self.remapped();
                Ok(())
            }
            Unit::Crc => self.crc.write(offset, value).ok_or(""),
            Unit::Iwdg => self.iwdg.write(self.now_ps(), offset, value).ok_or(""),
            Unit::Adc(number) => self.adcs[number - 1].write(self.now_ps(), offset, value),
            Unit::AdcCommon => {
                let mut adcs = self.adcs.iter_mut();
                adcs.try_for_each(|adc| adc.write_common(offset, value))
            }
            Unit::Other => Err(""),
        }
    }

    /// A store to the flash array; false for a bus error.
    pub(crate) fn program_flash(&mut self, offset: u64, data: &[u8]) -> bool {
        let now_ps = self.now_ps();
        let accepted = self.flash.program(now_ps, offset, data);
        self.check_power();
        self.settle();
        accepted
    }

    /// Stops when the power has failed in a flash operation.
    fn check_power(&mut self) {
        if self.flash.power_is_cut() {
            self.stop.get_or_insert(StopKind::PowerCut);
        }
    }

    /// Resets what RCC holds in reset.
    fn apply_resets(&mut self) {
        for entry in self.chip.all_peripherals() {
            if !self.rcc.in_reset(entry.gate) {
                continue;
            }
            match entry.unit {
                Unit::Timer(number) => self.timers[number].reset(self.now),
                Unit::Gpio(port) => {
                    let before = self.gpio[port as usize].idr();
                    self.gpio[port as usize].reset();
                    self.pins_changed(port, before);
                }
                Unit::Can1 => self.can.reset(),
                Unit::Can2 => self.can2.reset(),
                Unit::Usart2 => self.usart2.reset(),
                Unit::Spi1 => self.spi1.reset(),
                Unit::Dma1 => self.dma1.reset(),
                Unit::Crc => self.crc.reset(),
                Unit::Pwr => self.pwr.reset(),
                Unit::Adc(number) => self.adcs[number - 1].reset(),
                Unit::Syscfg => self.exti.reset_syscfg(),
                Unit::Afio => {
                    self.exti.reset_syscfg();
                    self.afio = Afio::default();
                    self.remapped();
                }
                _ => {}
            }
        }
    }

    /// Applies the clock tree that RCC now describes.
    fn apply_clocks(&mut self) {
        let clocks = self.rcc.clocks(self.now_ps());
        let hclk = clocks.hclk.max(1);
        for (number, timer) in self.timers.iter_mut().enumerate() {
            let clock = if on_apb2(number) {
                clocks.timer2
            } else {
                clocks.timer1
            };
            timer.set_ratio(self.now, hclk / clock.max(1) * self.defects.divider(number));
        }
        self.can.set_ratio(hclk / clocks.pclk1.max(1));
        self.can2.set_ratio(hclk / clocks.pclk1.max(1));
        self.usart2.set_ratio(hclk / clocks.pclk1.max(1));
        self.spi1.set_ratio(hclk / clocks.pclk2.max(1));
        for adc in &mut self.adcs {
            adc.set_clock(self.rcc.adc_source(clocks.pclk2));
        }
        if hclk != self.clock.hz() {
            self.clock.set_hz(self.now, hclk);
            self.check_clocks();
        }
    }

    /// Stops when the chip is clocked outside the limits of the manual.
    fn check_clocks(&mut self) {
        let now_ps = self.now_ps();
        let clocks = self.rcc.clocks(now_ps);
        let fault = self.rcc.pll_fault(now_ps).or_else(|| {
            [
                (
                    clocks.hclk,
                    self.flash.max_hclk(self.pwr.vdd()),
                    "HCLK with these flash wait states and this VDD",
                ),
                (
                    clocks.hclk,
                    self.pwr.max_hclk(now_ps),
                    "HCLK with this voltage scale",
                ),
                (clocks.pclk1, self.chip.clocks.apb1_hz, "APB1"),
                (clocks.pclk2, self.chip.clocks.apb2_hz, "APB2"),
            ]
            .into_iter()
            .find(|(is, max, _)| is > max)
            .map(|(is, max, what)| {
                let Chip { name, manual, .. } = self.chip;
                format!("{what}: {is} Hz, at most {max} Hz on an {name} ({manual})")
            })
        });
        if let Some(fault) = fault {
            self.stop.get_or_insert(StopKind::Clock(fault));
        }
    }
}

fn on_ahb(entry: &Entry) -> bool {
    entry.base >= 0x4002_0000
}
