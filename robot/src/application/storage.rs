//! Saving and restoring parameters (objects 0x1010 and 0x1011): makes the image to store.

use canopen::{AbortCode, NodeId, Storage, StoreProgress, StoreScope};
use control::time::Micros;
use protocol::{ENTRIES, Fault, Kind, crc32, is_robot};

use super::Application;
use crate::state;
use crate::store::{CRC, FORMAT, HEADER, IMAGE_MAX, Stored};

/// What an image to be stored has of the application.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Content {
    /// What is stored.
    Kept,
    /// What has been written.
    Written,
    /// Nothing: the defaults.
    Forgotten,
}

/// Collects an image.
struct Writer {
    bytes: [u8; IMAGE_MAX],
    length: usize,
}

impl Writer {
    fn add(&mut self, bytes: &[u8]) -> Result<(), AbortCode> {
        let end = self.length.saturating_add(bytes.len());
        let to = self.bytes.get_mut(self.length..end);
        to.ok_or(AbortCode::CannotStore)?.copy_from_slice(bytes);
        self.length = end;
        Ok(())
    }

    fn put<const N: usize>(&mut self, at: usize, bytes: [u8; N]) {
        if let Some(to) = self.bytes.get_mut(at..at.saturating_add(N)) {
            to.copy_from_slice(&bytes);
        }
    }
}

impl Application {
    pub fn load(&mut self, now: Micros, memory: &'static mut [u8; IMAGE_MAX], stored: Stored<'_>) {
        self.store.give(memory);
        self.store.keep(stored);
        self.parameters = self.store.parameters();
        if self.store.corrupt.is_some() {
            self.transition(state::Event::StartRefused(Fault::ParametersCorrupt), now);
        }
    }

    /// Makes the image to store; what is not given, the communication part or the node, stays as it
    /// is stored.
    #[inline(never)]
    fn ask(
        &mut self,
        application: Content,
        communication: Option<&[u8]>,
        node: Option<u8>,
    ) -> Result<StoreProgress, AbortCode> {
        self.lock.pass(self.now())?;
        if !self.is_at_rest() || self.store.asked {
            return Err(AbortCode::DeviceState);
        }
        let (old_application, old_communication) = self.store.parts();
        let mut image = Writer {
            bytes: [0; IMAGE_MAX],
            length: HEADER,
        };
        if application == Content::Kept {
            image.add(old_application)?;
        } else if application == Content::Written {
            for entry in ENTRIES.iter().filter(|entry| entry.slot().is_some()) {
                let Some(value) = self.parameters.written(entry) else {
                    continue;
                };
                let [low, high] = entry.address.index.to_le_bytes();
                image.add(&[low, high, entry.address.sub])?;
                if entry.kind == Kind::Domain {
                    let set = self.parameters.set_bytes();
                    image.add(&[u8::try_from(set.len()).unwrap_or(0)])?;
                    image.add(set)?;
                    continue;
                }
                let bytes = value.to_bytes();
                let length = usize::from(entry.kind.bytes());
                image.add(bytes.get(..length).unwrap_or(&[]))?;
            }
        }
        let length = u16::try_from(image.length.saturating_sub(HEADER)).unwrap_or(u16::MAX);
        let [low, high] = length.to_le_bytes();
        let node = node.unwrap_or_else(|| self.store.node());
        image.put(CRC, [FORMAT, low, high, node]);
        image.add(communication.unwrap_or(old_communication))?;
        let content = image.bytes.get(CRC..image.length).unwrap_or(&[]);
        let crc = crc32(content.iter().copied());
        image.put(0, crc.to_le_bytes());
        let whole = image.bytes.get(..image.length).unwrap_or(&[]);
        self.store.put(whole)?;
        Ok(StoreProgress::Pending)
    }
}

/// What becomes of the application's part in a save or restore of this scope.
fn part(scope: StoreScope, changed: Content) -> Content {
    if scope.has_application() {
        changed
    } else {
        Content::Kept
    }
}

impl Storage for Application {
    fn save(
        &mut self,
        scope: StoreScope,
        communication: &[u8],
    ) -> Result<StoreProgress, AbortCode> {
        self.ask(
            part(scope, Content::Written),
            scope.has_communication().then_some(communication),
            None,
        )
    }

    fn restore(&mut self, scope: StoreScope) -> Result<StoreProgress, AbortCode> {
        self.ask(
            part(scope, Content::Forgotten),
            scope.has_communication().then_some(&[]),
            None,
        )
    }

    fn save_node(&mut self, node: Option<NodeId>) -> Result<StoreProgress, AbortCode> {
        let node = node.map_or(0, NodeId::get);
        if node != 0 && !is_robot(node) {
            return Err(AbortCode::InvalidValue);
        }
        self.ask(Content::Kept, None, Some(node))
    }

    fn load(&mut self, out: &mut [u8]) -> usize {
        let (_, communication) = self.store.parts();
        let Some(to) = out.get_mut(..communication.len()) else {
            return 0;
        };
        to.copy_from_slice(communication);
        communication.len()
    }
}
