//! The bus task: CAN frames into the controller's bus side and its frames out, in order; the cable.
//!
//! It wakes for a received frame, for bytes of the cable, for the bus side's next deadline, for a
//! free mailbox while a frame waits for one, for error passive and bus-off, when the control side
//! has a fault or reaches standstill, and at least every 5 ms. For deadlines, and for frames that
//! have no effect before the next SYNC, the control tick wakes it, so they are handled at its next
//! tick. The CAN interrupt has already dropped frames that this robot does not use. In each turn
//! the task passes the control side's latest report to the bus side, then the frames in the order
//! of reception, each with the time stamp of its interrupt, and stores the resulting command. A
//! frame that finds no free mailbox waits here; the others wait in the bus side's own queues, and
//! when one of those is full the bus side counts what it drops. It reports bus-off and lost frames,
//! which only the CAN controller detects, to the bus side, which also decides when to recover from
//! bus-off. It logs events and makes no decisions.
//!
//! It also does what an update asks for (`update`), when its answers are on the way, and it stores
//! faults and parameters; the bus side provides an image of the parameters only
//! while the outputs are off. While it writes, no other task of this executor runs: usually for 3
//! ms, and for a quarter of a second when a sector has to be erased. Frames lost in that time are
//! counted but are not a fault.

use ::control::time::Micros;
use canopen::{Frame, NmtState};
use protocol::Fault;
use robot::record_store::{RecordStore, StoreError};
use robot::{BusSide, Event, IMAGE_MAX, Memorable, State, Stored};

use crate::board::{Can, Health, ParameterFlash, now, patiently};
use crate::control;
use crate::gateway::Gateway;
use crate::led::{self, Pattern};
use crate::shared::{BUS_PROGRESS, COMMAND, IDENTIFIED, SYNC};
use crate::update::Updates;
use crate::wake;

/// Longest time between two turns. The watchdog is fed every 10 ms, if there has been one.
const LONGEST_WAIT: Micros = Micros(5_000);

/// Connects the bus side to the CAN controller.
#[embassy_executor::task]
pub async fn bus(
    mut can: Can,
    mut gateway: Gateway,
    side: &'static mut BusSide,
    mut store: RecordStore<ParameterFlash>,
    mut updates: Updates,
) {
    let mut waiting: Option<Frame> = None;
    let mut health = can.health();
    loop {
        wake::BUS.wait().await;
        control::report(|report| side.on_report(report));
        if let Some(outcome) = IDENTIFIED.receive() {
            side.on_identification(now(), &outcome);
        }
        gateway.receive(&mut can);
        loop {
            // Before each look into the queue: a vote that comes after the last look was expected.
            can.expect_votes(side.votes_missing());
            let Some(received) = can.try_receive() else {
                break;
            };
            side.on_frame(received.at, &received.frame);
            if side.is_updating() {
                updates.program(side);
            }
        }
        // One time for the whole turn: reading the clock costs as much as checking a queue.
        let at = now();
        side.on_can_errors(at, &can.errors());
        side.poll(at);
        if supervise(&mut can, &mut gateway, &mut health, side) {
            can.discard();
            waiting = None;
        }

        if let Some(configuration) = side.take_configuration() {
            control::configure(configuration);
        }
        COMMAND.put(side.command());
        let saved = side.image_to_store().is_some() && save(side, &mut store);
        if saved || side.may_write() && remember(side, &mut store, at) {
            health = Health {
                bus_off: health.bus_off,
                ..can.health()
            };
        }
        waiting = waiting.or_else(|| next(side, &mut gateway));
        if waiting.is_some() {
            // A change by a master takes effect before the answer to it is sent.
            can.listen(side.function_codes(), side.node(), BusSide::CAN_WAIT);
        }
        while let Some(frame) = waiting
            && (can.try_send(&frame) || gateway.goes_on_without(&mut can))
        {
            waiting = next(side, &mut gateway);
        }
        if waiting.is_none() && side.is_updating() && updates.work(side, &mut can) {
            health = Health {
                bus_off: health.bus_off,
                ..can.health()
            };
        }
        while let Some(event) = side.pop_event() {
            match event {
                Event::RecoverBus => can.recover(),
                Event::Sync { at, .. } => SYNC.put(&at),
                other => log(other),
            }
        }
        led::show(pattern(side, health.bus_off));
        BUS_PROGRESS.made();

        let latest = at + LONGEST_WAIT;
        wake::BUS.signal_at(side.next_deadline().map_or(latest, |at| at.min(latest)));
    }
}

/// The next frame to send, which the cable has then.
fn next(side: &mut BusSide, gateway: &mut Gateway) -> Option<Frame> {
    let frame = side.pop_frame()?;
    gateway.send(&frame);
    Some(frame)
}

/// Stores an image if there is one to store. Not inlined, so that its stack is released.
#[inline(never)]
fn save(side: &mut BusSide, store: &mut RecordStore<ParameterFlash>) -> bool {
    let Some(image) = side.image_to_store() else {
        return false;
    };
    defmt::info!("storing {=usize} bytes", image.len());
    let saved = patiently(|| store.save(image));
    side.counters_mut().store = store.wear();
    if matches!(saved, Ok(Ok(()))) {
        side.finish_store(Ok(()));
        return true;
    }
    defmt::error!("storing failed");
    let mut buffer = [0; IMAGE_MAX];
    side.finish_store(Err(match store.image(&mut buffer) {
        Ok(Some(image)) => Stored::Image(image),
        Ok(None) => Stored::Nothing,
        Err(StoreError) => Stored::Unreadable,
    }));
    true
}

/// Writes a key and pending entries of the fault memory. Not inlined, for the same reason.
#[inline(never)]
fn remember(side: &mut BusSide, store: &mut RecordStore<ParameterFlash>, at: Micros) -> bool {
    if side.to_remember(at).is_none() {
        return false;
    }
    let written = patiently(|| {
        while let Some(next) = side.to_remember(at) {
            let stored = match next {
                Memorable::Start => store.add_start(),
                Memorable::Key => store.set_key(side.new_key()),
                Memorable::Fault(fault) => store.add_fault(&fault),
            };
            side.remembered(at, stored.is_ok());
        }
    });
    if written.is_err() {
        side.remembered(at, false);
    }
    side.counters_mut().store = store.wear();
    true
}

/// Passes on the errors of the CAN controller; `true` when it has just gone off the bus.
fn supervise(can: &mut Can, gateway: &mut Gateway, last: &mut Health, side: &mut BusSide) -> bool {
    let health = gateway.judge(can.health(), can, side);
    if health == *last {
        return false;
    }
    defmt::warn!("{}", health);
    let before = core::mem::replace(last, health);
    side.counters_mut().can_errors = health.lost();
    if health.lost() != before.lost() {
        side.on_fault(now(), Fault::ReceiveOverrun);
    }
    match (before.bus_off, health.bus_off) {
        (false, true) => side.on_bus_off(now()),
        (true, false) => side.on_bus_recovered(now()),
        (false, false) | (true, true) => {}
    }
    health.bus_off && !before.bus_off
}

fn log(event: Event) {
    match event {
        Event::Nmt(state) => defmt::info!("NMT {=istr}", nmt_name(state)),
        Event::Fault(fault) => {
            defmt::error!("fault {=u16:#06x} {}", fault.code(), fault);
        }
        Event::State { from, to } => {
            defmt::info!("{=istr} -> {=istr}", state_name(from), state_name(to));
        }
        _ => {}
    }
}

fn nmt_name(state: NmtState) -> defmt::Str {
    match state {
        NmtState::Initialising => defmt::intern!("initialising"),
        NmtState::PreOperational => defmt::intern!("pre-operational"),
        NmtState::Operational => defmt::intern!("operational"),
        NmtState::Stopped => defmt::intern!("stopped"),
    }
}

fn state_name(state: State) -> defmt::Str {
    match state {
        State::Ready => defmt::intern!("ready"),
        State::Armed => defmt::intern!("armed"),
        State::Moving => defmt::intern!("moving"),
        State::Alone => defmt::intern!("alone"),
        State::Ramping(_) => defmt::intern!("ramping"),
        State::Faulted(_) => defmt::intern!("faulted"),
    }
}

fn pattern(side: &BusSide, bus_off: bool) -> Pattern {
    if bus_off {
        return Pattern::Flickering;
    }
    if side.blinks() {
        return Pattern::Here;
    }
    match (side.state().fault(), side.nmt_state()) {
        (Some(Fault::EmergencyStop), _) => Pattern::DoubleFlash,
        (Some(fault), _) if fault.is_consequence() => Pattern::LongFlash,
        (Some(_), _) => Pattern::TripleFlash,
        (None, NmtState::Operational) => Pattern::On,
        (None, NmtState::Stopped) => Pattern::SingleFlash,
        (None, NmtState::Initialising | NmtState::PreOperational) => Pattern::Blinking,
    }
}
