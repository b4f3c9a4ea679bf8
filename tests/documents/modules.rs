//! Modules know each other in one direction (ADR 0053), and no public name is without a user.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::{files, nothing, read};

/// Path of a module inside its crate.
type Module = Vec<String>;

/// Circles that stay, with a word of each of their modules; ADR 0053 has the reasons.
const CIRCLES: [&[&str]; 3] = [
    &["board::stm32::can::cable", "board::stm32::can::mailboxes"],
    &["address_space", "board", "can::port", "soc"],
    &["address", "object", "table"],
];

/// The sources without comments, and without the tests at their end.
fn code(text: &str) -> String {
    let product = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    let lines = product.lines().map(|line| line.split("//").next());
    lines.flatten().collect::<Vec<_>>().join("\n")
}

fn is_test(path: &Path) -> bool {
    let path = path.to_string_lossy();
    ["tests/", "tests.rs", "fuzz/", "examples/"]
        .iter()
        .any(|part| path.contains(part))
}

/// Crate and module of a file in a folder `src`.
fn module_of(path: &Path) -> Option<(String, Module)> {
    let path = path.to_str()?.strip_suffix(".rs")?;
    let (package, inside) = match path.strip_prefix("src/") {
        Some(inside) => ("", inside),
        None => path.split_once("/src/")?,
    };
    let mut module: Module = inside.split('/').map(str::to_owned).collect();
    if matches!(module.last()?.as_str(), "mod" | "lib" | "main") {
        module.pop();
    }
    Some((package.to_owned(), module))
}

/// The paths at the beginning of a text: `a::{b, c::d}` has two. What follows a path is left.
fn paths(text: &mut &str, before: &[String], found: &mut Vec<Module>) {
    let mut path = before.to_vec();
    loop {
        *text = text.trim_start();
        if let Some(rest) = text.strip_prefix('{') {
            *text = rest;
            while !text.is_empty() && !text.starts_with('}') {
                paths(text, &path, found);
                *text = text.trim_start();
                *text = text.strip_prefix(',').unwrap_or(text).trim_start();
            }
            *text = text.strip_prefix('}').unwrap_or(text);
            return;
        }
        let end = text.find(|letter: char| !(letter.is_alphanumeric() || letter == '_'));
        let (name, rest) = text.split_at(end.unwrap_or(text.len()));
        if name.is_empty() {
            // A star, or something that is no path.
            *text = rest.get(1..).unwrap_or_default();
            break;
        }
        path.push(name.to_owned());
        *text = rest;
        match text.strip_prefix("::") {
            Some(rest) => *text = rest,
            None => break,
        }
    }
    if let Some(alias) = text.strip_prefix(" as ") {
        *text = alias.trim_start_matches(|letter: char| letter.is_alphanumeric() || letter == '_');
    }
    found.push(path);
}

/// Modules that a module names, its own submodules and the modules around it apart.
fn named(module: &Module, code: &str, all: &BTreeSet<Module>) -> BTreeSet<Module> {
    let mut found = Vec::new();
    for start in ["crate::", "super::"] {
        for (at, _) in code.match_indices(start) {
            let inside = code[..at].ends_with(|letter: char| {
                letter.is_alphanumeric() || letter == '_' || letter == '$' || letter == ':'
            });
            if inside {
                continue;
            }
            let mut rest = &code[at + "crate::".len()..];
            let mut base = Module::new();
            if start == "super::" {
                base = module.clone();
                base.pop();
                while let Some(further) = rest.strip_prefix("super::") {
                    base.pop();
                    rest = further;
                }
            }
            paths(&mut rest, &base, &mut found);
        }
    }
    let known = found.into_iter().filter_map(|mut path| {
        while !all.contains(&path) {
            path.pop()?;
        }
        let related = path.starts_with(module) || module.starts_with(&path);
        (!related).then_some(path)
    });
    known.collect()
}

/// Sets of modules each of which reaches all others of its set.
fn circles(edges: &BTreeMap<Module, BTreeSet<Module>>) -> BTreeSet<BTreeSet<Module>> {
    let reach = |from: &Module| {
        let mut reached: BTreeSet<&Module> = BTreeSet::new();
        let mut open = vec![from];
        while let Some(module) = open.pop() {
            for next in edges.get(module).into_iter().flatten() {
                if reached.insert(next) {
                    open.push(next);
                }
            }
        }
        reached
    };
    let reached: BTreeMap<_, _> = edges.keys().map(|module| (module, reach(module))).collect();
    let circle = |module: &&Module| -> BTreeSet<Module> {
        let back = |other: &&&Module| reached.get(**other).is_some_and(|r| r.contains(module));
        let others = reached[*module].iter().filter(back);
        others.map(|other| (*other).clone()).collect()
    };
    let all = edges.keys().collect::<Vec<_>>();
    let found = all.iter().map(circle).filter(|circle| circle.len() > 1);
    found.collect()
}

#[test]
fn modules_know_each_other_in_one_direction() {
    let mut crates: BTreeMap<String, BTreeMap<Module, String>> = BTreeMap::new();
    for path in files("rs").into_iter().filter(|path| !is_test(path)) {
        if let Some((package, module)) = module_of(&path) {
            let text = crates.entry(package).or_default().entry(module);
            *text.or_default() += &code(&read(&path));
        }
    }
    assert!(crates.len() > 10, "{:?}", crates.keys());
    let mut complaints = Vec::new();
    for (package, modules) in &crates {
        let all: BTreeSet<Module> = modules.keys().cloned().collect();
        let edges = modules
            .iter()
            .map(|(module, code)| (module.clone(), named(module, code, &all)));
        for circle in circles(&edges.collect()) {
            let names: Vec<String> = circle.iter().map(|module| module.join("::")).collect();
            let stays = CIRCLES.iter().any(|allowed| {
                let within = |name: &&String| {
                    let part = |module: &&&str| {
                        let rest = name.strip_prefix(**module);
                        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with("::"))
                    };
                    allowed.iter().any(|module| part(&module))
                };
                names.iter().all(|name| within(&name))
            });
            if !stays {
                complaints.push(format!("{package}: {}", names.join(" <-> ")));
            }
        }
    }
    nothing(&complaints);
}

#[test]
fn public_names_have_a_user() {
    let is_name = |letter: char| letter.is_alphanumeric() || letter == '_';
    let mut uses: BTreeMap<String, usize> = BTreeMap::new();
    let mut declared = Vec::new();
    for path in files("rs") {
        let code = code(&read(&path));
        for line in code.lines() {
            let after = |keyword| line.trim_start().strip_prefix("pub ")?.split_once(keyword);
            let name = [
                "fn ", "const ", "static ", "struct ", "enum ", "trait ", "type ",
            ]
            .into_iter()
            .find_map(after)
            .and_then(|(_, rest)| rest.split(|letter| !is_name(letter)).next());
            if let Some(name) = name.filter(|name| !name.is_empty() && !is_test(&path)) {
                declared.push((path.clone(), name.to_owned()));
            }
        }
        for word in read(&path).split(|letter| !is_name(letter)) {
            *uses.entry(word.to_owned()).or_default() += 1;
        }
    }
    assert!(declared.len() > 1000, "{}", declared.len());
    let unused = declared.iter().filter(|(_, name)| uses[name] < 2);
    let complaints: Vec<String> = unused
        .map(|(path, name)| format!("{}: {name}: nothing uses it", path.display()))
        .collect();
    nothing(&complaints);
}

#[test]
fn paths_and_circles_are_found() {
    let module = |path: &str| -> Module { path.split("::").map(str::to_owned).collect() };
    let all: BTreeSet<Module> = ["a", "a::b", "a::c", "d", "e"].map(module).into();
    let code = "use crate::{d::{self, X as Y}, e};\nuse super::c::Z; fn f(x: crate::e::T) {}";
    let found = named(&module("a::b"), code, &all);
    assert_eq!(found, ["a::c", "d", "e"].map(module).into());
    let edges: BTreeMap<Module, BTreeSet<Module>> = [
        (module("d"), [module("e")].into()),
        (module("e"), [module("a")].into()),
        (module("a"), [module("e")].into()),
    ]
    .into();
    let circle: BTreeSet<Module> = ["a", "e"].map(module).into();
    assert_eq!(circles(&edges), [circle].into());
}
