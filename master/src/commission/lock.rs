//! The lock of robots: object 0x2004, by challenge and response.

use boot::Software;
use canopen::{AbortCode, Micros};
use protocol::{Kind, Value, address as at};
use robot::lock::{KEY_LENGTH, NO_KEY, hmac_sha512};

pub use robot::lock::Key;

use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::error::MasterError;

/// A robot has no challenge in the first second after a start, and takes none for as long after a
/// wrong response; this is time enough, in us.
const PATIENCE_US: u64 = 3_000_000;
/// How often it is asked, in us.
const ASK_US: u64 = 100_000;

/// State of a robot's lock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LockState {
    /// It has no key, so everything may be written.
    NoKey,
    /// Guarded writes are refused.
    Locked,
    /// It has a key, and guarded writes are accepted for a while.
    Unlocked,
}

/// Reads the 32 bytes of a key.
///
/// # Errors
/// In words, what is wrong with them.
pub fn key(bytes: &[u8]) -> Result<Key, String> {
    let key = Key::try_from(bytes).map_err(|_| {
        let length = bytes.len();
        format!(
            "a key has {KEY_LENGTH} bytes, not {length}; `omnibus lock --set-key FILE --new` makes one"
        )
    })?;
    if key == NO_KEY {
        return Err("all zeros are no key; `omnibus lock --set-key FILE --new` makes one".into());
    }
    Ok(key)
}

/// The state of a robot's lock.
///
/// # Errors
/// When the robot does not answer, or has no such object.
pub fn state<L: Link>(wire: &mut Wire<L>, node: u8) -> Result<LockState, MasterError> {
    let state = wire.read(node, at::LOCK_STATE, Kind::U8)?;
    Ok(match state.to_bits() {
        0 => LockState::NoKey,
        1 => LockState::Locked,
        _ => LockState::Unlocked,
    })
}

/// Unlocks a robot. Does nothing to one that has no key or is unlocked.
///
/// # Errors
/// When the key is another one, when wrong responses bar the robot for a while, and when it does
/// not answer or is OPERATIONAL.
pub fn unlock<L: Link>(wire: &mut Wire<L>, node: u8, key: &Key) -> Result<(), MasterError> {
    if state(wire, node)? != LockState::Locked {
        return Ok(());
    }
    let until = wire.now() + Micros(PATIENCE_US);
    loop {
        let error = match attempt(wire, node, key) {
            Ok(()) => return Ok(()),
            Err(error) => error,
        };
        match error.cause() {
            MasterError::Refused { abort, .. } if *abort == AbortCode::InvalidValue => {
                return Err(MasterError::WrongKey { node });
            }
            MasterError::Refused { abort, .. } if *abort == AbortCode::DeviceState => {
                if wire.now() >= until {
                    return Err(MasterError::Barred { node });
                }
                wire.pass(ASK_US)?;
            }
            _ => return Err(error),
        }
    }
}

/// One challenge and its response.
fn attempt<L: Link>(wire: &mut Wire<L>, node: u8, key: &Key) -> Result<(), MasterError> {
    let mut message = wire.read_block(node, at::LOCK_CHALLENGE)?;
    message.push(node);
    let response = hmac_sha512(&Software::default(), key, &message);
    wire.download(node, at::LOCK_RESPONSE, &response, &mut |_| Ok(()))
}

/// Locks a robot that has a key.
///
/// # Errors
/// When it refuses or does not answer.
pub fn lock<L: Link>(wire: &mut Wire<L>, node: u8) -> Result<(), MasterError> {
    wire.write(node, at::LOCK_STATE, Value::U8(1))
}

/// Gives a robot a key, or takes its key away with `None`. It has to be unlocked or without a key.
///
/// # Errors
/// When it is locked or not at rest, and when it does not answer.
pub fn set_key<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    key: Option<&Key>,
) -> Result<(), MasterError> {
    let key = key.unwrap_or(&NO_KEY);
    wire.download(node, at::LOCK_KEY, key, &mut |_| Ok(()))
}
