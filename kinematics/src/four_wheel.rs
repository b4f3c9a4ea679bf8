//! The usual robot: four wheels in a rectangle, rollers mirrored, and its four wheel rates.

use crate::arithmetic::{Real, Scalar};
use crate::error::GeometryError;
use crate::wheel::Wheel;

/// A symmetric four-wheel robot.
///
/// ```
/// use mecanum_kinematics::{FourWheelGeometry, GeometryError};
///
/// assert!(FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians()).is_ok());
/// let error = FourWheelGeometry::new(0.370, 0.350, 0.0, 45_f32.to_radians()).unwrap_err();
/// assert_eq!(error.to_string(), "wheel_radius must be greater than zero");
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FourWheelGeometry<S = f32> {
    half_track: S,
    half_wheelbase: S,
    wheel_radius: S,
    roller_angle: S,
}

impl<S: Real> FourWheelGeometry<S> {
    /// Half the distance between left and right wheel centres (m), half the distance between front
    /// and rear (m), the wheel radius (m), and the angle between roller axle and wheel axle (rad).
    ///
    /// # Errors
    ///
    /// [`GeometryError`] naming the field that is not finite or not positive, or a roller angle
    /// outside 0 to 90 degrees.
    pub fn new(
        half_track: S,
        half_wheelbase: S,
        wheel_radius: S,
        roller_angle: S,
    ) -> Result<Self, GeometryError> {
        for (value, field) in [
            (half_track, "half_track"),
            (half_wheelbase, "half_wheelbase"),
            (wheel_radius, "wheel_radius"),
        ] {
            if !value.is_finite() {
                return Err(GeometryError::NotFinite(field));
            }
            if value <= S::zero() {
                return Err(GeometryError::NotPositive(field));
            }
        }
        if !roller_angle.is_finite() {
            return Err(GeometryError::NotFinite("roller_angle"));
        }
        if roller_angle <= S::zero() || roller_angle >= S::frac_pi_2() {
            return Err(GeometryError::RollerAngle);
        }
        Ok(Self {
            half_track,
            half_wheelbase,
            wheel_radius,
            roller_angle,
        })
    }

    /// Half the distance between left and right wheel centres, m.
    #[must_use]
    pub const fn half_track(&self) -> S {
        self.half_track
    }

    /// Half the distance between front and rear wheel centres, m.
    #[must_use]
    pub const fn half_wheelbase(&self) -> S {
        self.half_wheelbase
    }

    /// Wheel radius, m.
    #[must_use]
    pub const fn wheel_radius(&self) -> S {
        self.wheel_radius
    }

    /// Angle between roller axle and wheel axle, rad.
    #[must_use]
    pub const fn roller_angle(&self) -> S {
        self.roller_angle
    }

    /// The four wheels: front left, front right, rear left, rear right.
    ///
    /// # Errors
    ///
    /// None in practice: the fields were checked when the geometry was built.
    pub fn wheels(&self) -> Result<[Wheel<S>; 4], GeometryError> {
        let Self {
            half_track: w,
            half_wheelbase: h,
            wheel_radius: r,
            roller_angle: g,
        } = *self;
        let ahead = S::zero();
        Ok([
            Wheel::new(h, w, ahead, g, r)?,
            Wheel::new(h, -w, ahead, -g, r)?,
            Wheel::new(-h, w, ahead, -g, r)?,
            Wheel::new(-h, -w, ahead, g, r)?,
        ])
    }
}

/// Angular velocities of the four wheels, rad/s; positive rolls the base forward.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WheelRates<S = f32> {
    /// Front left, rad/s.
    pub front_left: S,
    /// Front right, rad/s.
    pub front_right: S,
    /// Rear left, rad/s.
    pub rear_left: S,
    /// Rear right, rad/s.
    pub rear_right: S,
}

impl WheelRates {
    /// All wheels standing.
    pub const ZERO: Self = Self {
        front_left: 0.0,
        front_right: 0.0,
        rear_left: 0.0,
        rear_right: 0.0,
    };
}

impl<S: Scalar> WheelRates<S> {
    /// Whether any rate stands at the end of its scalar's range, so that the true one may lie
    /// beyond.
    #[must_use]
    #[inline]
    pub fn is_saturated(&self) -> bool {
        self.front_left.is_saturated()
            | self.front_right.is_saturated()
            | self.rear_left.is_saturated()
            | self.rear_right.is_saturated()
    }
}

impl<S> From<[S; 4]> for WheelRates<S> {
    /// In the order front left, front right, rear left, rear right.
    fn from([front_left, front_right, rear_left, rear_right]: [S; 4]) -> Self {
        Self {
            front_left,
            front_right,
            rear_left,
            rear_right,
        }
    }
}

impl<S> From<WheelRates<S>> for [S; 4] {
    /// In the order front left, front right, rear left, rear right.
    fn from(rates: WheelRates<S>) -> Self {
        [
            rates.front_left,
            rates.front_right,
            rates.rear_left,
            rates.rear_right,
        ]
    }
}

/// Scales all wheels by one factor so that none exceeds `limit` (rad/s), which keeps the direction
/// of motion; returns the rates and that factor, 1 when nothing had to give.
///
/// A limit below zero or NaN permits no motion, and its factor is 0 whatever the rates. A limit of
/// zero permits standing: for wheels at rest nothing has to give and the factor is 1, for all
/// others it is 0. A NaN or infinite rate yields the factor 0 and standing wheels. In fixed point
/// the scaled rates are rounded towards zero.
///
/// ```
/// use mecanum_kinematics::{WheelRates, desaturate};
///
/// let (rates, scale) = desaturate(WheelRates::from([10.0, -20.0, 5.0, 0.0]), 10.0_f32);
/// assert_eq!(rates, WheelRates::from([5.0, -10.0, 2.5, 0.0]));
/// assert_eq!(scale, 0.5);
/// ```
#[must_use]
#[inline]
pub fn desaturate<S: Scalar>(rates: WheelRates<S>, limit: S) -> (WheelRates<S>, S) {
    let (limited, scale) = S::limit::<4>(rates.into(), limit);
    (WheelRates::from(limited), scale)
}
