//! Drives a metre ahead by the messages that a page would send, and records all of it.
//!
//! The text that [`run`] returns has the true pose of the group, each robot's pose, wheel rates and
//! duties every 50 ms, and the log of the bus. The same choice gives the same text on every
//! machine, to the byte: a browser is compared with this machine by it.

use emulator::Firmware;
use serde_json::json;

use crate::choice::Choice;
use crate::playground::Playground;

/// How far, m.
const WAY: f64 = 1.0;
/// How fast, m/s.
const SPEED: f64 = 0.5;
/// Time between two messages of a press, ms.
const REPEAT_MS: u64 = 50;
/// Time after which the drive has failed, ms of virtual time.
const PATIENCE_MS: u64 = 20_000;
/// Time to come to rest, ms.
const REST_MS: u64 = 1_500;

/// Drives a metre with the robots of a choice.
///
/// # Errors
/// When the world cannot be built, or the group does not get there.
pub fn run(choice: &Choice, image: Option<&Firmware>) -> Result<String, String> {
    let mut playground = Playground::new(choice, image)?;
    playground.log_frames();
    let mut samples = Vec::new();
    playground.advance(500);
    for text in [r#"{"type":"take"}"#, r#"{"type":"start"}"#] {
        playground.receive(text);
    }
    // The start runs to its end within one step.
    let started = playground.now_ms() + 1;
    playground.advance(started);
    while playground.world().truth().group.x < WAY {
        let now = playground.now_ms();
        if now > PATIENCE_MS {
            let news = playground.news();
            return Err(format!(
                "the group did not go {WAY} m: {}",
                news["messages"]
            ));
        }
        let drive = json!({"type": "drive", "press": 1, "vx": SPEED, "vy": 0, "omega": 0,
                           "clock": now});
        playground.receive(&drive.to_string());
        playground.advance(now + REPEAT_MS);
        samples.push(sample(&mut playground));
    }
    playground.receive(r#"{"type":"release"}"#);
    let until = playground.now_ms() + REST_MS;
    playground.advance(until);
    samples.push(sample(&mut playground));
    let log = String::from_utf8_lossy(&playground.take_log()).into_owned();
    let digest = format!("{:016x}", playground.world().digest());
    let end = playground.now_ms();
    Ok(json!({"end_ms": end, "samples": samples, "digest": digest, "log": log}).to_string())
}

fn sample(playground: &mut Playground) -> serde_json::Value {
    let truth = playground.world().truth();
    let robots = truth.robots.iter().map(|robot| {
        let rates: [f64; 4] = robot.wheel_rates.into();
        let pose = robot.pose;
        json!({"node": robot.node, "pose": [pose.x, pose.y, pose.heading],
               "rates": rates, "duties": robot.duties})
    });
    let group = truth.group;
    json!({"time_ns": truth.time_ns, "pose": [group.x, group.y, group.heading],
           "robots": robots.collect::<Vec<_>>()})
}
