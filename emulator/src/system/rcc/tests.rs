//! The clock tree against RM0390 rev 6, section 6.

use super::*;
use crate::chip::{F407, F446};

const HSEON_BYP: u32 = HSEON | HSEBYP;

/// 8 MHz / `m` x `n` / 2 as the system clock, APB1 by 4, APB2 by 2.
fn running_from_pll(m: u32, n: u32) -> Rcc {
    let mut rcc = Rcc::new(&F446.clocks, 8_000_000);
    rcc.write(0, reg::CR, 0x83 | HSEON_BYP, false).unwrap();
    rcc.write(0, reg::PLLCFGR, 1 << 22 | n << 6 | m, false)
        .unwrap();
    rcc.write(0, reg::CR, 0x83 | HSEON_BYP | PLLON, false)
        .unwrap();
    rcc.write(PLL_LOCK_PS, reg::CFGR, 2 | 5 << 10 | 4 << 13, false)
        .unwrap();
    rcc
}

#[test]
fn reset_values() {
    let rcc = Rcc::new(&F446.clocks, 8_000_000);
    assert_eq!(rcc.read(0, reg::CR), Some(0x83));
    assert_eq!(rcc.read(0, reg::PLLCFGR), Some(0x2400_3010));
    assert_eq!(rcc.read(0, reg::CSR), Some(0x0E00_0000));
    assert_eq!(rcc.clocks(0).hclk, 16_000_000);
}

#[test]
fn the_tree_at_180_mhz() {
    let clocks = running_from_pll(4, 180).clocks(PLL_LOCK_PS);
    assert_eq!(
        clocks,
        Clocks {
            sysclk: 180_000_000,
            hclk: 180_000_000,
            pclk1: 45_000_000,
            pclk2: 90_000_000,
            timer1: 90_000_000,
            timer2: 180_000_000
        }
    );
}

#[test]
fn a_pll_takes_its_time_to_lock() {
    let mut rcc = Rcc::new(&F446.clocks, 8_000_000);
    rcc.write(0, reg::CR, 0x83 | PLLON, false).unwrap();
    assert_eq!(rcc.read(PLL_LOCK_PS - 1, reg::CR).unwrap() & 1 << 25, 0);
    assert_ne!(rcc.read(PLL_LOCK_PS, reg::CR).unwrap() & 1 << 25, 0);
}

#[test]
fn without_hse_the_pll_never_locks_and_the_switch_does_not_happen() {
    let mut rcc = Rcc::new(&F446.clocks, 0);
    rcc.write(0, reg::PLLCFGR, 1 << 22 | 180 << 6 | 4, false)
        .unwrap();
    rcc.write(0, reg::CR, 0x83 | HSEON_BYP | PLLON, false)
        .unwrap();
    rcc.write(1, reg::CFGR, 2, false).unwrap();
    let late = 10_000_000 * US;
    assert_eq!(rcc.read(late, reg::CR).unwrap() & (1 << 17 | 1 << 25), 0);
    assert_eq!(rcc.read(late, reg::CFGR).unwrap() & 0xC, 0);
    assert_eq!(rcc.clocks(late).hclk, 16_000_000);
}

#[test]
fn a_clock_that_stops_is_seen_with_css_only() {
    let late = 2 * PLL_LOCK_PS;
    let mut rcc = running_from_pll(4, 180);
    assert_eq!(rcc.set_hse(late, false), HseFailure::Unseen);

    let mut rcc = running_from_pll(4, 180);
    let on = rcc.read(late, reg::CR).unwrap() | CSSON;
    rcc.write(late, reg::CR, on, false).unwrap();
    assert_eq!(rcc.set_hse(late, false), HseFailure::Seen);
    assert_eq!(rcc.clocks(late).sysclk, 16_000_000);
    let off = rcc.read(late, reg::CR).unwrap() & (HSEON | PLLON | 1 << 17 | 1 << 25);
    assert_eq!(off, 0);
    assert!(rcc.nmi() && rcc.read(late, reg::CIR).unwrap() & CSSF != 0);
    rcc.write(late, reg::CIR, CSSC, false).unwrap();
    assert!(!rcc.nmi());
}

#[test]
fn a_clock_that_begins_late_is_ready_late() {
    let mut rcc = Rcc::new(&F446.clocks, 8_000_000);
    assert_eq!(rcc.set_hse(0, false), HseFailure::None);
    rcc.write(0, reg::CR, 0x83 | HSEON_BYP, false).unwrap();
    assert_eq!(rcc.read(5 * US, reg::CR).unwrap() & 1 << 17, 0);
    rcc.set_hse(5 * US, true);
    assert_ne!(rcc.read(5 * US, reg::CR).unwrap() & 1 << 17, 0);
}

#[test]
fn pll_limits() {
    assert_eq!(running_from_pll(4, 180).pll_fault(PLL_LOCK_PS), None);
    assert!(
        running_from_pll(2, 90).pll_fault(PLL_LOCK_PS).is_some(),
        "4 MHz into the PLL"
    );
    assert!(running_from_pll(4, 433).pll_fault(PLL_LOCK_PS).is_some());
}

#[test]
fn causes_are_kept_until_removed() {
    let mut rcc = Rcc::new(&F446.clocks, 8_000_000);
    rcc.write(0, reg::CSR, RMVF, false).unwrap();
    assert_eq!(rcc.csr & CAUSES, 0);
    rcc.reset(cause::IWDG | cause::PIN);
    assert_eq!(rcc.csr & CAUSES, 0x2400_0000);
}

/// RM0090 7.3: the map of RCC ends with PLLI2SCFGR, and CR has no PLLSAI.
#[test]
fn an_stm32f407_has_two_plls() {
    let mut rcc = Rcc::new(&F407.clocks, 12_000_000);
    assert_eq!(rcc.read(0, 0x84), Some(0x2000_3000));
    assert_eq!(rcc.read(0, 0x88), None);
    assert_eq!(rcc.write(0, 0x8C, 1 << 24, false), None);
    rcc.write(0, reg::CR, 0x83 | 1 << 28, false).unwrap();
    assert_eq!(rcc.read(PLL_LOCK_PS, reg::CR), Some(0x83));
}
