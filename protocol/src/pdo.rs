//! The eight bytes of every process data frame.
//!
//! | frame | bytes 0-1 | 2-3 | 4-5 | 6 | 7 |
//! |---|---|---|---|---|---|
//! | [`GroupTwist`] (also the commissioning twist) | vx i16 | vy i16 | omega i16 | sequence u8 | group u8 |
//! | [`MemberStatus`] | state u8, sequence u8 | scale u16 | slip residual i16 | code u16 | |
//! | [`MeasuredTwist`] | vx i16 | vy i16 | omega i16 | sequence u8 | group u8 |
//! | [`PoseReport`] | x i24 (bytes 0-2) | y i24 (3-5) | heading i16 (6-7) | | |
//! | [`WheelRateReport`] | front left i16 | front right i16 | rear left i16 | rear right i16 | |
//! | [`YawRateReport`] | state of the gyro u8 (byte 0) | yaw rate f32 (1-4) | | | |
//!
//! Little-endian throughout, scaled as [`crate::scaling`] says. All frames but the last are exactly
//! eight bytes, that is five: a shorter one is refused, not padded, since a missing byte means
//! another layout.

use kinematics::{Pose, Twist, WheelRates};

use crate::code::Code;
use crate::gyro::GyroState;
use crate::scaling::{
    HEADING_STEPS, POSITION_STEPS, SLIP_STEPS, VELOCITY_STEPS, WHEEL_RATE_STEPS, YAW_RATE_STEPS,
    decode_i16, decode_i24, decode_magnitude, encode_i16, encode_i24, encode_magnitude,
    i24_from_bytes, i24_to_bytes,
};

/// Why eight bytes are not the frame they should be.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DecodeError {
    /// The frame has this many bytes instead of eight, or of five where its name is YawRate.
    Length(usize),
    /// The named field is marked invalid.
    Invalid(&'static str),
    /// The state byte, of a member or of its gyro, is none this version knows.
    State(u8),
    /// The code is none this version knows.
    Code(u16),
}

impl core::fmt::Display for DecodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Length(length) => write!(f, "{length} bytes are not the length of this frame"),
            Self::Invalid(field) => write!(f, "field {field} is marked invalid"),
            Self::State(state) => write!(f, "unknown state {state}"),
            Self::Code(code) => write!(f, "unknown limit or fault code {code:#06x}"),
        }
    }
}

impl core::error::Error for DecodeError {}

fn eight(data: &[u8]) -> Result<[u8; 8], DecodeError> {
    data.try_into().map_err(|_| DecodeError::Length(data.len()))
}

/// The commanded velocity of all members, in the group frame; or, on the commissioning identifier,
/// the velocity of one robot alone in its own frame.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct GroupTwist {
    /// m/s, m/s, rad/s; REP-103.
    pub twist: Twist,
    /// Goes up by one with every new setpoint, wrapping.
    pub sequence: u8,
    /// The group that is meant; others do not listen.
    pub group: u8,
}

fn encode_twist(twist: Twist, sequence: u8, group: u8) -> [u8; 8] {
    let [a, b] = encode_i16(twist.vx, VELOCITY_STEPS).to_le_bytes();
    let [c, d] = encode_i16(twist.vy, VELOCITY_STEPS).to_le_bytes();
    let [e, f] = encode_i16(twist.omega, YAW_RATE_STEPS).to_le_bytes();
    [a, b, c, d, e, f, sequence, group]
}

fn decode_twist(data: &[u8]) -> Result<(Twist, u8, u8), DecodeError> {
    let [a, b, c, d, e, f, sequence, group] = eight(data)?;
    let field = |low, high, steps, name| {
        decode_i16(i16::from_le_bytes([low, high]), steps).ok_or(DecodeError::Invalid(name))
    };
    let twist = Twist {
        vx: field(a, b, VELOCITY_STEPS, "vx")?,
        vy: field(c, d, VELOCITY_STEPS, "vy")?,
        omega: field(e, f, YAW_RATE_STEPS, "omega")?,
    };
    Ok((twist, sequence, group))
}

impl GroupTwist {
    /// The bytes of this frame.
    #[must_use]
    pub fn encode(&self) -> [u8; 8] {
        encode_twist(self.twist, self.sequence, self.group)
    }
}

impl TryFrom<&[u8]> for GroupTwist {
    type Error = DecodeError;

    fn try_from(data: &[u8]) -> Result<Self, DecodeError> {
        let (twist, sequence, group) = decode_twist(data)?;
        Ok(Self {
            twist,
            sequence,
            group,
        })
    }
}

/// The velocity of the group as one member measures it at its own wheels, in the group frame.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct MeasuredTwist {
    /// m/s, m/s, rad/s; REP-103.
    pub twist: Twist,
    /// Sequence of the setpoint that was in force.
    pub sequence: u8,
    /// The group this member belongs to.
    pub group: u8,
}

impl MeasuredTwist {
    /// The bytes of this frame.
    #[must_use]
    pub fn encode(&self) -> [u8; 8] {
        encode_twist(self.twist, self.sequence, self.group)
    }
}

impl TryFrom<&[u8]> for MeasuredTwist {
    type Error = DecodeError;

    fn try_from(data: &[u8]) -> Result<Self, DecodeError> {
        let (twist, sequence, group) = decode_twist(data)?;
        Ok(Self {
            twist,
            sequence,
            group,
        })
    }
}

/// What one robot is doing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub enum MemberState {
    /// The configuration is incomplete or invalid; outputs off.
    Unconfigured = 0,
    /// Configured, not started; outputs off, brake engaged.
    Ready = 1,
    /// Started, drivers on, standing, waiting for a new setpoint all members agree on.
    Armed = 2,
    /// Following the group twist.
    Moving = 3,
    /// Following a commissioning twist of its own.
    Alone = 4,
    /// Ramping down to standstill.
    Ramping = 5,
    /// At rest with a latched fault; outputs off, brake engaged.
    Faulted = 6,
}

impl MemberState {
    /// Every state, by rising number.
    pub const ALL: [Self; 7] = [
        Self::Unconfigured,
        Self::Ready,
        Self::Armed,
        Self::Moving,
        Self::Alone,
        Self::Ramping,
        Self::Faulted,
    ];

    /// True when a member in this state follows, or is able to follow, the group twist.
    #[must_use]
    pub const fn can_follow(self) -> bool {
        matches!(self, Self::Armed | Self::Moving)
    }
}

impl TryFrom<u8> for MemberState {
    type Error = DecodeError;

    fn try_from(raw: u8) -> Result<Self, DecodeError> {
        Ok(match raw {
            0 => Self::Unconfigured,
            1 => Self::Ready,
            2 => Self::Armed,
            3 => Self::Moving,
            4 => Self::Alone,
            5 => Self::Ramping,
            6 => Self::Faulted,
            unknown => return Err(DecodeError::State(unknown)),
        })
    }
}

/// A factor 0 to 1 for the whole group, as it is on the wire: 65535 is 1.
///
/// Members compare these integers, never their own unrounded floats, so that all of them come to
/// the same smallest value.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default)]
pub struct Scale(pub u16);

impl Scale {
    /// Do not move.
    pub const ZERO: Self = Self(0);
    /// Move as asked.
    pub const ONE: Self = Self(u16::MAX);

    /// The nearest step to a factor; below 0 and NaN is zero, above 1 is one. A factor above zero
    /// is never rounded to zero, because zero means "stop".
    #[must_use]
    pub fn new(factor: f32) -> Self {
        if factor.is_nan() || factor <= 0.0 {
            return Self::ZERO;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "positive here, and saturating is what is wanted"
        )]
        let steps = (factor * f32::from(u16::MAX) + 0.5) as u16;
        Self(steps.max(1))
    }

    /// The factor, 0 to 1.
    #[must_use]
    pub fn factor(self) -> f32 {
        f32::from(self.0) / f32::from(u16::MAX)
    }
}

/// What every member tells all others and the master at every SYNC.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct MemberStatus {
    /// What it is doing.
    pub state: MemberState,
    /// Sequence of the setpoint it latched at this SYNC.
    pub sequence: u8,
    /// The scale at which its own wheels can follow that setpoint; zero stops the group.
    pub scale: Scale,
    /// Magnitude of the wheel rates that no rigid motion explains, rad/s; `None` when not measured.
    pub slip_residual: Option<f32>,
    /// The most important limit or fault.
    pub code: Code,
    /// Checksum over what this member is about to do, see [`crate::Plan`]; members that differ stop
    /// the group.
    pub plan: u8,
}

impl MemberStatus {
    /// The bytes of this frame.
    #[must_use]
    pub fn encode(&self) -> [u8; 8] {
        let [scale_low, scale_high] = self.scale.0.to_le_bytes();
        let [code_low, code_high] = self.code.code().to_le_bytes();
        [
            self.state as u8,
            self.sequence,
            scale_low,
            scale_high,
            encode_magnitude(self.slip_residual.unwrap_or(f32::NAN), SLIP_STEPS),
            code_low,
            code_high,
            self.plan,
        ]
    }
}

impl TryFrom<&[u8]> for MemberStatus {
    type Error = DecodeError;

    fn try_from(data: &[u8]) -> Result<Self, DecodeError> {
        let [state, sequence, a, b, slip, c, d, plan] = eight(data)?;
        let code = u16::from_le_bytes([c, d]);
        Ok(Self {
            state: MemberState::try_from(state)?,
            sequence,
            scale: Scale(u16::from_le_bytes([a, b])),
            slip_residual: decode_magnitude(slip, SLIP_STEPS),
            code: Code::from_code(code).ok_or(DecodeError::Code(code))?,
            plan,
        })
    }
}

/// Pose of the *group frame* as this member's wheels say, from where it was configured.
///
/// All members of a rigid group report the same pose; the pose of a robot is this composed with its
/// mount.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct PoseReport {
    /// m, m, rad (heading within +-pi).
    pub pose: Pose,
}

impl PoseReport {
    /// The bytes of this frame.
    #[must_use]
    pub fn encode(&self) -> [u8; 8] {
        let [a, b, c] = i24_to_bytes(encode_i24(self.pose.x, POSITION_STEPS));
        let [d, e, f] = i24_to_bytes(encode_i24(self.pose.y, POSITION_STEPS));
        let [g, h] = encode_i16(self.pose.heading, HEADING_STEPS).to_le_bytes();
        [a, b, c, d, e, f, g, h]
    }
}

impl TryFrom<&[u8]> for PoseReport {
    type Error = DecodeError;

    fn try_from(data: &[u8]) -> Result<Self, DecodeError> {
        let [a, b, c, d, e, f, g, h] = eight(data)?;
        let position = |bytes, name| {
            decode_i24(i24_from_bytes(bytes), POSITION_STEPS).ok_or(DecodeError::Invalid(name))
        };
        Ok(Self {
            pose: Pose {
                x: position([a, b, c], "x")?,
                y: position([d, e, f], "y")?,
                heading: decode_i16(i16::from_le_bytes([g, h]), HEADING_STEPS)
                    .ok_or(DecodeError::Invalid("heading"))?,
            },
        })
    }
}

/// Measured wheel rates of one robot.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct WheelRateReport {
    /// rad/s; positive rolls the base forward.
    pub rates: WheelRates,
}

impl WheelRateReport {
    /// The bytes of this frame.
    #[must_use]
    pub fn encode(&self) -> [u8; 8] {
        let field = |rate| encode_i16(rate, WHEEL_RATE_STEPS).to_le_bytes();
        let [a, b] = field(self.rates.front_left);
        let [c, d] = field(self.rates.front_right);
        let [e, f] = field(self.rates.rear_left);
        let [g, h] = field(self.rates.rear_right);
        [a, b, c, d, e, f, g, h]
    }
}

impl TryFrom<&[u8]> for WheelRateReport {
    type Error = DecodeError;

    fn try_from(data: &[u8]) -> Result<Self, DecodeError> {
        let [a, b, c, d, e, f, g, h] = eight(data)?;
        let field = |low, high, name| {
            decode_i16(i16::from_le_bytes([low, high]), WHEEL_RATE_STEPS)
                .ok_or(DecodeError::Invalid(name))
        };
        Ok(Self {
            rates: WheelRates {
                front_left: field(a, b, "front_left")?,
                front_right: field(c, d, "front_right")?,
                rear_left: field(e, f, "rear_left")?,
                rear_right: field(g, h, "rear_right")?,
            },
        })
    }
}

/// What one robot's gyro measures. The robot reads both objects when the frame is made.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct YawRateReport {
    /// Of the robot without bias, rad/s, counter-clockwise positive; `None` while the gyro is not
    /// used.
    pub yaw_rate: Option<f32>,
}

impl TryFrom<&[u8]> for YawRateReport {
    type Error = DecodeError;

    fn try_from(data: &[u8]) -> Result<Self, DecodeError> {
        let [state, rate @ ..] = data else {
            return Err(DecodeError::Length(0));
        };
        let rate = rate
            .try_into()
            .map_err(|_| DecodeError::Length(data.len()))?;
        let rate = f32::from_le_bytes(rate);
        if !rate.is_finite() {
            return Err(DecodeError::Invalid("yaw_rate"));
        }
        let state = GyroState::from_number(*state).ok_or(DecodeError::State(*state))?;
        Ok(Self {
            yaw_rate: (state == GyroState::InUse).then_some(rate),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::code::{Fault, Limit};

    /// Rounding of an f32 near 4, on top of half a step.
    const ROUNDING: f32 = 5e-7;

    #[test]
    fn golden_group_twist() {
        // 1.2345 m/s = 12345 = 0x3039, -0.5 m/s = -5000 = 0xEC78, 0.314159 rad/s -> 3142 = 0x0C46.
        let frame = GroupTwist {
            twist: Twist::new(1.2345, -0.5, 0.314_159),
            sequence: 0xA5,
            group: 7,
        };
        let bytes = [0x39, 0x30, 0x78, 0xEC, 0x46, 0x0C, 0xA5, 0x07];
        assert_eq!(frame.encode(), bytes);
        let back = GroupTwist::try_from(&bytes[..]).unwrap();
        assert_eq!((back.sequence, back.group), (0xA5, 7));
        assert!((back.twist.omega - 0.3142).abs() < ROUNDING);
    }

    #[test]
    fn golden_member_status() {
        // Half scale: 0.5 * 65535 = 32767.5 -> 32768. Slip 0.26 rad/s = 13 = 0x0D.
        let frame = MemberStatus {
            state: MemberState::Ramping,
            sequence: 9,
            scale: Scale::new(0.5),
            slip_residual: Some(0.26),
            code: Code::Fault(Fault::MasterSilent),
            plan: 0xA5,
        };
        let bytes = [0x05, 0x09, 0x00, 0x80, 0x0D, 0x30, 0x81, 0xA5];
        assert_eq!(frame.encode(), bytes);
        assert_eq!(MemberStatus::try_from(&bytes[..]), Ok(frame));
    }

    #[test]
    fn golden_member_status_without_a_measurement() {
        let frame = MemberStatus {
            state: MemberState::Moving,
            sequence: 255,
            scale: Scale::ONE,
            slip_residual: None,
            code: Code::Limit(Limit::WheelRate),
            plan: 0,
        };
        let bytes = [0x03, 0xFF, 0xFF, 0xFF, 0xFF, 0x01, 0x00, 0x00];
        assert_eq!(frame.encode(), bytes);
        assert_eq!(MemberStatus::try_from(&bytes[..]), Ok(frame));
    }

    #[test]
    fn golden_measured_twist() {
        let frame = MeasuredTwist {
            twist: Twist::new(-0.0001, 0.0, 9.9),
            sequence: 1,
            group: 1,
        };
        let bytes = [0xFF, 0xFF, 0x00, 0x00, 0xFF, 0x7F, 0x01, 0x01];
        assert_eq!(frame.encode(), bytes);
    }

    #[test]
    fn golden_pose() {
        // 12.3456 m = 123456 = 0x01E240; -1 m = -10000 = 0xFFD8F0; -pi/2 = -15708 = 0xC2A4.
        let frame = PoseReport {
            pose: Pose::new(12.3456, -1.0, -core::f32::consts::FRAC_PI_2),
        };
        let bytes = [0x40, 0xE2, 0x01, 0xF0, 0xD8, 0xFF, 0xA4, 0xC2];
        assert_eq!(frame.encode(), bytes);
        let back = PoseReport::try_from(&bytes[..]).unwrap().pose;
        assert_eq!((back.x, back.y), (12.3456, -1.0));
    }

    #[test]
    fn golden_wheel_rates() {
        // 1 rad/s = 500 = 0x01F4; -1 = 0xFE0C; 65.6 saturates at 32767; 0.002 = 1.
        let frame = WheelRateReport {
            rates: WheelRates {
                front_left: 1.0,
                front_right: -1.0,
                rear_left: 65.6,
                rear_right: 0.002,
            },
        };
        let bytes = [0xF4, 0x01, 0x0C, 0xFE, 0xFF, 0x7F, 0x01, 0x00];
        assert_eq!(frame.encode(), bytes);
    }

    #[test]
    fn golden_yaw_rate() {
        // 0.5 = 0x3F000000; state 2 is in use, 1 waits for rest.
        let bytes = [2, 0, 0, 0, 0x3F];
        let read = |bytes: &[u8]| YawRateReport::try_from(bytes).map(|said| said.yaw_rate);
        assert_eq!(read(&bytes), Ok(Some(0.5)));
        assert_eq!(read(&[1, 0, 0, 0, 0]), Ok(None));
        assert_eq!(read(&[7, 0, 0, 0, 0]), Err(DecodeError::State(7)));
        assert_eq!(read(&bytes[..4]), Err(DecodeError::Length(4)));
        assert_eq!(read(&[]), Err(DecodeError::Length(0)));
        let infinite = read(&[2, 0, 0, 0x80, 0x7F]);
        assert_eq!(infinite, Err(DecodeError::Invalid("yaw_rate")));
    }

    #[test]
    fn wrong_length_is_refused_with_the_length() {
        for length in (0..8).chain(9..12) {
            let data = [0; 12];
            let data = &data[..length];
            assert_eq!(GroupTwist::try_from(data), Err(DecodeError::Length(length)));
            assert_eq!(
                MemberStatus::try_from(data),
                Err(DecodeError::Length(length))
            );
            assert_eq!(PoseReport::try_from(data), Err(DecodeError::Length(length)));
        }
    }

    #[test]
    fn not_a_number_is_refused_by_name() {
        let frame = GroupTwist {
            twist: Twist::new(0.0, f32::NAN, 0.0),
            sequence: 0,
            group: 0,
        };
        assert_eq!(
            GroupTwist::try_from(&frame.encode()[..]),
            Err(DecodeError::Invalid("vy"))
        );
        let frame = PoseReport {
            pose: Pose::new(f32::NAN, 0.0, 0.0),
        };
        assert_eq!(
            PoseReport::try_from(&frame.encode()[..]),
            Err(DecodeError::Invalid("x"))
        );
    }

    #[test]
    fn unknown_state_and_code_are_refused() {
        let mut bytes = [0; 8];
        bytes[0] = 7;
        assert_eq!(
            MemberStatus::try_from(&bytes[..]),
            Err(DecodeError::State(7))
        );
        bytes[0] = 6;
        bytes[6] = 0x12;
        assert_eq!(
            MemberStatus::try_from(&bytes[..]),
            Err(DecodeError::Code(0x1200))
        );
        for state in MemberState::ALL {
            assert_eq!(MemberState::try_from(state as u8), Ok(state));
        }
    }

    #[test]
    fn scale_above_zero_never_becomes_the_stop() {
        assert_eq!(Scale::new(1e-9), Scale(1));
        assert_eq!(Scale::new(0.0), Scale::ZERO);
        assert_eq!(Scale::new(-1.0), Scale::ZERO);
        assert_eq!(Scale::new(f32::NAN), Scale::ZERO);
        assert_eq!(Scale::new(1.5), Scale::ONE);
        assert_eq!(Scale::ONE.factor(), 1.0);
    }

    #[test]
    fn any_eight_bytes_decode_without_panic_and_encode_back() {
        // A full-period generator instead of a random one: the same bytes every time.
        let mut word = 0x1234_5678_9ABC_DEF1_u64;
        for _ in 0..200_000 {
            word = word
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let bytes = word.to_le_bytes();
            if let Ok(frame) = GroupTwist::try_from(&bytes[..]) {
                assert_eq!(frame.encode(), bytes);
            }
            if let Ok(frame) = PoseReport::try_from(&bytes[..]) {
                // The heading exactly; far positions to one step, see `scaling`.
                assert_eq!(frame.encode()[6..], bytes[6..]);
            }
            if let Ok(frame) = WheelRateReport::try_from(&bytes[..]) {
                assert_eq!(frame.encode(), bytes);
            }
            if let Ok(frame) = MemberStatus::try_from(&bytes[..]) {
                assert_eq!(frame.encode(), bytes);
            }
        }
    }
}
