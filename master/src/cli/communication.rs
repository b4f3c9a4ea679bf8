//! Communication objects (CiA 301, 0x1000 to 0x1FFF), which `protocol::OBJECTS` does not have: the
//! CANopen device of a robot answers for them. They are only read here; their names are those of
//! the data sheet.

use omnibus::bus::link::Link;
use omnibus::bus::wire::Wire;
use protocol::Address;
use serde_json::json;

use crate::cli::{json, print_json, print_line};

/// The address of such an object.
pub fn find(text: &str) -> Option<Address> {
    let (index, sub) = text.split_once(':').unwrap_or((text, "0"));
    let index = u16::from_str_radix(index.trim_start_matches("0x"), 16).ok()?;
    let sub = u8::from_str_radix(sub, 16).ok()?;
    (0x1000..0x2000)
        .contains(&index)
        .then(|| Address::new(index, sub))
}

/// Its name in CiA 301.
///
/// # Errors
/// When no robot has it.
pub fn name(at: Address) -> anyhow::Result<String> {
    let mut name = String::new();
    if canopen::eds::name(&mut name, at.index, at.sub).is_err() {
        usage!("there is no object {at}; docs/omnibus.eds lists the communication objects");
    }
    Ok(name)
}

/// Reads one: text, or a number of as many bytes as the robot sends.
pub fn get(
    address: Address,
    node: u8,
    open: impl FnOnce() -> anyhow::Result<Wire<Box<dyn Link>>>,
) -> anyhow::Result<()> {
    let name = name(address)?;
    let mut wire = open()?;
    let bytes = wire.read_block(node, address)?;
    let is_text = (0x1008..=0x100A).contains(&address.index);
    let (value, shown) = if is_text || bytes.len() > 4 {
        let text = String::from_utf8_lossy(&bytes).into_owned();
        (json!(text), text)
    } else {
        let bits = bytes
            .iter()
            .rev()
            .fold(0_u32, |bits, byte| bits << 8 | u32::from(*byte));
        (json!(bits), format!("{bits} (0x{bits:X})"))
    };
    if json() {
        return print_json(
            &json!({"node": node, "object": address.to_string(), "name": name,
            "value": value, "unit": "", "meaning": null}),
        );
    }
    print_line(format_args!("{name} ({address}) = {shown}"))
}
