//! A robot built without updates over the bus says so, also one whose program runs from a slot.

use boot::Slot;
use canopen::{Frame, NodeId};
use control::time::Micros;

use crate::{BusSide, Identity};

/// CiA 301, 7.2.4.3.17: unsupported access to an object.
const UNSUPPORTED: u32 = 0x0601_0000;

#[test]
fn a_robot_without_updates_refuses_them_by_its_reason() {
    let identity = Identity {
        slot: Some(Slot::A),
        ..Identity::new(NodeId::new(2).unwrap(), 1)
    };
    let mut bus = BusSide::new(identity);
    let now = Micros(1_000);
    bus.poll(now);
    while bus.pop_frame().is_some() {}
    let mut ask = |request: [u8; 8]| {
        bus.on_frame(now, &Frame::new(0x602, &request).unwrap());
        let answer = bus.pop_frame().unwrap();
        <[u8; 8]>::try_from(answer.data()).unwrap()
    };
    let code = |answer: [u8; 8]| {
        let [kind, _, _, _, a, b, c, d] = answer;
        (kind, u32::from_le_bytes([a, b, c, d]))
    };
    // 0x2003:1, the slot that the program runs from: none.
    assert_eq!(code(ask([0x40, 0x03, 0x20, 1, 0, 0, 0, 0])), (0x4F, 0));
    // 0x1F51:1, stop, and 0x1F50:1, a download of 900 bytes.
    let stop = ask([0x2F, 0x51, 0x1F, 1, 0, 0, 0, 0]);
    assert_eq!(code(stop), (0x80, UNSUPPORTED));
    let download = ask([0x21, 0x50, 0x1F, 1, 0x84, 3, 0, 0]);
    assert_eq!(code(download), (0x80, UNSUPPORTED));
    assert_eq!(bus.update_job(), None);
}
