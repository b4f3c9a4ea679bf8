//! `omnibus serve --http ADDR`: a page with the group on it, for every browser that may see it.

use std::net::{SocketAddr, TcpListener, ToSocketAddrs};
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context as _, bail};
use omnibus::controls::Controls;
use omnibus::serve::http::Names;
use omnibus::serve::page_state::{PageState, operate};
use omnibus::serve::server::{self, Access};
use serde_json::json;

use super::{Target, Usage, input, print_line};

/// A token of one's own must be at least this long.
const SHORTEST_TOKEN: usize = 12;
/// Bytes of a token made here.
const TOKEN_BYTES: usize = 16;

const EXAMPLES: &str = "Examples:
  omnibus serve --bus sim:groups/tcc-2.toml
  omnibus serve --http 0.0.0.0:8080 --token-file token.txt --name robots.local --bus socketcan:can0 --group my-group.toml
  omnibus serve --watch --bus socketcan:can0 --group my-group.toml";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Address and port of the page; port 0 picks a free one.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8080")]
    http: String,
    #[command(flatten)]
    target: Target,
    /// File with the token that a page must show before it may drive. Needed to serve on an address
    /// that other computers reach; for this computer alone a token is generated and printed.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Name under which browsers reach this server, besides its address; may be given several
    /// times.
    #[arg(long, value_name = "HOST")]
    name: Vec<String>,
    /// Only shows the group and never sends anything to the bus.
    #[arg(long)]
    watch: bool,
}

/// The token of the file, or a new one where only this machine reaches the page.
fn token(arguments: &Arguments, address: SocketAddr) -> anyhow::Result<String> {
    if let Some(path) = &arguments.token_file {
        let give = format!("--token-file a file with at least {SHORTEST_TOKEN} characters");
        let text = input::text(path, &give)?;
        let token = text.trim();
        if token.len() < SHORTEST_TOKEN {
            bail!(
                "--token-file {}: the token has {} characters; it needs at least {SHORTEST_TOKEN}",
                path.display(),
                token.len()
            );
        }
        return Ok(token.to_owned());
    }
    if !address.ip().is_loopback() {
        usage!(
            "--http {address}: other computers reach this address; give --token-file FILE, or \
             serve on 127.0.0.1 and connect through an SSH tunnel"
        );
    }
    let mut bytes = [0; TOKEN_BYTES];
    if let Err(error) = getrandom::fill(&mut bytes) {
        bail!(
            "the system provides no random numbers for a token ({error}); give --token-file FILE"
        );
    }
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = target.group()?;
    if target.elf()?.is_some() {
        usage!(
            "--backend {}: the page does not drive emulated robots; give native",
            target.backend()
        );
    }
    let mut addresses = arguments.http.to_socket_addrs().map_err(|error| {
        Usage(format!(
            "--http {}: {error}; give ADDRESS:PORT, for example 127.0.0.1:8080",
            arguments.http
        ))
    })?;
    let Some(address) = addresses.next() else {
        bail!("--http {}: no such address", arguments.http);
    };
    let token = token(arguments, address)?;
    let listener = TcpListener::bind(address).with_context(|| {
        format!("--http {address}: cannot listen at this address; another program may use the port, so choose another one")
    })?;
    let address = listener.local_addr()?;
    let abort = super::abort_on_ctrl_c()?;
    let pilot = Arc::new(target.pilot(&group)?);
    let access = Access {
        names: Names::new(address, arguments.name.clone()),
        token: token.clone(),
        closed: !address.ip().is_loopback(),
    };
    let bus = target.bus.to_string();
    let controls = if arguments.watch {
        Controls::new(&group.limits, Box::new(|_| {}))
    } else {
        Controls::of(&pilot, &group.limits)
    };
    let page = Arc::new(PageState::new(&group, &bus, controls, !arguments.watch));
    server::serve(listener, Arc::clone(&page), access);
    greet(arguments, address, &token)?;
    Ok(operate(pilot, &page, &abort)?)
}

/// Says where the page is. The token stands behind `#`, which browsers do not send anywhere.
fn greet(arguments: &Arguments, address: SocketAddr, token: &str) -> anyhow::Result<()> {
    let url = format!("http://{address}/");
    // A token of one's own is not printed: it may be a secret of more than this.
    let own = arguments.token_file.is_some();
    if super::json() {
        let token = (!own).then_some(token);
        return super::print_json_line(
            &json!({"url": url, "token": token, "watch": arguments.watch}),
        );
    }
    if super::quiet() {
        return Ok(());
    }
    if own || arguments.watch {
        print_line(format_args!("the page is at {url}"))?;
    } else {
        print_line(format_args!("the page is at {url}#token={token}"))?;
        print_line(
            "anyone who opens it with this token may drive; without the token the page only shows the group",
        )?;
    }
    print_line("Ctrl-C ramps the group down and ends")
}
