//! The parameter store: one image in a log-structured map over two flash sectors.
//!
//! `sequential-storage` appends each new image behind the last one, with a CRC of its own, and the newest complete one
//! counts. Until the new one is complete the old one does, so a power loss at any flash operation leaves the old image
//! or the new one. Only when a sector is full is the other one erased, after the newest image has been copied: once in
//! some thirty saves. What is cut off in between is put right at the next access.
//!
//! Beside the image lies a small record: how many saves there have been, how many sectors were erased for them, how many
//! saves were cut off. It is written before a save, marked open, and after it, closed. A record that is open at start-up
//! means that power was lost in between: what is stored is whole, old or new, but whoever asked for the save has had no
//! answer. It is counted, closed and reported, once.
//!
//! Generic over the flash, so that the host tests run this very code on a flash whose power they cut. The flash blocks;
//! the futures of the map are therefore never pending.

use controller::{IMAGE_MAX, StoreWear};
use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};

/// Key of the image.
const KEY: u8 = 1;

/// Key of the record.
const RECORD: u8 = 2;

/// Bytes of the record: whether a save is under way, saves, erases, cut saves.
const RECORD_LENGTH: usize = 13;

/// Bytes the map needs to work in: key and image, in whole words of flash.
pub const BUFFER: usize = (1 + IMAGE_MAX).next_multiple_of(4);

/// The flash cannot be read or written, or what it holds cannot be put right.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StoreError;

/// The store.
pub struct Store<F: NorFlash> {
    map: MapStorage<u8, Counted<F>, Cache<Uncached, Uncached, Uncached, u8>>,
    wear: StoreWear,
}

/// A flash that counts its erases.
struct Counted<F> {
    flash: F,
    erases: u32,
}

impl<F: ErrorType> ErrorType for Counted<F> {
    type Error = F::Error;
}

impl<F: ReadNorFlash> ReadNorFlash for Counted<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), F::Error> {
        self.flash.read(offset, bytes).await
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<F: NorFlash> NorFlash for Counted<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), F::Error> {
        let sectors = to.saturating_sub(from) / F::ERASE_SIZE as u32;
        self.erases = self.erases.saturating_add(sectors);
        self.flash.erase(from, to).await
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), F::Error> {
        self.flash.write(offset, bytes).await
    }
}

impl<F: NorFlash> Store<F> {
    /// A store on the two sectors from `start` on.
    pub const fn new(flash: F, start: u32) -> Self {
        // Sectors are far smaller than 2 GiB.
        let range = start..start + 2 * F::ERASE_SIZE as u32;
        let flash = Counted { flash, erases: 0 };
        Self {
            map: MapStorage::new(flash, MapConfig::new(range), Cache::new_uncached()),
            wear: StoreWear {
                saves: 0,
                erases: 0,
                cut: 0,
            },
        }
    }

    /// Reads what the store has been through. `true` if power was lost during the last save; that is noted, so it is told
    /// once. Called once, at start-up.
    ///
    /// # Errors
    /// When the flash fails.
    pub fn open(&mut self) -> Result<bool, StoreError> {
        let mut buffer = [0; BUFFER];
        let record: Option<&[u8]> =
            block_on(self.map.fetch_item(&mut buffer, &RECORD)).map_err(|_| StoreError)?;
        let Some(&[open, a, b, c, d, e, f, g, h, i, j, k, l]) = record else {
            return Ok(false);
        };
        self.wear = StoreWear {
            saves: u32::from_le_bytes([a, b, c, d]),
            erases: u32::from_le_bytes([e, f, g, h]),
            cut: u32::from_le_bytes([i, j, k, l]),
        };
        if open == 0 {
            return Ok(false);
        }
        // Whether it had come to an erase is not known: it counts as one.
        self.wear.erases = self.wear.erases.saturating_add(1);
        self.wear.cut = self.wear.cut.saturating_add(1);
        self.note(false)?;
        Ok(true)
    }

    /// What the store has been through.
    pub const fn wear(&self) -> StoreWear {
        self.wear
    }

    /// Writes the record. Not inlined, so that the stack it takes is given back.
    #[inline(never)]
    fn note(&mut self, open: bool) -> Result<(), StoreError> {
        self.count_erases();
        let StoreWear { saves, erases, cut } = self.wear;
        let mut record = [0; RECORD_LENGTH];
        let fields = [
            &[u8::from(open)][..],
            &saves.to_le_bytes(),
            &erases.to_le_bytes(),
            &cut.to_le_bytes(),
        ];
        for (to, from) in record.iter_mut().zip(fields.into_iter().flatten()) {
            *to = *from;
        }
        // Whichever write finds its sector full copies the image.
        let mut buffer = [0; BUFFER];
        let stored = block_on(self.map.store_item(&mut buffer, &RECORD, &&record[..]));
        // An erase for the record itself is in the next one.
        self.count_erases();
        stored.map_err(|_| StoreError)
    }

    fn count_erases(&mut self) {
        let erases = core::mem::take(&mut self.map.flash().erases);
        self.wear.erases = self.wear.erases.saturating_add(erases);
    }

    /// The image stored last; `None` when there has never been one.
    ///
    /// # Errors
    /// When the flash fails.
    pub fn load<'b>(
        &mut self,
        buffer: &'b mut [u8; BUFFER],
    ) -> Result<Option<&'b [u8]>, StoreError> {
        block_on(self.map.fetch_item(buffer, &KEY)).map_err(|_| StoreError)
    }

    /// Stores an image in place of the last one.
    ///
    /// # Errors
    /// When the flash fails; the last image is still there, or the new one is.
    pub fn save(&mut self, image: &[u8]) -> Result<(), StoreError> {
        self.note(true)?;
        self.put(image)?;
        self.wear.saves = self.wear.saves.saturating_add(1);
        // The image is there. Should the record fail, the next start says that the save was cut off, which is the safe
        // side.
        let _ = self.note(false);
        Ok(())
    }

    /// Stores the image itself. Not inlined, so that the stack it takes is given back.
    #[inline(never)]
    fn put(&mut self, image: &[u8]) -> Result<(), StoreError> {
        let mut buffer = [0; BUFFER];
        block_on(self.map.store_item(&mut buffer, &KEY, &image)).map_err(|_| StoreError)
    }
}
