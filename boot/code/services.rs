//! The functions that images call, see [`omnibus_boot::services`], which has what a caller
//! promises.

#![expect(unsafe_code, reason = "functions for another program")]

use core::mem::{align_of, size_of};
use core::slice;

use omnibus_boot::services::{HashMemory, MAGIC, Services};
use omnibus_boot::{Crypto, Software, key};

/// The table, which the linker script puts behind the vectors.
#[used]
#[unsafe(link_section = ".services")]
static SERVICES: Services = Services {
    magic: MAGIC,
    begin,
    update,
    finish,
    is_signed,
    is_development: key::is_development() as u32,
};

type Hash = <Software as Crypto>::Hash;

const _: () = assert!(size_of::<Hash>() <= size_of::<HashMemory>());
const _: () = assert!(align_of::<Hash>() <= align_of::<HashMemory>());

const SOFTWARE: Software = Software {
    public_key: key::PUBLIC,
};

unsafe extern "C" fn begin(memory: *mut HashMemory) {
    // SAFETY: the caller passes memory of its own; the assertions above say that a hash fits.
    unsafe { memory.cast::<Hash>().write(SOFTWARE.begin()) }
}

unsafe extern "C" fn update(memory: *mut HashMemory, bytes: *const u8, length: usize) {
    // SAFETY: by contract the memory holds a hash that `begin` has written, and the bytes are the
    // caller's and do not change during the call.
    unsafe { SOFTWARE.update(&mut *memory.cast(), slice::from_raw_parts(bytes, length)) }
}

unsafe extern "C" fn finish(memory: *mut HashMemory, hash: *mut [u8; 64]) {
    // SAFETY: by contract the memory holds a hash, which the caller does not use again, and `hash`
    // is 64 bytes of the caller's.
    unsafe { hash.write(SOFTWARE.finish(memory.cast::<Hash>().read())) }
}

unsafe extern "C" fn is_signed(
    message: *const u8,
    length: usize,
    signature: *const [u8; 64],
) -> u32 {
    // SAFETY: by contract both are the caller's and do not change during the call.
    let (message, signature) = unsafe { (slice::from_raw_parts(message, length), &*signature) };
    u32::from(SOFTWARE.is_signed(message, signature))
}
