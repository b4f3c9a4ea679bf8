//! What the tasks of `cargo xtask` share, and the demo, which is a program of its own, too.
//!
//! [`cargo`] runs the tools and [`firmware`] builds and inspects the image.
#![expect(
    clippy::missing_errors_doc,
    reason = "every error is printed, with the cause and the remedy, and ends the task"
)]

use std::process::ExitCode;

pub mod cargo;
pub mod demo;
mod environment;
pub mod firmware;

/// The exit code of a task: that which it gives, or 1 with its error on standard error.
pub fn exit_code(done: anyhow::Result<ExitCode>) -> ExitCode {
    done.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::FAILURE
    })
}
