//! The functions that the device calls.

use canopen::{
    AbortCode, Errors, Frame, NmtState, NodeId, PdoDirection, ReceivedSync, ResetScope, Sink,
};
use control::time::Micros;
use protocol::address::{LOCK_CHALLENGE, PROGRAM_DATA};
use protocol::{Access, Address, Kind, MASTER, table::highest_sub};

use super::objects::find;
use super::publish::record;
use super::{Application, Received, local_time};
use crate::event::Event;

impl canopen::Application for Application {
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        if sub == 0
            && let Some(highest) = highest_sub(index)
            && highest != 0
        {
            *out.first_mut().ok_or(AbortCode::OutOfMemory)? = highest;
            return Ok(1);
        }
        let entry = find(Address::new(index, sub))?;
        if entry.access() == Access::WriteOnly {
            return Err(AbortCode::WriteOnly);
        }
        if entry.kind == Kind::Domain {
            if entry.address == LOCK_CHALLENGE {
                let to = out.first_chunk_mut().ok_or(AbortCode::OutOfMemory)?;
                self.challenge(to)?;
                return Ok(to.len());
            }
            let block = self.block(entry.address);
            let to = out.get_mut(..block.len()).ok_or(AbortCode::OutOfMemory)?;
            to.copy_from_slice(block);
            return Ok(block.len());
        }
        let value = self.value(entry).ok_or(AbortCode::General)?;
        let length = usize::from(entry.kind.bytes());
        let to = out.get_mut(..length).ok_or(AbortCode::OutOfMemory)?;
        for (to, byte) in to.iter_mut().zip(value.to_bytes()) {
            *to = byte;
        }
        Ok(length)
    }

    fn write(
        &mut self,
        index: u16,
        sub: u8,
        data: &[u8],
        state: NmtState,
    ) -> Result<(), AbortCode> {
        let done = if sub == 0 && highest_sub(index).is_some_and(|highest| highest != 0) {
            Err(AbortCode::ReadOnly)
        } else {
            self.check_write(Address::new(index, sub), data, state)
        };
        if done.is_err() {
            self.counters.refused_writes = self.counters.refused_writes.wrapping_add(1);
        }
        done
    }

    fn mappable(&self, index: u16, sub: u8, direction: PdoDirection) -> Result<u8, AbortCode> {
        let entry = find(Address::new(index, sub))?;
        let fits = match direction {
            PdoDirection::Receive => entry.access() == Access::ReadWrite,
            PdoDirection::Transmit => true,
        };
        if entry.is_mappable() && fits {
            Ok(entry.kind.bytes() * 8)
        } else {
            Err(AbortCode::NotMappable)
        }
    }

    fn rpdo(&mut self, number: u8, data: &[u8]) -> bool {
        let to = match number {
            1 => &mut self.group_twist,
            2 => &mut self.alone.twist,
            _ => return false,
        };
        let Ok(bytes) = data.try_into() else {
            return false;
        };
        to.bytes = bytes;
        to.is_fresh = true;
        true
    }

    fn tpdo(&self, number: u8, out: &mut [u8; 8]) -> Option<usize> {
        *out = self.process_data(match number {
            1 => record::STATUS,
            2 => record::MEASURED,
            3 => record::POSE,
            4 => record::RATES,
            _ => return None,
        })?;
        Some(8)
    }

    fn on_sync(&mut self, sync: ReceivedSync, errors: &mut Errors<'_>) {
        let at = local_time(sync.at);
        self.agree(at, sync.counter);
        self.note_limit(at);
        if self.has_news() {
            self.announce(errors);
        }
        self.emit(Event::Sync {
            counter: sync.counter,
            at,
        });
    }

    fn on_rpdo(&mut self, number: u8, data: &[u8]) -> bool {
        if number == 1 {
            if !self.is_for_this_group(data) {
                return false;
            }
            self.setpoints.count_frame();
        }
        true
    }

    fn on_heartbeat(&mut self, now: canopen::Micros, node: NodeId, state: NmtState) {
        if node.get() == MASTER {
            self.on_master_heartbeat(local_time(now), state);
        } else if node == self.identity.node {
            self.on_double(local_time(now));
        }
    }

    fn on_frame(&mut self, now: canopen::Micros, frame: &Frame, state: NmtState) {
        let is_operational = state == NmtState::Operational;
        self.on_robot_frame(local_time(now), frame, is_operational);
    }

    fn storage(&mut self) -> Option<&mut dyn canopen::Storage> {
        if self.identity.storage {
            Some(self)
        } else {
            None
        }
    }

    fn sink(&mut self, index: u16, sub: u8) -> Option<&mut dyn Sink> {
        (Address::new(index, sub) == PROGRAM_DATA).then_some(self as &mut dyn Sink)
    }

    fn may_change_node(&self) -> bool {
        self.is_at_rest() && self.may_configure()
    }

    fn may_configure(&self) -> bool {
        !self.lock.is_locked(self.now())
    }

    fn reset(&mut self, scope: ResetScope) {
        self.group_twist.is_fresh = false;
        self.alone.twist.is_fresh = false;
        self.alone.is_permitted = false;
        self.alone.for_now = false;
        self.lock.lock();
        if self.identification.is_running {
            self.end_identification(self.now());
        }
        if scope == ResetScope::Application {
            self.parameters = self.store.parameters();
            // What is measured is not reset: a reset does not move the robot. The sequence that
            // it followed last stays barred.
            (self.group_twist, self.alone.twist) = (Received::default(), Received::default());
            self.identification.reset();
            self.blinks_until = Micros::ZERO;
        }
    }
}
