//! Numbers that the documents promise, read from the documents.
//!
//! A promise is found by the words around its number. A document that no longer has these words is
//! an error, and so is one in which they stand beside several numbers.

use anyhow::{Context as _, bail};

/// A document, as it was when this was built.
#[derive(Clone, Copy)]
pub struct Document {
    /// Path in the repository.
    pub path: &'static str,
    /// Its text.
    pub text: &'static str,
}

/// docs/safety.md.
pub const SAFETY: Document = Document {
    path: "docs/safety.md",
    text: include_str!("../../docs/safety.md"),
};
/// docs/bring-up.md.
pub const BRING_UP: Document = Document {
    path: "docs/bring-up.md",
    text: include_str!("../../docs/bring-up.md"),
};
/// docs/performance.md.
pub const PERFORMANCE: Document = Document {
    path: "docs/performance.md",
    text: include_str!("../../docs/performance.md"),
};
/// docs/acceptance.md.
pub const ACCEPTANCE: Document = Document {
    path: "docs/acceptance.md",
    text: include_str!("../../docs/acceptance.md"),
};

/// A number and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Promise {
    /// The number, in the unit of the text.
    pub value: f64,
    /// Document and words.
    pub source: String,
}

/// Finds the number between these words.
///
/// # Errors
/// When the document does not have these words around one number.
pub fn number(document: Document, before: &str, after: &str) -> anyhow::Result<Promise> {
    let text = document
        .text
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ");
    let words = format!("{before} ... {after}");
    let mut found: Vec<f64> = Vec::new();
    for (at, _) in text.match_indices(before) {
        let rest = text[at + before.len()..].trim_start();
        let end = rest
            .find(|c: char| !c.is_ascii_digit() && c != '.' && c != ' ')
            .unwrap_or(rest.len());
        let (digits, tail) = rest.split_at(end);
        let digits: String = digits.chars().filter(|c| *c != ' ').collect();
        if tail.trim_start().starts_with(after)
            && let Ok(value) = digits.parse()
        {
            found.push(value);
        }
    }
    found.dedup();
    match found[..] {
        [value] => Ok(Promise {
            value,
            source: format!("{}: {before} {value} {after}", document.path),
        }),
        [] => bail!("{} does not say '{words}' any more", document.path),
        _ => bail!("{} says '{words}' with several numbers", document.path),
    }
}

/// What a figure of docs/performance.md is held to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Column {
    /// What it should be at most.
    Budget,
    /// What a run of the bench fails beyond.
    Ceiling,
}

/// The budget or the ceiling of a figure of docs/performance.md, in the unit of its row.
///
/// # Errors
/// When the page has no such row, or no number there.
pub fn figure(name: &str, column: Column) -> anyhow::Result<Promise> {
    let (cell, word) = match column {
        Column::Budget => (4, "budget"),
        Column::Ceiling => (5, "ceiling"),
    };
    let row = PERFORMANCE.text.lines().find_map(|line| {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        (cells.get(1) == Some(&format!("`{name}`").as_str())).then(|| cells.get(cell).copied())
    });
    let text = row.flatten().unwrap_or("");
    let value = text.parse();
    Ok(Promise {
        value: value.with_context(|| format!("{} has no {word} of {name}", PERFORMANCE.path))?,
        source: format!("{}: {word} of {name}", PERFORMANCE.path),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: Document = Document {
        path: "page",
        text: "A reset follows within\n100 ms. It takes 3 ms or 22 500 steps.\n",
    };

    #[test]
    fn a_number_is_found_between_its_words() {
        assert_eq!(number(PAGE, "within", "ms").unwrap().value, 100.0);
        assert_eq!(number(PAGE, "or", "steps").unwrap().value, 22_500.0);
    }

    #[test]
    fn words_that_are_gone_are_an_error() {
        let error = number(PAGE, "after", "ms").unwrap_err();
        assert_eq!(
            error.to_string(),
            "page does not say 'after ... ms' any more"
        );
    }

    #[test]
    fn a_figure_has_its_budget_and_its_ceiling() {
        assert_eq!(figure("skew.worst", Column::Budget).unwrap().value, 5.0);
        let load = figure("load", Column::Ceiling).unwrap();
        assert!((4.0..5.0).contains(&load.value), "{load:?}");
        assert!(figure("load.bus_side", Column::Ceiling).is_err());
        assert!(figure("skew", Column::Budget).is_err());
    }

    /// The stored run of an emulated board, with which others are compared.
    #[test]
    fn the_emulated_board_is_held_to_what_the_page_promises_now() {
        let run = include_str!("../emulated/level-1.json");
        let run: serde_json::Value = serde_json::from_str(run).unwrap();
        let mut compared = 0;
        for check in run["checks"].as_array().unwrap() {
            let source = check["source"].as_str().unwrap();
            for (word, column) in [("budget", Column::Budget), ("ceiling", Column::Ceiling)] {
                let words = format!("{}: {word} of ", PERFORMANCE.path);
                let Some(name) = source.strip_prefix(&words) else {
                    continue;
                };
                let promised = figure(name, column).unwrap().value;
                assert_eq!(check["promised"], promised, "{name}");
                assert_eq!(check["bound"], format!("at most {promised}"), "{name}");
                assert!(check["measured"].as_f64().unwrap() <= promised, "{name}");
                compared += 1;
            }
        }
        assert_eq!(compared, 2, "load and skew");
    }
}
