//! The source paper's experiments by name: its Tables 3 to 9, its eleven motions, its seven
//! configurations.
//!
//! A [`Scenario`] drives simulated robots over their bus, as a master would, measures their true
//! motion, and prints the results beside the paper's. Each is run on one plant or on several; every
//! plant gets its column. Robots, curves and coefficients are the paper's where it gives them;
//! [`robots`] lists the assumptions. The paper's axes are used throughout: x lateral, right
//! positive; y longitudinal.

pub mod configurations;
pub mod drive;
pub mod motions;
pub mod page;
pub mod robots;
pub mod tables;

use chart::Chart;

use crate::error::SimError;
use crate::robot::Backend;

/// A plant to run on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OnPlant {
    /// The paper's own tables.
    Table,
    /// Rollers, friction, rigid bodies.
    Contact,
}

impl OnPlant {
    /// Its name in group files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Table => "table",
            Self::Contact => "contact",
        }
    }
}

/// What to run with.
#[derive(Debug)]
pub struct Setting {
    /// What the robots are.
    pub backend: Backend,
    /// The plants, one column each; empty takes the scenario's own.
    pub plants: Vec<OnPlant>,
}

impl Setting {
    /// The plants asked for, else these.
    fn plants(&self, usual: &[OnPlant]) -> Vec<OnPlant> {
        if self.plants.is_empty() {
            usual.to_vec()
        } else {
            self.plants.clone()
        }
    }
}

/// One number of the paper, and what came out here.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// What was measured, and at what setting.
    pub what: String,
    /// Its unit.
    pub unit: &'static str,
    /// What the paper prints, in the unit, where it prints it.
    pub paper: Option<f64>,
    /// What came out, in the unit, a value a column.
    pub ours: Vec<f64>,
}

/// What a scenario found.
#[derive(Debug, Clone)]
pub struct Findings {
    /// The scenario's name.
    pub name: &'static str,
    /// The scenario's text.
    pub text: &'static str,
    /// What has to be known to read it.
    pub notes: Vec<String>,
    /// Names of the columns of [`Row::ours`].
    pub columns: Vec<String>,
    /// The table.
    pub rows: Vec<Row>,
    /// The figures.
    pub charts: Vec<Chart>,
}

/// An experiment of the paper.
pub struct Scenario {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it is, with its place in the paper.
    pub text: &'static str,
    run: Run,
}

enum Run {
    Table(fn(&Setting) -> Result<Parts, SimError>),
    Motion(kinematics::trajectory::MotionMode),
    Configuration(configurations::Kind),
}

/// What a scenario's own code finds; name and text are added.
#[derive(Debug, Default)]
pub(crate) struct Parts {
    notes: Vec<String>,
    columns: Vec<String>,
    rows: Vec<Row>,
    charts: Vec<Chart>,
}

impl Scenario {
    /// Runs it.
    ///
    /// # Errors
    /// When a robot faults or the world cannot continue.
    pub fn run(&self, setting: &Setting) -> Result<Findings, SimError> {
        let parts = match &self.run {
            Run::Table(run) => run(setting),
            Run::Motion(mode) => motions::run(*mode, setting),
            Run::Configuration(kind) => configurations::run(*kind, setting),
        }?;
        Ok(Findings {
            name: self.name,
            text: self.text,
            notes: parts.notes,
            columns: parts.columns,
            rows: parts.rows,
            charts: parts.charts,
        })
    }
}

/// The scenario with this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static Scenario> {
    SCENARIOS.iter().find(|scenario| scenario.name == name)
}

/// All of them, in the paper's order.
pub const SCENARIOS: &[Scenario] = &{
    use configurations::Kind;
    use kinematics::trajectory::MotionMode as Mode;
    const fn table(
        name: &'static str,
        text: &'static str,
        run: fn(&Setting) -> Result<Parts, SimError>,
    ) -> Scenario {
        let run = Run::Table(run);
        Scenario { name, text, run }
    }
    const fn motion(name: &'static str, text: &'static str, mode: Mode) -> Scenario {
        let run = Run::Motion(mode);
        Scenario { name, text, run }
    }
    const fn group(name: &'static str, text: &'static str, kind: Kind) -> Scenario {
        let run = Run::Configuration(kind);
        Scenario { name, text, run }
    }
    [
        table(
            "table-3",
            "virtual robot, straight motion (Table 3, figure 8)",
            tables::table_3,
        ),
        table(
            "table-4",
            "virtual robot, oblique motion (Table 4, figure 10)",
            tables::table_4,
        ),
        table(
            "table-5",
            "virtual robot, turning on the spot (Table 5)",
            tables::table_5,
        ),
        table(
            "table-6",
            "virtual robot, curves (Table 6, figure 12)",
            tables::table_6,
        ),
        table(
            "table-7",
            "physical robot, straight motion (Table 7)",
            tables::table_7,
        ),
        table(
            "table-8",
            "physical robot, turning on the spot (Table 8)",
            tables::table_8,
        ),
        table(
            "table-9",
            "physical robot, curves, without and with C3 (Table 9, figure 18)",
            tables::table_9,
        ),
        motion(
            "longitudinal",
            "motion (a): straight ahead",
            Mode::Longitudinal,
        ),
        motion("lateral", "motion (b): sideways", Mode::Lateral),
        motion("oblique", "motion (c): at 45 degrees", Mode::Oblique),
        motion("turning", "motion (d): turning on the spot", Mode::Turning),
        motion("circle", "motion (e): circle of 2500 mm", Mode::Circle),
        motion(
            "figure-eight",
            "motion (f): figure-eight of 2500 mm",
            Mode::FigureEight,
        ),
        motion("harmonic", "motion (g): harmonic curve", Mode::Harmonic),
        motion(
            "oblique-circle",
            "motion (h): circle, robot turned by 60 degrees",
            Mode::ObliqueCircle,
        ),
        motion(
            "oblique-figure-eight",
            "motion (i): figure-eight, robot turned by 60 degrees",
            Mode::ObliqueFigureEight,
        ),
        motion(
            "centripetal",
            "motion (j): circle of 1350 mm, front outwards",
            Mode::Centripetal,
        ),
        motion(
            "oblique-centripetal",
            "motion (l): the same, robot turned by 45 degrees",
            Mode::ObliqueCentripetal,
        ),
        group(
            "scc-2",
            "two robots side by side, connected (figure 19a)",
            Kind::Scc2,
        ),
        group(
            "suc-2",
            "two robots side by side, free (figure 19b)",
            Kind::Suc2,
        ),
        group(
            "tcc-2",
            "two robots in tandem, connected (figure 19c)",
            Kind::Tcc2,
        ),
        group(
            "tuc-2",
            "two robots in tandem, free (figure 19d)",
            Kind::Tuc2,
        ),
        group(
            "tcc-3",
            "three robots in tandem, connected (figure 19e)",
            Kind::Tcc3,
        ),
        group(
            "auc-2",
            "two robots at 30 degrees, free (figure 19f)",
            Kind::Auc2,
        ),
        group(
            "acc-2",
            "two robots at 30 degrees, connected (figure 19f)",
            Kind::Acc2,
        ),
    ]
};
