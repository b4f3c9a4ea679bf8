//! The message `order` (6.7), in the spellings of 2.0, 2.1 and 3.0.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::action::Action;

/// An order or an update of one.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Order {
    /// Number of the message.
    pub header_id: u64,
    /// When it was sent.
    pub timestamp: String,
    /// Version of the sender.
    pub version: String,
    /// For whom.
    pub manufacturer: String,
    /// For whom.
    pub serial_number: String,
    /// Which order.
    pub order_id: String,
    /// Which update of it.
    pub order_update_id: u32,
    /// Zones that the order was planned with.
    #[serde(default)]
    pub zone_set_id: Option<String>,
    /// Where to drive, in this order.
    pub nodes: Vec<Node>,
    /// How to drive from each node to the next.
    pub edges: Vec<Edge>,
}

/// A place.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Node {
    /// Its name.
    pub node_id: String,
    /// Its number in the order: even.
    pub sequence_id: u32,
    /// Whether the vehicle may drive there already.
    pub released: bool,
    /// Where it is.
    #[serde(default)]
    pub node_position: Option<NodePosition>,
    /// What is to be done there.
    pub actions: Vec<Action>,
}

/// Where a node is.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct NodePosition {
    /// m.
    pub x: f64,
    /// m.
    pub y: f64,
    /// Heading there, rad.
    #[serde(default)]
    pub theta: Option<f64>,
    /// How far from it the vehicle may be.
    #[serde(default, rename = "allowedDeviationXY", alias = "allowedDeviationXy")]
    pub allowed_deviation_xy: Option<Deviation>,
    /// How far from its heading, rad.
    #[serde(default)]
    pub allowed_deviation_theta: Option<f64>,
    /// Which map.
    pub map_id: String,
}

/// How far from a node the vehicle may be: a radius, or (3.0) an ellipse.
// By way of a `Value`: an untagged enum finds no number in it where a crate of the same build has
// switched on numbers of any precision.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "Value")]
pub enum Deviation {
    /// m.
    Radius(f64),
    /// Half axes in m, and the direction of the first in rad.
    Ellipse {
        /// Semi-major axis, m.
        a: f64,
        /// Semi-minor axis, m.
        b: f64,
        /// Direction of the major axis, rad.
        theta: f64,
    },
}

impl TryFrom<Value> for Deviation {
    type Error = String;

    fn try_from(value: Value) -> Result<Self, String> {
        let number = |value: Option<&Value>| value.and_then(Value::as_f64);
        if let Some(radius) = value.as_f64() {
            return Ok(Self::Radius(radius));
        }
        match (
            number(value.get("a")),
            number(value.get("b")),
            number(value.get("theta")),
        ) {
            (Some(a), Some(b), Some(theta)) => Ok(Self::Ellipse { a, b, theta }),
            _ => Err(format!(
                "{value} is neither a radius in m nor an ellipse with a, b and theta"
            )),
        }
    }
}

impl Deviation {
    /// Whether a place so far away counts as the node. `least` is the vehicle's own tolerance, m.
    #[must_use]
    pub fn holds(self, dx: f64, dy: f64, least: f64) -> bool {
        match self {
            Self::Radius(radius) => dx.hypot(dy) <= radius.max(least),
            Self::Ellipse { a, b, theta } => {
                let (sin, cos) = theta.sin_cos();
                let (along, across) = (cos * dx + sin * dy, cos * dy - sin * dx);
                (along / a.max(least)).hypot(across / b.max(least)) <= 1.0
            }
        }
    }

    /// The largest distance that counts, m.
    #[must_use]
    pub fn largest(self) -> f64 {
        match self {
            Self::Radius(radius) => radius,
            Self::Ellipse { a, b, .. } => a.max(b),
        }
    }
}

/// What an edge's orientation is measured against.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum OrientationType {
    /// The map.
    Global,
    /// The direction of travel.
    #[default]
    Tangential,
}

/// The way from one node to the next.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Edge {
    /// Its name.
    pub edge_id: String,
    /// Its number in the order: odd.
    pub sequence_id: u32,
    /// Whether the vehicle may drive along it already.
    pub released: bool,
    /// The node before it. 3.0 leaves it out.
    #[serde(default)]
    pub start_node_id: Option<String>,
    /// The node after it. 3.0 leaves it out.
    #[serde(default)]
    pub end_node_id: Option<String>,
    /// m/s.
    #[serde(default, alias = "maximumSpeed")]
    pub max_speed: Option<f64>,
    /// Height of the vehicle with its load at most, m.
    #[serde(default, alias = "maximumMobileRobotHeight")]
    pub max_height: Option<f64>,
    /// Height of a load handling device at least, m.
    #[serde(default, alias = "minimumLoadHandlingDeviceHeight")]
    pub min_height: Option<f64>,
    /// Heading on the edge, rad.
    #[serde(default)]
    pub orientation: Option<f64>,
    /// What that is measured against.
    #[serde(default)]
    pub orientation_type: Option<OrientationType>,
    /// For vehicles on lines.
    #[serde(default)]
    pub direction: Option<String>,
    /// Whether the vehicle may turn on the edge.
    #[serde(default)]
    pub rotation_allowed: Option<bool>,
    /// The same in 3.0, the other way round.
    #[serde(default)]
    pub reach_orientation_before_entering: Option<bool>,
    /// rad/s.
    #[serde(default, alias = "maximumRotationSpeed")]
    pub max_rotation_speed: Option<f64>,
    /// The curve to follow.
    #[serde(default)]
    pub trajectory: Option<Trajectory>,
    /// How far the vehicle may leave the curve (2.1). It never does.
    #[serde(default)]
    pub corridor: Option<Value>,
    /// What is to be done on the way.
    pub actions: Vec<Action>,
}

impl Edge {
    /// Whether the vehicle has to turn before it enters the edge.
    #[must_use]
    pub fn turns_before(&self) -> bool {
        self.rotation_allowed == Some(false) || self.reach_orientation_before_entering == Some(true)
    }
}

/// A NURBS curve.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Trajectory {
    /// Degree; 1 where it is missing.
    #[serde(default = "one")]
    pub degree: f64,
    /// Knots; spread evenly and clamped where they are missing (3.0).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knot_vector: Option<Vec<f64>>,
    /// What pulls the curve.
    pub control_points: Vec<ControlPoint>,
}

/// A point that pulls the curve.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct ControlPoint {
    /// m.
    pub x: f64,
    /// m.
    pub y: f64,
    /// How strongly.
    #[serde(default = "one")]
    pub weight: f64,
}

fn one() -> f64 {
    1.0
}
