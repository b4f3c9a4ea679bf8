//! Builds in the public key that images are checked with, and links the boot code.

use std::{env, fs, path::PathBuf};

/// Public half of the key in `src/key.rs`.
const DEVELOPMENT: &str = "keys/development.pub";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=OMNIBUS_PUBLIC_KEY");
    let path = env::var_os("OMNIBUS_PUBLIC_KEY").map_or_else(|| DEVELOPMENT.into(), PathBuf::from);
    println!("cargo::rerun-if-changed={}", path.display());
    let key = fs::read_to_string(&path)
        .map_err(|error| error.to_string())
        .and_then(|text| bytes(text.trim()).ok_or_else(|| "not 64 hexadecimal digits".to_owned()));
    let key = match key {
        Ok(key) => key,
        Err(error) => {
            let path = path.display();
            println!(
                "cargo::error=the public key {path}, from OMNIBUS_PUBLIC_KEY: {error}; `cargo \
                 xtask keys` makes one"
            );
            return;
        }
    };
    println!("cargo::rerun-if-changed=boot.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        // The file is what is programmed, byte for byte.
        for argument in ["--nmagic", "--oformat=binary", "-Tboot.x"] {
            println!("cargo::rustc-link-arg-bins={argument}");
        }
        println!("cargo::rustc-link-search={}", env!("CARGO_MANIFEST_DIR"));
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::write(out.join("public_key"), key).expect("OUT_DIR can be written");
}

/// The 32 bytes that 64 hexadecimal digits stand for.
fn bytes(digits: &str) -> Option<[u8; 32]> {
    let mut key = [0; 32];
    if digits.len() != 64 || !digits.is_ascii() {
        return None;
    }
    for (byte, at) in key.iter_mut().zip((0..).step_by(2)) {
        *byte = u8::from_str_radix(&digits[at..at + 2], 16).ok()?;
    }
    Some(key)
}
