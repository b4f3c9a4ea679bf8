//! What commands that record share: `--record`, `--rotate-mb`, and what is said when the disk is
//! full.

use std::path::{Path, PathBuf};

use canopen::Micros;
use omnibus::recording::{Recorder, RecordingError, Settings};

use super::{Target, print_note};

/// Where a drive is recorded.
#[derive(clap::Args)]
pub struct RecordTo {
    /// Records all frames on the bus during the drive; an existing file is replaced.
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    #[command(flatten)]
    rotate: Rotate,
}

impl RecordTo {
    /// Refuses a recording that would replace the group file in use.
    pub fn check(&self, target: &Target) -> anyhow::Result<()> {
        match &self.record {
            Some(path) => target.check_output("--record", path),
            None => Ok(()),
        }
    }

    /// Begins the recording, if one is wanted. The link has `now` on its clock.
    pub fn begin(
        &self,
        target: &Target,
        activity: &str,
        now: Micros,
    ) -> anyhow::Result<Option<Recorder>> {
        let Some(path) = &self.record else {
            if self.rotate.megabytes.is_some() {
                usage!("--rotate-mb applies to recordings; add --record FILE.mcap");
            }
            return Ok(None);
        };
        Ok(Some(self.rotate.begin(path, target, activity, now)?))
    }
}

/// How large a file of a recording may become.
#[derive(clap::Args)]
pub struct Rotate {
    /// Begins a new file (FILE-002.mcap, FILE-003.mcap, ...) after this number of megabytes.
    #[arg(long = "rotate-mb", value_name = "MB", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    megabytes: Option<u64>,
}

impl Rotate {
    /// Begins a recording.
    pub fn begin(
        &self,
        path: &Path,
        target: &Target,
        activity: &str,
        now: Micros,
    ) -> anyhow::Result<Recorder> {
        let settings = Settings {
            rotate_bytes: self.megabytes.map(|megabytes| megabytes * 1_000_000),
            waits: target.bus.waits(),
            on_error: Some(Box::new(warn)),
        };
        Ok(Recorder::create(
            path,
            &target.header(activity, now)?,
            settings,
        )?)
    }
}

fn warn(error: &RecordingError) {
    print_note(format_args!(
        "warning: {error}; the robots are not affected"
    ));
}

/// Ends a recording, if there is one.
pub fn finish(recorder: Option<Recorder>) -> anyhow::Result<()> {
    if let Some(recorder) = recorder {
        recorder.finish()?;
    }
    Ok(())
}
