//! The messages as other implementations can compare them (`tests/interop/test_ros.py`).
//!
//! Prints a line for each: its type, a tab, its definition as a string. Then it reads lines of a
//! type, a tab and a message in CDR as hexadecimal digits, and answers each with the same message,
//! read and written again.

use std::io::BufRead as _;

use byteorder::LittleEndian;
use omnibus_ros::message::{self, Message};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Four bytes before every message say how it is encoded.
const ENCAPSULATION: usize = 4;

struct Kind {
    name: &'static str,
    definition: String,
    again: fn(&[u8]) -> Result<Vec<u8>, String>,
}

fn kind<M: Message + Serialize + DeserializeOwned>() -> Kind {
    Kind {
        name: M::TYPE,
        definition: message::definition::<M>(),
        again: |bytes| {
            let body = bytes.get(ENCAPSULATION..).ok_or("too short")?;
            let (value, read) = cdr_encoding::from_bytes::<M, LittleEndian>(body)
                .map_err(|error| error.to_string())?;
            if read != body.len() {
                return Err(format!("{} bytes are left", body.len() - read));
            }
            message::to_cdr(&value).map_err(|error| error.to_string())
        },
    }
}

fn kinds() -> Vec<Kind> {
    vec![
        kind::<message::Bool>(),
        kind::<message::Twist>(),
        kind::<message::TwistStamped>(),
        kind::<message::Odometry>(),
        kind::<message::TFMessage>(),
        kind::<message::JointState>(),
        kind::<message::BatteryState>(),
        kind::<message::DiagnosticArray>(),
    ]
}

fn bytes(digits: &str) -> Result<Vec<u8>, String> {
    let pair = |at| {
        let two = digits.get(at..at + 2).ok_or("an odd number of digits")?;
        u8::from_str_radix(two, 16).map_err(|error| error.to_string())
    };
    (0..digits.len()).step_by(2).map(pair).collect()
}

fn main() -> Result<(), String> {
    let kinds = kinds();
    for kind in &kinds {
        println!("{}\t{:?}", kind.name, kind.definition);
    }
    for line in std::io::stdin().lock().lines() {
        let line = line.map_err(|error| error.to_string())?;
        let (name, digits) = line.split_once('\t').ok_or("a line has no tab")?;
        let kind = kinds.iter().find(|kind| kind.name == name);
        let kind = kind.ok_or_else(|| format!("{name} is not used"))?;
        let again = (kind.again)(&bytes(digits)?)?;
        println!(
            "{}",
            again
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect::<String>()
        );
    }
    Ok(())
}
