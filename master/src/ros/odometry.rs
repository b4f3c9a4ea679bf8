//! The group's pose for `odom`, how well it is known, and the angles of its wheels.
//!
//! The pose is the members' own, the mean of them. It starts again whenever the robots are
//! configured; here it goes on from where it was. The covariance is that of the kinematics crate
//! for each member's wheel rates, as the mean of independent members, and grows with the way.

use group::{GroupFile, Robot};
use kinematics::{
    Covariance, FourWheelGeometry, Mount, Platform, Pose, Twist, TwistUncertainty,
    UncertainOdometry, Uncertainty, VelocityCompensation, Wheel, WheelRates,
};

use crate::monitor::odometry::relative_to;
use crate::monitor::telemetry::{SessionState, Snapshot};

/// What is left of slip after a calibration, as a share of the velocity along each axis.
const LONGITUDINAL: f64 = 0.005;
const LATERAL: f64 = 0.01;
const YAW: f64 = 0.01;
/// How long an error of the velocity lasts, s: slip is that of a motion, not of a step.
const PERSISTS: f64 = 1.0;
/// Longer between two snapshots, s, and nothing is worked out for the time between.
const GAP: f64 = 0.5;

/// Pose, velocity and wheel angles of a group.
pub struct Odometry {
    members: Vec<TwistUncertainty<4, f64>>,
    /// Where the frame of the snapshots' poses lies in that of `odom`.
    anchor: Pose,
    anchored: bool,
    pose: Pose,
    twist: Twist,
    uncertain: UncertainOdometry<f64>,
    velocity: Covariance<f64>,
    at: Option<f64>,
    angles: Vec<[f64; 4]>,
    rates: Vec<[f64; 4]>,
}

impl Odometry {
    /// At the origin, standing.
    #[must_use]
    pub fn new(group: &GroupFile) -> Self {
        let members = group.robots.iter().filter_map(|robot| {
            let platform = Platform::new(&wheels(robot)?).ok()?;
            let pose = robot.mount;
            let pose = Pose::new(
                f64::from(pose.x),
                f64::from(pose.y),
                f64::from(pose.heading),
            );
            let mount = Mount::new(pose).ok()?;
            let step = std::f64::consts::TAU / f64::from(robot.encoder.counts_per_revolution);
            let period = f64::from(group.sync_period_us) * 1e-6;
            let known = Uncertainty {
                // One step, evenly spread, seen over one period.
                wheel_rate: step / period / 12_f64.sqrt(),
                longitudinal: LONGITUDINAL,
                lateral: LATERAL,
                yaw: YAW,
            };
            let none = VelocityCompensation::new(1.0, 1.0, 1.0).ok()?;
            Some(TwistUncertainty::new(&platform, &mount, &none, &known))
        });
        Self {
            members: members.collect(),
            anchor: Pose::new(0.0, 0.0, 0.0),
            anchored: false,
            pose: Pose::new(0.0, 0.0, 0.0),
            twist: Twist::ZERO,
            uncertain: UncertainOdometry::default(),
            velocity: Covariance::default(),
            at: None,
            angles: vec![[0.0; 4]; group.robots.len()],
            rates: vec![[0.0; 4]; group.robots.len()],
        }
    }

    /// Takes in what is known at a SYNC.
    pub fn update(&mut self, now: &Snapshot) {
        let dt = self.at.map_or(0.0, |before| now.t - before);
        let dt = if (0.0..GAP).contains(&dt) { dt } else { 0.0 };
        self.at = Some(now.t);
        // Poses start again with a configuration, which only happens to robots that are not
        // running.
        if now.phase == SessionState::Idle {
            self.anchored = false;
        }
        if let Some(pose) = now.pose {
            if !self.anchored {
                self.anchor = anchor(self.pose, pose);
                self.anchored = true;
            }
            self.pose = within(self.anchor, pose);
        }
        self.twist = now.measured.unwrap_or(Twist::ZERO);
        for (index, member) in now.members.iter().enumerate() {
            let rates = member.wheel_rates.unwrap_or(WheelRates::ZERO);
            let rates = <[f32; 4]>::from(rates).map(f64::from);
            self.rates[index] = rates;
            for (angle, rate) in self.angles[index].iter_mut().zip(rates) {
                *angle += rate * dt;
            }
        }
        self.velocity = self.spread();
        let twist = self.twist;
        let [vx, vy, omega] = [twist.vx, twist.vy, twist.omega].map(|v| f64::from(v) * dt);
        // Of `n` steps with one error in common the variances add up to n times as much.
        let covariance = self.velocity.scaled(dt * PERSISTS.max(dt));
        self.uncertain
            .advance(Twist::new(vx, vy, omega), &covariance);
    }

    /// Covariance of the mean of the members' twists.
    fn spread(&self) -> Covariance<f64> {
        let count = self.members.len().max(1) as f64;
        let sum = self.members.iter().zip(&self.rates);
        let sum = sum.map(|(member, rates)| member.covariance(rates));
        let add = |a: Covariance<f64>, b: Covariance<f64>| Covariance {
            xx: a.xx + b.xx,
            xy: a.xy + b.xy,
            xw: a.xw + b.xw,
            yy: a.yy + b.yy,
            yw: a.yw + b.yw,
            ww: a.ww + b.ww,
        };
        sum.fold(Covariance::default(), add)
            .scaled(1.0 / (count * count))
    }

    /// The pose in the frame of `odom`.
    #[must_use]
    pub const fn pose(&self) -> Pose {
        self.pose
    }

    /// The velocity in the group's frame.
    #[must_use]
    pub const fn twist(&self) -> Twist {
        self.twist
    }

    /// Covariance of the pose.
    #[must_use]
    pub const fn pose_covariance(&self) -> Covariance<f64> {
        self.uncertain.covariance()
    }

    /// Covariance of the velocity.
    #[must_use]
    pub const fn twist_covariance(&self) -> Covariance<f64> {
        self.velocity
    }

    /// Angle of each wheel of each robot, rad, and its rate, rad/s.
    pub fn wheels(&self) -> impl Iterator<Item = ([f64; 4], [f64; 4])> + '_ {
        self.angles.iter().copied().zip(self.rates.iter().copied())
    }
}

fn wheels(robot: &Robot) -> Option<[Wheel<f64>; 4]> {
    let wide = f64::from;
    if let Some(each) = &robot.wheels {
        let mut wheels = Vec::new();
        for wheel in each {
            let (x, y) = (wide(wheel.x), wide(wheel.y));
            let angle = wide(wheel.roller_angle);
            wheels.push(Wheel::new(x, y, 0.0, angle, wide(wheel.radius)).ok()?);
        }
        return wheels.try_into().ok();
    }
    let shape = &robot.geometry;
    let shape = FourWheelGeometry::new(
        wide(shape.half_track()),
        wide(shape.half_wheelbase()),
        wide(shape.wheel_radius()),
        wide(shape.roller_angle()),
    );
    shape.ok()?.wheels().ok()
}

/// The frame in which what is now at `seen` is at `at`.
fn anchor(at: Pose, seen: Pose) -> Pose {
    let back = relative_to(seen, Pose::new(0.0, 0.0, 0.0));
    within(at, back)
}

/// What is at `pose` in a frame that is at `frame`.
fn within(frame: Pose, pose: Pose) -> Pose {
    let (sin, cos) = frame.heading.sin_cos();
    Pose::new(
        frame.x + cos * pose.x - sin * pose.y,
        frame.y + sin * pose.x + cos * pose.y,
        frame.heading + pose.heading,
    )
}
