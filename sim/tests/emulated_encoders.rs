//! Encoders whose wires are disturbed, at the timers under the release image. Needs the image:
//! `cargo xtask test` builds it, switches these tests on and names it in `OMNIBUS_ELF`.

use canopen::Micros;
use emulator::{Change, Firmware};
use group::GroupFile;
use omnibus_sim::{Backend, EncoderState, Options, World};

/// Front left.
const TIMER: usize = 2;

/// The counter of the front left wheel, which stands, over one second with this disturbance: how
/// often it changed, and where it stood at last, as a signed number.
fn counted(disturb: fn(&mut World)) -> (usize, i64) {
    let path = std::env::var("OMNIBUS_ELF")
        .expect("OMNIBUS_ELF names a release image; cargo xtask test sets it");
    let folder = env!("CARGO_MANIFEST_DIR");
    let group = GroupFile::load(format!("{folder}/../groups/single.toml")).unwrap();
    let backend = Backend::Emulator(Firmware::load(path).unwrap());
    let mut world = World::new(&group, backend, Options::default()).unwrap();
    world.run_until(Micros(500_000)).unwrap();
    world.board(2).unwrap().start_trace();
    disturb(&mut world);
    world.run_until(Micros(1_500_000)).unwrap();
    let trace = world.board(2).unwrap().take_trace();
    let counts: Vec<u32> = trace
        .iter()
        .filter_map(|traced| match traced.change {
            Change::Encoder {
                timer: TIMER,
                count,
            } => Some(count),
            _ => None,
        })
        .collect();
    // The counter has 16 bits; a wheel that stands stays near 0.
    let last = counts.last().copied().unwrap_or(0) as u16;
    (counts.len(), i64::from(last.cast_signed()))
}

/// 2000 strikes a second on open wires: as many counts, within 4 sqrt(2000), of either sign.
#[test]
fn noise_on_open_wires_is_counted() {
    let (changes, count) = counted(|world| {
        world.set_encoder(0, 0, EncoderState::Dead);
        world.set_encoder_noise(0, 0, 2_000.0);
    });
    assert!(changes.abs_diff(2_000) < 180, "{changes}");
    assert!(count.abs() < 180, "{count}");
}

/// On driven wires every strike is a pulse of 60 ns, which the timer's filter takes away; without
/// it each would count up and down again. Two strikes that fall together may make one that is
/// longer than the 89 ns of the filter: one pair in eight seconds.
#[test]
fn noise_on_driven_wires_leaves_the_count() {
    let (changes, count) = counted(|world| world.set_encoder_noise(0, 0, 2_000.0));
    assert_eq!(count, 0);
    assert!(changes <= 8, "{changes}");
}
