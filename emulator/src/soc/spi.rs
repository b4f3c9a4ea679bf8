//! SPI1 and the gyro on it: who is selected, and whether the pins are the port's.

use super::Soc;
use crate::bmi088::Bmi088;
use crate::system::gpio::{PinLevel, Port};
use crate::system::spi::Spi;

/// The wire into the master, not driven, with its pull-up.
const OPEN: u16 = 0xFFFF;

impl Soc {
    pub(crate) fn connect_gyro(&mut self, select: (Port, u8)) {
        self.gyro = Some((Bmi088::default(), select));
        self.select_gyro();
    }

    pub(crate) fn gyro(&mut self) -> Option<&mut Bmi088> {
        self.gyro.as_mut().map(|(gyro, _)| gyro)
    }

    /// Tells the gyro the level of its chip select; an open wire is high.
    pub(super) fn select_gyro(&mut self) {
        if let Some((_, (port, pin))) = self.gyro {
            let low = self.output(port, pin) == PinLevel::Low;
            if let Some(gyro) = self.gyro() {
                gyro.select(low);
            }
        }
    }

    pub(super) fn read_spi(&mut self, offset: u32) -> Option<u32> {
        self.with_spi(|spi, now, exchange| spi.read(now, offset, exchange))
    }

    pub(super) fn write_spi(&mut self, offset: u32, value: u32) -> Result<(), &'static str> {
        self.with_spi(|spi, now, exchange| spi.write(now, offset, value, exchange))
    }

    fn with_spi<T>(
        &mut self,
        access: impl FnOnce(&mut Spi, u64, &mut dyn FnMut(u16, u32) -> u16) -> T,
    ) -> T {
        let mut lines = self.chip.pins.spi1.into_iter();
        let wired = lines.all(|line| line.iter().any(|route| self.connected(route)));
        let (now, now_ns) = (self.now, self.clock.world_ns(self.now));
        let gyro = &mut self.gyro;
        access(&mut self.spi1, now, &mut |word, bits| match gyro {
            Some((gyro, _)) if wired => gyro.exchange(now_ns, word, bits),
            _ => OPEN,
        })
    }
}
