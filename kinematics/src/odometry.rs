//! From velocity to pose, exactly.
//!
//! A body that keeps a constant twist for a step moves on a circular arc. The Euler step (straight
//! ahead, then turn) misses that arc by half the turn; here the arc is integrated in closed form,
//! so the only remaining errors are the twist's own and rounding. Rounding is kept out of the sums:
//! the heading is an integer of 2^-61 rad, to which an `f32` turn is added exactly, and the
//! position carries the rounding error of each addition into the next.
//!
//! Speeds are not needed: [`Odometry::advance`] takes a displacement, and forward kinematics, which
//! is linear, converts wheel-angle increments into a displacement as it converts wheel rates into a
//! twist.

use nalgebra::Matrix3;

use crate::arithmetic::{Chord, Real, SMALL_TURN, Scalar, TURN_UNITS};
use crate::covariance::Covariance;
use crate::four_wheel::WheelRates;
use crate::frame::{Pose, Rotation, Twist};
use crate::member::MemberKinematics;

/// pi in units of 2^-61 rad.
const PI_UNITS: i64 = 7_244_019_458_077_122_842;

/// Integrates a body's motion into its pose.
///
/// ```
/// use mecanum_kinematics::{Odometry, Twist};
///
/// let mut odometry = Odometry::<f64>::new();
/// // A quarter of a circle of 1 m radius, in one step.
/// odometry.update(Twist::new(1.0, 0.0, 1.0), core::f64::consts::FRAC_PI_2);
/// assert!((odometry.pose().x - 1.0).abs() < 1e-12 && (odometry.pose().y - 1.0).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Odometry<S = f32> {
    /// Units of 2^-61 rad, within ±pi.
    heading: i64,
    x: S,
    y: S,
    /// What the last addition to x and y lost.
    lost_x: S,
    lost_y: S,
}

impl<S: Real> Odometry<S> {
    /// Starts at the origin, heading along x.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            heading: 0,
            x: S::ZERO,
            y: S::ZERO,
            lost_x: S::ZERO,
            lost_y: S::ZERO,
        }
    }

    /// Starts at this pose (m, m, rad).
    #[must_use]
    pub fn at(pose: Pose<S>) -> Self {
        Self {
            heading: turned_far(0, pose.heading.turn_units()),
            x: pose.x,
            y: pose.y,
            ..Self::default()
        }
    }

    /// Goes on from this pose (m, m, rad).
    pub fn reset(&mut self, pose: Pose<S>) {
        *self = Self::at(pose);
    }

    /// Moves on with a constant `twist` (body frame) for `dt` seconds.
    #[inline]
    pub fn update(&mut self, twist: Twist<S>, dt: S) {
        self.advance(twist * dt);
    }

    /// Moves on by wheel-angle increments (rad, signs as wheel rates); the body is the group whose
    /// twist `kinematics` speaks of.
    #[inline]
    pub fn advance_wheels(&mut self, kinematics: &MemberKinematics<S>, increments: &WheelRates<S>) {
        self.advance(kinematics.displacement(increments));
    }

    /// Moves on by a displacement: a constant twist (body frame) times its duration; m, m, rad.
    #[inline]
    pub fn advance(&mut self, displacement: Twist<S>) {
        if displacement.omega.abs() < <S as Scalar>::constant(SMALL_TURN) {
            let way = Rotation::by_heading(S::from_units(self.heading));
            self.translate(displacement, displacement.omega.small_chord(), way);
            let next = self.heading.wrapping_add(displacement.omega.to_units());
            // Looks at the upper half only: that is cheaper, and it does not matter where exactly
            // the wrap is.
            let upper = next >> 32;
            self.heading = if upper.abs() > PI_UNITS >> 32 {
                wrapped(next)
            } else {
                next
            };
        } else {
            self.advance_far(displacement);
        }
    }

    /// [`Odometry::advance`] for a large turn.
    #[cold]
    #[inline(never)]
    fn advance_far(&mut self, displacement: Twist<S>) {
        let way = Rotation::by(S::from_units(self.heading));
        self.translate(displacement, chord(displacement.omega), way);
        self.heading = turned_far(self.heading, displacement.omega.turn_units());
    }

    /// Goes along a chord from this heading.
    #[inline]
    fn translate(&mut self, displacement: Twist<S>, chord: Chord<S>, heading: Rotation<S>) {
        let step = chord.of(displacement).rotated(heading);
        add(&mut self.x, &mut self.lost_x, step.vx);
        add(&mut self.y, &mut self.lost_y, step.vy);
    }

    /// The pose now: m, m, and the heading within ±pi.
    #[must_use]
    #[inline]
    pub fn pose(&self) -> Pose<S> {
        Pose {
            x: self.x,
            y: self.y,
            heading: S::from_units(self.heading),
        }
    }
}

impl<S: Real> Chord<S> {
    /// Where a displacement along the arc leads.
    #[inline]
    fn of(self, Twist { vx, vy, omega }: Twist<S>) -> Twist<S> {
        let Self { along, across } = self;
        Twist::new(along * vx - across * vy, across * vx + along * vy, omega)
    }
}

/// The chord of an arc with this turn, rad.
fn chord<S: Real>(turn: S) -> Chord<S> {
    if turn.abs() < <S as Scalar>::constant(SMALL_TURN) {
        turn.small_chord()
    } else {
        let (sin, cos) = turn.sine_cosine();
        Chord {
            along: sin / turn,
            across: (S::ONE - cos) / turn,
        }
    }
}

/// Adds `step` to `sum`, with what the last addition lost (Kahan).
#[inline]
fn add<S: Real>(sum: &mut S, lost: &mut S, step: S) {
    let wanted = step - *lost;
    let next = *sum + wanted;
    *lost = (next - *sum) - wanted;
    *sum = next;
}

/// A heading just beyond ±pi, one turn back.
#[cold]
#[inline(never)]
fn wrapped(heading: i64) -> i64 {
    // Two steps of pi, because 2 pi does not fit: the units reach ±4.
    if heading > 0 {
        heading.wrapping_sub(PI_UNITS).wrapping_sub(PI_UNITS)
    } else {
        heading.wrapping_add(PI_UNITS).wrapping_add(PI_UNITS)
    }
}

/// The heading after a turn of any size, given without its whole turns.
fn turned_far(heading: i64, turn: u64) -> i64 {
    // A sum modulo a whole turn, which leaves no room for a carry in 64 bits.
    let from = if heading < 0 {
        TURN_UNITS.wrapping_add_signed(heading)
    } else {
        heading.unsigned_abs()
    };
    let room = TURN_UNITS.wrapping_sub(from);
    let units = if turn >= room {
        turn.wrapping_sub(room)
    } else {
        turn.wrapping_add(from)
    };
    if units > PI_UNITS.unsigned_abs() {
        units.wrapping_sub(TURN_UNITS).cast_signed()
    } else {
        units.cast_signed()
    }
}

/// Odometry that also says how sure it is.
///
/// Costs several times what [`Odometry`] does; meant for where the covariance is used, not for
/// every tick.
///
/// ```
/// use mecanum_kinematics::{Covariance, Pose, Twist, UncertainOdometry};
///
/// let mut odometry = UncertainOdometry::at(Pose::ZERO, Covariance::default());
/// let step = Covariance::from_deviations(0.0, 0.0, 0.01); // each turn is known to 0.01 rad
/// for _ in 0..100 {
///     odometry.advance(Twist::new(0.01, 0.0, 0.0), &step);
/// }
/// // 1 m straight ahead: the heading is known to 0.1 rad, the side by as much less as it was known
/// // better before.
/// let covariance = odometry.covariance();
/// assert!((covariance.ww.sqrt() - 0.1_f32).abs() < 1e-3);
/// assert!((covariance.yy.sqrt() - 0.0577).abs() < 2e-3);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct UncertainOdometry<S = f32> {
    odometry: Odometry<S>,
    covariance: Covariance<S>,
}

impl<S: Real> UncertainOdometry<S> {
    /// Starts at this pose (m, m, rad), known this well (world frame).
    #[must_use]
    pub fn at(pose: Pose<S>, covariance: Covariance<S>) -> Self {
        Self {
            odometry: Odometry::at(pose),
            covariance,
        }
    }

    /// Moves on by a displacement (body frame; m, m, rad) with this covariance: a twist's, times
    /// `dt^2`.
    ///
    /// To first order: the pose's covariance is carried along with the step, the displacement's
    /// turned into the world and added.
    pub fn advance(&mut self, displacement: Twist<S>, covariance: &Covariance<S>) {
        let before = self.odometry.pose();
        self.odometry.advance(displacement);
        let after = self.odometry.pose();
        let heading = Rotation::by(before.heading);
        let (zero, one) = (S::ZERO, S::ONE);
        // An error of the heading before swings the whole step.
        let carried = Matrix3::new(
            one,
            zero,
            before.y - after.y,
            zero,
            one,
            after.x - before.x,
            zero,
            zero,
            one,
        );
        // An error of the displacement moves the end of the chord, one of the turn bends it.
        let chord = chord(displacement.omega);
        let bent = bend(displacement.omega).of(displacement).rotated(heading);
        let forward = chord.of(Twist::new(one, zero, zero)).rotated(heading);
        let left = chord.of(Twist::new(zero, one, zero)).rotated(heading);
        let added = Matrix3::new(
            forward.vx, left.vx, bent.vx, forward.vy, left.vy, bent.vy, zero, zero, one,
        );
        self.covariance = Covariance::from_matrix(
            &(self.covariance.through(&carried).matrix() + covariance.through(&added).matrix()),
        );
    }

    /// The pose now: m, m, and the heading within ±pi.
    #[must_use]
    pub fn pose(&self) -> Pose<S> {
        self.odometry.pose()
    }

    /// Its covariance, world frame.
    #[must_use]
    pub const fn covariance(&self) -> Covariance<S> {
        self.covariance
    }
}

/// Derivative of [`chord`] by the turn.
fn bend<S: Real>(turn: S) -> Chord<S> {
    let constant = <S as Scalar>::constant;
    let square = turn * turn;
    if turn.abs() < constant(SMALL_TURN) {
        Chord {
            along: -turn
                * (constant(1.0 / 3.0)
                    - square * (constant(1.0 / 30.0) - square * constant(1.0 / 840.0))),
            across: constant(0.5) - square * (constant(1.0 / 8.0) - square * constant(1.0 / 144.0)),
        }
    } else {
        let (sin, cos) = turn.sine_cosine();
        Chord {
            along: (turn * cos - sin) / square,
            across: (turn * sin - (S::ONE - cos)) / square,
        }
    }
}
