//! The security counter and the hardware revision of images of this source.

/// Raised when an older image must not come back, because it has a hole; see
/// [`Header::admit`](crate::header::Header::admit).
pub const SECURITY_COUNTER: u32 = 1;

/// Revision of the boards' hardware that the images are for: the wiring of `docs/bring-up.md`.
pub const HARDWARE_REVISION: u16 = 1;
