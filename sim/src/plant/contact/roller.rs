//! The rollers of one wheel, as bodies that turn about their own axles.
//!
//! The roller that carries the wheel rolls along with the floor. It resists in proportion to how fast, and it has
//! inertia: one that comes down hardly turns, and friction has to bring it up to speed. That costs the robot a jolt at
//! every hand-over, and so a part of its speed that grows with the speed. A roller is a barrel: towards its ends it is
//! thinner, so the same velocity over the floor turns it faster there.

use std::f64::consts::PI;

use kinematics::FourWheelGeometry;

use super::Contact;

/// Thinnest place of a barrel over its thickest: with few rollers a true one would end in a point.
const THINNEST: f64 = 0.1;
/// Intervals of Simpson's rule over half a barrel.
const INTERVALS: u32 = 64;

/// The rollers of a wheel. Their rates are positive when the surface on the floor goes where friction across the axle
/// pushes.
#[derive(Debug, Clone)]
pub(super) struct Rollers {
    shape: Barrel,
    /// Moment of inertia of one about its axle, kg m^2.
    inertia: f64,
    /// Number of the one that carries the wheel, among `rates`.
    loaded: usize,
    /// How fast each turns, rad/s; of those in the air when it left the floor.
    rates: Vec<f64>,
    /// When each left the floor, s.
    left: Vec<f64>,
    /// Since the beginning, s.
    now: f64,
    /// Radius where the loaded one touches the floor now, m.
    radius: f64,
}

/// Such a shape that the wheel is round.
#[derive(Debug, Clone, Copy)]
struct Barrel {
    /// Radius of the wheel, and of its rollers' axles at their middles, m.
    wheel: f64,
    axle: f64,
}

impl Barrel {
    /// Radius where it touches the floor when the wheel has turned by `phi` from the barrel's middle, m.
    fn radius(self, phi: f64) -> f64 {
        (self.wheel - self.axle / phi.cos()).max(THINNEST * (self.wheel - self.axle))
    }

    /// Moment of inertia about its axle, if it were solid: half of density times pi times the integral of the fourth
    /// power of the radius. Where the wheel touches at `phi`, it is `axle tan(phi) / sin(roller angle)` from the middle.
    fn inertia(self, density: f64, sin_roller: f64, half_pitch: f64) -> f64 {
        let step = half_pitch / f64::from(INTERVALS);
        let sum: f64 = (0..=INTERVALS)
            .map(|k| {
                let phi = f64::from(k) * step;
                let weight = match k {
                    0 | INTERVALS => 1.0,
                    k if k % 2 == 1 => 4.0,
                    _ => 2.0,
                };
                weight * self.radius(phi).powi(4) / phi.cos().powi(2)
            })
            .sum();
        let half = self.axle / sin_roller * sum * step / 3.0;
        0.5 * density * PI * 2.0 * half
    }
}

impl Rollers {
    /// All of them at rest.
    pub fn new(contact: &Contact, geometry: &FourWheelGeometry<f64>) -> Self {
        let wheel = geometry.wheel_radius();
        let shape = Barrel {
            wheel,
            axle: wheel * (1.0 - contact.roller_ratio),
        };
        let half_pitch = PI / f64::from(contact.rollers);
        let sin_roller = geometry.roller_angle().sin();
        Self {
            shape,
            inertia: shape.inertia(contact.roller_density, sin_roller, half_pitch),
            loaded: 0,
            rates: vec![0.0; usize::from(contact.rollers)],
            left: vec![0.0; usize::from(contact.rollers)],
            now: 0.0,
            radius: shape.radius(0.0),
        }
    }

    /// The wheel stands on this roller, counted from where it began, and `phi` from its middle. `drag` is the loaded
    /// roller's resistance at the floor, N s/m; in the air the axle resists as much.
    pub fn stand_on(&mut self, roller: i64, phi: f64, drag: f64) {
        let count = self.rates.len();
        let roller = roller.rem_euclid(count as i64) as usize;
        if roller != self.loaded {
            self.left[self.loaded] = self.now;
            self.loaded = roller;
            if self.inertia > 0.0 {
                let middle = self.shape.radius(0.0);
                let slowing = drag * middle * middle / self.inertia;
                self.rates[roller] *= (slowing * (self.left[roller] - self.now)).exp();
            }
        }
        self.radius = self.shape.radius(phi);
    }

    /// Velocity across the axle at which the floor does not push it in the next `dt`, m/s, and force over the
    /// difference from that velocity, N s/m, when friction creeps with `grip`.
    pub fn resistance(&self, grip: f64, drag: f64, dt: f64) -> (f64, f64) {
        let inertia = self.inertia / (self.radius * self.radius) / dt;
        let resists = inertia + drag;
        if resists > 0.0 {
            let surface = self.rates[self.loaded] * self.radius;
            (
                surface * inertia / resists,
                grip * resists / (grip + resists),
            )
        } else {
            (0.0, 0.0)
        }
    }

    /// Turns the loaded roller for `dt` by a force of the floor, N.
    pub fn turn(&mut self, force: f64, drag: f64, dt: f64) {
        self.now += dt;
        let inertia = self.inertia / dt;
        let rate = &mut self.rates[self.loaded];
        let resists = inertia + drag * self.radius * self.radius;
        if inertia > 0.0 {
            *rate = (inertia * *rate + force * self.radius) / resists;
        }
    }
}
