//! The connection to the broker: a thread that reads, and a client that writes.
//!
//! The session is kept by the broker (`clean_session` off): what a fleet control sends with quality
//! 1 while the connection is down arrives afterwards. Retained orders and actions are passed over:
//! what a broker kept from an earlier day must not move anything. The last will says
//! CONNECTIONBROKEN.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ::vda5050::message::{Connection as Presence, Identity};
use ::vda5050::{Outgoing, Topic};
use rumqttc::{
    Client, Connection, ConnectionError, Event, LastWill, MqttOptions, Packet, QoS,
    TlsConfiguration, Transport,
};

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject as _;

use super::{delivery, unix_ms};

/// Heartbeat with the broker (6.14).
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// Between two attempts to connect.
const PAUSE: Duration = Duration::from_millis(500);
/// Requests that the client holds.
const HELD: usize = 2_000;
/// Largest packet, in bytes: beyond what is read as a message, so that a large one is refused in
/// words and does not end the connection.
const LARGEST: usize = 16_000_000;
/// How long closing may take.
const PATIENCE: Duration = Duration::from_secs(2);

/// Where the broker is, and how it knows us.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// Whether the connection is encrypted.
    pub tls: bool,
    /// Name or address.
    pub host: String,
    /// Port.
    pub port: u16,
}

impl std::str::FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let usage = "give mqtt://HOST[:PORT], or mqtts://HOST[:PORT] for TLS";
        let (tls, rest) = match (text.strip_prefix("mqtt://"), text.strip_prefix("mqtts://")) {
            (Some(rest), _) => (false, rest),
            (_, Some(rest)) => (true, rest),
            _ => return Err(usage.into()),
        };
        let rest = rest.trim_end_matches('/');
        // An IPv6 address stands in brackets.
        let (host, port) = match rest.rsplit_once(':') {
            Some((host, port)) if !port.contains(']') => {
                (host, port.parse().map_err(|_| usage.to_owned())?)
            }
            _ => (rest, if tls { 8883 } else { 1883 }),
        };
        let host = host.trim_start_matches('[').trim_end_matches(']');
        if host.is_empty() || host.contains(['/', '@']) {
            return Err(usage.into());
        }
        Ok(Self {
            tls,
            host: host.into(),
            port,
        })
    }
}

/// How the broker is reached.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Access {
    /// Where it is.
    pub address: Address,
    /// Certificate of who signed the broker's own, PEM; needed for TLS.
    pub authority: Option<Vec<u8>>,
    /// Name and password.
    pub user: Option<(String, String)>,
}

/// What was heard.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// There is a connection.
    Connected,
    /// There is none, and why.
    Disconnected(String),
    /// A message.
    Message(Topic, Vec<u8>),
}

/// The thread that reads has ended by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the connection to the broker has failed for good; the robots were ramped down and switched off; \
     start the program again"
)]
pub struct ThreadEnded;

/// A connection, or the attempt to have one.
pub struct Broker {
    client: Client,
    identity: Identity,
    inputs: Receiver<Input>,
    /// Whether there has ever been a connection.
    reached: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Broker {
    /// Begins to connect, and goes on for as long as this exists.
    ///
    /// # Errors
    /// When TLS is asked for without what it needs, or the reverse; names the option.
    pub fn connect(access: &Access, identity: &Identity) -> Result<Self, String> {
        let Address { tls, host, port } = &access.address;
        // One broker may have several groups, and each keeps its session.
        let name = format!(
            "{}-{}-{}",
            identity.interface, identity.manufacturer, identity.serial
        );
        let mut options = MqttOptions::new(name, host, *port);
        options.set_keep_alive(KEEP_ALIVE);
        options.set_clean_session(false);
        options.set_max_packet_size(LARGEST, LARGEST);
        let will = identity
            .connection(0, unix_ms(), Presence::Broken)
            .to_string();
        let topic = identity.topic(Topic::Connection.name());
        options.set_last_will(LastWill::new(topic, will, QoS::AtLeastOnce, true));
        if let Some((name, password)) = &access.user {
            options.set_credentials(name, password);
        }
        if *tls {
            let ca = access.authority.clone();
            let ca = ca.ok_or(
                "--broker mqtts://: give --ca FILE.pem, the certificate of the authority that \
                 signed the broker's",
            )?;
            if !CertificateDer::pem_slice_iter(&ca).any(|one| one.is_ok()) {
                return Err(
                    "--ca: the file contains no certificate; give one in PEM format".into(),
                );
            }
            // Another part of the program may have chosen the same already.
            let _ = rustls::crypto::ring::default_provider().install_default();
            options.set_transport(Transport::Tls(TlsConfiguration::Simple {
                ca,
                alpn: None,
                client_auth: None,
            }));
        } else if access.authority.is_some() {
            return Err(
                "--ca: a connection by mqtt:// is not encrypted and checks no certificate; give \
                 --broker mqtts://"
                    .into(),
            );
        }
        let (client, connection) = Client::new(options, HELD);
        let (sink, inputs) = channel();
        let (own, whose) = (client.clone(), identity.clone());
        let reached = Arc::<AtomicBool>::default();
        let seen = Arc::clone(&reached);
        let thread = std::thread::spawn(move || listen(connection, &own, &whose, &sink, &seen));
        Ok(Self {
            client,
            identity: identity.clone(),
            inputs,
            reached,
            thread: Some(thread),
        })
    }

    /// What was heard since, if anything.
    ///
    /// # Errors
    /// When the thread has ended by itself: the library panicked, and nothing will come any more.
    pub fn next(&self) -> Result<Option<Input>, ThreadEnded> {
        match self.inputs.try_recv() {
            Ok(input) => Ok(Some(input)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(ThreadEnded),
        }
    }

    /// Sends a message.
    pub fn send(&self, sent: &Outgoing) {
        let (quality, retained) = delivery(sent.topic);
        let topic = self.identity.topic(sent.topic.name());
        // Full only when the connection has stalled; it ends by its heartbeat then, and the state
        // of the next one says all.
        let _ = self
            .client
            .try_publish(topic, quality, retained, sent.message.to_string());
    }

    /// Says that this is the end, and closes the connection, if there ever was one.
    pub fn close(mut self, last: &Outgoing) {
        if !self.reached.load(Ordering::Relaxed) {
            return;
        }
        self.send(last);
        let _ = self.client.try_disconnect();
        let began = Instant::now();
        if let Some(thread) = self.thread.take() {
            while !thread.is_finished() && began.elapsed() < PATIENCE {
                std::thread::sleep(Duration::from_millis(10));
            }
        }
    }
}

/// Reads until the client disconnects on purpose or its channel has closed.
fn listen(
    mut connection: Connection,
    client: &Client,
    identity: &Identity,
    sink: &Sender<Input>,
    reached: &AtomicBool,
) {
    let topics =
        [Topic::Order, Topic::InstantActions].map(|topic| (topic, identity.topic(topic.name())));
    let mut reported = None;
    for event in connection.iter() {
        let sent = match event {
            Ok(Event::Incoming(Packet::ConnAck(_))) => {
                reported = None;
                reached.store(true, Ordering::Relaxed);
                for (_, topic) in &topics {
                    let _ = client.try_subscribe(topic, QoS::AtLeastOnce);
                }
                sink.send(Input::Connected)
            }
            Ok(Event::Incoming(Packet::Publish(message))) => {
                let topic = topics.iter().find(|(_, name)| *name == message.topic);
                match topic {
                    Some((topic, _)) if !message.retain => {
                        sink.send(Input::Message(*topic, message.payload.to_vec()))
                    }
                    _ => Ok(()),
                }
            }
            Ok(Event::Outgoing(rumqttc::Outgoing::Disconnect)) => return,
            Ok(_) => Ok(()),
            Err(ConnectionError::RequestsDone) => return,
            Err(error) => {
                let why = Some(error.to_string());
                // The same once, not at every attempt.
                let sent = match &why {
                    Some(text) if reported != why => sink.send(Input::Disconnected(text.clone())),
                    _ => Ok(()),
                };
                reported = why;
                std::thread::sleep(PAUSE);
                sent
            }
        };
        if sent.is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity() -> Identity {
        Identity {
            interface: "uagv".into(),
            version: ::vda5050::Version::V2_0,
            manufacturer: "test".into(),
            serial: "1".into(),
        }
    }

    /// What [`Broker::connect`] makes, with another thread.
    fn broker(read: impl FnOnce(Sender<Input>) + Send + 'static) -> Broker {
        let (client, _) = Client::new(MqttOptions::new("test", "localhost", 1883), 10);
        let (sink, inputs) = channel();
        Broker {
            client,
            identity: identity(),
            inputs,
            reached: Arc::default(),
            thread: Some(std::thread::spawn(move || read(sink))),
        }
    }

    #[test]
    fn a_thread_that_ends_by_itself_is_an_error_after_what_it_sent() {
        let mut broker = broker(|sink| {
            sink.send(Input::Connected).unwrap();
            drop(sink);
            panic!("as the library might");
        });
        assert!(broker.thread.take().unwrap().join().is_err());
        assert_eq!(broker.next(), Ok(Some(Input::Connected)));
        assert_eq!(broker.next(), Err(ThreadEnded));
    }

    /// A certificate that is given is meant to be checked, and the password to be encrypted.
    #[test]
    fn a_certificate_is_not_given_in_vain() {
        let access = Access {
            address: "mqtt://127.0.0.1:1".parse().unwrap(),
            authority: Some(b"PEM".to_vec()),
            user: None,
        };
        let refused = Broker::connect(&access, &identity()).err().unwrap();
        assert!(
            refused.starts_with("--ca: ") && refused.contains("mqtts://"),
            "{refused}"
        );
    }

    #[test]
    fn the_end_does_not_wait_for_a_broker_that_was_never_there() {
        let access = Access {
            address: "mqtt://127.0.0.1:1".parse().unwrap(),
            authority: None,
            user: None,
        };
        let identity = identity();
        let broker = Broker::connect(&access, &identity).unwrap();
        let last = Outgoing {
            topic: Topic::Connection,
            message: identity.connection(1, 0, Presence::Offline),
        };
        let began = Instant::now();
        broker.close(&last);
        assert!(began.elapsed() < PATIENCE / 2, "{:?}", began.elapsed());
    }

    #[test]
    fn a_silent_connection_is_no_error() {
        let (wait, release) = channel();
        let mut broker = broker(move |sink| {
            let _: Result<(), _> = release.recv();
            drop(sink);
        });
        assert_eq!(broker.next(), Ok(None));
        drop(wait);
        broker.thread.take().unwrap().join().unwrap();
        assert_eq!(broker.next(), Err(ThreadEnded));
    }
}
