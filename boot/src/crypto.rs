//! Signatures and hashes. The boot code contains their implementation, and the image calls it.

/// Ed25519 (RFC 8032) and SHA-512 (FIPS 180-4).
pub trait Crypto {
    /// A hash under way.
    type Hash;

    /// Begins a hash.
    fn begin(&self) -> Self::Hash;

    /// Goes on with a hash.
    fn update(&self, hash: &mut Self::Hash, bytes: &[u8]);

    /// Ends a hash.
    fn finish(&self, hash: Self::Hash) -> [u8; 64];

    /// Whether the signature of a message is one by the [public key](crate::key::PUBLIC) that this
    /// was built with.
    fn is_signed(&self, message: &[u8], signature: &[u8; 64]) -> bool;
}
