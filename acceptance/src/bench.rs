//! What level 1 needs from outside: a bus to the board, and someone who handles wires and plugs.

use canopen::Frame;

/// A firmware image of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Image {
    /// The self-test image.
    SelfTest,
    /// The image that robots run.
    Shipped,
}

/// Access to the board's memory while its program runs.
pub trait Debugger {
    /// Reads words, of RAM or of a peripheral.
    ///
    /// # Errors
    /// When the debugger does not reach the board.
    fn read(&mut self, address: u32, words: usize) -> anyhow::Result<Vec<u32>>;

    /// Writes a peripheral's register.
    ///
    /// # Errors
    /// As [`Debugger::read`].
    fn write(&mut self, address: u32, word: u32) -> anyhow::Result<()>;

    /// Begins to read, and returns where the words will be: frames have to go on meanwhile, and a
    /// debugger may take longer than setpoints may be late.
    ///
    /// # Errors
    /// As [`Debugger::read`].
    fn read_meanwhile(&mut self, address: u32, words: usize) -> anyhow::Result<Reading> {
        let (answer, reading) = std::sync::mpsc::channel();
        let _ = answer.send(self.read(address, words));
        Ok(reading)
    }
}

/// Words that a debugger reads meanwhile.
pub type Reading = std::sync::mpsc::Receiver<anyhow::Result<Vec<u32>>>;

/// A board on a bus. Times are those of the master's clock, in us.
pub trait Bench {
    /// The present.
    fn now_us(&self) -> u64;

    /// Sends a frame.
    ///
    /// # Errors
    /// When the bus cannot be used any more.
    fn send(&mut self, frame: &Frame) -> anyhow::Result<()>;

    /// Waits for a frame, until a time; returns it with the time of its end.
    ///
    /// # Errors
    /// When the bus cannot be used any more.
    fn receive(&mut self, until_us: u64) -> anyhow::Result<Option<(u64, Frame)>>;

    /// Writes an image into the board and starts it.
    ///
    /// # Errors
    /// When that fails.
    fn flash(&mut self, image: Image) -> anyhow::Result<()>;

    /// Switches the board off and on.
    ///
    /// # Errors
    /// When that fails.
    fn power_cycle(&mut self) -> anyhow::Result<()>;

    /// Disturbs the bus until the board is bus-off, and then leaves it alone.
    ///
    /// # Errors
    /// When that fails.
    fn force_bus_off(&mut self) -> anyhow::Result<()>;

    /// Takes these wires (places in [`crate::wires::WIRES`]) out; the next image starts without
    /// them.
    ///
    /// # Errors
    /// When that fails.
    fn take_out(&mut self, wires: &[u8]) -> anyhow::Result<()>;

    /// Puts a second board with the shipped image on the bus, and [`crate::wires::SECOND`] between
    /// the two; starts the shipped image on the first one with its other wires out but
    /// [`crate::wires::WITH_SECOND`]. Returns the second's node number, or nothing where there is
    /// no second board.
    ///
    /// # Errors
    /// When that fails.
    fn join_second(&mut self) -> anyhow::Result<Option<u8>> {
        Ok(None)
    }

    /// The debugger, if there is one. The program goes on meanwhile.
    fn debugger(&mut self) -> Option<&mut dyn Debugger> {
        None
    }

    /// Whether [`Bench::power_cycle`] and [`Bench::force_bus_off`] return at the moment of what
    /// they do, so that times can be measured from there. A person's do not.
    fn hands_are_timed(&self) -> bool {
        true
    }
}
