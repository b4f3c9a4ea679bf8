//! What endpoints over streams of bytes have in common: non-blocking reading and writing with a
//! limit.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};

/// Bytes that may wait for a client: some 40 000 frames of slcan.
pub const BACKLOG: usize = 1 << 20;

/// A connection that never blocks. Bytes wait in it in both directions; whoever owns it takes them
/// from `input` and puts them into `output`.
#[derive(Debug)]
pub(super) struct Pipe<S> {
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
                Ok(count) => self.input.extend_from_slice(&bytes[..count]),
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
pub(super) struct Listener {
    socket: TcpListener,
    address: SocketAddr,
}

impl Listener {
    /// Listens; port 0 picks a free one.
    pub fn bind(address: &str) -> io::Result<Self> {
        let socket = TcpListener::bind(address)?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            address: socket.local_addr()?,
            socket,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The next client that has connected.
    pub fn accept(&self) -> Option<Pipe<TcpStream>> {
        while let Ok((stream, _)) = self.socket.accept() {
            // One that is gone already is no client.
            if stream.set_nonblocking(true).is_ok() && stream.set_nodelay(true).is_ok() {
                return Some(Pipe::new(stream));
            }
        }
        None
    }
}
