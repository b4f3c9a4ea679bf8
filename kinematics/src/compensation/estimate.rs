//! Coefficients from measurements: commanded against measured velocity.
//!
//! The model is `measured = commanded / coefficient + noise`; the command is known exactly. A
//! robust first guess (the median of the ratios, and the median of the deviations from it) finds
//! the outliers, least squares on the rest gives the coefficient, and its residuals give the
//! confidence interval. Data that cannot determine the coefficient are refused with the reason. The
//! estimate is meant for a host, in `f64`; it nevertheless needs no allocator, and its medians take
//! time quadratic in the number of samples.

use core::fmt;

use super::VelocityCompensation;
use super::table::AxisTable;
use crate::error::CompensationError;
use crate::frame::Twist;

/// One measurement along one axis, m/s or rad/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// What the wheels were asked for, by uncompensated kinematics.
    pub commanded: f64,
    /// What the robot did.
    pub measured: f64,
}

/// What a fit accepts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Samples commanded slower than this say nothing, m/s or rad/s.
    pub least_speed: f64,
    /// Resolution of the measurement: a deviation this small is never an outlier, m/s or rad/s.
    pub resolution: f64,
    /// Outliers are this many standard deviations away.
    pub outlier_deviations: f64,
    /// At least this many samples must remain.
    pub least_samples: usize,
    /// The 95 % interval may reach this far from the coefficient, as a fraction of it.
    pub widest_interval: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            least_speed: 0.02,
            resolution: 1e-4,
            outlier_deviations: 4.0,
            least_samples: 3,
            widest_interval: 0.02,
        }
    }
}

/// A fitted coefficient and how sure it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Commanded over achieved speed.
    pub coefficient: f64,
    /// 95 % confidence interval of it.
    pub interval: (f64, f64),
    /// Root mean square of the residuals, m/s or rad/s.
    pub residual: f64,
    /// Samples the fit rests on.
    pub used: usize,
    /// Samples rejected as outliers.
    pub rejected: usize,
}

/// Why the data do not determine a coefficient.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum EstimationError {
    /// This sample (counted from 0) is NaN or infinite.
    NotFinite(usize),
    /// So few samples are fast enough and not outliers.
    TooFewSamples(usize),
    /// More samples are outliers than not.
    Inconsistent,
    /// The robot moves against the command, or not at all.
    NotFollowing,
    /// The 95 % interval reaches this far from the coefficient, relative.
    TooUncertain(f64),
}

impl fmt::Display for EstimationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite(i) => write!(f, "sample {i} is not a finite number"),
            Self::TooFewSamples(n) => write!(f, "only {n} usable samples"),
            Self::Inconsistent => f.write_str("most samples contradict the others"),
            Self::NotFollowing => f.write_str("the robot does not follow the command"),
            Self::TooUncertain(share) => write!(
                f,
                "the coefficient is uncertain by {:.1} %: measure longer or more often",
                share * 100.0
            ),
        }
    }
}

impl core::error::Error for EstimationError {}

/// Why a whole compensation is not determined: the axis, and what is wrong with it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum CalibrationError {
    /// This axis cannot be estimated.
    Axis(&'static str, EstimationError),
    /// The result is not a valid compensation.
    Compensation(CompensationError),
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Axis(axis, error) => write!(f, "{axis}: {error}"),
            Self::Compensation(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for CalibrationError {}

/// Fits the coefficient of one axis.
///
/// # Errors
///
/// [`EstimationError`] saying why the samples do not determine it.
///
/// ```
/// use mecanum_kinematics::estimate::{Limits, Sample, fit};
///
/// // The paper's Table 3, longitudinal, m/s.
/// let rows = [(0.1, 0.099_767), (0.2, 0.199_564), (0.3, 0.299_339), (0.4, 0.399_151)];
/// let samples = rows.map(|(commanded, measured)| Sample { commanded, measured });
/// let fit = fit(samples.iter().copied(), &Limits::default())?;
/// assert!((fit.coefficient - 1.002).abs() < 2e-4);
/// # Ok::<(), mecanum_kinematics::estimate::EstimationError>(())
/// ```
pub fn fit(
    samples: impl Iterator<Item = Sample> + Clone,
    limits: &Limits,
) -> Result<Fit, EstimationError> {
    for (i, sample) in samples.clone().enumerate() {
        if !(sample.commanded.is_finite() && sample.measured.is_finite()) {
            return Err(EstimationError::NotFinite(i));
        }
    }
    let usable = samples.filter(|s| s.commanded.abs() >= limits.least_speed);
    let count = usable.clone().count();
    if count < limits.least_samples.max(2) {
        return Err(EstimationError::TooFewSamples(count));
    }
    let guess = median(usable.clone().map(|s| s.measured / s.commanded));
    let deviation = |s: &Sample| (s.measured - guess * s.commanded).abs();
    // 1.4826 median deviations are one standard deviation of normally distributed noise.
    let spread = 1.4826 * median(usable.clone().map(|s| deviation(&s)));
    let allowed = (limits.outlier_deviations * spread).max(limits.resolution);
    let inliers = usable.filter(|s| deviation(s) <= allowed);
    let used = inliers.clone().count();
    if used * 2 <= count {
        return Err(EstimationError::Inconsistent);
    }
    if used < limits.least_samples.max(2) {
        return Err(EstimationError::TooFewSamples(used));
    }

    let (power, product) = inliers.clone().fold((0.0, 0.0), |(power, product), s| {
        (
            power + s.commanded * s.commanded,
            product + s.commanded * s.measured,
        )
    });
    let ratio = product / power;
    let error = inliers.fold(0.0, |sum, s| {
        let residual = s.measured - ratio * s.commanded;
        sum + residual * residual
    });
    let free = used - 1;
    let reach = student_95(free) * libm::sqrt(error / float(free) / power);
    if ratio <= reach {
        return Err(EstimationError::NotFollowing);
    }
    let interval = (1.0 / (ratio + reach), 1.0 / (ratio - reach));
    let share = interval.1 * ratio - 1.0;
    if share > limits.widest_interval {
        return Err(EstimationError::TooUncertain(share));
    }
    Ok(Fit {
        coefficient: 1.0 / ratio,
        interval,
        residual: libm::sqrt(error / float(used)),
        used,
        rejected: count - used,
    })
}

/// Fits a constant compensation from (commanded, measured) twists in the robot's frame.
///
/// Each axis rests on the samples that command it; a sample that combines axes counts for all it
/// commands.
///
/// # Errors
///
/// [`CalibrationError`] naming the axis that the data do not determine.
///
/// ```
/// use mecanum_kinematics::Twist;
/// use mecanum_kinematics::estimate::{Limits, fit_constant};
///
/// let mut samples = Vec::new();
/// for speed in [0.2, 0.3, 0.4] {
///     let run = |x: f64, y: f64, w: f64, factor: f64| {
///         let commanded = Twist::new(x, y, w) * speed;
///         (commanded, commanded * factor)
///     };
///     samples.push(run(1.0, 0.0, 0.0, 0.998));
///     samples.push(run(0.0, 1.0, 0.0, 0.968));
///     samples.push(run(0.0, 0.0, 1.0, 0.981));
/// }
/// let (compensation, fits) = fit_constant(&samples, &Limits::default())?;
/// assert!((compensation.lateral() - 1.0 / 0.968).abs() < 1e-9);
/// assert_eq!(fits[1].rejected, 0);
/// # Ok::<(), mecanum_kinematics::estimate::CalibrationError>(())
/// ```
pub fn fit_constant(
    samples: &[(Twist<f64>, Twist<f64>)],
    limits: &Limits,
) -> Result<(VelocityCompensation<f64>, [Fit; 3]), CalibrationError> {
    let axis = |name, of: fn(&Twist<f64>) -> f64| {
        let samples = samples.iter().map(|(commanded, measured)| Sample {
            commanded: of(commanded),
            measured: of(measured),
        });
        fit(samples, limits).map_err(|error| CalibrationError::Axis(name, error))
    };
    let fits = [
        axis("longitudinal", |twist| twist.vx)?,
        axis("lateral", |twist| twist.vy)?,
        axis("yaw", |twist| twist.omega)?,
    ];
    let [x, y, w] = fits;
    VelocityCompensation::new(x.coefficient, y.coefficient, w.coefficient)
        .map(|compensation| (compensation, fits))
        .map_err(CalibrationError::Compensation)
}

/// Fits one axis' table with a row for each of the `speeds` (increasing, m/s or rad/s) that were
/// commanded; a sample belongs to a speed when it was commanded within 1 % of it.
///
/// # Errors
///
/// [`CalibrationError`] when a speed's samples do not determine its coefficient, or the table is
/// not invertible.
pub fn fit_table<const R: usize>(
    samples: &[Sample],
    speeds: &[f64; R],
    limits: &Limits,
) -> Result<(AxisTable<R, f64>, [Fit; R]), CalibrationError> {
    let mut fits = [Fit {
        coefficient: 1.0,
        interval: (1.0, 1.0),
        residual: 0.0,
        used: 0,
        rejected: 0,
    }; R];
    for (result, speed) in fits.iter_mut().zip(speeds) {
        let here = samples
            .iter()
            .copied()
            .filter(|s| (s.commanded.abs() - speed).abs() <= 0.01 * speed);
        *result = fit(here, limits).map_err(|error| CalibrationError::Axis("table row", error))?;
    }
    let mut rows = [(0.0, 0.0); R];
    for (row, (fit, speed)) in rows.iter_mut().zip(fits.iter().zip(speeds)) {
        *row = (speed / fit.coefficient, fit.coefficient);
    }
    AxisTable::new(&rows)
        .map(|table| (table, fits))
        .map_err(CalibrationError::Compensation)
}

/// The middle value, without a place to sort in: the one with as many below as above.
fn median(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count();
    let rank = |wanted: usize| {
        values.clone().find(|candidate| {
            let below = values.clone().filter(|v| v < candidate).count();
            let same = values.clone().filter(|v| v == candidate).count();
            below <= wanted && wanted < below + same
        })
    };
    let lower = rank(count.saturating_sub(1) / 2).unwrap_or(0.0);
    let upper = rank(count / 2).unwrap_or(lower);
    f64::midpoint(lower, upper)
}

/// Two-sided 95 % quantile of Student's t: tabled where it is far from normal, else the expansion
/// in 1/n, which is right to 0.4 % from seven degrees of freedom on.
#[must_use]
pub fn student_95(free: usize) -> f64 {
    match free {
        0 => f64::INFINITY,
        1 => 12.706,
        2 => 4.303,
        3 => 3.182,
        4 => 2.776,
        5 => 2.571,
        6 => 2.447,
        _ => {
            let z = 1.959_964;
            let n = float(free);
            let cube = z * z * z;
            z + (cube + z) / (4.0 * n)
                + (5.0 * cube * z * z + 16.0 * cube + 3.0 * z) / (96.0 * n * n)
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts of samples are small")]
const fn float(count: usize) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn student_quantiles_are_those_of_the_tables() {
        for (free, want) in [
            (1, 12.706),
            (4, 2.776),
            (5, 2.571),
            (7, 2.365),
            (10, 2.228),
            (30, 2.042),
        ] {
            assert!((student_95(free) / want - 1.0).abs() < 4e-3, "{free}");
        }
    }

    #[test]
    fn median_of_even_and_odd_counts() {
        assert!(median([3.0, 1.0, 2.0].into_iter()) == 2.0);
        assert!(median([4.0, 1.0, 2.0, 3.0].into_iter()) == 2.5);
        assert!(median([1.0, 1.0, 1.0, 9.0].into_iter()) == 1.0);
    }
}
