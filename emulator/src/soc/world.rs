//! What the world sees of the chip: pins, PWM outputs, encoder inputs, the CAN connector.

use super::Soc;
use crate::system::gpio::{Mode, PinLevel, Port};
use crate::system::pins::{self, Route};
use crate::timer::PwmState;
use crate::trace::{Change, PWM_TIMERS, Trace};

/// Offset of a timer's counter (RM0390 section 17.4.21).
const CNT: u32 = 0x24;

impl Soc {
    /// Connects a pin to a level outside.
    pub(crate) fn set_input(&mut self, port: Port, pin: u8, level: bool) {
        let before = self.gpio[port as usize].idr();
        self.gpio[port as usize].set_external(pin, level);
        self.pins_changed(port, before);
        self.settle();
    }

    /// Connects a voltage to an input of the ADC.
    pub(crate) fn set_analog(&mut self, channel: usize, volts: f64) {
        let now_ps = self.clock.local_ps(self.now);
        self.adc.set_input(now_ps, channel, volts);
    }

    /// What a pin does to its wire.
    pub(crate) fn output(&mut self, port: Port, pin: u8) -> PinLevel {
        let gpio = &self.gpio[port as usize];
        let open_drain = gpio.open_drain(pin);
        let level = match gpio.mode(pin) {
            Mode::Alternate(af) => {
                let route = Route { port, pin, af };
                if let Some((timer, channel)) = pins::timer_at(port, pin, af) {
                    self.timers[timer].sync(self.now);
                    self.timers[timer].level(channel - 1)
                } else if let Some((timer, channel)) = pins::complementary_at(route) {
                    self.timers[timer].sync(self.now);
                    self.timers[timer].complementary_level(channel - 1)
                } else {
                    // Idle: recessive.
                    pins::CAN1_TX.contains(&route).then_some(true)
                }
            }
            _ => return gpio.driven(pin),
        };
        match level {
            Some(true) if !open_drain => PinLevel::High,
            Some(false) => PinLevel::Low,
            _ => PinLevel::Floating,
        }
    }

    /// A PWM output as it arrives at a pin.
    pub(crate) fn pwm(&mut self, timer: usize, channel: usize) -> PwmState {
        if !(1..=14).contains(&timer) || !(1..=4).contains(&channel) {
            return PwmState::default();
        }
        self.timers[timer].sync(self.now);
        let state = self.timers[timer].pwm(channel - 1, self.clock.hz());
        let connected = pins::timer_channel(timer, channel).any(|route| self.connected(route));
        if connected && self.timer_clocked(timer) {
            state
        } else {
            PwmState {
                duty: 0.0,
                active: false,
                ..state
            }
        }
    }

    /// Turns the encoder on a timer's first two channels.
    pub(crate) fn encoder_add(&mut self, timer: usize, edges: i32) {
        let wired =
            |channel| pins::timer_channel(timer, channel).any(|route| self.connected(route));
        if (1..=14).contains(&timer) && wired(1) && wired(2) && self.timer_clocked(timer) {
            self.timers[timer].encoder_add(self.now, edges);
            let count = self.timers[timer].read(self.now, CNT).unwrap_or(0);
            if let Some(trace) = &mut self.trace {
                let change = Change::Encoder { timer, count };
                trace.changes.push((self.now, change));
            }
            self.settle();
        }
    }

    /// Whether CAN1 has its pins.
    pub(crate) fn can_connected(&self) -> bool {
        pins::CAN1_RX.iter().any(|route| self.connected(route))
            && pins::CAN1_TX.iter().any(|route| self.connected(route))
    }

    /// The CAN bit rate by the board's own crystal, in bit/s.
    pub(crate) fn can_bit_rate(&self) -> Option<u32> {
        if !self.can_connected() || !self.can.on_bus() {
            return None;
        }
        let pclk1 = self.rcc.clocks(self.now_ps()).pclk1;
        let clocks = self.can.clocks_per_bit();
        Some(((pclk1 + clocks / 2) / clocks) as u32)
    }

    /// Compares all outputs with the record.
    pub(super) fn record(&mut self, trace: &mut Trace) {
        for (index, timer) in PWM_TIMERS.into_iter().enumerate() {
            for channel in 1..=4 {
                trace.pwm(self.now, index, channel, self.pwm(timer, channel));
            }
        }
        for port in Port::ALL {
            for pin in 0..16 {
                // A complementary output on its own is a gate, high or low; what a timer's channel does is its PWM.
                let gate = match self.gpio[port as usize].mode(pin) {
                    Mode::Alternate(af) => {
                        pins::complementary_at(Route { port, pin, af }).is_some()
                    }
                    _ => false,
                };
                let level = if gate {
                    self.output(port, pin)
                } else {
                    self.gpio[port as usize].driven(pin)
                };
                trace.pin(self.now, port, pin, level);
            }
        }
        trace.request(self.can.requests(), self.can.latest_request());
    }
}
