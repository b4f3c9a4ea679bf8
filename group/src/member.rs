//! One `[[robots]]` entry becomes one member.
//!
//! Every field is looked up in the entry, then in the `[robot]` table, then among the defaults; an error
//! names the place it was found in, because that is where it has to be mended.

use kinematics::{FourWheelGeometry, Pose, VelocityCompensation};

use crate::check::{Checked, Checker, Range, Value, default};
use crate::error::GroupError;
use crate::model::{Control, Encoder, FIRST_NODE, LAST_NODE, Motor, Robot};
use crate::schema::{self, At};

impl Checker<'_> {
    pub fn robot(
        &self,
        index: usize,
        entry: &At<schema::Entry>,
        defaults: &schema::Defaults,
    ) -> Checked<Robot> {
        let e = entry.get_ref();
        let field = Member {
            checker: self,
            index,
            at: entry.span().start,
        };
        let node = e
            .node
            .as_ref()
            .ok_or_else(|| field.missing("node", "this entry"))?;
        let node = u8::try_from(*node.get_ref())
            .ok()
            .filter(|n| (FIRST_NODE..=LAST_NODE).contains(n))
            .ok_or_else(|| {
                self.refuse(
                    node,
                    &format!("robots[{index}].node"),
                    &format!("is {}", node.get_ref()),
                    &format!("give a robot's node, {FIRST_NODE} to {LAST_NODE} (1 is the master)"),
                )
            })?;
        let degrees = |key, value: &Value, fallback| -> Checked<f32> {
            Ok(field
                .number(key, value, &None, fallback, Range::Any)?
                .to_radians())
        };
        let mount = Pose {
            x: field.number("x", &e.x, &None, Some(0.0), Range::Any)?,
            y: field.number("y", &e.y, &None, Some(0.0), Range::Any)?,
            heading: degrees("heading_deg", &e.heading_deg, Some(0.0))?,
        };
        let positive = |key, own: &Value, shared: &Value, fallback| {
            field.number(key, own, shared, fallback, Range::Positive)
        };
        let not_negative = |key, own: &Value, shared: &Value, fallback| {
            field.number(key, own, shared, fallback, Range::NotNegative)
        };
        let d = defaults;
        let motor = Motor {
            supply: positive("motor.supply", &e.motor.supply, &d.motor.supply, None)?,
            constant: positive("motor.constant", &e.motor.constant, &d.motor.constant, None)?,
            resistance: positive(
                "motor.resistance",
                &e.motor.resistance,
                &d.motor.resistance,
                None,
            )?,
            inductance: not_negative(
                "motor.inductance",
                &e.motor.inductance,
                &d.motor.inductance,
                Some(default::INDUCTANCE),
            )?,
            inertia: positive("motor.inertia", &e.motor.inertia, &d.motor.inertia, None)?,
            friction: not_negative(
                "motor.friction",
                &e.motor.friction,
                &d.motor.friction,
                Some(default::FRICTION),
            )?,
            viscous: not_negative(
                "motor.viscous",
                &e.motor.viscous,
                &d.motor.viscous,
                Some(default::VISCOUS),
            )?,
        };
        let max_wheel_rate =
            positive("max_wheel_rate", &e.max_wheel_rate, &d.max_wheel_rate, None)?;
        if max_wheel_rate > motor.no_load_rate() {
            return Err(field.refuse(
                "max_wheel_rate",
                &e.max_wheel_rate,
                &d.max_wheel_rate,
                &format!(
                    "is {max_wheel_rate} rad/s, but the motor ends at {:.1}",
                    motor.no_load_rate()
                ),
                "lower it, or mend motor.supply and motor.constant",
            ));
        }
        Ok(Robot {
            node,
            mount,
            geometry: self.geometry(&field, e, d)?,
            compensation: self.compensation(&field, e, d)?,
            max_wheel_rate,
            encoder: Encoder {
                counts_per_revolution: positive(
                    "encoder.counts_per_revolution",
                    &e.encoder.counts_per_revolution,
                    &d.encoder.counts_per_revolution,
                    None,
                )?,
            },
            motor,
            control: Control {
                proportional: not_negative(
                    "control.proportional",
                    &e.control.proportional,
                    &d.control.proportional,
                    Some(default::PROPORTIONAL),
                )?,
                integral: not_negative(
                    "control.integral",
                    &e.control.integral,
                    &d.control.integral,
                    Some(default::INTEGRAL),
                )?,
            },
        })
    }

    fn geometry(
        &self,
        field: &Member<'_, '_>,
        e: &schema::Entry,
        d: &schema::Defaults,
    ) -> Checked<FourWheelGeometry> {
        let positive = |key, own: &Value, shared: &Value| {
            field.number(key, own, shared, None, Range::Positive)
        };
        let half_track = positive("half_track", &e.half_track, &d.half_track)?;
        let half_wheelbase = positive("half_wheelbase", &e.half_wheelbase, &d.half_wheelbase)?;
        let wheel_radius = positive("wheel_radius", &e.wheel_radius, &d.wheel_radius)?;
        let angle = positive("roller_angle_deg", &e.roller_angle_deg, &d.roller_angle_deg)?;
        if angle >= 90.0 {
            return Err(field.refuse(
                "roller_angle_deg",
                &e.roller_angle_deg,
                &d.roller_angle_deg,
                &format!("is {angle}"),
                "give the angle between roller axle and wheel axle in degrees, above 0 and below 90",
            ));
        }
        FourWheelGeometry::new(half_track, half_wheelbase, wheel_radius, angle.to_radians())
            .map_err(|error| {
                field.refuse(
                    "wheel_radius",
                    &e.wheel_radius,
                    &d.wheel_radius,
                    &format!("{error:?}"),
                    "mend the dimensions",
                )
            })
    }

    fn compensation(
        &self,
        field: &Member<'_, '_>,
        e: &schema::Entry,
        d: &schema::Defaults,
    ) -> Checked<VelocityCompensation> {
        let axis = |key: &str, own: &Value, shared: &Value| -> Checked<f32> {
            let value = field.number(key, own, shared, Some(1.0), Range::Any)?;
            if value <= 0.0 {
                let remedy = "give 1 for no compensation; 0 would delete the axis";
                return Err(field.refuse(key, own, shared, &format!("is {value}"), remedy));
            }
            Ok(value)
        };
        let longitudinal = axis(
            "compensation.longitudinal",
            &e.compensation.longitudinal,
            &d.compensation.longitudinal,
        )?;
        let lateral = axis(
            "compensation.lateral",
            &e.compensation.lateral,
            &d.compensation.lateral,
        )?;
        let yaw = axis("compensation.yaw", &e.compensation.yaw, &d.compensation.yaw)?;
        VelocityCompensation::new(longitudinal, lateral, yaw).map_err(|error| {
            field.refuse(
                "compensation",
                &None,
                &None,
                &format!("{error:?}"),
                "mend the coefficients",
            )
        })
    }
}

/// One `[[robots]]` entry, for naming its fields.
struct Member<'c, 's> {
    checker: &'c Checker<'s>,
    index: usize,
    /// Where the entry starts, for what it lacks.
    at: usize,
}

impl Member<'_, '_> {
    /// The name of a field. One that came from `[robot]` is named as such: that is where it has to be
    /// mended.
    fn name(&self, key: &str, own: &Value, shared: &Value) -> String {
        if own.is_none() && shared.is_some() {
            format!("robot.{key}")
        } else {
            format!("robots[{}].{key}", self.index)
        }
    }

    /// A number from the entry, else from `[robot]`, else the default, else an error.
    fn number(
        &self,
        key: &str,
        own: &Value,
        shared: &Value,
        fallback: Option<f64>,
        range: Range,
    ) -> Checked<f32> {
        let field = self.name(key, own, shared);
        match (own.as_ref().or(shared.as_ref()), fallback) {
            (Some(value), _) => self.checker.number(&field, Some(value), 0.0, range),
            (None, Some(fallback)) => self.checker.number(&field, None, fallback, range),
            (None, None) => Err(self.missing(key, "`[robot]` or in this entry")),
        }
    }

    fn missing(&self, key: &str, place: &str) -> GroupError {
        let field = format!("robots[{}].{key}", self.index);
        let remedy = format!("give it in {place}");
        self.checker
            .source
            .error(self.at, field, "is missing", remedy)
    }

    fn refuse(
        &self,
        key: &str,
        own: &Value,
        shared: &Value,
        problem: &str,
        remedy: &str,
    ) -> GroupError {
        let place = own.as_ref().or(shared.as_ref());
        let at = place.map_or(self.at, |p| p.span().start);
        self.checker
            .source
            .error(at, self.name(key, own, shared), problem, remedy)
    }
}
