//! A native robot as the world sees it.

use canopen::Frame;
use control::quantity::InputVoltage;
use control::time::Micros;
use emulator::{Bmi088, GyroDefect};
use group::Driver;
use protocol::Fault;
use robot::Hardware;

use super::drives::SmartDrives;
use super::{Clock, Live, NativeRobot, hmac};
use crate::bridge::{self, levels};
use crate::bus::errors::{ErrorCounters, ErrorState, TransmitError};
use crate::error::SimError;
use crate::motor::Bridge;
use crate::robot::emulated::SUPPLY_DIVIDER;
use crate::robot::{LogLine, Robot, Wake};
use crate::smart_drive::DriveChange;
use crate::world::index::Pulse;

impl Robot for NativeRobot {
    fn run_until(&mut self, time_ns: u64) -> Result<(), SimError> {
        self.now_ns = time_ns;
        if !self.is_running() {
            return Ok(());
        }
        let now = self.live.clock.local(time_ns);
        self.run_drives();
        while self.live.next_tick <= now {
            self.tick();
        }
        // What the tick commands may find the bus free.
        self.run_drives();
        if self
            .live
            .bus
            .next_deadline()
            .is_some_and(|deadline| deadline <= now)
        {
            self.live.bus.poll(now);
        }
        if self.live.back_ns.take_if(|at| *at <= time_ns).is_some() {
            self.live.errors.recovered();
            self.live.bus.on_bus_recovered(now);
        }
        self.pump(now);
        Ok(())
    }

    fn is_lazy(&self) -> bool {
        true
    }

    fn set_now(&mut self, time_ns: u64) {
        self.now_ns = time_ns;
    }

    fn wake(&self) -> Wake {
        if !self.powered {
            return Wake::Never;
        }
        let clock = self.live.clock;
        let next = match self.live.bus.next_deadline() {
            // What is still due has already been processed in this microsecond.
            Some(deadline) if deadline < self.live.next_tick => {
                clock.world_ns(deadline.max(clock.local(self.now_ns) + Micros(1)))
            }
            _ => u64::MAX,
        };
        let next = next.min(self.live.next_tick_ns);
        let back = self.live.back_ns;
        let drives = self
            .smart
            .as_ref()
            .map(|(_, drives)| drives.next_event_ns());
        let drives = drives.filter(|_| self.is_running());
        Wake::At([back, drives].into_iter().flatten().fold(next, u64::min))
    }

    fn pending(&self) -> Option<Frame> {
        if self.live.errors.state() == ErrorState::BusOff {
            return None;
        }
        self.first()
    }

    fn begin(&mut self) {
        self.live.sending = self.first();
    }

    fn transmitted(&mut self) {
        self.live.errors.transmitted();
        self.report_errors(0);
        if let Some(sent) = self.live.sending.take()
            && let Some(place) = self.live.mailboxes.iter().position(|frame| *frame == sent)
        {
            self.live.mailboxes.remove(place);
        }
        self.pump(self.live.clock.local(self.now_ns));
    }

    fn lost_arbitration(&mut self) {}

    fn transmit_failed(&mut self, error: TransmitError) {
        self.live.sending = None;
        if self.is_running() && self.live.errors.transmit_failed(error) {
            self.go_off();
        }
        // As ESR.LEC has it (RM0390 30.9.2).
        self.report_errors(match error {
            TransmitError::Form => 2,
            TransmitError::Acknowledge => 3,
            TransmitError::Bit => 4,
        });
    }

    fn receive_failed(&mut self, first: bool) {
        if self.is_on_bus() {
            self.live.errors.receive_failed(first);
            self.report_errors(1);
        }
    }

    fn error_state(&self) -> (ErrorState, ErrorCounters) {
        (self.live.errors.state(), self.live.errors.counters())
    }

    fn receive(&mut self, frame: &Frame) {
        if !self.is_on_bus() {
            return;
        }
        self.live.errors.received();
        self.report_errors(0);
        // As the firmware's interrupt does.
        let codes = self.live.bus.function_codes();
        let own = frame.id() & 0x7F == u16::from(self.live.bus.node());
        if codes & canopen::function_code_bit(frame.id()) == 0 && !own {
            return;
        }
        let now = self.live.clock.local(self.now_ns);
        self.live.bus.on_frame(now, frame);
        self.pump(now);
    }

    fn drives(&self) -> [Bridge; 4] {
        let outputs = &self.live.outputs;
        if let Some((_, drives)) = &self.smart {
            return if self.powered {
                drives.bridges(outputs.brake_released)
            } else {
                Default::default()
            };
        }
        outputs.given().map(|duty| {
            let (duty, enabled) = (f64::from(duty), outputs.drivers_enabled);
            let output = bridge::output(self.driver, &levels(self.live.stage, duty, enabled));
            Bridge {
                duty: output.unwrap_or(0.0),
                enabled: output.is_some(),
                brake_released: outputs.brake_released,
            }
        })
    }

    fn wire_driver(&mut self, driver: Driver) {
        self.driver = driver;
    }

    fn wire_smart_drives(&mut self, robot: &group::Robot) {
        self.smart = SmartDrives::new(robot, self.now_ns).map(|drives| (robot.clone(), drives));
        let output_stages = if self.smart.is_some() {
            Hardware::SMART
        } else if robot.output.kind.has_two_pwms() {
            Hardware::TWO_PWMS
        } else {
            Hardware::SWITCHED
        };
        self.hardware = Hardware {
            output_stages,
            ..robot.board.hardware()
        };
        // It runs another image then.
        self.gyro = (robot.board == group::Board::RobomasterC).then(Bmi088::default);
        self.set_power(self.powered);
    }

    fn change_smart_drive(&mut self, wheel: usize, change: DriveChange) {
        if let Some((_, drives)) = &mut self.smart {
            drives.change(wheel, change);
        }
    }

    fn has_gyro(&self) -> bool {
        self.gyro.is_some()
    }

    fn set_yaw_rate(&mut self, rate: f64) {
        if let Some(gyro) = &mut self.gyro {
            gyro.set_rate(rate);
        }
    }

    fn set_gyro_defect(&mut self, defect: Option<GyroDefect>) {
        if let Some(gyro) = &mut self.gyro {
            gyro.set_defect(defect);
        }
    }

    fn set_wheel_rates(&mut self, rates: [f64; 4]) {
        if let Some((_, drives)) = &mut self.smart {
            drives.rates = rates;
        }
    }

    fn turn_encoders(&mut self, counts: [i32; 4]) {
        if let Some((_, drives)) = &mut self.smart {
            drives.turn(counts);
        }
        for (counter, passed) in self.inputs.encoder_counts.iter_mut().zip(counts) {
            // The counter has 16 bits and wraps: the low half of the sum is meant.
            *counter = counter.wrapping_add(passed as u16);
        }
    }

    fn index(&mut self, wheel: usize, pulse: Pulse) {
        let ago = pulse.counts_ago;
        if let Some((_, drives)) = &mut self.smart {
            drives.index(wheel, self.live.clock.local(pulse.at_ns));
        }
        let counts = self.inputs.encoder_counts.get(wheel);
        let pulse = self.inputs.index.as_mut();
        let pulse = pulse.and_then(|pulses| pulses.get_mut(wheel));
        if let (Some(count), Some(pulse)) = (counts, pulse) {
            pulse.number = pulse.number.wrapping_add(1);
            pulse.count = count.wrapping_sub(ago as u16);
        }
    }

    fn set_emergency_stop(&mut self, pressed: bool) {
        self.inputs.emergency_stop = pressed;
    }

    fn set_protective_stop(&mut self, open: bool) {
        self.inputs.protective_stop = open;
    }

    fn set_driver_fault(&mut self, fault: bool) {
        self.driver_fault = fault;
    }

    fn set_supply(&mut self, volts: f64) {
        if let Some((_, drives)) = &mut self.smart {
            drives.supply = volts;
        }
        let input = InputVoltage::new((volts / SUPPLY_DIVIDER) as f32);
        self.inputs.supply_input = Some(input);
    }

    fn set_current_inputs(&mut self, volts: [f64; 3]) {
        self.inputs.current_inputs = Some(volts.map(|volts| volts.clamp(0.0, 3.3) as f32));
    }

    fn set_power(&mut self, on: bool) {
        self.powered = on;
        let clock = Clock::new(self.crystal_ppm, self.now_ns);
        if let Some((robot, drives)) = &mut self.smart {
            drives.restart(robot, self.now_ns);
        }
        self.live = Live::boot(
            self.id,
            self.serial,
            clock,
            (self.hardware, self.gyro.is_some()),
            self.flash.as_deref(),
            self.wear,
            &mut self.program,
        );
        let faults = self.memory.faults.iter().copied();
        self.live.bus.recall(self.memory.starts, faults);
        self.live.bus.load_lock(self.memory.key, hmac);
        // The counters are the microcontroller's; emergency stop and driver fault are wires from
        // outside.
        self.inputs.encoder_counts = Default::default();
    }

    fn force_bus_off(&mut self) -> bool {
        if !self.is_running() {
            return false;
        }
        while !self.live.errors.transmit_failed(TransmitError::Bit) {
            if self.live.errors.state() == ErrorState::BusOff {
                return true;
            }
        }
        self.go_off();
        true
    }

    fn overrun(&mut self) {
        if !self.is_running() {
            return;
        }
        let now = self.live.clock.local(self.now_ns);
        self.live.bus.on_fault(now, Fault::ReceiveOverrun);
        self.pump(now);
    }

    fn take_log(&mut self) -> Vec<LogLine> {
        std::mem::take(&mut self.log)
    }

    fn try_clone(&self) -> Option<Box<dyn Robot>> {
        Some(Box::new(self.clone()))
    }
}
