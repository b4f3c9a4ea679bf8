//! The configuration of the control side: all parameters, checked as a whole and converted.
//!
//! It holds the drivetrain, signed angles per count, and limits as reciprocals. Using it cannot
//! fail; `robot` builds it from parameters and refuses invalid ones.

use kinematics::Mount;

use crate::brake::BrakeTimes;
use crate::current::CurrentConfiguration;
use crate::drivetrain::Drivetrain;
use crate::limiter::ChangeLimits;
use crate::output_stage::OutputStage;
use crate::quantity::Rate;
use crate::smart_drive::DriveConfiguration;
use crate::supply::SupplyConfiguration;
use crate::wheel::Gains;
use crate::wheel_drive::MotorLimits;

/// One wheel: encoder, motor, loop.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct WheelConfiguration {
    /// rad for one count up; negative where the encoder is reversed.
    pub step: f32,
    /// Factor of the duty: 1, or -1 where the motor is reversed.
    pub motor_sign: f32,
    /// Feedforward and gains.
    pub gains: Gains,
    /// Largest voltage beyond the back EMF, V: largest current times winding resistance.
    pub torque: f32,
}

/// Times, all in microseconds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Times {
    /// Period of SYNC.
    pub sync_period_us: u32,
    /// From SYNC, without its jitter, to the effect of the setpoint latched there.
    pub agreement_delay_us: u32,
    /// Longest time without SYNC.
    pub sync_timeout_us: u64,
    /// Longest time without a fresh setpoint.
    pub setpoint_timeout_us: u64,
    /// Longest time without the master's heartbeat.
    pub heartbeat_timeout_us: u64,
    /// How long a wheel may be suspected before it is a fault.
    pub wheel_fault_us: u64,
}

impl Times {
    /// How long after a SYNC the next one is overdue: a quarter of a period more than one.
    #[must_use]
    pub const fn silence_us(&self) -> u64 {
        self.sync_period_us as u64 * 5 / 4
    }

    /// How long slip or strain must last before it is a fault: one and a half times as long as the
    /// wheel watch needs to name the wheel that causes it, and at least 300 ms, which does not
    /// occur without a fault.
    #[must_use]
    pub const fn consequence_us(&self) -> u64 {
        let after_watch = self.wheel_fault_us * 3 / 2;
        if after_watch > 300_000 {
            after_watch
        } else {
            300_000
        }
    }
}

/// Thresholds; 0 turns one off.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Thresholds {
    /// rad/s.
    pub slip_limit: Rate,
    /// rad/s.
    pub slip_fault: Rate,
    /// m/s.
    pub strain_limit: Rate,
    /// m/s.
    pub strain_fault: Rate,
    /// rad/s.
    pub blocked_rate: Rate,
}

/// A complete and consistent configuration.
#[derive(Clone, Copy, Debug)]
pub struct Configuration {
    /// CRC over the parameters it was built from; never 0.
    pub crc: u32,
    /// Another checksum over them, of which the CRC says nothing.
    pub check: u32,
    /// Group this robot belongs to.
    pub group: u8,
    /// Bit n stands for node n.
    pub members: u32,
    /// SYNCs near standstill after a start, before anything moves.
    pub standstill_syncs: u8,
    /// A protective stop is connected.
    pub protective_stop: bool,
    /// An emergency stop of one member cuts all.
    pub cuts_together: bool,
    /// Group twist to wheel rates and back.
    pub drivetrain: Drivetrain,
    /// Filter of the encoder channels, for the board: ICxF of the timers.
    pub encoder_filter: u8,
    /// Pose of this robot in the group.
    pub mount: Mount,
    /// Fastest wheel rate, rad/s.
    pub wheel_rate_max: f32,
    /// Largest speed of the group frame's origin, m/s; infinite where only wheels limit it.
    pub speed_max: f32,
    /// Largest yaw rate of the group, rad/s; infinite where only wheels limit it.
    pub yaw_rate_max: f32,
    /// Limits while following.
    pub follow: ChangeLimits,
    /// Limits of the ramp to standstill.
    pub ramp: ChangeLimits,
    /// Front left, front right, rear left, rear right.
    pub wheels: [WheelConfiguration; 4],
    /// rad/s.
    pub observer_bandwidth: f32,
    /// Supply of the bridges.
    pub supply: SupplyConfiguration,
    /// Sensors of the motors' current; `None` where there are none.
    pub current: Option<CurrentConfiguration>,
    /// Frequency of the PWM, for the board, Hz.
    pub pwm_hz: u32,
    /// Kind of the wheels' drives, for the board.
    pub output_stage: OutputStage,
    /// A bridge gets no duty for a tick before it changes its direction.
    pub direction_pause: bool,
    /// Times of the holding brake.
    pub brake: BrakeTimes,
    /// Thresholds for slip, strain and a blocked wheel.
    pub thresholds: Thresholds,
    /// Timeouts.
    pub times: Times,
    /// Smart drives, for the board.
    pub drives: DriveConfiguration,
    /// What current drives need to know of the motors.
    pub motors: MotorLimits,
}

/// Equal are those of the same parameters, by 64 bits over them, and of the same members, which a
/// robot that is alone for now replaces. Everything else follows from these. Comparing all of it
/// takes 1.8 KB.
impl PartialEq for Configuration {
    fn eq(&self, other: &Self) -> bool {
        self.crc == other.crc && self.check == other.check && self.members == other.members
    }
}

impl Configuration {
    /// Whether `node` is one of the group.
    #[must_use]
    pub const fn is_member(&self, node: u8) -> bool {
        node < 32 && self.members >> node & 1 == 1
    }
}
