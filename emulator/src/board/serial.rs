//! USART2 as seen from the other end of its line.

use super::Board;

/// A board's serial line. All times are the board's present, the end of its last run.
pub struct SerialPort<'a> {
    pub(super) board: &'a mut Board,
}

impl SerialPort<'_> {
    /// Puts bytes on the line into the chip, behind those that are still on it, from a sender with
    /// this baud rate.
    pub fn send(&mut self, bytes: &[u8], baud: f64) {
        self.board
            .shared
            .with(|soc| soc.serial_arrive(bytes, baud, true));
    }

    /// Puts a byte on the line whose stop bit is missing.
    pub fn send_broken(&mut self, byte: u8, baud: f64) {
        self.board
            .shared
            .with(|soc| soc.serial_arrive(&[byte], baud, false));
    }

    /// The other end lets go of the line into the chip, in the middle of a byte or not, as a cable
    /// does that is pulled: it stays at this level, and what is sent is lost.
    pub fn release(&mut self, level: bool) {
        self.board
            .shared
            .with(|soc| soc.serial_release(Some(level)));
    }

    /// The other end drives the line again.
    pub fn drive(&mut self) {
        self.board.shared.with(|soc| soc.serial_release(None));
    }

    /// Bytes that the chip has not yet received in full.
    #[must_use]
    pub fn on_line(&self) -> usize {
        self.board.shared.look(|soc| soc.usart2.on_line())
    }

    /// Takes the bytes that the chip has sent, each with the world time in ns at which it ended.
    pub fn take_sent(&mut self) -> Vec<(u64, u8)> {
        let sent = self.board.shared.look(|soc| soc.serial_sent());
        sent.into_iter()
            .map(|(cycle, byte)| (self.board.world_ns(cycle), byte))
            .collect()
    }

    /// The baud rate that the chip has set, without its crystal's error; `None` while the port is
    /// off.
    #[must_use]
    pub fn baud(&self) -> Option<f64> {
        self.board.shared.look(|soc| soc.serial_baud())
    }
}
