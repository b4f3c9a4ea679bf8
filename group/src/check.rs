//! From the file to the group: defaults, units, and every rule.
//!
//! Two kinds of default, no others: the `[robot]` table stands in for what a `[[robots]]` entry
//! leaves out, and a few values that describe no hardware (periods, limits of motion, gains,
//! electrical details that only a simulation needs) have a default here, listed in [`default`].
//! Dimensions, encoder and the motor's main data have none: guessing them moves a real robot
//! wrongly.

use std::cell::RefCell;
use std::path::Path;

use serde::Deserialize as _;
use toml::Spanned;
use toml::de::DeTable;

use crate::declaration::FILE;
use crate::error::{GroupError, Source};
use crate::model::{ContactLag, FIRST_NODE, GroupFile, LAST_NODE, Limits, Robot};
use crate::number::{shown, slip};
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
        Examination::of_file(path)?.into_group()
    }

    /// Checks a text that came from `file`; the name is only used in errors.
    ///
    /// # Errors
    /// As [`GroupFile::load`].
    pub fn parse(file: &str, text: &str) -> Result<GroupFile, GroupError> {
        Examination::of(file, text).into_group()
    }
}

/// Everything there is to say about a group file.
#[derive(Debug)]
pub struct Examination {
    /// The group, if the file breaks no rule.
    pub group: Option<GroupFile>,
    /// Every rule that it breaks, in the order of its lines.
    pub errors: Vec<GroupError>,
    /// What is allowed and hardly meant.
    pub warnings: Vec<GroupError>,
}

impl Examination {
    /// Examines a file.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn of_file(path: impl AsRef<Path>) -> Result<Self, GroupError> {
        let path = path.as_ref();
        let file = path.display().to_string();
        let text = crate::input::text(path).map_err(|e| GroupError {
            file: file.clone(),
            line: None,
            field: String::new(),
            problem: format!("cannot be read ({e})"),
            remedy: "give the path of a group file".to_owned(),
        })?;
        Ok(Self::of(&file, &text))
    }

    /// Examines a text that came from `file`; the name is only used in errors.
    #[must_use]
    pub fn of(file: &str, text: &str) -> Self {
        let source = Source { file, text };
        let (tree, broken) = DeTable::parse_recoverable(text);
        if !broken.is_empty() {
            let mut errors: Vec<_> = broken.iter().map(|e| source.toml_error(e)).collect();
            errors.dedup_by_key(|error| error.line);
            return Self {
                group: None,
                errors,
                warnings: Vec::new(),
            };
        }
        let checker = Checker {
            source,
            errors: RefCell::default(),
            warnings: RefCell::default(),
            settled: RefCell::default(),
        };
        let group = checker.examine(tree);
        let by_line = |mut found: Vec<GroupError>| {
            found.sort_by_key(|error| error.line);
            found
        };
        let errors = by_line(checker.errors.into_inner());
        Self {
            group: group.ok().filter(|_| errors.is_empty()),
            errors,
            warnings: by_line(checker.warnings.into_inner()),
        }
    }

    fn into_group(self) -> Result<GroupFile, GroupError> {
        match (self.group, self.errors.into_iter().next()) {
            (_, Some(error)) => Err(error),
            (Some(group), None) => Ok(group),
            (None, None) => unreachable!("a file that breaks no rule is a group"),
        }
    }
}

/// What has been found out about one file.
pub struct Checker<'a> {
    pub source: Source<'a>,
    errors: RefCell<Vec<GroupError>>,
    warnings: RefCell<Vec<GroupError>>,
    /// Keys about which everything has been said although they are not the field of an error.
    settled: RefCell<Vec<String>>,
}

/// Says that what was wrong has been reported.
#[derive(Debug)]
pub struct Reported;

/// The range a value has to be in.
#[derive(Clone, Copy)]
pub enum Range {
    Any,
    Positive,
    NotNegative,
}

/// A number the file may have given.
pub type Value = Option<At<f64>>;

/// A value, or the word that it is wrong and reported. Where rules that come later can go on, a
/// wrong number is NaN instead, which no comparison objects to.
pub type Checked<T> = Result<T, Reported>;

impl Checker<'_> {
    fn examine(&self, mut tree: Spanned<DeTable<'_>>) -> Checked<GroupFile> {
        let fields: Vec<_> = FILE.iter().collect();
        self.prune(tree.get_mut(), &fields, "");
        self.required(tree.get_ref(), FILE);
        let numbers = tree.clone();
        let raw = schema::File::deserialize(toml::Deserializer::from(tree)).map_err(|error| {
            let start = error.span().map_or(0, |span| span.start);
            self.report(start, "", error.message(), "fix the TOML here")
        })?;
        let group = self.group(raw);
        self.outside_limits(numbers.get_ref(), &fields, "");
        self.suspicious_angles(numbers.get_ref());
        let group = group?;
        // What follows takes the robots as they are.
        let bad = |error: &GroupError| error.field.starts_with("robot");
        if !self.errors.borrow().iter().any(bad) {
            self.overlaps(&group, numbers.get_ref());
            self.votes_fit(&group, numbers.get_ref());
        }
        if self.errors.borrow().is_empty() {
            self.parameters_in_limits(&group, numbers.get_ref());
        }
        if self.errors.borrow().is_empty() {
            self.robots_accept(&group, numbers.get_ref());
            self.robots_can_be(&group, numbers.get_ref());
        }
        Ok(group)
    }

    fn group(&self, raw: schema::File) -> Checked<GroupFile> {
        if let Some(name) = &raw.name
            && name.get_ref().trim().is_empty()
        {
            self.refuse(name, "name", "is empty", "give the group a short name");
        }
        let group_id = raw.group_id.as_ref().and_then(|raw| {
            let id = u8::try_from(*raw.get_ref()).ok().filter(|id| *id > 0);
            if id.is_none() {
                let problem = format!("is {}", raw.get_ref());
                let remedy = "give a whole number from 1 to 255";
                self.refuse(raw, "group_id", &problem, remedy);
            }
            id
        });
        let defaults = raw.robot.unwrap_or_default();
        let robots = match &raw.robots {
            Some(entries) if !entries.get_ref().is_empty() => {
                self.robots(entries.get_ref(), &defaults)
            }
            None if self.is_settled("robots") => Err(Reported),
            entries => {
                let end = self.source.text.len();
                let at = entries.as_ref().map_or(end, |entries| entries.span().start);
                Err(self.report(at, "robots", "the group is empty", ADD_ROBOT))
            }
        };
        let known = robots.as_deref().ok();
        let simulation = self.simulation(raw.simulation.unwrap_or_default(), known);
        let period = raw.sync_period_ms.as_ref();
        let sync_period_us = self.milliseconds(period, "sync_period_ms", default::SYNC_PERIOD_MS);
        let limits = self.limits(&raw.limits);
        let contact_lag = self.contact_lag(&raw.contact_lag);
        let loss = raw.roller_transition.loss_s_per_m.as_ref();
        let hand_over_loss = self.hand_over_loss(loss, robots.as_deref().ok());
        Ok(GroupFile {
            name: raw.name.map(Spanned::into_inner).unwrap_or_default(),
            group_id: group_id.unwrap_or_default(),
            sync_period_us,
            limits,
            contact_lag,
            hand_over_loss,
            robots: robots?,
            simulation: simulation?,
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
            let remedy = format!("put at most {most} on one bus");
            return Err(self.refuse(first_over, "robots", &problem, &remedy));
        }
        let mut nodes: Vec<u8> = Vec::new();
        let mut robots = Vec::with_capacity(entries.len());
        for (index, entry) in entries.iter().enumerate() {
            let node = self.node(index, entry);
            if let (Some(raw), Ok(node)) = (&entry.get_ref().node, &node)
                && let Some(other) = nodes.iter().position(|n| n == node)
            {
                self.refuse(
                    raw,
                    &format!("robots[{index}].node"),
                    &format!("node {node} is already robots[{other}]"),
                    "give every robot a node of its own",
                );
            }
            nodes.push(*node.as_ref().unwrap_or(&0));
            robots.push(self.robot(index, entry, defaults, node));
        }
        robots.into_iter().collect()
    }

    fn limits(&self, raw: &schema::Limits) -> Limits {
        let positive = |key: &str, value: &Value, fallback: f64| {
            let field = format!("limits.{key}");
            self.number(&field, value.as_ref(), fallback, Range::Positive)
        };
        Limits {
            linear_speed: positive("linear_speed", &raw.linear_speed, default::LINEAR_SPEED),
            yaw_rate: positive("yaw_rate", &raw.yaw_rate, default::YAW_RATE),
            linear_acceleration: positive(
                "linear_acceleration",
                &raw.linear_acceleration,
                default::LINEAR_ACCELERATION,
            ),
            yaw_acceleration: positive(
                "yaw_acceleration",
                &raw.yaw_acceleration,
                default::YAW_ACCELERATION,
            ),
            linear_jerk: positive("linear_jerk", &raw.linear_jerk, default::LINEAR_JERK),
            yaw_jerk: positive("yaw_jerk", &raw.yaw_jerk, default::YAW_JERK),
            command_timeout_us: self.milliseconds(
                raw.command_timeout_ms.as_ref(),
                "limits.command_timeout_ms",
                default::COMMAND_TIMEOUT_MS,
            ),
            sync_timeout_us: match &raw.sync_timeout_ms {
                None => 0,
                set => self.milliseconds(set.as_ref(), "limits.sync_timeout_ms", 0.0),
            },
        }
    }

    fn contact_lag(&self, raw: &schema::ContactLag) -> ContactLag {
        let seconds = |key: &str, value: &Value| {
            let field = format!("contact_lag.{key}");
            let ms = self.number(&field, value.as_ref(), 0.0, Range::NotNegative);
            if let Some(raw) = value
                && ms > LONGEST_LAG_MS
            {
                let remedy = "give at most 100; contacts do not creep by more";
                self.refuse(raw, &field, &format!("is {ms}"), remedy);
            }
            ms * 1e-3
        };
        ContactLag {
            longitudinal: seconds("longitudinal_ms", &raw.longitudinal_ms),
            lateral: seconds("lateral_ms", &raw.lateral_ms),
            yaw: seconds("yaw_ms", &raw.yaw_ms),
        }
    }

    fn hand_over_loss(&self, raw: Option<&At<f64>>, robots: Option<&[Robot]>) -> f32 {
        const FIELD: &str = "roller_transition.loss_s_per_m";
        let loss = self.number(FIELD, raw, 0.0, Range::NotNegative);
        let Some(raw) = raw else { return loss };
        if robots.is_some_and(|robots| robots.iter().all(|robot| robot.rollers.is_none())) {
            // The tables of robots that do not know their rollers have it in them.
            let remedy = "add the robots' rollers, or remove it";
            self.refuse(raw, FIELD, "applies only to robots with `rollers`", remedy);
        } else if loss > GroupFile::LARGEST_HAND_OVER_LOSS {
            let most = GroupFile::LARGEST_HAND_OVER_LOSS;
            let remedy = format!("give at most {most}; a roller does not cost more");
            self.refuse(raw, FIELD, &format!("is {loss}"), &remedy);
        }
        loss
    }

    /// A period: a whole number of milliseconds, because robots count them in ticks of one.
    fn milliseconds(&self, raw: Option<&At<f64>>, field: &str, fallback: f64) -> u32 {
        let ms = self.number(field, raw, fallback, Range::Positive);
        let whole = |ms: f64| ms.fract() == 0.0 && (1.0..=10_000.0).contains(&ms);
        if ms.is_finite() && !whole(f64::from(ms)) {
            let at = raw.map_or(0, |r| r.span().start);
            let given = raw.map_or(fallback, |raw| *raw.get_ref());
            let meant = slip(given, "ms", |ms| whole(ms) && ms <= LONGEST_SLIP_MS);
            let meant = meant.map_or_else(String::new, |meant| format!("; {meant}"));
            let remedy = format!("give whole milliseconds, 1 to 10000{meant}");
            self.report(at, field, &format!("is {}", shown(given)), &remedy);
            return 0;
        }
        // Whole and at most 10 000: exact. What is wrong has been reported, and becomes 0.
        ms as u32 * 1000
    }

    /// A number in its range; NaN, and a report, otherwise.
    pub fn number(&self, field: &str, raw: Option<&At<f64>>, fallback: f64, range: Range) -> f32 {
        let Some(raw) = raw else {
            return fallback as f32;
        };
        // A value that f32 turns into zero or infinity is as wrong as zero or infinity.
        let value = *raw.get_ref() as f32;
        let fits = match range {
            Range::Any => value.is_finite(),
            Range::Positive => value.is_finite() && value > 0.0,
            Range::NotNegative => value.is_finite() && value >= 0.0,
        };
        if fits {
            return value;
        }
        let remedy = match range {
            Range::Any => "give a finite number",
            Range::Positive => "give a number greater than 0",
            Range::NotNegative => "give 0 or a positive number",
        };
        self.refuse(raw, field, &format!("is {}", shown(*raw.get_ref())), remedy);
        f32::NAN
    }

    /// Reports what is wrong at a place in the text, unless the same field has a report already.
    pub fn report(&self, at: usize, field: &str, problem: &str, remedy: &str) -> Reported {
        let mut errors = self.errors.borrow_mut();
        if field.is_empty() || !errors.iter().any(|error| error.field == field) {
            errors.push(self.source.error(at, field, problem, remedy));
        }
        Reported
    }

    /// Mentions what is allowed and hardly meant.
    pub fn warn(&self, at: usize, field: &str, problem: &str, remedy: &str) {
        let warning = self.source.error(at, field, problem, remedy);
        self.warnings.borrow_mut().push(warning);
    }

    /// Marks a key about which nothing more is to be said.
    pub fn settle(&self, field: String) {
        self.settled.borrow_mut().push(field);
    }

    /// Whether a key, or the table it is in, has been reported.
    pub fn is_settled(&self, field: &str) -> bool {
        let covers = |known: &str| {
            field
                .strip_prefix(known)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        self.errors.borrow().iter().any(|e| covers(&e.field))
            || self.settled.borrow().iter().any(|known| covers(known))
    }

    pub fn refuse<T>(&self, place: &At<T>, field: &str, problem: &str, remedy: &str) -> Reported {
        self.report(place.span().start, field, problem, remedy)
    }
}

/// A period or timeout that was given in seconds is a fraction of one: ms.
const LONGEST_SLIP_MS: f64 = 300.0;

/// Longest lag of a contact, ms.
const LONGEST_LAG_MS: f32 = 100.0;

const ADD_ROBOT: &str = "add a `[[robots]]` entry for every robot";
