//! Rules of CONTRIBUTING.md that a machine can check: length of files and essays, and names.

use std::path::Path;

use super::{files, nothing, read};

/// A file with more lines than this is split.
const LONGEST_FILE: usize = 600;

/// An essay with more lines than this has headings.
const LONGEST_PLAIN_ESSAY: usize = 20;

/// Words that once stood for something with a standard name; `docs/glossary.md` has the names.
const DIALECT: [&str; 26] = [
    "altogether",
    "anew",
    "anybody",
    "bell",
    "crew",
    "everybody",
    "eyes",
    "handover",
    "happen",
    "happening",
    "harm",
    "heard",
    "hear",
    "hears",
    "helm",
    "kept",
    "nobody",
    "parcel",
    "rig",
    "said",
    "say",
    "somebody",
    "tell",
    "tells",
    "told",
    "whoever",
];

/// Words that pages and documentation comments do without: who or what is meant stands there
/// instead.
const NOT_IN_PROSE: [&str; 10] = [
    "altogether",
    "anew",
    "anybody",
    "everybody",
    "mend",
    "mended",
    "mends",
    "nobody",
    "somebody",
    "whoever",
];

/// Pages with the words of their time, or about words.
const FREE_PAGES: [&str; 3] = ["CHANGELOG.md", "docs/adr", "docs/glossary.md"];

/// Names that have such a word and keep it: what users already type.
const TYPED: [&str; 1] = ["kept"];

#[test]
fn no_file_is_too_long() {
    let mut complaints = Vec::new();
    for path in files("rs") {
        let lines = read(&path).lines().count();
        if lines > LONGEST_FILE {
            complaints.push(format!("{}: {lines} lines; split it", path.display()));
        }
    }
    nothing(&complaints);
}

/// What begins every crate that runs on a robot, after its essay.
const HEADER_OF_THE_ROBOT: &str = "\
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]
";

/// Cargo takes the lints of the workspace for all its crates or for none, and those for the host
/// have others; so the crates of the robot repeat these lines.
#[test]
fn crates_of_the_robot_have_the_same_lints() {
    let robot = |path: &Path| {
        path.ends_with("src/lib.rs") && read(path).lines().any(|line| line == "#![no_std]")
    };
    let crates: Vec<_> = files("rs").into_iter().filter(|path| robot(path)).collect();
    assert!(crates.len() >= 7, "{crates:?}");
    let mut complaints = Vec::new();
    for path in crates {
        if !read(&path).contains(HEADER_OF_THE_ROBOT) {
            complaints.push(format!("{}: other lints", path.display()));
        }
    }
    nothing(&complaints);
}

#[test]
fn long_essays_have_headings() {
    let mut complaints = Vec::new();
    for path in files("rs") {
        let text = read(&path);
        let essay: Vec<&str> = text
            .lines()
            .filter_map(|line| line.strip_prefix("//!"))
            .collect();
        let has_heading = essay.iter().any(|line| line.starts_with(" #"));
        if essay.len() > LONGEST_PLAIN_ESSAY && !has_heading {
            complaints.push(format!(
                "{}: an essay of {} lines without a heading",
                path.display(),
                essay.len()
            ));
        }
    }
    nothing(&complaints);
}

/// Names that a line declares: after a keyword, or before the colon of a field.
fn declared(line: &str) -> Vec<&str> {
    const KEYWORDS: [&str; 9] = [
        "fn", "struct", "enum", "trait", "mod", "const", "static", "type", "let",
    ];
    let code = line.split("//").next().unwrap_or_default();
    let is_name = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
    let words: Vec<&str> = code
        .split(|letter| !is_name(letter))
        .filter(|word| !word.is_empty() && *word != "mut")
        .collect();
    let after_keyword = words
        .windows(2)
        .filter(|pair| KEYWORDS.contains(&pair[0]))
        .map(|pair| pair[1]);
    let field = code.split_once(": ").and_then(|(before, _)| {
        let name = before.trim().trim_start_matches("pub ");
        (!name.is_empty() && name.chars().all(is_name)).then_some(name)
    });
    after_keyword.chain(field).collect()
}

/// Words of a name in snake, camel or upper case, in lower case.
fn words(name: &str) -> Vec<String> {
    let mut found = vec![String::new()];
    let mut before = '_';
    for letter in name.chars() {
        let starts = letter == '_' || (letter.is_ascii_uppercase() && before.is_ascii_lowercase());
        if starts {
            found.push(String::new());
        }
        if let Some(word) = found.last_mut().filter(|_| letter != '_') {
            word.push(letter.to_ascii_lowercase());
        }
        before = letter;
    }
    found.retain(|word| !word.is_empty());
    found
}

#[test]
fn pages_and_documentation_are_in_standard_words() {
    let mut complaints = Vec::new();
    let is_free = |page: &Path| FREE_PAGES.iter().any(|free| page.starts_with(free));
    let pages = files("md").into_iter().filter(|page| !is_free(page));
    for path in pages.chain(files("rs")) {
        let is_page = path.extension().is_some_and(|name| name == "md");
        for (number, line) in (1..).zip(read(&path).lines()) {
            if !is_page && !line.trim_start().starts_with("//!") && !line.contains("///") {
                continue;
            }
            let words = line.split(|letter: char| !letter.is_ascii_alphanumeric());
            for word in words.filter(|word| NOT_IN_PROSE.contains(&word.to_lowercase().as_str())) {
                complaints.push(format!(
                    "{}:{number}: '{word}': name who or what is meant",
                    path.display()
                ));
            }
        }
    }
    nothing(&complaints);
}

/// A name of four words and more is a sentence, such as a test's.
#[test]
fn names_are_standard_words() {
    let mut complaints = Vec::new();
    for path in files("rs") {
        for (number, line) in (1..).zip(read(&path).lines()) {
            for name in declared(line) {
                let words = words(name);
                let dialect = words.iter().find(|word| DIALECT.contains(&word.as_str()));
                if let Some(word) = dialect.filter(|_| words.len() < 4 && !TYPED.contains(&name)) {
                    complaints.push(format!(
                        "{}:{number}: {name}: '{word}' has a standard name in docs/glossary.md",
                        path.display()
                    ));
                }
            }
        }
    }
    nothing(&complaints);
}

#[test]
fn names_are_found_and_split() {
    assert_eq!(declared("    pub fn take_turn(&mut self) {"), ["take_turn"]);
    assert_eq!(
        declared("    let mut label = Vec::new(); // let said"),
        ["label"]
    );
    assert_eq!(declared("    kept: Option<PathBuf>,"), ["kept"]);
    assert_eq!(words("SAY_EVERY"), ["say", "every"]);
    assert_eq!(words("TestMaster2"), ["test", "master2"]);
}

/// The causes of an error type that its own messages print as well: field, and line of the message.
fn repeated_causes(text: &str) -> Vec<(usize, &str)> {
    let mut found = Vec::new();
    for (at, _) in text.match_indices("#[error(") {
        let rest = &text[at..];
        if !rest["#[error(".len()..].trim_start().starts_with('"') {
            continue;
        }
        let (message, variant) = rest.split_once(")]\n").unwrap_or((rest, ""));
        let variant = variant.split("#[error(").next().unwrap_or_default();
        let mut marked = false;
        for line in variant.lines().map(str::trim) {
            let mark = line.contains("#[from]") || line.contains("#[source]");
            let name = match line.split_once(": ") {
                Some((name, _)) => name,
                None if mark && line.contains('(') => "0",
                None => "",
            };
            let is_cause = mark || marked || name == "source";
            if is_cause && !name.is_empty() && message.contains(&format!("{{{name}")) {
                found.push((text[..at].lines().count() + 1, name));
            }
            marked = mark && name.is_empty();
        }
    }
    found
}

/// Commands print an error with its causes, so that a cause in its message would be there twice.
#[test]
fn errors_print_their_cause_once() {
    let mut complaints = Vec::new();
    for path in files("rs") {
        for (line, name) in repeated_causes(&read(&path)) {
            let path = path.display();
            complaints.push(format!(
                "{path}:{line}: the message prints {name}, which is its cause as well"
            ));
        }
    }
    nothing(&complaints);
}

#[test]
fn repeated_causes_are_found() {
    let text = |message: &str, variant: &str| {
        // A long message is on lines of its own.
        let lines = if message.contains('\n') { "\n" } else { "" };
        format!("enum E {{\n#[error({lines}\"{message}\"{lines})]\n{variant}\n}}\n")
    };
    for (message, variant, causes) in [
        ("{path}: {source}", "Io {\n/// It.\nsource: Error,\n},", 1),
        ("no file", "Io {\nsource: Error,\n},", 0),
        ("no file: {0}", "Io(#[from] Error),", 1),
        ("no file: {0}", "Io(Error),", 0),
        ("no file: {why}", "Io {\n#[source]\nwhy: Error,\n},", 1),
        ("no file: {why}", "Io {\nwhy: Error,\n},", 0),
        ("no file: \\\n{why}", "Io {\n#[source]\nwhy: Error,\n},", 1),
    ] {
        assert_eq!(
            repeated_causes(&text(message, variant)).len(),
            causes,
            "{message} {variant}"
        );
    }
}
