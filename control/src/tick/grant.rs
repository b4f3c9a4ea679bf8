//! *Grant*: how much of the bus side's request is allowed, and the safe state.

use protocol::Reaction;

use super::Supervision;
use super::judge::reaction;
use super::motion::Motion;
use crate::brake::Brake;
use crate::interface::{Command, Mode, Outputs};
use crate::limiter::Limiter;
use crate::quantity::Rate;
use crate::time::Micros;
use crate::twist::still;

/// Wheels slower than this are at rest, rad/s.
const STANDING_RATE: Rate = Rate::new(0.05);

/// Longest time from the end of a ramp until the wheels are at rest, us; then the brake is engaged
/// anyway.
const SETTLE_US: u64 = 300_000;

impl Supervision {
    /// The mode that is allowed for the bus side's command.
    #[inline]
    pub(super) fn grant(&mut self, motion: &Motion, command: &Command) -> Mode {
        let known = command.configuration == motion.configuration.crc;
        let mode = match (command.mode, self.report.fault.map(reaction)) {
            _ if !known || self.unproven > 0 => Mode::Off,
            (_, Some(Reaction::Cut)) => Mode::Off,
            (Mode::Hold | Mode::Follow | Mode::Identify, Some(Reaction::Ramp)) => Mode::Ramp,
            // The motors carry the load until the brake holds it.
            (Mode::Off, _) if self.holds(motion) => Mode::Ramp,
            (mode, None | Some(Reaction::Ramp)) => mode,
        };
        self.report.mode = mode;
        if mode != Mode::Ramp {
            self.settling = None;
            self.report.standstill = false;
        }
        mode
    }

    /// Whether the robot is at rest and its drivers hold the load until the brake does.
    pub(super) fn holds(&self, motion: &Motion) -> bool {
        let waits = motion.configuration.brake.engage_us > 0;
        waits && self.brake.is_held_by_drivers() && motion.limiter.stands()
    }

    /// The safe state, with loops and reference at rest.
    #[inline(never)]
    pub(super) fn rest(
        &mut self,
        motion: &mut Motion,
        command: &Command,
        standstill: bool,
    ) -> Outputs {
        motion.rest(command.update);
        self.safe(standstill)
    }

    /// The safe state: no torque, drivers off, braked; `standstill` says that a ramp has ended.
    #[inline(never)]
    pub(super) fn safe(&mut self, standstill: bool) -> Outputs {
        self.brake = Brake::Engaged;
        self.report.brake_is_free = false;
        self.report.standstill = standstill;
        self.report.limit = None;
        self.report.twist_ref = still();
        self.report.rates_ref = [Rate::ZERO; 4];
        Outputs::SAFE
    }
}

/// Whether a ramp is over: the reference is zero, and the wheels are at rest or their time has
/// expired.
pub(super) fn settled(
    since: &mut Option<Micros>,
    limiter: &Limiter,
    rates: &[Rate; 4],
    now: Micros,
) -> bool {
    if !limiter.stands() {
        *since = None;
        return false;
    }
    let waited = now.since(*since.get_or_insert(now)).0;
    let standing = rates.iter().all(|rate| rate.abs() < STANDING_RATE);
    (standing && waited >= 20_000) || waited >= SETTLE_US
}
