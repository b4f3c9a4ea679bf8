//! Identification of the motors on the bus: requested by SDO, with the results in objects that can
//! be read at any time.
//!
//! It begins where a commissioning twist would (started, standing, permitted by object 0x2050:1,
//! which declares the wheels free or the area clear) and ends at rest: success, failure and abort
//! all ramp to standstill and switch off, and the robot moves again only after an NMT start. No
//! result takes effect by itself. Heartbeat and SYNC of the master are monitored as in any motion.

use ::identification::{Bounds, Outcome, Stopped, WheelModel};
use canopen::{AbortCode, NmtState};
use control::time::Micros;
use control::wheel::Gains;
use protocol::Address;

use super::Application;
use crate::state::{self, State};

/// What has been asked for, and the result.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Identification {
    /// The commissioning motion is an identification.
    pub is_running: bool,
    /// Object 0x2051:2.
    pub status: u8,
    /// Object 0x2051:3: the wheel concerned, or 255.
    pub wheel: u8,
    pub bounds: Bounds,
    /// Wanted bandwidth of the wheel loops, rad/s.
    pub bandwidth: f32,
    /// Wanted damping of the wheel loops, without a unit.
    pub damping: f32,
    models: [WheelModel; 4],
}

/// No wheel in particular.
const NO_WHEEL: u8 = u8::MAX;
const RUNNING: u8 = 1;
const DONE: u8 = 2;

impl Identification {
    /// What may be asked for is as after power-on; the results stay.
    pub fn reset(&mut self) {
        let new = Self::new();
        self.bounds = new.bounds;
        (self.bandwidth, self.damping) = (new.bandwidth, new.damping);
    }

    pub const fn new() -> Self {
        Self {
            is_running: false,
            status: 0,
            wheel: 0,
            bounds: Bounds {
                rate: 5.0,
                travel: 12.0,
                wheels: 0,
            },
            bandwidth: 10.0,
            damping: 1.0,
            models: [WheelModel {
                static_friction: 0.0,
                speed: 0.0,
                acceleration: 0.0,
                residual: 0.0,
            }; 4],
        }
    }

    /// A result, by its object: 0x2052 to 0x2055 for the four wheels.
    pub fn result(&self, address: Address) -> Option<f32> {
        let wheel = address
            .index
            .checked_sub(protocol::address::identified::FIRST)?;
        let model = self.models.get(usize::from(wheel))?;
        let gains = gains(model, self.bandwidth, self.damping);
        Some(match address.sub {
            1 => model.static_friction,
            2 => model.speed,
            3 => model.acceleration,
            4 => gains.proportional,
            5 => gains.integral,
            6 => model.residual,
            _ => return None,
        })
    }
}

/// Feedforward as found, and a loop with this bandwidth `b`, rad/s, and damping `d`: the
/// characteristic polynomial `kA s^2 + (kV + kP) s + kI` is made `kA (s^2 + 2 d b s + b^2)`.
///
/// A wheel that is more than damped enough by its own back-EMF still gets a tenth of `kV`, because
/// the loop's anti-windup needs some `kP`.
fn gains(model: &WheelModel, bandwidth: f32, damping: f32) -> Gains {
    let proportional = 2.0 * damping * bandwidth * model.acceleration - model.speed;
    Gains {
        static_friction: model.static_friction,
        speed: model.speed,
        acceleration: model.acceleration,
        proportional: proportional.max(0.1 * model.speed),
        integral: model.acceleration * bandwidth * bandwidth,
    }
}

impl Application {
    /// Takes in what the control side has found out.
    pub fn on_identification(&mut self, now: Micros, outcome: &Outcome) {
        let record = &mut self.identification;
        (record.status, record.wheel) = match outcome {
            Ok(models) => {
                record.models = *models;
                (DONE, NO_WHEEL)
            }
            Err((why, wheel)) => (why.code(), wheel.unwrap_or(NO_WHEEL)),
        };
        self.end_identification(now);
    }

    /// A write of 0x2051:1. A run begins only where a robot may move alone; what it may do is
    /// settled before.
    pub(super) fn begin_identification(&mut self, nmt: NmtState) -> Result<(), AbortCode> {
        let is_able = self.state == State::Armed && self.able().is_some();
        if nmt != NmtState::Operational || !self.alone.is_permitted || !is_able {
            return Err(AbortCode::DeviceState);
        }
        let record = &mut self.identification;
        record.is_running = true;
        record.status = RUNNING;
        record.wheel = NO_WHEEL;
        record.models = [WheelModel::default(); 4];
        self.command.bounds = record.bounds;
        self.transition(state::Event::OwnSetpoint, self.now());
        Ok(())
    }

    /// Stops it, or takes note that it has ended.
    pub(super) fn end_identification(&mut self, now: Micros) {
        if self.state == State::Alone && self.identification.is_running {
            self.transition(state::Event::Left, now);
        }
        if self.identification.status == RUNNING {
            self.identification.status = Stopped::Asked.code();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_place_the_poles_where_they_are_asked_for() {
        let model = WheelModel {
            static_friction: 0.4,
            speed: 0.8,
            acceleration: 0.15,
            residual: 0.0,
        };
        // s^2 + (kV + kP)/kA s + kI/kA = s^2 + 2 * 0.8 * 20 s + 400.
        let found = gains(&model, 20.0, 0.8);
        assert!(((found.speed + found.proportional) / found.acceleration - 32.0).abs() < 1e-4);
        assert!((found.integral / found.acceleration - 400.0).abs() < 1e-3);
        // Slower than the motor is by itself: 2 * 1 * 2 * 0.15 < 0.8.
        assert!((gains(&model, 2.0, 1.0).proportional - 0.08).abs() < 1e-6);
    }
}
