//! Tests of when a gyro is used, of its bias, and of the turn it reports.

use super::*;

const STAND: [u16; 4] = [10, 20, 30, 40];

/// Noise of an even spread of -4 to 4 counts, about the BMI088's 2.5 rms.
fn noise(n: u16) -> i16 {
    [0, 3, -2, 4, -4, 1, -1, 2, -3][usize::from(n % 9)]
}

/// A gyro that has stood for a window with this mean.
fn at_rest(mean: i16) -> Gyro {
    let mut gyro = Gyro::new();
    for n in 0..=WINDOW {
        gyro.update(Reading::Rate(mean + noise(n)), &STAND);
    }
    gyro
}

/// The bias is known to the noise's share in a window: 2.6 counts / sqrt(500), within four
/// deviations half a count. Turning at 60 counts is the turn without it.
#[test]
fn bias_is_learned_at_rest_and_taken_off() {
    let mut gyro = at_rest(30);
    let report = gyro.report();
    assert_eq!(report.state, GyroState::InUse);
    assert!((report.bias / COUNT - 30.0).abs() < 0.5, "{report:?}");
    assert_eq!(gyro.rate(), None, "the wheels say that it stands");
    let mut counts = STAND;
    for n in 0..100 {
        counts[0] += 5;
        gyro.update(Reading::Rate(30 + 60 + noise(n)), &counts);
    }
    let rate = gyro.rate().unwrap() / COUNT;
    assert!((rate - 60.0).abs() < 4.6, "{rate}");
    let bias = gyro.report().bias / COUNT;
    assert!((bias - 30.0).abs() < 0.5, "kept while it moves: {bias}");
}

/// Pushed without its wheels turning, 300 counts (18 degrees/s): the gyro's turn counts.
#[test]
fn a_turn_that_no_wheel_makes_is_seen() {
    let mut gyro = at_rest(0);
    for n in 0..100 {
        gyro.update(Reading::Rate(300 + noise(n)), &STAND);
    }
    let rate = gyro.rate().unwrap() / COUNT;
    assert!((rate - 300.0).abs() < 4.6, "{rate}");
}

#[test]
fn no_bias_is_learned_while_wheels_turn_or_the_robot_is_moved() {
    let (mut moving, mut carried, mut turned) = (Gyro::new(), Gyro::new(), Gyro::new());
    for n in 0..4 * WINDOW {
        moving.update(Reading::Rate(30 + noise(n)), &[n, 20, 30, 40]);
        let sway = if n % 100 < 50 { 60 } else { -60 };
        carried.update(Reading::Rate(sway + noise(n)), &STAND);
        turned.update(Reading::Rate(200 + noise(n)), &STAND);
    }
    for gyro in [moving, carried, turned] {
        assert_eq!(gyro.report().state, GyroState::Starting);
        assert_eq!(gyro.rate(), None);
        assert_eq!(gyro.report().rate, 0.0);
    }
}

/// What is not believed is named, and stays so.
#[test]
fn a_gyro_that_fails_is_named_and_not_used() {
    type Feed = fn(&mut Gyro, u16);
    let cases: [(GyroState, u16, Feed); 5] = [
        (GyroState::Missing, 1, |g, _| {
            g.update(Reading::Missing, &STAND);
        }),
        (GyroState::Silent, SILENT + 1, |g, _| {
            g.update(Reading::Waiting, &STAND);
        }),
        (GyroState::Stuck, STUCK, |g, _| {
            g.update(Reading::Rate(7), &STAND);
        }),
        // Three that are 5000 away from the last good one.
        (GyroState::Implausible, 3, |g, n| {
            g.update(Reading::Rate(5000 + noise(n)), &STAND);
        }),
        (GyroState::Implausible, 3, |g, _| {
            g.update(Reading::Rate(i16::MIN), &STAND);
        }),
    ];
    for (state, within, feed) in cases {
        let mut gyro = at_rest(0);
        for n in 0..within {
            assert_eq!(gyro.report().state, GyroState::InUse, "{state:?} after {n}");
            feed(&mut gyro, n);
        }
        assert_eq!(gyro.report().state, state);
        assert_eq!(gyro.rate(), None, "{state:?}");
        for n in 0..2 * WINDOW {
            gyro.update(Reading::Rate(noise(n)), &STAND);
        }
        assert_eq!(gyro.report().state, state, "it is not believed again");
    }
}

/// A single wrong bit does not end it, and its sample is not used.
#[test]
fn one_implausible_sample_is_dropped() {
    let mut gyro = at_rest(0);
    let mut counts = STAND;
    for n in 0..400 {
        counts[1] += 9;
        let wrong = if n % 100 == 50 { 0x4000 } else { 0 };
        gyro.update(Reading::Rate(100 + noise(n) + wrong), &counts);
        let rate = gyro.rate().unwrap_or_default() / COUNT;
        assert!((rate - 100.0).abs() < 4.6, "{rate}");
    }
    assert_eq!(gyro.report().state, GyroState::InUse);
}
