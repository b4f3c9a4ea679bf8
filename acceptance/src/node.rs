//! The board's objects, over a bench.

use anyhow::{Context as _, bail};
use canopen::client::{self, Outcome, SdoClient, SdoError};
use canopen::{AbortCode, Micros, NmtState, NodeId};

use crate::bench::Bench;

/// How long the board may take for an answer: a save with two erases, 500 ms each at most.
const ANSWER: Micros = Micros(3_000_000);

/// A board on its bus.
pub struct Node<'a> {
    /// Where it is.
    pub bench: &'a mut dyn Bench,
    id: NodeId,
}

impl<'a> Node<'a> {
    /// The board with this node-ID.
    pub fn new(bench: &'a mut dyn Bench, id: NodeId) -> Self {
        Self { bench, id }
    }

    /// Its node-ID.
    #[must_use]
    pub fn id(&self) -> NodeId {
        self.id
    }

    /// Waits for the board's boot-up message; returns when it ended, us, or nothing when it did not
    /// come in time.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn boot_up(&mut self, within_us: u64) -> anyhow::Result<Option<u64>> {
        let until = self.bench.now_us() + within_us;
        while let Some((at, frame)) = self.bench.receive(until)? {
            if client::parse_heartbeat(&frame) == Some((self.id, NmtState::Initialising)) {
                return Ok(Some(at));
            }
        }
        Ok(None)
    }

    /// Lets time pass.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn wait(&mut self, us: u64) -> anyhow::Result<()> {
        let until = self.bench.now_us() + us;
        while self.bench.receive(until)?.is_some() {}
        Ok(())
    }

    /// Writes an object; returns when its answer ended, us.
    ///
    /// # Errors
    /// When the board refuses or does not answer.
    pub fn write(&mut self, index: u16, sub: u8, data: &[u8]) -> anyhow::Result<u64> {
        Ok(self.transfer(index, sub, Some(data))?.1)
    }

    /// Reads an object of up to four bytes.
    ///
    /// # Errors
    /// When the board refuses or does not answer.
    pub fn read(&mut self, index: u16, sub: u8) -> anyhow::Result<u32> {
        Ok(self.read_at(index, sub)?.0)
    }

    /// Reads an object, with the time at which its answer ended, us.
    ///
    /// # Errors
    /// When the board refuses or does not answer.
    pub fn read_at(&mut self, index: u16, sub: u8) -> anyhow::Result<(u32, u64)> {
        let (data, at) = self.transfer(index, sub, None)?;
        let mut bytes = [0; 4];
        let to = bytes.get_mut(..data.len());
        to.with_context(|| format!("0x{index:04X}:{sub} has {} bytes", data.len()))?
            .copy_from_slice(&data);
        Ok((u32::from_le_bytes(bytes), at))
    }

    /// Reads an object that is text.
    ///
    /// # Errors
    /// When the board refuses or does not answer.
    pub fn text(&mut self, index: u16, sub: u8) -> anyhow::Result<String> {
        let (data, _) = self.transfer(index, sub, None)?;
        Ok(String::from_utf8_lossy(&data).into_owned())
    }

    fn transfer(
        &mut self,
        index: u16,
        sub: u8,
        data: Option<&[u8]>,
    ) -> anyhow::Result<(Vec<u8>, u64)> {
        let mut client = SdoClient::new(self.id, ANSWER);
        let now = Micros(self.bench.now_us());
        let started = match data {
            Some(data) => client.download(now, index, sub, data),
            None => client.upload(now, index, sub),
        };
        if started.is_err() {
            bail!("0x{index:04X}:{sub}: the value is too long");
        }
        let (outcome, at) = loop {
            while let Some(frame) = client.pop_frame() {
                self.bench.send(&frame)?;
            }
            let until = client.next_deadline().map_or(0, |at| at.0);
            let (at, outcome) = match self.bench.receive(until)? {
                Some((at, frame)) => (at, client.on_frame(Micros(at), &frame)),
                None => (until, client.poll(Micros(self.bench.now_us()))),
            };
            if let Some(outcome) = outcome {
                break (outcome, at);
            }
        };
        match outcome {
            Outcome::Failed(error) => bail!("0x{index:04X}:{sub} {}", reason(error)),
            Outcome::Uploaded | Outcome::Downloaded => Ok((client.data().to_vec(), at)),
        }
    }
}

fn reason(error: SdoError) -> String {
    match error {
        SdoError::Aborted(code) => match AbortCode::from_code(code) {
            Some(code) => format!("is refused by the board: {code:?}"),
            None => format!("is refused by the board: 0x{code:08X}"),
        },
        SdoError::Timeout => "is not answered: is the board on, and its node-ID right?".to_owned(),
        SdoError::Protocol(code) => format!("is not answered as it should be: {code:?}"),
    }
}
