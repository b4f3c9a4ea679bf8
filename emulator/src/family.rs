//! The families of chips: what their registers have in common.

/// Whose registers a chip has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// STM32F1.
    F1,
    /// STM32F4.
    F4,
}
