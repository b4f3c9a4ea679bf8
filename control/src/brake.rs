//! The holding brake and the time it takes.
//!
//! A spring brake takes 30 to 150 ms to let go and as long to hold. Meanwhile the loops hold the
//! wheels at zero: a load on a slope hangs on the motors until the brake has it, and nothing is
//! followed, and no wheel judged, against a brake that is still closed.

use crate::time::Micros;

/// What a brake takes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct BrakeTimes {
    /// To let go, us.
    pub release_us: u64,
    /// To hold, us.
    pub engage_us: u64,
}

/// The holding brake of a robot. Engaged without power.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum Brake {
    /// It has been engaged for long, or nobody waits for it.
    #[default]
    Engaged,
    /// Released at this time.
    Released(Micros),
    /// Engaged at this time, with the drivers on until it holds.
    Engaging(Micros),
}

impl Brake {
    /// Asks for the brake to be released, which one that is engaging ignores; says whether it has
    /// let go.
    #[inline]
    pub(crate) fn release(&mut self, now: Micros, times: BrakeTimes) -> bool {
        if times.release_us == 0 && matches!(self, Self::Released(_)) {
            return true;
        }
        self.waits_to_release(now, times)
    }

    /// The same, for a brake that takes time or was not released before.
    #[cold]
    fn waits_to_release(&mut self, now: Micros, times: BrakeTimes) -> bool {
        let since = match *self {
            Self::Released(since) => since,
            Self::Engaged => {
                *self = Self::Released(now);
                now
            }
            Self::Engaging(_) => return false,
        };
        times.release_us == 0 || now.since(since).0 >= times.release_us
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
