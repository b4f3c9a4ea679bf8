//! `omnibus group draw`: the group seen from above, as text or as SVG.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Context as _;
use group::{GroupFile, Robot, Wheel};
use kinematics::Pose;

use super::{json, print_json, print_line, refuse_input};

const EXAMPLES: &str = "Examples:
  omnibus group draw groups/tcc-2.toml
  omnibus group draw groups/tcc-2.toml --output tcc-2.svg

The group moves up the page: x is up and y is to the left, as in the file. Wheels show their rollers as seen from above,
so a robot with four equal corners shows an X; the rollers on the floor slant the other way.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The file.
    file: PathBuf,
    /// Writes an SVG file instead of a picture in the terminal; an existing file is replaced.
    #[arg(long, value_name = "FILE.svg")]
    output: Option<PathBuf>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let group = GroupFile::load(&arguments.file)?;
    let Some(path) = &arguments.output else {
        if json() {
            return print_json(&serde_json::json!({"svg": svg(&group)}));
        }
        return print_line(text(&group).trim_end());
    };
    if path.extension().is_none_or(|end| end != "svg") {
        usage!("--output {}: the name must end in .svg", path.display());
    }
    refuse_input("--output", path, &arguments.file, "the group file itself")?;
    omnibus::file::replace(path, svg(&group).as_bytes())
        .with_context(|| format!("cannot write {}", path.display()))?;
    if json() {
        return print_json(&serde_json::json!({"file": path.display().to_string()}));
    }
    print_line(path.display())
}

/// A place in a robot's frame, in the group's.
fn placed(mount: Pose, x: f32, y: f32) -> (f32, f32) {
    let at = mount.compose(Pose::new(x, y, 0.0));
    (at.x, at.y)
}

/// How far the group reaches from its origin: ahead, behind, left, right, m.
fn extent(group: &GroupFile) -> [f32; 4] {
    let mut out = [0.0_f32; 4];
    for robot in &group.robots {
        for wheel in robot.each_wheel() {
            for (dx, dy) in [(1.0, 0.3), (1.0, -0.3), (-1.0, 0.3), (-1.0, -0.3)] {
                let (x, y) = (wheel.x + dx * wheel.radius, wheel.y + dy * wheel.radius);
                let (x, y) = placed(robot.mount, x, y);
                out = [out[0].max(x), out[1].max(-x), out[2].max(y), out[3].max(-y)];
            }
        }
    }
    out
}

/// Columns and rows of a picture in the terminal.
const COLUMNS: usize = 72;
const ROWS: usize = 30;
/// A character is about twice as high as it is wide.
const ASPECT: f32 = 2.0;

/// Characters on a grid of metres.
struct Canvas {
    cells: Vec<Vec<char>>,
    extent: [f32; 4],
    /// Metres a row.
    scale: f32,
}

impl Canvas {
    fn new(extent: [f32; 4]) -> Self {
        let [ahead, behind, left, right] = extent;
        let rows = (ahead + behind) / (ROWS - 1) as f32;
        let columns = (left + right) * ASPECT / (COLUMNS - 1) as f32;
        let scale = rows.max(columns).max(0.02);
        let count = |metres: f32, step: f32| (metres / step).round() as usize + 1;
        let width = count(left + right, scale / ASPECT);
        Self {
            cells: vec![vec![' '; width]; count(ahead + behind, scale)],
            extent,
            scale,
        }
    }

    fn put(&mut self, x: f32, y: f32, text: &str) {
        let row = ((self.extent[0] - x) / self.scale).round();
        let column = ((self.extent[2] - y) * ASPECT / self.scale).round();
        for (n, c) in text.chars().enumerate() {
            let column = column as usize + n - text.chars().count() / 2;
            let cell = self
                .cells
                .get_mut(row as usize)
                .and_then(|row| row.get_mut(column));
            if let Some(cell) = cell {
                *cell = c;
            }
        }
    }

    fn line(&mut self, from: (f32, f32), to: (f32, f32), c: char) {
        let length = (to.0 - from.0).hypot(to.1 - from.1);
        let steps = (length / self.scale * ASPECT * 2.0).ceil().max(1.0) as usize;
        for step in 0..=steps {
            let share = step as f32 / steps as f32;
            let x = from.0 + share * (to.0 - from.0);
            let y = from.1 + share * (to.1 - from.1);
            self.put(x, y, c.encode_utf8(&mut [0; 4]));
        }
    }
}

/// The group as text.
pub fn text(group: &GroupFile) -> String {
    let mut canvas = Canvas::new(extent(group));
    for robot in &group.robots {
        let corners = robot
            .each_wheel()
            .map(|wheel| placed(robot.mount, wheel.x, wheel.y));
        let [front_left, front_right, rear_left, rear_right] = corners;
        for (from, to) in [
            (front_left, front_right),
            (rear_left, rear_right),
            (front_left, rear_left),
            (front_right, rear_right),
        ] {
            canvas.line(from, to, '·');
        }
        for wheel in robot.each_wheel() {
            let (x, y) = placed(robot.mount, wheel.x, wheel.y);
            canvas.put(x, y, slant(robot.mount.heading - wheel.roller_angle));
        }
        canvas.put(
            robot.mount.x,
            robot.mount.y,
            &format!("{}{}", arrow(robot.mount.heading), robot.node),
        );
    }
    canvas.put(0.0, 0.0, "+");
    for robot in &group.robots {
        // The origin may be in the middle of a robot, whose number counts more.
        if robot.mount.x.hypot(robot.mount.y) < canvas.scale {
            let label = format!("{}{}", arrow(robot.mount.heading), robot.node);
            canvas.put(robot.mount.x, robot.mount.y, &label);
        }
    }
    let mut out = String::new();
    for row in &canvas.cells {
        let row: String = row.iter().collect();
        let _ = writeln!(out, "{}", row.trim_end());
    }
    let [ahead, behind, left, right] = canvas.extent;
    let _ = write!(
        out,
        "\n{}: {:.2} m long, {:.2} m wide. Up is x, left is y, + the group's origin.\n",
        group.name,
        ahead + behind,
        left + right
    );
    for robot in &group.robots {
        let mount = robot.mount;
        let _ = writeln!(
            out,
            "{} node {}: x {:+.3} m, y {:+.3} m, heading {:+.1} degrees",
            arrow(mount.heading),
            robot.node,
            mount.x,
            mount.y,
            mount.heading.to_degrees()
        );
    }
    out
}

/// Which of the arrows shows a heading; 0 is up.
fn arrow(heading: f32) -> char {
    let eighth = (heading / std::f32::consts::FRAC_PI_4).round() as i32;
    ['↑', '↖', '←', '↙', '↓', '↘', '→', '↗'][eighth.rem_euclid(8) as usize]
}

/// A roller's axle as a character: the wheel's axle lies across the page where the robot faces up.
fn slant(angle: f32) -> &'static str {
    let eighth = (angle / std::f32::consts::FRAC_PI_4).round() as i32;
    match eighth.rem_euclid(4) {
        0 => "─",
        1 => "╱",
        2 => "│",
        _ => "╲",
    }
}

/// Pixels of the longer side of the drawing, and around it.
const SIDE: f32 = 640.0;
const MARGIN: f32 = 60.0;

/// The group as SVG: x up, y left.
fn svg(group: &GroupFile) -> String {
    let [ahead, behind, left, right] = extent(group);
    let scale = SIDE / (ahead + behind).max(left + right);
    let width = (left + right) * scale + 2.0 * MARGIN;
    let height = (ahead + behind) * scale + 2.0 * MARGIN + 30.0;
    // Metres of the group frame to pixels.
    let at = |x: f32, y: f32| (MARGIN + (left - y) * scale, MARGIN + (ahead - x) * scale);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" \
         width=\"{width:.0}\" height=\"{height:.0}\" font-family=\"system-ui, sans-serif\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
    );
    for robot in &group.robots {
        robot_svg(&mut out, robot, scale, at(robot.mount.x, robot.mount.y));
    }
    let (x, y) = at(0.0, 0.0);
    let _ = write!(
        out,
        "<g stroke=\"#c2410c\" stroke-width=\"2\" fill=\"none\">\
         <path d=\"M{x:.1} {y:.1}V{:.1}m-5 9l5 -9l5 9M{x:.1} {y:.1}H{:.1}m9 -5l-9 5l9 5\"/></g>\n\
         <g fill=\"#c2410c\" font-size=\"15\"><text x=\"{:.1}\" y=\"{:.1}\">x</text>\
         <text x=\"{:.1}\" y=\"{:.1}\">y</text></g>\n",
        y - 44.0,
        x - 44.0,
        x + 8.0,
        y - 38.0,
        x - 44.0,
        y + 18.0
    );
    bar_svg(&mut out, scale, height - 28.0);
    let name = chart::page::escape(&group.name);
    let _ = write!(
        out,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" font-size=\"14\" fill=\"#334155\">\
         {name}: {:.2} m long, {:.2} m wide</text>\n</svg>\n",
        width - 12.0,
        height - 16.0,
        ahead + behind,
        left + right
    );
    out
}

/// A robot in its own frame, turned and moved: pixels, x up.
fn robot_svg(out: &mut String, robot: &Robot, scale: f32, at: (f32, f32)) {
    let turn = -robot.mount.heading.to_degrees();
    let _ = writeln!(
        out,
        "<g transform=\"translate({:.1} {:.1}) rotate({turn:.2})\">",
        at.0, at.1
    );
    let all = robot.each_wheel();
    let reach = |of: fn(&Wheel) -> f32| {
        all.iter()
            .map(of)
            .fold(0.0_f32, |most, v| most.max(v.abs()))
    };
    let (x, y) = (reach(|w| w.x) * scale, reach(|w| w.y) * scale);
    let inset = all[0].radius * 0.35 * scale;
    let half = (y - inset).max(0.3 * y);
    let _ = writeln!(
        out,
        "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" rx=\"6\" fill=\"#e0ecf8\" \
         stroke=\"#1d4ed8\" stroke-width=\"2\"/>",
        -half,
        -x,
        2.0 * half,
        2.0 * x
    );
    for wheel in &all {
        let (px, py) = (-wheel.y * scale, -wheel.x * scale);
        let (long, wide) = (wheel.radius * scale, wheel.radius * 0.3 * scale);
        let _ = write!(
            out,
            "<g transform=\"translate({px:.1} {py:.1})\"><rect x=\"{:.1}\" y=\"{:.1}\" \
             width=\"{:.1}\" height=\"{:.1}\" rx=\"3\" fill=\"#475569\"/>",
            -wide,
            -long,
            2.0 * wide,
            2.0 * long
        );
        // The rollers seen from above slant the other way than the one on the floor does.
        let (rise, run) = (wide * wheel.roller_angle.tan(), wide);
        for n in -2..=2 {
            let middle = n as f32 * long * 0.38;
            let _ = write!(
                out,
                "<path d=\"M{:.1} {:.1}L{:.1} {:.1}\" stroke=\"#e2e8f0\" stroke-width=\"2.5\"/>",
                -run,
                middle - rise,
                run,
                middle + rise
            );
        }
        out.push_str("</g>\n");
    }
    let tip = -0.55 * x;
    let size = (0.5 * half).clamp(12.0, 30.0);
    let _ = write!(
        out,
        "<path d=\"M0 {:.1}V{tip:.1}m{:.1} {:.1}l{:.1} {:.1}l{:.1} {:.1}\" stroke=\"#1d4ed8\" \
         stroke-width=\"3\" fill=\"none\"/>\n\
         <text transform=\"translate(0 {:.1}) rotate({:.2})\" text-anchor=\"middle\" \
         dominant-baseline=\"central\" font-size=\"{size:.0}\" font-weight=\"600\" \
         fill=\"#0f172a\">{}</text></g>\n",
        -0.05 * x,
        -0.12 * x,
        0.14 * x,
        0.12 * x,
        -0.14 * x,
        0.12 * x,
        0.14 * x,
        0.35 * x,
        -turn,
        robot.node
    );
}

/// A bar of a round length.
fn bar_svg(out: &mut String, scale: f32, y: f32) {
    let metres = [5.0, 2.0, 1.0, 0.5, 0.2, 0.1];
    let fits = |metres: &&f32| **metres * scale <= SIDE / 4.0;
    let metres = metres.iter().find(fits).copied().unwrap_or(0.05);
    let _ = writeln!(
        out,
        "<g stroke=\"#334155\" stroke-width=\"2\"><path d=\"M20 {y:.1}v8h{:.1}v-8\" fill=\"none\"/>\
         </g><text x=\"{:.1}\" y=\"{:.1}\" font-size=\"14\" fill=\"#334155\">{metres} m</text>",
        metres * scale,
        28.0 + metres * scale,
        y + 12.0
    );
}
