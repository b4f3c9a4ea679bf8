//! Traces as VCD files (IEEE 1364-2005, section 18), which GTKWave, Surfer and PulseView open.
//!
//! The caller names the signals to be written, because it knows the use of each pin; the program's
//! exception and task, and the frames on the bus, have separate signals. Times are in ns of the
//! world. Names of tasks and frames are string changes, an extension that the viewers above
//! support.

use std::io::{self, Write};

use vcd::{IdCode, SimulationCommand, TimescaleUnit, Value, VarType};

use crate::can::{CanFrame, CanId};
use crate::system::gpio::{PinLevel, Port};
use crate::timer::PwmState;
use crate::trace::{Change, Traced};

/// Which signals of a board are written, each with its name.
#[derive(Debug, Clone, Default)]
pub struct Signals {
    /// PWM outputs: timer, channel. Written as the duty, and whether the output is driven.
    pub pwm: Vec<(usize, usize, String)>,
    /// Output pins.
    pub pins: Vec<(Port, u8, String)>,
    /// Encoders: timer. Written as the counter.
    pub encoders: Vec<(usize, String)>,
}

/// Writes one board's trace.
pub struct Waveform<W: Write> {
    out: vcd::Writer<W>,
    pwm: Vec<((usize, usize), IdCode, IdCode)>,
    pins: Vec<((Port, u8), IdCode)>,
    encoders: Vec<(usize, IdCode)>,
    exception: IdCode,
    task: IdCode,
    sent: IdCode,
    arrived: IdCode,
    time_ns: Option<u64>,
}

impl<W: Write> Waveform<W> {
    /// Begins a file: names of the board and its signals, everything unknown.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn new(out: W, board: &str, signals: &Signals) -> io::Result<Self> {
        let mut out = vcd::Writer::new(out);
        out.timescale(1, TimescaleUnit::NS)?;
        out.add_module(&identifier(board))?;
        let mut pwm = Vec::new();
        for (timer, channel, name) in &signals.pwm {
            let name = identifier(name);
            let duty = out.add_var(VarType::Real, 64, &format!("{name}_duty"), None)?;
            let driven = out.add_wire(1, &format!("{name}_driven"))?;
            pwm.push(((*timer, *channel), duty, driven));
        }
        let mut pins = Vec::new();
        for (port, pin, name) in &signals.pins {
            pins.push(((*port, *pin), out.add_wire(1, &identifier(name))?));
        }
        let mut encoders = Vec::new();
        for (timer, name) in &signals.encoders {
            let id = out.add_var(VarType::Integer, 32, &identifier(name), None)?;
            encoders.push((*timer, id));
        }
        let exception = out.add_var(VarType::Integer, 32, "exception", None)?;
        let mut text = |name| out.add_var(VarType::String, 1, name, None);
        let (task, sent, arrived) = (text("task")?, text("can_sent")?, text("can_arrived")?);
        out.upscope()?;
        out.enddefinitions()?;
        out.timestamp(0)?;
        out.begin(SimulationCommand::Dumpvars)?;
        for (_, duty, driven) in &pwm {
            out.change_real(*duty, 0.0)?;
            out.change_scalar(*driven, Value::V0)?;
        }
        for (_, pin) in &pins {
            out.change_scalar(*pin, Value::Z)?;
        }
        for (_, encoder) in &encoders {
            out.change_vector(*encoder, bits(0))?;
        }
        out.change_vector(exception, bits(0))?;
        for id in [task, sent, arrived] {
            out.change_string(id, "-")?;
        }
        out.end()?;
        Ok(Self {
            out,
            pwm,
            pins,
            encoders,
            exception,
            task,
            sent,
            arrived,
            time_ns: None,
        })
    }

    /// Writes what [`Board::take_trace`](crate::Board::take_trace) gave, call after call in order.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&mut self, mut changes: Vec<Traced>) -> io::Result<()> {
        changes.sort_by_key(|traced| traced.t_ns);
        for Traced { t_ns, change } in changes {
            // A frame is requested a little before it is noticed.
            let time_ns = self.time_ns.map_or(t_ns, |last| last.max(t_ns));
            if self.time_ns.replace(time_ns) != Some(time_ns) {
                self.out.timestamp(time_ns)?;
            }
            self.change(&change)?;
        }
        Ok(())
    }

    fn change(&mut self, change: &Change) -> io::Result<()> {
        let out = &mut self.out;
        match change {
            Change::Pwm {
                timer,
                channel,
                state,
            } => {
                let PwmState { duty, active, .. } = *state;
                for (_, duty_id, driven_id) in find(&self.pwm, |s| s.0 == (*timer, *channel)) {
                    out.change_real(*duty_id, f64::from(duty))?;
                    out.change_scalar(*driven_id, active)?;
                }
            }
            Change::Pin { port, pin, level } => {
                let value = match level {
                    PinLevel::High => Value::V1,
                    PinLevel::Low => Value::V0,
                    PinLevel::Floating => Value::Z,
                };
                for (_, id) in find(&self.pins, |s| s.0 == (*port, *pin)) {
                    out.change_scalar(*id, value)?;
                }
            }
            Change::Encoder { timer, count } => {
                for (_, id) in find(&self.encoders, |s| s.0 == *timer) {
                    out.change_vector(*id, bits(*count))?;
                }
            }
            Change::Exception(number) => {
                out.change_vector(self.exception, bits(u32::from(*number)))?;
            }
            Change::Task(name) => out.change_string(self.task, name.as_deref().unwrap_or("-"))?,
            Change::Request(frame) => out.change_string(self.sent, &text(frame))?,
            Change::Arrival(frame) => out.change_string(self.arrived, &text(frame))?,
        }
        Ok(())
    }

    /// Writes out what is buffered.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

fn find<T>(signals: &[T], is: impl Fn(&T) -> bool) -> impl Iterator<Item = &T> {
    signals.iter().filter(move |signal| is(signal))
}

/// 32 bits, the highest first.
fn bits(value: u32) -> impl Iterator<Item = Value> {
    (0..32)
        .rev()
        .map(move |bit| Value::from(value >> bit & 1 != 0))
}

/// A frame as candump writes it, "181#0102": no blanks, which a VCD string cannot have.
fn text(frame: &CanFrame) -> String {
    let id = match frame.id() {
        CanId::Standard(id) => format!("{id:03X}"),
        CanId::Extended(id) => format!("{id:08X}"),
    };
    if frame.is_remote() {
        return format!("{id}#R{}", frame.dlc());
    }
    frame
        .data()
        .iter()
        .fold(format!("{id}#"), |text, byte| format!("{text}{byte:02X}"))
}

/// A name without what a VCD identifier cannot have.
fn identifier(name: &str) -> String {
    name.chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trace_reads_back_as_it_was_written() {
        let signals = Signals {
            pwm: vec![(1, 2, "front right".to_owned())],
            pins: vec![(Port::B, 0, "enable".to_owned())],
            encoders: vec![(3, "encoder".to_owned())],
        };
        let mut file = Vec::new();
        let mut waveform = Waveform::new(&mut file, "node 2", &signals).unwrap();
        let at = |t_ns, change| Traced { t_ns, change };
        let pin = |level| Change::Pin {
            port: Port::B,
            pin: 0,
            level,
        };
        let frame = CanFrame::new(0x181, &[1, 0xAB]).unwrap();
        waveform
            .write(vec![
                at(20, pin(PinLevel::High)),
                at(10, Change::Request(frame)),
                at(20, Change::Encoder { timer: 3, count: 5 }),
                // Another pin, which was not requested.
                at(
                    25,
                    Change::Pin {
                        port: Port::C,
                        pin: 0,
                        level: PinLevel::High,
                    },
                ),
            ])
            .unwrap();
        waveform
            .write(vec![at(30, Change::Task(Some("led".into())))])
            .unwrap();
        waveform.finish().unwrap();
        drop(waveform);

        let mut parser = vcd::Parser::new(&*file);
        let header = parser.parse_header().unwrap();
        assert_eq!(header.timescale, Some((1, TimescaleUnit::NS)));
        let id = |name: &str| header.find_var(&["node_2", name]).unwrap().code;
        let (enable, encoder) = (id("enable"), id("encoder"));
        let (sent, task) = (id("can_sent"), id("task"));
        let commands: Vec<vcd::Command> = parser.map(Result::unwrap).collect();
        let dumped = commands
            .iter()
            .position(|c| matches!(c, vcd::Command::End(_)))
            .unwrap();
        let expected = [
            vcd::Command::Timestamp(10),
            vcd::Command::ChangeString(sent, "181#01AB".to_owned()),
            vcd::Command::Timestamp(20),
            vcd::Command::ChangeScalar(enable, Value::V1),
            vcd::Command::ChangeVector(encoder, bits(5).collect()),
            vcd::Command::Timestamp(25),
            vcd::Command::Timestamp(30),
            vcd::Command::ChangeString(task, "led".to_owned()),
        ];
        assert_eq!(&commands[dumped + 1..], expected);
    }
}
