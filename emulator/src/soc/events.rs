//! Events that are due, DMA, and interrupt lines of the chip.

use super::Soc;
use crate::family::Family;
use crate::system::map::irq;
use crate::system::rcc::cause;
use crate::timer::{Kind, Timer};

impl Soc {
    /// A debugger has held the core for some cycles up to now: the peripherals that its freeze bits
    /// name were stopped (33.16.4 and 33.16.5).
    pub(crate) fn stood(&mut self, cycles: u64) {
        const IWDG: u32 = 1 << 12;
        // RM0008 31.16.3.
        const F1_IWDG: u32 = 1 << 8;
        let [_, cr, apb1, apb2] = self.dbgmcu;
        let family = self.chip.family;
        let frozen = match family {
            Family::F1 => cr & F1_IWDG,
            Family::F4 => apb1 & IWDG,
        };
        if frozen != 0 {
            let ps = self.now_ps() - self.clock.local_ps(self.now - cycles);
            self.iwdg.stood(ps);
        }
        for number in 1..self.timers.len() {
            let frozen = match number {
                1..=4 if family == Family::F1 => cr >> (9 + number),
                5..=7 if family == Family::F1 => cr >> (13 + number),
                8 if family == Family::F1 => cr >> 17,
                1 => apb2,
                8 => apb2 >> 1,
                9..=11 => apb2 >> (16 + number - 9),
                2..=7 => apb1 >> (number - 2),
                _ => apb1 >> (6 + number - 12),
            };
            if frozen & 1 != 0 {
                self.timers[number].stood(cycles);
            }
        }
        self.settle();
    }

    /// The core has slept for some cycles up to now: timers with a clock only while it is awake
    /// (RM0390 6.3.14) were stopped.
    pub(crate) fn slept(&mut self, cycles: u64) {
        for number in 1..self.timers.len() {
            if self.rcc.stops_asleep(number) {
                self.timers[number].stood(cycles);
            }
        }
    }

    /// Whether a watchdog is running that will reset the chip.
    pub(crate) fn watchdog_running(&self) -> bool {
        self.iwdg.expires_at().is_some()
    }

    /// Processes all events that are due by `now`.
    pub(crate) fn dispatch(&mut self) {
        let (now, now_ps) = (self.now, self.now_ps());
        for number in 0..self.timers.len() {
            // A quiet timer has no event, and is brought to the present when something looks at it.
            if self.timers[number].is_quiet() {
                continue;
            }
            let delayed = self.timers[number].edge_due(now);
            self.timers[number].sync(now);
            if delayed {
                self.trace_encoder(number);
            }
        }
        self.can.sync(now);
        self.can2.sync(now);
        while self.usart2.sync(now) {
            self.serve_usart();
        }
        self.flash.sync(now_ps);
        if self.iwdg.expires_at().is_some_and(|at| now_ps >= at) {
            self.reset_request |= cause::IWDG;
        }
        self.settle();
    }

    /// Lets DMA1 move what USART2 has and wants (RM0390 section 9.3.4, table 28: channel 4 of
    /// streams 5 and 6).
    pub(super) fn serve_usart(&mut self) {
        const DATA: u32 = 0x4000_4404;
        const CHANNEL: u32 = 4;
        const RECEIVE: usize = 5;
        const TRANSMIT: usize = 6;
        if self.usart2.offers_byte() && self.dma1.takes(RECEIVE, CHANNEL, DATA) {
            let byte = self.usart2.read_byte();
            self.dma1.put(&self.ram, RECEIVE, CHANNEL, DATA, byte);
        }
        while self.usart2.wants_byte()
            && let Some(byte) = self.dma1.get(&self.ram, TRANSMIT, CHANNEL, DATA)
        {
            self.usart2.put(self.now, byte);
        }
    }

    /// Computes the interrupt lines and the time of the next event.
    pub(crate) fn settle(&mut self) {
        if let Some(mut trace) = self.trace.take() {
            self.record(&mut trace);
            self.trace = Some(trace);
        }
        let mut lines: u128 = 0;
        let mut line = |number: u16, on: bool| lines |= u128::from(on) << number;
        let mut next = u64::MAX;
        for number in 1..self.timers.len() {
            let timer = &self.timers[number];
            if timer.is_quiet() {
                continue;
            }
            let on = timer.lines();
            let any = on.update || on.compare || on.trigger || on.breaking;
            match number {
                1 => {
                    line(irq::TIM1_BRK_TIM9, on.breaking);
                    line(irq::TIM1_UP_TIM10, on.update);
                    line(irq::TIM1_TRG_COM_TIM11, on.trigger);
                    line(irq::TIM1_CC, on.compare);
                }
                8 => {
                    line(irq::TIM8_BRK_TIM12, on.breaking);
                    line(irq::TIM8_UP_TIM13, on.update);
                    line(irq::TIM8_TRG_COM_TIM14, on.trigger);
                    line(irq::TIM8_CC, on.compare);
                }
                _ => line(timer_irq(number), any),
            }
            if let Some(at) = timer.next_event() {
                next = next.min(at);
            }
        }
        let can = self.can.lines();
        line(irq::CAN1_TX, can.tx);
        line(irq::CAN1_RX0, can.rx[0]);
        line(irq::CAN1_RX1, can.rx[1]);
        line(irq::CAN1_SCE, can.sce);
        let can = self.can2.lines();
        line(irq::CAN2_TX, can.tx);
        line(irq::CAN2_RX0, can.rx[0]);
        line(irq::CAN2_RX1, can.rx[1]);
        line(irq::CAN2_SCE, can.sce);
        line(irq::FLASH, self.flash.line());
        line(irq::USART2, self.usart2.line());
        line(irq::DMA1_STREAM_5, self.dma1.line(5));
        line(irq::DMA1_STREAM_6, self.dma1.line(6));
        if !self.exti.is_quiet() {
            for (number, on) in self.exti.lines() {
                line(number, on);
            }
        }
        self.irq = std::array::from_fn(|word| (lines >> (32 * word)) as u32);
        next = next.min(self.can.next_event().unwrap_or(u64::MAX));
        next = next.min(self.can2.next_event().unwrap_or(u64::MAX));
        next = next.min(self.usart2.next_event().unwrap_or(u64::MAX));
        for at_ps in [self.flash.busy_until(), self.iwdg.expires_at()]
            .into_iter()
            .flatten()
        {
            next = next.min(self.clock.cycle_at_local(at_ps));
        }
        if self.trace.is_some() {
            let loads = self.timers.iter().filter_map(Timer::next_load);
            next = next.min(loads.min().unwrap_or(u64::MAX));
        }
        self.next_event = next;
    }
}

/// Which kind of timer has a number.
pub(super) fn timer_kind(family: Family, number: usize) -> Kind {
    match number {
        2 | 5 if family == Family::F1 => Kind::GENERAL_16,
        1 | 8 => Kind::ADVANCED,
        2 | 5 => Kind::GENERAL_32,
        3 | 4 => Kind::GENERAL_16,
        9 | 12 => Kind::TWO_CHANNELS,
        6 | 7 => Kind::BASIC,
        _ => Kind::ONE_CHANNEL,
    }
}

fn timer_irq(number: usize) -> u16 {
    match number {
        2 => irq::TIM2,
        3 => irq::TIM3,
        4 => irq::TIM4,
        5 => irq::TIM5,
        6 => irq::TIM6_DAC,
        7 => irq::TIM7,
        9 => irq::TIM1_BRK_TIM9,
        10 => irq::TIM1_UP_TIM10,
        11 => irq::TIM1_TRG_COM_TIM11,
        12 => irq::TIM8_BRK_TIM12,
        13 => irq::TIM8_UP_TIM13,
        _ => irq::TIM8_TRG_COM_TIM14,
    }
}
