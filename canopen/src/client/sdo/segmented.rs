//! Expedited and segmented transfers, the client's side.

use super::{EXPEDITED, Outcome, SIZE_INDICATED, SdoClient, State};
use crate::AbortCode;

const TOGGLE: u8 = 0x10;
const LAST: u8 = 0x01;

const fn toggle_bit(toggle: bool) -> u8 {
    if toggle { TOGGLE } else { 0 }
}

impl SdoClient<'_> {
    pub(super) fn on_upload(
        &mut self,
        command: u8,
        value: [u8; 4],
    ) -> Result<Option<Outcome>, AbortCode> {
        let indicated = command & SIZE_INDICATED != 0;
        if command & EXPEDITED != 0 {
            let len = match indicated {
                true => 4 - usize::from(command >> 2 & 0b11),
                false => 4,
            };
            self.collect(value.get(..len).unwrap_or(&value))?;
            return self.uploaded(len);
        }
        let len = u32::from_le_bytes(value);
        self.announced = indicated
            .then_some(len)
            .and_then(|len| usize::try_from(len).ok());
        self.state = State::UploadSegment { toggle: false };
        self.queue([0x60, 0, 0, 0, 0, 0, 0, 0]);
        Ok(None)
    }

    pub(super) fn on_upload_segment(
        &mut self,
        toggle: bool,
        answer: [u8; 8],
    ) -> Result<Option<Outcome>, AbortCode> {
        let [command, bytes @ ..] = answer;
        if command & TOGGLE != toggle_bit(toggle) {
            return Err(AbortCode::ToggleBit);
        }
        let used = 7 - usize::from(command >> 1 & 0b111);
        self.collect(bytes.get(..used).unwrap_or(&bytes))?;
        if command & LAST != 0 {
            return self.uploaded(self.at);
        }
        let toggle = !toggle;
        self.state = State::UploadSegment { toggle };
        self.queue([0x60 | toggle_bit(toggle), 0, 0, 0, 0, 0, 0, 0]);
        Ok(None)
    }

    /// The device has accepted the start; an expedited download is done with that.
    pub(super) fn on_download(&mut self) -> Option<Outcome> {
        if matches!(self.len, 1..=4) {
            return Some(Outcome::Downloaded);
        }
        self.send_segment(false);
        None
    }

    pub(super) fn on_download_segment(
        &mut self,
        toggle: bool,
        command: u8,
    ) -> Result<Option<Outcome>, AbortCode> {
        if command & TOGGLE != toggle_bit(toggle) {
            return Err(AbortCode::ToggleBit);
        }
        self.at = self.at.saturating_add(7);
        if self.at >= self.len {
            return Ok(Some(Outcome::Downloaded));
        }
        self.send_segment(!toggle);
        Ok(None)
    }

    fn send_segment(&mut self, toggle: bool) {
        let ([a, b, c, d, e, f, g], unused) = self.segment(self.at);
        let last = match self.at.saturating_add(7) >= self.len {
            true => LAST,
            false => 0,
        };
        self.state = State::DownloadSegment { toggle };
        self.queue([toggle_bit(toggle) | unused << 1 | last, a, b, c, d, e, f, g]);
    }
}
