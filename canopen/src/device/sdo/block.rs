//! Block transfers (CiA 301, 7.2.4.3.9 to 7.2.4.3.15).
//!
//! In a download only segments that continue the sequence are kept; at the end of the block the
//! last good number is acknowledged and the client repeats the rest. In an upload the segments are
//! made when the transmit queue is empty, so a block of 127 needs no memory and does not delay
//! other frames.

use super::{Access, Answer, Server, State};
use crate::AbortCode;
use crate::crc::crc16;

/// Segments the client may send before it must wait for the acknowledgement: few enough for a
/// receive queue of modest size.
const DOWNLOAD_BLOCK: u8 = 32;

/// In an initiate request or response: CRC is supported, the size is given.
const CRC: u8 = 0b100;
const SIZE: u8 = 0b010;
/// In a segment: the last of the transfer.
const LAST: u8 = 0x80;

impl Server {
    pub(super) fn start_block_download(
        &mut self,
        command: u8,
        len: u32,
        access: &mut Access<'_>,
    ) -> Answer {
        self.announce((command & SIZE != 0).then_some(len), access)?;
        self.with_crc = command & CRC != 0;
        self.state = State::BlockDownload { seq: 0 };
        Ok(Some(self.reply(0xA0 | CRC, [DOWNLOAD_BLOCK, 0, 0, 0])))
    }

    pub(super) fn on_block_segment(
        &mut self,
        seq: u8,
        request: [u8; 8],
        access: &mut Access<'_>,
    ) -> Answer {
        let [command, bytes @ ..] = request;
        if command == LAST {
            // Number 0 does not exist: this is the client's abort.
            self.give_up(access.app);
            return Ok(None);
        }
        let number = command & !LAST;
        if number == 0 || number > DOWNLOAD_BLOCK {
            return Err(AbortCode::SequenceNumber);
        }
        let in_order = number == seq.saturating_add(1);
        let seq = match in_order {
            true => {
                self.collect(&bytes, access)?;
                number
            }
            false => seq,
        };
        self.state = State::BlockDownload { seq };
        if command & LAST == 0 && number < DOWNLOAD_BLOCK {
            return Ok(None);
        }
        self.state = match in_order && command & LAST != 0 {
            true => State::BlockDownloadEnd,
            false => State::BlockDownload { seq: 0 },
        };
        Ok(Some([0xA2, seq, DOWNLOAD_BLOCK, 0, 0, 0, 0, 0]))
    }

    pub(super) fn end_block_download(
        &mut self,
        command: u8,
        crc: [u8; 2],
        access: &mut Access<'_>,
    ) -> Answer {
        if !matches!(self.state, State::BlockDownloadEnd) {
            return Err(AbortCode::CommandSpecifier);
        }
        let unused = usize::from(command >> 2 & 0b111);
        let len = self.at.saturating_sub(unused);
        let crc = self.with_crc.then_some(u16::from_le_bytes(crc));
        if self.streams {
            self.end_stream(unused, crc, access)?;
        } else {
            let value = self.buffer.get(..len).ok_or(AbortCode::OutOfMemory)?;
            if crc.is_some_and(|crc| crc != crc16(0, value)) {
                return Err(AbortCode::Crc);
            }
        }
        self.deliver(len, access)?;
        Ok(Some([0xA1, 0, 0, 0, 0, 0, 0, 0]))
    }

    pub(super) fn start_block_upload(
        &mut self,
        command: u8,
        block_size: u8,
        access: &Access<'_>,
    ) -> Answer {
        self.set_block_size(block_size)?;
        self.fetch(access)?;
        self.with_crc = command & CRC != 0;
        self.state = State::BlockUploadStart;
        Ok(Some(self.reply(0xC0 | CRC | SIZE, self.len_bytes())))
    }

    pub(super) fn on_block_start(&mut self) -> Answer {
        if !matches!(self.state, State::BlockUploadStart) {
            return Err(AbortCode::CommandSpecifier);
        }
        self.state = State::BlockUpload { seq: 0 };
        Ok(None)
    }

    /// The next segment, if one is to be sent.
    pub(super) fn next_segment(&mut self) -> Option<[u8; 8]> {
        let State::BlockUpload { seq } = self.state else {
            return None;
        };
        let at = self.at.saturating_add(usize::from(seq).saturating_mul(7));
        // All sent, or an empty value, which still takes one segment.
        if seq >= self.block_size || (at >= self.len && seq != 0) {
            return None;
        }
        let number = seq.saturating_add(1);
        self.state = State::BlockUpload { seq: number };
        let last = match at.saturating_add(7) >= self.len {
            true => LAST,
            false => 0,
        };
        let (mut segment, _) = self.segment(at);
        segment[0] = number | last;
        Some(segment)
    }

    pub(super) fn on_block_acknowledge(&mut self, good: u8, block_size: u8) -> Answer {
        let State::BlockUpload { seq } = self.state else {
            return Err(AbortCode::CommandSpecifier);
        };
        if good > seq {
            return Err(AbortCode::SequenceNumber);
        }
        self.at = self.at.saturating_add(usize::from(good).saturating_mul(7));
        if self.at < self.len || (good == 0 && self.at == 0) {
            self.set_block_size(block_size)?;
            self.state = State::BlockUpload { seq: 0 };
            return Ok(None);
        }
        self.state = State::BlockUploadEnd;
        let value = self.buffer.get(..self.len).unwrap_or(&[]);
        let crc = match self.with_crc {
            true => crc16(0, value),
            false => 0,
        };
        let [low, high] = crc.to_le_bytes();
        let unused = u8::try_from(self.at.saturating_sub(self.len)).unwrap_or(0) & 0b111;
        Ok(Some([0xC1 | unused << 2, low, high, 0, 0, 0, 0, 0]))
    }

    pub(super) fn end_block_upload(&mut self) -> Answer {
        if !matches!(self.state, State::BlockUploadEnd) {
            return Err(AbortCode::CommandSpecifier);
        }
        self.reset();
        Ok(None)
    }

    fn set_block_size(&mut self, size: u8) -> Result<(), AbortCode> {
        match size {
            1..=127 => {
                self.block_size = size;
                Ok(())
            }
            _ => Err(AbortCode::BlockSize),
        }
    }
}
