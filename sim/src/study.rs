//! Many groups at once, without a bus: for planning studies in which a thousand groups have to be
//! driven faster than real time and the frames on the bus do not matter.
//!
//! A group is its members' kinematics and its plant. Every SYNC period the caller gives a twist;
//! the group's twist follows it within the acceleration limits, all members use the smallest scale
//! at which every wheel stays within its rate, and the wheels turn exactly as commanded. Bus,
//! clocks, motors, wheel loops, encoders and faults are left out. The kinematics, the compensation
//! and the plants are those of the full simulation.
//!
//! Groups are independent, so they run on all available threads, with the same result on any
//! number. Each group runs through the whole time of a call before the next one, so that its state
//! stays in the processor's cache and the cost per robot does not depend on the number of robots.

use group::{GroupFile, Plant as Kind};
use kinematics::{MemberKinematics, Mount, Pose, Twist, VelocityCompensation, WheelRates};

use crate::error::SimError;
use crate::plant::{self, Plant};

/// How a study is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StudyOptions {
    /// Step of the plants, s; a SYNC period is cut into whole ones.
    pub step: f64,
    /// Whether members compensate as their file says.
    pub compensation: bool,
}

impl Default for StudyOptions {
    fn default() -> Self {
        Self {
            step: 1e-3,
            compensation: true,
        }
    }
}

/// A group of a study.
pub struct StudyGroup {
    members: Vec<Member>,
    plant: Box<dyn Plant>,
    /// Acceleration limits, m/s² and rad/s².
    linear: f64,
    yaw: f64,
    period: f64,
    steps: u32,
    twist: Twist<f64>,
    turned: Vec<[f64; 4]>,
    periods: u64,
    worst_shape_error_mm: f64,
}

struct Member {
    kinematics: MemberKinematics<f64>,
    max_rate: f64,
}

impl StudyGroup {
    /// A group at rest with its frame at `start`.
    ///
    /// # Errors
    /// When a robot's wheels have no kinematics, the plant cannot be built, or it is another
    /// program.
    pub fn new(
        file: &GroupFile,
        start: Pose<f64>,
        options: StudyOptions,
    ) -> Result<Self, SimError> {
        if matches!(file.simulation.plant, Kind::External { .. }) {
            return Err(SimError::Plant {
                problem: "simulation.plant: a study cannot wait for another program; use table or \
                          contact"
                    .to_owned(),
            });
        }
        let members = file.robots.iter().map(|robot| {
            let mount = Mount::new(robot.mount).map_err(SimError::wheels)?;
            let compensation = if options.compensation {
                robot.compensation
            } else {
                VelocityCompensation::new(1.0, 1.0, 1.0).map_err(SimError::wheels)?
            };
            let kinematics = MemberKinematics::new(&robot.geometry, &mount, &compensation)
                .map_err(SimError::wheels)?;
            Ok(Member {
                kinematics: kinematics.convert().map_err(SimError::wheels)?,
                max_rate: f64::from(robot.max_wheel_rate),
            })
        });
        let period = f64::from(file.sync_period_us) * 1e-6;
        Ok(Self {
            members: members.collect::<Result<_, SimError>>()?,
            plant: plant::build(file, start)?,
            linear: f64::from(file.limits.linear_acceleration),
            yaw: f64::from(file.limits.yaw_acceleration),
            period,
            steps: (period / options.step).ceil().max(1.0) as u32,
            twist: Twist::new(0.0, 0.0, 0.0),
            turned: vec![[0.0; 4]; file.robots.len()],
            periods: 0,
            worst_shape_error_mm: 0.0,
        })
    }

    /// Time that has passed, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.periods as f64 * self.period
    }

    /// Where the group is.
    #[must_use]
    pub fn pose(&self) -> Pose<f64> {
        self.plant.group()
    }

    /// Where its robots are.
    #[must_use]
    pub fn robots(&self) -> &[Pose<f64>] {
        self.plant.poses()
    }

    /// Largest distance of a robot from its place so far, mm, sampled once a period.
    #[must_use]
    pub fn worst_shape_error_mm(&self) -> f64 {
        self.worst_shape_error_mm
    }

    /// One SYNC period towards `asked`, the group's twist in its own frame.
    fn advance(&mut self, asked: Twist<f64>) -> Result<(), SimError> {
        self.twist = self.limited(asked);
        let dt = self.period / f64::from(self.steps);
        let mut scale: f64 = 1.0;
        for (member, turned) in self.members.iter().zip(&mut self.turned) {
            let rates: WheelRates<f64> = member.kinematics.inverse(self.twist);
            *turned = rates.into();
            let fastest = turned
                .iter()
                .fold(0.0f64, |most, rate| most.max(rate.abs()));
            if fastest > member.max_rate {
                scale = scale.min(member.max_rate / fastest);
            }
        }
        for turned in &mut self.turned {
            *turned = turned.map(|rate| rate * scale * dt);
        }
        self.plant.steps(self.steps, dt, &self.turned)?;
        self.periods += 1;
        self.worst_shape_error_mm = self.worst_shape_error_mm.max(self.plant.shape_error_mm());
        Ok(())
    }

    /// The twist after one period that goes towards `asked` as fast as it may.
    fn limited(&self, asked: Twist<f64>) -> Twist<f64> {
        let (dx, dy) = (asked.vx - self.twist.vx, asked.vy - self.twist.vy);
        let change = dx.hypot(dy);
        let most = self.linear * self.period;
        let part = if change > most { most / change } else { 1.0 };
        let turn = self.yaw * self.period;
        Twist::new(
            self.twist.vx + part * dx,
            self.twist.vy + part * dy,
            self.twist.omega + (asked.omega - self.twist.omega).clamp(-turn, turn),
        )
    }
}

/// Groups that run side by side.
pub struct Study {
    groups: Vec<StudyGroup>,
}

impl Study {
    /// A study of these groups.
    #[must_use]
    pub fn new(groups: Vec<StudyGroup>) -> Self {
        Self { groups }
    }

    /// A group so many times, each with the next seed, all at `start`.
    ///
    /// # Errors
    /// As [`StudyGroup::new`].
    pub fn copies(
        file: &GroupFile,
        count: usize,
        start: Pose<f64>,
        options: StudyOptions,
    ) -> Result<Self, SimError> {
        let mut file = file.clone();
        let groups = (0..count).map(|_| {
            let group = StudyGroup::new(&file, start, options);
            file.simulation.seed = file.simulation.seed.wrapping_add(1);
            group
        });
        Ok(Self::new(groups.collect::<Result<_, _>>()?))
    }

    /// Its groups.
    #[must_use]
    pub fn groups(&self) -> &[StudyGroup] {
        &self.groups
    }

    /// Robots in all groups.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.groups.iter().map(|group| group.members.len()).sum()
    }

    /// Lets so many SYNC periods pass on so many threads. Before each one `command` is asked for
    /// the twist, in the group's own frame, of the group with this place.
    ///
    /// # Errors
    /// When a plant fails.
    pub fn run(
        &mut self,
        periods: u32,
        threads: usize,
        command: &(dyn Fn(usize, &StudyGroup) -> Twist<f64> + Sync),
    ) -> Result<(), SimError> {
        let run = |first: usize, groups: &mut [StudyGroup]| -> Result<(), SimError> {
            for (n, group) in groups.iter_mut().enumerate() {
                for _ in 0..periods {
                    let asked = command(first + n, group);
                    group.advance(asked)?;
                }
            }
            Ok(())
        };
        let share = self.groups.len().div_ceil(threads.max(1)).max(1);
        if share >= self.groups.len() {
            return run(0, &mut self.groups);
        }
        std::thread::scope(|scope| {
            let parts = self.groups.chunks_mut(share).enumerate();
            let running: Vec<_> = parts
                .map(|(n, part)| scope.spawn(move || run(n * share, part)))
                .collect();
            running.into_iter().try_for_each(|thread| {
                thread
                    .join()
                    .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            })
        })
    }
}
