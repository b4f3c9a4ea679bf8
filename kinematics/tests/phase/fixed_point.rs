//! Kinematics by roller phase in fixed point, against the same in `f64`.

use super::*;

/// The secants of eight rollers at these angles, exact and in fixed point.
fn secants_at(angles: [i32; 4]) -> ([f64; 4], [i32; 4]) {
    let secant = Secant::<f64>::for_count(8).unwrap();
    let fixed = FixedSecant::new(&secant).unwrap();
    let angles = angles.map(RollerAngle::from_bits);
    (angles.map(|a| secant.at(a)), angles.map(|a| fixed.at(a)))
}

proptest! {
    /// Fixed point: a step of 2^-16 for each of a few cuts, and half a coefficient step for each
    /// unit of input.
    #[test]
    fn fixed_point_follows(twist in twists(), angles in prop::array::uniform4(any::<i32>())) {
        let (robot, mount, c) = (robot(45.0), mount(1.2, -0.4, 0.3), compensation());
        let exact = PhaseMember::new(&robot, &mount, &c).unwrap();
        let fixed = FixedPhaseMember::new(&robot, &mount, &c).unwrap();
        let (secants, fixed_secants) = secants_at(angles);
        let rates: [f64; 4] = exact.inverse(twist, &secants).into();
        let single = twist.convert::<f32>();
        let found: [f32; 4] = fixed.inverse(single, &fixed_secants).into();
        for (a, b) in rates.iter().zip(found) {
            // Five cuts of a step each, six units of input at 2^-21, a rounded input times 12
            // rad/m.
            prop_assert!((a - f64::from(b)).abs() < (5.0 + 12.0) / 65_536.0, "{a} {b}");
        }
        let (back, residual) = fixed.measure(&WheelRates::from(found), &fixed_secants);
        let back = back.convert::<f64>();
        // The rates' own error, times less than a radius of 0.15 m, and a few steps.
        prop_assert!(close(back, twist, 1e-4), "{back:?} {twist:?}");
        prop_assert!(residual.abs() < 3e-4, "{residual}");
    }

    /// The same for any robot, roller count and phase, by what the head of the module says. A step
    /// of a rate is at most 2^-21 of what one unit on all three axes asks of a wheel at most, and
    /// there are three of them.
    #[test]
    fn fixed_point_follows_on_any_robot(
        (half_track, half_wheelbase) in (0.05..1.0, 0.17..1.0),
        (radius, angle) in (0.03..0.3, 30.0_f64..60.0),
        (x, y, heading) in (-3.0..3.0, -3.0..3.0, -PI..PI),
        count in 3..20_u16,
        twist in twists(),
        slips in prop::array::uniform4(-1.0..1.0),
        angles in prop::array::uniform4(any::<i32>()),
    ) {
        let robot =
            FourWheelGeometry::new(half_track, half_wheelbase, radius, angle.to_radians()).unwrap();
        let (mount, c) = (mount(x, y, heading), compensation());
        let exact = PhaseMember::new(&robot, &mount, &c).unwrap();
        let fixed = FixedPhaseMember::new(&robot, &mount, &c).unwrap();
        let fixed_secant = FixedSecant::new(&Secant::<f64>::for_count(count).unwrap()).unwrap();
        let fixed_secants = angles.map(|a| fixed_secant.at(RollerAngle::from_bits(a)));
        // The same ones, so that this is about the matrices alone.
        let secants = fixed_secants.map(|s| f64::from(s) / f64::from(1 << FixedSecant::FRACTION));
        let single = twist.convert::<f32>();
        let rates: [f64; 4] = exact.inverse(single.convert(), &secants).into();
        let units = [
            Twist::new(1.0, 0.0, 0.0),
            Twist::new(0.0, 1.0, 0.0),
            Twist::new(0.0, 0.0, 1.0),
        ];
        let sizes = units.map(|unit| <[f64; 4]>::from(exact.inverse(unit, &[2.01; 4])));
        let size = (0..4).map(|n| sizes.iter().map(|s| s[n].abs()).sum()).fold(0.0, f64::max);
        // Three steps, and 2^-25 of what goes in.
        let bound = 3.1 * size * 0.5_f64.powi(21) + 1e-6;
        let found: [f32; 4] = fixed.inverse(single, &fixed_secants).into();
        for (a, b) in rates.iter().zip(found) {
            prop_assert!((a - f64::from(b)).abs() < bound, "{a} {b} {bound}");
        }
        // The way back, of rates that no rigid motion explains: what four rates mean whose errors
        // are a step of 2^-14 (what leans is found to that), two steps of the result, and 2^-23 of
        // it all.
        let rates: [f32; 4] = std::array::from_fn(|n| (rates[n] + slips[n]) as f32);
        let rates = WheelRates::from(rates);
        let list: [f32; 4] = rates.into();
        let (want, slip) = exact.measure(&WheelRates::from(list.map(f64::from)), &secants);
        let (found, residual) = fixed.measure(&rates, &fixed_secants);
        let found = found.convert::<f64>();
        let (mut gain, mut all) = ([0.0; 3], [0.0; 3]);
        for wheel in 0..4 {
            let mut one = [0.0; 4];
            one[wheel] = 1.0;
            let t = exact.forward(&WheelRates::from(one), &secants);
            for ((gain, all), t) in gain.iter_mut().zip(&mut all).zip([t.vx, t.vy, t.omega]) {
                *gain += t.abs();
                *all += (t * f64::from(list[wheel])).abs();
            }
        }
        let pairs = [(want.vx, found.vx), (want.vy, found.vy), (want.omega, found.omega)];
        // A quarter of the sum of all rates, and what front and rear pair see sideways, each as 1
        // rad/s.
        let (side, turn) = (0.5 * radius * angle.to_radians().tan(), 1.0 / half_wheelbase);
        let meant = [
            Twist::new(0.25 * radius, 0.0, 0.0),
            Twist::new(0.0, side, side * turn),
            Twist::new(0.0, side, -side * turn),
        ]
            .map(|twist| mount.to_group(c.remove(twist)));
        let row = |axis: fn(&Twist<f64>) -> f64| meant.iter().map(|t| axis(t).abs()).sum::<f64>();
        let longest = row(|t| t.vx).max(row(|t| t.vy)).max(row(|t| t.omega));
        for ((a, b), (gain, all)) in pairs.into_iter().zip(gain.into_iter().zip(all)) {
            let steps = 2.0 * longest * 0.5_f64.powi(15);
            let bound = gain * 0.5_f64.powi(14) + steps + all * 0.5_f64.powi(23);
            prop_assert!((a - b).abs() < bound, "{a} {b} {bound}");
        }
        // Two halves of what leans, and 2^-23 of the rates.
        let fastest = list.iter().fold(0.0_f32, |most, rate| most.max(rate.abs()));
        let bound = 2.0 * 0.5_f64.powi(14) + f64::from(fastest) * 0.5_f64.powi(21);
        prop_assert!((slip - f64::from(residual)).abs() < bound, "{slip} {residual} {bound}");
    }

    /// Beyond 64 m/s and rad/s on each axis the twist is that of the end, and nothing wraps.
    #[test]
    fn fixed_point_ends_where_its_twist_ends(
        fast in prop::array::uniform3(64.0_f32..1e30),
        signs in prop::array::uniform3(any::<bool>()),
        angles in prop::array::uniform4(any::<i32>()),
    ) {
        let (robot, mount, c) = (robot(45.0), mount(1.2, -0.4, 0.3), compensation());
        let fixed = FixedPhaseMember::new(&robot, &mount, &c).unwrap();
        let secant = FixedSecant::new(&Secant::<f64>::for_count(3).unwrap()).unwrap();
        let secants = angles.map(|a| secant.at(RollerAngle::from_bits(a)));
        let sign = |n: usize| if signs[n] { 1.0 } else { -1.0 };
        let there = Twist::new(fast[0] * sign(0), fast[1] * sign(1), fast[2] * sign(2));
        let end = Twist::new(64.0 * sign(0), 64.0 * sign(1), 64.0 * sign(2));
        prop_assert_eq!(fixed.inverse(there, &secants), fixed.inverse(end, &secants));
        let exact = PhaseMember::new(&robot, &mount, &c).unwrap();
        let known = secants.map(|s| f64::from(s) / f64::from(1 << FixedSecant::FRACTION));
        let want: [f64; 4] = exact.inverse(end.convert(), &known).into();
        let found: [f32; 4] = fixed.inverse(end, &secants).into();
        for (a, b) in want.iter().zip(found) {
            prop_assert!((a - f64::from(b)).abs() < 1e-6 * 64.0 * 40.0, "{a} {b}");
        }
    }

    /// Up to 8000 rad/s no sum reaches the end of the range; all wheels ahead, faster ones end
    /// there and never wrap.
    #[test]
    fn fixed_point_saturates(
        rates in prop::array::uniform4(-8_000.0_f32..8_000.0),
        fast in prop::array::uniform4(16_000.0_f32..30_000.0),
        angles in prop::array::uniform4(any::<i32>()),
    ) {
        let (robot, mount, c) = (robot(45.0), mount(0.0, 0.0, 0.0), compensation());
        let exact = PhaseMember::new(&robot, &mount, &c).unwrap();
        let fixed = FixedPhaseMember::new(&robot, &mount, &c).unwrap();
        let (secants, fixed_secants) = secants_at(angles);
        let expected = exact.forward(&WheelRates::from(rates.map(f64::from)), &secants);
        let found = fixed.forward(&WheelRates::from(rates), &fixed_secants).convert::<f64>();
        // 32000 units of input at half a step of 2^-26, and what an f32 of that size rounds.
        prop_assert!(close(found, expected, 1e-3), "{found:?} {expected:?}");
        let found = fixed.forward(&WheelRates::from(fast), &fixed_secants);
        let end = 32_767.0 * 0.1524 / 4.0 / 1.002;
        prop_assert!(f64::from(found.vx) >= end && f64::from(found.vx) < 1.01 * end, "{found:?}");
    }
}
