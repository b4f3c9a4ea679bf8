//! What endpoints over streams of bytes have in common: non-blocking reading and writing with a
//! limit.

use std::cell::Cell;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use canopen::Micros;

use super::Endpoint;
use crate::world::{Port, World};

/// Bytes that may wait for a client: some 40 000 frames of slcan.
pub const BACKLOG: usize = 1 << 20;
/// While time passes, how often to ask for what is not expected: new clients, and the end of those
/// that wait. To ask costs as much as to simulate a slice of time.
const LOOK: Micros = Micros(10_000);

/// How long to look for an answer before sleeping.
const SOON: Duration = Duration::from_micros(100);
/// After how many waits to look again when nothing came soon: perhaps the client can only work
/// while this process sleeps. Twice as many each time, up to the most.
const RESTS: u32 = 32;
const MOST_RESTS: u32 = 1024;

/// A connection that never blocks. Bytes wait in it in both directions; its owner takes them from
/// `input` and puts them into `output`.
#[derive(Debug)]
pub struct Pipe<S> {
    stream: S,
    pub input: Vec<u8>,
    pub output: Vec<u8>,
}

impl<S: Read + Write> Pipe<S> {
    /// Over a stream that does not block.
    pub fn new(stream: S) -> Self {
        Self {
            stream,
            input: Vec::new(),
            output: Vec::new(),
        }
    }

    /// Reads what has come.
    ///
    /// # Errors
    /// When the other side has gone.
    pub fn fill(&mut self) -> io::Result<()> {
        let mut bytes = [0; 4096];
        // A client that sends faster than it is read must not keep time from passing.
        while self.input.len() < BACKLOG {
            match self.stream.read(&mut bytes) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => {
                    self.input.extend_from_slice(&bytes[..count]);
                    if count < bytes.len() {
                        break;
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Writes what can be written now.
    ///
    /// # Errors
    /// When the other side has gone, or has read nothing for [`BACKLOG`] bytes.
    pub fn flush(&mut self) -> io::Result<()> {
        let mut written = 0;
        while written < self.output.len() {
            match self.stream.write(&self.output[written..]) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => written += count,
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        self.output.drain(..written);
        if self.output.len() > BACKLOG {
            return Err(ErrorKind::OutOfMemory.into());
        }
        Ok(())
    }

    /// The stream underneath.
    pub fn stream(&self) -> &S {
        &self.stream
    }
}

/// A TCP address that clients connect to.
#[derive(Debug)]
pub struct Listener {
    socket: TcpListener,
    address: SocketAddr,
    asked: Micros,
    looked: Micros,
    /// Whether a client was there when a wait ended because something had come; not for long.
    knocked: Cell<Option<bool>>,
}

impl Listener {
    /// Listens; port 0 picks a free one.
    pub(super) fn bind(address: &str) -> io::Result<Self> {
        let socket = TcpListener::bind(address)?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            address: socket.local_addr()?,
            socket,
            asked: Micros(0),
            looked: Micros(0),
            knocked: Cell::new(None),
        })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether to look for new clients, and for those that have gone. When time stands, it may
    /// stand for one of them: always, unless the last wait has seen that there is no new one.
    pub(super) fn is_time_to_look(&mut self, now: Micros) -> bool {
        let stands = now == self.asked;
        self.asked = now;
        let is_alone = stands && self.knocked.take() == Some(false);
        let is_due = stands || now.0 >= self.looked.0 + LOOK.0;
        if is_due {
            self.looked = now;
        }
        is_due && !is_alone
    }

    /// The next client that has connected.
    pub(super) fn accept(&self) -> Option<Pipe<TcpStream>> {
        while let Ok((stream, _)) = self.socket.accept() {
            // One that is gone already is no client.
            if stream.set_nonblocking(true).is_ok() && stream.set_nodelay(true).is_ok() {
                return Some(Pipe::new(stream));
            }
        }
        None
    }
}

/// What a client of a [`Server`] speaks: one value per client, which is a node of its own.
pub trait Client {
    /// What the endpoint is called where it is announced.
    const NAME: &'static str;

    /// Greets a client that has connected.
    fn connect(output: &mut Vec<u8>, port: Port, world: &mut World) -> Self;

    /// Its port on the bus.
    fn port(&self) -> Port;

    /// Answers what the client has sent, and sends what has happened; `false` drops the client.
    fn exchange(&mut self, pipe: &mut Pipe<TcpStream>, world: &mut World) -> bool;

    /// Whether it may say something now; one that waits for an answer does not.
    fn may_talk(&self) -> bool {
        true
    }

    /// Whether clients are accepted at this time.
    fn accepts(_now: Micros) -> bool {
        true
    }

    /// How far time may go with these clients; see [`Endpoint::limit`].
    fn limit<'a>(_clients: impl Iterator<Item = &'a Self>, _now: Micros) -> Option<Micros>
    where
        Self: 'a,
    {
        None
    }
}

/// An endpoint at a TCP address, and its clients.
#[derive(Debug)]
pub struct Server<C> {
    listener: Listener,
    clients: Vec<(Pipe<TcpStream>, C)>,
    /// Ports of clients that have gone.
    spare: Vec<Port>,
    /// In how many waits not to look first, and in how many the next time; see [`RESTS`].
    rests: Cell<u32>,
    next_rests: Cell<u32>,
}

impl<C> Server<C> {
    /// Listens; port 0 picks a free one.
    ///
    /// # Errors
    /// When the address cannot be had.
    pub fn bind(address: &str) -> io::Result<Self> {
        Ok(Self {
            listener: Listener::bind(address)?,
            clients: Vec::new(),
            spare: Vec::new(),
            rests: Cell::new(0),
            next_rests: Cell::new(RESTS),
        })
    }
}

impl<C: Client> Endpoint for Server<C> {
    fn announce(&self) -> String {
        format!("{} {}", C::NAME, self.listener.address())
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        if !C::accepts(world.now()) {
            return Ok(());
        }
        let looks = self.listener.is_time_to_look(world.now());
        while let Some(mut pipe) = looks.then(|| self.listener.accept()).flatten() {
            let port = self.spare.pop().unwrap_or_else(|| world.add_port());
            let client = C::connect(&mut pipe.output, port, world);
            self.clients.push((pipe, client));
        }
        let spare = &mut self.spare;
        self.clients.retain_mut(|(pipe, client)| {
            // What came before the end still counts.
            let came = if looks || client.may_talk() {
                pipe.fill()
            } else {
                Ok(())
            };
            let stays = client.exchange(pipe, world);
            let alive = stays && came.and_then(|()| pipe.flush()).is_ok();
            if !alive {
                world.set_listening(client.port(), false);
                spare.push(client.port());
            }
            alive
        });
        Ok(())
    }

    fn limit(&self, now: Micros) -> Option<Micros> {
        C::limit(self.clients.iter().map(|(_, client)| client), now)
    }

    fn listener(&self) -> Option<&Listener> {
        Some(&self.listener)
    }

    #[cfg(unix)]
    fn wait(&self, listeners: &[&Listener], most: Duration) {
        use rustix::event::{PollFd, PollFlags, Timespec, poll};

        let talking = self.clients.iter().filter(|(_, client)| client.may_talk());
        let sockets = listeners
            .iter()
            .map(|one| PollFd::new(&one.socket, PollFlags::IN));
        let mut all: Vec<_> = sockets
            .chain(talking.map(|(pipe, _)| PollFd::new(pipe.stream(), PollFlags::IN)))
            .collect();
        // Whether there is anything, within a time.
        let mut come = |within: &Timespec| {
            let come = poll(&mut all, Some(within));
            let is_known = come.is_ok_and(|count| count > 0);
            for (listener, socket) in listeners.iter().zip(&all) {
                let knocked = is_known.then(|| !socket.revents().is_empty());
                listener.knocked.set(knocked);
            }
            come != Ok(0)
        };
        // A program that works with the world answers within microseconds, and a core that has gone
        // to sleep takes longer to wake up.
        let began = Instant::now();
        let rests = self.rests.get();
        while rests == 0 && began.elapsed() < SOON {
            if come(&Timespec::default()) {
                self.next_rests.set(RESTS);
                return;
            }
            std::hint::spin_loop();
        }
        if rests == 0 {
            let rests = self.next_rests.get();
            self.rests.set(rests);
            self.next_rests.set(MOST_RESTS.min(2 * rests));
        } else {
            self.rests.set(rests - 1);
        }
        // Interrupted by a signal, it has waited long enough.
        if let Ok(most) = Timespec::try_from(most) {
            come(&most);
        }
    }
}

#[cfg(test)]
mod tests {
    use group::GroupFile;

    use super::super::lockstep::{LockstepServer, Session};
    use super::*;
    use crate::robot::Backend;
    use crate::world::Options;

    const WHILE: Duration = Duration::from_secs(5);

    /// While time stands, a wait sees new clients of all endpoints: they are accepted at once, and
    /// where there are none the system is not asked for one.
    #[test]
    fn a_wait_sees_new_clients_of_all_endpoints() {
        let group = GroupFile::load("../groups/tcc-2.toml").unwrap();
        let mut world = World::new(&group, Backend::Native, Options::default()).unwrap();
        world.run_until(Micros(100_000)).unwrap();
        let mut held: LockstepServer = Server::<Session>::bind("127.0.0.1:0").unwrap();
        let mut other = Listener::bind("127.0.0.1:0").unwrap();
        let now = world.now();
        assert!(other.is_time_to_look(now), "long since the last look");
        assert!(other.is_time_to_look(now), "nothing is known");

        let mut client = TcpStream::connect(held.listener.address()).unwrap();
        held.exchange(&mut world).unwrap();
        assert_eq!(held.clients.len(), 1);
        client.write_all(b"w0\n").unwrap();
        held.wait(&[&held.listener, &other], WHILE);
        assert!(!other.is_time_to_look(now), "only the client has spoken");
        assert!(other.is_time_to_look(now), "known once");

        let _late = TcpStream::connect(other.address()).unwrap();
        held.wait(&[&held.listener, &other], WHILE);
        assert!(other.is_time_to_look(now));
        assert!(other.accept().is_some());

        held.exchange(&mut world).unwrap();
        held.wait(&[&held.listener, &other], Duration::ZERO);
        assert!(other.is_time_to_look(now), "nothing came: all are asked");
    }
}
