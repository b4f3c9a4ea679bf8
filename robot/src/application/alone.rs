//! One robot moved alone, for tests with a person near it: the permission (object 0x2050:1), the
//! declaration by which a member of a group counts as its only one for a while (0x2050:2), and the
//! commissioning twist (0x2101), whose speed is limited here.

use canopen::{AbortCode, NmtState};
use control::configuration::Configuration;
use control::time::Micros;
use kinematics::Twist;
use protocol::Limit;
use protocol::address::{HEARTBEAT_TIMEOUT, MEMBERS};

use super::agree::{permitted, slower};
use super::{Application, Received};
use crate::interlock::Interlock;
use crate::rhythm::Beat;
use crate::sequence::{Reception, Setpoints};
use crate::state::{self, State};

/// How long a permission to move alone lasts, us. An identification ends within 20 s by itself.
const PERMISSION_US: u64 = 60_000_000;

/// Fastest commissioning twist, m/s: the reduced speed of ISO 10218-1, 250 mm/s.
const SPEED: f32 = 0.25;
/// The same about the vertical axis, rad/s: a corner half a metre from the centre then has that
/// speed.
const YAW_RATE: f32 = 0.5;

/// What a robot that is moved alone knows about that.
#[derive(Clone)]
pub(super) struct Alone {
    /// It may, object 0x2050:1.
    pub is_permitted: bool,
    /// Until when.
    permitted_until: Micros,
    /// It is its own only member, whatever 0x2040:2 says: object 0x2050:2.
    pub for_now: bool,
    /// It has been started as that.
    pub started_so: bool,
    /// The commissioning twist as the bus writes it.
    pub twist: Received,
    pub setpoints: Setpoints,
    /// Keeps it at rest after a start, as the group's keeps the group.
    pub interlock: Interlock,
}

impl Alone {
    pub const fn new() -> Self {
        Self {
            is_permitted: false,
            permitted_until: Micros::ZERO,
            for_now: false,
            started_so: false,
            twist: Received {
                bytes: [0; 8],
                is_fresh: false,
            },
            setpoints: Setpoints::new(),
            interlock: Interlock::new(u8::MAX),
        }
    }
}

impl Application {
    /// A write of 0x2050:1, the permission to move alone. It ends by itself: a client that needs it
    /// longer gives it again.
    pub(super) fn permit_alone(&mut self, wanted: bool) -> Result<(), AbortCode> {
        let itself = 1 << self.identity.node.get();
        let alone = self.alone.for_now || self.parameters.unsigned(MEMBERS) == itself;
        if wanted && !alone {
            return Err(AbortCode::ParameterIncompatible);
        }
        if wanted {
            self.alone.is_permitted = true;
            self.alone.permitted_until = self.now() + Micros(PERMISSION_US);
        } else {
            self.end_permission(self.now());
        }
        Ok(())
    }

    /// A write of 0x2050:2.
    pub(super) fn declare_alone(&mut self, wanted: bool, nmt: NmtState) -> Result<(), AbortCode> {
        // A started robot has told the others what it is a part of.
        if nmt == NmtState::Operational {
            return Err(AbortCode::DeviceState);
        }
        self.alone.for_now = wanted;
        if wanted {
            self.last_heartbeat = self.now();
        }
        Ok(())
    }

    /// Ends the permission, and the declaration, that were not renewed.
    #[inline(always)]
    pub(super) fn expire_alone(&mut self, now: Micros) {
        if self.alone.for_now {
            self.expire_declaration(now);
        }
        if self.alone.is_permitted && now >= self.alone.permitted_until {
            self.end_permission(now);
        }
    }

    /// The permission was not renewed, or taken back.
    #[cold]
    #[inline(never)]
    fn end_permission(&mut self, now: Micros) {
        self.alone.is_permitted = false;
        if self.identification.is_running {
            self.end_identification(now);
        } else if self.state == State::Alone {
            self.transition(state::Event::Left, now);
        }
    }

    /// Who declared the robot alone has to stay: without a master it is a member again.
    #[cold]
    #[inline(never)]
    fn expire_declaration(&mut self, now: Micros) {
        let timeout_ms = self.parameters.unsigned(HEARTBEAT_TIMEOUT);
        let silent = self.last_heartbeat + Micros(u64::from(timeout_ms) * 1_000);
        self.alone.for_now = now < silent;
    }

    /// The commissioning twist: no other member to agree with, so it takes effect at once, or after
    /// a start at the last of the setpoints near standstill that are asked for then.
    pub(super) fn follow_alone(&mut self, at: Micros, beat: Beat) {
        let received = self.alone.twist.take();
        let permitted_now = self.alone.is_permitted
            && !self.identification.is_running
            && matches!(self.state, State::Armed | State::Alone)
            && self.able_to_move().is_some();
        let only_itself = 1 << self.identity.node.get();
        let configuration = self.configuration.as_ref();
        let alone = |known: &&Configuration| permitted_now && known.members == only_itself;
        let Some(configuration) = configuration.filter(alone) else {
            self.alone.interlock.disagree();
            return;
        };
        let setpoints = &mut self.alone.setpoints;
        let reception = setpoints.on_sync(at, beat, received.as_ref(), configuration.group);
        let (Reception::Fresh, Some(latched)) = (reception, setpoints.latched()) else {
            self.alone.interlock.disagree();
            return;
        };
        if self.state == State::Armed && !self.alone.interlock.begins_with(latched.twist) {
            self.waits = self.waits.or(Some(Limit::AwaitingStandstill));
            return;
        }
        let twist = configuration.mount.to_group(slowly(latched.twist));
        self.scale = permitted(configuration, twist);
        self.scale_is_own = true;
        self.own_limit = Limit::WheelRate;
        self.transition(state::Event::OwnSetpoint, at);
        self.aim(at, twist * self.scale.factor(), latched.sequence);
    }
}

/// A twist in the robot's frame, brought down to what is safe beside a person.
fn slowly(twist: Twist) -> Twist {
    twist * slower(twist, SPEED, YAW_RATE).unwrap_or(1.0)
}
