//! One `[[robots]]` entry becomes one member.
//!
//! Every field is looked up in the entry, then in the `[robot]` table, then among the defaults; an
//! error names the place it was found in, because that is the place to correct.

mod output_stage;

use kinematics::{
    AxisTable, DirectionalCompensation, FourWheelGeometry, Pose, VelocityCompensation,
};

use protocol::compensation::{ObliqueRow, Row};

use crate::check::{Checked, Checker, Range, Reported, Value, default};
use crate::model::{
    Board, CompensationTable, Control, Encoder, FIRST_NODE, LAST_NODE, Motor, Reversed, Robot,
    Rollers, Wheel,
};
use crate::schema::{self, At};

impl Checker<'_> {
    /// The node of an entry.
    pub fn node(&self, index: usize, entry: &At<schema::Entry>) -> Checked<u8> {
        let field = format!("robots[{index}].node");
        let Some(raw) = &entry.get_ref().node else {
            if !self.is_settled(&field) {
                let at = entry.span().start;
                self.report(at, &field, "is missing", "give it in this entry");
            }
            return Err(Reported);
        };
        let node = u8::try_from(*raw.get_ref()).ok();
        node.filter(|n| (FIRST_NODE..=LAST_NODE).contains(n))
            .ok_or_else(|| {
                let problem = format!("is {}", raw.get_ref());
                let remedy =
                    format!("give a robot's node, {FIRST_NODE} to {LAST_NODE} (1 is the master)");
                self.refuse(raw, &field, &problem, &remedy)
            })
    }

    pub fn robot(
        &self,
        index: usize,
        entry: &At<schema::Entry>,
        defaults: &schema::Defaults,
        node: Checked<u8>,
    ) -> Checked<Robot> {
        let (e, d) = (entry.get_ref(), defaults);
        let field = Member {
            checker: self,
            index,
            at: entry.span().start,
        };
        let place = |key, value: &Value| field.number(key, value, &None, Some(0.0), Range::Any);
        let mount = Pose {
            x: place("x", &e.x),
            y: place("y", &e.y),
            heading: place("heading_deg", &e.heading_deg).to_radians(),
        };
        let positive = |key, own: &Value, shared: &Value, fallback| {
            field.number(key, own, shared, fallback, Range::Positive)
        };
        let not_negative = |key, own: &Value, shared: &Value, fallback| {
            field.number(key, own, shared, fallback, Range::NotNegative)
        };
        let motor = self.motor(&field, e, d);
        let max_wheel_rate = positive("max_wheel_rate", &e.max_wheel_rate, &d.max_wheel_rate, None);
        if max_wheel_rate > motor.no_load_rate() {
            field.refuse(
                "max_wheel_rate",
                &e.max_wheel_rate,
                &d.max_wheel_rate,
                &format!(
                    "is {max_wheel_rate} rad/s, but the motors of robots[{index}] reach only {:.1}",
                    motor.no_load_rate().max(0.0)
                ),
                "lower it, or fix the values of `motor`",
            );
        }
        let encoder = Encoder {
            counts_per_revolution: positive(
                "encoder.counts_per_revolution",
                &e.encoder.counts_per_revolution,
                &d.encoder.counts_per_revolution,
                None,
            ),
            gear_ratio: positive(
                "encoder.gear_ratio",
                &e.encoder.gear_ratio,
                &d.encoder.gear_ratio,
                Some(1.0),
            ),
        };
        let reversed = Reversed {
            encoders: field.reversed(
                "encoder.directions",
                &e.encoder.directions,
                &d.encoder.directions,
            ),
            motors: field.reversed("motor.directions", &e.motor.directions, &d.motor.directions),
        };
        let control = Control {
            proportional: not_negative(
                "control.proportional",
                &e.control.proportional,
                &d.control.proportional,
                Some(default::PROPORTIONAL),
            ),
            integral: not_negative(
                "control.integral",
                &e.control.integral,
                &d.control.integral,
                Some(default::INTEGRAL),
            ),
            identified: (e.control.identified.as_ref())
                .or(d.control.identified.as_ref())
                .is_some_and(|identified| *identified.get_ref()),
        };
        let geometry = self.geometry(&field, e, d);
        let wheels = self.wheels(&field, e, d);
        let rollers = self.known_rollers(&field, e, d);
        let output = self.output_stage(&field, e, d);
        let board = e.board.as_ref().or(d.board.as_ref());
        let board = board.map_or_else(Board::default, |board| *board.get_ref());
        if board.hardware().current_inputs == 0 {
            field.measures_no_current(board, &output, e, d);
        }
        if board == Board::KitF103rc {
            field.fits_kit(&output, e, d);
        }
        let compensation = self.compensation(&field, e, d)?;
        let compensation_table = self.compensation_table(&field, e, d, &compensation);
        Ok(Robot {
            node: node?,
            mount,
            geometry: geometry?,
            wheels: wheels?,
            compensation,
            compensation_table: compensation_table?,
            rollers: rollers?,
            max_wheel_rate,
            board,
            encoder,
            reversed,
            output,
            motor,
            control,
        })
    }

    fn motor(&self, field: &Member<'_, '_>, e: &schema::Entry, d: &schema::Defaults) -> Motor {
        let (own, shared) = (&e.motor, &d.motor);
        let needed = |key, own: &Value, shared: &Value| {
            field.number(key, own, shared, None, Range::Positive)
        };
        let or = |key, own: &Value, shared: &Value, fallback| {
            field.number(key, own, shared, Some(fallback), Range::NotNegative)
        };
        Motor {
            supply: needed("motor.supply", &own.supply, &shared.supply),
            constant: needed("motor.constant", &own.constant, &shared.constant),
            resistance: needed("motor.resistance", &own.resistance, &shared.resistance),
            inductance: or(
                "motor.inductance",
                &own.inductance,
                &shared.inductance,
                default::INDUCTANCE,
            ),
            inertia: needed("motor.inertia", &own.inertia, &shared.inertia),
            friction: or(
                "motor.friction",
                &own.friction,
                &shared.friction,
                default::FRICTION,
            ),
            viscous: or(
                "motor.viscous",
                &own.viscous,
                &shared.viscous,
                default::VISCOUS,
            ),
        }
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
        let half_track = positive("half_track", &e.half_track, &d.half_track);
        let half_wheelbase = positive("half_wheelbase", &e.half_wheelbase, &d.half_wheelbase);
        let wheel_radius = positive("wheel_radius", &e.wheel_radius, &d.wheel_radius);
        let angle = positive("roller_angle_deg", &e.roller_angle_deg, &d.roller_angle_deg);
        if angle >= 90.0 {
            return Err(field.refuse(
                "roller_angle_deg",
                &e.roller_angle_deg,
                &d.roller_angle_deg,
                &format!("is {angle}"),
                "give the angle between roller axle and wheel axle in degrees, above 0 and below \
                 90",
            ));
        }
        if (half_track + half_wheelbase + wheel_radius + angle).is_nan() {
            return Err(Reported);
        }
        FourWheelGeometry::new(half_track, half_wheelbase, wheel_radius, angle.to_radians())
            .map_err(|error| {
                field.refuse(
                    "wheel_radius",
                    &e.wheel_radius,
                    &d.wheel_radius,
                    &format!("{error:?}"),
                    "fix the dimensions",
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
            let value = field.number(key, own, shared, Some(1.0), Range::Any);
            if value.is_nan() {
                return Err(Reported);
            }
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
        );
        let lateral = axis(
            "compensation.lateral",
            &e.compensation.lateral,
            &d.compensation.lateral,
        );
        let yaw = axis("compensation.yaw", &e.compensation.yaw, &d.compensation.yaw);
        VelocityCompensation::new(longitudinal?, lateral?, yaw?).map_err(|error| {
            field.refuse::<f64>(
                "compensation",
                &None,
                &None,
                &format!("{error:?}"),
                "fix the coefficients",
            )
        })
    }
}

impl Checker<'_> {
    /// The wheels one by one, from the entry or from `[robot]`, if either has them; they must make
    /// a robot.
    fn wheels(
        &self,
        field: &Member<'_, '_>,
        e: &schema::Entry,
        d: &schema::Defaults,
    ) -> Checked<Option<[Wheel; 4]>> {
        let (wheels, path) = match (&e.wheels, &d.wheels) {
            (Some(own), _) => (own, format!("robots[{}].wheels", field.index)),
            (None, Some(shared)) => (shared, "robot.wheels".to_owned()),
            (None, None) => return Ok(None),
        };
        let one = |name: &str, raw: &At<schema::Wheel>| -> Checked<Wheel> {
            let path = format!("{path}.{name}");
            let w = raw.get_ref();
            let number = |key: &str, value: &At<f64>, range| {
                self.number(&format!("{path}.{key}"), Some(value), 0.0, range)
            };
            let counts = w.counts_per_revolution.as_ref();
            let wheel = Wheel {
                x: number("x", &w.x, Range::Any),
                y: number("y", &w.y, Range::Any),
                radius: number("radius", &w.radius, Range::Positive),
                roller_angle: number("roller_angle_deg", &w.roller_angle_deg, Range::Any)
                    .to_radians(),
                counts_per_revolution: counts
                    .map(|counts| number("counts_per_revolution", counts, Range::Positive)),
            };
            if (wheel.x + wheel.y + wheel.radius + wheel.roller_angle).is_nan() {
                return Err(Reported);
            }
            kinematics::Wheel::new(wheel.x, wheel.y, 0.0, wheel.roller_angle, wheel.radius)
                .map_err(|error| self.refuse(raw, &path, &error.to_string(), "fix this wheel"))?;
            Ok(wheel)
        };
        let all = [
            one("front_left", &wheels.front_left),
            one("front_right", &wheels.front_right),
            one("rear_left", &wheels.rear_left),
            one("rear_right", &wheels.rear_right),
        ];
        let [front_left, front_right, rear_left, rear_right] = all;
        let all = [front_left?, front_right?, rear_left?, rear_right?];
        let built = all.map(|w| kinematics::Wheel::new(w.x, w.y, 0.0, w.roller_angle, w.radius));
        let built: Result<Vec<_>, _> = built.into_iter().collect();
        let robot = built
            .ok()
            .and_then(|wheels| <[kinematics::Wheel; 4]>::try_from(wheels).ok());
        let platform = robot.map(|wheels| kinematics::Platform::new(&wheels));
        if let Some(Err(error)) = platform {
            let remedy = "fix positions and roller angles";
            return Err(self.refuse(&wheels.front_left, &path, &error.to_string(), remedy));
        }
        Ok(Some(all))
    }
}

impl Checker<'_> {
    /// What an entry knows of its rollers, else what `[robot]` knows, else nothing.
    fn known_rollers(
        &self,
        field: &Member<'_, '_>,
        e: &schema::Entry,
        d: &schema::Defaults,
    ) -> Checked<Option<Rollers>> {
        let (raw, path) = match (&e.rollers, &d.rollers) {
            (Some(own), _) => (own, format!("robots[{}].rollers", field.index)),
            (None, Some(shared)) => (shared, "robot.rollers".to_owned()),
            (None, None) => return Ok(None),
        };
        let rollers = raw.get_ref();
        let count = rollers.count.get_ref();
        let count = match u8::try_from(*count) {
            Ok(count @ 3..=64) => count,
            _ => {
                let (path, problem) = (format!("{path}.count"), format!("is {count}"));
                let remedy = "give the number of rollers of a wheel, 3 to 64";
                return Err(self.refuse(&rollers.count, &path, &problem, remedy));
            }
        };
        let pitch = 360.0 / f64::from(count);
        let mut phases = [0.0; 4];
        if let Some(given) = &rollers.phases_deg {
            for (phase, degrees) in phases.iter_mut().zip(given.get_ref()) {
                if degrees.abs() > pitch / 2.0 + 1e-6 || degrees.is_nan() {
                    let (path, problem) = (format!("{path}.phases_deg"), format!("has {degrees}"));
                    let remedy = format!(
                        "give angles within half of the {pitch} degrees from roller to roller; \
                         `omnibus calibrate --phase` finds them"
                    );
                    return Err(self.refuse(given, &path, &problem, &remedy));
                }
                *phase = degrees.to_radians() as f32;
            }
        }
        let index_tolerance = match &rollers.index_tolerance {
            None => None,
            Some(given) => match u16::try_from(*given.get_ref()) {
                Ok(counts @ 1..=10_000) => Some(counts),
                _ => {
                    let path = format!("{path}.index_tolerance");
                    let problem = format!("is {}", given.get_ref());
                    let remedy = "give encoder counts, 1 to 10000: the play between encoder and \
                        wheel, and two";
                    return Err(self.refuse(given, &path, &problem, remedy));
                }
            },
        };
        let axis = |key: &str, value: &Value| -> Checked<f32> {
            let Some(value) = value else { return Ok(1.0) };
            let coefficient = *value.get_ref();
            if !(0.5..=2.0).contains(&coefficient) {
                let (path, problem) = (format!("{path}.{key}"), format!("is {coefficient}"));
                let remedy = "give 0.5 to 2; 1 is no compensation, 0 would delete the axis";
                return Err(self.refuse(value, &path, &problem, remedy));
            }
            Ok(coefficient as f32)
        };
        let compensation = VelocityCompensation::new(
            axis("longitudinal", &rollers.longitudinal)?,
            axis("lateral", &rollers.lateral)?,
            axis("yaw", &rollers.yaw)?,
        )
        .map_err(|error| self.refuse(raw, &path, &error.to_string(), "fix the coefficients"))?;
        Ok(Some(Rollers {
            count,
            phases,
            index_tolerance,
            compensation,
        }))
    }
}

/// The most rows of one compensation table: what a robot keeps.
const ROWS: usize = 8;

impl Checker<'_> {
    /// The tables of an entry, else those of `[robot]`, else none. They must be what a robot takes:
    /// rising speeds, coefficients from 0.5 to 1.9999, and tables that can be inverted.
    fn compensation_table(
        &self,
        field: &Member<'_, '_>,
        e: &schema::Entry,
        d: &schema::Defaults,
        constant: &VelocityCompensation,
    ) -> Checked<CompensationTable> {
        let (raw, path) = match (&e.compensation.table, &d.compensation.table) {
            (Some(own), _) => (own, format!("robots[{}].compensation.table", field.index)),
            (None, Some(shared)) => (shared, "robot.compensation.table".to_owned()),
            (None, None) => return Ok(CompensationTable::default()),
        };
        let table = raw.get_ref();
        let version = u32::try_from(*table.version.get_ref()).map_err(|_| {
            let problem = format!("is {}", table.version.get_ref());
            let remedy = "give a whole number, 0 to 4294967295, such as the date 20261121";
            self.refuse(&table.version, &format!("{path}.version"), &problem, remedy)
        })?;
        let pairs = |key: &str, rows: &[At<[f64; 2]>]| -> Checked<Vec<Row>> {
            let row = |[speed, coefficient]: [f64; 2]| (speed, [coefficient, coefficient]);
            let rows = self.rows(&format!("{path}.{key}"), rows, row)?;
            Ok(rows.into_iter().map(ObliqueRow::along).collect())
        };
        let longitudinal = pairs("longitudinal", &table.longitudinal)?;
        let lateral = pairs("lateral", &table.lateral)?;
        let yaw = pairs("yaw", &table.yaw)?;
        let oblique = self.rows(&format!("{path}.oblique"), &table.oblique, |[s, x, y]| {
            (s, [x, y])
        })?;

        let axis = |key: &str, rows: &[Row], constant: f32| {
            let pairs = rows.iter().map(|row| row.pair());
            AxisTable::<ROWS>::filled(pairs, constant).map_err(|error| {
                let problem = error.to_string();
                self.refuse(raw, &format!("{path}.{key}"), &problem, "fix the rows")
            })
        };
        let ahead = axis("longitudinal", &longitudinal, constant.longitudinal())?;
        let aside = axis("lateral", &lateral, constant.lateral())?;
        let about = axis("yaw", &yaw, constant.yaw())?;
        if !oblique.is_empty() {
            let x: Vec<_> = oblique.iter().map(|row| row.along()).collect();
            let y: Vec<_> = oblique.iter().map(|row| row.across()).collect();
            let (x, y) = (axis("oblique", &x, 1.0)?, axis("oblique", &y, 1.0)?);
            DirectionalCompensation::new(ahead, aside, x, y, about).map_err(|error| {
                let problem = error.to_string();
                self.refuse(raw, &format!("{path}.oblique"), &problem, "fix the rows")
            })?;
        }
        Ok(CompensationTable {
            version,
            longitudinal,
            lateral,
            oblique,
            yaw,
        })
    }

    /// Rows of speed and two coefficients, each within what a robot takes.
    fn rows<const N: usize>(
        &self,
        path: &str,
        rows: &[At<[f64; N]>],
        split: impl Fn([f64; N]) -> (f64, [f64; 2]),
    ) -> Checked<Vec<ObliqueRow>> {
        if let Some(over) = rows.get(ROWS) {
            let problem = format!("has {} rows", rows.len());
            return Err(self.refuse(over, path, &problem, "keep at most 8"));
        }
        let mut before = 0;
        let mut out = Vec::with_capacity(rows.len());
        for (i, row) in rows.iter().enumerate() {
            let (speed, coefficients) = split(*row.get_ref());
            let path = format!("{path}[{i}]");
            // The robot has speeds in steps of 0.1 mm/s or 0.1 mrad/s.
            let steps = (speed * 1e4).round() as u32;
            if steps <= before || speed > 6.5 {
                let problem = format!("has speed {speed}");
                let remedy = "give speeds up to 6.5 that rise from row to row by 0.0001 or more";
                return Err(self.refuse(row, &path, &problem, remedy));
            }
            before = steps;
            if let Some(bad) = coefficients.iter().find(|c| !(0.5..=1.9999).contains(*c)) {
                let problem = format!("has coefficient {bad}");
                let remedy = "give 0.5 to 1.9999; 1 is no compensation, 0 would delete the axis";
                return Err(self.refuse(row, &path, &problem, remedy));
            }
            let [longitudinal, lateral] = coefficients.map(|c| c as f32);
            out.push(ObliqueRow {
                speed: speed as f32,
                longitudinal,
                lateral,
            });
        }
        Ok(out)
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
    /// The name of a field. One that came from `[robot]` is named as such: that is where it has to
    /// be corrected.
    fn name<T>(&self, key: &str, own: &Option<At<T>>, shared: &Option<At<T>>) -> String {
        if own.is_none() && shared.is_some() {
            format!("robot.{key}")
        } else {
            format!("robots[{}].{key}", self.index)
        }
    }

    /// A number from the entry, else from `[robot]`, else the default; NaN where it is wrong or
    /// missing, which is reported.
    fn number(
        &self,
        key: &str,
        own: &Value,
        shared: &Value,
        fallback: Option<f64>,
        range: Range,
    ) -> f32 {
        let field = self.name(key, own, shared);
        match (own.as_ref().or(shared.as_ref()), fallback) {
            (Some(value), _) => self.checker.number(&field, Some(value), 0.0, range),
            (None, Some(fallback)) => self.checker.number(&field, None, fallback, range),
            (None, None) => {
                self.missing(key);
                f32::NAN
            }
        }
    }

    /// Reports a key that neither this entry nor `[robot]` has; of several robots the first.
    fn missing(&self, key: &str) {
        let shared = format!("robot.{key}");
        let field = format!("robots[{}].{key}", self.index);
        if self.checker.is_settled(&shared) || self.checker.is_settled(&field) {
            return;
        }
        let remedy = "give it in `[robot]` or in this entry";
        self.checker.report(self.at, &field, "is missing", remedy);
        self.checker.settle(shared);
    }

    /// The wheels whose direction is -1, one bit each.
    fn reversed(
        &self,
        key: &str,
        own: &Option<At<[f64; 4]>>,
        shared: &Option<At<[f64; 4]>>,
    ) -> Option<u8> {
        let given = own.as_ref().or(shared.as_ref())?.get_ref();
        if given.iter().any(|direction| direction.abs() != 1.0) {
            let problem = format!("is {given:?}");
            self.refuse(key, own, shared, &problem, "give 1 or -1 for each wheel");
        }
        let bits = (0..).zip(given).filter(|(_, direction)| **direction < 0.0);
        Some(bits.map(|(wheel, _)| 1 << wheel).sum())
    }

    fn refuse<T>(
        &self,
        key: &str,
        own: &Option<At<T>>,
        shared: &Option<At<T>>,
        problem: &str,
        remedy: &str,
    ) -> Reported {
        let place = own.as_ref().or(shared.as_ref());
        let at = place.map_or(self.at, |p| p.span().start);
        let name = self.name(key, own, shared);
        self.checker.report(at, &name, problem, remedy)
    }
}
