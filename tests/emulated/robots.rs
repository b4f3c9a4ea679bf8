//! The robots that a test runs with: reference boards or Board Cs.

use emulator::Port;
use sim::Backend;

/// The robots of a test: their image, and what they are.
pub struct Robots {
    /// The variable of the environment that names the image.
    variable: &'static str,
    is_board_c: bool,
    pub led: (Port, u8),
}

pub const REFERENCE: Robots = Robots {
    variable: "OMNIBUS_ELF",
    is_board_c: false,
    led: (Port::A, 5),
};

pub const BOARD_C: Robots = Robots {
    variable: "OMNIBUS_ELF_BOARD_C",
    is_board_c: true,
    led: (Port::H, 11),
};

impl Robots {
    pub fn image(&self) -> emulator::Firmware {
        super::named_image(self.variable)
    }

    pub fn backend(&self) -> Backend {
        Backend::Emulator(self.image())
    }

    /// A group file of the workspace, with these robots in it.
    pub fn group(&self, name: &str) -> group::GroupFile {
        let mut group = super::common::group(name);
        if self.is_board_c {
            for robot in &mut group.robots {
                robot.board = group::Board::RobomasterC;
                super::common::fit_smart_drives(robot);
            }
        }
        group
    }
}
