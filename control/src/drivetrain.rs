//! From the group's twist to this robot's wheels and back: `J C(v) K`, equation (19) with a `C`
//! that may depend on the motion.
//!
//! The three factors are applied one after the other, because the middle one changes while the
//! robot moves: the mount converts the group's twist to the member's, the compensation scales it,
//! and the wheel kinematics give the rates. The forward direction divides by the same coefficients.
//! The coefficients depend on the velocity that the robot *achieves*, and looking them up costs
//! more than using them; so the control tick keeps them in [`Factors`] and renews them every second
//! tick, alternately for the reference and for the measurement. The cost is that a coefficient is
//! one or two ticks old, and that in the forward direction the inversion of a table is spread over
//! several ticks. Each of these ticks at least halves the error (tables for which this does not
//! hold are refused), and the velocity changes by less than a hundredth of a per cent of the
//! wheels' range per tick. With constant coefficients there is no lookup and no such error.

#[cfg(feature = "fixed-point")]
use kinematics::FixedMember as Kinematics;
#[cfg(not(feature = "fixed-point"))]
use kinematics::MemberKinematics as Kinematics;
use kinematics::{
    GeometryError, GridCompensation, Mount, Twist, VelocityCompensation, Wheel, WheelRates,
};

use crate::quantity::Quantity;
use crate::rollers::Rolling;

/// The kinematics that take the tick's own numbers.
#[cfg(feature = "fixed-point")]
const fn raw(wheels: &Kinematics) -> &kinematics::MemberKinematics<fixed::types::I16F16> {
    wheels.member()
}
#[cfg(not(feature = "fixed-point"))]
const fn raw(wheels: &Kinematics) -> &Kinematics {
    wheels
}

/// Wheels, mount and compensation of one robot.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Drivetrain {
    /// Uncompensated, in the robot's frame; in fixed point with the feature of that name.
    wheels: Kinematics,
    mount: Mount,
    compensation: GridCompensation,
    contact: Contact,
}

/// Where the wheels touch the floor.
#[derive(Clone, Copy, PartialEq, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one, in a place of its own"
)]
pub enum Contact {
    /// In their middle, as if they had infinitely many rollers.
    Ideal,
    /// Where their ground rollers stand.
    Rolling(Rolling),
}

/// Coefficients along x, along y and about z of the robot.
pub type Coefficients = [f32; 3];

/// The coefficients a control tick works with.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Factors {
    /// At the reference: achieved to asked.
    asked: Coefficients,
    /// At the measurement: asked to achieved.
    achieved: Coefficients,
    /// Whose turn it is.
    reference_next: bool,
}

impl Drivetrain {
    /// Puts the three together.
    ///
    /// # Errors
    /// [`GeometryError`] when the wheels leave a motion uncontrolled.
    // Not inlined: a caller would take it apart, and copy number by number.
    #[inline(never)]
    pub fn new(
        wheels: &[Wheel; 4],
        mount: Mount,
        compensation: GridCompensation,
        contact: Contact,
    ) -> Result<Self, GeometryError> {
        Ok(Self {
            wheels: Kinematics::from_wheels(wheels, &Mount::IDENTITY, &VelocityCompensation::NONE)?,
            mount,
            compensation,
            contact,
        })
    }

    /// The wheels' rollers; `None` for ideal wheels.
    #[must_use]
    #[inline]
    pub const fn rolling(&self) -> Option<&Rolling> {
        match &self.contact {
            Contact::Ideal => None,
            Contact::Rolling(rolling) => Some(rolling),
        }
    }

    /// Wheel rates (rad/s) that make the group move with this twist (group frame).
    #[must_use]
    pub fn inverse(&self, group: Twist) -> WheelRates {
        self.rates(group, &self.at(group))
    }

    /// The fastest that each wheel has to turn for this twist, wherever its rollers stand, rad/s
    /// with its sign.
    #[must_use]
    pub fn fastest(&self, group: Twist) -> WheelRates {
        let Contact::Rolling(rolling) = &self.contact else {
            return self.inverse(group);
        };
        // Rates are linear in the secant, so the fastest is at one of its ends.
        let asked = times(self.mount.to_member(group), &self.at(group));
        let slow: [f32; 4] = rolling.wheels.inverse(asked, &rolling.least).into();
        let fast: [f32; 4] = rolling.wheels.inverse(asked, &rolling.largest).into();
        let [a, b, c, d] = slow;
        let [e, f, g, h] = fast;
        let more = |a: f32, b: f32| if a.abs() > b.abs() { a } else { b };
        WheelRates::from([more(a, e), more(b, f), more(c, g), more(d, h)])
    }

    /// Whether the coefficients are the same for every motion.
    #[must_use]
    pub fn is_constant(&self) -> bool {
        self.compensation.is_constant()
    }

    /// Rates or accelerations of the wheels for a twist of the group or its derivative.
    #[inline]
    pub(crate) fn wheels<const FRACTION: u32>(
        &self,
        group: Twist,
        factors: &Factors,
    ) -> [Quantity<FRACTION>; 4] {
        let member = self.member_twist(group, factors);
        let scalar = |value| Quantity::<FRACTION>::new(value).scalar();
        let wheels: [_; 4] = raw(&self.wheels)
            .inverse(Twist {
                vx: scalar(member.vx),
                vy: scalar(member.vy),
                omega: scalar(member.omega),
            })
            .into();
        wheels.map(Quantity::from_scalar)
    }

    /// What the wheels are asked for, a twist of the robot in its own frame, when they turn at
    /// these rates or by these angles.
    #[inline]
    pub(crate) fn forward<const FRACTION: u32>(&self, wheels: [Quantity<FRACTION>; 4]) -> Twist {
        let wheels = WheelRates::from(wheels.map(Quantity::scalar));
        let twist = raw(&self.wheels).forward(&wheels);
        let single = |value| Quantity::<FRACTION>::from_scalar(value).to_f32();
        Twist {
            vx: single(twist.vx),
            vy: single(twist.vy),
            omega: single(twist.omega),
        }
    }

    /// What no rigid motion explains in these wheel rates, rad/s.
    #[must_use]
    #[inline]
    pub fn slip_residual(&self, rates: &WheelRates) -> f32 {
        self.wheels.slip_residual(rates)
    }

    /// What no rigid motion explains in these rates or angles of the wheels.
    #[inline]
    pub(crate) fn unexplained<const FRACTION: u32>(
        &self,
        wheels: [Quantity<FRACTION>; 4],
    ) -> Quantity<FRACTION> {
        let wheels = WheelRates::from(wheels.map(Quantity::scalar));
        Quantity::from_scalar(raw(&self.wheels).slip_residual(&wheels))
    }

    /// The factors of a robot that stands.
    #[must_use]
    pub fn factors(&self) -> Factors {
        let asked = self.at(Twist::ZERO);
        Factors {
            asked,
            achieved: asked.map(|one| 1.0 / one),
            reference_next: true,
        }
    }

    /// Renews one half of the factors: those of the reference or those of the measurement, both
    /// given in the group frame.
    #[inline]
    pub fn renew(&self, factors: &mut Factors, reference: Twist, measured: Twist) {
        if self.compensation.is_constant() {
            return;
        }
        if factors.reference_next {
            factors.asked = self.at(reference);
        } else {
            factors.achieved = self.at(measured).map(|one| 1.0 / one);
        }
        factors.reference_next = !factors.reference_next;
    }

    /// What the wheels are asked for, a twist of the robot in its own frame, for a twist of the
    /// group.
    #[inline]
    pub(crate) fn member_twist(&self, group: Twist, factors: &Factors) -> Twist {
        times(self.mount.to_member(group), &factors.asked)
    }

    /// A displacement of the group with this turn of the robot, rad, in place of its own: the robot
    /// turns where it is.
    #[inline]
    pub(crate) fn turned_by(&self, moved: Twist, turn: f32) -> Twist {
        let more = Twist {
            omega: turn - moved.omega,
            ..Twist::ZERO
        };
        moved + self.mount.to_group(more)
    }

    /// The group's twist for what the wheels are asked for; displacements alike.
    #[inline]
    pub(crate) fn group_twist(&self, asked: Twist, factors: &Factors) -> Twist {
        self.mount.to_group(times(asked, &factors.achieved))
    }

    fn at(&self, group: Twist) -> Coefficients {
        self.compensation.coefficients(self.mount.to_member(group))
    }

    #[inline]
    fn rates(&self, group: Twist, coefficients: &Coefficients) -> WheelRates {
        let member = self.mount.to_member(group);
        self.wheels.inverse(times(member, coefficients))
    }
}

#[inline]
fn times(twist: Twist, [x, y, w]: &Coefficients) -> Twist {
    Twist {
        vx: twist.vx * x,
        vy: twist.vy * y,
        omega: twist.omega * w,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantity::{Angle, Rate};
    use kinematics::{AxisTable, FourWheelGeometry, Pose, SpeedCompensation};

    fn drivetrain(compensation: GridCompensation) -> Drivetrain {
        let geometry =
            FourWheelGeometry::new(0.370, 0.350, 0.1524, core::f32::consts::FRAC_PI_4).unwrap();
        let mount = Mount::new(Pose::new(1.2, -0.4, 0.3)).unwrap();
        Drivetrain::new(
            &geometry.wheels().unwrap(),
            mount,
            compensation,
            Contact::Ideal,
        )
        .unwrap()
    }

    /// Achieved(asked(v)) is v once the factors have settled; with constant coefficients at once.
    #[test]
    fn the_way_back_uses_the_same_coefficients() {
        // Single precision at 15 rad/s has steps of 1e-6 rad/s. In fixed point a step is 2^-16, and
        // half of one may be lost on each of three axes on the way in, as many on the way out, and
        // on four wheels, 0.15 m/rad each, in between.
        const STEP: f32 = 1.0 / 65_536.0;
        const BOUND: f32 = if cfg!(feature = "fixed-point") {
            0.5 * STEP * (3.0 + 3.0 + 4.0 * 0.15)
        } else {
            1e-5
        };
        let same = |a: Twist, b: Twist| {
            let far = (a.vx - b.vx).abs() + (a.vy - b.vy).abs() + (a.omega - b.omega).abs();
            assert!(far < BOUND, "{a:?} {b:?}");
        };
        let twist = Twist::new(0.31, -0.22, 0.2);
        let constant = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
        let speed = SpeedCompensation {
            longitudinal: AxisTable::<2>::new(&[(0.1, 1.022), (0.5, 1.027)]).unwrap(),
            lateral: AxisTable::new(&[(0.1, 1.141), (0.5, 1.157)]).unwrap(),
            yaw: AxisTable::new(&[(1.0, 1.0195)]).unwrap(),
        };
        for (compensation, ticks) in [
            (GridCompensation::from(&constant), 0),
            (GridCompensation::from(&speed), 20),
        ] {
            let drivetrain = drivetrain(compensation);
            let mut factors = drivetrain.factors();
            let mut back = Twist::ZERO;
            for _ in 0..=ticks {
                let rates: [Rate; 4] = drivetrain.wheels(twist, &factors);
                back = drivetrain.group_twist(drivetrain.forward(rates), &factors);
                drivetrain.renew(&mut factors, twist, back);
            }
            same(back, twist);
            let rates = drivetrain.inverse(twist);
            let seen = <[f32; 4]>::from(rates).map(Rate::new);
            same(
                drivetrain.group_twist(drivetrain.forward(seen), &factors),
                twist,
            );
            let angles: [f32; 4] = rates.into();
            let moved = angles.map(|rate| Angle::new(rate * 1e-3));
            let moved = drivetrain.group_twist(drivetrain.forward(moved), &factors);
            same(moved * 1e3, twist);
        }
    }
}
