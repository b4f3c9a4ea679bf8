//! The chip's interface to the world: pins, PWM outputs, encoder inputs, the CAN connector.

use super::Soc;
use crate::can::CanFrame;
use crate::can::port::Which;
use crate::defect::Defect;
use crate::family::Family;
use crate::stop::StopKind;
use crate::system::exti;
use crate::system::gpio::{Mode, PinLevel, Port};
use crate::system::map::Unit;
use crate::system::rcc::HseFailure;
use crate::timer::PwmState;
use crate::trace::{Change, PWM_TIMERS, Trace};

/// Offset of a timer's counter (RM0390 section 17.4.21).
const CNT: u32 = 0x24;

impl Soc {
    /// Connects a pin to a level outside.
    pub(crate) fn set_input(&mut self, port: Port, pin: u8, level: bool) {
        let before = self.gpio[port as usize].idr();
        self.gpio[port as usize].set_external(pin, level);
        self.wires.forget();
        self.pins_changed(port, before);
        self.settle();
    }

    /// Starts or stops the clock at the HSE input.
    pub(crate) fn set_hse(&mut self, runs: bool) {
        match self.rcc.set_hse(self.now_ps(), runs) {
            HseFailure::None => {}
            HseFailure::Seen => {
                for timer in [1, 8] {
                    self.timers[timer].clock_failure(self.now);
                }
            }
            HseFailure::Unseen => {
                let what =
                    "HSE has stopped under the system clock, and CSS is off (RM0390 section 6.2.7)";
                self.stop.get_or_insert(StopKind::Clock(what.to_owned()));
            }
        }
        self.apply_clocks();
        self.settle();
    }

    /// Sets the supply of the chip, V.
    pub(crate) fn set_vdd(&mut self, volts: f64) {
        let before = self.pwr.is_low();
        self.pwr.set_vdd(volts);
        for adc in &mut self.adcs {
            adc.set_reference(volts);
        }
        self.detected(before);
        self.check_clocks();
        self.settle();
    }

    /// Passes a change of the voltage detector's output on to its interrupt line.
    pub(super) fn detected(&mut self, before: bool) {
        let low = self.pwr.is_low();
        if low != before {
            self.exti.internal_edge(exti::PVD_LINE, low);
        }
    }

    /// Connects a voltage to a pin that the converters can measure.
    pub(crate) fn set_analog(&mut self, port: Port, pin: u8, volts: f64) {
        let now_ps = self.clock.local_ps(self.now);
        self.wires.forget();
        for adc in &mut self.adcs {
            adc.set_pin(now_ps, port, pin, volts);
        }
    }

    /// How a pin drives its wire.
    pub(crate) fn output(&mut self, port: Port, pin: u8) -> PinLevel {
        let (from_port, from_pin) = self.defects.source((port, pin));
        let level = self.intended(from_port, from_pin);
        self.defects.driven((port, pin), level)
    }

    /// The same without defects.
    fn intended(&mut self, port: Port, pin: u8) -> PinLevel {
        let gpio = &self.gpio[port as usize];
        let open_drain = gpio.open_drain(pin);
        let level = match gpio.mode(pin) {
            Mode::Alternate(_) => {
                let pins = &self.chip.pins;
                let (mut level, mut taken) = (None, false);
                // An STM32F1's pin can be two timers': the one that has its output on drives it.
                for &&(timer, channel, ref route) in
                    &self.places.channels_at[port as usize][usize::from(pin & 15)]
                {
                    if self.connected(route) {
                        self.timers[timer].sync(self.now);
                        level = level.or(self.timers[timer].level(channel - 1));
                        taken = true;
                    }
                }
                if level.is_none()
                    && let Some((timer, channel)) = self.complementary(port, pin)
                {
                    self.timers[timer].sync(self.now);
                    level = self.timers[timer].complementary_level(channel - 1);
                    taken = true;
                }
                // Idle: recessive, or the level of a stop bit.
                let mut bus = pins
                    .bus_outputs()
                    .filter(|to| (to.port, to.pin) == (port, pin));
                level.or((!taken && bus.any(|route| self.connected(route))).then_some(true))
            }
            _ if self.debug_has(port, pin) => None,
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
        let mut routes = self.places.channels[timer][channel - 1].iter();
        let connected = routes.any(|route| self.connected(route));
        self.at_pin(state, timer, connected)
    }

    /// The same of a complementary output that is on without its main one.
    pub(crate) fn complementary_pwm(&mut self, timer: usize, channel: usize) -> PwmState {
        if !(1..=14).contains(&timer) || !(1..=3).contains(&channel) {
            return PwmState::default();
        }
        self.timers[timer].sync(self.now);
        let state = self.timers[timer].complementary_pwm(channel - 1, self.clock.hz());
        let mut routes = self.chip.pins.complementary(timer, channel);
        let connected = routes.any(|route| self.connected(route));
        self.at_pin(state, timer, connected)
    }

    fn at_pin(&self, state: PwmState, timer: usize, connected: bool) -> PwmState {
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
        let pins = &self.chip.pins;
        let wired = |channel| {
            let mut routes = pins.timer_channel(timer, channel);
            routes.any(|route| self.receives(route))
        };
        if (1..=14).contains(&timer) && wired(1) && wired(2) && self.timer_clocked(timer) {
            self.timers[timer].encoder_add(self.now, edges);
            self.trace_encoder(timer);
        }
    }

    /// Passes the level of a pin to the timer of which it is an input.
    pub(super) fn timer_input(&mut self, port: Port, pin: u8) {
        let level = self.gpio[port as usize].level(pin);
        for &(timer, channel, ref route) in self.chip.pins.channels_at(port, pin) {
            if matches!(channel, 1 | 2)
                && self.receives(route)
                && !self.defects.has(Defect::TimerInput(timer, channel))
                && self.timers[timer].set_input(self.now, channel - 1, level)
            {
                self.trace_encoder(timer);
            }
        }
    }

    /// The complementary output that a pin carries.
    fn complementary(&self, port: Port, pin: u8) -> Option<(usize, usize)> {
        let mut rows = self.places.complementary_at[port as usize][usize::from(pin & 15)].iter();
        let row = rows.find(|row| {
            let (timer, channel, route) = row;
            // TIM1 and TIM8 of an STM32F1 can share one: it is the one that has it on.
            self.connected(route)
                && (self.chip.family == Family::F4
                    || self.timers[*timer]
                        .complementary_level(channel - 1)
                        .is_some())
        })?;
        Some((row.0, row.1))
    }

    fn debug_has(&self, port: Port, pin: u8) -> bool {
        self.chip.family == Family::F1 && self.afio.debug_has(port, pin)
    }

    /// Records the value of an encoder's counter.
    pub(super) fn trace_encoder(&mut self, timer: usize) {
        if let Some(trace) = &mut self.trace {
            let count = self.timers[timer].read(self.now, CNT).unwrap_or(0);
            let change = Change::Encoder { timer, count };
            trace.changes.push((self.now, change));
        }
    }

    /// Whether a CAN controller has its pins.
    fn can_connected(&self, which: Which) -> bool {
        let pins = &self.chip.pins;
        let (receive, transmit) = match which {
            Which::First => (pins.can1_receive, pins.can1_transmit),
            Which::Second => (pins.can2_receive, pins.can2_transmit),
        };
        receive.iter().any(|route| self.receives(route))
            && transmit.iter().any(|route| self.connected(route))
    }

    /// The CAN bit rate by the board's own crystal, in bit/s.
    pub(crate) fn can_bit_rate(&self, which: Which) -> Option<u32> {
        let can = match which {
            Which::First => &self.can,
            Which::Second => &self.can2,
        };
        if !self.can_connected(which) || !can.on_bus() {
            return None;
        }
        let pclk1 = self.rcc.clocks(self.now_ps()).pclk1;
        let clocks = can.clocks_per_bit();
        Some(((pclk1 + clocks / 2) / clocks) as u32)
    }

    /// How the flash is read: wait states, prefetch and caches that work.
    pub(crate) fn flash_access(&self) -> u32 {
        const PREFETCH_AND_CACHES: u32 = 7 << 8;
        let dead = self.defects.has(Defect::Caches);
        self.flash.acr() & !if dead { PREFETCH_AND_CACHES } else { 0 }
    }

    /// A frame of another node has arrived complete.
    pub(crate) fn can_receive(&mut self, which: Which, frame: &CanFrame, bits: u32) {
        if !self.can_connected(which) {
            return;
        }
        match which {
            Which::First => self.can.receive(self.now, frame, bits),
            // 30.2: the filters of CAN2 are in CAN1, and have its clock.
            Which::Second if self.clocked(Unit::Can1) => {
                self.can2.receive_second(&self.can, self.now, frame, bits);
            }
            Which::Second => {}
        }
    }

    /// Puts bytes on the line into USART2, one after the other, from a sender with this baud rate.
    /// Without its pin the port receives nothing.
    pub(crate) fn serial_arrive(&mut self, bytes: &[u8], baud: f64, stop: bool) {
        if self
            .chip
            .pins
            .usart2_receive
            .iter()
            .any(|route| self.receives(route))
        {
            let bit = self.clock.hz() as f64 * self.clock.rate() / baud;
            for byte in bytes {
                self.usart2.arrive(self.now, *byte, bit, stop);
            }
            self.settle();
        }
    }

    /// Lets go of the line into USART2, which stays at this level, or drives it again.
    pub(crate) fn serial_release(&mut self, level: Option<bool>) {
        match level {
            Some(level) => self.usart2.release(self.now, level),
            None => self.usart2.drive(self.now),
        }
        self.settle();
    }

    /// Takes the bytes that have left USART2 through its pin, with the cycle at which each ended.
    pub(crate) fn serial_sent(&mut self) -> Vec<(u64, u8)> {
        let sent = self.usart2.take_sent();
        if self
            .chip
            .pins
            .usart2_transmit
            .iter()
            .any(|route| self.connected(route))
        {
            sent
        } else {
            Vec::new()
        }
    }

    /// The baud rate of USART2 by the board's own crystal.
    pub(crate) fn serial_baud(&self) -> Option<f64> {
        let cycles = self.usart2.cycles_per_bit()?;
        Some(self.clock.hz() as f64 / cycles as f64)
    }

    /// Compares all outputs with the record.
    pub(super) fn record(&mut self, trace: &mut Trace) {
        let mut changed = false;
        for (index, timer) in PWM_TIMERS.into_iter().enumerate() {
            // Nothing else that its outputs follow from changes with time alone.
            let load = self.timers[timer].next_load();
            if load.is_some_and(|at| at <= self.now) {
                self.timers[timer].sync(self.now);
            }
            let state = self.timers[timer].output_state();
            if !trace.is_new(index, (self.wiring, self.clock.hz(), state)) {
                continue;
            }
            changed = true;
            for channel in 1..=4 {
                trace.pwm(self.now, index, channel, self.pwm(timer, channel));
            }
        }
        if changed {
            self.record_pins(trace);
        }
        trace.request(self.can.requests(), self.can.latest_request());
    }

    fn record_pins(&mut self, trace: &mut Trace) {
        for port in Port::ALL {
            let (mut low, mut high) = self.gpio[port as usize].all_driven();
            // A complementary output on its own is a gate, high or low; a timer's channel is its
            // PWM.
            let mut gates = self.gpio[port as usize].alternate()
                & self.places.complementary_pins[port as usize];
            while gates != 0 {
                let pin = gates.trailing_zeros() as u8;
                gates &= gates - 1;
                if self.complementary(port, pin).is_none() {
                    continue;
                }
                match self.output(port, pin) {
                    PinLevel::Low => low |= 1 << pin,
                    PinLevel::High => high |= 1 << pin,
                    PinLevel::Floating => {}
                }
            }
            trace.pins(self.now, port, low, high);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rsemu::core::space::RamStore;

    use super::*;
    use crate::board::BoardConfig;
    use crate::chip::{Chip, F407, F446};
    use crate::ram::Ram;
    use crate::system::map::irq;

    fn soc(chip: &'static Chip) -> Soc {
        let store = Arc::new(RamStore::new(chip.flash_size()));
        Soc::new(
            chip,
            store,
            Arc::new(Ram::new(chip)),
            &BoardConfig::default(),
        )
    }

    /// A PWM of a quarter at PE9, whose port has its clock.
    fn begin_pwm(soc: &mut Soc) {
        for (address, value) in [
            (0x4002_3844, 1),       // TIM1
            (0x4002_1000, 2 << 18), // PE9
            (0x4002_1024, 1 << 4),  // is TIM1's
            (0x4001_002C, 99),      // ARR
            (0x4001_0034, 25),      // CCR1
            (0x4001_0018, 0x60),    // PWM mode 1
            (0x4001_0020, 1),
            (0x4001_0044, 0x8000),
            (0x4001_0000, 1),
        ] {
            soc.write(address, 4, value);
        }
    }

    /// The pins of one chip are not the other's: CAN1 at PD0 and PD1, PWM at PE9.
    #[test]
    fn a_chip_has_its_own_pins() {
        for (chip, has) in [(&F446, false), (&F407, true)] {
            let mut soc = soc(chip);
            soc.system_reset(0);
            for (address, value) in [
                (0x4002_3830, 0x18),    // GPIOD, GPIOE
                (0x4002_3840, 1 << 25), // CAN1
                (0x4002_0C00, 0xA),     // PD0 and PD1
                (0x4002_0C20, 0x99),    // are CAN1's
            ] {
                soc.write(address, 4, value);
            }
            begin_pwm(&mut soc);
            assert_eq!(soc.stop, None, "{chip:?}");
            assert_eq!(soc.can_connected(Which::First), has, "{chip:?}");
            assert_eq!(soc.pwm(1, 1).active, has, "{chip:?}");
        }
    }

    /// What ends an output without its timer's counting, and begins it again.
    #[test]
    fn a_record_has_what_ends_an_output() {
        let mut soc = soc(&F407);
        soc.system_reset(0);
        soc.trace = Some(Box::default());
        soc.write(0x4002_3830, 4, 0x10); // GPIOE
        begin_pwm(&mut soc);
        for (what, address, off, on) in [
            ("pin", 0x4002_1000, 0, 2 << 18),
            ("function of the pin", 0x4002_1024, 2 << 4, 1 << 4),
            ("clock", 0x4002_3844, 0, 1),
            ("channel", 0x4001_0020, 0, 1),
            ("MOE", 0x4001_0044, 0, 0x8000),
            ("counter", 0x4001_0000, 0, 1),
        ] {
            for (value, expected) in [(off, false), (on, true)] {
                if let Some(trace) = &mut soc.trace {
                    trace.changes.clear();
                }
                soc.write(address, 4, value);
                let changes = soc.trace.as_ref().map(|trace| &trace.changes[..]);
                let active = |(_, change): &(u64, Change)| match change {
                    Change::Pwm {
                        timer: 1,
                        channel: 1,
                        state,
                    } => Some(state.active),
                    _ => None,
                };
                let found: Vec<bool> = changes.unwrap().iter().filter_map(active).collect();
                assert_eq!(found, [expected], "{what} {value:#x}");
            }
        }
    }

    #[test]
    fn encoder_pins_reach_the_counter_through_the_filter() {
        let mut soc = soc(&F446);
        soc.system_reset(0);
        soc.trace = Some(Box::default());
        // TI1 is high before the pins are the timer's: no edge.
        soc.set_input(Port::C, 6, true);
        for (address, value) in [
            (0x4002_3830, 4),          // GPIOC
            (0x4002_3840, 2),          // TIM3
            (0x4002_0800, 0xA << 12),  // PC6 and PC7
            (0x4002_0820, 0x22 << 24), // are TIM3's
            (0x4000_0418, 0x3131),     // fCK_INT, N = 8
            (0x4000_0408, 3),
            (0x4000_0400, 1),
        ] {
            soc.write(address, 4, value);
        }
        let mut at = |now, level| {
            soc.now = now;
            soc.set_input(Port::C, 7, level);
            soc.next_event
        };
        assert_eq!(at(100, true), 108);
        assert_eq!(at(107, false), u64::MAX, "seven samples are too few");
        assert_eq!(at(200, true), 208);
        soc.now = 208;
        soc.dispatch();
        assert_eq!(soc.timers[3].read(208, CNT), Ok(1), "TI2 rises under TI1");
        let changes = soc.trace.map(|trace| trace.changes).unwrap_or_default();
        let turned = |(_, change): &(u64, Change)| matches!(change, Change::Encoder { .. });
        let changes: Vec<_> = changes.into_iter().filter(turned).collect();
        assert_eq!(changes, [(208, Change::Encoder { timer: 3, count: 1 })]);
    }

    /// 25.6.1: a read of SR and one of DR clear IDLE, and with it the request of an interrupt,
    /// without any write or event that would update the lines.
    #[test]
    fn reading_the_data_register_ends_its_request() {
        let mut soc = soc(&F446);
        soc.system_reset(0);
        for (address, value) in [
            (0x4002_3830, 1),       // GPIOA
            (0x4002_3840, 1 << 17), // USART2
            (0x4002_0000, 0xA8 << 24 | 2 << 6),
            (0x4002_0020, 7 << 12), // PA3 is USART2's RX
            (0x4000_4408, 0x10),
            (0x4000_440C, 0x2034), // UE, RXNEIE, IDLEIE, RE
        ] {
            soc.write(address, 4, value);
        }
        let asks = |soc: &Soc| soc.irq[1] >> (irq::USART2 - 32) & 1 != 0;
        soc.serial_arrive(b"x", 1e6, true);
        for _ in 0..2 {
            assert!(!asks(&soc));
            soc.now = soc.next_event;
            soc.dispatch();
            assert!(asks(&soc));
            soc.read(0x4000_4400, 4);
            assert!(asks(&soc), "reading SR alone clears nothing");
            soc.read(0x4000_4404, 4);
        }
        assert!(!asks(&soc));
    }
}
