//! The virtual CAN bus: arbitration, exact frame times, and load.
//!
//! One frame at a time. When the wire has been free for the intermission, every node with a pending
//! frame takes part in arbitration, and the lowest identifier wins. The winner's frame then
//! occupies the bus for its exact number of bits, see [`canopen::bits`]; all nodes receive it at
//! its end. A frame with an error ends early, with an error frame ([`Fate`]); [`errors`] has the
//! counting rules.
//!
//! Queues are in the nodes, not in the bus, so the bus cannot fill up; a node that never wins
//! arbitration waits indefinitely, as on a real bus.
//!
//! Two nodes that begin a frame with one identifier in the same bit have been numbered wrongly, and
//! the bus models the resulting collision. While their bits are the same there is one frame on the
//! wire, and both have sent it. At the first bit that differs, the one that sends a recessive bit
//! reads a dominant one: a bit error. An error-active node then destroys the frame for all nodes,
//! and both try again at once; an error-passive one drops out, and the other's frame stands.

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
    /// All nodes receive it.
    Good,
    /// One bit, counted from 0, is inverted for all nodes; `active`: the sender may destroy the
    /// rest.
    Corrupt {
        /// Which.
        bit: u32,
        /// Whether the sender is error active.
        active: bool,
    },
    /// The acknowledge does not reach the sender. An error-active one destroys the frame; an
    /// error-passive one can only send it again, and the others get it twice.
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
    /// Two senders of one identifier differ in this bit, counted from 0, and one of them was error
    /// active.
    Collided {
        /// Which.
        bit: u32,
    },
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
            Self::Collided { bit } => wire.bits_when_collided(bit),
            Self::Good | Self::Unacknowledged { active: false } | Self::CutOff => wire.bits(),
        }
    }
}

/// A frame on its way over the wire.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transfer {
    /// Who sends it.
    pub sender: usize,
    /// Who else sends it in the same bits.
    pub others: Vec<usize>,
    /// Error-passive senders of another frame with this identifier, which had to give way.
    pub dropped: Vec<usize>,
    /// What.
    pub frame: Frame,
    /// When its first bit was on the wire, ns.
    pub start_ns: u64,
    /// Time of its last bit, ns: all nodes have received it, or the error frame is over.
    pub end_ns: u64,
    /// What becomes of it.
    pub fate: Fate,
}

/// The wire.
#[derive(Debug, Clone)]
pub struct Bus {
    transfer: Option<Transfer>,
    free_at_ns: u64,
    load: LoadMeter,
    frames: u64,
    error_frames: u64,
    collisions: u64,
}

impl Transfer {
    /// Whether a node is one of those whose frame is on the wire.
    #[must_use]
    pub fn is_sent_by(&self, node: usize) -> bool {
        self.sender == node || self.others.contains(&node)
    }
}

/// Several senders of one identifier, on the wire together.
struct Contention {
    senders: Vec<(usize, Frame)>,
    dropped: Vec<usize>,
    /// The bit in which an error-active one of them destroyed the frame.
    destroyed: Option<u32>,
}

impl Contention {
    fn new(senders: Vec<(usize, Frame)>, is_active: impl Fn(usize) -> bool) -> Self {
        let mut contention = Self {
            senders,
            dropped: Vec::new(),
            destroyed: None,
        };
        while let Some(bit) = contention.first_difference() {
            let recessive = |(_, frame): &(usize, Frame)| Wire::of(frame).level(bit);
            let losers = contention
                .senders
                .extract_if(.., |sender| recessive(sender));
            let losers: Vec<(usize, Frame)> = losers.collect();
            if losers.iter().any(|(node, _)| is_active(*node)) {
                // A sender of the dominant bit comes first: its bits are those on the wire.
                contention.senders.extend(losers);
                contention.destroyed = Some(bit);
                break;
            }
            contention
                .dropped
                .extend(losers.iter().map(|(node, _)| node));
        }
        contention
    }

    /// The first bit in which any two of the senders differ.
    fn first_difference(&self) -> Option<u32> {
        let (_, first) = self.senders.first()?;
        let first = Wire::of(first);
        let differences = self.senders.iter();
        differences
            .filter_map(|(_, other)| first.first_difference(&Wire::of(other)))
            .min()
    }
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
        self.transfer.as_ref().map(|t| t.end_ns)
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

    /// Arbitration among the nodes that want to send, each with the frame it would send first. Call
    /// only when the bus [is free](Self::is_free). Returns the transfer that begins; `fate` says
    /// what becomes of the frame of these senders, and `is_active` whether a node is error active.
    pub fn arbitrate(
        &mut self,
        now_ns: u64,
        contenders: impl Iterator<Item = (usize, Frame)>,
        is_active: impl Fn(usize) -> bool,
        fate: impl FnOnce(&[usize], &Frame) -> Fate,
    ) -> Option<&Transfer> {
        debug_assert!(self.is_free(now_ns));
        let mut winner: Option<(usize, Frame)> = None;
        let mut several = Vec::new();
        for (sender, frame) in contenders {
            match winner {
                Some((_, best)) if best.id() < frame.id() => {}
                Some((_, best)) if best.id() == frame.id() => several.push((sender, frame)),
                _ => {
                    winner = Some((sender, frame));
                    several.clear();
                }
            }
        }
        let (mut sender, mut frame) = winner?;
        let (mut others, mut dropped, mut destroyed) = (Vec::new(), Vec::new(), None);
        if !several.is_empty() {
            self.collisions += 1;
            several.insert(0, (sender, frame));
            let contention = Contention::new(several, is_active);
            (sender, frame) = *contention.senders.first()?;
            let rest = contention.senders.iter().skip(1);
            others = rest.map(|(node, _)| *node).collect();
            (dropped, destroyed) = (contention.dropped, contention.destroyed);
        }
        let fate = match destroyed {
            Some(bit) => Fate::Collided { bit },
            None if others.is_empty() => fate(&[sender], &frame),
            None => {
                let senders: Vec<usize> = others.iter().copied().chain([sender]).collect();
                fate(&senders, &frame)
            }
        };
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
            others,
            dropped,
            frame,
            start_ns: now_ns,
            end_ns,
            fate,
        });
        self.transfer.as_ref()
    }

    /// The node goes while it may be sending: then the wire stays recessive, the others notice at
    /// the sixth such bit, and send their error flags.
    pub fn cut_off(&mut self, now_ns: u64, node: usize) {
        let Some(transfer) = self.transfer.as_mut() else {
            return;
        };
        transfer.others.retain(|other| *other != node);
        transfer.dropped.retain(|other| *other != node);
        if transfer.sender != node {
            return;
        }
        if let Some(other) = transfer.others.pop() {
            transfer.sender = other;
            return;
        }
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

    /// How often several nodes began a frame with one identifier in the same bit.
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

    fn good(_: &[usize], _: &Frame) -> Fate {
        Fate::Good
    }

    fn active(_: usize) -> bool {
        true
    }

    /// 20 bits have gone when the sender goes: six recessive ones, six of the others' flags, eight
    /// of delimiter, three of intermission.
    #[test]
    fn a_sender_that_goes_leaves_an_error_frame() {
        let mut bus = Bus::new(100_000);
        bus.arbitrate(0, [(2, frame(0))].into_iter(), active, good)
            .unwrap();
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
        let transfer = bus
            .arbitrate(0, contenders.into_iter(), active, good)
            .unwrap();
        assert_eq!((transfer.sender, transfer.frame.id()), (1, 0x080));
    }

    #[test]
    fn the_wire_is_free_after_the_intermission() {
        let mut bus = Bus::new(1_000_000);
        // Identifier 0 without data: 50 bits (see `bits`).
        bus.arbitrate(7, [(0, frame(0))].into_iter(), active, good)
            .unwrap();
        assert_eq!(bus.finish(50_006), None);
        assert_eq!(bus.finish(50_007).unwrap().end_ns, 50_007);
        assert_eq!(bus.finish(50_007), None);
        assert!(!bus.is_free(53_006));
        assert!(bus.is_free(53_007));
    }

    #[test]
    fn the_same_frame_of_two_nodes_is_one_frame() {
        let mut bus = Bus::new(1_000_000);
        let senders = [(3, frame(5)), (4, frame(5)), (5, frame(6))];
        let transfer = bus.arbitrate(0, senders.into_iter(), active, good).unwrap();
        assert_eq!((transfer.sender, &transfer.others), (3, &vec![4]));
        assert_eq!(transfer.fate, Fate::Good);
        assert_eq!((bus.collisions(), bus.frames()), (1, 1));
    }

    /// Start, identifier, RTR, IDE, reserved bit and length of 0x555 with one byte are 19 bits: 0,
    /// 10101010101, 000, 0001. After the five dominant ones in a row comes a stuff bit, so the
    /// first bit of data is bit 20.
    fn byte(data: u8) -> Frame {
        Frame::new(0x555, &[data]).unwrap()
    }

    #[test]
    fn different_frames_of_active_nodes_destroy_each_other() {
        let mut bus = Bus::new(1_000_000);
        let senders = [(3, byte(0x80)), (4, byte(0x00))];
        let transfer = bus.arbitrate(0, senders.into_iter(), active, good).unwrap();
        assert_eq!(transfer.fate, Fate::Collided { bit: 20 });
        assert!(transfer.is_sent_by(3) && transfer.is_sent_by(4));
        // 21 bits, the last of which is dominant: five more of the flag until all have seen six,
        // their flags, and the delimiter.
        assert_eq!(transfer.end_ns, (21 + 5 + 6 + 8) * BIT_NS);
        assert_eq!((bus.error_frames(), bus.frames()), (1, 0));
    }

    #[test]
    fn a_passive_node_gives_way_to_the_dominant_bit() {
        let mut bus = Bus::new(1_000_000);
        let senders = [(3, byte(0x80)), (4, byte(0x00)), (5, byte(0x00))];
        let passive = |node| node != 3;
        let transfer = bus
            .arbitrate(0, senders.into_iter(), |node| !passive(node), good)
            .unwrap();
        assert_eq!(transfer.fate, Fate::Collided { bit: 20 }, "3 is active");
        let mut bus = Bus::new(1_000_000);
        let transfer = bus
            .arbitrate(0, senders.into_iter(), |_| false, good)
            .unwrap();
        assert_eq!((transfer.sender, &transfer.others), (4, &vec![5]));
        assert_eq!((transfer.fate, &transfer.dropped), (Fate::Good, &vec![3]));
        assert_eq!((transfer.frame, bus.frames()), (byte(0x00), 1));
    }
}
