//! The SDO server: lets a client read and write every object (CiA 301, 7.2.4).
//!
//! Requests come on 0x600 plus node-ID, answers go out on 0x580 plus node-ID. Only expedited
//! transfers so far: values of up to four bytes.

use super::Core;
use crate::bytes::low_u8;
use crate::{AbortCode, Event, Frame, Micros, NmtState, ObjectDictionary};

const SDO_RESPONSE: u16 = 0x580;

/// Client command specifiers, bits 5 to 7 of the first byte.
const DOWNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const ABORT: u8 = 4;

/// Bits of an initiate request or response.
const EXPEDITED: u8 = 0b10;
const SIZE_INDICATED: u8 = 0b01;

pub(super) struct Server {}

impl Server {
    pub const fn new() -> Self {
        Self {}
    }

    /// Forgets any transfer without a word.
    pub fn reset(&mut self) {}

    pub fn on_request<O: ObjectDictionary>(
        &mut self,
        now: Micros,
        frame: &Frame,
        core: &mut Core,
        od: &mut O,
    ) {
        let speaks = matches!(core.state, NmtState::PreOperational | NmtState::Operational);
        let (Some(node), true, 8) = (core.node, speaks, frame.len()) else {
            return;
        };
        let [command, low, high, sub, a, b, c, d] = *frame.padded();
        let index = u16::from_le_bytes([low, high]);
        let answer = match command >> 5 {
            ABORT => return,
            DOWNLOAD => download(now, command, index, sub, [a, b, c, d], core, od)
                .map(|()| [0x60, low, high, sub, 0, 0, 0, 0]),
            UPLOAD => upload(index, sub, core, od),
            _ => Err(AbortCode::CommandSpecifier),
        };
        let answer = answer.unwrap_or_else(|code| {
            core.out.count(|counters| &mut counters.sdo_aborts);
            let [a, b, c, d] = code.code().to_le_bytes();
            [0x80, low, high, sub, a, b, c, d]
        });
        core.out.send(Frame::of(node.cob_id(SDO_RESPONSE), answer));
    }
}

fn upload<O: ObjectDictionary>(
    index: u16,
    sub: u8,
    core: &Core,
    od: &O,
) -> Result<[u8; 8], AbortCode> {
    let mut value = [0; 64];
    let len = core.read(index, sub, &mut value, od)?;
    if len > 4 {
        return Err(AbortCode::OutOfMemory);
    }
    let unused = 4u8.saturating_sub(u8::try_from(len).unwrap_or(4));
    let [a, b, c, d, ..] = value;
    let [low, high] = index.to_le_bytes();
    let command = 0x40 | unused << 2 | EXPEDITED | SIZE_INDICATED;
    Ok([command, low, high, sub, a, b, c, d])
}

fn download<O: ObjectDictionary>(
    now: Micros,
    command: u8,
    index: u16,
    sub: u8,
    value: [u8; 4],
    core: &mut Core,
    od: &mut O,
) -> Result<(), AbortCode> {
    if command & EXPEDITED == 0 {
        return Err(AbortCode::OutOfMemory);
    }
    let len = match command & SIZE_INDICATED != 0 {
        true => 4 - usize::from(low_u8(u32::from(command >> 2 & 0b11))),
        false => expected_len(index, sub, core, od),
    };
    let value = value.get(..len).unwrap_or(&value);
    core.write(now, index, sub, value, od)?;
    core.out.emit(Event::ObjectWritten { index, sub });
    Ok(())
}

/// The length an expedited download has if the client does not say: that of the object as it is,
/// four bytes if it cannot be read.
fn expected_len<O: ObjectDictionary>(index: u16, sub: u8, core: &Core, od: &O) -> usize {
    let mut value = [0; 4];
    core.read(index, sub, &mut value, od).unwrap_or(4)
}
