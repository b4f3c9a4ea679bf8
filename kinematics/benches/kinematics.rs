//! What one call costs on this machine, in each scalar: `cargo bench -p mecanum-kinematics`.
//!
//! Times of a host are for comparing one run with another on the same machine. What the robot pays
//! is counted in instructions of its own core (docs/kinematics.md).

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use mecanum_kinematics::{
    FixedMember, FourWheelGeometry, MemberKinematics, Mount, Odometry, Pose, Real, Twist,
    VelocityCompensation, WheelRates, arithmetic::sin_cos, desaturate,
};

/// The paper's virtual robot, 1.2 m in front of the group's origin, with its Table 3 and 5
/// coefficients.
fn parts<S: Real>() -> (FourWheelGeometry<S>, Mount<S>, VelocityCompensation<S>) {
    let c = S::constant;
    let angle = c(core::f64::consts::FRAC_PI_4);
    (
        FourWheelGeometry::new(c(0.370), c(0.350), c(0.1524), angle).unwrap(),
        Mount::new(Pose::new(c(1.2), c(0.0), c(0.1))).unwrap(),
        VelocityCompensation::new(c(1.002), c(1.033), c(1.0195)).unwrap(),
    )
}

fn floating<S: Real>(criterion: &mut Criterion, scalar: &str) {
    let (geometry, mount, compensation) = parts::<S>();
    let member = MemberKinematics::new(&geometry, &mount, &compensation).unwrap();
    let twist = Twist::new(S::constant(0.4), S::constant(-0.3), S::constant(0.2));
    let rates = member.inverse(twist);
    let mut group = criterion.benchmark_group(scalar);
    group.bench_function("inverse", |b| b.iter(|| member.inverse(black_box(twist))));
    group.bench_function("forward", |b| b.iter(|| member.forward(black_box(&rates))));
    group.bench_function("build", |b| {
        b.iter(|| MemberKinematics::new(black_box(&geometry), &mount, &compensation));
    });
    group.finish();
}

fn single(criterion: &mut Criterion) {
    floating::<f32>(criterion, "f32");
    let (geometry, mount, compensation) = parts::<f32>();
    let member = MemberKinematics::new(&geometry, &mount, &compensation).unwrap();
    let twist = Twist::new(0.4, -0.3, 0.2);
    criterion.bench_function("f32/inverse and desaturate", |b| {
        b.iter(|| desaturate(member.inverse(black_box(twist)), 2.0));
    });
    let mut odometry = Odometry::new();
    let increments = WheelRates::from([0.003_f32, 0.001, -0.002, 0.004]);
    criterion.bench_function("f32/forward and odometry", |b| {
        b.iter(|| odometry.update(member.displacement(black_box(&increments)), 1.0));
    });
    criterion.bench_function("f32/sine and cosine", |b| {
        b.iter(|| sin_cos(black_box(1.234)))
    });
}

fn double(criterion: &mut Criterion) {
    floating::<f64>(criterion, "f64");
}

fn fixed(criterion: &mut Criterion) {
    let (geometry, mount, compensation) = parts::<f64>();
    let member = FixedMember::new(&geometry, &mount, &compensation).unwrap();
    let twist = Twist::new(0.4, -0.3, 0.2);
    let rates = member.inverse(twist);
    let mut group = criterion.benchmark_group("fixed");
    group.bench_function("inverse", |b| b.iter(|| member.inverse(black_box(twist))));
    group.bench_function("forward", |b| b.iter(|| member.forward(black_box(&rates))));
    group.finish();
}

criterion_group!(benches, single, double, fixed);
criterion_main!(benches);
