//! The group's state as ROS 2 messages.

use group::GroupFile;
use kinematics::{Covariance, Pose};
use ros::message::{
    self, BatteryState, Header, JointState, Matrix6, PoseWithCovariance, Quaternion, TFMessage,
    Time, Transform, TransformStamped, TwistWithCovariance, Vector3,
};
use ros::names::{self, Frames, WHEELS};

use super::odometry::Odometry;

/// Variance of what odometry on a floor does not know: height, roll, pitch.
const UNKNOWN: f64 = 1e6;

fn header(stamp: &Time, frame: &str) -> Header {
    Header {
        stamp: stamp.clone(),
        frame_id: frame.into(),
    }
}

/// A covariance of the plane in six dimensions. Never zero: that would mean certain.
fn matrix(of: Covariance<f64>) -> Matrix6 {
    let mut all = [0.0; 36];
    for (row, column, value) in [
        (0, 0, of.xx),
        (0, 1, of.xy),
        (0, 5, of.xw),
        (1, 1, of.yy),
        (1, 5, of.yw),
        (5, 5, of.ww),
        (2, 2, UNKNOWN),
        (3, 3, UNKNOWN),
        (4, 4, UNKNOWN),
    ] {
        all[row * 6 + column] = value;
        all[column * 6 + row] = value;
    }
    for diagonal in [0, 7, 35] {
        all[diagonal] = all[diagonal].max(f64::MIN_POSITIVE);
    }
    Matrix6(all)
}

fn place(pose: Pose) -> (f64, f64, Quaternion) {
    let turn = Quaternion::of_heading(f64::from(pose.heading));
    (f64::from(pose.x), f64::from(pose.y), turn)
}

/// `odom`.
#[must_use]
pub fn odometry(stamp: &Time, frames: &Frames, state: &Odometry) -> message::Odometry {
    let (x, y, orientation) = place(state.pose());
    let twist = state.twist();
    message::Odometry {
        header: header(stamp, &frames.odom),
        child_frame_id: frames.base.clone(),
        pose: PoseWithCovariance {
            pose: message::Pose {
                position: message::Point { x, y, z: 0.0 },
                orientation,
            },
            covariance: matrix(state.pose_covariance()),
        },
        twist: TwistWithCovariance {
            twist: message::Twist {
                linear: Vector3 {
                    x: f64::from(twist.vx),
                    y: f64::from(twist.vy),
                    z: 0.0,
                },
                angular: Vector3 {
                    z: f64::from(twist.omega),
                    ..Vector3::default()
                },
            },
            covariance: matrix(state.twist_covariance()),
        },
    }
}

/// `tf`: the group in the frame of its odometry.
#[must_use]
pub fn transforms(stamp: &Time, frames: &Frames, state: &Odometry) -> TFMessage {
    let (x, y, rotation) = place(state.pose());
    TFMessage {
        transforms: vec![TransformStamped {
            header: header(stamp, &frames.odom),
            child_frame_id: frames.base.clone(),
            transform: Transform {
                translation: Vector3 { x, y, z: 0.0 },
                rotation,
            },
        }],
    }
}

/// `joint_states`: every wheel of every robot.
#[must_use]
pub fn joints(stamp: &Time, group: &GroupFile, state: &Odometry) -> JointState {
    let mut joints = JointState {
        header: header(stamp, ""),
        ..JointState::default()
    };
    for (robot, (angles, rates)) in group.robots.iter().zip(state.wheels()) {
        for (index, wheel) in WHEELS.iter().enumerate() {
            joints.name.push(names::wheel_joint(robot.node, wheel));
            joints.position.push(angles[index]);
            joints.velocity.push(rates[index]);
        }
    }
    joints
}

/// `battery_state`: the robot with the lowest supply, which the group goes by.
#[must_use]
pub fn battery(stamp: &Time, supply: impl Iterator<Item = (u8, f32)>) -> Option<BatteryState> {
    let (node, voltage) = supply.min_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(BatteryState {
        header: header(stamp, &names::robot_link(node)),
        voltage,
        temperature: f32::NAN,
        current: f32::NAN,
        charge: f32::NAN,
        capacity: f32::NAN,
        design_capacity: f32::NAN,
        percentage: f32::NAN,
        present: true,
        location: names::robot_link(node),
        ..BatteryState::default()
    })
}
