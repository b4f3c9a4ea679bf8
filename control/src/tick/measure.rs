//! *Measure*: from encoder counts to the wheels' rates, the group's twist, slip and pose.

use super::motion::{Motion, Wheel};
use crate::interface::{Inputs, Report};
use crate::quantity::{Angle, Rate, Time};
use crate::rollers;

impl Motion {
    /// Angle by which each wheel turned, rad, a whole number of counts.
    #[inline]
    fn turned(&self, previous: &[u16; 4], counts: &[u16; 4]) -> [Angle; 4] {
        let [a, b, c, d] = &self.wheels;
        let [pa, pb, pc, pd] = *previous;
        let [na, nb, nc, nd] = *counts;
        let one = |wheel: &Wheel, from: u16, to: u16| {
            wheel.step.turned(to.wrapping_sub(from).cast_signed())
        };
        [
            one(a, pa, na),
            one(b, pb, nb),
            one(c, pc, nc),
            one(d, pd, nd),
        ]
    }

    /// Measures the wheels since the last tick; returns the angle by which each turned, rad. `turn`
    /// is what the gyro has seen meanwhile, rad.
    #[inline]
    pub(super) fn measure(
        &mut self,
        previous: &[u16; 4],
        inputs: &Inputs,
        dt: Time,
        turn: Option<Angle>,
        report: &mut Report,
    ) -> [Angle; 4] {
        let turned = self.turned(previous, &inputs.encoder_counts);
        let mut rates = [Rate::ZERO; 4];
        for (((wheel, turned), acceleration), rate) in self
            .wheels
            .iter_mut()
            .zip(turned)
            .zip(self.accelerations)
            .zip(&mut rates)
        {
            *rate = wheel.observer.update(turned, acceleration, dt);
        }
        report.rates = rates;
        self.locate(previous, inputs, rates, turned, turn, report);
        turned
    }

    /// Twist, slip and pose from the wheels' rates and angles.
    #[inline]
    fn locate(
        &mut self,
        previous: &[u16; 4],
        inputs: &Inputs,
        rates: [Rate; 4],
        turned: [Angle; 4],
        turn: Option<Angle>,
        report: &mut Report,
    ) {
        let (drivetrain, factors) = (&self.configuration.drivetrain, &self.factors);
        // Whole counts, not filtered rates: no motion is lost at any speed.
        let moved = if let Some(rollers) = &mut self.rollers {
            let passed = passed(previous, &inputs.encoder_counts);
            let middle = rollers.update(passed, inputs.encoder_counts, inputs.index.as_ref());
            let wheels = rollers.kinematics();
            let (asked, residual) = rollers::measure(wheels, rates, rollers.secants());
            report.measured = drivetrain.group(asked, factors);
            report.slip_residual = residual;
            report.roller_states = rollers.states();
            report.roller_sweeps = rollers.sweeps();
            drivetrain.group(rollers::displacement(wheels, turned, &middle), factors)
        } else {
            report.measured = drivetrain.forward(rates, factors);
            report.slip_residual = drivetrain.unexplained(rates);
            drivetrain.forward(turned, factors)
        };
        let moved = match turn {
            Some(turn) => drivetrain.turned_by(moved, turn),
            None => moved,
        };
        self.odometry.advance(moved);
        report.odometry = self.odometry;
    }
}

/// Counts by which each encoder has advanced.
#[inline]
fn passed(from: &[u16; 4], to: &[u16; 4]) -> [i16; 4] {
    let [a, b, c, d] = *from;
    let [e, f, g, h] = *to;
    let one = |from: u16, to: u16| to.wrapping_sub(from).cast_signed();
    [one(a, e), one(b, f), one(c, g), one(d, h)]
}
