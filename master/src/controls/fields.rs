//! The fields of a message that asks for something: one JSON object, `type` first.
//!
//! The page and the bridge read their clients' messages through this, so that both name the field
//! that is wrong and what it must be, without a word of how it is kept here. Fields are taken one
//! by one; [`Fields::end`] refuses what is left, so that a field with a typing error is never
//! ignored.

use serde_json::{Map, Value};

/// What a message says that is not its type.
#[derive(Clone, Debug)]
pub struct Fields(Map<String, Value>);

impl Fields {
    /// Reads a message: its type and its other fields.
    ///
    /// # Errors
    /// When it is no JSON object with a type.
    pub fn read(text: &[u8]) -> Result<(String, Self), String> {
        let value = serde_json::from_slice(text).map_err(|error| refuse(format!("{error}")))?;
        let Value::Object(mut fields) = value else {
            return Err(refuse(
                "a message is a JSON object, as in {\"type\":\"stop\"}",
            ));
        };
        match fields.remove("type") {
            Some(Value::String(kind)) => Ok((kind, Self(fields))),
            Some(other) => Err(refuse(format!("type: {other} is not a string"))),
            None => Err(refuse("the field `type` is missing")),
        }
    }

    /// Takes a number that an f32 can hold; `None` when it is not there.
    ///
    /// # Errors
    /// When it is something else.
    pub fn number(&mut self, name: &str) -> Result<Option<f64>, String> {
        let Some(value) = self.0.remove(name) else {
            return Ok(None);
        };
        match value.as_f64() {
            Some(number) if number.abs() <= f64::from(f32::MAX) => Ok(Some(number)),
            Some(_) => Err(refuse(format!("{name}: the number is too large"))),
            None => Err(refuse(format!("{name}: {value} is not a number"))),
        }
    }

    /// Takes a whole number from 0 up to `most`.
    ///
    /// # Errors
    /// When it is missing or something else.
    pub fn count(&mut self, name: &str, most: u64) -> Result<u64, String> {
        let value = self.take(name)?;
        let count = value.as_u64().filter(|count| *count <= most);
        count.ok_or_else(|| {
            refuse(format!(
                "{name}: {value} is not a whole number from 0 to {most}"
            ))
        })
    }

    /// Takes a text.
    ///
    /// # Errors
    /// When it is missing or something else.
    pub fn text(&mut self, name: &str) -> Result<String, String> {
        match self.take(name)? {
            Value::String(text) => Ok(text),
            other => Err(refuse(format!("{name}: {other} is not a string"))),
        }
    }

    fn take(&mut self, name: &str) -> Result<Value, String> {
        self.0.remove(name).ok_or_else(|| missing(name))
    }

    /// Every field has been taken.
    ///
    /// # Errors
    /// When one has not.
    pub fn end(self) -> Result<(), String> {
        match self.0.keys().next() {
            None => Ok(()),
            Some(field) => Err(refuse(format!("unknown field `{field}`"))),
        }
    }
}

/// The reason why a message was not understood.
#[must_use]
pub fn refuse(reason: impl std::fmt::Display) -> String {
    format!("not understood: {reason}")
}

/// The reason when a field is not there.
#[must_use]
pub fn missing(name: &str) -> String {
    refuse(format_args!("the field `{name}` is missing"))
}
