//! Time on one board: core clock cycles, the crystal's time, the world's time.
//!
//! Everything on the chip that counts the core clock (timers, the core itself) is modelled in whole
//! HCLK cycles since power-on, so that nothing rounds and two runs are the same to the cycle. The
//! world outside counts nanoseconds. Between the two is *local* time, which the board's own crystal
//! would show and which runs fast by [`Clock::new`]'s parts per million. A clock switch (RCC)
//! starts a new segment: cycles before it keep their time, cycles after it last as long as the new
//! frequency says.
//!
//! The internal oscillators are assumed to have the error of the crystal, except for the LSI of the
//! watchdog, which has its own tolerance and frequency.

use std::cell::Cell;

const PS_PER_S: u64 = 1_000_000_000_000;

/// Maps core cycles to local time and local time to the world's time.
#[derive(Debug, Clone)]
pub struct Clock {
    /// Crystal error in parts per 10^12, positive when the board's clock runs fast.
    error_e12: i64,
    segment_cycle: u64,
    segment_ps: u64,
    hz: u64,
    /// Time of a cycle in ps.
    cycle_ps: Fraction,
    /// Local time over the world's.
    local: Fraction,
    /// The last conversions, because the same moments are converted again and again: the next event
    /// of a sleeping board, and the end of its watchdog's time.
    last_world_ns: Cell<Conversion>,
    last_cycle: Cell<Conversion>,
}

/// What was converted, and to what.
type Conversion = Option<(u64, u64)>;

/// Converts a value, unless it is the one of the last time.
fn remembered(last: &Cell<Conversion>, value: u64, convert: impl FnOnce(u64) -> u64) -> u64 {
    if let Some((known, result)) = last.get()
        && known == value
    {
        return result;
    }
    let result = convert(value);
    last.set(Some((value, result)));
    result
}

/// Numerator and denominator in lowest terms, so that most products fit 64 bits.
type Fraction = (u64, u64);

const fn fraction(numerator: u64, denominator: u64) -> Fraction {
    let (mut divisor, mut rest) = (numerator, denominator);
    while rest != 0 {
        (divisor, rest) = (rest, divisor % rest);
    }
    (numerator / divisor, denominator / divisor)
}

/// `value` times a fraction: the whole part, and whether something is left.
fn times(value: u64, (numerator, denominator): Fraction) -> (u64, bool) {
    let (whole, part) = (value / denominator, value % denominator);
    let (more, left) = match part.checked_mul(numerator) {
        Some(product) => (product / denominator, product % denominator),
        None => {
            let product = u128::from(part) * u128::from(numerator);
            let denominator = u128::from(denominator);
            (
                (product / denominator) as u64,
                (product % denominator) as u64,
            )
        }
    };
    (whole * numerator + more, left != 0)
}

/// The earliest of several times.
pub(crate) fn earliest(times: [Option<u64>; 3]) -> Option<u64> {
    // An iterator's `min` over options takes the host several times as long.
    let [a, b, c] = times.map(|at| at.unwrap_or(u64::MAX));
    let at = a.min(b).min(c);
    (at != u64::MAX).then_some(at)
}

impl Clock {
    /// A clock at power-on, at the world's time zero, with a crystal that runs fast by
    /// `crystal_ppm` and the core at `hz`, which is the internal oscillator's frequency.
    #[must_use]
    pub fn new(crystal_ppm: f64, hz: u64) -> Self {
        // Half a million ppm either way is far beyond anything that oscillates.
        let error_e12 = (crystal_ppm.clamp(-5e5, 5e5) * 1e6).round() as i64;
        Self {
            error_e12,
            segment_cycle: 0,
            segment_ps: 0,
            hz,
            cycle_ps: fraction(PS_PER_S, hz),
            local: fraction(PS_PER_S.saturating_add_signed(error_e12), PS_PER_S),
            last_world_ns: Cell::default(),
            last_cycle: Cell::default(),
        }
    }

    /// Core clock (HCLK) in Hz by the board's own crystal.
    #[must_use]
    pub fn hz(&self) -> u64 {
        self.hz
    }

    /// Real frequency over nominal frequency.
    #[must_use]
    pub fn rate(&self) -> f64 {
        1.0 + self.error_e12 as f64 * 1e-12
    }

    /// From cycle `now` on, one cycle lasts 1 / `hz`.
    pub fn set_hz(&mut self, now: u64, hz: u64) {
        if hz != self.hz && hz != 0 {
            self.segment_ps = self.local_ps(now);
            self.segment_cycle = now;
            self.hz = hz;
            self.cycle_ps = fraction(PS_PER_S, hz);
            self.last_world_ns.set(None);
            self.last_cycle.set(None);
        }
    }

    /// Local time in ps of the start of a cycle, rounded down.
    #[must_use]
    pub fn local_ps(&self, cycle: u64) -> u64 {
        let cycles = cycle.saturating_sub(self.segment_cycle);
        self.segment_ps + times(cycles, self.cycle_ps).0
    }

    /// First cycle that starts at or after a local time in ps.
    #[must_use]
    pub fn cycle_at_local(&self, ps: u64) -> u64 {
        remembered(&self.last_cycle, ps, |ps| self.convert_to_cycle(ps))
    }

    fn convert_to_cycle(&self, ps: u64) -> u64 {
        let (numerator, denominator) = self.cycle_ps;
        let ps = ps.saturating_sub(self.segment_ps);
        let (cycles, left) = times(ps, (denominator, numerator));
        self.segment_cycle + cycles + u64::from(left)
    }

    /// Local time in ps at a world time in ns. What the crystal's error adds or takes is rounded
    /// towards zero.
    #[must_use]
    pub fn world_to_local_ps(&self, t_ns: u64) -> u64 {
        let (ps, left) = times(t_ns * 1000, self.local);
        ps + u64::from(left && self.error_e12 < 0)
    }

    /// World time in ns, rounded up, at a local time in ps.
    #[must_use]
    pub fn local_to_world_ns(&self, ps: u64) -> u64 {
        let (local, world) = self.local;
        times(ps, (world, local)).0.div_ceil(1000)
    }

    /// World time in ns, rounded up, of a cycle.
    #[must_use]
    pub fn world_ns(&self, cycle: u64) -> u64 {
        remembered(&self.last_world_ns, cycle, |cycle| {
            self.local_to_world_ns(self.local_ps(cycle))
        })
    }

    /// First cycle at or after a world time in ns.
    #[must_use]
    pub fn cycle_at_world(&self, t_ns: u64) -> u64 {
        self.convert_to_cycle(self.world_to_local_ps(t_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HSI_HZ: u64 = 16_000_000;

    #[test]
    fn counts_whole_cycles_without_drift() {
        let mut clock = Clock::new(0.0, HSI_HZ);
        clock.set_hz(16_000, 180_000_000); // after 1 ms of HSI
        assert_eq!(clock.world_ns(16_000), 1_000_000);
        // One hour at 180 MHz later: 180e6 x 3600 cycles.
        assert_eq!(clock.world_ns(16_000 + 648_000_000_000), 3_600_001_000_000);
        assert_eq!(
            clock.cycle_at_world(3_600_001_000_000),
            16_000 + 648_000_000_000
        );
    }

    #[test]
    fn a_fast_crystal_counts_more_cycles_in_the_same_world_time() {
        let fast = Clock::new(50.0, HSI_HZ);
        let slow = Clock::new(-50.0, HSI_HZ);
        // 1 s at 16 MHz +- 50 ppm is 16 000 000 +- 800 cycles.
        assert_eq!(fast.cycle_at_world(1_000_000_000), 16_000_800);
        assert_eq!(slow.cycle_at_world(1_000_000_000), 15_999_200);
        // And back: the rounding is within the last nanosecond.
        assert!(fast.world_ns(16_000_800).abs_diff(1_000_000_000) <= 1);
    }

    #[test]
    fn a_clock_switch_keeps_the_past() {
        let mut clock = Clock::new(0.0, HSI_HZ);
        clock.set_hz(1_600, 8_000_000); // at 100 us
        clock.set_hz(2_400, 180_000_000); // 800 cycles of 125 ns: at 200 us
        assert_eq!(clock.world_ns(2_400), 200_000);
        assert_eq!(clock.world_ns(2_580), 201_000);
        assert_eq!(clock.cycle_at_world(201_000), 2_580);
    }
}
