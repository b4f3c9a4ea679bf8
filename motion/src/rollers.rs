//! Where each wheel's ground roller stands, and how sure that is.
//!
//! The encoder counts from wherever the robot was switched on, so a wheel's angle is unknown until its index has
//! passed. From then on the counts say how far the roller has swept ([`RollerTrack`]), and every further index must
//! come a whole number of turns later:
//!
//! | state | the wheel computes with | until |
//! |---|---|---|
//! | [`RollerState::Constant`] | ideal rollers: no roller count is configured | |
//! | [`RollerState::Sought`] | the mean ratio over a roller | the first index |
//! | [`RollerState::Known`] | its angle | an index at an unexpected count, or none in [`PATIENCE`] turns |
//! | [`RollerState::Lost`] | the mean ratio; limit "roller phase" | two indexes in a row a whole number of turns apart |
//!
//! An index that bounces at one place is one index. A stray pulse costs the reference until two good ones have
//! followed; two indexes a turn never agree with each other, so such a wheel stays with the mean. When what a wheel
//! computes with changes, it passes over in [`BLEND`] ticks, because a step of its secant would be a step of its rate.
//!
//! Cost: about 15 instructions a wheel and tick, and the secants.

use kinematics::{FourWheelGeometry, GeometryError, RollerAngle, RollerTrack, WheelRates};

pub use scalar::{Secant, Value, Wheels};

/// Turns without an index after which a reference is no longer trusted.
const PATIENCE: i32 = 2;

/// Ticks over which a wheel passes from the mean ratio to its angle and back.
const BLEND: u16 = 64;

/// Most counts by which an index may move for good reasons, as a share of a turn.
const PLAY_DIVISOR: i32 = 64;

#[cfg(not(feature = "fixed-point"))]
mod scalar {
    //! In single precision.
    pub use kinematics::PhaseMember as Wheels;
    /// Secants of a wheel.
    pub type Secant = kinematics::Secant<f32>;
    /// One of them.
    pub type Value = f32;

    use kinematics::{FourWheelGeometry, GeometryError, Mount, VelocityCompensation};

    #[expect(
        clippy::unnecessary_wraps,
        reason = "as in fixed point, where it may not fit"
    )]
    pub fn wheels(geometry: &FourWheelGeometry) -> Result<Wheels, GeometryError> {
        Ok(Wheels::new(
            geometry,
            &Mount::IDENTITY,
            &VelocityCompensation::NONE,
        ))
    }

    pub fn secant(rollers: u16) -> Result<Secant, GeometryError> {
        Secant::for_count(rollers)
    }

    /// `share` of `whole` from one to the other.
    #[inline]
    pub fn between(from: Value, to: Value, share: u16, whole: u16) -> Value {
        from + (to - from) * (f32::from(share) / f32::from(whole))
    }

    #[inline]
    pub fn middle(a: Value, b: Value) -> Value {
        0.5 * (a + b)
    }
}

#[cfg(feature = "fixed-point")]
mod scalar {
    //! In fixed point.
    pub use kinematics::FixedPhaseMember as Wheels;
    /// Secants of a wheel.
    pub type Secant = kinematics::FixedSecant;
    /// One of them, with [`kinematics::FixedSecant::FRACTION`] fractional bits.
    pub type Value = i32;

    use kinematics::{FourWheelGeometry, GeometryError, Mount, VelocityCompensation};

    pub fn wheels(geometry: &FourWheelGeometry) -> Result<Wheels, GeometryError> {
        Wheels::new(geometry, &Mount::IDENTITY, &VelocityCompensation::NONE)
    }

    pub fn secant(rollers: u16) -> Result<Secant, GeometryError> {
        Secant::new(&kinematics::Secant::<f32>::for_count(rollers)?)
    }

    /// `share` of `whole` from one to the other. Divided first, so that any share fits.
    #[inline]
    pub const fn between(from: Value, to: Value, share: u16, whole: u16) -> Value {
        from + (to - from) / whole as i32 * share as i32
    }

    #[inline]
    pub const fn middle(a: Value, b: Value) -> Value {
        a + (b - a) / 2
    }
}

/// Wheels with rollers, uncompensated, in the robot's frame.
pub(crate) fn wheels(geometry: &FourWheelGeometry) -> Result<Wheels, GeometryError> {
    scalar::wheels(geometry)
}

/// The secants of the four wheels.
pub type Secants = [Value; 4];

/// An index pulse as it was captured.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct IndexPulse {
    /// Counts the pulses, wrapping: a new one has come when this changes.
    pub number: u8,
    /// The encoder's counter at the pulse.
    pub count: u16,
}

/// What a wheel computes with, and why.
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
    /// Steps of a roller angle for a radian of the wheel; 0 for ideal rollers.
    per_radian: f32,
    /// Roller angle at the index.
    phase: RollerAngle,
    /// Counts of a turn.
    turn: i32,
}

/// The rollers of a robot, as configured.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct RollerConfiguration {
    wheels: [RollerWheel; 4],
    /// Whether there are index inputs to listen to.
    index: bool,
    /// Counts by which an index may be off.
    tolerance: i32,
}

impl RollerWheel {
    /// A wheel with this many rollers (0: ideal ones), this phase (rad: how far it has rolled on past a roller's
    /// middle at the index) and these counts a turn, negative where the encoder is reversed.
    ///
    /// # Errors
    /// [`GeometryError`] for one or two rollers, and for an encoder that cannot tell where a roller stands.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "counts of a turn fit; a step of 2^-32 fits what an f32 has"
    )]
    pub fn new(rollers: u8, phase: f32, counts: f32) -> Result<Self, GeometryError> {
        let count = u16::from(rollers);
        let (track, angle, per_radian) = if rollers == 0 {
            (
                RollerTrack::new(3, f64::from(counts))?,
                RollerAngle::default(),
                0.0,
            )
        } else {
            let known = kinematics::Rollers::<f32>::new(count)?;
            (
                RollerTrack::new(count, f64::from(counts))?,
                RollerAngle::new(phase, &known),
                4_294_967_296.0 / known.pitch(),
            )
        };
        Ok(Self {
            secant: scalar::secant(count)?,
            track,
            per_radian,
            phase: angle,
            turn: counts.abs() as i32,
        })
    }

    fn is_ideal(&self) -> bool {
        self.per_radian == 0.0
    }
}

impl RollerConfiguration {
    /// Four wheels, with or without index inputs; an index may be off by `tolerance` counts.
    #[must_use]
    pub fn new(wheels: [RollerWheel; 4], index: bool, tolerance: u16) -> Self {
        let least = wheels.iter().map(|wheel| wheel.turn).min().unwrap_or(0);
        Self {
            wheels,
            index,
            tolerance: i32::from(tolerance).min(least / PLAY_DIVISOR).max(1),
        }
    }

    /// Whether all wheels have ideal rollers, so that nothing here is needed.
    #[must_use]
    pub fn is_ideal(&self) -> bool {
        self.wheels.iter().all(RollerWheel::is_ideal)
    }

    /// Secants at the hand-over: the most a wheel is ever asked for.
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

/// One wheel while it runs.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Tracked {
    configuration: RollerWheel,
    track: RollerTrack,
    state: RollerState,
    /// Number of the last pulse that was looked at; `None` before the first tick.
    number: Option<u8>,
    /// Counts since the last pulse, if there was one.
    since: Option<i32>,
    /// How much of the way from the mean to the angle, 0 to [`BLEND`].
    share: u16,
}

impl Tracked {
    fn new(configuration: RollerWheel) -> Self {
        Self {
            configuration,
            track: configuration.track,
            state: if configuration.is_ideal() {
                RollerState::Constant
            } else {
                RollerState::Sought
            },
            number: None,
            since: None,
            share: 0,
        }
    }

    #[inline]
    fn update(&mut self, passed: i16, now: u16, pulse: IndexPulse, tolerance: Option<i32>) {
        let passed = i32::from(passed);
        self.track.advance(passed);
        if let Some(since) = &mut self.since {
            *since = since.saturating_add(passed);
        }
        if let Some(tolerance) = tolerance
            && self.state != RollerState::Constant
        {
            let last = self.number.replace(pulse.number);
            if last.is_some_and(|last| last != pulse.number) {
                self.on_index(
                    i32::from(now.wrapping_sub(pulse.count).cast_signed()),
                    tolerance,
                );
            }
            let patience = PATIENCE.saturating_mul(self.configuration.turn) + tolerance;
            if self.state == RollerState::Known
                && self.since.is_none_or(|since| since.abs() > patience)
            {
                self.state = RollerState::Lost;
                self.since = None;
            }
        }
        if self.state == RollerState::Known {
            self.share = (self.share + 1).min(BLEND);
        } else {
            self.share = self.share.saturating_sub(1);
        }
    }

    /// The index passed `ago` counts before now.
    #[cold]
    fn on_index(&mut self, ago: i32, tolerance: i32) {
        let turn = self.configuration.turn;
        // Counts from the pulse before to this one, and how far they are from a whole number of turns.
        let between = self.since.map(|since| since.saturating_sub(ago));
        let off = between.map(|between| {
            let rest = between.rem_euclid(turn.max(1));
            rest.min(turn - rest)
        });
        let fits = off.is_some_and(|off| off <= tolerance);
        let moved_on = between.is_some_and(|between| between.abs() > turn / 2);
        self.state = match self.state {
            RollerState::Constant => RollerState::Constant,
            RollerState::Sought => RollerState::Known,
            RollerState::Known if fits => RollerState::Known,
            RollerState::Lost if fits && moved_on => RollerState::Known,
            // Back and forth over the same pulse says nothing new.
            RollerState::Lost if fits => return,
            RollerState::Known | RollerState::Lost => RollerState::Lost,
        };
        self.since = Some(ago);
        if self.state == RollerState::Known {
            self.track.set(self.configuration.phase);
            self.track.advance(ago);
        }
    }

    #[inline]
    fn secant(&self, ahead: RollerAngle) -> Value {
        let secant = &self.configuration.secant;
        let unknown = secant.unknown();
        if self.share == 0 {
            return unknown;
        }
        let known = secant.at(self.track.angle().advanced(ahead));
        if self.share == BLEND {
            known
        } else {
            scalar::between(unknown, known, self.share, BLEND)
        }
    }
}

/// The rollers of a robot while it runs.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Rollers {
    configuration: RollerConfiguration,
    wheels: [Tracked; 4],
    secants: Secants,
}

impl Rollers {
    /// All angles unknown; those that `before` knew of the same wheels are kept.
    pub fn new(configuration: RollerConfiguration, before: Option<&Self>) -> Self {
        let mut wheels = configuration.wheels.map(Tracked::new);
        let kept = before.filter(|before| before.configuration.index == configuration.index);
        if let Some(before) = kept {
            for (wheel, before) in wheels.iter_mut().zip(&before.wheels) {
                if wheel.track == before.configuration.track
                    && wheel.configuration.turn == before.configuration.turn
                {
                    let own = wheel.configuration;
                    *wheel = *before;
                    wheel.configuration = own;
                    let shift = own
                        .phase
                        .to_bits()
                        .wrapping_sub(before.configuration.phase.to_bits());
                    wheel
                        .track
                        .set(before.track.angle().advanced(RollerAngle::from_bits(shift)));
                }
            }
        }
        let mut rollers = Self {
            secants: configuration.least(),
            configuration,
            wheels,
        };
        rollers.secants = rollers.now();
        rollers
    }

    fn now(&self) -> Secants {
        self.wheels
            .map(|wheel| wheel.secant(RollerAngle::from_bits(0)))
    }

    /// Takes in that the counters went on by `passed` to `now`, and returns the secants in the middle between the
    /// last call and this one.
    #[inline]
    pub fn update(&mut self, passed: [i16; 4], now: [u16; 4], index: &[IndexPulse; 4]) -> Secants {
        let tolerance = self
            .configuration
            .index
            .then_some(self.configuration.tolerance);
        for (((wheel, passed), now), pulse) in
            self.wheels.iter_mut().zip(passed).zip(now).zip(index)
        {
            wheel.update(passed, now, *pulse, tolerance);
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

    /// The secants in `dt` s, when the wheels turn with these rates (rad/s).
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a tick's part of a roller; beyond half a roller it saturates"
    )]
    #[inline]
    pub fn ahead(&self, rates: &WheelRates, dt: f32) -> Secants {
        let rates: [f32; 4] = (*rates).into();
        let [a, b, c, d] = &self.wheels;
        let [ra, rb, rc, rd] = rates;
        let one = |wheel: &Tracked, rate: f32| {
            let steps = (rate * dt * wheel.configuration.per_radian) as i32;
            wheel.secant(RollerAngle::from_bits(steps))
        };
        [one(a, ra), one(b, rb), one(c, rc), one(d, rd)]
    }

    /// What each wheel computes with.
    pub fn states(&self) -> [RollerState; 4] {
        self.wheels.map(|wheel| wheel.state)
    }

    /// How far each wheel has rolled on past the middle of its ground roller, rad; true for wheels in
    /// [`RollerState::Known`], else counted from where the robot was configured.
    pub fn sweeps(&self) -> [f32; 4] {
        self.wheels.map(|wheel| {
            if wheel.configuration.is_ideal() {
                0.0
            } else {
                wheel.track.angle().to_bits() as f32 / wheel.configuration.per_radian
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts of a turn; eight rollers, 500 counts a pitch.
    const TURN: i16 = 4000;
    const TOLERANCE: u16 = 10;

    /// One wheel (the front left one) on a robot whose others have ideal rollers.
    struct Bench {
        rollers: Rollers,
        counts: [u16; 4],
        index: [IndexPulse; 4],
    }

    impl Bench {
        fn new(phase: f32) -> Self {
            let mut bench = Self {
                rollers: Rollers::new(configuration(phase), None),
                counts: [0; 4],
                index: [IndexPulse::default(); 4],
            };
            // The first tick only learns how many pulses there have been.
            bench.go(0, None);
            bench
        }

        /// Goes on by some counts; a pulse came `ago` counts before the end.
        fn go(&mut self, counts: i16, ago: Option<i16>) -> RollerState {
            self.counts[0] = self.counts[0].wrapping_add(counts.cast_unsigned());
            if let Some(ago) = ago {
                self.index[0].number = self.index[0].number.wrapping_add(1);
                self.index[0].count = self.counts[0].wrapping_sub(ago.cast_unsigned());
            }
            self.rollers
                .update([counts, 0, 0, 0], self.counts, &self.index);
            self.rollers.states()[0]
        }

        /// A number of counts in steps of a tick, no pulse.
        fn roll(&mut self, counts: i16) -> RollerState {
            for _ in 0..counts / 100 {
                self.go(100, None);
            }
            self.go(counts % 100, None)
        }
    }

    fn configuration(phase: f32) -> RollerConfiguration {
        let wheel = |rollers| RollerWheel::new(rollers, phase, f32::from(TURN)).unwrap();
        RollerConfiguration::new([wheel(8), wheel(0), wheel(0), wheel(0)], true, TOLERANCE)
    }

    /// A secant as a number.
    fn number(value: Value) -> f32 {
        #[cfg(feature = "fixed-point")]
        return value as f32 / (1 << kinematics::FixedSecant::FRACTION) as f32;
        #[cfg(not(feature = "fixed-point"))]
        value
    }

    #[test]
    fn computes_with_the_mean_until_the_index_has_come() {
        let mut bench = Bench::new(0.1);
        let mean = (core::f32::consts::PI / 8.0) / (core::f32::consts::PI / 8.0).sin();
        assert_eq!(bench.roll(3000), RollerState::Sought);
        assert!((number(bench.rollers.secants()[0]) - mean).abs() < 1e-5);
        assert_eq!(number(bench.rollers.secants()[1]), 1.0);
        assert_eq!(bench.go(100, Some(20)), RollerState::Known);
        // 20 counts past the index: 0.1 rad and 20/4000 of a turn.
        let sweep = 0.1 + 20.0 / 4000.0 * core::f32::consts::TAU;
        assert!((bench.rollers.sweeps()[0] - sweep).abs() < 1e-5);
        // Passes over without a step.
        let mut last = number(bench.rollers.secants()[0]);
        for _ in 0..BLEND {
            bench.go(0, None);
            let now = number(bench.rollers.secants()[0]);
            assert!((now - last).abs() < 0.09 / f32::from(BLEND), "{last} {now}");
            last = now;
        }
        assert!((last - 1.0 / sweep.cos()).abs() < 1e-5, "{last}");
        assert_eq!(bench.rollers.states()[1], RollerState::Constant);
    }

    #[test]
    fn an_index_where_it_belongs_keeps_the_reference() {
        let mut bench = Bench::new(0.0);
        bench.go(50, Some(0));
        for _ in 0..5 {
            bench.roll(TURN - 100);
            // Off by a little less than the tolerance, and back.
            assert_eq!(bench.go(100, Some(9)), RollerState::Known);
            bench.roll(TURN - 100);
            assert_eq!(bench.go(100, Some(0)), RollerState::Known);
        }
        // Backwards over the same index: the same place.
        bench.go(-50, Some(-50));
        assert_eq!(bench.rollers.states()[0], RollerState::Known);
        assert!(!bench.rollers.any_lost());
    }

    #[test]
    fn a_slipped_reference_is_lost_and_found_again() {
        let mut bench = Bench::new(0.0);
        bench.go(50, Some(0));
        // The encoder slips on its shaft by 300 counts.
        bench.roll(TURN - 400);
        assert_eq!(bench.go(100, Some(0)), RollerState::Lost);
        assert!(bench.rollers.any_lost());
        bench.roll(TURN - 100);
        assert_eq!(bench.go(100, Some(0)), RollerState::Known);
        assert!(bench.rollers.sweeps()[0].abs() < 1e-4);
    }

    #[test]
    fn a_missing_index_is_noticed_after_two_turns() {
        let mut bench = Bench::new(0.0);
        bench.go(50, Some(0));
        assert_eq!(bench.roll(2 * TURN), RollerState::Known);
        assert_eq!(bench.roll(100), RollerState::Lost);
    }

    #[test]
    fn two_indexes_a_turn_never_agree() {
        let mut bench = Bench::new(0.0);
        bench.go(50, Some(0));
        bench.roll(TURN / 2 - 100);
        assert_eq!(bench.go(100, Some(0)), RollerState::Lost);
        for _ in 0..6 {
            bench.roll(TURN / 2 - 100);
            assert_eq!(bench.go(100, Some(0)), RollerState::Lost);
        }
    }

    #[test]
    fn a_stray_pulse_costs_two_turns() {
        let mut bench = Bench::new(0.0);
        bench.go(50, Some(0));
        bench.roll(1000);
        assert_eq!(bench.go(0, Some(0)), RollerState::Lost);
        // A bounce of the same pulse is no second opinion.
        assert_eq!(bench.go(2, Some(0)), RollerState::Lost);
        bench.roll(TURN - 1002);
        assert_eq!(bench.go(0, Some(0)), RollerState::Lost);
        bench.roll(TURN);
        assert_eq!(bench.go(0, Some(0)), RollerState::Known);
    }

    #[test]
    fn a_new_configuration_keeps_what_the_index_has_told() {
        let mut bench = Bench::new(0.1);
        bench.go(50, Some(0));
        bench.roll(130);
        let before = bench.rollers.sweeps()[0];
        let again = Rollers::new(configuration(0.1), Some(&bench.rollers));
        assert_eq!(again.states(), bench.rollers.states());
        assert!((again.sweeps()[0] - before).abs() < 1e-6);
        let moved = Rollers::new(configuration(0.15), Some(&bench.rollers));
        assert!((moved.sweeps()[0] - before - 0.05).abs() < 1e-5);
        // Other rollers are other wheels.
        let wheel = |rollers| RollerWheel::new(rollers, 0.1, f32::from(TURN)).unwrap();
        let other = RollerConfiguration::new([wheel(9); 4], true, TOLERANCE);
        let other = Rollers::new(other, Some(&bench.rollers));
        assert_eq!(other.states()[0], RollerState::Sought);
    }

    #[test]
    fn a_reversed_encoder_turns_the_same_roller() {
        let wheel = RollerWheel::new(8, 0.0, -f32::from(TURN)).unwrap();
        let configuration = RollerConfiguration::new([wheel; 4], true, TOLERANCE);
        let mut rollers = Rollers::new(configuration, None);
        let pulse = [IndexPulse {
            number: 1,
            count: 0,
        }; 4];
        rollers.update([0; 4], [0; 4], &[IndexPulse::default(); 4]);
        rollers.update([0; 4], [0; 4], &pulse);
        // Forward is down.
        rollers.update([-100; 4], [0_u16.wrapping_sub(100); 4], &pulse);
        let sweep = 100.0 / 4000.0 * core::f32::consts::TAU;
        assert!((rollers.sweeps()[2] - sweep).abs() < 1e-5);
    }
}
