//! Times that both ends of the bus go by. Each stands here and nowhere else; those that can be set
//! are objects of the [`table`](crate::table).
//!
//! Robots and master both work out how long the members of a group need to agree on a setpoint
//! ([`agreement_delay_us`]); object 0x2041:5 says so, and every member's checksum covers it.

use crate::MASTER;

/// Period of every heartbeat, the master's and the robots', ms.
pub const HEARTBEAT_MS: u16 = 100;

/// The bit rate of the bus, 1/s.
pub const BIT_RATE: u32 = 1_000_000;

/// Longest data frame with an 11-bit identifier, the space behind it included, bits: 44 bits
/// around eight bytes, 3 of space, and a stuff bit after every fourth of the 98 bits up to the
/// checksum's end but the first (ISO 11898-1 10.5).
pub const LONGEST_FRAME_BITS: u32 = 44 + 64 + 3 + (98 - 1) / 4;

/// How long before its SYNC a setpoint goes out, us: longer than a frame of USB, which would hand
/// both to the adapter at once, and a controller with several mailboxes sends SYNC first.
pub const SETPOINT_LEAD_US: u32 = 1_250;

/// Longest time from the end of SYNC to a robot's vote in a mailbox of its CAN controller, us.
pub(crate) const RESPONSE_US: u32 = 150;

/// Longest time from the end of the last vote to a command that the next control tick reads, us.
pub(crate) const DECISION_US: u32 = 150;

/// How much later than its mean a SYNC may come without a member acting late, us.
pub const SYNC_ALLOWANCE_US: u32 = 600;

/// Control ticks come half a millisecond after whole ones since SYNC. What is to act at a tick is
/// due this long after a whole millisecond: 200 us before the tick, which is more than SYNC's
/// jitter makes ticks lag behind their grid.
const PHASE_US: u32 = 300;
const TICK_US: u32 = 1_000;

/// How long after SYNC the last vote of members up to node `highest` is known in all of them, us.
///
/// SYNC makes all robots vote. The votes go out by node number; those of every lower node come
/// first, whether it is of this group or of another one on the same bus. Before them may come a
/// frame that is already on the wire, and one of higher priority (a setpoint, an NMT command or an
/// emergency message). Each is as long as a frame can be.
#[must_use]
pub const fn votes_known_us(highest: u32, bit_rate: u32) -> u32 {
    let votes = highest.saturating_sub(MASTER as u32);
    let bits = (votes + 2) * LONGEST_FRAME_BITS;
    RESPONSE_US + (bits * 1_000).div_ceil(bit_rate / 1_000) + DECISION_US
}

/// How long after SYNC the setpoint latched there takes effect, us: the first control tick by which
/// the votes are known in all members, with an allowance for SYNC that comes late. `members` is a
/// mask of nodes. Short of that by less than the allowance where the period is too short for it;
/// `None` where the votes themselves do not fit.
#[must_use]
pub const fn agreement_delay_us(members: u32, period_us: u32, bit_rate: u32) -> Option<u32> {
    let known = if members.count_ones() > 1 {
        let highest = u32::BITS - 1 - members.leading_zeros();
        votes_known_us(highest, bit_rate)
    } else {
        RESPONSE_US + DECISION_US
    };
    let latest = latest_delay_us(period_us);
    let wanted = (known + SYNC_ALLOWANCE_US).saturating_sub(PHASE_US);
    let delay = PHASE_US + wanted.div_ceil(TICK_US) * TICK_US;
    if delay <= latest {
        Some(delay)
    } else if known <= latest {
        Some(latest)
    } else {
        None
    }
}

/// The longest delay of the agreement that a SYNC period leaves, us: a setpoint takes effect before
/// the next SYNC.
#[must_use]
pub const fn latest_delay_us(period_us: u32) -> u32 {
    period_us.saturating_sub(TICK_US - PHASE_US)
}

/// How long after the SYNC that latches it a setpoint is reached, us: the members pass to it evenly
/// over one period.
#[must_use]
pub const fn reached_after_us(period_us: u32, agreement_delay_us: u32) -> u32 {
    period_us + agreement_delay_us
}

/// SYNC's counter runs from 1 to this (object 0x1019).
pub const SYNC_OVERFLOW: u8 = 240;

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u32 = 10_000;

    /// A mask of so many robots from node 2 on.
    fn row(robots: u32) -> u32 {
        ((1 << robots) - 1) << 2
    }

    /// A data frame of eight bytes has 98 bits that are stuffed and 13 that are not; of a sequence
    /// of equal bits the first stuff bit comes after five, each further one after four.
    #[test]
    fn a_frame_has_135_bits_at_most() {
        assert_eq!(LONGEST_FRAME_BITS, 98 + 13 + 24);
    }

    /// Ten frames of 135 us for eight robots, 18 for sixteen, twice and four times that on slower
    /// buses.
    #[test]
    fn votes_take_their_bits() {
        assert_eq!(votes_known_us(9, 1_000_000), 300 + 1_350);
        assert_eq!(votes_known_us(17, 1_000_000), 300 + 2_430);
        assert_eq!(votes_known_us(9, 500_000), 300 + 2_700);
        assert_eq!(votes_known_us(9, 250_000), 300 + 5_400);
    }

    #[test]
    fn the_delay_is_the_smallest_that_fits_the_members() {
        let delay = |robots, period| agreement_delay_us(row(robots), period, BIT_RATE);
        let expected = [(1, 1_300), (2, 2_300), (8, 2_300), (9, 3_300), (16, 4_300)];
        for (robots, us) in expected {
            assert_eq!(delay(robots, PERIOD), Some(us), "{robots}");
            assert_eq!(delay(robots, 20_000), Some(us), "{robots}");
        }
        // At 200 Hz sixteen still fit with the allowance.
        assert_eq!(delay(16, 5_000), Some(4_300));
        // At 500 Hz two have 0.46 ms of it left, and for eight there is no time.
        assert_eq!(delay(2, 2_000), Some(1_300));
        assert_eq!(delay(8, 2_000), None);
        // A slower bus.
        assert_eq!(agreement_delay_us(row(8), PERIOD, 500_000), Some(4_300));
        assert_eq!(agreement_delay_us(row(8), PERIOD, 250_000), Some(6_300));
    }

    /// Robots of other groups on the bus vote, too: those of lower nodes before these.
    #[test]
    fn lower_nodes_of_other_groups_count() {
        let two = 1 << 16 | 1 << 17;
        assert_eq!(agreement_delay_us(two, PERIOD, BIT_RATE), Some(4_300));
    }

    /// A member later than the delay minus the allowance is later than the bits explain.
    #[test]
    fn every_delay_leaves_time_for_the_votes_and_before_the_next_sync() {
        for highest in 3..18 {
            for period in (2..100).map(|ms| ms * 1_000) {
                let Some(delay) = agreement_delay_us(1 << 2 | 1 << highest, period, BIT_RATE)
                else {
                    continue;
                };
                assert!(delay >= votes_known_us(highest, BIT_RATE));
                assert!(delay < period);
            }
        }
    }
}
