//! A new image that comes over the bus, without I/O.
//!
//! # Theory of operation
//!
//! A client writes 0x1F51 = 0 and 3, then 0x1F50, then 0x1F51 = 1, and reads 0x1F57 in between (the
//! variant of CiA 302-3 that Zephyr's client uses). A request is judged and answered at once. What
//! takes time is a [`Job`], which the platform does after the answer has been sent. Meanwhile
//! 0x1F57 reads as busy; while a sector is erased, a [`StandIn`] gives this answer. Each sector to
//! erase is a job of its own, so any other request that came while one was erased is answered
//! before the next.
//!
//! A download begins with the header, which is held in RAM. As soon as it is complete it is parsed
//! and compared with the robot and the announced length; only these checks protect the flash of the
//! slot that is not running. Once the last word is programmed, the image is read back: its hash,
//! the signature of the header and the first vectors decide whether the slot is sealed. Only a
//! sealed image can be started.
//!
//! An image on trial is confirmed by its client (0x1F51 = 0x80), or by itself after five seconds
//! with SYNC and the heartbeat of its master if it can read the stored parameters. One that is not
//! confirmed within a minute starts again, which the boot code permits only a few times before it
//! goes back to the other image.
//!
//! # Interface
//!
//! The application asks [`Update::control`] and is the sink of 0x1F50; the platform does
//! [`Update::job`] by [`Update::work`] with its flash and its cryptography.
//!
//! # Limits
//!
//! The signature is checked at the end, not before the other slot is written. Any client on the bus
//! can therefore destroy the image that the robot would go back to, but it cannot make the robot
//! start another one.

mod stand_in;
mod work;

use boot::header::{Device, Header, LENGTH, Refusal};
use boot::records::{self, State};
use boot::{Flash, Slot};
use canopen::{AbortCode, NmtState};
use control::time::Micros;
use heapless::Vec;

pub use stand_in::StandIn;
pub use work::{Done, Job};

/// How long an image on trial has to hear SYNC and its master until it confirms itself, us.
const PROOF_US: u64 = 5_000_000;
/// How long an image may be on trial until it starts again, us.
const TRIAL_US: u64 = 60_000_000;

/// Whether this robot takes updates at all. Without the feature it is one without slots, and the
/// compiler leaves out everything that needs one.
const IS_TAKEN: bool = cfg!(feature = "update");

/// Bytes of a header, as the length of a download is counted.
#[expect(clippy::cast_possible_truncation, reason = "256")]
const HEADER: u32 = LENGTH as u32;

/// Bytes that wait to be programmed: those of two frames, and what is left of a word.
const WAITING: usize = 20;

/// What has become of an update.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Phase {
    /// None has begun.
    Running,
    /// One is being prepared, or ended early.
    Stopped,
    /// So many sectors of the slot are erased.
    Erasing(u8),
    /// The slot is erased.
    Cleared,
    /// So many bytes of the download have come.
    Receiving(u32),
    /// All have come.
    Verifying,
    /// The image is whole and sealed.
    Ready,
}

/// What ended an update; object 0x2003:3.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub enum Problem {
    /// Nothing.
    None = 0,
    /// The bytes are no header.
    Header = 1,
    /// The image is for another board.
    Board = 2,
    /// The image is for another revision of the hardware.
    Hardware = 3,
    /// The security counter is below that of the running image.
    Downgrade = 4,
    /// The length is not that of the image for the wanted slot.
    Length = 5,
    /// The hash is another one than the header says.
    Hash = 6,
    /// The header is not signed with the key that this robot knows.
    Signature = 7,
    /// The flash cannot be written.
    Flash = 8,
    /// The transfer ended early, or the slot was not erased.
    Transfer = 9,
    /// The running image is on trial.
    Trial = 10,
}

impl Problem {
    /// As bits 1 to 7 of object 0x1F57.
    const fn status(self) -> u32 {
        match self {
            Self::None => 0,
            Self::Transfer => 1,
            Self::Header => 2,
            Self::Length | Self::Hash => 3,
            Self::Flash => 5,
            Self::Board | Self::Hardware | Self::Downgrade | Self::Signature | Self::Trial => 7,
        }
    }
}

/// What the robot runs and has, as read from its flash.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Survey {
    on_trial: bool,
    security_counter: u32,
    identification: u32,
    other_version: u32,
    may_go_back: bool,
}

/// See the [module](self).
#[derive(Clone)]
pub(crate) struct Update {
    running: Option<Slot>,
    device: Device,
    survey: Survey,
    phase: Phase,
    problem: Problem,
    ordered: Option<Job>,
    announced: Option<u32>,
    header: [u8; LENGTH],
    length: u32,
    waiting: Vec<u8, WAITING>,
    /// Where the first of those that wait goes to.
    address: u32,
    /// Since when an image on trial has heard what it needs.
    proven_since: Option<Micros>,
}

/// Values of 0x1F51.
pub mod order {
    /// Prepares an update.
    pub const STOP: u8 = 0;
    /// Starts what was received.
    pub const START: u8 = 1;
    /// Starts again.
    pub const RESET: u8 = 2;
    /// Erases the other slot.
    pub const CLEAR: u8 = 3;
    /// Confirms the running image.
    pub const CONFIRM: u8 = 0x80;
    /// Goes back to the other image.
    pub const GO_BACK: u8 = 0x81;
}

impl Update {
    /// Of a robot whose program runs from `running`; `None` for one without slots.
    pub const fn new(running: Option<Slot>, device: Device) -> Self {
        Self {
            running,
            device,
            survey: Survey {
                on_trial: false,
                security_counter: device.security_counter,
                identification: 0,
                other_version: 0,
                may_go_back: false,
            },
            phase: Phase::Running,
            problem: Problem::None,
            ordered: None,
            announced: None,
            header: [0; LENGTH],
            length: 0,
            waiting: Vec::new(),
            address: 0,
            proven_since: None,
        }
    }

    /// The slot that the program runs from.
    const fn running(&self) -> Option<Slot> {
        if IS_TAKEN { self.running } else { None }
    }

    /// Reads what is known about both slots, at start. A confirmation that a loss of power has cut
    /// is written again, once: its second word might read otherwise the next time.
    pub fn start(&mut self, flash: &impl Flash) {
        self.survey(flash);
        let state = self.running().map(|slot| State::read(flash, slot));
        if let Some(State::Confirmed {
            is_settled: false, ..
        }) = state
        {
            self.ordered = Some(Job::Confirm);
        }
    }

    /// Reads what is known about both slots, after every job that changes it.
    fn survey(&mut self, flash: &impl Flash) {
        let Some(running) = self.running() else {
            return;
        };
        let (state, other) = (
            State::read(flash, running),
            State::read(flash, running.other()),
        );
        let shown = if self.phase == Phase::Ready {
            other
        } else {
            state
        };
        let counter = state.seal().map_or(0, |seal| seal.security_counter);
        let other_is_good = match other {
            State::Confirmed { .. } => true,
            State::Unknown => {
                let at = running.other().address();
                let (stack, entry) = (flash.word(at), flash.word(at + 4));
                running.other().has_vectors(stack, entry)
            }
            State::Receiving | State::Ready(_) | State::Trial { .. } | State::Rejected(_) => false,
        };
        self.survey = Survey {
            on_trial: !records::may_be_replaced(flash, running.other()),
            security_counter: counter.max(self.device.security_counter),
            identification: shown.seal().map_or(0, |seal| seal.checksum),
            other_version: other.seal().map_or(0, |seal| seal.version),
            may_go_back: state.seal().is_some() && other_is_good,
        };
    }

    /// Object 0x2003:1.
    pub const fn running_slot(&self) -> u8 {
        match self.running() {
            None => 0,
            Some(slot) => number(slot),
        }
    }

    /// Object 0x2003:2.
    pub const fn wanted_slot(&self) -> u8 {
        match self.running() {
            None => 0,
            Some(slot) => number(slot.other()),
        }
    }

    /// Object 0x2003:3.
    pub const fn problem(&self) -> Problem {
        self.problem
    }

    /// Object 0x2003:4.
    pub const fn security_counter(&self) -> u32 {
        self.survey.security_counter
    }

    /// Object 0x2003:5.
    pub const fn other_version(&self) -> u32 {
        self.survey.other_version
    }

    /// Object 0x2003:6 and :7.
    pub const fn device(&self) -> &Device {
        &self.device
    }

    /// Object 0x1F56, for a robot of this version.
    pub const fn identification(&self, version: u32) -> u32 {
        match self.survey.identification {
            0 => version,
            checksum => checksum,
        }
    }

    /// Object 0x1F51.
    pub const fn control_state(&self) -> u8 {
        match self.phase {
            _ if self.survey.on_trial => order::CONFIRM,
            Phase::Running => order::START,
            Phase::Erasing(_) | Phase::Cleared | Phase::Receiving(_) => order::CLEAR,
            Phase::Stopped | Phase::Verifying | Phase::Ready => order::STOP,
        }
    }

    /// Object 0x1F57.
    pub const fn flash_status(&self) -> u32 {
        self.is_busy() as u32 | self.problem.status() << 1
    }

    /// Whether something is under way. Every turn of the bus task asks this before anything else.
    #[inline(always)]
    pub const fn is_busy(&self) -> bool {
        IS_TAKEN
            && (self.ordered.is_some()
                || matches!(
                    self.phase,
                    Phase::Erasing(_) | Phase::Receiving(_) | Phase::Verifying
                ))
    }

    /// Does what 0x1F51 is written for. `is_at_rest`: the outputs are off, and nothing is being
    /// stored.
    ///
    /// # Errors
    /// [`AbortCode::UnsupportedAccess`] for a robot without slots, [`AbortCode::DeviceState`] if
    /// not now, [`AbortCode::InvalidValue`] for an unknown value.
    pub fn control(&mut self, value: u8, nmt: NmtState, is_at_rest: bool) -> Result<(), AbortCode> {
        if self.running().is_none() {
            return Err(AbortCode::UnsupportedAccess);
        }
        if nmt != NmtState::PreOperational || !is_at_rest || self.is_busy() {
            return Err(AbortCode::DeviceState);
        }
        let on_trial = self.survey.on_trial;
        match value {
            order::CONFIRM if on_trial => self.ordered = Some(Job::Confirm),
            order::CONFIRM => {}
            order::GO_BACK if self.survey.may_go_back => self.ordered = Some(Job::GoBack),
            order::GO_BACK => return Err(AbortCode::DeviceState),
            order::RESET => self.ordered = Some(Job::Reset),
            order::STOP | order::START | order::CLEAR if on_trial => {
                self.problem = Problem::Trial;
                return Err(AbortCode::DeviceState);
            }
            order::STOP => {
                if self.phase == Phase::Running {
                    self.phase = Phase::Stopped;
                }
            }
            order::START => match self.phase {
                Phase::Ready => self.ordered = Some(Job::Start),
                _ => self.phase = Phase::Running,
            },
            order::CLEAR => match self.phase {
                Phase::Stopped | Phase::Ready => {
                    self.problem = Problem::None;
                    self.phase = Phase::Erasing(0);
                }
                Phase::Cleared => {}
                _ => return Err(AbortCode::DeviceState),
            },
            _ => return Err(AbortCode::InvalidValue),
        }
        Ok(())
    }

    /// A download begins.
    pub fn begin(
        &mut self,
        size: Option<u32>,
        nmt: NmtState,
        is_at_rest: bool,
    ) -> Result<(), AbortCode> {
        let slot = self.running().ok_or(AbortCode::UnsupportedAccess)?.other();
        if nmt != NmtState::PreOperational || !is_at_rest || self.phase != Phase::Cleared {
            return Err(AbortCode::DeviceState);
        }
        match size {
            Some(size) if size < HEADER + boot::slots::SHORTEST_IMAGE => {
                return Err(self.refuse(Problem::Length, AbortCode::TooShort));
            }
            Some(size) if size > HEADER + slot.longest_image() => {
                return Err(self.refuse(Problem::Length, AbortCode::TooLong));
            }
            Some(_) | None => {}
        }
        self.problem = Problem::None;
        self.announced = size;
        self.phase = Phase::Receiving(0);
        self.address = slot.address();
        self.waiting.clear();
        Ok(())
    }

    /// The next bytes of a download.
    pub fn receive(&mut self, bytes: &[u8]) -> Result<(), AbortCode> {
        let Phase::Receiving(mut got) = self.phase else {
            return Err(AbortCode::DeviceState);
        };
        if !IS_TAKEN {
            return Err(AbortCode::UnsupportedAccess);
        }
        for byte in bytes {
            if let Some(to) = usize::try_from(got)
                .ok()
                .and_then(|at| self.header.get_mut(at))
            {
                *to = *byte;
            } else if got >= self.length {
                return Err(self.refuse(Problem::Length, AbortCode::TooLong));
            } else if self.waiting.push(*byte).is_err() {
                return Err(self.refuse(Problem::Transfer, AbortCode::CannotStore));
            }
            got = got.saturating_add(1);
            if got == HEADER {
                self.admit()?;
            }
        }
        self.phase = Phase::Receiving(got);
        Ok(())
    }

    /// The download is complete.
    pub fn finish(&mut self) -> Result<(), AbortCode> {
        match self.phase {
            _ if !IS_TAKEN => Err(AbortCode::UnsupportedAccess),
            Phase::Receiving(got) if got == self.length && got > 0 => {
                self.phase = Phase::Verifying;
                Ok(())
            }
            Phase::Receiving(_) => Err(self.refuse(Problem::Length, AbortCode::TooShort)),
            _ => Err(AbortCode::DeviceState),
        }
    }

    /// The download, or what is done with it, ends without success: also when the robot leaves
    /// PRE-OPERATIONAL.
    pub fn cancel(&mut self) {
        if !IS_TAKEN {
            return;
        }
        match self.phase {
            Phase::Receiving(_) | Phase::Verifying | Phase::Erasing(_) => {
                self.phase = Phase::Stopped;
                self.length = 0;
                if self.problem == Problem::None {
                    self.problem = Problem::Transfer;
                }
            }
            Phase::Running | Phase::Stopped | Phase::Cleared | Phase::Ready => {}
        }
    }

    /// The header is complete: whether it is one for this robot.
    fn admit(&mut self) -> Result<(), AbortCode> {
        let slot = self.running().ok_or(AbortCode::UnsupportedAccess)?.other();
        let Ok(header) = Header::parse(&self.header) else {
            return Err(self.refuse(Problem::Header, AbortCode::InvalidValue));
        };
        let device = Device {
            security_counter: self.survey.security_counter,
            ..self.device
        };
        if let Err(refusal) = header.admit(&device) {
            let problem = match refusal {
                Refusal::Board(_) => Problem::Board,
                Refusal::Hardware(_) => Problem::Hardware,
                Refusal::Downgrade(_) => Problem::Downgrade,
            };
            return Err(self.refuse(problem, AbortCode::ParameterIncompatible));
        }
        self.length = header.download_length(slot);
        if self.announced.is_some_and(|size| size != self.length) {
            return Err(self.refuse(Problem::Length, AbortCode::LengthMismatch));
        }
        Ok(())
    }

    const fn refuse(&mut self, problem: Problem, code: AbortCode) -> AbortCode {
        self.problem = problem;
        code
    }

    /// Every poll: an image on trial confirms itself or starts again. `is_sound`: SYNC and the
    /// heartbeat of the master have come within the last moments, and the parameters are readable.
    pub fn supervise(&mut self, now: Micros, is_sound: bool) {
        if self.ordered.is_some() {
            return;
        }
        if !is_sound {
            self.proven_since = None;
        }
        let since = match (is_sound, self.proven_since) {
            (true, None) => *self.proven_since.insert(now),
            (_, since) => since.unwrap_or(now),
        };
        if now.since(since).0 >= PROOF_US {
            self.ordered = Some(Job::Confirm);
        } else if now.0 >= TRIAL_US {
            self.ordered = Some(Job::Reset);
        }
    }

    /// Whether the running image is on trial.
    #[inline(always)]
    pub const fn is_on_trial(&self) -> bool {
        IS_TAKEN && self.survey.on_trial
    }

    /// What is to be done now.
    pub fn job(&self) -> Option<Job> {
        match (self.ordered, self.phase) {
            _ if !IS_TAKEN => None,
            (Some(job), _) => Some(job),
            (None, Phase::Erasing(nth)) => Some(Job::Erase(nth)),
            (None, Phase::Receiving(_)) if self.waiting.len() >= 4 => Some(Job::Program),
            (None, Phase::Verifying) if self.waiting.is_empty() => Some(Job::Verify),
            (None, Phase::Verifying) => Some(Job::Program),
            (None, _) => None,
        }
    }
}

const fn number(slot: Slot) -> u8 {
    match slot {
        Slot::A => 1,
        Slot::B => 2,
    }
}
