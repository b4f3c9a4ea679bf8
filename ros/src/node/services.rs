//! The services: their calls, the time at which each was made, and their replies.
//!
//! [`Servers::calls`] yields the calls of all services; [`Called::pass`] passes one on and sends
//! its reply. The servers of `ros2-client` would do that, too, but they do not tell when a call was
//! made. Therefore requests and replies are topics here, one reader and one writer a service, with
//! the names and types that ROS 2 gives them.
//!
//! # Old calls
//!
//! A caller retains its calls while it believes that a node that was killed still runs: for the
//! 50 s of a RustDDS participant's lease. RustDDS asks every caller that it discovers for all that
//! it retains, also where neither side asks for durability. A new node therefore receives calls
//! that were made before it began. [`refusal`] recognises them by the time that the caller's
//! middleware sends with every message (InfoTimestamp of RTPS 2.5): those that start robots are
//! refused, those that stop them are followed.
//!
//! # Two forms
//!
//! A reply carries what the caller recognises it by. `rmw_fastrtps` has that in the metadata of
//! both messages (related sample identity of DDS-RPC 1.0), `rmw_cyclonedds` in front of both
//! ([`Headed`]).
//!
//! # Limits
//!
//! A caller's clock that is ahead makes its calls younger, so clocks have to agree.
//! `ros_discovery_info` does not list the writers of replies in the form of `rmw_fastrtps`, because
//! the library lists only its own publishers, and these do not write that identity. ROS finds the
//! services of a node by the readers, which are listed.

use std::pin::Pin;
use std::time::{Duration, Instant, SystemTime};

use futures::stream::{Stream, StreamExt as _, select_all};
use ros2_client::dds::rustdds::no_key::DataWriterCdr;
use ros2_client::dds::rustdds::rpc::SampleIdentity;
use ros2_client::dds::rustdds::{
    DomainParticipant, Publisher as Writers, QosPolicies, SequenceNumber, Timestamp, Topic,
    TopicKind, WriteOptionsBuilder,
};
use ros2_client::{Context, MessageInfo, Node, Publisher, RmwRequestId, Subscription};
use serde::de::{Error as _, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::environment::Services;
use super::{Incoming, NodeError, pin, refused, volatile};

/// How long after its begin a node may receive a call from before it: the lease of a RustDDS
/// participant that was killed, 50 s (`spdp_publish` in RustDDS 0.15.1), and 10 s for delivery.
const RETENTION: Duration = Duration::from_secs(60);

/// What a service is called for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call {
    /// `start`, or `enable` with true.
    Start,
    /// `stop`, or `enable` with false.
    Stop,
    /// `e_stop_trigger`.
    Trigger,
    /// `e_stop_reset`.
    Reset,
}

/// The reply of a service.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Reply {
    /// Whether it was done.
    pub success: bool,
    /// What was done, or why not.
    pub message: String,
}

/// Services by name. `enable` has a truth value in its request, the others have nothing.
const NAMES: [(&str, Option<Call>); 5] = [
    ("start", Some(Call::Start)),
    ("stop", Some(Call::Stop)),
    ("e_stop_trigger", Some(Call::Trigger)),
    ("e_stop_reset", Some(Call::Reset)),
    ("enable", None),
];

/// A request of one byte: none at all has a byte that says nothing, because DDS has no empty
/// structs, and a truth value is one.
///
/// A longer one is refused. It is of another middleware, which puts who asks in front of the
/// message: the first byte would be taken for the truth value.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Request(u8);

/// What may stand behind a request: messages are filled up to four bytes.
const FILLED: usize = 4;

impl<'de> Deserialize<'de> for Request {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Bytes;
        impl<'de> Visitor<'de> for Bytes {
            type Value = Request;

            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("one byte")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut bytes: A) -> Result<Request, A::Error> {
                let first = bytes.next_element()?;
                let first = first.ok_or_else(|| A::Error::invalid_length(0, &self))?;
                // The end of the message is an error here.
                let mut more = || matches!(bytes.next_element::<u8>(), Ok(Some(_)));
                if (0..FILLED).all(|_| more()) {
                    return Err(A::Error::custom("it is longer than a request"));
                }
                Ok(Request(first))
            }
        }
        deserializer.deserialize_tuple(1 + FILLED, Bytes)
    }
}

/// A request or reply in the form of `rmw_cyclonedds` (`cdds_request_header_t` in its
/// `serdata.hpp`): a caller recognises its replies by what stands in front.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Headed<B> {
    /// Who asks.
    guid: u64,
    /// The number of its request.
    sequence: i64,
    body: B,
}

/// The two ends of a service.
enum Ends {
    FastDds(Subscription<Request>, DataWriterCdr<Reply>),
    Cyclone(Subscription<Headed<Request>>, Publisher<Headed<Reply>>),
}

struct Server {
    name: &'static str,
    call: Option<Call>,
    ends: Ends,
}

/// All services.
pub(super) struct Servers {
    servers: Vec<Server>,
    /// Before the first reader was there.
    began: Instant,
}

/// How a call is answered.
enum Answer<'a> {
    FastDds(&'a DataWriterCdr<Reply>, RmwRequestId),
    Cyclone(&'a Publisher<Headed<Reply>>, Headed<()>),
}

/// A call, or a request that is none.
pub(super) struct Called<'a> {
    incoming: Incoming,
    answer: Option<Answer<'a>>,
}

impl Called<'_> {
    /// Passes it on, and sends the reply where there is someone to hear it.
    pub(super) fn pass(self, on: &mut dyn FnMut(Incoming) -> Reply) {
        let reply = on(self.incoming);
        // There may be no room for it. The caller has to call again then, as after a lost message.
        match self.answer {
            Some(Answer::FastDds(writer, to)) => {
                let options = WriteOptionsBuilder::new()
                    .source_timestamp(Timestamp::now())
                    .related_sample_identity(SampleIdentity::from(to))
                    .build();
                let _ = writer.write_with_options(reply, options);
            }
            Some(Answer::Cyclone(writer, to)) => {
                let _ = writer.publish(Headed {
                    guid: to.guid,
                    sequence: to.sequence,
                    body: reply,
                });
            }
            None => {}
        }
    }
}

impl Servers {
    pub(super) fn new(
        context: &Context,
        node: &mut Node,
        services: Services,
    ) -> Result<Self, NodeError> {
        let began = Instant::now();
        let participant = context.domain_participant();
        let writers = participant
            .create_publisher(&QosPolicies::from(volatile()))
            .map_err(|error| refused("replies")(&format_args!("{error:?}")))?;
        let mut servers = Vec::new();
        for (name, call) in NAMES {
            let of = if call.is_some() { "Trigger" } else { "SetBool" };
            let namespace = node.namespace().trim_end_matches('/');
            let request = (format!("rq{namespace}/{name}Request"), "Request");
            let reply = (format!("rr{namespace}/{name}Reply"), "Response");
            let [request, reply] = [request, reply].map(|(topic, part)| {
                let of = format!("std_srvs::srv::dds_::{of}_{part}_");
                create_topic(&participant, topic, of)
            });
            let ends = ends(node, &writers, services, &request?, &reply?)?;
            servers.push(Server { name, call, ends });
        }
        Ok(Self { servers, began })
    }

    /// The calls of all services.
    pub(super) fn calls(&self) -> Pin<Box<dyn Stream<Item = Called<'_>> + '_>> {
        pin(select_all(
            self.servers.iter().map(|server| server.calls(self.began)),
        ))
    }
}

fn create_topic(
    participant: &DomainParticipant,
    name: String,
    of: String,
) -> Result<Topic, NodeError> {
    let what = name.clone();
    participant
        .create_topic(name, of, &QosPolicies::from(volatile()), TopicKind::NoKey)
        .map_err(|error| refused(&what)(&format_args!("{error:?}")))
}

fn ends(
    node: &mut Node,
    writers: &Writers,
    services: Services,
    request: &Topic,
    reply: &Topic,
) -> Result<Ends, NodeError> {
    let ends = match services {
        Services::FastDds => node
            .create_subscription(request, Some(volatile()))
            .and_then(|requests| {
                let qos = QosPolicies::from(volatile());
                let replies = writers.create_datawriter_no_key_cdr(reply, Some(qos))?;
                Ok(Ends::FastDds(requests, replies))
            }),
        Services::Cyclone => node
            .create_subscription(request, Some(volatile()))
            .and_then(|requests| {
                let replies = node.create_publisher(reply, Some(volatile()))?;
                Ok(Ends::Cyclone(requests, replies))
            }),
    };
    ends.map_err(|error| refused("a service")(&format_args!("{error:?}")))
}

impl Server {
    fn calls(&self, began: Instant) -> Pin<Box<dyn Stream<Item = Called<'_>> + '_>> {
        match &self.ends {
            Ends::FastDds(requests, replies) => {
                pin(requests.async_stream().map(move |request| match request {
                    Ok((request, info)) => {
                        let answer = Answer::FastDds(replies, asked(&info));
                        self.called(request, &info, began, answer)
                    }
                    Err(_) => self.foreign(),
                }))
            }
            Ends::Cyclone(requests, replies) => {
                pin(requests.async_stream().map(move |request| match request {
                    Ok((request, info)) => {
                        let to = Headed {
                            guid: request.guid,
                            sequence: request.sequence,
                            body: (),
                        };
                        let answer = Answer::Cyclone(replies, to);
                        self.called(request.body, &info, began, answer)
                    }
                    Err(_) => self.foreign(),
                }))
            }
        }
    }

    fn called<'a>(
        &self,
        request: Request,
        info: &MessageInfo,
        began: Instant,
        answer: Answer<'a>,
    ) -> Called<'a> {
        let call = match (self.call, request) {
            (Some(call), _) => call,
            (None, Request(1)) => Call::Start,
            (None, Request(0)) => Call::Stop,
            (None, Request(_)) => return self.foreign(),
        };
        let made = info.source_timestamp().and_then(|made| {
            let since_1970 = Duration::from_nanos(u64::try_from(made.to_nanos()).ok()?);
            SystemTime::UNIX_EPOCH.checked_add(since_1970)
        });
        let refusal = refusal(call, made, SystemTime::now(), began.elapsed());
        Called {
            incoming: match refusal {
                Some(why) => Incoming::Refused(format!("a call of {} {why}", self.name)),
                None => Incoming::Call(call),
            },
            answer: Some(answer),
        }
    }

    /// A request in the form of another middleware, whose caller hears nothing.
    fn foreign<'a>(&self) -> Called<'a> {
        Called {
            incoming: Incoming::Unreadable(format!(
                "a call of {}, as another middleware makes it; start omnibus ros with the caller's \
                 RMW_IMPLEMENTATION",
                self.name
            )),
            answer: None,
        }
    }
}

/// By what a caller of `rmw_fastrtps` recognises its reply.
fn asked(info: &MessageInfo) -> RmwRequestId {
    // A caller that names no reader of replies recognises the request itself.
    let mut id = info.related_request_id().unwrap_or(RmwRequestId {
        writer_gid: info.publisher_gid(),
        sequence_number: info.sequence_number(),
    });
    // Fast DDS names the reader of replies, and leaves the number to the request's own.
    if id.sequence_number == i64::from(SequenceNumber::UNKNOWN) {
        id.sequence_number = info.sequence_number();
    }
    id
}

/// Why a call is not followed that was made at `made`, by the caller's clock, and has come at
/// `now`, when the node had run for `up`.
///
/// Ages are compared, not times: if this computer's clock is set while the node runs, a new call
/// does not become an old one. A call that says no time is refused for [`RETENTION`]. RTPS does not
/// demand a time, so a caller may never send one, and must not be refused for ever.
fn refusal(call: Call, made: Option<SystemTime>, now: SystemTime, up: Duration) -> Option<String> {
    match (call, made) {
        (Call::Stop | Call::Trigger, _) => None,
        (Call::Start | Call::Reset, Some(made)) => {
            // One of a clock that is ahead has no age.
            let age = now.duration_since(made).unwrap_or_default();
            let older = age.checked_sub(up).filter(|older| !older.is_zero())?;
            Some(format!(
                "is {:.3} s older than this node, or its caller's clock is behind: call again; if \
                 that is refused too, synchronise the clocks",
                older.as_secs_f64()
            ))
        }
        (Call::Start | Call::Reset, None) => {
            let left = RETENTION.checked_sub(up).filter(|left| !left.is_zero())?;
            Some(format!(
                "does not say when it was made, so it may be older than this node: call again in \
                 {:.0} s",
                left.as_secs_f64().ceil()
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use byteorder::LittleEndian;
    use cdr_encoding::from_bytes;

    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// A node that has run for 10 s, at some time.
    const UP: Duration = Duration::from_secs(10);

    fn now() -> SystemTime {
        SystemTime::UNIX_EPOCH + Duration::from_secs(1_800_000_000)
    }

    #[test]
    fn what_starts_robots_is_refused_if_it_is_older_than_the_node() {
        for call in [Call::Start, Call::Reset] {
            let of = |age: Duration| refusal(call, Some(now() - age), now(), UP);
            assert_eq!(of(Duration::ZERO), None);
            assert_eq!(of(UP), None);
            assert!(of(UP + MS).is_some());
            let why = of(UP + Duration::from_secs(3_600)).unwrap();
            assert!(
                why.starts_with("is 3600.000 s older than this node"),
                "{why}"
            );
            assert!(why.contains("clock is behind"), "{why}");
            // The caller's clock is ahead.
            assert_eq!(refusal(call, Some(now() + UP), now(), UP), None);
        }
    }

    #[test]
    fn what_stops_robots_is_followed_whenever_it_was_made() {
        for call in [Call::Stop, Call::Trigger] {
            for made in [None, Some(SystemTime::UNIX_EPOCH), Some(now() + UP)] {
                assert_eq!(refusal(call, made, now(), Duration::ZERO), None);
            }
        }
    }

    #[test]
    fn a_call_without_a_time_is_refused_while_it_may_be_an_old_one() {
        for call in [Call::Start, Call::Reset] {
            let of = |up: Duration| refusal(call, None, now(), up);
            assert!(of(Duration::ZERO).unwrap().ends_with("call again in 60 s"));
            assert!(of(RETENTION - MS).unwrap().ends_with("call again in 1 s"));
            assert_eq!(of(RETENTION), None);
        }
    }

    #[test]
    fn a_request_in_the_form_of_the_other_middleware_is_none() {
        let plain = |bytes: &[u8]| Some(from_bytes::<Request, LittleEndian>(bytes).ok()?.0);
        let headed =
            |bytes: &[u8]| Some(from_bytes::<Headed<Request>, LittleEndian>(bytes).ok()?.0);
        // The byte alone, and filled up to four.
        for request in [&[1][..], &[1, 0, 0, 0]] {
            assert_eq!(plain(request), Some(Request(1)));
            assert_eq!(headed(request), None);
            let mut bytes = vec![7, 0, 0, 0, 0, 0, 0, 1, 2, 0, 0, 0, 0, 0, 0, 0];
            bytes.extend(request);
            assert_eq!(plain(&bytes), None);
            let read = headed(&bytes).unwrap();
            assert_eq!((read.guid, read.sequence), (7 | 1 << 56, 2));
            assert_eq!(read.body, Request(1));
            bytes.extend([0; 4]);
            assert_eq!(headed(&bytes), None, "longer than a request");
        }
        assert_eq!(plain(&[]), None);
    }
}
