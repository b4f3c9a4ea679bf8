//! The report of one or more runs: a table for the terminal, an HTML page with charts, a JSON file.
//!
//! [`Report`] holds the figures and the rows they came from; the submodules only present them, each
//! in its own way: [`table`] (terminal), [`html`] (one self-contained page), [`json`]
//! (for programs). The paper's printed values stand beside the measured ones wherever the paper
//! ran the same curve; where it printed none, none is shown.

pub mod charts;
pub mod figures;
pub mod html;
pub mod json;
pub mod motion;
pub mod table;

/// How charts look; shared with the simulator.
pub use ::chart;

use crate::monitor::metrics::{Evenness, PathErrors};
use crate::monitor::rows::{Row, TruthRow};

/// Robots in a sentence: `node 2`, `nodes 2, 3`.
#[must_use]
pub fn nodes(nodes: &[u8]) -> String {
    let word = if nodes.len() == 1 { "node" } else { "nodes" };
    let numbers: Vec<_> = nodes.iter().map(u8::to_string).collect();
    format!("{word} {}", numbers.join(", "))
}

/// One drive along the curve.
#[derive(Clone, Debug)]
pub struct Run {
    /// Whether the members compensated for wheel slip.
    pub compensation: bool,
    /// Whether the members computed with the angles of their wheels' rollers.
    pub phase: bool,
    /// Displacement and tracking errors.
    pub errors: PathErrors,
    /// Ripple and heading.
    pub evenness: Evenness,
    /// Largest distance of a robot from its place in the group, in mm.
    pub shape_error_mm: f64,
    /// Largest bus load over 100 ms while driving, in per cent; `None` where it was not measured.
    pub bus_load_percent: Option<f64>,
    /// Time on the robots' clocks over time on the wall.
    pub realtime_factor: f64,
    /// What the observer saw, in order of time.
    pub truth: Vec<TruthRow>,
    /// What the master heard, in order of time.
    pub rows: Vec<Row>,
}

impl Run {
    /// "off", "on", "phase" or "phase+on".
    #[must_use]
    pub fn compensation_word(&self) -> &'static str {
        match (self.phase, self.compensation) {
            (false, false) => "off",
            (false, true) => "on",
            (true, false) => "phase",
            (true, true) => "phase+on",
        }
    }
}

/// What the robots ran on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum BackendName {
    /// The firmware's control code compiled for this machine.
    Native,
    /// The firmware image on emulated microcontrollers.
    Emulator,
    /// Robots on a real bus, seen through their own odometry.
    #[value(skip)]
    Robots,
}

impl BackendName {
    /// The word used on the command line and in JSON.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Emulator => "emulator",
            Self::Robots => "robots",
        }
    }
}

impl std::fmt::Display for BackendName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.word())
    }
}

/// What the robots compute their kinematics in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Scalar {
    /// Single precision, on the floating-point unit.
    F32,
    /// 32-bit fixed point, `I16F16`.
    Fixed,
}

impl Scalar {
    /// The word used on the command line and in JSON.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Fixed => "fixed",
        }
    }
}

impl std::fmt::Display for Scalar {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.word())
    }
}

/// A robot as drawn on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// Node id, for labels.
    pub node: u8,
    /// Pose in the group frame.
    pub mount: kinematics::Pose,
    /// Half of the distance between left and right wheels, in m.
    pub half_track: f32,
    /// Half of the distance between front and rear wheels, in m.
    pub half_wheelbase: f32,
}

/// Everything a report shows.
#[derive(Clone, Debug)]
pub struct Report {
    /// What the robots ran on.
    pub backend: BackendName,
    /// What they computed in; `None` where it is unknown.
    pub scalar: Option<Scalar>,
    /// Name of the group.
    pub config: String,
    /// Name of the curve.
    pub trajectory: String,
    /// The robots of the group.
    pub robots: Vec<Outline>,
    /// The drives, in the order they were made.
    pub runs: Vec<Run>,
    /// Whether figures are in the paper's axes, beside its values.
    pub paper: bool,
    /// Why the last drive ended before its curve did, where it did.
    pub stopped: Option<String>,
}

impl Report {
    /// What drove what.
    #[must_use]
    pub fn title(&self) -> String {
        match self.robots.len() {
            1 => format!("{}, one robot", self.trajectory),
            robots => format!("{}, {robots} robots as one body", self.trajectory),
        }
    }

    /// What heads a run's figures. Compensation is named where runs differ in it or it was left
    /// out; it is on otherwise, and a group file without coefficients has none to name.
    #[must_use]
    pub fn heading(&self, run: &Run) -> String {
        match &self.runs[..] {
            [only] if only.compensation => "this run".into(),
            _ => format!("compensation {}", run.compensation_word()),
        }
    }

    /// Whether the curve turns on the spot.
    #[must_use]
    pub fn turns(&self) -> bool {
        self.trajectory == "turn"
    }
}

impl Report {
    /// Largest bus load of all runs, in per cent; `None` where it was not measured.
    #[must_use]
    pub fn bus_load_percent(&self) -> Option<f64> {
        let loads = self.runs.iter().filter_map(|run| run.bus_load_percent);
        loads.reduce(f64::max)
    }

    /// Smallest ratio of emulated time over real time of all runs.
    #[must_use]
    pub fn realtime_factor(&self) -> f64 {
        self.runs
            .iter()
            .map(|run| run.realtime_factor)
            .fold(f64::INFINITY, f64::min)
    }
}

/// What the paper printed for the same curve (Table 6, virtual prototype, without compensation):
/// relative error of displacement in per cent, lateral and longitudinal.
#[must_use]
pub fn paper_table_6(trajectory: &str) -> Option<(f64, f64)> {
    match trajectory {
        "circle" => Some((-3.48, -0.14)),
        "figure-eight" => Some((-2.92, -0.28)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::nodes;

    #[test]
    fn one_robot_is_not_many() {
        assert_eq!(nodes(&[2]), "node 2");
        assert_eq!(nodes(&[2, 3]), "nodes 2, 3");
    }
}
