//! Block transfers, the client's side.
//!
//! Lost segments are repeated: in an upload only those in order are kept and acknowledged, in a
//! download the device says which was the last good one.

use super::{Outcome, SdoClient, SdoError, State};
use crate::AbortCode;
use crate::crc::crc16;

/// Segments the device may send before it must wait for the acknowledgement.
const UPLOAD_BLOCK: u8 = 127;

const CRC: u8 = 0b100;
const SIZE: u8 = 0b010;
const LAST: u8 = 0x80;

impl SdoClient<'_> {
    pub(super) fn request_block_upload(&mut self) {
        self.request(0xA0 | CRC, [UPLOAD_BLOCK, 0, 0, 0]);
    }

    pub(super) fn on_block_upload(
        &mut self,
        command: u8,
        len: [u8; 4],
    ) -> Result<Option<Outcome>, AbortCode> {
        if command & 1 != 0 {
            return Err(AbortCode::CommandSpecifier);
        }
        self.with_crc = command & CRC != 0;
        let indicated = command & SIZE != 0;
        self.announced = indicated
            .then_some(u32::from_le_bytes(len))
            .and_then(|len| usize::try_from(len).ok());
        self.state = State::BlockUploadSegment { seq: 0 };
        self.queue([0xA3, 0, 0, 0, 0, 0, 0, 0]);
        Ok(None)
    }

    pub(super) fn on_block_segment(
        &mut self,
        seq: u8,
        answer: [u8; 8],
    ) -> Result<Option<Outcome>, AbortCode> {
        let [command, bytes @ ..] = answer;
        if command == LAST {
            // Number 0 does not exist: this is the device's abort.
            let [_, _, _, _, code @ ..] = answer;
            let code = u32::from_le_bytes(code);
            return Ok(Some(Outcome::Failed(SdoError::Aborted(code))));
        }
        let (number, last) = (command & !LAST, command & LAST != 0);
        let in_order = number == seq.saturating_add(1);
        let seq = match in_order {
            true => {
                self.collect(&bytes)?;
                number
            }
            false => seq,
        };
        self.state = State::BlockUploadSegment { seq };
        if number == UPLOAD_BLOCK || last {
            self.state = match in_order && last {
                true => State::BlockUploadEnd,
                false => State::BlockUploadSegment { seq: 0 },
            };
            self.queue([0xA2, seq, UPLOAD_BLOCK, 0, 0, 0, 0, 0]);
        }
        Ok(None)
    }

    pub(super) fn on_block_upload_end(
        &mut self,
        command: u8,
        crc: [u8; 2],
    ) -> Result<Option<Outcome>, AbortCode> {
        if command & 0b11 != 1 {
            return Err(AbortCode::CommandSpecifier);
        }
        let unused = usize::from(command >> 2 & 0b111);
        let len = self.at.saturating_sub(unused);
        let value = self.data.get(..len).unwrap_or(&[]);
        if self.with_crc && crc16(0, value) != u16::from_le_bytes(crc) {
            return Err(AbortCode::Crc);
        }
        let outcome = self.uploaded(len)?;
        self.queue([0xA1, 0, 0, 0, 0, 0, 0, 0]);
        Ok(outcome)
    }

    pub(super) fn request_block_download(&mut self) {
        self.request(0xC0 | CRC | SIZE, self.len_bytes());
    }

    pub(super) fn on_block_download(
        &mut self,
        command: u8,
        block_size: u8,
    ) -> Result<Option<Outcome>, AbortCode> {
        if command & 0b11 != 0 {
            return Err(AbortCode::CommandSpecifier);
        }
        self.with_crc = command & CRC != 0;
        self.next_block(block_size)
    }

    fn next_block(&mut self, block_size: u8) -> Result<Option<Outcome>, AbortCode> {
        if !matches!(block_size, 1..=127) {
            return Err(AbortCode::BlockSize);
        }
        self.block_size = block_size;
        self.state = State::BlockDownloadSegment { seq: 0 };
        Ok(None)
    }

    /// The next segment of a download, if one is to be sent.
    pub(super) fn next_block_segment(&mut self) -> Option<[u8; 8]> {
        let State::BlockDownloadSegment { seq } = self.state else {
            return None;
        };
        let at = self.at.saturating_add(usize::from(seq).saturating_mul(7));
        if seq >= self.block_size || (at >= self.len && seq != 0) {
            return None;
        }
        let number = seq.saturating_add(1);
        self.state = State::BlockDownloadSegment { seq: number };
        let last = match at.saturating_add(7) >= self.len {
            true => LAST,
            false => 0,
        };
        let ([a, b, c, d, e, f, g], _) = self.segment(at);
        Some([number | last, a, b, c, d, e, f, g])
    }

    pub(super) fn on_block_ack(
        &mut self,
        seq: u8,
        command: u8,
        good: u8,
        block_size: u8,
    ) -> Result<Option<Outcome>, AbortCode> {
        if command & 0b11 != 2 {
            return Err(AbortCode::CommandSpecifier);
        }
        if good > seq {
            return Err(AbortCode::SequenceNumber);
        }
        self.at = self.at.saturating_add(usize::from(good).saturating_mul(7));
        if self.at < self.len || self.at == 0 {
            return self.next_block(block_size);
        }
        let crc = match self.with_crc {
            true => crc16(0, self.data()),
            false => 0,
        };
        let [low, high] = crc.to_le_bytes();
        let unused = u8::try_from(self.at.saturating_sub(self.len)).unwrap_or(0) & 0b111;
        self.state = State::BlockDownloadEnd;
        self.queue([0xC1 | unused << 2, low, high, 0, 0, 0, 0, 0]);
        Ok(None)
    }
}
