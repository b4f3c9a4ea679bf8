//! A simulated bus in another process whose time waits for this one: `omnibus-sim serve
//! --lockstep`, whose side of the protocol is `sim/src/endpoint/lockstep.rs`.
//!
//! Its clock is virtual, as that of a simulated bus in this process: it moves only while
//! [`Link::receive`] waits. So nothing is late on a machine that is busy.

use std::collections::VecDeque;
use std::io::{self, BufRead as _, BufReader, BufWriter, Write as _};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::time::{Duration, Instant};

use can_text::slcan::{self, Answer};
use canopen::{Frame, Micros};

use crate::bus::link::{Link, LinkError};

/// What the server says first.
const GREETING: &str = "omnibus-lockstep 1";
/// How long connecting and greeting may take.
const PATIENCE: Duration = Duration::from_secs(3);
/// How long to look for an answer before sleeping.
const SOON: Duration = Duration::from_micros(100);
/// After how many answers to look again when one did not come soon: perhaps the simulator can only
/// work while this end sleeps. Twice as many each time, up to the most.
const RESTS: u32 = 32;
const MOST_RESTS: u32 = 1024;

/// A connection to the simulator.
pub struct LockstepLink {
    bus: String,
    input: BufReader<TcpStream>,
    output: BufWriter<TcpStream>,
    now: Micros,
    received: VecDeque<(Micros, Frame)>,
    /// For how many answers not to look, and for how many the next time; see [`RESTS`].
    rests: u32,
    next_rests: u32,
}

/// Connects to `HOST:PORT`.
pub(super) fn open(bus: String, address: &str) -> io::Result<LockstepLink> {
    let host = address.to_socket_addrs()?.next();
    let host = host.ok_or_else(|| io::Error::other("the host has no address"))?;
    let stream = TcpStream::connect_timeout(&host, PATIENCE)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    let mut link = LockstepLink {
        bus,
        input: BufReader::new(stream.try_clone()?),
        output: BufWriter::new(stream),
        now: Micros(0),
        received: VecDeque::new(),
        rests: 0,
        next_rests: RESTS,
    };
    if link.line()? != GREETING {
        return Err(io::Error::other(
            "the server there is not omnibus-sim serve --lockstep",
        ));
    }
    link.wait_for_turn()?;
    // From here on time waits, so this end may take as long as it needs.
    link.input.get_ref().set_read_timeout(None)?;
    Ok(link)
}

impl LockstepLink {
    /// Looks for an answer, which mostly takes microseconds, before it is waited for: a core that
    /// has gone to sleep takes longer to wake up.
    fn look(&mut self) -> io::Result<()> {
        if let Some(fewer) = self.rests.checked_sub(1) {
            self.rests = fewer;
            return Ok(());
        }
        self.rests = self.next_rests;
        self.next_rests = MOST_RESTS.min(2 * self.rests);
        let stream = self.input.get_ref();
        stream.set_nonblocking(true)?;
        let began = Instant::now();
        while began.elapsed() < SOON {
            match stream.peek(&mut [0]) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => std::hint::spin_loop(),
                _ => {
                    (self.rests, self.next_rests) = (0, RESTS);
                    break;
                }
            }
        }
        stream.set_nonblocking(false)
    }

    fn line(&mut self) -> io::Result<String> {
        if self.input.buffer().is_empty() {
            self.look()?;
        }
        let mut text = String::new();
        if self.input.read_line(&mut text)? == 0 {
            return Err(io::Error::other("the simulator closed the connection"));
        }
        Ok(text.trim_end().to_owned())
    }

    /// Reads until it is this end's turn.
    fn wait_for_turn(&mut self) -> io::Result<()> {
        loop {
            let line = self.line()?;
            let nonsense = || {
                io::Error::other(format!(
                    "the simulator sent '{line}', which is not part of the protocol"
                ))
            };
            let (kind, rest) = line.split_at_checked(1).ok_or_else(nonsense)?;
            let (time, frame) = rest.split_once(' ').unwrap_or((rest, ""));
            let time = Micros(time.parse().map_err(|_| nonsense())?);
            match (kind, Answer::parse(frame.as_bytes())) {
                ("n", _) => {
                    self.now = time;
                    return Ok(());
                }
                ("f", Answer::Frame(frame, None)) => self.received.push_back((time, frame)),
                _ => return Err(nonsense()),
            }
        }
    }

    fn wait(&mut self, until: Micros) -> io::Result<()> {
        writeln!(self.output, "w{}", until.0)?;
        self.output.flush()?;
        self.wait_for_turn()
    }

    fn error(&self, error: &io::Error) -> LinkError {
        LinkError {
            bus: self.bus.clone(),
            problem: error.to_string(),
            remedy: "start the simulator again".into(),
        }
    }
}

impl Link for LockstepLink {
    fn now(&self) -> Micros {
        self.now
    }

    fn time_waits(&self) -> bool {
        true
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        let text = slcan::frame(frame, None);
        writeln!(self.output, "{}", text.trim_end()).map_err(|error| self.error(&error))
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        loop {
            if let Some(frame) = self.received.pop_front() {
                return Ok(Some(frame));
            }
            // Frames that are there already come also when there is no time left.
            self.wait(until).map_err(|error| self.error(&error))?;
            if self.received.is_empty() && self.now >= until {
                return Ok(None);
            }
        }
    }
}
