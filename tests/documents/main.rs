//! The documents agree with the sources, and the sources with the rules of CONTRIBUTING.md.
//!
//! The checks read the Markdown files and the sources as text. They cannot tell whether a sentence
//! is true; they find links that lead nowhere, files and tests that are gone ([`self`]), tables and
//! sentences that repeat a constant and no longer agree with it ([`boards`], [`statements`]), and
//! files, essays and names that break a rule of style ([`style`]), and modules that import each
//! other in a circle ([`modules`]).

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

mod boards;
mod modules;
mod statements;
mod style;
mod units;

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
fn every_package_is_in_the_readme() {
    let readme = read("README.md");
    let manifests = files("toml").into_iter();
    let packages: Vec<String> = manifests
        .filter(|path| path.ends_with("Cargo.toml") && path.iter().count() == 2)
        .map(|path| path.with_file_name("").display().to_string())
        .collect();
    assert!(packages.len() >= 20, "only {packages:?}");
    let is_missing = |folder: &&String| !readme.contains(&format!("\n| `{folder}`"));
    let missing: Vec<String> = packages.iter().filter(is_missing).cloned().collect();
    nothing(&missing);
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

/// A page that types `omnibus` says how to install it: a program that is only built is not found.
/// README runs it where it was built, and says that it alone does.
#[test]
fn what_is_typed_is_installed() {
    let mut complaints = Vec::new();
    let mut installed = 0;
    for path in files("md") {
        for line in read(&path).lines() {
            let words: Vec<&str> = line.split([' ', '`', ';']).collect();
            let after = |option: &str| {
                let at = words.iter().position(|word| *word == option)?;
                words.get(at + 1).copied()
            };
            if line.contains("cargo build") && after("-p") == Some("omnibus-master") {
                complaints.push(format!("{}: {line}: leaves no `omnibus`", path.display()));
            }
            if line.starts_with("cargo run -p omnibus-") && path != Path::new("README.md") {
                complaints.push(format!("{}: {line}: type `omnibus`", path.display()));
            }
            let (true, Some(package)) = (line.contains("cargo install"), after("--path")) else {
                continue;
            };
            installed += 1;
            let manifest = read(format!("{package}/Cargo.toml"));
            let has = |start: &str| manifest.lines().any(|line| line.starts_with(start));
            let feature = after("--features").map(|feature| format!("{feature} = ["));
            if !has("[[bin]]") || !feature.is_none_or(|feature| has(&feature)) {
                complaints.push(format!("{}: {line}: installs nothing", path.display()));
            }
        }
    }
    nothing(&complaints);
    assert!(installed >= 6, "{installed}");
}
