//! Power failures and damaged flash: how a robot starts with them.
//!
//! One emulated board without a group: parameters are saved over SDO, the power fails or the flash
//! is changed, and the next board starts with that flash. From power-on to the end it must keep its
//! drivers off and its brake engaged. The measured reaction is the one that a master observes: the
//! time from power-on to the emergency message, or, where there is no error, to the boot-up
//! message.

use anyhow::{Context as _, bail, ensure};
use emulator::{Board, BoardConfig, CanFrame, Firmware, PinLevel, Port, StopKind};
use protocol::{Address, Fault, address as at, cob};
use sim::robot::emulated::{outputs, parameters, ready_board};

use super::image;
use super::measured::Measured;

/// How a cause is tried.
pub type Procedure = fn(&Firmware) -> anyhow::Result<Measured>;

const NODE: u8 = 2;
const SAVE: Address = Address::new(0x1010, 1);
/// Longest time for an answer, saving included, and for coming up, ns.
const ANSWER_NS: u64 = 1_500_000_000;
const UP_NS: u64 = 300_000_000;
/// What is saved first and second: a half track in m.
const FIRST: f32 = 0.4;
const SECOND: f32 = 0.5;
/// More than the table allows.
const TOO_MUCH: f32 = 99.0;
/// Every how many flash operations the power is cut.
const CUTS: usize = 8;

/// One board and what it has sent.
struct Robot {
    board: Board,
    /// Driver enable and brake release.
    outputs: [(Port, u8); 2],
    sent: Vec<(u64, CanFrame)>,
}

impl Robot {
    fn power_on(firmware: &Firmware, flash: &[u8]) -> anyhow::Result<Self> {
        let board = ready_board(firmware, flash).map_err(anyhow::Error::msg)?;
        Ok(Self {
            board,
            outputs: outputs(firmware).map_err(anyhow::Error::msg)?,
            sent: Vec::new(),
        })
    }

    /// Runs until a time, or until a frame with this identifier has been sent.
    fn run(
        &mut self,
        end_ns: u64,
        wanted: Option<u16>,
    ) -> Result<Option<CanFrame>, emulator::Stop> {
        while self.board.now_ns() < end_ns {
            self.board.run_until_request(end_ns)?;
            while let Some(frame) = self.board.can().begin() {
                self.board.can().transmitted();
                self.sent.push((self.board.now_ns(), frame));
                if wanted.is_some() && frame.standard_id() == wanted {
                    return Ok(Some(frame));
                }
            }
        }
        Ok(None)
    }

    /// Whether drivers are on or the brake is released: a pin that floats is pulled down on the
    /// board.
    fn is_live(&self) -> bool {
        self.outputs
            .map(|(port, pin)| self.board.output(port, pin))
            .contains(&PinLevel::High)
    }

    fn request(&mut self, request: [u8; 8]) -> Result<[u8; 8], anyhow::Error> {
        let frame = CanFrame::new(cob::sdo_request(NODE), &request).context("a frame")?;
        self.board.can().receive(&frame);
        let end = self.board.now_ns() + ANSWER_NS;
        let answer = self.run(end, Some(cob::sdo_response(NODE)))?;
        Ok(answer.context("no answer")?.data().try_into()?)
    }

    fn write(&mut self, to: Address, value: [u8; 4]) -> anyhow::Result<()> {
        let ([low, high], [a, b, c, d]) = (to.index.to_le_bytes(), value);
        let answer = self.request([0x23, low, high, to.sub, a, b, c, d])?;
        ensure!(
            answer[0] == 0x60,
            "the robot refuses to write {to}: {answer:02x?}"
        );
        Ok(())
    }

    fn half_track(&mut self) -> anyhow::Result<f32> {
        let [low, high] = at::HALF_TRACK.index.to_le_bytes();
        let [_, _, _, _, a, b, c, d] =
            self.request([0x40, low, high, at::HALF_TRACK.sub, 0, 0, 0, 0])?;
        Ok(f32::from_le_bytes([a, b, c, d]))
    }

    fn save(&mut self, half_track: f32) -> anyhow::Result<()> {
        self.write(at::HALF_TRACK, half_track.to_le_bytes())?;
        self.write(SAVE, *b"save")
    }

    /// Emergency messages: when, code, and what follows it.
    fn emergencies(&self) -> impl Iterator<Item = (u64, u16, [u8; 5])> {
        let emergency = Some(cob::emergency(NODE));
        let sent = self.sent.iter();
        sent.filter(move |(_, frame)| frame.standard_id() == emergency)
            .filter_map(|(at, frame)| match *frame.data() {
                [low, high, _, ref rest @ ..] => {
                    let code = u16::from_le_bytes([low, high]);
                    Some((*at, code, (*rest).try_into().ok()?))
                }
                _ => None,
            })
    }

    /// Comes up, tries to start by itself and on command, and must stay off. The time of the
    /// boot-up message, ns.
    fn stays_off(&mut self) -> anyhow::Result<u64> {
        for ns in (0..UP_NS).step_by(1_000_000) {
            self.run(ns, None)?;
            ensure!(!self.is_live(), "live {} ms after power-on", ns / 1_000_000);
        }
        let boot_up = Some(0x700 + u16::from(NODE));
        let mut sent = self.sent.iter();
        let boot_up = sent.find(|(_, frame)| frame.standard_id() == boot_up);
        let at = boot_up.context("the robot sends no boot-up message")?.0;
        let start = CanFrame::new(cob::NMT, &[1, 0]).context("a frame")?;
        self.board.can().receive(&start);
        for ms in 1..=100 {
            self.run(UP_NS + ms * 1_000_000, None)?;
            ensure!(!self.is_live(), "an NMT start switches its outputs on");
        }
        Ok(at)
    }
}

fn measured(at_ns: u64) -> Measured {
    let ms = at_ns as f64 / 1e6;
    Measured {
        reaction_ms: ms,
        emergency_ms: ms,
        rest_ms: 0.0,
        wheel_rate: None,
        way: None,
    }
}

/// A flash in which a first set has been saved.
fn with_first_set(firmware: &Firmware) -> anyhow::Result<Vec<u8>> {
    let blank = Board::new(firmware, BoardConfig::default()).flash();
    let mut robot = Robot::power_on(firmware, &blank)?;
    robot.run(UP_NS, None)?;
    robot.save(FIRST)?;
    Ok(robot.board.flash())
}

/// Cause 21: the power fails in the middle of saving a second set.
pub fn interrupted(firmware: &Firmware) -> anyhow::Result<Measured> {
    let flash = with_first_set(firmware)?;
    let mut whole = Robot::power_on(firmware, &flash)?;
    whole.run(UP_NS, None)?;
    whole.save(SECOND)?;
    let done = whole.board.flash_operations();
    let mut worst = 0;
    let mut found = [0, 0];
    for cut in (1..=done.programs + done.erases).step_by(CUTS) {
        let mut robot = Robot::power_on(firmware, &flash)?;
        robot.run(UP_NS, None)?;
        robot.board.cut_power_at_flash_operation(cut);
        match robot.save(SECOND) {
            Err(error) => match error.downcast_ref::<emulator::Stop>() {
                Some(stop) if stop.kind == StopKind::PowerCut => {}
                _ => return Err(error),
            },
            Ok(()) => bail!("operation {cut} does not happen"),
        }
        let mut robot = Robot::power_on(firmware, &robot.board.flash())?;
        worst = worst.max(robot.stays_off()?);
        match robot.half_track()? {
            FIRST => found[0] += 1,
            SECOND => found[1] += 1,
            other => bail!("cut in operation {cut}: half track {other}"),
        }
    }
    ensure!(found[0] > 0, "the power was never cut in time");
    Ok(measured(worst))
}

/// Cause 22: an image in order but for one value.
pub fn corrupt(firmware: &Firmware) -> anyhow::Result<Measured> {
    let mut flash = with_first_set(firmware)?;
    let sectors = parameters(firmware).map_err(anyhow::Error::msg)?;
    let sectors = flash.get_mut(sectors).context("no flash")?;
    let image = image::with(at::HALF_TRACK, TOO_MUCH);
    sectors.copy_from_slice(&image::sectors(&image, sectors.len())?);
    let mut robot = Robot::power_on(firmware, &flash)?;
    robot.stays_off()?;
    let [low, high] = at::HALF_TRACK.index.to_le_bytes();
    let named = [0, low, high, at::HALF_TRACK.sub, 0];
    let first = robot.emergencies().next().context("announces nothing")?;
    let (at_ns, code, info) = first;
    ensure!(
        code == Fault::ParametersCorrupt.code() && info == named,
        "the robot announces 0x{code:04X} {info:02x?}"
    );
    ensure!(
        robot.half_track()? != TOO_MUCH,
        "the robot uses an image that it has refused"
    );
    Ok(measured(at_ns))
}
