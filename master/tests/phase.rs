//! `omnibus calibrate --phase` as a user runs it, on robots with rollers of random phase: from
//! gyros with the noise and the bias of inexpensive ones, and from poses.
//!
//! The bounds were set before anything was measured. A phasor of amplitude A in white noise of
//! density N is known to N / (A sqrt(T)) after T seconds. Here A is the yaw rate that the
//! fundamental of one wheel's secant makes, `2 / n^2` of the rims' sideways speed, at four lever
//! arms; T is eight motions of ten seconds; and an angle of the wheel is an nth of the phasor's.
//! Four of these deviations are allowed, and a thousandth of a pitch for what the model leaves out.

mod common;

use std::f64::consts::TAU;
use std::path::PathBuf;

use common::omnibus;
use group::{GroupFile, Rollers};
use kinematics::{Pose, Twist, VelocityCompensation};
use omnibus::abort::Abort;
use omnibus::bus::link::Link as _;
use omnibus::commission::calibrate::journal::Journal;
use omnibus::commission::calibrate::recorded_motions::{self, Source};
use omnibus::commission::calibrate::rollers;
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::run::Drive;
use omnibus::session::Group;
use omnibus::simulation::contact;
use omnibus::simulation::link::SimLink;
use omnibus::simulation::run::simulated;
use omnibus::source::gyro::GyroStream;

/// Density of the gyros' noise, rad/s in 1 Hz.
const NOISE: f64 = 0.005 * TAU / 360.0;
/// The rims' sideways speed in the motions of the calibration, m/s.
const SIDEWAYS: f64 = 1.65 * 0.12;

/// Steps of the headings that robots send, rad, and SYNCs in a second.
const HEADING_STEP: f64 = 1e-4;
const SYNCS: f64 = 100.0;
/// The fastest rim in these motions, m/s, and its radius, m.
const FASTEST_RIM: f64 = 2.3 * 0.12;
const RADIUS: f64 = 0.1524;
/// The board of a group file's robots, without and with a gyro.
const WITH_BOARD: (&str, &str) = ("[robot]", "[robot]\nboard = \"robomaster-c\"");

/// A robot of the group files with other rollers.
struct Robot {
    path: PathBuf,
    rollers: u8,
    degrees: f64,
}

impl Robot {
    fn new(name: &str, (rollers, degrees, seed): (u8, f64, u64), gyro: &str) -> Self {
        let file = common::root().join("groups/single-rollers.toml");
        let text = std::fs::read_to_string(file).unwrap();
        let replaced = [
            (
                "roller_angle_deg = 45.0",
                format!("roller_angle_deg = {degrees:.1}"),
            ),
            ("rollers = 8", format!("rollers = {rollers}")),
            ("seed = 1", format!("seed = {seed}\n{gyro}")),
        ];
        let text = replaced.iter().fold(text, |text, (from, to)| {
            assert!(text.contains(from), "{from}");
            text.replacen(from, to, 1)
        });
        let name = format!("omnibus-phase-{name}-{}.toml", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).unwrap();
        Self {
            path,
            rollers,
            degrees,
        }
    }

    /// On the board that has a gyro.
    fn with_board(self) -> Self {
        let text = std::fs::read_to_string(&self.path).unwrap();
        let text = text.replacen(WITH_BOARD.0, WITH_BOARD.1, 1);
        std::fs::write(&self.path, text).unwrap();
        self
    }

    /// What the command finds: phases and half intervals of 95 %, rad; or what it says instead.
    fn calibrated(&self, options: &[&str]) -> Result<[[f64; 4]; 2], String> {
        let bus = format!("sim:{}", self.path.display());
        let rollers = self.rollers.to_string();
        let plain = ["calibrate", "--phase", "--rollers", &rollers, "--bus", &bus];
        let output = omnibus(&[&plain, options].concat());
        if !output.status.success() {
            assert!(output.stdout.is_empty(), "figures from what was refused");
            return Err(String::from_utf8(output.stderr).unwrap());
        }
        let text = String::from_utf8(output.stdout).unwrap();
        println!("{text}");
        let numbers = |from: &str, to: &str| -> [f64; 4] {
            let (_, rest) = text.split_once(from).unwrap();
            let (all, _) = rest.split_once(to).unwrap();
            let words = all.split([' ', ',']).filter(|word| !word.is_empty());
            let numbers: Vec<f64> = words.map(|word| word.parse().unwrap()).collect();
            <[f64; 4]>::try_from(numbers).unwrap().map(f64::to_radians)
        };
        Ok([numbers("phases_deg = [", "]"), numbers("# ±", "degrees")])
    }

    /// Errors of what was found, rad.
    fn errors(&self, found: &[f64; 4]) -> [f64; 4] {
        let group = GroupFile::load(&self.path).unwrap();
        let truth = sim::index::roller_phases(&group).unwrap()[0];
        let pitch = TAU / f64::from(self.rollers);
        std::array::from_fn(|n| {
            let off = found[n] - truth[n];
            off - (off / pitch).round() * pitch
        })
    }

    /// See the head of this file.
    fn bound(&self, source: &str) -> f64 {
        let n = f64::from(self.rollers);
        let lever = 0.370 + 0.350 / self.degrees.to_radians().tan();
        let amplitude = 2.0 / (n * n) * SIDEWAYS / (4.0 * lever);
        // Steps of headings, evenly spread: noise of an angle, and of its rate times the ripple's
        // angular frequency, the most of which the fastest wheel has.
        let steps = if source == "robot" {
            HEADING_STEP / (12.0 * SYNCS).sqrt() * n * FASTEST_RIM / RADIUS
        } else {
            0.0
        };
        let deviation = NOISE.hypot(steps) / (amplitude * 80_f64.sqrt()) / n;
        4.0 * deviation + 1e-3 * TAU / n
    }

    /// The bounds of `tests/phase.rs`, with what was found in the robot.
    #[expect(clippy::cast_possible_truncation, reason = "a file holds f32")]
    fn drives_straight(&self, found: &[f64; 4]) {
        let mut group = GroupFile::load(&self.path).unwrap();
        group.robots[0].rollers = Some(Rollers {
            count: self.rollers,
            phases: found.map(|phase| phase as f32),
            index_tolerance: None,
            compensation: VelocityCompensation::NONE,
        });
        let abort = Abort::default();
        let group = contact::calibrated(&group, &abort).unwrap();
        let drive = |curve| {
            let drive = Drive {
                group: &group,
                course: Course::of(curve),
                feedback: None,
                compensation: true,
                elf: None,
                candump: None,
                log: None,
                abort: abort.clone(),
                record: None,
                index_search: Some(&|_| {}),
            };
            simulated(&drive, &mut |_, _| {}).unwrap().evenness
        };
        let ripple = drive(Curve::Lateral).ripple_percent;
        let heading = drive(Curve::Oblique).heading_error_deg;
        println!("ripple {ripple:.3} %, heading {heading:+.3} deg");
        assert!(ripple <= 0.6);
        assert!(heading.abs() <= 0.1);
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Calibrates a robot; how many of its four intervals hold the truth.
fn calibrate(name: &str, which: (u8, f64, u64), source: &str, drives: bool) -> usize {
    let mut robot = Robot::new(name, which, "");
    if source == "robot" {
        robot = robot.with_board();
    }
    let [found, intervals] = robot.calibrated(&["--gyro", source]).unwrap();
    let errors = robot.errors(&found);
    println!(
        "{which:?}: off by {:.3?} degrees, bound {:.3}",
        errors.map(f64::to_degrees),
        robot.bound(source).to_degrees()
    );
    for error in errors {
        assert!(error.abs() < robot.bound(source));
    }
    if drives {
        robot.drives_straight(&found);
    }
    let pairs = errors.iter().zip(intervals);
    pairs.filter(|(error, sure)| error.abs() < *sure).count()
}

/// Three seeds each, and one robot with other rollers' angles. Of 40 intervals of 95 % the truth is
/// outside of 6 or more once in 70 times, were they independent.
#[test]
fn a_gyro_shows_the_phases() {
    let mut inside = 0;
    for rollers in [8, 10, 12] {
        for seed in [3, 2, 1] {
            inside += calibrate("gyro", (rollers, 45.0, seed), "sim", seed == 1);
        }
    }
    inside += calibrate("leaning", (8, 52.0, 1), "sim", true);
    println!("{inside} of 40");
    assert!(inside >= 35);
}

/// Nothing is plugged in: the gyro is that of the board, and comes over the bus as headings, which
/// have steps of their own. Board C has both, emulated in `tests/gyro.rs`. Of 12 intervals the
/// truth is outside of 4 or more once in 450 times.
#[test]
fn the_gyro_on_a_board_shows_the_phases() {
    let robots = [(8, 3), (10, 2), (12, 1)];
    let inside: usize = robots
        .iter()
        .map(|(rollers, seed)| calibrate("board", (*rollers, 45.0, *seed), "robot", *seed == 3))
        .sum();
    println!("{inside} of 12");
    assert!(inside >= 9);
}

/// Before anything moves where there is none; after the motion where it has failed in it.
#[test]
fn a_gyro_on_a_board_that_is_not_used_is_refused() {
    let plain = "sim:groups/single-rollers.toml";
    let output = omnibus(&["calibrate", "--phase", "--gyro", "robot", "--bus", plain]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(4), "{message}");
    for words in ["node 2", "0x2132:1", "none", "--gyro tcp://HOST:PORT"] {
        assert!(message.contains(words), "{message}");
    }

    let file = common::root().join("groups/single-rollers.toml");
    let text = std::fs::read_to_string(file).unwrap();
    let text = text.replacen(WITH_BOARD.0, WITH_BOARD.1, 1);
    let file = GroupFile::parse("board", &text).unwrap();
    let file = rollers::without_phases(&file, 8).unwrap();
    let world = omnibus::simulation::run::world(&file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
    let mut group = Group::connect(SimLink::new(world, "sim"), &file).unwrap();
    group.find_rollers(&mut |_| {}).unwrap();
    group
        .link()
        .world
        .set_gyro_defect(0, Some(emulator::GyroDefect::Stuck));
    let sideways = Twist::new(0.0, 0.15, 0.0);
    let journal = &mut Journal::new(|_| {});
    let found = recorded_motions::record(&mut group, &[sideways], &mut Source::Board, journal);
    let error = found.unwrap_err().to_string();
    assert!(
        error.contains("stuck") && error.contains("docs/bring-up.md"),
        "{error}"
    );
}

/// Poses without noise: the thousandth of a pitch that the model is trusted to, twice, because that
/// is for 95 %.
#[test]
fn poses_show_the_phases() {
    for (rollers, seed) in [(8, 4), (10, 5), (12, 6)] {
        let robot = Robot::new("poses", (rollers, 45.0, seed), "");
        let [found, _] = robot.calibrated(&[]).unwrap();
        let errors = robot.errors(&found);
        println!(
            "{rollers}: off by {:.3?} degrees",
            errors.map(f64::to_degrees)
        );
        for error in errors {
            assert!(error.abs() < 2e-3 * TAU / f64::from(rollers));
        }
        if rollers == 8 {
            robot.drives_straight(&found);
        }
    }
}

/// What cannot be known is not made up: noise two hundred times as dense, a gyro with 10 samples a
/// second, other rollers than said, and wheels that do not ripple at all.
#[test]
fn what_does_not_show_is_refused() {
    let gyro = ["--gyro", "sim"];
    let robot = Robot::new("noisy", (8, 45.0, 1), "gyro = { noise_dps_rthz = 1 }");
    let error = robot.calibrated(&gyro).unwrap_err();
    assert!(
        error.contains("node 2") && error.contains("quieter"),
        "{error}"
    );
    let robot = Robot::new("slow", (8, 45.0, 1), "gyro = { rate_hz = 10 }");
    let error = robot.calibrated(&gyro).unwrap_err();
    assert!(error.contains("10.0 samples a second"), "{error}");
    let mut robot = Robot::new("other", (8, 45.0, 1), "");
    robot.rollers = 10;
    for options in [&gyro[..], &[]] {
        let error = robot.calibrated(options).unwrap_err();
        assert!(error.contains("number of rollers"), "{error}");
        let bus = ["calibrate", "--phase", "--bus", "sim:groups/single.toml"];
        let output = omnibus(&[&bus, options].concat());
        assert_eq!(output.status.code(), Some(1), "ideal rollers");
    }
}

/// A gyro whose connection goes in the middle of a motion: its error comes through, and the robot
/// stands.
#[test]
fn a_robot_whose_gyro_is_lost_is_stopped() {
    use std::io::Write as _;
    let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = server.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let (mut stream, _) = server.accept().unwrap();
        for n in 0..3 {
            writeln!(stream, "{{\"t\":{n},\"yaw_rate\":0.0}}").unwrap();
        }
    });
    let mut file = GroupFile::load(common::root().join("groups/single-rollers.toml")).unwrap();
    file.robots[0].rollers = Some(Rollers {
        count: 8,
        phases: [0.0; 4],
        index_tolerance: None,
        compensation: VelocityCompensation::NONE,
    });
    let world = omnibus::simulation::run::world(&file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
    let mut group = Group::connect(SimLink::new(world, "sim"), &file).unwrap();
    group.find_rollers(&mut |_| {}).unwrap();
    let gyro = GyroStream::connect(&address).unwrap();
    let (mut calls, mut speed) = (0, 0.0);
    let mut rates = |link: &mut SimLink| {
        calls += 1;
        if calls < 100 {
            return Ok(vec![Vec::new()]);
        }
        // 1 s into the motion, 0.7 s of it moving.
        speed = link.world.truth().robots[0].wheel_rates.front_right;
        std::thread::sleep(std::time::Duration::from_millis(100));
        gyro.take(&[2], link.now())
    };
    let sideways = Twist::new(0.0, 0.15, 0.0);
    let error = recorded_motions::record(
        &mut group,
        &[sideways],
        &mut Source::Gyro(&mut rates),
        &mut Journal::new(|_| {}),
    );
    let error = error.unwrap_err().to_string();
    assert!(error.contains("connection was closed"), "{error}");
    assert!(speed > 0.9, "it was moving: {speed}");
    let rates = group.link().world.truth().robots[0].wheel_rates;
    for rate in <[f64; 4]>::from(rates) {
        assert!(rate.abs() < 0.01, "{rates:?}");
    }
}

#[test]
fn options_that_do_not_fit_say_what_does() {
    let real = [
        "--bus",
        "slcan-tcp://127.0.0.1:1",
        "--group",
        "groups/single.toml",
    ];
    let simulated = ["--bus", "sim:groups/single-rollers.toml"];
    for (options, bus, code, words) in [
        (
            &["--gyro", "sim"][..],
            &real[..],
            2,
            "--gyro tcp://HOST:PORT",
        ),
        (&[], &real, 2, "--gyro tcp://HOST:PORT"),
        (
            &["--gyro", "can0"],
            &real,
            2,
            "not tcp://HOST:PORT or robot",
        ),
        (
            &["--gyro", "tcp://127.0.0.1:1"],
            &real,
            1,
            "docs/operating.md",
        ),
        (
            &["--gyro", "tcp://127.0.0.1:1"],
            &simulated,
            2,
            "--gyro sim",
        ),
        (
            &["--gyro", "sim", "--pose", "tcp://127.0.0.1:1"],
            &simulated,
            2,
            "--pose",
        ),
        (
            &["--gyro", "sim", "--repeats", "0"],
            &simulated,
            2,
            "--repeats",
        ),
    ] {
        let output = omnibus(&[&["calibrate", "--phase"], options, bus].concat());
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(message.contains(words), "{message}");
    }
    let output = omnibus(&[&["calibrate", "--gyro", "sim"], &simulated[..]].concat());
    assert_eq!(
        output.status.code(),
        Some(2),
        "a gyro cannot find what the floor takes"
    );
}
