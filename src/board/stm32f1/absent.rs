//! The functions that a robot with an STM32F1 lacks, as values that do nothing or cannot exist:
//! smart drives, which need a second CAN controller; a gyro; the cable; updates over the bus,
//! because 256 KiB have no room for two slots, and with them the boot code's signatures and the
//! lock.

/// Smart drives.
pub mod drives {
    use control::rollers::IndexPulse;
    use control::smart_drive::DriveConfiguration;
    use control::smart_drive::frames::Model;
    use control::smart_drive::index::IndexEdge;
    use control::time::Micros;
    use protocol::Fault;

    /// Whether smart drives turn the wheels.
    pub const ARE_WIRED: bool = false;

    /// None.
    pub struct Drives(());

    #[allow(missing_docs)]
    impl Drives {
        pub fn new() -> Self {
            Self(())
        }

        pub fn configure(&mut self, _wheels: DriveConfiguration, _model: Model) {}

        pub fn read(&self, _now: Micros) -> ([u16; 4], Option<Fault>) {
            ([0; 4], None)
        }

        pub fn index_pulses(&self, _edges: &[IndexEdge; 4], _now: Micros) -> [IndexPulse; 4] {
            Default::default()
        }

        pub fn temperature(&self) -> u8 {
            0
        }

        pub fn send(&mut self, _currents: [f32; 4], _enabled: bool) {}
    }

    /// No filter.
    pub fn set_filter() {}

    /// Nothing to bring to rest.
    #[inline(always)]
    pub fn rest() {}
}

/// A gyro.
pub mod gyro {
    use control::gyro::Reading;

    /// None.
    pub struct Gyro(());

    #[allow(missing_docs)]
    impl Gyro {
        pub fn new() -> Self {
            Self(())
        }

        pub fn read(&mut self) -> Option<Reading> {
            None
        }

        pub fn ask(&mut self) {}
    }
}

/// The cable.
pub mod serial {
    use can_text::slcan::LINE;

    /// Whether the board has one.
    pub const IS_WIRED: bool = false;

    /// Cannot exist.
    pub enum Serial {}

    /// Cannot exist either.
    pub struct Arrived {
        /// Whether some of it was wrong.
        pub damaged: bool,
    }

    #[allow(missing_docs)]
    impl Serial {
        pub fn new() -> Option<Self> {
            None
        }

        pub fn has_news(&self) -> bool {
            match *self {}
        }

        pub fn arrived(&mut self) -> Arrived {
            match *self {}
        }

        pub fn read(&mut self, _arrived: &Arrived) -> Option<u8> {
            match *self {}
        }

        pub fn write(&mut self, _bytes: &[u8]) {
            match *self {}
        }

        pub fn dropped(&self) -> u32 {
            match *self {}
        }
    }

    /// Drops it: this chip has no serial port for it.
    pub fn put(_print: impl FnOnce(&mut [u8; LINE]) -> usize) {}
}

/// Updates over the bus.
pub mod program_flash {
    use boot::{Crypto, Flash, FlashError, Slot};
    use robot::update::StandIn;

    enum Never {}

    /// Cannot exist.
    pub struct ProgramFlash(Never);

    /// Cannot exist.
    pub struct Slots(Never);

    /// Cannot exist.
    pub struct BootCode(Never);

    #[allow(missing_docs)]
    impl ProgramFlash {
        pub fn find() -> Option<(Self, BootCode)> {
            None
        }

        pub fn saying(&mut self, _stand_in: Option<StandIn>) -> Slots {
            match self.0 {}
        }

        pub const fn running(&self) -> Slot {
            match self.0 {}
        }
    }

    #[allow(missing_docs)]
    impl BootCode {
        pub fn find() -> Option<Self> {
            None
        }
    }

    impl Flash for Slots {
        fn word(&self, _address: u32) -> u32 {
            match self.0 {}
        }

        fn program(&mut self, _address: u32, _word: u32) -> Result<(), FlashError> {
            match self.0 {}
        }

        fn erase(&mut self, _sector: u8) -> Result<(), FlashError> {
            match self.0 {}
        }
    }

    impl Crypto for BootCode {
        type Hash = ();

        fn begin(&self) {
            match self.0 {}
        }

        fn update(&self, (): &mut (), _bytes: &[u8]) {
            match self.0 {}
        }

        fn finish(&self, (): ()) -> [u8; 64] {
            match self.0 {}
        }

        fn is_signed(&self, _message: &[u8], _signature: &[u8; 64]) -> bool {
            match self.0 {}
        }
    }
}
