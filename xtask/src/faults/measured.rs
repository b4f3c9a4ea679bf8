//! The figures of one trial.

/// What was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// From the cause to the beginning of the reaction, ms.
    pub reaction_ms: f64,
    /// From the cause to the end of the emergency message, ms.
    pub emergency_ms: f64,
    /// From the cause to drivers off and brake engaged, ms.
    pub rest_ms: f64,
    /// Largest ratio of the true rate of any wheel of the group after the cause to what was asked
    /// before it.
    pub wheel_rate: Option<f64>,
    /// How far the body went from the cause to rest, m.
    pub way: Option<f64>,
}
