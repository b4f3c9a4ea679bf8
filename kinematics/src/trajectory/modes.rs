//! The paper's eleven motions (its Figure 6), with its parameters.
//!
//! Table 2 gives the circle (2500 mm, and 1350 mm for the centripetal ones) and the figure-eight.
//! What it does not give is chosen here: the straight motions at 500 mm/s an axis for 10 s (the
//! paper's largest set speed), one turn on the spot at pi/6 rad/s, the harmonic curve of the
//! physical test. "Centripetal" is read as: the heading turns with the circle, so that the same
//! side always faces the centre.
//!
//! The "oblique state" of (h) and (i) is 60 degrees: section 3.2.2 has them "maintaining a 60°
//! angle during translating motion". From what, and which way round, it does not say. Here it is
//! the heading, counter-clockwise, so that the robot's lateral axis, the section's "x-direction in
//! the local coordinate system of the robot", stands at 60 degrees to the paper's x. (c), (l) and
//! (m) are printed as 45 degrees.

use super::{Acceleration, Circle, FigureEight, Harmonic, Heading, Line, Trajectory, Turn};
use crate::arithmetic::Real;
use crate::frame::{Pose, Twist};

/// The motions of the paper's Figure 6, by their letters there.
///
/// ```
/// use mecanum_kinematics::trajectory::{MotionMode, PaperMotion, Trajectory};
///
/// for mode in MotionMode::ALL {
///     let motion: PaperMotion<f32> = mode.motion();
///     let length = motion.arc_length();
///     assert!(length > 1.0 || mode == MotionMode::Turning);
/// }
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionMode {
    /// (a) Straight ahead.
    Longitudinal,
    /// (b) Sideways to the right.
    Lateral,
    /// (c) At 45 degrees ahead and to the right.
    Oblique,
    /// (d) Turning on the spot.
    Turning,
    /// (e) Round a circle, heading fixed.
    Circle,
    /// (f) Round a figure-eight, heading fixed.
    FigureEight,
    /// (g) Along a harmonic curve, heading fixed.
    Harmonic,
    /// (h) Round a circle with the robot turned left by 60 degrees.
    ObliqueCircle,
    /// (i) Round a figure-eight with the robot turned left by 60 degrees.
    ObliqueFigureEight,
    /// (j, k) Round a circle, its front always outwards.
    Centripetal,
    /// (l, m) The same with the robot turned by 45 degrees.
    ObliqueCentripetal,
}

impl MotionMode {
    /// All eleven, in the paper's order.
    pub const ALL: [Self; 11] = [
        Self::Longitudinal,
        Self::Lateral,
        Self::Oblique,
        Self::Turning,
        Self::Circle,
        Self::FigureEight,
        Self::Harmonic,
        Self::ObliqueCircle,
        Self::ObliqueFigureEight,
        Self::Centripetal,
        Self::ObliqueCentripetal,
    ];

    /// The motion with the paper's parameters.
    #[must_use]
    pub fn motion<S: Real>(self) -> PaperMotion<S> {
        let speed = S::constant(0.5);
        let line = |vx, vy| {
            PaperMotion::Line(Line {
                vx,
                vy,
                duration: S::constant(10.0),
            })
        };
        let small = Circle {
            radius: S::constant(1.35),
            frequency: S::pi() / S::constant(5.0),
        };
        let circle = |path, offset, rate| PaperMotion::Circle(Heading { path, offset, rate });
        let eight = |offset| {
            PaperMotion::FigureEight(Heading {
                path: FigureEight::paper(),
                offset,
                rate: S::ZERO,
            })
        };
        match self {
            Self::Longitudinal => line(speed, S::ZERO),
            Self::Lateral => line(S::ZERO, -speed),
            Self::Oblique => line(speed, -speed),
            Self::Turning => PaperMotion::Turn(Turn {
                omega: S::frac_pi_6(),
                duration: S::constant(12.0),
            }),
            Self::Circle => circle(Circle::paper(), S::ZERO, S::ZERO),
            Self::FigureEight => eight(S::ZERO),
            Self::Harmonic => PaperMotion::Harmonic(Harmonic {
                amplitude: S::ONE,
                speed: S::constant(0.3),
                frequency: S::pi() / S::constant(5.0),
                periods: S::constant(2.0),
            }),
            Self::ObliqueCircle => circle(Circle::paper(), S::frac_pi_3(), S::ZERO),
            Self::ObliqueFigureEight => eight(S::frac_pi_3()),
            // The circle starts ahead of its centre and goes round clockwise.
            Self::Centripetal => circle(small, S::ZERO, -small.frequency),
            Self::ObliqueCentripetal => circle(small, S::frac_pi_4(), -small.frequency),
        }
    }
}

/// Any of the eleven motions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PaperMotion<S = f32> {
    /// Straight.
    Line(Line<S>),
    /// On the spot.
    Turn(Turn<S>),
    /// Round a circle.
    Circle(Heading<Circle<S>, S>),
    /// Round a figure-eight.
    FigureEight(Heading<FigureEight<S>, S>),
    /// Along a harmonic curve.
    Harmonic(Harmonic<S>),
}

impl<S: Real> PaperMotion<S> {
    fn inner(&self) -> &dyn Trajectory<S> {
        match self {
            Self::Line(motion) => motion,
            Self::Turn(motion) => motion,
            Self::Circle(motion) => motion,
            Self::FigureEight(motion) => motion,
            Self::Harmonic(motion) => motion,
        }
    }
}

impl<S: Real> Trajectory<S> for PaperMotion<S> {
    fn at(&self, time: S) -> (Pose<S>, Twist<S>) {
        self.inner().at(time)
    }

    fn duration(&self) -> S {
        self.inner().duration()
    }

    fn acceleration(&self, time: S) -> Acceleration<S> {
        self.inner().acceleration(time)
    }
}
