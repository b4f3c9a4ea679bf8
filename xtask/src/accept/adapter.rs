//! The emulated board behind an emulated serial adapter, in real time: the way that a real board
//! goes, with everything in it but the board.
//!
//! A thread has the board, its wires and its bus. It speaks slcan at a pseudo terminal, which the
//! master opens like any other serial device, and does what hands would do when it is asked to.
//! The board's clock follows that of this computer, so times are as good as this computer is free.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use acceptance::emulated::{EmulatedBench, Images, Mutation};
use acceptance::{Bench, Debugger, Image};
use anyhow::Context as _;
use can_text::slcan::{self, Channel, Step};
use sim::endpoint::terminal::Terminal;

use super::board::Hands;

/// How long the thread sleeps between two looks at the terminal.
const PAUSE: Duration = Duration::from_micros(200);
/// Serial number of the adapter.
const NUMBER: u32 = 0x0064;

/// What is asked of the thread.
enum Request {
    Flash(Image),
    PowerCycle,
    Short,
    TakeOut(Vec<u8>),
    Read(u32, usize),
    Write(u32, u32),
}

/// What it answers: the words of [`Request::Read`], and nothing to the others.
type Answer = anyhow::Result<Vec<u32>>;

/// The board, while it is served.
pub struct Adapter {
    path: PathBuf,
    requests: Option<Sender<Request>>,
    answers: Receiver<Answer>,
    thread: Option<JoinHandle<anyhow::Result<()>>>,
}

impl Adapter {
    /// Serves a board at a terminal of its own.
    ///
    /// # Errors
    /// When there are no terminals.
    pub fn start(images: Images, mutation: Option<&'static Mutation>) -> anyhow::Result<Self> {
        let path = std::env::temp_dir().join(format!("omnibus-accept-{}", std::process::id()));
        let terminal = Terminal::open(&path).context("cannot open a pseudo terminal")?;
        let (requests, asked) = mpsc::channel();
        let (answer, answers) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            serve(
                EmulatedBench::new(&images, mutation),
                terminal,
                &asked,
                &answer,
            )
        });
        Ok(Self {
            path,
            requests: Some(requests),
            answers,
            thread: Some(thread),
        })
    }

    /// The device that the master opens.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn ask(&mut self, request: Request) -> Answer {
        let gone = "the emulated adapter has stopped";
        self.requests.as_ref().context(gone)?.send(request)?;
        self.answers.recv().context(gone)?
    }
}

impl Hands for Adapter {
    fn flash(&mut self, image: Image) -> anyhow::Result<()> {
        self.ask(Request::Flash(image)).map(drop)
    }

    fn power_cycle(&mut self) -> anyhow::Result<()> {
        self.ask(Request::PowerCycle).map(drop)
    }

    fn short_the_bus(&mut self) -> anyhow::Result<()> {
        self.ask(Request::Short).map(drop)
    }

    fn take_out(&mut self, wires: &[u8]) -> anyhow::Result<()> {
        self.ask(Request::TakeOut(wires.to_vec())).map(drop)
    }

    fn debugger(&mut self) -> Option<&mut dyn Debugger> {
        Some(self)
    }
}

impl Debugger for Adapter {
    fn read(&mut self, address: u32, words: usize) -> anyhow::Result<Vec<u32>> {
        self.ask(Request::Read(address, words))
    }

    fn write(&mut self, address: u32, word: u32) -> anyhow::Result<()> {
        self.ask(Request::Write(address, word)).map(drop)
    }
}

impl Drop for Adapter {
    fn drop(&mut self) {
        self.requests = None;
        if let Some(Ok(Err(error))) = self.thread.take().map(JoinHandle::join) {
            eprintln!("the emulated adapter stopped: {error:#}");
        }
    }
}

/// Serves until no client can ask any more.
fn serve(
    mut bench: EmulatedBench<'_>,
    mut terminal: Terminal,
    asked: &Receiver<Request>,
    answer: &Sender<Answer>,
) -> anyhow::Result<()> {
    let mut channel = Channel::new(NUMBER);
    let (began, from_us) = (Instant::now(), bench.now_us());
    loop {
        match asked.try_recv() {
            Ok(request) => {
                let _ = answer.send(carry_out(&mut bench, &request));
            }
            Err(mpsc::TryRecvError::Disconnected) => return Ok(()),
            Err(mpsc::TryRecvError::Empty) => {}
        }
        terminal.fill();
        let (input, output) = terminal.bytes();
        for byte in input.drain(..) {
            match channel.push(byte) {
                Some(Step::Answer(line)) => output.extend_from_slice(line.as_bytes()),
                Some(Step::Flags) => output.extend_from_slice(slcan::flags_answer(0).as_bytes()),
                Some(Step::Send(frame)) => {
                    bench.send(&frame)?;
                    output.extend_from_slice(slcan::SENT);
                }
                None => {}
            }
        }
        let present = from_us + u64::try_from(began.elapsed().as_micros())?;
        while let Some((_, frame)) = bench.receive(present)? {
            if channel.is_open() {
                output.extend_from_slice(slcan::frame(&frame, None).as_bytes());
            }
        }
        terminal.flush();
        std::thread::sleep(PAUSE);
    }
}

/// Does what hands or a debugger would.
fn carry_out(bench: &mut EmulatedBench<'_>, request: &Request) -> Answer {
    match *request {
        Request::Flash(image) => bench.flash(image)?,
        Request::PowerCycle => bench.power_cycle()?,
        Request::Short => bench.force_bus_off()?,
        Request::TakeOut(ref wires) => bench.take_out(wires)?,
        Request::Read(address, words) => return Debugger::read(bench, address, words),
        Request::Write(address, word) => Debugger::write(bench, address, word)?,
    }
    Ok(Vec::new())
}
