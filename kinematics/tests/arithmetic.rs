//! What the alternatives would have cost in accuracy: `micromath` measured against the smallest
//! step each function's result feeds. None of its functions is used; these tests say why, and would
//! say if that changed.

use mecanum_kinematics::arithmetic::{sin_cos, square_root};
use micromath::F32Ext;

/// Position travels the bus in 0.1 mm/s steps of velocity; a velocity of 2 m/s turned by a sine
/// that is off by e is off by 2 e: the sine may be off by half a step of that.
const SINE_STEP: f32 = 0.05e-3 / 2.0;
/// A table's key is a speed; Table 7 changes by 0.04 per m/s, so at 1 m/s a relative error e of the
/// root moves a velocity of 1 m/s by 0.04 e: half a step of 0.1 mm/s again.
const ROOT_STEP: f32 = 0.05e-3 / 0.04;

fn worst(mut error: impl FnMut(f32) -> f32, from: f32, to: f32) -> f32 {
    (0..=100_000).fold(0.0, |worst: f32, i| {
        worst.max(error(from + (to - from) * i as f32 / 1e5))
    })
}

#[test]
fn micromath_sine_is_too_coarse_and_ours_is_not() {
    let pi = core::f32::consts::PI;
    let theirs = worst(
        |a| (F32Ext::sin(a) - f64::from(a).sin() as f32).abs(),
        -pi,
        pi,
    );
    let ours = worst(
        |a| (sin_cos(a).0 - f64::from(a).sin() as f32).abs(),
        -pi,
        pi,
    );
    assert!(theirs > 10.0 * SINE_STEP, "{theirs}: no longer too coarse?");
    assert!(ours < SINE_STEP / 100.0, "{ours}");
}

#[test]
fn micromath_root_is_too_coarse_and_ours_is_not() {
    let theirs = worst(
        |v| (F32Ext::sqrt(v) / f64::from(v).sqrt() as f32 - 1.0).abs(),
        1e-3,
        4.0,
    );
    let ours = worst(
        |v| (square_root(v) / f64::from(v).sqrt() as f32 - 1.0).abs(),
        1e-3,
        4.0,
    );
    assert!(theirs > 10.0 * ROOT_STEP, "{theirs}: no longer too coarse?");
    assert!(ours < ROOT_STEP / 1000.0, "{ours}");
}
