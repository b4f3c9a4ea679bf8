//! Commissioning that is stopped at any moment leaves the robots at rest, all configured or none,
//! and members of their group. What was driven is not lost to a file that cannot be written.

mod common;

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use canopen::{Frame, Micros};
use common::{Served, copied_group, omnibus, root, serve, serve_in};
use group::GroupFile;
use kinematics::Pose;
use omnibus::bus::link::{Link, LinkError};
use omnibus::commission::motors::{Settings, identify_motors};
use omnibus::commission::wheel_test::test_wheels;
use omnibus::error::MasterError;
use omnibus::session::Group;
use omnibus::simulation::{link::SimLink, run::world};
use protocol::{Fault, Kind, MemberState, address, cob};

fn file() -> GroupFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-2.toml");
    GroupFile::load(path).unwrap()
}

fn simulated(file: &GroupFile) -> SimLink {
    let world = world(file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
    SimLink::new(world, "sim")
}

/// A configured group on a simulated bus.
fn session() -> Group<SimLink> {
    let file = file();
    let mut session = Group::connect(simulated(&file), &file).unwrap();
    session.configure(true).unwrap();
    session
}

/// Stops after so many seconds.
fn stop_at(limit: f64) -> impl FnMut(f64) -> Result<(), MasterError> {
    move |t| {
        if t < limit {
            Ok(())
        } else {
            Err(MasterError::Aborted)
        }
    }
}

fn assert_at_rest(session: &mut Group<SimLink>, members: u32) {
    let wire = session.wire();
    let mut read = |at, kind| wire.read(2, at, kind).unwrap().to_bits();
    assert_eq!(read(address::MEMBERS, Kind::U32), members);
    assert_eq!(read(address::COMMISSIONING, Kind::U8), 0);
    // Not armed, not moving, no fault: as it was after it had been configured.
    let state = u8::try_from(read(address::STATE, Kind::U8)).unwrap();
    assert_eq!(MemberState::try_from(state), Ok(MemberState::Ready));
    let code = u16::try_from(read(address::STATUS_CODE, Kind::U16)).unwrap();
    assert_eq!(Fault::from_code(code), None, "code {code:#06x}");
}

#[test]
fn an_identification() {
    let mut session = session();
    let period = session.period_us();
    let wire = session.wire();
    let stopped = identify_motors(wire, 2, period, &Settings::default(), &mut stop_at(1.0));
    assert_eq!(stopped, Err(MasterError::Aborted));
    assert_at_rest(&mut session, 0b1100);
}

#[test]
fn a_wheel_test() {
    let mut session = session();
    let period = session.period_us();
    let mut look = |_, _: &_| Ok(None);
    let stopped = test_wheels(session.wire(), 2, period, &mut look, &mut stop_at(0.3));
    assert_eq!(stopped.unwrap_err(), MasterError::Aborted);
    assert_at_rest(&mut session, 0b1100);
}

/// A bus that loses every SYNC sent between 1.0 and 1.1 s after the first one.
struct Loses<L> {
    link: L,
    began: Option<Micros>,
}

impl<L: Link> Link for Loses<L> {
    fn now(&self) -> Micros {
        self.link.now()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        if frame.id() == cob::SYNC {
            let now = self.now();
            let since = now.since(*self.began.get_or_insert(now)).0;
            if (1_000_000..1_100_000).contains(&since) {
                return Ok(());
            }
        }
        self.link.send(frame)
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        self.link.receive(until)
    }
}

#[test]
fn a_fault_in_an_identification_is_named() {
    let file = file();
    let began = None;
    let link = Loses {
        link: simulated(&file),
        began,
    };
    let mut session = Group::connect(link, &file).unwrap();
    session.configure(true).unwrap();
    let period = session.period_us();
    let settings = Settings::default();
    let ended = identify_motors(session.wire(), 2, period, &settings, &mut |_| Ok(()));
    let text = ended.unwrap_err().to_string();
    assert!(text.contains("fault SyncLost"), "{text}");
    assert!(!text.contains("stopped by the master"), "{text}");
}

/// How a command ended, how many lines it sent to the bus, and what it printed.
struct Ended {
    code: Option<i32>,
    sent: usize,
    shown: String,
}

/// How long the line after Ctrl-C is held back. The command waits for its answer meanwhile, so it
/// does nothing but take notice of the signal.
const NOTICE: Duration = Duration::from_millis(100);

/// Runs a command on a bus. It gets a Ctrl-C when it sends line number `stop`.
fn run(arguments: &[&str], bus: &str, stop: usize) -> Ended {
    relayed(arguments, bus, stop, |id| {
        let killed = Command::new("kill").args(["-INT", id]).status().unwrap();
        assert!(killed.success());
        std::thread::sleep(NOTICE);
        true
    })
}

/// Runs a command on a bus. When it sends line number `stop`, `stopped` gets its process, and
/// returns whether the bus is still there.
fn relayed(arguments: &[&str], bus: &str, stop: usize, stopped: fn(&str) -> bool) -> Ended {
    let proxy = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("lockstep://{}", proxy.local_addr().unwrap());
    let child = Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .args(arguments)
        .args(["--bus", &address, "--group", "groups/tcc-2.toml"])
        .current_dir(root())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let id = child.id().to_string();
    let (from, _) = proxy.accept().unwrap();
    let mut to = TcpStream::connect(bus).unwrap();
    from.set_nodelay(true).unwrap();
    to.set_nodelay(true).unwrap();
    let (mut answers, mut back) = (to.try_clone().unwrap(), from.try_clone().unwrap());
    std::thread::spawn(move || std::io::copy(&mut answers, &mut back));
    let mut sent = 0;
    for line in BufReader::new(from).lines().map_while(Result::ok) {
        if sent == stop && !stopped(&id) {
            break;
        }
        sent += 1;
        if writeln!(to, "{line}").is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
    let output = child.wait_with_output().unwrap();
    Ended {
        code: output.status.code(),
        sent,
        shown: String::from_utf8(output.stdout).unwrap(),
    }
}

/// What `omnibus status` says of each robot: its NMT state and its state as a member.
fn states(bus: &str) -> Vec<(String, String)> {
    let bus = format!("lockstep://{bus}");
    let output = omnibus(&["status", "--json", "--bus", &bus]);
    let status: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let word = |value: &serde_json::Value| value.as_str().unwrap_or("none").to_owned();
    let robots = status["robots"].as_array().unwrap().iter();
    robots
        .map(|robot| (word(&robot["nmt"]), word(&robot["state"])))
        .collect()
}

/// Interrupts a command at moments spread evenly from its first line to its last but a tenth.
fn at_any_moment(arguments: &[&str]) {
    const MOMENTS: usize = 8;
    let (served, bus) = serve(&[]);
    let whole = run(arguments, &bus, usize::MAX);
    assert_eq!(whole.code, Some(0));
    drop(served);
    let mut seen = Vec::new();
    for moment in 0..MOMENTS {
        let (_served, bus) = serve(&[]);
        let stop = whole.sent * 9 / 10 * moment / (MOMENTS - 1);
        let ended = run(arguments, &bus, stop);
        assert_eq!(ended.code, Some(130), "at line {stop} of {}", whole.sent);
        let states = states(&bus);
        let state = states[0].1.clone();
        let at_rest = ["Unconfigured", "Ready"].contains(&state.as_str());
        assert!(at_rest, "at line {stop} of {}: {states:?}", whole.sent);
        let alike = ("PreOperational".to_owned(), state.clone());
        assert_eq!(states, [alike.clone(), alike], "at line {stop}");
        seen.push(state);
    }
    seen.dedup();
    assert_eq!(seen, ["Unconfigured", "Ready"], "first and later moments");
}

#[test]
fn ctrl_c_at_any_moment_of_a_wheel_test() {
    at_any_moment(&["wheel-test", "--node", "2", "--wheels-free"]);
}

#[test]
fn ctrl_c_at_any_moment_of_an_identification() {
    at_any_moment(&["identify-motors", "--node", "2", "--wheels-free"]);
}

/// What was measured is shown where it cannot be written: the bus goes before the last value.
#[test]
fn an_identification_outlives_its_bus() {
    let identify = ["identify-motors", "--node", "2", "--wheels-free"];
    let identify = [&identify[..], &["--accept"]].concat();
    let (served, bus) = serve(&[]);
    let whole = run(&identify, &bus, usize::MAX);
    assert_eq!(whole.code, Some(0));
    drop(served);
    let (_served, bus) = serve(&[]);
    let ended = relayed(&identify, &bus, whole.sent - 20, |_| false);
    assert_eq!(ended.code, Some(3));
    let is_table = |line: &&str| line.contains('│');
    let table = |shown: &str| shown.lines().filter(is_table).map(String::from).collect();
    let tables: [Vec<String>; 2] = [&whole, &ended].map(|one| table(&one.shown));
    assert_eq!(tables[0].len(), 5);
    assert_eq!(tables[0], tables[1]);
}

/// What was driven up to a Ctrl-C is in the report, which says so. Where nothing was driven yet, no
/// report replaces the one that is there.
#[test]
fn ctrl_c_in_a_drive_with_a_report() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("interrupted.html");
    let before = "the report of another drive";
    std::fs::write(&file, before).unwrap();
    let path = file.to_str().unwrap();
    let follow = ["follow", "circle", "--quick", "--report", path];
    let (served, bus) = serve(&[]);
    let whole = run(&follow, &bus, usize::MAX);
    assert_eq!(whole.code, Some(0));
    drop(served);
    let complete = std::fs::read_to_string(&file).unwrap();
    assert!(!complete.contains("before the end of the curve"));
    std::fs::write(&file, before).unwrap();
    for (stop, is_driving) in [(2, false), (whole.sent * 3 / 4, true)] {
        let (_served, bus) = serve(&[]);
        let ended = run(&follow, &bus, stop);
        assert_eq!(ended.code, Some(130));
        let report = std::fs::read_to_string(&file).unwrap();
        if is_driving {
            assert!(report.contains("before the end of the curve: stopped on request"));
            let charts = |page: &str| page.matches("<svg").count();
            assert_eq!(charts(&report), charts(&complete));
        } else {
            assert_eq!(report, before);
        }
        assert!(states(&bus).iter().all(|(nmt, _)| nmt == "PreOperational"));
    }
}

/// What was driven up to a robot's fault is in the report, which says whose it was: the motor
/// driver's, while the robots are on the circle, 6 s after they were switched on.
#[test]
fn a_robot_that_fails_in_a_drive_with_a_report() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("failed.html");
    let _ = std::fs::remove_file(&file);
    let (_served, bus) = serve(&["t=6:node=3:driver-fault"]);
    let follow = ["follow", "circle", "--quick", "--report"];
    let ended = run(
        &[&follow[..], &[file.to_str().unwrap()]].concat(),
        &bus,
        usize::MAX,
    );
    assert_eq!(ended.code, Some(5));
    let report = std::fs::read_to_string(&file).unwrap();
    let (_, after) = report
        .split_once(" s, before the end of the curve: ")
        .unwrap();
    let (why, after) = after.split_once("</strong>").unwrap();
    assert_eq!(
        why,
        "node 3: fault DriverFault (0xff0e): The motor driver reports a fault. The group ramps down."
    );
    assert!(after.contains("<svg"), "what was driven");
}

/// What would be lost after a drive is refused before it: nothing is driven or printed.
#[test]
fn outputs_that_cannot_be_written_are_refused_first() {
    let folder = std::env::temp_dir().join(format!("omnibus-outputs-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let nowhere = |name: &str| folder.join("none").join(name).display().to_string();
    let (page, picture) = (nowhere("a.html"), nowhere("a.svg"));
    let same = folder.join("same").display().to_string();
    let folder_itself = folder.display().to_string();
    let name = folder.file_name().unwrap().display();
    let dotted = format!("{}/../{name}/same", folder.display());
    let bus = "sim:groups/tcc-2.toml";
    let curve = ["follow", "circle", "--quick", "--bus", bus];
    let calibrate = ["calibrate", "--speeds", "0.3", "--bus", bus];
    for (arguments, code, message) in [
        (
            [&curve[..], &["--report", &page]].concat(),
            1,
            format!("--report {page}: cannot be written: "),
        ),
        (
            [&curve[..], &["--log", &folder_itself]].concat(),
            1,
            format!("--log {folder_itself}: cannot be written: is a directory"),
        ),
        (
            [&curve[..], &["--candump", &same, "--log", &dotted]].concat(),
            2,
            format!("--log {dotted}: --candump writes this file, too; give another one"),
        ),
        (
            [&calibrate[..], &["--plot", &picture]].concat(),
            1,
            format!("--plot {picture}: cannot be written: "),
        ),
        (
            [&calibrate[..], &["--write", "--kept", &page]].concat(),
            1,
            format!("--kept {page}: cannot be written: "),
        ),
    ] {
        let output = omnibus(&arguments);
        let errors = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {errors}");
        assert!(errors.starts_with(&format!("error: {message}")), "{errors}");
        assert_eq!(errors.lines().count(), 1, "{errors}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0);
    std::fs::remove_dir(folder).unwrap();
}

/// Robots in a folder, and what calibrates them with few motions.
struct Floor {
    _served: Served,
    folder: PathBuf,
    bus: String,
    poses: String,
}

impl Floor {
    fn new(name: &str) -> Self {
        let folder = copied_group(name);
        let (served, address) = serve_in(&folder, &["--pose-tcp", "127.0.0.1:0"]);
        Self {
            _served: served,
            folder,
            bus: format!("lockstep://{}", address("lockstep")),
            poses: format!("tcp://{}", address("pose-tcp")),
        }
    }

    /// Calibrates; `spoil` is called during the second motion, if that is driven.
    fn calibrate(&self, options: &[&str], spoil: impl FnOnce()) -> Output {
        let mut child = Command::new(env!("CARGO_BIN_EXE_omnibus"))
            .args(["calibrate", "--speeds", "0.25", "--rates", "0.5"])
            .args(["--repeats", "1", "--distance", "0.25"])
            .args(["--bus", &self.bus, "--pose", &self.poses])
            .args(["--group", "groups/tcc-2.toml"])
            .args(options)
            .current_dir(&self.folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let errors = BufReader::new(child.stderr.take().unwrap());
        let (mut notes, mut spoil) = (String::new(), Some(spoil));
        for line in errors.lines().map_while(Result::ok) {
            let is_driven = line.starts_with("motion 2 of") && line.ends_with(" to go");
            if let Some(spoil) = spoil.take_if(|_| is_driven) {
                spoil();
            }
            notes += &line;
            notes.push('\n');
        }
        let mut output = child.wait_with_output().unwrap();
        output.stderr = notes.into();
        output
    }

    fn group(&self) -> String {
        std::fs::read_to_string(self.folder.join("groups/tcc-2.toml")).unwrap()
    }
}

/// The picture's folder goes while the robots drive: the result is printed, and the error is the
/// picture's.
#[test]
fn a_calibration_outlives_its_picture() {
    let floor = Floor::new("picture");
    let pictures = floor.folder.join("pictures");
    std::fs::create_dir(&pictures).unwrap();
    let remove = || std::fs::remove_dir_all(&pictures).unwrap();
    let ended = floor.calibrate(&["--plot", "pictures/fit.svg"], remove);
    let [out, errors] = [ended.stdout, ended.stderr].map(|it| String::from_utf8(it).unwrap());
    assert_eq!(ended.status.code(), Some(1), "{errors}");
    assert!(out.contains("# From `omnibus calibrate`."), "{out}");
    assert!(
        errors.contains("error: cannot write pictures/fit.svg"),
        "{errors}"
    );
}

/// A result that cannot be written when all motions are driven. The robots hold what they held, and
/// --resume writes it without driving again; --undo then still knows the first values.
#[test]
fn a_calibration_that_cannot_be_written_is_resumed() {
    let floor = Floor::new("unwritten");
    let before = floor.group();
    let undo = floor.folder.join("groups/tcc-2.calibration.json");
    let ended = floor.calibrate(&["--write"], || std::fs::create_dir(&undo).unwrap());
    let [out, errors] = [ended.stdout, ended.stderr].map(|it| String::from_utf8(it).unwrap());
    assert_eq!(ended.status.code(), Some(1), "{errors}");
    assert!(out.contains("# From `omnibus calibrate`."), "{out}");
    assert!(errors.contains("--resume continues from there"), "{errors}");
    assert_eq!(floor.group(), before);
    std::fs::remove_dir(&undo).unwrap();
    let ended = floor.calibrate(&["--write", "--resume"], || panic!("drives again"));
    let errors = String::from_utf8(ended.stderr).unwrap();
    assert!(ended.status.success(), "{errors}");
    assert_eq!(
        String::from_utf8(ended.stdout)
            .unwrap()
            .matches("# From")
            .count(),
        1
    );
    assert_ne!(floor.group(), before);
    let record: serde_json::Value = serde_json::from_slice(&std::fs::read(&undo).unwrap()).unwrap();
    assert_eq!(record["group_file"], before);
    for robot in record["robots"].as_array().unwrap() {
        assert_eq!(robot["constants"], serde_json::json!([1.0, 1.0, 1.0]));
    }
    assert!(!floor.folder.join("groups/tcc-2.calibration.jsonl").exists());
}

/// Finished motions could not be kept, or are not there: that is said before the first is driven.
#[test]
fn a_record_of_motions_that_cannot_be_used_is_refused() {
    let floor = Floor::new("record");
    let record = floor.folder.join("groups/tcc-2.calibration.jsonl");
    let refusal = |options: &[&str]| {
        let ended = floor.calibrate(options, || panic!("drives"));
        let errors = String::from_utf8(ended.stderr).unwrap();
        assert_eq!(ended.status.code(), Some(1), "{errors}");
        assert!(!errors.contains("motion 1 of"), "{errors}");
        let error = errors.lines().find(|line| line.starts_with("error: "));
        let error = error.unwrap_or_default().to_owned();
        assert!(error.contains("tcc-2.calibration.jsonl"), "{errors}");
        error
    };
    let says = |options: &[&str], words: &str| {
        let error = refusal(options);
        assert!(error.contains(words), "{error}");
    };
    says(
        &["--resume"],
        "no calibration to resume; run it without --resume",
    );
    std::fs::write(&record, [0xFF, b'\n']).unwrap();
    says(
        &["--resume"],
        "so it has no motions; calibrate without --resume",
    );
    std::fs::remove_file(&record).unwrap();
    std::fs::create_dir(&record).unwrap();
    for options in [&[][..], &["--resume"]] {
        says(
            options,
            "is a directory; finished motions are kept in this file",
        );
    }
}

/// The frames of a recording are sent up to a Ctrl-C, and no robot stays in OPERATIONAL.
#[test]
fn ctrl_c_in_a_replay() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("interrupted.mcap");
    let file = file.to_str().unwrap();
    let drive = ["drive", "--vx", "0.1", "--for", "1", "--record", file];
    let recorded = omnibus(&[&drive[..], &["--bus", "sim:groups/tcc-2.toml"]].concat());
    assert!(recorded.status.success());
    let replay = ["replay", file, "--drive"];
    let (served, bus) = serve(&[]);
    let whole = run(&replay, &bus, usize::MAX);
    assert_eq!(whole.code, Some(0));
    drop(served);
    let (_served, bus) = serve(&[]);
    let ended = run(&replay, &bus, whole.sent / 2);
    assert_eq!(ended.code, Some(130));
    assert!(ended.sent < whole.sent);
    assert!(states(&bus).iter().all(|(nmt, _)| nmt == "PreOperational"));
}

/// What was found before a Ctrl-C is in the report, which says that the rest was not tried; the
/// report of the next trial has everything.
#[test]
fn ctrl_c_in_an_acceptance_keeps_what_was_found() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("accept-interrupted");
    let _ = std::fs::remove_dir_all(&folder);
    let arguments = [
        "accept",
        "--level",
        "2",
        "--wheels-free",
        "--skip",
        "fault",
        "--report",
    ];
    let arguments = [&arguments[..], &[folder.to_str().unwrap()]].concat();
    let trial = |stop| {
        let (_served, bus) = serve(&[]);
        let ended = run(&arguments, &bus, stop);
        let text = std::fs::read(folder.join("report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&text).unwrap();
        let checks = report["checks"].as_array().unwrap().iter();
        let kept = checks.filter(|check| check["within"] == true);
        let kept: Vec<String> = kept.map(|check| check["name"].to_string()).collect();
        (ended, report["limits"].to_string(), kept)
    };
    let all = ["wheels.2", "wheels.3", "motors.2", "motors.3"].map(|name| format!("\"{name}\""));

    let (whole, limits, kept) = trial(usize::MAX);
    assert_eq!((whole.code, kept), (Some(0), all.to_vec()));
    assert!(!limits.contains("not tried"), "{limits}");
    let (ended, limits, kept) = trial(whole.sent * 9 / 10);
    assert_eq!((ended.code, kept), (Some(130), all[..3].to_vec()));
    assert!(
        limits.contains("stopped by the user: what is not listed was not tried"),
        "{limits}"
    );
    let (ended, _, kept) = trial(usize::MAX);
    assert_eq!((ended.code, kept), (Some(0), all.to_vec()));
}

/// A question for a measure waits for a person, not for a line alone.
#[test]
fn ctrl_c_at_a_question_ends_an_acceptance() {
    let (_served, bus) = serve(&[]);
    let bus = format!("lockstep://{bus}");
    let mut child = Command::new(env!("CARGO_BIN_EXE_omnibus"))
        .args(["accept", "--level", "3", "--tape", "--bus", &bus])
        .args(["--group", "groups/tcc-2.toml"])
        .current_dir(root())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let notes = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut notes = notes.map_while(Result::ok);
    assert!(notes.any(|note| note.contains("Enter skips it")));
    let id = child.id().to_string();
    let killed = Command::new("kill").args(["-INT", &id]).status().unwrap();
    assert!(killed.success());
    // The rest of its notes, until it ends; the standard input is open all the while.
    assert!(notes.any(|note| note.contains("stopped on request")));
    assert_eq!(child.wait().unwrap().code(), Some(130));
}
