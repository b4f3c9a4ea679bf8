//! Images as the firmware stores them, made on the host by the firmware's own store.

use std::cell::RefCell;

use anyhow::anyhow;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use protocol::Address;

#[path = "../../../src/store.rs"]
#[expect(dead_code, reason = "only saving is wanted")]
mod store;

/// One parameter, with the CRC that it should have: format 2 as `controller/src/store.rs` describes it.
pub fn with(address: Address, value: f32) -> Vec<u8> {
    let [low, high] = address.index.to_le_bytes();
    let mut body = vec![2, 7, 0, 0, low, high, address.sub];
    body.extend(value.to_le_bytes());
    let mut image = crc32(&body).to_le_bytes().to_vec();
    image.extend(body);
    image
}

/// CRC-32 (IEEE 802.3).
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            crc >> 1 ^ if crc & 1 == 1 { 0xEDB8_8320 } else { 0 }
        })
    })
}

/// The two sectors with this image stored.
pub fn sectors(image: &[u8]) -> anyhow::Result<Vec<u8>> {
    let memory = RefCell::new(vec![0xFF; 2 * Memory::ERASE_SIZE]);
    store::Store::new(Memory(&memory), 0)
        .save(image)
        .map_err(|_| anyhow!("the image cannot be stored"))?;
    Ok(memory.into_inner())
}

struct Memory<'a>(&'a RefCell<Vec<u8>>);

impl ErrorType for Memory<'_> {
    type Error = core::convert::Infallible;
}

impl ReadNorFlash for Memory<'_> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        let from = offset as usize;
        bytes.copy_from_slice(&self.0.borrow()[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * Self::ERASE_SIZE
    }
}

impl NorFlash for Memory<'_> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 0x4000;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        self.0.borrow_mut()[from as usize..to as usize].fill(0xFF);
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let from = offset as usize;
        self.0.borrow_mut()[from..from + bytes.len()].copy_from_slice(bytes);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn crc_is_that_of_ieee_802_3() {
        assert_eq!(super::crc32(b"123456789"), 0xCBF4_3926);
    }
}
