//! A native robot: the crate `robot` compiled for the host instead of a microcontroller.
//!
//! This file replaces the firmware's two tasks in virtual time: the bus side gets frames when they
//! end and is polled at its deadlines; the control side ticks every millisecond, in step with SYNC;
//! outputs act at once. Computing takes no time. Frames to send go through three mailboxes from
//! which the lowest identifier is sent first, as in the real CAN controller; the controller keeps
//! the rest.
//!
//! Its error counters are those of [`Confinement`]; at bus-off the frames in the mailboxes are
//! discarded, as in the firmware.
//!
//! Its stores of parameters and faults are memory that takes no time to write. They survive a power
//! cycle; only emulated robots model a power failure in the middle of a save. Images come into such
//! memory, too ([`ProgramFlash`]).
//!
//! The robot's clock starts [`BOOT_NS`] after power-on and runs fast by its crystal's error.

use canopen::{Frame, NodeId};
use control::clock::TickSchedule;
use control::interface::{Inputs, Outputs, Report};
use control::output_stage::OutputStage;
use control::tick::ControlSide;
use control::time::{Micros, TICK_US};
use group::Driver;
use protocol::{Fault, StoredFault};
use robot::lock::{Code, Key, NO_KEY, hmac_sha512};
use robot::update::{Done, Job};
use robot::{
    BusSide, CanErrors, Event, IMAGE_MAX, Identity, Memorable, StoreWear, Stored, stored_node,
};

use super::program_flash::{ProgramFlash, Signatures};
use super::{LogLine, Robot, Wake};
use crate::bridge::{self, levels};
use crate::bus::errors::{Confinement, ErrorCounters, ErrorState, RECOVERY_NS, TransmitError};
use crate::error::SimError;
use crate::motor::Bridge;

/// Time from power to the first instruction of the tasks, ns: about what the firmware takes.
pub const BOOT_NS: u64 = 3_000_000;
/// Mailboxes of the CAN controller.
const MAILBOXES: usize = 3;

/// The robot's clock: microseconds since its boot.
#[derive(Debug, Clone, Copy)]
struct Clock {
    /// Microseconds of this clock in a nanosecond of the world's.
    rate: f64,
    /// And nanoseconds of the world's in one of its microseconds.
    ns_a_us: f64,
    /// World time at which it starts, ns.
    boot_ns: u64,
}

impl Clock {
    /// A clock that starts with a robot whose power comes at this time.
    fn new(crystal_ppm: f64, power_ns: u64) -> Self {
        Self {
            rate: (1.0 + crystal_ppm * 1e-6) * 1e-3,
            ns_a_us: 1e3 / (1.0 + crystal_ppm * 1e-6),
            boot_ns: power_ns + BOOT_NS,
        }
    }

    /// What the clock shows at a world time.
    fn local(self, world_ns: u64) -> Micros {
        Micros((world_ns.saturating_sub(self.boot_ns) as f64 * self.rate) as u64)
    }

    /// The first world time at which the clock shows this.
    fn world_ns(self, local: Micros) -> u64 {
        let mut at = self.boot_ns + (local.0 as f64 * self.ns_a_us) as u64;
        while self.local(at) < local {
            at += 1;
        }
        at
    }
}

/// See the [module](self).
pub struct NativeRobot {
    id: NodeId,
    serial: u32,
    driver: Driver,
    crystal_ppm: f64,
    /// Content and wear of its flash.
    flash: Option<Vec<u8>>,
    wear: StoreWear,
    memory: Memory,
    program: ProgramFlash,
    powered: bool,
    now_ns: u64,
    inputs: Inputs,
    /// The state that exists only with power.
    live: Live,
    log: Vec<LogLine>,
}

/// Its fault memory.
#[derive(Default)]
struct Memory {
    starts: u32,
    faults: Vec<[u8; StoredFault::LENGTH]>,
    key: Key,
}

/// HMAC-SHA-512, as a robot has it of its boot code.
fn hmac(key: &Key, message: &[u8], out: &mut Code) -> bool {
    *out = hmac_sha512(&Signatures::default(), key, message);
    true
}

/// A running program and the CAN controller beside it.
struct Live {
    clock: Clock,
    bus: BusSide,
    control: ControlSide,
    /// The kind of motor drivers that it was told.
    stage: OutputStage,
    next_tick: Micros,
    /// Keeps the ticks in step with SYNC, and the SYNC it has not seen yet.
    schedule: TickSchedule,
    sync: Option<Micros>,
    outputs: Outputs,
    mailboxes: Vec<Frame>,
    sending: Option<Frame>,
    errors: Confinement,
    /// What its program knows of them.
    reported: CanErrors,
    /// World time at which it is back on the bus, ns, once it has begun to come back.
    back_ns: Option<u64>,
}

impl Live {
    fn boot(
        id: NodeId,
        serial: u32,
        clock: Clock,
        flash: Option<&[u8]>,
        wear: StoreWear,
        program: &mut ProgramFlash,
    ) -> Self {
        let (slot, seal) = program.start();
        // The serial number is that of the board, whatever node LSS has stored.
        let node = flash.and_then(stored_node).unwrap_or(id);
        let mut bus = BusSide::new(Identity {
            storage: true,
            node_switches: id.get(),
            slot: Some(slot),
            firmware: seal.map_or(Identity::FIRMWARE, |seal| seal.version),
            ..Identity::new(node, serial)
        });
        // The bus side wants memory that outlives it, as a static does on the robot: a kilobyte or
        // two for every time a robot is switched on.
        bus.survey(program);
        bus.load_lock(NO_KEY, hmac);
        let memory = Box::leak(Box::new([0; IMAGE_MAX]));
        let stored = flash.map_or(Stored::Nothing, Stored::Image);
        bus.load(Micros::ZERO, memory, stored);
        bus.counters_mut().store = wear;
        Self {
            clock,
            bus,
            control: ControlSide::new(),
            stage: OutputStage::default(),
            next_tick: Micros(TICK_US.into()),
            schedule: TickSchedule::new(),
            sync: None,
            outputs: Outputs::SAFE,
            mailboxes: Vec::with_capacity(MAILBOXES),
            sending: None,
            errors: Confinement::default(),
            reported: CanErrors::default(),
            back_ns: None,
        }
    }
}

impl NativeRobot {
    /// A robot with this node and crystal error, just switched on.
    ///
    /// # Errors
    /// When the node is not a CANopen node.
    pub fn new(node: u8, crystal_ppm: f64) -> Result<Self, SimError> {
        Self::with_serial(node, 0x4F4D_0000 + u32::from(node), crystal_ppm)
    }

    /// The same with a serial number of its own, as two robots whose node switches are set alike
    /// have.
    ///
    /// # Errors
    /// As [`NativeRobot::new`].
    pub fn with_serial(node: u8, serial: u32, crystal_ppm: f64) -> Result<Self, SimError> {
        let id = NodeId::new(node).ok_or_else(|| SimError::Robot {
            node,
            problem: "is not a CANopen node".to_owned(),
        })?;
        let mut program = ProgramFlash::new();
        Ok(Self {
            id,
            serial,
            driver: Driver::default(),
            crystal_ppm,
            flash: None,
            wear: StoreWear::default(),
            memory: Memory::default(),
            powered: true,
            now_ns: 0,
            inputs: Inputs {
                index: Some(Default::default()),
                ..Inputs::default()
            },
            live: Live::boot(
                id,
                serial,
                Clock::new(crystal_ppm, 0),
                None,
                StoreWear::default(),
                &mut program,
            ),
            program,
            log: Vec::new(),
        })
    }

    /// What the control side last reported.
    #[must_use]
    pub fn report(&self) -> Report {
        *self.live.control.report()
    }

    /// Whether its program runs: it has power and has started.
    fn is_running(&self) -> bool {
        self.powered && self.now_ns >= self.live.clock.boot_ns
    }

    fn is_on_bus(&self) -> bool {
        self.is_running() && self.live.errors.state() != ErrorState::BusOff
    }

    /// Passes the error counters to the program, as the firmware reads them from its controller.
    fn report_errors(&mut self, last: u8) {
        let ErrorCounters { transmit, receive } = self.live.errors.counters();
        let byte = |count: u32| u8::try_from(count).unwrap_or(u8::MAX);
        let errors = CanErrors {
            transmit: byte(transmit),
            receive: byte(receive),
            last,
        };
        if self.is_running() && (errors != self.live.reported || last != 0) {
            self.live.reported = errors;
            let now = self.live.clock.local(self.now_ns);
            self.live.bus.on_can_errors(now, &errors);
            self.pump(now);
        }
    }

    /// The firmware's reaction to bus-off.
    fn go_off(&mut self) {
        self.live.mailboxes.clear();
        self.live.sending = None;
        let now = self.live.clock.local(self.now_ns);
        self.live.bus.on_bus_off(now);
        self.pump(now);
    }

    fn tick(&mut self) {
        if let Some(configuration) = self.live.bus.take_configuration() {
            self.live.schedule = TickSchedule::with_period(configuration.times.sync_period_us);
            self.live.stage = configuration.output_stage;
            self.live.control.configure(configuration);
        }
        let command = *self.live.bus.command();
        self.live.outputs = self
            .live
            .control
            .tick(self.live.next_tick, &command, &self.inputs);
        self.live.bus.on_report(self.live.control.report());
        if let Some(outcome) = self.live.control.take_identification() {
            let now = self.live.next_tick;
            self.live.bus.on_identification(now, &outcome);
        }
        if let Some(sync) = self.live.sync.take() {
            self.live.schedule.on_sync(sync);
        }
        self.live.next_tick = self.live.schedule.next(self.live.next_tick);
    }

    /// Moves frames from the controller to free mailboxes, and events to the log.
    fn pump(&mut self, now: Micros) {
        if let Some(image) = self.live.bus.image_to_store() {
            self.flash = Some(image.to_vec());
            self.wear.saves += 1;
            self.live.bus.counters_mut().store = self.wear;
            self.live.bus.finish_store(Ok(()));
        }
        while let Some(next) = self.live.bus.to_remember(now) {
            match next {
                Memorable::Start => self.memory.starts += 1,
                Memorable::Key => self.memory.key = *self.live.bus.new_key(),
                Memorable::Fault(fault) => self.memory.faults.push(fault),
            }
            self.live.bus.remembered(now, true);
        }
        while self.live.mailboxes.len() < MAILBOXES {
            let Some(frame) = self.live.bus.pop_frame() else {
                break;
            };
            self.live.mailboxes.push(frame);
        }
        self.update();
        while let Some(event) = self.live.bus.pop_event() {
            match event {
                Event::Sync { at, .. } => self.live.sync = Some(at),
                Event::RecoverBus => self.live.back_ns = Some(self.now_ns + RECOVERY_NS),
                event => self.log.push(log_line(now, &event)),
            }
        }
    }

    /// Does what an update asks for, when the answers are on the bus.
    fn update(&mut self) {
        while let Some(job) = self.live.bus.update_job() {
            let are_answers_sent = self.live.mailboxes.is_empty();
            if !are_answers_sent && job != Job::Program {
                return;
            }
            let crypto = Signatures::default();
            if self.live.bus.work_on_update(&mut self.program, &crypto) == Done::Reset {
                self.set_power(true);
                return;
            }
        }
    }

    fn first(&self) -> Option<Frame> {
        // Stable: of two frames with one identifier the older goes first.
        self.live
            .mailboxes
            .iter()
            .min_by_key(|frame| frame.id())
            .copied()
    }
}

fn log_line(now: Micros, event: &Event) -> LogLine {
    LogLine {
        time_us: now.0,
        level: "info".to_owned(),
        text: format!("{event:?}"),
    }
}

impl Robot for NativeRobot {
    fn run_until(&mut self, time_ns: u64) -> Result<(), SimError> {
        self.now_ns = time_ns;
        if !self.is_running() {
            return Ok(());
        }
        let now = self.live.clock.local(time_ns);
        while self.live.next_tick <= now {
            self.tick();
        }
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
        // What is still due has already been processed in this microsecond.
        let soonest = self.live.clock.local(self.now_ns) + Micros(1);
        let deadline = self
            .live
            .bus
            .next_deadline()
            .map(|deadline| deadline.max(soonest));
        let next = deadline.map_or(self.live.next_tick, |deadline| {
            deadline.min(self.live.next_tick)
        });
        let next = self.live.clock.world_ns(next);
        Wake::At(self.live.back_ns.map_or(next, |at| at.min(next)))
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
        outputs.drive.map(|duty| {
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

    fn turn_encoders(&mut self, counts: [i32; 4]) {
        for (counter, passed) in self.inputs.encoder_counts.iter_mut().zip(counts) {
            // The counter has 16 bits and wraps: the low half of the sum is meant.
            *counter = counter.wrapping_add(passed as u16);
        }
    }

    fn index(&mut self, wheel: usize, ago: i32) {
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
        self.inputs.drive_fault = fault.then_some(Fault::DriverFault);
    }

    fn set_supply(&mut self, volts: f64) {
        self.inputs.supply_input = Some((volts / super::emulated::SUPPLY_DIVIDER) as f32);
    }

    fn set_current_inputs(&mut self, volts: [f64; 3]) {
        self.inputs.current_inputs = Some(volts.map(|volts| volts.clamp(0.0, 3.3) as f32));
    }

    fn set_power(&mut self, on: bool) {
        self.powered = on;
        let clock = Clock::new(self.crystal_ppm, self.now_ns);
        self.live = Live::boot(
            self.id,
            self.serial,
            clock,
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_finds_the_first_moment_of_a_microsecond() {
        for ppm in [-50.0, 0.0, 37.5] {
            let clock = Clock::new(ppm, 0);
            for local in [0, 1, 999, 1_000_000, 3_600_000_000] {
                let at = clock.world_ns(Micros(local));
                assert_eq!(clock.local(at), Micros(local));
                assert!(local == 0 || clock.local(at - 1) < Micros(local));
            }
        }
    }
}
