//! An emulated robot: the firmware's release image on an emulated NUCLEO-F446RE, wired as a real
//! one.
//!
//! # Wiring
//!
//! | wheel | PWM | direction | encoder |
//! |---|---|---|---|
//! | front left | TIM1 CH1 | PC0 | TIM2 |
//! | front right | TIM1 CH2 | PC1 | TIM3 |
//! | rear left | TIM1 CH3 | PC2 | TIM4 |
//! | rear right | TIM1 CH4 | PC3 | TIM5 |
//!
//! Driver enable PB0, brake release PB1 (high is released), emergency stop PB12 and PA6 (a closed
//! contact pulls them low), driver fault PB13 (low is a fault), protective stop PC12 (low is
//! closed), node switches PC8..PC11 (closed pulls low and is 1; node = 2 + value), supply PA4 (ADC
//! input 4, divided by 11), motor current PA7. The opposites of the directions are PB2, PB4, PB5
//! and PD2. The motor driver is the one the world has ([`crate::bridge`]); pull-downs hold every
//! output low that the board does not drive.
//!
//! Encoder index front left PB10, front right PA12, rear left PB14, rear right PB15, high for a
//! moment at each pulse.
//!
//! # Time
//!
//! A power cycle creates a new board with the flash of the old one; its time begins at power-on.
//!
//! A sleeping board is not run: it is advanced to the present when an input changes or its own next
//! event is due. It receives encoder counts in one sum when it next computes; the edges of an
//! encoder whose wires are disturbed reach the pins one by one, each at its time.

mod robot;

use canopen::Frame;
use emulator::{Board, BoardConfig, CanId, Firmware, PinLevel, Port};
use group::Driver;

use super::LogLine;
use crate::bridge::{self, Levels};
use crate::bus::errors::{ErrorCounters, ErrorState};
use crate::encoder::wires::Edge;
use crate::error::SimError;
use crate::motor::Bridge;
use crate::smart_drive::DriveBus;

/// The PWM timer, and the encoder timers of the wheels.
const PWM_TIMER: usize = 1;
const ENCODER_TIMERS: [usize; 4] = [2, 3, 4, 5];
/// The encoders' wires A and B.
const ENCODER_PINS: [[(Port, u8); 2]; 4] = [
    [(Port::A, 15), (Port::B, 3)],
    [(Port::C, 6), (Port::C, 7)],
    [(Port::B, 6), (Port::B, 7)],
    [(Port::A, 0), (Port::A, 1)],
];
/// The encoders' indexes.
const INDEX_PINS: [(Port, u8); 4] = [(Port::B, 10), (Port::A, 12), (Port::B, 14), (Port::B, 15)];
/// How long a counter stands still at an index, so that the program reads it there, ns: a few
/// hundred instructions.
const INDEX_NS: u64 = 3_000;
/// The opposites of the directions.
const INVERSE_PINS: [(Port, u8); 4] = [(Port::B, 2), (Port::B, 4), (Port::B, 5), (Port::D, 2)];
/// Pins of port B.
const DRIVER_ENABLE: u8 = 0;
const BRAKE_RELEASE: u8 = 1;
const EMERGENCY_STOP: u8 = 12;
/// Pin of port A that is wired to it: the emergency stop cuts brake and driver enable there.
const EMERGENCY_STOP_A: u8 = 6;
/// ADC input of the supply, and its divider.
const SUPPLY_INPUT: usize = 4;
/// ADC inputs of the current sensors: PA7, PC4, PC5.
const CURRENT_INPUTS: [usize; 3] = [7, 14, 15];
pub(super) const SUPPLY_DIVIDER: f64 = 11.0;
const DRIVER_FAULT: u8 = 13;
/// Pin of port C.
const PROTECTIVE_STOP: u8 = 12;
/// Pins of port C: directions from 0, switches from here.
const FIRST_SWITCH: u8 = 8;
const FIRST_NODE: u8 = 2;
/// How long after the processor last computed its outputs may still change by themselves, ns: a new
/// duty takes effect at the end of a PWM period of 50 us.
const SETTLING_NS: u64 = 60_000;

/// See the [module](self).
pub struct EmulatedRobot {
    node: u8,
    firmware: Firmware,
    driver: Driver,
    config: BoardConfig,
    board: Board,
    /// World time at which the board was switched on, ns: its own time begins there.
    born_ns: u64,
    powered: bool,
    emergency_stop: bool,
    driver_fault: bool,
    protective_stop: bool,
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
    /// Counts since an index pulse that the board has not seen yet.
    pending_index: [Option<i32>; 4],
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

impl EmulatedRobot {
    /// A robot with this node and crystal error, just switched on.
    ///
    /// # Errors
    /// When four switches cannot say the node.
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
        if switches(node).is_none() {
            let problem = "four switches give nodes 2 to 17 only".to_owned();
            return Err(SimError::Robot { node, problem });
        }
        let config = BoardConfig {
            crystal_ppm,
            uid,
            ..BoardConfig::default()
        };
        let mut robot = Self {
            node,
            firmware: firmware.clone(),
            driver: Driver::default(),
            board: Board::new(firmware, config.clone()),
            config,
            born_ns: 0,
            powered: true,
            emergency_stop: false,
            driver_fault: false,
            protective_stop: false,
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
        Ok(robot)
    }

    /// Connects everything outside to the board's pins.
    fn wire(&mut self) {
        // Checked when it was built.
        let switches = switches(self.node).unwrap_or_default();
        for bit in 0..4 {
            let open = switches >> bit & 1 == 0;
            self.board.set_input(Port::C, FIRST_SWITCH + bit, open);
        }
        self.board
            .set_input(Port::B, EMERGENCY_STOP, self.emergency_stop);
        self.board
            .set_input(Port::A, EMERGENCY_STOP_A, self.emergency_stop);
        self.board
            .set_analog(SUPPLY_INPUT, self.supply / SUPPLY_DIVIDER);
        self.board
            .set_input(Port::B, DRIVER_FAULT, !self.driver_fault);
        self.board
            .set_input(Port::C, PROTECTIVE_STOP, self.protective_stop);
        for (pins, levels) in ENCODER_PINS.into_iter().zip(self.encoder_levels) {
            for ((port, pin), level) in pins.into_iter().zip(levels) {
                self.board.set_input(port, pin, level);
            }
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
        for (high, (port, pin)) in self.index_high.iter_mut().zip(INDEX_PINS) {
            if std::mem::take(high) {
                self.board.set_input(port, pin, false);
            }
        }
        if self.pending_index != [None; 4] {
            self.pulse(time_ns)?;
        }
        if let Some(bus) = &mut self.drive_bus {
            bus.turn(
                std::mem::take(&mut self.pending_counts),
                self.rates,
                time_ns,
            );
        }
        for (timer, counts) in ENCODER_TIMERS.into_iter().zip(&mut self.pending_counts) {
            if *counts != 0 {
                self.board.encoder_add(timer, *counts);
                *counts = 0;
            }
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

    /// Brings the counters to where they stood at the index pulses, raises the pins and lets the
    /// board see it.
    fn pulse(&mut self, time_ns: u64) -> Result<(), SimError> {
        for wheel in 0..4 {
            let Some(ago) = self.pending_index[wheel].take() else {
                continue;
            };
            let to_index = self.pending_counts[wheel] - ago;
            self.board.encoder_add(ENCODER_TIMERS[wheel], to_index);
            self.pending_counts[wheel] = ago;
            let (port, pin) = INDEX_PINS[wheel];
            self.board.set_input(port, pin, true);
            self.index_high[wheel] = true;
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
            let (port, pin) = ENCODER_PINS[wheel][edge.channel];
            self.board.set_input(port, pin, edge.level);
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
        let high = |port, pin| self.board.output(port, pin) == PinLevel::High;
        let enabled = high(Port::B, DRIVER_ENABLE);
        let brake_released = high(Port::B, BRAKE_RELEASE);
        if let Some(bus) = &self.drive_bus {
            self.drives = bus.voltages(self.rates).map(|voltage| Bridge {
                duty: voltage.unwrap_or(0.0),
                enabled: voltage.is_some(),
                brake_released,
            });
            return;
        }
        self.drives = std::array::from_fn(|wheel| {
            let (port, pin) = INVERSE_PINS[wheel];
            let levels = Levels {
                enabled,
                pwm: self.board.pwm(PWM_TIMER, wheel + 1).duty.into(),
                // Four wheels: a u8 holds the pin.
                direction: high(Port::C, wheel as u8),
                inverse: high(port, pin),
            };
            let output = bridge::output(self.driver, &levels);
            Bridge {
                duty: output.unwrap_or(0.0),
                enabled: output.is_some(),
                brake_released,
            }
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
