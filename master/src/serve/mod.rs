//! The page of `omnibus serve`: who may see the group, who may drive it, and what stops it.
//!
//! ```text
//!  browser --WebSocket--> server (a thread per connection) --messages--> Controls
//!     ^                                                                     | orders
//!     '---- state, 20 times a second ---- PageState <--- telemetry ---- Pilot
//!                                                                         |
//!                                                                       robots
//! ```
//!
//! The [`Controls`](crate::controls::Controls) decide. A press becomes an order to the
//! [`Pilot`](crate::pilot::Pilot) that is good for
//! [`STALE_MS`](crate::controls::arbiter::STALE_MS) and no longer: when
//! nothing newer has come by then, the pilot commands standstill and the robots ramp down by the
//! limits of the group file. [`server`] carries messages and refuses strangers ([`http`]); it
//! cannot move anything by itself. Text messages are JSON ([`message`]).
//!
//! There is no encryption. The token keeps out clients that cannot read the traffic; across a
//! network that others can read, go through an SSH tunnel to the loopback address.

#[cfg(feature = "server")]
pub mod http;
pub mod message;
pub mod page_state;
#[cfg(feature = "server")]
pub mod server;
