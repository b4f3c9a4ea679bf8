//! What the documents say of files, pins and priorities is what the sources say.
//!
//! A check reads the Markdown files and the sources as text. It cannot tell whether a sentence is
//! true; it finds links that lead nowhere, files and tests that are gone, and tables that repeat a
//! constant and no longer agree with it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The board whose pins the documents describe.
const BOARD: &str = "src/board/nucleo_f446re.rs";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: impl AsRef<Path>) -> String {
    let path = root().join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Every file of the workspace with this extension, relative to the root, build output apart.
fn files(extension: &str) -> Vec<PathBuf> {
    fn walk(folder: &Path, extension: &str, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).expect("a folder of the workspace") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if path.is_dir() {
                if !name.starts_with('.') && name != "target" {
                    walk(&path, extension, found);
                }
            } else if path.extension().is_some_and(|found| found == extension) {
                found.push(path.strip_prefix(root()).expect("below the root").into());
            }
        }
    }
    let mut found = Vec::new();
    walk(root(), extension, &mut found);
    found.sort();
    found
}

/// Lines of a Markdown text outside code blocks.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut code = false;
    text.lines().filter(move |line| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        !fence && !code && !line.starts_with("    ")
    })
}

/// Paragraphs of a Markdown text outside code blocks, each on one line.
fn paragraphs(text: &str) -> Vec<String> {
    let mut found = vec![String::new()];
    for line in prose(text) {
        if line.trim().is_empty() {
            found.push(String::new());
        } else if let Some(paragraph) = found.last_mut() {
            paragraph.push(' ');
            paragraph.push_str(line.trim());
        }
    }
    found
}

/// What stands between backticks.
fn quoted(text: &str) -> Vec<String> {
    let spans = |paragraph: String| -> Vec<String> {
        let spans = paragraph.split('`').skip(1).step_by(2);
        spans.map(str::to_owned).collect()
    };
    paragraphs(text).into_iter().flat_map(spans).collect()
}

/// Targets of the links and pictures.
fn links(text: &str) -> Vec<String> {
    let targets = |paragraph: String| -> Vec<String> {
        let rests = paragraph.split("](").skip(1);
        rests
            .filter_map(|rest| rest.split(')').next())
            .map(str::to_owned)
            .collect()
    };
    paragraphs(text).into_iter().flat_map(targets).collect()
}

/// The anchor that a Markdown heading gets: lower case, blanks become hyphens, punctuation goes.
fn anchor(heading: &str) -> String {
    heading
        .trim_start_matches('#')
        .trim()
        .to_lowercase()
        .chars()
        .filter_map(|letter| match letter {
            ' ' => Some('-'),
            '-' | '_' => Some(letter),
            _ if letter.is_alphanumeric() => Some(letter),
            _ => None,
        })
        .collect()
}

fn anchors(text: &str) -> BTreeSet<String> {
    prose(text)
        .filter(|line| line.starts_with('#'))
        .map(anchor)
        .collect()
}

/// Fails with all complaints at once.
fn nothing(complaints: &[String]) {
    assert!(complaints.is_empty(), "\n{}", complaints.join("\n"));
}

#[test]
fn links_lead_to_files_and_headings() {
    let mut complaints = Vec::new();
    for page in files("md") {
        let text = read(&page);
        for target in links(&text) {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            let (file, heading) = target.split_once('#').unwrap_or((&target, ""));
            let path = match file {
                "" => page.clone(),
                file => page.parent().expect("a folder").join(file),
            };
            if !root().join(&path).exists() {
                complaints.push(format!("{}: no file for {target}", page.display()));
            } else if !heading.is_empty() && !anchors(&read(&path)).contains(heading) {
                complaints.push(format!("{}: no heading for {target}", page.display()));
            }
        }
    }
    nothing(&complaints);
}

#[test]
fn files_named_in_the_documents_exist() {
    const EXTENSIONS: [&str; 12] = [
        "rs", "md", "toml", "py", "sh", "x", "svg", "csv", "eds", "dbc", "json", "in",
    ];
    let sources: BTreeSet<String> = EXTENSIONS
        .iter()
        .flat_map(|extension| files(extension))
        .map(|path| path.to_string_lossy().into_owned())
        .collect();
    let mut complaints = Vec::new();
    for page in files("md") {
        for name in quoted(&read(&page)) {
            let path = Path::new(&name);
            let plain = |letter: char| letter.is_ascii_alphanumeric() || "_-./".contains(letter);
            let a_file = path
                .extension()
                .is_some_and(|extension| EXTENSIONS.iter().any(|known| extension == *known));
            let a_folder = name.ends_with('/');
            // Names of files the reader makes have capitals or begin with target/.
            let ours = name.chars().all(plain)
                && !name.starts_with(['/', '-', '.'])
                && !name.starts_with("target/")
                && !name.contains(|letter: char| letter.is_ascii_uppercase());
            if !ours || !(a_file || a_folder) {
                continue;
            }
            // A page may leave out the folders it has been speaking of.
            let known = root().join(path).exists()
                || page
                    .parent()
                    .is_some_and(|at| root().join(at).join(path).exists())
                || sources
                    .iter()
                    .any(|source| source.ends_with(&format!("/{name}")));
            if !known && !ELSEWHERE.contains(&name.as_str()) {
                complaints.push(format!("{}: no file {name}", page.display()));
            }
        }
    }
    nothing(&complaints);
}

/// Not there: what a demo writes.
const ELSEWHERE: [&str; 2] = ["tracking.svg", "heading.svg"];

#[test]
fn documents_named_in_the_sources_exist() {
    let mut complaints = Vec::new();
    for source in files("rs") {
        for line in read(&source).lines() {
            for rest in line.split("docs/").skip(1) {
                let end = rest.find(|letter: char| {
                    !(letter.is_ascii_alphanumeric() || "_-./".contains(letter))
                });
                let name = rest[..end.unwrap_or(rest.len())].trim_end_matches('.');
                let external = line.contains("://");
                if name.ends_with(".md") && !external && !root().join("docs").join(name).exists() {
                    complaints.push(format!("{}: no document docs/{name}", source.display()));
                }
            }
        }
    }
    nothing(&complaints);
}

#[test]
fn tests_named_in_the_documents_exist() {
    // A name of four words and more is a test's; shorter ones are fields and objects.
    let is_test = |name: &str| {
        name.split('_').count() >= 4
            && name.chars().all(|letter| {
                letter == '_' || letter.is_ascii_lowercase() || letter.is_ascii_digit()
            })
    };
    let sources: String = files("rs")
        .into_iter()
        .chain(files("py"))
        .map(read)
        .collect();
    let mut complaints = Vec::new();
    for page in files("md") {
        for name in quoted(&read(&page))
            .into_iter()
            .filter(|name| is_test(name))
        {
            let there = sources.contains(&format!("fn {name}("))
                || sources.contains(&format!("def {name}("))
                || sources.contains(&format!("{name}:"));
            if !there {
                complaints.push(format!("{}: no test {name}", page.display()));
            }
        }
    }
    nothing(&complaints);
}

#[test]
fn paths_of_code_named_in_the_documents_exist() {
    const KEYWORDS: [&str; 8] = [
        "mod", "struct", "enum", "trait", "fn", "const", "type", "static",
    ];
    const EXTERNAL: [&str; 2] = ["defmt", "embedded_can"];
    let mut declared = BTreeSet::new();
    for source in files("rs") {
        let text = read(source);
        let mut before = "";
        for word in text.split(|letter: char| !letter.is_alphanumeric() && letter != '_') {
            if KEYWORDS.contains(&before) {
                declared.insert(word.to_owned());
            }
            before = word;
        }
        // The constants of `protocol::address` are declared by a macro: NAME = 0x2010:1;
        let constants = text
            .lines()
            .filter_map(|line| line.trim().split_once(" = "));
        declared.extend(constants.map(|(name, _)| name.to_owned()));
    }
    let mut complaints = Vec::new();
    // The glossary also names what is going to be.
    let pages = files("md")
        .into_iter()
        .filter(|page| !page.ends_with("glossary.md"));
    for page in pages {
        for name in quoted(&read(&page)) {
            let path: Vec<&str> = name.trim_end_matches("()").split("::").collect();
            let word = |part: &&str| {
                !part.is_empty()
                    && part
                        .chars()
                        .all(|letter| letter.is_alphanumeric() || letter == '_')
            };
            if path.len() < 2 || !path.iter().all(word) || EXTERNAL.contains(&path[0]) {
                continue;
            }
            let package = root().join(path[0]).is_dir();
            let unknown = path
                .iter()
                .skip(usize::from(package))
                .find(|part| !declared.contains(**part));
            if let Some(part) = unknown {
                complaints.push(format!("{}: {name}: no {part}", page.display()));
            }
        }
    }
    nothing(&complaints);
}

/// Commands of a program, from the variants of its `clap` enum.
fn commands(source: &str) -> BTreeSet<String> {
    let text = read(source);
    let body = text
        .split_once("#[derive(Subcommand)]")
        .map(|(_, rest)| rest)
        .and_then(|rest| rest.split("\n}").next())
        .unwrap_or_else(|| panic!("{source} has no commands"));
    let variants = body
        .lines()
        .filter_map(|line| line.strip_prefix("    "))
        .filter(|line| line.starts_with(|first: char| first.is_ascii_uppercase()));
    variants
        .map(|line| {
            let end = line.find(|letter: char| !letter.is_alphanumeric());
            let mut command = String::new();
            for letter in line[..end.unwrap_or(line.len())].chars() {
                if letter.is_uppercase() && !command.is_empty() {
                    command.push('-');
                }
                command.extend(letter.to_lowercase());
            }
            command
        })
        .collect()
}

#[test]
fn commands_named_in_the_documents_exist() {
    let programs = [
        ("omnibus", commands("master/src/main.rs")),
        ("omnibus-sim", commands("sim/src/bin/omnibus-sim/main.rs")),
        ("xtask", commands("xtask/src/main.rs")),
    ];
    let mut complaints = Vec::new();
    // The glossary also names what is going to be.
    let pages = files("md")
        .into_iter()
        .filter(|page| !page.ends_with("glossary.md"));
    for page in pages {
        let text = read(&page).replace(" -- ", " ");
        let words: Vec<&str> = text
            .split_whitespace()
            .map(|word| word.trim_start_matches(['`', '(']))
            .collect();
        for pair in words.windows(2) {
            let name = pair[1].trim_end_matches(['`', ')', ',', '.', ';', ':', '?']);
            let command = !name.is_empty()
                && !name.starts_with('-')
                && name
                    .chars()
                    .all(|letter| letter == '-' || letter.is_ascii_lowercase());
            for (program, commands) in &programs {
                if pair[0] == *program && command && !commands.contains(name) {
                    complaints.push(format!("{}: {program} has no {name}", page.display()));
                }
            }
        }
    }
    nothing(&complaints);
}

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
const FUNCTIONS: [(&str, &str); 15] = [
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
    let mut table = BTreeMap::new();
    let rows = text
        .lines()
        .map(|line| line.trim_start_matches("//! "))
        .skip_while(|line| !line.starts_with("| function"))
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
    assert!(table.len() >= 10, "a table with few functions: {table:?}");
    table
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
    for board in [BOARD, "src/board/robomaster_c.rs"] {
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
    let (can, board) = (read("src/board/stm32f4/can/start.rs"), read(BOARD));
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
    const NAMES: [(&str, &[&str]); 7] = [
        ("PVD", &["PVD"]),
        ("TIM9", &["TIM1_BRK_TIM9"]),
        ("EXTI15_10", &["EXTI15_10"]),
        ("CAN1 receive", &["CAN1_RX0"]),
        ("CAN1 transmit", &["CAN1_TX", "CAN1_SCE"]),
        ("TIM7", &["TIM7"]),
        ("USART2", &["USART2", "DMA1_STREAM5", "DMA1_STREAM6"]),
    ];
    let table: BTreeMap<String, String> = read("src/board/stm32f4/executors.rs")
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
        "the table of src/board/stm32f4/executors.rs against the code"
    );
}

#[test]
fn decisions_have_one_form_and_are_in_the_index() {
    let index = paragraphs(&read("docs/README.md")).join("\n");
    let mut complaints = Vec::new();
    let decisions = files("md")
        .into_iter()
        .filter(|path| path.starts_with("docs/adr"));
    let mut last = 0;
    for path in decisions {
        let text = read(&path);
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let mut complain = |what: &str| complaints.push(format!("{name}: {what}"));
        // A number may be missing while a decision is on its way; none stands twice.
        let digits = name.split('-').next().filter(|digits| digits.len() == 4);
        let number: u32 = digits
            .and_then(|digits| digits.parse().ok())
            .unwrap_or_default();
        if number <= last {
            complain("the name does not begin with a number of its own, four digits");
        }
        last = number;
        let lines: Vec<&str> = text.lines().collect();
        let title = lines[0].strip_prefix(&format!("# {number:04}: "));
        if title.is_none_or(str::is_empty) {
            complain("the title is not '# NNNN: words'");
        }
        let status = lines.get(2).and_then(|line| line.strip_prefix("Status: "));
        let (state, rest) = status
            .and_then(|status| status.split_once(", 2"))
            .unwrap_or_default();
        let superseded = state.starts_with("superseded by [");
        if !lines[1].is_empty() || !(state == "accepted" || superseded) || !rest.starts_with("0") {
            complain(
                "line 3 is not 'Status: accepted, YYYY-MM' or '... superseded by [NNNN](file), \
                 ...'",
            );
        }
        let headings: Vec<&str> = lines
            .iter()
            .filter_map(|line| line.strip_prefix("## "))
            .collect();
        if headings != ["Problem", "Decision", "Why not the others", "Consequences"] {
            complain(&format!("sections are {headings:?}"));
        }
        let entry = format!("- [{number:04}](adr/{name}): {}", title.unwrap_or_default());
        if !index.contains(&entry) {
            complain(&format!("docs/README.md lacks the line '{entry}'"));
        }
    }
    nothing(&complaints);
}

#[test]
fn every_document_is_in_the_index() {
    let index = read("docs/README.md");
    for entry in fs::read_dir(root().join("docs")).expect("docs") {
        let name = entry.expect("an entry").file_name();
        let name = name.to_string_lossy();
        let document = [".md", ".eds", ".dbc"]
            .iter()
            .any(|end| name.ends_with(end));
        if document && name != "README.md" && name != "performance.in.md" {
            assert!(
                index.contains(&format!("]({name})")),
                "docs/README.md does not name {name}"
            );
        }
    }
}

#[test]
fn the_check_of_anchors_follows_the_rule_of_the_forge() {
    assert_eq!(anchor("## Where is ...?"), "where-is-");
    assert_eq!(anchor("# 0013: The control tick"), "0013-the-control-tick");
    assert_eq!(
        anchor("### A `code` word, and-more"),
        "a-code-word-and-more"
    );
}
