//! Expedited and segmented transfers (CiA 301, 7.2.4.3.3 to 7.2.4.3.8).

use super::{Access, Answer, EXPEDITED, SIZE_INDICATED, Server, State};
use crate::AbortCode;

/// The toggle bit of a segment.
const TOGGLE: u8 = 0x10;
/// The bit of the last segment.
const LAST: u8 = 0x01;

impl Server {
    pub(super) fn upload(&mut self, access: &Access<'_>) -> Answer {
        self.fetch(access)?;
        let unused = match self.len {
            1 => 3,
            2 => 2,
            3 => 1,
            4 => 0,
            _ => {
                self.state = State::Upload { toggle: false };
                return Ok(Some(self.reply(0x40 | SIZE_INDICATED, self.len_bytes())));
            }
        };
        let [_, a, b, c, d, ..] = self.segment(0).0;
        let command = 0x40 | unused << 2 | EXPEDITED | SIZE_INDICATED;
        Ok(Some(self.reply(command, [a, b, c, d])))
    }

    pub(super) fn on_upload_segment(&mut self, command: u8) -> Answer {
        let State::Upload { toggle } = self.state else {
            return Err(AbortCode::CommandSpecifier);
        };
        if (command & TOGGLE != 0) != toggle {
            return Err(AbortCode::ToggleBit);
        }
        let (mut segment, unused) = self.segment(self.at);
        self.at = self.at.saturating_add(7);
        let mut command = unused << 1 | if toggle { TOGGLE } else { 0 };
        if self.at < self.len {
            self.state = State::Upload { toggle: !toggle };
        } else {
            command |= LAST;
            self.reset();
        }
        segment[0] = command;
        Ok(Some(segment))
    }

    pub(super) fn download(
        &mut self,
        command: u8,
        value: [u8; 4],
        access: &mut Access<'_>,
    ) -> Answer {
        let indicated = command & SIZE_INDICATED != 0;
        if command & EXPEDITED == 0 {
            let len = u32::from_le_bytes(value);
            self.announce(indicated.then_some(len), access)?;
            self.state = State::Download { toggle: false };
            return Ok(Some(self.reply(0x60, [0; 4])));
        }
        let len = match indicated {
            true => 4 - usize::from(command >> 2 & 0b11),
            // The client does not say: as long as the object is, four bytes if it cannot be read.
            false => match self.fetch(access) {
                Ok(()) => self.len,
                Err(_) => 4,
            },
        };
        // What has been read to know its length is no part of what is written.
        self.len = 0;
        let value = value.get(..len).unwrap_or(&value);
        if self.begin_stream(u32::try_from(len).ok(), access)? {
            self.stream(value, access)?;
            self.deliver(len, access)?;
        } else {
            access.write(self.index, self.sub, value)?;
        }
        Ok(Some(self.reply(0x60, [0; 4])))
    }

    pub(super) fn on_download_segment(
        &mut self,
        request: [u8; 8],
        access: &mut Access<'_>,
    ) -> Answer {
        let State::Download { toggle } = self.state else {
            return Err(AbortCode::CommandSpecifier);
        };
        let [command, bytes @ ..] = request;
        if (command & TOGGLE != 0) != toggle {
            return Err(AbortCode::ToggleBit);
        }
        let used = 7 - usize::from(command >> 1 & 0b111);
        self.collect(bytes.get(..used).unwrap_or(&bytes), access)?;
        if self.announced.is_some_and(|announced| self.at > announced) {
            return Err(AbortCode::TooLong);
        }
        if command & LAST != 0 {
            self.deliver(self.at, access)?;
        } else {
            self.state = State::Download { toggle: !toggle };
        }
        let answer = 0x20 | if toggle { TOGGLE } else { 0 };
        Ok(Some([answer, 0, 0, 0, 0, 0, 0, 0]))
    }
}
