//! The simulator's fault injection in the place of a person's hands.

use canopen::Micros;
use sim::EncoderState;

use super::link::SimLink;
use crate::accept::hand::{Hand, Prepared, Task};
use crate::error::MasterError;
use crate::session::Group;

/// A share of the minimum to which the supply is lowered, and of the maximum to which it is raised.
const LOWERED: f64 = 0.9;
const RAISED: f64 = 1.02;

/// Hands that act at once, and never refuse.
#[derive(Clone, Copy, Debug, Default)]
pub struct Injection;

impl Injection {
    /// Does it, or undoes it.
    fn set(group: &mut Group<SimLink>, task: Task, on: bool) {
        let config = group.config();
        let node = task.node();
        let place = config.robots.iter().position(|robot| robot.node == node);
        let Some(place) = place else { return };
        let supply = f64::from(config.robots[place].motor.supply);
        let world = &mut group.link().world;
        match task {
            Task::UnplugEncoder { wheel, .. } => {
                let state = if on {
                    EncoderState::Dead
                } else {
                    EncoderState::Works
                };
                world.set_encoder(place, wheel, state);
            }
            Task::UnplugBus { .. } => world.set_connected(place, !on),
            Task::PressStop { .. } => world.set_emergency_stop(place, on),
            Task::DriverFault { .. } => world.set_driver_fault(place, on),
            Task::OpenProtectiveStop { .. } => world.set_protective_stop(place, on),
            Task::LowerSupply { minimum_v, .. } => {
                let low = f64::from(minimum_v) * LOWERED;
                world.set_supply(place, if on { low } else { supply });
            }
            Task::RaiseSupply { maximum_v, .. } => {
                let high = f64::from(maximum_v) * RAISED;
                world.set_supply(place, if on { high } else { supply });
            }
        }
    }
}

impl Hand<SimLink> for Injection {
    fn prepare(&mut self, _: &mut Group<SimLink>, _: Task) -> Result<Prepared, MasterError> {
        Ok(Prepared::Ready)
    }

    fn act(&mut self, group: &mut Group<SimLink>, task: Task) -> Option<Micros> {
        Self::set(group, task, true);
        Some(group.link().world.now())
    }

    fn undo(&mut self, group: &mut Group<SimLink>, task: Task) -> Result<(), MasterError> {
        Self::set(group, task, false);
        // What has been put right is believed after a while: a second for a supply.
        let until = Micros(group.link().world.now().0 + 1_200_000);
        group.listen(until)
    }

    fn patience_us(&self) -> u64 {
        0
    }
}
