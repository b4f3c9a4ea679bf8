//! What can go wrong with a simulated robot, at the caller's word.
//!
//! Everything here happens outside the robot's program: at its inputs, wheels, wires and processor. What the robot
//! makes of it, it has to notice itself. Robots are named by their place in the group file, wheels in the usual order
//! (front left, front right, rear left, rear right); a place that does not exist is left alone. Native robots have no
//! processor, so what concerns one is answered with `false` by them.

use super::World;

/// What an encoder tells of its wheel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EncoderState {
    /// The truth.
    #[default]
    Works,
    /// Nothing: a broken wire.
    Dead,
    /// The opposite: its two channels are swapped.
    Reversed,
}

/// What is wrong with one robot.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Harm {
    encoders: [EncoderState; 4],
    /// The identifier of the frames that it does not get.
    pub misses: Option<u16>,
}

impl Harm {
    /// What the encoder says when its wheel has gone on by this many counts.
    pub fn on_counts(&self, wheel: usize, counts: i32) -> i32 {
        match self.encoders[wheel] {
            EncoderState::Works => counts,
            EncoderState::Dead => 0,
            EncoderState::Reversed => -counts,
        }
    }
}

impl World {
    /// Presses or releases the emergency stop of a robot, by its place in the group file.
    pub fn set_emergency_stop(&mut self, robot: usize, pressed: bool) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.robot.set_emergency_stop(pressed);
        }
    }

    /// Raises or clears the driver fault of a robot.
    pub fn set_driver_fault(&mut self, robot: usize, fault: bool) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.robot.set_driver_fault(fault);
        }
    }

    /// Plugs or pulls the CAN connector of a robot.
    pub fn set_connected(&mut self, robot: usize, connected: bool) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.connected = connected;
        }
    }

    /// Breaks or mends an encoder.
    pub fn set_encoder(&mut self, robot: usize, wheel: usize, state: EncoderState) {
        let unit = self.units.get_mut(robot);
        if let Some(encoder) = unit.and_then(|unit| unit.harm.encoders.get_mut(wheel)) {
            *encoder = state;
        }
    }

    /// Lets something drag at a wheel with this torque, N·m; 0 frees it.
    pub fn set_wheel_drag(&mut self, robot: usize, wheel: usize, torque: f64) {
        let unit = self.units.get_mut(robot);
        if let Some(motor) = unit.and_then(|unit| unit.motors.get_mut(wheel)) {
            motor.set_drag(torque);
        }
    }

    /// Keeps frames with this identifier from a robot, or none.
    pub fn set_misses(&mut self, robot: usize, id: Option<u16>) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.harm.misses = id;
        }
    }

    /// Lets a robot send a frame that fails until its controller goes off the bus. `false` when it has nothing to
    /// send at the moment.
    pub fn force_bus_off(&mut self, robot: usize) -> bool {
        let unit = self.units.get_mut(robot);
        unit.is_some_and(|unit| unit.robot.force_bus_off())
    }

    /// Lets more frames arrive at a robot at once than its controller can hold.
    pub fn overrun(&mut self, robot: usize) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.robot.overrun();
        }
    }

    /// Halts a robot's processor, or lets it go on; its peripherals run on. `false` when it has none.
    pub fn halt(&mut self, robot: usize, halted: bool) -> bool {
        let unit = self.units.get_mut(robot);
        unit.is_some_and(|unit| unit.robot.halt(halted))
    }

    /// Sends a robot's processor where there is no memory. `false` when it has none.
    pub fn crash(&mut self, robot: usize) -> bool {
        let unit = self.units.get_mut(robot);
        unit.is_some_and(|unit| unit.robot.crash())
    }
}
