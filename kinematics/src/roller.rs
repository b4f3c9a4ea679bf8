//! The effect of a finite number of rollers on a wheel.
//!
//! Between two roller transitions the ground roller swings with the wheel, by up to pi/n either
//! way. Seen from above its axle is then at `tan(gamma') = tan(gamma) cos(sweep)`, so sideways
//! motion per wheel angle shrinks with `cos(sweep)`: on average by `sin(pi/n)/(pi/n)`, 2.55 % at
//! eight rollers, with a ripple between `cos(pi/n)` and 1, n times a wheel turn. Straight motion is
//! not affected. The point of contact wanders along the wheel's axle as well, which changes the
//! wheel's lever arm.
//!
//! This is geometry, not slip: it can be computed from the wheel's angle, by a simulator that
//! models it or by a controller that corrects it.

use crate::arithmetic::{Real, SMALL_TURN};
use crate::error::GeometryError;
use crate::wheel::Wheel;

/// The rollers of a wheel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rollers<S = f32> {
    count: S,
    pitch: S,
}

impl<S: Real> Rollers<S> {
    /// This many rollers, evenly spaced, each handing over to the next without a gap.
    ///
    /// # Errors
    ///
    /// [`GeometryError::NotPositive`] for fewer than three rollers.
    ///
    /// ```
    /// let eight = mecanum_kinematics::Rollers::<f64>::new(8)?;
    /// assert!((eight.mean_lateral_ratio() - 0.9745).abs() < 5e-5);
    /// assert!((eight.least_lateral_ratio() - 0.9239).abs() < 5e-5);
    /// # Ok::<(), mecanum_kinematics::GeometryError>(())
    /// ```
    pub fn new(count: u16) -> Result<Self, GeometryError> {
        if count < 3 {
            return Err(GeometryError::NotPositive("rollers - 2"));
        }
        let count = S::constant(f64::from(count));
        Ok(Self {
            count,
            pitch: S::two_pi() / count,
        })
    }

    /// Angle from one roller to the next, rad.
    #[must_use]
    pub const fn pitch(&self) -> S {
        self.pitch
    }

    /// How far the wheel has rolled on since the middle of its ground roller stood lowest, within ±
    /// half a pitch, rad. `wheel_angle` counts forward rolling positive; `phase` is the sweep at
    /// angle 0. An angle of many turns has few digits left: an `f32` is good to a thousandth of a
    /// roller for about 400 turns.
    #[must_use]
    pub fn sweep(&self, wheel_angle: S, phase: S) -> S {
        let angle = wheel_angle + phase;
        angle - (angle / self.pitch).round() * self.pitch
    }

    /// Lateral motion per wheel angle at this sweep, relative to a wheel of infinitely many
    /// rollers.
    #[must_use]
    pub fn lateral_ratio(&self, sweep: S) -> S {
        let (_, cos) = sweep.sine_cosine();
        cos
    }

    /// The mean of that over whole rollers, `sin(pi/n)/(pi/n)`, as a wheel that turns evenly
    /// averages it.
    #[must_use]
    pub fn mean_lateral_ratio(&self) -> S {
        let half = S::pi() / self.count;
        let (sin, _) = half.sine_cosine();
        sin / half
    }

    /// Its minimum, `cos(pi/n)`, at the roller transition.
    #[must_use]
    pub fn least_lateral_ratio(&self) -> S {
        let (_, cos) = (S::pi() / self.count).sine_cosine();
        cos
    }

    /// How far sideways a wheel rolls while it turns from angle 0, over what it would with
    /// infinitely many rollers, as a wheel angle, rad: the integral of [`Rollers::lateral_ratio`],
    /// in closed form, over any number of rollers.
    #[must_use]
    pub fn lateral_travel(&self, wheel_angle: S, phase: S) -> S {
        let since_middle = |angle: S| {
            let whole = (angle / self.pitch).round();
            let (sin, _) = (angle - whole * self.pitch).sine_cosine();
            whole * self.pitch * self.mean_lateral_ratio() + sin
        };
        since_middle(wheel_angle + phase) - since_middle(phase)
    }

    /// The mean lateral ratio between two wheel angles, rad; the ratio itself when they are equal.
    ///
    /// Good to 1e-6 in `f32` for angles of a turn or so, however small the turn between them: it is
    /// the mean over the parts of each roller, by their length, and not the difference of two
    /// travels.
    #[must_use]
    pub fn mean_lateral_ratio_between(&self, from: S, to: S, phase: S) -> S {
        let (from, to) = if to < from { (to, from) } else { (from, to) };
        let roller = |angle: S| ((angle + phase) / self.pitch).round();
        let transitions = roller(to) - roller(from);
        let (start, end) = (self.sweep(from, phase), self.sweep(to, phase));
        let two = S::constant(2.0);
        if transitions == S::ZERO {
            return mean_cosine((start + end) / two, (to - from) / two);
        }
        let edge = self.pitch / two;
        // Rounding may have put a sweep a little beyond its roller's end.
        let before = (edge - start).max(S::ZERO);
        let after = (end + edge).max(S::ZERO);
        let whole = (transitions - S::ONE) * self.pitch;
        let length = before + after + whole;
        if length == S::ZERO {
            return self.least_lateral_ratio();
        }
        let first = mean_cosine(edge - before / two, before / two);
        let last = mean_cosine(after / two - edge, after / two);
        (first * before + last * after + self.mean_lateral_ratio() * whole) / length
    }

    /// By how much the lateral ratio at this sweep is above its mean, relative: what a ripple
    /// compensation that works beside a constant coefficient must take out.
    #[must_use]
    pub fn ripple(&self, sweep: S) -> S {
        self.lateral_ratio(sweep) / self.mean_lateral_ratio() - S::ONE
    }
}

/// Mean of the cosine from `half` before the middle to `half` after it.
fn mean_cosine<S: Real>(middle: S, half: S) -> S {
    let (_, cos) = middle.sine_cosine();
    let chord = if half < S::constant(SMALL_TURN) {
        half.small_chord().along
    } else {
        let (sin, _) = half.sine_cosine();
        sin / half
    };
    cos * chord
}

impl<S: Real> Wheel<S> {
    /// The ideal wheel that this one equals at a sweep (rad) of its ground roller: its roller angle
    /// seen from above, its centre moved along its axle to where the ground is touched.
    ///
    /// `axle_distance` (m) is from the wheel's axle to the middle of a roller's: the wheel's radius
    /// less the roller's. Zero leaves the point of contact where it is.
    ///
    /// # Errors
    ///
    /// [`GeometryError::RollerAngle`] for a sweep of 90 degrees or more, which no wheel has: there
    /// the roller's axle is seen along the direction of rolling. [`GeometryError::NotFinite`] for a
    /// sweep or an axle distance that is no finite number.
    pub fn swept(&self, sweep: S, axle_distance: S) -> Result<Self, GeometryError> {
        if !sweep.is_finite() {
            return Err(GeometryError::NotFinite("sweep"));
        }
        if sweep.abs() >= S::frac_pi_2() {
            return Err(GeometryError::RollerAngle);
        }
        let (sin, cos) = sweep.sine_cosine();
        let (sin_roller, cos_roller) = self.roller_angle().sine_cosine();
        let seen = (sin_roller * cos).atan2(cos_roller);
        // The lowest point lies where the roller's axle crosses below the wheel's: rolled forward,
        // a roller that points left and back (positive angle) is crossed further right.
        let left = -axle_distance * sin / cos * cos_roller / sin_roller;
        let (ahead_y, ahead_x) = self.mounting_angle().sine_cosine();
        let wheel = Self::new(
            self.x() - ahead_y * left,
            self.y() + ahead_x * left,
            self.mounting_angle(),
            seen,
            self.radius(),
        )?;
        Ok(if self.is_reversed() {
            wheel.reversed()
        } else {
            wheel
        })
    }
}
