//! Native robots and emulated ones do the same: how close is what this file measures.

mod common;

use common::quick_drive;
use omnibus::curve::Curve;
use sim::Backend;

fn image() -> emulator::Firmware {
    let path = std::env::var("OMNIBUS_ELF").expect("OMNIBUS_ELF names the firmware's release image");
    emulator::Firmware::load(path).unwrap()
}

#[test]
fn agree() {
    let group = common::group("tcc-3");
    let mut drive = quick_drive(&group, Backend::Emulator(image()), Curve::FigureEight, true);
    for (node, line) in drive.world.take_logs() {
        println!("{node} {:>10} {} {}", line.time_us, line.level, line.text);
    }
    println!("{:?} {}", drive.result, drive.world.now_ns());
}
