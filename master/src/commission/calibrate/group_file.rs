//! The results of a calibration as numbers and lines of a group file.
//!
//! [`rounded`] gives every number the decimals that the file gets. It is applied before the last
//! motions are driven, so file, robots and verification hold the same values. [`rewrite`] changes
//! only these values: all other lines and their comments stay as they are.

use std::path::Path;

use group::{CompensationTable, ContactLag, GroupFile, Robot, Rollers};
use kinematics::VelocityCompensation;
use protocol::compensation::Row;
use toml_edit::{Array, DocumentMut, InlineTable, Item, Table, Value, value};

use super::CalibrateError;

/// Decimals of coefficients and of the hand-over's loss: finer than a robot's 1/32768.
const COEFFICIENT: usize = 5;
/// Decimals of a table's speeds, m/s and rad/s.
const SPEED: usize = 4;
/// Decimals of phases in degrees, and of lags in milliseconds.
const HUNDREDTHS: usize = 2;

/// A number with so many decimals, as TOML reads it back.
fn decimal(number: f64, decimals: usize) -> f64 {
    let text = format!("{number:.decimals$}");
    text.parse().map_or(number, |rounded: f64| rounded + 0.0)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a group file's numbers are held as f32"
)]
fn single(number: f32, decimals: usize) -> f32 {
    decimal(f64::from(number), decimals) as f32
}

/// The same group with the decimals that its file gets.
///
/// # Errors
/// When a rounded coefficient is outside what a robot takes.
pub fn rounded(mut file: GroupFile) -> Result<GroupFile, CalibrateError> {
    file.hand_over_loss = single(file.hand_over_loss, COEFFICIENT);
    // As the file's reader turns milliseconds into seconds.
    let lag = |seconds: f32| single(seconds * 1e3, HUNDREDTHS) * 1e-3;
    file.contact_lag = ContactLag {
        longitudinal: lag(file.contact_lag.longitudinal),
        lateral: lag(file.contact_lag.lateral),
        yaw: lag(file.contact_lag.yaw),
    };
    let constant = |c: &VelocityCompensation| {
        let [x, y, w] = [c.longitudinal(), c.lateral(), c.yaw()].map(|v| single(v, COEFFICIENT));
        VelocityCompensation::new(x, y, w)
            .map_err(|error| CalibrateError::Unusable(error.to_string()))
    };
    let round = |row: &mut Row| {
        *row = Row::new(
            single(row.speed, SPEED),
            single(row.coefficient, COEFFICIENT),
        );
    };
    for robot in &mut file.robots {
        if let Some(rollers) = &mut robot.rollers {
            rollers.compensation = constant(&rollers.compensation)?;
            rollers.phases = rollers.phases.map(|phase| {
                let degrees = decimal(f64::from(phase).to_degrees(), HUNDREDTHS);
                #[expect(clippy::cast_possible_truncation, reason = "a robot holds f32")]
                let phase = degrees.to_radians() as f32;
                phase
            });
            continue;
        }
        robot.compensation = constant(&robot.compensation)?;
        let table = &mut robot.compensation_table;
        let axes = [&mut table.longitudinal, &mut table.lateral, &mut table.yaw];
        axes.into_iter().flatten().for_each(round);
        for row in &mut table.oblique {
            row.speed = single(row.speed, SPEED);
            for coefficient in [&mut row.longitudinal, &mut row.lateral] {
                *coefficient = single(*coefficient, COEFFICIENT);
            }
        }
    }
    Ok(file)
}

fn number(number: f32, decimals: usize) -> Value {
    decimal(f64::from(number), decimals).into()
}

fn rows<const N: usize>(rows: impl Iterator<Item = [f32; N]>) -> Item {
    let rows = rows.map(|row| {
        let numbers = row.into_iter().enumerate();
        let numbers = numbers.map(|(n, v)| number(v, if n == 0 { SPEED } else { COEFFICIENT }));
        Value::Array(numbers.collect::<Array>())
    });
    value(rows.collect::<Array>())
}

/// A `[robot.compensation]` with its table.
fn compensation(constant: &VelocityCompensation, table: &CompensationTable) -> Table {
    let mut out = Table::new();
    out.decor_mut()
        .set_prefix("\n# From `omnibus calibrate`.\n");
    out["longitudinal"] = value(number(constant.longitudinal(), COEFFICIENT));
    out["lateral"] = value(number(constant.lateral(), COEFFICIENT));
    out["yaw"] = value(number(constant.yaw(), COEFFICIENT));
    let mut inner = Table::new();
    inner
        .decor_mut()
        .set_prefix("\n# Achieved speed (m/s, rad/s) and coefficient.\n");
    inner["version"] = value(i64::from(table.version));
    let pairs = |of: &[Row]| rows(of.iter().map(|row| [row.speed, row.coefficient]));
    inner["longitudinal"] = pairs(&table.longitudinal);
    inner["lateral"] = pairs(&table.lateral);
    let oblique = table.oblique.iter();
    inner["oblique"] = rows(oblique.map(|row| [row.speed, row.longitudinal, row.lateral]));
    inner["yaw"] = pairs(&table.yaw);
    out["table"] = Item::Table(inner);
    out
}

/// The `rollers = { ... }` of a robot.
fn rollers(of: &Rollers) -> InlineTable {
    let mut out = InlineTable::new();
    out.insert("count", i64::from(of.count).into());
    let degrees = of
        .phases
        .map(|phase| decimal(f64::from(phase).to_degrees(), HUNDREDTHS));
    out.insert("phases_deg", Value::Array(degrees.into_iter().collect()));
    if let Some(counts) = of.index_tolerance {
        out.insert("index_tolerance", i64::from(counts).into());
    }
    let constant = &of.compensation;
    for (key, coefficient) in [
        ("longitudinal", constant.longitudinal()),
        ("lateral", constant.lateral()),
        ("yaw", constant.yaw()),
    ] {
        out.insert(key, number(coefficient, COEFFICIENT));
    }
    out
}

fn same_compensation(a: &Robot, b: &Robot) -> bool {
    a.compensation == b.compensation && a.compensation_table == b.compensation_table
}

/// Puts a calibration into a group file's document. Robots that share their coefficients share them
/// in `[robot.compensation]`.
fn put(document: &mut DocumentMut, wanted: &GroupFile) -> Option<()> {
    let lag = &wanted.contact_lag;
    if *lag != ContactLag::default() || document.contains_key("contact_lag") {
        let mut table = Table::new();
        table
            .decor_mut()
            .set_prefix("\n# How far the group trails its wheels, from `omnibus calibrate`.\n");
        for (key, seconds) in [
            ("longitudinal_ms", lag.longitudinal),
            ("lateral_ms", lag.lateral),
            ("yaw_ms", lag.yaw),
        ] {
            table[key] = value(number(seconds * 1e3, HUNDREDTHS));
        }
        document["contact_lag"] = Item::Table(table);
    }
    if wanted.robots.iter().any(|robot| robot.rollers.is_some()) {
        let mut table = Table::new();
        table
            .decor_mut()
            .set_prefix("\n# From `omnibus calibrate`.\n");
        table["loss_s_per_m"] = value(number(wanted.hand_over_loss, COEFFICIENT));
        // Its name until version 0.2.
        document.remove("hand_over");
        document["roller_transition"] = Item::Table(table);
    }
    let sliding: Vec<&Robot> = wanted
        .robots
        .iter()
        .filter(|r| r.rollers.is_none())
        .collect();
    let shared = match sliding.as_slice() {
        [first, others @ ..] if others.iter().all(|other| same_compensation(first, other)) => {
            let defaults = document.entry("robot").or_insert(Item::Table(Table::new()));
            let defaults = defaults.as_table_like_mut()?;
            let table = compensation(&first.compensation, &first.compensation_table);
            defaults.insert("compensation", Item::Table(table));
            true
        }
        _ => false,
    };
    let robots = document.get_mut("robots")?.as_array_of_tables_mut()?;
    for (entry, robot) in robots.iter_mut().zip(&wanted.robots) {
        match &robot.rollers {
            Some(known) => {
                entry.remove("rollers");
                entry["rollers"] = value(rollers(known));
            }
            None if shared => {
                entry.remove("compensation");
            }
            None => {
                let table = compensation(&robot.compensation, &robot.compensation_table);
                entry["compensation"] = Item::Table(table);
            }
        }
    }
    Some(())
}

/// The lines that a calibration adds to a group file, for people to read.
#[must_use]
pub fn lines(wanted: &GroupFile) -> String {
    let mut document = DocumentMut::new();
    let mut robots = toml_edit::ArrayOfTables::new();
    for robot in &wanted.robots {
        let mut entry = Table::new();
        entry["node"] = value(i64::from(robot.node));
        robots.push(entry);
    }
    document["robots"] = Item::ArrayOfTables(robots);
    let _ = put(&mut document, wanted);
    if wanted.robots.iter().all(|robot| robot.rollers.is_none()) && document.get("robot").is_some()
    {
        document.remove("robots");
    }
    document.to_string()
}

/// A group file's text with a calibration in it; all else stays as it is.
///
/// # Errors
/// When the file cannot be read, or the result would not say what `wanted` says.
pub fn rewrite(path: &Path, wanted: &GroupFile) -> Result<String, CalibrateError> {
    let problem = |problem: String| CalibrateError::File {
        path: path.display().to_string(),
        problem,
    };
    let text = std::fs::read_to_string(path).map_err(|error| problem(error.to_string()))?;
    let mut document: DocumentMut = text
        .parse()
        .map_err(|e: toml_edit::TomlError| problem(e.to_string()))?;
    let by_hand = || {
        problem(format!(
            "its values are in a form that cannot be replaced; add these lines by hand:\n{}",
            lines(wanted)
        ))
    };
    put(&mut document, wanted).ok_or_else(by_hand)?;
    let out = document.to_string();
    match GroupFile::parse(&path.to_string_lossy(), &out) {
        Ok(parsed) if parsed == *wanted => Ok(out),
        _ => Err(by_hand()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::compensation::ObliqueRow;

    fn rewritten(name: &str, change: impl Fn(&mut GroupFile)) -> (String, String, GroupFile) {
        let source = format!("{}/../groups/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        let before = std::fs::read_to_string(&source).unwrap();
        let mut wanted = GroupFile::load(&source).unwrap();
        change(&mut wanted);
        let wanted = rounded(wanted).unwrap();
        (
            before,
            rewrite(Path::new(&source), &wanted).unwrap(),
            wanted,
        )
    }

    fn table(version: u32) -> CompensationTable {
        CompensationTable {
            version,
            longitudinal: vec![Row::new(0.123_456, 1.012_345_6)],
            lateral: vec![Row::new(0.1, 1.1), Row::new(0.4, 1.12)],
            oblique: vec![ObliqueRow {
                speed: 0.2,
                longitudinal: 1.03,
                lateral: 1.04,
            }],
            yaw: vec![Row::new(0.5, 1.02)],
        }
    }

    #[test]
    fn a_group_file_keeps_everything_but_what_was_calibrated() {
        let (before, after, wanted) = rewritten("tcc-3", |wanted| {
            wanted.contact_lag.lateral = 0.009_123;
            for robot in &mut wanted.robots {
                robot.compensation = VelocityCompensation::new(1.01, 1.1, 1.02).unwrap();
                robot.compensation_table = table(3);
            }
        });
        assert_eq!(
            wanted.robots[0].compensation_table.longitudinal,
            [Row::new(0.1235, 1.01235)]
        );
        let gone: Vec<_> = before.lines().filter(|l| !after.contains(l)).collect();
        assert!(
            gone.len() <= 4,
            "a comment and three coefficients: {gone:?}"
        );
        // A second calibration with the same result changes nothing.
        let path = std::env::temp_dir().join(format!("omnibus-file-{}.toml", std::process::id()));
        std::fs::write(&path, &after).unwrap();
        assert_eq!(rewrite(&path, &wanted).unwrap(), after);
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn robots_that_differ_have_coefficients_of_their_own() {
        let (_, after, wanted) = rewritten("tcc-2", |wanted| {
            for (n, robot) in (1..).zip(&mut wanted.robots) {
                robot.compensation = VelocityCompensation::NONE;
                robot.compensation_table = table(n);
            }
        });
        assert_eq!(wanted.robots[1].compensation_table.version, 2);
        assert_eq!(after.matches("[robots.compensation.table]").count(), 2);
    }

    #[test]
    fn rollers_and_their_loss_are_written() {
        let (_, after, _) = rewritten("single-rollers", |wanted| {
            wanted.hand_over_loss = 0.001_234_5;
            for robot in &mut wanted.robots {
                robot.rollers = Some(Rollers {
                    count: 8,
                    phases: [0.1, -0.2, 0.3, -0.0],
                    index_tolerance: Some(80),
                    compensation: VelocityCompensation::new(1.0, 1.003_217, 1.0).unwrap(),
                });
            }
        });
        for line in [
            "phases_deg = [5.73, -11.46, 17.19, 0.0]",
            "lateral = 1.00322",
        ] {
            assert!(after.contains(line), "{after}");
        }
        assert!(
            after.contains("[roller_transition]\nloss_s_per_m = 0.00123"),
            "{after}"
        );
    }
}
