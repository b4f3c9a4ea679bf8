//! What is done to robots before they drive: found ([`survey`]), numbered ([`lss`]), their wiring
//! tried ([`wheel_test`]), their motors identified ([`motors`]) and their slip and rollers
//! calibrated ([`calibrate`]).

#[cfg(feature = "calibration")]
pub mod calibrate;
pub mod lss;
pub mod motors;
pub mod survey;
pub mod wheel_test;
