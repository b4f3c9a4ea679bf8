//! The thread that sends SYNC: on its schedule whatever the session is doing.
//!
//! It sleeps until shortly before a SYNC is due and spins for the rest, because a sleeping thread
//! wakes some 50 to 100 µs late on Linux. Every SYNC is due a whole number of periods after the
//! first: lateness does not add up. How late each went out is measured where the system has taken
//! the frame. When the machine was so busy that the next one is less than half a period away, that
//! one is left out: robots need the time between two SYNCs to hear from each other, and bridge a
//! missing one, but not a burst.
//!
//! It asks the system for real-time priority (SCHED_FIFO on Linux), so that other programs do not
//! hold it up; without permission it goes on as any thread, and says so in its punctuality.
//!
//! The thread shares the adapter's writing end with the session, one frame at a time. It ends when
//! the link is dropped or the schedule is taken back. It sends no setpoints and no heartbeat: when
//! the session hangs, robots must notice.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use canopen::client;

use super::{OnBus, Received, Write, time_since};
use crate::bus::link::Schedule;
use crate::bus::punctuality::Lateness;

/// How long before a SYNC is due the thread stops sleeping.
const SPIN: Duration = Duration::from_micros(300);

/// The adapter's writing end, shared by the session and the SYNC thread.
pub(super) type SharedWrite = Arc<Mutex<Box<Write>>>;

/// Writes one frame, alone.
pub(super) fn write(shared: &SharedWrite, frame: &canopen::Frame) -> io::Result<()> {
    let mut write = shared.lock().unwrap_or_else(PoisonError::into_inner);
    (*write)(frame)
}

/// A running SYNC thread; dropping it ends it.
pub(super) struct Pacer {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Pacer {
    /// Starts to send SYNC. `started` is the zero of the link's clock; `sender` gets the frames
    /// that were sent, and failures.
    pub fn start(
        schedule: Schedule,
        started: Instant,
        output: SharedWrite,
        lateness: Arc<Mutex<Lateness>>,
        sender: Sender<Received>,
    ) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let granted = ask_for_priority();
            lateness
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .set_realtime(granted);
            let period = Duration::from_micros(schedule.period_us.max(1));
            let mut due = started + Duration::from_micros(schedule.first.0);
            let mut counter = schedule.counter;
            loop {
                wait(due, &stopped);
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                let sync = client::sync(Some(counter));
                // Said first, so that no robot's answer comes before it.
                let _ = sender.send(Ok(OnBus::Sent(time_since(started), sync)));
                if let Err(error) = write(&output, &sync) {
                    let _ = sender.send(Err(error));
                    return;
                }
                let late = due.elapsed();
                let nanos = u64::try_from(late.as_nanos()).unwrap_or(u64::MAX);
                lateness
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .record(nanos);
                counter = counter % schedule.overflow + 1;
                due = after(due, Instant::now(), period);
            }
        });
        Self {
            stop,
            thread: Some(thread),
        }
    }
}

/// Asks for real-time priority, above ordinary programs and below the system's own threads; whether
/// it was given.
#[cfg(target_os = "linux")]
fn ask_for_priority() -> bool {
    use thread_priority::{
        RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
        set_thread_priority_and_policy, thread_native_id,
    };
    /// Of 0 to 99.
    const PRIORITY: u8 = 50;
    ThreadPriority::try_from(PRIORITY).is_ok_and(|priority| {
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        set_thread_priority_and_policy(thread_native_id(), priority, policy).is_ok()
    })
}

#[cfg(not(target_os = "linux"))]
const fn ask_for_priority() -> bool {
    false
}

/// When the next SYNC is due after one that was due at `due` and has been sent `now`.
fn after(mut due: Instant, now: Instant, period: Duration) -> Instant {
    due += period;
    while due < now + period / 2 {
        due += period;
    }
    due
}

/// Returns at `due`, or when told to stop.
fn wait(due: Instant, stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        let left = due.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return;
        }
        if left > SPIN {
            std::thread::sleep((left - SPIN).min(Duration::from_millis(50)));
        } else {
            std::hint::spin_loop();
        }
    }
}

impl Drop for Pacer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_sync_is_followed_on_schedule_but_never_closely() {
        let period = Duration::from_millis(10);
        let due = Instant::now();
        let next = |late_ms| after(due, due + Duration::from_millis(late_ms), period) - due;
        assert_eq!(next(0), period);
        assert_eq!(next(5), period);
        // 4 ms before the next: that one is left out.
        assert_eq!(next(6), 2 * period);
        assert_eq!(next(12), 2 * period);
        assert_eq!(next(47), 6 * period);
    }
}
