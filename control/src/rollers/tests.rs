//! Tests of the state of a wheel's index.

use super::tracked::BLEND;
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
        Self::of(configuration(phase, f32::from(TURN)))
    }

    fn of(configuration: RollerConfiguration) -> Self {
        let mut bench = Self {
            rollers: Rollers::new(&rolling(&configuration), None),
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
            .update([counts, 0, 0, 0], self.counts, Some(&self.index));
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

fn configuration(phase: f32, turn: f32) -> RollerConfiguration {
    let wheel = |rollers| RollerWheel::new(rollers, phase, turn).unwrap();
    RollerConfiguration::new([wheel(8), wheel(0), wheel(0), wheel(0)], true, TOLERANCE)
}

/// These rollers on the paper's robot.
fn rolling(rollers: &RollerConfiguration) -> Rolling {
    let angle = core::f32::consts::FRAC_PI_4;
    let geometry = FourWheelGeometry::new(0.370, 0.350, 0.1524, angle).unwrap();
    Rolling::new(&geometry, rollers).unwrap()
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
    assert!((bench.rollers.sweeps()[0].to_f32() - sweep).abs() < 1e-5);
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
    assert!(bench.rollers.sweeps()[0].to_f32().abs() < 1e-4);
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
    let before = bench.rollers.sweeps()[0].to_f32();
    let again = Rollers::new(
        &rolling(&configuration(0.1, f32::from(TURN))),
        Some(&bench.rollers),
    );
    assert_eq!(again.states(), bench.rollers.states());
    assert!((again.sweeps()[0].to_f32() - before).abs() < 1e-6);
    let moved = Rollers::new(
        &rolling(&configuration(0.15, f32::from(TURN))),
        Some(&bench.rollers),
    );
    assert!((moved.sweeps()[0].to_f32() - before - 0.05).abs() < 1e-5);
    // Other rollers are other wheels.
    let wheel = |rollers| RollerWheel::new(rollers, 0.1, f32::from(TURN)).unwrap();
    let other = RollerConfiguration::new([wheel(9); 4], true, TOLERANCE);
    let other = Rollers::new(&rolling(&other), Some(&bench.rollers));
    assert_eq!(other.states()[0], RollerState::Sought);
}

#[test]
fn a_reversed_encoder_turns_the_same_roller() {
    let wheel = RollerWheel::new(8, 0.0, -f32::from(TURN)).unwrap();
    let configuration = RollerConfiguration::new([wheel; 4], true, TOLERANCE);
    let mut rollers = Rollers::new(&rolling(&configuration), None);
    let pulse = [IndexPulse {
        number: 1,
        count: 0,
    }; 4];
    rollers.update([0; 4], [0; 4], Some(&[IndexPulse::default(); 4]));
    rollers.update([0; 4], [0; 4], Some(&pulse));
    // Forward is down.
    rollers.update([-100; 4], [0_u16.wrapping_sub(100); 4], Some(&pulse));
    let sweep = 100.0 / 4000.0 * core::f32::consts::TAU;
    assert!((rollers.sweeps()[2].to_f32() - sweep).abs() < 1e-5);
}

/// Counts of a shaft's turn, and of a wheel's behind 26.85 : 1.
const SHAFT: f32 = 64.0;
const GEARED: f64 = 64.0 * 26.85;

/// Rolls through so many turns of a wheel whose index comes every `turn` counts, first after a
/// quarter; the states at the end and at worst.
fn rolls(bench: &mut Bench, turn: f64, turns: u32) -> (RollerState, bool) {
    let mut ever_lost = false;
    let mut at = 0_i64;
    for n in 0..turns {
        let pulse = (turn * (f64::from(n) + 0.25)).floor() as i64;
        // To 13 counts past the pulse, in steps of a tick.
        while at < pulse + 13 {
            let step = (pulse + 13 - at).min(50);
            at += step;
            let came = (at >= pulse && at - step < pulse).then_some((at - pulse) as i16);
            ever_lost |= bench.go(step as i16, came) == RollerState::Lost;
        }
    }
    (bench.rollers.states()[0], ever_lost)
}

#[test]
fn behind_a_gear_a_turn_is_no_whole_number_and_nothing_adds_up() {
    // One count of tolerance: what two pulses in whole counts need.
    let wheel = |rollers| RollerWheel::new(rollers, 0.1, SHAFT * 26.85).unwrap();
    let wheels = [wheel(8), wheel(0), wheel(0), wheel(0)];
    let mut bench = Bench::of(RollerConfiguration::new(wheels, true, 1));
    assert_eq!(
        rolls(&mut bench, GEARED, 10_000),
        (RollerState::Known, false)
    );
    // 13 counts past the last pulse, which begins within a count.
    let sweep = 0.1 + 13.0 / GEARED as f32 * core::f32::consts::TAU;
    let count = core::f32::consts::TAU / GEARED as f32;
    assert!((bench.rollers.sweeps()[0].to_f32() - sweep).abs() < 0.01 * count);
}

#[test]
fn a_wrong_gear_is_not_followed() {
    // A tooth more or less on a wheel of 60, with the widest tolerance there is.
    for ratio in [59.0 / 60.0, 61.0 / 60.0] {
        let mut bench = Bench::of(configuration(0.1, SHAFT * 26.85));
        assert_eq!(
            rolls(&mut bench, GEARED * ratio, 2),
            (RollerState::Lost, true)
        );
        assert_eq!(
            rolls(&mut bench, GEARED * ratio, 100),
            (RollerState::Lost, true)
        );
        let wheel = |rollers| RollerWheel::new(rollers, 0.1, SHAFT * 26.85).unwrap();
        let wheels = [wheel(8), wheel(0), wheel(0), wheel(0)];
        let mut bench = Bench::of(RollerConfiguration::new(wheels, true, 10_000));
        assert_eq!(
            rolls(&mut bench, GEARED * ratio, 100),
            (RollerState::Lost, true)
        );
    }
}
