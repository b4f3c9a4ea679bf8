//! A server of one folder, for this computer: GET, one request a connection.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Component, Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;

/// A request must have come by then.
const PATIENCE: Duration = Duration::from_secs(3);

/// Serves the folder until the program is ended.
pub fn serve(address: SocketAddr, folder: &Path) -> anyhow::Result<()> {
    let listener = TcpListener::bind(address).with_context(|| {
        format!("--serve {address}: cannot listen there; choose another port, or 0 for a free one")
    })?;
    println!(
        "the page is at http://{}/ until Ctrl-C",
        listener.local_addr()?
    );
    for stream in listener.incoming().flatten() {
        let folder = folder.to_owned();
        std::thread::spawn(move || {
            // A browser that has gone needs no answer.
            let _ = answer(stream, &folder);
        });
    }
    Ok(())
}

fn answer(stream: TcpStream, folder: &Path) -> std::io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    let mut line = String::new();
    BufReader::new(&stream).read_line(&mut line)?;
    let found = file(&line, folder).and_then(|path| Some((std::fs::read(&path).ok()?, path)));
    let (status, kind, body) = match &found {
        Some((bytes, path)) => ("200 OK", kind(path), &bytes[..]),
        None => ("404 Not Found", "text/plain", &b"no such file\n"[..]),
    };
    let mut out = &stream;
    write!(
        out,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\n\
         Cache-Control: no-store\r\nConnection: close\r\n\r\n",
        body.len()
    )?;
    out.write_all(body)
}

/// The file that a request line asks for; nothing outside the folder.
fn file(line: &str, folder: &Path) -> Option<PathBuf> {
    let path = line.strip_prefix("GET /")?.split_whitespace().next();
    let path = path
        .filter(|path| !path.starts_with("HTTP/"))
        .unwrap_or_default();
    let path = Path::new(path.split(['?', '#']).next()?);
    let inside = path
        .components()
        .all(|component| matches!(component, Component::Normal(_)));
    let path = inside.then(|| folder.join(path))?;
    Some(if path.is_dir() {
        path.join("index.html")
    } else {
        path
    })
}

fn kind(path: &Path) -> &'static str {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/plain; charset=utf-8",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_of_the_folder_are_served() {
        let folder = Path::new("/folder");
        let asked = |line| file(line, folder);
        assert_eq!(
            asked("GET /a/b.js?x HTTP/1.1\r\n"),
            Some("/folder/a/b.js".into())
        );
        for bad in [
            "GET /../secret HTTP/1.1",
            "GET //etc/passwd HTTP/1.1",
            "POST /a HTTP/1.1",
            "",
        ] {
            assert_eq!(asked(bad), None, "{bad}");
        }
    }
}
