//! The file as TOML has it.
//!
//! Every value is optional where a default or the `[robot]` table can give it, and carries its place in
//! the text so that a rule broken later can still name the line. Unknown keys are refused at every level.
//! Nothing is checked here.

use serde::Deserialize;
use toml::Spanned;

/// A value with its place in the text.
pub type At<T> = Spanned<T>;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    pub name: At<String>,
    pub group_id: At<i64>,
    pub sync_period_ms: Option<At<f64>>,
    #[serde(default)]
    pub limits: Limits,
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
    #[serde(default)]
    pub compensation: Compensation,
    #[serde(default)]
    pub encoder: Encoder,
    #[serde(default)]
    pub motor: Motor,
    #[serde(default)]
    pub control: Control,
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
    #[serde(default)]
    pub compensation: Compensation,
    #[serde(default)]
    pub encoder: Encoder,
    #[serde(default)]
    pub motor: Motor,
    #[serde(default)]
    pub control: Control,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Compensation {
    pub longitudinal: Option<At<f64>>,
    pub lateral: Option<At<f64>>,
    pub yaw: Option<At<f64>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Encoder {
    pub counts_per_revolution: Option<At<f64>>,
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
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Control {
    pub proportional: Option<At<f64>>,
    pub integral: Option<At<f64>>,
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
