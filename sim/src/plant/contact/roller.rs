//! The rollers of wheels, as bodies that turn about their own axles.
//!
//! A roller that carries the wheel rolls along with the floor. It resists in proportion to how
//! fast, and it has inertia: one that comes down hardly turns, and friction has to bring it up to
//! speed. That costs the robot a jolt at every hand-over, and so a part of its speed that grows
//! with the speed. A roller is a barrel: towards its ends it is thinner, so the same velocity over
//! the floor turns it faster there.

use std::f64::consts::PI;

use kinematics::Wheel;

use super::Contact;
use super::footprint::Foot;
use crate::four::Four;

/// Thinnest place of a barrel over its thickest: with few rollers a true one would end in a point.
const THINNEST: f64 = 0.1;
/// Intervals of Simpson's rule over half a barrel.
const INTERVALS: u32 = 64;

/// The rollers of a robot's wheels. Their rates are positive when the surface on the floor goes
/// where friction across the axle pushes.
#[derive(Debug, Clone)]
pub(super) struct Rollers {
    shape: Barrel,
    /// Moment of inertia of one about its axle, kg m^2.
    inertia: Four,
    /// By number, then by wheel. How fast those on the floor turn is in `turning`.
    each: Vec<[Roller; 4]>,
    /// Those on the floor under each wheel, a first and a second; the same twice where it stands on
    /// one, and then the second does not count.
    down: Option<[Four; 2]>,
    turning: [Turning; 2],
    /// Since the beginning, s.
    now: f64,
}

/// Where the roller on the floor under each wheel touches it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grip {
    /// Its radius there, m.
    pub radius: Four,
    /// Part of the wheel's load.
    pub share: Four,
}

/// How a roller on the floor under each wheel turns.
#[derive(Debug, Clone, Copy)]
struct Turning {
    /// Now, rad/s.
    rate: Four,
    /// At the end of the step, if the floor does not push it, rad/s.
    free: Four,
    /// What each newton of the floor adds to that, rad/(N s).
    gain: Four,
}

impl Turning {
    const AT_REST: Self = Self {
        rate: Four::ZERO,
        free: Four::ZERO,
        gain: Four::ZERO,
    };
}

#[derive(Debug, Clone, Copy)]
struct Roller {
    /// How fast it turned when it left the floor, rad/s.
    rate: f64,
    /// When it left the floor, s; nothing while it is down.
    left: Option<f64>,
}

/// Such a shape that the wheel is round.
#[derive(Debug, Clone, Copy)]
pub(super) struct Barrel {
    /// Radius of the wheels, and of their rollers' axles at their middles, m.
    wheel: Four,
    axle: Four,
}

impl Barrel {
    pub fn new(contact: &Contact, wheels: &[Wheel<f64>; 4]) -> Self {
        let wheel = Four(wheels.map(|wheel| wheel.radius()));
        Self {
            wheel,
            axle: wheel * (1.0 - contact.roller_ratio),
        }
    }

    /// Where the floor touches rollers on which wheels stand.
    #[inline(always)]
    pub fn grip(self, foot: &Foot) -> Grip {
        Grip {
            radius: self.radius(foot.secant),
            share: foot.share,
        }
    }

    /// Radius where it touches the floor when the wheel has turned from the barrel's middle by an
    /// angle of this secant, m.
    #[inline(always)]
    fn radius(self, secant: Four) -> Four {
        (self.wheel - self.axle * secant).max((self.wheel - self.axle) * THINNEST)
    }

    /// Moment of inertia about its axle, if it were solid: half of density times pi times the
    /// integral of the fourth power of the radius. Where the wheel touches at `phi`, it is `axle
    /// tan(phi) / sin(roller angle)` from the middle.
    fn inertia(self, density: f64, sin_roller: Four, half_pitch: f64) -> Four {
        let step = half_pitch / f64::from(INTERVALS);
        let sum = (0..=INTERVALS).fold(Four::ZERO, |sum, k| {
            let secant = 1.0 / libm::cos(f64::from(k) * step);
            let weight = match k {
                0 | INTERVALS => 1.0,
                k if k % 2 == 1 => 4.0,
                _ => 2.0,
            };
            let fourth = self.radius(Four::all(secant)).map(|radius| radius.powi(4));
            sum + fourth * weight * secant.powi(2)
        });
        let half = self.axle / sin_roller * sum * step / Four::all(3.0);
        half * (0.5 * density * PI * 2.0)
    }
}

impl Rollers {
    /// All of them at rest.
    pub fn new(contact: &Contact, wheels: &[Wheel<f64>; 4]) -> Self {
        let shape = Barrel::new(contact, wheels);
        let half_pitch = PI / f64::from(contact.rollers);
        let sin_roller = Four(wheels.map(|wheel| libm::sin(wheel.roller_angle().abs())));
        let at_rest = Roller {
            rate: 0.0,
            left: Some(0.0),
        };
        Self {
            shape,
            inertia: shape.inertia(contact.roller_density, sin_roller, half_pitch),
            each: vec![[at_rest; 4]; usize::from(contact.rollers)],
            down: None,
            turning: [Turning::AT_REST; 2],
            now: 0.0,
        }
    }

    /// From now on one or two under each wheel are `down` on the floor. An axle resists with
    /// `drag`, as a force at the floor under all of a wheel's load, N s/m; in the air as much.
    #[inline(always)]
    pub fn stand_on(&mut self, down: [Four; 2], drag: Four) {
        if let Some([first, second]) = self.down
            && first.is(down[0])
            && second.is(down[1])
        {
            return;
        }
        self.change(down, drag);
    }

    #[inline(never)]
    fn change(&mut self, down: [Four; 2], drag: Four) {
        let before = self.down.replace(down);
        let middle = self.shape.radius(Four::ONE);
        let slowing = drag * middle * middle / self.inertia;
        for (wheel, slowing) in slowing.0.into_iter().enumerate() {
            let numbers = |of: [Four; 2]| of.map(|down| down.0[wheel] as usize);
            let down = numbers(down);
            if let Some(before) = before.map(numbers) {
                if before == down {
                    continue;
                }
                // The first last: it is the one that counts where both are the same.
                for (turning, number) in self.turning.iter().zip(before).rev() {
                    let roller = &mut self.each[number][wheel];
                    roller.rate = turning.rate.0[wheel];
                    if !down.contains(&number) {
                        roller.left = Some(self.now);
                    }
                }
            }
            for (turning, number) in self.turning.iter_mut().zip(down) {
                let roller = &mut self.each[number][wheel];
                // Without inertia it is infinite, or no number without drag.
                if let Some(left) = roller.left.take()
                    && slowing.is_finite()
                {
                    roller.rate *= libm::exp(slowing * (left - self.now));
                }
                turning.rate.0[wheel] = roller.rate;
            }
        }
    }

    /// Velocity across the axle at which the floor does not push its first rollers (`which` 0) or
    /// second ones (1) in the next `dt`, m/s, and force over the difference from that velocity, N
    /// s/m, when friction creeps with `stiffness`.
    #[inline(always)]
    pub fn resistance(
        &mut self,
        which: usize,
        grip: &Grip,
        stiffness: Four,
        drag: Four,
        dt: f64,
    ) -> (Four, Four) {
        let turning = &mut self.turning[which];
        let lever = grip.radius * dt;
        let over = grip.radius * lever;
        // As much inertia as drag and inertia together are in this step, kg m^2; one without either
        // does not resist, and nothing has to turn it.
        let resists = self.inertia + drag * grip.share * over;
        let gives = resists.where_positive(Four::ONE / resists, Four::ZERO);
        turning.free = turning.rate * self.inertia * gives;
        turning.gain = lever * gives;
        let resistance = stiffness * resists / (resists + stiffness * over);
        (
            turning.free * grip.radius,
            resists.where_positive(resistance, Four::ZERO),
        )
    }

    /// Turns the first or second rollers on the floor by the floor's forces, N, in the step that
    /// [`resistance`](Self::resistance) was asked about.
    #[inline(always)]
    pub fn turn(&mut self, which: usize, force: Four) {
        let turning = &mut self.turning[which];
        turning.rate = turning.free + force * turning.gain;
    }

    /// Lets `dt` pass, s.
    pub fn pass(&mut self, dt: f64) {
        self.now += dt;
    }
}

#[cfg(test)]
mod tests {
    use kinematics::FourWheelGeometry;

    use super::*;

    const WHEEL: f64 = 0.1524;
    const DT: f64 = 1e-5;
    /// Force over slip, N s/m.
    const GRIP: f64 = 1e4;

    fn rollers(contact: Contact) -> Rollers {
        let angle = std::f64::consts::FRAC_PI_4;
        let geometry = FourWheelGeometry::new(0.37, 0.35, WHEEL, angle).unwrap();
        Rollers::new(&contact, &geometry.wheels().unwrap())
    }

    /// Wheels each on one roller: its number, and where.
    fn on(roller: u8, phi: f64) -> (u8, Grip) {
        let barrel = rollers(Contact::default()).shape;
        let grip = barrel.grip(&Foot {
            roller: Four::all(roller.into()),
            tilt: Four::all(libm::cos(phi)),
            tan: Four::all(libm::tan(phi)),
            secant: Four::all(1.0 / libm::cos(phi)),
            share: Four::ONE,
        });
        (roller, grip)
    }

    /// Puts a roller down and lets the floor go by at `speed` under it for `seconds`; the sum of
    /// the floor's impulses, N s.
    fn spin_up(rollers: &mut Rollers, on: &(u8, Grip), speed: f64, drag: f64, seconds: f64) -> f64 {
        let drag = Four::all(drag);
        let (number, grip) = on;
        rollers.stand_on([Four::all((*number).into()); 2], drag);
        let mut impulse = Four::ZERO;
        for _ in 0..(seconds / DT).round() as u32 {
            let (rest, stiffness) = rollers.resistance(0, grip, Four::all(GRIP), drag, DT);
            let force = stiffness * (Four::all(speed) - rest);
            rollers.turn(0, force);
            rollers.pass(DT);
            impulse = impulse + force * DT;
        }
        impulse.0[2]
    }

    /// Of the first or second roller on the floor.
    fn surface(rollers: &Rollers, which: usize, (_, grip): &(u8, Grip)) -> f64 {
        (rollers.turning[which].rate * grip.radius).0[2]
    }

    /// With 128 rollers half a pitch is 1.4 degrees and a barrel is thinner at its ends by `0.1189
    /// (1 / cos(1.4 degrees) - 1)` = 0.036 mm of 33.5 mm, a part in a thousand. The fourth power of
    /// that, over the length, takes 4/3 parts in a thousand off the inertia of a cylinder.
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
        let ratio = rollers(contact).inertia.0[1] / (0.5 * mass * radius * radius);
        assert!(
            (ratio - (1.0 - 4.0 / 3.0 * 1.07e-3)).abs() < 1e-5,
            "{ratio}"
        );
    }

    /// With eight it narrows to seven tenths. The integral of `(R - A sqrt(1 + u^2))^4` over u =
    /// tan(phi), term by term.
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
        let ratio = rollers(contact).inertia.0[1] / expected;
        // The terms are a thousand times larger than their sum.
        assert!((ratio - 1.0).abs() < 1e-8, "{ratio}");
    }

    /// The floor pushes with the momentum that it leaves in the roller, wherever on the barrel it
    /// does.
    #[test]
    fn the_floor_spins_a_roller_up() {
        for phi in [0.0, PI / 8.0] {
            let mut rollers = rollers(Contact::default());
            let foot = on(0, phi);
            let impulse = spin_up(&mut rollers, &foot, 0.7, 0.0, 0.02);
            let radius = WHEEL - (WHEEL - 0.0335) / phi.cos();
            let expected = rollers.inertia.0[2] * 0.7 / (radius * radius);
            // Contacts of 10^4 N s/m under a mass of a kilogram are there after a tenth of a
            // millisecond.
            let reached = surface(&rollers, 0, &foot);
            assert!((reached - 0.7).abs() < 1e-9, "{reached}");
            assert!(
                (impulse / expected - 1.0).abs() < 1e-9,
                "{impulse} {expected}"
            );
        }
    }

    /// Once it turns, drag is all that the floor has to overcome: in series with the creep of the
    /// contact. A roller with a quarter of the load has a quarter of the drag.
    #[test]
    fn a_spinning_roller_resists_by_its_drag() {
        let mut rollers = rollers(Contact::default());
        let drag = 12.0;
        for share in [1.0, 0.25] {
            let mut foot = on(0, 0.0);
            foot.1.share = Four::all(share);
            spin_up(&mut rollers, &foot, 0.7, drag, 0.1);
            let force = spin_up(&mut rollers, &foot, 0.7, drag, DT) / DT;
            let expected = 0.7 / (1.0 / GRIP + 1.0 / (drag * share));
            assert!((force / expected - 1.0).abs() < 1e-9, "{force} {expected}");
        }
    }

    /// A roller in the air slows down by its axle's drag; one that is back at once has not noticed.
    #[test]
    fn a_roller_keeps_what_is_left_of_its_spin() {
        let edge = PI / 8.0;
        let drag = 12.0;
        let mut rollers = rollers(Contact::default());
        let foot = on(0, edge);
        spin_up(&mut rollers, &foot, 0.7, 0.0, 0.02);
        let rate = rollers.turning[0].rate.0[2];
        rollers.stand_on([Four::all(1.0); 2], Four::all(drag));
        rollers.stand_on([Four::all(0.0); 2], Four::all(drag));
        assert!((rollers.turning[0].rate.0[2] - rate).abs() < 1e-12);
        let impulse = spin_up(&mut rollers, &foot, 0.7, 0.0, DT);
        assert!(impulse.abs() < 1e-9, "{impulse}");
        // 50 ms on the next one, then back; the radius that the axle's drag acts with is that of
        // the middle.
        spin_up(&mut rollers, &on(1, edge), 0.7, drag, 0.05);
        rollers.stand_on([Four::all(0.0); 2], Four::all(drag));
        let expected = rate * (-drag * 0.0335 * 0.0335 * 0.05 / rollers.inertia.0[2]).exp();
        let left = rollers.turning[0].rate.0[2];
        assert!((left / expected - 1.0).abs() < 1e-9, "{left} {expected}");
        assert!(expected < 0.5 * rate);
    }

    /// While two are down both keep turning as the floor turns them.
    #[test]
    fn both_rollers_on_the_floor_are_turned_by_it() {
        let mut rollers = rollers(Contact::default());
        let feet = [on(3, PI / 8.0), on(4, -PI / 8.0)];
        spin_up(&mut rollers, &feet[0], 0.7, 0.0, 0.02);
        rollers.stand_on([Four::all(3.0), Four::all(4.0)], Four::all(12.0));
        rollers.pass(0.05);
        for (which, expected) in [0.7, 0.0].into_iter().enumerate() {
            assert!((surface(&rollers, which, &feet[which]) - expected).abs() < 1e-9);
        }
    }
}
