//! The self-test image: a bare board that measures itself with a few wires between its pins.
//!
//! It is a CANopen device with the objects of `protocol::self_test` and nothing of a robot: there
//! is no state machine, no setpoint and no control tick, so it can never be started. The procedure
//! is the host's (`cargo xtask accept`); this sets pins, measures and answers. It is reached as a
//! robot is, over CAN or the cable.
//!
//! # Safety
//!
//! A duty and the driver enable are never on together ([`Outputs::test`]); a pin of the power stage
//! that is driven as a plain output bars both until the next reset. Driver enable and brake release
//! are no plain outputs at all. All of this is for boards without motors: with locked antiphase a
//! low PWM is full voltage.
//!
//! # Limits
//!
//! One task, at the lowest priority; while a measurement runs, up to 20 ms, nothing is answered.
//! The watchdog runs at its normal time and is fed every 5 ms.

use canopen::{AbortCode, Application, Config, Device, Frame, Micros, NmtState, NodeId};
use defmt::unwrap;
use embassy_executor::Spawner;
use embassy_time::{Duration, Timer};
use protocol::self_test::{
    BITS, CHIP, CLOCK, ENCODER, FAIL, FLASH, HALT, LEVELS, METERS, NAME, OTHERS, OUTPUTS, OWN,
    PANIC, PIN, RESET, STOP, WATCHED, WAVE,
};
use robot::record_store::Flash as _;

use crate::board::pin::{Pin, Pull};
use crate::board::probe::{self, Bits, Signals, Wave};
use crate::board::{
    Board, Encoders, Meters, Outputs, ParameterFlash, calibrate_meters, chip, executors, now,
    patiently, reset,
};
use crate::gateway::Gateway;
use crate::wake;

/// How long a failure waits for its answer to be sent.
const ANSWER: Duration = Duration::from_millis(2);
/// Longest time between two turns, and two feedings of the watchdog.
const LONGEST_WAIT: Duration = Duration::from_millis(5);

/// The board as the objects see it.
struct Bench {
    outputs: Outputs,
    encoders: Encoders,
    meters: Meters,
    reset_cause: u8,
    duty: [i16; 4],
    gates: [bool; 2],
    /// A pin of the power stage is a plain output.
    loose: bool,
    wave: Wave,
    watched: [Option<Pin>; WATCHED],
    low: [u32; WATCHED],
    signals: Signals,
    failure: Option<u8>,
    flash: ParameterFlash,
    flash_times: FlashTimes,
    bits: Bits,
    /// The sender whose frame is measured.
    listens_to: Option<u8>,
}

/// Raw times of the flash, clocks of the core.
#[derive(Clone, Copy, Default)]
struct FlashTimes {
    erase: u32,
    word: u32,
    /// Words that read back wrong, and operations that failed.
    wrong: u16,
}

/// Runs the self-test.
pub fn run() -> ! {
    let board = Board::new();
    executors::bus().run(|spawner: Spawner| {
        spawner.spawn(unwrap!(bench(board)));
        spawner.spawn(unwrap!(turns()));
    })
}

/// Wakes the bench often enough for the watchdog.
#[embassy_executor::task]
async fn turns() {
    loop {
        Timer::after(LONGEST_WAIT).await;
        wake::BUS.signal();
    }
}

/// Answers and measures.
#[embassy_executor::task]
async fn bench(board: Board) {
    probe::start();
    let node = NodeId::new(protocol::FIRST_ROBOT + board.node_switches).unwrap_or(NodeId::MIN);
    let mut device = Device::new(Config {
        node: Some(node),
        identity: canopen::Identity {
            vendor: 0,
            product: protocol::PRODUCT,
            revision: u32::from(protocol::WIRE_VERSION) << 16,
            serial: board.serial,
        },
        name: NAME,
        ..Config::DEFAULT
    });
    let mut can = board.can;
    can.listen(device.function_codes(), node.get(), 0);
    let mut gateway = Gateway::new(board.cable, board.serial);
    let mut watchdog = board.watchdog;
    let nowhere = Pin { port: 0, bit: 0 };
    let mut bench = Bench {
        outputs: board.outputs,
        encoders: board.encoders,
        meters: board.meters,
        reset_cause: board.reset_cause as u8,
        duty: [0; 4],
        gates: [false; 2],
        loose: false,
        wave: Wave::default(),
        watched: [None; WATCHED],
        low: [0; WATCHED],
        signals: Signals {
            pins: [nowhere; 2],
            step_us: 5,
            noisy: false,
        },
        failure: None,
        flash: board.flash,
        flash_times: FlashTimes::default(),
        bits: Bits::default(),
        listens_to: None,
    };
    let mut waiting: Option<Frame> = None;
    loop {
        watchdog.feed();
        gateway.receive(&mut can);
        while let Some(received) = can.try_receive() {
            device.on_frame(Micros(received.at.0), &received.frame, &mut bench);
        }
        device.poll(Micros(now().0), &mut bench);
        while device.pop_event().is_some() {}
        waiting = waiting.or_else(|| next(&mut device, &mut gateway));
        while let Some(frame) = waiting
            && (can.try_send(&frame) || gateway.goes_on_without(&mut can))
        {
            waiting = next(&mut device, &mut gateway);
        }
        match bench.listens_to.take_if(|_| waiting.is_none()) {
            // The answer has just been given to the controller.
            Some(OWN) => bench.bits = probe::bits(),
            Some(_) => {
                Timer::after(ANSWER).await;
                watchdog.feed();
                bench.bits = probe::bits();
            }
            None => {}
        }
        if let Some(failure) = bench.failure {
            Timer::after(ANSWER).await;
            watchdog.feed();
            fail(failure);
        }
        wake::BUS.wait().await;
    }
}

/// The next frame to send, which the cable has then.
fn next(device: &mut Device, gateway: &mut Gateway) -> Option<Frame> {
    let frame = device.pop_frame()?;
    gateway.send(&frame);
    Some(frame)
}

/// Fails as asked.
fn fail(failure: u8) -> ! {
    match failure {
        HALT => probe::halt(),
        RESET => reset(),
        _ => panic!("asked for"),
    }
}

/// A value of one, two or four bytes.
fn number(data: &[u8]) -> Result<u32, AbortCode> {
    let mut bytes = [0; 4];
    let to = bytes.get_mut(..data.len()).ok_or(AbortCode::TooLong)?;
    to.copy_from_slice(data);
    Ok(u32::from_le_bytes(bytes))
}

/// A value of exactly so many bytes.
fn exactly(bytes: usize, data: &[u8]) -> Result<u32, AbortCode> {
    match data.len() {
        length if length < bytes => Err(AbortCode::TooShort),
        length if length > bytes => Err(AbortCode::TooLong),
        _ => number(data),
    }
}

fn pin(number: u32) -> Result<Pin, AbortCode> {
    let pin = u8::try_from(number).ok().and_then(probe::by_number);
    pin.ok_or(AbortCode::InvalidValue)
}

impl Bench {
    /// Makes a pin an input or an output, whose lower byte is the pin.
    fn set_pin(&mut self, sub: u8, value: u32) -> Result<(), AbortCode> {
        let (pin, what) = (pin(value & 0xFF)?, value >> 8);
        let is_off = self.duty == [0; 4] && self.gates == [false; 2];
        if probe::is_of_the_power_stage(pin) {
            if !is_off {
                return Err(AbortCode::DeviceState);
            }
            self.loose = true;
        }
        let done = match (sub, what) {
            (1, 0) => probe::become_input(pin, Pull::None),
            (1, 1) => probe::become_input(pin, Pull::Up),
            (1, 2) => probe::become_input(pin, Pull::Down),
            (2, 0 | 1) => probe::become_output(pin, what == 1),
            (1 | 2, _) => return Err(AbortCode::InvalidValue),
            _ => return Err(AbortCode::NoSubIndex),
        };
        done.ok_or(AbortCode::InvalidValue)
    }

    /// Sets a duty or a gate.
    fn set_output(&mut self, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        if self.loose {
            return Err(AbortCode::DeviceState);
        }
        let (mut duty, mut gates) = (self.duty, self.gates);
        match sub {
            1..=4 => {
                let value = exactly(2, data)? as u16 as i16;
                if value.unsigned_abs() > 1000 {
                    return Err(AbortCode::InvalidValue);
                }
                duty[usize::from(sub - 1)] = value;
            }
            5 | 6 => gates[usize::from(sub - 5)] = exactly(1, data)? != 0,
            _ => return Err(AbortCode::NoSubIndex),
        }
        if gates[0] && duty != [0; 4] {
            return Err(AbortCode::DeviceState);
        }
        (self.duty, self.gates) = (duty, gates);
        let duty = duty.map(|duty| f32::from(duty) / 1000.0);
        self.outputs.test(duty, gates[0], gates[1]);
        Ok(())
    }

    /// Watches pins, or runs the measurement.
    fn stop(&mut self, sub: u8, value: u32) -> Result<(), AbortCode> {
        match sub {
            1 => {
                let source = pin(value)?;
                if probe::is_of_the_power_stage(source) {
                    return Err(AbortCode::InvalidValue);
                }
                probe::become_output(source, false).ok_or(AbortCode::InvalidValue)?;
                self.low = probe::stop(source, &self.watched);
            }
            2..=7 => self.watched[usize::from(sub - 2)] = pin(value).ok(),
            _ => return Err(AbortCode::NoSubIndex),
        }
        Ok(())
    }

    /// Sets up the signals of an encoder, or makes them.
    fn turn(&mut self, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        let byte = || exactly(1, data);
        match sub {
            1 => {
                let edges = exactly(2, data)? as u16 as i16;
                // Only plain outputs; those of the power stage are by way of `set_pin`.
                if !self.loose {
                    return Err(AbortCode::DeviceState);
                }
                probe::turn(&self.signals, edges.unsigned_abs(), edges >= 0);
            }
            2 | 3 => self.signals.pins[usize::from(sub - 2)] = pin(byte()?)?,
            4 => self.signals.step_us = byte()? as u8,
            5 => self.signals.noisy = byte()? != 0,
            _ => return Err(AbortCode::NoSubIndex),
        }
        Ok(())
    }

    /// Erases the sectors of the parameters, programs words, erases again. This forgets what was
    /// stored; the self-test itself stores nothing.
    fn try_flash(&mut self, words: u32) {
        let mut times = FlashTimes::default();
        let flash = &mut self.flash;
        let patient = patiently(|| {
            times.erase(flash, 0);
            times.erase(flash, ParameterFlash::SECTOR);
            for word in 0..words {
                let (at, value) = (word * 4, word.wrapping_mul(0x9E37_79B9));
                let (took, done) = probe::clocks(|| flash.program(at, value));
                times.word = times.word.max(took);
                times.wrong += u16::from(done.is_err() || flash.word(at) != value);
            }
            times.erase(flash, 0);
        });
        times.wrong += u16::from(patient.is_err());
        self.flash_times = times;
    }

    /// What is read, and its length in bytes.
    fn value(&self, index: u16, sub: u8) -> Option<(u32, usize)> {
        let at = usize::from(sub);
        Some(match (index, sub) {
            (LEVELS, 1..=4) => (u32::from(probe::levels(sub - 1)), 2),
            (WAVE, 2) => (self.wave.total, 4),
            (WAVE, 3) => (self.wave.high, 4),
            (WAVE, 4) => (u32::from(self.wave.periods), 1),
            (STOP, 8..=13) => (self.low[at - 8], 4),
            (ENCODER, 6..=9) => (u32::from(self.encoders.counts()[at - 6]), 2),
            (METERS, 1) => (millivolts(self.meters.supply().to_f32()), 2),
            (METERS, 2..=4) => (millivolts(self.meters.currents()[at - 2]), 2),
            (CLOCK, 1) => (now().0 as u32, 4),
            (CLOCK, 2) => (probe::core_hz(), 4),
            (CLOCK, 3) => (u32::from(probe::over_drive()), 1),
            (CHIP, 1) => (chip(), 4),
            (FLASH, 2) => (self.flash_times.erase, 4),
            (FLASH, 3) => (self.flash_times.word, 4),
            (FLASH, 4) => (u32::from(self.flash_times.wrong), 2),
            (BITS, 2) => (self.bits.total, 4),
            (BITS, 3) => (self.bits.off, 4),
            (BITS, 4) => (u32::from(self.bits.bits), 1),
            (BITS, 5) => (u32::from(self.bits.edges), 1),
            (FAIL, 2) => (u32::from(self.reset_cause), 1),
            _ => return None,
        })
    }
}

impl FlashTimes {
    /// Erases the sector that begins here.
    fn erase(&mut self, flash: &mut ParameterFlash, at: u32) {
        let (took, done) = probe::clocks(|| flash.erase(at));
        self.erase = self.erase.max(took);
        self.wrong += u16::from(done.is_err() || flash.word(at) != u32::MAX);
    }
}

fn millivolts(volts: f32) -> u32 {
    (volts * 1000.0) as u32
}

impl Application for Bench {
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        if index == METERS {
            calibrate_meters();
        }
        let (value, length) = self.value(index, sub).ok_or(AbortCode::NoObject)?;
        let to = out.get_mut(..length).ok_or(AbortCode::OutOfMemory)?;
        to.copy_from_slice(&value.to_le_bytes()[..length]);
        Ok(length)
    }

    fn write(&mut self, index: u16, sub: u8, data: &[u8], _: NmtState) -> Result<(), AbortCode> {
        match (index, sub) {
            (PIN, _) => self.set_pin(sub, exactly(2, data)?),
            (OUTPUTS, _) => self.set_output(sub, data),
            (WAVE, 1) => {
                self.wave = probe::wave(pin(exactly(1, data)?)?);
                Ok(())
            }
            (STOP, _) => self.stop(sub, exactly(1, data)?),
            (ENCODER, _) => self.turn(sub, data),
            (FLASH, 1) => {
                self.try_flash(exactly(1, data)?);
                Ok(())
            }
            (BITS, 1) => match exactly(1, data)? as u8 {
                whose @ (OWN | OTHERS) => {
                    self.listens_to = Some(whose);
                    Ok(())
                }
                _ => Err(AbortCode::InvalidValue),
            },
            (FAIL, 1) => match exactly(1, data)? as u8 {
                failure @ (HALT | PANIC | RESET) => {
                    self.failure = Some(failure);
                    Ok(())
                }
                _ => Err(AbortCode::InvalidValue),
            },
            _ => Err(AbortCode::NoObject),
        }
    }
}
