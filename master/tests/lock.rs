//! The lock of native robots: by the library, and by the commands.

mod common;

use std::path::Path;

use canopen::Micros;
use omnibus::bus::wire::Wire;
use omnibus::commission::lock::{self, LockState};
use omnibus::error::MasterError;
use omnibus::simulation;
use omnibus::simulation::link::SimLink;
use protocol::{Value, address as at};

const NODE: u8 = 2;
const KEY: lock::Key = *b"thirty-two bytes of a secret key";

fn wire() -> Wire<SimLink> {
    let group = ::group::GroupFile::load(common::root().join("groups/single.toml")).unwrap();
    let mut link = simulation::open(&group, None, "sim").unwrap();
    link.world.run_until(Micros(100_000)).unwrap();
    Wire::visiting(link)
}

fn write(wire: &mut Wire<SimLink>) -> Result<(), MasterError> {
    wire.write(NODE, at::MOUNT_X, Value::F32(0.25))
}

#[test]
fn a_locked_robot_keeps_its_parameters_until_it_is_unlocked() {
    let mut wire = wire();
    assert_eq!(lock::state(&mut wire, NODE).unwrap(), LockState::NoKey);
    write(&mut wire).unwrap();
    lock::set_key(&mut wire, NODE, Some(&KEY)).unwrap();
    assert_eq!(lock::state(&mut wire, NODE).unwrap(), LockState::Unlocked);
    lock::lock(&mut wire, NODE).unwrap();
    let error = write(&mut wire).unwrap_err().to_string();
    assert!(error.contains("omnibus unlock --key FILE"), "{error}");
    // Without the key nobody changes it.
    assert!(lock::set_key(&mut wire, NODE, None).is_err());

    let mut other = KEY;
    other[31] ^= 1;
    let error = lock::unlock(&mut wire, NODE, &other).unwrap_err();
    assert!(
        matches!(error, MasterError::WrongKey { node: NODE }),
        "{error}"
    );
    assert_eq!(lock::state(&mut wire, NODE).unwrap(), LockState::Locked);
    // The wrong response bars others for a second, which unlocking waits for.
    lock::unlock(&mut wire, NODE, &KEY).unwrap();
    write(&mut wire).unwrap();
    lock::set_key(&mut wire, NODE, None).unwrap();
    assert_eq!(lock::state(&mut wire, NODE).unwrap(), LockState::NoKey);
}

#[test]
fn what_is_no_key_is_refused() {
    let error = lock::key(&[1; 31]).unwrap_err();
    assert!(error.contains("32 bytes, not 31"), "{error}");
    assert!(lock::key(&[0; 32]).unwrap_err().contains("zeros"));
    assert_eq!(lock::key(&KEY), Ok(KEY));
}

#[test]
fn the_commands_name_what_to_do() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let path = folder.join("lock.key");
    let _ = std::fs::remove_file(&path);
    let file = path.to_str().unwrap();
    let run = |arguments: &[&str]| {
        let output = common::omnibus(arguments);
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (
            output.status.code(),
            text(output.stdout),
            text(output.stderr),
        )
    };
    let bus = ["--bus", "sim:groups/single.toml"];
    let on_the_bus = |arguments: &[&str]| run(&[arguments, &bus[..]].concat());
    let (code, result, _) = on_the_bus(&["lock", "--set-key", file, "--new"]);
    assert_eq!((code, &*result), (Some(0), "node 2 is locked\n"));
    assert_eq!(std::fs::read(&path).unwrap().len(), 32);
    // Never over another key.
    let (code, _, error) = on_the_bus(&["lock", "--set-key", file, "--new"]);
    assert_eq!(code, Some(1), "{error}");
    let (code, result, _) = on_the_bus(&["lock", "--set-key", file]);
    assert_eq!((code, &*result), (Some(0), "node 2 is locked\n"));
    // A simulated bus begins anew with every command.
    let (code, _, error) = on_the_bus(&["lock"]);
    assert_eq!(code, Some(2), "{error}");
    assert!(error.contains("--set-key FILE"), "{error}");
    let (code, result, _) = on_the_bus(&["unlock", "--key", file]);
    assert_eq!((code, &*result), (Some(0), "node 2 is without a key\n"));
    let (code, _, error) = on_the_bus(&["unlock", "--key", "Cargo.toml"]);
    assert_eq!(code, Some(2), "{error}");
    assert!(error.contains("a key has 32 bytes"), "{error}");
}
