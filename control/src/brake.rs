//! The holding brake and its times to release and to engage.
//!
//! A spring-applied brake takes 30 to 150 ms to release and as long to engage. During these times
//! the loops hold the wheels at zero: the motors carry a load on a slope until the brake holds it,
//! and while the brake is still closed no setpoint is followed and no wheel is checked.

use crate::time::Micros;

/// What a brake takes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct BrakeTimes {
    /// To release, us.
    pub release_us: u64,
    /// To engage, us.
    pub engage_us: u64,
}

/// The holding brake of a robot. Engaged without power.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum Brake {
    /// It has been engaged for longer than its time, or no time is configured.
    #[default]
    Engaged,
    /// Released at this time.
    Released(Micros),
    /// Engaged at this time, with the drivers on until it holds.
    Engaging(Micros),
}

impl Brake {
    /// Asks for the brake to be released, also one that is engaging; says whether it has let go.
    #[inline]
    pub(crate) fn release(&mut self, now: Micros, times: BrakeTimes) -> bool {
        if times.release_us == 0 && self.is_released() {
            return true;
        }
        self.waits_to_release(now, times)
    }

    /// The same, for a brake that takes time or was not released before.
    #[cold]
    fn waits_to_release(&mut self, now: Micros, times: BrakeTimes) -> bool {
        if !self.is_released() {
            *self = Self::Released(now);
        }
        self.has_let_go(now, times)
    }

    /// Whether it has had its time since it was released.
    pub(crate) fn has_let_go(self, now: Micros, times: BrakeTimes) -> bool {
        match self {
            Self::Released(since) => now.since(since).0 >= times.release_us,
            Self::Engaged | Self::Engaging(_) => false,
        }
    }

    /// Asks for the brake to be engaged; says whether it holds.
    pub(crate) fn engage(&mut self, now: Micros, times: BrakeTimes) -> bool {
        let since = match *self {
            Self::Engaging(since) => since,
            Self::Released(_) => {
                *self = Self::Engaging(now);
                now
            }
            Self::Engaged => return true,
        };
        now.since(since).0 >= times.engage_us
    }

    /// Whether it gets power.
    pub(crate) const fn is_released(self) -> bool {
        matches!(self, Self::Released(_))
    }

    /// Whether the drivers hold the load.
    pub(crate) const fn is_held_by_drivers(self) -> bool {
        matches!(self, Self::Released(_) | Self::Engaging(_))
    }
}
