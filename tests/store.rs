//! The firmware's parameter store on a flash whose power fails: at every operation of a long row of saves, in each of
//! several ways. What is found afterwards is the last complete image or the one being written; it is the same code as in
//! the image (`src/store.rs`), on sectors a quarter as long so that they fill up sooner.

#[path = "../src/store.rs"]
mod store;

use std::cell::RefCell;
use std::rc::Rc;

use controller::IMAGE_MAX;
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use store::{BUFFER, Store};

const SECTOR: usize = 4096;
/// Saves in a row: enough to fill both sectors and to erase each.
const SAVES: u8 = 30;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Failed;

impl NorFlashError for Failed {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// What the power leaves of the operation in which it fails.
#[derive(Clone, Copy, Debug)]
enum Left {
    Nothing,
    Half,
    All,
}

/// Two sectors. Every word programmed and every sector erased is one operation.
struct Memory {
    bytes: Vec<u8>,
    operations: usize,
    cut: Option<(usize, Left)>,
    erases: usize,
}

impl Memory {
    fn new() -> Rc<RefCell<Self>> {
        Rc::new(RefCell::new(Self {
            bytes: vec![0xFF; 2 * SECTOR],
            operations: 0,
            cut: None,
            erases: 0,
        }))
    }

    /// How much of the next operation is done; after a cut, nothing is.
    fn next(&mut self, length: usize) -> Result<usize, (usize, Failed)> {
        self.operations += 1;
        match self.cut {
            Some((at, left)) if self.operations == at => Err((
                match left {
                    Left::Nothing => 0,
                    Left::Half => length / 2,
                    Left::All => length,
                },
                Failed,
            )),
            Some((at, _)) if self.operations > at => Err((0, Failed)),
            _ => Ok(length),
        }
    }
}

struct Fake(Rc<RefCell<Memory>>);

impl ErrorType for Fake {
    type Error = Failed;
}

impl ReadNorFlash for Fake {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failed> {
        let at = offset as usize;
        bytes.copy_from_slice(&self.0.borrow().bytes[at..at + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * SECTOR
    }
}

impl NorFlash for Fake {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Failed> {
        let mut memory = self.0.borrow_mut();
        for sector in (from as usize..to as usize).step_by(SECTOR) {
            memory.erases += 1;
            let (done, result) = match memory.next(SECTOR) {
                Ok(done) => (done, Ok(())),
                Err((done, failed)) => (done, Err(failed)),
            };
            memory.bytes[sector..sector + done].fill(0xFF);
            result?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failed> {
        assert_eq!((offset % 4, bytes.len() % 4), (0, 0), "whole words");
        let mut memory = self.0.borrow_mut();
        for (word, at) in bytes.chunks(4).zip((offset as usize..).step_by(4)) {
            let (done, result) = match memory.next(4) {
                Ok(done) => (done, Ok(())),
                Err((done, failed)) => (done, Err(failed)),
            };
            for (cell, new) in memory.bytes[at..at + done].iter_mut().zip(word) {
                *cell &= new;
            }
            result?;
        }
        Ok(())
    }
}

/// The `n`th image: no two alike in any part, of different lengths, the first longest.
fn image(n: u8) -> Vec<u8> {
    (0..IMAGE_MAX - usize::from(n) * 7)
        .map(|at| (at as u8).wrapping_mul(31) ^ n)
        .collect()
}

fn power_on(memory: &Rc<RefCell<Memory>>) -> Store<Fake> {
    Store::new(Fake(Rc::clone(memory)), 0)
}

/// What is stored, and whether the last save was cut off.
fn start(memory: &Rc<RefCell<Memory>>) -> (Option<Vec<u8>>, bool) {
    let mut store = power_on(memory);
    let cut = store.open().expect("it can be opened");
    let mut buffer = [0; BUFFER];
    let image = store.load(&mut buffer).expect("it can be read");
    (image.map(<[u8]>::to_vec), cut)
}

fn load(memory: &Rc<RefCell<Memory>>) -> Option<Vec<u8>> {
    start(memory).0
}

/// Saves one image after the other until the power fails; returns how many saves were complete.
fn save_all(memory: &Rc<RefCell<Memory>>) -> u8 {
    let mut store = power_on(memory);
    store.open().expect("it can be opened");
    let done = (1..=SAVES).take_while(|n| store.save(&image(*n)).is_ok());
    u8::try_from(done.count()).unwrap()
}

#[test]
fn a_blank_flash_holds_nothing() {
    assert_eq!(load(&Memory::new()), None);
}

#[test]
fn the_last_image_comes_back() {
    let memory = Memory::new();
    assert_eq!(save_all(&memory), SAVES);
    assert_eq!(load(&memory), Some(image(SAVES)));
    assert!(memory.borrow().erases >= 3, "the test fills both sectors");
}

#[test]
fn a_power_cut_at_every_operation_leaves_the_old_or_the_new_image() {
    let whole = Memory::new();
    save_all(&whole);
    let operations = whole.borrow().operations;
    let mut cuts_told = 0;
    for left in [Left::Nothing, Left::Half, Left::All] {
        for cut in 1..=operations {
            let memory = Memory::new();
            memory.borrow_mut().cut = Some((cut, left));
            let complete = save_all(&memory);
            memory.borrow_mut().cut = None;
            let (found, told) = start(&memory);
            let old = (complete > 0).then(|| image(complete));
            let new = Some(image(complete + 1));
            assert!(
                found == old || found == new,
                "{left:?} of operation {cut}, after {complete} saves"
            );
            // Whoever waits for an answer in vain finds either nothing changed or the robot saying so.
            assert!(told || found == old, "{left:?} of operation {cut}");
            cuts_told += u32::from(told);
            assert!(!start(&memory).1, "it is told once");
            // It goes on working.
            let next = image(SAVES + 1);
            power_on(&memory).save(&next).expect("it can be written");
            assert_eq!(load(&memory), Some(next), "{left:?} of operation {cut}");
        }
    }
    assert!(cuts_told > 0, "the test cuts into saves");
}

#[test]
fn wear_is_counted_and_kept() {
    let memory = Memory::new();
    assert_eq!(save_all(&memory), SAVES);
    let mut store = power_on(&memory);
    assert!(!store.open().unwrap(), "nothing was cut off");
    let wear = store.wear();
    assert_eq!(wear.saves, u32::from(SAVES));
    assert_eq!(wear.cut, 0);
    // The erase that the last record itself needed is only in the next one.
    let erases = memory.borrow().erases as u32;
    assert!(
        wear.erases == erases || wear.erases + 1 == erases,
        "{wear:?}, {erases}"
    );
    store.save(&image(1)).unwrap();
    assert_eq!(store.wear().saves, u32::from(SAVES) + 1);
}

/// The power fails once more while the store puts right what the first failure left.
#[test]
fn a_second_cut_during_the_repair_loses_nothing() {
    let whole = Memory::new();
    save_all(&whole);
    let operations = whole.borrow().operations;
    let mut repairs = 0;
    // Every seventh first failure, each with every second one: all of them take minutes.
    for cut in (1..=operations).step_by(7) {
        let broken = Memory::new();
        broken.borrow_mut().cut = Some((cut, Left::Half));
        let complete = save_all(&broken);
        let bytes = broken.borrow().bytes.clone();
        for second in 1.. {
            let memory = Memory::new();
            memory.borrow_mut().bytes.clone_from(&bytes);
            memory.borrow_mut().cut = Some((second, Left::Half));
            let mut buffer = [0; BUFFER];
            let mut store = power_on(&memory);
            let is_repaired = store.open().is_ok() && store.load(&mut buffer).is_ok();
            if is_repaired {
                break;
            }
            repairs += 1;
            memory.borrow_mut().cut = None;
            let found = load(&memory);
            let old = (complete > 0).then(|| image(complete));
            let new = Some(image(complete + 1));
            assert!(found == old || found == new, "{cut}, then {second}");
        }
    }
    assert!(repairs > 0, "the test repairs something");
}
