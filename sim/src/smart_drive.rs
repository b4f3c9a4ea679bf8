//! RoboMaster C620 and C610 drives, and the CAN bus that they share with one robot.
//!
//! # Theory of operation
//!
//! A drive takes a torque current from the command `0x200` and regulates its motor to it. The model
//! gives the motor the voltage that this current needs, `u = R i + K w`, within the supply: with
//! the winding of [`crate::motor`] the current then follows within `L / R`, and what is left of a
//! current at high speed is what the supply leaves. Every millisecond of its own clock the drive
//! reports the rotor's angle, rate, current and temperature as `0x200` plus its identifier.
//!
//! Source of the frames: "RoboMaster C610 Brushless DC Motor Speed Controller User Guide" v1.0;
//! they are built here by that table, not by the robot's code. **Assumed**, because no manual that
//! was found says it: a drive that has had no command for [`TIME_OUT_NS`] gives no current.
//!
//! # Interface
//!
//! [`DriveBus::run`] is called with the robot's CAN2 whenever one of [`DriveBus::next_event_ns`] is
//! due; [`DriveBus::turn`] with what the wheels have done; [`DriveBus::voltages`] says what the
//! motors get.
//!
//! # Limits
//!
//! Two frames of one identifier that begin together do not collide here: one goes first. No errors
//! on this bus. Temperatures are what a test sets.

use canopen::Frame;
use canopen::bits::frame_bits;
use emulator::{CanFrame, CanPort};
use group::StageKind;

use crate::motor::Bridge;

/// How long a drive goes on without a command, ns: an assumption.
pub const TIME_OUT_NS: u64 = 100_000_000;

/// Between reports, ns.
const PERIOD_NS: u64 = 1_000_000;

/// A bit at 1 Mbit/s, ns, and the bits between two frames.
const BIT_NS: u64 = 1_000;
const INTERMISSION: u64 = 3;

/// Identifier of the command, and of the feedback of drive 0, which there is not.
const COMMAND: u16 = 0x200;

/// Counts in a turn of the rotor.
const COUNTS: f64 = 8192.0;

/// Something that happens to one drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriveChange {
    /// Its power is switched on or off.
    Power(bool),
    /// It is given another identifier.
    Identifier(u8),
    /// Its motor has this temperature, degrees Celsius.
    Temperature(u8),
}

/// The robot's end of the drives' bus: its second CAN controller.
pub trait Connector {
    /// The frame that it would send.
    fn pending(&self) -> Option<Frame>;

    /// That frame is on the wire.
    fn begin(&mut self) -> Option<Frame>;

    /// A drive's frame went first.
    fn lost_arbitration(&mut self);

    /// Its frame has been sent.
    fn transmitted(&mut self);

    /// A drive's frame has ended, which took so many bits.
    fn receive(&mut self, frame: &Frame, bits: u32);
}

impl Connector for CanPort<'_> {
    fn pending(&self) -> Option<Frame> {
        CanPort::pending(self).and_then(|frame| to_frame(&frame))
    }

    fn begin(&mut self) -> Option<Frame> {
        CanPort::begin(self).and_then(|frame| to_frame(&frame))
    }

    fn lost_arbitration(&mut self) {
        CanPort::lost_arbitration(self);
    }

    fn transmitted(&mut self) {
        CanPort::transmitted(self);
    }

    fn receive(&mut self, frame: &Frame, bits: u32) {
        if let Some(frame) = CanFrame::new(frame.id(), frame.data()) {
            self.receive_stuffed(&frame, bits);
        }
    }
}

/// One drive with its motor's rotor.
#[derive(Debug, Clone)]
struct Drive {
    identifier: u8,
    powered: bool,
    temperature: u8,
    /// Counts that the rotor has turned by.
    counts: i64,
    /// Rate of the rotor, rpm.
    rpm: f64,
    /// Commanded current, A, and when.
    current: f64,
    commanded_ns: u64,
    /// When it next reports, and how far apart its reports are, ns.
    reports_ns: u64,
    period_ns: u64,
}

/// Who sends the frame on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sender {
    Robot,
    Drive(usize),
}

/// A frame on the wire, and when it ends.
#[derive(Debug, Clone)]
struct Transfer {
    sender: Sender,
    frame: Frame,
    end_ns: u64,
}

/// The motor behind a drive: what its current needs.
#[derive(Debug, Clone, Copy)]
struct Winding {
    constant: f64,
    resistance: f64,
    gear: f64,
}

/// Four drives, and the bus between them and their robot.
#[derive(Debug, Clone)]
pub struct DriveBus {
    drives: [Drive; 4],
    winding: Winding,
    /// A for one step of a command.
    step: f64,
    largest: f64,
    transfer: Option<Transfer>,
    /// When the next frame may begin, ns.
    free_ns: u64,
    /// Up to when the wheels have turned, ns.
    turned_ns: u64,
    now_ns: u64,
}

impl DriveBus {
    /// The drives of a robot, if its wheels are turned by such: with the identifiers that
    /// the group file gives them, and power since just now.
    #[must_use]
    pub fn new(robot: &group::Robot, now_ns: u64) -> Option<Self> {
        let largest = f64::from(robot.output.kind.drive_current()?);
        let full_scale = match robot.output.kind {
            StageKind::C610 => 10_000.0,
            _ => 16_384.0,
        };
        let motor = &robot.motor;
        let drive = |place: u8| Drive {
            identifier: robot.output.drive_identifiers[usize::from(place)],
            powered: true,
            temperature: 30,
            counts: 1_000 * i64::from(place),
            rpm: 0.0,
            current: 0.0,
            commanded_ns: now_ns,
            // Clocks of their own, up to 0.2 % apart, and no common beginning.
            reports_ns: now_ns + PERIOD_NS + 170_000 * u64::from(place),
            period_ns: PERIOD_NS - 1_000 + 700 * u64::from(place),
        };
        Some(Self {
            drives: [drive(0), drive(1), drive(2), drive(3)],
            winding: Winding {
                constant: motor.constant.into(),
                resistance: motor.resistance.into(),
                gear: robot.encoder.gear_ratio.into(),
            },
            step: largest / full_scale,
            largest,
            transfer: None,
            free_ns: now_ns,
            turned_ns: now_ns,
            now_ns,
        })
    }

    /// The wheels have turned by these counts of their rotors up to a time, and turn at these
    /// rates, rad/s.
    pub fn turn(&mut self, counts: [i32; 4], rates: [f64; 4], now_ns: u64) {
        self.turned_ns = now_ns;
        for ((drive, counts), rate) in self.drives.iter_mut().zip(counts).zip(rates) {
            drive.counts += i64::from(counts);
            drive.rpm = rate * self.winding.gear * 60.0 / std::f64::consts::TAU;
        }
    }

    /// Something happens to the drive of a wheel.
    pub fn change(&mut self, wheel: usize, change: DriveChange) {
        let now_ns = self.now_ns;
        let Some(drive) = self.drives.get_mut(wheel) else {
            return;
        };
        match change {
            DriveChange::Power(on) => {
                drive.powered = on;
                drive.current = 0.0;
                drive.reports_ns = now_ns + PERIOD_NS;
            }
            DriveChange::Identifier(identifier) => drive.identifier = identifier,
            DriveChange::Temperature(temperature) => drive.temperature = temperature,
        }
    }

    /// The voltages over the supply, V, that the motors get at these rates, rad/s; `None` where
    /// there is no current or no supply: then it does not matter what the motor is connected to.
    #[must_use]
    pub fn voltages(&self, rates: [f64; 4], supply: f64) -> [Option<f64>; 4] {
        let Winding {
            constant,
            resistance,
            ..
        } = self.winding;
        let currents = self.currents();
        std::array::from_fn(|wheel| {
            let voltage = resistance * currents[wheel] + constant * rates[wheel];
            let share = (voltage / supply).clamp(-1.0, 1.0);
            (currents[wheel] != 0.0 && supply > 0.0).then_some(share)
        })
    }

    /// The same as bridges that put these voltages on the motors.
    #[must_use]
    pub fn bridges(&self, rates: [f64; 4], supply: f64, brake_released: bool) -> [Bridge; 4] {
        self.voltages(rates, supply).map(|voltage| Bridge {
            duty: voltage.unwrap_or(0.0),
            enabled: voltage.is_some(),
            brake_released,
        })
    }

    /// The currents that the drives regulate to, A.
    #[must_use]
    pub fn currents(&self) -> [f64; 4] {
        self.drives.each_ref().map(|d| d.current_at(self.now_ns))
    }

    /// When something next happens by itself, ns.
    #[must_use]
    pub fn next_event_ns(&self) -> u64 {
        if let Some(transfer) = &self.transfer {
            return transfer.end_ns;
        }
        let reports = self.drives.iter().filter(|drive| drive.powered);
        let due = reports.map(|drive| drive.reports_ns).min();
        due.unwrap_or(u64::MAX).max(self.free_ns)
    }

    /// The bus at a time, which is not past the next event, with the robot's connector.
    pub fn run(&mut self, now_ns: u64, port: &mut impl Connector) {
        self.now_ns = now_ns;
        if let Some(transfer) = self.transfer.take_if(|transfer| transfer.end_ns <= now_ns) {
            self.deliver(&transfer, port);
            self.free_ns = now_ns + INTERMISSION * BIT_NS;
        }
        if self.transfer.is_some() || now_ns < self.free_ns {
            return;
        }
        let robot = port.pending().map(|frame| (frame.id(), Sender::Robot));
        let ready = self.drives.iter().enumerate();
        let ready = ready.filter(|(_, drive)| drive.powered && drive.reports_ns <= now_ns);
        let drives = ready.map(|(place, drive)| (drive.report_id(), Sender::Drive(place)));
        let Some((_, sender)) = drives.chain(robot).min_by_key(|(id, _)| *id) else {
            return;
        };
        if sender != Sender::Robot && robot.is_some() {
            port.lost_arbitration();
        }
        let frame = match sender {
            Sender::Robot => port.begin(),
            Sender::Drive(place) => {
                let turned_ns = self.turned_ns;
                let drive = &mut self.drives[place];
                drive.reports_ns += drive.period_ns;
                let report = drive.report(now_ns, turned_ns, self.step);
                Frame::new(drive.report_id(), &report)
            }
        };
        self.transfer = frame.map(|frame| Transfer {
            sender,
            end_ns: now_ns + u64::from(frame_bits(&frame)) * BIT_NS,
            frame,
        });
    }

    fn deliver(&mut self, transfer: &Transfer, port: &mut impl Connector) {
        match transfer.sender {
            Sender::Robot => {
                port.transmitted();
                if transfer.frame.id() == COMMAND {
                    self.command(transfer.frame.data());
                }
            }
            Sender::Drive(_) => {
                port.receive(&transfer.frame, frame_bits(&transfer.frame));
            }
        }
    }

    /// A command: two bytes for each of the drives 1 to 4, the high one first.
    fn command(&mut self, data: &[u8]) {
        for drive in self.drives.iter_mut().filter(|drive| drive.powered) {
            let place = 2 * usize::from(drive.identifier.wrapping_sub(1));
            if let Some([high, low]) = data.get(place..).and_then(<[u8]>::first_chunk) {
                let number = i16::from_be_bytes([*high, *low]);
                let current = f64::from(number) * self.step;
                drive.current = current.clamp(-self.largest, self.largest);
                drive.commanded_ns = self.now_ns;
            }
        }
    }
}

impl Drive {
    fn report_id(&self) -> u16 {
        COMMAND + u16::from(self.identifier)
    }

    fn current_at(&self, now_ns: u64) -> f64 {
        if now_ns - self.commanded_ns < TIME_OUT_NS {
            self.current
        } else {
            0.0
        }
    }

    /// What it reports at a time, from where the wheel stood at another.
    fn report(&self, now_ns: u64, turned_ns: u64, step: f64) -> [u8; 8] {
        let since = (now_ns as f64 - turned_ns as f64) * 1e-9;
        let moved = self.rpm / 60.0 * COUNTS * since;
        let counts = self.counts + moved.round() as i64;
        let angle = counts.rem_euclid(COUNTS as i64) as u16;
        let rpm = self.rpm.round() as i16;
        let current = (self.current_at(now_ns) / step).round() as i16;
        let [a, b] = angle.to_be_bytes();
        let [c, d] = rpm.to_be_bytes();
        let [e, f] = current.to_be_bytes();
        [a, b, c, d, e, f, self.temperature, 0]
    }
}

fn to_frame(frame: &CanFrame) -> Option<Frame> {
    Frame::new(frame.standard_id()?, frame.data())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::Motors;

    fn robot() -> group::Robot {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/c620.toml");
        let mut file = group::GroupFile::load(path).unwrap();
        file.robots.remove(0)
    }

    /// Wheel 1 gets a current, A, for so many seconds, in steps of 100 us; returns its rate, rad/s.
    fn rate_after(bus: &mut DriveBus, motors: &mut Motors, current: f64, seconds: f64) -> f64 {
        let number = (current / 20.0 * 16_384.0).round() as i16;
        for step in 0..(seconds * 1e4).round() as u64 {
            if step.is_multiple_of(10) {
                let [a, b] = number.to_be_bytes();
                bus.command(&[a, b, 0, 0, 0, 0, 0, 0]);
            }
            bus.now_ns += 100_000;
            let [share, ..] = bus.voltages(motors.rates(), motors.supply());
            let bridge = Bridge {
                duty: share.unwrap_or(0.0),
                enabled: share.is_some(),
                brake_released: true,
            };
            motors.run(&[bridge; 4], 1, 1e-4);
        }
        motors.rates()[0]
    }

    /// `J w' = K i`: 5 A x 0.3 N m/A on 0.035 kg m2 are 42.9 rad/s2. Friction and winding left out.
    #[test]
    fn a_constant_current_is_a_constant_acceleration() {
        let mut robot = robot();
        robot.motor.friction = 0.0;
        robot.motor.viscous = 0.0;
        robot.motor.inductance = 0.0;
        let mut bus = DriveBus::new(&robot, 0).unwrap();
        let mut motors = Motors::new(&robot.motor);
        let rate = rate_after(&mut bus, &mut motors, 5.0, 0.4);
        let expected = 0.3 * 5.0 / 0.035 * 0.4;
        assert!((rate / expected - 1.0).abs() < 1e-3, "{rate} {expected}");
        // Whatever the supply is, if it suffices.
        motors.set_supply(17.0);
        let faster = rate_after(&mut bus, &mut motors, 5.0, 0.4);
        assert!(
            (faster / expected - 2.0).abs() < 2e-3,
            "{faster} {expected}"
        );
        motors.set_supply(24.0);
        // The supply ends it: at 24 V / 0.3 V s/rad nothing is left for a current.
        let rate = rate_after(&mut bus, &mut motors, 5.0, 4.0);
        assert!((rate - 80.0).abs() < 0.1, "{rate}");
    }

    #[test]
    fn a_drive_takes_its_own_place_in_a_command_and_keeps_within_its_range() {
        let mut bus = DriveBus::new(&robot(), 0).unwrap();
        bus.change(1, DriveChange::Identifier(4));
        bus.change(3, DriveChange::Identifier(2));
        bus.command(&[0x20, 0, 0xE0, 0, 0x7F, 0xFF, 0, 0]);
        assert_eq!(bus.currents(), [10.0, 0.0, 20.0, -10.0]);
        bus.now_ns += TIME_OUT_NS - 1;
        assert_eq!(bus.currents()[0], 10.0);
        bus.now_ns += 1;
        assert_eq!(bus.currents(), [0.0; 4], "nobody has commanded anything");
        bus.command(&[0x20; 8]);
        bus.change(0, DriveChange::Power(false));
        assert_eq!(bus.voltages([1.0; 4], 24.0)[0], None);
    }

    /// A turn is 8192, modulo; at 600 rpm, 81.92 counts in a millisecond more than it was turned
    /// by.
    #[test]
    fn a_report_has_the_rotors_angle_at_its_own_time() {
        let mut bus = DriveBus::new(&robot(), 0).unwrap();
        let gear = f64::from(robot().encoder.gear_ratio);
        bus.turn(
            [-1, 0, 0, 0],
            [std::f64::consts::TAU * 10.0 / gear; 4],
            5_000_000,
        );
        let report = |bus: &DriveBus, at| bus.drives[0].report(at, bus.turned_ns, bus.step);
        assert_eq!(
            report(&bus, 5_000_000),
            [0x1F, 0xFF, 0x02, 0x58, 0, 0, 30, 0]
        );
        assert_eq!(report(&bus, 6_000_000)[..2], 81_u16.to_be_bytes());
    }
}
