//! What was on the bus is in the recording, whole or cut off; a candump log goes in and out
//! unchanged.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use canopen::{Frame, Micros};
use group::GroupFile;
use kinematics::{Pose, Twist};
use omnibus::bus::link::Link as _;
use omnibus::bus::tap::{FrameSink, Tap};
use omnibus::recording::{self, Header, Recorder, RecordingError, Settings, Summary, candump};
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;

type Frames = Vec<(Micros, Frame, bool)>;
type Received = Arc<Mutex<Frames>>;

/// A folder of this test's own.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("recording")
        .join(name);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn group_text() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../groups/tcc-2.toml");
    std::fs::read_to_string(path).unwrap()
}

/// Drives two native robots for half a second in virtual time and records it; returns what was on
/// the bus by another tap's account.
fn drive(file: &Path) -> Frames {
    let (summary, received) = drive_with(file, WAITS);
    assert_eq!(summary.unwrap().frames, received.len() as u64);
    received
}

/// Time is virtual, so it may wait for the disk.
const WAITS: Settings = Settings {
    rotate_bytes: None,
    waits: true,
    on_error: None,
};

fn drive_with(file: &Path, settings: Settings) -> (Result<Summary, RecordingError>, Frames) {
    drive_group(file, settings, group_text(), 0)
}

/// The same with another group, which stands for so many cycles before.
fn drive_group(
    file: &Path,
    settings: Settings,
    text: String,
    rest: u32,
) -> (Result<Summary, RecordingError>, Frames) {
    let group_file = GroupFile::parse("tcc-2", &text).unwrap();
    let header = Header {
        bus: "sim".into(),
        activity: "drive".into(),
        group: Some(text),
        epoch_ns: 0,
    };
    let recorder = Recorder::create(file, &header, settings).unwrap();
    let received = Received::default();
    let collector: FrameSink = {
        let received = Arc::clone(&received);
        Arc::new(move |at, frame, sent| received.lock().unwrap().push((at, *frame, sent)))
    };
    let world =
        omnibus::simulation::run::world(&group_file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
    let mut group = Group::observe(
        Tap::new(SimLink::new(world, "sim"), [collector]),
        &group_file,
    );
    group.wire().tap(recorder.sink());
    group.claim().unwrap();
    group.configure(true).unwrap();
    group.start().unwrap();
    for _ in 0..rest {
        group.cycle(Twist::ZERO).unwrap();
    }
    for _ in 0..50 {
        group.cycle(Twist::new(0.2, 0.1, 0.1)).unwrap();
        let at = group.link().now();
        recorder.pose(recording::TRUTH, at, Pose::new(1.0, 2.0, 3.0));
    }
    group.ramp_down(2_000_000).unwrap();
    let summary = recorder.finish();
    let received = std::mem::take(&mut *received.lock().unwrap());
    (summary, received)
}

#[test]
fn every_frame_is_there_with_its_time() {
    let file = folder("whole").join("drive.mcap");
    let mut sent = drive(&file);
    sent.sort_by_key(|(at, ..)| at.0);
    let mut shares = vec![0.0];
    let recording = recording::read_with(&file, &mut |share| shares.push(share)).unwrap();
    assert!(
        shares.is_sorted() && shares.last() == Some(&1.0),
        "{shares:?}"
    );
    assert_eq!(recording.damage, None);
    let read: Vec<_> = recording
        .frames
        .iter()
        .map(|recorded| (Micros(recorded.t_ns / 1_000), recorded.frame, recorded.sent))
        .collect();
    assert!(read.len() > 1_000, "{} frames", read.len());
    assert_eq!(read, sent);
    assert_eq!(recording.truth.len(), 50);
    assert_eq!(recording.truth[7].1, Pose::new(1.0, 2.0, 3.0));
    assert_eq!(recording.group().unwrap().unwrap().name, "tcc-2");
    // The group moved as it was told: half a second at 0.2 m/s, less the way up to speed.
    let (snapshots, events) = recording.decode();
    let fastest = snapshots.iter().filter_map(|s| s.measured).map(|m| m.vx);
    let fastest = fastest.fold(0.0, f32::max);
    assert!((fastest - 0.2).abs() < 0.01, "{fastest}");
    assert!(!events.is_empty());
}

/// Where the boards have a gyro, each robot's message has its yaw rate, which is that of the group:
/// half a second towards 0.1 rad/s, within five deviations of the gyro's noise (1.8 counts of 1.07
/// mrad/s). Before the bias is known there is none.
#[test]
fn the_yaw_rate_of_a_gyro_is_recorded() {
    let file = folder("gyro").join("drive.mcap");
    let boards = "[robot]\nboard = \"robomaster-c\"";
    let text = group_text().replacen("[robot]", boards, 1);
    drive_group(&file, WAITS, text, 300).0.unwrap();
    let (snapshots, _) = recording::read(&file).unwrap().decode();
    let all = snapshots.iter().flat_map(|snapshot| &snapshot.members);
    let rates = all.clone().filter_map(|member| member.yaw_rate);
    let fastest = rates.fold(0.0, f32::max);
    assert!((fastest - 0.1).abs() < 0.01, "{fastest}");
    let written = |member| recording::messages::of_robot(member)["yaw_rate"].as_f64();
    for member in all {
        assert_eq!(written(member).map(|rate| rate as f32), member.yaw_rate);
    }
    assert_eq!(snapshots[1].members[0].yaw_rate, None);
    // The gyro's own rate, not that of the wheels.
    let last = snapshots[snapshots.len() - 20].members[0];
    assert_ne!(last.yaw_rate, last.measured.map(|twist| twist.omega));
}

#[test]
fn the_same_drive_is_the_same_file() {
    let folder = folder("same");
    let (a, b) = (folder.join("a.mcap"), folder.join("b.mcap"));
    drive(&a);
    drive(&b);
    assert!(std::fs::read(a).unwrap() == std::fs::read(b).unwrap());
}

/// Cut anywhere, a recording gives the first of its frames, and says that it was cut.
#[test]
fn a_cut_recording_is_read_up_to_the_cut() {
    let folder = folder("cut");
    let whole_file = folder.join("whole.mcap");
    drive(&whole_file);
    let whole = recording::read(&whole_file).unwrap();
    let bytes = std::fs::read(&whole_file).unwrap();
    let cut_file = folder.join("cut.mcap");
    let mut most = 0;
    for tenth in 1..10 {
        std::fs::write(&cut_file, &bytes[..bytes.len() * tenth / 10]).unwrap();
        let cut = recording::read(&cut_file).unwrap();
        assert!(cut.damage.is_some(), "{tenth}");
        let mut remaining = cut.frames.clone();
        remaining.truncate(whole.frames.len());
        // Order in time may differ at the very end only: compare as sets.
        assert!(remaining.iter().all(|frame| whole.frames.contains(frame)));
        assert!(cut.frames.len() >= most, "{tenth}");
        most = cut.frames.len();
    }
    assert!(
        most > whole.frames.len() / 2,
        "{most} of {}",
        whole.frames.len()
    );
}

#[test]
fn what_is_no_recording_is_refused() {
    let folder = folder("bad");
    for (name, content) in [
        ("text.mcap", &b"hello, this is no recording at all"[..]),
        ("empty.mcap", b""),
    ] {
        let file = folder.join(name);
        std::fs::write(&file, content).unwrap();
        let error = recording::read(&file)
            .map(|r| r.frames.len())
            .unwrap_err()
            .to_string();
        assert!(error.contains(name), "{error}");
    }
    let error = recording::read(&folder.join("none.mcap"))
        .unwrap_err()
        .to_string();
    assert!(error.contains("cannot be read"), "{error}");
    let error = Recorder::create(&folder.join("none/x.mcap"), &Header::default(), WAITS);
    assert!(
        error
            .err()
            .unwrap()
            .to_string()
            .contains("cannot be written")
    );
}

#[test]
fn a_log_becomes_a_recording_and_back() {
    let folder = folder("log");
    let log = "(1700000000.000100) can0 080#01\n(1700000000.000350) can0 182#0201FFFF00000000\n\
               (1700000003.000000) can0 702#05\n";
    let from_log = candump::read(log.as_bytes()).unwrap();
    let file = folder.join("log.mcap");
    let recorder = Recorder::create(&file, &from_log.header, WAITS).unwrap();
    let sink = recorder.sink();
    for recorded in &from_log.frames {
        sink(
            Micros(recorded.t_ns / 1_000),
            &recorded.frame,
            recorded.sent,
        );
    }
    recorder.finish().unwrap();
    let mut out = Vec::new();
    candump::write(&recording::read(&file).unwrap(), &mut out).unwrap();
    assert_eq!(String::from_utf8(out).unwrap(), log);
}

/// All files of one recording together hold every frame once, in order, and each says which it is.
#[test]
fn a_large_recording_goes_on_in_another_file() {
    let folder = folder("rotated");
    for old in std::fs::read_dir(&folder).unwrap() {
        std::fs::remove_file(old.unwrap().path()).unwrap();
    }
    let settings = Settings {
        rotate_bytes: Some(1),
        ..WAITS
    };
    let (summary, mut sent) = drive_with(&folder.join("drive.mcap"), settings);
    sent.sort_by_key(|(at, ..)| at.0);
    let files = summary.unwrap().files;
    assert!(files > 1, "{files}");
    let mut read = Vec::new();
    for number in 1..=files {
        let name = match number {
            1 => "drive.mcap".to_owned(),
            _ => format!("drive-{number:03}.mcap"),
        };
        let recording = recording::read(&folder.join(name)).unwrap();
        assert_eq!(recording.damage, None, "file {number}");
        assert_eq!(recording.group().unwrap().unwrap().name, "tcc-2");
        let frames = recording.frames.iter();
        read.extend(frames.map(|f| (Micros(f.t_ns / 1_000), f.frame, f.sent)));
    }
    read.sort_by_key(|(at, ..)| at.0);
    assert_eq!(read, sent);
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), files as usize);
}

/// /dev/full takes nothing, as a full disk. The drive goes on; the reason is told at once and
/// returned at the end, in the system's words.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_is_named_at_once_and_the_drive_goes_on() {
    let reports = Arc::new(Mutex::new(Vec::new()));
    let settings = Settings {
        on_error: Some({
            let reports = Arc::clone(&reports);
            Box::new(move |error| reports.lock().unwrap().push(error.to_string()))
        }),
        ..WAITS
    };
    let full = Path::new("/dev/full");
    let refused = Recorder::create(full, &Header::default(), settings);
    let refused = refused.err().unwrap().to_string();
    assert!(refused.contains("No space left on device"), "{refused}");

    // A disk that becomes full on the way: a pipe whose reader has gone refuses as well.
    let fifo = folder("pipe").join("pipe.mcap");
    let _ = std::fs::remove_file(&fifo);
    let made = std::process::Command::new("mkfifo").arg(&fifo).status();
    assert!(made.unwrap().success());
    let reader = {
        let fifo = fifo.clone();
        std::thread::spawn(move || {
            use std::io::Read as _;
            let mut first = [0; 8];
            std::fs::File::open(fifo)
                .unwrap()
                .read_exact(&mut first)
                .unwrap();
        })
    };
    let settings = Settings {
        on_error: Some({
            let reports = Arc::clone(&reports);
            Box::new(move |error| reports.lock().unwrap().push(error.to_string()))
        }),
        ..WAITS
    };
    let (summary, received) = drive_with(&fifo, settings);
    reader.join().unwrap();
    let error = summary.unwrap_err().to_string();
    assert!(error.contains("Broken pipe"), "{error}");
    assert_eq!(*reports.lock().unwrap(), [error]);
    assert!(received.len() > 1_000, "{} frames", received.len());
}

/// The second of two recordings of one name is refused, and the first one stays whole. What a
/// killed recorder wrote gets another name.
#[test]
fn two_recordings_of_one_name_do_not_destroy_each_other() {
    let folder = folder("twice");
    for old in std::fs::read_dir(&folder).unwrap() {
        std::fs::remove_file(old.unwrap().path()).unwrap();
    }
    let (file, part) = (folder.join("run.mcap"), folder.join("run.mcap.part"));
    std::fs::write(&part, "of a killed recorder").unwrap();
    let header = Header::default();
    let first = Recorder::create(&file, &header, WAITS).unwrap();
    let sink = first.sink();
    sink(Micros(7), &Frame::new(0x80, &[1]).unwrap(), true);
    let refused = Recorder::create(&file, &header, WAITS).err().unwrap();
    let refused = refused.to_string();
    let expected = "run.mcap.part is being written by another omnibus; give another name";
    assert!(refused.contains(expected), "{refused}");
    drop(sink);
    first.finish().unwrap();
    assert_eq!(recording::read(&file).unwrap().frames.len(), 1);
    let aside = std::fs::read_to_string(folder.join("run.mcap.part.1"));
    assert_eq!(aside.unwrap(), "of a killed recorder");
    assert!(!part.exists());
}

/// A file that grows is not there under its name until it is complete; the old one is.
#[test]
fn a_file_is_replaced_whole_or_not_at_all() {
    use std::io::Write as _;
    let path = folder("beside").join("file");
    omnibus::file::replace(&path, "old").unwrap();
    let mut beside = omnibus::file::Beside::create(&path).unwrap();
    beside.write_all(b"new").unwrap();
    beside.flush().unwrap();
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
    drop(beside);
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
    assert_eq!(
        std::fs::read_dir(path.parent().unwrap()).unwrap().count(),
        1
    );
    omnibus::file::replace(&path, "new").unwrap();
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "new");
}

/// Nothing is drawn of no frames; of frames without SYNC it is said what their charts lack.
#[test]
fn a_recording_without_motion_says_so() {
    let folder = folder("without-motion");
    let draw = |command: &str, file: &str| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_omnibus"))
            .args([command, file])
            .current_dir(&folder)
            .output()
            .unwrap();
        let notes = String::from_utf8(output.stderr).unwrap();
        (output.status.code(), notes)
    };
    let pictures = ["none.svg", "none.png", "none.html"].map(|name| folder.join(name));
    for picture in &pictures {
        let _ = std::fs::remove_file(picture);
    }
    std::fs::write(folder.join("none.log"), "").unwrap();
    let idle = "(1.000000) can0 702#05\n";
    std::fs::write(folder.join("idle.log"), idle).unwrap();
    for command in ["plot", "report"] {
        let (code, notes) = draw(command, "none.log");
        assert_eq!(code, Some(1), "{notes}");
        let names_it = notes.starts_with("error: none.log: has no frames");
        assert!(names_it, "{notes}");
        let (code, notes) = draw(command, "idle.log");
        assert_eq!(code, Some(0), "{notes}");
        assert!(
            notes.contains("idle.log: no master has sent SYNC"),
            "{notes}"
        );
    }
    assert!(!pictures.iter().any(|picture| picture.exists()));
}
