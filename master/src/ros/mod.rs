//! `omnibus ros`: the group as one holonomic robot to ROS 2.
//!
//! ```text
//!  DDS <--> node (thread) --velocities, calls--> Commands --wishes--> Controls --orders--> Pilot
//!             ^                                                                             |
//!             '-- a bounded channel, no waiting -- messages <------- telemetry -----------'
//! ```
//!
//! The node lives in a thread of its own, because its library panics where it should not. When that
//! thread ends, for whatever reason, the robots are ramped down and switched off, and so ends
//! `operate`. When it hangs, the last velocity runs out in the pilot; when the program dies, the
//! robots ramp down because SYNC is missing, as with a pulled plug.
//!
//! `commands` judges what comes in; the [`Controls`](crate::controls::Controls) decide who drives.
//! Nothing here moves a group by itself.
//!
//! [`messages`] and [`odometry`] need no network.

#[cfg(feature = "ros")]
pub mod commands;
#[cfg(feature = "ros")]
pub mod diagnostics;
pub mod messages;
pub mod odometry;
#[cfg(feature = "ros")]
mod operate;

#[cfg(feature = "ros")]
pub use operate::{NodeBody, Options, RosError, operate};
