//! The cables of emulated robots: bytes to and from their serial ports, and cables that are pulled.

use super::World;
use super::unit::Cable;

/// The baud rate of the ST-LINK's end.
const BAUD: f64 = 1e6;

impl World {
    /// Puts bytes on the line into a robot's serial port, behind those that are still on it. They
    /// are lost on a robot without a processor, or without power, and if its cable is pulled.
    pub fn send_cable(&mut self, node: u8, bytes: &[u8]) {
        let (now_ns, step_ns) = (self.now_ns, self.options.motor_step_ns);
        let found = self.units.iter_mut().find(|unit| unit.node == node);
        let found = found.filter(|unit| unit.powered && unit.cable == Cable::Plugged);
        if let Some(unit) = found.filter(|_| !bytes.is_empty()) {
            unit.touch(now_ns, step_ns);
            unit.robot.send_cable(bytes, BAUD);
        }
    }

    /// Makes the cable of an emulated robot the way in for programs that ask for one, instead of
    /// the bus.
    pub fn set_adapter(&mut self, node: Option<u8>) {
        self.adapter = node;
    }

    /// The robot whose cable is the way in for programs, if one is.
    #[must_use]
    pub fn adapter(&self) -> Option<u8> {
        self.adapter
    }

    /// Pulls the cable of a robot, or plugs it in, by its place in the group file.
    pub fn set_cable(&mut self, robot: usize, cable: Cable) {
        let (now_ns, step_ns) = (self.now_ns, self.options.motor_step_ns);
        let Some(unit) = self.units.get_mut(robot) else {
            return;
        };
        unit.touch(now_ns, step_ns);
        unit.cable = cable;
        // What a cable has not carried when it is pulled is lost.
        unit.robot.take_cable();
        unit.robot.release_cable(cable.level());
    }

    /// Whether a robot's cable is plugged in.
    #[must_use]
    pub fn is_plugged(&self, node: u8) -> bool {
        let found = self.units.iter().find(|unit| unit.node == node);
        found.is_some_and(|unit| unit.cable == Cable::Plugged)
    }

    /// Bytes that are still on the line into a robot's serial port.
    pub fn on_cable(&mut self, node: u8) -> usize {
        self.board(node).map_or(0, |board| board.serial().on_line())
    }

    /// Takes the bytes that a robot's serial port has sent, each with the time at which it ended,
    /// by the time since the robot was switched on, ns. None come through a cable that is pulled.
    pub fn take_cable(&mut self, node: u8) -> Vec<(u64, u8)> {
        let Some(unit) = self.units.iter_mut().find(|unit| unit.node == node) else {
            return Vec::new();
        };
        let sent = unit.robot.take_cable();
        if unit.cable == Cable::Plugged {
            sent
        } else {
            Vec::new()
        }
    }
}
