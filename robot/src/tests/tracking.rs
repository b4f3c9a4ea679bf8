//! How well a group follows a curve, from group twist to wheel.

use kinematics::Twist;
use kinematics::trajectory::{FigureEight, Ramped, Trajectory};
use protocol::Value;
use protocol::address as at;
use protocol::timing::{BIT_RATE, agreement_delay_us, reached_after_us};

use super::world::World;
use crate::state::State;

/// Robots that are fast enough for the paper's figure-eight: 1.57 m/s sideways and 0.79 m/s ahead
/// at its crossing make 15.5 rad/s.
fn fast(nodes: &[u8]) -> World {
    let mut world = World::new(nodes);
    world.configure();
    for node in nodes {
        for (address, value) in [(at::WHEEL_RATE_MAX, 18.0), (at::ACCELERATION, 3.0)] {
            world.write(*node, address, Value::F32(value)).unwrap();
        }
    }
    world.start();
    world.run(30);
    world.release();
    world
}

/// Drives the paper's figure-eight with a ramped start; calls `look` after every tick.
fn figure_eight(world: &mut World, seconds: u32, mut look: impl FnMut(&World, Twist)) {
    let curve = Ramped::new(FigureEight::<f32>::paper(), 2.0);
    let delay = agreement_delay_us(world.mask(), 10_000, BIT_RATE).unwrap();
    let preview = reached_after_us(10_000, delay) as f32 * 1e-6;
    let begin = world.now.next_multiple_of(10_000);
    world.until(10, |world| world.now == begin);
    for tick in 0..seconds * 1000 {
        let t = tick as f32 * 1e-3;
        world.twist = Some(curve.sample(t + preview).body_twist());
        world.step();
        look(world, curve.sample(t).body_twist());
    }
}

#[test]
fn setpoint_pipeline_reproduces_the_curve() {
    let mut world = fast(&[2]);
    let mut worst = 0.0_f32;
    figure_eight(&mut world, 20, |world, want| {
        let error = world.robots[0].control.report().twist_ref() - want;
        worst = worst.max(error.vx.abs()).max(error.vy.abs());
    });
    // Two chords of 10 ms on a curve of at most 2.5 m * (2 w)^3 = 0.62 m/s^3: 0.62 * 0.01^2 / 8 =
    // 8e-6, and the rounding of the setpoint to 5e-5 m/s, which the limiter passes on.
    assert!(worst < 2.5e-4, "off by {worst} m/s");
}

#[test]
fn wheels_follow_the_figure_eight_within_one_percent_of_their_peak() {
    let mut world = fast(&[2, 3, 4]);
    let (mut sum, mut count, mut peak) = (0.0_f64, 0_u32, 0.0_f64);
    figure_eight(&mut world, 22, |world, _| {
        for robot in &world.robots {
            let wanted: [f32; 4] = robot.control.report().rates_ref().into();
            for (wanted, rate) in wanted.into_iter().zip(robot.rates) {
                let wanted = f64::from(wanted);
                sum += (rate - wanted) * (rate - wanted);
                count += 1;
                peak = peak.max(wanted.abs());
            }
        }
    });
    for robot in &world.robots {
        assert_eq!(robot.bus.state(), State::Moving);
    }
    let rms = (sum / f64::from(count)).sqrt();
    std::println!("wheel tracking: rms {rms:.4} of peak {peak:.2} rad/s");
    assert!(rms < 0.01 * peak, "rms {rms} of {peak}");
}

#[test]
fn odometry_is_what_the_encoders_turned() {
    let mut world = World::started(&[2]);
    world.drive(Twist::new(0.3, 0.0, 0.0), 3000);
    world.drive(Twist::ZERO, 1500);
    let pose = world.robots[0].control.report().pose();
    // Straight ahead: the angle of a wheel times its radius, to one count.
    let rolled = world.robots[0].angles[0] as f32 * 0.1524;
    let count = core::f32::consts::TAU / 4096.0 * 0.1524;
    assert!((pose.x - rolled).abs() < count, "{} and {rolled}", pose.x);
    assert!(pose.y.abs() < count && pose.heading.abs() < 1e-3);
}

/// Rms error of the true wheel rates at a crawl, as part of the rate, when the feedforward's
/// friction is off by `mismatch`.
fn crawl_error(mismatch: f32) -> f64 {
    let mut world = World::new(&[2]);
    world.configure();
    world
        .write(2, at::ENCODER_COUNTS, Value::F32(2048.0))
        .unwrap();
    for wheel in 0..4 {
        let friction = Value::F32(super::world::STATIC_FRICTION * mismatch);
        world
            .write(2, at::motor::static_friction(wheel), friction)
            .unwrap();
    }
    world.robots[0].counts = 2048.0;
    world.start();
    world.run(30);
    // 20 mm/s, some time to settle.
    world.drive(Twist::new(0.02, 0.0, 0.0), 3000);
    let want = 0.02 / 0.1524;
    let (mut sum, mut count) = (0.0, 0);
    for _ in 0..3000 {
        world.step();
        for rate in world.robots[0].rates {
            sum += (rate / want - 1.0).powi(2);
            count += 1;
        }
    }
    (sum / f64::from(count)).sqrt()
}

#[test]
fn crawling_at_20_mm_s_is_true_to_one_percent_with_a_2048_count_encoder() {
    for mismatch in [1.0, 0.8, 1.2] {
        let error = crawl_error(mismatch);
        std::println!(
            "crawl, friction times {mismatch}: rms {:.2} %",
            error * 100.0
        );
        assert!(error < 0.01, "{error} with friction off by {mismatch}");
    }
}
