//! Actions: on nodes, on edges and at once (6.8, 6.9).

use serde::Deserialize;
use serde_json::Value;

/// What else may happen while an action runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum BlockingType {
    /// Driving and other actions.
    None,
    /// Driving alone (3.0).
    Single,
    /// Other actions, but no driving.
    Soft,
    /// Nothing.
    Hard,
}

/// An action that the fleet control asks for.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Action {
    /// Its identifier.
    pub action_id: String,
    /// What is to be done.
    pub action_type: String,
    /// What else may happen meanwhile.
    pub blocking_type: BlockingType,
    /// Details.
    #[serde(default)]
    pub action_parameters: Vec<Parameter>,
}

/// A detail of an action.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Parameter {
    /// Its name.
    pub key: String,
    /// Its value.
    pub value: Value,
}

impl Action {
    /// A parameter by name.
    #[must_use]
    pub fn parameter(&self, key: &str) -> Option<&Value> {
        let mut found = self.action_parameters.iter();
        Some(&found.find(|parameter| parameter.key == key)?.value)
    }
}

/// The message `instantActions`. Its list is called `actions` in the text of 2.0 and
/// `instantActions` by fleet controls that follow 1.1 or the schema of that time; both are read.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct InstantActions {
    /// Number of the message.
    pub header_id: u64,
    /// When it was sent.
    pub timestamp: String,
    /// Version of the sender.
    pub version: String,
    /// For whom.
    pub manufacturer: String,
    /// For whom.
    pub serial_number: String,
    /// What is to be done.
    #[serde(alias = "instantActions")]
    pub actions: Vec<Action>,
}
