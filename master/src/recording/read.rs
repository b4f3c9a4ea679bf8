//! Reading a recording back: the frames, what was planned and seen, and how it ended.
//!
//! The file is read from its beginning to its end without its index, so one that was cut off gives
//! everything up to the cut; [`Recording::damage`] then says so. What is kept is the frames (32
//! bytes each) and the poses, all in memory: an hour of sixteen robots is some 900 MB.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use canopen::Frame;
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader};

use super::content::{Recorded, Recording};
use super::{
    CAN, FrameRecord, Header, METADATA, PLAN, PoseRecord, RecordingError, TRUTH, candump, from_hex,
};

/// Instead of what is no recording.
const GIVE_RECORDING: &str =
    "give a file that `omnibus record` wrote, or a candump log named *.log";

/// Reads a recording, or the candump log that a file is when its name ends in `.log`.
///
/// # Errors
/// When the file cannot be read or is no recording. A file that was cut off is no error.
pub fn read(path: &Path) -> Result<Recording, RecordingError> {
    read_with(path, &mut |_| {})
}

/// The same; `progress` gets the fraction of the file that has been read, 0 to 1, now and then.
///
/// # Errors
/// As [`read`].
pub fn read_with(path: &Path, progress: &mut dyn FnMut(f64)) -> Result<Recording, RecordingError> {
    let refuse = |problem: &dyn std::fmt::Display| RecordingError::new(path, problem);
    let file = File::open(path)
        .map_err(|error| refuse(&format_args!("cannot be read ({error}); {GIVE_RECORDING}")))?;
    let file = BufReader::new(Counted {
        length: file.metadata().map_or(0, |metadata| metadata.len()),
        file,
        read: 0,
        progress,
    });
    if path.extension().is_some_and(|extension| extension == "log") {
        return candump::read(file).map_err(|error| refuse(&error));
    }
    let mut recording = Recording::default();
    match read_mcap(file, &mut recording) {
        Ok(()) => {}
        Err(ReadError::Mcap(McapError::BadMagic)) if recording.frames.is_empty() => {
            return Err(refuse(&format_args!(
                "is not an MCAP file; {GIVE_RECORDING}"
            )));
        }
        Err(ReadError::Mcap(error)) => {
            let seconds = recording.seconds();
            let frames = recording.frames.len();
            recording.damage = Some(format!(
                "the file is cut off ({error}); {frames} frames ({seconds:.3} s) could be read"
            ));
        }
        Err(ReadError::Io(error)) => return Err(refuse(&format_args!("cannot be read: {error}"))),
        Err(ReadError::Content(problem)) => return Err(refuse(&problem)),
    }
    if recording.frames.is_empty() && recording.header.activity.is_empty() {
        return Err(refuse(
            &"is not a recording of omnibus, or was cut off before its first frame",
        ));
    }
    // Every tool but a printer of files wants order in time.
    recording.frames.sort_by_key(|recorded| recorded.t_ns);
    Ok(recording)
}

/// A file that says how far it has been read.
struct Counted<'a> {
    file: File,
    length: u64,
    read: u64,
    progress: &'a mut dyn FnMut(f64),
}

impl Read for Counted<'_> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        let count = self.file.read(into)?;
        self.read += count as u64;
        (self.progress)(self.read as f64 / self.length.max(self.read).max(1) as f64);
        Ok(count)
    }
}

enum ReadError {
    Mcap(McapError),
    Io(std::io::Error),
    Content(String),
}

impl From<McapError> for ReadError {
    fn from(error: McapError) -> Self {
        Self::Mcap(error)
    }
}

fn read_mcap(mut file: impl Read, recording: &mut Recording) -> Result<(), ReadError> {
    let mut reader = LinearReader::new();
    let mut topics = BTreeMap::new();
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(wanted) => {
                let read = file.read(reader.insert(wanted)).map_err(ReadError::Io)?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { data, opcode } => match mcap::parse_record(opcode, data)? {
                Record::Channel(channel) => {
                    topics.insert(channel.id, channel.topic);
                }
                Record::Metadata(metadata) if metadata.name == METADATA => {
                    recording.header = header(metadata.metadata)?;
                }
                Record::Message { header, data } => {
                    if let Some(topic) = topics.get(&header.channel_id) {
                        message(recording, topic, header.log_time, &data)?;
                    }
                }
                Record::DataEnd(_) => topics.clear(),
                _ => {}
            },
        }
    }
    Ok(())
}

fn header(mut fields: BTreeMap<String, String>) -> Result<Header, ReadError> {
    let mut take = |name: &str| fields.remove(name);
    let epoch = take("epoch_ns").unwrap_or_else(|| "0".into());
    let epoch_ns = epoch.parse().map_err(|_| {
        ReadError::Content(format!(
            "metadata field epoch_ns: '{epoch}' is not a whole number of ns"
        ))
    })?;
    Ok(Header {
        bus: take("bus").unwrap_or_default(),
        activity: take("activity").unwrap_or_default(),
        group: take("group_file"),
        epoch_ns,
    })
}

fn message(
    recording: &mut Recording,
    topic: &str,
    time: u64,
    data: &[u8],
) -> Result<(), ReadError> {
    let t_ns = time.saturating_sub(recording.header.epoch_ns);
    let bad = |problem: &dyn std::fmt::Display| {
        ReadError::Content(format!("channel {topic}, message at {t_ns} ns: {problem}"))
    };
    match topic {
        CAN => {
            let record: FrameRecord = serde_json::from_slice(data).map_err(|error| bad(&error))?;
            let bytes = from_hex(&record.data);
            let frame = bytes.and_then(|bytes| Frame::new(record.id, &bytes));
            let frame = frame.ok_or_else(|| bad(&"id and data are not a CAN frame of 11 bits"))?;
            recording.frames.push(Recorded {
                t_ns,
                frame,
                sent: record.sent,
            });
        }
        PLAN | TRUTH => {
            let pose: PoseRecord = serde_json::from_slice(data).map_err(|error| bad(&error))?;
            let poses = if topic == PLAN {
                &mut recording.plan
            } else {
                &mut recording.truth
            };
            poses.push((t_ns as f64 * 1e-9, pose.into()));
        }
        _ => {}
    }
    Ok(())
}
