//! Reports: written as Markdown, and turned into one HTML page that needs no other file.

use base64::{Engine as _, prelude::BASE64_STANDARD};
use pulldown_cmark::{CowStr, Event, Options, Parser, Tag, html::push_html};
use std::path::Path;
use surgtpgs_core::{Error, Result, files::write_whole};

use crate::text::visible;

/// Escapes text of any origin, so that Markdown shows it as it is, on one line.
pub(super) fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    let line: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    for c in visible(&line).chars() {
        if r"\`*_~[]<>&|#!$".contains(c) {
            safe.push('\\');
        }
        safe.push(c);
    }
    safe
}

/// Returns a table of Markdown; cells are Markdown themselves.
pub(super) fn table(head: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let line = |cells: &[&str]| format!("| {} |\n", cells.join(" | "));
    let body = rows.into_iter().map(|row| line(&row.iter().map(String::as_str).collect::<Vec<_>>()));
    format!("{}|{}\n{}\n", line(head), "---|".repeat(head.len()), body.collect::<String>())
}

/// Formats a number that may be unknown.
pub(super) fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("unknown".into(), |v| format!("{v:.digits$}"))
}

/// Writes `report.md` into `folder`, and `report.html` with its pictures inside.
pub(super) fn write_report(folder: &Path, title: &str, markdown: &str) -> Result<()> {
    write_whole(&folder.join("report.md"), markdown.as_bytes())?;
    write_whole(&folder.join("report.html"), page(title, markdown, folder)?.as_bytes())
}

/// Returns the HTML page; pictures are taken from `folder`.
fn page(title: &str, markdown: &str, folder: &Path) -> Result<String> {
    let events: Vec<Event<'_>> = Parser::new_ext(markdown, Options::ENABLE_TABLES)
        .map(|event| match event {
            Event::Start(Tag::Image { link_type, dest_url, title, id }) => {
                let dest_url = embedded(&folder.join(&*dest_url))?;
                Ok(Event::Start(Tag::Image { link_type, dest_url, title, id }))
            }
            // The program writes no HTML of its own: anything that looks like HTML is somebody's text.
            Event::Html(text) | Event::InlineHtml(text) => Ok(Event::Text(text)),
            other => Ok(other),
        })
        .collect::<Result<_>>()?;
    let html = |events: Vec<Event<'_>>| {
        let mut html = String::new();
        push_html(&mut html, events.into_iter());
        html
    };
    let title = html(vec![Event::Text(title.into())]);
    Ok(format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>{title}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n{}</body>\n</html>\n",
        html(events)
    ))
}

const STYLE: &str = "\
body { font: 15px/1.45 system-ui, sans-serif; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; color: #1c1c1c; background: #fff; }
table { border-collapse: collapse; margin: 1rem 0; display: block; overflow-x: auto; }
th, td { border: 1px solid #c4c4c4; padding: 0.25rem 0.6rem; text-align: left; }
th { background: #efefef; }
img { max-width: 100%; }
pre { white-space: pre-wrap; }
code { background: #efefef; padding: 0 0.2rem; overflow-wrap: anywhere; }
";

/// Returns a data URL that holds the picture.
fn embedded(path: &Path) -> Result<CowStr<'static>> {
    let bytes = std::fs::read(path).map_err(|e| Error::io("read the picture", path, e))?;
    let kind = if path.extension().is_some_and(|e| e == "png") { "png" } else { "jpeg" };
    Ok(format!("data:image/{kind};base64,{}", BASE64_STANDARD.encode(bytes)).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_text_is_shown_as_it_is() {
        let folder = Path::new("");
        for text in
            ["<script>alert(1)</script>", "a | b *c* _d_ [e](f) `g` &amp; \\ # ! ~~h~~ $i$", "</title>"]
        {
            let markdown = format!("{}\n\n{}", escaped(text), table(&["x"], [vec![escaped(text)]]));
            let page = page(text, &markdown, folder).unwrap();
            let shown = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
            assert_eq!(page.matches(&shown).count(), 3, "{page}");
            assert!(!page.contains("<script") && !page.contains("<em>") && !page.contains("<a "));
        }
        assert_eq!(escaped("two\nlines"), "two lines");
        assert!(page("", &escaped("a\u{202e}b"), folder).unwrap().contains(r"a\u{202e}b"));
        assert!(page("", "<b>", folder).unwrap().contains("&lt;b&gt;"));
    }

    #[test]
    fn pictures_are_inside_and_a_missing_one_is_said() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.png"), b"abc").unwrap();
        write_report(folder.path(), "t", "![a](a.png)").unwrap();
        let html = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
        assert!(html.contains(r#"<img src="data:image/png;base64,YWJj" alt="a""#), "{html}");
        assert!(page("t", "![b](b.png)", folder.path()).unwrap_err().to_string().contains("b.png"));
    }
}
