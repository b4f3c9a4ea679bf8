//! Non-uniform rational B-splines in the plane, evaluated by De Boor's algorithm.
//!
//! A curve of degree p over control points P_i with weights w_i and knots u_j is
//! C(u) = sum N_i,p(u) w_i P_i / sum N_i,p(u) w_i. De Boor's recurrence is applied to the
//! homogeneous points (w x, w y, w), and its last but one column gives the derivative:
//! d/du = p (d_1 - d_0) / (u_k+1 - u_k). The quotient rule brings both back to the plane.
//!
//! Every denominator of the recurrence is an interval of knots that contains the one of `u`, so it
//! is never zero. Cost: p^2 operations a point. (Piegl and Tiller, The NURBS Book, 2nd edition,
//! chapters 2 to 4; de Boor 1972.)

use crate::message::order::Trajectory;

/// Highest degree that is evaluated.
pub const HIGHEST_DEGREE: usize = 15;
/// Most control points of one curve.
pub const MOST_POINTS: usize = 10_000;

/// A homogeneous point: weight times x, weight times y, weight.
type Weighted = [f64; 3];

/// A curve, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Nurbs {
    degree: usize,
    knots: Vec<f64>,
    points: Vec<Weighted>,
}

impl Nurbs {
    /// Checks a trajectory.
    ///
    /// # Errors
    /// With the field that is wrong, and why.
    pub fn new(trajectory: &Trajectory) -> Result<Self, String> {
        let count = trajectory.control_points.len();
        let highest = HIGHEST_DEGREE as f64;
        let given = trajectory.degree;
        if given.fract() != 0.0 || !(1.0..=highest).contains(&given) {
            return Err(format!(
                "degree: {given} is not a whole number from 1 to {HIGHEST_DEGREE}"
            ));
        }
        #[expect(clippy::cast_possible_truncation, reason = "1 to 15")]
        #[expect(clippy::cast_sign_loss, reason = "1 to 15")]
        let degree = given as usize;
        if count < degree + 1 || count > MOST_POINTS {
            return Err(format!(
                "controlPoints: {count} points; a curve of degree {degree} needs {} to \
                 {MOST_POINTS}",
                degree + 1
            ));
        }
        let mut points = Vec::with_capacity(count);
        for (index, point) in trajectory.control_points.iter().enumerate() {
            let weight = point.weight;
            if !(1e-6..=1e6).contains(&weight) {
                return Err(format!(
                    "controlPoints[{index}].weight: {weight} is not between 1e-6 and 1e6"
                ));
            }
            if !(point.x.abs() < 1e6 && point.y.abs() < 1e6) {
                return Err(format!(
                    "controlPoints[{index}]: ({}, {}) is further than 1000 km away",
                    point.x, point.y
                ));
            }
            points.push([weight * point.x, weight * point.y, weight]);
        }
        let knots = match &trajectory.knot_vector {
            Some(knots) => checked(knots, count, degree)?,
            None => uniform(count, degree),
        };
        Ok(Self {
            degree,
            knots,
            points,
        })
    }

    /// Where the parameter begins and ends.
    #[must_use]
    pub fn domain(&self) -> (f64, f64) {
        let knot = |index: usize| self.knots.get(index).copied().unwrap_or_default();
        (knot(self.degree), knot(self.points.len()))
    }

    /// Length of the line through the control points, m: at least the curve's.
    #[must_use]
    pub fn span_length(&self) -> f64 {
        let place = |[x, y, weight]: Weighted| [x / weight, y / weight];
        let pairs = self.points.iter().zip(self.points.iter().skip(1));
        let ways = pairs.map(|(a, b)| {
            let ([ax, ay], [bx, by]) = (place(*a), place(*b));
            (bx - ax).hypot(by - ay)
        });
        ways.sum()
    }

    /// Place and derivative by the parameter at `u`, which is clamped to the domain.
    #[must_use]
    pub fn at(&self, u: f64) -> ([f64; 2], [f64; 2]) {
        let (low, high) = self.domain();
        let u = u.clamp(low, high);
        let span = self.span(u);
        let degree = self.degree;
        let knot = |index: usize| self.knots.get(index).copied().unwrap_or_default();
        let first = span - degree;
        let mut column: Vec<Weighted> = self
            .points
            .iter()
            .skip(first)
            .take(degree + 1)
            .copied()
            .collect();
        let mut slope = [0.0; 3];
        for level in 1..=degree {
            if level == degree
                && let [before, after, ..] = column[..]
            {
                let width = knot(span + 1) - knot(span);
                slope = blend(before, after, |a, b| degree as f64 * (b - a) / width);
            }
            column = column
                .windows(2)
                .enumerate()
                .map(|(index, pair)| {
                    let left = knot(first + level + index);
                    let right = knot(first + degree + 1 + index);
                    let share = (u - left) / (right - left);
                    let &[a, b] = pair else { return [0.0; 3] };
                    blend(a, b, |a, b| (1.0 - share) * a + share * b)
                })
                .collect();
        }
        let [x, y, weight] = column.first().copied().unwrap_or([0.0, 0.0, 1.0]);
        let (x, y) = (x / weight, y / weight);
        let [dx, dy, dw] = slope;
        ([x, y], [(dx - dw * x) / weight, (dy - dw * y) / weight])
    }

    /// The interval of knots that holds `u`, of those that are not empty.
    fn span(&self, u: f64) -> usize {
        let (_, high) = self.domain();
        let above = if u < high {
            self.knots.partition_point(|knot| *knot <= u)
        } else {
            self.knots.partition_point(|knot| *knot < high)
        };
        above - 1
    }
}

fn blend(a: Weighted, b: Weighted, of: impl Fn(f64, f64) -> f64) -> Weighted {
    [of(a[0], b[0]), of(a[1], b[1]), of(a[2], b[2])]
}

fn checked(knots: &[f64], count: usize, degree: usize) -> Result<Vec<f64>, String> {
    let wanted = count + degree + 1;
    if knots.len() != wanted {
        return Err(format!(
            "knotVector: {} knots; {count} control points of degree {degree} need {wanted}",
            knots.len()
        ));
    }
    for (index, pair) in knots.windows(2).enumerate() {
        if let &[before, after] = pair
            && before > after
        {
            return Err(format!(
                "knotVector[{}]: {after} comes after {before}; knots must not fall",
                index + 1
            ));
        }
    }
    if !knots.iter().all(|knot| (0.0..=1.0).contains(knot)) {
        return Err("knotVector: knots must lie between 0 and 1".into());
    }
    // A knot more often than the degree within the curve would tear it.
    let (low, high) = (knots.get(degree).copied(), knots.get(count).copied());
    if low >= high {
        return Err(format!(
            "knotVector: knots {degree} and {count} are equal, so the curve has no length"
        ));
    }
    let torn = knots.windows(degree + 1).any(|run| {
        let (first, last) = (run.first().copied(), run.last().copied());
        first == last && first > low && first < high
    });
    if torn {
        return Err(format!(
            "knotVector: an inner knot occurs more than {degree} times, which tears the curve"
        ));
    }
    Ok(knots.to_vec())
}

/// Clamped knots, evenly spread between.
fn uniform(count: usize, degree: usize) -> Vec<f64> {
    let spans = (count - degree) as f64;
    (0..=count + degree)
        .map(|index| (index.saturating_sub(degree) as f64 / spans).min(1.0))
        .collect()
}
