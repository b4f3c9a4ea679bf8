//! What can go wrong with a simulated robot, at the caller's word.
//!
//! Everything here happens outside the robot's program: at its inputs, wheels, wires and processor.
//! What the robot makes of it, it has to notice itself. Robots are named by their place in the
//! group file, wheels in the usual order (front left, front right, rear left, rear right); a place
//! that does not exist is left alone. Native robots have no processor, so what concerns one is
//! answered with `false` by them.

use canopen::Frame;

use super::index::IndexState;
use super::unit::Unit;
use super::{EncoderState, Port, World};
use crate::bus::disturb::Share;
use crate::bus::errors::{ErrorCounters, ErrorState};
use crate::motor::Brake;
use crate::robot::Crash;

/// What is wrong with one robot on the bus.
#[derive(Debug, Clone, Copy)]
pub(super) struct InjectedFaults {
    /// The identifier of the frames that it does not get.
    pub misses: Option<u16>,
    /// Frames that its receiver gets wrong.
    pub bad_receiver: Share,
    /// What its controller sends all the time instead of its own frames.
    pub babble: Option<Frame>,
    /// By how much its frames are late, ns.
    pub delay_ns: u64,
}

impl Default for InjectedFaults {
    fn default() -> Self {
        Self {
            misses: None,
            bad_receiver: Share::NONE,
            babble: None,
            delay_ns: 0,
        }
    }
}

impl World {
    /// A robot that something is about to happen to.
    fn touched(&mut self, robot: usize) -> Option<&mut Unit> {
        let unit = self.units.get_mut(robot)?;
        unit.touch(self.now_ns, self.options.motor_step_ns);
        Some(unit)
    }

    /// Presses or releases the emergency stop of a robot, by its place in the group file.
    pub fn set_emergency_stop(&mut self, robot: usize, pressed: bool) {
        if let Some(unit) = self.touched(robot) {
            unit.robot.set_emergency_stop(pressed);
        }
    }

    /// Opens or closes the protective stop of a robot, by its place in the group file.
    pub fn set_protective_stop(&mut self, robot: usize, open: bool) {
        if let Some(unit) = self.touched(robot) {
            unit.robot.set_protective_stop(open);
        }
    }

    /// Raises or clears the driver fault of a robot.
    pub fn set_driver_fault(&mut self, robot: usize, fault: bool) {
        if let Some(unit) = self.touched(robot) {
            unit.robot.set_driver_fault(fault);
        }
    }

    /// Takes a robot's power away or gives it back; once is as good as twice. Its wheels roll on
    /// until friction and brake stop them.
    pub fn set_power(&mut self, robot: usize, on: bool) {
        if let Some(unit) = self.touched(robot)
            && unit.powered != on
        {
            unit.powered = on;
            unit.robot.set_power(on);
            unit.held = None;
            if !on {
                self.cut_off(self.node_of(robot));
            }
        }
    }

    /// Whether a robot has power.
    #[must_use]
    pub fn is_powered(&self, robot: usize) -> bool {
        self.units.get(robot).is_some_and(|unit| unit.powered)
    }

    /// Plugs or pulls the CAN connector of a robot.
    pub fn set_connected(&mut self, robot: usize, connected: bool) {
        let now_ns = self.now_ns;
        if let Some(unit) = self.touched(robot) {
            unit.connected = connected;
            unit.alone_ns = now_ns;
            if !connected {
                self.cut_off(self.node_of(robot));
            }
        }
    }

    /// Breaks the cable before a robot: it and all that follow it in the group file hear only each
    /// other, the others and the ports only themselves. `None` mends it. A frame on the wire
    /// meanwhile is lost, with an error frame.
    pub fn set_partition(&mut self, first: Option<usize>) {
        for (place, unit) in self.units.iter_mut().enumerate() {
            unit.far = first.is_some_and(|first| place >= first);
        }
        let foreign = self.node_of(self.units.len());
        (0..=foreign).for_each(|node| self.cut_off(node));
    }

    /// A node stops in the middle of its frame, if it is sending one.
    fn cut_off(&mut self, node: usize) {
        self.bus.cut_off(self.now_ns, node);
        self.far.cut_off(self.now_ns, node);
    }

    /// Inverts one bit of this share of the frames, for everybody.
    pub fn set_corruption(&mut self, share: Share) {
        self.disturbances.corrupt = share;
    }

    /// Keeps the acknowledge of this share of the frames from their senders.
    pub fn set_lost_acknowledge(&mut self, share: Share) {
        self.disturbances.unacknowledged = share;
    }

    /// Lets a node that is none of ours send frames with this identifier all the time, or nothing.
    pub fn set_babbler(&mut self, id: Option<u16>) {
        self.disturbances.babble = id.and_then(babble);
    }

    /// Lets a robot's receiver get this share of the frames wrong.
    pub fn set_bad_receiver(&mut self, robot: usize, share: Share) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.injected.bad_receiver = share;
        }
    }

    /// Lets a robot's CAN controller send frames with this identifier all the time instead of its
    /// own.
    pub fn set_babbling(&mut self, robot: usize, id: Option<u16>) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.injected.babble = id.and_then(babble);
        }
    }

    /// Lets everything that a robot sends reach the bus later by this, ns.
    pub fn set_delay(&mut self, robot: usize, delay_ns: u64) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.injected.delay_ns = delay_ns;
            unit.held = None;
        }
    }

    /// Lets everything that is sent at the ports from now on reach the bus later by this, ns, as a
    /// slow adapter does.
    pub fn set_port_delay(&mut self, delay_ns: u64) {
        self.port_delay_ns = delay_ns;
    }

    /// What a robot's CAN controller may still do, and its error counters.
    #[must_use]
    pub fn robot_errors(&self, robot: usize) -> (ErrorState, ErrorCounters) {
        let unit = self.units.get(robot);
        unit.map_or_else(Default::default, |unit| unit.robot.error_state())
    }

    /// What the node at a port may still do, and its error counters.
    #[must_use]
    pub fn port_errors(&self, port: Port) -> (ErrorState, ErrorCounters) {
        let errors = self.ports.get(port.0).map(|port| port.errors);
        errors.map_or_else(Default::default, |e| (e.state(), e.counters()))
    }

    /// Breaks or mends an encoder.
    pub fn set_encoder(&mut self, robot: usize, wheel: usize, state: EncoderState) {
        let unit = self.touched(robot);
        if let Some(encoder) = unit.and_then(|unit| unit.encoders.get_mut(wheel)) {
            encoder.set_state(state);
        }
    }

    /// Lets noise strike the wires of an encoder so many times a second, or ends it with 0.
    pub fn set_encoder_noise(&mut self, robot: usize, wheel: usize, hz: f64) {
        let unit = self.touched(robot);
        if let Some(encoder) = unit.and_then(|unit| unit.encoders.get_mut(wheel)) {
            encoder.set_noise(hz);
        }
    }

    /// Gives the wires of an encoder slow rising edges: R times C, s; 0 ends it.
    pub fn set_encoder_slow_edges(&mut self, robot: usize, wheel: usize, rc: f64) {
        let unit = self.touched(robot);
        if let Some(encoder) = unit.and_then(|unit| unit.encoders.get_mut(wheel)) {
            encoder.set_slow_edges(rc);
        }
    }

    /// Breaks or mends the index of an encoder.
    pub fn set_index(&mut self, robot: usize, wheel: usize, state: IndexState) {
        let unit = self.units.get_mut(robot);
        if let Some(index) = unit.and_then(|unit| unit.indexes.state.get_mut(wheel)) {
            *index = state;
        }
    }

    /// Lets something drag at a wheel with this torque, N·m; 0 frees it.
    pub fn set_wheel_drag(&mut self, robot: usize, wheel: usize, torque: f64) {
        let unit = self.touched(robot);
        if let Some(motor) = unit.and_then(|unit| unit.motors.get_mut(wheel)) {
            motor.set_drag(torque);
        }
    }

    /// Lets something turn a wheel with this torque, N·m, positive as if the base rolled forward; 0
    /// ends it.
    pub fn set_wheel_push(&mut self, robot: usize, wheel: usize, torque: f64) {
        let unit = self.touched(robot);
        if let Some(motor) = unit.and_then(|unit| unit.motors.get_mut(wheel)) {
            motor.set_push(torque);
        }
    }

    /// Exchanges the holding brakes of a robot.
    pub fn set_brake(&mut self, robot: usize, brake: Brake) {
        if let Some(unit) = self.touched(robot) {
            unit.motors.iter_mut().for_each(|m| m.set_brake(brake));
        }
    }

    /// The holding brakes of a robot.
    #[must_use]
    pub fn brake(&self, robot: usize) -> Brake {
        let unit = self.units.get(robot);
        unit.map_or_else(Brake::default, |unit| unit.motors[0].brake())
    }

    /// Lets a robot's motor driver trip when a motor draws more than this, A: its bridges are off
    /// and it pulls its fault line until this is called again. `None` never trips.
    pub fn set_driver_trip(&mut self, robot: usize, amperes: Option<f64>) {
        if let Some(unit) = self.touched(robot) {
            unit.set_trip(amperes);
        }
    }

    /// Connects a sensor that sees the current of all of a robot's motors to its first input (PA7),
    /// or nothing: `scale` in A/V, `offset` the voltage without current, V.
    pub fn set_current_sensor(&mut self, robot: usize, sensor: Option<(f64, f64)>) {
        if let Some(unit) = self.touched(robot) {
            unit.current_sensor = sensor;
            if sensor.is_none() {
                unit.robot.set_current_inputs([0.0; 3]);
            }
        }
    }

    /// Lets a robot's supply take no charge any more: what its motors send back goes into this
    /// capacitance, F. `None` lets it take charge again.
    pub fn block_charge(&mut self, robot: usize, capacitance: Option<f64>) {
        if let Some(unit) = self.touched(robot) {
            unit.supply.block_charge(capacitance);
        }
    }

    /// Keeps frames with this identifier from a robot, or none.
    pub fn set_misses(&mut self, robot: usize, id: Option<u16>) {
        if let Some(unit) = self.touched(robot) {
            unit.injected.misses = id;
        }
    }

    /// Lets a robot send a frame that fails until its controller goes off the bus. `false` when it
    /// has nothing to send at the moment.
    pub fn force_bus_off(&mut self, robot: usize) -> bool {
        let unit = self.touched(robot);
        unit.is_some_and(|unit| unit.robot.force_bus_off())
    }

    /// Lets more frames arrive at a robot at once than its controller can hold.
    pub fn overrun(&mut self, robot: usize) {
        if let Some(unit) = self.touched(robot) {
            unit.robot.overrun();
        }
    }

    /// Halts a robot's processor, or lets it go on; its peripherals run on. `false` when it has
    /// none.
    pub fn halt(&mut self, robot: usize, halted: bool) -> bool {
        let unit = self.touched(robot);
        unit.is_some_and(|unit| unit.robot.halt(halted))
    }

    /// Makes a robot's program go wrong. `false` when it has no processor, or at the moment is not
    /// where it can be.
    pub fn crash(&mut self, robot: usize, how: Crash) -> bool {
        let unit = self.touched(robot);
        unit.is_some_and(|unit| unit.robot.crash(how))
    }

    /// Changes the supply of a robot's motors, V, which it may measure.
    pub fn set_supply(&mut self, robot: usize, volts: f64) {
        if let Some(unit) = self.touched(robot) {
            unit.motors
                .iter_mut()
                .for_each(|motor| motor.set_supply(volts));
            unit.robot.set_supply(volts);
        }
    }

    /// Begins to note when the duties of emulated robots change.
    pub fn start_trace(&mut self) {
        self.units.iter_mut().for_each(|u| u.robot.start_trace());
    }

    /// When the duty of a robot's front left wheel changed since the last call, ns.
    pub fn take_duty_changes(&mut self, robot: usize) -> Vec<u64> {
        let unit = self.units.get_mut(robot);
        unit.map_or_else(Vec::new, |unit| unit.robot.take_duty_changes())
    }
}

/// What a babbling node says.
fn babble(id: u16) -> Option<Frame> {
    Frame::new(id, &[0x55; 8])
}
