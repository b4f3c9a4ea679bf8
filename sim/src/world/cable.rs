//! The cables of emulated robots: bytes to and from their serial ports.

use super::World;

/// The baud rate of the ST-LINK's end.
const BAUD: f64 = 1e6;

impl World {
    /// Puts bytes on the line into a robot's serial port, behind those that are still on it. They
    /// are lost on a robot without a processor, or without power.
    pub fn send_cable(&mut self, node: u8, bytes: &[u8]) {
        let (now_ns, step_ns) = (self.now_ns, self.options.motor_step_ns);
        let found = self.units.iter_mut().find(|unit| unit.node == node);
        if let Some(unit) = found.filter(|unit| unit.powered && !bytes.is_empty()) {
            unit.touch(now_ns, step_ns);
            unit.robot.send_cable(bytes, BAUD);
        }
    }

    /// Bytes that are still on the line into a robot's serial port.
    pub fn on_cable(&mut self, node: u8) -> usize {
        self.board(node).map_or(0, |board| board.serial().on_line())
    }

    /// Takes the bytes that a robot's serial port has sent, each with the time at which it ended,
    /// by the time since the robot was switched on, ns.
    pub fn take_cable(&mut self, node: u8) -> Vec<(u64, u8)> {
        let found = self.units.iter_mut().find(|unit| unit.node == node);
        found.map_or_else(Vec::new, |unit| unit.robot.take_cable())
    }
}
