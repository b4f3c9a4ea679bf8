//! The position in the program, for the trace: the active exception and the Embassy task that is
//! polled.
//!
//! A task is recognised by the symbol of its poll function, and ends at that function's return
//! address. The symbol does not contain the name of the task; the debug information of its code
//! does.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::firmware::{Firmware, Symbol};
use crate::trace::Change;

/// What the symbols of all poll functions have in common.
const POLL: &str = "TaskStorage<F>::poll";

/// A poll function under way.
#[derive(Debug, Clone)]
struct Open {
    /// Program counter and stack pointer after its return.
    back: (u32, u32),
    exception: u16,
    outer: Option<Arc<str>>,
}

/// Follows the program of one board.
#[derive(Debug, Clone)]
pub(super) struct Follow {
    tasks: BTreeMap<u32, Arc<str>>,
    open: Vec<Open>,
    exception: u16,
    task: Option<Arc<str>>,
}

/// The core before an instruction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) pc: u32,
    pub(super) sp: u32,
    pub(super) lr: u32,
    pub(super) exception: u16,
}

impl Follow {
    pub(super) fn new(firmware: &Firmware) -> Self {
        Self {
            tasks: tasks(firmware),
            open: Vec::new(),
            exception: 0,
            task: None,
        }
    }

    /// Looks at the core before an instruction; says what is another than before the last one.
    pub(super) fn look(&mut self, place: Place, mut changed: impl FnMut(Change)) {
        if std::mem::replace(&mut self.exception, place.exception) != place.exception {
            changed(Change::Exception(place.exception));
        }
        let returned =
            |open: &Open| open.exception == place.exception && open.back == (place.pc, place.sp);
        while let Some(open) = self.open.pop_if(|open| returned(open)) {
            self.task = open.outer;
            changed(Change::Task(self.task.clone()));
        }
        if let Some(task) = self.tasks.get(&place.pc) {
            self.open.push(Open {
                back: (place.lr & !1, place.sp),
                exception: place.exception,
                outer: self.task.replace(Arc::clone(task)),
            });
            changed(Change::Task(self.task.clone()));
        }
    }

    /// A reset: nothing that was begun will return.
    pub(super) fn reset(&mut self) {
        self.open.clear();
    }
}

/// All poll functions by address, with the names of their tasks.
fn tasks(firmware: &Firmware) -> BTreeMap<u32, Arc<str>> {
    let functions = firmware.functions().iter();
    let polls: Vec<_> = functions.filter(|f| f.name.contains(POLL)).collect();
    let code = polls
        .iter()
        .flat_map(|poll| (poll.address..poll.address + poll.size).step_by(2));
    let code: Vec<u32> = code.collect();
    let frames = firmware.names(&code);
    let named = |poll: &&Symbol| {
        let mut found = BTreeMap::<&str, u32>::new();
        for (at, frames) in code.iter().zip(&frames) {
            if (poll.address..poll.address + poll.size).contains(at)
                && let Some(name) = task_name(frames)
            {
                *found.entry(name).or_default() += 1;
            }
        }
        let most = found.into_iter().max_by_key(|(_, count)| *count);
        let name = most.map_or_else(
            || format!("{:#010x}", poll.address),
            |(name, _)| name.into(),
        );
        (poll.address, Arc::from(name))
    };
    polls.iter().map(named).collect()
}

/// The task whose code these functions are inlined into each other at, innermost first: what the
/// task calls, `task::{async_fn#0}`, poll.
fn task_name(frames: &[String]) -> Option<&str> {
    let poll = frames.iter().position(|frame| frame.contains("::poll"))?;
    let frame = frames[..poll]
        .iter()
        .rev()
        .find(|frame| !frame.contains("embassy_executor"))?;
    // Embassy's macro makes __name_task of a task's name, and puts functions of its own into it.
    frame
        .split("::")
        .find_map(|part| part.strip_prefix("__")?.strip_suffix("_task"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_task_is_named_by_what_is_inlined_into_its_poll_function() {
        let frames = [
            "core::ptr::read",
            "omnibus_firmware::start::__led_task::inner::{async_fn#0}",
            "embassy_executor::raw::TaskStorage<F>::poll",
        ]
        .map(str::to_owned);
        assert_eq!(task_name(&frames), Some("led"));
        assert_eq!(task_name(&["memcpy".to_owned()]), None);
    }

    #[test]
    fn a_task_lasts_from_its_poll_function_to_its_return_whatever_interrupts() {
        let mut follow = Follow {
            tasks: BTreeMap::from([(0x100, Arc::from("a")), (0x200, Arc::from("b"))]),
            open: Vec::new(),
            exception: 0,
            task: None,
        };
        let at = |pc, sp, lr, exception| Place {
            pc,
            sp,
            lr,
            exception,
        };
        let mut changes = Vec::new();
        for place in [
            at(0x100, 80, 0x51, 0),
            at(0x102, 72, 0x51, 0),
            // An interrupt polls another, and passes the address that the first returns to.
            at(0x200, 40, 0x61, 69),
            at(0x50, 80, 0, 69),
            at(0x60, 40, 0, 69),
            at(0x104, 72, 0, 0),
            at(0x50, 80, 0, 0),
        ] {
            follow.look(place, |change| changes.push(change));
        }
        let task = |name: Option<&str>| Change::Task(name.map(Arc::from));
        let expected = [
            task(Some("a")),
            Change::Exception(69),
            task(Some("b")),
            task(Some("a")),
            Change::Exception(0),
            task(None),
        ];
        assert_eq!(changes, expected);
    }
}
