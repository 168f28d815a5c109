//! From questions to queries: what the words mean in a scene, and what they compete with.

use super::{EncoderChoice, Negatives, Question, Sample, answer::Answer, no_features, opening::open_encoder};
use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    sync::Arc,
};
use surgtpgs_clip::TextEncoder;
use surgtpgs_core::{
    Error, Result,
    meaning::{
        Calibration, ClassWords, EncoderIdentity, Fit, Interpreter, Meaning, Reason, Space, Vocabulary,
    },
    num,
    relevancy::{Query, RelevancySettings, Rivals},
    scene::Scene,
    sequence::{Class, NO_LABEL, is_same_name},
};

/// The questions that a scene is asked, and everything that is needed to understand them.
pub(super) struct Asking {
    choice: EncoderChoice,
    /// Opened when it is needed first: looking at a scene needs no encoder.
    encoder: Option<TextEncoder>,
    /// Embeddings of words in the template.
    prompts: BTreeMap<String, Vec<f32>>,
    /// Embeddings of words without it.
    phrases: BTreeMap<String, Vec<f32>>,
    /// The words' space of the encoder; made for the first word that is in no table.
    space: Option<Space<'static>>,
    interpreter: Interpreter<'static>,
    /// The scene's classes.
    classes: Arc<Rivals>,
    /// Concepts of the vocabulary, for scenes without several classes.
    concepts: Option<Arc<Rivals>>,
    /// Classes that prompts may mean: the scene's, then those that only marks name.
    known: Vec<(Class, Vec<f32>)>,
    /// Questions of before.
    understood: HashMap<Question, Understood>,
    pub(super) queries: Vec<Query>,
    pub(super) answers: Vec<Answer>,
    /// Names of the classes that each question means.
    pub(super) meant: Vec<Vec<String>>,
    /// Names of the classes whose corrections change each question.
    pub(super) corrected: Vec<Vec<String>>,
}

/// A question, as the scene understands it.
#[derive(Clone)]
struct Understood {
    query: Query,
    answer: Answer,
    /// Places of what it means among the known classes.
    meant: Vec<usize>,
    /// Places of those whose corrections change it.
    corrected: Vec<usize>,
}

/// Number of questions of before that are kept.
const MOST_UNDERSTOOD: usize = 1000;

impl Asking {
    pub(super) fn new(scene: &Scene, choice: EncoderChoice, settings: &RelevancySettings) -> Self {
        Self {
            choice,
            encoder: None,
            prompts: BTreeMap::new(),
            phrases: BTreeMap::new(),
            space: None,
            interpreter: Interpreter::new(
                Vocabulary::standard(),
                &class_words(scene, &scene.classes, settings),
                scene.words.calibration.as_ref(),
            ),
            classes: Rivals::new(
                scene.classes.iter().map(|(class, row)| (class.name.as_str(), row.as_slice())),
            ),
            concepts: None,
            known: scene.classes.clone(),
            understood: HashMap::new(),
            queries: Vec::new(),
            answers: Vec::new(),
            meant: Vec::new(),
            corrected: Vec::new(),
        }
    }

    /// Takes over an open text encoder, if it is the one that the scene was prepared with.
    pub(super) fn with_encoder(self, scene: &Scene, encoder: Option<TextEncoder>) -> Self {
        let encoder = encoder.filter(|open| open.identity().sha256 == encoder_sha256(scene));
        Self { encoder, ..self }
    }

    /// Gives the text encoder away, if it is open.
    pub(super) fn give_encoder(&mut self) -> Option<TextEncoder> {
        self.encoder.take()
    }

    /// Returns the names of the scene's classes by other words for them.
    pub(super) fn class_names<'a>(
        scene: &'a Scene,
        settings: &RelevancySettings,
    ) -> impl Fn(&str) -> Option<String> + 'a {
        let words = class_words(scene, &scene.classes, settings);
        let interpreter = Interpreter::new(Vocabulary::standard(), &words, None);
        move |name| interpreter.class_called(name).map(|k| scene.classes[k].0.name.clone())
    }

    /// Makes the names of marks classes, beside those of the scene; forgets the questions.
    pub(super) fn know(
        &mut self,
        scene: &Scene,
        settings: &RelevancySettings,
        names: &[String],
    ) -> Result<()> {
        let is_new = |name: &&String| !scene.classes.iter().any(|(class, _)| class.name == **name);
        let names: Vec<&str> = names.iter().filter(is_new).map(String::as_str).collect();
        let rows =
            if names.is_empty() { Vec::new() } else { self.open_encoder(scene)?.encode_prompts(&names)? };
        self.forget(scene, settings);
        if names.is_empty() {
            return Ok(());
        }
        let class = |name: &&str| Class { id: NO_LABEL, name: (*name).to_owned(), colour: [0; 3] };
        self.known.extend(names.iter().map(class).zip(rows));
        let words = class_words(scene, &self.known, settings);
        self.interpreter = Interpreter::new(Vocabulary::standard(), &words, scene.words.calibration.as_ref());
        Ok(())
    }

    /// Forgets the questions, and begins anew with other settings.
    pub(super) fn forget(&mut self, scene: &Scene, settings: &RelevancySettings) {
        let (encoder, choice) = (self.encoder.take(), std::mem::take(&mut self.choice));
        *self = Self { encoder, ..Self::new(scene, choice, settings) };
    }

    /// Returns the query of a name, with what the settings compare it with: of a class, or of words that are
    /// asked as a prompt is.
    pub(super) fn query_of(
        &mut self,
        scene: &Scene,
        settings: &RelevancySettings,
        name: &str,
    ) -> Result<Query> {
        let question = Question::words(name, Negatives::of(settings));
        let Some(place) = scene.classes.iter().position(|(class, _)| class.name == name) else {
            self.encode(scene, std::slice::from_ref(&question))?;
            return Ok(self.understand(scene, settings, &question)?.query);
        };
        let (class, row) = &scene.classes[place];
        let query = Query::new(&class.name, row.clone());
        if settings.class_negatives {
            return Ok(query.among(&self.classes, vec![place]));
        }
        self.encode(scene, std::slice::from_ref(&question))?;
        let phrases = question.negatives.phrases.iter().map(|p| (p.clone(), self.phrases[p].clone()));
        Ok(query.but_not(phrases.collect()))
    }

    /// Returns the text encoder in use, or that of the scene as long as no words needed one.
    pub(super) fn encoder(&mut self, scene: &Scene) -> Result<EncoderIdentity> {
        match self.encoder.as_ref().map(TextEncoder::identity).or(scene.encoder.as_ref()) {
            Some(known) => Ok(known.clone()),
            None => Ok(self.open_encoder(scene)?.identity().clone()),
        }
    }

    /// Sets the questions, see [`super::Engine::set_questions`]. `has_marks` says that there are marks, even if
    /// they show nothing: then questions have an answer without features, too.
    pub(super) fn set(
        &mut self,
        scene: &Scene,
        settings: &RelevancySettings,
        has_marks: bool,
        questions: &[Question],
    ) -> Result<()> {
        if questions.is_empty() {
            self.queries.clear();
            self.answers.clear();
            self.meant.clear();
            self.corrected.clear();
            return Ok(());
        }
        if questions.iter().any(|q| q.text.trim().is_empty()) {
            return Err(Error::input("a prompt is empty", "Give a few words, such as \"gallbladder\"."));
        }
        if scene.codec.is_none() && self.known.is_empty() && !has_marks {
            return Err(no_features(scene));
        }
        self.encode(scene, questions)?;
        if self.understood.len() > MOST_UNDERSTOOD {
            self.understood.clear();
        }
        let mut understood = Vec::with_capacity(questions.len());
        for question in questions {
            if !self.understood.contains_key(question) {
                let new = self.understand(scene, settings, question)?;
                scene.codec.as_ref().map_or(Ok(()), |codec| new.query.check(codec))?;
                self.understood.insert(question.clone(), new);
            }
            understood.extend(self.understood.get(question).cloned());
        }
        let names = |places: &[usize]| places.iter().map(|k| self.known[*k].0.name.clone()).collect();
        self.meant = understood.iter().map(|u| names(&u.meant)).collect();
        self.corrected = understood.iter().map(|u| names(&u.corrected)).collect();
        (self.queries, self.answers) = understood.into_iter().map(|u| (u.query, u.answer)).unzip();
        Ok(())
    }

    /// Returns the query of a question whose words are encoded, and what the scene says to it.
    fn understand(
        &mut self,
        scene: &Scene,
        settings: &RelevancySettings,
        question: &Question,
    ) -> Result<Understood> {
        let (text, negatives) = (question.text.trim(), &question.negatives);
        let mut own: Vec<(String, Vec<f32>)> =
            negatives.phrases.iter().map(|p| (p.clone(), self.phrases[p].clone())).collect();
        for (name, sample) in &negatives.samples {
            own.push((name.clone(), embedding_of(scene, name, sample)?));
        }
        let embedding = match &question.like {
            Some(sample) => embedding_of(scene, text, sample)?,
            None => self.prompts[text].clone(),
        };
        let query = Query::new(text, embedding.clone()).but_not(own);
        let (query, answer) = match &question.like {
            // Without features, marks are all that can be asked for.
            _ if !negatives.uses_classes && scene.codec.is_some() => {
                let named = self.interpreter.by_words(text).filter(|_| question.like.is_none());
                let meant = named.map_or_else(Vec::new, |meaning| meaning.classes);
                let corrected = self.corrected_by(scene, question, &meant);
                let answer = Answer::compared("compared as it is");
                return Ok(Understood { query, answer, meant, corrected });
            }
            Some(_) => {
                let nearest = nearest_class(scene, &embedding).into_iter().collect();
                (query.among(&self.classes, nearest), Answer::compared("like a point of the picture"))
            }
            None if scene.codec.is_none() && self.known.is_empty() => {
                (query, Answer::new(&Meaning::unknown(), &self.known, true))
            }
            None if !scene.classes.is_empty() || scene.codec.is_none() => {
                let meaning = self.meaning(scene, settings, text, &embedding)?;
                return self.among_classes(scene, question, query, meaning);
            }
            None => {
                let (rivals, allies) = self.concepts_beside(scene, &[(text, &embedding)])?;
                let compared = query.clone().among(&rivals, allies);
                // Where nothing but marks has names, features answer all words that mean none of these.
                if !self.known.is_empty() {
                    let meaning = self.meaning(scene, settings, text, &embedding)?;
                    let is_marked = meaning.is_found() || question.shows_nearest;
                    let marked = self.among_classes(scene, question, query, meaning)?;
                    if is_marked && !marked.meant.is_empty() {
                        return Ok(Understood { query: compared, ..marked });
                    }
                }
                (compared, Answer::compared("compared with all that it could mean"))
            }
        };
        let corrected = self.corrected_by(scene, question, &[]);
        Ok(Understood { query, answer, meant: Vec::new(), corrected })
    }

    /// Returns the places of the known classes whose corrections change a question: those that it means or,
    /// where features find any words, the one that it names.
    fn corrected_by(&self, scene: &Scene, question: &Question, meant: &[usize]) -> Vec<usize> {
        if !scene.finds_any_words() {
            return meant.to_vec();
        }
        let words = question.text.trim();
        let spelled = self.known.iter().position(|(class, _)| is_same_name(&class.name, words));
        let called = spelled.or_else(|| self.interpreter.class_called(words));
        called.filter(|_| question.like.is_none()).into_iter().collect()
    }

    /// Completes a query that competes with the scene's classes; `meaning` is that of its words.
    fn among_classes(
        &mut self,
        scene: &Scene,
        question: &Question,
        query: Query,
        meaning: Meaning,
    ) -> Result<Understood> {
        let are_marked = scene.codec.is_none() || scene.words.from_marks;
        let answer = Answer::new(&meaning, &self.known, are_marked);
        let (meant, certainty) = match (&answer.nearest, meaning.nearest) {
            (Some(_), Some(nearest)) if question.shows_nearest => (vec![nearest], 1.0),
            _ => (meaning.classes, meaning.probability),
        };
        // Classes that only marks name have no features to compare with.
        let labelled = scene.classes.len();
        let classes: Vec<usize> = meant.iter().copied().filter(|k| *k < labelled).collect();
        let rows = classes.iter().map(|&k| scene.classes[k].1.clone()).collect();
        let query = Query { meant: rows, certainty, ..query };
        let corrected = self.corrected_by(scene, question, &meant);
        let understood = |query| Understood { query, answer, meant, corrected };
        if classes.len() < labelled || scene.codec.is_none() {
            return Ok(understood(query.among(&self.classes, classes)));
        }
        // No class means something else; the concepts that do compete instead.
        let texts: Vec<(&str, &[f32])> =
            scene.classes.iter().map(|(class, row)| (class.name.as_str(), row.as_slice())).collect();
        let (rivals, allies) = self.concepts_beside(scene, &texts)?;
        Ok(understood(query.among(&rivals, allies)))
    }

    /// Returns what words mean among the scene's classes.
    fn meaning(
        &mut self,
        scene: &Scene,
        settings: &RelevancySettings,
        text: &str,
        embedding: &[f32],
    ) -> Result<Meaning> {
        if let Some(meaning) = self.interpreter.by_words(text) {
            return Ok(meaning.or_nearest(|| self.interpreter.nearest(embedding)));
        }
        if self.make_space(scene).is_err() {
            // Words that are in no list are not understood then.
            return Ok(Meaning::unknown());
        }
        let Some(space) = &self.space else { return Ok(Meaning::unknown()) };
        if !self.interpreter.is_calibrated() {
            // The scene is older than calibrations, or was prepared with other lists of words.
            let classes = class_words(scene, &self.known, settings);
            let calibration = Calibration::measure(space, &classes);
            self.interpreter = Interpreter::new(Vocabulary::standard(), &classes, Some(&calibration));
        }
        let meaning = self.interpreter.by_encoder(text, embedding, space);
        // The built-in encoder knows listed words alone, and keeps all others away from them.
        let is_judged = meaning.reason == Reason::Encoder && !meaning.is_found();
        if is_judged && self.encoder(scene)?.folder.is_none() {
            return Ok(Meaning { reason: Reason::Unknown, ..meaning });
        }
        Ok(meaning)
    }

    /// Makes sure that there is the words' space: of the scene's own vectors, or else by encoding the vocabulary.
    fn make_space(&mut self, scene: &Scene) -> Result<()> {
        let kept = &scene.words.vectors;
        if self.space.is_none() && self.interpreter.is_calibrated() && !kept.is_empty() {
            self.space = Space::of_kept(Vocabulary::standard(), encoder_sha256(scene), kept);
        }
        if self.space.is_none() {
            let encoder = self.open_encoder(scene)?;
            let sha256 = encoder.identity().sha256.clone();
            let mut encode = |words: &[&str]| encoder.encode_prompts(words);
            self.space = Some(Space::new(Vocabulary::standard(), &sha256, &mut encode)?);
        }
        Ok(())
    }

    /// Returns the concepts of the vocabulary as rivals, and the numbers of those that mean the same as one of
    /// `texts` (words and their embeddings).
    fn concepts_beside(
        &mut self,
        scene: &Scene,
        texts: &[(&str, &[f32])],
    ) -> Result<(Arc<Rivals>, Vec<usize>)> {
        self.make_space(scene)?;
        let Some(space) = &self.space else { return Ok(Default::default()) };
        let rivals = self.concepts.get_or_insert_with(|| Rivals::new(space.concepts()));
        let fit = self.interpreter.fit().cloned().unwrap_or_else(|| Fit::of(space));
        let same = texts.iter().flat_map(|(words, row)| space.same_as(&fit, words, row));
        Ok((rivals.clone(), same.collect::<BTreeSet<usize>>().into_iter().collect()))
    }

    fn open_encoder(&mut self, scene: &Scene) -> Result<&mut TextEncoder> {
        match &mut self.encoder {
            Some(encoder) => Ok(encoder),
            none => Ok(none.insert(open_encoder(scene, &self.choice)?)),
        }
    }

    /// Makes sure that the words of questions, and the phrases that they are compared with, have embeddings.
    fn encode(&mut self, scene: &Scene, questions: &[Question]) -> Result<()> {
        let words = questions.iter().filter(|q| q.like.is_none()).map(|q| q.text.trim());
        let prompts: BTreeSet<&str> = words.filter(|p| !self.prompts.contains_key(*p)).collect();
        let phrases = questions.iter().flat_map(|q| &q.negatives.phrases).map(String::as_str);
        let phrases: BTreeSet<&str> = phrases.filter(|p| !self.phrases.contains_key(*p)).collect();
        let [prompts, phrases] = [prompts, phrases].map(Vec::from_iter);
        if !prompts.is_empty() {
            let rows = self.open_encoder(scene)?.encode_prompts(&prompts)?;
            self.prompts.extend(prompts.into_iter().map(str::to_owned).zip(rows));
        }
        if !phrases.is_empty() {
            let rows = self.open_encoder(scene)?.encode_bare(&phrases)?;
            self.phrases.extend(phrases.into_iter().map(str::to_owned).zip(rows));
        }
        Ok(())
    }
}

/// Returns the class that is nearest to an embedding.
fn nearest_class(scene: &Scene, embedding: &[f32]) -> Option<usize> {
    let cosines = scene.classes.iter().map(|(_, row)| num::dot(row, embedding)).enumerate();
    cosines.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k)
}

/// Returns the words of the known classes, and those of classes that are known to be absent.
fn class_words(scene: &Scene, known: &[(Class, Vec<f32>)], settings: &RelevancySettings) -> Vec<ClassWords> {
    let seen = known.iter().map(|(class, row)| ClassWords::seen(&class.name, row));
    let is_known = |name: &str| known.iter().any(|(class, _)| class.name == name);
    let unseen = scene.words.unseen.iter().filter(|name| settings.knows_unseen && !is_known(name));
    seen.chain(unseen.map(|name| ClassWords::unseen(name))).collect()
}

/// Returns the embedding of a sample. A sample from another scene must be of the same text encoder.
fn embedding_of(scene: &Scene, name: &str, sample: &Sample) -> Result<Vec<f32>> {
    if sample.encoder_sha256 == encoder_sha256(scene) {
        return Ok(sample.embedding.clone());
    }
    Err(Error::input(
        format!("\"{name}\" is from a scene that was prepared with another text encoder"),
        "Click on a point of this scene instead.",
    ))
}

pub(super) fn encoder_sha256(scene: &Scene) -> &str {
    scene.encoder.as_ref().map_or("", |e| &e.sha256)
}
