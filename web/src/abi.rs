//! What JavaScript calls: bytes in and bytes out.
//!
//! `page/worker.js` puts a request, a JSON object with one field, into memory that it has asked
//! for ([`omnibus_allocate`]), calls [`omnibus_call`] and reads the answer, which stays until the
//! next call. Time passes in [`omnibus_advance`] alone. A panic says its text through the import
//! `omnibus_failed` and traps; the instance cannot be used any more then.
//!
//! An instance of the module has one playground, as a page has: JavaScript starts another worker
//! for another one.
#![expect(
    unsafe_code,
    reason = "memory is shared with JavaScript, which knows only addresses"
)]

use std::cell::RefCell;

use emulator::Firmware;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::choice::{Choice, GROUPS};
use crate::playground::Playground;
use crate::scenario;

/// What this instance holds.
#[derive(Default)]
struct Instance {
    image: Option<Firmware>,
    playground: Option<Playground>,
    answer: Vec<u8>,
}

thread_local! {
    static INSTANCE: RefCell<Instance> = RefCell::default();
}

/// A request of the worker.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
enum Request {
    /// What can be chosen.
    Groups {},
    /// Builds the world of a choice.
    Open(Choice),
    /// A message of the page, as text.
    Say(String),
    /// A fault, as text.
    Inject(String),
    /// Which robot the page looks into, and whether it looks at the frames.
    Look { node: Option<u8>, frames: bool },
    /// What the page has not seen yet.
    News {},
    /// Drives a metre in a world of its own.
    Scenario(Choice),
}

#[link(wasm_import_module = "omnibus")]
unsafe extern "C" {
    fn omnibus_failed(text: *const u8, length: usize);
}

/// Memory for so many bytes, to be given to one of the functions below.
#[unsafe(no_mangle)]
extern "C" fn omnibus_allocate(length: usize) -> *mut u8 {
    let bytes = vec![0_u8; length].into_boxed_slice();
    Box::into_raw(bytes).cast()
}

/// Takes over what [`omnibus_allocate`] gave.
///
/// # Safety
/// `start` and `length` are those of one call of [`omnibus_allocate`] that has not been taken over.
unsafe fn take(start: *mut u8, length: usize) -> Vec<u8> {
    let bytes = std::ptr::slice_from_raw_parts_mut(start, length);
    // SAFETY: by contract it came from `Box::into_raw` with this length, and nothing else owns it.
    unsafe { Box::from_raw(bytes) }.into_vec()
}

/// To be called first: panics are told from here on.
#[unsafe(no_mangle)]
extern "C" fn omnibus_begin() {
    std::panic::set_hook(Box::new(|panic| {
        let text = panic.to_string();
        // SAFETY: the text lives until the call returns.
        unsafe { omnibus_failed(text.as_ptr(), text.len()) };
    }));
}

/// Takes over the image that emulated robots run, an ELF file. Returns 1 when it is one.
#[unsafe(no_mangle)]
extern "C" fn omnibus_image(start: *mut u8, length: usize) -> u32 {
    // SAFETY: the worker passes what it was given, once.
    let elf = unsafe { take(start, length) };
    let image = Firmware::from_elf(elf).ok();
    INSTANCE.with_borrow_mut(|instance| {
        instance.image = image;
        u32::from(instance.image.is_some())
    })
}

/// Answers a request. The answer is JSON, `{"done": ...}` or `{"failed": "why"}`, and lies at the
/// address returned for [`omnibus_answer_length`] bytes until the next call.
#[unsafe(no_mangle)]
extern "C" fn omnibus_call(start: *mut u8, length: usize) -> *const u8 {
    // SAFETY: the worker passes what it was given, once.
    let request = unsafe { take(start, length) };
    INSTANCE.with_borrow_mut(|instance| {
        let answer = match answer(instance, &request) {
            Ok(done) => json!({"done": done}),
            Err(reason) => json!({"failed": reason}),
        };
        instance.answer = answer.to_string().into_bytes();
        instance.answer.as_ptr()
    })
}

/// Bytes of the last answer.
#[unsafe(no_mangle)]
extern "C" fn omnibus_answer_length() -> usize {
    INSTANCE.with_borrow(|instance| instance.answer.len())
}

/// Lets time pass up to this, ms of virtual time; returns the time, which may be later.
#[unsafe(no_mangle)]
extern "C" fn omnibus_advance(until_ms: f64) -> f64 {
    INSTANCE.with_borrow_mut(|instance| {
        let playground = instance.playground.as_mut();
        playground.map_or(0.0, |playground| playground.advance(until_ms as u64) as f64)
    })
}

fn answer(instance: &mut Instance, request: &[u8]) -> Result<Value, String> {
    let request: Request = serde_json::from_slice(request).map_err(|error| error.to_string())?;
    let image = instance.image.as_ref();
    let playground = instance.playground.as_mut().ok_or("no world is open");
    match request {
        Request::Groups {} => Ok(json!(GROUPS.map(|(name, title, ..)| [name, title]))),
        Request::Open(choice) => {
            instance.playground = Some(Playground::new(&choice, image)?);
            Ok(Value::Null)
        }
        Request::Say(text) => {
            playground?.receive(&text);
            Ok(Value::Null)
        }
        Request::Inject(text) => playground?.inject(&text).map(|()| Value::Null),
        Request::Look { node, frames } => {
            playground?.look(node, frames);
            Ok(Value::Null)
        }
        Request::News {} => Ok(playground?.news()),
        Request::Scenario(choice) => scenario::run(&choice, image).map(Value::String),
    }
}
