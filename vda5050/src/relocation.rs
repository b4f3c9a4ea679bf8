//! The action `initPosition` (6.8.1), called `initializePosition` in 3.0: at once, or on a node.
//!
//! On a node the action is executed when the vehicle stands there: the drive ends at the node, the
//! action sets the vehicle's position and map, and the drive continues from there. The rest of the
//! order is in the coordinates of that map, for example after a lift.

use kinematics::Pose;
use serde_json::Value;

use crate::error::{ErrorKind, Refusal};
use crate::leg::Leg;
use crate::message::action::Action;
use crate::message::order::{Node, NodePosition};

/// Whether an action is this one.
#[must_use]
pub fn is_relocation(action: &Action) -> bool {
    matches!(
        action.action_type.as_str(),
        "initPosition" | "initializePosition"
    )
}

/// The pose that an initPosition gives a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// m, m, rad on the map.
    pub pose: Pose<f64>,
    /// Which map.
    pub map: String,
    /// Which node that is, where it is said.
    pub last_node: Option<String>,
}

impl Place {
    /// Reads the parameters.
    ///
    /// # Errors
    /// With the parameter and what is wrong with it.
    pub fn of(action: &Action) -> Result<Self, String> {
        let kind = &action.action_type;
        let number = |key: &str| {
            let value = action.parameter(key).and_then(Value::as_f64);
            let value = value.filter(|value| value.abs() <= 1e6);
            value.ok_or_else(|| format!("{kind}: {key} is missing or not a number"))
        };
        let text = |key: &str| {
            let text = action.parameter(key).and_then(Value::as_str);
            text.filter(|text| !text.is_empty()).map(str::to_owned)
        };
        let pose = Pose::new(number("x")?, number("y")?, number("theta")?);
        if pose.heading.abs() > std::f64::consts::PI + 1e-6 {
            return Err(format!("{kind}: theta must lie between -pi and pi"));
        }
        let map = text("mapId").ok_or_else(|| format!("{kind}: mapId is missing or no text"))?;
        let last_node = text("lastNodeId");
        Ok(Self {
            pose,
            map,
            last_node,
        })
    }

    /// The same as the position of a node.
    #[must_use]
    pub fn position(&self) -> NodePosition {
        NodePosition {
            x: self.pose.x,
            y: self.pose.y,
            theta: None,
            allowed_deviation_xy: None,
            allowed_deviation_theta: None,
            map_id: self.map.clone(),
        }
    }
}

/// The action on a node, and what is driven after it.
#[derive(Clone, Debug)]
pub struct Relocation {
    /// Number of the node.
    pub sequence: u32,
    /// Identifier and type of the action.
    pub action: (String, String),
    /// Where the vehicle is then.
    pub place: Place,
    /// Whether the order begins with it.
    pub first: bool,
    /// The way from there.
    pub legs: Vec<Leg>,
}

impl Relocation {
    /// What a node asks for.
    ///
    /// # Errors
    /// When the node has another action, or more than one.
    pub fn on(node: &Node) -> Result<Option<Self>, Refusal> {
        let name = &node.node_id;
        let wrong = |action: &Action, sentence: String| {
            Refusal::new(
                ErrorKind::InvalidOrderAction,
                format!("node {name}: {sentence}"),
            )
            .about("actionId", &action.action_id)
            .about("actionType", &action.action_type)
        };
        if let Some(other) = node.actions.iter().find(|action| !is_relocation(action)) {
            let sentence = format!(
                "action {}; this vehicle drives, and on nodes its one action is initPosition",
                other.action_type
            );
            return Err(wrong(other, sentence));
        }
        let [action] = node.actions.as_slice() else {
            return match node.actions.get(1) {
                None => Ok(None),
                Some(second) => Err(wrong(second, "there is more than one initPosition".into())),
            };
        };
        let place = Place::of(action).map_err(|why| wrong(action, why))?;
        Ok(Some(Self {
            sequence: node.sequence_id,
            action: (action.action_id.clone(), action.action_type.clone()),
            place,
            first: false,
            legs: Vec::new(),
        }))
    }
}
