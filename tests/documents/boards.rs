//! Pins, bit timing and interrupt priorities in the documents are those of the code.

use std::collections::{BTreeMap, BTreeSet};

use super::{files, read};

/// The board whose pins the documents describe.
const BOARD: &str = "src/board/nucleo_f446re.rs";

/// Port and number of every pin in a text, in order.
fn pins(text: &str) -> Vec<String> {
    let bytes = text.as_bytes();
    let mut found = Vec::new();
    for at in 0..bytes.len().saturating_sub(2) {
        let starts = at == 0 || !bytes[at - 1].is_ascii_alphanumeric();
        let pin = bytes[at] == b'P'
            && (b'A'..=b'I').contains(&bytes[at + 1])
            && bytes[at + 2].is_ascii_digit();
        if starts && pin {
            let number: String = text[at + 2..]
                .chars()
                .take_while(char::is_ascii_digit)
                .collect();
            found.push(format!("P{}{number}", bytes[at + 1] as char));
        }
    }
    found
}

/// What a row of a pin table is about; the first word that fits decides.
const FUNCTIONS: [(&str, &str); 16] = [
    ("gyro", "gyro"),
    ("index", "encoder index"),
    ("PWM", "PWM"),
    ("direction", "direction"),
    ("encoder", "encoder"),
    ("protective", "protective stop"),
    ("emergency", "emergency stop"),
    ("current", "motor current"),
    ("enable", "driver enable"),
    ("brake", "brake"),
    ("fault", "driver fault"),
    ("supply", "supply"),
    ("CAN", "CAN"),
    ("node", "node switches"),
    ("LED", "LED"),
    ("cable", "cable"),
];

/// Pins by function, from the first table whose head says `function`; `column` holds the pins.
/// Rows of one function add up, in their order.
fn pin_table(text: &str, column: usize) -> BTreeMap<&'static str, Vec<String>> {
    let table = pin_table_of("| function |", text, column);
    assert!(table.len() >= 10, "a table with few functions: {table:?}");
    table
}

/// The same from the first table whose head begins like this.
fn pin_table_of(head: &str, text: &str, column: usize) -> BTreeMap<&'static str, Vec<String>> {
    let mut table = BTreeMap::new();
    let rows = text
        .lines()
        .map(|line| line.trim_start_matches("//! "))
        .skip_while(|line| !line.starts_with(head))
        .take_while(|line| line.starts_with('|'))
        .skip(2);
    for row in rows {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let Some((_, function)) = FUNCTIONS.iter().find(|(word, _)| cells[0].contains(word)) else {
            continue;
        };
        table
            .entry(*function)
            .or_insert_with(Vec::new)
            .extend(pins(cells[column]));
    }
    table
}

/// What an image with two PWMs a wheel has elsewhere: in the code, at the head of the board's file
/// and in the page.
#[test]
fn pins_with_two_pwms_are_those_of_the_board() {
    let head = "| function with two PWMs |";
    let board = read(BOARD);
    let table = pin_table_of(head, &board, 2);
    assert_eq!(pin_table_of(head, &read("docs/bring-up.md"), 1), table);
    let (_, code) = board.split_once("#[cfg(feature = \"two-pwms\")]").unwrap();
    let (code, _) = code.split_once("..BRIDGES").unwrap();
    let mut in_table: Vec<String> = table.into_values().flatten().collect();
    // The first four are those of the other images.
    in_table.retain(|pin| !pin.starts_with("PA"));
    let mut in_code = pins(code);
    in_table.sort();
    in_code.sort();
    assert_eq!(in_code, in_table);
}

#[test]
fn pins_are_those_of_the_board() {
    let board = read(BOARD);
    let board_table = pin_table(&board, 2);
    let bring_up = pin_table(&read("docs/bring-up.md"), 1);
    let mut readme = pin_table(&read("README.md"), 1);
    // On the board, with nothing to wire.
    for function in ["LED", "cable"] {
        readme.insert(function, board_table[function].clone());
    }
    assert_eq!(
        bring_up, board_table,
        "docs/bring-up.md against the head of {BOARD}"
    );
    assert_eq!(readme, board_table, "README.md against the head of {BOARD}");
}

#[test]
fn the_table_of_a_board_is_that_of_its_code() {
    for board in [
        BOARD,
        "src/board/robomaster_c.rs",
        "src/board/kit_f103rc.rs",
        "src/board/nucleo_g474re.rs",
    ] {
        let text = read(board);
        let table = pin_table(&text, 2);
        let code: Vec<String> = text
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"))
            .flat_map(pins)
            .collect();
        for (function, expected) in &table {
            let there = code
                .windows(expected.len())
                .any(|window| window == expected.as_slice());
            assert!(
                there,
                "{function}: {expected:?} in the table of {board}, not in its code"
            );
        }
        let in_table: BTreeSet<&String> = table.values().flatten().collect();
        for pin in &code {
            assert!(
                in_table.contains(pin),
                "{pin} is used in {board} and in no row of its table"
            );
        }
    }
}

/// The number that a constant of this name has in a source.
fn constant(source: &str, name: &str) -> f64 {
    let after = source.split(&format!("const {name}:")).nth(1);
    number(
        after.and_then(|rest| rest.split('=').nth(1)?.split(';').next()),
        name,
    )
}

/// The number that a field of this name has in a source.
fn field(source: &str, name: &str) -> f64 {
    let after = source.split(&format!(" {name}: ")).nth(1);
    number(after.and_then(|rest| rest.split(',').next()), name)
}

fn number(value: Option<&str>, name: &str) -> f64 {
    let value = value.and_then(|value| value.trim().replace('_', "").parse().ok());
    value.unwrap_or_else(|| panic!("no number {name}"))
}

#[test]
fn the_bit_timing_is_that_of_the_code() {
    let (can, board) = (read("src/board/stm32/can/start.rs"), read(BOARD));
    // Half of the PLL's output is the core's clock, a quarter of that APB1's.
    let apb1_hz =
        field(&board, "hse_hz") / field(&board, "divide_by") * field(&board, "multiply_by") / 8.0;
    let quanta = apb1_hz / constant(&can, "PRESCALER") / constant(&can, "BIT_HZ");
    let before = quanta - constant(&can, "SEGMENT_2");
    let bit_rate = constant(&can, "BIT_HZ") / 1e6;
    let row = format!(
        "| CAN | {bit_rate} Mbit/s, {quanta} quanta, sampled at {:.1} %, jump width {} |",
        100.0 * before / quanta,
        constant(&can, "JUMP_WIDTH")
    );
    let page = read("docs/bring-up.md");
    assert!(page.contains(&row), "docs/bring-up.md lacks the row {row}");
}

#[test]
fn interrupt_priorities_are_those_of_the_code() {
    /// How the table names the vectors.
    const NAMES: [(&str, &[&str]); 9] = [
        ("PVD", &["PVD"]),
        ("TIM9", &["TIM1_BRK_TIM9"]),
        ("EXTI9_5", &["EXTI9_5", "EXTI15_10"]),
        ("CAN1 receive, transmit", &["CAN1_RX0", "CAN1_TX"]),
        ("CAN1 errors", &["CAN1_SCE"]),
        ("CAN1_RX1", &["CAN1_RX1"]),
        ("TIM7", &["TIM7"]),
        ("CAN2 receive", &["CAN2_RX0"]),
        ("USART2", &["USART2", "DMA1_STREAM5", "DMA1_STREAM6"]),
    ];
    let table: BTreeMap<String, String> = read("src/board/stm32/executors.rs")
        .lines()
        .filter_map(|line| line.strip_prefix("//! | "))
        .filter(|row| row.starts_with(|first: char| first.is_ascii_digit()))
        .flat_map(|row| {
            let cells: Vec<&str> = row.split('|').map(str::trim).collect();
            let vectors = NAMES
                .iter()
                .find(|(name, _)| cells[1].starts_with(name))
                .unwrap_or_else(|| panic!("which vector is {}?", cells[1]))
                .1;
            let priority = cells[0].to_owned();
            vectors
                .iter()
                .map(move |vector| ((*vector).to_owned(), priority.clone()))
        })
        .collect();
    let mut code = BTreeMap::new();
    for source in files("rs").iter().filter(|path| path.starts_with("src")) {
        for line in read(source).lines() {
            if let Some((vector, priority)) = line.split_once(".set_priority(Priority::P") {
                let vector = vector.trim().trim_start_matches("interrupt::").to_owned();
                let priority = priority.split(')').next().unwrap_or_default().to_owned();
                code.insert(vector, priority);
            }
        }
    }
    assert_eq!(
        table, code,
        "the table of src/board/stm32/executors.rs against the code"
    );
}
