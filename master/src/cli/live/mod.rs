//! `omnibus watch` and `omnibus teleop`: a running group in the terminal, and driving it by hand.
//!
//! The session runs in a pilot's thread; this one draws ten times a second and reads keys. `watch`
//! only listens until the user starts it; on a bus that another master commands it never does more.
//! Driving needs a key (or the gamepad's button) that is held down: see [`deadman`]. Every 50 ms
//! while it is held, the [`Controls`] get the velocity again, valid for 0.2 s; so when this program
//! hangs, the group ramps down. A signal, as of a terminal that closes, ends it as the key does.

mod deadman;
mod gamepad;
mod keys;
mod view;

use std::io::IsTerminal as _;
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use kinematics::Twist;
use omnibus::abort::Abort;
use omnibus::controls::Controls;
use omnibus::controls::arbiter::Client;
use omnibus::monitor::telemetry::{EventKind, SessionState, Snapshot, Telemetry};
use omnibus::pilot::Pilot;
use omnibus::session::slowed;
use ratatui::crossterm::event::{
    self, Event, KeyboardEnhancementFlags, PopKeyboardEnhancementFlags,
    PushKeyboardEnhancementFlags,
};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::supports_keyboard_enhancement;
use serde_json::json;

use self::deadman::DeadMan;
use self::gamepad::Gamepad;
use self::keys::Action;
use self::view::View;
use super::Target;

/// Interval of velocities to the pilot and of drawing the screen.
const TICK: Duration = Duration::from_millis(50);
/// How long a velocity is good for, in ms.
const GOOD_MS: u64 = 200;

const WATCH_EXAMPLES: &str = "Examples:
  omnibus watch --bus sim:groups/tcc-2.toml
  omnibus watch --bus socketcan:can0 --group groups/tcc-2.toml
  omnibus watch --json --for 5 --bus slcan:/dev/ttyACM0 --group my-group.toml

It only listens until you press 's'. On a bus that another master commands it shows what that master does.";
const TELEOP_EXAMPLES: &str = "Examples:
  omnibus teleop --bus sim:groups/tcc-2.toml
  omnibus teleop --speed 0.3 --turn 0.4 --bus socketcan:can0 --group groups/tcc-2.toml
  omnibus teleop --gamepad /dev/input/js0 --bus socketcan:can0 --group groups/tcc-2.toml

The group moves while a key is held and ramps down when it is released: at once where the terminal reports
the release (kitty, foot, WezTerm, Ghostty), otherwise 0.25 s after the last repetition of the key.
With a gamepad, the left shoulder button must be held.";

#[derive(clap::Args)]
#[command(after_help = WATCH_EXAMPLES)]
pub struct Watch {
    #[command(flatten)]
    live: Live,
}

#[derive(clap::Args)]
#[command(after_help = TELEOP_EXAMPLES)]
pub struct Teleop {
    #[command(flatten)]
    live: Live,
    /// A Linux joystick device, such as /dev/input/js0.
    #[arg(long, value_name = "DEVICE")]
    gamepad: Option<PathBuf>,
}

#[derive(clap::Args)]
struct Live {
    #[command(flatten)]
    target: Target,
    /// Speed when driving by hand, m/s.
    #[arg(long, default_value_t = 0.2, value_parser = super::real::<f32>)]
    speed: f32,
    /// Yaw rate when turning by hand, rad/s.
    #[arg(long, default_value_t = 0.3, value_parser = super::real::<f32>)]
    turn: f32,
    /// Duration, s; by default until the program is quit.
    #[arg(long = "for", value_name = "SECONDS", value_parser = super::real::<f64>)]
    seconds: Option<f64>,
}

/// `omnibus watch`.
pub fn watch(arguments: &Watch) -> anyhow::Result<()> {
    run(&arguments.live, None, false)
}

/// `omnibus teleop`.
pub fn teleop(arguments: &Teleop) -> anyhow::Result<()> {
    if super::json() {
        usage!("teleop has no JSON output; programs drive with `omnibus bridge`");
    }
    let gamepad = match &arguments.gamepad {
        Some(path) => Some(Gamepad::open(path).with_context(|| {
            format!(
                "cannot open the gamepad {}; ls /dev/input/js* lists them, and you may need to be \
                 in the group input",
                path.display()
            )
        })?),
        None => None,
    };
    run(&arguments.live, gamepad, true)
}

fn run(live: &Live, gamepad: Option<Gamepad>, steers: bool) -> anyhow::Result<()> {
    let file = live.target.group()?;
    let limits = &file.limits;
    for (option, value) in [("--speed", live.speed), ("--turn", live.turn)] {
        if value <= 0.0 {
            usage!("{option}: {value} is not above 0");
        }
    }
    if !(live.speed > 0.0 && live.speed <= limits.linear_speed) {
        bail!(
            "--speed: {} m/s is not between 0 and the group's limits.linear_speed, {} m/s",
            live.speed,
            limits.linear_speed
        );
    }
    if !(live.turn > 0.0 && live.turn <= limits.yaw_rate) {
        bail!(
            "--turn: {} rad/s is not between 0 and the group's limits.yaw_rate, {} rad/s",
            live.turn,
            limits.yaw_rate
        );
    }
    if let Some(seconds) = live.seconds
        && !(0.0..=1e6).contains(&seconds)
    {
        usage!("--for: {seconds} s is not between 0 and 1000000 s");
    }
    let until = live
        .seconds
        .map(|seconds| Instant::now() + Duration::from_secs_f64(seconds));
    let abort = super::abort_on_ctrl_c()?;
    if super::json() && !steers {
        return lines(live.target.pilot(&file)?, until, &abort);
    }
    if !std::io::stdout().is_terminal() || !std::io::stdin().is_terminal() {
        bail!("this needs a terminal; `omnibus watch --json` prints one line per SYNC without one");
    }
    let pilot = Arc::new(live.target.pilot(&file)?);
    let controls = Controls::of(&pilot, &file.limits);
    let mut screen = Screen::open()?;
    let mut hand = Hand {
        client: controls.client(),
        controls,
        limits: file.limits,
        deadman: DeadMan::new(),
        speed: live.speed,
        turn: live.turn,
        twist: Twist::default(),
        gamepad,
    };
    let mut view = View::new(format!("{} on {}", file.name, live.target.bus), steers);
    if steers {
        hand.start();
    }
    let is_over = || abort.is_asked() || until.is_some_and(|until| Instant::now() >= until);
    let shown = show(&pilot, &mut screen, &mut view, &mut hand, &is_over);
    drop(screen);
    let flown = Pilot::finish_shared(pilot);
    // A terminal that closes can no longer be drawn on.
    if !abort.is_asked() {
        shown?;
    }
    Ok(flown?)
}

/// Prints snapshots as lines of JSON.
fn lines(pilot: Pilot, until: Option<Instant>, abort: &Abort) -> anyhow::Result<()> {
    let stream = pilot.telemetry();
    while until.is_none_or(|until| Instant::now() < until) && !pilot.is_over() && !abort.is_asked()
    {
        if let Some(Telemetry::Snapshot(now)) = stream.next_within(TICK) {
            let line = serde_json::to_string(&snapshot_json(&now))?;
            // Not `print_line`: lines are the result, whatever else is asked for.
            use std::io::Write as _;
            writeln!(std::io::stdout().lock(), "{line}")?;
        }
    }
    Ok(pilot.finish()?)
}

fn snapshot_json(now: &Snapshot) -> serde_json::Value {
    let twist = |t: Twist| json!({"vx": t.vx, "vy": t.vy, "omega": t.omega});
    let members = now.members.iter().map(|m| {
        json!({"node": m.node, "nmt": m.nmt.map(|nmt| format!("{nmt:?}")),
               "state": m.state.map(|state| format!("{state:?}")), "code": m.code.code(),
               "past": m.past.map(|past| json!({"state": past.state.map(|state| format!("{state:?}")),
                                                "code": past.code.code(), "age_s": past.age})),
               "scale": m.permitted_scale, "slip": m.slip_residual,
               "motor_temperature_c": m.motor_temperature,
               "wheel_rates": m.wheel_rates.map(<[f32; 4]>::from)})
    });
    json!({"t": now.t, "phase": now.phase.name(), "foreign_master": now.foreign_master, "command": twist(now.command),
           "pose": now.pose.map(|p| json!({"x": p.x, "y": p.y, "heading": p.heading})),
           "measured": now.measured.map(twist), "scale": now.scale, "strain": now.strain,
           "bus_load": now.bus_load, "sync": now.sync.map(|s| super::sync_json(&s)),
           "members": members.collect::<Vec<_>>()})
}

/// What steers.
struct Hand {
    controls: Controls,
    client: Client,
    limits: group::Limits,
    deadman: DeadMan,
    speed: f32,
    turn: f32,
    twist: Twist,
    gamepad: Option<Gamepad>,
}

impl Hand {
    /// The velocity asked for at this moment.
    fn asks(&mut self, now: Instant) -> Option<Twist> {
        if let Some(stick) = self.gamepad.as_ref().and_then(Gamepad::stick) {
            let (speed, turn) = (self.speed, self.turn);
            return Some(Twist::new(
                stick.forward * speed,
                stick.left * speed,
                stick.turn * turn,
            ));
        }
        self.deadman.is_held(now).then_some(self.twist)
    }
}

fn show(
    pilot: &Pilot,
    screen: &mut Screen,
    view: &mut View,
    hand: &mut Hand,
    is_over: &dyn Fn() -> bool,
) -> anyhow::Result<()> {
    let stream = pilot.telemetry();
    let events = events();
    let mut next = Instant::now();
    loop {
        let now = Instant::now();
        if now >= next {
            next = now + TICK;
            while let Some(item) = stream.try_next() {
                hand.controls.on_telemetry(&item);
                match item {
                    Telemetry::Snapshot(snapshot) => view.update(snapshot),
                    Telemetry::Event(event) => {
                        // Start and stop are shown by the phase.
                        if !matches!(event.what, EventKind::SessionState(_)) {
                            view.add_event(&event);
                        }
                    }
                    Telemetry::Frame(_) => {}
                }
            }
            let asked = hand.asks(now);
            if let Some(twist) = asked
                && view.phase() == SessionState::Running
            {
                hand.drive(twist);
            }
            view.hand(asked, hand.speed, hand.turn);
            screen.terminal.draw(|frame| view.draw(frame))?;
        }
        if pilot.is_over() || is_over() {
            return Ok(());
        }
        let key = match events.recv_timeout(next.saturating_duration_since(Instant::now())) {
            Ok(Event::Key(key)) => key,
            Ok(_) | Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => bail!("the terminal can no longer be read"),
        };
        match keys::action(&key) {
            Some(Action::Quit) => return Ok(()),
            Some(Action::Start) => hand.start(),
            Some(Action::Stop) => {
                hand.deadman.release();
                hand.controls.stop();
            }
            Some(Action::Halt) => hand.let_go(),
            Some(Action::Move(direction)) => {
                let twist = direction.twist(hand.speed, hand.turn);
                hand.deadman.press(Instant::now(), twist != hand.twist);
                hand.twist = twist;
            }
            Some(Action::LetGo(direction))
                if direction.twist(hand.speed, hand.turn) == hand.twist =>
            {
                hand.let_go();
            }
            Some(Action::LetGo(_)) => {}
            Some(Action::Faster) => hand.change(1.1),
            Some(Action::Slower) => hand.change(1.0 / 1.1),
            None => {}
        }
    }
}

/// Keys and what else the terminal says, from a thread of its own: once a terminal is closed, the
/// library reads it for ever and does not return.
fn events() -> mpsc::Receiver<Event> {
    let (send, events) = mpsc::channel();
    std::thread::spawn(move || {
        while let Ok(event) = event::read() {
            if send.send(event).is_err() {
                return;
            }
        }
    });
    events
}

impl Hand {
    /// No other client drives from this terminal, so it can take the controls.
    fn start(&self) {
        let taken = self.controls.take(self.client);
        if taken.is_ok() {
            let _ = self.controls.start(self.client);
        }
    }

    /// A refusal, while the robots are not ready, shows as a group that stands.
    fn drive(&self, twist: Twist) {
        if let Some((twist, _)) = slowed(twist, &self.limits) {
            let _ = self.controls.stream(self.client, twist, GOOD_MS);
        }
    }

    fn let_go(&mut self) {
        self.deadman.release();
        self.controls.release(self.client);
    }

    /// Changes the speeds; the limits of the group hold all the same.
    fn change(&mut self, factor: f32) {
        self.speed = (self.speed * factor).clamp(0.01, 5.0);
        self.turn = (self.turn * factor).clamp(0.01, 5.0);
        self.deadman.release();
    }
}

/// The terminal, put back as it was whatever happens.
struct Screen {
    /// Not dropped: of a terminal that was closed it would complain where nothing can be written.
    terminal: ManuallyDrop<ratatui::DefaultTerminal>,
    /// The terminal says when a key is let go.
    reports_release: bool,
}

impl Screen {
    fn open() -> anyhow::Result<Self> {
        let terminal = ratatui::try_init().context("cannot draw on this terminal")?;
        let reports_release = supports_keyboard_enhancement().unwrap_or(false);
        if reports_release {
            let flags = KeyboardEnhancementFlags::REPORT_EVENT_TYPES
                | KeyboardEnhancementFlags::DISAMBIGUATE_ESCAPE_CODES;
            execute!(std::io::stdout(), PushKeyboardEnhancementFlags(flags))?;
        }
        Ok(Self {
            terminal: ManuallyDrop::new(terminal),
            reports_release,
        })
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        if self.reports_release {
            let _ = execute!(std::io::stdout(), PopKeyboardEnhancementFlags);
        }
        let _ = self.terminal.show_cursor();
        let _ = ratatui::try_restore();
    }
}
