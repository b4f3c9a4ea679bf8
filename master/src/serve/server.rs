//! The server: a thread that accepts, and one for each of a few connections.
//!
//! Blocking sockets with timeouts on both ways: a peer that sends its request too slowly, or does
//! not take what it is sent for a second, is dropped. A connection that ends gives up the controls.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

use super::http::{self, LONGEST_HEAD, Names, Wish};
use super::message::{self, ClientMessage, LONGEST};
use super::page_state::{Cursor, PageState};
use crate::controls::arbiter::Client;

/// Connections at a time.
const MOST: usize = 24;
/// A request must be complete by then.
const HEAD_PATIENCE: Duration = Duration::from_secs(3);
/// What is sent must be taken within this.
const WRITE_PATIENCE: Duration = Duration::from_secs(1);
/// How long a connection waits for a message before it looks for news.
const READ_SLICE: Duration = Duration::from_millis(20);
/// What a wrong token costs.
const WRONG_TOKEN: Duration = Duration::from_millis(500);
/// Wrong tokens on one connection.
const MOST_WRONG: u32 = 3;

/// Who may do what.
#[derive(Clone, Debug)]
pub struct Access {
    /// Names of this server.
    pub names: Names,
    /// What a page has to show before it may drive.
    pub token: String,
    /// Whether a page has to show it before it may see anything.
    pub closed: bool,
}

/// What all connections share.
struct Shared {
    page: Arc<PageState>,
    access: Access,
    /// Connections that are open.
    connections: AtomicUsize,
}

/// Accepts connections from now on, in threads of its own, as long as the program runs.
pub fn serve(listener: TcpListener, page: Arc<PageState>, access: Access) {
    let shared = Arc::new(Shared {
        page,
        access,
        connections: AtomicUsize::new(0),
    });
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(stream) = stream else {
                // Out of descriptors: time mends that.
                std::thread::sleep(Duration::from_millis(50));
                continue;
            };
            let shared = Arc::clone(&shared);
            if shared.connections.fetch_add(1, Ordering::Relaxed) >= MOST {
                shared.connections.fetch_sub(1, Ordering::Relaxed);
                continue;
            }
            std::thread::spawn(move || {
                // The connection has failed, so an error cannot be reported to the client.
                let _ = connection(stream, &shared);
                shared.connections.fetch_sub(1, Ordering::Relaxed);
            });
        }
    });
}

fn connection(mut stream: TcpStream, shared: &Shared) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(WRITE_PATIENCE))?;
    match request(&mut stream, &shared.access.names)? {
        Wish::File(kind, text) => stream.write_all(http::answer("200 OK", kind, text).as_bytes()),
        Wish::Refused(status, reason) => {
            let answer = http::answer(status, "text/plain; charset=utf-8", &format!("{reason}\n"));
            stream.write_all(answer.as_bytes())
        }
        Wish::WebSocket(key) => {
            stream.write_all(http::upgrade(&key).as_bytes())?;
            stream.set_read_timeout(Some(READ_SLICE))?;
            let config = WebSocketConfig::default()
                .max_message_size(Some(LONGEST))
                .max_frame_size(Some(LONGEST))
                .read_buffer_size(4 * LONGEST);
            let socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
            let client = shared.page.client();
            let ended = talk(socket, client, shared);
            shared.page.gone(client);
            ended.map_err(io::Error::other)
        }
    }
}

fn request(stream: &mut TcpStream, names: &Names) -> io::Result<Wish> {
    let until = Instant::now() + HEAD_PATIENCE;
    let mut head = Vec::new();
    loop {
        if let Some(wish) = http::read(&head, names) {
            return Ok(wish);
        }
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        let mut piece = [0; 1024];
        let room = (LONGEST_HEAD - head.len()).min(piece.len());
        match stream.read(&mut piece[..room])? {
            0 => return Err(ErrorKind::UnexpectedEof.into()),
            count => head.extend_from_slice(&piece[..count]),
        }
    }
}

/// Whether two texts are the same, in a time that does not tell where they differ.
fn same(a: &str, b: &str) -> bool {
    let differ = a
        .bytes()
        .zip(b.bytes())
        .fold(0, |sum, (a, b)| sum | (a ^ b));
    a.len() == b.len() && std::hint::black_box(differ) == 0
}

fn talk(mut socket: WebSocket<TcpStream>, client: Client, shared: &Shared) -> Result<(), Error> {
    let Shared { page, access, .. } = shared;
    let mut trusted = false;
    let mut wrong = 0;
    let mut cursor = Cursor::default();
    loop {
        let refusal = match socket.read() {
            Ok(Message::Text(text)) => match ClientMessage::parse(text.as_str()) {
                Ok(ClientMessage::Hello { token }) => {
                    trusted = same(&token, &access.token);
                    if trusted {
                        socket.send(Message::text(r#"{"type":"trusted"}"#))?;
                        None
                    } else {
                        wrong += 1;
                        page.confused(client);
                        std::thread::sleep(WRONG_TOKEN);
                        Some("wrong token".into())
                    }
                }
                Ok(_) if access.closed && !trusted => Some("send the token first".into()),
                Ok(message) => page.handle(client, trusted, &message),
                Err(reason) => {
                    page.confused(client);
                    Some(reason)
                }
            },
            Ok(Message::Binary(_)) => {
                page.confused(client);
                Some("messages are text".into())
            }
            Ok(Message::Close(_)) | Err(Error::ConnectionClosed) => return Ok(()),
            Ok(_) => None,
            Err(Error::Io(error))
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
            {
                None
            }
            Err(error) => return Err(error),
        };
        if let Some(reason) = refusal {
            socket.send(Message::text(message::refused(&reason).to_string()))?;
            if wrong >= MOST_WRONG {
                return socket.close(None);
            }
        }
        if trusted || !access.closed {
            for news in page.news(client, &mut cursor) {
                socket.send(Message::text(news.to_string()))?;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_the_same_or_not() {
        assert!(same("abc", "abc") && same("", ""));
        assert!(!same("abc", "abd") && !same("abc", "ab") && !same("ab", "abc") && !same("", "a"));
    }
}
