//! Reading and writing one object of one robot, over any link.
//!
//! The transfer itself is `canopen`'s SDO client; this file gives it time and frames, and keeps the
//! master's heartbeat going meanwhile. What else arrives waits in the wire's backlog, from which
//! the session takes it. One transfer runs at a time, which a robot needs anyway: it has one SDO
//! server.

use canopen::client::{Outcome, SdoClient, SdoError};
use canopen::{AbortCode, Frame, Micros, NodeId};
use protocol::{Address, Kind, OBJECTS, RECORDS, Value, cob};

use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::error::MasterError;

/// How often a request is made before the robot counts as silent: frames may be late on a busy
/// machine, and lost on a bad bus.
const TRIES: u32 = 3;

/// Store parameters (CiA 301 7.5.2.13): all of them, and the word that says so, "save".
const STORE: (Address, Value) = (Address::new(0x1010, 1), Value::U32(0x6576_6173));
/// Restore defaults (CiA 301 7.5.2.14), "load".
const RESTORE: (Address, Value) = (Address::new(0x1011, 1), Value::U32(0x6461_6F6C));
/// How long storing may take, in µs: a sector of flash has to be erased first.
const STORE_TIMEOUT_US: u64 = 3_000_000;
/// How long a robot that has just been stopped may take until its outputs are off and its brake
/// holds, and how often it is asked meanwhile to save.
const REST_TIMEOUT_US: u64 = 2_000_000;
const SAVE_AGAIN_US: u64 = 50_000;

/// An object as people know it: its name and its address.
#[must_use]
pub fn name(address: Address) -> String {
    let object = OBJECTS.iter().find(|object| object.address == address);
    object.map_or_else(
        || format!("object {address}"),
        |object| format!("{} ({address})", object.name),
    )
}

/// The name with its record's, which distinguishes six objects called "Front left".
#[must_use]
pub fn full_name(address: Address) -> String {
    let object = OBJECTS.iter().find(|object| object.address == address);
    let name = object.map_or("", |object| object.name);
    let record = RECORDS.iter().find(|(index, _)| *index == address.index);
    record.map_or_else(
        || name.to_owned(),
        |(_, record)| format!("{record}: {name}"),
    )
}

/// The unit of an object's value; empty for a plain number.
#[must_use]
pub fn unit(address: Address) -> &'static str {
    let object = OBJECTS.iter().find(|object| object.address == address);
    object.map_or("", |object| object.unit)
}

/// A value as people write it.
#[must_use]
pub fn show(value: Value) -> String {
    match value {
        Value::I16(v) => v.to_string(),
        Value::U8(v) => v.to_string(),
        Value::U16(v) => v.to_string(),
        Value::U32(v) => v.to_string(),
        Value::F32(v) => v.to_string(),
        Value::I24(v) => v.to_string(),
        Value::Domain => "a block of bytes".into(),
    }
}

/// What is to be done with an object.
#[derive(Clone, Copy)]
enum Transfer<'a> {
    Read,
    Write(Value),
    WriteBlock(&'a [u8]),
    /// By block transfer, of any length.
    Download(&'a [u8]),
}

impl Transfer<'_> {
    /// What is done, for people.
    fn action(self, address: Address) -> String {
        let object = name(address);
        match self {
            Self::Read => format!("reading {object}"),
            Self::Write(_) if address == STORE.0 => "saving the parameters".into(),
            Self::Write(_) if address == RESTORE.0 => "restoring the defaults".into(),
            Self::Write(value) => format!("writing {} to {object}", show(value)),
            Self::WriteBlock(bytes) | Self::Download(bytes) => {
                format!("writing {} bytes to {object}", bytes.len())
            }
        }
    }
}

/// The end of a transfer that this end does not want to go on with (CiA 301 7.2.4.3.17).
fn abort_of(server: NodeId, Address { index, sub }: Address) -> Frame {
    let [low, high] = index.to_le_bytes();
    let [a, b, c, d] = AbortCode::General.code().to_le_bytes();
    let data = [0x80, low, high, sub, a, b, c, d];
    Frame::of(cob::sdo_request(server.get()), data)
}

/// Whether a robot refused because of its lock.
fn is_locked(error: &MasterError) -> bool {
    let refused = |abort: &AbortCode| *abort == AbortCode::LocalControl;
    matches!(error.cause(), MasterError::Refused { abort, .. } if refused(abort))
}

impl<L: Link> Wire<L> {
    /// Reads an object of a type.
    ///
    /// # Errors
    /// When the robot refuses, does not answer, or answers with another type.
    pub fn read(&mut self, node: u8, address: Address, kind: Kind) -> Result<Value, MasterError> {
        let data = self.transfer(node, address, Transfer::Read)?;
        Value::from_bytes(kind, &data).map_err(|error| MasterError::Answer {
            node,
            object: name(address),
            problem: format!(
                "the answer has {} bytes, not a {}: {error}",
                data.len(),
                kind.name()
            ),
        })
    }

    /// Writes an object.
    ///
    /// # Errors
    /// When the robot refuses or does not answer.
    pub fn write(&mut self, node: u8, address: Address, value: Value) -> Result<(), MasterError> {
        self.transfer(node, address, Transfer::Write(value))?;
        Ok(())
    }

    /// Writes an object and reads it back. A locked robot that has the value already may keep it.
    ///
    /// # Errors
    /// As [`Wire::write`] and [`Wire::read`], and when the value read is not the value written.
    pub fn write_checked(
        &mut self,
        node: u8,
        address: Address,
        value: Value,
    ) -> Result<(), MasterError> {
        let written = self.write(node, address, value);
        if !written.as_ref().err().is_some_and(is_locked) {
            written?;
            return self.read_back(node, address, value);
        }
        self.read_back(node, address, value).or(written)
    }

    fn read_back(&mut self, node: u8, address: Address, value: Value) -> Result<(), MasterError> {
        let found = self.read(node, address, value.kind())?;
        if found.to_bits() == value.to_bits() {
            return Ok(());
        }
        Err(MasterError::ReadBack {
            node,
            object: name(address),
            written: show(value),
            found: show(found),
        })
    }

    /// Stores the parameters of a robot in its flash.
    ///
    /// # Errors
    /// When the robot refuses (it must not be OPERATIONAL) or does not answer.
    pub fn save(&mut self, node: u8) -> Result<(), MasterError> {
        let before = std::mem::replace(&mut self.patience_us, STORE_TIMEOUT_US);
        let deadline = self.now().0 + REST_TIMEOUT_US;
        let stored = loop {
            let stored = self.write(node, STORE.0, STORE.1);
            let comes_to_rest = matches!(
                &stored,
                Err(MasterError::Refused {
                    abort: AbortCode::DeviceState,
                    ..
                })
            );
            if !comes_to_rest || self.now().0 > deadline {
                break stored;
            }
            self.pass(SAVE_AGAIN_US)?;
        };
        self.patience_us = before;
        stored
    }

    /// Lets time pass and sends heartbeats; received frames wait for the next reader.
    pub(crate) fn pass(&mut self, us: u64) -> Result<(), MasterError> {
        let until = Micros(self.now().0 + us);
        let mut received = Vec::new();
        while let Some(frame) = self.next(until)? {
            received.push(frame);
        }
        self.backlog.extend(received);
        Ok(())
    }

    /// Lets a robot have its default parameters after the next reset.
    ///
    /// # Errors
    /// When the robot refuses or does not answer.
    pub fn restore(&mut self, node: u8) -> Result<(), MasterError> {
        let before = std::mem::replace(&mut self.patience_us, STORE_TIMEOUT_US);
        let restored = self.write(node, RESTORE.0, RESTORE.1);
        self.patience_us = before;
        restored
    }

    /// Reads the bytes of an object, however many.
    ///
    /// # Errors
    /// When the robot refuses or does not answer.
    pub fn read_block(&mut self, node: u8, address: Address) -> Result<Vec<u8>, MasterError> {
        self.transfer(node, address, Transfer::Read)
    }

    /// Writes an object of any length and reads it back.
    ///
    /// # Errors
    /// When the robot refuses or does not answer, and when it reads back something else.
    pub fn write_block(
        &mut self,
        node: u8,
        address: Address,
        bytes: &[u8],
    ) -> Result<(), MasterError> {
        self.transfer(node, address, Transfer::WriteBlock(bytes))?;
        let found = self.read_block(node, address)?;
        if found == bytes {
            return Ok(());
        }
        Err(MasterError::ReadBack {
            node,
            object: name(address),
            written: format!("{} bytes", bytes.len()),
            found: format!("{} others", found.len()),
        })
    }

    /// Writes an object of any length by block transfer; `show` gets the number of bytes that the
    /// robot has confirmed, and ends the transfer by an error. It is not tried again, because a
    /// part of it has arrived.
    ///
    /// # Errors
    /// When the robot refuses or does not answer, and that of `show`.
    pub fn download(
        &mut self,
        node: u8,
        address: Address,
        bytes: &[u8],
        show: &mut dyn FnMut(usize) -> Result<(), MasterError>,
    ) -> Result<(), MasterError> {
        let done = self.attempt(node, address, Transfer::Download(bytes), show);
        done.map(|_| ()).map_err(|error| self.blame(error))
    }

    /// One transfer, made again when the robot does not answer in time. Whatever can be read or
    /// written can be so twice.
    fn transfer(
        &mut self,
        node: u8,
        address: Address,
        what: Transfer<'_>,
    ) -> Result<Vec<u8>, MasterError> {
        for _ in 1..TRIES {
            match self.attempt(node, address, what, &mut |_| Ok(())) {
                Err(MasterError::NodeSilent { .. }) => {}
                done => return done,
            }
        }
        let last = self.attempt(node, address, what, &mut |_| Ok(()));
        last.map_err(|error| self.blame(error))
    }

    fn attempt(
        &mut self,
        node: u8,
        address: Address,
        what: Transfer<'_>,
        show: &mut dyn FnMut(usize) -> Result<(), MasterError>,
    ) -> Result<Vec<u8>, MasterError> {
        let answer = |problem: &str| MasterError::Answer {
            node,
            object: name(address),
            problem: problem.into(),
        };
        let server = NodeId::new(node).ok_or(MasterError::NodeSilent { node })?;
        let mut client = SdoClient::new(server, Micros(self.patience_us));
        let (now, index, sub) = (self.link.now(), address.index, address.sub);
        match what {
            Transfer::Read => client.upload(now, index, sub),
            Transfer::Write(value) => {
                let length = usize::from(value.kind().bytes());
                client.download(now, index, sub, &value.to_bytes()[..length])
            }
            Transfer::WriteBlock(bytes) => client.download(now, index, sub, bytes),
            Transfer::Download(bytes) => client.download_block_of(now, index, sub, bytes),
        }
        .map_err(|_| answer("the request cannot be made"))?;
        let outcome = loop {
            self.beat()?;
            while let Some(frame) = client.pop_frame() {
                self.send(&frame)?;
            }
            let outcome = match self.receive(self.wake(client.next_deadline().unwrap_or(now)))? {
                Some((at, frame)) => {
                    let before = client.progress();
                    let outcome = client.on_frame(at, &frame);
                    if client.progress() != before
                        && let Err(error) = show(client.progress())
                    {
                        self.send(&abort_of(server, address))?;
                        return Err(error);
                    }
                    if outcome.is_none() {
                        self.backlog.push_back((at, frame));
                    }
                    outcome
                }
                None => client.poll(self.link.now()),
            };
            if let Some(outcome) = outcome {
                break outcome;
            }
        };
        while let Some(frame) = client.pop_frame() {
            self.send(&frame)?;
        }
        match outcome {
            Outcome::Uploaded | Outcome::Downloaded => Ok(client.data().to_vec()),
            Outcome::Failed(SdoError::Timeout) => Err(MasterError::NodeSilent { node }),
            Outcome::Failed(SdoError::Aborted(code)) => Err(MasterError::Refused {
                node,
                action: what.action(address),
                abort: AbortCode::from_code(code).unwrap_or(AbortCode::General),
            }),
            Outcome::Failed(SdoError::Protocol(code)) => Err(answer(code.text())),
        }
    }
}
