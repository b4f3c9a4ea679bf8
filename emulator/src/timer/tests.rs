//! The timers against RM0390, by their registers alone.

use super::*;

const CEN: u32 = 1;
const UIF: u32 = 1;
const CC1IF: u32 = 2;

fn timer(kind: Kind, setup: &[(u32, u32)]) -> Timer {
    let mut timer = Timer::new(kind);
    for &(offset, value) in setup {
        timer.write(0, offset, value).unwrap();
    }
    timer
}

fn read(timer: &mut Timer, now: u64, offset: u32) -> u32 {
    timer.read(now, offset).unwrap()
}

#[test]
fn counts_the_clock_through_the_prescaler() {
    // 180 MHz / 180 = 1 MHz, as the time driver wants it.
    let mut t = timer(
        Kind::TWO_CHANNELS,
        &[(reg::PSC, 179), (reg::EGR, 1), (reg::CR1, CEN)],
    );
    assert_eq!(read(&mut t, 179, reg::CNT), 0);
    assert_eq!(read(&mut t, 180, reg::CNT), 1);
    assert_eq!(read(&mut t, 180 * 65_535, reg::CNT), 65_535);
    assert_eq!(read(&mut t, 180 * 65_536 + 360, reg::CNT), 2);
}

#[test]
fn the_prescaler_is_preloaded() {
    // 17.4.11: the new value is taken at the next update event, without which the old one stays.
    let mut t = timer(Kind::GENERAL_16, &[(reg::PSC, 9), (reg::CR1, CEN)]);
    assert_eq!(read(&mut t, 100, reg::CNT), 100);
    t.write(100, reg::EGR, 1).unwrap();
    assert_eq!(read(&mut t, 200, reg::CNT), 10);
}

#[test]
fn update_flag_and_urs() {
    let mut t = timer(Kind::GENERAL_16, &[(reg::CR1, 4), (reg::EGR, 1)]);
    assert_eq!(
        read(&mut t, 0, reg::SR),
        0,
        "URS: an update made by software sets no flag"
    );
    t.write(0, reg::CR1, 0).unwrap();
    t.write(0, reg::EGR, 1).unwrap();
    assert_eq!(read(&mut t, 0, reg::SR), UIF);
    t.write(0, reg::SR, !UIF).unwrap();
    assert_eq!(read(&mut t, 0, reg::SR), 0);
}

#[test]
fn events_come_at_the_compare_and_the_overflow() {
    let mut t = timer(
        Kind::TWO_CHANNELS,
        &[
            (reg::ARR, 999),
            (reg::CCR1, 400),
            (reg::DIER, UIF | CC1IF),
            (reg::CR1, CEN),
        ],
    );
    assert_eq!(t.next_event(), Some(400));
    t.sync(399);
    assert_eq!(t.lines(), Lines::default());
    t.sync(400);
    assert!(t.lines().compare && !t.lines().update);
    assert_eq!(t.next_event(), Some(1000));
    t.sync(1000);
    assert!(t.lines().update);
    t.write(1000, reg::SR, 0).unwrap();
    assert_eq!(t.next_event(), Some(1400));
}

#[test]
fn a_late_look_sees_every_flag() {
    let mut t = timer(
        Kind::GENERAL_16,
        &[(reg::ARR, 99), (reg::CCR1, 98), (reg::CR1, CEN)],
    );
    assert_eq!(read(&mut t, 1_000_000_050, reg::CNT), 50);
    assert_eq!(
        read(&mut t, 1_000_000_050, reg::SR) & (UIF | CC1IF),
        UIF | CC1IF
    );
}

#[test]
fn auto_reload_preload_waits_for_the_update() {
    const ARPE: u32 = 1 << 7;
    let mut t = timer(
        Kind::GENERAL_16,
        &[(reg::ARR, 99), (reg::EGR, 1), (reg::CR1, ARPE | CEN)],
    );
    t.write(50, reg::ARR, 49).unwrap();
    assert_eq!(read(&mut t, 99, reg::CNT), 99);
    assert_eq!(read(&mut t, 149, reg::CNT), 49);
    assert_eq!(read(&mut t, 150, reg::CNT), 0);
}

#[test]
fn without_preload_a_short_auto_reload_is_overrun() {
    // The counter is at 60 when ARR becomes 49: it runs to the end of its 16 bits.
    let mut t = timer(Kind::GENERAL_16, &[(reg::ARR, 99), (reg::CR1, CEN)]);
    t.write(60, reg::ARR, 49).unwrap();
    assert_eq!(read(&mut t, 65_535, reg::CNT), 65_535);
    assert_eq!(read(&mut t, 65_535, reg::SR) & UIF, 0);
    assert_eq!(read(&mut t, 65_536 + 49, reg::CNT), 49);
    assert_eq!(read(&mut t, 65_536 + 50, reg::CNT), 0);
}

/// TIM1 as a motor driver uses it: PWM mode 1 on channel 1, preloaded, edge-aligned, 9000 clocks.
fn pwm(extra: &[(u32, u32)]) -> Timer {
    let mut t = timer(
        Kind::ADVANCED,
        &[
            (reg::ARR, 8999),
            (reg::CCMR1, 0x68),
            (reg::CCER, 1),
            (reg::CCR1, 2250),
            (reg::EGR, 1),
        ],
    );
    for &(offset, value) in extra {
        t.write(0, offset, value).unwrap();
    }
    t
}

#[test]
fn pwm_duty_and_period() {
    let t = pwm(&[(reg::BDTR, 0x8000), (reg::CR1, CEN)]);
    let state = t.pwm(0, 180_000_000);
    assert_eq!(
        state,
        PwmState {
            duty: 0.25,
            period_ns: 50_000,
            active: true
        }
    );
}

#[test]
fn compare_preload_waits_for_the_update() {
    let mut t = pwm(&[(reg::BDTR, 0x8000), (reg::CR1, CEN)]);
    t.write(100, reg::CCR1, 4500).unwrap();
    t.sync(8999);
    assert_eq!(t.pwm(0, 180_000_000).duty, 0.25);
    t.sync(9000);
    assert_eq!(t.pwm(0, 180_000_000).duty, 0.5);
}

#[test]
fn repetition_counter_thins_out_updates() {
    let mut t = pwm(&[(reg::RCR, 3), (reg::EGR, 1), (reg::CR1, CEN)]);
    t.write(0, reg::SR, 0).unwrap();
    t.sync(3 * 9000);
    assert_eq!(read(&mut t, 3 * 9000, reg::SR) & UIF, 0);
    assert_eq!(read(&mut t, 4 * 9000, reg::SR) & UIF, UIF);
}

#[test]
fn no_output_without_moe() {
    let t = pwm(&[(reg::CR1, CEN)]);
    assert_eq!(
        t.pwm(0, 180_000_000),
        PwmState {
            duty: 0.0,
            period_ns: 50_000,
            active: false
        }
    );
}

#[test]
fn break_input_cuts_the_outputs_and_holds_them_off() {
    const MOE: u32 = 1 << 15;
    const BKE_BKP: u32 = 3 << 12;
    let mut t = pwm(&[
        (reg::BDTR, MOE | BKE_BKP),
        (reg::DIER, 1 << 7),
        (reg::CR1, CEN),
    ]);
    assert!(t.pwm(0, 180_000_000).active);
    t.set_break_input(1000, true);
    assert!(!t.pwm(0, 180_000_000).active);
    assert!(t.lines().breaking);
    // 17.3.12: MOE cannot be set while the break is active; after it, only by software.
    t.write(1100, reg::BDTR, MOE | BKE_BKP).unwrap();
    assert!(!t.pwm(0, 180_000_000).active);
    t.set_break_input(1200, false);
    assert!(!t.pwm(0, 180_000_000).active);
    t.write(1300, reg::BDTR, MOE | BKE_BKP).unwrap();
    assert!(t.pwm(0, 180_000_000).active);
}

#[test]
fn automatic_output_enable_returns_at_the_update() {
    const AOE_BKE_BKP: u32 = 7 << 12;
    let mut t = pwm(&[(reg::BDTR, AOE_BKE_BKP), (reg::CR1, CEN)]);
    t.set_break_input(0, true);
    t.sync(20_000);
    assert!(!t.outputs_enabled());
    t.set_break_input(20_000, false);
    t.sync(26_999);
    assert!(!t.outputs_enabled());
    t.sync(27_000);
    assert!(t.outputs_enabled());
}

#[test]
fn lock_level_1_freezes_the_break_setting() {
    let mut t = pwm(&[(reg::BDTR, 3 << 12 | 1 << 8)]);
    t.write(0, reg::BDTR, 0).unwrap();
    assert_eq!(read(&mut t, 0, reg::BDTR), 3 << 12 | 1 << 8);
}

#[test]
fn the_first_write_settles_the_lock() {
    let mut t = pwm(&[(reg::BDTR, 3 << 12)]);
    t.write(0, reg::BDTR, 3 << 12 | 3 << 8).unwrap();
    assert_eq!(read(&mut t, 0, reg::BDTR), 3 << 12, "17.4.18");
}

#[test]
fn locks_leave_only_the_outputs_to_be_switched() {
    // Level, whether polarity and whether the mode can still be changed.
    for (level, polarity, mode) in [(1, true, true), (2, false, true), (3, false, false)] {
        let mut t = pwm(&[(reg::BDTR, 1 << 10 | 3 << 12 | level << 8)]);
        t.write(0, reg::CR2, 0x7F00).unwrap();
        assert_eq!(read(&mut t, 0, reg::CR2), 0, "idle states");
        let changed = |t: &mut Timer, register, value| {
            let before = read(t, 0, register);
            t.write(0, register, value).unwrap();
            read(t, 0, register) != before
        };
        assert_eq!(changed(&mut t, reg::CCER, 3), polarity, "level {level}");
        assert_eq!(changed(&mut t, reg::CCMR1, 0x50), mode, "level {level}");
        t.write(0, reg::BDTR, 1 << 15).unwrap();
        let off = if level == 1 { 0 } else { 1 << 10 };
        let expected = 1 << 15 | off | 3 << 12 | level << 8;
        assert_eq!(read(&mut t, 0, reg::BDTR), expected, "level {level}");
    }
}

#[test]
fn centre_aligned_counts_up_and_down() {
    let mut t = timer(
        Kind::ADVANCED,
        &[
            (reg::ARR, 100),
            (reg::CCR1, 25),
            (reg::CCMR1, 0x60),
            (reg::CCER, 1),
            (reg::BDTR, 0x8000),
        ],
    );
    t.write(0, reg::CR1, 1 << 5 | CEN).unwrap();
    assert_eq!(read(&mut t, 30, reg::CNT), 30);
    assert_eq!(read(&mut t, 100, reg::CNT), 100);
    assert_eq!(read(&mut t, 170, reg::CNT), 30);
    assert_eq!(read(&mut t, 230, reg::CNT), 30);
    let state = t.pwm(0, 1_000_000_000);
    assert_eq!((state.duty, state.period_ns), (0.25, 200));
}

#[test]
fn encoder_counts_in_both_directions_and_wraps_at_arr() {
    let mut t = timer(
        Kind::GENERAL_16,
        &[
            (reg::ARR, 0xFFFF),
            (reg::CCMR1, 0x0101),
            (reg::SMCR, 3),
            (reg::CR1, CEN),
        ],
    );
    t.encoder_add(0, 5);
    assert_eq!(read(&mut t, 1, reg::CNT), 5);
    t.encoder_add(2, -7);
    assert_eq!(read(&mut t, 3, reg::CNT), 0xFFFE);
    assert_eq!(
        read(&mut t, 3, reg::CR1) & 0x10,
        0x10,
        "DIR shows the direction"
    );
    // Time alone moves nothing.
    assert_eq!(read(&mut t, 1_000_000, reg::CNT), 0xFFFE);
}

#[test]
fn encoder_polarity_reverses_the_count() {
    let mut t = timer(
        Kind::GENERAL_32,
        &[
            (reg::CCMR1, 0x0101),
            (reg::CCER, 1 << 1),
            (reg::SMCR, 3),
            (reg::CR1, CEN),
        ],
    );
    t.encoder_add(0, 3);
    assert_eq!(read(&mut t, 0, reg::CNT), 0xFFFF_FFFD);
}

#[test]
fn encoder_is_deaf_without_its_inputs_or_clock() {
    for setup in [
        &[(reg::SMCR, 3), (reg::CR1, CEN)][..],
        &[(reg::CCMR1, 0x0101), (reg::SMCR, 3)],
        &[(reg::CCMR1, 0x0101), (reg::CR1, CEN)],
    ] {
        let mut t = timer(Kind::GENERAL_16, setup);
        t.encoder_add(0, 100);
        assert_eq!(read(&mut t, 0, reg::CNT), 0);
    }
}

#[test]
fn what_is_not_modelled_is_refused() {
    let mut t = timer(Kind::GENERAL_16, &[]);
    assert!(t.write(0, reg::SMCR, 4).is_err());
    assert!(t.write(0, reg::CCMR1, 2).is_err());
    assert!(t.write(0, reg::DIER, 1 << 8).is_err());
    assert!(t.read(0, reg::DMAR).is_err());
}

#[test]
fn timer_clock_ratio() {
    // APB1 divided by 4: the timer clock is twice PCLK1, half the core clock.
    let mut t = timer(Kind::GENERAL_16, &[]);
    t.set_ratio(0, 2);
    t.write(0, reg::CR1, CEN).unwrap();
    assert_eq!(read(&mut t, 1000, reg::CNT), 500);
}

/// 18.4.7, CCxS: the channels of an encoder are inputs, and leave their pins to the encoder.
#[test]
fn an_input_drives_no_pin() {
    let mut timer = Timer::new(Kind::GENERAL_16);
    for (offset, value) in [(reg::CCMR1, 0x0101), (reg::CCER, 0x11), (reg::SMCR, 3)] {
        timer.write(0, offset, value).unwrap();
    }
    assert_eq!((timer.level(0), timer.level(1)), (None, None));
    timer.write(0, reg::CCMR1, 0x0001).unwrap();
    assert_eq!(timer.level(1), Some(false), "an output");
}
