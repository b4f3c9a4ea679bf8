//! Kinematics of Mecanum-wheeled robots and of groups of them.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;
