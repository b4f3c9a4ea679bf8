//! A recording in memory, whatever file it came from.

use canopen::Frame;
use kinematics::Pose;

use super::Header;
use crate::monitor::listener::Listener;
use crate::monitor::telemetry::{Event, Snapshot};

/// A frame of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// Time on the link's clock, in ns.
    pub t_ns: u64,
    /// The frame.
    pub frame: Frame,
    /// Whether the recording program had sent it.
    pub sent: bool,
}

/// A recording in memory.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// What its head says.
    pub header: Header,
    /// Every frame, in the order of the file.
    pub frames: Vec<Recorded>,
    /// Where the curve asked the group to be: time in s, pose.
    pub plan: Vec<(f64, Pose)>,
    /// Where an observer saw the group.
    pub truth: Vec<(f64, Pose)>,
    /// What is wrong with the file, when it does not end as it should.
    pub damage: Option<String>,
}

impl Recording {
    /// Seconds from the first frame to the last.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        let (first, last) = (self.frames.first(), self.frames.last());
        let (first, last) = (first.map_or(0, |f| f.t_ns), last.map_or(0, |f| f.t_ns));
        last.saturating_sub(first) as f64 * 1e-9
    }

    /// The group file inside, if there is one.
    ///
    /// # Errors
    /// When it is not a group file.
    pub fn group(&self) -> Result<Option<group::GroupFile>, group::GroupError> {
        let text = self.header.group.as_ref();
        text.map(|text| group::GroupFile::parse("group file of the recording", text))
            .transpose()
    }

    /// What a listener on the bus would have known: the group at every SYNC, and what happened.
    #[must_use]
    pub fn decode(&self) -> (Vec<Snapshot>, Vec<Event>) {
        let group = self.group().ok().flatten();
        let nodes = group.iter().flat_map(|group| &group.robots).map(|r| r.node);
        let mut listener = Listener::new(nodes.collect::<Vec<_>>());
        let (mut snapshots, mut events) = (Vec::new(), Vec::new());
        for recorded in &self.frames {
            snapshots.extend(listener.push(recorded.t_ns as f64 * 1e-9, &recorded.frame));
            events.append(&mut listener.take_events());
        }
        (snapshots, events)
    }
}
