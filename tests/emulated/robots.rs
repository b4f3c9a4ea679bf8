//! The robots that a test runs with: reference boards, Board Cs or kits.

use emulator::Port;
use sim::Backend;

/// The robots of a test: their image, and what they are.
pub struct Robots {
    /// The variable of the environment that names the image.
    variable: &'static str,
    board: group::Board,
    pub led: (Port, u8),
}

pub const REFERENCE: Robots = Robots {
    variable: "OMNIBUS_ELF",
    board: group::Board::NucleoF446re,
    led: (Port::A, 5),
};

pub const BOARD_C: Robots = Robots {
    variable: "OMNIBUS_ELF_BOARD_C",
    board: group::Board::RobomasterC,
    led: (Port::H, 11),
};

pub const KIT: Robots = Robots {
    variable: "OMNIBUS_ELF_KIT",
    board: group::Board::KitF103rc,
    led: (Port::C, 13),
};

impl Robots {
    pub fn image(&self) -> emulator::Firmware {
        super::common::image(self.variable)
    }

    pub fn backend(&self) -> Backend {
        Backend::Emulator(self.image())
    }

    /// A group file of the workspace, with these robots in it.
    pub fn group(&self, name: &str) -> group::GroupFile {
        let mut group = super::common::group(name);
        for robot in &mut group.robots {
            robot.board = self.board;
            match self.board {
                group::Board::NucleoF446re => {}
                group::Board::RobomasterC => super::common::fit_smart_drives(robot),
                group::Board::KitF103rc => robot.output.kind = group::StageKind::InInBrake,
            }
        }
        group
    }
}
