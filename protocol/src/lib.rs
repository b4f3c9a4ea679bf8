//! What Omnibus says on the CAN bus.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;
