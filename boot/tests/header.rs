//! Headers of image files: what is refused, and that anything but the signed bytes is.

use omnibus_boot::header::{Board, Device, Header, HeaderError, LENGTH, Link, Refusal};
use omnibus_boot::{Crypto, Slot, Software, key, public_key, sign};

const DEVICE: Device = Device {
    board: Board::NUCLEO_F446RE,
    hardware: 1,
    security_counter: 7,
};

fn header() -> Header {
    let link = |length, byte| Link {
        length,
        hash: [byte; 64],
    };
    Header {
        board: Board::NUCLEO_F446RE,
        hardware: 1,
        wire_version: 5,
        version: 0x0001_0203,
        security_counter: 7,
        a: link(118_188, 0xA5),
        b: link(118_192, 0x5A),
    }
}

fn signed(header: &Header) -> Vec<u8> {
    let message = header.to_bytes();
    let signature = sign(&key::DEVELOPMENT_PRIVATE, &message);
    [&message[..], &signature].concat()
}

const DEVELOPMENT: Software = Software {
    public_key: key::DEVELOPMENT,
};

/// Bytes of hexadecimal digits.
fn hex<const N: usize>(digits: &str) -> [u8; N] {
    std::array::from_fn(|nth| u8::from_str_radix(&digits[2 * nth..2 * nth + 2], 16).unwrap())
}

#[test]
fn rfc_8032_section_7_1_test_3() {
    let private = hex("c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7");
    let public = hex("fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025");
    let signature = hex(
        "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac\
         18ff9b538d16f290ae67f760984dc6594a7c15e9716ed28dc027beceea1ec40a",
    );
    let message = [0xAF, 0x82];
    assert_eq!(public_key(&private), public);
    assert_eq!(sign(&private, &message), signature);
    assert!(Software { public_key: public }.is_signed(&message, &signature));
    assert!(!Software { public_key: public }.is_signed(&[0xAF, 0x83], &signature));
}

#[test]
fn fips_180_sha_512_of_abc_in_pieces() {
    let expected = hex(
        "ddaf35a193617abacc417349ae20413112e6fa4e89a97ea20a9eeee64b55d39a\
         2192992a274fc1a836ba3c23a3feebbd454d4423643ce80e2a9ac94fa54ca49f",
    );
    let mut hash = DEVELOPMENT.begin();
    DEVELOPMENT.update(&mut hash, b"a");
    DEVELOPMENT.update(&mut hash, b"");
    DEVELOPMENT.update(&mut hash, b"bc");
    assert_eq!(DEVELOPMENT.finish(hash), expected);
}

#[test]
fn the_development_key_is_a_pair() {
    assert_eq!(public_key(&key::DEVELOPMENT_PRIVATE), key::DEVELOPMENT);
}

#[test]
fn a_header_says_what_it_was_made_from() {
    let bytes = signed(&header());
    assert_eq!(bytes.len(), LENGTH);
    assert_eq!(Header::parse(&bytes), Ok(header()));
    assert!(Header::is_signed(&bytes, &DEVELOPMENT));
    assert_eq!(header().download_length(Slot::A), 256 + 118_188);
    assert_eq!(header().offset(Slot::B), 256 + 118_188);
    assert_eq!(header().admit(&DEVICE), Ok(()));
}

#[test]
fn one_bit_anywhere_takes_the_signature_away() {
    let bytes = signed(&header());
    for bit in 0..LENGTH * 8 {
        let mut bent = bytes.clone();
        bent[bit / 8] ^= 1 << (bit % 8);
        assert!(!Header::is_signed(&bent, &DEVELOPMENT), "bit {bit}");
    }
}

#[test]
fn a_signature_by_another_key_counts_for_nothing() {
    let message = header().to_bytes();
    let foreign = sign(&[42; 32], &message);
    assert!(!Header::is_signed(
        &[&message[..], &foreign].concat(),
        &DEVELOPMENT
    ));
    let other = Software {
        public_key: public_key(&[42; 32]),
    };
    assert!(!Header::is_signed(&signed(&header()), &other));
    // Not a point of the curve.
    let none = Software {
        public_key: [0xFF; 32],
    };
    assert!(!Header::is_signed(&signed(&header()), &none));
}

#[test]
fn what_is_no_header_is_refused_by_name() {
    let parse = |at: usize, part: &[u8]| {
        let mut bytes = signed(&header());
        bytes[at..at + part.len()].copy_from_slice(part);
        Header::parse(&bytes)
    };
    assert_eq!(Header::parse(&[]), Err(HeaderError::Short));
    assert_eq!(
        Header::parse(&signed(&header())[..LENGTH - 1]),
        Err(HeaderError::Short)
    );
    assert_eq!(parse(7, b"\n"), Err(HeaderError::Magic));
    assert_eq!(parse(8, &[2, 0]), Err(HeaderError::Format(2)));
    assert_eq!(parse(31, &[1]), Err(HeaderError::Reserved));
    assert_eq!(parse(191, &[1]), Err(HeaderError::Reserved));
    let b = Slot::B.address().to_le_bytes();
    assert_eq!(parse(32, &b), Err(HeaderError::Address(Slot::A)));
    for wrong in [0, 508, 118_190, 0x3_0000 - 60, u32::MAX - 3] {
        let refused = parse(36, &u32::to_le_bytes(wrong));
        assert_eq!(refused, Err(HeaderError::Length(Slot::A)), "{wrong}");
    }
    let longest = parse(108, &(0x4_0000_u32 - 64).to_le_bytes());
    assert_eq!(longest.map(|header| header.b.length), Ok(0x3_FFC0));
}

#[test]
fn an_image_for_another_robot_or_below_the_security_counter_is_not_admitted() {
    let admit = |change: fn(&mut Header)| {
        let mut header = header();
        change(&mut header);
        header.admit(&DEVICE)
    };
    let board = Board::ROBOMASTER_C;
    assert_eq!(
        admit(|header| header.board = Board(2)),
        Err(Refusal::Board(board))
    );
    assert_eq!(
        admit(|header| header.hardware = 2),
        Err(Refusal::Hardware(2))
    );
    assert_eq!(
        admit(|header| header.security_counter = 6),
        Err(Refusal::Downgrade(6))
    );
    assert_eq!(admit(|header| header.security_counter = 8), Ok(()));
    assert_eq!(admit(|header| header.version = 0), Ok(()));
}

/// A sequence of numbers, the same every time (Marsaglia, "Xorshift RNGs", 64 bits).
struct Random(u64);

impl Random {
    fn below(&mut self, end: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 32) as usize % end
    }

    fn byte(&mut self) -> u8 {
        self.below(256) as u8
    }
}

/// A million headers: bits flipped, bytes and words replaced by their extremes, cut off, or random
/// from the start. What is read says the same when it is written, so no byte is without a meaning;
/// what is admitted is for this device; and nothing but the signed bytes has the signature.
#[test]
fn a_million_fuzzed_headers_are_refused_or_read_to_the_last_byte() {
    let good = signed(&header());
    let mut random = Random(0x9E37_79B9_7F4A_7C15);
    let (mut read, mut admitted, mut checked) = (0, 0, 0);
    for round in 0..1_000_000 {
        let mut bytes = good.clone();
        for _ in 0..=random.below(3) {
            let at = random.below(LENGTH);
            match random.below(4) {
                0 => bytes[at] ^= 1 << random.below(8),
                1 => bytes[at] = random.byte(),
                2 => bytes[at / 4 * 4..][..4].fill([0, 0xFF][random.below(2)]),
                _ => bytes[at] = bytes[at].wrapping_add(1),
            }
        }
        match random.below(16) {
            0 => bytes.truncate(random.below(LENGTH + 1)),
            1 => bytes.iter_mut().for_each(|byte| *byte = random.byte()),
            2 => bytes.extend([0; 40]),
            _ => {}
        }
        let Ok(found) = Header::parse(&bytes) else {
            continue;
        };
        read += 1;
        assert_eq!(found.to_bytes()[..], bytes[..192], "round {round}");
        let fits = found.board == DEVICE.board
            && found.hardware == DEVICE.hardware
            && found.security_counter >= DEVICE.security_counter;
        assert_eq!(found.admit(&DEVICE).is_ok(), fits, "round {round}");
        admitted += u32::from(fits);
        // The check of a signature takes as long as ten thousand headers.
        if fits && bytes[..LENGTH] != good && admitted % 4_096 == 0 {
            checked += 1;
            assert!(
                !Header::is_signed(&bytes[..LENGTH], &DEVELOPMENT),
                "{round}"
            );
        }
    }
    println!("{read} read, {admitted} admitted, {checked} signatures checked");
    assert!(read > 100_000 && admitted > 50_000 && checked > 10);
}
