//! Just enough HTTP: one request a connection, GET only, and who may ask.
//!
//! A browser that was lured onto another site's page must not reach the robots. Two checks see to
//! that. `Host` must be a name of this server: a page of another name that was made to resolve to
//! this address (DNS rebinding) brings its own name. `Origin`, which browsers send with every
//! WebSocket, must be this server's own pages.

use std::net::{IpAddr, SocketAddr};

/// Longest head of a request, in bytes.
pub const LONGEST_HEAD: usize = 8 * 1024;
const MOST_HEADERS: usize = 64;

/// The page and its parts.
const FILES: [(&str, &str, &str); 4] = [
    (
        "/",
        "text/html; charset=utf-8",
        include_str!("page/index.html"),
    ),
    (
        "/page.css",
        "text/css; charset=utf-8",
        include_str!("page/page.css"),
    ),
    (
        "/backend.js",
        "text/javascript; charset=utf-8",
        include_str!("page/backend.js"),
    ),
    (
        "/page.js",
        "text/javascript; charset=utf-8",
        include_str!("page/page.js"),
    ),
];

/// What a request wants.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wish {
    /// A file of the page: its type and text.
    File(&'static str, &'static str),
    /// To talk: the value of `Sec-WebSocket-Key`.
    WebSocket(String),
    /// Something that is refused: status line and reason.
    Refused(&'static str, String),
}

/// Under which names this server answers.
#[derive(Clone, Debug)]
pub struct Names {
    address: SocketAddr,
    more: Vec<String>,
}

impl Names {
    /// The names of a server that listens at `address`, and those it was told.
    #[must_use]
    pub fn new(address: SocketAddr, more: Vec<String>) -> Self {
        Self { address, more }
    }

    /// Whether `host` (a `Host` header: name or address, and port) is this server.
    #[must_use]
    pub fn accept(&self, host: &str) -> bool {
        let (name, port) = match host.rsplit_once(':') {
            Some((name, port)) if !port.contains(']') => (name, port.parse().ok()),
            _ => (host, Some(80)),
        };
        if port != Some(self.address.port()) {
            return false;
        }
        if self.more.iter().any(|more| more.eq_ignore_ascii_case(name)) {
            return true;
        }
        let ip = self.address.ip();
        if ip.is_loopback() && name.eq_ignore_ascii_case("localhost") {
            return true;
        }
        let bare = name
            .strip_prefix('[')
            .and_then(|name| name.strip_suffix(']'));
        // A foreign name cannot be an address: a request by address is meant for this server.
        match bare.unwrap_or(name).parse::<IpAddr>() {
            Ok(asked) => ip.is_unspecified() || asked == ip,
            Err(_) => false,
        }
    }
}

/// Reads the head of a request; `None` while it is not complete.
#[must_use]
pub fn read(head: &[u8], names: &Names) -> Option<Wish> {
    let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(head) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) if head.len() < LONGEST_HEAD => return None,
        Ok(httparse::Status::Partial) => {
            return Some(refused("431 Request Header Fields Too Large", "too long"));
        }
        Err(error) => return Some(refused("400 Bad Request", &error.to_string())),
    }
    Some(judge(&request, names))
}

fn refused(status: &'static str, reason: &str) -> Wish {
    Wish::Refused(status, reason.into())
}

fn judge(request: &httparse::Request<'_, '_>, names: &Names) -> Wish {
    // A header given twice is given once too often.
    let header = |name: &str| {
        let mut all = request
            .headers
            .iter()
            .filter(|h| h.name.eq_ignore_ascii_case(name));
        let first = all
            .next()
            .map(|header| std::str::from_utf8(header.value).unwrap_or_default());
        if all.next().is_some() {
            Some("")
        } else {
            first
        }
    };
    let host = header("host").unwrap_or_default();
    if !names.accept(host) {
        return refused(
            "421 Misdirected Request",
            "this server has another name; if this name is right, give it with --name",
        );
    }
    if request.method != Some("GET") {
        return refused("405 Method Not Allowed", "only GET is answered");
    }
    let path = request.path.unwrap_or_default();
    if path == "/ws" {
        let own = |origin: &str| origin.strip_prefix("http://") == Some(host);
        if !header("origin").is_none_or(own) {
            return refused(
                "403 Forbidden",
                "the request came from a page of another server",
            );
        }
        let upgrades = header("upgrade").is_some_and(|v| v.eq_ignore_ascii_case("websocket"));
        let version = header("sec-websocket-version") == Some("13");
        return match header("sec-websocket-key") {
            Some(key) if upgrades && version && key.len() == 24 => Wish::WebSocket(key.into()),
            _ => refused(
                "400 Bad Request",
                "this address is for WebSocket, version 13",
            ),
        };
    }
    let file = FILES.iter().find(|(name, ..)| *name == path);
    file.map_or_else(
        || refused("404 Not Found", "no such page"),
        |(_, kind, text)| Wish::File(kind, text),
    )
}

/// The answer with a body, after which the connection ends.
#[must_use]
pub fn answer(status: &str, kind: &str, body: &str) -> String {
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
         Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; \
         connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\
         \r\n\r\n{body}",
        body.len()
    )
}

/// The answer that turns the connection into a WebSocket.
#[must_use]
pub fn upgrade(key: &str) -> String {
    format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Accept: {}\r\n\r\n",
        tungstenite::handshake::derive_accept_key(key.as_bytes())
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(address: &str, more: &[&str]) -> Names {
        let more = more.iter().map(|name| (*name).to_owned()).collect();
        Names::new(address.parse().unwrap(), more)
    }

    #[test]
    fn only_our_own_names_are_ours() {
        let local = names("127.0.0.1:8080", &[]);
        for good in ["127.0.0.1:8080", "localhost:8080", "LOCALHOST:8080"] {
            assert!(local.accept(good), "{good}");
        }
        for bad in [
            "",
            "evil.example:8080",
            "evil.example",
            "127.0.0.1",
            "127.0.0.1:80",
            "127.0.0.1:8080:8080",
            "127.0.0.1.evil.example:8080",
            "localhost.:8080",
            "10.0.0.1:8080",
            "127.0.0.1:x",
        ] {
            assert!(!local.accept(bad), "{bad}");
        }
        let all = names("0.0.0.0:80", &["robots.lan"]);
        for good in ["10.0.0.1:80", "10.0.0.1", "robots.lan", "[::1]"] {
            assert!(all.accept(good), "{good}");
        }
        assert!(!all.accept("localhost:80") && !all.accept("evil.example"));
        assert!(names("[::1]:8080", &[]).accept("[::1]:8080"));
    }

    fn ask(lines: &str) -> Wish {
        let head = format!("{}\r\n\r\n", lines.trim().replace("\n", "\r\n"));
        read(head.as_bytes(), &names("127.0.0.1:8080", &[])).unwrap()
    }

    const SOCKET: &str = "GET /ws HTTP/1.1\nHost: localhost:8080\nUpgrade: websocket\n\
         Connection: Upgrade\nSec-WebSocket-Version: 13\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==";

    #[test]
    fn pages_of_other_servers_cannot_talk_to_us() {
        assert!(matches!(ask(SOCKET), Wish::WebSocket(_)));
        let own = format!("{SOCKET}\nOrigin: http://localhost:8080");
        assert!(matches!(ask(&own), Wish::WebSocket(_)));
        for origin in [
            "http://evil.example",
            "http://localhost:8081",
            "https://localhost:8080",
            "null",
            "http://127.0.0.1:8080",
        ] {
            let wish = ask(&format!("{SOCKET}\nOrigin: {origin}"));
            assert!(
                matches!(wish, Wish::Refused("403 Forbidden", _)),
                "{origin}"
            );
        }
        let rebound = SOCKET.replace("localhost", "evil.example");
        assert!(matches!(
            ask(&rebound),
            Wish::Refused("421 Misdirected Request", _)
        ));
        // Twice, so that one of them fits.
        let twice = format!("{SOCKET}\nHost: evil.example");
        assert!(matches!(
            ask(&twice),
            Wish::Refused("421 Misdirected Request", _)
        ));
    }

    #[test]
    fn the_page_is_four_files_and_nothing_else() {
        let host = "Host: 127.0.0.1:8080";
        for path in ["/", "/page.css", "/backend.js", "/page.js"] {
            let wish = ask(&format!("GET {path} HTTP/1.1\n{host}"));
            assert!(matches!(wish, Wish::File(..)), "{path}");
        }
        for (request, status) in [
            ("GET /../Cargo.toml HTTP/1.1", "404 Not Found"),
            ("GET /page.js?x HTTP/1.1", "404 Not Found"),
            ("POST / HTTP/1.1", "405 Method Not Allowed"),
            ("GET /ws HTTP/1.1", "400 Bad Request"),
        ] {
            let wish = ask(&format!("{request}\n{host}"));
            assert!(
                matches!(wish, Wish::Refused(found, _) if found == status),
                "{request}: {wish:?}"
            );
        }
        assert!(matches!(
            ask("GET / HTTP/1.1"),
            Wish::Refused("421 Misdirected Request", _)
        ));
        let names = names("127.0.0.1:8080", &[]);
        assert!(matches!(
            read(b"\0\0\0", &names),
            Some(Wish::Refused("400 Bad Request", _))
        ));
        assert_eq!(read(b"GET / HTTP/1.1\r\nHost: local", &names), None);
        let long = [b"GET / HTTP/1.1\r\nA: ".to_vec(), vec![b'a'; LONGEST_HEAD]].concat();
        assert!(matches!(read(&long, &names), Some(Wish::Refused(..))));
    }

    /// The example of RFC 6455, 1.3.
    #[test]
    fn the_key_is_answered_as_the_standard_says() {
        let answer = upgrade("dGhlIHNhbXBsZSBub25jZQ==");
        assert!(answer.contains("Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n"));
    }
}
