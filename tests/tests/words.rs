//! The project's own words: first words of doc comments, lengths of lines, and whether cited places exist.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

/// Widest line of prose, in columns.
const COLUMNS: usize = 110;
/// Words that no doc comment begins with: it says what a thing is or does.
const QUESTIONS: [&str; 10] =
    ["What", "How", "Whether", "Which", "Where", "Why", "Who", "Whose", "When", "That"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// Lists the files of the project with this ending.
fn files(ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders =
        ["crates", "tests", "shaders", "assets", ".github"].map(|name| root().join(name)).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.extend((!path.ends_with("target")).then_some(path));
            } else if path.extension().is_some_and(|e| e == ending) {
                found.push(path);
            }
        }
    }
    if ending == "md" {
        found.push(root().join("README.md"));
    }
    assert!(found.len() > 5, "{ending}");
    found
}

/// Calls `look` with every line of the files, numbered from 1.
fn lines(ending: &str, mut look: impl FnMut(&Path, usize, &str)) {
    for path in files(ending) {
        let text = fs::read_to_string(&path).unwrap();
        text.lines().enumerate().for_each(|(i, line)| look(&path, i + 1, line));
    }
}

/// Returns the text of a doc comment's line.
fn doc(line: &str) -> Option<&str> {
    let line = line.trim_start();
    line.strip_prefix("///").or_else(|| line.strip_prefix("//!")).map(str::trim_start)
}

#[test]
fn doc_comments_say_what_things_are_or_do() {
    let (mut wrong, mut was_doc) = (Vec::new(), false);
    lines("rs", |path, number, line| {
        let text = doc(line);
        let first = text.and_then(|text| text.split(|c: char| !c.is_alphanumeric()).next());
        if !was_doc && first.is_some_and(|word| QUESTIONS.contains(&word)) {
            wrong.push(format!("{}:{number}: {}", path.display(), line.trim()));
        }
        was_doc = text.is_some();
    });
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn lines_of_prose_are_short() {
    let is_exempt = |line: &str| {
        ["http", "](", "─", "|", "cargo test"].iter().any(|mark| line.contains(mark))
            || line.starts_with("    ")
    };
    let mut wrong = Vec::new();
    let mut look = |path: &Path, number: usize, line: &str| {
        if line.chars().count() > COLUMNS && !is_exempt(line) {
            wrong.push(format!("{}:{number}", path.display()));
        }
    };
    for ending in ["rs", "wgsl"] {
        lines(ending, |path, number, line| {
            if line.trim_start().starts_with("//") {
                look(path, number, line.trim_start());
            }
        });
    }
    let mut is_code = false;
    lines("md", |path, number, line| {
        is_code ^= line.trim_start().starts_with("```");
        if !is_code {
            look(path, number, line);
        }
    });
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn sections_of_the_method_that_are_cited_exist() {
    const CITED: &str = "method §";
    let page = fs::read_to_string(root().join("crates/core/README.md")).unwrap();
    let headings: BTreeSet<&str> =
        page.lines().filter(|line| line.starts_with('#')).filter_map(|line| line.split(' ').nth(1)).collect();
    let (mut cited, mut wrong) = (0, Vec::new());
    for ending in ["rs", "wgsl", "py"] {
        lines(ending, |path, number, line| {
            let is_here = path.ends_with("tests/tests/words.rs");
            for rest in line.split(CITED).skip(1).filter(|_| !is_here) {
                let section = rest.split(|c: char| !c.is_ascii_digit() && c != '.').next().unwrap();
                cited += 1;
                if !headings.contains(section.trim_end_matches('.')) {
                    wrong.push(format!("{}:{number}: §{section}", path.display()));
                }
            }
        });
    }
    assert!(wrong.is_empty() && cited > 10, "{cited} citations; {wrong:#?}");
}

#[test]
fn links_between_pages_lead_somewhere() {
    let mut wrong = Vec::new();
    let mut is_code = false;
    lines("md", |path, number, line| {
        is_code ^= line.trim_start().starts_with("```");
        if is_code {
            return;
        }
        for rest in line.split("](").skip(1) {
            let link = rest.split_once(')').map(|(link, _)| link);
            if !link.is_some_and(|link| leads_somewhere(path, link)) {
                wrong.push(format!("{}:{number}: {rest}", path.display()));
            }
        }
    });
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Tests whether a link in a page leads to a file, and to a heading of it; pages elsewhere are not looked at.
fn leads_somewhere(page: &Path, link: &str) -> bool {
    let (file, heading) = link.split_once('#').unwrap_or((link, ""));
    if file.contains("://") || file.starts_with("mailto:") {
        return true;
    }
    let target = if file.is_empty() { page.to_owned() } else { page.parent().unwrap().join(file) };
    let has_heading =
        || fs::read_to_string(&target).unwrap().lines().any(|line| anchor(line).as_deref() == Some(heading));
    target.exists() && (heading.is_empty() || has_heading())
}

/// Returns the name by which links know a heading.
fn anchor(line: &str) -> Option<String> {
    let heading = line.strip_prefix('#')?.trim_start_matches('#').trim().to_lowercase();
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || "-_ ".contains(*c));
    Some(kept.map(|c| if c == ' ' { '-' } else { c }).collect())
}
