//! The virtual CAN bus: who may send, how long it takes, and how full the wire is.
//!
//! One frame at a time. When the wire has been free for the intermission, every node that has something
//! to send takes part in arbitration and the lowest identifier wins, as on the wire. The winner's frame
//! then occupies the bus for its exact number of bits, see [`bits`]; everybody hears it when it ends. A frame
//! that goes wrong ends early, with an error frame ([`Fate`]); who counts what is told in [`errors`].
//!
//! The bus holds no queues: nodes do. It cannot fill up; a node that never wins waits for ever, as in
//! life. Two nodes sending one identifier at the same time would destroy each other's frames on a real
//! bus; here the first node wins and the case is counted in [`Bus::collisions`].

pub mod candump;
pub mod disturb;
pub mod errors;
mod load;

use canopen::Frame;

pub use load::{BusLoad, LoadMeter};

use canopen::bits::{ERROR_DELIMITER, FLAG, INTERMISSION, Wire};

/// One bit at 1 Mbit/s, ns.
pub const BIT_NS: u64 = 1_000;

/// What becomes of a frame on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// Everybody gets it.
    Good,
    /// One bit, counted from 0, is inverted for everybody; `active`: the sender may destroy the rest.
    Corrupt {
        /// Which.
        bit: u32,
        /// Whether the sender is error active.
        active: bool,
    },
    /// The acknowledge does not reach the sender. An error-active one destroys the frame; an error-passive
    /// one can only send it again, and the others get it twice.
    Unacknowledged {
        /// Whether the sender is error active.
        active: bool,
    },
    /// A receiver, by its number, has seen something else and destroys the frame.
    Refused {
        /// Which.
        by: usize,
    },
    /// The sender has gone while it was sending.
    CutOff,
}

impl Fate {
    /// Whether an error frame ends it.
    #[must_use]
    pub fn is_destroyed(self) -> bool {
        !matches!(self, Self::Good | Self::Unacknowledged { active: false })
    }

    /// Bits that the frame takes, or what there is of it with the error frame.
    fn bits(self, wire: &Wire) -> u32 {
        match self {
            Self::Corrupt { bit, active } => wire.bits_when_corrupt(bit, active),
            Self::Unacknowledged { active: true } => wire.bits_when_unacknowledged(),
            Self::Refused { .. } => wire.bits_when_refused(),
            Self::Good | Self::Unacknowledged { active: false } | Self::CutOff => wire.bits(),
        }
    }
}

/// A frame on its way over the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Transfer {
    /// Who sends it.
    pub sender: usize,
    /// What.
    pub frame: Frame,
    /// When its first bit was on the wire, ns.
    pub start_ns: u64,
    /// When its last bit has been, ns: everybody has received it, or the error frame is over.
    pub end_ns: u64,
    /// What becomes of it.
    pub fate: Fate,
}

/// The wire.
#[derive(Debug)]
pub struct Bus {
    transfer: Option<Transfer>,
    free_at_ns: u64,
    load: LoadMeter,
    frames: u64,
    error_frames: u64,
    collisions: u64,
}

impl Bus {
    /// A free bus at time 0 whose load is measured over windows of this length, ns.
    #[must_use]
    pub fn new(load_window_ns: u64) -> Self {
        Self {
            transfer: None,
            free_at_ns: 0,
            load: LoadMeter::new(load_window_ns),
            frames: 0,
            error_frames: 0,
            collisions: 0,
        }
    }

    /// When the frame on the wire ends, ns; `None` when there is none.
    #[must_use]
    pub fn transfer_end_ns(&self) -> Option<u64> {
        self.transfer.map(|t| t.end_ns)
    }

    /// The earliest time at which another frame may start, ns.
    #[must_use]
    pub fn free_at_ns(&self) -> u64 {
        self.free_at_ns
    }

    /// Whether a frame may start now.
    #[must_use]
    pub fn is_free(&self, now_ns: u64) -> bool {
        self.transfer.is_none() && now_ns >= self.free_at_ns
    }

    /// Arbitration among the nodes that want to send, each with the frame it would send first. Call only
    /// when the bus [is free](Self::is_free). Returns the transfer that begins; `fate` says what becomes of
    /// it.
    pub fn arbitrate(
        &mut self,
        now_ns: u64,
        contenders: impl Iterator<Item = (usize, Frame)>,
        fate: impl FnOnce(usize, &Frame) -> Fate,
    ) -> Option<Transfer> {
        debug_assert!(self.is_free(now_ns));
        let mut winner: Option<(usize, Frame)> = None;
        for (sender, frame) in contenders {
            match winner {
                Some((_, best)) if best.id() < frame.id() => {}
                Some((_, best)) if best.id() == frame.id() => self.collisions += 1,
                _ => winner = Some((sender, frame)),
            }
        }
        let (sender, frame) = winner?;
        let fate = fate(sender, &frame);
        let bits = u64::from(fate.bits(&Wire::of(&frame)));
        let end_ns = now_ns + bits * BIT_NS;
        self.free_at_ns = end_ns + u64::from(INTERMISSION) * BIT_NS;
        self.load.busy(now_ns, self.free_at_ns);
        if fate.is_destroyed() {
            self.error_frames += 1;
        } else {
            self.frames += 1;
        }
        self.transfer = Some(Transfer {
            sender,
            frame,
            start_ns: now_ns,
            end_ns,
            fate,
        });
        self.transfer
    }

    /// The node goes while it may be sending: then the wire stays recessive, the others notice at the sixth
    /// such bit, and send their error flags.
    pub fn cut_off(&mut self, now_ns: u64, node: usize) {
        let Some(transfer) = self.transfer.as_mut().filter(|t| t.sender == node) else {
            return;
        };
        if !transfer.fate.is_destroyed() {
            self.error_frames += 1;
            self.frames -= 1;
        }
        let sent = (now_ns - transfer.start_ns).div_ceil(BIT_NS);
        let rest = u64::from(FLAG + FLAG + ERROR_DELIMITER);
        transfer.fate = Fate::CutOff;
        transfer.end_ns = transfer.start_ns + (sent + rest) * BIT_NS;
        self.free_at_ns = transfer.end_ns + u64::from(INTERMISSION) * BIT_NS;
        self.load.ends(self.free_at_ns);
    }

    /// The transfer that has ended by now, once.
    pub fn finish(&mut self, now_ns: u64) -> Option<Transfer> {
        self.transfer.take_if(|t| t.end_ns <= now_ns)
    }

    /// Load up to now.
    #[must_use]
    pub fn load(&self, now_ns: u64) -> BusLoad {
        self.load.read(now_ns)
    }

    /// Time the wire has been taken up to now, ns, intermissions included.
    #[must_use]
    pub fn busy_ns(&self, now_ns: u64) -> u64 {
        self.load.busy_ns(now_ns)
    }

    /// Error frames so far.
    #[must_use]
    pub fn error_frames(&self) -> u64 {
        self.error_frames
    }

    /// Frames that were sent.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// How often two nodes tried to send one identifier at the same time.
    #[must_use]
    pub fn collisions(&self) -> u64 {
        self.collisions
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(id: u16) -> Frame {
        Frame::new(id, &[]).unwrap()
    }

    fn good(_: usize, _: &Frame) -> Fate {
        Fate::Good
    }

    /// 20 bits have gone when the sender goes: six recessive ones, six of the others' flags, eight of
    /// delimiter, three of intermission.
    #[test]
    fn a_sender_that_goes_leaves_an_error_frame() {
        let mut bus = Bus::new(100_000);
        bus.arbitrate(0, [(2, frame(0))].into_iter(), good).unwrap();
        bus.cut_off(19_500, 1);
        assert_eq!(bus.transfer_end_ns(), Some(50_000));
        bus.cut_off(19_500, 2);
        assert_eq!(bus.transfer_end_ns(), Some(40_000));
        assert_eq!((bus.frames(), bus.error_frames()), (0, 1));
        assert_eq!(bus.finish(40_000).unwrap().fate, Fate::CutOff);
        assert!(bus.is_free(43_000) && !bus.is_free(42_999));
        assert_eq!(bus.busy_ns(100_000), 43_000);
    }

    #[test]
    fn the_lowest_identifier_wins_whoever_sends_it() {
        let mut bus = Bus::new(1_000_000);
        let contenders = [(0, frame(0x181)), (1, frame(0x080)), (2, frame(0x182))];
        let transfer = bus.arbitrate(0, contenders.into_iter(), good).unwrap();
        assert_eq!((transfer.sender, transfer.frame.id()), (1, 0x080));
    }

    #[test]
    fn the_wire_is_free_after_the_intermission() {
        let mut bus = Bus::new(1_000_000);
        // Identifier 0 without data: 50 bits (see `bits`).
        bus.arbitrate(7, [(0, frame(0))].into_iter(), good).unwrap();
        assert_eq!(bus.finish(50_006), None);
        assert_eq!(bus.finish(50_007).unwrap().end_ns, 50_007);
        assert_eq!(bus.finish(50_007), None);
        assert!(!bus.is_free(53_006));
        assert!(bus.is_free(53_007));
    }

    #[test]
    fn two_nodes_with_one_identifier_are_counted() {
        let mut bus = Bus::new(1_000_000);
        let transfer = bus
            .arbitrate(0, [(3, frame(5)), (4, frame(5))].into_iter(), good)
            .unwrap();
        assert_eq!((transfer.sender, bus.collisions()), (3, 1));
    }
}
