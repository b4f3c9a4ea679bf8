//! NMT start, the only way into motion, and what a change of the NMT state brings with it.

use canopen::{Device, NmtState, NodeId};
use control::time::Micros;
use protocol::Fault;
use protocol::timing::HEARTBEAT_MS;

use super::Application;
use crate::agreement::Own;
use crate::configuration;
use crate::event::Event;
use crate::interlock::Interlock;
use crate::state::{self, State};

/// How long a robot listens after its boot-up before it moves, us: the longest a robot of the same
/// node that has booted in the same instant can take to its first heartbeat, and as much as a tick
/// and a frame take.
const LISTEN_US: u64 = HEARTBEAT_MS as u64 * 1_000 + 20_000;

impl Application {
    /// NMT start. Everything that speaks against it is checked here. Not inlined: it has a
    /// configuration on its stack, a kilobyte.
    #[inline(never)]
    pub fn start(&mut self, now: Micros, device: &Device) {
        if !matches!(self.state, State::Ready | State::Armed | State::Faulted(_)) {
            return;
        }
        if self.store.asked {
            // Outputs stay off until it is over; the master has not had its answer yet.
            return;
        }
        if self.store.corrupt.is_some() {
            return self.transition(state::Event::StartRefused(Fault::ParametersCorrupt), now);
        }
        let node = self.identity.node.get();
        // Borrowed, not moved: each move would copy a kilobyte on the stack.
        let mut built = configuration::build(&self.parameters, node, self.identity.hardware);
        let Ok(configuration) = &mut built else {
            return self.transition(state::Event::StartRefused(Fault::Unconfigured), now);
        };
        if self.alone.for_now {
            configuration.members = 1 << node;
        }
        let configuration = &*configuration;
        if now < self.doubled_until {
            return self.transition(state::Event::StartRefused(Fault::DuplicateNode), now);
        }
        let protective = configuration.protective_stop && self.report.protective_stop;
        let obstacle = self.report.obstacle;
        if let Some(fault) = obstacle.or(protective.then_some(Fault::ProtectiveStop)) {
            return self.transition(state::Event::StartRefused(fault), now);
        }
        if self.configuration.as_ref() != Some(configuration) {
            self.configuration = Some(*configuration);
            self.to_hand = true;
        }
        self.alone.started_so = self.alone.for_now;
        self.command.configuration = configuration.crc;
        self.group_byte = self.group_byte(device);
        self.command.start = self.command.start.wrapping_add(1);
        self.last_heartbeat = now;
        self.runs_out = now;
        self.setpoints.restart();
        self.alone.setpoints.restart();
        self.strain.restart();
        self.own = Own::NONE;
        self.agreement.clear();
        self.is_undecided = false;
        self.is_late = false;
        self.interlock = Interlock::new(configuration.standstill_syncs);
        self.alone.interlock = self.interlock;
        self.plan = self.make_plan(device);
        self.transition(state::Event::Started, now);
    }

    /// The NMT state has changed, and with a reset perhaps the node-ID.
    pub fn on_nmt(&mut self, now: Micros, from: NmtState, to: NmtState, node: Option<NodeId>) {
        self.nmt = to;
        if to != NmtState::PreOperational {
            self.update.cancel();
        }
        self.alone.is_permitted = false;
        if from == NmtState::Operational {
            self.alone.for_now = false;
            self.transition(state::Event::Left, now);
        }
        if from == NmtState::Initialising {
            self.listened = now + Micros(LISTEN_US);
        }
        if let Some(node) = node {
            self.identity.node = node;
        }
        self.emit(Event::Nmt(to));
    }
}
