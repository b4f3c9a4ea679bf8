//! Fault injection: the faults that a caller can cause in a simulated robot.
//!
//! All faults act outside the robot's program: on its inputs, wheels, wires and processor. The
//! robot has to detect them itself. Robots are identified by their position in the group file,
//! wheels by the usual order (front left, front right, rear left, rear right); a position that does
//! not exist is ignored. Native robots have no processor, so faults of a processor return `false`
//! for them.

use canopen::Frame;
use emulator::GyroDefect;

use super::index::IndexState;
use super::unit::Unit;
use super::{EncoderState, Port, World};
use crate::bus::disturb::Share;
use crate::bus::errors::{ErrorCounters, ErrorState};
use crate::motor::Brake;
use crate::robot::Crash;
use crate::smart_drive::DriveChange;

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

    /// Changes the smart drive of a robot's wheel.
    pub fn set_smart_drive(&mut self, robot: usize, wheel: usize, change: DriveChange) {
        if let Some(unit) = self.touched(robot) {
            unit.robot.change_smart_drive(wheel, change);
        }
    }

    /// Something is wrong with a robot's gyro, or no more.
    pub fn set_gyro_defect(&mut self, robot: usize, defect: Option<GyroDefect>) {
        if let Some(unit) = self.touched(robot) {
            unit.robot.set_gyro_defect(defect);
        }
    }

    /// Switches a robot's power off or on; repeated calls have no effect. Its wheels keep rolling
    /// until friction and brake stop them.
    pub fn set_power(&mut self, robot: usize, on: bool) {
        if let Some(unit) = self.touched(robot)
            && unit.powered != on
        {
            unit.powered = on;
            unit.robot.set_power(on);
            unit.robot.release_cable(unit.cable.level());
            unit.held = None;
            if !on {
                self.cut_off(robot);
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
        self.all_connected = false;
        if let Some(unit) = self.touched(robot) {
            unit.connected = connected;
            unit.alone_ns = now_ns;
            if !connected {
                self.cut_off(robot);
            }
        }
    }

    /// Breaks the cable before a robot: it and all that follow it in the group file form one bus,
    /// the other robots and the ports another. `None` repairs it. A frame on the wire meanwhile is
    /// lost, with an error frame.
    pub fn set_partition(&mut self, first: Option<usize>) {
        self.all_connected = false;
        for (place, unit) in self.units.iter_mut().enumerate() {
            unit.far = first.is_some_and(|first| place >= first);
        }
        let nodes = self.first_port() + self.ports.len();
        (0..nodes).for_each(|node| self.cut_off(node));
    }

    /// A node stops in the middle of its frame, if it is sending one.
    fn cut_off(&mut self, node: usize) {
        self.bus.cut_off(self.now_ns, node);
        self.far.cut_off(self.now_ns, node);
    }

    /// Inverts one bit in this fraction of the frames, for all nodes.
    pub fn set_corruption(&mut self, share: Share) {
        self.disturbances.corrupt = share;
    }

    /// Removes the acknowledge from this fraction of the frames.
    pub fn set_lost_acknowledge(&mut self, share: Share) {
        self.disturbances.unacknowledged = share;
    }

    /// Makes a foreign node send frames with this identifier continuously, or stops it.
    pub fn set_babbler(&mut self, id: Option<u16>) {
        self.disturbances.babble = id.and_then(babble);
    }

    /// Makes a robot's receiver misread this fraction of the frames.
    pub fn set_bad_receiver(&mut self, robot: usize, share: Share) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.injected.bad_receiver = share;
        }
    }

    /// Makes a robot's CAN controller send frames with this identifier continuously instead of its
    /// own.
    pub fn set_babbling(&mut self, robot: usize, id: Option<u16>) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.injected.babble = id.and_then(babble);
        }
    }

    /// Delays all frames that a robot sends, ns.
    pub fn set_delay(&mut self, robot: usize, delay_ns: u64) {
        self.all_connected = false;
        if let Some(unit) = self.units.get_mut(robot) {
            unit.injected.delay_ns = delay_ns;
            unit.held = None;
        }
    }

    /// Delays all frames that the ports send from now on, ns, as a slow adapter does.
    pub fn set_port_delay(&mut self, delay_ns: u64) {
        self.port_delay_ns = delay_ns;
    }

    /// The error state of a robot's CAN controller, and its error counters.
    #[must_use]
    pub fn robot_errors(&self, robot: usize) -> (ErrorState, ErrorCounters) {
        let unit = self.units.get(robot);
        unit.map_or_else(Default::default, |unit| unit.robot.error_state())
    }

    /// The error state of the node at a port, and its error counters.
    #[must_use]
    pub fn port_errors(&self, port: Port) -> (ErrorState, ErrorCounters) {
        let errors = self.ports.get(port.0).map(|port| port.errors);
        errors.map_or_else(Default::default, |e| (e.state(), e.counters()))
    }

    /// Breaks the encoders whose time has come.
    pub(super) fn break_encoders(&mut self) {
        while let Some((_, robot, wheel, state)) =
            self.breaking.pop_if(|(at, ..)| *at <= self.now_ns)
        {
            self.set_encoder(robot, wheel, state);
            // It has been touched, so it has to run.
            if !self.due.contains(&robot) {
                self.due.push(robot);
                self.due.sort_unstable();
            }
        }
    }

    /// Breaks or repairs an encoder.
    pub fn set_encoder(&mut self, robot: usize, wheel: usize, state: EncoderState) {
        let unit = self.touched(robot);
        if let Some(encoder) = unit.and_then(|unit| unit.encoder_mut(wheel)) {
            encoder.set_state(state);
        }
    }

    /// Adds noise to the wires of an encoder at this rate per second; 0 ends it.
    pub fn set_encoder_noise(&mut self, robot: usize, wheel: usize, hz: f64) {
        let unit = self.touched(robot);
        if let Some(encoder) = unit.and_then(|unit| unit.encoder_mut(wheel)) {
            encoder.set_noise(hz);
        }
    }

    /// Gives the wires of an encoder slow rising edges: R times C, s; 0 ends it.
    pub fn set_encoder_slow_edges(&mut self, robot: usize, wheel: usize, rc: f64) {
        let unit = self.touched(robot);
        if let Some(encoder) = unit.and_then(|unit| unit.encoder_mut(wheel)) {
            encoder.set_slow_edges(rc);
        }
    }

    /// Breaks or repairs the index of an encoder.
    pub fn set_index(&mut self, robot: usize, wheel: usize, state: IndexState) {
        let unit = self.units.get_mut(robot);
        if let Some(index) = unit.and_then(|unit| unit.index_mut(wheel)) {
            *index = state;
        }
    }

    /// Brakes a wheel with this friction torque, N·m; 0 frees it.
    pub fn set_wheel_drag(&mut self, robot: usize, wheel: usize, torque: f64) {
        if let Some(unit) = self.touched(robot) {
            unit.motors.set_drag(wheel, torque);
        }
    }

    /// Applies this external torque to a wheel, N·m, positive in the direction that rolls the base
    /// forward; 0 ends it.
    pub fn set_wheel_push(&mut self, robot: usize, wheel: usize, torque: f64) {
        if let Some(unit) = self.touched(robot) {
            unit.motors.set_push(wheel, torque);
        }
    }

    /// Replaces the holding brakes of a robot.
    pub fn set_brake(&mut self, robot: usize, brake: Brake) {
        if let Some(unit) = self.touched(robot) {
            unit.motors.set_brake(brake);
        }
    }

    /// The holding brakes of a robot.
    #[must_use]
    pub fn brake(&self, robot: usize) -> Brake {
        let unit = self.units.get(robot);
        unit.map_or_else(Brake::default, |unit| unit.motors.brake())
    }

    /// Makes a robot's motor driver trip when a motor draws more than this current, A: its bridges
    /// are off and its fault line is low until this is called again. `None` never trips.
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

    /// Makes a robot's supply sink no current: the energy that its motors return charges this
    /// capacitance, F. `None` ends this.
    pub fn block_charge(&mut self, robot: usize, capacitance: Option<f64>) {
        if let Some(unit) = self.touched(robot) {
            unit.supply.block_charge(capacitance);
        }
    }

    /// Hides frames with this identifier from a robot; `None` hides none.
    pub fn set_misses(&mut self, robot: usize, id: Option<u16>) {
        if let Some(unit) = self.touched(robot) {
            unit.injected.misses = id;
        }
    }

    /// Makes a robot's frame fail until its controller goes bus-off. `false` when it has nothing to
    /// send at the moment.
    pub fn force_bus_off(&mut self, robot: usize) -> bool {
        let unit = self.touched(robot);
        unit.is_some_and(|unit| unit.robot.force_bus_off())
    }

    /// Delivers more frames to a robot at once than its controller can hold.
    pub fn overrun(&mut self, robot: usize) {
        if let Some(unit) = self.touched(robot) {
            unit.robot.overrun();
        }
    }

    /// Halts or resumes a robot's processor; its peripherals keep running. `false` when it has
    /// none.
    pub fn halt(&mut self, robot: usize, halted: bool) -> bool {
        let unit = self.touched(robot);
        unit.is_some_and(|unit| unit.robot.halt(halted))
    }

    /// Makes a robot's program fail. `false` when it has no processor, or when its program is at a
    /// place where this is impossible.
    pub fn crash(&mut self, robot: usize, how: Crash) -> bool {
        let unit = self.touched(robot);
        unit.is_some_and(|unit| unit.robot.crash(how))
    }

    /// Changes the supply of a robot's motors, V, which it may measure.
    pub fn set_supply(&mut self, robot: usize, volts: f64) {
        if let Some(unit) = self.touched(robot) {
            unit.motors.set_supply(volts);
            unit.robot.set_supply(volts);
        }
    }

    /// Begins to record when the duties of emulated robots change.
    pub fn start_trace(&mut self) {
        self.units.iter_mut().for_each(|u| u.robot.start_trace());
    }

    /// When the duty of a robot's front left wheel changed since the last call, ns.
    pub fn take_duty_changes(&mut self, robot: usize) -> Vec<u64> {
        let unit = self.units.get_mut(robot);
        unit.map_or_else(Vec::new, |unit| unit.robot.take_duty_changes())
    }
}

/// The frame of a babbling node.
fn babble(id: u16) -> Option<Frame> {
    Frame::new(id, &[0x55; 8])
}
