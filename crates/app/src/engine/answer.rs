//! Answers to prompts: it is here, it looks like something else, it is not in this recording, or the words
//! are not understood.

use surgtpgs_core::{
    meaning::{Meaning, Reason},
    sequence::Class,
};

/// Answer on a frame, or on several. Of a prompt that may be found, the frames decide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It is here.
    Found,
    /// It is not here, but something that is like it.
    Nearest,
    /// It is not here.
    Absent,
    /// The scene shows nothing here.
    NotShown,
}

impl Verdict {
    /// Returns its name in tables and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Found => "found",
            Self::Nearest => "nearest",
            Self::Absent => "absent",
            Self::NotShown => "not_shown",
        }
    }
}

/// Reading of an answer where nothing is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Absence {
    /// It is not in the recording.
    NotThere,
    /// Nothing can be said: only what is marked by hand can be looked for, and the words mean none of it.
    NeedsMark,
    /// The words are not understood, so that nobody knows if what they mean is there.
    NotUnderstood,
}

impl Absence {
    /// Says it.
    pub(crate) fn words(self) -> &'static str {
        match self {
            Self::NotThere => "not in this recording",
            Self::NeedsMark => "cannot be looked for: mark it by hand",
            Self::NotUnderstood => {
                "these words are not known here: try another (English or Latin) word, or mark it by hand"
            }
        }
    }

    /// Says it where there is little room.
    pub(crate) fn in_short(self) -> &'static str {
        if self == Self::NotUnderstood { "words not known here" } else { self.words() }
    }
}

/// Answer of a scene to a prompt, whatever the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Probability that the words mean something that the scene knows, 0–1. No score is higher.
    pub certainty: f32,
    /// Class that is most like the words, if any is like them at all and they do not mean one.
    pub nearest: Option<String>,
    /// Reason, in a few words.
    pub why: String,
    /// Reading of it where nothing is found.
    pub absence: Absence,
}

impl Answer {
    /// Says what `meaning` comes to among the known classes. They `are_marked` if only marks name them.
    pub(super) fn new(meaning: &Meaning, known: &[(Class, Vec<f32>)], are_marked: bool) -> Self {
        let may_be_found = meaning.is_found();
        let nearest = meaning.nearest.filter(|_| !may_be_found).and_then(|k| known.get(k));
        let certainty = if meaning.classes.is_empty() { 0.0 } else { meaning.probability };
        let nearest = nearest.map(|(class, _)| class.name.clone());
        let absence = if are_marked && !may_be_found && !matches!(meaning.reason, Reason::Negated) {
            Absence::NeedsMark
        } else if !may_be_found && meaning.reason == Reason::Unknown {
            Absence::NotUnderstood
        } else {
            Absence::NotThere
        };
        let why = match absence {
            Absence::NotThere => meaning.reason.to_string(),
            Absence::NeedsMark => "only what is marked by hand can be looked for here".into(),
            Absence::NotUnderstood => "it is in no list of English and Latin words".into(),
        };
        Self { certainty, nearest, why, absence }
    }

    /// The answer to an embedding that is compared as it is.
    pub(super) fn compared(why: &str) -> Self {
        Self { certainty: 1.0, nearest: None, why: why.to_owned(), absence: Absence::NotThere }
    }

    /// Returns `true` if an export writes something for the words: a score above `threshold` is possible, or
    /// the class that is most like them is to be written.
    pub(crate) fn is_exported(&self, threshold: f32, writes_nearest: bool) -> bool {
        self.may_be_found(threshold) || (writes_nearest && self.nearest.is_some())
    }

    /// Returns `true` if a score above `threshold` is possible.
    pub fn may_be_found(&self, threshold: f32) -> bool {
        self.certainty > threshold
    }

    /// Returns the verdict on a frame, or on several: what was found there, and if the nearest class is there.
    pub fn verdict(&self, is_found: bool, shows_nearest: bool) -> Verdict {
        match (is_found, &self.nearest) {
            (true, _) => Verdict::Found,
            (false, Some(_)) if shows_nearest => Verdict::Nearest,
            _ => Verdict::Absent,
        }
    }
}
