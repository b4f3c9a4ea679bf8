//! What the group is called in ROS: frames, joints, namespaces.

/// Names of frames, which several groups in one tree of frames tell apart by a prefix.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frames {
    /// The frame of the odometry.
    pub odom: String,
    /// The group's frame.
    pub base: String,
}

impl Frames {
    /// The usual names behind a prefix, such as `left/`.
    #[must_use]
    pub fn new(prefix: &str) -> Self {
        Self {
            odom: format!("{prefix}odom"),
            base: format!("{prefix}base_link"),
        }
    }
}

/// The wheels of a robot, in the order of its wheel rates.
pub const WHEELS: [&str; 4] = ["front_left", "front_right", "rear_left", "rear_right"];

/// The link of a robot in the group.
#[must_use]
pub fn robot_link(node: u8) -> String {
    format!("robot_{node}")
}

/// The link of a robot's wheel.
#[must_use]
pub fn wheel_link(node: u8, wheel: &str) -> String {
    format!("robot_{node}_{wheel}_wheel")
}

/// The joint of a robot's wheel.
#[must_use]
pub fn wheel_joint(node: u8, wheel: &str) -> String {
    format!("robot_{node}_{wheel}_wheel_joint")
}

/// A namespace as ROS writes it: `/` or `/a/b`.
///
/// # Errors
/// With the reason when it is none.
pub fn namespace(text: &str) -> Result<String, String> {
    let trimmed = text.trim_matches('/');
    if trimmed.is_empty() {
        return Ok("/".into());
    }
    for token in trimmed.split('/') {
        let begins = token
            .chars()
            .next()
            .is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
        let fits = token.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        if !begins || !fits || token.contains("__") {
            return Err(format!(
                "the namespace {text}: `{token}` is not a name of letters, digits and single \
                 underscores that begins with a letter"
            ));
        }
    }
    Ok(format!("/{trimmed}"))
}
