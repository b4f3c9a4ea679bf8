//! Bounds of the arithmetic against `f64`, in either representation.

use super::*;
use crate::wheel::{Available, Gains, Held, WheelLoop, WheelReference};

/// Numbers from -1 to 1, the same ones every time (Numerical Recipes' generator).
struct Spread(u32);

impl Spread {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 8_388_608.0 - 1.0
    }

    /// From a thousandth of `most` to all of it, each decade alike, with either sign.
    fn of(&mut self, most: f32) -> f32 {
        let size = 10_f32.powf(-1.5 + 1.5 * self.next());
        (most * size).copysign(self.next())
    }
}

/// A step of a number of this magnitude.
fn step<const FRACTION: u32>(magnitude: f64) -> f64 {
    if cfg!(feature = "fixed-point") {
        2.0_f64.powi(-(FRACTION as i32))
    } else {
        magnitude * f64::from(f32::EPSILON)
    }
}

fn product<const A: u32, const B: u32, const C: u32>(most: (f32, f32)) {
    let mut spread = Spread(A + B);
    for _ in 0..10_000 {
        let a = Quantity::<A>::new(spread.of(most.0));
        let b = Quantity::<B>::new(spread.of(most.1));
        let exact = exact(a) * exact(b);
        let found: Quantity<C> = a.times(b);
        let off = (self::exact(found) - exact).abs();
        // Half a step; the test reads a quantity exactly.
        assert!(
            off <= 0.5 * step::<C>(exact.abs()),
            "{a:?} {b:?}: {found:?}"
        );
    }
}

/// The value, exactly.
fn exact<const FRACTION: u32>(value: Quantity<FRACTION>) -> f64 {
    // The part that a float has, and what it has not.
    let near = value.to_f32();
    if near.is_infinite() {
        return near.into();
    }
    let rest = value - Quantity::new(near);
    f64::from(near) + f64::from(rest.to_f32())
}

#[test]
fn products_are_off_by_half_a_step() {
    // As the tick multiplies, up to the ends of the ranges that docs/numbers.md derives.
    product::<23, 36, 27>((250.0, 0.02)); // rate, time
    product::<19, 36, 23>((4_000.0, 0.02)); // acceleration, time
    product::<23, 24, 15>((250.0, 100.0)); // rate, gain
    product::<19, 28, 15>((4_000.0, 7.9)); // acceleration, gain
    product::<23, 10, 22>((250.0, 2.0)); // rate, counts in a radian
    product::<22, 36, 27>((400.0, 0.02)); // bandwidth, time
    product::<27, 27, 27>((3.9, 3.9)); // angle, share
    product::<27, 22, 23>((0.5, 400.0)); // angle, bandwidth
    product::<23, 27, 23>((120.0, 2.0)); // velocity, coefficient
    product::<27, 27, 27>((2.0, 2.0)); // displacement, coefficient
    product::<23, 25, 23>((4.0, 50.0)); // yaw rate, lever
    product::<19, 25, 19>((50.0, 50.0)); // yaw acceleration, lever
    product::<27, 25, 27>((0.2, 50.0)); // turn, lever
    product::<27, 18, 19>((6.6, 600.0)); // what is left, one over a time
    product::<19, 27, 24>((100.0, 1.0)); // change, share
    product::<24, 36, 27>((50.0, 0.02)); // acceleration of the group, time
    product::<18, 36, 24>((5_000.0, 0.02)); // jerk, time
    product::<27, 22, 15>((3.3, 100.0)); // input, divider
    product::<15, 27, 24>((100.0, 1.0)); // voltage, one over the supply
    product::<15, 20, 24>((0.5, 200.0)); // voltage, conductance
}

#[test]
fn what_does_not_fit_stays_at_the_end() {
    let (most, least) = (Rate::MAX, Rate::MIN);
    assert_eq!(most + most, most);
    assert_eq!(least - most, least);
    assert_eq!(least + least, least);
    assert!(-least >= Rate::new(255.9) && least.abs() >= Rate::new(255.9));
    for (a, b, sign) in [(most, most, 1.0), (most, least, -1.0), (least, least, 1.0)] {
        // Shifted by 14: it would take 32 integer bits.
        let found: Quantity<32> = a.times(b);
        assert!(exact(found) * sign >= 0.499, "{found:?}");
    }
    let infinite = [f32::INFINITY, f32::NEG_INFINITY].map(Rate::new);
    assert_eq!(infinite, [most, least]);
    let wide: Quantity<30> = Rate::new(100.0).to();
    assert!(exact(wide) >= 1.999);
    let wide: Quantity<30> = Rate::new(-100.0).to();
    assert!(exact(wide) <= -1.999);
}

/// All that saturates is noticed, and nothing up to 0.999 of the range: of sums, products with the
/// coarsest and the finest result, and conversions.
#[test]
fn an_end_of_the_range_is_noticed() {
    fn is_noticed<const FRACTION: u32>(value: Quantity<FRACTION>) -> bool {
        let mut ends = Ends::NONE;
        ends.note(Quantity::<FRACTION>::ZERO);
        ends.note(value);
        ends.note(Quantity::<FRACTION>::ZERO);
        ends.reached()
    }
    let is_fixed = cfg!(feature = "fixed-point");
    for sign in [1.0, -1.0] {
        let most = Rate::new(sign * 255.99);
        assert_eq!(is_noticed(most + most), is_fixed);
        assert_eq!(is_noticed(most + Rate::new(sign)), is_fixed);
        // Shifted by 11, the least of any product in the tick, and by 31.
        let product: Bandwidth = most.times(Large::new(3.0));
        assert_eq!(is_noticed(product), is_fixed);
        let product: Quantity<15> = most.times(Quantity::<23>::new(255.99));
        assert_eq!(
            is_noticed(product),
            exact(product).abs() > 65_472.0 && is_fixed
        );
        let wide: Angle = most.to();
        assert_eq!(is_noticed(wide), is_fixed);
        assert_eq!(is_noticed(Rate::new(sign * 300.0)), is_fixed);
        assert!(!is_noticed(Rate::new(sign * 255.7)));
        assert!(!is_noticed(Rate::new(sign * 1e-6)));
    }
}

#[test]
fn conversions_are_off_by_half_a_step() {
    let mut spread = Spread(3);
    for _ in 0..10_000 {
        let value = spread.of(255.0);
        let found = Rate::new(value);
        let off = (exact(found) - f64::from(value)).abs();
        assert!(
            off <= 0.5 * step::<23>(f64::from(value.abs())),
            "{value}: {found:?}"
        );
        let back: Quantity<19> = found.to();
        assert!(
            (exact(back) - exact(found)).abs() <= step::<19>(0.0),
            "{found:?}"
        );
    }
    for micros in 250..=20_000_u16 {
        let inverse = exact(PerSecond::of_micros(micros.into()));
        let off = (inverse / (1e6 / f64::from(micros)) - 1.0).abs();
        assert!(off < 2e-7, "{micros} us: {inverse} 1/s");
        let part = exact(Part::of(20_000).at(micros.into()));
        let off = (part - f64::from(micros) / 20_000.0).abs();
        assert!(off < 2e-8 + 1.2e-7 * part, "{micros} us: {part}");
        let time = exact(Time::from_micros(micros.into()));
        let off = (time / (f64::from(micros) * 1e-6) - 1.0).abs();
        assert!(off < 2e-7, "{micros} us: {time} s");
    }
}

#[test]
fn one_over_a_number_is_off_by_its_steps() {
    let mut spread = Spread(5);
    for _ in 0..10_000 {
        // Coefficients of the compensation, and more.
        let ratio = Ratio::new(2.1 + 1.9 * spread.next());
        let (found, wanted) = (exact(ratio.inverse()), 1.0 / exact(ratio));
        let off = (found - wanted).abs();
        assert!(
            off <= step::<27>(wanted) + 2e-9 * wanted,
            "{ratio:?}: {found}"
        );
        // From a tenth of a volt to a hundred.
        let voltage = Voltage::new(spread.of(100.0).abs());
        let (found, exact) = (exact(voltage.inverse()), 1.0 / exact(voltage));
        let off = (found - exact).abs();
        assert!(
            off <= step::<27>(0.0) + 1.2e-7 * exact,
            "{voltage:?}: {found}"
        );
    }
}

/// Ends of the tables of a compensation, as far apart as a robot accepts, and rates from standstill
/// to far beyond them.
#[test]
fn steps_of_a_rate_are_off_by_its_step() {
    let mut spread = Spread(11);
    for _ in 0..20_000 {
        let end = spread.of(6.5535).abs().max(1e-4);
        let most = if spread.next() < 0.5 { end } else { 250.0 };
        let rate = Rate::new(spread.of(most));
        let (step, part) = Steps::<16>::new(end).at(rate);
        let found = step as f64 + exact(part);
        let wanted = (16.0 * exact(rate).abs() / f64::from(end)).min(16.0);
        // Half a step of the end, and the reciprocal's own; a float has 24 bits of either.
        let off = 2.0_f64.powi(-24) / f64::from(end) + 2.0_f64.powi(-27);
        let off = if cfg!(feature = "fixed-point") {
            off
        } else {
            2.5e-7
        };
        assert!(step < 16 && exact(part) <= 1.0, "{step} {part:?}");
        assert!(
            (found - wanted).abs() <= 16.0 * off,
            "{rate:?} of {end}: {found}, not {wanted}"
        );
    }
}

#[test]
fn size_and_share_are_those_of_the_vector() {
    let mut spread = Spread(13);
    for _ in 0..20_000 {
        // From 10 um/s to what a rate can hold.
        let size = 1e-5 * 10_f32.powf(3.7 + 3.7 * spread.next());
        let [x, y] = [0, 1].map(|_| Rate::new(size.min(180.0) * spread.next()));
        let Some((found, share)) = polar(x, y) else {
            assert!(exact(x).hypot(exact(y)) <= 1e-6);
            continue;
        };
        let wanted = exact(x).hypot(exact(y));
        let bound = step::<23>(0.0) + 2.4e-7 * wanted;
        assert!(
            (exact(found) - wanted).abs() <= bound,
            "{x:?} {y:?}: {found:?}"
        );
        let wanted = 2.0 * exact(y).powi(2) / wanted.powi(2);
        let off = (exact(share) - wanted).abs();
        assert!(
            off <= 2.0 * step::<27>(0.0) + 3e-7 * wanted,
            "{x:?} {y:?}: {share:?}"
        );
    }
    assert_eq!(polar(Rate::new(5e-7), Rate::new(-5e-7)), None);
}

/// From the finest encoder that fits to the coarsest: what counts add up to over an hour.
#[test]
fn counts_keep_their_scale() {
    let mut step = 2e-7_f32;
    while step < 16.0 {
        for sign in [1.0, -1.0] {
            let count = Count::new(sign * step);
            // A hundred rad/s, in a tick.
            let most = (0.1 / step).clamp(1.0, 32_000.0) as i16;
            for counts in [1, -1, most / 3, most, -most] {
                let turned = exact(count.turned(counts));
                let wanted = f64::from(counts) * f64::from(sign * step);
                // Half a step of an angle, and the mantissa's own.
                let bound = 0.5 * self::step::<27>(wanted.abs()) + wanted.abs() * 1e-9;
                assert!((turned - wanted).abs() <= bound, "{counts} of {step}");
            }
        }
        // The last is 15.3 rad.
        step *= 1.68;
    }
}

#[test]
fn signs_agree_only_where_both_have_one() {
    let [one, none] = [Rate::new(1.0), Rate::ZERO];
    assert!(one.agrees(one) && (-one).agrees(-one));
    assert!(!one.agrees(-one) && !one.agrees(none) && !none.agrees(none));
    assert!(!none.agrees(-one));
}

#[test]
fn half_along_has_the_sign_of_the_direction() {
    let value = Angle::new(0.5);
    assert_eq!(Half::along(Rate::new(3.0)).of(value), Angle::new(0.25));
    assert_eq!(Half::along(Rate::ZERO).of(value), Angle::new(0.25));
    assert_eq!(Half::along(Rate::new(-3.0)).of(value), Angle::new(-0.25));
    assert_eq!(Angle::new(-0.5).not_below_zero(), Angle::ZERO);
    assert_eq!(value.not_below_zero(), value);
}

/// The loop of a wheel against `f64`, with gains over all that a configuration accepts.
#[test]
fn a_wheel_loop_is_off_by_what_its_numbers_are() {
    let mut spread = Spread(7);
    for _ in 0..20_000 {
        let mut gain = |most: f32| spread.of(most).abs();
        let gains = Gains {
            static_friction: gain(50.0),
            speed: gain(100.0),
            acceleration: gain(7.9),
            proportional: gain(100.0),
            integral: gain(2_000.0),
        };
        let [w, seen] = [spread.of(65.0), spread.of(65.0)];
        let reference = WheelReference {
            rate: Rate::new(w),
            acceleration: Acceleration::new(spread.of(2_000.0)),
        };
        let a = reference.acceleration.to_f32();
        if w.abs() < 0.02 {
            continue;
        }
        let mut wheel = WheelLoop::new(gains, 60_000.0);
        let plenty = Available {
            voltage: Voltage::new(60_000.0),
            dt: Time::from_micros(1_000),
        };
        let given = wheel.update(reference, Rate::new(seen), plenty, &mut Held::default());
        let wide = |value: f32| f64::from(value);
        let terms = [
            wide(gains.static_friction).copysign(wide(w)),
            wide(gains.speed) * wide(w),
            wide(gains.acceleration) * wide(a),
            wide(gains.proportional) * (wide(w) - wide(seen)),
        ];
        let wanted: f64 = terms.iter().sum();
        let size: f64 = terms.iter().map(|term| term.abs()).sum();
        let bound = if cfg!(feature = "fixed-point") {
            // Half a step of each term; of each rate and gain half a step, times the other.
            let rates = 2.0_f64.powi(-24) * wide(gains.speed + 2.0 * gains.proportional);
            let gained = 2.0_f64.powi(-25) * wide(w.abs() + (w - seen).abs());
            let accelerated =
                2.0_f64.powi(-20) * wide(gains.acceleration) + 2.0_f64.powi(-29) * wide(a.abs());
            0.5 * 4.0 / 32_768.0 + rates + gained + accelerated
        } else {
            4.0 * wide(f32::EPSILON) * size
        };
        let off = (exact(given) - wanted).abs();
        assert!(off <= bound, "{gains:?} {w} {a} {seen}: {off} of {bound}");
    }
}

/// Rows of the table: name, fractional bits, range, resolution.
#[test]
fn the_table_of_the_documents_is_this_one() {
    fn bits<const FRACTION: u32>(_: Quantity<FRACTION>) -> u32 {
        FRACTION
    }
    macro_rules! names {
        ($($name:ident),*) => { [$((stringify!($name), bits($name::ZERO))),*] };
    }
    let page = include_str!("../../../docs/numbers.md");
    let rows: std::vec::Vec<std::vec::Vec<&str>> = page
        .lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| line.split('|').map(str::trim).collect())
        .collect();
    let names = names![
        Rate,
        Angle,
        Acceleration,
        Time,
        Duration,
        Voltage,
        RateGain,
        AccelerationGain,
        AngleGain,
        Bandwidth,
        Ratio,
        Lever,
        Large,
        Velocity,
        Change,
        Jerk,
        PerSecond,
        InputVoltage,
        Divider,
        Drive,
        Conductance
    ];
    assert_eq!(rows.len(), names.len());
    for (name, bits) in names {
        let tick = std::format!("`{name}`");
        let row = rows.iter().find(|row| row[1] == tick).expect(name);
        assert_eq!(row[3].parse(), Ok(bits), "{name}");
        let near = |text: &str, value: f64| {
            let written: f64 = text.parse().expect(name);
            (written / value - 1.0).abs() < 0.05
        };
        assert!(near(row[4], 2.0_f64.powi(31 - bits as i32)), "{name}");
        assert!(near(row[5], 2.0_f64.powi(-(bits as i32))), "{name}");
    }
}
