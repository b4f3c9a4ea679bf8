//! Power that is lost at every flash operation of an update, and again in the one that follows.

use boot::Slot;
use protocol::address as at;

use super::bench::{Bench, File};
use crate::update::order;

/// A client's whole update, up to the order to start; what is refused is skipped.
fn update(bench: &mut Bench, bytes: &[u8]) {
    let _ = bench.control(order::STOP);
    let _ = bench.control(order::CLEAR);
    let _ = bench.download(bytes);
    let _ = bench.control(order::START);
}

/// The same with the power lost after so many operations; the robot starts again.
fn cut(bench: &mut Bench, bytes: &[u8], operations: u32) {
    bench.chip.left = Some(operations);
    update(bench, bytes);
    assert_eq!(bench.chip.left, Some(0), "the power is lost within it");
    bench.chip.left = None;
    bench.restart();
}

/// Until the new image is ordered to start, what has run runs again, whatever else was cut; and
/// the next update is taken.
#[test]
fn power_lost_at_every_operation_and_again_in_the_recovery_leaves_the_old_image() {
    let file = File::new(|_| ());
    for old in Slot::ALL {
        let begin = || match old {
            Slot::A => Bench::new(),
            Slot::B => {
                let mut bench = Bench::on_trial();
                bench.control(order::CONFIRM).unwrap();
                bench
            }
        };
        let number = |slot: Slot| if slot == Slot::A { 1 } else { 2 };
        let bytes = file.download(old.other());
        // Two words and two erases, two or one of the marks, the words of the image, its seal, the
        // order.
        let mut bench = begin();
        bench.chip.left = Some(u32::MAX);
        update(&mut bench, &bytes);
        let operations = u32::MAX - bench.chip.left.unwrap();
        assert_eq!(bench.read(at::RUNNING_SLOT), number(old.other()));
        // The last one is the attempt, which the boot code notes.
        let orders = operations - 1;
        assert!(orders > 500, "a word is an operation");
        for operation in 0..orders {
            let mut bench = begin();
            cut(&mut bench, &bytes, operation);
            assert_eq!(bench.read(at::RUNNING_SLOT), number(old), "{operation}");
            // The recovery may be three operations shorter: the mark of the cable is not taken
            // twice, nor the two words that discard what is in the slot. 389 is prime, so that all
            // of them come.
            let again = operation * 389 % (orders - 3);
            cut(&mut bench, &bytes, again);
            let name = (operation, again);
            assert_eq!(bench.read(at::RUNNING_SLOT), number(old), "{name:?}");
            update(&mut bench, &bytes);
            assert_eq!(
                bench.read(at::RUNNING_SLOT),
                number(old.other()),
                "{name:?}"
            );
        }
    }
}
