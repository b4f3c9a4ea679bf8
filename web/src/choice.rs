//! What can be chosen on the page, and the group file that it stands for.
//!
//! The groups are the seven configurations of the source paper (its figure 19), one robot alone,
//! and two robots of different size. A free group is the file of the connected one with its robots
//! unbolted.
//!
//! On the contact floor robots need other coefficients than on the paper's tables: [`MEAN`] and
//! [`PHASED`] are those that a calibration there gives for the paper's robot
//! (`omnibus::simulation::contact::calibrated`); a test compares them.

use group::{CompensationTable, ContactLag, GroupFile};
use kinematics::VelocityCompensation;
use omnibus::simulation::contact;
use serde::Deserialize;

/// Rollers of a wheel on the contact floor.
pub const ROLLERS: u8 = 8;

/// Name, what the page calls it, file, and whether the robots are bolted together.
pub const GROUPS: [(&str, &str, &str, bool); 9] = [
    ("tcc-3", "TCC-3: three in tandem, connected", TCC_3, true),
    ("tcc-2", "TCC-2: two in tandem, connected", TCC_2, true),
    ("tuc-2", "TUC-2: two in tandem, free", TCC_2, false),
    ("scc-2", "SCC-2: two side by side, connected", SCC_2, true),
    ("suc-2", "SUC-2: two side by side, free", SCC_2, false),
    ("acc-2", "ACC-2: two at an angle, connected", ACC_2, true),
    ("auc-2", "AUC-2: two at an angle, free", ACC_2, false),
    ("single", "one robot", SINGLE, true),
    ("sizes", "two of different size, connected", SIZES, true),
];

const TCC_3: &str = include_str!("../../groups/tcc-3.toml");
const TCC_2: &str = include_str!("../../groups/tcc-2.toml");
const SCC_2: &str = include_str!("../../groups/scc-2.toml");
const ACC_2: &str = include_str!("../../groups/acc-2.toml");
const SINGLE: &str = include_str!("../../groups/single.toml");
const SIZES: &str = include_str!("../../groups/sizes.toml");

/// What a calibration on the contact floor gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibrated {
    /// Longitudinal, lateral, yaw coefficients, without a unit.
    pub coefficients: [f32; 3],
    /// Share of a lateral velocity that the hand-over of rollers costs, s/m.
    pub hand_over_loss: f32,
    /// How far the group trails its wheels, s.
    pub lag: [f32; 3],
}

/// For robots that are told nothing of their rollers.
pub const MEAN: Calibrated = Calibrated {
    coefficients: [1.0022, 1.0312, 1.0144],
    hand_over_loss: 0.0,
    lag: [0.0095, 0.0088, 0.0],
};

/// For robots that know the phases of their rollers.
pub const PHASED: Calibrated = Calibrated {
    coefficients: [1.0022, 1.0039, 1.0017],
    hand_over_loss: 0.0013,
    lag: [0.0095, 0.0091, 0.0008],
};

/// The floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Floor {
    /// Losses as the source paper measured them.
    Table,
    /// Rollers with friction.
    Contact,
}

/// The robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Robots {
    /// The robot's crate compiled with the rest.
    Native,
    /// The release image on an emulated processor.
    Emulated,
}

/// What was chosen on the page.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Choice {
    /// The first of a row of [`GROUPS`].
    pub group: String,
    /// The floor.
    pub floor: Floor,
    /// Whether losses are made up for.
    pub compensation: bool,
    /// Whether robots on the contact floor know the phases of their rollers.
    pub phases: bool,
    /// The robots.
    pub robots: Robots,
}

impl Choice {
    /// The group file of this choice.
    ///
    /// # Errors
    /// When there is no group of this name, or its file is damaged.
    pub fn file(&self) -> Result<GroupFile, String> {
        let Some((name, _, text, rigid)) = GROUPS.iter().find(|(name, ..)| *name == self.group)
        else {
            let names = GROUPS.map(|(name, ..)| name).join(", ");
            return Err(format!("no group {}; there are {names}", self.group));
        };
        let mut file = GroupFile::parse(name, text).map_err(|error| error.to_string())?;
        (*name).clone_into(&mut file.name);
        file.simulation.rigid = *rigid;
        if self.floor == Floor::Contact {
            file = contact::on_contact(&file, ROLLERS);
            let mut calibrated = MEAN;
            if self.phases {
                file = contact::with_phases(&file);
                calibrated = PHASED;
            }
            set_compensation(&mut file, &calibrated)?;
        }
        if !self.compensation {
            uncompensated(&mut file);
        }
        Ok(file)
    }
}

fn set_compensation(file: &mut GroupFile, calibrated: &Calibrated) -> Result<(), String> {
    let [longitudinal, lateral, yaw] = calibrated.coefficients;
    let compensation = VelocityCompensation::new(longitudinal, lateral, yaw)
        .map_err(|error| format!("{error:?}"))?;
    let [longitudinal, lateral, yaw] = calibrated.lag;
    file.hand_over_loss = calibrated.hand_over_loss;
    file.contact_lag = ContactLag {
        longitudinal,
        lateral,
        yaw,
    };
    for robot in &mut file.robots {
        match &mut robot.rollers {
            Some(rollers) => rollers.compensation = compensation,
            None => robot.compensation = compensation,
        }
    }
    Ok(())
}

fn uncompensated(file: &mut GroupFile) {
    file.hand_over_loss = 0.0;
    file.contact_lag = ContactLag::default();
    for robot in &mut file.robots {
        robot.compensation = VelocityCompensation::NONE;
        robot.compensation_table = CompensationTable::default();
        if let Some(rollers) = &mut robot.rollers {
            rollers.compensation = VelocityCompensation::NONE;
        }
    }
}
