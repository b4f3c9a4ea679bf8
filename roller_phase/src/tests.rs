//! Tests of the fit with robots that roll on the swept wheels of the kinematics crate, in small
//! time steps.

use kinematics::{FourWheelGeometry, Platform, Rollers};

use super::*;

const PHASES: [f64; 4] = [0.1, -0.3, 0.25, 0.0];
/// From a wheel's axle to its rollers', m.
const DISTANCE: f64 = 0.11;
const DT: f64 = 1e-3;

/// Rim speeds of the wheels as the calibration drives them, over the radius.
const MIXED: [[f64; 4]; 4] = [
    [-1.1, 1.8, 1.5, -0.8],
    [1.1, -1.8, -1.5, 0.8],
    [-1.5, 0.8, 1.1, -1.8],
    [1.5, -0.8, -1.1, 1.8],
];
const LEFT: [f64; 4] = [-1.0, 1.0, 1.0, -1.0];
const TURN: [f64; 4] = [-1.0, 1.0, -1.0, 1.0];

fn robot() -> FourWheelGeometry<f64> {
    FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f64.to_radians()).unwrap()
}

/// Pseudo-random numbers of about normal distribution: sums of twelve in ±1/2.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut one = || {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 33) as f64 / (1_u64 << 31) as f64 - 0.5
        };
        (0..12).map(|_| one()).sum()
    }
}

/// Displacement in a step, robot frame.
fn step(rollers: &Rollers<f64>, angles: &[f64; 4], rates: &[f64; 4]) -> [f64; 3] {
    let wheels = robot().wheels().unwrap();
    let mut number = 0;
    let wheels = wheels.map(|wheel| {
        let sweep = rollers.sweep(angles[number] + 0.5 * rates[number] * DT, PHASES[number]);
        number += 1;
        wheel.swept(sweep, DISTANCE).unwrap()
    });
    let weights = wheels.map(|wheel| wheel.roller_angle().sin().powi(2));
    let platform = Platform::weighted(&wheels, &weights).unwrap();
    let twist = platform.twist(rates);
    // Two per cent of the sideways motion are lost: the gain has to find them.
    [twist.vx, 0.98 * twist.vy, twist.omega].map(|v| v * DT)
}

/// Wheels that stand, turn evenly for so many seconds, and stand. Poses and yaw rates 100 times a
/// second, with this noise, the yaw rates 20 ms late and with a bias.
fn driven(rates: [f64; 4], seconds: f64, noise: f64) -> [Motion; 2] {
    let rollers = Rollers::<f64>::new(8).unwrap();
    let (mut pose, mut angles) = ([0.0_f64; 3], [0.0; 4]);
    let mut noise_of = Noise(rates[0].to_bits());
    let (mut times, mut track) = (Vec::new(), Vec::new());
    let (mut poses, mut yaw_rates) = (Vec::new(), Vec::new());
    let mut heading = 0.0;
    for k in 0..((seconds + 1.0) / DT) as u32 {
        let t = f64::from(k) * DT;
        if k % 10 == 0 {
            times.push(t);
            track.push(angles);
            let mut seen = pose;
            seen.iter_mut().for_each(|v| *v += noise * noise_of.next());
            poses.push((t, seen));
            let rate = (pose[2] - heading) / (10.0 * DT) + 0.01 + noise * noise_of.next();
            yaw_rates.push((t + 0.02, rate));
            heading = pose[2];
        }
        if (0.5..seconds + 0.5).contains(&t) {
            let [dx, dy, turn] = step(&rollers, &angles, &rates);
            let (sin, cos) = (pose[2] + 0.5 * turn).sin_cos();
            pose[0] += cos * dx - sin * dy;
            pose[1] += sin * dx + cos * dy;
            pose[2] += turn;
            angles = std::array::from_fn(|n| angles[n] + rates[n] * DT);
        }
    }
    [Samples::Poses(poses), Samples::YawRates(yaw_rates)].map(|seen| Motion {
        times: times.clone(),
        angles: track.clone(),
        seen,
    })
}

fn found(motions: &[[f64; 4]], gyro: bool, noise: f64) -> Result<Phases, PhaseError> {
    let motions: Vec<_> = motions
        .iter()
        .map(|rates| driven(*rates, 8.0, noise)[usize::from(gyro)].clone())
        .collect();
    estimate(&robot(), Rollers::new(8).unwrap(), &motions)
}

/// Without noise within the thousandth of a pitch that the model is trusted to, from either source.
#[test]
fn finds_the_phases_it_was_made_with() {
    for gyro in [false, true] {
        let found = found(&MIXED, gyro, 0.0).unwrap();
        for (found, made) in found.phases.iter().zip(PHASES) {
            let bound = 1e-3 * std::f64::consts::TAU / 8.0;
            assert!((found - made).abs() < bound, "{gyro} {found} {made}");
        }
        assert!(found.explained > 0.99, "{found:?}");
        assert!((found.yaw_gain - 1.0).abs() < 2e-3, "{found:?}");
    }
}

/// With noise the truth lies within the interval it gives (times 1.5 for four wheels at once), and
/// the interval grows with the noise.
#[test]
fn says_how_sure_it_is() {
    for (gyro, noises) in [(false, [3e-5, 1e-4]), (true, [5e-4, 2e-3])] {
        let mut before = 0.0;
        for noise in noises {
            let found = found(&MIXED, gyro, noise).unwrap();
            let all = found.phases.iter().zip(PHASES).zip(found.confidence);
            for ((found, made), interval) in all {
                assert!(
                    (found - made).abs() < 1.5 * interval,
                    "{gyro} {found} {made} ± {interval}"
                );
            }
            assert!(found.confidence[0] > 1.5 * before, "{found:?}");
            before = found.confidence[0];
        }
    }
}

#[test]
fn refuses_what_shows_no_ripple() {
    let rollers = Rollers::new(8).unwrap();
    let short = estimate(&robot(), rollers, &driven(LEFT, 1.0, 0.0)[..1]);
    assert!(
        matches!(
            short,
            Err(PhaseError::TooShort {
                wheel: "front left",
                ..
            })
        ),
        "{short:?}"
    );
    // A ripple of millimetres under centimetres of noise, and one of milliradians a second under
    // some tenths.
    for (gyro, noise) in [(false, 0.02), (true, 0.2)] {
        let noisy = found(&MIXED, gyro, noise);
        assert!(noisy.is_err(), "{noisy:?}");
    }
    // Straight ahead no roller leans.
    for gyro in [false, true] {
        let ahead = found(&[[1.0; 4], [-1.0; 4]], gyro, 1e-6);
        assert!(ahead.is_err(), "{ahead:?}");
    }
}

/// Sideways and on the spot all wheels turn equally fast. Poses tell their ripples apart by where
/// they act; a gyro with the noise of an inexpensive one does not know whose they are.
#[test]
fn a_gyro_needs_a_rate_of_its_own_for_every_wheel() {
    let plain = [LEFT, LEFT.map(|r| -r), TURN, TURN.map(|r| -r)];
    assert!(found(&plain, false, 1e-4).is_ok());
    assert!(found(&MIXED, true, 1e-3).is_ok());
    let lost = found(&plain[..2], true, 1e-3);
    assert!(matches!(lost, Err(PhaseError::Alike { .. })), "{lost:?}");
}

#[test]
fn refuses_gyros_that_cannot_be_the_robots() {
    let with = |change: fn(f64) -> f64, every: usize| {
        let motions: Vec<_> = MIXED
            .iter()
            .map(|rates| {
                let mut motion = driven(*rates, 8.0, 1e-4)[1].clone();
                if let Samples::YawRates(samples) = &mut motion.seen {
                    *samples = samples.iter().copied().step_by(every).collect();
                    samples
                        .iter_mut()
                        .for_each(|(_, rate)| *rate = change(*rate));
                }
                motion
            })
            .collect();
        estimate(&robot(), Rollers::new(8).unwrap(), &motions).map_err(|error| error.to_string())
    };
    assert!(with(|rate| rate, 1).is_ok());
    for (change, every, words) in [
        ((|rate| -rate) as fn(f64) -> f64, 1, "counts clockwise"),
        (f64::to_degrees, 1, "look like degrees"),
        (|_| 0.0, 1, "fixed to this robot"),
        // 10 Hz for 1.8 rad/s of eight rollers: 2.3 a second.
        (|rate| rate, 10, "10.0 samples a second"),
    ] {
        let error = with(change, every).unwrap_err();
        assert!(error.contains(words), "{error}");
    }
}
