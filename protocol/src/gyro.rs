//! What a robot says about its gyro.

/// Whether a robot's gyro is used, and if not, why: object 0x2132:1.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[repr(u8)]
pub enum GyroState {
    /// The board has none.
    #[default]
    None = 0,
    /// Its bias is not known yet: the robot has not stood still for a second.
    Starting = 1,
    /// The odometry takes turns from it.
    InUse = 2,
    /// It does not answer, or another chip does.
    Missing = 3,
    /// It repeats one value.
    Stuck = 4,
    /// Its values jump, or are at the end of its range.
    Implausible = 5,
    /// It was there, and its driver has no samples any more.
    Silent = 6,
}

impl GyroState {
    /// Every state, by its number.
    pub const ALL: [Self; 7] = [
        Self::None,
        Self::Starting,
        Self::InUse,
        Self::Missing,
        Self::Stuck,
        Self::Implausible,
        Self::Silent,
    ];

    /// The one with this number.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// There is a gyro, and it is not believed.
    #[must_use]
    pub const fn has_failed(self) -> bool {
        matches!(
            self,
            Self::Missing | Self::Stuck | Self::Implausible | Self::Silent
        )
    }

    /// In words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Starting => "waits for rest",
            Self::InUse => "in use",
            Self::Missing => "missing",
            Self::Stuck => "stuck",
            Self::Implausible => "implausible",
            Self::Silent => "silent",
        }
    }
}
