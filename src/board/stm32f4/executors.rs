//! The executor of the bus side, and the priorities of all interrupts.
//!
//! The tasks of the bus side run in thread mode, at the lowest priority. The control tick is the
//! handler of TIM7's interrupt (`tick`): it interrupts the bus side whatever that is doing. The
//! priorities, strongest first:
//!
//! | priority | interrupt | why |
//! |---|---|---|
//! | 0 | PVD (supply of the chip) | cuts the outputs and does not return |
//! | 1 | TIM9 (time) | counts on, wakes the slow tasks; a few microseconds at most |
//! | 2 | EXTI15_10 (encoder index) | reads the counters at the edge; about 50 instructions, once a wheel and tick at most |
//! | 2 | CAN1 receive | takes the time stamp of a frame; must not wait for a control tick |
//! | 3 | CAN1 transmit, errors | refills a mailbox; tells the bus task |
//! | 6 | TIM7 (control tick) | encoders to PWM |
//! | 7 | USART2, DMA1 streams 5 and 6 (cable) | waits for a control tick; the rings last for two of them |
//! | - | thread mode | the bus side |

use cortex_m::peripheral::NVIC;
use embassy_executor::Executor;
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use static_cell::StaticCell;

static BUS: StaticCell<Executor> = StaticCell::new();

/// Returns the executor of the bus side. To be called once.
pub fn bus() -> &'static mut Executor {
    BUS.init(Executor::new())
}

/// Sets the priorities of the interrupts that the HAL has enabled.
pub fn set_priorities() {
    interrupt::TIM1_BRK_TIM9.set_priority(Priority::P1);
    interrupt::CAN1_RX0.set_priority(Priority::P2);
    interrupt::CAN1_TX.set_priority(Priority::P3);
    interrupt::CAN1_SCE.set_priority(Priority::P3);
    // A pended request from before a warm reset must not run a handler early.
    NVIC::unpend(interrupt::TIM7);
}
