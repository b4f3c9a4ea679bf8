//! A path from a CSV file: where the group should be at which time.
//!
//! The first line names the columns, `t,x,y` or `t,x,y,heading` (s, m, m, rad); empty lines and
//! lines that begin with `#` are passed over. Between the rows the path is a natural cubic spline,
//! so that velocity and acceleration are continuous; the path begins and ends in motion if the rows
//! say so, and the drive's ramps take care of that. Headings are as written: from 3.1 to -3.1 is a
//! turn of 6.2.

use std::path::Path;

use kinematics::trajectory::Trajectory;
use kinematics::{Pose, Twist};

/// The farthest from zero that a coordinate may be, in m. Poses are f32 from here on, whose steps
/// are 1 mm there: errors of a drive come out in millimetres.
pub const FARTHEST: f64 = 10_000.0;

/// Why a file gives no path.
#[derive(Debug, thiserror::Error)]
pub enum PathFileError {
    /// It cannot be read.
    #[error("{path}: cannot be read ({problem}); give a .csv file or the name of a curve")]
    Read {
        /// The file.
        path: String,
        /// The system's message.
        problem: String,
    },
    /// A line is wrong.
    #[error("{path}, line {line}: {problem}")]
    Line {
        /// The file.
        path: String,
        /// Counted from 1.
        line: usize,
        /// What is wrong and what to write instead.
        problem: String,
    },
}

/// A path through the rows of a file.
#[derive(Clone, Debug)]
pub struct Spline {
    times: Vec<f64>,
    x: Column,
    y: Column,
    heading: Column,
}

/// Values and second derivatives at the times.
#[derive(Clone, Debug)]
struct Column {
    values: Vec<f64>,
    bends: Vec<f64>,
}

impl Column {
    /// The natural spline: no bend at the ends, and slopes that agree in between (a tridiagonal
    /// system).
    fn through(times: &[f64], values: Vec<f64>) -> Self {
        let count = values.len();
        let (mut upper, mut right) = (vec![0.0; count], vec![0.0; count]);
        for n in 1..count - 1 {
            let (before, after) = (times[n] - times[n - 1], times[n + 1] - times[n]);
            let slopes = (values[n + 1] - values[n]) / after - (values[n] - values[n - 1]) / before;
            let pivot = 2.0 * (before + after) - before * upper[n - 1];
            upper[n] = after / pivot;
            right[n] = (6.0 * slopes - before * right[n - 1]) / pivot;
        }
        let mut bends = vec![0.0; count];
        for n in (1..count - 1).rev() {
            bends[n] = right[n] - upper[n] * bends[n + 1];
        }
        Self { values, bends }
    }

    /// Value and slope in the span that begins at row `n`, `time` s.
    fn at(&self, times: &[f64], n: usize, time: f64) -> (f64, f64) {
        let width = times[n + 1] - times[n];
        let (a, b) = (times[n + 1] - time, time - times[n]);
        let (v, w) = (self.values[n], self.values[n + 1]);
        let (p, q) = (self.bends[n], self.bends[n + 1]);
        let value = (p * a.powi(3) + q * b.powi(3)) / (6.0 * width)
            + (v / width - p * width / 6.0) * a
            + (w / width - q * width / 6.0) * b;
        let slope =
            (q * b * b - p * a * a) / (2.0 * width) + (w - v) / width - (q - p) * width / 6.0;
        (value, slope)
    }
}

impl Trajectory<f64> for Spline {
    fn at(&self, time: f64) -> (Pose<f64>, Twist<f64>) {
        let time = (time + self.times[0]).clamp(self.times[0], self.times[self.times.len() - 1]);
        let after = self.times.partition_point(|t| *t <= time);
        let n = after.saturating_sub(1).min(self.times.len() - 2);
        let at = |column: &Column| column.at(&self.times, n, time);
        let ((x, vx), (y, vy), (heading, omega)) = (at(&self.x), at(&self.y), at(&self.heading));
        (Pose::new(x, y, heading), Twist::new(vx, vy, omega))
    }

    fn duration(&self) -> f64 {
        self.times[self.times.len() - 1] - self.times[0]
    }
}

/// Reads a file.
///
/// # Errors
/// Names file and line.
pub fn read(path: &Path) -> Result<Spline, PathFileError> {
    let name = path.display().to_string();
    let text = group::input::text(path).map_err(|error| PathFileError::Read {
        path: name.clone(),
        problem: error.to_string(),
    })?;
    parse(&text).map_err(|(line, problem)| PathFileError::Line {
        path: name,
        line,
        problem,
    })
}

fn parse(text: &str) -> Result<Spline, (usize, String)> {
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(n, line)| (n + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let (at, head) = lines.next().ok_or((1, "the file is empty".to_owned()))?;
    let names: Vec<&str> = head.split(',').map(str::trim).collect();
    let turns = match names[..] {
        ["t", "x", "y"] => false,
        ["t", "x", "y", "heading"] => true,
        _ => {
            let problem = format!("the columns are '{head}'; they must be t,x,y or t,x,y,heading");
            return Err((at, problem));
        }
    };
    let mut columns: [Vec<f64>; 4] = Default::default();
    let mut last = 1;
    for (at, line) in lines {
        let fields: Vec<&str> = line.split(',').collect();
        if fields.len() != names.len() {
            let problem = format!(
                "the row has {} fields, the header has {}",
                fields.len(),
                names.len()
            );
            return Err((at, problem));
        }
        for ((column, name), field) in columns.iter_mut().zip(&names).zip(&fields) {
            let value = field.trim().parse::<f64>().ok().filter(|v| v.is_finite());
            let value = value.ok_or_else(|| (at, format!("{name}: '{field}' is not a number")))?;
            if ["x", "y"].contains(name) && value.abs() > FARTHEST {
                let problem = format!(
                    "{name}: {} m is farther than {FARTHEST} m from zero; move the path nearer to \
                     its origin",
                    field.trim()
                );
                return Err((at, problem));
            }
            column.push(value);
        }
        if !turns {
            columns[3].push(0.0);
        }
        let times = &columns[0];
        if let [.., before, now] = times[..]
            && now <= before
        {
            return Err((at, format!("t: {now} is not later than {before}")));
        }
        last = at;
    }
    if columns[0].len() < 3 {
        return Err((last, "a path has at least three rows".into()));
    }
    let [times, x, y, heading] = columns;
    Ok(Spline {
        x: Column::through(&times, x),
        y: Column::through(&times, y),
        heading: Column::through(&times, heading),
        times,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A natural spline through three points has a closed form: for 0, 1, 0 at 0, 1, 2 s the bend
    /// in the middle is -3, and the first span is 1.5 t - 0.5 t^3.
    #[test]
    fn three_points_are_the_spline_of_the_textbook() {
        let path = parse("t,x,y\n# a bump\n0,0,0\n1,1,0\n\n2,0,0\n").unwrap();
        for t in [0.0_f64, 0.25, 0.5, 1.0] {
            let (pose, twist) = path.at(t);
            assert!((pose.x - (1.5 * t - 0.5 * t.powi(3))).abs() < 1e-12, "{t}");
            assert!((twist.vx - (1.5 - 1.5 * t * t)).abs() < 1e-12, "{t}");
        }
        assert_eq!(path.duration(), 2.0);
    }

    /// With a byte order mark, and lines that end as on Windows.
    #[test]
    fn a_file_of_a_spreadsheet_is_read() {
        let file = std::env::temp_dir().join(format!("omnibus-sheet-{}.csv", std::process::id()));
        std::fs::write(&file, "\u{FEFF}t,x,y\r\n0,0,0\r\n1,1,0\r\n2,0,0\r\n").unwrap();
        let path = read(&file);
        std::fs::remove_file(&file).unwrap();
        assert_eq!(path.unwrap().times, [0.0, 1.0, 2.0]);
    }

    /// A straight line is a straight line, wherever its time begins.
    #[test]
    fn evenly_moving_rows_give_an_even_motion() {
        let path = parse("t,x,y,heading\n5,0,1,0\n6,0.5,1,0.1\n7,1,1,0.2\n9,2,1,0.4\n").unwrap();
        let (pose, twist) = path.at(2.5);
        assert!((pose.x - 1.25).abs() < 1e-12 && (pose.heading - 0.25).abs() < 1e-12);
        assert!((twist.vx - 0.5).abs() < 1e-12 && (twist.omega - 0.1).abs() < 1e-12);
        assert_eq!(path.duration(), 4.0);
    }

    #[test]
    fn a_dense_circle_comes_out_as_one() {
        let mut text = String::from("t,x,y\n");
        for n in 0..=100 {
            let t = f64::from(n) * 0.1;
            text += &format!("{t},{},{}\n", (t * 0.5).cos(), (t * 0.5).sin());
        }
        let path = parse(&text).unwrap();
        let (pose, twist) = path.at(4.321);
        assert!((pose.x.hypot(pose.y) - 1.0).abs() < 1e-6);
        assert!((twist.vx.hypot(twist.vy) - 0.5).abs() < 1e-5);
    }

    #[test]
    fn what_is_wrong_is_named_by_line() {
        for (text, line, part) in [
            ("", 1, "empty"),
            ("x,y\n", 1, "t,x,y"),
            ("t,x,y\n0,0,0\n1,a,0\n", 3, "x: 'a'"),
            ("t,x,y\n0,0,0\n1,nan,0\n", 3, "is not a number"),
            ("t,x,y\n0,0,0\n1,1e300,0\n", 3, "x: 1e300 m is farther"),
            ("t,x,y\n0,0,0\n\n0,1,0\n", 4, "is not later than"),
            ("t,x,y\n0,0,0\n1,1\n", 3, "2 fields"),
            ("t,x,y\n0,0,0\n1,1,1\n", 3, "three rows"),
        ] {
            let (at, problem) = parse(text).unwrap_err();
            assert_eq!(at, line, "{text}");
            assert!(problem.contains(part), "{problem}");
        }
    }
}
