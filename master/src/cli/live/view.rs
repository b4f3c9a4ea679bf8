//! The screen: 80 columns and 24 lines hold a group of sixteen; what is left below shows what
//! happened.

use std::collections::VecDeque;
use std::sync::Arc;

use canopen::NmtState;
use kinematics::{Pose, Twist};
use omnibus::monitor::telemetry::{Event, MemberSample, SessionState, Snapshot};
use protocol::Code;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;

/// Column at which the text of an event begins.
const INDENT: usize = 13;
/// Columns for the group, its bus and what the session is doing.
const TITLE: usize = 64;
/// Happenings kept.
const HISTORY: usize = 50;

/// What is on the screen.
pub struct View {
    title: String,
    steers: bool,
    now: Option<Arc<Snapshot>>,
    /// The last pose and so on that were known: while nothing runs, nothing is reported.
    pose: Option<Pose>,
    history: VecDeque<(f64, String, bool)>,
    asked: Option<Twist>,
    speeds: (f32, f32),
}

fn red() -> Style {
    Style::new().fg(Color::Red).add_modifier(Modifier::BOLD)
}

fn bold() -> Style {
    Style::new().add_modifier(Modifier::BOLD)
}

fn twist_text(twist: Option<Twist>) -> String {
    twist.map_or_else(
        || "     -        -   m/s      -   rad/s".into(),
        |t| format!("{:+8.3} {:+8.3} m/s {:+7.3} rad/s", t.vx, t.vy, t.omega),
    )
}

impl View {
    /// An empty screen.
    pub fn new(title: String, steers: bool) -> Self {
        Self {
            title,
            steers,
            now: None,
            pose: None,
            history: VecDeque::new(),
            asked: None,
            speeds: (0.0, 0.0),
        }
    }

    /// What the session is doing, as last heard.
    pub fn phase(&self) -> SessionState {
        self.now
            .as_ref()
            .map_or(SessionState::Idle, |now| now.phase)
    }

    /// Takes a snapshot.
    pub fn update(&mut self, now: Arc<Snapshot>) {
        self.pose = now.pose.or(self.pose);
        self.now = Some(now);
    }

    /// Adds an event.
    pub fn add_event(&mut self, event: &Event) {
        use omnibus::monitor::telemetry::EventKind;
        let who = event
            .node
            .map_or_else(|| "master".into(), |node| format!("node {node}"));
        let bad = matches!(
            event.what,
            EventKind::Failed(_) | EventKind::Late(_) | EventKind::Code(Code::Fault(_))
        );
        if self.history.len() == HISTORY {
            self.history.pop_front();
        }
        self.history
            .push_back((event.t, format!("{who}: {}", event.what), bad));
    }

    /// Notes what the hand asks for.
    pub fn hand(&mut self, asked: Option<Twist>, speed: f32, turn: f32) {
        (self.asked, self.speeds) = (asked, (speed, turn));
    }

    /// Draws everything.
    pub fn draw(&self, frame: &mut Frame) {
        let robots = self.now.as_ref().map_or(0, |now| now.members.len());
        let rows = u16::try_from(robots).unwrap_or(16);
        let parts = Layout::vertical([
            Constraint::Length(4),
            Constraint::Length(rows + 1),
            Constraint::Min(0),
            Constraint::Length(2),
        ]);
        let [head, table, history, foot] = parts.areas(frame.area());
        frame.render_widget(Paragraph::new(self.head()), head);
        frame.render_widget(Paragraph::new(self.table()), table);
        frame.render_widget(Paragraph::new(self.history(history)), history);
        frame.render_widget(Paragraph::new(self.foot()), foot);
    }

    fn head(&self) -> Vec<Line<'_>> {
        let (phase, t) = self
            .now
            .as_ref()
            .map_or((SessionState::Idle, 0.0), |now| (now.phase, now.t));
        let foreign = self.now.as_ref().is_some_and(|now| now.foreign_master);
        let style = match phase {
            SessionState::Running => Style::new().fg(Color::Green).add_modifier(Modifier::BOLD),
            SessionState::Starting | SessionState::Stopping => Style::new().fg(Color::Yellow),
            SessionState::Idle => Style::new(),
        };
        let (words, style) = if foreign {
            let words = "listening: another master drives";
            (words, Style::new().fg(Color::Yellow))
        } else {
            (phase.name(), style)
        };
        let room = TITLE - words.len();
        let mut lines = vec![Line::from(vec![
            Span::styled(format!("{:<room$.room$} ", self.title), bold()),
            Span::styled(words, style),
            Span::raw(format!(" {t:>9.2} s")),
        ])];
        let Some(now) = &self.now else {
            lines.push(Line::from("opening the bus"));
            return lines;
        };
        let pose = self.pose.map_or_else(
            || "x     -     y     -     heading     -".into(),
            |p| {
                format!(
                    "x {:+8.3} m  y {:+8.3} m  heading {:+7.3} rad",
                    p.x, p.y, p.heading
                )
            },
        );
        let percent = |share: Option<f32>| {
            share.map_or_else(|| "  -".into(), |share| format!("{:3.0}", share * 100.0))
        };
        lines.push(Line::from(format!(
            "{pose:<50} bus {} %",
            percent(now.bus_load)
        )));
        let strain = now
            .strain
            .map_or_else(|| "-".into(), |s| format!("{:.1}", s * 1000.0));
        lines.push(Line::from(format!(
            "moves {} strain {strain} mm/s",
            twist_text(now.measured)
        )));
        let scale = now.scale;
        lines.push(Line::from(vec![
            Span::raw(format!("asked {} scale ", twist_text(Some(now.command)))),
            Span::styled(
                format!("{} %", percent(scale)),
                if scale.is_some_and(|s| s < 0.999) {
                    red()
                } else {
                    Style::new()
                },
            ),
        ]));
        lines
    }

    fn table(&self) -> Vec<Line<'_>> {
        let mut lines = vec![Line::from(Span::styled(
            format!(
                "{:>4} {:<6} {:<12} {:>5} {:>5} {:^27} {}",
                "node", "NMT", "state", "scale", "slip", "wheel rates, rad/s", "limit or fault"
            ),
            Style::new().add_modifier(Modifier::UNDERLINED),
        ))];
        let members = self.now.iter().flat_map(|now| &now.members);
        lines.extend(members.map(row));
        lines
    }

    /// The newest of what happened, as much as there is room for; what is longer than a line goes
    /// on in the next.
    fn history(&self, area: Rect) -> Vec<Line<'_>> {
        let width = usize::from(area.width).saturating_sub(INDENT).max(20);
        let mut lines = Vec::new();
        for (t, text, bad) in &self.history {
            let style = if *bad { red() } else { Style::new() };
            let mut start = format!("{t:9.2} s  ");
            for part in wrapped(text, width) {
                lines.push(Line::from(Span::styled(start + &part, style)));
                start = " ".repeat(INDENT);
            }
        }
        let skip = lines.len().saturating_sub(usize::from(area.height));
        lines.split_off(skip)
    }

    fn foot(&self) -> Vec<Line<'_>> {
        let sync = match self.now.as_ref().map(|now| now.sync) {
            Some(Some(sync)) if sync.count > 0 => format!(
                "SYNC late {:.0} us, 99 % {:.0}, worst {:.0}, missed {}",
                sync.mean_us, sync.p99_us, sync.worst_us, sync.missed
            ),
            Some(None) => "SYNC: virtual time, exact".into(),
            _ => "SYNC: none sent yet".into(),
        };
        let hand = match self.asked {
            Some(twist) => format!(
                "{:+.2} {:+.2} m/s {:+.2} rad/s",
                twist.vx, twist.vy, twist.omega
            ),
            None => format!("hand: {:.2} m/s, {:.2} rad/s", self.speeds.0, self.speeds.1),
        };
        let keys = if self.steers {
            "hold arrows move, u/o turn  +/- speed  space halt  s start  x stop  q quit"
        } else {
            "s start  x stop  space halt  hold arrows move, u/o turn  +/- speed  q quit"
        };
        vec![
            Line::from(vec![
                Span::raw(format!("{sync:<52.52} ")),
                Span::styled(
                    hand,
                    if self.asked.is_some() {
                        bold()
                    } else {
                        Style::new()
                    },
                ),
            ]),
            Line::from(Span::styled(
                keys,
                Style::new().add_modifier(Modifier::REVERSED),
            )),
        ]
    }
}

fn row(member: &MemberSample) -> Line<'_> {
    let nmt = match member.nmt {
        Some(NmtState::Operational) => "OP",
        Some(NmtState::PreOperational) => "PRE-OP",
        Some(NmtState::Stopped) => "STOP",
        Some(NmtState::Initialising) => "BOOT",
        None => "silent",
    };
    let state = member
        .state
        .map_or_else(|| "-".into(), |state| format!("{state:?}"));
    let scale = member
        .permitted_scale
        .map_or_else(|| "-".into(), |scale| format!("{:.0} %", scale * 100.0));
    let slip = member
        .slip_residual
        .map_or_else(|| "-".into(), |slip| format!("{slip:.2}"));
    let wheels = member.wheel_rates.map_or_else(
        || format!("{:^27}", "-"),
        |rates| {
            let [a, b, c, d] = <[f32; 4]>::from(rates);
            format!("{a:+6.2} {b:+6.2} {c:+6.2} {d:+6.2}")
        },
    );
    if let Some(past) = member.past {
        let style = Style::new().add_modifier(Modifier::DIM);
        let text = format!("{:>4} {nmt:<6} {:<12} last: {past}", member.node, "-");
        return Line::styled(text, style);
    }
    let degrees = member
        .motor_temperature
        .map_or_else(String::new, |degrees| format!("{degrees} C "));
    let (code, style) = match member.code {
        Code::None => ("", Style::new()),
        Code::Limit(limit) => (limit.name(), Style::new().fg(Color::Yellow)),
        Code::Fault(fault) => (fault.name(), red()),
    };
    Line::from(vec![
        Span::raw(format!(
            "{:>4} {nmt:<6} {state:<12.12} {scale:>5} {slip:>5} {wheels} {degrees}",
            member.node
        )),
        Span::styled(code, style),
    ])
}

/// A text in lines of at most so many characters, broken between words.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use kinematics::WheelRates;
    use omnibus::bus::punctuality::Punctuality;
    use omnibus::monitor::telemetry::EventKind;
    use protocol::{Fault, Limit, MemberState};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    fn screen(view: &View) -> String {
        let mut terminal = Terminal::new(TestBackend::new(80, 24)).unwrap();
        terminal.draw(|frame| view.draw(frame)).unwrap();
        let buffer = terminal.backend().buffer();
        let lines = (0..24).map(|y| {
            let line: String = (0..80).map(|x| buffer[(x, y)].symbol()).collect();
            line.trim_end().to_owned() + "\n"
        });
        lines.collect()
    }

    fn member(node: u8, code: Code) -> MemberSample {
        MemberSample {
            node,
            nmt: Some(NmtState::Operational),
            state: Some(MemberState::Moving),
            code,
            permitted_scale: Some(0.8),
            slip_residual: Some(0.05),
            wheel_rates: Some(WheelRates::from([1.5, -1.5, 10.25, -10.25])),
            ..MemberSample::default()
        }
    }

    fn view(members: Vec<MemberSample>) -> View {
        let mut view = View::new("tcc-2 on socketcan:can0".into(), false);
        view.update(Arc::new(Snapshot {
            t: 12.34,
            phase: SessionState::Running,
            command: Twist::new(0.2, -0.1, 0.3),
            measured: Some(Twist::new(0.16, -0.08, 0.24)),
            pose: Some(Pose::new(1.5, -0.25, 0.7)),
            scale: Some(0.8),
            strain: Some(0.0012),
            bus_load: Some(0.168),
            sync: Some(Punctuality {
                lately_us: 0.0,
                realtime: true,
                count: 1234,
                mean_us: 6.4,
                p99_us: 18.0,
                worst_us: 85.0,
                missed: 0,
            }),
            members,
            ..Snapshot::default()
        }));
        view.hand(None, 0.2, 0.3);
        view
    }

    /// The text a user sees. Written by hand from the numbers above.
    #[test]
    fn a_group_of_two_in_80_by_24() {
        let mut view = view(vec![
            member(2, Code::Limit(Limit::WheelRate)),
            member(3, Code::Fault(Fault::EmergencyStop)),
        ]);
        view.add_event(&Event {
            t: 12.3,
            node: Some(3),
            what: EventKind::Emergency(0xFF0F),
        });
        let text = screen(&view);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            &lines[..8],
            [
                "tcc-2 on socketcan:can0                                   running     12.34 s",
                "x   +1.500 m  y   -0.250 m  heading  +0.700 rad    bus  17 %",
                "moves   +0.160   -0.080 m/s  +0.240 rad/s strain 1.2 mm/s",
                "asked   +0.200   -0.100 m/s  +0.300 rad/s scale  80 %",
                "node NMT    state        scale  slip     wheel rates, rad/s      limit or fault",
                "   2 OP     Moving        80 %  0.05  +1.50  -1.50 +10.25 -10.25 WheelRate",
                "   3 OP     Moving        80 %  0.05  +1.50  -1.50 +10.25 -10.25 EmergencyStop",
                "    12.30 s  node 3: emergency 0xff0f",
            ]
        );
        assert_eq!(
            lines[22],
            "SYNC late 6 us, 99 % 18, worst 85, missed 0          hand: 0.20 m/s, 0.30 rad/s"
        );
        assert!(lines[23].starts_with("s start"), "{}", lines[23]);
    }

    #[test]
    fn sixteen_robots_and_the_keys_fit() {
        let text = screen(&view(
            (2..=17).map(|node| member(node, Code::None)).collect(),
        ));
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[20].starts_with("  17 OP"), "{text}");
        assert!(lines[23].contains("q quit"), "{text}");
    }

    /// What was is not what is: a robot that fell silent after a fault, under another master.
    #[test]
    fn an_old_status_is_told_with_its_age() {
        let mut silent = member(3, Code::Fault(Fault::SyncLost));
        silent.state = Some(MemberState::Moving);
        let mut view = view(vec![silent.aged(Some(2.34), Some(0.05))]);
        let text = screen(&view);
        assert!(
            text.contains("   3 OP     -            last: SyncLost 2.3 s ago\n"),
            "{text}"
        );
        let mut now = Snapshot::clone(view.now.as_ref().unwrap());
        (now.phase, now.foreign_master) = (SessionState::Idle, true);
        now.members[0] = member(3, Code::None).aged(Some(0.05), Some(1.2));
        view.update(Arc::new(now));
        let text = screen(&view);
        assert!(
            text.starts_with(
                "tcc-2 on socketcan:can0          listening: another master drives     12.34 s"
            ),
            "{text}"
        );
        assert!(text.contains("   3 silent Moving "), "{text}");
    }

    /// Behind the wheels' rates, where the row has room for it, and only where it is known.
    #[test]
    fn the_motors_temperature_is_shown_before_the_fault() {
        let mut hot = member(2, Code::Fault(Fault::DriveHot));
        hot.motor_temperature = Some(81);
        let text = screen(&view(vec![hot, member(3, Code::None)]));
        assert!(text.contains(" -10.25 81 C DriveHot\n"), "{text}");
        assert!(text.contains(" -10.25\n"), "{text}");
    }

    #[test]
    fn nothing_known_is_dashes_and_not_zeros() {
        let mut view = View::new("x".into(), true);
        assert!(screen(&view).contains("opening the bus"));
        view.update(Arc::new(Snapshot {
            members: vec![MemberSample {
                node: 2,
                ..MemberSample::default()
            }],
            ..Snapshot::default()
        }));
        let text = screen(&view);
        assert!(
            text.contains("   2 silent -                -     -"),
            "{text}"
        );
        assert!(!text.contains("+0.000 m  y"), "{text}");
    }

    /// A limit's text is longer than a line: it goes on below, and the newest line is the last.
    #[test]
    fn long_events_continue_in_the_next_line() {
        let mut view = view(vec![member(2, Code::None)]);
        for what in [
            EventKind::Code(Code::Limit(Limit::Acceleration)),
            EventKind::Code(Code::None),
        ] {
            view.add_event(&Event {
                t: 1.0,
                node: Some(2),
                what,
            });
        }
        let shown = screen(&view);
        assert!(shown.contains("\n     1.00 s  node 2: limit Acceleration: The group twist"));
        let words = Code::Limit(Limit::Acceleration).to_string();
        for word in words.split(' ') {
            assert!(shown.contains(word), "{word} is cut off: {shown}");
        }
        assert!(shown.contains("node 2: limit cleared"), "{shown}");
        assert_eq!(wrapped("a bb ccc", 4), ["a bb", "ccc"]);
    }
}
