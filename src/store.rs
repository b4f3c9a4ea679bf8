//! The parameter store: one image in a log-structured map over two flash sectors.
//!
//! `sequential-storage` appends each new image behind the last one, with a CRC of its own, and the newest complete one
//! counts. Until the new one is complete the old one does, so a power loss at any flash operation leaves the old image
//! or the new one. Only when a sector is full is the other one erased, after the newest image has been copied: once in
//! some thirty saves. What is cut off in between is put right at the next access.
//!
//! Generic over the flash, so that the host tests run this very code on a flash whose power they cut. The flash blocks;
//! the futures of the map are therefore never pending.

use controller::IMAGE_MAX;
use embassy_futures::block_on;
use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};

/// The only key of the map.
const KEY: u8 = 1;

/// Bytes the map needs to work in: key and image, in whole words of flash.
pub const BUFFER: usize = (1 + IMAGE_MAX).next_multiple_of(4);

/// The flash cannot be read or written, or what it holds cannot be put right.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StoreError;

/// The store.
pub struct Store<F: NorFlash> {
    map: MapStorage<u8, F, Cache<Uncached, Uncached, Uncached, u8>>,
}

impl<F: NorFlash> Store<F> {
    /// A store on the two sectors from `start` on.
    pub const fn new(flash: F, start: u32) -> Self {
        // Sectors are far smaller than 2 GiB.
        let range = start..start + 2 * F::ERASE_SIZE as u32;
        Self {
            map: MapStorage::new(flash, MapConfig::new(range), Cache::new_uncached()),
        }
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
        let mut buffer = [0; BUFFER];
        block_on(self.map.store_item(&mut buffer, &KEY, &image)).map_err(|_| StoreError)
    }
}
