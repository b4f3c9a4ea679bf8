//! The page with the group inside: robots, bus, floor and master in a browser.
//!
//! # Theory of operation
//!
//! The page is the one of `omnibus serve`; `page/backend.js` here stands in for its WebSocket. It
//! starts a worker that runs this crate as WebAssembly:
//!
//! ```text
//!  page --messages--> worker --> Playground: Controls --orders--> Flight --> Group (the session)
//!    ^                                                                          | frames
//!    '-- state, frames, robot -- PageState <--- telemetry ----------------------'  sim::World
//! ```
//!
//! [`choice`] makes a group file of what was chosen on the page. [`playground`] is the world of
//! such a file with its master; it moves only while [`playground::Playground::advance`] runs, and
//! all its times are virtual. [`panes`] says what the page shows beside the group: frames, and one
//! robot from inside. [`scenario`] drives a metre and says everything about it, so that a browser
//! can be compared with this machine. The module `abi` is what JavaScript calls.
//!
//! # Limits
//!
//! Starting, stopping and configuring run to their end within one call, in virtual time, and
//! messages of the page wait for it. One thread runs all robots.

#[cfg(target_arch = "wasm32")]
mod abi;
pub mod choice;
pub mod panes;
pub mod playground;
pub mod scenario;
