//! A filter in the kernel that protects the library from datagrams with absurd sequence numbers.
//!
//! RustDDS 0.15.1 lists each message that a heartbeat declares to exist and each that a gap
//! declares to be missing, and allocates the size of a fragmented message as its first fragment
//! declares it. One damaged number there takes all the memory of the computer. [`guard`] puts a
//! filter on the sockets of the participant (classic BPF, `SO_ATTACH_FILTER`) that drops a datagram
//! with such a submessage before the library reads it. Damaged datagrams that are cut off are
//! dropped as well.
//!
//! The library does not give access to its sockets. They are found by their ports among the
//! descriptors of this process, as in [`super::ports`], and duplicated; a filter belongs to the
//! socket and not to the descriptor.
//!
//! Limits: this works on Linux only. The filter checks the first submessages of a datagram, as many
//! as fit in a program that the kernel accepts ([`DEPTHS`]). It cannot distinguish a damaged number
//! within [`MOST`] from a true one, and it does not detect a peer that sends in another's name. For
//! these cases the caller ends a program that takes more and more memory.

use std::io;

use rustix::process::{PidfdFlags, PidfdGetfdFlags, getpid, pidfd_getfd, pidfd_open};
use socket2::{SockFilter, SockRef};

use super::ports;

/// Submessages that are checked: the first of these numbers whose program the kernel takes.
const DEPTHS: [u32; 3] = [32, 16, 8];
/// Messages that a heartbeat or a gap may name, in steps of 256: a million.
const MOST: u32 = 1 << 12;
/// Bytes of a message in fragments, in steps of 65 536: 16 MB.
const LARGEST: u32 = 256;

/// Where submessages begin behind the headers of UDP (8 bytes) and RTPS (RTPS 2.5, 9.4.4).
const FIRST: u32 = 8 + 20;

// Kinds of submessages (RTPS 2.5, 9.4.5.1.1).
const PAD: u32 = 0x01;
const HEARTBEAT: u32 = 0x07;
const GAP: u32 = 0x08;
const INFO_TS: u32 = 0x09;
const DATA_FRAG: u32 = 0x16;

// Instructions of classic BPF (linux/bpf_common.h), by what they do. `X` points at a submessage.
const LOAD_LENGTH: u16 = 0x80;
const LOAD_BYTE: u16 = 0x50;
const LOAD_HALF: u16 = 0x48;
const LOAD_WORD: u16 = 0x40;
const LOAD: u16 = 0x60;
const LOAD_X: u16 = 0x61;
const SET_X: u16 = 0x01;
const STORE: u16 = 0x02;
const STORE_X: u16 = 0x03;
const ADD: u16 = 0x04;
const ADD_X: u16 = 0x0c;
const SUBTRACT_X: u16 = 0x1c;
const SHIFT_LEFT: u16 = 0x64;
const SHIFT_RIGHT: u16 = 0x74;
const A_TO_X: u16 = 0x07;
const X_TO_A: u16 = 0x87;
const IF_EQUAL: u16 = 0x15;
const IF_GREATER_X: u16 = 0x2d;
const IF_AT_LEAST: u16 = 0x35;
const IF_BIT: u16 = 0x45;
const IF_EQUAL_X: u16 = 0x1d;
const RETURN: u16 = 0x06;

// Cells of its memory.
const HERE: u32 = 0;
const LENGTH: u32 = 1;
const SCRATCH: u32 = 2;
const EARLIER: u32 = 3;

const PASS: u32 = u32::MAX;
const DROP: u32 = 0;

/// A program, put together one instruction after the other.
#[derive(Default)]
struct Program(Vec<SockFilter>);

impl Program {
    fn put(&mut self, code: u16, value: u32) {
        self.0.push(SockFilter::new(code, 0, 0, value));
    }

    /// Goes on with `then` where the comparison holds, and behind it where it does not.
    fn when(&mut self, code: u16, value: u32, then: impl FnOnce(&mut Self)) {
        let mut inner = Self::default();
        then(&mut inner);
        let over = u8::try_from(inner.0.len()).expect("a branch is short");
        self.0.push(SockFilter::new(code, 0, over, value));
        self.0.extend(inner.0);
    }

    fn unless(&mut self, code: u16, value: u32, then: impl FnOnce(&mut Self)) {
        let mut inner = Self::default();
        then(&mut inner);
        let over = u8::try_from(inner.0.len()).expect("a branch is short");
        self.0.push(SockFilter::new(code, over, 0, value));
        self.0.extend(inner.0);
    }

    /// The upper three bytes of the number at `at`, in A.
    fn upper(&mut self, at: u32, little: bool) {
        if !little {
            self.put(LOAD_WORD, at);
            self.put(SHIFT_RIGHT, 8);
            return;
        }
        self.put(LOAD_BYTE, at + 3);
        self.put(SHIFT_LEFT, 8);
        self.put(STORE, SCRATCH);
        self.put(LOAD_BYTE, at + 2);
        self.put(LOAD_X, SCRATCH);
        self.put(ADD_X, 0);
        self.put(SHIFT_LEFT, 8);
        self.put(STORE, SCRATCH);
        self.put(LOAD_X, HERE);
        self.put(LOAD_BYTE, at + 1);
        self.put(LOAD_X, SCRATCH);
        self.put(ADD_X, 0);
        self.put(LOAD_X, HERE);
    }

    /// Drops a heartbeat or a gap between whose two numbers there are too many (RTPS 2.5, 9.4.5.6
    /// and 9.4.5.5: reader, writer, then the numbers, each high and low). One that has nothing
    /// names the first as one more than the last.
    fn check_range(&mut self, little: bool) {
        self.put(LOAD_WORD, 12);
        self.put(STORE, EARLIER);
        self.put(LOAD_WORD, 20);
        self.put(LOAD_X, EARLIER);
        // Equal in either order of bytes.
        self.unless(IF_EQUAL_X, 0, |bad| bad.put(RETURN, DROP));
        self.put(LOAD_X, HERE);
        self.upper(16, little);
        self.put(STORE, EARLIER);
        self.upper(24, little);
        self.put(LOAD_X, EARLIER);
        self.put(SUBTRACT_X, 0);
        self.put(ADD, 1);
        self.when(IF_AT_LEAST, MOST, |bad| bad.put(RETURN, DROP));
        self.put(LOAD_X, HERE);
    }

    /// Drops a fragment of a message that is too large (RTPS 2.5, 9.4.5.4).
    fn check_size(&mut self, little: bool) {
        self.upper(32, little);
        self.put(SHIFT_RIGHT, 8);
        self.when(IF_AT_LEAST, LARGEST, |bad| bad.put(RETURN, DROP));
    }

    fn check(&mut self, little: bool) {
        // These kinds follow each other, and their numbers are in one place.
        self.put(LOAD_BYTE, 0);
        self.put(ADD, HEARTBEAT.wrapping_neg());
        self.unless(IF_AT_LEAST, GAP - HEARTBEAT + 1, |range| {
            range.check_range(little);
        });
        self.put(LOAD_BYTE, 0);
        self.when(IF_EQUAL, DATA_FRAG, |size| size.check_size(little));
    }

    /// Looks at the submessage at X and moves X behind it.
    fn submessage(&mut self) {
        self.put(STORE_X, HERE);
        self.put(LOAD_LENGTH, 0);
        // The kernel wants every cell to be written on every way to where it is read.
        self.put(STORE, LENGTH);
        self.unless(IF_GREATER_X, 0, |end| end.put(RETURN, PASS));
        // The lowest flag is the order of bytes.
        for little in [true, false] {
            self.put(LOAD_BYTE, 1);
            let test = |then: &mut Self| {
                if little {
                    then.put(LOAD_BYTE, 3);
                    then.put(SHIFT_LEFT, 8);
                    then.put(STORE, SCRATCH);
                    then.put(LOAD_BYTE, 2);
                    then.put(LOAD_X, SCRATCH);
                    then.put(ADD_X, 0);
                    then.put(STORE, LENGTH);
                    then.put(LOAD_X, HERE);
                } else {
                    then.put(LOAD_HALF, 2);
                    then.put(STORE, LENGTH);
                }
                then.check(little);
            };
            if little {
                self.when(IF_BIT, 1, test);
            } else {
                self.unless(IF_BIT, 1, test);
            }
        }
        // Without a length it is the last one, unless its kind may be empty.
        self.put(LOAD, LENGTH);
        self.when(IF_EQUAL, 0, |last| {
            last.put(LOAD_BYTE, 0);
            last.unless(IF_EQUAL, PAD, |other| {
                other.unless(IF_EQUAL, INFO_TS, |end| end.put(RETURN, PASS));
            });
        });
        self.put(X_TO_A, 0);
        self.put(ADD, 4);
        self.put(STORE, SCRATCH);
        self.put(LOAD_X, SCRATCH);
        self.put(LOAD, LENGTH);
        self.put(ADD_X, 0);
        self.put(A_TO_X, 0);
    }
}

fn program(depth: u32) -> Vec<SockFilter> {
    let mut program = Program::default();
    program.put(SET_X, FIRST);
    for _ in 0..depth {
        program.submessage();
    }
    program.put(RETURN, PASS);
    program.0
}

/// Puts the filter on a socket.
fn attach(socket: &SockRef<'_>) -> io::Result<()> {
    let mut refused = None;
    for depth in DEPTHS {
        match socket.attach_filter(&program(depth)) {
            Ok(()) => return Ok(()),
            Err(error) => refused = Some(error),
        }
    }
    Err(refused.unwrap_or_else(|| io::ErrorKind::Unsupported.into()))
}

/// Puts the filter on all sockets of this process that have ports of the domain. Gives how many
/// there are.
///
/// # Errors
/// When the kernel does not permit it.
pub(super) fn guard(domain: u16) -> io::Result<usize> {
    let process = pidfd_open(getpid(), PidfdFlags::empty())?;
    let sockets = ports::own()?;
    let mut guarded = 0;
    for (descriptor, port) in sockets {
        if ports::is_of(domain, port) {
            let socket = pidfd_getfd(&process, descriptor, PidfdGetfdFlags::empty())?;
            attach(&SockRef::from(&socket))?;
            guarded += 1;
        }
    }
    Ok(guarded)
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, UdpSocket};
    use std::time::Duration;

    use super::*;

    /// A submessage in either order of bytes, its body as numbers of 32 bits.
    fn submessage(kind: u32, little: bool, body: &[u32]) -> Vec<u8> {
        let length = u16::try_from(4 * body.len()).unwrap();
        let mut bytes = vec![u8::try_from(kind).unwrap(), u8::from(little)];
        if little {
            bytes.extend(length.to_le_bytes());
            bytes.extend(body.iter().flat_map(|word| word.to_le_bytes()));
        } else {
            bytes.extend(length.to_be_bytes());
            bytes.extend(body.iter().flat_map(|word| word.to_be_bytes()));
        }
        bytes
    }

    /// Reader, writer, two numbers of 64 bits, and a count.
    fn range(kind: u32, little: bool, first: u64, last: u64) -> Vec<u8> {
        let high = |number: u64| u32::try_from(number >> 32).unwrap();
        let low = |number: u64| u32::try_from(number & 0xffff_ffff).unwrap();
        let body = [0, 0, high(first), low(first), high(last), low(last), 1];
        submessage(kind, little, &body)
    }

    fn fragment(little: bool, size: u32) -> Vec<u8> {
        submessage(DATA_FRAG, little, &[0, 0, 0, 0, 1, 1, 0x0001_0400, size, 0])
    }

    /// Whether a datagram with these submessages arrives.
    struct Line(UdpSocket, UdpSocket);

    impl Line {
        fn new() -> Self {
            let to = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
            attach(&SockRef::from(&to)).unwrap();
            to.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
            let from = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
            from.connect(to.local_addr().unwrap()).unwrap();
            Self(from, to)
        }

        fn carries(&self, submessages: &[Vec<u8>]) -> bool {
            let datagram = [
                b"RTPS\x02\x05\x01\x10".to_vec(),
                vec![7; 12],
                submessages.concat(),
            ];
            self.carries_bytes(&datagram.concat())
        }

        /// What comes first: this, or what is sent after it.
        fn carries_bytes(&self, datagram: &[u8]) -> bool {
            self.0.send(datagram).unwrap();
            self.0.send(b"the end").unwrap();
            let mut buffer = [0; 65_536];
            let mut next = || {
                let size = self.1.recv(&mut buffer).unwrap();
                buffer[..size].to_vec()
            };
            let first = next();
            if first == b"the end" {
                return false;
            }
            assert_eq!(
                (first.as_slice(), next().as_slice()),
                (datagram, &b"the end"[..])
            );
            true
        }
    }

    #[test]
    fn ranges_that_a_peer_may_have_arrive_and_others_do_not() {
        let line = Line::new();
        for kind in [HEARTBEAT, GAP] {
            for little in [true, false] {
                let arrives = |first, last| line.carries(&[range(kind, little, first, last)]);
                // Nothing there yet is 1 to 0.
                for (first, last) in [
                    (1, 0),
                    (257, 256),
                    (1, 1),
                    (1, 500_000),
                    (0x7fff_ff00, 0x8000_0100),
                    ((5 << 32) + 7, (5 << 32) + 900),
                ] {
                    assert!(arrives(first, last), "{kind} {little} {first} {last}");
                }
                for (first, last) in [
                    (1, 1 << 40),
                    (1, 1 << 32),
                    (1, 1 << 30),
                    (1, 1 << 21),
                    (7, u64::MAX),
                    (1 << 40, 7),
                    (1 << 30, 7),
                ] {
                    assert!(!arrives(first, last), "{kind} {little} {first} {last}");
                }
            }
        }
    }

    #[test]
    fn a_message_in_fragments_is_no_larger_than_16_mb() {
        let line = Line::new();
        for little in [true, false] {
            assert!(line.carries(&[fragment(little, 1 << 20)]));
            assert!(!line.carries(&[fragment(little, 1 << 24)]));
            assert!(!line.carries(&[fragment(little, u32::MAX)]));
        }
    }

    #[test]
    fn a_submessage_is_found_behind_others_and_what_is_cut_off_is_dropped() {
        let line = Line::new();
        let good = range(HEARTBEAT, true, 1, 9);
        let bad = range(HEARTBEAT, true, 1, 1 << 40);
        let before = [
            submessage(0x0e, true, &[1, 2, 3]),
            submessage(INFO_TS, false, &[]),
            submessage(PAD, true, &[]),
            submessage(0x15, false, &[4; 40]),
        ];
        for number in 0..=before.len() {
            let with = |last: &Vec<u8>| [&before[..number], std::slice::from_ref(last)].concat();
            assert!(line.carries(&with(&good)), "{number}");
            assert!(!line.carries(&with(&bad)), "{number}");
        }
        // Data without a length is the last of a datagram, whatever its bytes say.
        assert!(line.carries(&[submessage(0x15, true, &[]), bad]));
        assert!(!line.carries(&[good[..good.len() - 8].to_vec()]));
        // What is no message at all is the library's to refuse.
        assert!(line.carries_bytes(b"hello"));
    }
}
