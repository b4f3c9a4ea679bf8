//! The rules of the `[simulation]` table.
//!
//! What a plant does not know is refused when it is given all the same: a file that says how
//! slippery the floor is means a floor.

use std::ops::RangeInclusive;

use crate::check::{Checked, Checker, Reported, default};
use crate::model::Robot;
use crate::number::shown;
use crate::schema::{self, At, PlantName, TablesName};
use crate::simulation::{
    Battery, Contact, EncoderFault, EncoderNoise, Gyro, Patch, Payload, Plant, PoseNoise,
    Simulation, Tables,
};

/// Largest crystal error, ppm: ten times that of the worst part one can buy.
const CRYSTAL_PPM_LIMIT: f64 = 1000.0;

/// Ranges of numbers.
const ANY: RangeInclusive<f64> = f64::MIN..=f64::MAX;
const NOT_NEGATIVE: RangeInclusive<f64> = 0.0..=f64::MAX;
const POSITIVE: RangeInclusive<f64> = f64::MIN_POSITIVE..=f64::MAX;
/// Voltages of a battery, V.
const VOLTS: RangeInclusive<f64> = f64::MIN_POSITIVE..=1e3;
/// Ends of a piece of the floor, m.
const FLOOR: RangeInclusive<f64> = -1e6..=1e6;
const SHARE: RangeInclusive<f64> = 0.0..=1.0;
/// Looks at the plant in a second, which samples of a gyro divide.
const GYRO_HZ: u32 = 4000;
/// Play of a gear, degrees: more than that is a broken one.
const BACKLASH: RangeInclusive<f64> = 0.0..=10.0;

impl Checker<'_> {
    pub fn simulation(
        &self,
        raw: schema::Simulation,
        robots: Option<&[Robot]>,
    ) -> Checked<Simulation> {
        let plant = match raw
            .plant
            .as_ref()
            .map_or(PlantName::Table, |p| *p.get_ref())
        {
            PlantName::Table => Plant::Table(
                match raw
                    .tables
                    .as_ref()
                    .map_or(TablesName::Virtual, |t| *t.get_ref())
                {
                    TablesName::Virtual => Tables::Virtual,
                    TablesName::Physical => Tables::Physical,
                    TablesName::Ideal => Tables::Ideal,
                },
            ),
            PlantName::Contact => Plant::Contact {
                rollers: self.rollers(raw.rollers.as_ref())?,
            },
            PlantName::External => Plant::External {
                address: self.address(&raw)?,
            },
        };
        let contact = self.contact(&raw, &plant);
        let gyro = self.gyro(&raw.gyro);
        let crystal_ppm = self.crystals(raw.crystal_ppm, robots.map(<[_]>::len));
        Ok(Simulation {
            rigid: raw.rigid.as_ref().is_none_or(|r| *r.get_ref()),
            plant,
            driver: raw.driver.map(|driver| *driver.get_ref()),
            battery: raw.battery.map(|b| self.battery(&b)).transpose()?,
            backlash: self
                .real(
                    "simulation.backlash_deg",
                    raw.backlash_deg.as_ref(),
                    0.0,
                    &BACKLASH,
                )?
                .to_radians(),
            encoder_noise: EncoderNoise {
                lost: self.real(
                    "simulation.encoder.lost",
                    raw.encoder.lost.as_ref(),
                    0.0,
                    &SHARE,
                )?,
                extra_per_s: self.real(
                    "simulation.encoder.extra_per_s",
                    raw.encoder.extra_per_s.as_ref(),
                    0.0,
                    &NOT_NEGATIVE,
                )?,
            },
            encoder_faults: raw
                .encoder_faults
                .iter()
                .enumerate()
                .map(|(n, fault)| self.encoder_fault(n, fault, robots))
                .collect::<Checked<_>>()?,
            pose_noise: PoseNoise {
                position: 1e-3
                    * self.real(
                        "simulation.pose_noise.position_mm",
                        raw.pose_noise.position_mm.as_ref(),
                        0.0,
                        &NOT_NEGATIVE,
                    )?,
                heading: 1e-3
                    * self.real(
                        "simulation.pose_noise.heading_mrad",
                        raw.pose_noise.heading_mrad.as_ref(),
                        0.0,
                        &NOT_NEGATIVE,
                    )?,
            },
            gyro: gyro?,
            contact: contact?,
            crystal_ppm: crystal_ppm?,
            seed: match raw.seed {
                None => 1,
                Some(seed) => u64::try_from(*seed.get_ref()).map_err(|_| {
                    self.refuse(
                        &seed,
                        "simulation.seed",
                        &format!("is {}", seed.get_ref()),
                        "give a whole number, 0 or more",
                    )
                })?,
            },
        })
    }

    /// A number of a simulated world, which stays an f64.
    fn real(
        &self,
        field: &str,
        raw: Option<&At<f64>>,
        fallback: f64,
        range: &RangeInclusive<f64>,
    ) -> Checked<f64> {
        let Some(raw) = raw else {
            return Ok(fallback);
        };
        let value = *raw.get_ref();
        if value.is_finite() && range.contains(&value) {
            return Ok(value);
        }
        let remedy = if *range.end() == f64::MAX {
            if *range.start() == 0.0 {
                "give 0 or a positive number".to_owned()
            } else if *range.start() == f64::MIN {
                "give a finite number".to_owned()
            } else {
                "give a number greater than 0".to_owned()
            }
        } else {
            format!("give a number from {} to {}", range.start(), range.end())
        };
        Err(self.refuse(raw, field, &format!("is {}", shown(value)), &remedy))
    }

    fn gyro(&self, raw: &schema::Gyro) -> Checked<Gyro> {
        let usual = Gyro::default();
        let rate_hz = match &raw.rate_hz {
            None => usual.rate_hz,
            Some(rate) => u32::try_from(*rate.get_ref())
                .ok()
                .filter(|hz| (1..=GYRO_HZ).contains(hz) && GYRO_HZ.is_multiple_of(*hz))
                .ok_or_else(|| {
                    self.refuse(
                        rate,
                        "simulation.gyro.rate_hz",
                        &format!("is {}", rate.get_ref()),
                        "give a divisor of 4000, for example 100 or 200",
                    )
                })?,
        };
        // A value in the file's unit, that being `unit` of ours; the usual one is not turned back
        // and forth.
        let real = |key: &str, raw: Option<&At<f64>>, usual: f64, unit: f64, range| match raw {
            None => Ok(usual),
            Some(_) => Ok(unit * self.real(&format!("simulation.gyro.{key}"), raw, 0.0, range)?),
        };
        let degree = 1_f64.to_radians();
        let (noise, drift) = (raw.noise_dps_rthz.as_ref(), raw.drift_dps_rts.as_ref());
        let (bias, delay) = (raw.bias_dps.as_ref(), raw.delay_ms.as_ref());
        Ok(Gyro {
            rate_hz,
            noise: real("noise_dps_rthz", noise, usual.noise, degree, &NOT_NEGATIVE)?,
            bias: real("bias_dps", bias, usual.bias, degree, &ANY)?,
            drift: real("drift_dps_rts", drift, usual.drift, degree, &NOT_NEGATIVE)?,
            delay: real("delay_ms", delay, usual.delay, 1e-3, &NOT_NEGATIVE)?,
        })
    }

    fn battery(&self, raw: &At<schema::Battery>) -> Checked<Battery> {
        let battery = raw.get_ref();
        let capacity_ah = battery
            .capacity_ah
            .as_ref()
            .map(|c| self.real("simulation.battery.capacity_ah", Some(c), 0.0, &POSITIVE))
            .transpose()?;
        Ok(Battery {
            resistance: self.real(
                "simulation.battery.resistance",
                Some(&battery.resistance),
                0.0,
                &NOT_NEGATIVE,
            )?,
            capacity_ah,
            charge: self.real(
                "simulation.battery.charge",
                battery.charge.as_ref(),
                1.0,
                &SHARE,
            )?,
            curve: self.battery_curve(battery.curve.as_ref())?,
        })
    }

    fn battery_curve(&self, raw: Option<&At<schema::Curve>>) -> Checked<Vec<(f64, f64)>> {
        const FIELD: &str = "simulation.battery.curve";
        let rows = raw.map_or(&[][..], |curve| curve.get_ref());
        let mut curve: Vec<(f64, f64)> = Vec::with_capacity(rows.len());
        for row in rows {
            let (charge, volts) = *row.get_ref();
            let shown = format!("has the row [{charge}, {volts}]");
            if !(SHARE.contains(&charge) && VOLTS.contains(&volts)) {
                let remedy = "give rows [charge 0 to 1, volts above 0 up to 1000]";
                return Err(self.refuse(row, FIELD, &shown, remedy));
            }
            if curve.last().is_some_and(|(before, _)| *before >= charge) {
                let remedy = "give the rows in order of rising charge";
                return Err(self.refuse(row, FIELD, &shown, remedy));
            }
            curve.push((charge, volts));
        }
        Ok(curve)
    }

    fn encoder_fault(
        &self,
        index: usize,
        raw: &schema::EncoderFault,
        robots: Option<&[Robot]>,
    ) -> Checked<EncoderFault> {
        let field = format!("simulation.encoder_faults[{index}]");
        let node = *raw.node.get_ref();
        let robots = robots.ok_or(Reported)?;
        let robot = robots.iter().position(|r| i64::from(r.node) == node);
        let robot = robot.ok_or_else(|| {
            self.refuse(
                &raw.node,
                &format!("{field}.node"),
                &format!("is {node}, which no robot has"),
                "give the node of a robot in this file",
            )
        })?;
        Ok(EncoderFault {
            robot,
            wheel: raw.wheel,
            kind: raw.kind,
            at: self.real(&format!("{field}.at"), raw.at.as_ref(), 0.0, &NOT_NEGATIVE)?,
        })
    }

    fn contact(&self, raw: &schema::Simulation, plant: &Plant) -> Checked<Contact> {
        let given = [
            ("friction", raw.friction.as_ref().map(|v| v.span().start)),
            (
                "robot_mass",
                raw.robot_mass.as_ref().map(|v| v.span().start),
            ),
            (
                "wheel_inertia",
                raw.wheel_inertia.as_ref().map(|v| v.span().start),
            ),
            (
                "scattered_rollers",
                raw.scattered_rollers.as_ref().map(|v| v.span().start),
            ),
            ("payload", raw.payload.as_ref().map(|v| v.span().start)),
            ("floor", raw.floor.first().map(|v| v.span().start)),
        ];
        if !matches!(plant, Plant::Contact { .. })
            && let Some((key, at)) = given.iter().find_map(|(key, at)| Some((key, (*at)?)))
        {
            return Err(self.report(
                at,
                &format!("simulation.{key}"),
                "has no effect on this plant",
                "set plant = \"contact\", or remove it",
            ));
        }
        let positive = |key: &str, raw: Option<&At<f64>>| {
            raw.map(|value| self.real(&format!("simulation.{key}"), Some(value), 0.0, &POSITIVE))
                .transpose()
        };
        Ok(Contact {
            friction: positive("friction", raw.friction.as_ref())?,
            robot_mass: positive("robot_mass", raw.robot_mass.as_ref())?,
            wheel_inertia: positive("wheel_inertia", raw.wheel_inertia.as_ref())?,
            scattered: raw.scattered_rollers.as_ref().is_some_and(|s| *s.get_ref()),
            payload: raw
                .payload
                .as_ref()
                .map(|payload| self.payload(payload, raw.rigid.as_ref()))
                .transpose()?,
            floor: raw
                .floor
                .iter()
                .enumerate()
                .map(|(n, patch)| self.patch(n, patch.get_ref()))
                .collect::<Checked<_>>()?,
        })
    }

    fn payload(&self, raw: &At<schema::Payload>, rigid: Option<&At<bool>>) -> Checked<Payload> {
        const FIELD: &str = "simulation.payload";
        if rigid.is_some_and(|rigid| !*rigid.get_ref()) {
            let remedy = "set rigid = true, or remove it";
            return Err(self.refuse(raw, FIELD, "lies on robots that are not connected", remedy));
        }
        let payload = raw.get_ref();
        let place =
            |key: &str, raw: Option<&At<f64>>| self.real(&format!("{FIELD}.{key}"), raw, 0.0, &ANY);
        Ok(Payload {
            mass: self.real(
                &format!("{FIELD}.mass"),
                Some(&payload.mass),
                0.0,
                &POSITIVE,
            )?,
            x: place("x", payload.x.as_ref())?,
            y: place("y", payload.y.as_ref())?,
        })
    }

    fn patch(&self, index: usize, raw: &schema::Patch) -> Checked<Patch> {
        let field = format!("simulation.floor[{index}]");
        let span = |key: &str, raw: &At<(f64, f64)>| {
            let (from, to) = *raw.get_ref();
            if FLOOR.contains(&from) && FLOOR.contains(&to) && from < to {
                return Ok((from, to));
            }
            Err(self.refuse(
                raw,
                &format!("{field}.{key}"),
                &format!("is [{from}, {to}]"),
                "give [from, to] in metres, the smaller first, from -1e6 to 1e6",
            ))
        };
        Ok(Patch {
            x: span("x", &raw.x)?,
            y: span("y", &raw.y)?,
            friction: self.real(
                &format!("{field}.friction"),
                Some(&raw.friction),
                0.0,
                &POSITIVE,
            )?,
        })
    }

    fn rollers(&self, raw: Option<&At<i64>>) -> Checked<u8> {
        let Some(rollers) = raw else {
            return Ok(default::ROLLERS);
        };
        u8::try_from(*rollers.get_ref())
            .ok()
            .filter(|n| (3..=64).contains(n))
            .ok_or_else(|| {
                let problem = format!("is {}", rollers.get_ref());
                self.refuse(
                    rollers,
                    "simulation.rollers",
                    &problem,
                    "give the rollers of one wheel, 3 to 64",
                )
            })
    }

    fn address(&self, raw: &schema::Simulation) -> Checked<String> {
        const REMEDY: &str = "give the other simulator's `host:port`";
        match (&raw.address, &raw.plant) {
            (Some(address), _) if address.get_ref().contains(':') => Ok(address.get_ref().clone()),
            (Some(address), _) => {
                let problem = format!("\"{}\" has no port", address.get_ref());
                Err(self.refuse(address, "simulation.address", &problem, REMEDY))
            }
            (None, plant) => {
                let at = plant.as_ref().map_or(0, |p| p.span().start);
                Err(self.report(at, "simulation.address", "is missing", REMEDY))
            }
        }
    }

    fn crystals(&self, raw: Option<At<Vec<At<f64>>>>, robots: Option<usize>) -> Checked<Vec<f64>> {
        const FIELD: &str = "simulation.crystal_ppm";
        let Some(list) = raw else {
            return Ok(vec![0.0; robots.unwrap_or(0)]);
        };
        if let Some(robots) = robots
            && list.get_ref().len() != robots
        {
            let problem = format!("has {} values for {robots} robots", list.get_ref().len());
            return Err(self.refuse(
                &list,
                FIELD,
                &problem,
                "give one value per robot, in their order",
            ));
        }
        list.get_ref()
            .iter()
            .map(|value| {
                let ppm = *value.get_ref();
                if ppm.abs() <= CRYSTAL_PPM_LIMIT {
                    Ok(ppm)
                } else {
                    Err(self.refuse(
                        value,
                        FIELD,
                        &format!("is {}", shown(ppm)),
                        "give an error between -1000 and 1000 ppm",
                    ))
                }
            })
            .collect()
    }
}
