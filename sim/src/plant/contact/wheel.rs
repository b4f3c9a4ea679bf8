//! The wheels of a robot as contacts of a body: where the floor can push it, and how hard.

use super::footprint::{Foot, Footprint};
use super::roller::{Barrel, Grip, Rollers};
use super::{Contact, Part};
use crate::four::Four;

/// The wheels of a robot as the floor sees them from below. Directions are in the robot's frame.
#[derive(Debug, Clone)]
pub(super) struct Underside {
    footprint: Footprint,
    barrel: Barrel,
    sin_roller: Four,
    /// With the sign of the wheel's hand: the roller's axle to the left, level.
    left: Four,
    /// By how much the contact wanders along the wheel's axle, over the tangent of the roller's
    /// tilt, m.
    wander: Four,
}

/// How a robot stands on its wheels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stand {
    first: Touch,
    /// The second roller of those wheels that stand on two.
    other: Option<Touch>,
    /// Which rollers the wheels stand on; the same twice where it is one.
    down: [Four; 2],
}

/// A roller under each wheel, and where it touches the floor.
#[derive(Debug, Clone, Copy)]
struct Touch {
    grip: Grip,
    /// Direction of its axle over the floor.
    ahead: Four,
    left: Four,
    /// How far along the wheel's axle, m.
    along: Four,
}

/// The wheels of a robot that is a part of a body. Directions and places are in the body's frame,
/// from its centre of mass.
#[derive(Debug, Clone)]
pub(super) struct Wheels {
    pub robot: usize,
    /// Hubs, m.
    pub x: Four,
    pub y: Four,
    /// Direction of the robot: sine and cosine.
    sin: f64,
    cos: f64,
    /// Rolling radius, settled, m.
    radius: Four,
    /// 1 over the slip velocity at which friction is fully developed, s/m; finite, so that a wheel
    /// without load has no friction.
    per_creep: f64,
    /// Force across a roller's axle over load and velocity, s/m.
    damping: f64,
    /// What they carry, N.
    load: Four,
    /// Under all of the load: the largest force, N, and force across a roller's axle over velocity,
    /// N s/m.
    limit: Four,
    drag: Four,
    rollers: Rollers,
    /// What the floor did to them in the last step, N·m, if that turns them.
    pub torques: Four,
    /// What turns with a wheel, kg m^2, if its rate is not its motor's alone.
    inertia: Option<f64>,
}

/// What the floor can do at a roller under each wheel of a robot: along its axle, and across, to
/// the axle's left. What is a pair belongs to the two.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pushes {
    /// Direction of the axle in the body's frame: ahead and to the left.
    pub axle: [Four; 2],
    /// Moment arms about the centre of mass, m.
    pub arms: [Four; 2],
    /// Velocities at which the contact would rest, m/s.
    pub rest: [Four; 2],
    /// Largest force, N; 0 where there is no contact.
    pub limit: Four,
    /// Force over slip velocity below the limit, N s/m.
    pub stiffness: [Four; 2],
    /// The forces without limit at the last velocity that was looked at, N.
    pub wanted: [Four; 2],
}

/// One direction of [`Pushes`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Push {
    /// Direction, and moment arm about the centre of mass.
    pub row: [Four; 3],
    pub rest: Four,
    pub limit: Four,
    pub stiffness: Four,
}

/// Stiffest contact, N s/m: what wheels that contradict each other fight about is shared by it.
const STIFFEST: f64 = 4e9;

impl Underside {
    pub fn new(contact: &Contact, part: &Part) -> Self {
        let of_wheel = |of: &dyn Fn(f64, f64, f64) -> f64| {
            Four(part.wheels.map(|wheel| {
                let (sin, cos) = libm::sincos(wheel.roller_angle().abs());
                let axle = wheel.radius() * (1.0 - contact.roller_ratio);
                of(sin, -cos * wheel.roller_angle().signum(), axle)
            }))
        };
        Self {
            footprint: Footprint::new(contact.rollers, part.phases, contact.settling),
            barrel: Barrel::new(contact, &part.wheels),
            sin_roller: of_wheel(&|sin, _, _| sin),
            left: of_wheel(&|_, left, _| left),
            wander: of_wheel(&|sin, left, axle| axle * left / sin),
        }
    }

    /// How the robot stands on wheels with these angles.
    #[inline(always)]
    pub fn stand(&self, angles: Four) -> Stand {
        let (first, other) = self.footprint.feet(angles);
        #[expect(
            clippy::manual_map,
            reason = "`map` is not always inlined, and so made without vectors"
        )]
        let second = match &other {
            Some(foot) => Some(self.touch(foot)),
            None => None,
        };
        Stand {
            down: [first.roller, other.as_ref().unwrap_or(&first).roller],
            first: self.touch(&first),
            other: second,
        }
    }

    #[inline(always)]
    fn touch(&self, foot: &Foot) -> Touch {
        // The roller's axle over the floor.
        let (ahead, left) = (foot.tilt * self.sin_roller, self.left);
        let shorter = Four::ONE / (ahead * ahead + left * left).sqrt();
        Touch {
            grip: self.barrel.grip(foot),
            ahead: ahead * shorter,
            left: left * shorter,
            along: self.wander * foot.tan,
        }
    }
}

impl Wheels {
    /// The wheels of a robot whose centre is at (`x`, `y`) from the body's centre of mass; no load
    /// yet.
    pub fn of(contact: &Contact, part: &Part, (x, y): (f64, f64)) -> Self {
        let (sin, cos) = libm::sincos(part.place.heading);
        let (ahead, left) = (
            part.wheels.map(|wheel| wheel.x()),
            part.wheels.map(|wheel| wheel.y()),
        );
        Self {
            robot: part.robot,
            x: Four::from_fn(|wheel| x + cos * ahead[wheel] - sin * left[wheel]),
            y: Four::from_fn(|wheel| y + sin * ahead[wheel] + cos * left[wheel]),
            sin,
            cos,
            radius: Four(part.wheels.map(|wheel| wheel.radius())) * (1.0 - contact.settling),
            per_creep: (1.0 / contact.creep).min(f64::MAX),
            damping: contact.roller_damping,
            load: Four::ZERO,
            limit: Four::ZERO,
            drag: Four::ZERO,
            rollers: Rollers::new(contact, &part.wheels),
            torques: Four::ZERO,
            inertia: contact.wheel_inertia,
        }
    }

    /// From now on they carry a load, N, on a floor with this friction.
    pub fn carry(&mut self, load: Four, friction: f64) {
        self.load = load;
        self.drag = load * self.damping;
        self.rub(Four::all(friction));
    }

    /// From now on this is the friction under each.
    #[inline(always)]
    pub fn rub(&mut self, friction: Four) {
        self.limit = friction * self.load;
    }

    /// Stands on these rollers with wheels that turn at `rates`, and puts into the next of `pushes`
    /// what the floor can do to them in the next `dt`.
    #[inline(always)]
    pub fn stand<'a>(
        &mut self,
        stand: &Stand,
        rates: Four,
        dt: f64,
        pushes: &mut impl Iterator<Item = &'a mut Pushes>,
    ) {
        self.rollers.stand_on(stand.down, self.drag);
        if let Some(pushes) = pushes.next() {
            self.push(0, &stand.first, rates, dt, pushes);
        }
        if let Some(other) = &stand.other
            && let Some(pushes) = pushes.next()
        {
            self.push(1, other, rates, dt, pushes);
        }
    }

    #[inline(always)]
    fn push(&mut self, which: usize, touch: &Touch, rates: Four, dt: f64, pushes: &mut Pushes) {
        let Touch {
            grip, ahead, left, ..
        } = *touch;
        let x = self.x - touch.along * self.sin;
        let y = self.y + touch.along * self.cos;
        let limit = self.limit * grip.share;
        let creeping = (limit * self.per_creep).min(Four::all(STIFFEST));
        let (rest, resistance) = self
            .rollers
            .resistance(which, &grip, creeping, self.drag, dt);
        let dx = ahead * self.cos - left * self.sin;
        let dy = ahead * self.sin + left * self.cos;
        let levers = self.levers(touch);
        pushes.axle = [dx, dy];
        pushes.arms = [x * dy - y * dx, x * dx + y * dy];
        pushes.rest = [rates * levers[0], rates * levers[1] + rest];
        pushes.limit = limit;
        pushes.stiffness = [
            self.giving(creeping, levers[0], grip.share, dt),
            self.giving(resistance, levers[1], grip.share, dt),
        ];
    }

    /// Over what levers a force along an axle and one across it turn the wheel, m.
    #[inline(always)]
    fn levers(&self, touch: &Touch) -> [Four; 2] {
        [touch.ahead * self.radius, -touch.left * self.radius]
    }

    /// Stiffness of contacts with wheels that give way to a newton in this step as far as they
    /// stand on these rollers, N s/m.
    #[inline(always)]
    fn giving(&self, mut stiffness: Four, lever: Four, share: Four, dt: f64) -> Four {
        if let Some(inertia) = self.inertia {
            let gives = lever * lever * dt / (share * inertia);
            stiffness = stiffness / (Four::ONE + stiffness * gives);
            stiffness = share.where_positive(stiffness, Four::ZERO);
        }
        stiffness
    }

    /// Turns the rollers on the floor by what it did to each in a step of `dt`: the next of
    /// `pushes` at this velocity of the body.
    #[inline(always)]
    pub fn turn_rollers<'a>(
        &mut self,
        stand: &Stand,
        pushes: &mut impl Iterator<Item = &'a Pushes>,
        dt: f64,
    ) {
        self.torques = Four::ZERO;
        if let Some(pushes) = pushes.next() {
            self.turn_each(0, &stand.first, pushes);
        }
        if let Some(other) = &stand.other
            && let Some(pushes) = pushes.next()
        {
            self.turn_each(1, other, pushes);
        }
        self.rollers.pass(dt);
    }

    #[inline(always)]
    fn turn_each(&mut self, which: usize, touch: &Touch, pushes: &Pushes) {
        let [along, across] = pushes.each();
        let force = across.held(pushes.wanted[1]);
        self.rollers.turn(which, force);
        if self.inertia.is_some() {
            let [ahead, left] = self.levers(touch);
            self.torques = self.torques + (ahead * along.held(pushes.wanted[0]) + left * force);
        }
    }
}

impl Pushes {
    pub const NONE: Self = Self {
        axle: [Four::ZERO; 2],
        arms: [Four::ZERO; 2],
        rest: [Four::ZERO; 2],
        limit: Four::ZERO,
        stiffness: [Four::ZERO; 2],
        wanted: [Four::ZERO; 2],
    };

    /// Along the axle, and across.
    #[inline(always)]
    pub fn each(&self) -> [Push; 2] {
        let ([x, y], limit) = (self.axle, self.limit);
        [
            Push {
                row: [x, y, self.arms[0]],
                rest: self.rest[0],
                limit,
                stiffness: self.stiffness[0],
            },
            Push {
                row: [-y, x, self.arms[1]],
                rest: self.rest[1],
                limit,
                stiffness: self.stiffness[1],
            },
        ]
    }
}
