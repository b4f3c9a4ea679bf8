//! The dead-man's key: whether a key is held down, on terminals that do not say when it is let go.
//!
//! Most terminals report a held key as presses that repeat: the first, a pause of up to 0.66 s
//! (X11's and most desktops' default), then 25 or more a second. So a first press holds for 0.7 s,
//! and from the second on each holds for 0.25 s. A tap moves the group for 0.7 s at most. Terminals
//! with the kitty keyboard protocol report the release itself; then a first press holds for 0.7 s
//! too, because the connection may be what broke.

use std::time::{Duration, Instant};

/// How long a first press holds.
const FIRST: Duration = Duration::from_millis(700);
/// How long a repeated press holds.
const AGAIN: Duration = Duration::from_millis(250);

/// The state of the key.
#[derive(Debug)]
pub struct DeadMan {
    until: Option<Instant>,
    last: Option<Instant>,
}

impl DeadMan {
    /// Nothing is held.
    pub const fn new() -> Self {
        Self {
            until: None,
            last: None,
        }
    }

    /// A press or a repeat came; `other` when it is another key than before.
    pub fn press(&mut self, now: Instant, other: bool) {
        let repeats = !other
            && self.is_held(now)
            && self
                .last
                .is_some_and(|last| now.duration_since(last) < FIRST);
        self.until = Some(now + if repeats { AGAIN } else { FIRST });
        self.last = Some(now);
    }

    /// The key was let go.
    pub fn release(&mut self) {
        (self.until, self.last) = (None, None);
    }

    /// Whether it counts as held.
    pub fn is_held(&self, now: Instant) -> bool {
        self.until.is_some_and(|until| now < until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(start: Instant, ms: u64) -> Instant {
        start + Duration::from_millis(ms)
    }

    /// Presses as X11 sends them: 660 ms, then every 40 ms.
    #[test]
    fn a_held_key_holds_over_the_pause_and_lets_go_within_a_quarter_second() {
        let (start, mut key) = (Instant::now(), DeadMan::new());
        assert!(!key.is_held(start));
        key.press(start, true);
        assert!(key.is_held(ms(start, 659)));
        let mut last = 660;
        while last < 2000 {
            assert!(key.is_held(ms(start, last)), "{last}");
            key.press(ms(start, last), false);
            last += 40;
        }
        let last = last - 40;
        assert!(key.is_held(ms(start, last + 249)));
        assert!(!key.is_held(ms(start, last + 250)));
    }

    #[test]
    fn another_key_begins_anew_and_a_release_is_at_once() {
        let (start, mut key) = (Instant::now(), DeadMan::new());
        key.press(start, true);
        key.press(ms(start, 100), false);
        assert!(!key.is_held(ms(start, 350)), "a repeat holds for 250 ms");
        key.press(ms(start, 400), true);
        assert!(key.is_held(ms(start, 1_050)));
        key.release();
        assert!(!key.is_held(ms(start, 401)));
    }
}
