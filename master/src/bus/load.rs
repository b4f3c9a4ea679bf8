//! How full the bus will be, calculated from the frames of the protocol.
//!
//! In every SYNC period go SYNC, the group twist, and from each robot its status, measured twist,
//! pose and wheel rates, and the yaw rate of one with a gyro; besides, heartbeats. A base frame of
//! n bytes takes 44 + 8n bits and 3 between frames; stuffing adds from nothing to (34 + 8n - 1) / 4
//! bits, by its data (ISO 11898-1).
//! Parameters, emergency messages and node management come on top and are not counted: they are
//! rare while a group moves. How full it *is* a [`Meter`] says, which is shown every frame.

use std::collections::VecDeque;

use canopen::{Frame, bits};
use protocol::{
    GroupTwist, MeasuredTwist, MemberState, MemberStatus, PoseReport, Scale, WheelRateReport,
};

/// Bits a second on the wire.
pub const BIT_RATE: f64 = 1e6;
/// Heartbeats a second of each robot; see `robot`'s identity.
const HEARTBEATS: f64 = 10.0;
/// Share of the bus beyond which frames of low priority wait noticeably.
pub const BUSY: f64 = 0.70;

/// What frames take of the bus, which depends on their data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stuffing<T> {
    /// Without stuffing.
    pub none: T,
    /// With as much stuffing as can be.
    pub most: T,
}

/// Bits of a frame with `bytes` of data.
#[must_use]
pub fn frame_bits(bytes: usize) -> Stuffing<u32> {
    let data = 8 * u32::try_from(bytes).unwrap_or(8);
    let none = 44 + data + 3;
    Stuffing {
        none,
        most: none + (34 + data - 1) / 4,
    }
}

/// One kind of frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Traffic {
    /// What it is.
    pub name: &'static str,
    /// Bytes of data.
    pub bytes: usize,
    /// Frames a second on the whole bus.
    pub rate_hz: f64,
}

impl Traffic {
    /// Share of the bus.
    #[must_use]
    pub fn share(&self) -> Stuffing<f64> {
        let bits = frame_bits(self.bytes);
        let share = |bits: u32| f64::from(bits) * self.rate_hz / BIT_RATE;
        Stuffing {
            none: share(bits.none),
            most: share(bits.most),
        }
    }
}

/// The load of a bus with `robots` robots, of which `gyros` have one, and `rate_hz` SYNCs per
/// second.
#[must_use]
pub fn traffic(robots: u8, gyros: u8, rate_hz: f64) -> Vec<Traffic> {
    let each = rate_hz * f64::from(robots);
    let line = |name, bytes, rate_hz| Traffic {
        name,
        bytes,
        rate_hz,
    };
    let nothing = kinematics::Twist::default();
    let setpoint = GroupTwist {
        twist: nothing,
        sequence: 0,
        group: 0,
    };
    let status = MemberStatus {
        state: MemberState::Ready,
        sequence: 0,
        scale: Scale::ONE,
        slip_residual: None,
        code: protocol::Code::None,
        plan: 0,
    };
    let measured = MeasuredTwist {
        twist: nothing,
        sequence: 0,
        group: 0,
    };
    let pose = PoseReport {
        pose: kinematics::Pose::new(0.0, 0.0, 0.0),
    };
    let rates = WheelRateReport {
        rates: kinematics::WheelRates::ZERO,
    };
    let mut all = vec![
        line("SYNC", 1, rate_hz),
        line("group twist", setpoint.encode().len(), rate_hz),
        line("member status", status.encode().len(), each),
        line("measured twist", measured.encode().len(), each),
        line("pose", pose.encode().len(), each),
        line("wheel rates", rates.encode().len(), each),
        line("heartbeats", 1, HEARTBEATS * f64::from(robots + 1)),
    ];
    if gyros > 0 {
        // State of the gyro and its rate, objects 0x2132:1 and :2.
        let bytes = size_of::<u8>() + size_of::<f32>();
        all.push(line("yaw rate", bytes, rate_hz * f64::from(gyros)));
    }
    all
}

/// Share of the bus of all of it together.
#[must_use]
pub fn total(traffic: &[Traffic]) -> Stuffing<f64> {
    let shares = traffic.iter().map(Traffic::share);
    shares.fold(Stuffing::default(), |sum, share| Stuffing {
        none: sum.none + share.none,
        most: sum.most + share.most,
    })
}

/// Time over which a [`Meter`] averages, in s.
const WINDOW: f64 = 0.1;

/// Adds up the bits of frames over the last 100 ms.
#[derive(Clone, Debug, Default)]
pub struct Meter {
    /// Time and bits of the frames in the window.
    recent: VecDeque<(f64, u32)>,
}

impl Meter {
    /// Notes a frame that was on the bus at `t`, in s.
    pub fn record(&mut self, t: f64, frame: &Frame) {
        let bits = bits::frame_bits(frame) + bits::INTERMISSION;
        self.recent.push_back((t, bits));
        while self.recent.front().is_some_and(|(at, _)| t - at > WINDOW) {
            self.recent.pop_front();
        }
    }

    /// Share of the time that the bus was taken in the window before `t`.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "a share of one")]
    pub fn share(&self, t: f64) -> f32 {
        let recent = self.recent.iter().filter(|(at, _)| t - at <= WINDOW);
        let bits: u32 = recent.map(|(_, bits)| *bits).sum();
        (f64::from(bits) / (BIT_RATE * WINDOW)) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ISO 11898-1: 8 bytes take 108 bits and 3 between frames, at most 24 stuffed; no data 44, 3
    /// and 8.
    #[test]
    fn frame_lengths_of_the_standard() {
        assert_eq!((frame_bits(8).none, frame_bits(8).most), (111, 135));
        assert_eq!((frame_bits(0).none, frame_bits(0).most), (47, 55));
    }

    /// A sum of no floats is -0.0, which JSON prints.
    #[test]
    fn a_silent_bus_has_a_load_of_plus_zero() {
        let share = Meter::default().share(1.0);
        assert_eq!(share.to_bits(), 0, "{share:?}");
    }

    /// By hand, at 100 Hz with 3 robots: 12 + 1 frames of 8 bytes and one of 1, 40 heartbeats of 1
    /// byte a second.
    #[test]
    fn three_robots_at_100_hz() {
        let load = total(&traffic(3, 0, 100.0));
        let plain = (13.0 * 111.0 + 55.0) * 100.0 + 40.0 * 55.0;
        assert!((load.none - plain / 1e6).abs() < 1e-9, "{load:?}");
        let stuffed = (13.0 * 135.0 + 65.0) * 100.0 + 40.0 * 65.0;
        assert!((load.most - stuffed / 1e6).abs() < 1e-9, "{load:?}");
        // Two of them with a gyro, 5 bytes: 84 bits and 3, at most 18 stuffed.
        let more = total(&traffic(3, 2, 100.0));
        assert!((more.none - load.none - 200.0 * 87.0 / 1e6).abs() < 1e-9);
        assert!((more.most - load.most - 200.0 * 105.0 / 1e6).abs() < 1e-9);
    }
}
