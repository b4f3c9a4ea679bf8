//! Disturbances of the bus, and the frames they affect.
//!
//! Random numbers come from the world's seed, one per frame and disturbance, and only while there
//! is a disturbance: a run without one does not depend on the seed.

use canopen::Frame;

use super::Fate;
use crate::random::Random;
use canopen::bits::Wire;

/// The first bit that may be struck. A bit of the identifier would make its sender lose arbitration
/// to no node: start and identifier are 12 bits, with two stuff bits at most and perhaps one after
/// them.
const FIRST_BIT: u32 = 15;

/// A share of the frames, all or those with one identifier.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Share {
    /// 0..=1.
    pub of: f64,
    /// Only frames with this identifier.
    pub id: Option<u16>,
}

impl Share {
    /// None at all.
    pub const NONE: Self = Self { of: 0.0, id: None };
}

/// Everything that disturbs the wire itself.
#[derive(Debug, Clone)]
pub struct Disturbances {
    random: Random,
    /// Frames in which one bit is inverted for all nodes.
    pub corrupt: Share,
    /// Frames whose acknowledge does not arrive.
    pub unacknowledged: Share,
    /// The frame that a foreign node sends all the time.
    pub babble: Option<Frame>,
}

impl Disturbances {
    /// None, with the chances of this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            // Others use the seed, too.
            random: Random::new(seed ^ 0x4255_5345_5252_4F52),
            corrupt: Share::NONE,
            unacknowledged: Share::NONE,
            babble: None,
        }
    }

    /// Whether one of a share is struck.
    pub fn strikes(&mut self, share: Share, frame: &Frame) -> bool {
        let concerned = share.of > 0.0 && share.id.is_none_or(|id| id == frame.id());
        concerned && self.random.unit() < share.of
    }

    /// What becomes of a frame on the wire. `active`: its sender is error active.
    pub fn fate(&mut self, frame: &Frame, active: bool) -> Fate {
        if self.strikes(self.corrupt, frame) {
            let last = Wire::of(frame).stuffed();
            let among = u64::from(last - FIRST_BIT);
            // Below 128.
            let bit = FIRST_BIT + (self.random.next() % among) as u32;
            Fate::Corrupt { bit, active }
        } else if self.strikes(self.unacknowledged, frame) {
            Fate::Unacknowledged { active }
        } else {
            Fate::Good
        }
    }
}
