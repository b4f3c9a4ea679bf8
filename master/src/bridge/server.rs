//! The endpoint for clients of a bridge: a TCP port of this machine, or a Unix socket.
//!
//! There is no token and no encryption: any client that can connect may drive. So TCP is served on
//! this machine's own addresses only, and a Unix socket can be opened by this user only.

use std::io::{self, BufReader};
use std::net::{TcpListener, TcpStream, ToSocketAddrs};
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use super::Bridge;

/// Connections at a time.
const MOST: usize = 16;
/// What is sent must be taken within this.
const WRITE_PATIENCE: Duration = Duration::from_secs(1);

/// Where a bridge listens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// HOST:PORT of this machine.
    Tcp(String),
    /// A path.
    Unix(PathBuf),
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text.strip_prefix("tcp://"), text.strip_prefix("unix:")) {
            (Some(address), _) if address.contains(':') => Ok(Self::Tcp(address.into())),
            (_, Some(path)) if !path.is_empty() => Ok(Self::Unix(path.into())),
            _ => Err("give tcp://127.0.0.1:PORT or unix:PATH".into()),
        }
    }
}

/// A bridge's socket. Dropping a Unix one takes its path away.
pub enum Listener {
    /// A TCP port.
    Tcp(TcpListener),
    /// A Unix socket and its path.
    #[cfg(unix)]
    Unix(std::os::unix::net::UnixListener, PathBuf),
}

impl Listener {
    /// Listens; port 0 picks a free one.
    ///
    /// # Errors
    /// When the address cannot be had, or other machines could reach it.
    pub fn bind(address: &Address) -> io::Result<Self> {
        match address {
            Address::Tcp(address) => {
                let all: Vec<_> = address.to_socket_addrs()?.collect();
                if !all.iter().all(|address| address.ip().is_loopback()) {
                    return Err(io::Error::other(
                        "other computers reach this address, and anyone who connects may drive; \
                         listen on 127.0.0.1 and connect through an SSH tunnel",
                    ));
                }
                TcpListener::bind(&all[..]).map(Self::Tcp)
            }
            #[cfg(unix)]
            Address::Unix(path) => {
                use std::os::unix::fs::PermissionsExt as _;
                use std::os::unix::net::{UnixListener, UnixStream};
                // The socket of a killed bridge does not answer.
                if UnixStream::connect(path)
                    .is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused)
                {
                    std::fs::remove_file(path)?;
                }
                let listener = UnixListener::bind(path)?;
                std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600))?;
                Ok(Self::Unix(listener, path.clone()))
            }
            #[cfg(not(unix))]
            Address::Unix(_) => Err(io::ErrorKind::Unsupported.into()),
        }
    }

    /// What clients connect to.
    #[must_use]
    pub fn address(&self) -> String {
        match self {
            Self::Tcp(listener) => listener.local_addr().map_or_else(
                |error| error.to_string(),
                |address| format!("tcp://{address}"),
            ),
            #[cfg(unix)]
            Self::Unix(_, path) => format!("unix:{}", path.display()),
        }
    }

    /// Accepts clients, each in a thread of its own, as long as the program runs.
    pub fn serve(self, bridge: &Arc<Bridge>) {
        let open = Arc::new(AtomicUsize::new(0));
        loop {
            let bridge = Arc::clone(bridge);
            let served = match &self {
                Self::Tcp(listener) => listener
                    .accept()
                    .map(|(stream, _)| admit(&open, move || tcp(&bridge, stream))),
                #[cfg(unix)]
                Self::Unix(listener, _) => listener
                    .accept()
                    .map(|(stream, _)| admit(&open, move || unix(&bridge, stream))),
            };
            if served.is_err() {
                // Out of descriptors: time mends that.
                std::thread::sleep(Duration::from_millis(50));
            }
        }
    }
}

#[cfg(unix)]
impl Drop for Listener {
    fn drop(&mut self) {
        if let Self::Unix(_, path) = self {
            let _ = std::fs::remove_file(path);
        }
    }
}

fn admit(open: &Arc<AtomicUsize>, serve: impl FnOnce() -> io::Result<()> + Send + 'static) {
    let open = Arc::clone(open);
    if open.fetch_add(1, Ordering::Relaxed) >= MOST {
        open.fetch_sub(1, Ordering::Relaxed);
        return;
    }
    std::thread::spawn(move || {
        // The connection has failed, so an error cannot be reported to the client.
        let _ = serve();
        open.fetch_sub(1, Ordering::Relaxed);
    });
}

fn tcp(bridge: &Bridge, stream: TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(WRITE_PATIENCE))?;
    let output = stream.try_clone()?;
    bridge.serve(BufReader::new(stream), output)
}

#[cfg(unix)]
fn unix(bridge: &Bridge, stream: std::os::unix::net::UnixStream) -> io::Result<()> {
    stream.set_write_timeout(Some(WRITE_PATIENCE))?;
    let output = stream.try_clone()?;
    bridge.serve(BufReader::new(stream), output)
}
