//! A gyro about the axis that points up: whether it is used, its bias, and the turn it measures.
//!
//! # Theory of operation
//!
//! Wheels that slip report turns that did not happen. A gyro measures turns only, with a bias that
//! it also shows at rest. The two complement each other:
//!
//! | | heading from | bias |
//! |---|---|---|
//! | wheels stand, and the gyro without its bias shows less than 0.5 degrees/s | wheels: no turn | learned |
//! | anything else | gyro without its bias | constant |
//! | gyro not used: failed, or its bias is not known yet | wheels | |
//!
//! The bias is the mean of a window of 500 samples in which no wheel moved and all samples lay
//! within 3 degrees/s of each other. Further windows enter a mean of up to 16 of them.
//!
//! Covariance: with the sensor's noise density `n` and a bias with the standard deviation `b`, the
//! heading after a motion of `t` seconds has the variance `n^2 t + (b t)^2`. After one window `b`
//! is `n / sqrt(1 s)`, after 16 a quarter of that. Errors of the wheels then affect the position
//! only.
//!
//! A gyro that has failed is not used again until the next start of the program; [`GyroState`] has
//! the reason. Its failure does not stop the robot.
//!
//! # Interface
//!
//! The control tick calls [`Gyro::update`] with the driver's [`Reading`], and [`Gyro::rate`] for
//! the odometry. [`bmi088`] is the protocol of one kind of sensor.
//!
//! # Limits
//!
//! A robot that is turned slowly by hand while its wheels stand, below 5 degrees/s, takes this rate
//! for the bias. A sensor whose axis points down, or whose scale is wrong, is not noticed.

pub mod bmi088;

use protocol::GyroState;

/// One count, rad/s: BMI088 in its range of 2000 degrees/s has 16.384 counts a degree/s (data sheet
/// BST-BMI088-DS001-13, 5.5.4).
pub const COUNT: f32 = 0.001_065_264_4;

/// Samples in a window: a second of them.
const WINDOW: u16 = 500;
/// Windows over which the bias is a mean.
const WINDOWS: u8 = 16;
/// How far the samples of a window may lie apart, counts. A noise of 0.014 degrees/s/sqrt(Hz) in
/// 116 Hz is 2.5 counts rms, so 500 samples span some 16; vibration and a turn by hand span more.
const SPREAD: u16 = 48;
/// A larger mean is no bias, counts: 5 degrees/s. The data sheet has 1 degree/s and 0.015 a kelvin.
const LARGEST_BIAS: f32 = 82.0;
/// What the gyro shows at rest at most, counts: half a degree/s, more than three times its noise.
const REST_RATE: f32 = 8.2;
/// Wheels that stand may tremble by this many counts: a fiftieth of a degree of a wheel behind an
/// M3508, whose rotor has 8192 in each of its 19 turns.
const TREMBLE: u16 = 8;
/// Samples after which wheels that stand mean rest.
const SETTLED: u16 = 50;
/// As many equal samples in a row are no measurement: the noise makes four of five differ.
const STUCK: u16 = 125;
/// No robot gains this much from one sample to the next, counts: 250 degrees/s in 2 ms.
const JUMP: u16 = 4096;
/// The last counts of the range: the rate is that or more.
const SATURATED: u16 = 32_760;
/// What an implausible sample counts, against one for each good one, and how much is too much.
const SUSPICION: (u8, u8) = (16, 48);
/// Ticks without a sample after which the driver is silent; it has one every second tick.
const SILENT: u16 = 50;

/// What the gyro's driver says in a tick.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Reading {
    /// Nothing new.
    Waiting,
    /// A sample, in counts; counter-clockwise is positive.
    Rate(i16),
    /// It does not answer, or as something else.
    Missing,
}

/// What is reported of a gyro.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct GyroReport {
    /// Whether it is used, and if not, why.
    pub state: GyroState,
    /// Yaw rate without bias, rad/s, counter-clockwise positive; 0 while it is not used.
    pub rate: f32,
    /// Bias, rad/s; 0 while it is not known.
    pub bias: f32,
}

impl GyroReport {
    /// A board without a gyro.
    pub const NONE: Self = Self {
        state: GyroState::None,
        rate: 0.0,
        bias: 0.0,
    };
}

/// Samples while nothing moves.
#[derive(Clone, Copy)]
struct Window {
    /// Where the wheels stand.
    counts: [u16; 4],
    samples: u16,
    sum: i32,
    least: i16,
    most: i16,
}

impl Window {
    const EMPTY: Self = Self {
        counts: [0; 4],
        samples: 0,
        sum: 0,
        least: i16::MAX,
        most: i16::MIN,
    };
}

/// A gyro, as far as it is believed.
#[derive(Clone, Copy)]
pub struct Gyro {
    state: GyroState,
    window: Window,
    /// Counts, and how many windows it is the mean of.
    bias: f32,
    windows: u8,
    /// The last sample that was plausible, and how often in a row; 0 before the first.
    last: i16,
    equal: u16,
    silent: u16,
    suspicion: u8,
}

impl Default for Gyro {
    fn default() -> Self {
        Self::new()
    }
}

impl Gyro {
    /// A gyro of which nothing is known.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            state: GyroState::None,
            window: Window::EMPTY,
            bias: 0.0,
            windows: 0,
            last: 0,
            equal: 0,
            silent: 0,
            suspicion: 0,
        }
    }

    /// Takes what the driver says, and where the wheels stand.
    pub fn update(&mut self, reading: Reading, counts: &[u16; 4]) {
        if self.state == GyroState::None {
            self.state = GyroState::Starting;
        }
        if !matches!(self.state, GyroState::Starting | GyroState::InUse) {
            return;
        }
        match reading {
            Reading::Missing => self.state = GyroState::Missing,
            // Before the first sample the driver waits, or reports a missing gyro.
            Reading::Waiting if self.equal == 0 => {}
            Reading::Waiting => {
                self.silent += 1;
                if self.silent > SILENT {
                    self.state = GyroState::Silent;
                }
            }
            Reading::Rate(rate) => {
                self.silent = 0;
                self.sample(rate, counts);
            }
        }
    }

    fn sample(&mut self, rate: i16, counts: &[u16; 4]) {
        let is_first = self.equal == 0;
        let jumps = !is_first && rate.abs_diff(self.last) > JUMP;
        if jumps || rate.unsigned_abs() >= SATURATED {
            self.suspicion += SUSPICION.0;
            self.window.samples = 0;
            if self.suspicion >= SUSPICION.1 {
                self.state = GyroState::Implausible;
            }
            return;
        }
        self.suspicion = self.suspicion.saturating_sub(1);
        self.equal = if is_first || rate != self.last {
            1
        } else {
            self.equal + 1
        };
        self.last = rate;
        if self.equal >= STUCK {
            self.state = GyroState::Stuck;
            return;
        }
        self.rest(rate, counts);
    }

    /// Learns the bias while the wheels stand.
    fn rest(&mut self, rate: i16, counts: &[u16; 4]) {
        let window = &mut self.window;
        let mut wheels = counts.iter().zip(&window.counts);
        let moved = wheels
            .any(|(now, then)| now.wrapping_sub(*then).cast_signed().unsigned_abs() > TREMBLE);
        let (least, most) = (window.least.min(rate), window.most.max(rate));
        if window.samples == 0 || moved || most.abs_diff(least) > SPREAD {
            *window = Window {
                counts: *counts,
                samples: 1,
                sum: rate.into(),
                least: rate,
                most: rate,
            };
            return;
        }
        window.samples += 1;
        window.sum += i32::from(rate);
        (window.least, window.most) = (least, most);
        if window.samples < WINDOW {
            return;
        }
        let mean = window.sum as f32 / f32::from(WINDOW);
        // Goes on as rest; the next window begins.
        window.samples = SETTLED;
        window.sum = i32::from(rate) * i32::from(SETTLED);
        (window.least, window.most) = (rate, rate);
        if mean.abs() <= LARGEST_BIAS {
            self.windows = WINDOWS.min(self.windows + 1);
            self.bias += (mean - self.bias) / f32::from(self.windows);
            self.state = GyroState::InUse;
        }
    }

    /// The yaw rate for the odometry, rad/s; `None` where the wheels are to say it.
    #[must_use]
    pub fn rate(&self) -> Option<f32> {
        let rate = self.unbiased()?;
        let rests = self.window.samples >= SETTLED && rate.abs() < REST_RATE;
        (!rests).then_some(rate * COUNT)
    }

    /// Counts without bias.
    fn unbiased(&self) -> Option<f32> {
        (self.state == GyroState::InUse).then(|| f32::from(self.last) - self.bias)
    }

    /// What is reported of it.
    #[must_use]
    pub fn report(&self) -> GyroReport {
        GyroReport {
            state: self.state,
            rate: self.unbiased().unwrap_or(0.0) * COUNT,
            bias: self.bias * COUNT,
        }
    }
}

#[cfg(test)]
mod tests;
