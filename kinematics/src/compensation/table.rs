//! Coefficients over speed, interpolated without overshoot.
//!
//! Between two rows the coefficient follows a cubic whose slopes are chosen (Fritsch and Carlson)
//! so that it never leaves the range of the two: where the rows rise, it rises. Outside the table
//! it keeps the first or last coefficient, without a kink. A table of one row is a constant.

use super::{Compensation, STEEPEST, invert};
use crate::arithmetic::Real;
use crate::error::CompensationError;
use crate::frame::Twist;

/// One axis: the coefficient over the achieved speed, in `R` rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisTable<const R: usize, S = f32> {
    rows: [Row<S>; R],
    /// Largest relative change of the coefficient per relative change of speed.
    steepness: S,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Row<S> {
    speed: S,
    coefficient: S,
    slope: S,
}

impl<const R: usize, S: Real> AxisTable<R, S> {
    /// From (achieved speed, coefficient) in rows of increasing speed; m/s or rad/s.
    ///
    /// # Errors
    ///
    /// [`CompensationError`] for an empty table, speeds that do not increase from above zero,
    /// coefficients that are not positive and finite, and coefficients that change too fast to be
    /// inverted.
    pub fn new(rows: &[(S, S); R]) -> Result<Self, CompensationError> {
        let mut before = S::ZERO;
        for (i, (speed, coefficient)) in rows.iter().enumerate() {
            if !speed.is_finite() || *speed <= before {
                return Err(CompensationError::NotIncreasing(i));
            }
            before = *speed;
            if !coefficient.is_finite() {
                return Err(CompensationError::NotFinite("coefficient"));
            }
            if *coefficient <= S::ZERO {
                return Err(CompensationError::NotPositive("coefficient"));
            }
        }
        if R == 0 {
            return Err(CompensationError::Empty);
        }
        let mut table = Self {
            rows: rows.map(|(speed, coefficient)| Row {
                speed,
                coefficient,
                slope: S::ZERO,
            }),
            steepness: S::ZERO,
        };
        let inner = table.rows;
        for (window, row) in inner.windows(3).zip(table.rows.iter_mut().skip(1)) {
            if let [before, here, after] = window {
                row.slope = slope(before, here, after);
            }
        }
        for (i, pair) in table.rows.windows(2).enumerate() {
            if let [from, to] = pair {
                let steepness =
                    steepest(from, to) * to.speed / from.coefficient.min(to.coefficient);
                if steepness > S::constant(STEEPEST) {
                    return Err(CompensationError::TooSteep(i + 1));
                }
                table.steepness = table.steepness.max(steepness);
            }
        }
        Ok(table)
    }

    /// From what was set and what was measured, as the paper's Tables 3 to 8 list it: (set speed,
    /// measured speed).
    ///
    /// # Errors
    ///
    /// As [`AxisTable::new`].
    ///
    /// ```
    /// use mecanum_kinematics::AxisTable;
    ///
    /// // The first lateral rows of the paper's Table 7.
    /// let lateral = AxisTable::from_measurements(&[
    ///     (0.100, 0.087_621),
    ///     (0.200, 0.174_193),
    ///     (0.300, 0.260_675),
    /// ])?;
    /// let coefficient: f64 = lateral.coefficient(0.174_193);
    /// assert!((coefficient - 1.148).abs() < 5e-4);
    /// # Ok::<(), mecanum_kinematics::CompensationError>(())
    /// ```
    pub fn from_measurements(rows: &[(S, S); R]) -> Result<Self, CompensationError> {
        Self::new(&rows.map(|(set, measured)| (measured, set / measured)))
    }

    /// From up to `R` rows as for [`AxisTable::new`]; more are left out. The last one is repeated
    /// at higher speeds until all places are filled, which changes nothing: a table keeps its last
    /// coefficient anyway. Without rows the coefficient is `constant`.
    ///
    /// # Errors
    ///
    /// As [`AxisTable::new`].
    pub fn filled(
        mut rows: impl Iterator<Item = (S, S)>,
        constant: S,
    ) -> Result<Self, CompensationError> {
        let mut last = (S::ZERO, constant);
        let mut all = [last; R];
        for row in &mut all {
            last = rows.next().unwrap_or((last.0 + S::ONE, last.1));
            *row = last;
        }
        Self::new(&all)
    }

    /// The coefficient at this achieved speed, either sign.
    #[must_use]
    pub fn coefficient(&self, speed: S) -> S {
        let speed = speed.abs();
        let mut last: Option<&Row<S>> = None;
        for row in &self.rows {
            if speed < row.speed {
                return last.map_or(row.coefficient, |from| between(from, row, speed));
            }
            last = Some(row);
        }
        last.map_or(S::ONE, |row| row.coefficient)
    }

    /// Smallest and largest coefficient of the table.
    #[must_use]
    pub fn range(&self) -> (S, S) {
        let mut rows = self.rows.iter().map(|row| row.coefficient);
        let first = rows.next().unwrap_or(S::ONE);
        rows.fold((first, first), |(least, most), c| {
            (least.min(c), most.max(c))
        })
    }

    /// The speed from which on the coefficient no longer changes: that of the last row, or of an
    /// earlier one where all that follow have its coefficient.
    #[must_use]
    pub fn last_speed(&self) -> S {
        let mut rows = self.rows.iter().rev();
        let Some(last) = rows.next() else {
            return S::ONE;
        };
        rows.take_while(|row| row.coefficient == last.coefficient)
            .last()
            .map_or(last.speed, |row| row.speed)
    }

    pub(super) const fn steepness(&self) -> S {
        self.steepness
    }
}

/// The slope at the middle one of three rows: zero at an extremum, else a mean weighted so that
/// neither side overshoots.
fn slope<S: Real>(before: &Row<S>, here: &Row<S>, after: &Row<S>) -> S {
    let (left, right) = (here.speed - before.speed, after.speed - here.speed);
    let rise_left = (here.coefficient - before.coefficient) / left;
    let rise_right = (after.coefficient - here.coefficient) / right;
    if rise_left * rise_right <= S::ZERO {
        return S::ZERO;
    }
    let two = S::constant(2.0);
    let (weight_left, weight_right) = (two * right + left, right + two * left);
    (weight_left + weight_right) / (weight_left / rise_left + weight_right / rise_right)
}

/// The cubic between two rows.
fn between<S: Real>(from: &Row<S>, to: &Row<S>, speed: S) -> S {
    let width = to.speed - from.speed;
    let t = (speed - from.speed) / width;
    let rest = S::ONE - t;
    let (two, three) = (S::constant(2.0), S::constant(3.0));
    let blend = t * t * (three - two * t);
    from.coefficient * (S::ONE - blend)
        + to.coefficient * blend
        + width * t * rest * (from.slope * rest - to.slope * t)
}

/// The largest magnitude of that cubic's slope.
fn steepest<S: Real>(from: &Row<S>, to: &Row<S>) -> S {
    let rise = (to.coefficient - from.coefficient) / (to.speed - from.speed);
    let constant = <S as crate::arithmetic::Scalar>::constant;
    // The slope is a t^2 + b t + from.slope.
    let a = constant(3.0) * (from.slope + to.slope) - constant(6.0) * rise;
    let b = constant(6.0) * rise - constant(4.0) * from.slope - constant(2.0) * to.slope;
    let ends = from.slope.abs().max(to.slope.abs());
    let turning = -b / (constant(2.0) * a);
    if a != S::ZERO && turning > S::ZERO && turning < S::ONE {
        ends.max((from.slope + turning * (b + a * turning)).abs())
    } else {
        ends
    }
}

/// A table for each axis of the robot's own frame, each over the speed along that axis.
///
/// ```
/// use mecanum_kinematics::{AxisTable, Compensation, SpeedCompensation, Twist};
///
/// // What was set and what was measured (m/s, rad/s), from the paper's Tables 7 and 8.
/// let compensation = SpeedCompensation {
///     longitudinal: AxisTable::from_measurements(&[(0.1, 0.097_822), (0.5, 0.486_907)])?,
///     lateral: AxisTable::from_measurements(&[(0.1, 0.087_621), (0.5, 0.432_065)])?,
///     yaw: AxisTable::from_measurements(&[(0.524_f64, 0.511)])?,
/// };
/// // To achieve the 432 mm/s that were measured, ask for the 500 that were set.
/// let asked = compensation.apply(Twist::new(0.0, 0.432_065, 0.0));
/// assert!((asked.vy - 0.5).abs() < 1e-12);
/// assert!((compensation.remove(asked).vy - 0.432_065).abs() < 1e-12);
/// # Ok::<(), mecanum_kinematics::CompensationError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedCompensation<const X: usize, const Y: usize, const W: usize, S = f32> {
    /// Along x, over |vx| in m/s.
    pub longitudinal: AxisTable<X, S>,
    /// Along y, over |vy| in m/s.
    pub lateral: AxisTable<Y, S>,
    /// About z, over |omega| in rad/s.
    pub yaw: AxisTable<W, S>,
}

impl<const X: usize, const Y: usize, const W: usize, S: Real> SpeedCompensation<X, Y, W, S> {
    fn coefficients(&self, desired: Twist<S>) -> [S; 3] {
        [
            self.longitudinal.coefficient(desired.vx),
            self.lateral.coefficient(desired.vy),
            self.yaw.coefficient(desired.omega),
        ]
    }
}

impl<const X: usize, const Y: usize, const W: usize, S: Real> Compensation<S>
    for SpeedCompensation<X, Y, W, S>
{
    fn apply(&self, desired: Twist<S>) -> Twist<S> {
        let [x, y, w] = self.coefficients(desired);
        Twist::new(desired.vx * x, desired.vy * y, desired.omega * w)
    }

    fn remove(&self, asked: Twist<S>) -> Twist<S> {
        invert(asked, |desired| self.coefficients(desired))
    }
}
