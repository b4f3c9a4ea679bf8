//! The group's pose for `odom`, how well it is known, and the angles of its wheels.
//!
//! The pose is the members' own, the mean of them. It starts again whenever the robots are
//! configured; here it goes on from where it was. The covariance is that of the kinematics crate
//! for each member's wheel rates, as the mean of independent members, and grows with the way. A
//! member whose gyro is used measures turns by that, and its wheels' slip adds nothing to them.
//!
//! A bias of a gyro lasts longer than [`PERSISTS`]; of a motion of many seconds without a rest the
//! covariance of the heading is too small (docs/kinematics.md has the sum).

use group::{GroupFile, Robot};
use kinematics::{
    Covariance, Mount, Platform, Pose, Twist, TwistUncertainty, UncertainOdometry, Uncertainty,
    VelocityCompensation, Wheel, WheelRates,
};

use crate::monitor::average::mean_twist;
use crate::monitor::odometry::relative_to;
use crate::monitor::telemetry::{SessionState, Snapshot};

/// What is left of slip after a calibration, as a share of the velocity along each axis.
const LONGITUDINAL: f64 = 0.005;
const LATERAL: f64 = 0.01;
const YAW: f64 = 0.01;
/// What a gyro's scale is off, as a share of the yaw rate: an assumption, as those above are.
const GYRO_SCALE: f64 = 0.01;
/// What a gyro's rate is off in a second, and its bias after a second of rest, rad/s each. Public
/// programs quote the BMI088's noise density as 0.014 degrees/s/sqrt(Hz); its data sheet's table
/// was not at hand. The mean of a second of such noise deviates by 0.014 / sqrt(2), 0.010
/// degrees/s; what is left, 0.010 as well, is for the drift of the zero between rest and motion:
/// an assumption.
const GYRO_NOISE: f64 = 0.014 * std::f64::consts::PI / 180.0;
/// How long an error of the velocity lasts, s: slip is that of a motion, not of a step.
const PERSISTS: f64 = 1.0;
/// Longer between two snapshots, s, and nothing is worked out for the time between.
const GAP: f64 = 0.5;

/// What is known of a member's measurement.
struct Member {
    /// Its own twist by its wheels, along the axes of the group.
    wheels: TwistUncertainty<4, f64>,
    /// Its place in the group, m.
    place: [f64; 2],
}

impl Member {
    /// Covariance of the group's twist, by these wheel rates and the gyro's yaw rate.
    fn covariance(&self, rates: &[f64; 4], yaw_rate: Option<f32>) -> Covariance<f64> {
        let mut own = self.wheels.covariance(rates);
        if let Some(rate) = yaw_rate {
            let scale = GYRO_SCALE * f64::from(rate);
            own.ww = scale * scale + 2.0 * GYRO_NOISE * GYRO_NOISE;
            (own.xw, own.yw) = (0.0, 0.0);
        }
        // The group's origin moves with vx + y omega and vy - x omega.
        let ([x, y], Covariance { xw, yw, ww, .. }) = (self.place, own);
        Covariance {
            xx: own.xx + y * (2.0 * xw + y * ww),
            xy: own.xy + y * yw - x * (xw + y * ww),
            xw: xw + y * ww,
            yy: own.yy - x * (2.0 * yw - x * ww),
            yw: yw - x * ww,
            ww,
        }
    }
}

/// The group's twist as a member at this place measures it, turns by its gyro where that is used.
fn by_gyro(measured: Twist, yaw_rate: Option<f32>, place: Pose) -> Twist {
    let more = yaw_rate.map_or(0.0, |rate| rate - measured.omega);
    measured + Twist::new(place.y * more, -place.x * more, more)
}

/// Pose, velocity and wheel angles of a group.
pub struct Odometry {
    members: Vec<Member>,
    places: Vec<Pose>,
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
            let place = robot.mount;
            let mount = Mount::new(Pose::new(0.0, 0.0, f64::from(place.heading))).ok()?;
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
            Some(Member {
                wheels: TwistUncertainty::new(&platform, &mount, &none, &known),
                place: [f64::from(place.x), f64::from(place.y)],
            })
        });
        Self {
            members: members.collect(),
            places: group.robots.iter().map(|robot| robot.mount).collect(),
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
        let twists = now.members.iter().zip(&self.places);
        let twists = twists.filter_map(|(m, place)| Some(by_gyro(m.measured?, m.yaw_rate, *place)));
        self.twist = mean_twist(twists).unwrap_or(Twist::ZERO);
        for (index, member) in now.members.iter().enumerate() {
            let rates = member.wheel_rates.unwrap_or(WheelRates::ZERO);
            let rates = <[f32; 4]>::from(rates).map(f64::from);
            self.rates[index] = rates;
            for (angle, rate) in self.angles[index].iter_mut().zip(rates) {
                *angle += rate * dt;
            }
        }
        self.velocity = self.spread(now);
        let twist = self.twist;
        let [vx, vy, omega] = [twist.vx, twist.vy, twist.omega].map(|v| f64::from(v) * dt);
        // Of `n` steps with one error in common the variances add up to n times as much.
        let covariance = self.velocity.scaled(dt * PERSISTS.max(dt));
        self.uncertain
            .advance(Twist::new(vx, vy, omega), &covariance);
    }

    /// Covariance of the mean of the members' twists.
    fn spread(&self, now: &Snapshot) -> Covariance<f64> {
        let count = self.members.len().max(1) as f64;
        let yaw_rates = now.members.iter().map(|member| member.yaw_rate);
        let yaw_rates = yaw_rates.chain(std::iter::repeat(None));
        let sum = self.members.iter().zip(&self.rates).zip(yaw_rates);
        let sum = sum.map(|((member, rates), yaw_rate)| member.covariance(rates, yaw_rate));
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
    let one = |wheel: group::Wheel| {
        let (x, y, radius) = (wide(wheel.x), wide(wheel.y), wide(wheel.radius));
        Wheel::new(x, y, 0.0, wide(wheel.roller_angle), radius).ok()
    };
    let [a, b, c, d] = robot.each_wheel();
    Some([one(a)?, one(b)?, one(c)?, one(d)?])
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::telemetry::MemberSample;

    /// One robot 1 m to the left of the group's origin that turns by its wheels at 0.5 rad/s while
    /// its front wheels slip, and by its gyro, if it has one, at 0.4.
    fn turned(yaw_rate: Option<f32>) -> Odometry {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/single.toml");
        let mut group = GroupFile::load(path).unwrap();
        group.robots[0].mount = Pose::new(0.0, 1.0, 0.0);
        let mut odometry = Odometry::new(&group);
        for step in 0..100_u8 {
            odometry.update(&Snapshot {
                t: f64::from(step) * 0.01,
                members: vec![MemberSample {
                    measured: Some(Twist::new(0.5, 0.0, 0.5)),
                    wheel_rates: Some(WheelRates::from([-1.7, 2.7, -1.7, 2.2])),
                    yaw_rate,
                    ..MemberSample::default()
                }],
                ..Snapshot::default()
            });
        }
        odometry
    }

    /// By hand: (1 % of 0.4 rad/s)^2 + 2 (0.014 degrees/s)^2 = 1.6119e-5, over 0.99 s with errors
    /// that last 1 s.
    #[test]
    fn a_gyro_says_how_a_robot_turns_and_how_well_that_is_known() {
        let (wheels, gyro) = (turned(None), turned(Some(0.4)));
        assert_eq!(wheels.twist(), Twist::new(0.5, 0.0, 0.5));
        // It stands where it is, and the origin turns about it.
        let twist = gyro.twist();
        assert!((twist.vx - 0.4).abs() < 1e-6 && (twist.omega - 0.4).abs() < 1e-6);
        let known = gyro.twist_covariance();
        assert!((known.ww - 1.6119e-5).abs() < 1e-9, "{known:?}");
        assert!((known.xw - known.ww).abs() < 1e-12, "a lever of 1 m");
        assert!((gyro.pose_covariance().ww - 0.99 * known.ww).abs() < 1e-9);
        assert!(wheels.twist_covariance().ww > 10.0 * known.ww);
    }
}
