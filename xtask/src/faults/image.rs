//! Stored images, made on the host by the firmware's own store.

use std::cell::RefCell;
use std::rc::Rc;

use anyhow::anyhow;
use protocol::Address;
use robot::record_store::{Flash, RecordStore, StoreError};

/// One parameter, with the CRC that it should have: format 2 as `robot/src/store.rs` describes it.
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

/// Two sectors with this image stored, so many bytes together.
pub fn sectors(image: &[u8], length: usize) -> anyhow::Result<Vec<u8>> {
    match length {
        0x4000 => stored::<0x2000>(image),
        0x8000 => stored::<0x4000>(image),
        other => Err(anyhow!("no board has {other} bytes of parameters")),
    }
}

fn stored<const SECTOR: u32>(image: &[u8]) -> anyhow::Result<Vec<u8>> {
    let memory = Memory::<SECTOR>(Rc::new(RefCell::new(vec![
        u32::MAX;
        2 * SECTOR as usize / 4
    ])));
    RecordStore::open(memory.clone())
        .save(image)
        .map_err(|_| anyhow!("the image cannot be stored"))?;
    let words = memory.0.borrow();
    Ok(words.iter().flat_map(|word| word.to_le_bytes()).collect())
}

#[derive(Clone)]
struct Memory<const SECTOR: u32>(Rc<RefCell<Vec<u32>>>);

impl<const SECTOR: u32> Flash for Memory<SECTOR> {
    const SECTOR: u32 = SECTOR;

    fn word(&self, at: u32) -> u32 {
        self.0.borrow()[at as usize / 4]
    }

    fn program(&mut self, at: u32, word: u32) -> Result<(), StoreError> {
        self.0.borrow_mut()[at as usize / 4] &= word;
        Ok(())
    }

    fn erase(&mut self, at: u32) -> Result<(), StoreError> {
        let from = at as usize / 4;
        self.0.borrow_mut()[from..from + Self::SECTOR as usize / 4].fill(u32::MAX);
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
