//! The control task: from encoders to PWM, a thousand times a second.
//!
//! It runs on the control executor, above the bus side and below the short interrupts in the table
//! of `board::executors`. It is the only task that touches the motor outputs and the brake. Each
//! tick reads the encoders and the stop and fault inputs, uses the bus side's latest command, runs
//! the control side, sets the outputs, feeds the watchdog, and wakes the bus task when a deadline
//! is due or a fault has to be announced. Then it sleeps until the next tick that the control side
//! requests, which is in step with SYNC. The bus task reads its [`report`] where it is. The task
//! does not wait for the bus side and does not log. A tick that cannot start in time starts late,
//! and its lateness is recorded; missed ticks are not repeated.

use core::cell::RefCell;
use core::mem::MaybeUninit;

use ::control::clock::TickSchedule;
use ::control::configuration::Configuration;
use ::control::interface::{Inputs, Report};
use ::control::quantity::Drive;
use ::control::tick::ControlSide;
use ::control::time::Micros;
use embassy_sync::blocking_mutex::Mutex;
use protocol::Fault;
use static_cell::StaticCell;

use crate::board::now;
use crate::board::{
    DRIVES_ARE_WIRED, Drives, Encoders, Gyro, Indexes, Lines, Meters, Outputs, TickMutex, TickTimer,
};
use crate::shared::{COMMAND, CONTROL_LATENESS, IDENTIFIED, SYNC};
use crate::wake;
use crate::watchdog::Guard;

/// The part of the board that belongs to the tick.
pub struct Parts {
    /// Motors and brake.
    pub outputs: Outputs,
    /// Encoder counters.
    pub encoders: Encoders,
    /// Smart drives, where they turn the wheels.
    pub drives: Drives,
    /// The gyro, where the board has one.
    pub gyro: Gyro,
    /// Encoder index inputs.
    pub indexes: Indexes,
    /// Stop and fault inputs.
    pub lines: Lines,
    /// Supply and motor current.
    pub meters: Meters,
    /// Who feeds the watchdog.
    pub guard: Guard,
}

/// Turns commands and encoder counts into motor outputs.
struct Control {
    side: ControlSide,
    schedule: TickSchedule,
    /// When the next tick begins.
    due: Micros,
    /// Whether current sensors are configured.
    senses: bool,
    /// The changes that the bus side has been woken for.
    announced: (Option<Fault>, bool),
    parts: Parts,
}

/// Some kilobytes that must not be moved over the stack.
static PLACE: StaticCell<Control> = StaticCell::new();

/// The task's state, from [`prepare`] on. The bus side reads the report in it.
static CONTROL: Mutex<TickMutex, RefCell<Option<&'static mut Control>>> =
    Mutex::new(RefCell::new(None));

/// Makes the task's state, and returns when its first tick begins. Not inlined, so that its stack
/// is released.
#[inline(never)]
pub fn prepare(parts: Parts) -> Micros {
    let control = place(PLACE.uninit(), parts);
    let due = control.due;
    CONTROL.lock(|cell| *cell.borrow_mut() = Some(control));
    due
}

/// Turns commands and encoder counts into motor outputs, from `due` on. [`prepare`] comes before.
#[embassy_executor::task]
pub async fn control(mut timer: TickTimer, due: Micros) {
    let mut next = Some(due);
    while let Some(due) = next {
        let begin = timer.until(due).await;
        next = CONTROL.lock(|cell| Some(cell.borrow_mut().as_mut()?.tick(begin)));
    }
}

fn place(place: &'static mut MaybeUninit<Control>, parts: Parts) -> &'static mut Control {
    let mut schedule = TickSchedule::new();
    place.write(Control {
        side: ControlSide::new(),
        due: schedule.next(now()),
        schedule,
        senses: false,
        announced: (None, false),
        parts,
    })
}

/// The report of the last tick, where it is, for the bus side; before the first, that there has
/// been none.
pub fn report(use_it: impl FnOnce(&Report)) {
    CONTROL.lock(|cell| match &*cell.borrow() {
        Some(control) => use_it(control.side.report()),
        None => use_it(&Report::NONE),
    });
}

/// Applies a new configuration, between two ticks, from where the bus side has it: a cell for it
/// would hold a kilobyte. [`prepare`] comes before. Not inlined, so that its stack is released.
#[inline(never)]
pub fn configure(configuration: &Configuration) {
    CONTROL.lock(|cell| {
        if let Some(control) = &mut *cell.borrow_mut() {
            control.apply(configuration);
        }
    });
}

impl Control {
    /// Everything in a tick; returns when the next one begins.
    #[inline(always)]
    fn tick(&mut self, begin: Micros) -> Micros {
        let parts = &mut self.parts;
        let (index, encoder_counts, drive_fault) = if DRIVES_ARE_WIRED {
            let (counts, fault) = parts.drives.read(begin);
            let edges = parts.indexes.edges();
            let index = edges.map(|edges| parts.drives.index_pulses(&edges, begin));
            (index, counts, fault)
        } else {
            // Before the counts, so that no pulse is ahead of them.
            let index = parts.indexes.pulses();
            (index, parts.encoders.counts(), None)
        };
        // A bench image reports its drivers as faulty, so an NMT start is refused.
        let line = parts.lines.driver_fault() || cfg!(feature = "bench");
        let inputs = Inputs {
            index,
            encoder_counts,
            emergency_stop: parts.outputs.emergency_stop(),
            drive_fault: line.then_some(Fault::DriverFault).or(drive_fault),
            protective_stop: parts.lines.protective_stop(),
            supply_input: Some(parts.meters.supply()),
            gyro: parts.gyro.read(),
            current_inputs: self.senses.then(|| parts.meters.currents()),
        };
        let wanted = COMMAND.with(|command| {
            if DRIVES_ARE_WIRED {
                let temperature = parts.drives.temperature();
                self.side.tick_current(begin, command, &inputs, temperature)
            } else {
                self.side.tick(begin, command, &inputs)
            }
        });
        let duty = if DRIVES_ARE_WIRED {
            parts.drives.send(wanted.given(), wanted.drivers_enabled);
            [Drive::ZERO; 4]
        } else {
            wanted.drive
        };
        parts
            .outputs
            .set(duty, wanted.drivers_enabled, wanted.brake_released);
        parts.gyro.ask();
        let report = self.side.report();
        parts.guard.tick(report);
        // Changes that the bus side has to process at once.
        let news = (report.fault, report.standstill);
        if let Some(outcome) = self.side.take_identification() {
            IDENTIFIED.put(&outcome);
            wake::BUS.signal();
        }
        if news != self.announced {
            self.announced = news;
            wake::BUS.signal();
        }
        wake::BUS.tick(begin);

        CONTROL_LATENESS.record(begin.since(self.due));
        if let Some(sync) = SYNC.receive() {
            self.schedule.on_sync(sync);
        }
        self.due = self.schedule.next(self.due);
        if self.due <= begin {
            self.due = self.schedule.next(now());
        }
        self.due
    }

    fn apply(&mut self, configuration: &Configuration) {
        self.schedule = TickSchedule::with_period(configuration.times.sync_period_us);
        let rolling = configuration.drivetrain.rolling();
        let parts = &mut self.parts;
        parts.encoders.set_filter(configuration.encoder_filter);
        let listens = rolling.is_some_and(|rolling| rolling.rollers().has_index());
        parts.indexes.listen(listens);
        parts
            .outputs
            .configure(configuration.output_stage, configuration.pwm_hz);
        if let Some(model) = configuration.output_stage.smart_drive() {
            parts.drives.configure(configuration.drives, model);
        }
        self.senses = configuration.current.is_some();
        self.side.configure(configuration);
    }
}
