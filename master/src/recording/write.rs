//! Writing a recording: a thread that turns frames into messages, compresses a chunk every second
//! and begins a new file when one is large enough.
//!
//! The queue to the thread has room for [`QUEUE`] items. On a bus with virtual time the sender
//! waits when it is full, and so does time. On a real one frames cannot wait: those that come then
//! are left out and counted. Memory does not grow with the length of a recording but for the index,
//! some 300 B a second, which starts again with a new file.
//!
//! An error ends the recording, never the drive: [`OnError`] is called at once, later frames are
//! dropped, and [`Recorder::finish`] returns the error.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use canopen::{Frame, Micros};
use group::GroupFile;
use kinematics::Pose;
use mcap::McapError;

use super::messages::{Message, Messages};
use super::part::{Part, in_words};
use super::{Header, PLAN, RecordingError, TRUTH};
use crate::bus::tap::FrameSink;
use crate::run::Record;

/// Chunks are closed after this much of the bus's time, in ns.
const CHUNK_NS: u64 = 1_000_000_000;
/// Items that may wait for the disk: ten seconds of a full bus of 1 Mbit/s, some 3 MB.
const QUEUE: usize = 65_536;

/// Hears at once when a recording cannot go on. Called from the recording's thread.
pub type OnError = Box<dyn Fn(&RecordingError) + Send>;

/// How a recording is written.
#[derive(Default)]
pub struct Settings {
    /// A new file is begun when one has as many bytes.
    pub rotate_bytes: Option<u64>,
    /// Whether frames wait when the disk is slow: where time is virtual.
    pub waits: bool,
    /// Who hears of errors at once.
    pub on_error: Option<OnError>,
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Summary {
    /// Frames on the bus.
    pub frames: u64,
    /// Messages on all channels, the frames among them.
    pub messages: u64,
    /// From the first to the last frame, in s.
    pub seconds: f64,
    /// Files.
    pub files: u32,
}

enum Item {
    Frame(Micros, Frame, bool),
    Pose(&'static str, Micros, Pose),
    /// The end, though sinks may still be about.
    End,
}

/// A recording in the making. Dropping it finishes the file as well, without a word about errors.
pub struct Recorder {
    queue: Option<Queue>,
    thread: Option<JoinHandle<Result<Summary, RecordingError>>>,
}

impl Recorder {
    /// Begins a recording. An existing file is replaced when the new one is complete.
    ///
    /// # Errors
    /// When the file cannot be written or the group file is not one.
    pub fn create(
        path: &Path,
        header: &Header,
        settings: Settings,
    ) -> Result<Self, RecordingError> {
        let refuse = |problem: &dyn std::fmt::Display| RecordingError::new(path, problem);
        let group = header
            .group
            .as_ref()
            .map(|text| GroupFile::parse("group file", text));
        let group = group.transpose().map_err(|error| refuse(&error))?;
        let (sender, items) = sync_channel(QUEUE);
        let queue = Queue {
            sender,
            waits: settings.waits,
            lost: Arc::default(),
        };
        let writer = Writer {
            part: Some(Part::begin(path, header, 1)?),
            path: path.into(),
            header: header.clone(),
            rotate_bytes: settings.rotate_bytes.unwrap_or(u64::MAX),
            messages: Messages::new(header.epoch_ns, group),
            chunk_ends_ns: CHUNK_NS,
            summary: Summary {
                files: 1,
                ..Summary::default()
            },
            span_us: None,
        };
        let (lost, on_error, path) = (
            Arc::clone(&queue.lost),
            settings.on_error,
            PathBuf::from(path),
        );
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || {
                let report = |error: &RecordingError| {
                    if let Some(on_error) = &on_error {
                        on_error(error);
                    }
                };
                writer.run(&items, &lost, &report)
            })
            .map_err(|error| RecordingError::new(&path, error))?;
        Ok(Self {
            queue: Some(queue),
            thread: Some(thread),
        })
    }

    /// Where frames go. Once the recording is finished it takes them and drops them.
    #[must_use]
    pub fn sink(&self) -> FrameSink {
        let queue = self.queue.clone();
        Arc::new(move |at, frame, sent| {
            if let Some(queue) = &queue {
                queue.put(Item::Frame(at, *frame, sent));
            }
        })
    }

    /// Where the group is to be ([`super::PLAN`]) or was seen ([`super::TRUTH`]) at `at` on the
    /// link's clock.
    pub fn pose(&self, channel: &'static str, at: Micros, pose: Pose) {
        if let Some(queue) = &self.queue {
            queue.put(Item::Pose(channel, at, pose));
        }
    }

    /// Whether it has ended by itself, because of an error.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// The first error since it began; what was written until then is readable.
    pub fn finish(mut self) -> Result<Summary, RecordingError> {
        self.join().unwrap_or_else(|| Ok(Summary::default()))
    }

    fn join(&mut self) -> Option<Result<Summary, RecordingError>> {
        let _ = self.queue.take()?.sender.send(Item::End);
        match self.thread.take()?.join() {
            Ok(ended) => Some(ended),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
}

impl Record for Recorder {
    fn sink(&self) -> FrameSink {
        Self::sink(self)
    }

    fn plan(&self, at: Micros, pose: Pose) {
        self.pose(PLAN, at, pose);
    }

    fn truth(&self, at: Micros, pose: Pose) {
        self.pose(TRUTH, at, pose);
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            let _ = self.join();
        }
    }
}

/// The way to the recording's thread.
#[derive(Clone)]
struct Queue {
    sender: SyncSender<Item>,
    waits: bool,
    /// Items for which there was no room.
    lost: Arc<AtomicU64>,
}

impl Queue {
    /// A thread that has ended has said why; what comes afterwards is dropped.
    fn put(&self, item: Item) {
        if self.waits {
            let _ = self.sender.send(item);
        } else if let Err(TrySendError::Full(_)) = self.sender.try_send(item) {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

struct Writer {
    /// `None` only while one file follows another.
    part: Option<Part>,
    path: PathBuf,
    header: Header,
    rotate_bytes: u64,
    messages: Messages,
    chunk_ends_ns: u64,
    summary: Summary,
    span_us: Option<(u64, u64)>,
}

impl Writer {
    fn run(
        mut self,
        items: &Receiver<Item>,
        lost: &AtomicU64,
        report: &dyn Fn(&RecordingError),
    ) -> Result<Summary, RecordingError> {
        let mut warned = false;
        for item in items {
            let done = match item {
                Item::Frame(at, frame, sent) => self.frame(at, &frame, sent),
                Item::Pose(channel, at, pose) => {
                    let message = self.messages.pose(channel, at, pose);
                    write(&mut self.part, &mut self.summary, &message)
                }
                Item::End => break,
            };
            if let Err(error) = done {
                let error = self.failed(&error);
                report(&error);
                return Err(error);
            }
            if !warned && lost.load(Ordering::Relaxed) > 0 {
                warned = true;
                report(&self.too_slow(lost));
            }
        }
        if let Some(part) = self.part.take()
            && let Err(error) = part.finish()
        {
            return Err(incomplete(&self.path, &error));
        }
        if lost.load(Ordering::Relaxed) > 0 {
            return Err(self.too_slow(lost));
        }
        let (first, last) = self.span_us.unwrap_or_default();
        self.summary.seconds = (last - first) as f64 * 1e-6;
        Ok(self.summary)
    }

    fn frame(&mut self, at: Micros, frame: &Frame, sent: bool) -> Result<(), McapError> {
        let at_ns = at.0 * 1_000;
        if at_ns >= self.chunk_ends_ns {
            self.end_chunk()?;
            self.chunk_ends_ns = at_ns - at_ns % CHUNK_NS + CHUNK_NS;
        }
        let (first, last) = self.span_us.unwrap_or((at.0, at.0));
        self.span_us = Some((first.min(at.0), last.max(at.0)));
        self.summary.frames += 1;
        let (part, summary) = (&mut self.part, &mut self.summary);
        self.messages.frame(at, frame, sent, &mut |message| {
            write(part, summary, message)
        })
    }

    /// Puts the chunk into the file, and begins the next file when this one is large enough.
    fn end_chunk(&mut self) -> Result<(), McapError> {
        let Some(part) = &mut self.part else {
            return Ok(());
        };
        if part.flush()? < self.rotate_bytes {
            return Ok(());
        }
        if let Some(part) = self.part.take() {
            part.finish()?;
        }
        self.summary.files += 1;
        let path = part_path(&self.path, self.summary.files);
        let part = Part::begin(&path, &self.header, self.summary.files);
        self.part = Some(part.map_err(|error| std::io::Error::other(error.problem))?);
        Ok(())
    }

    /// Keeps what could be written.
    fn failed(&mut self, error: &McapError) -> RecordingError {
        if let Some(part) = self.part.take() {
            part.keep();
        }
        incomplete(&part_path(&self.path, self.summary.files), error)
    }

    fn too_slow(&self, lost: &AtomicU64) -> RecordingError {
        let lost = lost.load(Ordering::Relaxed);
        RecordingError::new(
            &self.path,
            format_args!("is incomplete: the disk was too slow for {lost} frames"),
        )
    }
}

fn write(
    part: &mut Option<Part>,
    summary: &mut Summary,
    message: &Message,
) -> Result<(), McapError> {
    summary.messages += 1;
    part.as_mut().map_or(Ok(()), |part| part.write(message))
}

/// The name of a recording's file: `run.mcap`, `run-002.mcap`, ...
fn part_path(path: &Path, number: u32) -> PathBuf {
    if number < 2 {
        return path.into();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{number:03}.{extension}"))
}

fn incomplete(path: &Path, error: &McapError) -> RecordingError {
    RecordingError::new(path, format_args!("is incomplete: {}", in_words(error)))
}
