//! A bare board that drives, as far as a board without wheels can: it is configured and started
//! like a robot, follows setpoints and has its loops closed, but its encoders stand still.
//!
//! A robot whose wheels do not turn stops with a fault. Without the check for blocked wheels
//! (0x2031:5 is 0) it continues, because encoders that all stand still do not contradict each
//! other. The emergency stop has to be closed: the debugger makes the node switches PC8 and PC9 low
//! outputs, and wires 15 and 16 connect them with both inputs of the stop. Wires 13 and 14 have to
//! be removed: driver enable is low before the start, and by wire 13 it would report a fault of the
//! drivers.
//!
//! Limits: the interrupts of roller indexes are missing from the load (encoders need none), and the
//! loops run into their bounds.

use anyhow::{Context as _, ensure};
use canopen::{Frame, NmtCommand, NmtState, NmtTarget, NodeId, client};
use group::GroupFile;
use kinematics::Twist;
use protocol::{GroupTwist, MemberState, MemberStatus, Value, address, cob};

use super::{PATIENCE_US, Session};
use crate::bench::Debugger;
use crate::node::Node;
use crate::wires::{self, STOP};

/// Robots as in the simulator's examples; what they are built like does not matter here.
const FILE: &str = include_str!("../../../groups/single.toml");
/// How long a setpoint comes before its SYNC, us.
const LEAD_US: u64 = 4_000;
/// SYNCs before the start, and at standstill after it.
const BEFORE: u64 = 30;
const STANDS: u64 = 30;
/// SYNCs from one reversal to the next.
pub(super) const REVERSAL: u64 = 100;
/// A heartbeat of the master comes every so many SYNCs.
const HEARTBEAT: u64 = 10;
/// Registers of a port: mode, set and reset of its outputs.
const PORT: u32 = 0x4002_0000;
const PORT_SIZE: u32 = 0x400;
const BSRR: u32 = 0x18;

/// A drive of one board or of several.
pub(super) struct Drive {
    file: GroupFile,
    nodes: Vec<NodeId>,
    /// SYNCs so far, those of them with a twist, and when the next is due.
    syncs: u64,
    moved: Option<u64>,
    due_us: u64,
    /// Whether the twist only goes to and fro.
    reverses: bool,
    /// Boards whose last status does not say that they move.
    resting: Vec<NodeId>,
}

impl Drive {
    /// A drive of these boards, before it begins.
    pub(super) fn new(nodes: &[NodeId]) -> anyhow::Result<Self> {
        let mut file = GroupFile::parse("groups/single.toml", FILE)?;
        let first = file.robots.first().context("the group has no robot")?;
        let robot = |node: &NodeId| {
            let mut robot = first.clone();
            robot.node = node.get();
            robot
        };
        file.robots = nodes.iter().map(robot).collect();
        Ok(Self {
            file,
            nodes: nodes.to_vec(),
            syncs: 0,
            moved: None,
            due_us: 0,
            reverses: false,
            resting: Vec::new(),
        })
    }

    /// The same, but to and fro: all wheels reverse once in so many SYNCs.
    pub(super) fn to_and_fro(nodes: &[NodeId]) -> anyhow::Result<Self> {
        let reverses = true;
        Ok(Self {
            reverses,
            ..Self::new(nodes)?
        })
    }

    /// Always changing once the boards follow.
    fn twist(&self) -> Twist {
        let Some(moved) = self.moved else {
            return Twist::new(0.0, 0.0, 0.0);
        };
        if moved < STANDS {
            return Twist::new(0.0, 0.0, 0.0);
        }
        let t = (moved - STANDS) as f32 * 0.01;
        if self.reverses {
            let turn = core::f32::consts::PI * (moved - STANDS) as f32 / REVERSAL as f32;
            return Twist::new(0.5 * turn.cos(), 0.0, 0.0);
        }
        let about = 0.3 * (0.7 * t).sin();
        Twist::new(0.5 * t.sin(), 0.4 * (1.3 * t).sin(), about)
    }
}

impl Session<'_> {
    /// Closes the emergency stop of the board with the debugger.
    pub(super) fn release_stops(&mut self) -> anyhow::Result<()> {
        for stop in STOP {
            let pin = wires::at(stop).from;
            let port = PORT + u32::from(pin >> 4) * PORT_SIZE;
            let bit = u32::from(pin & 15);
            self.debugged(|debugger| {
                debugger.write(port + BSRR, 1 << (bit + 16))?;
                change(debugger, port, 3 << (2 * bit), 1 << (2 * bit))
            })?;
        }
        Ok(())
    }

    /// Configures and starts the boards; afterwards they follow [`Session::period`].
    pub(super) fn begin_to_drive(&mut self, drive: &mut Drive) -> anyhow::Result<()> {
        for robot in &drive.file.robots {
            let id = NodeId::new(robot.node).context("a robot has no node-ID")?;
            let mut node = Node::new(self.node.bench, id);
            let mut write = |at: protocol::Address, value: Value| {
                let bytes = value.to_bytes();
                node.write(
                    at.index,
                    at.sub,
                    &bytes[..usize::from(value.kind().bytes())],
                )
            };
            for (at, value) in group::parameters(&drive.file, robot, false) {
                write(at, value)?;
            }
            write(address::BLOCKED_RATE, Value::F32(0.0))?;
            let status = address::CONFIGURATION_STATUS;
            let status = node.read(status.index, status.sub)?;
            ensure!(status == 0, "the configuration is refused: 0x{status:08X}");
        }
        for _ in 0..BEFORE {
            self.period(drive)?;
        }
        self.command(drive, NmtCommand::Start)?;
        drive.moved = Some(0);
        for _ in 0..2 * STANDS {
            self.period(drive)?;
        }
        ensure!(
            drive.resting.is_empty(),
            "node {} does not drive: {}",
            drive.resting[0].get(),
            self.why(drive.resting[0])
        );
        Ok(())
    }

    /// Takes the boards out of OPERATIONAL.
    pub(super) fn end_to_drive(&mut self, drive: &mut Drive) -> anyhow::Result<()> {
        self.command(drive, NmtCommand::EnterPreOperational)?;
        drive.moved = None;
        self.node.wait(PATIENCE_US / 10)
    }

    fn command(&mut self, drive: &Drive, command: NmtCommand) -> anyhow::Result<()> {
        for node in &drive.nodes {
            let frame = client::nmt(command, NmtTarget::Node(*node));
            self.node.bench.send(&frame)?;
        }
        Ok(())
    }

    /// One SYNC with what comes before it; whether all boards move, if they are to.
    pub(super) fn period(&mut self, drive: &mut Drive) -> anyhow::Result<bool> {
        let period_us = u64::from(drive.file.sync_period_us);
        let now = self.node.bench.now_us();
        if now >= drive.due_us + period_us {
            drive.due_us = now;
        }
        drive.due_us += period_us;
        self.listen(drive, drive.due_us - LEAD_US)?;
        let master = NodeId::new(protocol::MASTER).context("the master is a node")?;
        if drive.syncs.is_multiple_of(HEARTBEAT) {
            let alive = client::heartbeat(master, NmtState::Operational);
            self.node.bench.send(&alive)?;
        }
        let setpoint = GroupTwist {
            twist: drive.twist(),
            sequence: (drive.syncs % 256) as u8,
            group: drive.file.group_id,
        };
        let setpoint = Frame::of(cob::GROUP_TWIST, setpoint.encode());
        self.node.bench.send(&setpoint)?;
        self.listen(drive, drive.due_us)?;
        let counter = (drive.syncs % 240) as u8 + 1;
        self.node.bench.send(&client::sync(Some(counter)))?;
        drive.syncs += 1;
        if let Some(moved) = &mut drive.moved {
            *moved += 1;
        }
        Ok(drive.moved.is_none() || drive.resting.is_empty())
    }

    /// Takes in what the boards say, until a time.
    fn listen(&mut self, drive: &mut Drive, until_us: u64) -> anyhow::Result<()> {
        while let Some((_, frame)) = self.node.bench.receive(until_us)? {
            for node in &drive.nodes {
                if frame.id() == cob::member_status(node.get())
                    && let Ok(status) = MemberStatus::try_from(frame.data())
                {
                    drive.resting.retain(|resting| resting != node);
                    if status.state != MemberState::Moving {
                        drive.resting.push(*node);
                    }
                }
            }
        }
        Ok(())
    }

    /// What a board says about why it stands.
    fn why(&mut self, id: NodeId) -> String {
        let last = protocol::address::history::code(1);
        let mut node = Node::new(self.node.bench, id);
        match node.read(last.index, last.sub) {
            Ok(code) => {
                let fault = u16::try_from(code)
                    .ok()
                    .and_then(protocol::Fault::from_code);
                fault.map_or("no fault".to_owned(), |fault| fault.name().to_owned())
            }
            Err(error) => format!("{error:#}"),
        }
    }
}

/// Clears and sets bits of a register.
pub(super) fn change(
    debugger: &mut dyn Debugger,
    address: u32,
    clear: u32,
    set: u32,
) -> anyhow::Result<()> {
    let before = debugger.read(address, 1)?;
    let before = before.first().copied().unwrap_or(0);
    debugger.write(address, before & !clear | set)
}
