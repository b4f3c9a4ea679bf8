//! The store on a flash whose power fails: at every operation, in each of several ways, at random,
//! and twice in a row.
//!
//! What is found afterwards is the old state or the new one. Time is counted in words read and
//! operations done.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use omnibus_robot::record_store::{Flash, RecordStore, StoreError};
use omnibus_robot::{IMAGE_MAX, StoreWear};
use protocol::crc32;

/// Bytes of a sector on the robot, and of one that fills up sooner.
const SECTOR: u32 = 0x4000;
const SHORT: u32 = 4096;
/// Saves in a row: enough to fill both short sectors and to erase each.
const SAVES: usize = 30;

/// What the power leaves of the operation in which it fails.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Left {
    Nothing,
    Half,
    All,
    /// Some of the bits; of an erase, a sector of anything.
    Some(u32),
}

/// Numbers that look random (xorshift).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 16) as u32
    }

    fn below(&mut self, end: u32) -> u32 {
        self.next() % end
    }
}

/// Two sectors. Every word programmed and every sector erased is one operation.
struct Memory {
    words: Vec<u32>,
    operations: usize,
    cut: Option<(usize, Left)>,
    erases: usize,
    /// Bits have changed by themselves: what ought to be blank need not be.
    has_decayed: bool,
}

#[derive(Clone)]
struct Fake<const LENGTH: u32> {
    memory: Rc<RefCell<Memory>>,
    reads: Rc<Cell<usize>>,
}

impl<const LENGTH: u32> Fake<LENGTH> {
    fn new() -> Self {
        Self::with(vec![u32::MAX; LENGTH as usize / 2])
    }

    fn with(words: Vec<u32>) -> Self {
        Self {
            memory: Rc::new(RefCell::new(Memory {
                words,
                operations: 0,
                cut: None,
                erases: 0,
                has_decayed: false,
            })),
            reads: Rc::default(),
        }
    }

    /// The flash of an older version: what there is up to the last byte that is not blank.
    fn from_bytes(bytes: &[u8]) -> Self {
        let mut bytes = bytes.to_vec();
        bytes.resize(2 * LENGTH as usize, 0xFF);
        let words = bytes.chunks(4);
        Self::with(
            words
                .map(|word| u32::from_le_bytes(word.try_into().unwrap()))
                .collect(),
        )
    }

    fn copy(&self) -> Self {
        Self::with(self.memory.borrow().words.clone())
    }

    fn cut(&self, at: usize, left: Left) {
        let mut memory = self.memory.borrow_mut();
        memory.cut = Some((memory.operations + at, left));
    }

    fn power_on(&self) -> RecordStore<Self> {
        self.memory.borrow_mut().cut = None;
        RecordStore::open(self.clone())
    }

    fn operations(&self) -> usize {
        self.memory.borrow().operations
    }

    /// How much of the next operation is done; none after a cut.
    fn next(&self) -> (Left, Result<(), StoreError>) {
        let mut memory = self.memory.borrow_mut();
        memory.operations += 1;
        match memory.cut {
            Some((at, left)) if memory.operations == at => (left, Err(StoreError)),
            Some((at, _)) if memory.operations > at => (Left::Nothing, Err(StoreError)),
            _ => (Left::All, Ok(())),
        }
    }
}

impl<const LENGTH: u32> Flash for Fake<LENGTH> {
    const SECTOR: u32 = LENGTH;

    fn word(&self, at: u32) -> u32 {
        assert_eq!(at % 4, 0);
        self.reads.set(self.reads.get() + 1);
        self.memory.borrow().words[at as usize / 4]
    }

    fn program(&mut self, at: u32, word: u32) -> Result<(), StoreError> {
        let (left, result) = self.next();
        let mut memory = self.memory.borrow_mut();
        let has_decayed = memory.has_decayed;
        let cell = &mut memory.words[at as usize / 4];
        assert!(
            has_decayed || result.is_err() || *cell == u32::MAX || word == 0,
            "at {at:#x}: not blank"
        );
        *cell &= match left {
            Left::Nothing => u32::MAX,
            Left::Half => word | 0xFFFF_0000,
            Left::All => word,
            Left::Some(bits) => word | bits,
        };
        result
    }

    fn erase(&mut self, at: u32) -> Result<(), StoreError> {
        assert_eq!(at % LENGTH, 0);
        let (left, result) = self.next();
        let mut memory = self.memory.borrow_mut();
        memory.erases += 1;
        let length = LENGTH as usize / 4;
        let sector = &mut memory.words[at as usize / 4..][..length];
        match left {
            Left::Nothing => {}
            Left::Half => sector[..length / 2].fill(u32::MAX),
            Left::All => sector.fill(u32::MAX),
            Left::Some(bits) => {
                let mut random = Random(u64::from(bits) + 1);
                sector.fill_with(|| random.next() | random.next());
            }
        }
        result
    }
}

/// The `n`th image: no two alike, of different lengths, the first longest.
fn image(n: usize) -> Vec<u8> {
    (0..IMAGE_MAX - n * 7)
        .map(|at| (at as u8).wrapping_mul(31) ^ n as u8)
        .collect()
}

fn load<F: Flash>(store: &RecordStore<F>) -> Option<Vec<u8>> {
    let mut buffer = [0; IMAGE_MAX];
    let image = store.image(&mut buffer).expect("it can be read");
    image.map(<[u8]>::to_vec)
}

/// Saves one image after the other until the power fails; returns how many saves were complete.
fn save_all<F: Flash>(mut store: RecordStore<F>) -> usize {
    (1..=SAVES)
        .take_while(|n| store.save(&image(*n)).is_ok())
        .count()
}

#[test]
fn a_blank_flash_holds_nothing() {
    let store = Fake::<SECTOR>::new().power_on();
    assert_eq!(load(&store), None);
    assert!(!store.was_cut());
    assert_eq!(store.wear(), StoreWear::default());
}

#[test]
fn the_last_image_comes_back() {
    let flash = Fake::<SHORT>::new();
    assert_eq!(save_all(flash.power_on()), SAVES);
    assert_eq!(load(&flash.power_on()), Some(image(SAVES)));
    assert!(flash.memory.borrow().erases >= 3, "both sectors fill up");
}

#[test]
fn a_power_cut_at_every_operation_leaves_the_old_or_the_new_image() {
    let whole = Fake::<SHORT>::new();
    save_all(whole.power_on());
    let mut cuts_reported = 0;
    for left in [
        Left::Nothing,
        Left::Half,
        Left::All,
        Left::Some(0x0F0F_55AA),
    ] {
        for cut in 1..=whole.operations() {
            let flash = Fake::<SHORT>::new();
            let mut store = flash.power_on();
            flash.cut(cut, left);
            let mut complete = 0;
            while store.save(&image(complete + 1)).is_ok() {
                complete += 1;
                if flash.operations() >= cut {
                    break;
                }
            }
            let store = flash.power_on();
            let (found, told) = (load(&store), store.was_cut());
            let old = (complete > 0).then(|| image(complete));
            let is_new = found == Some(image(complete + 1));
            let name = format!("{left:?} of operation {cut}, after {complete} saves");
            assert!(found == old || is_new, "{name}");
            // Whoever waits for an answer in vain finds that nothing has changed, or the robot says
            // so; or the save was complete but for its last word.
            let saves = store.wear().saves as usize;
            assert_eq!(saves, complete + usize::from(is_new), "{name}");
            assert_eq!(store.wear().cut, u32::from(told), "{name}");
            cuts_reported += usize::from(told);
            // It is told until something has been written, and goes on working.
            let mut store = flash.power_on();
            assert_eq!(store.was_cut(), told, "{name}");
            store.add_fault(&[1]).expect("it can be written");
            let mut store = flash.power_on();
            assert!(!store.was_cut(), "{name}");
            assert_eq!(load(&store), found, "{name}");
            assert_eq!(store.wear().cut, u32::from(told), "{name}");
            store.save(&image(SAVES)).expect("it can be written");
            assert_eq!(load(&flash.power_on()), Some(image(SAVES)), "{name}");
        }
    }
    assert!(cuts_reported > whole.operations(), "{cuts_reported}");
}

#[test]
fn wear_is_counted_and_kept() {
    let flash = Fake::<SHORT>::new();
    assert_eq!(save_all(flash.power_on()), SAVES);
    let mut store = flash.power_on();
    let wear = StoreWear {
        saves: SAVES as u32,
        erases: flash.memory.borrow().erases as u32,
        cut: 0,
    };
    assert_eq!(store.wear(), wear);
    for start in 1..=1_000 {
        store.add_start().unwrap();
        assert_eq!(store.starts(), start);
    }
    let store = flash.power_on();
    assert_eq!((store.starts(), store.wear().saves), (1_000, SAVES as u32));
    assert_eq!(load(&store), Some(image(SAVES)));
}

/// What a robot may spend: every word of both sectors read twice at a start, and with what a save
/// copies four times.
#[test]
fn neither_the_count_nor_the_size_of_saves_makes_a_start_or_a_save_slower() {
    let words = 2 * SECTOR as usize / 4;
    let (mut slowest_start, mut slowest_save, mut most_operations) = (0, 0, 0);
    for length in [8, 9, 100, 139, 276, 404, IMAGE_MAX] {
        let flash = Fake::<SECTOR>::new();
        let mut store = flash.power_on();
        for save in 0..2_500 {
            let image = vec![save as u8; length];
            let (reads, operations) = (flash.reads.get(), flash.operations());
            store.save(&image).unwrap();
            slowest_save = slowest_save.max(flash.reads.get() - reads);
            most_operations = most_operations.max(flash.operations() - operations);
            if save % 50 == 49 {
                let reads = flash.reads.get();
                store = flash.power_on();
                slowest_start = slowest_start.max(flash.reads.get() - reads);
                assert_eq!(load(&store), Some(image));
            }
        }
    }
    println!(
        "{slowest_start} words read at a start, {slowest_save} and {most_operations} operations \
         in a save"
    );
    assert!(slowest_start <= 2 * words, "{slowest_start} words");
    assert!(slowest_save <= 4 * words, "{slowest_save} words");
    assert!(most_operations <= 600, "{most_operations} operations");
}

/// A robot's life: saves of any size, faults and starts, and the power fails anywhere, in any way.
#[test]
fn ten_thousand_random_saves_and_power_cuts() {
    let mut random = Random(0x00C0_FFEE);
    let flash = Fake::<SECTOR>::new();
    let mut store = flash.power_on();
    let (mut kept, mut faults, mut starts): (Option<Vec<u8>>, Vec<u32>, u32) = (None, vec![], 0);
    let (mut cuts, mut slowest) = (0, 0);
    for step in 0..10_000_u32 {
        let is_cut = random.below(3) == 0;
        if is_cut {
            let left = match random.below(4) {
                0 => Left::Nothing,
                1 => Left::Half,
                2 => Left::All,
                _ => Left::Some(random.next()),
            };
            let at = if random.below(2) == 0 {
                random.below(8)
            } else {
                random.below(500)
            };
            flash.cut(at as usize + 1, left);
        }
        let mut image = Vec::new();
        let done = match random.below(4) {
            0 => store.add_fault(&step.to_le_bytes()),
            1 => store.add_start(),
            _ => {
                let longest = [16, 200, IMAGE_MAX as u32][random.below(3) as usize];
                image.resize(8 + random.below(longest - 8) as usize, step as u8);
                image[0] = (step >> 8) as u8;
                store.save(&image)
            }
        };
        let may_be_new = done.is_err() || is_cut;
        if is_cut || random.below(20) == 0 {
            cuts += u32::from(is_cut);
            flash.reads.set(0);
            store = flash.power_on();
            slowest = slowest.max(flash.reads.get());
        }
        if done.is_ok() && !image.is_empty() {
            kept = Some(image.clone());
        }
        let found = load(&store);
        let is_new = may_be_new && !image.is_empty() && found.as_deref() == Some(&image[..]);
        assert!(found == kept || is_new, "step {step}");
        kept = found;

        let stored: Vec<u32> = store.faults().map(u32::from_le_bytes).collect();
        let mut expected = faults.clone();
        if stored.last() == Some(&step) {
            expected.push(step);
        } else {
            let is_fault = image.is_empty() && store.starts() == starts;
            assert!(!(is_fault && done.is_ok()), "step {step}: a fault is lost");
        }
        expected.drain(..expected.len().saturating_sub(8));
        assert_eq!(stored, expected, "step {step}");
        faults = stored;
        assert!((starts..=starts + 1).contains(&store.starts()));
        starts = store.starts();
    }
    let erases = flash.memory.borrow().erases;
    println!("{cuts} cuts, {erases} erases, {slowest} words read at the slowest start");
    assert!(cuts > 3_000 && erases > 100);
    assert!(slowest <= 2 * 2 * SECTOR as usize / 4);
}

#[test]
fn the_last_eight_faults_are_kept_in_order() {
    let flash = Fake::<SHORT>::new();
    let mut store = flash.power_on();
    store.save(&image(1)).unwrap();
    for fault in 0..500_u32 {
        store.add_fault(&fault.to_le_bytes()).unwrap();
        if fault % 7 == 0 {
            store = flash.power_on();
        }
        let found: Vec<u32> = store.faults().map(u32::from_le_bytes).collect();
        let expected: Vec<u32> = (fault.saturating_sub(7)..=fault).collect();
        assert_eq!(found, expected);
    }
    assert_eq!(load(&store), Some(image(1)));
}

/// The `n`th key.
fn key(n: usize) -> [u8; 32] {
    [n as u8; 32]
}

/// Changes the key again and again, with images in between, until the power fails; returns how many
/// changes were complete.
fn change_keys<F: Flash>(mut store: RecordStore<F>) -> usize {
    let mut change = |n| {
        store.set_key(&key(n))?;
        // It is not what is cut, but makes the sectors fill up.
        let _ = store.save(&image(n));
        Ok::<(), StoreError>(())
    };
    (1..=12).take_while(|n| change(*n).is_ok()).count()
}

#[test]
fn a_power_cut_at_every_operation_leaves_the_old_or_the_new_key() {
    let whole = Fake::<SHORT>::new();
    assert_eq!(change_keys(whole.power_on()), 12);
    assert!(whole.memory.borrow().erases >= 2);
    assert_eq!(whole.power_on().key(), key(12));
    for left in [
        Left::Nothing,
        Left::Half,
        Left::All,
        Left::Some(0x0F0F_55AA),
    ] {
        for cut in 1..=whole.operations() {
            let flash = Fake::<SHORT>::new();
            let store = flash.power_on();
            flash.cut(cut, left);
            let complete = change_keys(store);
            let mut store = flash.power_on();
            let found = store.key();
            let name = format!("{left:?} of operation {cut}, after {complete} changes");
            assert!(
                found == key(complete) || found == key(complete + 1),
                "{name}"
            );
            // It goes on, and the key stays when the other sector takes over.
            for n in 0..6 {
                store.save(&image(n)).expect("it can be written");
            }
            assert_eq!(flash.power_on().key(), found, "{name}");
        }
    }
}

/// Bits that change by themselves, one in each word of what is stored.
#[test]
fn what_has_decayed_is_not_used_and_stops_nobody() {
    let flash = Fake::<SHORT>::new();
    // An older image lies in the other sector and another one before the newest: neither must be
    // taken.
    save_all(flash.power_on());
    let mut store = flash.power_on();
    for fault in 0..3_u32 {
        store.add_fault(&fault.to_le_bytes()).unwrap();
    }
    store.save(&image(1)).unwrap();
    store.add_fault(&3_u32.to_le_bytes()).unwrap();
    let words = flash.memory.borrow().words.len();
    let (mut unreadable, mut fewer) = (0, 0);
    for word in 0..words {
        for bit in [0, 7, 13, 30] {
            let flash = flash.copy();
            flash.memory.borrow_mut().has_decayed = true;
            flash.memory.borrow_mut().words[word] ^= 1 << bit;
            let mut store = flash.power_on();
            let mut buffer = [0; IMAGE_MAX];
            match store.image(&mut buffer) {
                Ok(found) => assert_eq!(found, Some(&image(1)[..]), "word {word}, bit {bit}"),
                Err(StoreError) => unreadable += 1,
            }
            let faults: Vec<u32> = store.faults().map(u32::from_le_bytes).collect();
            assert!(faults.is_sorted(), "{faults:?}");
            fewer += usize::from(faults.len() < 4);
            // Whatever it was, a save puts it right.
            store.save(&image(2)).expect("it can be written");
            assert_eq!(load(&flash.power_on()), Some(image(2)));
        }
    }
    println!("{unreadable} times unreadable, {fewer} times a fault less");
    assert!(unreadable > 4 * image(1).len() / 4 && fewer > 0);
}

/// Flash that has never been a store of any kind.
#[test]
fn any_content_can_be_opened_and_written() {
    let mut random = Random(7);
    for round in 0..300 {
        let flash = Fake::<SHORT>::new();
        flash.memory.borrow_mut().has_decayed = true;
        let holes = random.below(4);
        for word in &mut flash.memory.borrow_mut().words {
            if random.below(4) >= holes {
                *word = random.next();
            }
        }
        let mut store = flash.power_on();
        let _ = store.image(&mut [0; IMAGE_MAX]);
        assert_eq!(store.faults::<4>().count(), 0, "round {round}");
        store.save(&image(2)).expect("it can be written");
        let store = flash.power_on();
        assert_eq!(load(&store), Some(image(2)), "round {round}");
        assert!(!store.was_cut(), "round {round}");
    }
}

/// Flashes as the version before left them, the half track they hold in m (0.4 saved first, 0.5
/// later), and whether a save was cut off.
const BEFORE: [(&str, &[u8], f32, bool); 5] = [
    (
        "one image",
        include_bytes!("data/one-image.bin"),
        0.4,
        false,
    ),
    (
        "the second sector in use",
        include_bytes!("data/second-sector.bin"),
        0.5,
        false,
    ),
    (
        "power lost while a full sector was copied",
        include_bytes!("data/cut-in-the-copy.bin"),
        0.4,
        true,
    ),
    (
        "power lost while the record before a save was written",
        include_bytes!("data/cut-in-the-record.bin"),
        0.4,
        false,
    ),
    (
        "so many small images that it did not start any more",
        include_bytes!("data/stuck.bin"),
        0.4,
        false,
    ),
];

#[test]
fn a_store_of_the_version_before_is_taken_over() {
    for (name, bytes, half_track, was_cut) in BEFORE {
        let flash = Fake::<SECTOR>::from_bytes(bytes);
        let store = flash.power_on();
        let reads = flash.reads.get();
        let before = load(&store).unwrap_or_else(|| panic!("{name}: no image"));
        let (crc, content) = before.split_first_chunk().unwrap();
        let content = content.iter().copied();
        assert_eq!(u32::from_le_bytes(*crc), crc32(content), "{name}");
        let half_track = half_track.to_le_bytes();
        let at = before.windows(4).position(|value| value == half_track);
        assert!(at.is_some(), "{name}");
        let wear = store.wear();
        println!(
            "{name}: {} bytes, {wear:?}, {reads} words read",
            before.len()
        );
        assert!(wear.saves > 0, "{name}");
        assert_eq!(store.was_cut(), was_cut, "{name}");
        assert!(reads <= 12 * SECTOR as usize, "{name}: {reads} words");

        // A save over it, cut off everywhere, leaves the old image or the new one.
        let whole = flash.copy();
        whole.power_on().save(&image(1)).unwrap();
        let (mut old, mut new) = (0, 0);
        for left in [
            Left::Nothing,
            Left::Half,
            Left::All,
            Left::Some(0x1234_5678),
        ] {
            for cut in 1..=whole.operations() {
                let flash = flash.copy();
                let mut store = flash.power_on();
                flash.cut(cut, left);
                let done = store.save(&image(1));
                let store = flash.power_on();
                let found = load(&store);
                let is_new = found == Some(image(1));
                assert!(
                    is_new || found.as_ref() == Some(&before),
                    "{name}, {left:?} of {cut}"
                );
                assert!(is_new || done.is_err(), "{name}, {left:?} of {cut}");
                (old, new) = (old + usize::from(!is_new), new + usize::from(is_new));
                let mut store = flash.power_on();
                store.save(&image(2)).unwrap();
                let store = flash.power_on();
                assert_eq!(load(&store), Some(image(2)));
                assert!(!store.was_cut(), "{name}, {left:?} of {cut}");
            }
        }
        assert!(old > 0 && new > 0, "{name}");
    }
}
