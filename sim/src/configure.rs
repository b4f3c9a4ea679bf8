//! The group file written into the robots of a world, over its bus.
//!
//! For programs that bring their own simple master, as [`crate::test_master`] is one: the same
//! objects with the same values as `omnibus` writes ([`group::parameters`]), over SDO, in
//! PRE-OPERATIONAL.

use canopen::client::{Outcome, SdoClient};
use canopen::{Micros, NmtCommand, NmtTarget, NodeId, client};
use group::GroupFile;
use protocol::{Address, address};

use crate::error::SimError;
use crate::world::World;

/// How long robots may take to start.
const BOOT: Micros = Micros(200_000);
/// How long a robot may take for one answer.
const ANSWER: Micros = Micros(250_000);

/// Waits until the robots have started and writes everything they must know into them; without
/// `compensation` they get the values of robots that lose nothing.
///
/// # Errors
/// When a robot does not answer, refuses a value or finds its configuration incomplete.
pub fn configure(world: &mut World, file: &GroupFile, compensation: bool) -> Result<(), SimError> {
    world.run_until(world.now() + BOOT)?;
    world.send(client::nmt(NmtCommand::EnterPreOperational, NmtTarget::All));
    for robot in &file.robots {
        for (at, value) in group::parameters(file, robot, compensation) {
            let length = usize::from(value.kind().bytes());
            transfer(world, robot.node, at, Some(&value.to_bytes()[..length]))?;
        }
        let set =
            group::compensation_set(robot, compensation).map_err(|error| SimError::Robot {
                node: robot.node,
                problem: format!("cannot be given its compensation tables: {error}"),
            })?;
        transfer(world, robot.node, address::COMPENSATION_SET, Some(&set))?;
    }
    for robot in &file.robots {
        let status = transfer(world, robot.node, address::CONFIGURATION_STATUS, None)?;
        if status.iter().any(|byte| *byte != 0) {
            return Err(SimError::Robot {
                node: robot.node,
                problem: format!("finds its configuration incomplete: {status:02x?}"),
            });
        }
    }
    Ok(())
}

/// Reads an object, or writes `data` into it.
fn transfer(
    world: &mut World,
    node: u8,
    at: Address,
    data: Option<&[u8]>,
) -> Result<Vec<u8>, SimError> {
    let problem = |what: String| SimError::Robot {
        node,
        problem: format!("object {at}: {what}"),
    };
    let server = NodeId::new(node).ok_or_else(|| problem("no CANopen node".to_owned()))?;
    let mut client = SdoClient::new(server, ANSWER);
    let now = world.now();
    match data {
        Some(data) => client.download(now, at.index, at.sub, data),
        None => client.upload(now, at.index, at.sub),
    }
    .map_err(|_| problem("the request cannot be made".to_owned()))?;
    loop {
        while let Some(frame) = client.pop_frame() {
            world.send(frame);
        }
        let until = client.next_deadline().unwrap_or(now);
        let outcome = match world.receive(until)? {
            Some((time, frame)) => client.on_frame(time, &frame),
            None => client.poll(world.now()),
        };
        match outcome {
            None => {}
            Some(Outcome::Failed(error)) => return Err(problem(error.to_string())),
            Some(Outcome::Uploaded | Outcome::Downloaded) => return Ok(client.data().to_vec()),
        }
    }
}
