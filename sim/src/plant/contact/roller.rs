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

#[cfg(test)]
mod tests {
    use super::*;

    const WHEEL: f64 = 0.1524;
    const DT: f64 = 1e-5;

    fn rollers(contact: Contact) -> Rollers {
        let angle = std::f64::consts::FRAC_PI_4;
        let geometry = FourWheelGeometry::new(0.37, 0.35, WHEEL, angle).unwrap();
        Rollers::new(&contact, &geometry)
    }

    /// Lets the floor go by at `speed` under a roller for `seconds`; the sum of the floor's impulses, N s.
    fn spin_up(rollers: &mut Rollers, speed: f64, drag: f64, seconds: f64) -> f64 {
        let mut impulse = 0.0;
        for _ in 0..(seconds / DT).round() as u32 {
            let (rest, stiffness) = rollers.resistance(1e4, drag, DT);
            let force = stiffness * (speed - rest);
            rollers.turn(force, drag, DT);
            impulse += force * DT;
        }
        impulse
    }

    fn surface(rollers: &Rollers) -> f64 {
        rollers.rates[rollers.loaded] * rollers.radius
    }

    /// With 128 rollers half a pitch is 1.4 degrees and a barrel is thinner at its ends by
    /// `0.1189 (1 / cos(1.4 degrees) - 1)` = 0.036 mm of 33.5 mm, a part in a thousand. The fourth power of that,
    /// over the length, takes 4/3 parts in a thousand off the inertia of a cylinder.
    #[test]
    fn a_barrel_that_hardly_narrows_is_a_cylinder() {
        let contact = Contact {
            rollers: 128,
            ..Contact::default()
        };
        let radius: f64 = 0.0335;
        let half_pitch = PI / 128.0;
        let length = 2.0 * (WHEEL - radius) * half_pitch.tan() * std::f64::consts::SQRT_2;
        let mass = contact.roller_density * PI * radius * radius * length;
        let ratio = rollers(contact).inertia / (0.5 * mass * radius * radius);
        assert!(
            (ratio - (1.0 - 4.0 / 3.0 * 1.07e-3)).abs() < 1e-5,
            "{ratio}"
        );
    }

    /// With eight it narrows to seven tenths. The integral of `(R - A sqrt(1 + u^2))^4` over u = tan(phi), term by term.
    #[test]
    fn a_barrel_of_eight_has_the_inertia_of_the_integral() {
        let contact = Contact::default();
        let a = WHEEL - 0.0335;
        let u = (PI / 8.0).tan();
        let s = u.hypot(1.0);
        let root = 0.5 * (u * s + u.asinh());
        let cubed = 0.25 * u * s.powi(3) + 0.75 * root;
        let square = u + u.powi(3) / 3.0;
        let fourth = u + 2.0 * u.powi(3) / 3.0 + u.powi(5) / 5.0;
        let integral = WHEEL.powi(4) * u - 4.0 * WHEEL.powi(3) * a * root
            + 6.0 * (WHEEL * a).powi(2) * square
            - 4.0 * WHEEL * a.powi(3) * cubed
            + a.powi(4) * fourth;
        let expected = contact.roller_density * PI * a * std::f64::consts::SQRT_2 * integral;
        let ratio = rollers(contact).inertia / expected;
        // The terms are a thousand times larger than their sum.
        assert!((ratio - 1.0).abs() < 1e-8, "{ratio}");
    }

    /// The floor pushes with the momentum that it leaves in the roller, wherever on the barrel it does.
    #[test]
    fn the_floor_spins_a_roller_up() {
        for phi in [0.0, PI / 8.0] {
            let mut rollers = rollers(Contact::default());
            rollers.stand_on(0, phi, 0.0);
            let impulse = spin_up(&mut rollers, 0.7, 0.0, 0.02);
            let radius = WHEEL - (WHEEL - 0.0335) / phi.cos();
            let expected = rollers.inertia * 0.7 / (radius * radius);
            // Contacts of 10^4 N s/m under a mass of a kilogram are there after a tenth of a millisecond.
            assert!(
                (surface(&rollers) - 0.7).abs() < 1e-9,
                "{}",
                surface(&rollers)
            );
            assert!(
                (impulse / expected - 1.0).abs() < 1e-9,
                "{impulse} {expected}"
            );
        }
    }

    /// Once it turns, drag is all that the floor has to overcome: in series with the creep of the contact.
    #[test]
    fn a_spinning_roller_resists_by_its_drag() {
        let mut rollers = rollers(Contact::default());
        let drag = 12.0;
        spin_up(&mut rollers, 0.7, drag, 0.02);
        let force = spin_up(&mut rollers, 0.7, drag, DT) / DT;
        let expected = 0.7 / (1.0 / 1e4 + 1.0 / drag);
        assert!((force / expected - 1.0).abs() < 1e-9, "{force} {expected}");
    }

    /// A roller in the air slows down by its axle's drag; one that is back at once has not noticed.
    #[test]
    fn a_roller_keeps_what_is_left_of_its_spin() {
        let edge = PI / 8.0;
        let drag = 12.0;
        let mut rollers = rollers(Contact::default());
        rollers.stand_on(0, edge, 0.0);
        spin_up(&mut rollers, 0.7, 0.0, 0.02);
        let rate = rollers.rates[0];
        // Over the edge to the next one and back: the seventh comes before the zeroth.
        for next in [1, -1] {
            rollers.stand_on(next, edge, drag);
            rollers.stand_on(0, edge, drag);
            assert!((rollers.rates[0] - rate).abs() < 1e-12, "{next}");
            let impulse = spin_up(&mut rollers, 0.7, 0.0, DT);
            assert!(impulse.abs() < 1e-9, "{impulse}");
        }
        // 50 ms on the next one, then back; the radius that the axle's drag acts with is that of the middle.
        rollers.stand_on(1, edge, drag);
        spin_up(&mut rollers, 0.7, drag, 0.05);
        rollers.stand_on(0, edge, drag);
        let expected = rate * (-drag * 0.0335 * 0.0335 * 0.05 / rollers.inertia).exp();
        assert!(
            (rollers.rates[0] / expected - 1.0).abs() < 1e-9,
            "{} {expected}",
            rollers.rates[0]
        );
        assert!(expected < 0.5 * rate);
        // A turn of the wheel is as many rollers as there are, either way.
        rollers.stand_on(8, edge, drag);
        rollers.stand_on(-8, edge, drag);
        assert_eq!(rollers.loaded, 0);
    }
}
