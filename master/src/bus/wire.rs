//! A link with the two things every conversation over it needs: the master's heartbeat, and a place
//! for frames that arrive while something else is waited for.
//!
//! The backlog is filled by SDO transfers and emptied by [`Wire::next`], which gives out what
//! waited before it asks the link again, so the order of frames is kept. It holds what arrives
//! during one transfer: some hundred frames at most on a busy bus.
//!
//! Every frame in either direction passes here, so this is also where the bus load is added up and
//! where subscribers who want frames get them. SYNC that the link sends by itself is taken from it
//! whenever it is listened to.

use std::collections::VecDeque;

use canopen::{Frame, Micros, NmtState, NodeId, client};
use protocol::cob;
use protocol::timing::HEARTBEAT_MS;

use crate::bus::link::Link;
use crate::bus::load::Meter;
use crate::bus::tap::FrameSink;
use crate::error::MasterError;
use crate::monitor::telemetry::{BusFrame, Hub, Interest, Telemetry};

/// The master's own node id.
const MASTER: NodeId = match NodeId::new(protocol::MASTER) {
    Some(node) => node,
    None => NodeId::MIN,
};
/// How long a robot may take for one answer unless told otherwise, in µs.
pub const ANSWER_TIMEOUT_US: u64 = 250_000;

/// Waking later than this after the time asked for is late where no group says otherwise, in µs.
const LATE_US: u64 = 10_000;
/// How long lateness may be the cause of what goes wrong, in µs.
const RECENT_US: u64 = 1_000_000;

/// A link in use.
pub struct Wire<L> {
    pub(crate) link: L,
    /// When the next heartbeat is due; `None` on a bus that is only listened to.
    next_heartbeat: Option<Micros>,
    pub(crate) backlog: VecDeque<(Micros, Frame)>,
    /// Where subscribers are.
    pub(crate) hub: HubOwner,
    /// Who gets every frame and loses none.
    sinks: Vec<FrameSink>,
    began: Micros,
    load: Meter,
    /// Counter of the last SYNC sent.
    sync_counter: u8,
    /// How long a robot may take for one SDO answer, in µs.
    pub(crate) patience_us: u64,
    /// Waking later than this after the time asked for is late, in µs. For a group that is a period
    /// of SYNC: its robots wait for one and a quarter periods more, of which the way to them takes
    /// its part.
    pub(crate) late_us: u64,
    /// When this end was last late, and by how much.
    late: Option<(Micros, Micros)>,
}

/// The hub of a session, which ends with it.
#[derive(Default)]
pub(crate) struct HubOwner(pub Hub);

impl Drop for HubOwner {
    fn drop(&mut self) {
        self.0.end();
    }
}

impl<L: Link> Wire<L> {
    /// Takes over a link without claiming to be its master: no heartbeat.
    #[must_use]
    pub fn visiting(link: L) -> Self {
        let began = link.now();
        Self {
            link,
            next_heartbeat: None,
            backlog: VecDeque::new(),
            hub: HubOwner::default(),
            sinks: Vec::new(),
            began,
            load: Meter::default(),
            sync_counter: 0,
            patience_us: ANSWER_TIMEOUT_US,
            late_us: LATE_US,
            late: None,
        }
    }

    /// What the adapter says is wrong with the bus, if it can tell.
    pub fn diagnosis(&mut self) -> Option<String> {
        self.link.diagnosis()
    }

    /// How long the adapter takes to answer, there and back, if it can be asked.
    pub fn latency(&mut self) -> Option<std::time::Duration> {
        self.link.latency()
    }

    /// Claims to be the bus's master from now on (with a heartbeat), or no longer.
    pub fn claim(&mut self, master: bool) {
        self.next_heartbeat = master.then(|| self.link.now());
    }

    /// Hands every frame from now on to `sink` as well.
    pub fn tap(&mut self, sink: FrameSink) {
        self.sinks.push(sink);
    }

    /// Whether this end claims to be the master.
    #[must_use]
    pub fn is_master(&self) -> bool {
        self.next_heartbeat.is_some()
    }

    /// Share of the bus that frames took in the last 100 ms, 0..=1, at 1 Mbit/s; `None` before as
    /// much has passed.
    #[must_use]
    pub fn bus_load(&self) -> Option<f32> {
        let now = self.seconds(self.now());
        (now >= 0.1).then(|| self.load.share(now))
    }

    /// Seconds from the beginning of the session to `at`.
    pub(crate) fn seconds(&self, at: Micros) -> f64 {
        (at.0 as f64 - self.began.0 as f64) / 1e6
    }

    /// Counter of the last SYNC that this end has sent; 0 before the first.
    pub(crate) fn sync_counter(&self) -> u8 {
        self.sync_counter
    }

    /// Notes a frame that is on the bus.
    fn record(&mut self, at: Micros, frame: &Frame, sent: bool) {
        if sent
            && frame.id() == cob::SYNC
            && let Some(counter) = frame.data().first()
        {
            self.sync_counter = *counter;
        }
        self.load.record(self.seconds(at), frame);
        for sink in &self.sinks {
            sink(at, frame, sent);
        }
        if self.hub.0.is_wanted(Interest::Frames) {
            let t = self.seconds(at);
            let frame = *frame;
            self.hub
                .0
                .publish(&Telemetry::Frame(BusFrame { t, frame, sent }));
        }
    }

    /// Time on the link's clock.
    #[must_use]
    pub fn now(&self) -> Micros {
        self.link.now()
    }

    /// Sends a frame.
    ///
    /// # Errors
    /// When the link fails.
    pub fn send(&mut self, frame: &Frame) -> Result<(), MasterError> {
        self.record(self.link.now(), frame, true);
        Ok(self.link.send(frame)?)
    }

    /// The next frame from the link before `until`, past the backlog.
    pub(crate) fn receive(
        &mut self,
        until: Micros,
    ) -> Result<Option<(Micros, Frame)>, MasterError> {
        let received = self.link.receive(until)?;
        let late = self.link.now().since(until);
        if received.is_none() && late.0 > self.late_us && !self.link.time_waits() {
            self.count_late(late);
        }
        while let Some((at, sync)) = self.link.take_sent() {
            self.record(at, &sync, true);
        }
        if let Some((at, frame)) = &received {
            self.record(*at, frame, false);
        }
        Ok(received)
    }

    /// This end did something so late.
    pub(crate) fn count_late(&mut self, late: Micros) {
        let before = self.lately();
        self.late = Some((self.link.now(), late.max(before)));
    }

    /// How late this end was within the last second, at worst.
    fn lately(&self) -> Micros {
        let now = self.link.now();
        let late = self.late.filter(|(at, _)| now.0 < at.0 + RECENT_US);
        late.map_or(Micros(0), |(_, late)| late)
    }

    /// Puts an error down to this end's being late where that is what explains it.
    pub(crate) fn blame(&self, error: MasterError) -> MasterError {
        let paced = self.link.punctuality().map_or(0.0, |read| read.lately_us);
        let late_ms = (paced * 1e-3).max(self.lately().0 as f64 * 1e-3);
        if late_ms * 1e3 < self.late_us as f64 || !error.may_come_of_lateness() {
            return error;
        }
        MasterError::Busy {
            late_ms,
            error: Box::new(error),
        }
    }

    /// Sends the master's heartbeat when it is due.
    pub(crate) fn beat(&mut self) -> Result<(), MasterError> {
        let now = self.link.now();
        if self.next_heartbeat.is_some_and(|due| now >= due) {
            let frame = client::heartbeat(MASTER, NmtState::Operational);
            self.send(&frame)?;
            self.next_heartbeat = Some(now + Micros::from_millis(HEARTBEAT_MS.into()));
        }
        Ok(())
    }

    /// When to stop waiting so that neither `deadline` nor the master's heartbeat is missed.
    pub(crate) fn wake(&self, deadline: Micros) -> Micros {
        self.next_heartbeat
            .map_or(deadline, |heartbeat| heartbeat.min(deadline))
    }

    /// The next frame that arrives before `until`; `None` once `until` has come. The heartbeat goes
    /// on meanwhile.
    ///
    /// # Errors
    /// When the link fails.
    pub fn next(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, MasterError> {
        if let Some(waiting) = self.backlog.pop_front() {
            return Ok(Some(waiting));
        }
        loop {
            self.beat()?;
            let stop = self.wake(until);
            let received = self.receive(stop)?;
            if received.is_some() || stop >= until {
                return Ok(received);
            }
        }
    }
}
