//! A recording as ROS 2 plays it: an MCAP file with `odom`, `tf` and `joint_states` as CDR, whose
//! schemas are the messages' definitions (`ros2msg`).
//!
//! A file of its own, because players of ROS 2 refuse the other channels of a recording. Times are
//! those of the recording's clock; on a simulated bus they begin at 0.

use std::collections::BTreeMap;
use std::io::{self, Seek, Write};

use group::GroupFile;
use mcap::records::MessageHeader;
use mcap::{Compression, McapResult, WriteOptions, Writer};
use ros::message::{self, JointState, Message, TFMessage, Time};
use ros::names::Frames;

use super::Recording;
use crate::ros::messages;
use crate::ros::odometry::Odometry;

/// One topic of the file.
struct Channel {
    id: u16,
    count: u32,
}

/// Writes what is known of the group at every SYNC. Returns how many messages there are.
///
/// # Errors
/// When the output fails, or a message is too long.
pub fn write(recording: &Recording, group: &GroupFile, out: impl Write + Seek) -> io::Result<u64> {
    whole(recording, group, out).map_err(io::Error::other)
}

fn whole(recording: &Recording, group: &GroupFile, out: impl Write + Seek) -> McapResult<u64> {
    let options = WriteOptions::new()
        .compression(Some(Compression::Lz4))
        .profile("ros2")
        .library(concat!("omnibus ", env!("CARGO_PKG_VERSION")));
    let mut file = options.create(out)?;
    let mut odom = channel::<message::Odometry>(&mut file, "/odom")?;
    let mut tf = channel::<TFMessage>(&mut file, "/tf")?;
    let mut joints = channel::<JointState>(&mut file, "/joint_states")?;
    let frames = Frames::new("");
    let mut state = Odometry::new(group);
    let mut count = 0;
    let (snapshots, _) = recording.decode();
    for snapshot in &snapshots {
        state.update(snapshot);
        let time_ns = recording.header.epoch_ns + nanoseconds(snapshot.t);
        let stamp = Time::of_ns(time_ns);
        let (odometry, transforms, wheels) = (
            messages::odometry(&stamp, &frames, &state),
            messages::transforms(&stamp, &frames, &state),
            messages::joints(&stamp, group, &state),
        );
        put(&mut file, &mut odom, time_ns, &odometry)?;
        put(&mut file, &mut tf, time_ns, &transforms)?;
        put(&mut file, &mut joints, time_ns, &wheels)?;
        count += 3;
    }
    file.finish()?;
    Ok(count)
}

fn channel<M: Message>(file: &mut Writer<impl Write + Seek>, topic: &str) -> McapResult<Channel> {
    let schema = file.add_schema(M::TYPE, "ros2msg", message::definition::<M>().as_bytes())?;
    // Empty: players take their own qualities of service.
    let metadata = BTreeMap::from([("offered_qos_profiles".into(), String::new())]);
    let id = file.add_channel(schema, topic, "cdr", &metadata)?;
    Ok(Channel { id, count: 0 })
}

fn put<M: Message + serde::Serialize>(
    file: &mut Writer<impl Write + Seek>,
    channel: &mut Channel,
    time_ns: u64,
    message: &M,
) -> McapResult<()> {
    channel.count = channel.count.wrapping_add(1);
    let header = MessageHeader {
        channel_id: channel.id,
        sequence: channel.count,
        log_time: time_ns,
        publish_time: time_ns,
    };
    let bytes = message::to_cdr(message).map_err(io::Error::other)?;
    file.write_to_known_channel(&header, &bytes)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "positive, and years fit"
)]
fn nanoseconds(t: f64) -> u64 {
    (t * 1e9).round().max(0.0) as u64
}
