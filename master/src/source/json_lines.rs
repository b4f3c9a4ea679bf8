//! A connection to a program that sends JSON lines over TCP.

use std::io::{self, BufRead as _, BufReader, Lines};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::time::Duration;

/// How long connecting and the first line may take.
const PATIENCE: Duration = Duration::from_secs(3);

/// Connects to `HOST:PORT` and waits for the first line, which is to be a `what`; gives it and
/// those that follow.
///
/// # Errors
/// When there is no connection, or nothing comes.
pub(crate) fn connect(
    address: &str,
    what: &str,
) -> io::Result<(String, Lines<BufReader<TcpStream>>)> {
    let host = address
        .to_socket_addrs()?
        .next()
        .ok_or_else(|| io::Error::other("the host has no address"))?;
    let stream = TcpStream::connect_timeout(&host, PATIENCE)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    let mut lines = BufReader::new(stream.try_clone()?).lines();
    let first = lines.next().ok_or_else(|| {
        io::Error::other(format!(
            "the server closed the connection before the first {what}"
        ))
    })??;
    stream.set_read_timeout(None)?;
    Ok((first, lines))
}
