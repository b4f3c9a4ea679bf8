//! The emulated robot behind the trait that all robots have.

use canopen::Frame;
use canopen::bits::frame_bits;
use emulator::{Board, CanError, CanFrame, Change, GyroDefect};
use group::Driver;

use super::{EmulatedRobot, SETTLING_NS, SUPPLY_DIVIDER};
use crate::bus::errors::{ErrorCounters, ErrorState, TransmitError};
use crate::encoder::wires::Edge;
use crate::error::SimError;
use crate::motor::Bridge;
use crate::robot::{Crash, LogLine, Robot, Wake, code};
use crate::smart_drive::{DriveBus, DriveChange};
use crate::world::index::Pulse;

impl Robot for EmulatedRobot {
    fn run_until(&mut self, time_ns: u64) -> Result<(), SimError> {
        self.now_ns = time_ns;
        if !self.powered {
            return Ok(());
        }
        let settled = time_ns > self.computed_ns + SETTLING_NS;
        let due = self.next_event_ns().is_some_and(|at| at <= time_ns);
        if settled && self.board.is_asleep() && !due && self.pending_index == [None; 4] {
            return Ok(());
        }
        self.run(time_ns)
    }

    fn wake(&self) -> Wake {
        match self.next_event_ns() {
            _ if !self.powered => Wake::Never,
            Some(at) if at <= self.now_ns || !self.board.is_asleep() => Wake::Busy,
            Some(at) => Wake::At(at),
            None => Wake::Never,
        }
    }

    fn pending(&self) -> Option<Frame> {
        self.pending
    }

    fn begin(&mut self) {
        self.catch_up();
        self.board.can().begin();
    }

    fn transmitted(&mut self) {
        self.catch_up();
        self.board.can().transmitted();
        self.look_at_mailboxes();
        self.follow_errors();
    }

    fn lost_arbitration(&mut self) {
        self.catch_up();
        self.board.can().lost_arbitration();
    }

    fn transmit_failed(&mut self, error: TransmitError) {
        self.catch_up();
        self.board.can().error(match error {
            TransmitError::Bit => CanError::BitDominant,
            TransmitError::Form => CanError::Form,
            TransmitError::Acknowledge => CanError::Acknowledge,
        });
        self.look_at_errors();
    }

    fn receive_failed(&mut self, first: bool) {
        if !self.powered {
            return;
        }
        self.catch_up();
        if first {
            self.board.can().receive_error(CanError::Crc);
            // It sees dominant bits after its own flag: 8 more.
            (0..8).for_each(|_| self.board.can().receive_error(CanError::BitRecessive));
        } else {
            self.board.can().receive_error(CanError::Stuff);
        }
        self.look_at_errors();
    }

    fn error_state(&self) -> (ErrorState, ErrorCounters) {
        self.errors
    }

    fn receive(&mut self, frame: &Frame) {
        if !self.powered {
            return;
        }
        self.catch_up();
        let bits = frame_bits(frame);
        if let Some(frame) = CanFrame::new(frame.id(), frame.data()) {
            self.board.can().receive_stuffed(&frame, bits);
        }
        self.follow_errors();
    }

    fn drives(&self) -> [Bridge; 4] {
        self.drives
    }

    fn wire_driver(&mut self, driver: Driver) {
        self.driver = driver;
    }

    fn wire_smart_drives(&mut self, robot: &group::Robot) {
        self.drive_bus = DriveBus::new(robot, self.now_ns);
    }

    fn change_smart_drive(&mut self, wheel: usize, change: DriveChange) {
        self.catch_up();
        if let Some(bus) = &mut self.drive_bus {
            bus.change(wheel, change);
        }
        self.look_at_bridges();
    }

    fn has_gyro(&self) -> bool {
        self.wiring.gyro.is_some()
    }

    fn set_yaw_rate(&mut self, rate: f64) {
        self.board.with_gyro(|gyro| gyro.set_rate(rate));
    }

    fn set_gyro_defect(&mut self, defect: Option<GyroDefect>) {
        self.gyro_defect = defect;
        self.board.with_gyro(|gyro| gyro.set_defect(defect));
    }

    fn set_wheel_rates(&mut self, rates: [f64; 4]) {
        self.rates = rates;
    }

    fn turn_encoders(&mut self, counts: [i32; 4]) {
        if !self.powered {
            return;
        }
        for (pending, counts) in self.pending_counts.iter_mut().zip(counts) {
            *pending += counts;
        }
    }

    fn encoder_edges(&mut self, wheel: usize, edges: &[Edge]) -> bool {
        for edge in edges {
            self.encoder_levels[wheel][edge.channel] = edge.level;
        }
        if self.powered {
            let ordered = self.pending_edges.last().is_none_or(|(_, last)| {
                edges.first().is_none_or(|first| last.at_ns <= first.at_ns)
            });
            self.pending_edges
                .extend(edges.iter().map(|edge| (wheel, *edge)));
            if !ordered {
                // Stable: the edges of one wheel stay in their order.
                self.pending_edges.sort_by_key(|(_, edge)| edge.at_ns);
            }
        }
        true
    }

    fn index(&mut self, wheel: usize, pulse: Pulse) {
        if self.powered {
            self.pending_index[wheel] = Some(pulse);
        }
    }

    fn set_emergency_stop(&mut self, pressed: bool) {
        self.emergency_stop = pressed;
        if !self.powered {
            return;
        }
        self.catch_up();
        self.wire_emergency_stop();
        // The break input acts without the processor, which may be asleep or halted.
        self.look_at_bridges();
    }

    fn set_protective_stop(&mut self, open: bool) {
        self.protective_stop = open;
        if self.powered {
            self.catch_up();
            self.set_pin(self.wiring.protective_stop, open);
        }
    }

    fn set_driver_fault(&mut self, fault: bool) {
        self.driver_fault = fault;
        if self.powered {
            self.catch_up();
            self.set_pin(self.wiring.driver_fault, !fault);
        }
    }

    fn set_power(&mut self, on: bool) {
        self.catch_up();
        self.powered = on;
        self.pending = None;
        self.pending_counts = [0; 4];
        self.pending_edges.clear();
        self.pending_index = [None; 4];
        self.index_high = [false; 4];
        self.drives = [Bridge::default(); 4];
        if on {
            self.instructions_before += self.board.instructions();
            self.log_before = self.take_log();
            let flash = self.board.flash();
            self.board = Board::with_flash(&self.firmware, self.config.clone(), &flash);
            self.born_ns = self.now_ns;
            self.computed_ns = self.now_ns;
            self.instructions = 0;
            self.errors = Default::default();
            self.wire();
        }
    }

    fn set_supply(&mut self, volts: f64) {
        self.supply = volts;
        if self.powered {
            self.catch_up();
            let (port, pin) = self.wiring.supply;
            self.board.set_analog(port, pin, volts / SUPPLY_DIVIDER);
        }
    }

    fn set_current_inputs(&mut self, volts: [f64; 3]) {
        if self.powered {
            self.catch_up();
            for ((port, pin), volts) in self.wiring.currents.iter().zip(volts) {
                self.board.set_analog(*port, *pin, volts);
            }
        }
    }

    fn force_bus_off(&mut self) -> bool {
        if !self.powered {
            return false;
        }
        self.catch_up();
        self.look_at_mailboxes();
        if self.pending.is_none() {
            return false;
        }
        let mut can = self.board.can();
        while !can.bus_off() && can.begin().is_some() {
            can.error(CanError::BitDominant);
        }
        let off = can.bus_off();
        self.look_at_errors();
        off
    }

    fn overrun(&mut self) {
        // The FIFO holds three (RM0390 rev 6, 30.7.5). No member of a group listens to this
        // identifier.
        const FRAMES: usize = 5;
        const IDENTIFIER: u16 = 0x7FF;
        if let Some(frame) = Frame::new(IDENTIFIER, &[]) {
            (0..FRAMES).for_each(|_| self.receive(&frame));
        }
    }

    fn halt(&mut self, halted: bool) -> bool {
        self.catch_up();
        self.board.halt(halted);
        true
    }

    fn crash(&mut self, how: Crash) -> bool {
        // Between the peripherals and the core's own registers there is nothing.
        const NOWHERE: u32 = 0xC000_0000;
        const STACK_POINTER: u8 = 13;
        self.catch_up();
        if how != Crash::Nowhere && !self.board.is_asleep() {
            return false;
        }
        let address = match how {
            Crash::Nowhere => Some(NOWHERE),
            Crash::Panic => code::panic_site(&self.firmware, &self.board),
            Crash::Loop => code::endless_loop(&self.firmware, &self.board),
            Crash::StackOverflow => {
                // Two words above the end: an exception pushes eight at least.
                let end = self.firmware.variable("_stack_end");
                if let Some(end) = end {
                    self.board.set_register(STACK_POINTER, end.address + 8);
                }
                return end.is_some();
            }
        };
        if let Some(address) = address {
            self.board.jump(address);
        }
        address.is_some()
    }

    fn start_trace(&mut self) {
        self.catch_up();
        self.board.start_trace();
    }

    fn take_duty_changes(&mut self) -> Vec<u64> {
        let changes = self.board.take_trace().into_iter();
        let [of, _] = self.wiring.channels[0];
        let first_wheel = changes.filter(|traced| {
            matches!(
                traced.change,
                Change::Pwm { timer, channel, .. } if (timer, channel) == (of.timer, of.number)
            )
        });
        let born_ns = self.born_ns;
        first_wheel.map(|traced| born_ns + traced.t_ns).collect()
    }

    fn take_log(&mut self) -> Vec<LogLine> {
        let line = |line: emulator::LogLine| LogLine {
            time_us: line.time_us,
            level: format!("{:?}", line.level).to_lowercase(),
            text: match line.location {
                Some(location) => format!("{} [{location}]", line.text),
                None => line.text,
            },
        };
        let mut log = std::mem::take(&mut self.log_before);
        log.extend(self.board.take_log().into_iter().map(line));
        log
    }

    fn send_cable(&mut self, bytes: &[u8], baud: f64) {
        self.catch_up();
        self.board.serial().send(bytes, baud);
    }

    fn release_cable(&mut self, level: Option<bool>) {
        self.catch_up();
        match level {
            Some(level) => self.board.serial().release(level),
            None => self.board.serial().drive(),
        }
    }

    fn take_cable(&mut self) -> Vec<(u64, u8)> {
        self.board.serial().take_sent()
    }

    fn board(&mut self) -> Option<&mut Board> {
        Some(&mut self.board)
    }

    fn instructions(&self) -> u64 {
        self.instructions_before + self.board.instructions()
    }

    fn try_clone(&self) -> Option<Box<dyn Robot>> {
        Some(Box::new(self.clone()))
    }
}
