//! The seven configurations of figure 19 on the moves the paper drives them on (its figures 20 to
//! 30).
//!
//! On the contact plant every wheel begins at a different roller phase, because two identical free
//! robots would never drift apart in a simulation. The paper prints no numbers here, but reports
//! observations: the distance between free robots changes and their centre drifts farther;
//! connected robots lose as much as a single one.

use chart::{Chart, PALETTE, Series, Stroke};
use kinematics::trajectory::{Circle, FigureEight, Harmonic, Ramped, Trajectory, Turn};
use kinematics::{Formation, MountError, Pose};

use super::drive::{Job, Point, displacement_error, drive_all, extent};
use super::page::map;
use super::robots::{SPACING, virtual_robots};
use super::tables::{RAMP, columns, forward, right};
use super::{OnPlant, Parts, Row, Setting};
use crate::error::SimError;

/// A configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Side by side, connected.
    Scc2,
    /// Side by side, free.
    Suc2,
    /// Tandem, connected.
    Tcc2,
    /// Tandem, free.
    Tuc2,
    /// Three in tandem, connected.
    Tcc3,
    /// At an angle, free.
    Auc2,
    /// At an angle, connected.
    Acc2,
}

/// A move, and whether the robots compensate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Move {
    /// Five turns on the spot.
    Spot,
    Circle,
    Eight,
    Harmonic,
}

/// Turns on the spot.
const TURNS: f64 = 5.0;

impl Kind {
    /// Name, places, whether connected.
    fn group(self) -> Result<(&'static str, Vec<Pose>, bool), MountError> {
        fn of<const M: usize>(c: &Formation<M>) -> (&'static str, Vec<Pose>, bool) {
            (
                c.name,
                c.mounts.iter().map(|m| m.pose()).collect(),
                c.connected,
            )
        }
        Ok(match self {
            Self::Scc2 => of(&Formation::<2>::scc_2(SPACING)?),
            Self::Suc2 => of(&Formation::<2>::suc_2(SPACING)?),
            Self::Tcc2 => of(&Formation::<2>::tcc_2(SPACING)?),
            Self::Tuc2 => of(&Formation::<2>::tuc_2(SPACING)?),
            Self::Tcc3 => of(&Formation::<3>::tcc_3(SPACING)?),
            Self::Auc2 => of(&Formation::<2>::auc_2(SPACING)?),
            Self::Acc2 => of(&Formation::<2>::acc_2(SPACING)?),
        })
    }

    /// What the paper drives it on: figures 20, 23, 25, 28 and, compensated, 30.
    fn moves(self) -> Vec<(Move, bool)> {
        let plain = |moves: &[Move]| moves.iter().map(|m| (*m, false)).collect::<Vec<_>>();
        match self {
            Self::Scc2 | Self::Tcc2 => plain(&[Move::Spot, Move::Eight, Move::Harmonic]),
            Self::Suc2 | Self::Tuc2 => {
                plain(&[Move::Spot, Move::Circle, Move::Eight, Move::Harmonic])
            }
            Self::Auc2 => plain(&[Move::Circle, Move::Eight, Move::Harmonic]),
            Self::Tcc3 => vec![
                (Move::Spot, false),
                (Move::Circle, false),
                (Move::Circle, true),
                (Move::Eight, false),
                (Move::Eight, true),
                (Move::Harmonic, false),
                (Move::Harmonic, true),
            ],
            Self::Acc2 => vec![
                (Move::Circle, false),
                (Move::Circle, true),
                (Move::Eight, false),
                (Move::Eight, true),
            ],
        }
    }
}

impl Move {
    fn name(self) -> &'static str {
        match self {
            Self::Spot => "on the spot",
            Self::Circle => "circle",
            Self::Eight => "figure-eight",
            Self::Harmonic => "harmonic",
        }
    }

    fn motion(self) -> Box<dyn Trajectory<f64> + Send + Sync> {
        match self {
            Self::Spot => {
                let omega = std::f64::consts::FRAC_PI_6;
                let turn = Turn {
                    omega,
                    duration: TURNS * std::f64::consts::TAU / omega,
                };
                Box::new(Ramped::new(turn, RAMP))
            }
            Self::Circle => Box::new(Ramped::new(Circle::paper(), RAMP)),
            Self::Eight => Box::new(Ramped::new(FigureEight::paper(), RAMP)),
            Self::Harmonic => {
                let harmonic = Harmonic {
                    amplitude: 1.0,
                    speed: 0.3,
                    frequency: std::f64::consts::PI / 5.0,
                    periods: 2.0,
                };
                Box::new(Ramped::new(harmonic, RAMP))
            }
        }
    }
}

/// Distance of the first two robots, mm.
fn distance(point: &Point) -> f64 {
    let [a, b, ..] = point.robots.as_slice() else {
        return 0.0;
    };
    (a.x - b.x).hypot(a.y - b.y) * 1e3
}

/// By how much it changes over a drive, mm.
fn distance_change(points: &[Point]) -> f64 {
    let (low, high) = extent(points.iter().map(distance));
    high - low
}

/// How far the group's origin gets from where it began, mm.
fn wandering(points: &[Point]) -> f64 {
    let from = |p: &Point| (p.group.x - p.theory.x).hypot(p.group.y - p.theory.y) * 1e3;
    points.iter().map(from).fold(0.0, f64::max)
}

pub(super) fn run(kind: Kind, setting: &Setting) -> Result<Parts, SimError> {
    let plants = setting.plants(&[OnPlant::Contact]);
    let (name, mounts, connected) = kind.group().map_err(SimError::wheels)?;
    let moves = kind.moves();
    let mut jobs = Vec::new();
    for (movement, compensation) in &moves {
        for plant in &plants {
            let mut file = virtual_robots(name, &mounts, connected, *plant)?;
            file.simulation.contact.scattered = *plant == OnPlant::Contact;
            jobs.push(Job {
                file,
                motion: movement.motion(),
                compensation: *compensation,
            });
        }
    }
    let drives = drive_all(&jobs, &setting.backend)?;
    let mut parts = Parts {
        columns: columns(&plants),
        notes: vec![format!(
            "Robots {SPACING} m apart, which the paper does not say; rollers in random phase on \
             the contact plant. The paper prints no numbers for groups: Table 6 has a single \
             robot's circle (-3.48, -0.14) and figure-eight (-2.92, -0.28)."
        )],
        ..Parts::default()
    };
    for ((movement, compensation), drives) in moves.iter().zip(drives.chunks(plants.len())) {
        let word = if *compensation { ", compensated" } else { "" };
        let mut row = |what: &str, unit, value: &dyn Fn(&[Point]) -> f64| {
            parts.rows.push(Row {
                what: format!("{}{word}: {what}", movement.name()),
                unit,
                paper: None,
                ours: drives.iter().map(|points| value(points)).collect(),
            });
        };
        if *movement == Move::Spot {
            row("centre wanders, largest", "mm", &wandering);
        } else {
            row("x error", "%", &|p| {
                displacement_error(p, right).unwrap_or(f64::NAN)
            });
            row("y error", "%", &|p| {
                displacement_error(p, forward).unwrap_or(f64::NAN)
            });
        }
        row("distance of the robots changes by", "mm", &distance_change);
        let paths = plants
            .iter()
            .zip(drives)
            .map(|(plant, points)| (format!("{} plant", plant.name()), points.as_slice()));
        let title = format!("{name}, {}{word}", movement.name());
        parts.charts.push(map(&title, paths));
        if !connected {
            let line = |(n, points): (usize, &Vec<Point>)| Series {
                label: format!("{} plant", plants[n].name()),
                color: Some(PALETTE[n]),
                stroke: Stroke::Line,
                points: points.iter().map(|p| (p.t, distance(p))).collect(),
            };
            parts.charts.push(Chart {
                title: format!("{title}: distance of the robots"),
                x_label: "time / s".into(),
                y_label: "distance / mm".into(),
                size: (520, 300),
                equal_axes: false,
                series: drives.iter().enumerate().map(line).collect(),
                outlines: vec![],
            });
        }
    }
    Ok(parts)
}
