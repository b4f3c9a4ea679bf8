//! The messages `state` (6.10) and `visualization` (6.13), as each version has them.

use kinematics::{Pose, Twist};
use serde_json::{Map, Value, json};

use crate::Version;
use crate::error::Refusal;
use crate::leg::wrapped;
use crate::message::order::{Edge, Node};

/// How far an action is (6.11).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionStatus {
    /// Its node is still ahead.
    Waiting,
    /// It is being done.
    Running,
    /// It is done.
    Finished,
    /// It could not be done.
    Failed,
}

/// An action that was received.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActionState {
    /// Its identifier.
    pub id: String,
    /// What is to be done.
    pub kind: String,
    /// How far it is.
    pub status: ActionStatus,
    /// The result.
    pub result: Option<String>,
    /// Whether it stands on a node of an order, and was not sent at once.
    pub ordered: bool,
}

/// Who controls the vehicle (6.10.6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OperatingMode {
    /// The fleet control.
    #[default]
    Automatic,
    /// A person by hand.
    Manual,
    /// Another program on its bus.
    Service,
}

/// An error of the vehicle itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VehicleError {
    /// Its name.
    pub kind: String,
    /// The same for people.
    pub sentence: String,
    /// Whether a person has to see to it before the vehicle drives on.
    pub fatal: bool,
    /// Where, as key and value.
    pub references: Vec<(String, String)>,
}

/// All that a state says.
#[derive(Clone, Debug)]
pub struct State<'a> {
    /// Current order, or the last one.
    pub order_id: &'a str,
    /// Its update.
    pub order_update_id: u32,
    /// Last node that was reached.
    pub last_node: (&'a str, u32),
    /// Nodes ahead.
    pub nodes: Vec<&'a Node>,
    /// Edges ahead.
    pub edges: Vec<&'a Edge>,
    /// Whether it moves.
    pub driving: bool,
    /// Whether it is paused.
    pub paused: bool,
    /// Whether more of the order should be released now.
    pub new_base_request: bool,
    /// Where it is, and on which map; `None` where that is not known.
    pub position: Option<Pose<f64>>,
    /// Map.
    pub map: &'a str,
    /// How fast it moves, in its own axes.
    pub velocity: Option<Twist<f64>>,
    /// Actions that were received at once.
    pub actions: &'a [ActionState],
    /// Whether its supply is fine.
    pub supply_good: bool,
    /// Who controls it.
    pub mode: OperatingMode,
    /// Whether an emergency stop is active.
    pub emergency_stop: bool,
    /// What was refused.
    pub refusals: &'a [Refusal],
    /// What is wrong with the vehicle.
    pub errors: &'a [VehicleError],
}

impl State<'_> {
    /// The message without its header.
    #[must_use]
    pub fn body(&self, version: Version) -> Map<String, Value> {
        let mut body = Map::new();
        let mut set = |key: &str, value: Value| body.insert(key.into(), value);
        let new = version == Version::V3_0;
        set("orderId", json!(self.order_id));
        set("orderUpdateId", json!(self.order_update_id));
        set("lastNodeId", json!(self.last_node.0));
        set("lastNodeSequenceId", json!(self.last_node.1));
        set(
            "nodeStates",
            self.nodes.iter().map(|node| node_state(node)).collect(),
        );
        set(
            "edgeStates",
            self.edges.iter().map(|edge| edge_state(edge)).collect(),
        );
        set("driving", json!(self.driving));
        set("paused", json!(self.paused));
        set("newBaseRequest", json!(self.new_base_request));
        let actions = |wanted: &dyn Fn(&ActionState) -> bool| -> Value {
            let actions = self.actions.iter().filter(|action| wanted(action));
            actions
                .map(|action| action_state(action, version))
                .collect()
        };
        if new {
            set("actionStates", actions(&|action| action.ordered));
            set("instantActionStates", actions(&|action| !action.ordered));
        } else {
            set("actionStates", actions(&|_| true));
        }
        let charge = if self.supply_good { 80.0 } else { 20.0 };
        if new {
            set(
                "powerSupply",
                json!({"stateOfCharge": charge, "charging": false}),
            );
        } else {
            set(
                "batteryState",
                json!({"batteryCharge": charge, "charging": false}),
            );
        }
        set("operatingMode", json!(self.mode_name()));
        set("errors", self.all_errors(version));
        set("information", json!([]));
        let stop = if self.emergency_stop {
            "MANUAL"
        } else {
            "NONE"
        };
        let key = if new { "activeEmergencyStop" } else { "eStop" };
        set("safetyState", json!({key: stop, "fieldViolation": false}));
        body.extend(self.motion(version));
        body
    }

    /// Where it is and how fast it moves: the message `visualization`, and part of the state.
    #[must_use]
    pub fn motion(&self, version: Version) -> Map<String, Value> {
        let mut body = Map::new();
        let pose = self.position.unwrap_or_default();
        let (x, y, theta) = (
            rounded(pose.x),
            rounded(pose.y),
            rounded(wrapped(pose.heading)),
        );
        let known = self.position.is_some();
        let (key, flag) = match version {
            Version::V3_0 => ("mobileRobotPosition", "localized"),
            _ => ("agvPosition", "positionInitialized"),
        };
        let place = json!({"x": x, "y": y, "theta": theta, "mapId": self.map, flag: known});
        body.insert(key.into(), place);
        if let Some(Twist { vx, vy, omega }) = self.velocity {
            let velocity = json!({"vx": rounded(vx), "vy": rounded(vy), "omega": rounded(omega)});
            body.insert("velocity".into(), velocity);
        }
        body
    }

    fn mode_name(&self) -> &'static str {
        match self.mode {
            OperatingMode::Automatic => "AUTOMATIC",
            OperatingMode::Manual => "MANUAL",
            OperatingMode::Service => "SERVICE",
        }
    }

    fn all_errors(&self, version: Version) -> Value {
        let refused = self.refusals.iter().map(|refusal| {
            let kind = refusal.kind;
            let (name, level) = (kind.name(version), kind.level(version));
            error(name, level, &refusal.sentence, &refusal.references)
        });
        let own = self.errors.iter().map(|own| {
            let level = if own.fatal { "FATAL" } else { "WARNING" };
            error(&own.kind, level, &own.sentence, &own.references)
        });
        refused.chain(own).collect()
    }
}

/// Four decimals: a tenth of a millimetre.
fn rounded(value: f64) -> f64 {
    let rounded = (value * 1e4).round() / 1e4;
    // Rounding must not lead beyond pi.
    if rounded.abs() > value.abs() {
        (value * 1e4).trunc() / 1e4
    } else {
        rounded
    }
}

fn error(kind: &str, level: &str, sentence: &str, references: &[(String, String)]) -> Value {
    let references: Vec<Value> = references
        .iter()
        .map(|(key, value)| json!({"referenceKey": key, "referenceValue": value}))
        .collect();
    json!({"errorType": kind, "errorLevel": level, "errorDescription": sentence,
           "errorReferences": references})
}

fn action_state(action: &ActionState, version: Version) -> Value {
    let status = match action.status {
        ActionStatus::Waiting => "WAITING",
        ActionStatus::Running => "RUNNING",
        ActionStatus::Finished => "FINISHED",
        ActionStatus::Failed => "FAILED",
    };
    let mut state =
        json!({"actionId": action.id, "actionType": action.kind, "actionStatus": status});
    if let (Some(result), Some(fields)) = (&action.result, state.as_object_mut()) {
        let key = match version {
            Version::V3_0 => "actionResult",
            _ => "resultDescription",
        };
        fields.insert(key.into(), json!(result));
    }
    state
}

fn node_state(node: &Node) -> Value {
    let mut state = json!({"nodeId": node.node_id, "sequenceId": node.sequence_id,
                           "released": node.released});
    if let (Some(at), Some(fields)) = (&node.node_position, state.as_object_mut()) {
        let mut place = json!({"x": at.x, "y": at.y, "mapId": at.map_id});
        if let (Some(theta), Some(place)) = (at.theta, place.as_object_mut()) {
            place.insert("theta".into(), json!(theta));
        }
        fields.insert("nodePosition".into(), place);
    }
    state
}

fn edge_state(edge: &Edge) -> Value {
    let mut state = json!({"edgeId": edge.edge_id, "sequenceId": edge.sequence_id,
                           "released": edge.released});
    if let (Some(curve), Some(fields)) = (&edge.trajectory, state.as_object_mut()) {
        let points: Vec<Value> = curve
            .control_points
            .iter()
            .map(|point| json!({"x": point.x, "y": point.y, "weight": point.weight}))
            .collect();
        let mut trajectory = json!({"degree": curve.degree, "controlPoints": points});
        if let (Some(knots), Some(fields)) = (&curve.knot_vector, trajectory.as_object_mut()) {
            fields.insert("knotVector".into(), json!(knots));
        }
        fields.insert("trajectory".into(), trajectory);
    }
    state
}
