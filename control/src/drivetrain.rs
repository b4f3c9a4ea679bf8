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
use kinematics::{GeometryError, Mount, Twist, VelocityCompensation, Wheel, WheelRates};

use crate::compensation::{Coefficients, GridCompensation};
use crate::quantity::{Lever, Quantity, Rate, Ratio};
use crate::rollers::Rolling;
use crate::twist::{quantities, scaled, single, to};

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
    mount: Placement,
    compensation: GridCompensation,
    contact: Contact,
}

/// Fractional bits of a twist that is not scaled to the robot's limits yet: the largest setpoint,
/// 3.3 m/s and rad/s, asks 480 m/s of a member 50 m ahead and 50 m aside whose coefficients are 2.
const SETPOINT: u32 = 20;

/// A twist or its derivative or integral, in the tick's own numbers.
type Motion<const FRACTION: u32> = Twist<Quantity<FRACTION>>;

/// A [`Mount`] in the tick's own numbers: `K_j`, equation (11), and back.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Placement {
    x: Lever,
    y: Lever,
    sin: Ratio,
    cos: Ratio,
}

impl Placement {
    fn new(mount: &Mount) -> Self {
        let [[cos, sin, _], ..] = mount.matrix();
        Self {
            x: Lever::new(mount.pose().x),
            y: Lever::new(mount.pose().y),
            sin: Ratio::new(sin),
            cos: Ratio::new(cos),
        }
    }

    /// As [`Mount::to_member`].
    #[inline]
    fn member<const FRACTION: u32>(&self, group: Motion<FRACTION>) -> Motion<FRACTION> {
        let vx = group.vx - group.omega.times(self.y);
        let vy = group.vy + group.omega.times(self.x);
        Twist {
            vx: vx.times::<_, FRACTION>(self.cos) + vy.times(self.sin),
            vy: vy.times::<_, FRACTION>(self.cos) - vx.times(self.sin),
            omega: group.omega,
        }
    }

    /// As [`Mount::to_group`].
    #[inline]
    fn group<const FRACTION: u32>(&self, member: Motion<FRACTION>) -> Motion<FRACTION> {
        let Twist { vx, vy, omega } = member;
        let ahead = vx.times::<_, FRACTION>(self.cos) - vy.times(self.sin);
        let aside = vx.times::<_, FRACTION>(self.sin) + vy.times(self.cos);
        Twist {
            vx: ahead + omega.times(self.y),
            vy: aside - omega.times(self.x),
            omega,
        }
    }
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
    /// Puts the three together, with a constant compensation.
    ///
    /// # Errors
    /// [`GeometryError`] when the wheels leave a motion uncontrolled.
    // Not inlined: a caller would take it apart, and copy number by number.
    #[inline(never)]
    pub fn new(
        wheels: &[Wheel; 4],
        mount: Mount,
        compensation: &VelocityCompensation,
        contact: &Contact,
    ) -> Result<Self, GeometryError> {
        Ok(Self {
            wheels: Kinematics::from_wheels(wheels, &Mount::IDENTITY, &VelocityCompensation::NONE)?,
            mount: Placement::new(&mount),
            compensation: GridCompensation::from(compensation),
            contact: *contact,
        })
    }

    /// Its compensation, to be given tables where it is: a robot's stack has no room for another.
    pub const fn compensation_mut(&mut self) -> &mut GridCompensation {
        &mut self.compensation
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
        // Up to 32 768 rad/s. A product is rounded to the nearest, a change of resolution is not.
        let rates = self.rates::<16>(scaled(self.setpoint(group), const { Ratio::new(1.0) }));
        WheelRates::from(rates.map(Quantity::to_f32))
    }

    /// The fastest that each wheel has to turn for this twist, wherever its rollers stand, rad/s
    /// with its sign.
    #[must_use]
    pub fn fastest(&self, group: Twist) -> WheelRates {
        let Contact::Rolling(rolling) = &self.contact else {
            return self.inverse(group);
        };
        // Rates are linear in the secant, so the fastest is at one of its ends.
        let asked = single(self.setpoint(group));
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

    /// Rates or accelerations of the wheels for a twist of the robot in its own frame or its
    /// derivative.
    #[inline]
    pub(crate) fn wheels<const FRACTION: u32>(
        &self,
        here: Motion<FRACTION>,
        factors: &Factors,
    ) -> [Quantity<FRACTION>; 4] {
        self.rates(factors.asked(here))
    }

    /// The wheels' rates for what they are asked for.
    #[inline]
    fn rates<const FRACTION: u32>(&self, member: Motion<FRACTION>) -> [Quantity<FRACTION>; 4] {
        let wheels: [_; 4] = raw(&self.wheels)
            .inverse(Twist {
                vx: member.vx.scalar(),
                vy: member.vy.scalar(),
                omega: member.omega.scalar(),
            })
            .into();
        wheels.map(Quantity::from_scalar)
    }

    /// The group's twist when the wheels turn at these rates; its displacement for angles.
    #[inline]
    pub(crate) fn forward<const FRACTION: u32>(
        &self,
        wheels: [Quantity<FRACTION>; 4],
        factors: &Factors,
    ) -> Motion<FRACTION> {
        let wheels = WheelRates::from(wheels.map(Quantity::scalar));
        let twist = raw(&self.wheels).forward(&wheels);
        let asked = Twist {
            vx: Quantity::from_scalar(twist.vx),
            vy: Quantity::from_scalar(twist.vy),
            omega: Quantity::from_scalar(twist.omega),
        };
        self.group(asked, factors)
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
        let asked = self.compensation.coefficients(Twist::default());
        Factors {
            asked,
            achieved: asked.map(Ratio::inverse),
            reference_next: true,
        }
    }

    /// Renews one half of the factors: those of the reference, a twist of the robot in its own
    /// frame, or those of the measurement, a twist of the group.
    #[inline]
    pub fn renew(&self, factors: &mut Factors, here: Twist<Rate>, measured: Twist<Rate>) {
        if self.compensation.is_constant() {
            return;
        }
        let is_reference = factors.reference_next;
        let motion = if is_reference {
            here
        } else {
            self.mount.member(measured)
        };
        let coefficients = self.compensation.coefficients(motion);
        if is_reference {
            factors.asked = coefficients;
        } else {
            factors.achieved = coefficients.map(Ratio::inverse);
        }
        factors.reference_next = !is_reference;
    }

    /// A displacement of the group with this turn of the robot, rad, in place of its own: the robot
    /// turns where it is.
    #[inline]
    pub(crate) fn turned_by(&self, moved: Motion<27>, turn: Quantity<27>) -> Motion<27> {
        let more = Twist {
            omega: turn - moved.omega,
            ..Twist::default()
        };
        moved + self.mount.group(more)
    }

    /// The group's twist or displacement for that of what the wheels are asked for.
    #[inline]
    pub(crate) fn group<const FRACTION: u32>(
        &self,
        asked: Motion<FRACTION>,
        factors: &Factors,
    ) -> Motion<FRACTION> {
        self.mount.group(times(asked, &factors.achieved))
    }

    #[inline]
    fn setpoint(&self, group: Twist) -> Motion<SETPOINT> {
        let here = self.here(quantities::<SETPOINT>(group));
        times(here, &self.compensation.coefficients(to(here)))
    }

    /// A twist of the group at the place of this robot, in its frame.
    #[must_use]
    pub fn here<const FRACTION: u32>(&self, group: Motion<FRACTION>) -> Motion<FRACTION> {
        self.mount.member(group)
    }
}

impl Factors {
    /// What the wheels are asked for, for a twist of the robot in its own frame.
    #[inline]
    pub(crate) fn asked<const FRACTION: u32>(&self, here: Motion<FRACTION>) -> Motion<FRACTION> {
        times(here, &self.asked)
    }
}

#[inline]
fn times<const FRACTION: u32>(
    twist: Motion<FRACTION>,
    [x, y, w]: &Coefficients,
) -> Motion<FRACTION> {
    Twist {
        vx: twist.vx.times(*x),
        vy: twist.vy.times(*y),
        omega: twist.omega.times(*w),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantity::Angle;
    use kinematics::{AxisTable, FourWheelGeometry, Pose, SpeedCompensation};

    fn drivetrain(compensation: &VelocityCompensation) -> Drivetrain {
        let geometry =
            FourWheelGeometry::new(0.370, 0.350, 0.1524, core::f32::consts::FRAC_PI_4).unwrap();
        let mount = Mount::new(Pose::new(1.2, -0.4, 0.3)).unwrap();
        Drivetrain::new(
            &geometry.wheels().unwrap(),
            mount,
            compensation,
            &Contact::Ideal,
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
        let constant = drivetrain(&constant);
        let mut tables = constant;
        tables.compensation_mut().sample(&speed);
        for (drivetrain, ticks) in [(constant, 0), (tables, 20)] {
            let mut factors = drivetrain.factors();
            let mut back = Twist::ZERO;
            for _ in 0..=ticks {
                let here = drivetrain.here(quantities(twist));
                let rates: [Rate; 4] = drivetrain.wheels(here, &factors);
                let seen = drivetrain.forward(rates, &factors);
                back = single(seen);
                drivetrain.renew(&mut factors, here, seen);
            }
            same(back, twist);
            let rates = drivetrain.inverse(twist);
            let seen = <[f32; 4]>::from(rates).map(Rate::new);
            same(single(drivetrain.forward(seen, &factors)), twist);
            let angles: [f32; 4] = rates.into();
            let moved = angles.map(|rate| Angle::new(rate * 1e-3));
            let moved = single(drivetrain.forward(moved, &factors));
            same(moved * 1e3, twist);
        }
    }

    /// Mount and compensation by themselves, against `f64`, over what the robot accepts.
    #[test]
    fn mount_and_compensation_are_off_by_their_steps() {
        let geometry = FourWheelGeometry::new(0.370, 0.350, 0.1524, 0.785).unwrap();
        for place in 0..400_i16 {
            // Up to 50 m, any heading, coefficients from 0.5 to 2 (0x2011, 0x2012).
            let part = |step: i16| f32::from((place * step) % 401) / 200.0 - 1.0;
            let pose = Pose::new(50.0 * part(7), 50.0 * part(11), 6.3 * part(13));
            let c = [17, 19, 23].map(|step| 2.0_f32.powf(part(step)));
            let mount = Mount::new(pose).unwrap();
            let drivetrain = Drivetrain::new(
                &geometry.wheels().unwrap(),
                mount,
                &VelocityCompensation::new(c[0], c[1], c[2]).unwrap(),
                &Contact::Ideal,
            )
            .unwrap();
            let factors = drivetrain.factors();
            // Members of up to 20 m/s and 1 rad/s.
            let group = Twist::new(20.0 * part(29), 20.0 * part(31), part(37));
            let wide = Mount::new(Pose::new(
                f64::from(pose.x),
                f64::from(pose.y),
                f64::from(pose.heading),
            ))
            .unwrap();
            let exact = wide.to_member(Twist {
                vx: group.vx.into(),
                vy: group.vy.into(),
                omega: group.omega.into(),
            });
            let exact = [exact.vx, exact.vy, exact.omega];
            let asked: Twist<Rate> = factors.asked(drivetrain.here(quantities(group)));
            let found = single(asked);
            let found = [found.vx, found.vy, found.omega];
            // Steps: of a result, of a coefficient or cosine, of a lever; or those of a float. A
            // velocity of the sum below has one of a number of 128 m/s at the most.
            let (rate, ratio, lever) = if cfg!(feature = "fixed-point") {
                (2.0_f64.powi(-23), 2.0_f64.powi(-27), 2.0_f64.powi(-25))
            } else {
                (2.0_f64.powi(-17), 2.0_f64.powi(-23), 2.0_f64.powi(-18))
            };
            // Half a step for each of two sums, two products and the input, twice that for the
            // coefficient, and a float's step to give it out; the sine is off by 1e-7.
            let speed = f64::from(group.vx.hypot(group.vy)) + 71.0;
            let bound = 2.0 * (3.0 * rate + lever + speed * (ratio + 1.5e-7 + 1.2e-7));
            for ((found, exact), c) in found.into_iter().zip(exact).zip(c) {
                let off = (f64::from(found) - exact * f64::from(c)).abs();
                assert!(off <= bound, "{off:e} {bound:e} {pose:?} {group:?}");
            }
            // And back: twice as much, as the coefficients may halve and double again.
            let back = single(drivetrain.group(asked, &factors));
            let far = (back.vx - group.vx).hypot(back.vy - group.vy);
            assert!(
                f64::from(far) <= 4.0 * bound,
                "{far:e} {bound:e} {pose:?} {c:?}"
            );
        }
    }

    /// The scale to the wheels' limit is computed from it, so it must not end at 256 m/s.
    #[test]
    fn the_fastest_setpoint_does_not_saturate() {
        let geometry = FourWheelGeometry::new(0.370, 0.350, 0.1524, 0.785).unwrap();
        let drivetrain = Drivetrain::new(
            &geometry.wheels().unwrap(),
            Mount::new(Pose::new(50.0, -50.0, 0.785)).unwrap(),
            &VelocityCompensation::new(2.0, 2.0, 2.0).unwrap(),
            &Contact::Ideal,
        )
        .unwrap();
        let slow = drivetrain.fastest(Twist::new(0.0, 0.0, 0.05)).front_left;
        let fast = drivetrain.fastest(Twist::new(0.0, 0.0, 3.2)).front_left;
        assert!((fast / slow - 64.0).abs() < 1e-4, "{fast} {slow}");
    }
}
