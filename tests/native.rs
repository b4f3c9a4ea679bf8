//! A group of three native robots, from the master's setpoints to the motion of the load.
//!
//! Everything the assertions look at came about through frames on the bus, duties, motors and the
//! floor.

mod common;

use common::quick_drive;
use omnibus::path::curve::Curve;
use sim::Backend;

/// What a group's path is over what was asked, per axis: the ratio of the distances covered up to
/// the sample at which it is farthest along that axis.
fn ratio(
    drive: &common::Drive,
    asked: impl Fn(f64) -> f64,
    axis: fn(&sim::TruthSample) -> f64,
) -> f64 {
    let start = axis(&drive.truth[0]);
    let period = 0.01;
    drive
        .truth
        .iter()
        .enumerate()
        .map(|(k, sample)| (asked(k as f64 * period), axis(sample) - start))
        .max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
        .map_or(f64::NAN, |(asked, moved)| moved / asked)
}

/// The circle's first seconds, uncompensated: across, the load falls short as Table 3's fastest row
/// says (3.36 % at 500 mm/s and 3.17 at 300; the circle runs at 785), ahead by 0.22 %.
#[test]
fn an_uncompensated_group_loses_what_the_tables_say() {
    let group = common::group("tcc-3");
    let drive = quick_drive(&group, Backend::Native, Curve::Circle, false);
    drive.result.as_ref().unwrap();
    let plan = Curve::Circle.plan(true);
    let begin = plan.start();
    let at = |t: f64| plan.at(t).0;
    let lateral = ratio(&drive, |t| f64::from(at(t).y) - begin.y, |s| s.group.y);
    let longitudinal = ratio(&drive, |t| f64::from(at(t).x) - begin.x, |s| s.group.x);
    println!("lateral {lateral}, longitudinal {longitudinal}");
    assert!((-0.036..-0.029).contains(&(lateral - 1.0)), "{lateral}");
    assert!(
        (-0.005..0.001).contains(&(longitudinal - 1.0)),
        "{longitudinal}"
    );
}

/// With the coefficients of the group file both axes come out right to 0.3 %, and the robots hold
/// their places in the load although their crystals differ by 70 ppm.
#[test]
fn a_compensated_group_goes_where_it_is_sent() {
    let group = common::group("tcc-3");
    let drive = quick_drive(&group, Backend::Native, Curve::Circle, true);
    drive.result.as_ref().unwrap();
    let plan = Curve::Circle.plan(true);
    let begin = plan.start();
    let at = |t: f64| plan.at(t).0;
    let lateral = ratio(&drive, |t| f64::from(at(t).y) - begin.y, |s| s.group.y);
    let longitudinal = ratio(&drive, |t| f64::from(at(t).x) - begin.x, |s| s.group.x);
    assert!((lateral - 1.0).abs() < 0.003, "{lateral}");
    assert!((longitudinal - 1.0).abs() < 0.003, "{longitudinal}");
    assert!(
        drive.world.worst_shape_error_mm() < 1.0,
        "{}",
        drive.world.worst_shape_error_mm()
    );
    // Configuring fills the bus as far as it goes; driving must leave room for more robots.
    let load = drive
        .truth
        .iter()
        .map(|sample| sample.bus_load)
        .fold(0.0, f64::max);
    assert!((0.05..0.25).contains(&load), "{load}");
}

/// The same run twice is the same to the bit.
#[test]
fn two_runs_have_one_digest() {
    let group = common::group("tcc-2");
    let digest = || {
        quick_drive(&group, Backend::Native, Curve::Harmonic, true)
            .world
            .digest()
    };
    assert_eq!(digest(), digest());
}
