//! What is done to robots before they drive: found ([`survey`]), numbered ([`lss`]), their wiring
//! tried ([`wheel_test`]), their motors identified ([`motors`]), their slip and rollers calibrated
//! ([`calibrate`]), their firmware updated ([`update`]), and what they keep locked ([`lock`]).

#[cfg(feature = "calibration")]
pub mod calibrate;
pub mod lock;
pub mod lss;
pub mod motors;
pub mod survey;
pub mod update;
pub mod wheel_test;
