//! The `emulate` command as a program beside it sees it: its log, its end, and GDB's remote
//! protocol (the GDB manual, appendix E). Needs the image: `cargo xtask test` builds it, switches
//! these tests on and names it in `OMNIBUS_ELF`.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use emulator::{Board, BoardConfig, Firmware};

fn elf() -> String {
    std::env::var("OMNIBUS_ELF")
        .expect("OMNIBUS_ELF names a release image; cargo xtask test sets it")
}

/// A running command; it ends with the test, however that ends.
struct Emulated {
    child: Child,
    lines: BufReader<ChildStdout>,
}

impl Drop for Emulated {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Emulated {
    fn new(arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
            .args(["emulate", &elf()])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap());
        Self { child, lines }
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.lines.read_line(&mut line).unwrap();
        line
    }

    /// Sends what Ctrl-C does.
    fn interrupt(&self) {
        let pid = self.child.id().to_string();
        let sent = Command::new("kill").args(["-INT", &pid]).status().unwrap();
        assert!(sent.success());
    }

    /// Waits for the end; whether it was a good one, and what was said on standard error.
    fn ended(mut self) -> (bool, String) {
        let mut output = String::new();
        let mut errors = self.child.stderr.take().unwrap();
        errors.read_to_string(&mut output).unwrap();
        (self.child.wait().unwrap().success(), output)
    }
}

/// A debugger of a few packets.
struct Gdb(BufReader<TcpStream>);

/// Registers as the target's description orders them.
type Registers = [u32; 17];
const R0: usize = 0;
const SP: usize = 13;
const PC: usize = 15;

impl Gdb {
    fn connect(emulated: &mut Emulated) -> Self {
        let line = emulated.line();
        let stream = TcpStream::connect(line.trim().strip_prefix("gdb ").unwrap()).unwrap();
        // Only so that a failure ends; nothing depends on how long anything takes.
        stream
            .set_read_timeout(Some(Duration::from_secs(60)))
            .unwrap();
        Self(BufReader::new(stream))
    }

    fn send(&mut self, packet: &str) {
        let sum = packet.bytes().fold(0u8, u8::wrapping_add);
        let packet = format!("${packet}#{sum:02x}");
        self.0.get_mut().write_all(packet.as_bytes()).unwrap();
    }

    /// The next packet from the target, acknowledged.
    fn reply(&mut self) -> String {
        self.0.read_until(b'$', &mut Vec::new()).unwrap();
        let (mut text, mut sum) = (Vec::new(), [0; 2]);
        self.0.read_until(b'#', &mut text).unwrap();
        self.0.read_exact(&mut sum).unwrap();
        text.pop();
        let right = text.iter().copied().fold(0u8, u8::wrapping_add);
        assert_eq!(String::from_utf8_lossy(&sum), format!("{right:02x}"));
        self.0.get_mut().write_all(b"+").unwrap();
        unpacked(&text)
    }

    fn ask(&mut self, packet: &str) -> String {
        self.send(packet);
        self.reply()
    }

    fn registers(&mut self) -> Registers {
        let bytes = bytes(&self.ask("g"));
        let (words, rest) = bytes.as_chunks::<4>();
        assert!(rest.is_empty());
        let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
        words.try_into().unwrap()
    }

    fn set_registers(&mut self, registers: &Registers) {
        let hex = registers.iter().flat_map(|word| word.to_le_bytes());
        let hex: String = hex.map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(self.ask(&format!("G{hex}")), "OK");
    }

    fn word(&mut self, address: u32) -> u32 {
        let bytes = bytes(&self.ask(&format!("m{address:x},4")));
        u32::from_le_bytes(bytes.try_into().unwrap())
    }
}

/// A packet with its repetitions written out: `0*"` are five zeros.
fn unpacked(packet: &[u8]) -> String {
    let mut text = String::new();
    let mut rest = packet.iter();
    while let Some(&byte) = rest.next() {
        if byte == b'*' {
            let last = text.chars().last().unwrap();
            let more = rest.next().unwrap() - 29;
            text.extend(std::iter::repeat_n(last, usize::from(more)));
        } else {
            text.push(char::from(byte));
        }
    }
    text
}

fn bytes(hex: &str) -> Vec<u8> {
    assert!(hex.len().is_multiple_of(2), "{hex}");
    let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap_or_else(|_| panic!("{hex}"));
    (0..hex.len()).step_by(2).map(byte).collect()
}

/// A word of the image as it lies in flash.
fn in_flash(firmware: &Firmware, address: u32) -> u32 {
    let board = Board::new(firmware, BoardConfig::default());
    board.read_word(address).unwrap()
}

fn function(firmware: &Firmware, name: &str) -> u32 {
    let found = firmware.functions().iter().find(|f| f.name == name);
    found.unwrap_or_else(|| panic!("no {name}")).address
}

#[test]
fn the_log_is_on_the_terminal_and_a_signal_ends_it() {
    let mut emulated = Emulated::new(&["--speed", "max"]);
    assert_eq!(emulated.line(), "node 2\n");
    let line = emulated.line();
    let [seconds, level, ..] = &*line.split_whitespace().collect::<Vec<_>>() else {
        panic!("{line}");
    };
    assert!(
        (0.001..0.02).contains(&seconds.parse::<f64>().unwrap()),
        "{line}"
    );
    assert_eq!(*level, "info");
    // The watchdog is set up before anything else.
    assert!(line.contains("watchdog: 50000 us typically"), "{line}");
    assert!(line.contains("src/board/stm32/iwdg.rs:"), "{line}");
    let line = emulated.line();
    assert!(line.contains("reset: Power, node 2"), "{line}");
    assert!(line.contains("src/start.rs:"), "{line}");
    emulated.interrupt();
    let (good, output) = emulated.ended();
    assert!(good, "{output}");
}

/// The robot boots, then time stands until a client waits for it.
#[test]
fn time_waits_for_a_lockstep_client() {
    let mut emulated = Emulated::new(&["--lockstep", "127.0.0.1:0", "--speed", "max"]);
    let announced = emulated.line();
    let address = announced.trim_end().strip_prefix("lockstep ").unwrap();
    let mut client = TcpStream::connect(address).unwrap();
    let mut answers = BufReader::new(client.try_clone().unwrap());
    let mut answer = || {
        let mut line = String::new();
        answers.read_line(&mut line).unwrap();
        line
    };
    assert_eq!(answer(), "omnibus-lockstep 1\n");
    assert_eq!(answer(), "n100000\n");
    std::thread::sleep(Duration::from_millis(300));
    client.write_all(b"w150000\n").unwrap();
    // Frames of the robot may come first, the robot's heartbeat among them.
    let time = loop {
        let line = answer();
        if let Some(time) = line.strip_prefix('n') {
            break time.trim_end().parse::<u64>().unwrap();
        }
        assert!(line.starts_with('f'), "{line}");
    };
    assert!((100_001..=150_000).contains(&time), "{time}");
}

/// A trace begins at once, and what a signal ends is complete: time stamps up to the end, and
/// Embassy's tasks by their names.
#[test]
fn a_trace_begins_soon_and_outlives_the_signal() {
    let file = std::env::temp_dir().join(format!("omnibus-trace-{}.vcd", std::process::id()));
    let began = Instant::now();
    let mut emulated = Emulated::new(&["--trace", file.to_str().unwrap()]);
    assert_eq!(emulated.line(), "node 2\n");
    let waited = began.elapsed();
    assert!(waited < Duration::from_secs(10), "{waited:?}");
    while !emulated.line().contains("stack:") {}
    emulated.interrupt();
    let (good, output) = emulated.ended();
    assert!(good, "{output}");
    let trace = std::fs::read_to_string(&file).unwrap();
    std::fs::remove_file(file).unwrap();
    let last = trace.lines().rev().find_map(|line| line.strip_prefix('#'));
    let last: u64 = last.unwrap().parse().unwrap();
    assert!(last > 1_000_000_000, "{last}");
    assert!(trace.contains("sbus "), "{trace}");
    assert!(trace.contains("scontrol "), "{trace}");
}

#[test]
fn a_debugger_finds_the_core_at_its_reset_vector() {
    let firmware = Firmware::load(elf()).unwrap();
    let mut emulated = Emulated::new(&["--gdb", "0"]);
    let mut gdb = Gdb::connect(&mut emulated);
    let registers = gdb.registers();
    assert_eq!(registers[SP], in_flash(&firmware, 0x0800_0000));
    assert_eq!(registers[PC], in_flash(&firmware, 0x0800_0004) & !1);
    assert_eq!(gdb.word(0x0800_0008), in_flash(&firmware, 0x0800_0008));
    // Where there is no memory there is nothing to read.
    assert_eq!(gdb.ask("m20000000,4").len(), 8);
    assert!(gdb.ask("m30000000,4").starts_with('E'));
    // RAM can be written, flash is not.
    assert_eq!(gdb.ask("M20000010,4:78563412"), "OK");
    assert_eq!(gdb.word(0x2000_0010), 0x1234_5678);
    assert!(gdb.ask("M08000000,4:78563412").starts_with('E'));
    // A peripheral's register: RCC_CR after reset, HSI on and ready with its trimming at 16 (RM0390
    // 6.3.1).
    assert_eq!(gdb.word(0x4002_3800) & 0xFFFF, 0x83);
    gdb.send("k");
    let (good, output) = emulated.ended();
    assert!(good, "{output}");
}

#[test]
fn a_debugger_breaks_steps_and_watches() {
    let firmware = Firmware::load(elf()).unwrap();
    let main = function(&firmware, "main");
    let mut emulated = Emulated::new(&["--gdb", "0"]);
    let mut gdb = Gdb::connect(&mut emulated);
    assert_eq!(gdb.ask(&format!("Z0,{main:x},2")), "OK");
    assert!(gdb.ask("c").starts_with("T05"));
    let stopped = gdb.registers();
    assert_eq!(stopped[PC], main);
    // cortex-m-rt's trampoline: push {r7, lr}; mov r7, sp.
    assert_eq!(gdb.ask("s"), "S05");
    let stepped = gdb.registers();
    assert_eq!((stepped[PC], stepped[SP]), (main + 2, stopped[SP] - 8));
    assert_eq!(gdb.word(stepped[SP] + 4), stopped[14]);
    assert_eq!(gdb.ask(&format!("z0,{main:x},2")), "OK");
    // The log's write pointer: it moves when the first message is there, and not before.
    let offset = firmware.variable("_SEGGER_RTT").unwrap().address + 24 + 12;
    assert_eq!(gdb.word(offset), 0);
    assert_eq!(gdb.ask(&format!("Z2,{offset:x},4")), "OK");
    let stop = gdb.ask("c");
    assert!(stop.contains(&format!("watch:{offset:x};")), "{stop}");
    assert_ne!(gdb.word(offset), 0);
    let pc = gdb.registers()[PC];
    assert!(firmware.location(pc).unwrap().contains("defmt"), "{pc:#x}");
    assert_eq!(gdb.ask(&format!("z2,{offset:x},4")), "OK");
    // Reads are not watched.
    assert!(gdb.ask(&format!("Z3,{offset:x},4")).starts_with('E'));
    // Ctrl-C stops it where it is.
    gdb.send("c");
    gdb.0.get_mut().write_all(&[3]).unwrap();
    assert_eq!(gdb.reply(), "S02");
    gdb.send("k");
    assert!(emulated.ended().0);
}

/// The core is sent to a load of the program's own with the address of a peripheral that is not
/// modelled.
#[test]
fn what_is_not_modelled_ends_it_with_address_and_source_line() {
    // DAC_CR (RM0390 14.5.1).
    const DAC: u32 = 0x4000_7400;
    let firmware = Firmware::load(elf()).unwrap();
    // ldr r0, [r0] (ARMv7-M ARM A7.7.43, T1), somewhere in the project's own code.
    let board = Board::new(&firmware, BoardConfig::default());
    let halfword = |at: u32| board.read_word(at & !3).unwrap() >> (8 * (at & 2)) & 0xFFFF;
    let own = |at: &u32| {
        halfword(*at) == 0x6800
            && firmware
                .location(*at)
                .is_some_and(|text| text.contains("src/"))
    };
    let functions = firmware.functions().iter();
    let place = functions
        .flat_map(|f| (f.address..f.address + f.size).step_by(2))
        .find(own)
        .unwrap();
    let mut emulated = Emulated::new(&["--gdb", "0"]);
    let mut gdb = Gdb::connect(&mut emulated);
    let mut registers = gdb.registers();
    registers[R0] = DAC;
    registers[PC] = place;
    gdb.set_registers(&registers);
    gdb.send("c");
    let (good, output) = emulated.ended();
    assert!(!good);
    assert!(output.contains("not modelled: read of"), "{output}");
    assert!(output.contains(&format!("{DAC:#010x}")), "{output}");
    let location = firmware.location(place).unwrap();
    assert!(output.contains(&location), "{output}: not {location}");
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let refused = |arguments: &[&str], word: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_omnibus-sim"))
            .args(arguments)
            .output()
            .unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(
            !output.status.success() && message.contains(word),
            "{message}"
        );
    };
    let elf = elf();
    refused(
        &["emulate", "no.elf"],
        "error: no.elf: cannot be read (No such file or directory (os error 2)); `cargo xtask \
         size` builds the firmware\n",
    );
    refused(&["emulate", &elf, "--duration", "0"], "--duration");
    refused(&["emulate", &elf, "--gdb", "none:0"], "--gdb none:0");
    let short = ["emulate", &elf, "--duration", "0.01"];
    for node in ["3", ""] {
        let at = format!("127.0.0.1:0@{node}");
        let word = format!("--lockstep @{node}: no robot of the group has this node");
        refused(&[&short[..], &["--lockstep", &at]].concat(), &word);
    }
    // Neither the image nor another output is written to.
    refused(
        &[&short[..], &["--trace", &elf]].concat(),
        "this is the image",
    );
    assert!(Firmware::load(&elf).is_ok());
    let log = std::env::temp_dir().join(format!("omnibus-older-{}", std::process::id()));
    std::fs::write(&log, "older").unwrap();
    let file = log.to_str().unwrap();
    for (trace, word) in [
        (file, "this is another output"),
        (
            "/nowhere/trace.vcd",
            "--trace /nowhere/trace.vcd: cannot be written",
        ),
    ] {
        let outputs = ["--log", file, "--trace", trace];
        refused(&[&short[..], &outputs].concat(), word);
        assert_eq!(std::fs::read_to_string(&log).unwrap(), "older", "{trace}");
    }
    std::fs::remove_file(log).unwrap();
    let three = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
    refused(&["emulate", &elf, "--group", three], "3 robots");
}
