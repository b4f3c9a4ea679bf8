//! A CiA 301 device without I/O.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;
