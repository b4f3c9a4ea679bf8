//! An emulated robot: the firmware's release image on an emulated NUCLEO-F446RE, wired as a real one.
//!
//! | wheel | PWM | direction | encoder |
//! |---|---|---|---|
//! | front left | TIM1 CH1 | PC0 | TIM2 |
//! | front right | TIM1 CH2 | PC1 | TIM3 |
//! | rear left | TIM1 CH3 | PC2 | TIM4 |
//! | rear right | TIM1 CH4 | PC3 | TIM5 |
//!
//! Driver enable PB0, brake release PB1 (high is released), emergency stop PB12 (a closed contact pulls it low),
//! driver fault PB13 (low is a fault), node switches PC8..PC11 (closed pulls low and is 1; node = 2 +
//! value). A bridge conducts while it is enabled and the timer drives its pin or holds it low; a pin that
//! floats is a bridge that is off.
//!
//! A sleeping board is not run: it is brought to the present when something reaches it or its own next
//! event is due. Encoder edges are handed over when it next computes, in one piece.

use canopen::Frame;
use emulator::{Board, BoardConfig, CanError, CanFrame, CanId, Firmware, PinLevel, Port};

use super::{LogLine, Robot, Wake};
use crate::error::SimError;
use crate::motor::Drive;

/// The PWM timer, and the encoder timers of the wheels.
const PWM_TIMER: usize = 1;
const ENCODER_TIMERS: [usize; 4] = [2, 3, 4, 5];
/// Pins of port B.
const DRIVER_ENABLE: u8 = 0;
const BRAKE_RELEASE: u8 = 1;
const EMERGENCY_STOP: u8 = 12;
const DRIVER_FAULT: u8 = 13;
/// Pins of port C: directions from 0, switches from here.
const FIRST_SWITCH: u8 = 8;
const FIRST_NODE: u8 = 2;
/// How long after the processor last computed its outputs may still change by themselves, ns: a new duty
/// takes effect at the end of a PWM period of 50 us.
const SETTLING_NS: u64 = 60_000;

/// See the [module](self).
pub struct EmulatedRobot {
    node: u8,
    board: Board,
    /// World time, which the board may be behind while it sleeps.
    now_ns: u64,
    computed_ns: u64,
    instructions: u64,
    pending_counts: [i32; 4],
    pending: Option<Frame>,
    drives: [Drive; 4],
}

impl EmulatedRobot {
    /// A robot with this node and crystal error, just switched on.
    ///
    /// # Errors
    /// When four switches cannot say the node.
    pub fn new(firmware: &Firmware, node: u8, crystal_ppm: f64) -> Result<Self, SimError> {
        let Some(switches) = node.checked_sub(FIRST_NODE).filter(|value| *value < 16) else {
            let problem = "four switches give nodes 2 to 17 only".to_owned();
            return Err(SimError::Robot { node, problem });
        };
        let mut uid = *b"OMNIBUS-SIM\0";
        uid[11] = node;
        let config = BoardConfig {
            crystal_ppm,
            uid,
            ..BoardConfig::default()
        };
        let mut board = Board::new(firmware, config);
        for bit in 0..4 {
            board.set_input(Port::C, FIRST_SWITCH + bit, switches >> bit & 1 == 0);
        }
        board.set_input(Port::B, EMERGENCY_STOP, false);
        board.set_input(Port::B, DRIVER_FAULT, true);
        Ok(Self {
            node,
            board,
            now_ns: 0,
            computed_ns: 0,
            instructions: 0,
            pending_counts: [0; 4],
            pending: None,
            drives: [Drive::default(); 4],
        })
    }

    /// The board, for looking at.
    #[must_use]
    pub fn board(&self) -> &Board {
        &self.board
    }

    fn run(&mut self, time_ns: u64) -> Result<(), SimError> {
        for (timer, counts) in ENCODER_TIMERS.into_iter().zip(&mut self.pending_counts) {
            if *counts != 0 {
                self.board.encoder_add(timer, *counts);
                *counts = 0;
            }
        }
        self.board
            .run_until(time_ns)
            .map_err(|stop| SimError::Stopped {
                node: self.node,
                time_ns: stop.t_ns,
                problem: stop.to_string(),
            })?;
        let instructions = self.board.instructions();
        if std::mem::replace(&mut self.instructions, instructions) != instructions {
            self.computed_ns = time_ns;
            self.look_at_mailboxes();
        }
        self.look_at_bridges();
        Ok(())
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
        self.drives = std::array::from_fn(|wheel| {
            // Four wheels: a u8 holds the pin.
            let forward = high(Port::C, wheel as u8);
            let pwm = self.board.pwm(PWM_TIMER, wheel + 1);
            let duty = f64::from(pwm.duty);
            Drive {
                duty: if forward { duty } else { -duty },
                enabled: enabled && pwm.active,
                brake_released,
            }
        });
    }

    /// Brings a sleeping board to the present.
    fn catch_up(&mut self) {
        if self.board.now_ns() < self.now_ns {
            // It sleeps with nothing due, so nothing can go wrong.
            let _ = self.run(self.now_ns);
        }
    }
}

impl Robot for EmulatedRobot {
    fn run_until(&mut self, time_ns: u64) -> Result<(), SimError> {
        self.now_ns = time_ns;
        let settled = time_ns > self.computed_ns + SETTLING_NS;
        let due = self.board.next_event_ns().is_some_and(|at| at <= time_ns);
        if settled && self.board.is_asleep() && !due {
            return Ok(());
        }
        self.run(time_ns)
    }

    fn wake(&self) -> Wake {
        match self.board.next_event_ns() {
            Some(at) if at <= self.now_ns || !self.board.is_asleep() => Wake::Busy,
            Some(at) => Wake::At(at),
            None => Wake::Never,
        }
    }

    fn pending(&self) -> Option<Frame> {
        self.pending
    }

    fn begin(&mut self) {
        self.catch_up();
        self.board.can().begin();
    }

    fn transmitted(&mut self) {
        self.catch_up();
        self.board.can().transmitted();
        self.look_at_mailboxes();
    }

    fn lost_arbitration(&mut self) {
        self.catch_up();
        self.board.can().lost_arbitration();
    }

    fn receive(&mut self, frame: &Frame) {
        self.catch_up();
        if let Some(frame) = CanFrame::new(frame.id(), frame.data()) {
            self.board.can().receive(&frame);
        }
    }

    fn drives(&self) -> [Drive; 4] {
        self.drives
    }

    fn turn_encoders(&mut self, counts: [i32; 4]) {
        for (pending, counts) in self.pending_counts.iter_mut().zip(counts) {
            *pending += counts;
        }
    }

    fn set_emergency_stop(&mut self, pressed: bool) {
        self.catch_up();
        self.board.set_input(Port::B, EMERGENCY_STOP, pressed);
        // The break input acts without the processor, which may be asleep or halted.
        self.look_at_bridges();
    }

    fn set_driver_fault(&mut self, fault: bool) {
        self.catch_up();
        self.board.set_input(Port::B, DRIVER_FAULT, !fault);
    }

    fn force_bus_off(&mut self) -> bool {
        self.catch_up();
        self.look_at_mailboxes();
        if self.pending.is_none() {
            return false;
        }
        let mut can = self.board.can();
        while !can.bus_off() && can.begin().is_some() {
            can.error(CanError::BitDominant);
        }
        let off = can.bus_off();
        self.look_at_mailboxes();
        off
    }

    fn overrun(&mut self) {
        // The FIFO holds three (RM0390 rev 6, 30.7.5). Nobody in a group listens to this identifier.
        const FRAMES: usize = 5;
        const IDENTIFIER: u16 = 0x7FF;
        if let Some(frame) = Frame::new(IDENTIFIER, &[]) {
            (0..FRAMES).for_each(|_| self.receive(&frame));
        }
    }

    fn halt(&mut self, halted: bool) -> bool {
        self.catch_up();
        self.board.halt(halted);
        true
    }

    fn crash(&mut self) -> bool {
        // Between the peripherals and the core's own registers there is nothing.
        const NOWHERE: u32 = 0xC000_0000;
        self.catch_up();
        self.board.jump(NOWHERE);
        true
    }

    fn take_log(&mut self) -> Vec<LogLine> {
        let line = |line: emulator::LogLine| LogLine {
            time_us: line.time_us,
            level: format!("{:?}", line.level).to_lowercase(),
            text: match line.location {
                Some(location) => format!("{} [{location}]", line.text),
                None => line.text,
            },
        };
        self.board.take_log().into_iter().map(line).collect()
    }

    fn is_heavy(&self, until_ns: u64) -> bool {
        // A processor that computes does some thousand instructions in a step of 20 us; shorter steps
        // are over before another thread has woken up.
        !self.board.is_asleep() && until_ns - self.now_ns > 2_000
    }

    fn instructions(&self) -> u64 {
        self.board.instructions()
    }
}
