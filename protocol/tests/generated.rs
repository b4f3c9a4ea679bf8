//! The generated documents in `docs/` are those this crate generates.
//!
//! `OMNIBUS_WRITE_DOCS=1 cargo test -p omnibus-protocol` rewrites them.

use std::fmt;
use std::path::Path;

use omnibus_protocol::generate;

fn compare(name: &str, write: impl Fn(&mut String) -> fmt::Result) {
    let mut made = String::new();
    write(&mut made).expect("a string takes everything");
    // One newline at the end, as every text file has.
    let made = format!("{}\n", made.trim_end());
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../docs")
        .join(name);
    if std::env::var_os("OMNIBUS_WRITE_DOCS").is_some() {
        std::fs::write(&path, &made).expect("docs/ can be written");
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        made == committed,
        "docs/{name} is stale: run OMNIBUS_WRITE_DOCS=1 cargo test -p omnibus-protocol"
    );
}

#[test]
fn protocol_page_is_up_to_date() {
    compare("can-protocol.md", generate::page::<String>);
}

#[test]
fn eds_is_up_to_date() {
    compare("omnibus.eds", |out| {
        let mut identity = robot::Identity::new(canopen::NodeId::MIN, 0);
        identity.storage = true;
        let device = identity.device();
        generate::eds(out, |out| {
            canopen::eds::communication_objects(
                out,
                &device,
                &omnibus_protocol::table::PROFILE_OBJECTS,
            )
        })
    });
}

#[test]
fn dbc_is_up_to_date() {
    compare("omnibus.dbc", generate::dbc::<String>);
}
