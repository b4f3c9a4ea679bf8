//! Signatures and hashes by `salty`, which was chosen for its size.

use salty::{Keypair, PublicKey, Sha512, Signature};

use crate::Crypto;

/// Signatures and hashes in software.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Software {
    /// The key that signatures are checked with.
    pub public_key: [u8; 32],
}

impl Default for Software {
    /// With the key that this was built with.
    fn default() -> Self {
        Self {
            public_key: crate::key::PUBLIC,
        }
    }
}

impl Crypto for Software {
    type Hash = Sha512;

    fn begin(&self) -> Sha512 {
        Sha512::new()
    }

    fn update(&self, hash: &mut Sha512, bytes: &[u8]) {
        hash.update(bytes);
    }

    fn finish(&self, hash: Sha512) -> [u8; 64] {
        hash.finalize()
    }

    fn is_signed(&self, message: &[u8], signature: &[u8; 64]) -> bool {
        let Ok(key) = PublicKey::try_from(&self.public_key) else {
            return false;
        };
        key.verify(message, &Signature::from(signature)).is_ok()
    }
}

/// The public key of a private one.
#[must_use]
pub fn public_key(private: &[u8; 32]) -> [u8; 32] {
    *Keypair::from(private).public.as_bytes()
}

/// Signs a message.
#[must_use]
pub fn sign(private: &[u8; 32], message: &[u8]) -> [u8; 64] {
    Keypair::from(private).sign(message).to_bytes()
}
