//! Writes the group file into the robots.
//!
//! Every value goes over SDO in PRE-OPERATIONAL and is read back; then the robot is asked whether
//! its configuration is complete and fits together (object 0x2002:1). Nothing is written into a
//! robot that has not said before that it speaks this wire version. The list of values is one
//! function of the file, [`group::parameters`], which `omnibus group show` prints as well.

use canopen::{Micros, NmtCommand};
pub use group::{Parameter, compensation_set, member_mask, parameters};
use protocol::{Address, Kind, Value, address};

use crate::bus::link::Link;
use crate::error::MasterError;
use crate::session::sdo;
use crate::session::{Configured, Group};

impl<L: Link> Group<L> {
    /// Asks one robot who it is, again and again until it answers or `deadline` has come: it may
    /// still be booting.
    pub(crate) fn check_version(
        &mut self,
        index: usize,
        deadline: Micros,
    ) -> Result<(), MasterError> {
        let node = self.members()[index].node;
        loop {
            match self.wire.read(node, address::WIRE_VERSION, Kind::U16) {
                Ok(Value::U16(version)) if version == protocol::WIRE_VERSION => return Ok(()),
                Ok(value) => {
                    return Err(MasterError::WireVersion {
                        node,
                        found: value.to_bits(),
                    });
                }
                Err(error)
                    if matches!(error.cause(), MasterError::NodeSilent { .. })
                        && self.wire.now().0 < deadline.0 => {}
                Err(MasterError::NodeSilent { node }) => {
                    return Err(match self.wire.link.diagnosis() {
                        Some(diagnosis) => MasterError::BusDiagnosis { node, diagnosis },
                        None => MasterError::NodeSilent { node },
                    });
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// Takes all robots into PRE-OPERATIONAL and writes the group file into them.
    ///
    /// # Errors
    /// When a robot refuses a value, a value reads back differently, or a robot finds its
    /// configuration incomplete; the error names node and object. When that robot has restarted
    /// meanwhile, it says so: what was written before is gone then. Nothing moves.
    pub fn configure(&mut self, compensation: bool) -> Result<(), MasterError> {
        self.command(NmtCommand::EnterPreOperational)?;
        // What was received so far is from before; a member that restarts from here on may do so
        // after its values were written.
        self.listen(self.wire.now())?;
        self.restarted = None;
        // Should it end halfway.
        self.doubt_configuration();
        let written = self.write_file(compensation);
        self.listen(self.wire.now())?;
        match (written, self.restarted) {
            (
                Err(MasterError::ReadBack { node, .. } | MasterError::Configuration { node, .. }),
                Some(restarted),
            ) if node == restarted => Err(MasterError::MemberRestarted { node }),
            (result, _) => result,
        }
    }

    fn write_file(&mut self, compensation: bool) -> Result<(), MasterError> {
        let file = std::sync::Arc::clone(&self.file);
        for robot in &file.robots {
            for (at, value) in parameters(&file, robot, compensation) {
                self.wire.write_checked(robot.node, at, value)?;
            }
            // Only where it is another one: it is the longest value there is.
            let set = compensation_set(robot, compensation).map_err(|error| {
                MasterError::Configuration {
                    node: robot.node,
                    object: sdo::name(address::COMPENSATION_SET),
                    reason: format!("cannot be made: {error}"),
                }
            })?;
            let crc = self
                .wire
                .read(robot.node, address::COMPENSATION_CRC, Kind::U32)?;
            if crc.to_bytes() != set[..4] {
                let at = address::COMPENSATION_SET;
                self.wire.write_block(robot.node, at, &set)?;
            }
        }
        for robot in &file.robots {
            self.check_configuration(robot.node)?;
        }
        (self.configured, self.compensation) = (Configured::Whole, compensation);
        Ok(())
    }

    /// Reads whether a robot finds its configuration complete.
    fn check_configuration(&mut self, node: u8) -> Result<(), MasterError> {
        let status = self
            .wire
            .read(node, address::CONFIGURATION_STATUS, Kind::U32)?;
        let bits = status.to_bits();
        if bits == 0 {
            return Ok(());
        }
        // Index in the upper half, then sub-index, then the reason.
        let [reason, sub, low, high] = bits.to_le_bytes();
        let at = Address::new(u16::from_le_bytes([low, high]), sub);
        Err(MasterError::Configuration {
            node,
            object: sdo::name(at),
            reason: match reason {
                1 => "was not written".into(),
                2 => "does not fit the rest of the configuration".into(),
                other => format!("was refused by the robot for reason {other}"),
            },
        })
    }
}
