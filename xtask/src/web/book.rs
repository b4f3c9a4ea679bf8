//! The documents as pages beside the page: every Markdown file that a reader gets to.
//!
//! A page lies where its file lies in the repository, so that links between documents hold; they
//! are followed from the README on. What else a document links to is copied if it is a file, and
//! its link is left out if it is not. Where a document shows the demo, its page has the live page.

use std::collections::{BTreeSet, VecDeque};
use std::fmt::Write as _;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context as _, bail};
use pulldown_cmark::{CowStr, Event, HeadingLevel, Options, Parser, Tag, TagEnd, html};

use crate::cargo;

/// Where reading begins.
const FIRST: &str = "README.md";
/// The picture in whose place the live page stands.
const LIVE: &str = "docs/demo.svg";
const STYLE: &str = "web/page/book.css";

/// A document on its way to a page.
struct Page<'a> {
    /// Its file, from the root of the repository.
    file: PathBuf,
    root: &'a Path,
    /// Files that it links to, from the root.
    linked: BTreeSet<PathBuf>,
    title: String,
}

/// Writes all pages into the folder and returns their number.
pub fn write(folder: &Path) -> anyhow::Result<usize> {
    let root = cargo::root();
    super::write(
        &folder.join("docs/book.css"),
        super::read(&root.join(STYLE))?.as_bytes(),
    )?;
    let mut seen = BTreeSet::from([PathBuf::from(FIRST)]);
    let mut coming = VecDeque::from([PathBuf::from(FIRST)]);
    let mut pages = 0;
    while let Some(file) = coming.pop_front() {
        let bytes = std::fs::read(root.join(&file)).with_context(|| file.display().to_string())?;
        if file.extension().is_none_or(|extension| extension != "md") {
            super::write(&folder.join(&file), &bytes)?;
            continue;
        }
        let text = String::from_utf8(bytes).with_context(|| file.display().to_string())?;
        let mut page = Page {
            file: file.clone(),
            root: &root,
            linked: BTreeSet::new(),
            title: String::new(),
        };
        let html = page.html(&text)?;
        super::write(&folder.join(file.with_extension("html")), html.as_bytes())?;
        pages += 1;
        let new = page
            .linked
            .into_iter()
            .filter(|file| seen.insert(file.clone()));
        coming.extend(new);
    }
    Ok(pages)
}

impl Page<'_> {
    /// The whole page.
    fn html(&mut self, text: &str) -> anyhow::Result<String> {
        let options = Options::ENABLE_TABLES | Options::ENABLE_STRIKETHROUGH;
        let events: Vec<_> = Parser::new_ext(text, options).collect();
        let events = self.linked_events(named_headings(events))?;
        let up = "../".repeat(self.file.components().count() - 1);
        let mut body = String::new();
        html::push_html(&mut body, events.into_iter());
        Ok(format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n\
             <link rel=\"stylesheet\" href=\"{up}docs/book.css\">\n</head>\n<body>\n\
             <nav><a href=\"{up}index.html\">Try it</a> <a href=\"{up}README.html\">Overview</a> \
             <a href=\"{up}docs/README.html\">Documents</a> \
             <a href=\"{up}docs/glossary.html\">Glossary</a></nav>\n<main>\n{body}</main>\n</body>\n\
             </html>\n",
            title = self.title,
        ))
    }

    /// Links and pictures as they are in the folder.
    fn linked_events<'e>(&mut self, events: Vec<Event<'e>>) -> anyhow::Result<Vec<Event<'e>>> {
        let mut out = Vec::with_capacity(events.len());
        // Whether the link that is open has been left out; links do not nest.
        let mut left_out = false;
        let mut in_live = false;
        let mut in_title = false;
        for event in events {
            match event {
                Event::Start(Tag::Link {
                    link_type,
                    dest_url,
                    title,
                    id,
                }) => match self.destination(&dest_url)? {
                    Some(dest_url) => {
                        let dest_url = CowStr::from(dest_url);
                        out.push(Event::Start(Tag::Link {
                            link_type,
                            dest_url,
                            title,
                            id,
                        }));
                    }
                    None => left_out = true,
                },
                Event::End(TagEnd::Link) if std::mem::take(&mut left_out) => {}
                Event::Start(Tag::Image { ref dest_url, .. })
                    if self.resolve(dest_url) == Path::new(LIVE) =>
                {
                    let up = "../".repeat(self.file.components().count() - 1);
                    let frame = format!(
                        "<iframe class=\"live\" src=\"{up}index.html#group=tcc-3\" \
                         title=\"Three robots drive a figure-eight in this page\"></iframe>"
                    );
                    out.push(Event::InlineHtml(frame.into()));
                    in_live = true;
                }
                Event::End(TagEnd::Image) if std::mem::take(&mut in_live) => {}
                _ if in_live => {}
                Event::Start(Tag::Image { ref dest_url, .. }) => {
                    self.destination(dest_url)?;
                    out.push(event);
                }
                other => {
                    match &other {
                        Event::Start(Tag::Heading { level, .. }) => {
                            in_title = *level == HeadingLevel::H1 && self.title.is_empty();
                        }
                        Event::End(TagEnd::Heading(_)) => in_title = false,
                        Event::Text(text) | Event::Code(text) if in_title => {
                            self.title.push_str(&escaped(text));
                        }
                        _ => {}
                    }
                    out.push(other);
                }
            }
        }
        Ok(out)
    }

    /// Where a link leads in the folder; `None` when it leads to what is not there.
    fn destination(&mut self, link: &str) -> anyhow::Result<Option<String>> {
        if link.contains("://") || link.starts_with(['#']) || link.starts_with("mailto:") {
            return Ok(Some(link.into()));
        }
        let (path, fragment) = link
            .split_once('#')
            .map_or((link, ""), |(path, name)| (path, name));
        let file = self.resolve(path);
        let there = self.root.join(&file);
        if there.is_dir() {
            return Ok(None);
        }
        if !there.is_file() {
            bail!("{}: the link {link} leads nowhere", self.file.display());
        }
        self.linked.insert(file);
        let mut to = match path.strip_suffix(".md") {
            Some(stem) => format!("{stem}.html"),
            None => path.into(),
        };
        if !fragment.is_empty() {
            write!(to, "#{fragment}")?;
        }
        Ok(Some(to))
    }

    /// The file of a link, from the root of the repository.
    fn resolve(&self, link: &str) -> PathBuf {
        let mut at = self.file.parent().unwrap_or(Path::new("")).to_owned();
        for component in Path::new(link).components() {
            match component {
                Component::ParentDir => _ = at.pop(),
                Component::Normal(name) => at.push(name),
                _ => {}
            }
        }
        at
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

/// Gives every heading the name under which links to it are written: lower case, with hyphens for
/// spaces, without punctuation; repeated ones are numbered.
fn named_headings(mut events: Vec<Event<'_>>) -> Vec<Event<'_>> {
    let mut names = BTreeSet::new();
    let mut open = None;
    let mut text = String::new();
    for at in 0..events.len() {
        match &events[at] {
            Event::Start(Tag::Heading { .. }) => {
                open = Some(at);
                text.clear();
            }
            Event::Text(part) | Event::Code(part) if open.is_some() => text.push_str(part),
            Event::End(TagEnd::Heading(_)) => {
                let stem = slug(&text);
                let numbered = (1..).map(|n| format!("{stem}-{n}"));
                let name = std::iter::once(stem.clone()).chain(numbered);
                let name = name.into_iter().find(|name| names.insert(name.clone()));
                if let Some(start) = open.take()
                    && let Event::Start(Tag::Heading { id, .. }) = &mut events[start]
                {
                    *id = name.map(CowStr::from);
                }
            }
            _ => {}
        }
    }
    events
}

fn slug(text: &str) -> String {
    let kept = text.to_lowercase();
    let kept = kept
        .chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(text: &str) -> anyhow::Result<String> {
        let root = cargo::root();
        let mut page = Page {
            file: "docs/README.md".into(),
            root: &root,
            linked: BTreeSet::new(),
            title: String::new(),
        };
        page.html(text)
    }

    #[test]
    fn links_lead_to_pages_and_headings_have_their_names() {
        let html = page(
            "# Where is `x` ...?\n[a](safety.md#b), [c](../groups/tcc-2.toml), [d](../groups), \
             [e](https://example.org)\n\n## b\n## b\n",
        )
        .unwrap();
        for part in [
            "<title>Where is x ...?</title>",
            "<h1 id=\"where-is-x-\">",
            "href=\"safety.html#b\"",
            "href=\"../groups/tcc-2.toml\"",
            ", d, ",
            "href=\"https://example.org\"",
            "<h2 id=\"b\">",
            "<h2 id=\"b-1\">",
        ] {
            assert!(html.contains(part), "{part}: {html}");
        }
        assert!(
            page("[a](nothing.md)")
                .unwrap_err()
                .to_string()
                .contains("nothing.md")
        );
    }

    #[test]
    fn the_demo_is_the_live_page() {
        let html = page("![Robots *move*](demo.svg)\n\n![a](wiring.svg)").unwrap();
        assert!(html.contains("<iframe class=\"live\" src=\"../index.html#group=tcc-3\""));
        assert!(!html.contains("demo.svg") && html.contains("src=\"wiring.svg\""));
    }
}
