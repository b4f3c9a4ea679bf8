//! The names of the group in ROS: frames, joints, namespaces.

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
    levels(trimmed)?;
    Ok(format!("/{trimmed}"))
}

/// A prefix of frames as it was given: nothing, or names as in a namespace and what separates the
/// last of them from the frame. tf2 has no frame that begins with a slash.
///
/// # Errors
/// With the reason when it is none.
pub fn frame_prefix(text: &str) -> Result<String, String> {
    if text.starts_with('/') {
        return Err("frames of tf2 do not begin with a slash; leave it out".into());
    }
    if !text.is_empty() {
        levels(text.trim_end_matches(['/', '_']))?;
    }
    Ok(text.into())
}

fn levels(text: &str) -> Result<(), String> {
    for token in text.split('/') {
        let begins = token
            .chars()
            .next()
            .is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
        let fits = token.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        if !begins || !fits || token.contains("__") {
            return Err(format!(
                "`{token}` is not a name of letters, digits and single underscores that begins \
                 with a letter"
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn namespaces_have_one_slash_in_front_and_none_behind() {
        for (text, is) in [
            ("", "/"),
            ("/", "/"),
            ("left", "/left"),
            ("/a/_b1/", "/a/_b1"),
        ] {
            assert_eq!(namespace(text).as_deref(), Ok(is));
        }
        for text in ["9x", "a//b", "a b", "a__b", "a-b", "~"] {
            assert!(namespace(text).is_err(), "{text}");
        }
    }

    #[test]
    fn prefixes_of_frames_are_taken_as_they_are_or_refused() {
        for text in ["", "left/", "robot_", "a/b/", "left"] {
            assert_eq!(frame_prefix(text).as_deref(), Ok(text));
        }
        for text in ["/left/", "a b", "a//b/", "9x", "/", "_"] {
            assert!(frame_prefix(text).is_err(), "{text}");
        }
    }
}
