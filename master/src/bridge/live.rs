//! The group live in Foxglove: its WebSocket protocol, by Foxglove's own library, with the channels
//! and schemas of a recording.
//!
//! A thread takes every frame from the session's telemetry and makes messages of them as a
//! recording does; the library sends them to its subscribers. When it falls behind, the oldest
//! frames are left out. Nothing can be sent from Foxglove to the group.

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::SystemTime;

use canopen::Micros;
use foxglove::{ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, Schema};
use group::GroupFile;

use crate::monitor::telemetry::{BusFrame, Hub, Interest, Telemetry};
use crate::recording::messages::{Message, Messages};

/// Frames that may wait: a second of a full bus.
const WAITING: usize = 8_192;

/// Serves the group at `address` as long as the program runs; returns where.
///
/// # Errors
/// When the address cannot be had.
pub fn serve(address: SocketAddr, hub: &Hub, group: &GroupFile) -> io::Result<SocketAddr> {
    let context = Context::new();
    let server = context
        .websocket_server()
        .name(format!("omnibus: {}", group.name))
        .bind(address.ip().to_string(), address.port())
        .start_blocking()
        .map_err(io::Error::other)?;
    let address = SocketAddr::new(address.ip(), server.port());
    let stream = hub.subscribe(Interest::Frames, WAITING);
    let group = group.clone();
    std::thread::spawn(move || {
        let mut live = Live {
            messages: None,
            channels: BTreeMap::new(),
            context,
        };
        for item in stream {
            if let Telemetry::Frame(frame) = item {
                live.on_frame(&frame, &group);
            }
        }
        server.stop().wait_blocking();
    });
    Ok(address)
}

struct Live {
    messages: Option<Messages>,
    channels: BTreeMap<String, Arc<RawChannel>>,
    context: Arc<Context>,
}

impl Live {
    fn on_frame(&mut self, frame_seen: &BusFrame, group: &GroupFile) {
        let at = micros(frame_seen.t);
        let messages = self.messages.get_or_insert_with(|| {
            let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
            let now_ns = since_1970.map_or(0, |since| since.as_nanos());
            let now_ns = u64::try_from(now_ns).unwrap_or(0);
            Messages::new(now_ns.saturating_sub(at.0 * 1_000), Some(group.clone()))
        });
        let (channels, context) = (&mut self.channels, &self.context);
        let result = messages.frame(at, &frame_seen.frame, frame_seen.sent, &mut |message| {
            send(channels, context, message)
        });
        debug_assert!(result.is_ok(), "a topic has one schema: {result:?}");
    }
}

fn send(
    channels: &mut BTreeMap<String, Arc<RawChannel>>,
    context: &Arc<Context>,
    message: &Message,
) -> Result<(), FoxgloveError> {
    let channel = match channels.get(message.topic) {
        Some(channel) => channel,
        None => {
            let text = (message.schema.text)().to_string();
            let schema = Schema::new(message.schema.name, "jsonschema", text.into_bytes());
            let channel = ChannelBuilder::new(message.topic)
                .message_encoding("json")
                .schema(schema)
                .context(context)
                .build_raw()?;
            channels.entry(message.topic.into()).or_insert(channel)
        }
    };
    let text = message.value.to_string();
    let time = PartialMetadata::with_log_time(message.time_ns);
    channel.log_with_meta(text.as_bytes(), time);
    Ok(())
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "times since the session began, and years fit"
)]
fn micros(t: f64) -> Micros {
    Micros((t * 1e6).round().max(0.0) as u64)
}
