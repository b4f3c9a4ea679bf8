//! A robot on its rollers as the fit sees it: how far it goes while its wheels turn, for assumed phases.
//!
//! Two things change while a roller sweeps by the angle t, both as in `docs/kinematics.md`: the wheel's row of J has its
//! sideways part multiplied by `sec t`, and the point of contact wanders along the wheel's axle by
//! `rho tan t cot g`, `rho` being the distance between the wheel's axle and a roller's. The wander acts on turns only
//! and is odd where the secant is even, so whoever leaves it out finds phases that are off by degrees as soon as the
//! robot turns. Both enter as means over an interval, in closed form.
//!
//! Wheels that contradict each other share the slip: the twist is least squares over the slip along the rollers' axles,
//! which is what contacts do whose force grows in proportion to their slip. Across their axles rollers resist being
//! turned, some thousandths as stiffly. That is small, but it pulls at the wandering point of contact: left out, it
//! moves front wheels' phases one way and rear wheels' the other, by a tenth of a degree.

use kinematics::{FourWheelGeometry, Rollers};

use super::solve::invert;

/// Points at which a wave is averaged.
const POINTS: u32 = 64;

/// What a wheel's rollers do in an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lean {
    /// Mean secant of the sweep.
    secant: f64,
    /// Mean tangent of the sweep, times the distance between the axles, m.
    wander: f64,
}

/// Columns: m, m, rad for a radian of each wheel.
pub(super) type Back = [[f64; 4]; 3];

pub(super) struct Model {
    pub rollers: Rollers<f64>,
    straight: [[f64; 3]; 4],
    across: [[f64; 3]; 4],
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

    /// Between two wheel angles, for a phase and a distance between the axles (m).
    pub fn lean(&self, from: f64, to: f64, phase: f64, distance: f64) -> Lean {
        let ratio = self.rollers.mean_lateral_ratio_between(from, to, phase);
        let sweep = |angle| self.rollers.sweep(angle, phase);
        let turned = to - from;
        let tangent = if turned.abs() > 1e-9 {
            // The integral of tan t is -ln cos t, which is the same at both ends of a roller.
            (sweep(from).cos() / sweep(to).cos()).ln() / turned
        } else {
            sweep(from).tan()
        };
        Lean {
            secant: 1.0 / ratio,
            wander: distance * tangent,
        }
    }

    /// Of a wheel that does not ripple.
    pub fn mean(&self) -> Lean {
        Lean {
            secant: 1.0 / self.rollers.mean_lateral_ratio(),
            wander: 0.0,
        }
    }

    /// From wheel angles to the displacement, for rollers that resist their own turning by this share of the
    /// contacts' stiffness.
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
        if !invert(&mut normal, 3) {
            return None;
        }
        Some(std::array::from_fn(|axis| {
            std::array::from_fn(|wheel| {
                (0..3).map(|n| normal[3 * axis + n] * right[n][wheel]).sum()
            })
        }))
    }

    /// What the cosine and the sine of a wheel's roller angle `n phase` change of the displacement `moved`, to first
    /// order: the fundamentals of secant and tangent, that wheel standing `n angle` further. (The linear start of the
    /// fit.)
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

    /// Amplitudes of the fundamental of the secant (a cosine) and of the tangent (a sine), a pitch being its period.
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
