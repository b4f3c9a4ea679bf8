//! External interrupts (RM0390 rev 6, section 10.3) and the port selection in SYSCFG (section 8).

use crate::system::gpio::Port;
use crate::system::map::irq;

/// EXTI and the four EXTICR registers.
#[derive(Debug, Clone, Default)]
pub struct Exti {
    imr: u32,
    emr: u32,
    rtsr: u32,
    ftsr: u32,
    pr: u32,
    exticr: [u32; 4],
    syscfg: [u32; 2],
}

/// Lines 0..=15 are pins; up to 22 there are internal ones.
const LINES: u32 = 0x007F_FFFF;

/// The line of the programmable voltage detector.
pub const PVD_LINE: u8 = 16;

impl Exti {
    /// Resets EXTI (it has no reset bit of its own: system reset only).
    pub fn reset(&mut self) {
        *self = Self {
            exticr: self.exticr,
            syscfg: self.syscfg,
            ..Self::default()
        };
    }

    /// Resets SYSCFG.
    pub fn reset_syscfg(&mut self) {
        self.exticr = [0; 4];
        self.syscfg = [0; 2];
    }

    /// Port that line 0..=15 listens to.
    #[must_use]
    pub fn port(&self, line: u8) -> Option<Port> {
        let selection = self.exticr[usize::from(line / 4)] >> (4 * (line % 4)) & 0xF;
        Port::ALL.get(selection as usize).copied()
    }

    /// Tells of an edge on the pin that a line may listen to.
    pub fn edge(&mut self, port: Port, pin: u8, rising: bool) {
        let wanted = if rising { self.rtsr } else { self.ftsr };
        if self.port(pin) == Some(port) && wanted >> pin & 1 != 0 {
            self.pr |= 1 << pin;
        }
    }

    /// Tells of an edge on an internal line.
    pub fn internal_edge(&mut self, line: u8, rising: bool) {
        let wanted = if rising { self.rtsr } else { self.ftsr };
        self.pr |= wanted & 1 << line;
    }

    /// Reads an EXTI register; `None` for an offset without one.
    #[must_use]
    pub fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.imr,
            0x04 => self.emr,
            0x08 => self.rtsr,
            0x0C => self.ftsr,
            0x10 => 0,
            0x14 => self.pr,
            _ => return None,
        })
    }

    /// Writes an EXTI register; `None` for an offset without one. Events (EMR) are stored without
    /// effect.
    pub fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x00 => self.imr = value & LINES,
            0x04 => self.emr = value & LINES,
            0x08 => self.rtsr = value & LINES,
            0x0C => self.ftsr = value & LINES,
            0x10 => self.pr |= value & self.imr & LINES,
            0x14 => self.pr &= !value,
            _ => return None,
        }
        Some(())
    }

    /// Reads a SYSCFG register; `None` for an offset without one.
    #[must_use]
    pub fn read_syscfg(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 | 0x04 => self.syscfg[(offset / 4) as usize],
            0x08..=0x14 => self.exticr[(offset / 4 - 2) as usize],
            // CMPCR: the compensation cell is ready as soon as it is on.
            0x20 => 0x101,
            0x2C => 0,
            _ => return None,
        })
    }

    /// Writes a SYSCFG register; `None` for an offset without one, and for remapping the memory at
    /// 0.
    pub fn write_syscfg(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x00 if value & 7 == 0 => self.syscfg[0] = value,
            0x04 => self.syscfg[1] = value,
            0x08..=0x14 => self.exticr[(offset / 4 - 2) as usize] = value & 0xFFFF,
            0x20 | 0x2C => {}
            _ => return None,
        }
        Some(())
    }

    /// Whether no line is up.
    #[must_use]
    pub fn is_quiet(&self) -> bool {
        self.pr & self.imr == 0
    }

    /// Interrupt lines: number and level.
    pub fn lines(&self) -> impl Iterator<Item = (u16, bool)> {
        let on = self.pr & self.imr;
        let single = (0..5).map(move |line| (irq::EXTI[line], on >> line & 1 != 0));
        single.chain([
            (irq::PVD, on >> PVD_LINE & 1 != 0),
            (irq::EXTI9_5, on & 0x03E0 != 0),
            (irq::EXTI15_10, on & 0xFC00 != 0),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_on_the_selected_port_pends_the_shared_vector() {
        let mut exti = Exti::default();
        exti.write_syscfg(0x14, 2 << 4).unwrap(); // EXTI13 from port C
        exti.write(0x00, 1 << 13).unwrap();
        exti.write(0x0C, 1 << 13).unwrap();
        exti.edge(Port::C, 13, true);
        exti.edge(Port::A, 13, false);
        assert!(exti.lines().all(|(_, on)| !on));
        exti.edge(Port::C, 13, false);
        assert!(exti.lines().any(|line| line == (irq::EXTI15_10, true)));
        exti.write(0x14, 1 << 13).unwrap();
        assert!(exti.lines().all(|(_, on)| !on));
    }
}
