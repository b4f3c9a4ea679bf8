//! Which rollers of a wheel are on the floor, and how much each of them carries.
//!
//! A loaded wheel settles, so its rim touches the floor over some angle to both sides of its lowest
//! place. It presses as a bed of springs would, by a parabola: most in the middle, nothing at the
//! ends. Where two rollers meet within that angle both carry the load, each on its side. So the
//! load passes to the next roller gradually, while each axle keeps its direction.

use std::f64::consts::TAU;

use crate::four::Four;

/// The parts of the rims of a robot's wheels that touch the floor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    rollers: f64,
    per_rollers: f64,
    /// Angle from one roller to the next, and how far each wheel has rolled on past a roller's
    /// middle at angle 0, rad.
    pitch: f64,
    per_pitch: f64,
    phase: Four,
    /// From its middle to its ends, rad.
    half: f64,
    per_half: f64,
    /// Sine and cosine of the pitch, and tangent and secant where a roller ends.
    turn: (f64, f64),
    end: (f64, f64),
}

/// A roller on the floor under each wheel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Foot {
    /// Which one: a whole number from 0.
    pub roller: Four,
    /// Cosine of the angle by which the wheel has rolled on past its middle.
    pub tilt: Four,
    /// Tangent and secant of the same angle, but not past its end: that is where it still touches.
    pub tan: Four,
    pub secant: Four,
    /// Part of the wheel's load.
    pub share: Four,
}

impl Footprint {
    /// Wheels whose radius is less by the part `settling` under load.
    pub fn new(rollers: u8, phases: [f64; 4], settling: f64) -> Self {
        let pitch = TAU / f64::from(rollers);
        let (sin, cos) = libm::sincos(0.5 * pitch);
        // A wheel on three rollers would have no wheel under it.
        let half = libm::acos(1.0 - settling).min(0.5 * pitch);
        Self {
            rollers: rollers.into(),
            per_rollers: 1.0 / f64::from(rollers),
            pitch,
            per_pitch: 1.0 / pitch,
            phase: Four(phases),
            half,
            per_half: 1.0 / half,
            turn: libm::sincos(pitch),
            end: (sin / cos, 1.0 / cos),
        }
    }

    /// On what the wheels stand at these angles: the rollers at their lowest places, and those that
    /// share the load with them, if one of the wheels stands on two. The other wheels' share is
    /// then 0.
    #[inline(always)]
    pub fn feet(&self, angles: Four) -> (Foot, Option<Foot>) {
        let pitch = Four::all(self.pitch);
        let half = Four::all(0.5);
        let place = (angles + self.phase) * self.per_pitch + half;
        let number = place.floor();
        let phi = (place - number - half) * pitch;
        let (sin, cos) = phi.sin_cos();
        let secant = Four::ONE / cos;
        let beyond = self.share_beyond(pitch * half - phi.abs());
        let first = Foot {
            roller: self.roller(number),
            tilt: cos,
            tan: sin * secant,
            secant,
            share: Four::ONE - beyond,
        };
        let mut other = None;
        if beyond.any_positive() {
            let next = phi.map(f64::signum);
            let (tan, secant) = self.end;
            other = Some(Foot {
                roller: self.roller(beyond.where_positive(number + next, number)),
                tilt: cos * self.turn.1 + next * sin * self.turn.0,
                tan: -next * tan,
                secant: Four::all(secant),
                share: beyond,
            });
        }
        (first, other)
    }

    #[inline(always)]
    fn roller(&self, number: Four) -> Four {
        // Half a roller on, so that rounding takes none to the turn before.
        let turns = ((number + Four::all(0.5)) * self.per_rollers).floor();
        number - turns * self.rollers
    }

    /// Part of the load that presses further than an angle from the middle: with the parabola `3/4
    /// (1 - x^2)`, x from -1 to 1 between the ends, it is `1/2 - 3/4 (x - x^3/3)`.
    #[inline(always)]
    fn share_beyond(&self, angle: Four) -> Four {
        let x = angle * self.per_half;
        let share = Four::all(0.5) - (x - x * x * x * (1.0 / 3.0)) * 0.75;
        (Four::all(self.half) - angle).where_positive(share, Four::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    /// A wheel's part of what carries the four.
    #[derive(Debug, PartialEq)]
    struct One {
        roller: u8,
        tilt: f64,
        tan: f64,
        secant: f64,
        share: f64,
    }

    /// On what one wheel stands; the others of the robot stand elsewhere.
    fn one(footprint: &Footprint, angle: f64) -> (One, Option<One>) {
        let angles = Four([angle + 0.1, angle - 0.3, angle, angle + 1.0]);
        let (first, other) = footprint.feet(angles);
        let of = |foot: Foot| One {
            roller: foot.roller.0[2] as u8,
            tilt: foot.tilt.0[2],
            tan: foot.tan.0[2],
            secant: foot.secant.0[2],
            share: foot.share.0[2],
        };
        (of(first), other.map(of).filter(|foot| foot.share > 0.0))
    }

    /// A radius that is 0.22 % less: the chord ends where the cosine is.
    const SETTLING: f64 = 0.0022;

    #[test]
    fn a_wheel_that_does_not_settle_stands_on_one_roller() {
        let footprint = Footprint::new(8, [0.0; 4], 0.0);
        for degrees in -180..180 {
            let (foot, other) = one(&footprint, f64::from(degrees).to_radians());
            assert_eq!(other, None);
            assert!((foot.share - 1.0).abs() < f64::EPSILON);
            assert!(foot.tilt >= (PI / 8.0).cos() - 1e-12);
        }
    }

    /// Half each where they meet; the next one begins to carry, and the last one ends to, at
    /// acos(1 - settling) from it.
    #[test]
    fn the_load_goes_over_while_the_edge_passes_below() {
        let footprint = Footprint::new(8, [0.0; 4], SETTLING);
        let half = (1.0 - SETTLING).acos();
        let edge = PI / 8.0;
        let share = |angle: f64, roller: u8| {
            let (first, other) = one(&footprint, angle);
            let feet = [Some(first), other];
            let of = |foot: &One| (foot.roller == roller).then_some(foot.share);
            feet.iter().flatten().find_map(of).unwrap_or(0.0)
        };
        for way in [1.0, -1.0] {
            let next = if way > 0.0 { 1 } else { 7 };
            assert!(share(way * (edge - 1.001 * half), next) == 0.0);
            assert!(share(way * (edge - 0.999 * half), next) > 0.0);
            assert!((share(way * edge, next) - 0.5).abs() < 1e-12);
            assert!((share(way * edge, 0) - 0.5).abs() < 1e-12);
            assert!(share(way * (edge + 0.999 * half), 0) > 0.0);
            assert!(share(way * (edge + 1.001 * half), 0) == 0.0);
            // The part of a parabola beyond half of its half: 5/32.
            let quarter = share(way * (edge - 0.5 * half), next);
            assert!((quarter - 5.0 / 32.0).abs() < 1e-12, "{quarter}");
        }
    }

    /// Wherever the wheel stands its rollers carry all of it, are neighbours, and their middles are
    /// a pitch apart.
    #[test]
    fn two_rollers_carry_the_whole_load() {
        let footprint = Footprint::new(12, [0.1; 4], SETTLING);
        let pitch = TAU / 12.0;
        let mut twice = 0;
        for step in 0..10_000 {
            let angle = f64::from(step) * 1e-3 - 5.0;
            let (first, other) = one(&footprint, angle);
            let Some(other) = other else { continue };
            twice += 1;
            assert!((first.share + other.share - 1.0).abs() < 1e-12);
            assert!(first.share >= other.share);
            // The lowest place is between their middles.
            let (near, far) = (first.tilt.acos(), other.tilt.acos());
            assert!((near + far - pitch).abs() < 1e-9, "{first:?} {other:?}");
            // The first touches where the lowest place is, the other at its end, on the side of the
            // first.
            assert!((first.secant * first.tilt - 1.0).abs() < 1e-12);
            assert!((other.secant * (0.5 * pitch).cos() - 1.0).abs() < 1e-12);
            assert!((first.tan - first.tan.signum() * near.tan()).abs() < 1e-9);
            assert!((other.tan + first.tan.signum() * (0.5 * pitch).tan()).abs() < 1e-12);
            let apart = first.roller.abs_diff(other.roller);
            assert!(apart == 1 || apart == 11, "{first:?} {other:?}");
        }
        // Two halves of the footprint out of a pitch.
        let expected = 2.0 * (1.0 - SETTLING).acos() / pitch;
        assert!((f64::from(twice) / 1e4 - expected).abs() < 0.02, "{twice}");
    }
}
