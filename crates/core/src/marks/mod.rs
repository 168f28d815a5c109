//! Marks by hand: what is marked on some frames is carried to all of them (method §12).
//!
//! ```text
//! marks ─▶ pixels ─▶ spread over the marked frames ─┬▶ looked up along optical flow ─────┐
//!                    (place, appearance)             └▶ seeds on Gaussians ─▶ spread over ─┴▶ mixed, refined ─▶ scores
//!                                                       their graph (place, colour, motion)
//! ```
//!
//! [`Marks`] reads and checks marks, [`Evidence`] sums them up for each pixel of a frame, and [`Carried`]
//! gives scores on every frame. [`ChapterMarks`] finds the marks that count in each chapter of a long scene.
//! Nothing depends on the order of marks, and a mark and its opposite leave nothing. A small structure may be
//! marked inside of a large one. Clicks and boxes can become masks first ([`Mark::with_mask`]).

mod appearance;
mod carried;
mod cell_grid;
mod cells;
mod chapter_marks;
#[cfg(test)]
mod chapter_tests;
mod conjugate;
mod correction;
mod entry;
mod evidence;
mod flow_to_marked;
mod frame_cache;
mod frame_splats;
mod graph;
mod guided;
mod hints;
mod links;
mod looks;
mod marked_frame;
mod means;
mod mix;
mod names;
mod notes;
mod outside;
mod plan;
mod pointed;
mod read;
#[cfg(test)]
mod read_tests;
mod redetect;
mod scores;
mod seeds;
mod spread;
#[cfg(test)]
mod tests;

pub use crate::annotations::{Canvas, Shape};
pub use carried::{Carried, CarrySettings};
pub use chapter_marks::ChapterMarks;
pub use correction::{Correction, ScoresBefore};
pub use evidence::Evidence;
pub use graph::Graph;
pub use names::join_names;
pub use scores::{FrameScores, LookHere};

use crate::{Error, Result, hash::sha256, sequence::plain_words};
use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    ops::Range,
};

/// Largest number of characters of a name.
const MOST_CHARACTERS: usize = 200;
/// Number of characters of a longer name that messages hold.
const MOST_CHARACTERS_TOLD: usize = 40;

/// A mark by hand on a frame.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(into = "entry::MarkEntry", try_from = "entry::MarkEntry")]
pub struct Mark {
    /// The frame, counted from 0.
    pub frame: usize,
    /// Name of the structure, in plain lower-case words.
    pub name: String,
    /// `true` if the pixels show the structure, `false` if they do not.
    pub add: bool,
    /// The marked pixels.
    pub shape: Shape,
}

/// Marks that fit a recording; their order does not matter. A mark that is given twice counts once, and a
/// mark and its opposite count as if neither had been made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Marks {
    /// The marks as they were given.
    marks: Vec<Mark>,
    /// Places of those that count, ascending.
    standing: Vec<usize>,
}

impl Mark {
    /// Creates a mark; the name becomes plain words.
    pub fn new(frame: usize, name: &str, add: bool, shape: Shape) -> Self {
        Self { frame, name: plain_words(name), add, shape }
    }

    /// Returns `true` if the mark can be on `canvas`.
    pub fn fits(&self, canvas: &Canvas) -> bool {
        self.problem(canvas).is_none()
    }

    /// Returns the reason why the mark cannot be on `canvas`, if there is one.
    fn problem(&self, canvas: &Canvas) -> Option<String> {
        if let Some(problem) = problem_of_name(&self.name) {
            return Some(problem);
        }
        if self.frame >= canvas.num_frames {
            let last = canvas.num_frames.saturating_sub(1);
            return Some(format!("there is no frame {}; the last one is {last}", self.frame));
        }
        self.shape.problem(canvas.width, canvas.height)
    }
}

impl Marks {
    /// Takes marks that fit the recording.
    ///
    /// # Errors
    /// The first mark that lies outside the picture, is on no frame, has no name that can be used, or is made
    /// of numbers that are not finite; the message names it.
    pub fn new(marks: Vec<Mark>, canvas: &Canvas) -> Result<Self> {
        for (i, mark) in marks.iter().enumerate() {
            if let Some(problem) = mark.problem(canvas) {
                return Err(bad_mark(&name_of(i, &mark.name, Some(mark.frame)), &problem));
            }
        }
        Ok(Self::unchecked(marks))
    }

    /// Takes marks that are known to fit.
    pub(crate) fn unchecked(marks: Vec<Mark>) -> Self {
        Self { standing: standing(&marks), marks }
    }

    /// Returns the marks as they were given, with those that do not count.
    pub fn all(&self) -> &[Mark] {
        &self.marks
    }

    /// Returns the marks that count: each once, without those whose opposite is there, too.
    pub fn standing(&self) -> impl Iterator<Item = &Mark> {
        self.standing.iter().map(move |place| &self.marks[*place])
    }

    /// Returns `true` if no marks were given, not even such as do not count.
    pub fn is_empty(&self) -> bool {
        self.marks.is_empty()
    }

    /// Returns the names of the marks that count, sorted, each once.
    pub fn names(&self) -> Vec<String> {
        names_of(self.standing())
    }

    /// Returns the names that some mark shows, sorted, each once. A name of which marks only say what it is
    /// not cannot be looked for, unless features find it.
    pub fn shown_names(&self) -> Vec<String> {
        names_of(self.standing().filter(|mark| mark.add))
    }

    /// Returns the frames of the marks that count, ascending.
    pub fn frames(&self) -> Vec<usize> {
        let frames: BTreeSet<usize> = self.standing().map(|m| m.frame).collect();
        frames.into_iter().collect()
    }

    /// Returns the SHA-256 over the marks that count in a fixed order, hexadecimal.
    pub fn digest(&self) -> String {
        digest(self.standing())
    }

    /// Returns the SHA-256 over the marks of each marked frame, hexadecimal.
    pub(crate) fn digests(&self) -> BTreeMap<usize, String> {
        let mut on: BTreeMap<usize, Vec<&Mark>> = BTreeMap::new();
        for mark in self.standing() {
            on.entry(mark.frame).or_default().push(mark);
        }
        on.into_iter().map(|(frame, marks)| (frame, digest(marks.into_iter()))).collect()
    }

    /// Returns the marks of some names.
    pub fn named(&self, names: &[&String]) -> Self {
        self.filtered(|mark| names.contains(&&mark.name))
    }

    /// Returns the marks on some frames.
    pub(crate) fn within(&self, frames: &Range<usize>) -> Self {
        self.filtered(|mark| frames.contains(&mark.frame))
    }

    /// Returns those marks that count and that `is_wanted`.
    pub(crate) fn filtered(&self, is_wanted: impl Fn(&Mark) -> bool) -> Self {
        let marks: Vec<Mark> = self.standing().filter(|mark| is_wanted(mark)).cloned().collect();
        Self { standing: (0..marks.len()).collect(), marks }
    }

    /// Returns the marks on a frame that count.
    pub fn on(&self, frame: usize) -> impl Iterator<Item = &Mark> {
        self.standing().filter(move |m| m.frame == frame)
    }
}

/// Returns the places of marks that count, ascending: each mark once, without those whose opposite is there,
/// too.
fn standing(marks: &[Mark]) -> Vec<usize> {
    // First place of each mark, denied and added.
    let mut places: HashMap<(usize, &str, String), [Option<usize>; 2]> = HashMap::new();
    for (i, mark) in marks.iter().enumerate() {
        let both = places.entry((mark.frame, mark.name.as_str(), mark.shape.written())).or_default();
        let place = &mut both[usize::from(mark.add)];
        *place = place.or(Some(i));
    }
    let mut standing: Vec<usize> =
        places.into_values().filter_map(|[denied, added]| denied.xor(added)).collect();
    standing.sort_unstable();
    standing
}

/// Returns the names of marks, sorted, each once.
fn names_of<'a>(marks: impl Iterator<Item = &'a Mark>) -> Vec<String> {
    let names: BTreeSet<&str> = marks.map(|mark| mark.name.as_str()).collect();
    names.into_iter().map(str::to_owned).collect()
}

/// Returns `true` if plain words can be the name of a mark. Nobody could look for signs alone.
pub fn is_name(words: &str) -> bool {
    problem_of_name(words).is_none()
}

/// Returns the reason why words cannot be the name of a mark, if there is one.
fn problem_of_name(words: &str) -> Option<String> {
    let length = words.chars().count();
    if words.contains(char::is_control) {
        return Some("its name has control characters".into());
    }
    if length > MOST_CHARACTERS {
        return Some(format!("its name has {length} characters, more than {MOST_CHARACTERS}"));
    }
    (!words.contains(char::is_alphanumeric)).then(|| "it has no name".into())
}

/// Returns the SHA-256 over marks in a fixed order, hexadecimal.
fn digest<'a>(marks: impl Iterator<Item = &'a Mark>) -> String {
    let line = |m: &Mark| format!("{} {:?} {} {}", m.frame, m.name, m.add, m.shape.written());
    let mut lines: Vec<String> = marks.map(line).collect();
    lines.sort_unstable();
    sha256(lines.join("\n").as_bytes())
}

/// Returns the words that name a mark in messages. Of a long name, they hold the beginning.
fn name_of(i: usize, name: &str, frame: Option<usize>) -> String {
    let on = frame.map_or(String::new(), |frame| format!(" on frame {frame}"));
    let mut name = name.replace(char::is_control, "\u{fffd}");
    if name.chars().count() > MOST_CHARACTERS {
        name = name.chars().take(MOST_CHARACTERS_TOLD).chain(['…']).collect();
    }
    if name.is_empty() { format!("marks[{i}]{on}") } else { format!("marks[{i}] (\"{name}\"{on})") }
}

/// Creates the error about one mark.
fn bad_mark(which: &str, problem: &str) -> Error {
    let hint = "Correct this mark; frames count from 0, pixels from the upper left corner.";
    Error::input(format!("{which} cannot be used: {problem}"), hint)
}
