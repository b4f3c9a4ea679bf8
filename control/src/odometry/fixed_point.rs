//! Odometry in fixed point.
//!
//! The heading is a fraction of a turn with 64 bits, which wraps as a turn does. The position keeps
//! 41 fractional bits of a metre.

use kinematics::{Pose, Twist};

use crate::quantity::{Angle, Quantity};

/// Sines, chords and what they are made of: 2 and more, 9.3e-10.
type Unit = Quantity<30>;

const ONE: Unit = Unit::new(1.0);

/// Coefficients of the chord: `sin(w/2) / (w/2) = 1 - w^2 / 24 + w^4 / 1920 - w^6 / 322560`.
const CHORD_2: Unit = Unit::new(1.0 / 24.0);
const CHORD_4: Unit = Unit::new(1.0 / 1920.0);
const CHORD_6: Unit = Unit::new(1.0 / 322_560.0);

/// A whole turn over a step of an [`Angle`], in 2^-64 turns: 2^37 / (2 pi), to 2e-11 of it.
const TURNS: i64 = 21_874_088_818;

/// 2 pi, to the nearest step.
const TAU: Quantity<28> = Quantity::from_bits(1_686_629_713);

/// Integrates the displacements of the ticks.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Odometry {
    /// 2^-64 turns.
    heading: i64,
    /// m, with 41 fractional bits.
    x: i64,
    y: i64,
}

impl Odometry {
    /// At the origin, heading along x.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            heading: 0,
            x: 0,
            y: 0,
        }
    }

    /// Moves on by a displacement in the group frame, m and rad.
    #[inline]
    pub fn advance(&mut self, moved: Twist<Angle>) {
        let Twist { vx, vy, omega } = moved;
        let turn = i64::from(omega.to_bits()).wrapping_mul(TURNS);
        // Half of a turn of more than a half is not half of what is left of it.
        let half = i64::from(omega.to_bits()).wrapping_mul(TURNS / 2);
        let (sin, cos) = sine_cosine(self.heading.wrapping_add(half));
        // Ends at 2, which is a turn of 1.4 rad; up to there the first term left out is 2e-7.
        let square: Unit = omega.times(omega);
        let inner: Unit = square.times(CHORD_4 - square.times(CHORD_6));
        let chord = ONE - square.times(CHORD_2 - inner);
        let (sin, cos): (Unit, Unit) = (sin.times(chord), cos.times(chord));
        self.x = self.x.saturating_add(along(vx, cos, vy, -sin));
        self.y = self.y.saturating_add(along(vx, sin, vy, cos));
        self.heading = self.heading.wrapping_add(turn);
    }

    /// The pose, m and rad, heading within ±pi.
    #[must_use]
    #[inline]
    pub fn pose(&self) -> Pose {
        let turn = Quantity::<32>::from_bits(high(self.heading));
        let heading: Quantity<29> = turn.times(TAU);
        Pose {
            x: metres(self.x),
            y: metres(self.y),
            heading: heading.to_f32(),
        }
    }
}

/// The upper word.
#[inline]
const fn high(wide: i64) -> i32 {
    (wide >> 32) as i32
}

/// Two sides times two parts of a direction, m with 41 fractional bits, to the nearest.
#[inline]
const fn along(a: Angle, p: Unit, b: Angle, q: Unit) -> i64 {
    // Each product is at most 2^61.
    let first = (a.to_bits() as i64).wrapping_mul(p.to_bits() as i64);
    let second = (b.to_bits() as i64).wrapping_mul(q.to_bits() as i64);
    first.wrapping_add(second).wrapping_add(1 << 15) >> 16
}

/// As a float.
#[inline]
#[expect(clippy::cast_precision_loss, reason = "what a float has of it")]
const fn metres(place: i64) -> f32 {
    let bits = (place as f32).to_bits();
    f32::from_bits(if place == 0 {
        0
    } else {
        bits.wrapping_sub(41 << 23)
    })
}

/// Sine and cosine of an angle in 2^-64 turns, to 1e-8.
///
/// Taylor's series about the nearest quarter turn, in eighths of a turn. The first terms left out
/// are 2e-9 of the sine, whose five terms end at the ninth power, and 2e-10 of the cosine.
#[inline]
fn sine_cosine(turns: i64) -> (Unit, Unit) {
    let turns = high(turns);
    let quarter = turns.wrapping_add(1 << 29) >> 30;
    let eighths = Unit::from_bits(turns.wrapping_sub(quarter << 30) << 1);
    let square: Unit = eighths.times(eighths);
    let series = |terms: [Unit; 5]| {
        let [first, rest @ ..] = terms;
        rest.into_iter()
            .fold(first, |sum, term| term - square.times(sum))
    };
    let sin: Unit = eighths.times(series(const { terms(9) }));
    let cos = ONE - square.times(series(const { terms(10) }));
    match quarter & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// Five coefficients `(pi/4)^n / n!`, from this n down in steps of two.
const fn terms(highest: u32) -> [Unit; 5] {
    [
        term(highest),
        term(highest - 2),
        term(highest - 4),
        term(highest - 6),
        term(highest - 8),
    ]
}

#[expect(clippy::cast_possible_truncation, reason = "at most 1")]
const fn term(n: u32) -> Unit {
    let mut value = 1.0;
    let mut factor = 1;
    while factor <= n {
        value *= core::f64::consts::FRAC_PI_4 / factor as f64;
        factor += 1;
    }
    // To the nearest step, which a float has not.
    Unit::from_bits((value * (1_u32 << 30) as f64 + 0.5) as i32)
}
