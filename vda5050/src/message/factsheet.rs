//! The message `factsheet` (6.15): what kind of vehicle it is and what it can do.

use serde_json::{Map, Value, json};

use crate::Version;
use crate::configuration::{Configuration, Physics, Size};
use crate::nurbs::MOST_POINTS;
use crate::validate::MOST_NODES;

/// Names and types.
type Parameters = &'static [(&'static str, &'static str)];

/// What each instant action is called and needs. 3.0 calls the second one otherwise.
const ACTIONS: [(&str, &str, Parameters); 6] = [
    ("startPause", "Stops on the way; the order is kept.", &[]),
    ("stopPause", "Drives on after startPause.", &[]),
    (
        "cancelOrder",
        "Stops on the way and forgets the order.",
        &[],
    ),
    (
        "initPosition",
        "Sets the map and the position of a vehicle that stands still.",
        &[
            ("x", "NUMBER"),
            ("y", "NUMBER"),
            ("theta", "NUMBER"),
            ("mapId", "STRING"),
            ("lastNodeId", "STRING"),
        ],
    ),
    ("stateRequest", "Sends the state.", &[]),
    ("factsheetRequest", "Sends this factsheet.", &[]),
];

/// Optional fields of orders that are used.
const USED: [(&str, &str); 9] = [
    ("order.nodes.nodePosition", "REQUIRED"),
    ("order.nodes.nodePosition.theta", "SUPPORTED"),
    ("order.nodes.nodePosition.allowedDeviationXY", "SUPPORTED"),
    (
        "order.nodes.nodePosition.allowedDeviationTheta",
        "SUPPORTED",
    ),
    ("order.edges.orientation", "SUPPORTED"),
    ("order.edges.orientationType", "SUPPORTED"),
    ("order.edges.trajectory", "SUPPORTED"),
    ("order.edges.maxSpeed", "SUPPORTED"),
    ("order.edges.maxRotationSpeed", "SUPPORTED"),
];

/// The message without its header.
#[must_use]
pub fn body(configuration: &Configuration) -> Map<String, Value> {
    let new = configuration.identity.version == Version::V3_0;
    let physics = &configuration.physics;
    let mut body = Map::new();
    let mut set = |key: &str, value: Value| body.insert(key.into(), value);
    let description = "Robots with mecanum wheels that move as one body";
    let kind = if new {
        json!({"seriesName": physics.series, "seriesDescription": description,
            "mobileRobotKinematics": "OMNIDIRECTIONAL", "mobileRobotClass": "CARRIER",
            "maximumLoadMass": 0.0, "localizationTypes": ["NATURAL"],
            "navigationTypes": ["VIRTUAL_LINE_GUIDED"]})
    } else {
        json!({"seriesName": physics.series, "seriesDescription": description,
            "agvKinematic": "OMNI", "agvClass": "CARRIER", "maxLoadMass": 0.0,
            "localizationTypes": ["NATURAL"], "navigationTypes": ["VIRTUAL_LINE_GUIDED"]})
    };
    set("typeSpecification", kind);
    set("physicalParameters", physical(configuration, new));
    set("protocolLimits", limits(configuration, new));
    set("protocolFeatures", features(new));
    let key = if new {
        "mobileRobotGeometry"
    } else {
        "agvGeometry"
    };
    set(key, geometry(physics, new));
    set(
        "loadSpecification",
        json!({"loadPositions": [], "loadSets": []}),
    );
    if !new {
        // 2.0 asks for a number of parameters here that it does not define.
        set("localizationParameters", json!(0));
    }
    body
}

fn physical(configuration: &Configuration, new: bool) -> Value {
    let (physics, height) = (&configuration.physics, configuration.height);
    let Size { length, width } = physics.size();
    let Physics {
        speed,
        turn,
        acceleration,
        ..
    } = *physics;
    if new {
        json!({"minimumSpeed": 0.0, "maximumSpeed": speed, "minimumAngularSpeed": 0.0,
            "maximumAngularSpeed": turn, "maximumAcceleration": acceleration,
            "maximumDeceleration": acceleration, "minimumHeight": height, "maximumHeight": height,
            "width": width, "length": length})
    } else {
        json!({"speedMin": 0.0, "speedMax": speed, "accelerationMax": acceleration,
            "decelerationMax": acceleration, "heightMin": height, "heightMax": height,
            "width": width, "length": length})
    }
}

fn limits(configuration: &Configuration, new: bool) -> Value {
    let (least, usual) = (0.0, configuration.state_interval_ms as f64 * 1e-3);
    let picture = configuration.visualization_interval_ms as f64 * 1e-3;
    let arrays = json!({"order.nodes": MOST_NODES, "order.edges": MOST_NODES - 1,
        "node.actions": 1, "edge.actions": 0, "trajectory.controlPoints": MOST_POINTS,
        "trajectory.knotVector": MOST_POINTS + crate::nurbs::HIGHEST_DEGREE + 1});
    let longest = crate::message::LONGEST;
    if new {
        json!({"maximumStringLengths": {"maximumMessageLength": longest},
            "maximumArrayLengths": arrays,
            "timing": {"minimumOrderInterval": least, "minimumStateInterval": least,
                "defaultStateInterval": usual, "visualizationInterval": picture}})
    } else {
        json!({"maxStringLens": {"msgLen": longest}, "maxArrayLens": arrays,
            "timing": {"minOrderInterval": least, "minStateInterval": least,
                "defaultStateInterval": usual, "visualizationInterval": picture}})
    }
}

fn features(new: bool) -> Value {
    let optional: Vec<Value> = USED
        .iter()
        .map(|(parameter, support)| json!({"parameter": parameter, "support": support}))
        .collect();
    let actions: Vec<Value> = ACTIONS
        .iter()
        .map(|(kind, description, parameters)| {
            let scopes = match *kind {
                "initPosition" => json!(["INSTANT", "NODE"]),
                _ => json!(["INSTANT"]),
            };
            let kind = match *kind {
                "initPosition" if new => "initializePosition",
                kind => kind,
            };
            let parameters: Vec<Value> = parameters
                .iter()
                .map(|(key, kind)| json!({"key": key, "valueDataType": kind}))
                .collect();
            let mut action = json!({"actionType": kind, "actionDescription": description,
                "actionScopes": scopes, "actionParameters": parameters});
            if let (true, Some(fields)) = (new, action.as_object_mut()) {
                // 3.0.0's schema has these two as strings.
                fields.insert("pauseAllowed".into(), json!("false"));
                fields.insert("cancelAllowed".into(), json!("false"));
            }
            action
        })
        .collect();
    let key = if new {
        "mobileRobotActions"
    } else {
        "agvActions"
    };
    json!({"optionalParameters": optional, key: actions})
}

fn geometry(physics: &Physics, new: bool) -> Value {
    let wheels: Vec<Value> = physics
        .wheels
        .iter()
        .map(|wheel| {
            json!({"type": "MECANUM", "isActiveDriven": true, "isActiveSteered": false,
                "position": {"x": wheel.x, "y": wheel.y, "theta": wheel.theta},
                "diameter": wheel.diameter, "width": wheel.width})
        })
        .collect();
    let points: Vec<Value> = physics
        .outline
        .iter()
        .map(|[x, y]| json!({"x": x, "y": y}))
        .collect();
    let outline = if new {
        json!({"envelope2dId": "group", "vertices": points})
    } else {
        json!({"set": "group", "polygonPoints": points})
    };
    json!({"wheelDefinitions": wheels, "envelopes2d": [outline]})
}
