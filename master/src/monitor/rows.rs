//! Everything that the master received during a run, one row per SYNC.
//!
//! The recorder is fed by the session with decoded frames and closed once per SYNC period. It
//! holds plain numbers in SI units and the group frame (REP-103); it grows by one row per member
//! and SYNC (about 100 B), so a minute at 100 Hz with 16 robots is some 10 MB. It cannot fail and
//! judges nothing: [`crate::monitor::metrics`] and [`crate::report`] do.

use kinematics::{Pose, Twist, WheelRates};
use protocol::Limit;

use super::average::mean_pose;

/// What one member said in one SYNC period; `None` where its frame did not come.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MemberRow {
    /// Scale at which its own wheels could follow, 0..=1.
    pub permitted_scale: Option<f32>,
    /// Wheel rates that no rigid motion explains, in rad/s as reported.
    pub slip_residual: Option<f32>,
    /// Fault or limit code as sent; 0 is none.
    pub code: Option<u16>,
    /// Measured velocity, in the group frame.
    pub measured: Option<Twist>,
    /// Odometry pose as reported.
    pub pose: Option<Pose>,
    /// Measured wheel rates in rad/s, positive rolls the base forward.
    pub wheel_rates: Option<WheelRates>,
    /// Yaw rate of its gyro, rad/s, counter-clockwise positive; only where that is used.
    pub yaw_rate: Option<f32>,
}

/// One SYNC period of the whole group.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Time of the SYNC on the link's clock since the run began, in s.
    pub t: f64,
    /// Sequence number of the group twist sent before the SYNC.
    pub sequence: u8,
    /// The group twist sent before the SYNC.
    pub command: Twist,
    /// One entry per robot, in the order of the group file.
    pub members: Vec<MemberRow>,
}

impl Row {
    /// Where the members say the group was: the mean.
    #[must_use]
    pub fn pose(&self) -> Option<Pose> {
        mean_pose(self.members.iter().filter_map(|member| member.pose))
    }
}

/// The slowest that a group was, and because of whom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slowdown {
    /// Smallest share of what was asked for that all members could follow.
    pub scale: f32,
    /// Place of the member that allowed no more.
    pub member: usize,
    /// Its limit, where it named one.
    pub limit: Option<Limit>,
}

/// Less than this is no rounding.
const SLOWED: f32 = 0.99;

/// Whether a group that was asked to move ran slower than that, from the rows of its run.
#[must_use]
pub fn slowdown<'a>(rows: impl IntoIterator<Item = &'a Row>) -> Option<Slowdown> {
    let moving = rows.into_iter().filter(|row| row.command != Twist::ZERO);
    let each = moving.flat_map(|row| row.members.iter().enumerate());
    let scales = each.filter_map(|(member, row)| {
        let scale = row
            .permitted_scale
            .filter(|scale| *scale > 0.0 && *scale < SLOWED)?;
        let limit = row.code.and_then(Limit::from_code);
        Some(Slowdown {
            scale,
            member,
            limit,
        })
    });
    scales.min_by(|a, b| a.scale.total_cmp(&b.scale))
}

/// What is kept of all rows, also of those that were dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outline {
    /// Where the group was first seen.
    pub first: Option<Pose>,
    /// The slowest that it was, where it was slower than asked.
    pub slowest: Option<Slowdown>,
}

impl Outline {
    fn add(&mut self, row: &Row) {
        self.first = self.first.or_else(|| row.pose());
        let both = [self.slowest, slowdown([row])].into_iter().flatten();
        self.slowest = both.min_by(|a, b| a.scale.total_cmp(&b.scale));
    }
}

/// The rows of a run, and the one being filled.
#[derive(Clone, Debug, Default)]
pub struct Recorder {
    rows: Vec<Row>,
    limit: Option<usize>,
    dropped: Outline,
}

impl Recorder {
    /// Keeps at least the last `rows` rows and drops older ones: for sessions without an end.
    /// Places of rows change when some are dropped.
    pub fn keep_last(&mut self, rows: usize) {
        self.limit = Some(rows.max(2));
    }

    /// Opens the row of the SYNC at `t`.
    pub fn open(&mut self, t: f64, sequence: u8, command: Twist, members: usize) {
        if let Some(limit) = self.limit
            && self.rows.len() >= 2 * limit
        {
            for row in self.rows.drain(..limit) {
                self.dropped.add(&row);
            }
        }
        self.rows.push(Row {
            t,
            sequence,
            command,
            members: vec![MemberRow::default(); members],
        });
    }

    /// The entry of a member in the row being filled; `None` before the first SYNC.
    pub fn member(&mut self, index: usize) -> Option<&mut MemberRow> {
        self.rows.last_mut()?.members.get_mut(index)
    }

    /// What all rows come to, those that were dropped among them.
    #[must_use]
    pub fn outline(&self) -> Outline {
        let mut outline = self.dropped;
        for row in &self.rows {
            outline.add(row);
        }
        outline
    }

    /// All rows in order of time.
    #[must_use]
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }
}

/// What an outside observer saw of one robot: the simulator's truth, or a motion-capture system.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotTruth {
    /// Pose in the world, m, m, rad.
    pub pose: Pose,
    /// Rate of the wheels' hubs, in rad/s, positive rolls the base forward.
    pub wheel_rates: WheelRates,
}

/// What an outside observer saw at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct TruthRow {
    /// Time since the first instant of the curve, in s; negative before it.
    pub t: f64,
    /// Pose the curve asks for.
    pub theory: Pose,
    /// Velocity the curve asks for, world frame.
    pub theory_twist: Twist,
    /// Pose of the group.
    pub group: Pose,
    /// Largest distance of a robot from its place in the group, in mm.
    pub shape_error_mm: f64,
    /// Load of the bus over the sampling period, 0..=1.
    pub bus_load: f64,
    /// One entry per robot, in the order of the group file.
    pub robots: Vec<RobotTruth>,
}
