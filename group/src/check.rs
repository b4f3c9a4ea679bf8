//! From the file to the group: defaults, units, and every rule.
//!
//! Two kinds of default, no others: the `[robot]` table stands in for what a `[[robots]]` entry
//! leaves out, and a few values that describe no hardware (periods, limits of motion, gains,
//! electrical details that only a simulation needs) have a default here, listed in [`default`].
//! Dimensions, encoder and the motor's main data have none: guessing them moves a real robot
//! wrongly.

use std::path::Path;

use crate::error::{GroupError, Source};
use crate::model::{ContactLag, FIRST_NODE, GroupFile, LAST_NODE, Limits, Robot};
use crate::schema::{self, At};

/// What a file may leave out.
pub mod default {
    pub const SYNC_PERIOD_MS: f64 = 10.0;
    pub const LINEAR_SPEED: f64 = 2.0;
    pub const YAW_RATE: f64 = 1.0;
    pub const LINEAR_ACCELERATION: f64 = 2.4;
    pub const YAW_ACCELERATION: f64 = 2.0;
    pub const LINEAR_JERK: f64 = 100.0;
    pub const YAW_JERK: f64 = 80.0;
    pub const COMMAND_TIMEOUT_MS: f64 = 100.0;
    pub const ROLLERS: u8 = 8;
    pub const INDUCTANCE: f64 = 0.0;
    pub const FRICTION: f64 = 0.0;
    pub const VISCOUS: f64 = 0.0;
    pub const PROPORTIONAL: f64 = 0.04;
    pub const INTEGRAL: f64 = 0.4;
}

impl GroupFile {
    /// The largest [`hand_over_loss`](Self::hand_over_loss) that a file may have, s/m: a robot that
    /// loses a fortieth of its speed at half a metre a second by nothing but jolts would be shaken
    /// to pieces.
    pub const LARGEST_HAND_OVER_LOSS: f32 = 0.05;

    /// Reads and checks a file.
    ///
    /// # Errors
    /// The first rule that the file breaks, with its line and the remedy.
    pub fn load(path: impl AsRef<Path>) -> Result<GroupFile, GroupError> {
        let path = path.as_ref();
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|e| GroupError {
            file: file.clone(),
            line: None,
            field: String::new(),
            problem: format!("cannot be read ({e})"),
            remedy: "give the path of a group file".to_owned(),
        })?;
        GroupFile::parse(&file, &text)
    }

    /// Checks a text that came from `file`; the name is only used in errors.
    ///
    /// # Errors
    /// As [`GroupFile::load`].
    pub fn parse(file: &str, text: &str) -> Result<GroupFile, GroupError> {
        let source = Source { file, text };
        let raw: schema::File = toml::from_str(text).map_err(|e| source.toml_error(&e))?;
        Checker { source }.group(raw)
    }
}

pub struct Checker<'a> {
    pub source: Source<'a>,
}

/// The range a value has to be in.
#[derive(Clone, Copy)]
pub enum Range {
    Any,
    Positive,
    NotNegative,
}

/// A number the file may have given.
pub type Value = Option<At<f64>>;

pub type Checked<T> = Result<T, GroupError>;

impl Checker<'_> {
    fn group(&self, raw: schema::File) -> Checked<GroupFile> {
        if raw.name.get_ref().trim().is_empty() {
            return Err(self.refuse(&raw.name, "name", "is empty", "give the group a short name"));
        }
        let group_id = u8::try_from(*raw.group_id.get_ref())
            .ok()
            .filter(|id| *id > 0)
            .ok_or_else(|| {
                self.refuse(
                    &raw.group_id,
                    "group_id",
                    &format!("is {}", raw.group_id.get_ref()),
                    "give a whole number from 1 to 255",
                )
            })?;
        let defaults = raw.robot.unwrap_or_default();
        let entries = match raw.robots {
            Some(entries) if !entries.get_ref().is_empty() => entries.into_inner(),
            Some(entries) => {
                return Err(self.refuse(&entries, "robots", "the group is empty", ADD_ROBOT));
            }
            None => {
                return Err(self.source.error(
                    self.source.text.len(),
                    "robots",
                    "the group is empty",
                    ADD_ROBOT,
                ));
            }
        };
        let robots = self.robots(&entries, &defaults)?;
        let simulation = self.simulation(raw.simulation.unwrap_or_default(), &robots)?;
        Ok(GroupFile {
            name: raw.name.into_inner(),
            group_id,
            sync_period_us: self.milliseconds(
                raw.sync_period_ms.as_ref(),
                "sync_period_ms",
                default::SYNC_PERIOD_MS,
            )?,
            limits: self.limits(&raw.limits)?,
            contact_lag: self.contact_lag(&raw.contact_lag)?,
            hand_over_loss: self.hand_over_loss(raw.hand_over.loss_s_per_m.as_ref(), &robots)?,
            robots,
            simulation,
        })
    }

    fn robots(
        &self,
        entries: &[At<schema::Entry>],
        defaults: &schema::Defaults,
    ) -> Checked<Vec<Robot>> {
        let most = usize::from(LAST_NODE - FIRST_NODE) + 1;
        if let Some(first_over) = entries.get(most) {
            let problem = format!("{} robots in one group", entries.len());
            return Err(self.refuse(
                first_over,
                "robots",
                &problem,
                &format!("keep at most {most} on one bus"),
            ));
        }
        let mut robots: Vec<Robot> = Vec::with_capacity(entries.len());
        for (index, entry) in entries.iter().enumerate() {
            let robot = self.robot(index, entry, defaults)?;
            if let Some(other) = robots.iter().position(|r| r.node == robot.node) {
                let at = entry
                    .get_ref()
                    .node
                    .as_ref()
                    .map_or(entry.span().start, |n| n.span().start);
                return Err(self.source.error(
                    at,
                    format!("robots[{index}].node"),
                    format!("node {} is already robots[{other}]", robot.node),
                    "give every robot a node of its own",
                ));
            }
            robots.push(robot);
        }
        Ok(robots)
    }

    fn limits(&self, raw: &schema::Limits) -> Checked<Limits> {
        let positive = |key: &str, value: &Value, fallback: f64| {
            self.number(
                &format!("limits.{key}"),
                value.as_ref(),
                fallback,
                Range::Positive,
            )
        };
        Ok(Limits {
            linear_speed: positive("linear_speed", &raw.linear_speed, default::LINEAR_SPEED)?,
            yaw_rate: positive("yaw_rate", &raw.yaw_rate, default::YAW_RATE)?,
            linear_acceleration: positive(
                "linear_acceleration",
                &raw.linear_acceleration,
                default::LINEAR_ACCELERATION,
            )?,
            yaw_acceleration: positive(
                "yaw_acceleration",
                &raw.yaw_acceleration,
                default::YAW_ACCELERATION,
            )?,
            linear_jerk: positive("linear_jerk", &raw.linear_jerk, default::LINEAR_JERK)?,
            yaw_jerk: positive("yaw_jerk", &raw.yaw_jerk, default::YAW_JERK)?,
            command_timeout_us: self.milliseconds(
                raw.command_timeout_ms.as_ref(),
                "limits.command_timeout_ms",
                default::COMMAND_TIMEOUT_MS,
            )?,
            sync_timeout_us: match &raw.sync_timeout_ms {
                None => 0,
                set => self.milliseconds(set.as_ref(), "limits.sync_timeout_ms", 0.0)?,
            },
        })
    }

    fn contact_lag(&self, raw: &schema::ContactLag) -> Checked<ContactLag> {
        let seconds = |key: &str, value: &Value| -> Checked<f32> {
            let field = format!("contact_lag.{key}");
            let ms = self.number(&field, value.as_ref(), 0.0, Range::NotNegative)?;
            match value {
                Some(raw) if ms > LONGEST_LAG_MS => {
                    let remedy = "give at most 100; more is no creep of a contact";
                    Err(self.refuse(raw, &field, &format!("is {ms}"), remedy))
                }
                _ => Ok(ms * 1e-3),
            }
        };
        Ok(ContactLag {
            longitudinal: seconds("longitudinal_ms", &raw.longitudinal_ms)?,
            lateral: seconds("lateral_ms", &raw.lateral_ms)?,
            yaw: seconds("yaw_ms", &raw.yaw_ms)?,
        })
    }

    fn hand_over_loss(&self, raw: Option<&At<f64>>, robots: &[Robot]) -> Checked<f32> {
        const FIELD: &str = "hand_over.loss_s_per_m";
        let loss = self.number(FIELD, raw, 0.0, Range::NotNegative)?;
        match raw {
            Some(raw) if robots.iter().all(|robot| robot.rollers.is_none()) => {
                // The tables of robots that do not know their rollers have it in them.
                let remedy = "give the robots' rollers, or remove it";
                Err(self.refuse(raw, FIELD, "is for robots that know their rollers", remedy))
            }
            Some(raw) if loss > GroupFile::LARGEST_HAND_OVER_LOSS => {
                let most = GroupFile::LARGEST_HAND_OVER_LOSS;
                let remedy = format!("give at most {most}; more is no jolt of a roller");
                Err(self.refuse(raw, FIELD, &format!("is {loss}"), &remedy))
            }
            _ => Ok(loss),
        }
    }

    /// A period: a whole number of milliseconds, because robots count them in ticks of one.
    fn milliseconds(&self, raw: Option<&At<f64>>, field: &str, fallback: f64) -> Checked<u32> {
        let ms = self.number(field, raw, fallback, Range::Positive)?;
        if ms.fract() != 0.0 || ms > 10_000.0 {
            let at = raw.map_or(0, |r| r.span().start);
            let remedy = "give whole milliseconds, 1 to 10000";
            return Err(self.source.error(at, field, format!("is {ms}"), remedy));
        }
        // Whole and at most 10 000: exact.
        Ok(ms as u32 * 1000)
    }

    pub fn number(
        &self,
        field: &str,
        raw: Option<&At<f64>>,
        fallback: f64,
        range: Range,
    ) -> Checked<f32> {
        let Some(raw) = raw else {
            return Ok(fallback as f32);
        };
        // A value that f32 turns into zero or infinity is as wrong as zero or infinity.
        let value = *raw.get_ref() as f32;
        let fits = match range {
            Range::Any => value.is_finite(),
            Range::Positive => value.is_finite() && value > 0.0,
            Range::NotNegative => value.is_finite() && value >= 0.0,
        };
        if fits {
            return Ok(value);
        }
        let remedy = match range {
            Range::Any => "give a finite number",
            Range::Positive => "give a number greater than 0",
            Range::NotNegative => "give 0 or a positive number",
        };
        Err(self.refuse(raw, field, &format!("is {}", shown(*raw.get_ref())), remedy))
    }

    pub fn refuse<T>(&self, place: &At<T>, field: &str, problem: &str, remedy: &str) -> GroupError {
        self.source
            .error(place.span().start, field, problem, remedy)
    }
}

/// Longest lag of a contact, ms.
const LONGEST_LAG_MS: f32 = 100.0;

const ADD_ROBOT: &str = "add a `[[robots]]` entry for every robot";

/// A number as TOML writes it.
pub fn shown(value: f64) -> String {
    if value.is_nan() {
        "nan".to_owned()
    } else {
        format!("{value}")
    }
}
