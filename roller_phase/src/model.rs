//! The fit's model of a robot on its rollers: its displacement while its wheels turn, for assumed
//! phases.
//!
//! Two things change while a roller sweeps by the angle t, both as in `docs/kinematics.md`: the
//! wheel's row of J has its sideways part multiplied by `sec t`, and the point of contact wanders
//! along the wheel's axle by `rho tan t cot g`, `rho` being the distance between the wheel's axle
//! and a roller's. The wander acts on turns only and is odd where the secant is even, so a model
//! without it finds phases that are off by degrees as soon as the robot turns. Both are averaged
//! over an interval in closed form.
//!
//! A loaded wheel touches the floor over some angle, so a roller takes over gradually. While the
//! edge between two rollers is within half of that angle of the lowest point, both carry, and the
//! wheel moves by the mean of both, weighted by the load on either side of the edge, a parabola.
//! How far a wheel settles is not known, so the angle is fitted as well.
//!
//! Wheels that contradict each other share the slip: the twist is the one with the least squared
//! slip along the rollers' axles, as of contacts whose force is proportional to their slip. Across
//! their axles rollers resist being turned, some thousandths as stiffly. This pulls at the
//! wandering point of contact: without it, phases are off by a tenth of a degree, front and rear in
//! opposite directions.

use kinematics::{FourWheelGeometry, Rollers};

use crate::solve::invert_three;

/// Points at which a wave is averaged.
const POINTS: u32 = 64;
/// Half the least turn of a wheel in an interval, rad: a wheel that stands still is averaged over
/// that.
const STANDING: f64 = 1e-6;

/// Unknown properties that all wheels' rollers share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shape {
    /// Between a wheel's axle and its rollers', m.
    pub distance: f64,
    /// From a wheel's lowest place to the ends of where it touches the floor, rad; its sign says
    /// nothing.
    pub footprint: f64,
}

/// What a wheel's rollers do in an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lean {
    /// Mean secant of the sweep.
    secant: f64,
    /// Mean tangent of the sweep, times the distance between the axles, m.
    wander: f64,
}

/// Integrals over the wheel's angle.
#[derive(Clone, Copy)]
struct Shared {
    /// Of the further roller's share times the angle from the edge, over all edges that have
    /// passed, rad^2.
    sum: f64,
    /// Of the share, against the sense before an edge and with it behind, rad.
    ends: f64,
    /// Of the share times the angle, likewise, rad^2.
    ways: f64,
}

/// Columns: m, m, rad for a radian of each wheel.
pub(crate) type Back = [[f64; 4]; 3];

pub(crate) struct Model {
    pub rollers: Rollers<f64>,
    straight: [[f64; 3]; 4],
    across: [[f64; 3]; 4],
    /// m.
    pub wheel_radius: f64,
}

impl Model {
    /// `None` for a geometry that no robot has.
    pub fn new(geometry: &FourWheelGeometry<f64>, rollers: Rollers<f64>) -> Option<Self> {
        let parts = geometry.wheels().ok()?.map(|wheel| wheel.jacobian_parts());
        Some(Self {
            rollers,
            straight: parts.map(|(straight, _)| straight),
            across: parts.map(|(_, across)| across),
            wheel_radius: geometry.wheel_radius(),
        })
    }

    /// Between two wheel angles, for a phase.
    pub fn lean(&self, from: f64, to: f64, phase: f64, shape: &Shape) -> Lean {
        let middle = 0.5 * (from + to);
        let half = (0.5 * (to - from).abs()).max(STANDING);
        let (from, to) = (middle - half, middle + half);
        let sweep = |angle| self.rollers.sweep(angle, phase);
        // The integral of tan t is -ln cos t, which is the same at both ends of a roller.
        let tangent = (sweep(from).cos() / sweep(to).cos()).ln();
        let shared = self.shared(to, phase, shape.footprint.abs());
        let before = self.shared(from, phase, shape.footprint.abs());
        let (sin, cos) = (0.5 * self.rollers.pitch()).sin_cos();
        let ratio = self.rollers.mean_lateral_ratio_between(from, to, phase)
            - 2.0 * sin * (shared.sum - before.sum) / (to - from);
        let tangent = tangent + 2.0 * sin / cos * (shared.ends - before.ends)
            - (shared.ways - before.ways) / (cos * cos);
        Lean {
            secant: 1.0 / ratio,
            wander: shape.distance * tangent / (to - from),
        }
    }

    /// What the roller that is further away has carried up to a wheel angle. At the angle e from
    /// where two meet it carries `1/2 - 3/4 (x - x^3/3)` with `x = |e| / footprint`. Its cosine is
    /// less than the nearer one's by `2 sin(a) |e|`, a being half a pitch. Its tangent, that of its
    /// end, is on the other side, `2 tan(a) - |e| / cos(a)^2` away.
    fn shared(&self, angle: f64, phase: f64, footprint: f64) -> Shared {
        let place = (angle + phase) / self.rollers.pitch() + 0.5;
        let e = (place - place.round()) * self.rollers.pitch();
        let x = (e.abs() / footprint.max(f64::MIN_POSITIVE)).min(1.0);
        let ways =
            |x: f64| footprint.powi(2) * (x.powi(2) / 4.0 - x.powi(3) / 4.0 + x.powi(5) / 20.0);
        Shared {
            sum: 2.0 * place.round() * ways(1.0) + ways(x).copysign(e),
            ends: footprint * (x / 2.0 - 3.0 / 8.0 * x.powi(2) + x.powi(4) / 16.0),
            ways: ways(x),
        }
    }

    /// Of a wheel that does not ripple.
    pub fn mean(&self) -> Lean {
        Lean {
            secant: 1.0 / self.rollers.mean_lateral_ratio(),
            wander: 0.0,
        }
    }

    /// From wheel angles to the displacement, for rollers that resist their own turning by this
    /// share of the contacts' stiffness.
    pub fn back(&self, leans: &[Lean; 4], drag: f64) -> Option<Back> {
        let mut normal = [0.0; 9];
        let mut right = [[0.0; 4]; 3];
        for (wheel, lean) in leans.iter().enumerate() {
            let (straight, across) = (self.straight[wheel], self.across[wheel]);
            let aside = lean.secant * across[1];
            // Where the wheel touches the floor, and the roller's axle there, of length 1.
            let x = across[2] / across[1];
            let y = (lean.wander * across[1] - straight[2]) / straight[0];
            let length = straight[0].hypot(aside);
            let (ahead, left) = (straight[0] / length, aside / length);
            for (ahead, left, stiffness) in [(ahead, left, 1.0), (-left, ahead, drag)] {
                let row = [ahead, left, x * left - y * ahead];
                for i in 0..3 {
                    for j in 0..3 {
                        normal[3 * i + j] += stiffness * row[i] * row[j];
                    }
                    right[i][wheel] += stiffness * row[i] * ahead * self.wheel_radius;
                }
            }
        }
        if !invert_three(&mut normal) {
            return None;
        }
        Some(std::array::from_fn(|axis| {
            std::array::from_fn(|wheel| {
                (0..3).map(|n| normal[3 * axis + n] * right[n][wheel]).sum()
            })
        }))
    }

    /// What the cosine and the sine of a wheel's roller angle `n phase` change of the displacement
    /// `moved`, to first order: the fundamentals of secant and tangent, that wheel standing `n
    /// angle` further. (The linear start of the fit.)
    pub fn fundamentals(
        &self,
        back: &Back,
        moved: &[f64; 3],
        (wheel, angle, distance): (usize, f64, f64),
    ) -> [[f64; 3]; 2] {
        let across = self.across[wheel];
        let sideways: f64 = across.iter().zip(moved).map(|(a, m)| a * m).sum();
        let turning = -across[1] * distance * moved[2];
        let (secant, tangent) = self.waves();
        let (sin, cos) = (angle * std::f64::consts::TAU / self.rollers.pitch()).sin_cos();
        let cosine = secant * cos * sideways + tangent * sin * turning;
        let sine = tangent * cos * turning - secant * sin * sideways;
        [cosine, sine].map(|change| [0, 1, 2].map(|axis| -back[axis][wheel] * change))
    }

    /// Amplitudes of the fundamental of the secant (a cosine) and of the tangent (a sine), a pitch
    /// being its period.
    fn waves(&self) -> (f64, f64) {
        let (mut even, mut odd) = (0.0, 0.0);
        for point in 0..POINTS {
            let share = (f64::from(point) + 0.5) / f64::from(POINTS) - 0.5;
            let sweep = share * self.rollers.pitch();
            let (sin, cos) = (share * std::f64::consts::TAU).sin_cos();
            even += cos / sweep.cos();
            odd += sin * sweep.tan();
        }
        let scale = 2.0 / f64::from(POINTS);
        (even * scale, odd * scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cosine and tangent at a wheel angle as the two rollers on the floor make them; `a` is half a
    /// pitch.
    fn by_shares(angle: f64, a: f64, footprint: f64) -> (f64, f64) {
        let place = (angle / (2.0 * a)).round();
        let sweep = angle - place * 2.0 * a;
        let ahead = a - sweep.abs();
        let share = if ahead < footprint {
            let x = ahead / footprint;
            0.5 - 0.75 * (x - x.powi(3) / 3.0)
        } else {
            0.0
        };
        let cos = (1.0 - share) * sweep.cos() + share * (a + ahead).cos();
        let tan = (1.0 - share) * sweep.tan() - share * a.tan().copysign(sweep);
        (cos, tan)
    }

    /// Intervals anywhere, either way, with an edge in them and without, shorter and longer than a
    /// roller, against the mean over small steps. The nearer roller's cosine and tangent are taken
    /// for straight within the footprint, which leaves a tenth of its square.
    #[test]
    fn an_interval_has_the_mean_of_what_carries_in_it() {
        const STEPS: u32 = 20_000;
        let geometry = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f64.to_radians()).unwrap();
        for (count, footprint) in [(8, 0.0663), (12, 0.04), (8, 0.0)] {
            let rollers = Rollers::new(count).unwrap();
            let a = 0.5 * rollers.pitch();
            let model = Model::new(&geometry, rollers).unwrap();
            let shape = Shape {
                distance: 1.0,
                footprint,
            };
            for n in 0..40 {
                let from = 0.17 * f64::from(n) - 3.0;
                for turned in [0.02, -0.05, 0.13, a, -3.1 * a] {
                    let phase = 0.1;
                    let lean = model.lean(from - phase, from - phase + turned, phase, &shape);
                    let (mut cos, mut tan) = (0.0, 0.0);
                    for step in 0..STEPS {
                        let part = (f64::from(step) + 0.5) / f64::from(STEPS);
                        let (c, t) = by_shares(from + part * turned, a, footprint);
                        cos += c / f64::from(STEPS);
                        tan += t / f64::from(STEPS);
                    }
                    let off = [1.0 / lean.secant - cos, lean.wander - tan];
                    let bound = 1e-4 + 0.1 * footprint * footprint;
                    assert!(
                        off.iter().all(|off| off.abs() < bound),
                        "{count} {footprint} {from} {turned}: {off:?}"
                    );
                }
            }
        }
    }
}
