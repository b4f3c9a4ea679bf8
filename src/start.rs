//! Start-up: board, identity, what the last run left behind, tasks.

use core::mem::MaybeUninit;

use canopen::NodeId;
use defmt::unwrap;
use embassy_executor::Spawner;
use protocol::Fault;
use robot::record_store::RecordStore;
use robot::{BusSide, IMAGE_MAX, Identity, Stored, stored_node};
use static_cell::{ConstStaticCell, StaticCell};

use crate::board::post_mortem::{self, Failure};
use crate::board::{self, Board, Can, Led, ParameterFlash, ResetCause, executors, now};
use crate::gateway::Gateway;
use crate::update::{self, Updates};
use crate::watchdog::Guard;
use crate::{bus_task, control, health, led};

/// Node id with all switches open.
const FIRST_NODE: u8 = 2;

/// Bit of the firmware version that says it is a bench image.
const BENCH: u32 = 1 << 31;

/// A few kilobytes that must not be moved over the stack.
static BUS_SIDE: StaticCell<BusSide> = StaticCell::new();

/// The image of the stored parameters.
static IMAGE: ConstStaticCell<[u8; IMAGE_MAX]> = ConstStaticCell::new([0; IMAGE_MAX]);

/// Builds the bus side in place. Not inlined, so that its stack is released.
#[inline(never)]
fn place(place: &'static mut MaybeUninit<BusSide>, identity: Identity) -> &'static mut BusSide {
    place.write(BusSide::new(identity))
}

/// Loads the stored parameters and faults. Not inlined, for the same reason.
#[inline(never)]
fn load(side: &mut BusSide, store: &RecordStore<ParameterFlash>) {
    let mut buffer = [0; IMAGE_MAX];
    let stored = match store.image(&mut buffer) {
        Ok(Some(image)) => Stored::Image(image),
        Ok(None) => Stored::Nothing,
        Err(_) => Stored::Unreadable,
    };
    side.load(now(), IMAGE.take(), stored);
    side.counters_mut().store = store.wear();
    side.recall(store.starts(), store.faults());
    side.load_lock(store.key(), update::hmac);
}

/// The node-ID stored by LSS, if there is one. Not inlined, for the same reason.
#[inline(never)]
fn node_stored(store: &RecordStore<ParameterFlash>) -> Option<NodeId> {
    let mut buffer = [0; IMAGE_MAX];
    let image = store.image(&mut buffer).ok()??;
    stored_node(image)
}

/// Starts everything; never returns.
pub fn start() -> ! {
    let parts = prepare();
    executors::bus().run(|spawner: Spawner| {
        spawner.spawn(unwrap!(bus_task::bus(
            parts.can,
            parts.gateway,
            parts.side,
            parts.store,
            parts.updates
        )));
        spawner.spawn(unwrap!(led::led(parts.led)));
        spawner.spawn(unwrap!(health::health()));
    })
}

/// What the tasks of the bus executor need.
struct Parts {
    can: Can,
    gateway: Gateway,
    side: &'static mut BusSide,
    store: RecordStore<ParameterFlash>,
    updates: Updates,
    led: Led,
}

/// Everything before the tasks, and the control task. Not inlined, for the same reason.
#[inline(never)]
fn prepare() -> Parts {
    let board = Board::new();
    let switches = unwrap!(NodeId::new(FIRST_NODE + board.node_switches));
    let store = RecordStore::open(board.flash);
    let node = node_stored(&store).unwrap_or(switches);
    defmt::info!(
        "reset: {}, node {=u8} (switches {=u8}), serial {=u32:#010x}",
        board.reset_cause,
        node.get(),
        switches.get(),
        board.serial
    );
    if cfg!(feature = "bench") {
        defmt::warn!("bench image: no output is ever switched on");
    }
    let crash = post_mortem::consume();
    if let Some(failure) = crash {
        defmt::error!("the last run ended with {}", failure);
    }
    let by_watchdog = board.reset_cause == ResetCause::Watchdog;

    let mut updates = Updates::find();
    let identity = Identity {
        reset_cause: board.reset_cause as u8,
        storage: true,
        node_switches: switches.get(),
        firmware: if cfg!(feature = "bench") {
            BENCH | Identity::FIRMWARE
        } else {
            Identity::FIRMWARE
        },
        chip: board::chip(),
        clock_wait_ms: board.clock_wait_ms,
        brown_out_level: board.brown_out_level,
        hardware: board.hardware,
        has_gyro: board.has_gyro,
        slot: updates.slot(),
        device_of_images: update::DEVICE,
        ..Identity::new(node, board.serial)
    };
    let side = place(BUS_SIDE.uninit(), identity);
    side.counters_mut().watchdog_resets = post_mortem::count_watchdog_reset(by_watchdog);
    updates.survey(side);
    load(side, &store);
    if store.was_cut() {
        side.on_fault(now(), Fault::StoreInterrupted);
    }
    match (crash, by_watchdog) {
        (Some(Failure::BusStarved), _) => side.on_fault(now(), Fault::BusStarved),
        (Some(Failure::ClockLost), _) => side.on_fault(now(), Fault::ClockLost),
        (Some(Failure::SupplyCollapse), _) => side.on_fault(now(), Fault::SupplyCollapse),
        (Some(_), _) => side.on_fault(now(), Fault::Crash),
        (None, true) => side.on_fault(now(), Fault::WatchdogReset),
        (None, false) => {}
    }

    let due = control::prepare(control::Parts {
        outputs: board.outputs,
        encoders: board.encoders,
        drives: board.drives,
        gyro: board.gyro,
        indexes: board.indexes,
        lines: board.lines,
        meters: board.meters,
        guard: Guard::new(board.watchdog),
    });
    executors::start_control().spawn(unwrap!(control::control(board.tick, due)));
    Parts {
        can: board.can,
        gateway: Gateway::new(board.cable, board.serial),
        side,
        store,
        updates,
        led: board.led,
    }
}
