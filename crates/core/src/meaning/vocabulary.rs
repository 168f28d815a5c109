//! The words that the program knows, by what they mean.

use super::{
    grammar::{Grammar, KeyFit, Phrase, token_set},
    spelling::Spelling,
    word_files::{self, Bank, Groups, Lexicon},
};
use crate::{Result, hash::sha256};
use std::{
    collections::{HashMap, HashSet},
    ops::Range,
    sync::LazyLock,
};

/// Every how many words of the lexicon's other English one is asked of the encoder.
const UNRELATED_EVERY: usize = 8;
/// Shortest token that is corrected.
const MIN_TOKEN: usize = 4;
/// Shortest phrase that is corrected as a whole, in letters.
const MIN_PHRASE: usize = 7;

/// A meaning, with all words for it.
#[derive(Debug)]
pub struct Concept {
    /// The first of its words.
    pub name: String,
    /// The kind of thing that it is. The concept named like its group stands for everything in it.
    pub group: String,
    /// All words for it, its name first.
    pub words: Vec<String>,
    /// Number of its words, from the first on, that are in the lexicon of the built-in encoder.
    pub(super) num_in_lexicon: usize,
    /// The content of each word.
    pub(super) contents: Vec<Vec<String>>,
}

/// Largest number of synonyms of a concept that are encoded. More take long and tell little more.
const MOST_SYNONYMS: usize = 2;

impl Concept {
    /// The words that an encoder is asked for: the name, and some synonyms if they are in the lexicon.
    pub(super) fn encoded(&self) -> &[String] {
        let synonyms = self.num_in_lexicon.saturating_sub(1).min(MOST_SYNONYMS);
        &self.words[..(1 + synonyms).min(self.words.len())]
    }
}

/// Way from words to a concept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Path {
    /// They are listed, or were after something was left out.
    Key(KeyFit),
    /// They are listed once a typing mistake is mended.
    Spelling,
}

/// Clues in the single words of a prompt to whether it means a class.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Clues {
    /// 1 if every word of content is one of the class's words.
    pub covered: f64,
    /// If so, how telling the most telling one is: one over the number of concepts that use it. Else 0.
    pub telling: f64,
    /// 1 if not, but the head noun means the class: "fenestrated grasper".
    pub head: f64,
}

/// The words that the program knows: concepts, rules of grammar, English that means something else.
#[derive(Debug, Default)]
pub struct Vocabulary {
    concepts: Vec<Concept>,
    grammar: Grammar,
    /// Concept of each key.
    by_key: HashMap<String, usize>,
    longest_key: usize,
    /// Number of concepts that use each token.
    uses: HashMap<String, usize>,
    /// Tokens of English and grammar, whatever they mean. Those that only concepts use are not among them.
    english: HashSet<String>,
    /// Tokens that are no typing mistakes.
    known: HashSet<String>,
    /// Tokens that show that something else is meant.
    everyday: HashSet<String>,
    /// Concepts that say little of what a thing is.
    generic: HashSet<usize>,
    /// Concepts whose meanings overlap, both ways round.
    near: HashMap<usize, Vec<usize>>,
    unrelated: Vec<String>,
    token_spelling: Spelling,
    key_spelling: Spelling,
    sha256: String,
}

impl Vocabulary {
    /// Returns the vocabulary that comes with the program.
    pub fn standard() -> &'static Self {
        static STANDARD: LazyLock<Vocabulary> = LazyLock::new(|| {
            Vocabulary::parse(word_files::LEXICON, word_files::BANK).expect("a test reads these files")
        });
        &STANDARD
    }

    /// Reads a vocabulary from the texts of a lexicon and a bank. Empty texts give one that knows no word.
    pub fn parse(lexicon: &str, bank: &str) -> Result<Self> {
        let hash = sha256(format!("{}\n{}", sha256(lexicon.as_bytes()), sha256(bank.as_bytes())).as_bytes());
        let (lexicon, bank): (Lexicon, Bank) = (word_files::parse(lexicon)?, word_files::parse(bank)?);
        let mut new = Self {
            grammar: Grammar::new(&bank.grammar, &lexicon.neutral.words),
            sha256: hash,
            ..Self::default()
        };
        new.add_concepts(&lexicon.concepts, true);
        new.add_concepts(&bank.concepts, false);
        new.index();
        new.relate(&lexicon, &bank);
        new.learn_other_words(&lexicon, &bank);
        Ok(new)
    }

    /// Adds concepts; those that are there already get more words.
    fn add_concepts(&mut self, groups: &Groups, in_lexicon: bool) {
        let mut by_name: HashMap<_, _> =
            self.concepts.iter().enumerate().map(|(i, concept)| (concept.name.clone(), i)).collect();
        for (group, concepts) in groups {
            for (name, others) in concepts {
                let i = *by_name.entry(name.clone()).or_insert(self.concepts.len());
                if i == self.concepts.len() {
                    let (name, group, words) = (name.clone(), group.clone(), vec![name.clone()]);
                    self.concepts.push(Concept {
                        name,
                        group,
                        words,
                        num_in_lexicon: 0,
                        contents: Vec::new(),
                    });
                }
                let concept = &mut self.concepts[i];
                for word in others {
                    if !concept.words.contains(word) {
                        concept.words.push(word.clone());
                    }
                }
                if in_lexicon {
                    concept.num_in_lexicon = concept.words.len();
                }
            }
        }
    }

    /// Fills what concepts are found by. Where two concepts claim a key, the stricter one has it, then the
    /// earlier one.
    fn index(&mut self) {
        let mut loose = Vec::new();
        for (i, concept) in self.concepts.iter_mut().enumerate() {
            let mut tokens = HashSet::new();
            for word in &concept.words {
                let phrase = self.grammar.phrase(word);
                let mut keys = phrase.keys.into_iter().filter(|key| key.fit != KeyFit::Part);
                if let Some(key) = keys.next() {
                    self.by_key.entry(key.text).or_insert(i);
                }
                loose.extend(keys.map(|key| (key.text, i)));
                concept.contents.push(phrase.content);
                tokens.extend(phrase.tokens);
            }
            for token in tokens {
                *self.uses.entry(token).or_default() += 1;
            }
        }
        for (key, i) in loose {
            self.by_key.entry(key).or_insert(i);
        }
        self.longest_key = self.by_key.keys().map(String::len).max().unwrap_or(0);
        self.token_spelling = Spelling::new(self.uses.keys());
        self.key_spelling = Spelling::new(self.by_key.keys().filter(|key| key.len() >= MIN_PHRASE));
    }

    fn relate(&mut self, lexicon: &Lexicon, bank: &Bank) {
        let by_name: HashMap<_, _> =
            self.concepts.iter().enumerate().map(|(i, concept)| (&*concept.name, i)).collect();
        self.generic = bank.grammar.generic.iter().filter_map(|name| by_name.get(&**name).copied()).collect();
        for (a, b) in &lexicon.near {
            if let (Some(&a), Some(&b)) = (by_name.get(&**a), by_name.get(&**b)) {
                self.near.entry(a).or_default().push(b);
                self.near.entry(b).or_default().push(a);
            }
        }
    }

    /// Sorts out which words are English but nothing that the operating room has.
    fn learn_other_words(&mut self, lexicon: &Lexicon, bank: &Bank) {
        let other =
            [&lexicon.other.words, &lexicon.other.held_out, &bank.everyday.words].map(|w| token_set(w));
        let is_everyday = |concept: &&Concept| bank.everyday.groups.contains(&concept.group);
        let tokens_of =
            |concept: &Concept| concept.words.iter().flat_map(|word| token_set(word)).collect::<Vec<_>>();
        let (everyday, surgical): (Vec<_>, Vec<_>) = self.concepts.iter().partition(is_everyday);
        self.everyday = other.iter().flatten().cloned().collect();
        self.everyday.extend(everyday.iter().flat_map(|concept| tokens_of(concept)));
        for token in surgical.iter().flat_map(|concept| tokens_of(concept)) {
            self.everyday.remove(&token);
        }
        let grammar = &self.grammar;
        self.everyday.retain(|token| !grammar.is_neutral(token) && !grammar.is_part(token));

        self.english = grammar.words().chain(other.iter().flatten()).cloned().collect();
        self.english.extend(token_set(&bank.real_words.words));
        self.known = self.uses.keys().chain(&self.english).cloned().collect();
        let asked = lexicon.other.words.split_whitespace().step_by(UNRELATED_EVERY).map(str::to_owned);
        self.unrelated = asked.chain(everyday.iter().map(|concept| concept.name.clone())).collect();
    }

    /// Returns all concepts.
    pub fn concepts(&self) -> &[Concept] {
        &self.concepts
    }

    /// Returns the hash of the files that the vocabulary was read from.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Returns the number of the concept that words are listed under, also if they hold a typing mistake.
    pub fn concept_of(&self, words: &str) -> Option<usize> {
        self.look_up(&self.phrase(words)).map(|(concept, _)| concept)
    }

    /// The concepts that a concept is a kind or part of, and those that are so of it.
    pub fn near(&self, concept: usize) -> &[usize] {
        self.near.get(&concept).map_or(&[], Vec::as_slice)
    }

    /// Words that mean nothing in an operating room.
    pub(super) fn unrelated(&self) -> &[String] {
        &self.unrelated
    }

    pub(super) fn phrase(&self, words: &str) -> Phrase {
        self.grammar.phrase(words)
    }

    /// Returns `true` if a phrase says what is not meant.
    pub(super) fn says_not(&self, phrase: &Phrase) -> bool {
        self.grammar.says_not(&phrase.tokens)
    }

    /// Returns the words of the thing beside which a phrase names a place.
    pub(super) fn beside(&self, phrase: &Phrase) -> Option<String> {
        self.grammar.beside(&phrase.tokens).map(|thing| thing.join(" "))
    }

    /// Tests whether each word of content means something by itself: it is English or listed.
    pub(super) fn knows_words(&self, phrase: &Phrase) -> bool {
        let is_known = |token: &String| self.english.contains(token) || self.at_key(token).is_some();
        !phrase.content.is_empty() && phrase.content.iter().all(is_known)
    }

    /// Tests whether a concept stands for everything in its group.
    pub(super) fn is_kind(&self, concept: usize) -> bool {
        self.concepts[concept].name == self.concepts[concept].group
    }

    /// The concept that a phrase is listed under.
    pub(super) fn look_up(&self, phrase: &Phrase) -> Option<(usize, Path)> {
        self.listed(phrase).or_else(|| Some((self.misspelt(phrase)?, Path::Spelling)))
    }

    /// The concept of a key.
    pub(super) fn at_key(&self, key: &str) -> Option<usize> {
        self.by_key.get(key).copied()
    }

    fn listed(&self, phrase: &Phrase) -> Option<(usize, Path)> {
        phrase.keys.iter().find_map(|key| Some((self.at_key(&key.text)?, Path::Key(key.fit))))
    }

    /// The concept of a phrase once each word is corrected, or else the only one whose key is one mistake
    /// from the whole ("gal bladder").
    fn misspelt(&self, phrase: &Phrase) -> Option<usize> {
        let tokens = phrase.tokens.iter().map(|token| self.corrected(token).unwrap_or(token).to_owned());
        let tokens: Vec<_> = tokens.collect();
        if tokens != phrase.tokens
            && let Some((concept, _)) = self.listed(&self.grammar.phrase_of(tokens))
        {
            return Some(concept);
        }
        if phrase.bare.len() < MIN_PHRASE || !self.may_be_misspelt(phrase) {
            return None;
        }
        let mut near = self.key_spelling.near(&phrase.bare).filter_map(|key| self.at_key(key));
        let first = near.next()?;
        near.all(|other| other == first).then_some(first)
    }

    /// Tests whether a phrase has something that is not a known word. Numbers are no mistakes.
    pub(super) fn may_be_misspelt(&self, phrase: &Phrase) -> bool {
        // So short a token may be the rest of a parted word: "gal bladder".
        let is_known = |token: &String| {
            self.grammar.is_tie(token)
                || token.bytes().all(|b| b.is_ascii_digit())
                || token.len() >= MIN_TOKEN && self.known.contains(token)
        };
        !self.known.contains(&phrase.bare) && !phrase.tokens.iter().all(is_known)
    }

    /// The listed token that an unknown one is most likely meant to be.
    fn corrected<'a>(&'a self, token: &'a str) -> Option<&'a str> {
        let is_plain = token.bytes().all(|b| b.is_ascii_lowercase());
        if token.len() < MIN_TOKEN || !is_plain || self.known.contains(token) {
            return None;
        }
        if let Some(undoubled) = self.token_spelling.undoubled(token) {
            return Some(undoubled);
        }
        let near = || self.token_spelling.near(token);
        if token.len() == MIN_TOKEN {
            // So short a word has many neighbours; only a left-out letter counts.
            let mut longer = near().filter(|listed| listed.len() > MIN_TOKEN);
            return longer.next().filter(|_| longer.next().is_none());
        }
        let same_initial = near().find(|listed| listed.len() > MIN_TOKEN && listed[..1] == token[..1]);
        same_initial.or_else(|| near().find(|listed| listed.len() > MIN_TOKEN + 1))
    }

    /// The concept of the longest end of a phrase's subject that is listed, if that says more than "this is
    /// a thing of the class's kind". The whole phrase does not count.
    pub(super) fn head_concept(&self, phrase: &Phrase, class: Option<usize>) -> Option<usize> {
        let subject = &phrase.subject;
        if self.grammar.is_part(subject.last()?) {
            return None;
        }
        let concept = self.ends(phrase).find_map(|from| self.at_key(&subject[from..].concat()))?;
        (!self.is_generic(concept, class)).then_some(concept)
    }

    /// Beginnings of those ends of a phrase's subject that are short enough to be listed.
    fn ends(&self, phrase: &Phrase) -> Range<usize> {
        let mut length = 0;
        let fits = |token: &&String| {
            length += token.len();
            length <= self.longest_key
        };
        let tokens = phrase.subject.len();
        let fitting = phrase.subject.iter().rev().take_while(fits).count();
        (tokens - fitting).max(usize::from(!phrase.has_more))..tokens
    }

    /// Tests whether a concept says little of what a thing is beside the class's own concept.
    fn is_generic(&self, concept: usize, class: Option<usize>) -> bool {
        let same_group = |class: usize| self.concepts[class].group == self.concepts[concept].group;
        self.generic.contains(&concept) || (self.is_kind(concept) && class.is_none_or(same_group))
    }

    /// Clues in the words of a phrase to a class with the given words of content and concept. `None` if they
    /// say that something else is meant:
    /// - its head noun means something else: "gallbladder cancer";
    /// - a word of content is everyday English that the class does not use: "black cat";
    /// - it shares words with the class, but its head noun is unknown: "bowel obstruction".
    pub(super) fn clues(
        &self,
        phrase: &Phrase,
        words: &HashSet<&str>,
        class: Option<usize>,
    ) -> Option<Clues> {
        let is_own = |token: &&String| words.contains(token.as_str());
        let own = || phrase.content.iter().filter(is_own);
        let head = self.head_concept(phrase, class);
        let is_everyday = phrase.content.iter().any(|token| !is_own(&token) && self.everyday.contains(token));
        let is_unknown = |noun: &String| !is_own(&noun) && !self.is_general_noun(noun, class);
        let has_unknown_head = own().next().is_some() && phrase.subject.last().is_some_and(is_unknown);
        if (head.is_some() && head != class) || is_everyday || has_unknown_head {
            return None;
        }
        let covered = !phrase.content.is_empty() && own().count() == phrase.content.len();
        let telling = own().map(|token| 1.0 / self.uses.get(token).map_or(1.0, |&uses| uses as f64));
        Some(Clues {
            covered: f64::from(u8::from(covered)),
            telling: if covered { telling.fold(0.0, f64::max) } else { 0.0 },
            head: f64::from(u8::from(!covered && head.is_some())),
        })
    }

    /// Tests whether a noun means a part, or is the last word of a generic concept.
    fn is_general_noun(&self, noun: &str, class: Option<usize>) -> bool {
        let ends_so = |concept: &Concept| {
            concept.contents.iter().any(|content| content.last().is_some_and(|last| last == noun))
        };
        let mut concepts = self.concepts.iter().enumerate();
        self.grammar.is_part(noun)
            || concepts.any(|(i, concept)| self.is_generic(i, class) && ends_so(concept))
    }
}
