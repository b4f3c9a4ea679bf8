//! The JSON Schemas of the channels. `docs/recording.md` shows them as tables; the names that begin
//! with `foxglove.` are Foxglove's own and known to it.

use serde_json::{Value, json};

fn number(unit: &str) -> Value {
    json!({"type": "number", "description": unit})
}

fn object(properties: Value) -> Value {
    json!({"type": "object", "properties": properties})
}

fn pose() -> Value {
    object(json!({"x": number("m, forward"), "y": number("m, left"),
                  "heading": number("rad, counter-clockwise")}))
}

fn twist() -> Value {
    object(
        json!({"vx": number("m/s, forward"), "vy": number("m/s, left"),
                  "omega": number("rad/s, counter-clockwise")}),
    )
}

fn wheels() -> Value {
    let rate = || number("rad/s, positive rolls the base forward");
    object(
        json!({"front_left": rate(), "front_right": rate(), "rear_left": rate(),
                  "rear_right": rate()}),
    )
}

/// `omnibus.CanFrame`.
pub fn can() -> Value {
    object(json!({
        "id": {"type": "integer", "description": "identifier, 11 bits"},
        "name": {"type": "string", "description": "what the identifier stands for"},
        "data": {"type": "string", "description": "data bytes, hexadecimal"},
        "sent": {"type": "boolean", "description": "true when the recording program sent it"},
    }))
}

/// `omnibus.Group`.
pub fn group() -> Value {
    object(json!({
        "sequence": {"type": "integer", "description": "sequence of the setpoint in this SYNC"},
        "phase": {"type": "string", "description": "idle, starting or running"},
        "command": twist(), "measured": twist(), "pose": pose(), "target": pose(),
        "scale": number("smallest permitted scale of all members, 0 to 1"),
        "strain": number("m/s, largest disagreement of two members"),
        "bus_load": number("share of the last 100 ms, 0 to 1"),
    }))
}

/// `omnibus.Robot`.
pub fn robot() -> Value {
    object(json!({
        "nmt": {"type": "string"}, "state": {"type": "string"},
        "code": {"type": "integer", "description": "limit or fault, 0 for none"},
        "code_name": {"type": "string"},
        "permitted_scale": number("scale its own wheels could follow, 0 to 1"),
        "slip_residual": number("magnitude, rad/s, of what no rigid motion explains"),
        "measured": twist(), "pose": pose(), "wheel_rates": wheels(),
        "yaw_rate": number("rad/s, counter-clockwise, by the gyro where that is used"),
    }))
}

/// `omnibus.Pose`.
pub fn pose_only() -> Value {
    pose()
}

fn time() -> Value {
    object(json!({"sec": {"type": "integer"}, "nsec": {"type": "integer"}}))
}

/// `foxglove.Log`.
pub fn log() -> Value {
    object(json!({
        "timestamp": time(),
        "level": {"type": "integer", "description": "1 debug, 2 info, 3 warning, 4 error, 5 fatal"},
        "message": {"type": "string"}, "name": {"type": "string"}, "file": {"type": "string"},
        "line": {"type": "integer"},
    }))
}

/// `foxglove.FrameTransforms`.
pub fn transforms() -> Value {
    let xyz = || object(json!({"x": number("m"), "y": number("m"), "z": number("m")}));
    let turn = object(json!({"x": number(""), "y": number(""), "z": number(""), "w": number("")}));
    let one = object(json!({
        "timestamp": time(), "parent_frame_id": {"type": "string"},
        "child_frame_id": {"type": "string"}, "translation": xyz(), "rotation": turn,
    }));
    object(json!({"transforms": {"type": "array", "items": one}}))
}
