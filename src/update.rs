//! What the bus task does for an update over the bus: the jobs of `robot::update`, each in its
//! turn.
//!
//! Words are programmed as they come, between two frames. Everything else waits until the answers
//! are in the CAN controller's mailboxes, which send them by themselves; then the watchdog gets the
//! longer time that flash needs. An erase and a reset wait until the mailboxes are empty; during an
//! erase `board::can::away` answers.

use boot::Slot;
use boot::header::{Board as ImageBoard, Device};
use robot::BusSide;
use robot::lock::{Code, Key, hmac_sha512};
use robot::update::{Done, Job};

use crate::board::{BootCode, Can, ProgramFlash, patiently, reset};

/// What the images of this board have to be made for.
pub const DEVICE: Device = Device {
    board: if cfg!(feature = "board-kit-f103rc") {
        ImageBoard::KIT_F103RC
    } else if cfg!(feature = "board-robomaster-c") {
        ImageBoard::ROBOMASTER_C
    } else if cfg!(feature = "drives-c620") {
        ImageBoard::NUCLEO_F446RE_C620
    } else if cfg!(feature = "two-pwms") {
        ImageBoard::NUCLEO_F446RE_TWO_PWMS
    } else {
        ImageBoard::NUCLEO_F446RE
    },
    hardware: boot::release::HARDWARE_REVISION,
    security_counter: boot::release::SECURITY_COUNTER,
};

/// HMAC-SHA-512 by the boot code, where there is one.
pub fn hmac(key: &Key, message: &[u8], out: &mut Code) -> bool {
    let boot = BootCode::find();
    if let Some(boot) = &boot {
        *out = hmac_sha512(boot, key, message);
    }
    boot.is_some()
}

/// The flash of programs and the boot code, on a robot that has both.
pub struct Updates(Option<(ProgramFlash, BootCode)>);

impl Updates {
    /// Looks for them.
    pub fn find() -> Self {
        Self(if cfg!(feature = "update") {
            ProgramFlash::find()
        } else {
            None
        })
    }

    /// The slot that the program runs from.
    pub fn slot(&self) -> Option<Slot> {
        self.0.as_ref().map(|(flash, _)| flash.running())
    }

    /// Tells the bus side what is known about both slots.
    pub fn survey(&mut self, side: &mut BusSide) {
        if let Some((flash, _)) = &mut self.0 {
            side.survey(&flash.saying(None));
        }
    }

    /// Programs what has just come, if anything has.
    pub fn program(&mut self, side: &mut BusSide) {
        if side.update_job() == Some(Job::Program)
            && let Some((flash, boot)) = &mut self.0
        {
            side.work_on_update(&mut flash.saying(None), boot);
        }
    }

    /// Does the next job; the answers are in mailboxes. `true` when the program was away for long.
    #[inline(never)]
    pub fn work(&mut self, side: &mut BusSide, can: &mut Can) -> bool {
        let (Some(job), Some((flash, boot))) = (side.update_job(), &mut self.0) else {
            return false;
        };
        let stand_in = matches!(job, Job::Erase(_)).then(|| {
            can.drain();
            side.stand_in()
        });
        let mut flash = flash.saying(stand_in.flatten());
        match patiently(|| side.work_on_update(&mut flash, boot)) {
            Ok(Done::GoOn) => {}
            Ok(Done::Reset) => {
                can.drain();
                reset();
            }
            // The watchdog has not taken its longer time; the next turn tries again.
            Err(_) => return false,
        }
        matches!(job, Job::Erase(_) | Job::Verify)
    }
}
