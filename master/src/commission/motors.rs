//! Identification of a robot's motors: the robot measures; this module starts it and reads the
//! results.
//!
//! One robot is started alone, with SYNC and heartbeat but no setpoints; the others stay in
//! PRE-OPERATIONAL. By the permission to move (object 0x2050:1) the caller declares that the wheels
//! are off the floor, or that the distance they may roll is clear. It is withdrawn at the end,
//! however the run ends, and the robot is left in PRE-OPERATIONAL at rest. The results take effect
//! only by [`accept`], and survive a power cycle only by [`Wire::save`].

use canopen::{Frame, Micros, NmtCommand, NmtState, NmtTarget, NodeId, client};
use protocol::address::{self as at, identified, motor};
use protocol::{Address, Code, Kind, RobotReport, Value};

use crate::bus::link::{Link, Schedule};
use crate::bus::wire::Wire;
use crate::error::MasterError;
use protocol::timing::SYNC_OVERFLOW;

/// SYNC periods before and after the start, for the robot to get in step.
const SETTLE_SYNCS: u32 = 10;
/// SYNC periods between two looks at the status.
const LOOK_SYNCS: u32 = 10;
/// SYNC periods in which a wheel without voltage comes to rest.
const COAST_SYNCS: u32 = 100;
/// How long a run may take in all, µs; the robot's own limit is 20 s.
const TIME_LIMIT_US: u64 = 25_000_000;
/// Status of object 0x2051:2.
const RUNNING: u32 = 1;
const DONE: u32 = 2;
const STOPPED: u32 = 3;
const FAULTED: u32 = 4;

/// How far a run may go, and what is made of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Fastest wheel rate, rad/s.
    pub rate: f32,
    /// Farthest a wheel may turn from where it stands, rad.
    pub travel: f32,
    /// Bandwidth of the wheel loops, rad/s.
    pub bandwidth: f32,
    /// Wanted damping of the wheel loops; 1 is critical.
    pub damping: f32,
    /// Wheels that take part, bit 0 front left and so on; 0 is all of them.
    pub wheels: u8,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            rate: 5.0,
            travel: 12.0,
            bandwidth: 10.0,
            damping: 1.0,
            wheels: 0,
        }
    }
}

/// The motor of one wheel, and gains for its loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motor {
    /// V.
    pub static_friction: f32,
    /// V s/rad.
    pub speed: f32,
    /// V s²/rad.
    pub acceleration: f32,
    /// V s/rad.
    pub proportional: f32,
    /// V/rad.
    pub integral: f32,
    /// Rms of what the fit leaves, V.
    pub misfit: f32,
}

/// Names of the wheels, in their order.
pub const WHEELS: [&str; 4] = ["front left", "front right", "rear left", "rear right"];

/// Identifies the motors of one robot that is configured and in PRE-OPERATIONAL. `period_us` is
/// that of SYNC; `seen` is called now and then with the seconds since it began.
///
/// # Errors
/// When the robot refuses, gives up (the error says why), or the link fails. The robot is at rest
/// then, too.
pub fn identify_motors<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    period_us: u64,
    settings: &Settings,
    seen: Watch<'_>,
) -> Result<[Motor; 4], MasterError> {
    let mut run = Run::new(wire, node, period_us);
    match run.whole(settings, seen)? {
        DONE => run.results(),
        status => {
            let wheel = run.read(at::IDENTIFY_WHEEL)?;
            Err(run.failure(status, wheel)?)
        }
    }
}

/// Is told how long a run takes already, in s; an error ends it, and the robot comes to rest.
pub type Watch<'a> = &'a mut dyn FnMut(f64) -> Result<(), MasterError>;

/// What the encoders said while one wheel was to turn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Turned {
    /// How far each wheel's encoder went to either side, rad: the farthest from where it stood,
    /// with its sign.
    pub ways: [f32; 4],
    /// Volts a rate of the wheel that was to turn, V s/rad, where the run came to its end.
    pub speed: Option<f32>,
}

impl Turned {
    /// Whether all wheels turned, although one alone was to.
    #[must_use]
    pub fn all(&self) -> bool {
        self.ways.iter().all(|way| way.abs() > TURNED)
    }
}

/// An encoder that went farther than this has turned, rad.
pub const TURNED: f32 = 0.05;

/// Gives one wheel of a robot some voltage, forward and then backward, and watches all encoders. As
/// [`identify_motors`] otherwise; what stops the robot is no error here: a wheel that stands or
/// turns backwards, or wheels that all turn by themselves.
///
/// # Errors
/// When the robot refuses, a fault came up, or the link fails.
pub fn turn_wheel<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    period_us: u64,
    wheel: u8,
    seen: Watch<'_>,
) -> Result<Turned, MasterError> {
    let settings = Settings {
        rate: 3.0,
        travel: 6.0,
        wheels: 1 << wheel,
        ..Settings::default()
    };
    let mut run = Run::new(wire, node, period_us);
    let status = run.whole(&settings, seen);
    if status != Err(MasterError::Aborted) {
        run.syncs(COAST_SYNCS)?;
    }
    // The next one who asks means all wheels.
    let all = run.wire.write(
        node,
        at::IDENTIFY_WHEELS,
        Value::U8(Settings::default().wheels),
    );
    all?;
    let ways = run.farthest;
    let turned = Turned { ways, speed: None };
    let ended = status == Err(MasterError::Aborted) || status == Ok(DONE) || run.restarted;
    if turned.all() && !ended {
        return Ok(turned);
    }
    let status = status?;
    if status != DONE && !(5..=10).contains(&status) {
        return Err(run.failure(status, u32::from(wheel))?);
    }
    let speed = if status == DONE {
        let results = run.results()?;
        results.get(usize::from(wheel)).map(|motor| motor.speed)
    } else {
        None
    };
    Ok(Turned { speed, ..turned })
}

/// Writes what was found into the motors' objects, in PRE-OPERATIONAL, and reads it back.
///
/// # Errors
/// When the robot refuses a value or reads back another.
pub fn accept<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    motors: &[Motor; 4],
) -> Result<(), MasterError> {
    for (wheel, found) in (0..).zip(motors) {
        for (address, value) in [
            (motor::static_friction(wheel), found.static_friction),
            (motor::speed(wheel), found.speed),
            (motor::acceleration(wheel), found.acceleration),
            (motor::proportional(wheel), found.proportional),
            (motor::integral(wheel), found.integral),
        ] {
            wire.write_checked(node, address, Value::F32(value))?;
        }
    }
    Ok(())
}

/// Why a run ends whose robot has restarted: it has no permission any more.
const RESTARTED: &str =
    "the robot restarted during the run; read its reset cause (2001:3) and its supply";

/// What a status says.
fn reason(status: u32, wheel: u32) -> String {
    let why = match status {
        STOPPED => "stopped by the master",
        FAULTED => "a fault occurred; `omnibus status --history` shows it",
        5 => "its time limit of 20 s expired",
        6 => {
            "a wheel exceeded the permitted rate by half; lower the rate, look for a slipping gear"
        }
        7 => "a wheel turned farther than permitted; lower the rate or permit a larger angle",
        8 => {
            "a wheel does not turn at a quarter of the nominal supply; look for a blocked wheel, \
             the motor's or the encoder's cable"
        }
        9 => {
            "a wheel turns backwards; swap its motor's wires or its encoder's channels, or set \
             0x2020:2 or 3"
        }
        10 => {
            "a wheel did not behave like a motor; look for slip, a loose coupling, a sagging supply"
        }
        0 => "the robot did not begin",
        _ => "the robot gives a reason that this release does not know",
    };
    let wheel = usize::try_from(wheel).ok().and_then(|n| WHEELS.get(n));
    match wheel {
        Some(wheel) => format!("{wheel}: {why}"),
        None => why.to_owned(),
    }
}

/// Whether a frame is the boot-up message of a node.
fn boots(node: u8, frame: &Frame) -> bool {
    client::parse_heartbeat(frame)
        .is_some_and(|(from, state)| from.get() == node && state == NmtState::Initialising)
}

struct Run<'a, L: Link> {
    wire: &'a mut Wire<L>,
    node: u8,
    period_us: u64,
    began: Micros,
    next_sync: Micros,
    /// The robot has restarted since then.
    restarted: bool,
    /// Whether the link sends SYNC by itself; `None` before the first.
    paced: Option<bool>,
    /// Where the wheels are by the rates they report, and the farthest they have been, rad.
    ways: [f32; 4],
    farthest: [f32; 4],
}

impl<'a, L: Link> Run<'a, L> {
    fn new(wire: &'a mut Wire<L>, node: u8, period_us: u64) -> Self {
        Self {
            next_sync: Micros((wire.now().0 / period_us + 1) * period_us),
            began: wire.now(),
            wire,
            node,
            period_us,
            restarted: false,
            paced: None,
            ways: [0.0; 4],
            farthest: [0.0; 4],
        }
    }

    /// A run from beginning to end, and how it ended (object 0x2051:2).
    fn whole(&mut self, settings: &Settings, seen: Watch<'_>) -> Result<u32, MasterError> {
        // Only a robot that is nobody's member may move alone. By itself it is a member again when
        // this master falls silent.
        self.wire
            .write_checked(self.node, at::ALONE_FOR_NOW, Value::U8(1))?;
        let done = self.until_over(settings, seen);
        if done == Err(MasterError::Aborted) {
            // It comes to rest along its ramp before its outputs are switched off.
            self.wire.write(self.node, at::IDENTIFY, Value::U8(0))?;
            self.syncs(COAST_SYNCS)?;
        }
        // Whatever happened: no permission, at rest, and a member again.
        let forbidden = self.wire.write(self.node, at::COMMISSIONING, Value::U8(0));
        self.command(NmtCommand::EnterPreOperational)?;
        let restored = self
            .wire
            .write_checked(self.node, at::ALONE_FOR_NOW, Value::U8(0));
        if done != Err(MasterError::Aborted) && self.has_restarted() {
            let (node, reason) = (self.node, RESTARTED.into());
            return Err(MasterError::Identification { node, reason });
        }
        let status = done?;
        forbidden?;
        restored?;
        Ok(status)
    }

    /// Whether the robot's boot-up was received during the run, or waits to be read.
    fn has_restarted(&mut self) -> bool {
        let (node, began) = (self.node, self.began);
        let mut waiting = self.wire.backlog.iter();
        let is_boot_up = |(at, frame): &(Micros, Frame)| *at > began && boots(node, frame);
        self.restarted |= waiting.any(is_boot_up);
        self.restarted
    }

    fn until_over(&mut self, settings: &Settings, seen: Watch<'_>) -> Result<u32, MasterError> {
        self.wire
            .write_checked(self.node, at::IDENTIFY_WHEELS, Value::U8(settings.wheels))?;
        for (address, value) in [
            (at::IDENTIFY_RATE, settings.rate),
            (at::IDENTIFY_TRAVEL, settings.travel),
            (at::IDENTIFY_BANDWIDTH, settings.bandwidth),
            (at::IDENTIFY_DAMPING, settings.damping),
        ] {
            self.wire
                .write_checked(self.node, address, Value::F32(value))?;
        }
        self.syncs(SETTLE_SYNCS)?;
        self.command(NmtCommand::Start)?;
        self.syncs(SETTLE_SYNCS)?;
        self.wire
            .write(self.node, at::COMMISSIONING, Value::U8(1))?;
        self.wire.write(self.node, at::IDENTIFY, Value::U8(1))?;
        let began = self.wire.now().0;
        loop {
            self.syncs(LOOK_SYNCS)?;
            let status = self.read(at::IDENTIFY_STATUS)?;
            let elapsed = self.wire.now().0 - began;
            seen(elapsed as f64 * 1e-6)?;
            if status != RUNNING || elapsed >= TIME_LIMIT_US {
                return Ok(status);
            }
        }
    }

    /// Why a run failed. Where a fault ended it, that is the cause.
    fn failure(&mut self, status: u32, wheel: u32) -> Result<MasterError, MasterError> {
        let node = self.node;
        let code = self.wire.read(node, at::STATUS_CODE, Kind::U16)?.to_bits();
        let code = u16::try_from(code).ok().and_then(Code::from_code);
        let reason = match (status, code) {
            (STOPPED | FAULTED, Some(Code::Fault(_))) => code.map(|code| code.to_string()),
            _ => None,
        };
        let reason = reason.unwrap_or_else(|| self::reason(status, wheel));
        let error = MasterError::Identification { node, reason };
        Ok(self.wire.blame(error))
    }

    fn read(&mut self, address: Address) -> Result<u32, MasterError> {
        Ok(self.wire.read(self.node, address, Kind::U8)?.to_bits())
    }

    fn results(&mut self) -> Result<[Motor; 4], MasterError> {
        let mut motors = [Motor::default(); 4];
        for (wheel, motor) in (0..).zip(&mut motors) {
            let mut real = |sub| -> Result<f32, MasterError> {
                let address = identified::value(wheel, sub);
                let value = self.wire.read(self.node, address, Kind::F32)?;
                Ok(f32::from_bits(value.to_bits()))
            };
            *motor = Motor {
                static_friction: real(1)?,
                speed: real(2)?,
                acceleration: real(3)?,
                proportional: real(4)?,
                integral: real(5)?,
                misfit: real(6)?,
            };
        }
        Ok(motors)
    }

    fn command(&mut self, command: NmtCommand) -> Result<(), MasterError> {
        let node = NodeId::new(self.node).map_or(NmtTarget::All, NmtTarget::Node);
        self.wire.send(&client::nmt(command, node))
    }

    /// Follows the wheels by their rates.
    fn follow(&mut self, rates: [f32; 4]) {
        let period = self.period_us as f32 * 1e-6;
        let wheels = self.ways.iter_mut().zip(&mut self.farthest).zip(rates);
        for ((way, farthest), rate) in wheels {
            *way += rate * period;
            if way.abs() > farthest.abs() {
                *farthest = *way;
            }
        }
    }

    /// So many periods of SYNC. Where the link has a thread for SYNC, that goes on until the run
    /// ends, so that neither a question to the robot nor a busy computer holds a SYNC up.
    fn syncs(&mut self, count: u32) -> Result<(), MasterError> {
        let paced = self.begin_sync();
        // Periods that passed while a robot was asked are left out; nothing is late because of
        // them.
        if self.next_sync < self.wire.now() {
            self.next_sync = self.next_period();
        }
        for _ in 0..count {
            while let Some((at, frame)) = self.wire.next(self.next_sync)? {
                self.restarted |= at > self.began && boots(self.node, &frame);
                let report = RobotReport::decode(frame.id(), frame.data());
                if let Some((node, RobotReport::WheelRates(report))) = report
                    && node == self.node
                {
                    self.follow(report.rates.into());
                }
            }
            if !paced {
                let sync = client::sync(Some(self.next_counter()));
                self.wire.send(&sync)?;
            }
            self.next_sync = self.next_period();
        }
        Ok(())
    }

    /// Begins with SYNC where that has not happened; whether the link sends it.
    fn begin_sync(&mut self) -> bool {
        if let Some(paced) = self.paced {
            return paced;
        }
        self.next_sync = self.next_period();
        let schedule = Schedule {
            first: self.next_sync,
            period_us: self.period_us,
            counter: self.next_counter(),
            overflow: SYNC_OVERFLOW,
        };
        *self.paced.insert(self.wire.link.pace(Some(schedule)))
    }

    fn next_period(&self) -> Micros {
        Micros((self.wire.now().0 / self.period_us + 1) * self.period_us)
    }

    fn next_counter(&self) -> u8 {
        self.wire.sync_counter() % SYNC_OVERFLOW + 1
    }
}

impl<L: Link> Drop for Run<'_, L> {
    fn drop(&mut self) {
        if self.paced == Some(true) {
            self.wire.link.pace(None);
        }
    }
}
