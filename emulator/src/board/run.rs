//! The loop that runs a board.
//!
//! [`Board::run`] selects the next activity: a due event, a stall, sleep, or instructions.
//! Instructions are executed in one of three ways: on the fast path, with the reference core for
//! those that are not plain; on the reference core alone; or one by one, with every instruction
//! examined for the profile, the debugger or the trace.

use std::sync::atomic::Ordering::Relaxed;

use super::Board;
use super::follow::Place;
use crate::fast::Memory;
use crate::profile::{At, Cost};
use crate::soc::Soc;
use crate::stop::{Stop, StopKind};
use crate::system::rcc;

/// Largest number of core cycles between two checks of a running core: 11 us at 180 MHz.
const LOOK_CYCLES: u64 = 2_000;
/// The first address that is not of the flash or its image at 0.
const SRAM_FROM: u32 = 0x1000_0000;
/// SCR: sleep means stop or standby mode.
const SLEEPDEEP: u32 = 1 << 2;

impl Board {
    pub(super) fn run(&mut self, t_ns: u64, requests: Option<u64>) -> Result<(), Stop> {
        self.shared.attention.store(true, Relaxed);
        let mut target = 0;
        let mut stall = None;
        loop {
            if self.shared.attention.load(Relaxed) {
                self.shared.attention.store(false, Relaxed);
                let (reset, stop, sent);
                (target, stall, reset, stop, sent) = self.shared.look(|soc| {
                    let stall = soc
                        .flash
                        .busy_until()
                        .map(|ps| soc.clock.cycle_at_local(ps));
                    let target = soc.clock.cycle_at_world(t_ns);
                    (
                        target,
                        stall,
                        soc.reset_request,
                        soc.stop.clone(),
                        soc.can.requests(),
                    )
                });
                if let Some(kind) = stop {
                    // The program counter is already past the instruction; two bytes back is inside
                    // it.
                    return Err(self.stop(kind, self.cpu.pc().wrapping_sub(2)));
                }
                if reset != 0 {
                    self.system_reset(reset);
                    continue;
                }
                if requests.is_some_and(|seen| sent != seen) {
                    break;
                }
            }
            let next = self.shared.next_event.load(Relaxed);
            if self.now >= next {
                self.shared.with(Soc::dispatch);
                continue;
            }
            if self.now >= target {
                break;
            }
            if self.now >= self.next_log {
                self.drain_log();
            }
            let limit = target.min(next).min(self.next_log);
            match stall.filter(|until| *until > self.now) {
                // The core reads the busy flash, so it waits, and interrupts wait too.
                Some(until) if self.awaits_flash() => self.stall_to(limit.min(until)),
                _ if self.halted || self.debugger.stopped => {
                    let stood = limit - self.now;
                    self.skip_to(limit);
                    self.shared.with(|soc| soc.stood(stood));
                }
                _ if self.asleep && !self.shared.lines_changed.load(Relaxed) => {
                    self.sleep_to(limit)?
                }
                _ => self.execute(limit.min(self.now + LOOK_CYCLES)),
            }
        }
        self.drain_log();
        Ok(())
    }

    /// Whether the core needs the flash while that is busy: its next instruction lies there, or the
    /// last one has read from there (a constant, the vector of an exception). The latter has its
    /// value already and waits for it afterwards.
    fn awaits_flash(&self) -> bool {
        self.shared.flash_busy.load(Relaxed)
            && (self.cpu.pc() < SRAM_FROM || self.shared.flash_awaited.load(Relaxed))
    }

    /// Steps the core until a cycle, or until something needs attention.
    fn execute(&mut self, limit: u64) {
        let drowsy = std::mem::replace(&mut self.asleep, false);
        if self.profile.is_some() || self.debugger.is_watching() || self.follows_tasks() {
            self.execute_one_by_one(limit);
        } else if self.config.reference_core {
            self.execute_slowly(limit, drowsy);
        } else {
            self.execute_fast(limit, drowsy);
        }
        if self.cpu.reset_requested() {
            self.system_reset(rcc::cause::SOFTWARE);
        } else if self.config.stop_on_hard_fault && self.cpu.current_exception().0 == 3 {
            self.shared
                .with(|soc| soc.stop.get_or_insert(StopKind::HardFault).clone());
        }
    }

    /// Plain instructions on the fast path, the others one by one on the reference core.
    fn execute_fast(&mut self, limit: u64, mut drowsy: bool) {
        loop {
            let memory = Memory {
                cpu: &self.cpu,
                ram: &self.ram,
                flash: &self.flash,
                shared: &self.shared,
            };
            let (now, instructions) = self.fast.run(memory, self.now, limit);
            self.now = now;
            self.instructions += instructions;
            if self.now >= limit || self.shared.attention.load(Relaxed) {
                break;
            }
            self.shared.lines_changed.store(false, Relaxed);
            let pc = self.cpu.pc();
            let (cycles, entered) = self.step();
            self.now += cycles;
            self.shared.now.store(self.now, Relaxed);
            let asleep = self.cpu.is_asleep() || self.cpu.is_locked_up();
            // Asleep before the step and after it: no pending interrupt wakes the core.
            self.asleep = asleep && (drowsy || self.nothing_pends());
            drowsy = asleep;
            // A core that slept before the step, and does after it, has executed nothing.
            let slept = asleep && self.cpu.pc() == pc;
            self.instructions += u64::from(!entered && !slept);
            if self.asleep
                || self.now >= limit
                || self.shared.attention.load(Relaxed)
                || self.awaits_flash()
            {
                break;
            }
        }
    }

    /// Whether no exception waits that could wake the core.
    fn nothing_pends(&self) -> bool {
        self.shared.lines() == [0; _] && self.cpu.with_sys(|sys| sys.highest_pending().is_none())
    }

    fn execute_slowly(&mut self, limit: u64, mut drowsy: bool) {
        loop {
            self.shared.lines_changed.store(false, Relaxed);
            let pc = self.cpu.pc();
            let (cycles, entered) = self.step();
            self.now += cycles;
            self.shared.now.store(self.now, Relaxed);
            let asleep = self.cpu.is_asleep() || self.cpu.is_locked_up();
            self.asleep = asleep && (drowsy || self.nothing_pends());
            drowsy = asleep;
            let slept = asleep && self.cpu.pc() == pc;
            self.instructions += u64::from(!entered && !slept);
            if self.asleep
                || self.now >= limit
                || self.shared.attention.load(Relaxed)
                || self.awaits_flash()
            {
                break;
            }
        }
    }

    fn execute_one_by_one(&mut self, limit: u64) {
        while self.now < limit {
            let pc = self.cpu.pc();
            if self.debugger.stops_before(pc) {
                break;
            }
            let at = At {
                pc,
                sp: self.cpu.reg(13),
                lr: self.cpu.reg(14),
                exception: self.cpu.current_exception().0,
                cycle: self.now,
            };
            self.trace_position(at);
            let waited = self.fast.waited();
            let (cycles, entered) = self.step_either_way();
            if cycles == 1
                && self.cpu.pc() == pc
                && (self.cpu.is_asleep() || self.cpu.is_locked_up())
            {
                self.asleep = true;
                break;
            }
            self.instructions += u64::from(!entered);
            if let Some(profile) = &mut self.profile {
                let cost = Cost {
                    cycles,
                    waited: self.fast.waited() - waited,
                };
                profile.count(&self.firmware, at, cost, entered);
            }
            self.asleep = self.cpu.is_asleep() && self.nothing_pends();
            let attention = self.shared.attention.load(Relaxed) || self.awaits_flash();
            if self.debugger.done(&self.ram) || attention || self.asleep {
                break;
            }
        }
    }

    /// Whether the trace records the position in the program.
    fn follows_tasks(&self) -> bool {
        self.follow.is_some()
    }

    fn trace_position(&mut self, at: At) {
        let Some(follow) = &mut self.follow else {
            return;
        };
        let place = Place {
            pc: at.pc,
            sp: at.sp,
            lr: at.lr,
            exception: at.exception,
        };
        let (shared, now) = (&self.shared, self.now);
        follow.look(place, |change| {
            shared.look(|soc| {
                if let Some(trace) = &mut soc.trace {
                    trace.changes.push((now, change));
                }
            });
        });
    }

    /// A single step takes the same path as a long run, so stepping costs the same cycles.
    fn step_either_way(&mut self) -> (u64, bool) {
        let memory = Memory {
            cpu: &self.cpu,
            ram: &self.ram,
            flash: &self.flash,
            shared: &self.shared,
        };
        let (now, instructions) = self.fast.run(memory, self.now, self.now + 1);
        if instructions > 0 {
            let cycles = now - self.now;
            self.now = now;
            return (cycles, false);
        }
        self.shared.lines_changed.store(false, Relaxed);
        let (cycles, entered) = self.step();
        self.now += cycles;
        self.shared.now.store(self.now, Relaxed);
        (cycles, entered)
    }

    /// Advances time while the core sleeps. SysTick and the cycle counter keep counting, as with
    /// the debug unit's DBG_SLEEP, which the HAL sets.
    fn sleep_to(&mut self, limit: u64) -> Result<(), Stop> {
        if self.cpu.is_locked_up() && self.shared.look(|soc| !soc.watchdog_running()) {
            return Err(self.stop(StopKind::LockedUp, self.cpu.pc()));
        }
        if self.cpu.with_sys(|sys| sys.scr & SLEEPDEEP != 0) {
            let kind = StopKind::Unmodelled {
                what: "SCB_SCR.SLEEPDEEP: stop and standby mode".to_owned(),
                address: 0xE000_ED10,
                written: None,
            };
            return Err(self.stop(kind, self.cpu.pc()));
        }
        let span = limit - self.now;
        let (span, wake) = self.cpu.with_sys(|sys| {
            let mut span = span;
            if sys.syst_csr & 3 == 3 {
                let left = u64::from(sys.syst_cvr & 0xFF_FFFF);
                span = span
                    .min(if left == 0 {
                        u64::from(sys.syst_rvr) + 1
                    } else {
                        left
                    })
                    .max(1);
            }
            sys.tick_cyccnt(span);
            let wake = sys.tick_systick(span) && sys.syst_csr & 2 != 0;
            if wake {
                sys.set_pending(rsemu::cpu::arm::v7m::sys::Exception::SYSTICK, true);
            }
            (span, wake)
        });
        if wake {
            self.shared.lines_changed.store(true, Relaxed);
        }
        self.slept += span;
        self.skip_to(self.now + span);
        self.shared.look(|soc| soc.slept(span));
        Ok(())
    }

    /// The core waits for the flash; its cycle counter goes on.
    fn stall_to(&mut self, cycle: u64) {
        let span = cycle.saturating_sub(self.now);
        self.cpu.with_sys(|sys| sys.tick_cyccnt(span));
        self.skip_to(cycle);
    }

    fn skip_to(&mut self, cycle: u64) {
        self.now = cycle;
        self.shared.now.store(cycle, Relaxed);
    }
}
