//! A BMI088's gyro on SPI1 (RM0090 rev 19, section 28): 16 bits a word, mode 0, at a sixteenth of
//! APB2's clock, which is 5.25 MHz with 84; the sensor takes up to 10 (data sheet
//! BST-BMI088-DS001-13, table 6).
//!
//! # Theory of operation
//!
//! No word is waited for: [`Gyro::ask`] sends one at the end of a control tick, and [`Gyro::read`]
//! takes the answer at the beginning of the next, long after its three microseconds. Which words,
//! [`Reader`] says. There is no interrupt and no DMA.
//!
//! # Interface
//!
//! The control task calls both in every tick, on a board that has a gyro.
//!
//! # Limits
//!
//! The data-ready pin is not used: the sensor's samples are read by the tick's clock, so one in
//! some hundreds is read twice or not at all.

use control::gyro::Reading;
use control::gyro::bmi088::Reader;
use embassy_stm32::pac;
use embassy_stm32::pac::spi::Spi;
use embassy_stm32::pac::spi::vals::{Br, Dff, Mstr};

use crate::board::WIRING;
use crate::board::stm32::pin::{Pull, Role, Speed};

const PORT: Spi = pac::SPI1;

/// The gyro.
pub struct Gyro {
    reader: Reader,
}

impl Gyro {
    /// Sets up pins and port. The sensor is first spoken to when it has started.
    pub fn new() -> Self {
        if let Some(pins) = WIRING.gyro {
            // DS8626 rev 9, table 9: SPI1 is alternate function 5.
            const SPI1_AF: u8 = 5;
            // The sensor's other half, an accelerometer, leaves I2C with a rising edge of its chip
            // select and then lets the wires alone (data sheet 3.1): low so far, as a new output.
            for select in [pins.select, pins.select_other] {
                select.become_a(Role::Output);
                select.set(true);
            }
            pins.miso.become_a(Role::PeripheralInput(SPI1_AF, Pull::Up));
            for pin in [pins.clock, pins.mosi] {
                pin.become_a(Role::PeripheralOutput(SPI1_AF, Pull::None, Speed::Medium));
            }
            pac::RCC.apb2enr().modify(|w| w.set_spi1en(true));
            PORT.cr1().write(|w| {
                w.set_mstr(Mstr::MASTER);
                w.set_br(Br::DIV16);
                w.set_ssm(true);
                w.set_ssi(true);
                w.set_dff(Dff::BITS16);
                w.set_spe(true);
            });
        }
        Self {
            reader: Reader::new(),
        }
    }

    /// Takes the answer to the last word; `None` on a board without a gyro.
    pub fn read(&mut self) -> Option<Reading> {
        let pins = WIRING.gyro?;
        let come = PORT.sr().read().rxne();
        let answer = come.then(|| PORT.dr().read().dr());
        if !self.reader.goes_on() {
            pins.select.set(true);
        }
        Some(self.reader.receive(answer))
    }

    /// Sends the next word.
    pub fn ask(&mut self) {
        if let (Some(pins), Some(word)) = (WIRING.gyro, self.reader.next()) {
            pins.select.set(false);
            PORT.dr().write(|w| w.set_dr(word));
        }
    }
}
