//! Against motors whose constants are known.

use super::*;

const DT: f64 = 1e-3;
const TICK_US: u32 = 1_000;
const NOMINAL: f32 = 24.0;
/// What a motor at rest may get, V.
const AT_REST: f32 = 5.0;
const BOUNDS: Bounds = Bounds {
    rate: 5.0,
    travel: 12.0,
    wheels: 0,
};

/// u = kS sgn(w) + kV w + kA w', solved in closed form over a tick of constant voltage.
#[derive(Clone, Copy)]
struct Motor {
    friction: f64,
    speed: f64,
    acceleration: f64,
    /// Voltage that it takes to break loose.
    breakaway: f64,
    rate: f64,
    angle: f64,
}

impl Motor {
    fn new(friction: f64, speed: f64, acceleration: f64) -> Self {
        Self {
            friction,
            speed,
            acceleration,
            breakaway: friction,
            rate: 0.0,
            angle: 0.0,
        }
    }

    fn step(&mut self, voltage: f64) {
        if self.rate == 0.0 {
            assert!(voltage.abs() < f64::from(AT_REST) + 0.01, "{voltage} V");
        }
        if self.rate == 0.0 && voltage.abs() <= self.breakaway {
            return;
        }
        let direction = if self.rate == 0.0 {
            voltage.signum()
        } else {
            self.rate.signum()
        };
        let end = (voltage - direction * self.friction) / self.speed;
        let fades = (-self.speed / self.acceleration * DT).exp();
        let rate = end + (self.rate - end) * fades;
        if rate * direction < 0.0 {
            // It comes to rest within the tick, and stays there for what is left of it.
            self.angle += 0.5 * self.rate * DT;
            self.rate = 0.0;
            return;
        }
        let tau = self.acceleration / self.speed;
        self.angle += end * DT + (self.rate - end) * tau * (1.0 - fades);
        self.rate = rate;
    }
}

/// Runs with these motors; the encoders have `counts` a revolution and see a vibration of `noise`
/// rad.
fn run(mut motors: [Motor; 4], bounds: Bounds, counts: f64, noise: f64) -> (Outcome, [f64; 2]) {
    let mut run = Identification::new(bounds, NOMINAL, AT_REST, TICK_US);
    let step = core::f64::consts::TAU / counts;
    let mut seen = [0_i64; 4];
    let mut random = 1_u64;
    let (mut fastest, mut farthest) = (0.0_f64, 0.0_f64);
    let mut voltage = 0.0;
    for _ in 0..25_000 {
        let mut turned = [0.0; 4];
        let wheels = motors.iter_mut().zip(&mut seen).zip(&mut turned);
        for (number, ((motor, seen), turned)) in wheels.enumerate() {
            if bounds.drives(number) {
                motor.step(f64::from(voltage));
            }
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            let shake = ((random >> 40) as f64 / f64::from(1 << 24) - 0.5) * 2.0 * noise;
            let count = ((motor.angle + shake) / step).floor() as i64;
            *turned = ((count - *seen) as f64 * step) as f32;
            *seen = count;
            fastest = fastest.max(motor.rate.abs());
            farthest = farthest.max(motor.angle.abs());
        }
        let rates = motors.map(|motor| motor.rate as f32);
        match run.tick(turned, rates, DT as f32) {
            Step::Voltage(next) => voltage = next,
            Step::Finished(outcome) => return (outcome, [fastest, farthest]),
            Step::Ended => panic!("it ended without a word"),
        }
    }
    panic!("it never ends");
}

const PAPER: fn() -> Motor = || Motor::new(0.375, 0.8075, 0.15);

fn close(found: f32, true_value: f64, share: f64) {
    let error = f64::from(found) / true_value - 1.0;
    assert!(error.abs() < share, "{found} instead of {true_value}");
}

#[test]
fn motors_with_known_constants_are_found_again() {
    // Quick, slow, weak, stiff: mechanical time constants from 31 ms to 0.4 s.
    let motors = [
        PAPER(),
        Motor::new(0.2, 1.6, 0.05),
        Motor::new(1.2, 1.0, 0.4),
        Motor::new(0.6, 2.0, 0.3),
    ];
    let (outcome, _) = run(motors, BOUNDS, 40_000.0, 0.0);
    for (model, motor) in outcome.unwrap().iter().zip(&motors) {
        std::println!("{model:?}");
        close(model.speed, motor.speed, 0.005);
        close(model.acceleration, motor.acceleration, 0.01);
        // 1 % of the ramp's voltage, some 6 V at its end.
        let error = f64::from(model.static_friction) - motor.friction;
        assert!(error.abs() < 0.06, "{error} V");
    }
}

#[test]
fn a_coarse_encoder_and_vibration_cost_a_few_percent() {
    // 2048 counts of 3.07 mrad; white vibration by a whole count to either side, 1.8 mrad rms. An
    // acceleration is off by 1.8e-3 * sqrt(6) / 0.1^2 = 0.43 rad/s^2 then, so kA w' by 0.065 V;
    // over some 15 rows with rates up to 5 rad/s, 1.5 rad/s rms about their mean, that is 0.065 /
    // sqrt(15) / 1.5 = 0.011 V s/rad of kV and, at the mean rate of 2.5, 0.033 V of kS. Three of
    // that.
    let motors = [PAPER(); 4];
    let (outcome, _) = run(motors, BOUNDS, 2048.0, core::f64::consts::TAU / 2048.0);
    for (model, motor) in outcome.unwrap().iter().zip(&motors) {
        std::println!("{model:?}");
        close(model.speed, motor.speed, 0.04);
        close(model.acceleration, motor.acceleration, 0.05);
        let error = f64::from(model.static_friction) - motor.friction;
        assert!(error.abs() < 0.1, "{error} V");
    }
}

#[test]
fn a_sticky_wheel_breaks_loose_and_is_found_all_the_same() {
    let mut sticky = PAPER();
    sticky.breakaway = 3.0 * sticky.friction;
    let (outcome, _) = run([sticky, PAPER(), PAPER(), PAPER()], BOUNDS, 40_000.0, 0.0);
    let model = outcome.unwrap()[0];
    close(model.speed, sticky.speed, 0.01);
    close(model.acceleration, sticky.acceleration, 0.02);
    let error = f64::from(model.static_friction) - sticky.friction;
    assert!(error.abs() < 0.06, "{error} V");
}

#[test]
fn speed_and_travel_stay_within_their_bounds() {
    for bounds in [
        BOUNDS,
        Bounds {
            rate: 5.0,
            travel: 4.0,
            wheels: 0,
        },
        Bounds {
            rate: 2.5,
            travel: 12.0,
            wheels: 0,
        },
    ] {
        let (outcome, [fastest, farthest]) = run([PAPER(); 4], bounds, 40_000.0, 0.0);
        assert!(outcome.is_ok(), "{outcome:?}");
        // The step lets the wheel catch up with the ramp of 2.4 V/s, which it followed a time
        // constant late.
        let (speed, acceleration) = (PAPER().speed, PAPER().acceleration);
        let late = 2.4 * acceleration / speed / speed;
        let highest = 1.01 * f64::from(bounds.rate) + late;
        assert!(fastest < highest, "{fastest} rad/s, {highest}");
        assert!(farthest < f64::from(bounds.travel), "{farthest} rad");
    }
}

fn fails(change: impl Fn(&mut Motor)) -> (Stopped, Option<u8>) {
    let mut motors = [PAPER(); 4];
    change(&mut motors[2]);
    run(motors, BOUNDS, 40_000.0, 0.0).0.unwrap_err()
}

#[test]
fn a_wheel_that_does_not_turn_is_named() {
    let blocked = fails(|motor| motor.breakaway = 100.0);
    assert_eq!(blocked, (Stopped::DoesNotMove, Some(2)));
}

#[test]
fn a_wheel_that_turns_backwards_is_named() {
    let mut run = Identification::new(BOUNDS, NOMINAL, AT_REST, TICK_US);
    let turned = [0.01, 0.01, 0.01, -0.01];
    let outcome = (0..20).find_map(|_| match run.tick(turned, [0.0; 4], 1e-3) {
        Step::Voltage(_) | Step::Ended => None,
        Step::Finished(outcome) => Some(outcome),
    });
    assert_eq!(outcome, Some(Err((Stopped::TurnsBackwards, Some(3)))));
}

#[test]
fn a_wheel_that_runs_away_is_named() {
    let mut run = Identification::new(BOUNDS, NOMINAL, AT_REST, TICK_US);
    let outcome = run.tick([0.0; 4], [0.0, 7.6, 0.0, 0.0], 1e-3);
    let expected = Err((Stopped::TooFast, Some(1)));
    assert_eq!(outcome, Step::Finished(expected));
    let outcome = run.tick([12.1, 0.0, 0.0, 0.0], [0.0; 4], 1e-3);
    assert_eq!(outcome, Step::Finished(Err((Stopped::TooFar, Some(0)))));
}

#[test]
fn it_times_out() {
    // Wheels that creep and are never fast enough, on a ramp that is never over.
    let mut run = Identification::new(
        Bounds {
            rate: 1e6,
            travel: 1e6,
            wheels: 0,
        },
        NOMINAL,
        AT_REST,
        TICK_US,
    );
    let mut ticks = 0_u32;
    let outcome = loop {
        run.voltage = run.voltage.min(5.0);
        match run.tick([1e-3; 4], [1.0; 4], 1e-3) {
            Step::Voltage(_) | Step::Ended => ticks += 1,
            Step::Finished(outcome) => break outcome,
        }
    };
    assert_eq!(outcome, Err((Stopped::TimedOut, None)));
    assert!((19_990..20_010).contains(&ticks), "{ticks} ms");
}

#[test]
fn one_wheel_alone_is_driven_and_found() {
    let only = |wheels| Bounds { wheels, ..BOUNDS };
    let (outcome, _) = run([PAPER(); 4], only(0b0100), 40_000.0, 0.0);
    let models = outcome.unwrap();
    close(models[2].speed, 0.8075, 0.005);
    assert_eq!([0, 1, 3].map(|n| models[n]), [WheelModel::default(); 3]);
    // One that is not driven may stand; the one that is must turn.
    let mut blocked = [PAPER(); 4];
    blocked[1].breakaway = 1e3;
    assert!(run(blocked, only(0b1101), 40_000.0, 0.0).0.is_ok());
    let (outcome, _) = run(blocked, only(0b0010), 40_000.0, 0.0);
    assert_eq!(outcome, Err((Stopped::DoesNotMove, Some(1))));
}
