//! Errors of orders and instant actions, with the names of the standard.

use crate::Version;

/// What is wrong. Version 2 has few names for it, version 3 one for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorKind {
    /// Not JSON, a field is missing or has another type, or the graph is no path (6.6.4.1).
    Malformed,
    /// An optional field that this vehicle cannot use (6.6.4.2).
    UnsupportedParameter,
    /// An action that this vehicle does not have (6.6.4.2).
    InvalidOrderAction,
    /// The same order with a lower update number (6.6.4.3).
    OutdatedUpdate,
    /// The same order and update number with other content (3.0: 6.1.4.5).
    SameUpdateId,
    /// An update that does not continue at the last released node (6.6.2).
    UpdateDoesNotContinue,
    /// An update of an order that was cancelled (3.0: 6.1.3.1).
    UpdateAfterCancel,
    /// Another order is being executed (6.6.2).
    OtherOrderActive,
    /// The vehicle does not stand on the first node (6.6.1).
    StartOutOfRange,
    /// A node or trajectory cannot be reached (2.0: figure 8; 3.0: 6.1.4.8).
    NoRoute,
    /// The vehicle is not in automatic mode (3.0: 6.1.4.9).
    NotAvailable,
    /// A node on another map (3.0: 6.1.4.10).
    UnknownMap,
    /// `cancelOrder` without an order (6.6.3.2).
    NoOrderToCancel,
    /// An instant action that this vehicle does not have, or with wrong parameters.
    InvalidInstantAction,
    /// An instant action message that cannot be read.
    MalformedInstantAction,
}

impl ErrorKind {
    /// The field `errorType`.
    #[must_use]
    pub const fn name(self, version: Version) -> &'static str {
        match version {
            Version::V2_0 | Version::V2_1 => self.name_2(),
            Version::V3_0 => self.name_3(),
        }
    }

    const fn name_2(self) -> &'static str {
        match self {
            Self::Malformed | Self::MalformedInstantAction => "validationError",
            Self::UnsupportedParameter
            | Self::InvalidOrderAction
            | Self::OtherOrderActive
            | Self::NotAvailable => "orderError",
            Self::OutdatedUpdate
            | Self::SameUpdateId
            | Self::UpdateDoesNotContinue
            | Self::UpdateAfterCancel => "orderUpdateError",
            Self::StartOutOfRange | Self::NoRoute | Self::UnknownMap => "noRouteError",
            Self::NoOrderToCancel => "noOrderToCancel",
            Self::InvalidInstantAction => "instantActionError",
        }
    }

    const fn name_3(self) -> &'static str {
        match self {
            Self::Malformed | Self::MalformedInstantAction => "VALIDATION_FAILURE",
            Self::UnsupportedParameter => "UNSUPPORTED_PARAMETER",
            Self::InvalidOrderAction => "INVALID_ORDER_ACTION",
            Self::OutdatedUpdate => "OUTDATED_ORDER_UPDATE",
            Self::SameUpdateId => "SAME_ORDER_UPDATE_ID",
            Self::UpdateDoesNotContinue => "INVALID_ORDER",
            Self::UpdateAfterCancel => "ORDER_UPDATE_FOLLOWING_CANCEL",
            Self::OtherOrderActive => "OTHER_ORDER_ACTIVE",
            Self::StartOutOfRange => "START_NODE_OUT_OF_RANGE",
            Self::NoRoute => "NO_ROUTE_TO_TARGET",
            Self::NotAvailable => "MOBILE_ROBOT_NOT_AVAILABLE",
            Self::UnknownMap => "UNKNOWN_MAP_ID",
            Self::NoOrderToCancel => "NO_ORDER_TO_CANCEL",
            Self::InvalidInstantAction => "INVALID_INSTANT_ACTION",
        }
    }

    /// The field `errorLevel`.
    #[must_use]
    pub const fn level(self, version: Version) -> &'static str {
        match (self, version) {
            (Self::UnsupportedParameter, Version::V3_0) => "CRITICAL",
            _ => "WARNING",
        }
    }
}

/// Why something was refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// What is wrong.
    pub kind: ErrorKind,
    /// The same for people: what is wrong, where, and what to do.
    pub sentence: String,
    /// Where in the message, as key and value.
    pub references: Vec<(String, String)>,
}

impl Refusal {
    /// A refusal without references.
    #[must_use]
    pub fn new(kind: ErrorKind, sentence: impl Into<String>) -> Self {
        Self {
            kind,
            sentence: sentence.into(),
            references: Vec::new(),
        }
    }

    /// The same with one more reference.
    #[must_use]
    pub fn about(mut self, key: &str, value: impl ToString) -> Self {
        self.references.push((key.into(), value.to_string()));
        self
    }
}
