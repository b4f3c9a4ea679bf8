//! Ways onto the virtual bus for programs that nobody here wrote.
//!
//! - [`slcan`]: the text protocol of serial CAN adapters, over TCP; python-can, slcand and `omnibus` itself
//!   speak it.

pub mod slcan;
