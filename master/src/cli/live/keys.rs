//! Which key does what.

use kinematics::Twist;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Configure and start the group.
    Start,
    /// Ramp down and leave OPERATIONAL.
    Stop,
    /// Stand still, ready to go on.
    Halt,
    /// Move as long as the key is held.
    Move(Direction),
    /// The key was let go.
    LetGo(Direction),
    /// Faster by a tenth.
    Faster,
    /// Slower by a tenth.
    Slower,
    /// Ramp down and end.
    Quit,
}

/// A way to move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    Forward,
    Back,
    Left,
    Right,
    TurnLeft,
    TurnRight,
}

impl Direction {
    /// The velocity, in the group frame.
    pub const fn twist(self, speed: f32, turn: f32) -> Twist {
        match self {
            Self::Forward => Twist::new(speed, 0.0, 0.0),
            Self::Back => Twist::new(-speed, 0.0, 0.0),
            Self::Left => Twist::new(0.0, speed, 0.0),
            Self::Right => Twist::new(0.0, -speed, 0.0),
            Self::TurnLeft => Twist::new(0.0, 0.0, turn),
            Self::TurnRight => Twist::new(0.0, 0.0, -turn),
        }
    }
}

/// The action of a key event.
pub fn action(key: &KeyEvent) -> Option<Action> {
    let direction = match key.code {
        KeyCode::Up | KeyCode::Char('i') => Some(Direction::Forward),
        KeyCode::Down | KeyCode::Char('k') => Some(Direction::Back),
        KeyCode::Left | KeyCode::Char('j') => Some(Direction::Left),
        KeyCode::Right | KeyCode::Char('l') => Some(Direction::Right),
        KeyCode::Char('u' | ',') => Some(Direction::TurnLeft),
        KeyCode::Char('o' | '.') => Some(Direction::TurnRight),
        _ => None,
    };
    if let Some(direction) = direction {
        return Some(match key.kind {
            KeyEventKind::Press | KeyEventKind::Repeat => Action::Move(direction),
            KeyEventKind::Release => Action::LetGo(direction),
        });
    }
    if key.kind == KeyEventKind::Release {
        return None;
    }
    Some(match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Action::Quit,
        KeyCode::Char('q') | KeyCode::Esc => Action::Quit,
        KeyCode::Char('s') => Action::Start,
        KeyCode::Char('x') => Action::Stop,
        KeyCode::Char(' ') => Action::Halt,
        KeyCode::Char('+' | '=') => Action::Faster,
        KeyCode::Char('-') => Action::Slower,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_that_move_act_while_held_and_others_once() {
        let key = |code, kind| KeyEvent::new_with_kind(code, KeyModifiers::NONE, kind);
        let up = |kind| action(&key(KeyCode::Up, kind));
        assert_eq!(
            up(KeyEventKind::Press),
            Some(Action::Move(Direction::Forward))
        );
        assert_eq!(
            up(KeyEventKind::Repeat),
            Some(Action::Move(Direction::Forward))
        );
        assert_eq!(
            up(KeyEventKind::Release),
            Some(Action::LetGo(Direction::Forward))
        );
        let stop = |kind| action(&key(KeyCode::Char('x'), kind));
        assert_eq!(stop(KeyEventKind::Press), Some(Action::Stop));
        assert_eq!(stop(KeyEventKind::Release), None);
        let interrupt = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(action(&interrupt), Some(Action::Quit));
    }

    #[test]
    fn left_is_positive() {
        assert_eq!(Direction::Left.twist(0.2, 0.3), Twist::new(0.0, 0.2, 0.0));
        assert_eq!(
            Direction::TurnLeft.twist(0.2, 0.3),
            Twist::new(0.0, 0.0, 0.3)
        );
    }
}
