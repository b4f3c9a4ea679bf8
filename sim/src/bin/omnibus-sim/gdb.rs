//! GDB at the emulated board: the remote serial protocol, as far as a Cortex-M needs it, by the
//! crate gdbstub.
//!
//! The core waits at its first instruction until GDB is there. Whenever GDB has stopped the core,
//! the world stands still: no watchdog bites, no master gives up. Breakpoints are the emulator's
//! own and change nothing in flash. `monitor reset` presses the reset button. When GDB leaves, the
//! robot goes on, and GDB may come back.

use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use emulator::CoreRegisters;
use gdbstub::arch::{Arch, Registers};
use gdbstub::common::Signal;
use gdbstub::conn::ConnectionExt as _;
use gdbstub::stub::run_blocking::{BlockingEventLoop, Event, WaitForStopReasonError};
use gdbstub::stub::{DisconnectReason, GdbStub, SingleThreadStopReason};
use gdbstub::target::ext::base::BaseOps;
use gdbstub::target::ext::base::singlethread::{
    SingleThreadBase, SingleThreadResume, SingleThreadResumeOps, SingleThreadSingleStep,
    SingleThreadSingleStepOps,
};
use gdbstub::target::ext::breakpoints::{
    Breakpoints, BreakpointsOps, HwBreakpoint, HwBreakpointOps, HwWatchpoint, HwWatchpointOps,
    SwBreakpoint, SwBreakpointOps, WatchKind,
};
use gdbstub::target::ext::monitor_cmd::{ConsoleOutput, MonitorCmd, MonitorCmdOps, outputln};
use gdbstub::target::{Target, TargetError, TargetResult};

use crate::bench::Bench;
use crate::output::{print_line, print_note};

/// Virtual time between two looks at whether the core has stopped, ns: what the rest of the world
/// may go on after it.
const SLICE_NS: u64 = 20_000;
/// Between two looks at whether GDB has come or left, ns.
const GLANCE_NS: u64 = 1_000_000;

/// Listens for debuggers at a port of this machine, or at HOST:PORT.
pub fn listen(at: &str) -> anyhow::Result<TcpListener> {
    let address = if at.contains(':') {
        at.to_owned()
    } else {
        format!("127.0.0.1:{at}")
    };
    let listener = TcpListener::bind(&address)
        .with_context(|| format!("--gdb {at}: cannot listen on {address}; give a free port"))?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves one debugger after another.
pub fn serve(
    bench: &mut Bench,
    listener: &TcpListener,
    until_ns: u64,
    stop: &AtomicBool,
) -> anyhow::Result<()> {
    print_line(format_args!("gdb {}", listener.local_addr()?))?;
    let mut session = Session {
        bench,
        until_ns,
        stop,
        single: false,
    };
    let mut first = true;
    while !session.ended() {
        match listener.accept() {
            Ok((stream, _)) => {
                stream.set_nonblocking(false)?;
                stream.set_nodelay(true)?;
                session.debug(stream)?;
                first = false;
            }
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                if first {
                    std::thread::sleep(Duration::from_millis(20));
                } else {
                    session.bench.advance(GLANCE_NS)?;
                }
            }
            Err(error) => return Err(error).context("--gdb: the port has failed"),
        }
    }
    Ok(())
}

/// What GDB debugs.
struct Session<'a> {
    bench: &'a mut Bench,
    until_ns: u64,
    stop: &'a AtomicBool,
    /// The core was let go for one instruction.
    single: bool,
}

impl Session<'_> {
    fn ended(&self) -> bool {
        self.bench.world.now_ns() >= self.until_ns || self.stop.load(Ordering::Relaxed)
    }

    /// One debugger, until it leaves.
    fn debug(&mut self, stream: TcpStream) -> anyhow::Result<()> {
        self.bench.board()?.debug_stop();
        let peer = stream.peer_addr()?;
        print_note(format_args!("gdb: {peer} has connected"));
        match GdbStub::new(stream).run_blocking::<Loop<'_>>(self) {
            Ok(DisconnectReason::Kill) => self.stop.store(true, Ordering::Relaxed),
            Ok(_) => print_note(format_args!("gdb: {peer} has detached")),
            Err(error) if error.is_connection_error() => {
                print_note(format_args!("gdb: {peer} has closed the connection"))
            }
            Err(error) => {
                let text = error.to_string();
                return Err(error.into_target_error().unwrap_or_else(|| anyhow!(text)));
            }
        }
        self.bench.board()?.debug_resume(false);
        Ok(())
    }

    fn go(&mut self, single: bool) -> Result<(), anyhow::Error> {
        self.single = single;
        self.bench.board()?.debug_resume(single);
        Ok(())
    }
}

/// ARMv7-M as GDB's feature "org.gnu.gdb.arm.m-profile" describes it.
enum CortexM {}

#[derive(Debug, Clone, PartialEq, Default)]
struct Core {
    r: [u32; 16],
    xpsr: u32,
}

impl Arch for CortexM {
    type Usize = u32;
    type Registers = Core;
    type BreakpointKind = usize;
    type RegId = ();

    fn target_description_xml() -> Option<&'static str> {
        Some(
            r#"<?xml version="1.0"?><!DOCTYPE target SYSTEM "gdb-target.dtd"><target version="1.0">
<architecture>arm</architecture><feature name="org.gnu.gdb.arm.m-profile">
<reg name="r0" bitsize="32"/><reg name="r1" bitsize="32"/><reg name="r2" bitsize="32"/>
<reg name="r3" bitsize="32"/><reg name="r4" bitsize="32"/><reg name="r5" bitsize="32"/>
<reg name="r6" bitsize="32"/><reg name="r7" bitsize="32"/><reg name="r8" bitsize="32"/>
<reg name="r9" bitsize="32"/><reg name="r10" bitsize="32"/><reg name="r11" bitsize="32"/>
<reg name="r12" bitsize="32"/><reg name="sp" bitsize="32" type="data_ptr"/>
<reg name="lr" bitsize="32"/><reg name="pc" bitsize="32" type="code_ptr"/>
<reg name="xpsr" bitsize="32" regnum="25"/></feature></target>"#,
        )
    }
}

impl Registers for Core {
    type ProgramCounter = u32;

    fn pc(&self) -> u32 {
        self.r[15]
    }

    fn gdb_serialize(&self, mut write_byte: impl FnMut(Option<u8>)) {
        for word in self.r.iter().chain([&self.xpsr]) {
            for byte in word.to_le_bytes() {
                write_byte(Some(byte));
            }
        }
    }

    fn gdb_deserialize(&mut self, bytes: &[u8]) -> Result<(), ()> {
        let (words, rest) = bytes.as_chunks::<4>();
        if words.len() != 17 || !rest.is_empty() {
            return Err(());
        }
        for (to, word) in self.r.iter_mut().chain([&mut self.xpsr]).zip(words) {
            *to = u32::from_le_bytes(*word);
        }
        Ok(())
    }
}

impl Target for Session<'_> {
    type Arch = CortexM;
    type Error = anyhow::Error;

    fn base_ops(&mut self) -> BaseOps<'_, CortexM, anyhow::Error> {
        BaseOps::SingleThread(self)
    }

    fn support_breakpoints(&mut self) -> Option<BreakpointsOps<'_, Self>> {
        Some(self)
    }

    fn support_monitor_cmd(&mut self) -> Option<MonitorCmdOps<'_, Self>> {
        Some(self)
    }
}

impl SingleThreadBase for Session<'_> {
    fn read_registers(&mut self, regs: &mut Core) -> TargetResult<(), Self> {
        let CoreRegisters { r, xpsr } = self.bench.board().map_err(TargetError::Fatal)?.registers();
        *regs = Core { r, xpsr };
        Ok(())
    }

    fn write_registers(&mut self, regs: &Core) -> TargetResult<(), Self> {
        let Core { r, xpsr } = *regs;
        let board = self.bench.board().map_err(TargetError::Fatal)?;
        board.set_registers(&CoreRegisters { r, xpsr });
        Ok(())
    }

    fn read_addrs(&mut self, start: u32, data: &mut [u8]) -> TargetResult<usize, Self> {
        let board = self.bench.board().map_err(TargetError::Fatal)?;
        let mut count = 0;
        for (address, to) in (start..).zip(data) {
            let Some(byte) = board.debug_read(address) else {
                break;
            };
            *to = byte;
            count += 1;
        }
        if count == 0 {
            return Err(TargetError::NonFatal);
        }
        Ok(count)
    }

    fn write_addrs(&mut self, start: u32, data: &[u8]) -> TargetResult<(), Self> {
        let board = self.bench.board().map_err(TargetError::Fatal)?;
        board.debug_write(start, data).ok_or(TargetError::NonFatal)
    }

    fn support_resume(&mut self) -> Option<SingleThreadResumeOps<'_, Self>> {
        Some(self)
    }
}

impl SingleThreadResume for Session<'_> {
    fn resume(&mut self, _: Option<Signal>) -> Result<(), anyhow::Error> {
        self.go(false)
    }

    fn support_single_step(&mut self) -> Option<SingleThreadSingleStepOps<'_, Self>> {
        Some(self)
    }
}

impl SingleThreadSingleStep for Session<'_> {
    fn step(&mut self, _: Option<Signal>) -> Result<(), anyhow::Error> {
        self.go(true)
    }
}

impl Breakpoints for Session<'_> {
    fn support_sw_breakpoint(&mut self) -> Option<SwBreakpointOps<'_, Self>> {
        Some(self)
    }

    fn support_hw_breakpoint(&mut self) -> Option<HwBreakpointOps<'_, Self>> {
        Some(self)
    }

    fn support_hw_watchpoint(&mut self) -> Option<HwWatchpointOps<'_, Self>> {
        Some(self)
    }
}

impl SwBreakpoint for Session<'_> {
    fn add_sw_breakpoint(&mut self, address: u32, _: usize) -> TargetResult<bool, Self> {
        self.bench
            .board()
            .map_err(TargetError::Fatal)?
            .add_breakpoint(address);
        Ok(true)
    }

    fn remove_sw_breakpoint(&mut self, address: u32, _: usize) -> TargetResult<bool, Self> {
        Ok(self
            .bench
            .board()
            .map_err(TargetError::Fatal)?
            .remove_breakpoint(address))
    }
}

impl HwBreakpoint for Session<'_> {
    fn add_hw_breakpoint(&mut self, address: u32, kind: usize) -> TargetResult<bool, Self> {
        self.add_sw_breakpoint(address, kind)
    }

    fn remove_hw_breakpoint(&mut self, address: u32, kind: usize) -> TargetResult<bool, Self> {
        self.remove_sw_breakpoint(address, kind)
    }
}

/// Changes of RAM are watched; reads, and registers of peripherals, are not.
impl HwWatchpoint for Session<'_> {
    fn add_hw_watchpoint(
        &mut self,
        address: u32,
        length: u32,
        kind: WatchKind,
    ) -> TargetResult<bool, Self> {
        let board = self.bench.board().map_err(TargetError::Fatal)?;
        Ok(kind == WatchKind::Write && board.add_watchpoint(address, length as usize).is_some())
    }

    fn remove_hw_watchpoint(
        &mut self,
        address: u32,
        length: u32,
        _: WatchKind,
    ) -> TargetResult<bool, Self> {
        let board = self.bench.board().map_err(TargetError::Fatal)?;
        Ok(board.remove_watchpoint(address, length as usize))
    }
}

impl MonitorCmd for Session<'_> {
    fn handle_monitor_cmd(
        &mut self,
        command: &[u8],
        mut out: ConsoleOutput<'_>,
    ) -> Result<(), anyhow::Error> {
        match command.trim_ascii() {
            b"reset" => {
                let board = self.bench.board()?;
                board.press_reset();
                board.debug_stop();
                outputln!(out, "reset");
            }
            b"time" => outputln!(out, "{:.6} s", self.bench.world.now_ns() as f64 * 1e-9),
            _ => outputln!(out, "monitor reset | time"),
        }
        Ok(())
    }
}

/// Lets the world go on until the core stops or GDB has something to say.
struct Loop<'a>(std::marker::PhantomData<&'a ()>);

impl<'a> BlockingEventLoop for Loop<'a> {
    type Target = Session<'a>;
    type Connection = TcpStream;
    type StopReason = SingleThreadStopReason<u32>;

    fn wait_for_stop_reason(
        target: &mut Session<'a>,
        connection: &mut TcpStream,
    ) -> Result<
        Event<SingleThreadStopReason<u32>>,
        WaitForStopReasonError<anyhow::Error, std::io::Error>,
    > {
        let mut glance_ns = 0;
        loop {
            let now_ns = target.bench.world.now_ns();
            if now_ns >= glance_ns {
                glance_ns = now_ns + GLANCE_NS;
                if connection
                    .peek()
                    .map_err(WaitForStopReasonError::Connection)?
                    .is_some()
                {
                    let byte = connection
                        .read()
                        .map_err(WaitForStopReasonError::Connection)?;
                    return Ok(Event::IncomingData(byte));
                }
                if target.ended() {
                    return Ok(Event::TargetStopped(SingleThreadStopReason::Exited(0)));
                }
            }
            target
                .bench
                .advance(SLICE_NS)
                .map_err(WaitForStopReasonError::Target)?;
            let board = target
                .bench
                .board()
                .map_err(WaitForStopReasonError::Target)?;
            if board.is_debug_stopped() {
                let changed = board.take_watched_change();
                let kind = WatchKind::Write;
                return Ok(Event::TargetStopped(match changed {
                    Some(addr) => SingleThreadStopReason::Watch {
                        tid: (),
                        kind,
                        addr,
                    },
                    None if target.single => SingleThreadStopReason::DoneStep,
                    None => SingleThreadStopReason::SwBreak(()),
                }));
            }
        }
    }

    fn on_interrupt(
        target: &mut Session<'a>,
    ) -> Result<Option<SingleThreadStopReason<u32>>, anyhow::Error> {
        target.bench.board()?.debug_stop();
        Ok(Some(SingleThreadStopReason::Signal(Signal::SIGINT)))
    }
}
