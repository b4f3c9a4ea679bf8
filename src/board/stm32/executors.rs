//! The two executors.
//!
//! The bus side runs in thread mode, at the lowest priority. The control side runs in the interrupt
//! of TIM7, which its ticks wait for (`tick`). Whatever the bus side is doing, a control tick
//! interrupts it. The priorities, strongest first:
//!
//! | priority | interrupt | why |
//! |---|---|---|
//! | 0 | PVD (supply of the chip) | cuts the outputs and does not return |
//! | 1 | TIM9 (time), where the chip has it | counts on, wakes the slow tasks; a few microseconds at most |
//! | 2 | EXTI9_5, EXTI15_10 (index of wheels) | read the counters or the time at the edge; about 50 instructions, once a wheel and tick at most |
//! | 2 | CAN1 receive, transmit | take the time of a frame; must not wait for a control tick, nor hold it up |
//! | 3 | CAN1 errors | save the error counters; wake the bus task |
//! | 6 | TIM7 (control executor) | the control tick |
//! | 6 | CAN2 receive | takes a report of a smart drive, where they turn the wheels; a tick and a report wait for each other |
//! | 7 | CAN1_RX1, of a FIFO that is not used | does what a frame asks for: queue, cable, bus task; may wait for a control tick |
//! | 7 | USART2, DMA1 streams 5 and 6 (cable) | waits for a control tick; the rings last for two of them |
//! | - | thread mode | the bus side |

#![expect(unsafe_code, reason = "an interrupt handler is called by the hardware")]

use cortex_m::peripheral::NVIC;
use embassy_executor::{Executor, InterruptExecutor, SendSpawner};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use static_cell::StaticCell;

use super::tick;
use crate::board::family::bxcan::{CAN1_RX0, CAN1_RX1, CAN1_SCE, CAN1_TX};
use crate::board::family::time;

static CONTROL: InterruptExecutor = InterruptExecutor::new();
static BUS: StaticCell<Executor> = StaticCell::new();

/// Starts the control executor and returns its spawner.
pub fn start_control() -> SendSpawner {
    interrupt::TIM7.set_priority(Priority::P6);
    CONTROL.start(interrupt::TIM7)
}

/// Returns the executor of the bus side. To be called once.
pub fn bus() -> &'static mut Executor {
    BUS.init(Executor::new())
}

#[interrupt]
unsafe fn TIM7() {
    tick::over();
    time::tick();
    // SAFETY: this is the interrupt the executor was started on, and nothing else calls it.
    unsafe { CONTROL.on_interrupt() }
}

/// Sets the priorities of the interrupts that the HAL has enabled.
pub fn set_priorities() {
    time::set_priority();
    CAN1_RX0.set_priority(Priority::P2);
    CAN1_TX.set_priority(Priority::P2);
    CAN1_RX1.set_priority(Priority::P7);
    CAN1_SCE.set_priority(Priority::P3);
    // A pended request from before a warm reset must not run a handler early.
    NVIC::unpend(interrupt::TIM7);
}
