//! A native robot: the controller crate on this machine, where the firmware has it on a microcontroller.
//!
//! What the firmware's two tasks do around the controller is done here in virtual time: the bus side gets
//! frames when they end and is polled when it asks to be; the control side ticks every millisecond, in
//! step with SYNC; outputs act at once. Computing takes no time. Frames to send go through three
//! mailboxes from which the lowest identifier is sent first, as in the real CAN controller; the
//! controller keeps the rest.
//!
//! Its parameter store is memory that takes no time to write and that no power cycle can be tried on.
//!
//! The robot's clock starts [`BOOT_NS`] after the world's and runs fast by its crystal's error.

use canopen::{Frame, Micros, NodeId};
use controller::{
    BusSide, ControlSide, Event, IMAGE_MAX, Identity, Inputs, Outputs, Stored, TICK_US, TickPhase,
};
use protocol::Fault;

use super::{LogLine, Robot, Wake};
use crate::error::SimError;
use crate::motor::Drive;

/// Time from power to the first instruction of the tasks, ns: about what the firmware takes.
pub const BOOT_NS: u64 = 3_000_000;
/// Mailboxes of the CAN controller.
const MAILBOXES: usize = 3;

/// The robot's clock: microseconds since its boot.
#[derive(Debug, Clone, Copy)]
struct Clock {
    /// Microseconds of this clock in a nanosecond of the world's.
    rate: f64,
}

impl Clock {
    fn new(crystal_ppm: f64) -> Self {
        Self {
            rate: (1.0 + crystal_ppm * 1e-6) * 1e-3,
        }
    }

    /// What the clock shows at a world time.
    fn local(self, world_ns: u64) -> Micros {
        Micros((world_ns.saturating_sub(BOOT_NS) as f64 * self.rate) as u64)
    }

    /// The first world time at which the clock shows this.
    fn world_ns(self, local: Micros) -> u64 {
        let mut at = BOOT_NS + (local.0 as f64 / self.rate) as u64;
        while self.local(at) < local {
            at += 1;
        }
        at
    }
}

/// See the [module](self).
pub struct NativeRobot {
    clock: Clock,
    now_ns: u64,
    bus: BusSide,
    control: ControlSide,
    next_tick: Micros,
    /// Keeps the ticks in step with SYNC, and the SYNC it has not seen yet.
    phase: TickPhase,
    sync: Option<Micros>,
    inputs: Inputs,
    outputs: Outputs,
    mailboxes: Vec<Frame>,
    sending: Option<Frame>,
    log: Vec<LogLine>,
}

impl NativeRobot {
    /// A robot with this node and crystal error, just switched on.
    ///
    /// # Errors
    /// When the node is not a CANopen node.
    pub fn new(node: u8, crystal_ppm: f64) -> Result<Self, SimError> {
        let id = NodeId::new(node).ok_or_else(|| SimError::Robot {
            node,
            problem: "is not a CANopen node".to_owned(),
        })?;
        let mut bus = BusSide::new(Identity {
            storage: true,
            ..Identity::new(id, 0x4F4D_0000 + u32::from(node))
        });
        // The bus side wants memory that outlives it, as a static does on the robot: a kilobyte or two a robot.
        let memory = Box::leak(Box::new([0; IMAGE_MAX]));
        bus.load(Micros::ZERO, memory, Stored::Nothing);
        Ok(Self {
            clock: Clock::new(crystal_ppm),
            now_ns: 0,
            bus,
            control: ControlSide::new(),
            next_tick: Micros(TICK_US),
            phase: TickPhase::new(),
            sync: None,
            inputs: Inputs::default(),
            outputs: Outputs::SAFE,
            mailboxes: Vec::with_capacity(MAILBOXES),
            sending: None,
            log: Vec::new(),
        })
    }

    /// What the control side last reported.
    #[must_use]
    pub fn report(&self) -> controller::Report {
        self.control.report()
    }

    fn tick(&mut self) {
        if let Some(configuration) = self.bus.take_configuration() {
            self.phase = TickPhase::with_period(configuration.times.sync_period_us);
            self.control.configure(configuration);
        }
        let command = self.bus.command();
        self.outputs = self.control.tick(self.next_tick, &command, &self.inputs);
        self.bus.on_report(&self.control.report());
        if let Some(sync) = self.sync.take() {
            self.phase.on_sync(sync);
        }
        self.next_tick = self.phase.next(self.next_tick);
    }

    /// Moves frames from the controller to free mailboxes, and events to the log.
    fn pump(&mut self, now: Micros) {
        if self.bus.image_to_store().is_some() {
            self.bus.finish_store(Ok(()));
        }
        while self.mailboxes.len() < MAILBOXES {
            let Some(frame) = self.bus.pop_frame() else {
                break;
            };
            self.mailboxes.push(frame);
        }
        while let Some(event) = self.bus.pop_event() {
            match event {
                Event::Sync { at, .. } => self.sync = Some(at),
                // The 1.4 ms that this takes on the wire are left out.
                Event::RecoverBus => self.bus.on_bus_recovered(now),
                event => self.log.push(log_line(now, &event)),
            }
        }
    }

    fn first(&self) -> Option<Frame> {
        // Stable: of two frames with one identifier the older goes first.
        self.mailboxes
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
        if time_ns < BOOT_NS {
            return Ok(());
        }
        let now = self.clock.local(time_ns);
        while self.next_tick <= now {
            self.tick();
        }
        if self
            .bus
            .next_deadline()
            .is_some_and(|deadline| deadline <= now)
        {
            self.bus.poll(now);
        }
        self.pump(now);
        Ok(())
    }

    fn wake(&self) -> Wake {
        // What is still due was looked at in this microsecond already.
        let soonest = self.clock.local(self.now_ns) + Micros(1);
        let deadline = self
            .bus
            .next_deadline()
            .map(|deadline| deadline.max(soonest));
        let next = deadline.map_or(self.next_tick, |deadline| deadline.min(self.next_tick));
        Wake::At(self.clock.world_ns(next))
    }

    fn pending(&self) -> Option<Frame> {
        self.first()
    }

    fn begin(&mut self) {
        self.sending = self.first();
    }

    fn transmitted(&mut self) {
        if let Some(sent) = self.sending.take()
            && let Some(place) = self.mailboxes.iter().position(|frame| *frame == sent)
        {
            self.mailboxes.remove(place);
        }
        self.pump(self.clock.local(self.now_ns));
    }

    fn lost_arbitration(&mut self) {}

    fn receive(&mut self, frame: &Frame) {
        if self.now_ns < BOOT_NS {
            return;
        }
        let now = self.clock.local(self.now_ns);
        self.bus.on_frame(now, frame);
        self.pump(now);
    }

    fn drives(&self) -> [Drive; 4] {
        self.outputs.duty.map(|duty| Drive {
            duty: f64::from(duty),
            enabled: self.outputs.drivers_enabled,
            brake_released: self.outputs.brake_released,
        })
    }

    fn turn_encoders(&mut self, counts: [i32; 4]) {
        for (counter, passed) in self.inputs.encoder_counts.iter_mut().zip(counts) {
            // The counter has 16 bits and wraps: the low half of the sum is meant.
            *counter = counter.wrapping_add(passed as u16);
        }
    }

    fn set_emergency_stop(&mut self, pressed: bool) {
        self.inputs.emergency_stop = pressed;
    }

    fn set_driver_fault(&mut self, fault: bool) {
        self.inputs.driver_fault = fault;
    }

    fn force_bus_off(&mut self) -> bool {
        self.mailboxes.clear();
        self.sending = None;
        let now = self.clock.local(self.now_ns);
        self.bus.on_bus_off(now);
        self.pump(now);
        true
    }

    fn overrun(&mut self) {
        let now = self.clock.local(self.now_ns);
        self.bus.on_fault(now, Fault::ReceiveOverrun);
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
            let clock = Clock::new(ppm);
            for local in [0, 1, 999, 1_000_000, 3_600_000_000] {
                let at = clock.world_ns(Micros(local));
                assert_eq!(clock.local(at), Micros(local));
                assert!(local == 0 || clock.local(at - 1) < Micros(local));
            }
        }
    }
}
