//! Parameters of `robot_localization` for a group: a filter in the plane that takes the velocity of
//! `odom` and publishes the transform, with room for a gyroscope.

use crate::names::Frames;

/// The file. `omnibus ros --no-tf` leaves the transform to the filter.
#[must_use]
pub fn params(name: &str, frames: &Frames, rate: f64) -> String {
    let Frames { odom, base } = frames;
    format!(
        "# robot_localization for the group {name}, made by omnibus group localization.
# Start the node with omnibus ros --no-tf: this filter publishes {odom} to {base}.
# Rows of a configuration: x y z, roll pitch yaw, their rates, accelerations.
ekf_filter_node:
  ros__parameters:
    frequency: {rate:?}
    two_d_mode: true
    publish_tf: true
    map_frame: map
    odom_frame: {odom}
    base_link_frame: {base}
    world_frame: {odom}
    odom0: odom
    odom0_config: [false, false, false,
                   false, false, false,
                   true,  true,  false,
                   false, false, true,
                   false, false, false]
    odom0_differential: false
    odom0_queue_size: 10
    # A gyroscope, which knows turns better than wheels that slip:
    # imu0: imu/data
    # imu0_config: [false, false, false,
    #               false, false, false,
    #               false, false, false,
    #               false, false, true,
    #               false, false, false]
"
    )
}
