//! Faults as actions on a world.

use std::fmt;

use crate::bus::disturb::Share;
use crate::motor::{BRAKE_TORQUE, Brake};
use crate::world::{Cable, EncoderState, World};

/// Names of the wheels in the usual order.
pub(super) const WHEELS: [&str; 4] = ["front-left", "front-right", "rear-left", "rear-right"];
/// How long a power cycle leaves the robot without power, unless it says so.
const POWER_CYCLE_NS: u64 = 100_000_000;

/// A robot, as the world and as people call it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Its place in the group file.
    pub robot: usize,
    /// Its node.
    pub node: u8,
}

/// A change to a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RobotAction {
    /// Power off for 100 ms, then on again.
    PowerCycle,
    /// Power on or off.
    Power(bool),
    /// Emergency stop pressed or released.
    EmergencyStop(bool),
    /// The motor driver's fault line.
    DriverFault(bool),
    /// The contact of the protective stop: open or closed.
    ProtectiveStop(bool),
    /// CAN connector pulled or plugged.
    BusCut(bool),
    /// The cable before the robot is broken.
    BusParts(bool),
    /// The USB cable pulled or plugged.
    Cable(Cable),
    /// The next frame fails until the controller is off the bus.
    BusOff,
    /// More frames at once than the controller holds.
    Overrun,
    /// The processor halts or resumes.
    Halt(bool),
    /// The processor goes where there is no memory.
    Crash,
    /// The output of a wheel's encoder.
    Encoder(usize, EncoderState),
    /// Noise strikes the wires of a wheel's encoder, times a second.
    EncoderNoise(usize, f64),
    /// The rising edges of a wheel's encoder are slow: R times C, s.
    EncoderSlowEdges(usize, f64),
    /// Something drags at a wheel, N·m.
    WheelDrag(usize, f64),
    /// Something turns a wheel with this torque, N·m.
    WheelPush(usize, f64),
    /// The holding brakes hold so much, N·m.
    BrakeTorque(f64),
    /// The holding brakes release with this delay, s.
    BrakeRelease(f64),
    /// The holding brakes hold so much later, s.
    BrakeEngage(f64),
    /// The driver trips at this current of a motor, A.
    DriverTrip(Option<f64>),
    /// The supply has so many volts.
    Supply(f64),
    /// The supply takes no charge, with this capacitance beside it, F.
    NoRegeneration(Option<f64>),
    /// Frames with this identifier do not reach the robot.
    Misses(Option<u16>),
    /// Its receiver gets frames wrong.
    BadReceiver(Share),
    /// Its controller sends frames with this identifier all the time.
    Babble(Option<u16>),
    /// What it sends is late, ns.
    Delay(u64),
}

/// A change to the bus.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BusAction {
    /// One bit of a frame is inverted.
    Corrupt(Share),
    /// The acknowledge does not reach the sender.
    LostAcknowledge(Share),
    /// A node that is none of ours sends frames with this identifier all the time.
    Babble(Option<u16>),
    /// What the programs outside send, the master among them, is late, ns.
    Delay(u64),
}

/// Something that goes wrong, or right again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// With a robot.
    Robot(Place, RobotAction),
    /// With the bus.
    Bus(BusAction),
}

impl Action {
    /// Does it; `false` when it has to be tried again a little later.
    pub(super) fn apply(self, world: &mut World) -> bool {
        match self {
            Self::Robot(place, action) => action.apply(world, place.robot),
            Self::Bus(action) => {
                action.apply(world);
                true
            }
        }
    }

    /// The opposite, where there is one.
    pub(super) fn undone(self) -> Option<Self> {
        match self {
            Self::Robot(place, action) => Some(Self::Robot(place, action.undone()?)),
            Self::Bus(action) => Some(Self::Bus(action.undone())),
        }
    }

    /// How long it lasts by itself.
    pub(super) fn lasts_ns(self) -> Option<u64> {
        matches!(self, Self::Robot(_, RobotAction::PowerCycle)).then_some(POWER_CYCLE_NS)
    }
}

impl RobotAction {
    fn apply(self, world: &mut World, robot: usize) -> bool {
        match self {
            Self::PowerCycle => world.set_power(robot, false),
            Self::Power(on) => world.set_power(robot, on),
            Self::EmergencyStop(pressed) => world.set_emergency_stop(robot, pressed),
            Self::DriverFault(fault) => world.set_driver_fault(robot, fault),
            Self::ProtectiveStop(open) => world.set_protective_stop(robot, open),
            Self::BusCut(cut) => world.set_connected(robot, !cut),
            Self::BusParts(parts) => world.set_partition(parts.then_some(robot)),
            Self::Cable(cable) => world.set_cable(robot, cable),
            // A robot without power has nothing to send, ever.
            Self::BusOff => return !world.is_powered(robot) || world.force_bus_off(robot),
            Self::Overrun => world.overrun(robot),
            Self::Halt(halted) => _ = world.halt(robot, halted),
            Self::Crash => _ = world.crash(robot, crate::Crash::Nowhere),
            Self::Encoder(wheel, state) => world.set_encoder(robot, wheel, state),
            Self::EncoderNoise(wheel, hz) => world.set_encoder_noise(robot, wheel, hz),
            Self::EncoderSlowEdges(wheel, rc) => world.set_encoder_slow_edges(robot, wheel, rc),
            Self::WheelDrag(wheel, torque) => world.set_wheel_drag(robot, wheel, torque),
            Self::WheelPush(wheel, torque) => world.set_wheel_push(robot, wheel, torque),
            Self::BrakeTorque(torque) => {
                let brake = world.brake(robot);
                world.set_brake(robot, Brake { torque, ..brake });
            }
            Self::BrakeRelease(release) => {
                let brake = world.brake(robot);
                world.set_brake(robot, Brake { release, ..brake });
            }
            Self::BrakeEngage(engage) => {
                let brake = world.brake(robot);
                world.set_brake(robot, Brake { engage, ..brake });
            }
            Self::DriverTrip(amperes) => world.set_driver_trip(robot, amperes),
            Self::Supply(volts) => world.set_supply(robot, volts),
            Self::NoRegeneration(farad) => world.block_charge(robot, farad),
            Self::Misses(id) => world.set_misses(robot, id),
            Self::BadReceiver(share) => world.set_bad_receiver(robot, share),
            Self::Babble(id) => world.set_babbling(robot, id),
            Self::Delay(ns) => world.set_delay(robot, ns),
        }
        true
    }

    fn undone(self) -> Option<Self> {
        Some(match self {
            Self::PowerCycle => Self::Power(true),
            Self::Power(on) => Self::Power(!on),
            Self::EmergencyStop(pressed) => Self::EmergencyStop(!pressed),
            Self::DriverFault(fault) => Self::DriverFault(!fault),
            Self::ProtectiveStop(open) => Self::ProtectiveStop(!open),
            Self::BusCut(cut) => Self::BusCut(!cut),
            Self::BusParts(parts) => Self::BusParts(!parts),
            Self::Cable(Cable::Plugged) => Self::Cable(Cable::Low),
            Self::Cable(Cable::Low | Cable::Open) => Self::Cable(Cable::Plugged),
            Self::Halt(halted) => Self::Halt(!halted),
            Self::Encoder(wheel, _) => Self::Encoder(wheel, EncoderState::Works),
            Self::EncoderNoise(wheel, _) => Self::EncoderNoise(wheel, 0.0),
            Self::EncoderSlowEdges(wheel, _) => Self::EncoderSlowEdges(wheel, 0.0),
            Self::WheelDrag(wheel, _) => Self::WheelDrag(wheel, 0.0),
            Self::WheelPush(wheel, _) => Self::WheelPush(wheel, 0.0),
            Self::BrakeTorque(_) => Self::BrakeTorque(BRAKE_TORQUE),
            Self::BrakeRelease(_) => Self::BrakeRelease(0.0),
            Self::BrakeEngage(_) => Self::BrakeEngage(0.0),
            Self::DriverTrip(_) => Self::DriverTrip(None),
            Self::NoRegeneration(_) => Self::NoRegeneration(None),
            Self::Misses(_) => Self::Misses(None),
            Self::BadReceiver(_) => Self::BadReceiver(Share::NONE),
            Self::Babble(_) => Self::Babble(None),
            Self::Delay(_) => Self::Delay(0),
            Self::BusOff | Self::Overrun | Self::Crash | Self::Supply(_) => return None,
        })
    }
}

impl BusAction {
    fn apply(self, world: &mut World) {
        match self {
            Self::Corrupt(share) => world.set_corruption(share),
            Self::LostAcknowledge(share) => world.set_lost_acknowledge(share),
            Self::Babble(id) => world.set_babbler(id),
            Self::Delay(ns) => world.set_port_delay(ns),
        }
    }

    fn undone(self) -> Self {
        match self {
            Self::Corrupt(_) => Self::Corrupt(Share::NONE),
            Self::LostAcknowledge(_) => Self::LostAcknowledge(Share::NONE),
            Self::Babble(_) => Self::Babble(None),
            Self::Delay(_) => Self::Delay(0),
        }
    }
}

impl fmt::Display for BusAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Corrupt(share) => share_of(f, "corrupt", *share),
            Self::LostAcknowledge(share) => share_of(f, "lost-acknowledge", *share),
            Self::Babble(id) => babble(f, *id),
            Self::Delay(ns) => delay(f, *ns),
        }
    }
}

fn share_of(f: &mut fmt::Formatter<'_>, name: &str, share: Share) -> fmt::Result {
    match share {
        Share { of: 0.0, .. } => write!(f, "{name}=off"),
        Share { of, id: None } => write!(f, "{name}={of}"),
        Share { of, id: Some(id) } => write!(f, "{name}={of}:id=0x{id:03X}"),
    }
}

fn babble(f: &mut fmt::Formatter<'_>, id: Option<u16>) -> fmt::Result {
    match id {
        Some(id) => write!(f, "babble=0x{id:03X}"),
        None => f.write_str("babble=off"),
    }
}

fn delay(f: &mut fmt::Formatter<'_>, ns: u64) -> fmt::Result {
    match ns {
        0 => f.write_str("delay=off"),
        _ => write!(f, "delay={}", ns as f64 / 1e9),
    }
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Robot(place, action) => write!(f, "node {}: {action}", place.node),
            Self::Bus(action @ BusAction::Delay(_)) => write!(f, "node 1: {action}"),
            Self::Bus(action) => write!(f, "bus: {action}"),
        }
    }
}

impl fmt::Display for RobotAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let on = |on: &bool| if *on { "" } else { "=off" };
        let wheel = |wheel: &usize| WHEELS.get(*wheel).copied().unwrap_or("no wheel");
        match self {
            Self::PowerCycle => f.write_str("power-cycle"),
            Self::Power(true) => f.write_str("power-on"),
            Self::Power(false) => f.write_str("power-off"),
            Self::EmergencyStop(pressed) => write!(f, "emergency-stop{}", on(pressed)),
            Self::DriverFault(fault) => write!(f, "driver-fault{}", on(fault)),
            Self::ProtectiveStop(open) => write!(f, "protective-stop{}", on(open)),
            Self::BusCut(cut) => write!(f, "bus-cut{}", on(cut)),
            Self::BusParts(parts) => write!(f, "bus-parts{}", on(parts)),
            Self::Cable(Cable::Plugged) => f.write_str("cable-cut=off"),
            Self::Cable(Cable::Low) => f.write_str("cable-cut"),
            Self::Cable(Cable::Open) => f.write_str("cable-cut=open"),
            Self::BusOff => f.write_str("bus-off"),
            Self::Overrun => f.write_str("overrun"),
            Self::Halt(halted) => write!(f, "halt{}", on(halted)),
            Self::Crash => f.write_str("crash"),
            Self::Encoder(n, EncoderState::Works) => write!(f, "encoder-works:wheel={}", wheel(n)),
            Self::Encoder(n, EncoderState::Dead) => write!(f, "encoder-dead:wheel={}", wheel(n)),
            Self::Encoder(n, EncoderState::OneChannel) => {
                write!(f, "encoder-one-channel:wheel={}", wheel(n))
            }
            Self::Encoder(n, EncoderState::Reversed) => {
                write!(f, "encoder-reversed:wheel={}", wheel(n))
            }
            Self::Encoder(n, EncoderState::Floats) => {
                write!(f, "encoder-floats:wheel={}", wheel(n))
            }
            Self::EncoderNoise(n, hz) => write!(f, "encoder-noise={hz}:wheel={}", wheel(n)),
            Self::EncoderSlowEdges(n, rc) => {
                write!(f, "encoder-slow-edges={}:wheel={}", rc * 1e6, wheel(n))
            }
            Self::WheelDrag(n, torque) => write!(f, "wheel-drag={torque}:wheel={}", wheel(n)),
            Self::WheelPush(n, torque) => write!(f, "wheel-push={torque}:wheel={}", wheel(n)),
            Self::BrakeTorque(torque) => write!(f, "brake-torque={torque}"),
            Self::BrakeRelease(s) => write!(f, "brake-release={}", s * 1e3),
            Self::BrakeEngage(s) => write!(f, "brake-engage={}", s * 1e3),
            Self::DriverTrip(Some(amperes)) => write!(f, "driver-trip={amperes}"),
            Self::DriverTrip(None) => f.write_str("driver-trip=off"),
            Self::Supply(volts) => write!(f, "supply={volts}"),
            Self::NoRegeneration(Some(farad)) => write!(f, "no-regeneration={}", farad * 1e6),
            Self::NoRegeneration(None) => f.write_str("no-regeneration=off"),
            Self::Misses(Some(id)) => write!(f, "misses=0x{id:03X}"),
            Self::Misses(None) => f.write_str("misses=off"),
            Self::BadReceiver(share) => share_of(f, "corrupt", *share),
            Self::Babble(id) => babble(f, *id),
            Self::Delay(ns) => delay(f, *ns),
        }
    }
}
