//! The file as TOML has it.
//!
//! Every value is optional where a default or the `[robot]` table can give it, and carries its
//! place in the text so that a rule broken later can still name the line. The keys are those of
//! `declaration`, which a test compares; what does not fit it is gone before this is read. Nothing
//! is checked here.

use serde::Deserialize;
use toml::Spanned;

use crate::model::{Board, StageKind};
use crate::simulation::{Driver, EncoderFaultKind, WheelName};

/// A value with its place in the text.
pub type At<T> = Spanned<T>;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    pub name: Option<At<String>>,
    pub group_id: Option<At<i64>>,
    pub sync_period_ms: Option<At<f64>>,
    #[serde(default)]
    pub limits: Limits,
    #[serde(default)]
    pub contact_lag: ContactLag,
    /// `hand_over` until version 0.2.
    #[serde(default, alias = "hand_over")]
    pub roller_transition: RollerTransition,
    pub robot: Option<Defaults>,
    pub robots: Option<At<Vec<At<Entry>>>>,
    pub simulation: Option<Simulation>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    pub linear_speed: Option<At<f64>>,
    pub yaw_rate: Option<At<f64>>,
    pub linear_acceleration: Option<At<f64>>,
    pub yaw_acceleration: Option<At<f64>>,
    pub linear_jerk: Option<At<f64>>,
    pub yaw_jerk: Option<At<f64>>,
    pub command_timeout_ms: Option<At<f64>>,
    pub sync_timeout_ms: Option<At<f64>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactLag {
    pub longitudinal_ms: Option<At<f64>>,
    pub lateral_ms: Option<At<f64>>,
    pub yaw_ms: Option<At<f64>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RollerTransition {
    pub loss_s_per_m: Option<At<f64>>,
}

/// The `[robot]` table: what every robot is unless its own entry says otherwise.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Defaults {
    pub half_track: Option<At<f64>>,
    pub half_wheelbase: Option<At<f64>>,
    pub wheel_radius: Option<At<f64>>,
    pub roller_angle_deg: Option<At<f64>>,
    pub max_wheel_rate: Option<At<f64>>,
    pub board: Option<At<Board>>,
    pub rollers: Option<At<Rollers>>,
    #[serde(default)]
    pub compensation: Compensation,
    pub wheels: Option<Wheels>,
    #[serde(default)]
    pub encoder: Encoder,
    #[serde(default)]
    pub motor: Motor,
    #[serde(default)]
    pub control: Control,
}

/// Wheels that differ.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wheels {
    pub front_left: At<Wheel>,
    pub front_right: At<Wheel>,
    pub rear_left: At<Wheel>,
    pub rear_right: At<Wheel>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wheel {
    pub x: At<f64>,
    pub y: At<f64>,
    pub radius: At<f64>,
    pub roller_angle_deg: At<f64>,
    pub counts_per_revolution: Option<At<f64>>,
}

/// One `[[robots]]` entry. The fields of [`Defaults`] are repeated because TOML readers cannot both
/// flatten a table and refuse unknown keys.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    pub node: Option<At<i64>>,
    pub x: Option<At<f64>>,
    pub y: Option<At<f64>>,
    pub heading_deg: Option<At<f64>>,
    pub half_track: Option<At<f64>>,
    pub half_wheelbase: Option<At<f64>>,
    pub wheel_radius: Option<At<f64>>,
    pub roller_angle_deg: Option<At<f64>>,
    pub max_wheel_rate: Option<At<f64>>,
    pub board: Option<At<Board>>,
    pub rollers: Option<At<Rollers>>,
    #[serde(default)]
    pub compensation: Compensation,
    pub wheels: Option<Wheels>,
    #[serde(default)]
    pub encoder: Encoder,
    #[serde(default)]
    pub motor: Motor,
    #[serde(default)]
    pub control: Control,
}

/// What is known of the rollers; the compensation is what is left with it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rollers {
    pub count: At<i64>,
    pub phases_deg: Option<At<[f64; 4]>>,
    pub index_tolerance: Option<At<i64>>,
    pub longitudinal: Option<At<f64>>,
    pub lateral: Option<At<f64>>,
    pub yaw: Option<At<f64>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Compensation {
    pub longitudinal: Option<At<f64>>,
    pub lateral: Option<At<f64>>,
    pub yaw: Option<At<f64>>,
    pub table: Option<At<CompensationTable>>,
}

/// Rows of achieved speed (m/s, rad/s) and coefficient; oblique ones have two coefficients.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompensationTable {
    pub version: At<i64>,
    #[serde(default)]
    pub longitudinal: Vec<At<[f64; 2]>>,
    #[serde(default)]
    pub lateral: Vec<At<[f64; 2]>>,
    #[serde(default)]
    pub oblique: Vec<At<[f64; 3]>>,
    #[serde(default)]
    pub yaw: Vec<At<[f64; 2]>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Encoder {
    pub counts_per_revolution: Option<At<f64>>,
    pub gear_ratio: Option<At<f64>>,
    pub directions: Option<At<[f64; 4]>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motor {
    pub supply: Option<At<f64>>,
    pub constant: Option<At<f64>>,
    pub resistance: Option<At<f64>>,
    pub inductance: Option<At<f64>>,
    pub inertia: Option<At<f64>>,
    pub friction: Option<At<f64>>,
    pub viscous: Option<At<f64>>,
    pub directions: Option<At<[f64; 4]>>,
    pub largest_current: Option<At<f64>>,
    pub largest_duty: Option<At<f64>>,
    pub brake_release_ms: Option<At<f64>>,
    pub brake_engage_ms: Option<At<f64>>,
    pub direction_pause: Option<At<bool>>,
    pub pwm_frequency: Option<At<f64>>,
    pub output_stage: Option<At<StageKind>>,
    pub drive_identifiers: Option<At<[f64; 4]>>,
    pub enable_wired: Option<At<bool>>,
    pub current_scale: Option<At<f64>>,
    pub current_offset: Option<At<f64>>,
    pub current_inputs: Option<At<f64>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Control {
    pub proportional: Option<At<f64>>,
    pub integral: Option<At<f64>>,
    pub identified: Option<At<bool>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulation {
    pub rigid: Option<At<bool>>,
    pub plant: Option<At<PlantName>>,
    pub tables: Option<At<TablesName>>,
    pub rollers: Option<At<i64>>,
    pub address: Option<At<String>>,
    pub crystal_ppm: Option<At<Vec<At<f64>>>>,
    pub seed: Option<At<i64>>,
    pub backlash_deg: Option<At<f64>>,
    pub driver: Option<At<Driver>>,
    pub friction: Option<At<f64>>,
    pub robot_mass: Option<At<f64>>,
    pub wheel_inertia: Option<At<f64>>,
    pub scattered_rollers: Option<At<bool>>,
    pub battery: Option<At<Battery>>,
    #[serde(default)]
    pub encoder: EncoderNoise,
    #[serde(default)]
    pub encoder_faults: Vec<EncoderFault>,
    #[serde(default)]
    pub pose_noise: PoseNoise,
    #[serde(default)]
    pub gyro: Gyro,
    pub payload: Option<At<Payload>>,
    #[serde(default)]
    pub floor: Vec<At<Patch>>,
}

/// Rows of charge (0 to 1) and volts.
pub type Curve = Vec<At<(f64, f64)>>;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Battery {
    pub resistance: At<f64>,
    pub capacity_ah: Option<At<f64>>,
    pub charge: Option<At<f64>>,
    pub curve: Option<At<Curve>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderNoise {
    pub lost: Option<At<f64>>,
    pub extra_per_s: Option<At<f64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderFault {
    pub node: At<i64>,
    pub wheel: WheelName,
    pub kind: EncoderFaultKind,
    pub at: Option<At<f64>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseNoise {
    pub position_mm: Option<At<f64>>,
    pub heading_mrad: Option<At<f64>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gyro {
    pub rate_hz: Option<At<i64>>,
    pub noise_dps_rthz: Option<At<f64>>,
    pub bias_dps: Option<At<f64>>,
    pub drift_dps_rts: Option<At<f64>>,
    pub delay_ms: Option<At<f64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Payload {
    pub mass: At<f64>,
    pub x: Option<At<f64>>,
    pub y: Option<At<f64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Patch {
    pub x: At<(f64, f64)>,
    pub y: At<(f64, f64)>,
    pub friction: At<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlantName {
    Table,
    Contact,
    External,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TablesName {
    Virtual,
    Physical,
    Ideal,
}
