//! Motor drivers, brake and current sensor of a robot, as a file gives them; every key has a
//! default.

use super::{Checker, Member, Range, Value, schema};
use crate::model::{Board, CurrentSensor, OutputStage, StageKind};

/// End of the range of a measuring input, V.
const FULL_SCALE: f32 = 3.3;
/// Current at which a robot stops, over what its four motors may take; it measures so far at
/// least (object 0x2026:3).
const CURRENT_MARGIN: f32 = 1.25;

/// A key with its values in the entry and in `[robot]`.
type Key<'a> = (&'static str, &'a Value, &'a Value);

impl Checker<'_> {
    /// What the motors' drivers and brakes stand and take; nothing of it has to be given.
    pub(super) fn output_stage(
        &self,
        field: &Member<'_, '_>,
        e: &schema::Entry,
        d: &schema::Defaults,
    ) -> OutputStage {
        let (own, shared) = (&e.motor, &d.motor);
        let largest_current = match (&own.largest_current, &shared.largest_current) {
            (None, None) => None,
            (own, shared) => {
                Some(field.number("motor.largest_current", own, shared, None, Range::Positive))
            }
        };
        let (key, own_duty, shared_duty) = (
            "motor.largest_duty",
            &own.largest_duty,
            &shared.largest_duty,
        );
        let largest_duty = field.number(key, own_duty, shared_duty, Some(1.0), Range::Positive);
        if !(0.1..=1.0).contains(&largest_duty) {
            let problem = format!("is {largest_duty}");
            field.refuse(key, own_duty, shared_duty, &problem, "give 0.1 to 1");
        }
        let millis = |key: Key<'_>| field.whole(key, 0, (0, 1_000), "milliseconds, ");
        let (own_kind, shared_kind) = (&own.output_stage, &shared.output_stage);
        let kind = own_kind.as_ref().or(shared_kind.as_ref());
        let kind = kind.map_or(StageKind::default(), |kind| *kind.get_ref());
        let wired = own.enable_wired.as_ref().or(shared.enable_wired.as_ref());
        let enable_wired = wired.is_some_and(|wired| *wired.get_ref());
        if let Some(drive_current) = kind.drive_current()
            && largest_current.is_none_or(|largest| largest > drive_current)
        {
            let (key, own, shared) = (
                "motor.largest_current",
                &own.largest_current,
                &shared.largest_current,
            );
            let problem = "must be a current that these drives can supply";
            let remedy = format!("give at most {drive_current} A, and no more than the motors may");
            field.refuse(key, own, shared, problem, &remedy);
        }
        if kind.needs_enable() && !enable_wired {
            let (key, problem) = ("motor.output_stage", "has no safe state without an enable");
            let remedy = "wire the drivers' enable to the robot's, so that low switches all bridges \
                          off, and set `enable_wired = true`";
            field.refuse(key, own_kind, shared_kind, problem, remedy);
        }
        let keeps_high = match kind {
            StageKind::InInSlow => Some("in-in-slow"),
            StageKind::InInBrake => Some("in-in-brake"),
            _ => None,
        };
        if let Some(name) = keeps_high
            && largest_duty < 1.0
        {
            let problem = format!("is {largest_duty}, but `{name}` keeps a high side on");
            let remedy = "leave it at 1, or take another driver";
            field.refuse(key, own_duty, shared_duty, &problem, remedy);
        }
        let drive_identifiers = field.drive_identifiers(own, shared);
        let pauses = (own.direction_pause.as_ref()).or(shared.direction_pause.as_ref());
        OutputStage {
            largest_current,
            largest_duty,
            direction_pause: pauses.is_some_and(|pauses| *pauses.get_ref()),
            brake_release_ms: millis((
                "motor.brake_release_ms",
                &own.brake_release_ms,
                &shared.brake_release_ms,
            )),
            brake_engage_ms: millis((
                "motor.brake_engage_ms",
                &own.brake_engage_ms,
                &shared.brake_engage_ms,
            )),
            pwm_frequency: field.whole(
                (
                    "motor.pwm_frequency",
                    &own.pwm_frequency,
                    &shared.pwm_frequency,
                ),
                20_000,
                (8_000, 40_000),
                "Hz, ",
            ),
            kind,
            drive_identifiers,
            enable_wired,
            current_sensor: field.current_sensor(own, shared, largest_current),
        }
    }
}

/// What is wrong with a key that asks for what the board does not have.
fn not_for(board: Board) -> String {
    format!("is not for a `{}`", board.name())
}

impl Member<'_, '_> {
    /// Refuses what a kit's board is not wired for (docs/boards.md).
    pub(super) fn fits_kit(&self, output: &OutputStage, e: &schema::Entry, d: &schema::Defaults) {
        let (own, shared) = (&e.motor, &d.motor);
        if !output.kind.has_two_pwms() {
            let remedy = "give `in-in-brake` or `in-in-fast`: its bridges have two PWMs a wheel";
            let (own, shared) = (&own.output_stage, &shared.output_stage);
            let problem = not_for(Board::KitF103rc);
            self.refuse("motor.output_stage", own, shared, &problem, remedy);
        }
        if e.rollers.is_some() || d.rollers.is_some() {
            let remedy = "remove it: the board has no index inputs, so the rollers' phase is \
                          never known";
            let problem = not_for(Board::KitF103rc);
            self.refuse("rollers", &e.rollers, &d.rollers, &problem, remedy);
        }
    }

    /// Refuses a current sensor on a board that has no input for one.
    pub(super) fn measures_no_current(
        &self,
        board: Board,
        output: &OutputStage,
        e: &schema::Entry,
        d: &schema::Defaults,
    ) {
        if output.current_sensor.is_some() {
            let remedy = "remove it: the board has no inputs for current sensors";
            let (own, shared) = (&e.motor.current_scale, &d.motor.current_scale);
            self.refuse("motor.current_scale", own, shared, &not_for(board), remedy);
        }
    }

    /// A whole number within bounds.
    fn whole(
        &self,
        (key, own, shared): Key<'_>,
        default: u16,
        (least, most): (u16, u16),
        unit: &str,
    ) -> u16 {
        let fallback = Some(f64::from(default));
        let value = self.number(key, own, shared, fallback, Range::NotNegative);
        if value.fract() != 0.0 || value < f32::from(least) || value > f32::from(most) {
            let problem = format!("is {value}");
            let remedy = format!("give whole {unit}{least} to {most}");
            self.refuse(key, own, shared, &problem, &remedy);
        }
        value as u16
    }

    /// Which smart drive is which wheel's.
    fn drive_identifiers(&self, own: &schema::Motor, shared: &schema::Motor) -> [u8; 4] {
        const USUAL: [u8; 4] = [1, 2, 3, 4];
        let (own, shared) = (&own.drive_identifiers, &shared.drive_identifiers);
        let Some(given) = own.as_ref().or(shared.as_ref()) else {
            return USUAL;
        };
        let given = given.get_ref();
        let mut sorted = *given;
        sorted.sort_by(f64::total_cmp);
        if sorted != USUAL.map(f64::from) {
            let problem = format!("is {given:?}");
            let remedy = "give each of 1, 2, 3 and 4 once: front left, front right, rear left, rear \
                          right";
            self.refuse("motor.drive_identifiers", own, shared, &problem, remedy);
            return USUAL;
        }
        given.map(|identifier| identifier as u8)
    }

    /// The sensors of the motors' current, where there are any; they have to show more than the
    /// motors may take.
    fn current_sensor(
        &self,
        own: &schema::Motor,
        shared: &schema::Motor,
        largest_current: Option<f32>,
    ) -> Option<CurrentSensor> {
        let key = "motor.current_scale";
        let (own_scale, shared_scale) = (&own.current_scale, &shared.current_scale);
        let scale = self.number(key, own_scale, shared_scale, Some(0.0), Range::NotNegative);
        let (own_offset, shared_offset) = (&own.current_offset, &shared.current_offset);
        let offset = self.number(
            "motor.current_offset",
            own_offset,
            shared_offset,
            Some(0.0),
            Range::NotNegative,
        );
        let inputs = self.whole(
            (
                "motor.current_inputs",
                &own.current_inputs,
                &shared.current_inputs,
            ),
            1,
            (1, 3),
            "numbers, ",
        );
        if scale == 0.0 {
            return None;
        }
        let refuse = |problem: &str, remedy: &str| {
            self.refuse(key, own_scale, shared_scale, problem, remedy);
        };
        let Some(largest) = largest_current else {
            let remedy = "give `motor.largest_current` as well: more than that is a fault";
            refuse("has nothing to be compared with", remedy);
            return None;
        };
        let (reach, bound) = (
            (FULL_SCALE - offset) * scale * f32::from(inputs),
            4.0 * CURRENT_MARGIN * largest,
        );
        if reach <= bound {
            let problem = format!("with the other keys reaches {reach} A");
            let remedy = format!("take a sensor that reaches more than {bound} A");
            refuse(&problem, &remedy);
        }
        Some(CurrentSensor {
            scale,
            offset,
            inputs: inputs as u8,
        })
    }
}
