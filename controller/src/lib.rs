//! One robot of a group, without I/O.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;
