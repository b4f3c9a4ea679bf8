//! The bus task: CAN frames into the controller's bus side and its frames out, in order.
//!
//! It wakes for a received frame, for the bus side's next deadline, for a free mailbox while a
//! frame waits for one, for error passive and bus-off, when the control side has a fault or stands,
//! and in any case every 5 ms. For deadlines, and for frames that mean nothing before the next
//! SYNC, the control task wakes it, so they are met at its next tick. Frames that nobody here reads
//! do not get this far. Each turn it hands over the control side's latest report, then the frames
//! in the order they were received, each with the time its interrupt noted, and leaves the command
//! that results. A frame that finds no free mailbox waits here; the others wait in the bus side's
//! own queues, and when one of those is full the bus side counts what it drops. What only the CAN
//! controller can see, bus-off and lost frames, is reported to the bus side, which also says when
//! to come back from bus-off. Events are logged; nothing is decided here.
//!
//! It also stores faults and the parameters, the latter when the bus side hands out an image, which
//! it does only while the outputs are off. Until that is done no other task runs here: 3 ms as a
//! rule, a quarter of a second when a sector has to be erased. Frames lost meanwhile are counted,
//! but no fault.

use canopen::{Frame, NmtState};
use control::time::Micros;
use protocol::Fault;
use robot::record_store::{RecordStore, StoreError};
use robot::{BusSide, Event, IMAGE_MAX, Memorable, State, Stored};

use crate::board::{Can, Health, ParameterFlash, now, patiently};
use crate::led::{self, Pattern};
use crate::shared::{BUS_PROGRESS, COMMAND, CONFIGURATION, IDENTIFIED, REPORT, SYNC};
use crate::wake;

/// Longest time between two turns. The watchdog is fed every 10 ms, if there has been one.
const LONGEST_WAIT: Micros = Micros(5_000);

/// Connects the bus side to the CAN controller.
#[embassy_executor::task]
pub async fn bus(mut can: Can, side: &'static mut BusSide, mut store: RecordStore<ParameterFlash>) {
    let mut waiting: Option<Frame> = None;
    let mut health = can.health();
    loop {
        wake::BUS.wait().await;

        side.on_report(&REPORT.get());
        if let Some(outcome) = IDENTIFIED.receive() {
            side.on_identification(now(), &outcome);
        }
        while let Some(received) = can.try_receive() {
            side.on_frame(received.at, &received.frame);
        }
        // One time for the whole turn: to work it out costs as much as to look at a queue.
        let at = now();
        side.on_can_errors(at, &can.errors());
        side.poll(at);
        if supervise(&can, &mut health, side) {
            can.discard();
            waiting = None;
        }

        if let Some(configuration) = side.take_configuration() {
            CONFIGURATION.put(configuration);
        }
        COMMAND.put(side.command());
        if save(side, &mut store) || remember(side, &mut store, at) {
            health = Health {
                bus_off: health.bus_off,
                ..can.health()
            };
        }
        waiting = waiting.or_else(|| side.pop_frame());
        if waiting.is_some() {
            // What a master has changed counts before the answer to it is sent.
            can.listen(side.function_codes(), side.node(), BusSide::CAN_WAIT);
        }
        while let Some(frame) = waiting
            && can.try_send(&frame)
        {
            waiting = side.pop_frame();
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

/// Stores an image if there is one to store. Not inlined, so that the stack it takes is given back.
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

/// Writes to the fault memory what is to be kept there. Not inlined, for the same reason.
#[inline(never)]
fn remember(side: &mut BusSide, store: &mut RecordStore<ParameterFlash>, at: Micros) -> bool {
    if side.to_remember(at).is_none() {
        return false;
    }
    let written = patiently(|| {
        while let Some(next) = side.to_remember(at) {
            let stored = match next {
                Memorable::Start => store.add_start(),
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

/// Passes on what the CAN controller complains about; `true` when it has just gone off the bus.
fn supervise(can: &Can, last: &mut Health, side: &mut BusSide) -> bool {
    let health = can.health();
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
        Event::Nmt(state) => defmt::info!("NMT {=str}", nmt_name(state)),
        Event::Fault(fault) => {
            defmt::error!("fault {=u16:#06x} {=str}", fault.code(), fault.name());
        }
        Event::State { from, to } => {
            defmt::info!("{=str} -> {=str}", state_name(from), state_name(to));
        }
        _ => {}
    }
}

fn nmt_name(state: NmtState) -> &'static str {
    match state {
        NmtState::Initialising => "initialising",
        NmtState::PreOperational => "pre-operational",
        NmtState::Operational => "operational",
        NmtState::Stopped => "stopped",
    }
}

fn state_name(state: State) -> &'static str {
    match state {
        State::Ready => "ready",
        State::Armed => "armed",
        State::Moving => "moving",
        State::Alone => "alone",
        State::Ramping(_) => "ramping",
        State::Faulted(_) => "faulted",
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
