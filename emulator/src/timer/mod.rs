//! The timers: TIM1/8 (RM0390 rev 6, section 17), TIM2..5 (18), TIM9..14 (19), TIM6/7 (20).
//!
//! One model serves all of them; [`Kind`] describes the features of a particular timer. This file
//! is the register view; [`counter`] turns time into counts, flags and events, [`encoder`] edges
//! into counts, [`output`] counts into PWM.
//!
//! Modelled: the internal clock with prescaler, up, down and centre-aligned counting, preload of
//! PSC, ARR and CCR with update events, repetition counter, one-pulse mode, compare flags, encoder
//! mode with its input filters, PWM and forced outputs, MOE, idle levels, the break input and the
//! lock levels, and capture of a channel's pin ([`capture`]). Not modelled, and refused: capture of
//! other pins, slave modes other than encoder, triggers to other peripherals, DMA bursts.

pub mod capture;
pub mod counter;
pub mod encoder;
pub mod output;
#[cfg(test)]
mod tests;

pub(crate) use output::OutputState;
pub use output::PwmState;

/// What a timer has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kind {
    /// Number of capture/compare channels.
    pub channels: usize,
    /// Largest counter value, 0xFFFF or 0xFFFF_FFFF.
    pub max: u64,
    /// Down and centre-aligned counting, encoder mode.
    pub full: bool,
    /// Break, repetition counter, complementary outputs.
    pub advanced: bool,
}

impl Kind {
    /// TIM1 and TIM8.
    pub const ADVANCED: Self = Self {
        channels: 4,
        max: 0xFFFF,
        full: true,
        advanced: true,
    };
    /// TIM2 and TIM5.
    pub const GENERAL_32: Self = Self {
        channels: 4,
        max: 0xFFFF_FFFF,
        full: true,
        advanced: false,
    };
    /// TIM3 and TIM4.
    pub const GENERAL_16: Self = Self {
        channels: 4,
        max: 0xFFFF,
        full: true,
        advanced: false,
    };
    /// TIM9 and TIM12.
    pub const TWO_CHANNELS: Self = Self {
        channels: 2,
        max: 0xFFFF,
        full: false,
        advanced: false,
    };
    /// TIM10, TIM11, TIM13 and TIM14.
    pub const ONE_CHANNEL: Self = Self {
        channels: 1,
        max: 0xFFFF,
        full: false,
        advanced: false,
    };
    /// TIM6 and TIM7.
    pub const BASIC: Self = Self {
        channels: 0,
        max: 0xFFFF,
        full: false,
        advanced: false,
    };
}

/// Register offsets.
pub mod reg {
    #![allow(missing_docs)]
    pub const CR1: u32 = 0x00;
    pub const CR2: u32 = 0x04;
    pub const SMCR: u32 = 0x08;
    pub const DIER: u32 = 0x0C;
    pub const SR: u32 = 0x10;
    pub const EGR: u32 = 0x14;
    pub const CCMR1: u32 = 0x18;
    pub const CCMR2: u32 = 0x1C;
    pub const CCER: u32 = 0x20;
    pub const CNT: u32 = 0x24;
    pub const PSC: u32 = 0x28;
    pub const ARR: u32 = 0x2C;
    pub const RCR: u32 = 0x30;
    pub const CCR1: u32 = 0x34;
    pub const CCR4: u32 = 0x40;
    pub const BDTR: u32 = 0x44;
    pub const DCR: u32 = 0x48;
    pub const DMAR: u32 = 0x4C;
    pub const OR: u32 = 0x50;
}

/// Bits of CR1.
mod cr1 {
    pub const CEN: u32 = 1;
    pub const UDIS: u32 = 1 << 1;
    pub const URS: u32 = 1 << 2;
    pub const OPM: u32 = 1 << 3;
    pub const DIR: u32 = 1 << 4;
    pub const CMS: u32 = 3 << 5;
    pub const ARPE: u32 = 1 << 7;
    pub const CKD: u32 = 3 << 8;
}

/// Bits of SR, DIER and EGR that lie at the same place in all three.
mod flag {
    pub const UPDATE: u32 = 1;
    pub const COM: u32 = 1 << 5;
    pub const TRIGGER: u32 = 1 << 6;
    pub const BREAK: u32 = 1 << 7;

    /// Compare flag of a channel, counted from 0.
    pub const fn compare(channel: usize) -> u32 {
        2 << channel
    }
}

/// Bits of BDTR.
mod bdtr {
    pub const LOCK_SHIFT: u32 = 8;
    pub const LOCK: u32 = 3 << LOCK_SHIFT;
    pub const OSSI: u32 = 1 << 10;
    pub const BKE: u32 = 1 << 12;
    pub const BKP: u32 = 1 << 13;
    pub const AOE: u32 = 1 << 14;
    pub const MOE: u32 = 1 << 15;
}

/// A register that takes effect at an update event, and what is in effect until then.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Preloaded {
    written: u64,
    active: u64,
}

impl Preloaded {
    fn load(&mut self) {
        self.active = self.written;
    }

    fn set_now(&mut self, value: u64) {
        self.written = value;
        self.active = value;
    }

    fn pending(self) -> bool {
        self.written != self.active
    }
}

/// The interrupt lines of one timer, before they share vectors.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Lines {
    /// Update event.
    pub update: bool,
    /// Compare match of any channel.
    pub compare: bool,
    /// Trigger or commutation.
    pub trigger: bool,
    /// Break.
    pub breaking: bool,
}

/// A use of the hardware that this model does not cover.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unmodelled(pub &'static str);

/// One timer.
#[derive(Debug, Clone)]
pub struct Timer {
    kind: Kind,
    /// Core clock cycles per timer clock.
    ratio: u64,
    cr1: u32,
    cr2: u32,
    smcr: u32,
    dier: u32,
    sr: u32,
    ccmr: [u32; 2],
    ccer: u32,
    rcr: u32,
    bdtr: u32,
    /// LOCK is settled.
    bdtr_written: bool,
    dcr: u32,
    option: u32,
    psc: Preloaded,
    arr: Preloaded,
    ccr: [Preloaded; 4],
    /// Cycle at which the counter reached `phase`: the last tick boundary that was processed.
    anchor: u64,
    /// Position within the counting period (see [`counter`]).
    phase: u64,
    /// Overflows still to pass before the next update event.
    repetitions: u32,
    /// Level of the break input after the pin, before polarity.
    break_level: bool,
    /// Inputs of the encoder interface.
    encoder: encoder::Inputs,
}

impl Timer {
    /// A timer as it is after reset.
    #[must_use]
    pub fn new(kind: Kind) -> Self {
        Self {
            kind,
            ratio: 1,
            cr1: 0,
            cr2: 0,
            smcr: 0,
            dier: 0,
            sr: 0,
            ccmr: [0; 2],
            ccer: 0,
            rcr: 0,
            bdtr: 0,
            bdtr_written: false,
            dcr: 0,
            option: 0,
            psc: Preloaded::default(),
            arr: Preloaded {
                written: kind.max,
                active: kind.max,
            },
            ccr: [Preloaded::default(); 4],
            anchor: 0,
            phase: 0,
            repetitions: 0,
            break_level: false,
            encoder: encoder::Inputs::default(),
        }
    }

    /// Resets everything but what comes from outside the timer.
    pub fn reset(&mut self, now: u64) {
        let (ratio, break_level) = (self.ratio, self.break_level);
        let encoder = self.encoder.after_reset();
        *self = Self::new(self.kind);
        self.ratio = ratio;
        self.break_level = break_level;
        self.encoder = encoder;
        self.anchor = now;
    }

    /// Changes the timer clock: `ratio` core clock cycles per timer clock from cycle `now` on.
    pub fn set_ratio(&mut self, now: u64, ratio: u64) {
        if ratio != self.ratio {
            self.sync(now);
            self.ratio = ratio;
            self.anchor = now;
            self.restart_filters(now);
        }
    }

    /// Reads a register at cycle `now`.
    ///
    /// # Errors
    /// Names the register when this timer has none there or this model does not cover it.
    pub fn read(&mut self, now: u64, offset: u32) -> Result<u32, Unmodelled> {
        self.sync(now);
        Ok(match offset {
            reg::CR1 => self.cr1,
            reg::CR2 => self.cr2,
            reg::SMCR => self.smcr,
            reg::DIER => self.dier,
            reg::SR => self.sr,
            reg::EGR => 0,
            reg::CCMR1 => self.ccmr[0],
            reg::CCMR2 => self.ccmr[1],
            reg::CCER => self.ccer,
            reg::CNT => self.count() as u32,
            reg::PSC => self.psc.written as u32,
            reg::ARR => self.arr.written as u32,
            reg::RCR => self.rcr,
            reg::CCR1..=reg::CCR4 => {
                let channel = Self::channel_at(offset);
                self.take_capture(channel);
                self.ccr[channel].written as u32
            }
            reg::BDTR => self.bdtr,
            reg::DCR => self.dcr,
            reg::OR => self.option,
            _ => return Err(Unmodelled("DMA burst")),
        })
    }

    /// Writes a register at cycle `now`.
    ///
    /// # Errors
    /// Names what this model does not cover: the register, or the mode that the value selects.
    pub fn write(&mut self, now: u64, offset: u32, value: u32) -> Result<(), Unmodelled> {
        self.sync(now);
        match offset {
            reg::CR1 => self.write_cr1(now, value & 0x3FF),
            reg::CR2 => {
                // 17.4.18: from level 1 on the idle states (OISx, OISxN) are locked.
                let keep = if self.lock_level() >= 1 { 0x7F00 } else { 0 };
                let value = (self.cr2 & keep) | (value & !keep);
                self.cr2 = value & if self.kind.advanced { 0x7FFD } else { 0xF8 };
            }
            reg::SMCR => {
                if !matches!(value & 7, 0..=3) {
                    return Err(Unmodelled("slave mode (SMCR.SMS) other than encoder"));
                }
                if value & (1 << 14) != 0 {
                    return Err(Unmodelled("external clock mode 2 (SMCR.ECE)"));
                }
                self.smcr = value & 0xFFF7;
            }
            reg::DIER => {
                if value & 0x7F00 != 0 {
                    return Err(Unmodelled("DMA request (DIER)"));
                }
                self.dier = value & 0xFF;
            }
            // Flags are cleared by writing 0; writing 1 leaves them (17.4.5).
            reg::SR => self.sr &= value,
            reg::EGR => self.generate(now, value),
            reg::CCMR1 => {
                self.write_ccmr(0, value)?;
                self.restart_filters(now);
            }
            reg::CCMR2 => self.write_ccmr(1, value)?,
            reg::CCER => self.write_ccer(value),
            reg::CNT => self.set_count(now, u64::from(value) & self.kind.max),
            reg::PSC => self.psc.written = u64::from(value & 0xFFFF),
            reg::ARR => {
                let value = u64::from(value) & self.kind.max;
                if self.cr1 & cr1::ARPE != 0 {
                    self.arr.written = value;
                } else {
                    self.set_arr_now(value);
                }
            }
            reg::RCR => self.rcr = value & 0xFF,
            reg::CCR1..=reg::CCR4 => {
                let channel = Self::channel_at(offset);
                let value = u64::from(value) & self.kind.max;
                if self.compare_preloaded(channel) {
                    self.ccr[channel].written = value;
                } else {
                    self.ccr[channel].set_now(value);
                }
            }
            reg::BDTR => self.write_bdtr(value & 0xFFFF),
            reg::DCR => self.dcr = value & 0x1F1F,
            reg::OR => self.option = value & 0xFFFF,
            _ => return Err(Unmodelled("DMA burst")),
        }
        Ok(())
    }

    /// Interrupt lines, valid after [`Timer::sync`].
    #[must_use]
    pub fn lines(&self) -> Lines {
        let on = self.sr & self.dier;
        Lines {
            update: on & flag::UPDATE != 0,
            compare: on & 0x1E != 0,
            trigger: on & (flag::TRIGGER | flag::COM) != 0,
            breaking: on & flag::BREAK != 0,
        }
    }

    /// Sets the level of the break input pin; `false` when no pin is connected to it. No clock is
    /// needed for the outputs to go off (17.3.12).
    pub fn set_break_input(&mut self, now: u64, level: bool) {
        self.sync(now);
        self.break_level = level;
        self.check_break();
    }

    /// The counter has stood still for so many cycles.
    pub fn stood(&mut self, cycles: u64) {
        self.anchor += cycles;
    }

    /// The clock security system has seen HSE fail: a break like that of the input (17.3.12).
    pub fn clock_failure(&mut self, now: u64) {
        self.sync(now);
        if self.kind.advanced && self.bdtr & bdtr::BKE != 0 {
            self.bdtr &= !bdtr::MOE;
            self.sr |= flag::BREAK;
        }
    }

    /// Whether the break input asks for the outputs to be off.
    fn break_active(&self) -> bool {
        self.kind.advanced
            && self.bdtr & bdtr::BKE != 0
            && self.break_level == (self.bdtr & bdtr::BKP != 0)
    }

    fn check_break(&mut self) {
        if self.break_active() {
            self.bdtr &= !bdtr::MOE;
            self.sr |= flag::BREAK;
        }
    }

    fn channel_at(offset: u32) -> usize {
        ((offset - reg::CCR1) / 4) as usize
    }

    fn compare_preloaded(&self, channel: usize) -> bool {
        let mode = self.ccmr[channel / 2] >> (8 * (channel % 2));
        mode & 3 == 0 && mode & 8 != 0
    }

    fn write_ccmr(&mut self, index: usize, value: u32) -> Result<(), Unmodelled> {
        for half in 0..2 {
            if !matches!((value >> (8 * half)) & 3, 0 | 1) {
                return Err(Unmodelled(
                    "input capture from another pin or TRC (CCMR.CCxS)",
                ));
            }
        }
        // 17.4.18: at level 3 the modes of output channels (OCxM, OCxPE) are locked.
        let mut keep = 0;
        for half in 0..2 {
            if self.lock_level() == 3 && self.ccmr[index] >> (8 * half) & 3 == 0 {
                keep |= 0x78 << (8 * half);
            }
        }
        self.ccmr[index] = (self.ccmr[index] & keep) | (value & 0xFFFF & !keep);
        for channel in [2 * index, 2 * index + 1] {
            if !self.compare_preloaded(channel) {
                self.ccr[channel].load();
            }
        }
        Ok(())
    }

    fn write_ccer(&mut self, value: u32) {
        let mut keep = 0;
        if self.lock_level() >= 2 {
            keep = 0xAAAA; // polarity bits are locked from level 2 on (17.4.18)
        }
        self.ccer = (self.ccer & keep) | (value & 0xFFFF & !keep);
    }

    fn lock_level(&self) -> u32 {
        (self.bdtr >> bdtr::LOCK_SHIFT) & 3
    }

    fn write_bdtr(&mut self, value: u32) {
        if !self.kind.advanced {
            return;
        }
        // 17.4.18: level 1 freezes DTG, BKE, BKP, AOE; level 2 also OSSR, OSSI. LOCK itself is
        // frozen by the first write of the register after reset, whatever that writes.
        let frozen = match self.lock_level() {
            0 => 0,
            1 => 0x70FF,
            _ => 0x7CFF,
        } | if self.bdtr_written { bdtr::LOCK } else { 0 };
        self.bdtr_written = true;
        let was_active = self.bdtr & bdtr::MOE != 0;
        self.bdtr = (self.bdtr & frozen) | (value & !frozen);
        if was_active || self.bdtr & bdtr::MOE != 0 || self.bdtr & bdtr::BKE != 0 {
            self.check_break();
        }
    }
}
