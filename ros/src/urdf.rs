//! The group as a robot's model: one body, the robots fixed to it, their wheels turning.
//!
//! Frames follow REP-103: x forward, y left, z up. A wheel's joint turns about its y axis, so that
//! a positive rate rolls the base forward. `base_link` is on the floor, at the origin of the group.

use std::fmt::Write as _;

use group::{GroupFile, Robot};

use crate::names::{WHEELS, robot_link, wheel_joint, wheel_link};

/// Width of a wheel over its radius, for the picture.
const WIDTH: f32 = 0.6;
/// Height of a robot's body over the radius of its wheels, for the picture.
const HEIGHT: f32 = 1.2;

/// The model as URDF. Frames have no prefix: `robot_state_publisher` adds one (`frame_prefix`).
#[must_use]
pub fn urdf(group: &GroupFile) -> String {
    let mut text = String::from("<?xml version=\"1.0\"?>\n");
    let name = escaped(&group.name);
    let _ = writeln!(
        text,
        "<robot name=\"{name}\">\n  <link name=\"base_link\"/>"
    );
    for robot in &group.robots {
        body(&mut text, robot);
        for (index, wheel) in WHEELS.iter().enumerate() {
            one_wheel(&mut text, robot, index, wheel);
        }
    }
    text += "</robot>\n";
    text
}

fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    text.replace('"', "&quot;")
}

fn body(text: &mut String, robot: &Robot) {
    let (link, mount, shape) = (robot_link(robot.node), robot.mount, &robot.geometry);
    let radius = shape.wheel_radius();
    let (long, wide) = (2.0 * shape.half_wheelbase(), 2.0 * shape.half_track());
    let high = HEIGHT * radius;
    let _ = writeln!(
        text,
        "  <link name=\"{link}\">
    <visual>
      <origin xyz=\"0 0 {radius}\" rpy=\"0 0 0\"/>
      <geometry><box size=\"{long} {wide} {high}\"/></geometry>
    </visual>
    <collision>
      <origin xyz=\"0 0 {radius}\" rpy=\"0 0 0\"/>
      <geometry><box size=\"{long} {wide} {high}\"/></geometry>
    </collision>
  </link>
  <joint name=\"{link}_joint\" type=\"fixed\">
    <parent link=\"base_link\"/>
    <child link=\"{link}\"/>
    <origin xyz=\"{} {} 0\" rpy=\"0 0 {}\"/>
  </joint>",
        mount.x, mount.y, mount.heading
    );
}

fn one_wheel(text: &mut String, robot: &Robot, index: usize, wheel: &str) {
    let (link, joint) = (
        wheel_link(robot.node, wheel),
        wheel_joint(robot.node, wheel),
    );
    let parent = robot_link(robot.node);
    let group::Wheel { x, y, radius, .. } = robot.each_wheel()[index];
    let width = WIDTH * radius;
    let quarter = std::f32::consts::FRAC_PI_2;
    let _ = writeln!(
        text,
        "  <link name=\"{link}\">
    <visual>
      <origin xyz=\"0 0 0\" rpy=\"{quarter} 0 0\"/>
      <geometry><cylinder radius=\"{radius}\" length=\"{width}\"/></geometry>
    </visual>
  </link>
  <joint name=\"{joint}\" type=\"continuous\">
    <parent link=\"{parent}\"/>
    <child link=\"{link}\"/>
    <origin xyz=\"{x} {y} {radius}\" rpy=\"0 0 0\"/>
    <axis xyz=\"0 1 0\"/>
    <limit effort=\"1000\" velocity=\"{}\"/>
  </joint>",
        robot.max_wheel_rate
    );
}
