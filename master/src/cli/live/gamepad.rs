//! A gamepad through Linux' joystick interface: a file that one reads.
//!
//! /dev/input/jsN gives eight bytes an event: time (u32, ms), value (i16), kind (1 button, 2 axis,
//! with 0x80 for the state at opening), number. Read so, no library and no udev is needed. The
//! layout is that of pads with the xpad driver: left stick axes 0 and 1, right stick axis 3, left
//! shoulder button 4. That button is the dead-man's switch: it must be held, and it counts as
//! released when the pad disappears.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Axes and button used.
const SIDEWAYS: u8 = 0;
const AHEAD: u8 = 1;
const TURNING: u8 = 3;
const SHOULDER: u8 = 4;
/// Sticks do not come back to zero exactly.
const DEAD: f32 = 0.08;

/// Where the sticks are, each -1..=1, in the group frame's directions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stick {
    pub forward: f32,
    pub left: f32,
    pub turn: f32,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct State {
    stick: Stick,
    held: bool,
}

impl State {
    fn apply(&mut self, event: [u8; 8]) {
        let [_, _, _, _, low, high, kind, number] = event;
        let value = i16::from_le_bytes([low, high]);
        // Away and to the right are positive there.
        let share = -(f32::from(value) / 32_767.0).clamp(-1.0, 1.0);
        let share = if share.abs() < DEAD { 0.0 } else { share };
        match (kind & 0x7F, number) {
            (1, SHOULDER) => self.held = value != 0,
            (2, SIDEWAYS) => self.stick.left = share,
            (2, AHEAD) => self.stick.forward = share,
            (2, TURNING) => self.stick.turn = share,
            _ => {}
        }
    }
}

/// A pad that is read by a thread.
pub struct Gamepad(Arc<Mutex<State>>);

impl Gamepad {
    /// Opens the device.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self::read(File::open(path)?))
    }

    fn read(mut device: impl Read + Send + 'static) -> Self {
        let state = Arc::new(Mutex::new(State::default()));
        let shared = Arc::clone(&state);
        std::thread::spawn(move || {
            let mut event = [0; 8];
            while device.read_exact(&mut event).is_ok() {
                shared
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .apply(event);
            }
            // The pad has gone: let go.
            *shared.lock().unwrap_or_else(PoisonError::into_inner) = State::default();
        });
        Self(state)
    }

    /// Where the sticks are, while the button is held.
    pub fn stick(&self) -> Option<Stick> {
        let state = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.held.then_some(state.stick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(kind: u8, number: u8, value: i16) -> [u8; 8] {
        let [low, high] = value.to_le_bytes();
        [0, 0, 0, 0, low, high, kind, number]
    }

    #[test]
    fn sticks_count_only_while_the_button_is_held() {
        let mut state = State::default();
        for event in [
            event(0x82, AHEAD, -32_767),
            event(2, SIDEWAYS, 16_384),
            event(2, TURNING, 500),
            event(2, 7, 32_767),
        ] {
            state.apply(event);
        }
        assert!(!state.held);
        assert_eq!(state.stick.forward, 1.0);
        assert!((state.stick.left + 0.5).abs() < 1e-4);
        assert_eq!(state.stick.turn, 0.0, "within the dead zone");
        state.apply(event(1, SHOULDER, 1));
        assert!(state.held);
        state.apply(event(1, SHOULDER, 0));
        assert!(!state.held);
    }

    /// A pad whose plug is pulled while its button is held.
    #[test]
    fn a_pad_that_goes_away_lets_go() {
        let (theirs, mut ours) = std::os::unix::net::UnixStream::pair().unwrap();
        let pad = Gamepad::read(theirs);
        use std::io::Write as _;
        ours.write_all(&event(1, SHOULDER, 1)).unwrap();
        while pad.stick().is_none() {
            std::thread::yield_now();
        }
        drop(ours);
        while pad.stick().is_some() {
            std::thread::yield_now();
        }
    }
}
