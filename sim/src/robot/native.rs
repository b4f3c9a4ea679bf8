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
//! Where a group file gives it smart drives ([`drives`]), it is the image for these: its control
//! side commands currents, and counts are what the drives report.
//!
//! The robot's clock starts [`BOOT_NS`] after power-on and runs fast by its crystal's error.

mod behaviour;
mod drives;

use canopen::{Frame, NodeId};
use control::clock::TickSchedule;
use control::gyro::Reading;
use control::interface::{Inputs, Outputs, Report};
use control::output_stage::OutputStage;
use control::tick::ControlSide;
use control::time::{Micros, TICK_US};
use emulator::{Bmi088, GyroDefect};
use group::Driver;
use protocol::{Fault, StoredFault};
use robot::lock::{Code, Key, NO_KEY, hmac_sha512};
use robot::update::{Done, Job};
use robot::{
    BusSide, CanErrors, Event, Hardware, IMAGE_MAX, Identity, Memorable, StoreWear, Stored,
    stored_node,
};

use self::drives::SmartDrives;
use super::program_flash::{ProgramFlash, Signatures};
use super::{LogLine, Robot as _};
use crate::bus::errors::{Confinement, ErrorCounters, ErrorState, RECOVERY_NS};
use crate::error::SimError;

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
#[derive(Clone)]
pub struct NativeRobot {
    id: NodeId,
    serial: u32,
    driver: Driver,
    /// Its smart drives, with what the group file says of them.
    smart: Option<(group::Robot, SmartDrives)>,
    /// What its board and image have.
    hardware: Hardware,
    /// Its gyro, where its board has one.
    gyro: Option<Bmi088>,
    /// The line of its motor drivers reports a fault.
    driver_fault: bool,
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
    /// Whether this tick has a sample of the gyro.
    samples: bool,
    log: Vec<LogLine>,
}

/// What the firmware's driver says of a gyro: a sample every second tick.
fn read(gyro: &Bmi088, samples: bool) -> Reading {
    match gyro.defect() {
        Some(GyroDefect::Absent | GyroDefect::Identifier(_)) => Reading::Missing,
        _ if samples => Reading::Rate(gyro.rate_z()),
        _ => Reading::Waiting,
    }
}

/// Its fault memory.
#[derive(Clone, Default)]
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
#[derive(Clone)]
struct Live {
    clock: Clock,
    bus: BusSide,
    control: ControlSide,
    /// The kind of motor drivers that it is configured for.
    stage: OutputStage,
    next_tick: Micros,
    /// When that is in the world, ns.
    next_tick_ns: u64,
    /// Keeps the ticks in step with SYNC, and the SYNC it has not seen yet.
    schedule: TickSchedule,
    sync: Option<Micros>,
    outputs: Outputs,
    /// Frames to send, the first one first.
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
        (hardware, has_gyro): (Hardware, bool),
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
            hardware,
            has_gyro,
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
            next_tick_ns: clock.world_ns(Micros(TICK_US.into())),
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
            smart: None,
            hardware: Hardware::NUCLEO_F446RE,
            gyro: None,
            driver_fault: false,
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
                (Hardware::NUCLEO_F446RE, false),
                None,
                StoreWear::default(),
                &mut program,
            ),
            program,
            samples: false,
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
    #[inline]
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

    /// Runs the bus of its smart drives up to the present.
    fn run_drives(&mut self) {
        if let Some((_, drives)) = &mut self.smart {
            drives.run(self.now_ns, self.live.clock);
        }
    }

    fn tick(&mut self) {
        if let Some(configuration) = self.live.bus.take_configuration() {
            self.live.schedule = TickSchedule::with_period(configuration.times.sync_period_us);
            self.live.stage = configuration.output_stage;
            if let Some((_, drives)) = &mut self.smart
                && let Some(model) = configuration.output_stage.smart_drive()
            {
                drives.configure(configuration.drives, model);
            }
            self.live.control.configure(configuration);
        }
        let command = *self.live.bus.command();
        let (now, control) = (self.live.next_tick, &mut self.live.control);
        let mut inputs = self.inputs;
        inputs.drive_fault = self.driver_fault.then_some(Fault::DriverFault);
        inputs.gyro = self.gyro.as_ref().map(|gyro| {
            self.samples = !self.samples;
            read(gyro, self.samples)
        });
        self.live.outputs = if let Some((_, drives)) = &mut self.smart {
            let (counts, fault) = drives.read(now);
            inputs.encoder_counts = counts;
            inputs.index = Some(drives.index_pulses(now));
            inputs.drive_fault = inputs.drive_fault.or(fault);
            let outputs = control.tick_current(now, &command, &inputs, drives.temperature());
            drives.send(outputs.given(), outputs.drivers_enabled);
            outputs
        } else {
            control.tick(now, &command, &inputs)
        };
        self.live.bus.on_report(self.live.control.report());
        if let Some(outcome) = self.live.control.take_identification() {
            let now = self.live.next_tick;
            self.live.bus.on_identification(now, &outcome);
        }
        if let Some(sync) = self.live.sync.take() {
            self.live.schedule.on_sync(sync);
        }
        self.live.next_tick = self.live.schedule.next(self.live.next_tick);
        self.live.next_tick_ns = self.live.clock.world_ns(self.live.next_tick);
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
            let mailboxes = &mut self.live.mailboxes;
            // Of two frames with one identifier the older goes first.
            let place = mailboxes.partition_point(|other| other.id() <= frame.id());
            mailboxes.insert(place, frame);
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
        self.live.mailboxes.first().copied()
    }
}

fn log_line(now: Micros, event: &Event) -> LogLine {
    LogLine {
        time_us: now.0,
        level: "info".to_owned(),
        text: format!("{event:?}"),
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
