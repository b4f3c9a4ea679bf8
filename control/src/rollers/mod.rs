//! The angle of each wheel's ground roller, and whether it is known.
//!
//! The encoder counts from the position at which the robot was switched on, so a wheel's angle is
//! unknown until its index has passed, once per turn of the wheel. From then on the counts give the
//! sweep of the roller ([`RollerTrack`]), and every further index must come a whole number of turns
//! later ([`tracked`]):
//!
//! | state | the wheel computes with | until |
//! |---|---|---|
//! | [`RollerState::Constant`] | ideal rollers: no roller count is configured | |
//! | [`RollerState::Sought`] | the mean ratio over a roller | the first index |
//! | [`RollerState::Known`] | its angle | an index at an unexpected count, or none in [`PATIENCE`] turns |
//! | [`RollerState::Lost`] | the mean ratio; limit "roller phase" | two indexes in a row a whole number of turns apart |
//!
//! Pulses that bounce at one count are one index. After a stray pulse the reference is lost until
//! two good ones have followed. Two indexes per turn never agree with each other, so such a wheel
//! keeps using the mean. A change between mean and angle is blended over [`BLEND`](tracked::BLEND)
//! ticks, because a step of the secant would be a step of the rate.
//!
//! Cost: about 15 instructions a wheel and tick, and the secants.

#[cfg(feature = "fixed-point")]
#[path = "fixed_point.rs"]
mod scalar;
#[cfg(not(feature = "fixed-point"))]
#[path = "single.rs"]
mod scalar;
#[cfg(test)]
mod tests;
mod tracked;

use kinematics::{FourWheelGeometry, GeometryError, RollerAngle, RollerTrack};

use crate::quantity::{Angle, Rate, Time};

use scalar::Pitch;
pub use scalar::{Secant, Value, Wheels};
pub(crate) use scalar::{displacement, inverse, measure};
use tracked::PATIENCE;
use tracked::Tracked;

/// Largest deviation of a correct index, as a fraction of a turn.
const PLAY: f32 = 1.0 / 64.0;

/// The secants of the four wheels.
pub type Secants = [Value; 4];

/// Wheels with rollers, and the ends of what their secants can be.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Rolling {
    pub(crate) wheels: Wheels,
    rollers: RollerConfiguration,
    pub(crate) least: Secants,
    pub(crate) largest: Secants,
}

impl Rolling {
    /// Wheels of this geometry with these rollers. Not inlined: moving it about is a kilobyte.
    ///
    /// # Errors
    /// [`GeometryError`] when the wheels leave a motion uncontrolled.
    #[inline(never)]
    pub fn new(
        geometry: &FourWheelGeometry,
        rollers: &RollerConfiguration,
    ) -> Result<Self, GeometryError> {
        Ok(Self {
            wheels: scalar::wheels(geometry)?,
            least: rollers.least(),
            largest: rollers.largest(),
            rollers: *rollers,
        })
    }

    /// Their rollers.
    #[must_use]
    pub const fn rollers(&self) -> &RollerConfiguration {
        &self.rollers
    }
}

/// An index pulse as it was captured.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct IndexPulse {
    /// Counts the pulses, wrapping: a new one has come when this changes.
    pub number: u8,
    /// The encoder's counter at the pulse.
    pub count: u16,
}

/// State of a wheel's roller phase.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[repr(u8)]
pub enum RollerState {
    /// Ideal rollers.
    #[default]
    Constant = 0,
    /// The mean over a roller; the index has not been seen yet.
    Sought = 1,
    /// The roller's angle.
    Known = 2,
    /// The mean over a roller; the reference was wrong or has slipped.
    Lost = 3,
}

/// The rollers of one wheel.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct RollerWheel {
    secant: Secant,
    /// Begins here.
    track: RollerTrack,
    /// From one roller to the next.
    pitch: Pitch,
    /// Roller angle at the index.
    phase: RollerAngle,
    /// Counts of a turn of the wheel, which behind a gear need not be whole.
    turn: f32,
    /// Counts without an index after which a reference is no longer trusted.
    patience: i32,
}

/// The rollers of a robot, as configured.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct RollerConfiguration {
    wheels: [RollerWheel; 4],
    /// Whether index inputs are used.
    index: bool,
    /// Counts by which an index may be off.
    tolerance: i32,
}

impl RollerWheel {
    /// A wheel with this many rollers (0: ideal ones), this phase (rad: how far it has rolled on
    /// past a roller's middle at the index) and these counts a turn of the wheel, gear included,
    /// negative where the encoder is reversed.
    ///
    /// # Errors
    /// [`GeometryError`] for one or two rollers, and for an encoder that cannot resolve where a
    /// roller stands.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "counts of a turn fit; a step of 2^-32 fits what an f32 has"
    )]
    pub fn new(rollers: u8, phase: f32, counts: f32) -> Result<Self, GeometryError> {
        let count = u16::from(rollers);
        let (track, angle, pitch) = if rollers == 0 {
            (
                RollerTrack::new(3, f64::from(counts))?,
                RollerAngle::default(),
                Pitch::NONE,
            )
        } else {
            let known = kinematics::Rollers::<f32>::new(count)?;
            (
                RollerTrack::new(count, f64::from(counts))?,
                RollerAngle::new(phase, &known),
                Pitch::new(known.pitch()),
            )
        };
        Ok(Self {
            secant: scalar::secant(count)?,
            track,
            pitch,
            phase: angle,
            turn: counts.abs(),
            patience: (PATIENCE * counts.abs()) as i32,
        })
    }

    fn is_ideal(&self) -> bool {
        self.pitch.is_none()
    }
}

impl RollerConfiguration {
    /// Four wheels, with or without index inputs; an index may be off by `tolerance` counts.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "counts of a turn fit")]
    pub fn new(wheels: [RollerWheel; 4], index: bool, tolerance: u16) -> Self {
        let turns = wheels.iter().map(|wheel| wheel.turn);
        let least = turns.fold(f32::INFINITY, f32::min);
        Self {
            wheels,
            index,
            tolerance: i32::from(tolerance).min((least * PLAY) as i32).max(1),
        }
    }

    /// Whether the wheels' phases come from index inputs.
    #[must_use]
    pub const fn has_index(&self) -> bool {
        self.index
    }

    /// Counts by which an index may be off.
    #[must_use]
    pub const fn tolerance(&self) -> i32 {
        self.tolerance
    }

    /// Whether all wheels have ideal rollers, so that no phase is needed.
    #[must_use]
    pub fn is_ideal(&self) -> bool {
        self.wheels.iter().all(RollerWheel::is_ideal)
    }

    /// Secants at the roller transition: the largest that can occur.
    #[must_use]
    pub fn largest(&self) -> Secants {
        let end = RollerAngle::from_bits(i32::MIN);
        self.wheels.map(|wheel| wheel.secant.at(end))
    }

    /// Secants in the middle of a roller: the least.
    #[must_use]
    pub fn least(&self) -> Secants {
        let middle = RollerAngle::from_bits(0);
        self.wheels.map(|wheel| wheel.secant.at(middle))
    }
}

/// The rollers of a robot while it runs.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Rollers {
    configuration: RollerConfiguration,
    kinematics: Wheels,
    wheels: [Tracked; 4],
    secants: Secants,
}

impl Rollers {
    /// All angles unknown, except those that `before` has for the same wheels. Not inlined: moving
    /// it about is half a kilobyte.
    #[inline(never)]
    pub fn new(rolling: &Rolling, before: Option<&Self>) -> Self {
        let configuration = rolling.rollers();
        let same_index = before.filter(|before| before.configuration.index == configuration.index);
        let [a, b, c, d] = configuration.wheels;
        let of = |wheel: usize| same_index.and_then(|before| before.wheels.get(wheel));
        let wheels = [
            Tracked::new(a, of(0)),
            Tracked::new(b, of(1)),
            Tracked::new(c, of(2)),
            Tracked::new(d, of(3)),
        ];
        let mut rollers = Self {
            secants: configuration.least(),
            kinematics: rolling.wheels,
            configuration: *configuration,
            wheels,
        };
        rollers.secants = rollers.now();
        rollers
    }

    fn now(&self) -> Secants {
        self.wheels
            .map(|wheel| wheel.secant(RollerAngle::from_bits(0)))
    }

    /// Processes an advance of the counters by `passed` to `now`, and returns the secants in the
    /// middle between the last call and this one.
    #[inline]
    pub fn update(
        &mut self,
        passed: [i16; 4],
        now: [u16; 4],
        index: Option<&[IndexPulse; 4]>,
    ) -> Secants {
        let tolerance = self.configuration.tolerance;
        let index = index.filter(|_| self.configuration.index);
        for (place, ((wheel, passed), now)) in
            self.wheels.iter_mut().zip(passed).zip(now).enumerate()
        {
            wheel.update(passed);
            if let Some(pulse) = index.and_then(|pulses| pulses.get(place)) {
                wheel.compare(now, *pulse, tolerance);
            }
            wheel.blend();
        }
        let now = self.now();
        let [a, b, c, d] = self.secants;
        let [e, f, g, h] = now;
        self.secants = now;
        [
            scalar::middle(a, e),
            scalar::middle(b, f),
            scalar::middle(c, g),
            scalar::middle(d, h),
        ]
    }

    /// The secants now.
    pub const fn secants(&self) -> &Secants {
        &self.secants
    }

    /// The kinematics for given secants, uncompensated, in the robot's frame.
    pub const fn kinematics(&self) -> &Wheels {
        &self.kinematics
    }

    /// The secants in `dt` s, when the wheels turn with these rates (rad/s).
    #[inline]
    pub fn ahead(&self, rates: [Rate; 4], dt: Time) -> Secants {
        let [a, b, c, d] = &self.wheels;
        let [ra, rb, rc, rd] = rates;
        let one = |wheel: &Tracked, rate: Rate| {
            let steps = wheel.configuration.pitch.steps(rate.times(dt));
            wheel.secant(RollerAngle::from_bits(steps))
        };
        [one(a, ra), one(b, rb), one(c, rc), one(d, rd)]
    }

    /// State of each wheel.
    pub fn states(&self) -> [RollerState; 4] {
        self.wheels.map(|wheel| wheel.state)
    }

    /// Angle by which each wheel has turned past the middle of its ground roller, rad; true for
    /// wheels in [`RollerState::Known`], else counted from where the robot was configured.
    pub fn sweeps(&self) -> [Angle; 4] {
        self.wheels.map(|wheel| {
            let pitch = wheel.configuration.pitch;
            if pitch.is_none() {
                Angle::ZERO
            } else {
                pitch.sweep(wheel.track.angle().to_bits())
            }
        })
    }

    /// Whether any wheel has lost its reference.
    pub fn any_lost(&self) -> bool {
        self.wheels
            .iter()
            .any(|wheel| wheel.state == RollerState::Lost)
    }
}
