//! The control task: from encoders to PWM, a thousand times a second.
//!
//! It runs on the control executor, above the bus side and below the short interrupts in the table
//! of `board::executors`. It is the only task that touches the motor outputs and the brake. Each
//! tick reads the encoders and the stop and fault inputs, takes the bus side's latest command, runs
//! the control side, sets the outputs, stores a report, feeds the watchdog, and wakes the bus task
//! when a deadline is due or a fault has to be announced. Then it sleeps until the next tick that
//! the control side requests, which is in step with SYNC. It does not wait for the bus side and
//! does not log. A tick that cannot start in time starts late, and its lateness is recorded; missed
//! ticks are not repeated.

use ::control::clock::TickSchedule;
use ::control::interface::Inputs;
use ::control::rollers::RollerConfiguration;
use ::control::tick::ControlSide;

use crate::board::{Encoders, Indexes, Lines, Meters, Outputs, TickTimer, now};
use crate::shared::{COMMAND, CONFIGURATION, CONTROL_LATENESS, IDENTIFIED, REPORT, SYNC};
use crate::wake;
use crate::watchdog::Guard;

/// Turns commands and encoder counts into motor outputs.
#[embassy_executor::task]
pub async fn control(
    mut outputs: Outputs,
    encoders: Encoders,
    mut indexes: Indexes,
    lines: Lines,
    meters: Meters,
    mut timer: TickTimer,
    mut guard: Guard,
) {
    let mut side = ControlSide::new();
    let mut schedule = TickSchedule::new();
    let mut senses = false;
    let mut due = schedule.next(now());
    let mut announced = (None, false);
    loop {
        let begin = timer.until(due).await;
        if CONFIGURATION.is_full() {
            let taken = take_over(&mut side, &mut schedule, &encoders, &mut indexes);
            senses = taken.senses;
            outputs.set_frequency(taken.pwm_hz);
        }
        // Before the counts, so that no pulse is ahead of them.
        let index = indexes.pulses();
        let inputs = Inputs {
            index,
            encoder_counts: encoders.counts(),
            emergency_stop: outputs.emergency_stop(),
            // A bench image reports its drivers as faulty, so an NMT start is refused.
            driver_fault: lines.driver_fault() || cfg!(feature = "bench"),
            protective_stop: lines.protective_stop(),
            supply_input: Some(meters.supply()),
            current_inputs: senses.then(|| meters.currents()),
        };
        let wanted = side.tick(begin, &COMMAND.get(), &inputs);
        outputs.set(wanted.duty, wanted.drivers_enabled, wanted.brake_released);
        let report = side.report();
        REPORT.put(report);
        guard.tick(report);
        // Changes that the bus side has to process at once.
        let news = (report.fault, report.standstill);
        if let Some(outcome) = side.take_identification() {
            IDENTIFIED.put(&outcome);
            wake::BUS.signal();
        }
        if news != announced {
            announced = news;
            wake::BUS.signal();
        }
        wake::BUS.tick(begin);

        CONTROL_LATENESS.record(begin.since(due));
        if let Some(sync) = SYNC.receive() {
            schedule.on_sync(sync);
        }
        due = schedule.next(due);
        if due <= begin {
            due = schedule.next(now());
        }
    }
}

/// The part of a configuration that the task itself needs.
struct Taken {
    /// Whether current sensors are configured.
    senses: bool,
    /// Frequency of the PWM.
    pwm_hz: u32,
}

/// Applies a new configuration. Not inlined, so that its stack is released.
#[inline(never)]
fn take_over(
    side: &mut ControlSide,
    schedule: &mut TickSchedule,
    encoders: &Encoders,
    indexes: &mut Indexes,
) -> Taken {
    let mut taken = Taken {
        senses: false,
        pwm_hz: 0,
    };
    CONFIGURATION.receive_with(|configuration| {
        *schedule = TickSchedule::with_period(configuration.times.sync_period_us);
        let rollers = configuration.rollers.as_ref();
        encoders.set_filter(configuration.encoder_filter);
        indexes.listen(rollers.is_some_and(RollerConfiguration::has_index));
        side.configure(configuration);
        taken = Taken {
            senses: configuration.current.is_some(),
            pwm_hz: configuration.pwm_hz,
        };
    });
    taken
}
