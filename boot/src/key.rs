//! The public key that images are checked with.
//!
//! It is built in: the key in the file that `OMNIBUS_PUBLIC_KEY` names in the environment of the
//! build, or else the development key. The private half of the development key is [in the
//! open](DEVELOPMENT_PRIVATE), so that anyone can try updates in the simulator; a signature with it
//! proves nothing.

/// The key that this was built with.
pub const PUBLIC: [u8; 32] = *include_bytes!(concat!(env!("OUT_DIR"), "/public_key"));

/// The development key.
pub const DEVELOPMENT: [u8; 32] = [
    0xad, 0x18, 0xd4, 0xbf, 0x24, 0x9e, 0x27, 0x91, 0x93, 0x7e, 0x37, 0xe9, 0x5e, 0x26, 0x51, 0x3b,
    0x4d, 0xe4, 0x18, 0x8f, 0x31, 0xce, 0x46, 0x58, 0x92, 0x5a, 0xa2, 0xb6, 0xcf, 0x50, 0x96, 0x8e,
];

/// The private half of the development key.
pub const DEVELOPMENT_PRIVATE: [u8; 32] = *b"Omnibus development key: insecur";

/// Whether images are checked with the development key, which protects nothing.
#[must_use]
pub const fn is_development() -> bool {
    let (mut ours, mut known) = (PUBLIC.as_slice(), DEVELOPMENT.as_slice());
    while let ([one, rest @ ..], [other, others @ ..]) = (ours, known) {
        if *one != *other {
            return false;
        }
        (ours, known) = (rest, others);
    }
    true
}
