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

/// The EDS of a robot that stores its parameters.
fn eds(out: &mut String) -> fmt::Result {
    let mut identity = robot::Identity::new(canopen::NodeId::MIN, 0);
    identity.storage = true;
    let device = identity.device();
    generate::eds(out, |out| {
        canopen::eds::communication_objects(out, &device, &omnibus_protocol::table::PROFILE_OBJECTS)
    })
}

#[test]
fn eds_is_up_to_date() {
    compare("omnibus.eds", eds);
}

#[test]
fn dbc_is_up_to_date() {
    compare("omnibus.dbc", generate::dbc::<String>);
}

/// CiA 302-3: the objects of the program download are arrays (object code 8, CiA 301, table 42).
#[test]
fn program_download_objects_are_arrays_in_the_eds() {
    let mut text = String::new();
    eds(&mut text).expect("a string takes everything");
    for index in ["1F50", "1F51", "1F56", "1F57"] {
        let section = text.split_once(&format!("[{index}]\n")).expect(index).1;
        let section = section.split_once("\n[").expect(index).0;
        assert!(section.contains("\nObjectType=0x8\n"), "{index}");
    }
}
