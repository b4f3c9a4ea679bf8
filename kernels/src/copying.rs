//! Tests the firmware's own copying and clearing of memory, at every alignment of words and for
//! every length up to one at which all of its loops have run, and its division of 64 bits, with
//! operands on both sides of powers of two.

use core::hint::black_box;

/// Bytes of a buffer, and the longest run that is moved within it.
const SIZE: usize = 48;
const LONGEST: usize = 24;

/// Calls [`memory_is_right`] when all is right.
pub fn check() {
    let fits = |f: fn(usize, usize, usize) -> bool| {
        (0..4).all(|to| (0..4).all(|from| (0..=LONGEST).all(|length| f(to, from, length))))
    };
    if fits(copies) && fits(moves) && fits(fills) && divides() {
        memory_is_right();
    }
}

/// The caller of this image looks it up by name.
#[inline(never)]
fn memory_is_right() {
    // Not empty: it would be one with the empty function of `kernels`.
    black_box(1);
}

/// Bytes that all differ.
fn pattern() -> [u8; SIZE] {
    let mut bytes = [0; SIZE];
    for (place, byte) in bytes.iter_mut().enumerate() {
        *byte = black_box(place as u8 ^ 0xA5);
    }
    bytes
}

/// Byte by byte, which `black_box` keeps from becoming a call of the function under test.
fn equal(found: &[u8; SIZE], want: impl Fn(usize) -> u8) -> bool {
    let mut places = found.iter().enumerate();
    places.all(|(place, byte)| black_box(*byte) == black_box(want(place)))
}

const fn within(place: usize, begin: usize, length: usize) -> bool {
    begin <= place && place < begin + length
}

fn copies(to: usize, from: usize, length: usize) -> bool {
    let source = black_box(pattern());
    let mut target = black_box([0x11; SIZE]);
    let run = black_box(from)..black_box(from) + black_box(length);
    let Some(run) = source.get(run) else {
        return false;
    };
    if let Some(place) = target.get_mut(to..to + run.len()) {
        place.copy_from_slice(run);
    }
    equal(&target, |place| {
        if within(place, to, length) {
            (place - to + from) as u8 ^ 0xA5
        } else {
            0x11
        }
    })
}

/// Within one buffer, upwards and downwards by up to three bytes and far apart.
fn moves(to: usize, from: usize, length: usize) -> bool {
    [(to, from), (to + 20, from), (to, from + 20)]
        .into_iter()
        .all(|(to, from)| {
            let mut bytes = black_box(pattern());
            bytes.copy_within(from..from + black_box(length), to);
            equal(&bytes, |place| {
                if within(place, to, length) {
                    (place - to + from) as u8 ^ 0xA5
                } else {
                    place as u8 ^ 0xA5
                }
            })
        })
}

/// `value` is a byte in disguise, so that it is not always zero.
fn fills(to: usize, value: usize, length: usize) -> bool {
    let value = black_box(value as u8 * 85);
    let mut bytes = black_box(pattern());
    if let Some(place) = bytes.get_mut(to..to + black_box(length)) {
        place.fill(value);
    }
    equal(&bytes, |place| {
        if within(place, to, length) {
            value
        } else {
            place as u8 ^ 0xA5
        }
    })
}

/// Quotient times divisor and remainder are the dividend, and the remainder is less than the
/// divisor: no other pair of numbers is so.
fn divides() -> bool {
    /// Around these the division takes another way, or another number of its digits.
    const POWERS: [u32; 12] = [0, 1, 2, 15, 16, 17, 31, 32, 33, 47, 48, 63];
    let around = |power: u32| {
        [
            (1_u64 << power).wrapping_sub(1),
            1 << power,
            (1 << power) | 5,
        ]
    };
    POWERS.into_iter().flat_map(around).all(|dividend| {
        POWERS.into_iter().flat_map(around).all(|divisor| {
            let (dividend, divisor) = (black_box(dividend), black_box(divisor));
            if divisor == 0 {
                return true;
            }
            let (quotient, rest) = (black_box(dividend / divisor), black_box(dividend % divisor));
            rest < divisor
                && quotient
                    .checked_mul(divisor)
                    .and_then(|whole| whole.checked_add(rest))
                    == Some(dividend)
        })
    })
}
