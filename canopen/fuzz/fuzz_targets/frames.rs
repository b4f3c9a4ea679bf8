//! libFuzzer makes up the frames: see `examples/fuzz/harness.rs` for what is done with its bytes
//! and what must hold.
//!
//! The first byte chooses. Even: the bytes decide what the example's generator decides, so most
//! frames are nearly right. Odd: they are the frames themselves, of any identifier, length, bytes
//! and time.
#![no_main]

#[path = "../../examples/fuzz/harness.rs"]
mod harness;

use harness::{Source, Totals, life, raw};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Some((choice, rest)) = data.split_first() else {
        return;
    };
    if choice % 2 == 0 {
        life(&mut Source::Bytes(rest), 5_000, &mut Totals::NONE);
    } else {
        raw(rest);
    }
});
