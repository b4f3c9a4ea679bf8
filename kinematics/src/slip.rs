//! Identification of a slipping wheel.
//!
//! N wheels measure three velocities, so N - 3 combinations of their rates must be zero, and a
//! wheel that slips disturbs them in its own pattern. With five or more wheels the pattern usually
//! identifies the wheel. With four there is only one combination: it shows that a wheel slips, but
//! not which one; then the commanded rates are also needed.

use crate::arithmetic::Real;
use crate::frame::Twist;
use crate::platform::Platform;

/// What the wheel rates say about slip.
///
/// ```
/// use mecanum_kinematics::{FourWheelGeometry, Platform, Suspect, Twist};
///
/// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 0.785_f64)?;
/// let platform = Platform::new(&robot.wheels()?)?;
/// let asked = Twist::new(0.5, 0.0, 0.0);
/// let mut rates = platform.rates(asked);
/// rates[2] = 0.0; // rear left stands
/// assert_eq!(platform.suspect(&rates, 0.1), Suspect::Unclear); // something is wrong
/// let found = platform.suspect_against(asked, &rates, 0.1);
/// assert!(matches!(found, Suspect::Wheel { index: 2, .. }));
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Suspect<S = f32> {
    /// Nothing beyond the threshold.
    None,
    /// One wheel explains what is seen.
    Wheel {
        /// Which, counted from 0 in the platform's order.
        index: usize,
        /// By how much it turns faster than the motion of the others explains, rad/s.
        excess: S,
    },
    /// Something is wrong that no single wheel explains, or that more than one wheel might.
    Unclear,
}

impl<const N: usize, S: Real> Platform<N, S> {
    /// Finds the wheel that slips, or whose encoder is dead, from the measured rates alone (rad/s).
    ///
    /// `threshold` (rad/s) is what noise may leave. Needs five wheels or more to name one: fewer
    /// yield [`Suspect::Unclear`].
    #[must_use]
    pub fn suspect(&self, rates: &[S; N], threshold: S) -> Suspect<S> {
        let seen = self.residual(rates);
        if norm(&seen) <= threshold {
            return Suspect::None;
        }
        let mut suspect = Suspect::Unclear;
        let mut candidates = 0;
        for index in 0..N {
            // What one rad/s of excess of this wheel alone would leave.
            let mut alone = [S::ZERO; N];
            if let Some(rate) = alone.get_mut(index) {
                *rate = S::ONE;
            }
            let pattern = self.residual(&alone);
            let strength = product(&pattern, &pattern);
            if strength <= S::constant(1e-6) {
                continue;
            }
            let excess = product(&pattern, &seen) / strength;
            let mut rest = seen;
            for (rest, pattern) in rest.iter_mut().zip(pattern) {
                *rest -= excess * pattern;
            }
            if norm(&rest) <= threshold {
                candidates += 1;
                suspect = Suspect::Wheel { index, excess };
            }
        }
        if candidates == 1 {
            suspect
        } else {
            Suspect::Unclear
        }
    }

    /// Finds the wheel that does not follow its command: dead, blocked or spinning freely. Works
    /// for any number of wheels.
    ///
    /// `asked` is the twist the wheels were asked for (robot frame, compensated), `threshold`
    /// (rad/s) what control error and noise may leave on a healthy wheel.
    #[must_use]
    pub fn suspect_against(&self, asked: Twist<S>, rates: &[S; N], threshold: S) -> Suspect<S> {
        let wanted = self.rates(asked);
        let mut suspect = Suspect::None;
        for (index, (rate, wanted)) in rates.iter().zip(wanted).enumerate() {
            let excess = *rate - wanted;
            let healthy = excess.abs() <= threshold;
            if healthy {
                continue;
            }
            if suspect != Suspect::None {
                return Suspect::Unclear;
            }
            suspect = Suspect::Wheel { index, excess };
        }
        suspect
    }
}

fn product<const N: usize, S: Real>(a: &[S; N], b: &[S; N]) -> S {
    a.iter().zip(b).fold(S::ZERO, |sum, (a, b)| sum + *a * *b)
}

fn norm<const N: usize, S: Real>(a: &[S; N]) -> S {
    product(a, a).root()
}
