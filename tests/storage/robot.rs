//! An emulated robot, spoken to by SDO and LSS.

use super::*;

pub struct Robot {
    pub board: Board,
    /// Every frame it sent.
    pub sent: Vec<CanFrame>,
    pub node: u16,
}

impl Robot {
    /// A robot that has just been switched on, and is waiting in PRE-OPERATIONAL.
    pub fn power_on(firmware: &Firmware, flash: &[u8]) -> Self {
        Self::power_on_as(firmware, flash, NODE)
    }

    /// The same of a robot that boots as another node than the switches say.
    pub fn power_on_as(firmware: &Firmware, flash: &[u8], node: u16) -> Self {
        let board = sim::robot::emulated::ready_board(firmware, flash).unwrap();
        let sent = Vec::new();
        let mut robot = Self { board, sent, node };
        let boot_up = 0x700 + node;
        let end = robot.board.now_ns() + BOOT_NS;
        robot.run(end, |frame| frame.id_is(boot_up)).unwrap();
        let log = robot.board.take_log();
        let sent = &robot.sent;
        assert!(sent.iter().any(|frame| frame.id_is(boot_up)), "{log:#?}");
        robot
    }

    /// Runs until a time or until the robot has sent a frame that is waited for.
    pub fn run(
        &mut self,
        end_ns: u64,
        waited_for: impl Fn(&CanFrame) -> bool,
    ) -> Result<Option<CanFrame>, Stop> {
        while self.board.now_ns() < end_ns {
            self.board.run_until_request(end_ns)?;
            while let Some(frame) = self.board.can().begin() {
                self.board.can().transmitted();
                self.sent.push(frame);
                if waited_for(&frame) {
                    return Ok(Some(frame));
                }
            }
        }
        Ok(None)
    }

    pub fn send(&mut self, id: u16, data: &[u8]) {
        let frame = CanFrame::new(id, data).unwrap();
        self.board.can().receive(&frame);
    }

    pub fn wait_ms(&mut self, ms: u64) {
        let end = self.board.now_ns() + ms * 1_000_000;
        self.run(end, |_| false).unwrap();
    }

    pub fn request(&mut self, request: [u8; 8]) -> Result<[u8; 8], Stop> {
        self.send(0x600 + self.node, &request);
        let end = self.board.now_ns() + ANSWER_NS;
        let response = 0x580 + self.node;
        let answer = self.run(end, |frame| frame.id_is(response))?;
        let Some(answer) = answer else {
            panic!("no answer: {:#?}", self.board.take_log());
        };
        Ok(answer.data().try_into().unwrap())
    }

    /// An LSS request that must be answered by its own command and no error.
    pub fn lss(&mut self, request: [u8; 8]) {
        self.send(0x7E5, &request);
        let end = self.board.now_ns() + ANSWER_NS;
        let answer = self.run(end, |frame| {
            frame.id_is(0x7E4) && frame.data()[0] == request[0]
        });
        let answer = answer.unwrap().expect("an answer");
        assert_eq!(answer.data()[..2], [request[0], 0]);
    }

    /// Writes up to four bytes; an abort comes back as its code.
    pub fn write(&mut self, to: Address, value: &[u8]) -> Result<Result<(), u32>, Stop> {
        let [low, high] = to.index.to_le_bytes();
        let mut request = [
            0x23 | (4 - value.len() as u8) << 2,
            low,
            high,
            to.sub,
            0,
            0,
            0,
            0,
        ];
        request[4..4 + value.len()].copy_from_slice(value);
        let [command, _, _, _, a, b, c, d] = self.request(request)?;
        Ok(match command {
            0x60 => Ok(()),
            _ => Err(u32::from_le_bytes([a, b, c, d])),
        })
    }

    /// Writes more than four bytes, in segments.
    pub fn write_block(&mut self, to: Address, value: &[u8]) {
        let [low, high] = to.index.to_le_bytes();
        let length = value.len() as u8;
        let answer = self.request([0x21, low, high, to.sub, length, 0, 0, 0]);
        assert_eq!(answer.unwrap()[0], 0x60);
        let segments = value.chunks(7);
        let last = segments.len() - 1;
        for (nth, segment) in segments.enumerate() {
            let mut request = [0; 8];
            let toggle = (nth as u8 & 1) << 4;
            request[0] = toggle | (7 - segment.len() as u8) << 1 | u8::from(nth == last);
            request[1..=segment.len()].copy_from_slice(segment);
            let answer = self.request(request).unwrap();
            assert_eq!(answer[0], 0x20 | toggle, "{answer:02x?}");
        }
    }

    pub fn read(&mut self, from: Address) -> u32 {
        let [low, high] = from.index.to_le_bytes();
        let answer = self
            .request([0x40, low, high, from.sub, 0, 0, 0, 0])
            .unwrap();
        let [command, _, _, _, a, b, c, d] = answer;
        assert_eq!(command & 0xE3, 0x43, "{from:?}: expedited, with its length");
        let length = 4 - u32::from(command >> 2 & 3);
        u32::from_le_bytes([a, b, c, d]) & (u32::MAX >> (32 - 8 * length))
    }

    /// Reads in segments.
    pub fn read_block(&mut self, from: Address) -> Vec<u8> {
        let [low, high] = from.index.to_le_bytes();
        let answer = self.request([0x40, low, high, from.sub, 0, 0, 0, 0]);
        let [command, _, _, _, a, b, c, d] = answer.unwrap();
        if command == 0x42 {
            return Vec::new();
        }
        assert_eq!(command, 0x41, "{from:?}: with its length");
        let length = u32::from_le_bytes([a, b, c, d]) as usize;
        let mut bytes = Vec::new();
        for nth in 0_u8.. {
            let toggle = (nth & 1) << 4;
            let answer = self.request([0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]).unwrap();
            let unused = usize::from(answer[0] >> 1 & 7);
            bytes.extend(&answer[1..8 - unused]);
            if answer[0] & 1 != 0 {
                break;
            }
        }
        assert_eq!(bytes.len(), length);
        bytes
    }

    /// The fault memory, the newest first.
    pub fn stored_faults(&mut self) -> Vec<StoredFault> {
        let bytes = self.read_block(at::STORED_FAULTS);
        let (faults, rest) = bytes.as_chunks();
        assert!(rest.is_empty());
        faults.iter().map(StoredFault::decode).collect()
    }

    pub fn set(&mut self, set: Set) {
        for (address, value) in set.values() {
            let length = if address == HEARTBEAT { 2 } else { 4 };
            let value = value.to_le_bytes();
            self.write(address, &value[..length]).unwrap().unwrap();
        }
    }

    pub fn save(&mut self) -> Result<(), Stop> {
        self.write(SAVE, b"save").map(|answer| answer.unwrap())
    }

    /// Which of the two sets it has; a mixture fails.
    pub fn found(&mut self) -> Option<Set> {
        let found = Set::default_values().map(|(address, _)| (address, self.read(address)));
        [Some(Set(1)), Some(Set(2)), None]
            .into_iter()
            .find(|set| match set {
                Some(set) => found == set.values(),
                None => found == Set::default_values(),
            })
            .unwrap_or_else(|| panic!("a mixture: {found:x?}"))
    }
}

pub trait Id {
    fn id_is(&self, id: u16) -> bool;
}

impl Id for CanFrame {
    fn id_is(&self, id: u16) -> bool {
        self.standard_id() == Some(id)
    }
}
