//! Parameters of Nav2 for a group: a controller that strafes, its limits, and the group's outline.
//!
//! The limits are those of the group file, and the outline is the convex hull of the robots' wheels
//! with a margin. Parameters that do not depend on the group (costs, tolerances, the planner) have
//! initial values that the user tunes.

use std::fmt::Write as _;

use group::GroupFile;

use crate::names::Frames;

/// Around the wheels' centres there is that much more robot, in wheel radii.
const MARGIN: f32 = 1.0;
/// Share of the limits at which Nav2 drives; the rest is for corrections.
const SHARE: f32 = 0.8;

/// The file. Frames have the prefix of the group's.
#[must_use]
pub fn params(group: &GroupFile, frames: &Frames) -> String {
    let limits = &group.limits;
    let (speed, turn) = (SHARE * limits.linear_speed, SHARE * limits.yaw_rate);
    let (push, twist) = (limits.linear_acceleration, limits.yaw_acceleration);
    let outline = outline(group);
    let mut footprint = String::from("[");
    for (index, (x, y)) in outline.iter().enumerate() {
        let comma = if index == 0 { "" } else { ", " };
        let _ = write!(footprint, "{comma}[{x:.3}, {y:.3}]");
    }
    footprint.push(']');
    let reach = outline.iter().map(|(x, y)| x.hypot(*y)).fold(0.0, f32::max);
    let (odom, base) = (&frames.odom, &frames.base);
    let (window, inflation) = (6.0 * reach, reach + 0.3);
    format!(
        "# Nav2 for the group {name}, made by omnibus group nav2. Limits in m/s, rad/s, m/s2, rad/s2.
# The group strafes: motion_model Omni, and three axes in the velocity smoother.
controller_server:
  ros__parameters:
    controller_frequency: 20.0
    odom_topic: odom
    enable_stamped_cmd_vel: true
    min_x_velocity_threshold: 0.001
    min_y_velocity_threshold: 0.001
    min_theta_velocity_threshold: 0.001
    progress_checker_plugins: [progress_checker]
    goal_checker_plugins: [goal_checker]
    controller_plugins: [FollowPath]
    progress_checker:
      plugin: nav2_controller::PoseProgressChecker
      required_movement_radius: 0.1
      required_movement_angle: 0.2
      movement_time_allowance: 10.0
    goal_checker:
      plugin: nav2_controller::SimpleGoalChecker
      xy_goal_tolerance: 0.05
      yaw_goal_tolerance: 0.05
      stateful: true
    FollowPath:
      plugin: nav2_mppi_controller::MPPIController
      motion_model: Omni
      time_steps: 40
      model_dt: 0.05
      batch_size: 1000
      vx_max: {speed}
      vx_min: {back}
      vy_max: {speed}
      wz_max: {turn}
      ax_max: {push}
      ax_min: {brake}
      ay_max: {push}
      ay_min: {brake}
      az_max: {twist}
      vx_std: {spread}
      vy_std: {spread}
      wz_std: {spread_turn}
      critics: [ConstraintCritic, ObstaclesCritic, GoalCritic, GoalAngleCritic, PathAlignCritic, PathFollowCritic, PathAngleCritic, TwirlingCritic]
      ObstaclesCritic:
        enabled: true
        consider_footprint: true
      TwirlingCritic:
        enabled: true
        cost_weight: 10.0
velocity_smoother:
  ros__parameters:
    smoothing_frequency: 20.0
    feedback: OPEN_LOOP
    odom_topic: odom
    enable_stamped_cmd_vel: true
    max_velocity: [{speed}, {speed}, {turn}]
    min_velocity: [{back}, {back}, {unturn}]
    max_accel: [{push}, {push}, {twist}]
    max_decel: [{brake}, {brake}, {untwist}]
    velocity_timeout: 0.2
behavior_server:
  ros__parameters:
    enable_stamped_cmd_vel: true
    local_frame: {odom}
    global_frame: map
    robot_base_frame: {base}
    max_rotational_vel: {turn}
    rotational_acc_lim: {twist}
bt_navigator:
  ros__parameters:
    global_frame: map
    robot_base_frame: {base}
    odom_topic: odom
planner_server:
  ros__parameters:
    planner_plugins: [GridBased]
    GridBased:
      plugin: nav2_navfn_planner::NavfnPlanner
      tolerance: 0.1
      allow_unknown: true
local_costmap:
  local_costmap:
    ros__parameters:
      global_frame: {odom}
      robot_base_frame: {base}
      rolling_window: true
      width: {cells}
      height: {cells}
      resolution: 0.05
      footprint: \"{footprint}\"
      plugins: [inflation_layer]
      inflation_layer:
        plugin: nav2_costmap_2d::InflationLayer
        inflation_radius: {inflation:.2}
        cost_scaling_factor: 3.0
global_costmap:
  global_costmap:
    ros__parameters:
      global_frame: map
      robot_base_frame: {base}
      resolution: 0.05
      footprint: \"{footprint}\"
      plugins: [static_layer, inflation_layer]
      static_layer:
        plugin: nav2_costmap_2d::StaticLayer
        map_subscribe_transient_local: true
      inflation_layer:
        plugin: nav2_costmap_2d::InflationLayer
        inflation_radius: {inflation:.2}
        cost_scaling_factor: 3.0
",
        name = group.name,
        speed = real(speed),
        back = real(-speed),
        turn = real(turn),
        unturn = real(-turn),
        push = real(push),
        brake = real(-push),
        twist = real(twist),
        untwist = real(-twist),
        spread = real(0.3 * speed),
        spread_turn = real(0.3 * turn),
        cells = window.ceil().max(3.0),
    )
}

/// A number that YAML takes for a real one.
fn real(value: f32) -> String {
    format!("{value:?}")
}

/// Convex hull of the robots' wheels with their margin, counter-clockwise, m.
fn outline(group: &GroupFile) -> Vec<(f32, f32)> {
    let mut points = Vec::new();
    for robot in &group.robots {
        let shape = &robot.geometry;
        let margin = MARGIN * shape.wheel_radius();
        let (long, wide) = (shape.half_wheelbase() + margin, shape.half_track() + margin);
        let (sin, cos) = robot.mount.heading.sin_cos();
        for (x, y) in [(long, wide), (-long, wide), (-long, -wide), (long, -wide)] {
            let (x, y) = (cos * x - sin * y, sin * x + cos * y);
            points.push((robot.mount.x + x, robot.mount.y + y));
        }
    }
    hull(points)
}

/// Andrew's monotone chain.
fn hull(mut points: Vec<(f32, f32)>) -> Vec<(f32, f32)> {
    points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let half = |points: &mut dyn Iterator<Item = (f32, f32)>| {
        let mut chain: Vec<(f32, f32)> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..] {
                let turn = (b.0 - a.0) * (point.1 - a.1) - (b.1 - a.1) * (point.0 - a.0);
                if turn > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut lower = half(&mut points.iter().copied());
    lower.extend(half(&mut points.iter().rev().copied()));
    lower
}
