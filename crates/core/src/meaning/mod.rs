//! Meaning of the words of a prompt: which of a scene's classes, if any.
//!
//! Lists of words answer first ([`Vocabulary`]): the names of the classes, then other words for the same,
//! words for a kind of thing, and all of these with a typing mistake. What is in no list is asked of the text
//! encoder ([`Space`]), together with what the single words tell. An encoder is only trusted as far as it was
//! measured to tell meanings apart ([`Calibration`]).
//!
//! A prompt without letters, vectors that are not finite or of a wrong length, and encoders that give all
//! words one vector are no errors: they never find anything.

mod alike;
mod calibration;
mod classes;
mod encoder;
mod facts;
mod grammar;
mod logistic;
mod space;
mod spelling;
mod text;
mod vocabulary;
mod word_files;

pub(crate) use alike::names_alike;
pub use calibration::{Calibration, Fit, Floors};
pub use classes::ClassWords;
pub use encoder::EncoderIdentity;
pub use facts::WordFacts;
pub use space::{Encode, Space};
pub use vocabulary::{Concept, Vocabulary};

use crate::num;
use calibration::name_cosines;
use classes::Class;
use grammar::{KeyFit, Phrase};
use space::{Query, centred, largest};
use std::{collections::BTreeSet, fmt};
use vocabulary::Path;

/// Probability above which a class is meant.
const MEANT: f32 = 0.5;
/// Probability that a listed word means its concept.
const LISTED: f32 = 0.99;
/// Probability that a word is a misspelt one.
const MISSPELT: f32 = 0.9;

/// Meaning of a prompt in a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Meaning {
    /// The classes that are most probably meant, by number; several if the prompt means a kind of thing or if
    /// classes have one name. Only classes that training frames show.
    pub classes: Vec<usize>,
    /// The probability that they are meant; 0 if there are none.
    pub probability: f32,
    /// The class that it looks like to the encoder, if it looks like one that training frames show.
    pub nearest: Option<usize>,
    /// The rule that decided.
    pub reason: Reason,
}

/// Rule that decided on a meaning.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// It is the name of a class.
    ClassName {
        /// `true` if a typing mistake was mended.
        spelled: bool,
    },
    /// It is listed.
    Listed {
        /// The name of the concept that it is listed under.
        concept: String,
        /// `true` if a typing mistake was mended.
        spelled: bool,
        /// `true` if it means all classes of a kind.
        kind: bool,
    },
    /// It names several things, each of which is a name or listed.
    Several {
        /// Those of its parts that are not in the scene.
        missing: Vec<String>,
    },
    /// It says what it does not mean.
    Negated,
    /// It names a place beside something, and no thing.
    Beside,
    /// It is in no list; the encoder and the single words decided.
    Encoder,
    /// Its single words mean something, and all of it means no class.
    SomethingElse,
    /// It means this class, which no training frame shows, or with too few pixels to be learned.
    UnseenClass(usize),
    /// Nothing is known of it: it is in no list, and no encoder was measured that can judge it.
    Unknown,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mended = |spelled: &bool| if *spelled { ", with a typing mistake" } else { "" };
        match self {
            Self::ClassName { spelled } => write!(f, "the name of a class{}", mended(spelled)),
            Self::Listed { concept, spelled, kind } => {
                let means = if *kind { "stands for every" } else { "means" };
                write!(f, "{means} {concept}{}", mended(spelled))
            }
            Self::Several { missing } if missing.is_empty() => write!(f, "stands for several"),
            Self::Several { missing } => write!(f, "stands for several, without {}", missing.join(", ")),
            Self::Negated => write!(f, "says what it is not; only what it is can be looked for"),
            Self::Beside => write!(f, "names a place, not what is there"),
            Self::Encoder => write!(f, "judged by the text encoder"),
            Self::SomethingElse => write!(f, "means something else"),
            Self::UnseenClass(_) => write!(f, "a class that training frames hardly show, or not at all"),
            Self::Unknown => write!(f, "not known"),
        }
    }
}

impl Meaning {
    /// Returns `true` if the prompt more probably means something in the scene than not.
    pub fn is_found(&self) -> bool {
        self.probability > MEANT
    }

    /// The meaning of words of which nothing is known.
    pub fn unknown() -> Self {
        Self::nothing(Reason::Unknown)
    }

    /// Takes the nearest class from `nearest` if none is known. What is not meant is like nothing.
    #[must_use]
    pub fn or_nearest(self, nearest: impl FnOnce() -> Option<usize>) -> Self {
        match self.reason {
            Reason::Negated => self,
            _ => Self { nearest: self.nearest.or_else(nearest), ..self },
        }
    }

    fn nothing(reason: Reason) -> Self {
        Self { classes: Vec::new(), probability: 0.0, nearest: None, reason }
    }
}

/// Tells which of a scene's classes a prompt means.
#[derive(Clone, Debug)]
pub struct Interpreter<'v> {
    vocabulary: &'v Vocabulary,
    classes: Vec<Class>,
    calibration: Option<Calibration>,
}

impl<'v> Interpreter<'v> {
    /// Creates an interpreter for the classes of a scene. Without a calibration, or with one of another
    /// vocabulary, the encoder is not trusted.
    pub fn new(
        vocabulary: &'v Vocabulary,
        classes: &[ClassWords],
        calibration: Option<&Calibration>,
    ) -> Self {
        let fitting = calibration.filter(|c| c.vocabulary == vocabulary.sha256());
        Self { vocabulary, classes: Class::all(vocabulary, classes), calibration: fitting.cloned() }
    }

    /// Tells what a prompt means from lists of words. `None` if they cannot tell, so that
    /// [`Self::by_encoder`] has to.
    pub fn by_words(&self, prompt: &str) -> Option<Meaning> {
        let phrase = self.vocabulary.phrase(prompt);
        if phrase.keys.is_empty() {
            return Some(Meaning::nothing(Reason::Unknown));
        }
        let exact = &phrase.keys[0].text;
        let is_listed = || {
            self.classes.iter().any(|class| class.key == *exact) || self.vocabulary.at_key(exact).is_some()
        };
        if self.vocabulary.says_not(&phrase) && !is_listed() {
            return Some(Meaning::nothing(Reason::Negated));
        }
        if let Some(thing) = self.vocabulary.beside(&phrase).filter(|_| !is_listed()) {
            let thing = self.by_words(&thing);
            let nearest = thing.and_then(|thing| thing.classes.first().copied().or(thing.nearest));
            return Some(Meaning { nearest, ..Meaning::nothing(Reason::Beside) });
        }
        if let Some(named) = self.named(&phrase) {
            return Some(self.meaning(named, 1.0, Reason::ClassName { spelled: false }));
        }
        if let Some((concept, path)) = self.vocabulary.look_up(&phrase) {
            return self.listed(concept, path);
        }
        if let Some(several) = self.several(prompt) {
            return Some(several);
        }
        let may_be_name = |class: &Class| class.is_misspelt_as(&phrase);
        let misspelt = self.classes_that(may_be_name).filter(|_| self.vocabulary.may_be_misspelt(&phrase));
        misspelt.map(|classes| self.meaning(classes, MISSPELT, Reason::ClassName { spelled: true }))
    }

    /// Returns the one class that words are a name of. Words for a kind of things, for several things, or with
    /// a typing mistake are no names.
    pub fn class_called(&self, words: &str) -> Option<usize> {
        let meaning = self.by_words(words)?;
        let is_name = matches!(
            meaning.reason,
            Reason::ClassName { spelled: false } | Reason::Listed { spelled: false, kind: false, .. }
        );
        match meaning.classes[..] {
            [class] if is_name => Some(class),
            _ => None,
        }
    }

    /// Tells what a prompt means from lists of words, and where these cannot tell from its embedding in the
    /// scene's template.
    pub fn by_encoder(&self, prompt: &str, embedding: &[f32], space: &Space<'_>) -> Meaning {
        let by_words = self.by_words(prompt);
        let Some(query) = self.query(embedding, space) else {
            return by_words.unwrap_or(Meaning::nothing(Reason::Unknown));
        };
        let by_encoder = self.nearest(embedding);
        by_words.unwrap_or_else(|| self.judged(prompt, query, space)).or_nearest(|| by_encoder)
    }

    /// The meaning of a prompt that names several things, at least two of which are found by lists of words.
    fn several(&self, prompt: &str) -> Option<Meaning> {
        let words = prompt.replace([',', ';', '/', '&', '+'], " and ").to_lowercase();
        let words: Vec<&str> = words.split_whitespace().collect();
        let parts = words.split(|word| ["and", "or"].contains(word)).filter(|part| !part.is_empty());
        let parts: Vec<String> = parts.map(|part| part.join(" ")).collect();
        if parts.len() < 2 {
            return None;
        }
        let (mut found, mut missing) = (Vec::new(), Vec::new());
        for part in parts {
            match self.by_words(&part).filter(Meaning::is_found) {
                Some(meaning) => found.push(meaning),
                None => missing.push(part),
            }
        }
        let probability = found.iter().map(|meaning| meaning.probability).fold(1.0, f32::min);
        let classes: BTreeSet<usize> = found.iter().flat_map(|meaning| meaning.classes.clone()).collect();
        let reason = Reason::Several { missing };
        (found.len() > 1).then(|| self.meaning(classes.into_iter().collect(), probability, reason))
    }

    /// Returns the class that a prompt looks like to the encoder, if it is nearer to one than unrelated words
    /// are. Only classes that training frames show count.
    pub fn nearest(&self, embedding: &[f32]) -> Option<usize> {
        let calibration = self.calibration.as_ref().filter(|c| c.fit.tells_apart)?;
        let embedding = centred(embedding, &calibration.mean);
        let cosines = name_cosines(&embedding, &calibration.mean, &self.classes).into_iter().enumerate();
        let near = cosines.filter(|(i, cosine)| self.classes[*i].is_seen && *cosine > calibration.floor());
        near.max_by(|a, b| a.1.total_cmp(&b.1).then_with(|| self.by_name(b.0, a.0))).map(|(i, _)| i)
    }

    /// Returns `true` if it is known how far the encoder can be trusted.
    pub fn is_calibrated(&self) -> bool {
        self.calibration.is_some()
    }

    /// Returns how far the encoder can be trusted, if that is known.
    pub fn fit(&self) -> Option<&Fit> {
        self.calibration.as_ref().map(|calibration| &calibration.fit)
    }

    /// A prompt in a space; `None` if the space is of another vocabulary.
    fn query(&self, embedding: &[f32], space: &Space<'_>) -> Option<Query> {
        (space.vocabulary().sha256() == self.vocabulary.sha256()).then(|| space.query(embedding))
    }

    /// The meaning of a prompt of which lists of words cannot tell.
    fn judged(&self, prompt: &str, mut query: Query, space: &Space<'_>) -> Meaning {
        let phrase = self.vocabulary.phrase(prompt);
        let listed = self.vocabulary.look_up(&phrase);
        if let Some((concept, _)) = listed {
            // What it is cannot be a rival of what it may be in this scene.
            query.concepts[concept] = -1.0;
        }
        match (self.likeliest(&phrase, &query, space, listed.is_some()), listed) {
            (Some((class, probability)), _) if listed.is_none() || probability > MEANT => {
                let same = self.classes_that(|other| other.is_same(&self.classes[class]));
                let is_found = probability > MEANT;
                let reason = if is_found { Reason::Encoder } else { self.unfound(&phrase, space) };
                self.meaning(same.unwrap_or_default(), probability, reason)
            }
            (_, Some((concept, path))) => Meaning::nothing(self.reason(concept, path, false)),
            _ => Meaning::nothing(self.unfound(&phrase, space)),
        }
    }

    /// The reason why a phrase in no list means no class.
    fn unfound(&self, phrase: &Phrase, space: &Space<'_>) -> Reason {
        let is_trusted = self.calibration_of(space).is_some_and(|c| c.fit.tells_apart);
        match is_trusted && phrase.is_latin() {
            _ if self.vocabulary.knows_words(phrase) => Reason::SomethingElse,
            true => Reason::Encoder,
            false => Reason::Unknown,
        }
    }

    /// The calibration, if it is of the encoder that a space is of.
    fn calibration_of(&self, space: &Space<'_>) -> Option<&Calibration> {
        self.calibration
            .as_ref()
            .filter(|c| c.encoder == space.encoder() && c.mean.len() == space.mean().len())
    }

    /// Order of two classes by their names, which decides between equals.
    fn by_name(&self, a: usize, b: usize) -> std::cmp::Ordering {
        self.classes[a].name.cmp(&self.classes[b].name)
    }

    /// The classes that a test accepts, if there are any.
    fn classes_that(&self, accepts: impl Fn(&Class) -> bool) -> Option<Vec<usize>> {
        let accepted: Vec<_> = (0..self.classes.len()).filter(|&i| accepts(&self.classes[i])).collect();
        (!accepted.is_empty()).then_some(accepted)
    }

    /// The classes that a phrase names. A looser form of it that is a name does not count if a stricter one
    /// is listed as something else.
    fn named(&self, phrase: &Phrase) -> Option<Vec<usize>> {
        for key in &phrase.keys {
            let named = self.classes_that(|class| class.key == key.text);
            if named.is_some() || self.vocabulary.at_key(&key.text).is_some() {
                return named;
            }
        }
        None
    }

    /// The meaning of words that are listed under a concept; `None` if it is not a class's, and there are
    /// classes of which no concept is known.
    fn listed(&self, concept: usize, path: Path) -> Option<Meaning> {
        let concepts = self.vocabulary.concepts();
        let reason = |kind| self.reason(concept, path, kind);
        let probability = if path == Path::Spelling { MISSPELT } else { LISTED };
        if let Some(same) = self.classes_that(|class| class.concept == Some(concept)) {
            return Some(self.meaning(same, probability, reason(false)));
        }
        if self.vocabulary.is_kind(concept) && path == Path::Key(KeyFit::Exact) {
            let group = &concepts[concept].group;
            let of_kind = |class: &Class| class.concept.is_some_and(|other| concepts[other].group == *group);
            if let Some(kind) = self.classes_that(of_kind) {
                return Some(self.meaning(kind, probability, reason(true)));
            }
        }
        let all_known = self.classes.iter().all(|class| class.concept.is_some());
        all_known.then(|| Meaning { nearest: self.kin_of(concept), ..Meaning::nothing(reason(false)) })
    }

    /// The class that a concept is a part or a kind of, or the other way round: "gallbladder fundus".
    fn kin_of(&self, concept: usize) -> Option<usize> {
        let near = self.vocabulary.near(concept);
        let is_kin =
            |class: &Class| class.is_seen && class.concept.is_some_and(|other| near.contains(&other));
        self.classes_that(is_kin).and_then(|classes| classes.first().copied())
    }

    fn reason(&self, concept: usize, path: Path, kind: bool) -> Reason {
        let concept = self.vocabulary.concepts()[concept].name.clone();
        Reason::Listed { concept, spelled: path == Path::Spelling, kind }
    }

    /// A meaning, in which only classes that training frames show are kept.
    fn meaning(&self, classes: Vec<usize>, probability: f32, reason: Reason) -> Meaning {
        let first = classes.first().copied();
        let seen: Vec<_> = classes.into_iter().filter(|&i| self.classes[i].is_seen).collect();
        match first {
            Some(unseen) if seen.is_empty() && probability > MEANT => {
                Meaning::nothing(Reason::UnseenClass(unseen))
            }
            _ if seen.is_empty() => Meaning::nothing(reason),
            _ => Meaning { classes: seen, probability, nearest: None, reason },
        }
    }

    /// The class that a phrase in no list means most probably, with the probability. If the phrase is listed
    /// after all, only classes without a concept count.
    fn likeliest(
        &self,
        phrase: &Phrase,
        query: &Query,
        space: &Space<'_>,
        listed: bool,
    ) -> Option<(usize, f32)> {
        let untrusted = Fit::default();
        let calibration = self.calibration_of(space);
        let fit = calibration.map_or(&untrusted, |c| &c.fit);
        let floor = calibration.map_or(1.0, Calibration::floor);
        let cosines = query.class_cosines(space, &self.classes);
        let candidates = (0..self.classes.len()).filter(|&i| !listed || self.classes[i].concept.is_none());
        let odds = candidates.filter_map(|i| {
            let class = &self.classes[i];
            let words = class.content.iter().map(String::as_str).collect();
            let clues = self.vocabulary.clues(phrase, &words, class.concept)?;
            let lead = cosines[i] - self.best_rival(i, query, &cosines);
            Some((i, fit.log_odds(clues, cosines[i], lead, floor)))
        });
        let order = |a: &(usize, f32), b: &(usize, f32)| {
            let by_cosine = cosines[a.0].total_cmp(&cosines[b.0]);
            a.1.total_cmp(&b.1).then(by_cosine).then_with(|| self.by_name(b.0, a.0))
        };
        odds.max_by(order).map(|(i, odds)| (i, num::sigmoid(odds)))
    }

    /// The largest cosine with a concept or class that is not the given class.
    fn best_rival(&self, class: usize, query: &Query, cosines: &[f32]) -> f32 {
        let concepts = query.concepts.iter().enumerate();
        let other_concepts = concepts.filter(|(i, _)| Some(*i) != self.classes[class].concept);
        let classes = cosines.iter().enumerate();
        let other_classes = classes.filter(|(i, _)| !self.classes[*i].is_same(&self.classes[class]));
        largest(other_concepts.chain(other_classes).map(|(_, cosine)| *cosine))
    }
}

#[cfg(test)]
mod tests;
