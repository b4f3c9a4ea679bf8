//! The functions that images call, see [`omnibus_boot::services`].

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
    // SAFETY: the caller gives memory of its own, which is large enough.
    unsafe { memory.cast::<Hash>().write(SOFTWARE.begin()) }
}

unsafe extern "C" fn update(memory: *mut HashMemory, bytes: *const u8, length: usize) {
    // SAFETY: as above, with a hash in it; the bytes are the caller's and do not change meanwhile.
    unsafe { SOFTWARE.update(&mut *memory.cast(), slice::from_raw_parts(bytes, length)) }
}

unsafe extern "C" fn finish(memory: *mut HashMemory, hash: *mut [u8; 64]) {
    // SAFETY: as above; the hash in the memory is not used again.
    unsafe { hash.write(SOFTWARE.finish(memory.cast::<Hash>().read())) }
}

unsafe extern "C" fn is_signed(
    message: *const u8,
    length: usize,
    signature: *const [u8; 64],
) -> u32 {
    // SAFETY: both are the caller's and do not change meanwhile.
    let (message, signature) = unsafe { (slice::from_raw_parts(message, length), &*signature) };
    u32::from(SOFTWARE.is_signed(message, signature))
}
