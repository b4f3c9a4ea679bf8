//! A vehicle's configuration: its identity, its dimensions and limits, and how often it reports.

use crate::message::Identity;

/// A vehicle's configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Configuration {
    /// Whose messages these are.
    pub identity: Identity,
    /// Map on which it begins.
    pub map: String,
    /// What it is like.
    pub physics: Physics,
    /// Its height, m.
    pub height: f64,
    /// How far from a node it may stand where the node says nothing, m.
    pub tolerance: f64,
    /// Longest time between two states, ms.
    pub state_interval_ms: u64,
    /// Time between two visualizations, ms; 0 for none.
    pub visualization_interval_ms: u64,
}

/// A wheel, as the factsheet has it: m, in the axes of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheel {
    /// Place ahead of the origin.
    pub x: f64,
    /// Place left of the origin.
    pub y: f64,
    /// Direction in which it rolls forward, rad.
    pub theta: f64,
    /// Diameter.
    pub diameter: f64,
    /// Width.
    pub width: f64,
}

/// What a vehicle is like.
#[derive(Clone, Debug, PartialEq)]
pub struct Physics {
    /// Name of its kind.
    pub series: String,
    /// m/s.
    pub speed: f64,
    /// rad/s.
    pub turn: f64,
    /// m/s2.
    pub acceleration: f64,
    /// Its outline on the floor, counter-clockwise, m.
    pub outline: Vec<[f64; 2]>,
    /// Its wheels.
    pub wheels: Vec<Wheel>,
}

/// How large a vehicle is, m.
pub(crate) struct Size {
    /// Along its x axis.
    pub length: f64,
    /// Along its y axis.
    pub width: f64,
}

impl Physics {
    /// Size of the outline.
    pub(crate) fn size(&self) -> Size {
        let span = |axis: usize| {
            let all = self
                .outline
                .iter()
                .filter_map(|point| point.get(axis).copied());
            let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            });
            (high - low).max(0.0)
        };
        Size {
            length: span(0),
            width: span(1),
        }
    }
}
