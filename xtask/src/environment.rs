//! The environment of a `cargo` that is started by a program which `cargo` has started.

use std::process::Command;

/// Leaves out what `cargo run` says of the package that it runs. A build script may ask to be run
/// again when that changes, as that of `ring` does, and what depends on it is then compiled again:
/// half of everything, whenever a build with a task follows one without.
pub fn without_package(command: &mut Command) {
    for (name, _) in std::env::vars_os() {
        if name.to_str().is_some_and(is_of_a_package) {
            command.env_remove(name);
        }
    }
}

/// Whether a variable is one that `cargo` sets for each package.
fn is_of_a_package(name: &str) -> bool {
    const NAMES: [&str; 4] = [
        "CARGO_BIN_NAME",
        "CARGO_CRATE_NAME",
        "CARGO_PRIMARY_PACKAGE",
        "OUT_DIR",
    ];
    NAMES.contains(&name) || name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_user_has_set_stays() {
        for name in ["CARGO_MANIFEST_DIR", "CARGO_PKG_VERSION_PRE", "OUT_DIR"] {
            assert!(is_of_a_package(name), "{name}");
        }
        for name in [
            "CARGO",
            "CARGO_HOME",
            "CARGO_TARGET_DIR",
            "CARGO_NET_OFFLINE",
            "PATH",
        ] {
            assert!(!is_of_a_package(name), "{name}");
        }
    }
}
