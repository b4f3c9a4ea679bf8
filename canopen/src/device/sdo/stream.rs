//! Downloads into a sink of the application, of any length.
//!
//! The last piece received stays in the buffer until the next one comes: the end of a block
//! transfer says how many of its bytes are unused.

use super::{Access, Server};
use crate::crc::crc16;
use crate::{AbortCode, Event};

/// The most bytes that one frame of a download carries.
const PIECE: usize = 7;

impl Server {
    /// Begins a download into a sink; `false` if the object has none.
    pub(super) fn begin_stream(
        &mut self,
        announced: Option<u32>,
        access: &mut Access<'_>,
    ) -> Result<bool, AbortCode> {
        let state = access.core.state;
        let Some(sink) = access.app.sink(self.index, self.sub) else {
            return Ok(false);
        };
        sink.begin(announced, state)?;
        self.streams = true;
        self.announced = announced.and_then(|len| usize::try_from(len).ok());
        Ok(true)
    }

    /// Takes one piece and passes the one before on.
    pub(super) fn stream(
        &mut self,
        bytes: &[u8],
        access: &mut Access<'_>,
    ) -> Result<(), AbortCode> {
        self.at = self.at.saturating_add(bytes.len());
        // The last segment of a block transfer is filled up.
        let is_too_long = |announced: usize| self.at >= announced.saturating_add(PIECE);
        if self.announced.is_some_and(is_too_long) {
            return Err(AbortCode::TooLong);
        }
        self.pass_on(self.len, access)?;
        let held = self.buffer.get_mut(..bytes.len());
        held.ok_or(AbortCode::OutOfMemory)?.copy_from_slice(bytes);
        self.len = bytes.len();
        Ok(())
    }

    /// Passes on what is held back but for these last bytes, which are unused, and compares the
    /// CRC.
    pub(super) fn end_stream(
        &mut self,
        unused: usize,
        crc: Option<u16>,
        access: &mut Access<'_>,
    ) -> Result<(), AbortCode> {
        self.pass_on(self.len.saturating_sub(unused), access)?;
        match crc {
            Some(crc) if crc != self.crc => Err(AbortCode::Crc),
            Some(_) | None => Ok(()),
        }
    }

    /// The value is complete.
    pub(super) fn finish_stream(&mut self, access: &mut Access<'_>) -> Result<(), AbortCode> {
        self.pass_on(self.len, access)?;
        let sink = access.app.sink(self.index, self.sub);
        sink.ok_or(AbortCode::General)?.finish()?;
        self.streams = false;
        let (index, sub) = (self.index, self.sub);
        access.core.out.emit(Event::ObjectWritten { index, sub });
        Ok(())
    }

    fn pass_on(&mut self, len: usize, access: &mut Access<'_>) -> Result<(), AbortCode> {
        self.len = 0;
        let held = self.buffer.get(..len).unwrap_or(&[]);
        if held.is_empty() {
            return Ok(());
        }
        self.crc = crc16(self.crc, held);
        let sink = access.app.sink(self.index, self.sub);
        sink.ok_or(AbortCode::General)?.write(held)
    }
}
