//! The lock of native robots: by the library, and by the commands.

mod common;

use std::path::Path;

use canopen::Micros;
use group::GroupFile;
use kinematics::Twist;
use omnibus::Group;
use omnibus::bus::wire::Wire;
use omnibus::commission::lock::{self, LockState};
use omnibus::error::MasterError;
use omnibus::simulation;
use omnibus::simulation::link::SimLink;
use protocol::{MemberState, Value, address as at};

const NODE: u8 = 2;
const KEY: lock::Key = *b"thirty-two bytes of a secret key";

fn group() -> GroupFile {
    GroupFile::load(common::root().join("groups/single.toml")).unwrap()
}

fn wire() -> Wire<SimLink> {
    let mut link = simulation::open(&group(), None, "sim").unwrap();
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

/// What a robot has already needs no key, so a locked group drives; anything else needs it.
#[test]
fn a_locked_robot_that_is_configured_drives() {
    let mut file = group();
    let mut link = simulation::open(&file, None, "sim").unwrap();
    let mut group = Group::connect(&mut link, &file).unwrap();
    group.configure(true).unwrap();
    lock::set_key(group.wire(), NODE, Some(&KEY)).unwrap();
    lock::lock(group.wire(), NODE).unwrap();
    drop(group);

    let mut group = Group::connect(&mut link, &file).unwrap();
    group.start().unwrap();
    group.set_twist(Twist::new(0.2, 0.0, 0.0)).unwrap();
    group.run(0.5).unwrap();
    assert!(
        group.members()[0]
            .status
            .is_some_and(|status| status.state == MemberState::Moving)
    );
    group.stop().unwrap();
    assert_eq!(lock::state(group.wire(), NODE).unwrap(), LockState::Locked);
    drop(group);

    file.limits.linear_jerk *= 0.5;
    let mut group = Group::connect(&mut link, &file).unwrap();
    let error = group.configure(true).unwrap_err().to_string();
    assert!(error.contains("omnibus unlock --key FILE"), "{error}");
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
    let (code, _, error) = on_the_bus(&["lock", "--set-key", "-", "--new"]);
    assert_eq!(code, Some(2), "{error}");
    // Never over another key.
    let (code, _, error) = on_the_bus(&["lock", "--set-key", file, "--new"]);
    assert_eq!(code, Some(1), "{error}");
    let (code, result, _) = on_the_bus(&["lock", "--set-key", file]);
    assert_eq!((code, &*result), (Some(0), "node 2 is locked\n"));
    // A simulated bus starts again with every command.
    let (code, _, error) = on_the_bus(&["lock"]);
    assert_eq!(code, Some(2), "{error}");
    assert!(error.contains("--set-key FILE"), "{error}");
    let (code, result, _) = on_the_bus(&["unlock", "--key", file]);
    assert_eq!((code, &*result), (Some(0), "node 2 is without a key\n"));
    let (code, _, error) = on_the_bus(&["unlock", "--key", "Cargo.toml"]);
    assert_eq!(code, Some(2), "{error}");
    assert!(error.contains("a key has 32 bytes"), "{error}");
}
