//! One file of a recording.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Compression, McapError, McapResult, WriteOptions};

use super::messages::Message;
use super::{Header, METADATA, RecordingError};
use crate::file::Beside;

/// An error in the system's own words: what MCAP says of one does not have them.
pub fn in_words(error: &McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

/// A channel and how many messages it has.
struct Channel {
    id: u16,
    count: u32,
}

/// A file that counts its bytes.
struct Counted {
    file: Beside,
    bytes: Arc<AtomicU64>,
}

impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// A file in the making.
pub struct Part {
    out: mcap::Writer<NoSeek<Counted>>,
    bytes: Arc<AtomicU64>,
    channels: BTreeMap<String, Channel>,
    schemas: BTreeMap<&'static str, u16>,
}

impl Part {
    /// Begins the file with what is known about the recording; `number` counts its files from 1.
    pub fn begin(path: &Path, header: &Header, number: u32) -> Result<Self, RecordingError> {
        let file = Beside::create(path).map_err(|error| {
            RecordingError::new(path, format_args!("cannot be written: {error}"))
        })?;
        Self::open(file, header, number).map_err(|error| {
            RecordingError::new(
                path,
                format_args!("cannot be written: {}", in_words(&error)),
            )
        })
    }

    fn open(file: Beside, header: &Header, number: u32) -> McapResult<Self> {
        let bytes = Arc::new(AtomicU64::new(0));
        let counted = Counted {
            file,
            bytes: Arc::clone(&bytes),
        };
        let options = WriteOptions::new()
            .compression(Some(Compression::Lz4))
            .chunk_size(None)
            // A chunk is put together in memory, so that a file cut off ends in whole chunks.
            .disable_seeking(true)
            .profile("omnibus")
            .library(concat!("omnibus ", env!("CARGO_PKG_VERSION")));
        let mut out = options.create(NoSeek::new(counted))?;
        let mut metadata = BTreeMap::from([
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("bus".into(), header.bus.clone()),
            ("activity".into(), header.activity.clone()),
            ("epoch_ns".into(), header.epoch_ns.to_string()),
            ("file".into(), number.to_string()),
        ]);
        metadata.extend(header.group.clone().map(|text| ("group_file".into(), text)));
        out.write_metadata(&mcap::records::Metadata {
            name: METADATA.into(),
            metadata,
        })?;
        out.flush()?;
        Ok(Self {
            out,
            bytes,
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
        })
    }

    /// Adds a message.
    pub fn write(&mut self, message: &Message) -> McapResult<()> {
        if !self.channels.contains_key(message.topic) {
            let id = self.add_channel(message)?;
            self.channels
                .insert(message.topic.into(), Channel { id, count: 0 });
        }
        let Some(channel) = self.channels.get_mut(message.topic) else {
            return Ok(());
        };
        channel.count = channel.count.wrapping_add(1);
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.count,
            log_time: message.time_ns,
            publish_time: message.time_ns,
        };
        let text = message.value.to_string();
        self.out.write_to_known_channel(&header, text.as_bytes())
    }

    fn add_channel(&mut self, message: &Message) -> McapResult<u16> {
        let name = message.schema.name;
        let id = match self.schemas.get(name) {
            Some(id) => *id,
            None => {
                let text = (message.schema.text)().to_string();
                let id = self.out.add_schema(name, "jsonschema", text.as_bytes())?;
                self.schemas.insert(name, id);
                id
            }
        };
        self.out
            .add_channel(id, message.topic, "json", &BTreeMap::new())
    }

    /// Ends the chunk; how many bytes the file has.
    pub fn flush(&mut self) -> McapResult<u64> {
        self.out.flush()?;
        Ok(self.bytes.load(Ordering::Relaxed))
    }

    /// Completes the file and gives it its name.
    pub fn finish(mut self) -> McapResult<()> {
        let finished = self.out.finish();
        let file = self.out.into_inner().into_inner().file;
        match finished {
            Ok(_) => Ok(file.commit()?),
            Err(error) => {
                file.keep()?;
                Err(error)
            }
        }
    }

    /// Gives the file its name as it is: nothing more can be written.
    pub fn keep(self) {
        // The reason why it ends here is already known; this would only be another.
        let _ = self.out.into_inner().into_inner().file.keep();
    }
}
