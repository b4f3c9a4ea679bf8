//! Each form as the programs that speak it write it, there and back, and against nonsense.

use can_text::{candump, slcan, socketcand};
use canopen::Frame;
use proptest::prelude::*;
use slcan::{Answer, Answers, Command, Commands};

fn any_frame() -> impl Strategy<Value = Frame> {
    let data = prop::collection::vec(any::<u8>(), 0..=8);
    (0..=Frame::MAX_ID, data).prop_map(|(id, data)| Frame::new(id, &data).expect("a frame"))
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(id, data).expect("a frame")
}

mod slcan_form {
    use super::*;

    fn commands(bytes: &[u8]) -> Vec<Command> {
        let mut commands = Commands::new();
        bytes.iter().filter_map(|b| commands.push(*b)).collect()
    }

    fn answers(bytes: &[u8]) -> Vec<Answer> {
        let mut answers = Answers::new();
        bytes.iter().filter_map(|b| answers.push(*b)).collect()
    }

    #[test]
    fn golden_lines() {
        let sent = frame(0x181, &[0x10, 0xFF, 0x00]);
        assert_eq!(&*slcan::frame(&sent, None), "t181310FF00\r");
        assert_eq!(&*slcan::frame(&sent, Some(0xEA5F)), "t181310FF00EA5F\r");
        assert_eq!(&*slcan::frame(&frame(0x80, &[]), None), "t0800\r");
        assert_eq!(&*slcan::flags_answer(0xA2), "FA2\r");
        assert_eq!(Command::parse(b"t181310ff00"), Command::Send(sent));
        assert_eq!(Answer::parse(b"t181310FF00"), Answer::Frame(sent, None));
        let stamped = Answer::Frame(sent, Some(0x1234));
        assert_eq!(Answer::parse(b"t181310FF001234"), stamped);
    }

    /// What slcand -o -c -s8, python-can and this house's adapter begin and end with.
    #[test]
    fn commands_as_programs_send_them() {
        let open = [Command::Close, Command::Accept, Command::Open];
        assert_eq!(commands(b"C\rS8\rO\r"), open);
        assert_eq!(
            commands(b"\rL\rF\rV\rN\rZ1\rZ0\r"),
            [
                Command::Accept,
                Command::Listen,
                Command::Flags,
                Command::Version,
                Command::Serial,
                Command::Stamps(true),
                Command::Stamps(false),
            ]
        );
    }

    /// What an adapter with this number answers; frames it is to send count as sent.
    fn served(bytes: &[u8]) -> String {
        let mut channel = slcan::Channel::new(0x1234_0BEF);
        let mut lines = Vec::new();
        for byte in bytes {
            match channel.push(*byte) {
                Some(slcan::Step::Answer(line)) => lines.extend_from_slice(line.as_bytes()),
                Some(slcan::Step::Send(_)) => lines.extend_from_slice(slcan::SENT),
                Some(slcan::Step::Flags) => lines.extend_from_slice(b"F?"),
                None => {}
            }
        }
        String::from_utf8(lines).expect("ASCII")
    }

    #[test]
    fn a_channel_sends_when_it_is_open_and_only_then() {
        assert_eq!(served(b"t0800\rV\rN\r"), "\u{7}V1013\rN0BEF\r");
        assert_eq!(served(b"O\rt0800\rF\rx\r"), "\rz\rF?\u{7}");
        assert_eq!(
            served(b"L\rt0800\rO\rt0800\rC\rt0800\r"),
            "\r\u{7}\rz\r\r\u{7}"
        );
    }

    #[test]
    fn what_is_no_command_of_this_bus_is_refused() {
        for line in [
            "t",
            "t18",
            "t181",
            "t1812E8",
            "t1812E80304",
            "t8000",
            "t181900112233445566778",
            "t181F001122334455667788",
            "T000001811FF",
            "r1810",
            "R000001810",
            "S6",
            "S",
            "OO",
            "Z2",
            "AT",
            "x",
            "t18\u{e9}0",
            "t18x1FF",
            "t+811FF",
        ] {
            assert_eq!(Command::parse(line.as_bytes()), Command::Refuse, "{line}");
        }
    }

    /// The longest line is an extended frame with a time stamp; one more byte, and nothing of the
    /// line counts, however it goes on.
    #[test]
    fn a_line_that_is_too_long_is_refused_whole() {
        let mut text = b"O".repeat(slcan::LONGEST + 1);
        text.extend_from_slice(b"\rO\r");
        assert_eq!(commands(&text), [Command::Refuse, Command::Open]);
    }

    #[test]
    fn a_line_of_which_something_was_lost_is_refused() {
        let mut commands = Commands::new();
        assert_eq!(commands.push(b'O'), None);
        commands.spoil();
        assert_eq!(commands.push(b'\r'), Some(Command::Refuse));
        assert_eq!(commands.push(b'O'), None);
        assert_eq!(commands.push(b'\r'), Some(Command::Open));
    }

    #[test]
    fn answers_arrive_in_pieces_and_after_noise() {
        let mut answered = answers(b"\rz\r\x07V1013\rF20\rt08\x07t08010");
        let wanted = [
            Answer::Other,
            Answer::Sent,
            Answer::Refused,
            Answer::Other,
            Answer::Flags(0x20),
            Answer::Refused,
        ];
        assert_eq!(answered, wanted);
        answered = answers(b"t080105\r");
        assert_eq!(answered, [Answer::Frame(frame(0x80, &[5]), None)]);
    }

    #[test]
    fn what_is_no_frame_of_ours_is_other() {
        for line in [
            "t18",
            "t1812A",
            "t8001FF",
            "T0000018110",
            "r1810",
            "t18x1FF",
            "t\u{fc}\u{fc}\u{fc}",
            "t1819000000000000000000",
            "t1810123",
            "t181012345",
            "F2",
            "F200",
            "Fx0",
        ] {
            assert_eq!(Answer::parse(line.as_bytes()), Answer::Other, "{line}");
        }
    }

    proptest! {
        #[test]
        fn a_frame_is_the_same_for_both_ends(frame in any_frame(), stamp in 0..60_000_u16) {
            let line = slcan::frame(&frame, None);
            prop_assert_eq!(commands(line.as_bytes()), [Command::Send(frame)]);
            prop_assert_eq!(answers(line.as_bytes()), [Answer::Frame(frame, None)]);
            let line = slcan::frame(&frame, Some(stamp));
            prop_assert_eq!(answers(line.as_bytes()), [Answer::Frame(frame, Some(stamp))]);
        }

        /// After anything at all, a carriage return makes the next command whole.
        #[test]
        fn any_bytes_end_with_their_line(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let mut all = bytes;
            all.extend_from_slice(b"\rF\r");
            prop_assert_eq!(commands(&all).pop(), Some(Command::Flags));
            prop_assert_eq!(answers(&all).pop(), Some(Answer::Other));
        }
    }
}

mod socketcand_form {
    use super::*;
    use socketcand::{Messages, Request, parse_frame, send};

    fn received(at_us: u64, frame: &Frame) -> String {
        let mut text = String::new();
        socketcand::write_frame(&mut text, at_us, frame).expect("a string takes it");
        text
    }

    /// The form of socketcand's own source, blanks included.
    #[test]
    fn golden_messages() {
        let sent = frame(0x181, &[0xE8, 0x03]);
        assert_eq!(send(&sent), "< send 181 2 e8 03 >");
        assert_eq!(send(&frame(0x80, &[])), "< send 80 0 >");
        let text = received(12_000_345, &frame(0x81, &[0xE8, 3]));
        assert_eq!(text, "< frame 081 12.000345 E803 >");
        assert_eq!(received(0, &frame(0x80, &[])), "< frame 080 0.000000  >");
        assert_eq!(parse_frame("frame 181 12.345678 E803"), Some(sent));
        // Both spellings of data are in use.
        assert_eq!(parse_frame("frame 181 12.345678 e8 03"), Some(sent));
        assert_eq!(parse_frame("frame 080 0.0"), Some(frame(0x80, &[])));
    }

    #[test]
    fn anything_that_is_no_frame_of_ours_is_none() {
        for message in [
            "",
            "hi",
            "frame",
            "frame 181",
            "frame 00000181 1.0 00",
            "frame 8FF 1.0 00",
            "frame 181 1.0 0",
            "frame 181 1.0 GG",
            "frame 181 1.0 112233445566778899",
            "frame 181 1.0 \u{fc}\u{fc}",
            "error 5",
        ] {
            assert_eq!(parse_frame(message), None, "{message}");
        }
    }

    #[test]
    fn requests_as_clients_write_them() {
        let sent = frame(0x181, &[0xE8, 0x03]);
        for (text, wanted) in [
            ("open can0", Request::Open),
            ("rawmode", Request::Raw),
            ("echo", Request::Echo),
            ("send 181 2 e8 3", Request::Send(sent)),
            ("send 181 2 E8 03", Request::Send(sent)),
            ("send 080 0 ", Request::Send(frame(0x80, &[]))),
            ("send 00000181 0", Request::SendForeign),
        ] {
            assert_eq!(Request::parse(text), wanted, "{text}");
        }
    }

    #[test]
    fn what_is_no_request_is_refused() {
        for text in [
            "",
            "send 800 0",
            "send 181 2 1",
            "send 181 1 100",
            "send 181 9 1 2 3 4 5 6 7 8 9",
            "send 181",
            "send",
            "add 1 0 123 1 0",
            "open",
            "\u{e9}",
        ] {
            let request = Request::parse(text);
            assert!(matches!(request, Request::Refuse(_)), "{text}: {request:?}");
        }
    }

    #[test]
    fn messages_arrive_in_pieces_and_after_noise() {
        let mut messages = Messages::new();
        let mut found = Vec::new();
        let long = format!("<{}>", "x".repeat(socketcand::LONGEST));
        let text = format!("x > y < hi > <fr<frame 181 1.0 E8 >{long}<\u{fc}>< ok");
        for byte in text.bytes() {
            found.extend(messages.push(byte).map(str::to_owned));
        }
        assert_eq!(found, ["hi", "frame 181 1.0 E8", "", "\u{fc}"]);
        assert_eq!(messages.push(b'>'), Some("ok"));
        let invalid = [b'<', 0xFF, b'>'].map(|byte| messages.push(byte).map(str::to_owned));
        assert_eq!(invalid, [None, None, Some(String::new())]);
    }

    proptest! {
        #[test]
        fn a_frame_goes_there_and_back(frame in any_frame(), at_us in any::<u64>()) {
            let inside = |text: &str| text.trim_matches(['<', '>', ' ']).to_owned();
            prop_assert_eq!(parse_frame(&inside(&received(at_us, &frame))), Some(frame));
            prop_assert_eq!(Request::parse(&inside(&send(&frame))), Request::Send(frame));
        }

        #[test]
        fn any_text_is_taken(text in any::<String>()) {
            let _ = (parse_frame(&text), Request::parse(&text));
        }
    }
}

mod candump_form {
    use super::*;
    use candump::{Line, parse_line};

    fn written(at_ns: u64, frame: &Frame) -> String {
        let mut line = String::new();
        candump::write_line(&mut line, at_ns, "can0", frame).expect("a string takes it");
        line
    }

    #[test]
    fn a_line_is_what_candump_writes() {
        let line = written(12_000_345_678, &frame(0x81, &[0xE8, 0x03]));
        assert_eq!(line, "(12.000345) can0 081#E803\n");
        assert_eq!(written(0, &frame(0x80, &[])), "(0.000000) can0 080#\n");
        let mut error = String::new();
        let data = [0, 0, 2, 0, 0, 0, 0, 0];
        candump::write_error(&mut error, 0, "can0", 0x88, data).expect("a string takes it");
        assert_eq!(error, "(0.000000) can0 20000088#0000020000000000\n");
        let foreign = Line::Foreign {
            at_ns: 0,
            interface: "can0",
        };
        assert_eq!(parse_line(&error), foreign);
    }

    #[test]
    fn what_is_no_data_frame_with_a_base_identifier_is_foreign() {
        for text in [
            "12345678#00",
            "181#R",
            "181#R8",
            "181##100",
            "00000181#",
            // A DLC of 9 to 15, which candump writes behind the data.
            "181#0001020304050607_9",
            "00000181#0001020304050607_E",
            "181#R8_F",
        ] {
            let line = format!("(1.000001) vcan1 {text} R");
            let foreign = Line::Foreign {
                at_ns: 1_000_001_000,
                interface: "vcan1",
            };
            assert_eq!(parse_line(&line), foreign, "{text}");
        }
    }

    #[test]
    fn anything_else_is_bad() {
        for text in [
            "hello",
            "(1.) can0 080#",
            "(.5) can0 080#",
            "(1.0000000001) can0 080#",
            "(1.000000) can0",
            "(1.000000) can0 080",
            "(1.000000) can0 800#",
            "(1.000000) can0 080#0",
            "(1.000000) can0 080#000000000000000000",
            "(1.000000) can0 08#00",
            "(1.000000) can0 080#00_8",
            "(1.000000) can0 080#00_",
            "(1.000000) can0 080#00 X",
            "(1.000000) can0 080#00 R R",
            "(99999999999999999999.000000) can0 080#",
            "(+1.000000) can0 080#",
            "(1.+00000) can0 080#",
        ] {
            assert_eq!(parse_line(text), Line::Bad, "{text}");
        }
        assert_eq!(parse_line(" \n"), Line::Empty);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(frame in any_frame(), at_us in 0..1_u64 << 50) {
            let at_ns = at_us * 1_000;
            let wanted = Line::Frame { at_ns, interface: "can0", frame };
            let line = written(at_ns, &frame);
            prop_assert_eq!(parse_line(&line), wanted);
        }
    }
}
