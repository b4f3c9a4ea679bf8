//! An emulated robot: the firmware's release image on an emulated board, wired as a real one.
//!
//! # Wiring
//!
//! The board is the one that the image is for, and `wiring` has its pins. A closed contact of the
//! emergency stop and of the protective stop pulls low, a driver's fault is low, a closed switch is
//! 1 (node = 2 + value). A board with a gyro has it on its SPI. The supply is divided by 11. The
//! motor driver is the one the world has ([`crate::bridge`]); pull-downs hold every output low that
//! the board does not drive. An encoder's index is high for a moment at each pulse. A board without
//! switches gets its node-ID by LSS before the world begins.
//!
//! # Time
//!
//! A power cycle creates a new board with the flash of the old one; its time begins at power-on.
//!
//! A sleeping board is not run: it is advanced to the present when an input changes or its own next
//! event is due. It receives encoder counts in one sum when it next computes; the edges of an
//! encoder whose wires are disturbed reach the pins one by one, each at its time.

mod commission;
mod robot;
mod wiring;

use canopen::{Frame, NodeId};
use emulator::{Board, BoardConfig, CanId, Firmware, GyroDefect, PinLevel};
use group::Driver;

use self::commission::commissioned;
pub(super) use self::wiring::is_for;
use self::wiring::{Channel, Pin, Wiring};
pub use self::wiring::{outputs, parameters};
use super::LogLine;
use crate::bridge::{self, Levels};
use crate::bus::errors::{ErrorCounters, ErrorState};
use crate::encoder::wires::Edge;
use crate::error::SimError;
use crate::motor::Bridge;
use crate::smart_drive::DriveBus;
use crate::world::index::Pulse;

/// How long a counter stands still at an index, so that the program reads it there, ns: a few
/// hundred instructions.
const INDEX_NS: u64 = 3_000;
/// Ratio of the divider of the supply.
pub(super) const SUPPLY_DIVIDER: f64 = 11.0;
/// Node of a board with open switches, or without any.
const FIRST_NODE: u8 = 2;
/// How long after the processor last computed its outputs may still change by themselves, ns: a new
/// duty takes effect at the end of a PWM period of 50 us.
const SETTLING_NS: u64 = 60_000;

/// See the [module](self).
#[derive(Clone)]
pub struct EmulatedRobot {
    node: u8,
    firmware: Firmware,
    wiring: &'static Wiring,
    driver: Driver,
    config: BoardConfig,
    board: Board,
    /// World time at which the board was switched on, ns: its own time begins there.
    born_ns: u64,
    powered: bool,
    emergency_stop: bool,
    driver_fault: bool,
    protective_stop: bool,
    gyro_defect: Option<GyroDefect>,
    /// V.
    supply: f64,
    /// Instructions and log of the boards before this one.
    instructions_before: u64,
    log_before: Vec<LogLine>,
    /// World time, which the board may be behind while it sleeps.
    now_ns: u64,
    computed_ns: u64,
    instructions: u64,
    pending_counts: [i32; 4],
    /// Edges that the board has not seen yet, with their wheels, in the order of time.
    pending_edges: Vec<(usize, Edge)>,
    /// Levels of the encoders' wires.
    encoder_levels: [[bool; 2]; 4],
    /// Index pulses that the board has not seen yet.
    pending_index: [Option<Pulse>; 4],
    /// Whether the index pins are high.
    index_high: [bool; 4],
    pending: Option<Frame>,
    drives: [Bridge; 4],
    /// The bus of its smart drives, where these turn its wheels, and the rates of the wheels,
    /// rad/s.
    drive_bus: Option<DriveBus>,
    rates: [f64; 4],
    /// As of the last read; no read is needed while there have been no errors.
    errors: (ErrorState, ErrorCounters),
}

/// A board of its own with this in its flash, just switched on and without a robot about it:
/// emergency stop released, no driver fault, switches open, which is node 2.
///
/// # Errors
/// When the board is not modelled.
pub fn ready_board(firmware: &Firmware, flash: &[u8]) -> Result<Board, String> {
    ready_board_with(firmware, flash, BoardConfig::default())
}

/// The same of a board that differs from others of its kind; its crystal is that of its kind.
///
/// # Errors
/// As [`ready_board`].
pub fn ready_board_with(
    firmware: &Firmware,
    flash: &[u8],
    config: BoardConfig,
) -> Result<Board, String> {
    let wiring = Wiring::of(firmware)?;
    let config = BoardConfig {
        hse_hz: wiring.hse_hz,
        ..config
    };
    let mut board = Board::with_flash(firmware, config, flash);
    for (port, pin) in wiring.emergency_stop {
        board.set_input(*port, *pin, false);
    }
    let (port, pin) = wiring.driver_fault;
    board.set_input(port, pin, true);
    Ok(board)
}

impl EmulatedRobot {
    /// A robot with this node and crystal error, just switched on.
    ///
    /// # Errors
    /// When the board cannot have the node, or is not modelled.
    pub fn new(firmware: &Firmware, node: u8, crystal_ppm: f64) -> Result<Self, SimError> {
        let mut uid = *b"OMNIBUS-SIM\0";
        uid[11] = node;
        Self::with_uid(firmware, node, uid, crystal_ppm)
    }

    /// The same with a unique number of its own, as two robots whose node switches are set alike
    /// have.
    ///
    /// # Errors
    /// As [`EmulatedRobot::new`].
    pub fn with_uid(
        firmware: &Firmware,
        node: u8,
        uid: [u8; 12],
        crystal_ppm: f64,
    ) -> Result<Self, SimError> {
        let refused = |problem| SimError::Robot { node, problem };
        let wiring = Wiring::of(firmware).map_err(refused)?;
        if !wiring.switches.is_empty() && switches(node).is_none() {
            let problem = "four switches give nodes 2 to 17 only".to_owned();
            return Err(refused(problem));
        }
        let config = BoardConfig {
            crystal_ppm,
            uid,
            hse_hz: wiring.hse_hz,
            ..BoardConfig::default()
        };
        let mut robot = Self {
            node,
            firmware: firmware.clone(),
            wiring,
            driver: Driver::default(),
            board: Board::new(firmware, config.clone()),
            config,
            born_ns: 0,
            powered: true,
            emergency_stop: false,
            driver_fault: false,
            protective_stop: false,
            gyro_defect: None,
            supply: 0.0,
            instructions_before: 0,
            log_before: Vec::new(),
            now_ns: 0,
            computed_ns: 0,
            instructions: 0,
            pending_counts: [0; 4],
            pending_edges: Vec::new(),
            encoder_levels: [[false; 2]; 4],
            pending_index: [None; 4],
            index_high: [false; 4],
            pending: None,
            drives: [Bridge::default(); 4],
            drive_bus: None,
            rates: [0.0; 4],
            errors: Default::default(),
        };
        robot.wire();
        if wiring.switches.is_empty() && node != FIRST_NODE {
            let id = NodeId::new(node).ok_or_else(|| refused("no node-ID".to_owned()))?;
            let new = Board::new(firmware, robot.config.clone());
            let flash = commissioned(std::mem::replace(&mut robot.board, new), id);
            let flash = flash.map_err(refused)?;
            robot.board = Board::with_flash(firmware, robot.config.clone(), &flash);
            robot.wire();
        }
        Ok(robot)
    }

    /// Connects everything outside to the board's pins.
    fn wire(&mut self) {
        // Checked when it was built; a board without switches has none to close.
        let switches = switches(self.node).unwrap_or_default();
        for (bit, (port, pin)) in self.wiring.switches.iter().enumerate() {
            let open = switches >> bit & 1 == 0;
            self.board.set_input(*port, *pin, open);
        }
        self.wire_emergency_stop();
        self.set_pin(self.wiring.driver_fault, !self.driver_fault);
        self.set_pin(self.wiring.protective_stop, self.protective_stop);
        if let Some(select) = self.wiring.gyro {
            self.board.connect_gyro(select);
            let defect = self.gyro_defect;
            self.board.with_gyro(|gyro| gyro.set_defect(defect));
        }
        let (port, pin) = self.wiring.supply;
        self.board
            .set_analog(port, pin, self.supply / SUPPLY_DIVIDER);
        let encoders = self.wiring.encoders.into_iter().flatten();
        for (pins, levels) in encoders.zip(self.encoder_levels) {
            for ((port, pin), level) in pins.into_iter().zip(levels) {
                self.board.set_input(port, pin, level);
            }
        }
    }

    fn set_pin(&mut self, (port, pin): Pin, high: bool) {
        self.board.set_input(port, pin, high);
    }

    fn wire_emergency_stop(&mut self) {
        for pin in self.wiring.emergency_stop {
            self.set_pin(*pin, self.emergency_stop);
        }
    }

    /// World time that the board has reached, ns.
    fn board_now_ns(&self) -> u64 {
        self.born_ns + self.board.now_ns()
    }

    /// World time of the next event of the board or of its smart drives, ns.
    fn next_event_ns(&self) -> Option<u64> {
        let board = self.board.next_event_ns().map(|at| self.born_ns + at);
        let drives = self.drive_bus.as_ref().map(DriveBus::next_event_ns);
        board.into_iter().chain(drives).min()
    }

    /// The board, for looking at.
    #[must_use]
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// The board, for measuring on it.
    pub fn board_mut(&mut self) -> &mut Board {
        &mut self.board
    }

    fn run(&mut self, time_ns: u64) -> Result<(), SimError> {
        let index = self.wiring.index.into_iter().flatten();
        for (high, (port, pin)) in self.index_high.iter_mut().zip(index) {
            if std::mem::take(high) {
                self.board.set_input(port, pin, false);
            }
        }
        if let Some(bus) = &mut self.drive_bus {
            bus.turn(
                std::mem::take(&mut self.pending_counts),
                self.rates,
                time_ns,
            );
            self.pulse_beside_drives()?;
        } else if self.pending_index != [None; 4] {
            self.pulse(time_ns)?;
        }
        if self.pending_counts != [0; 4] {
            let counts = std::mem::take(&mut self.pending_counts);
            let turned = self.wiring.encoder_timers.into_iter().zip(counts);
            self.board
                .encoders_add(turned.filter(|turned| turned.1 != 0));
        }
        self.turn_by_edges(time_ns)?;
        self.run_drive_bus(time_ns)?;
        self.advance(time_ns)?;
        let instructions = self.board.instructions();
        if std::mem::replace(&mut self.instructions, instructions) != instructions {
            self.computed_ns = time_ns;
            self.look_at_mailboxes();
        }
        self.look_at_bridges();
        self.follow_errors();
        Ok(())
    }

    /// Raises the pins of the index pulses, each at its time between the events of the drives' bus.
    fn pulse_beside_drives(&mut self) -> Result<(), SimError> {
        let pulses = std::mem::take(&mut self.pending_index).into_iter();
        let mut pulses: Vec<_> = pulses.enumerate().filter(|(_, p)| p.is_some()).collect();
        pulses.sort_by_key(|(_, pulse)| pulse.map(|pulse| pulse.at_ns));
        for (wheel, pulse) in pulses {
            let at_ns = pulse.map_or(0, |pulse| pulse.at_ns);
            self.run_drive_bus(at_ns.max(self.board_now_ns()))?;
            self.raise_index(wheel);
        }
        Ok(())
    }

    fn raise_index(&mut self, wheel: usize) {
        if let Some(pins) = self.wiring.index {
            let (port, pin) = pins[wheel];
            self.board.set_input(port, pin, true);
            self.index_high[wheel] = true;
        }
    }

    /// Brings the counters to where they stood at the index pulses, raises the pins and lets the
    /// board see it.
    fn pulse(&mut self, time_ns: u64) -> Result<(), SimError> {
        for wheel in 0..4 {
            let Some(pulse) = self.pending_index[wheel].take() else {
                continue;
            };
            let to_index = self.pending_counts[wheel] - pulse.counts_ago;
            self.board
                .encoder_add(self.wiring.encoder_timers[wheel], to_index);
            self.pending_counts[wheel] = pulse.counts_ago;
            self.raise_index(wheel);
        }
        let now_ns = self.born_ns + self.board.now_ns();
        self.advance((now_ns + INDEX_NS).min(time_ns))
    }

    /// Lets the edges up to a time reach the pins, each at its own.
    fn turn_by_edges(&mut self, time_ns: u64) -> Result<(), SimError> {
        let due = self
            .pending_edges
            .partition_point(|(_, edge)| edge.at_ns <= time_ns);
        let mut edges = std::mem::take(&mut self.pending_edges);
        for (wheel, edge) in edges.drain(..due) {
            self.advance(edge.at_ns.max(self.board_now_ns()))?;
            if let Some(encoders) = self.wiring.encoders {
                self.set_pin(encoders[wheel][edge.channel], edge.level);
            }
        }
        self.pending_edges = edges;
        Ok(())
    }

    /// Runs the board and the bus of its smart drives up to a time, from event to event.
    fn run_drive_bus(&mut self, time_ns: u64) -> Result<(), SimError> {
        let Some(mut bus) = self.drive_bus.take() else {
            return Ok(());
        };
        let mut result = Ok(());
        loop {
            let at = bus.next_event_ns().min(time_ns);
            if at > self.board_now_ns() {
                result = self.advance(at);
            }
            bus.run(at, &mut self.board.can2());
            if result.is_err() || bus.next_event_ns() > time_ns {
                break;
            }
        }
        self.drive_bus = Some(bus);
        result
    }

    /// Runs the board to a time.
    fn advance(&mut self, time_ns: u64) -> Result<(), SimError> {
        self.board
            .run_until(time_ns - self.born_ns)
            .map_err(|stop| SimError::Stopped {
                node: self.node,
                time_ns: self.born_ns + stop.t_ns,
                problem: stop.to_string(),
            })?;
        Ok(())
    }

    /// Looks at the error counters.
    fn look_at_errors(&mut self) {
        let can = self.board.can();
        let state = if can.bus_off() {
            ErrorState::BusOff
        } else if can.error_passive() {
            ErrorState::Passive
        } else {
            ErrorState::Active
        };
        self.errors = (state, can.error_counters());
        self.look_at_mailboxes();
    }

    /// Looks at the error counters if there is anything to see.
    fn follow_errors(&mut self) {
        if self.errors != Default::default() {
            self.look_at_errors();
        }
    }

    fn look_at_mailboxes(&mut self) {
        self.pending = self
            .board
            .can()
            .pending()
            .and_then(|frame| match frame.id() {
                CanId::Standard(id) => Frame::new(id, frame.data()),
                CanId::Extended(_) => None,
            });
    }

    fn look_at_bridges(&mut self) {
        let (wiring, driver) = (&self.wiring, self.driver);
        let (rates, supply, bus) = (self.rates, self.supply, &self.drive_bus);
        self.drives = self.board.outputs(|outputs| {
            let mut high = |(port, pin): Pin| outputs.level(port, pin) == PinLevel::High;
            let enabled = high(wiring.driver_enable);
            let brake_released = high(wiring.brake_release);
            if let Some(bus) = bus {
                return bus.bridges(rates, supply, brake_released);
            }
            let mut levels_of = |pins: Option<[Pin; 4]>| pins.map(|pins| pins.map(&mut high));
            let (directions, inverse) = (levels_of(wiring.directions), levels_of(wiring.inverse));
            let mut duty = |channel: Channel| {
                let (timer, number) = (channel.timer, channel.number);
                let state = if channel.complementary {
                    outputs.complementary_pwm(timer, number)
                } else {
                    outputs.pwm(timer, number)
                };
                f64::from(state.duty)
            };
            std::array::from_fn(|wheel| {
                let [first, second] = wiring.channels[wheel];
                let levels = Levels {
                    enabled,
                    pwm: duty(first),
                    direction: match directions {
                        Some(levels) => u8::from(levels[wheel]).into(),
                        None => duty(second),
                    },
                    inverse: inverse.is_some_and(|levels| levels[wheel]),
                };
                let output = bridge::output(driver, &levels);
                Bridge {
                    duty: output.unwrap_or(0.0),
                    enabled: output.is_some(),
                    brake_released,
                }
            })
        });
    }

    /// Brings a sleeping board to the present.
    fn catch_up(&mut self) {
        if self.powered && self.board_now_ns() < self.now_ns {
            // It sleeps with nothing due, so nothing can go wrong.
            let _ = self.run(self.now_ns);
        }
    }
}

/// What the four switches say for this node, if they can.
fn switches(node: u8) -> Option<u8> {
    node.checked_sub(FIRST_NODE).filter(|value| *value < 16)
}
