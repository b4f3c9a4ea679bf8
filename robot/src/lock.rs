//! The lock: a client with its key may change what a robot stores, for a while.
//!
//! # Theory of operation
//!
//! A robot that has a key refuses every write of an object that the table marks as guarded, of a
//! communication object, and of a node-ID, until it has been unlocked. A client reads a challenge
//! and writes the response, which is the HMAC-SHA-512 (RFC 2104, FIPS 180-4) of the challenge and
//! the node-ID under the key. The challenge is itself an HMAC, of serial number, number of the
//! start and number of the attempt. So no two attempts have the same one, and it cannot be
//! predicted without the key. Each attempt uses up its challenge, whether it was right or wrong.
//!
//! A wrong response bars further ones for a second, and each further one in a row for twice as
//! long, up to 64 s; a reset by NMT does not end that. The robot locks itself when nothing guarded
//! has been written for ten minutes, on command, and at every reset.
//!
//! # Interface
//!
//! The application asks `Lock::pass` before a guarded write. The platform provides the hash
//! function, stores the key in flash, and returns it at start.
//!
//! # Limits
//!
//! A key of zeros means that there is none. The key itself is sent over the bus when it is set, so
//! anyone who listens then has it. No object that moves or stops a robot is guarded.

use boot::Crypto;
use canopen::AbortCode;
use control::time::Micros;

/// Bytes of a key.
pub const KEY_LENGTH: usize = 32;
/// Bytes of a challenge, and of a response.
pub const CODE_LENGTH: usize = 64;

/// A key; all zeros for none.
pub type Key = [u8; KEY_LENGTH];
/// A challenge, or the response to one.
pub type Code = [u8; CODE_LENGTH];
/// Writes HMAC-SHA-512 of a message under a key; `false` on a robot that has no hash.
pub type Hmac = fn(&Key, &[u8], &mut Code) -> bool;

/// No key: the lock is off.
pub const NO_KEY: Key = [0; KEY_LENGTH];

/// How long a robot stays unlocked while nothing guarded is written: ten minutes.
const IDLE: u32 = seconds(Micros(600_000_000));
/// How often the wait after a wrong response doubles.
const DOUBLINGS: u32 = 6;

/// Bytes of a block of SHA-512.
const BLOCK: usize = 128;

/// HMAC-SHA-512 (RFC 2104). A shorter key is one with zeros behind it.
#[must_use]
pub fn hmac_sha512(crypto: &impl Crypto, key: &Key, message: &[u8]) -> Code {
    let mut code = [0; CODE_LENGTH];
    let mut message = message;
    for pad in [0x36, 0x5C] {
        let mut block = [pad; BLOCK];
        for (to, key) in block.iter_mut().zip(key) {
            *to ^= key;
        }
        let mut hash = crypto.begin();
        crypto.update(&mut hash, &block);
        crypto.update(&mut hash, message);
        code = crypto.finish(hash);
        message = &code;
    }
    code
}

/// Time in units of 2^20 us, 1.05 s: a word is enough for that, and no finer time is needed.
#[expect(clippy::cast_possible_truncation, reason = "a century")]
const fn seconds(time: Micros) -> u32 {
    (time.0 >> 20) as u32
}

/// See the [module](self).
#[derive(Clone)]
pub(crate) struct Lock {
    key: Key,
    hmac: Hmac,
    /// A key that waits to be put into flash, if it does.
    pub new_key: Key,
    pub is_key_new: bool,
    /// Responses that have been judged since the start.
    attempts: u32,
    /// Wrong ones in a row.
    wrong: u32,
    /// Unlocked until then.
    until: u32,
    /// No response is judged before.
    barred_until: u32,
}

impl Lock {
    pub const fn new() -> Self {
        Self {
            key: NO_KEY,
            hmac: |_, _, _| false,
            new_key: NO_KEY,
            is_key_new: false,
            attempts: 0,
            wrong: 0,
            until: 0,
            barred_until: 0,
        }
    }

    /// Takes in what the platform has.
    pub fn give(&mut self, key: Key, hmac: Hmac) {
        self.key = key;
        self.hmac = hmac;
        self.lock();
    }

    /// Object 0x2004:1.
    #[inline(never)]
    pub fn state(&self, now: Micros) -> u8 {
        if self.key == NO_KEY {
            0
        } else if seconds(now) >= self.until {
            1
        } else {
            2
        }
    }

    pub fn is_locked(&self, now: Micros) -> bool {
        self.state(now) == 1
    }

    /// Lets something guarded happen, unless the robot is locked.
    #[inline(never)]
    pub fn pass(&mut self, now: Micros) -> Result<(), AbortCode> {
        if self.is_locked(now) {
            return Err(AbortCode::LocalControl);
        }
        self.unlock(now);
        Ok(())
    }

    const fn unlock(&mut self, now: Micros) {
        self.until = seconds(now).wrapping_add(IDLE);
    }

    pub const fn lock(&mut self) {
        self.until = 0;
    }

    /// Writes the challenge of the next attempt.
    pub fn challenge(&self, serial: u32, start: u32, out: &mut Code) -> Result<(), AbortCode> {
        if self.key == NO_KEY {
            return Err(AbortCode::NoData);
        }
        let words = [serial, start, self.attempts].map(u32::to_le_bytes);
        self.code(&self.key, words.as_flattened(), out)
    }

    fn code(&self, key: &Key, message: &[u8], out: &mut Code) -> Result<(), AbortCode> {
        if (self.hmac)(key, message, out) {
            Ok(())
        } else {
            Err(AbortCode::Hardware)
        }
    }

    /// Judges the response to a challenge and what comes behind it.
    pub fn respond(
        &mut self,
        now: Micros,
        challenge: &[u8],
        response: &[u8],
    ) -> Result<(), AbortCode> {
        if seconds(now) < self.barred_until {
            return Err(AbortCode::DeviceState);
        }
        if response.len() != CODE_LENGTH {
            return Err(AbortCode::LengthMismatch);
        }
        let mut right = [0; CODE_LENGTH];
        self.code(&self.key, challenge, &mut right)?;
        self.attempts = self.attempts.wrapping_add(1);
        // All of it, so that the time says nothing about where they differ.
        let pairs = right.iter().zip(response);
        if pairs.fold(0, |differs, (a, b)| differs | (a ^ b)) == 0 {
            self.wrong = 0;
            self.unlock(now);
            return Ok(());
        }
        // One more, because this one has begun.
        self.barred_until = seconds(now).wrapping_add(1 + (1 << self.wrong));
        self.wrong = (self.wrong + 1).min(DOUBLINGS);
        Err(AbortCode::InvalidValue)
    }

    /// Takes a key that is to be put into flash, and in force when it is there.
    pub fn change(&mut self, key: &[u8]) -> Result<(), AbortCode> {
        let key = key.try_into().map_err(|_| AbortCode::LengthMismatch)?;
        // A robot without a hash could not be unlocked.
        self.code(key, &[], &mut [0; CODE_LENGTH])?;
        self.new_key = *key;
        self.is_key_new = true;
        Ok(())
    }

    /// The key that waited is in flash, or cannot be; `false` if none waited.
    pub fn stored(&mut self, now: Micros, is_stored: bool) -> bool {
        let waited = core::mem::take(&mut self.is_key_new);
        if waited && is_stored {
            self.key = self.new_key;
            self.unlock(now);
        }
        waited
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    fn hex(text: &str) -> Vec<u8> {
        let digits: Vec<char> = text.chars().filter(|c| !c.is_whitespace()).collect();
        digits
            .chunks(2)
            .map(|pair| {
                u8::from_str_radix(&pair.iter().collect::<std::string::String>(), 16).unwrap()
            })
            .collect()
    }

    fn code(key: &[u8], message: &[u8]) -> Vec<u8> {
        let mut padded = NO_KEY;
        padded[..key.len()].copy_from_slice(key);
        hmac_sha512(&boot::Software::default(), &padded, message).to_vec()
    }

    /// RFC 4231, test cases 1 to 4: those with keys of at most 32 bytes, and of a whole code.
    #[test]
    fn rfc_4231_hmac_sha_512() {
        let cases = [
            (
                vec![0x0B; 20],
                b"Hi There".to_vec(),
                "87aa7cdea5ef619d4ff0b4241a1d6cb0 2379f4e2ce4ec2787ad0b30545e17cde
                 daa833b7d6b8a702038b274eaea3f4e4 be9d914eeb61f1702e696c203a126854",
            ),
            (
                b"Jefe".to_vec(),
                b"what do ya want for nothing?".to_vec(),
                "164b7a7bfcf819e2e395fbe73b56e0a3 87bd64222e831fd610270cd7ea250554
                 9758bf75c05a994a6d034f65f8f0e6fd caeab1a34d4a6b4b636e070a38bce737",
            ),
            (
                vec![0xAA; 20],
                vec![0xDD; 50],
                "fa73b0089d56a284efb0f0756c890be9 b1b5dbdd8ee81a3655f83e33b2279d39
                 bf3e848279a722c806b485a47e67c807 b946a337bee8942674278859e13292fb",
            ),
            (
                (1..=25).collect(),
                vec![0xCD; 50],
                "b0ba465637458c6990e5a8c5f61d4af7 e576d97ff94b872de76f8050361ee3db
                 a91ca5c11aa25eb4d679275cc5788063 a5f19741120c4f2de2adebeb10a298dd",
            ),
        ];
        for (key, message, expected) in cases {
            assert_eq!(code(&key, &message), hex(expected));
        }
    }
}
