//! The built-in encoder keeps its promises over its whole lexicon, and its training can be repeated.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

#[path = "../examples/train_builtin/export.rs"]
mod export;
#[path = "../examples/train_builtin/lexicon.rs"]
mod lexicon;
#[path = "../examples/train_builtin/model.rs"]
mod model;
#[path = "../examples/train_builtin/targets.rs"]
mod targets;
#[path = "../examples/train_builtin/text.rs"]
mod text;
#[path = "../examples/train_builtin/train.rs"]
mod train;

use lexicon::Lexicon;
use std::collections::BTreeMap;
use surgtpgs_clip::TextEncoder;

const LEXICON: &str = include_str!("../../../assets/text_encoder/lexicon.toml");
const TOKENIZER: &str = include_str!("../../../assets/text_encoder/tokenizer.json");
const MODEL: &[u8] = include_bytes!("../../../assets/text_encoder/model.onnx");
const PHRASES: [&str; 4] = ["object", "things", "stuff", "texture"];
/// Margin p − max n above which the default threshold of 0.4 finds a pixel: ln(0.4/0.6)/10.
const FOUND: f32 = -0.0405;

fn cosine(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn lexicon() -> Lexicon {
    Lexicon::parse(LEXICON).unwrap()
}

fn encoder() -> TextEncoder {
    TextEncoder::builtin().unwrap()
}

fn one(encoder: &mut TextEncoder, prompt: &str) -> Vec<f32> {
    encoder.encode_prompts(&[prompt]).unwrap().remove(0)
}

/// Embeddings of the concepts by name, in the template as class names are.
fn concepts(encoder: &mut TextEncoder, lexicon: &Lexicon) -> BTreeMap<String, Vec<f32>> {
    let of_group = lexicon.concepts.iter().filter(|(group, _)| *group != "canonical");
    of_group.flat_map(|(_, members)| members.keys()).map(|name| (name.clone(), one(encoder, name))).collect()
}

/// Fails with all complaints at once, so that one run shows everything that is wrong with a training.
fn report(what: &str, mut complaints: Vec<(f32, String)>) {
    complaints.sort_by(|a, b| b.0.total_cmp(&a.0));
    let lines: Vec<String> = complaints.iter().take(40).map(|(_, line)| line.clone()).collect();
    assert!(complaints.is_empty(), "{} times: {what}\n{}", complaints.len(), lines.join("\n"));
}

#[test]
fn synonyms_share_an_embedding_with_and_without_template() {
    let (lexicon, mut encoder) = (lexicon(), encoder());
    let mut complaints = Vec::new();
    for (concept, phrase) in lexicon.phrases() {
        let [name, templated] = [concept, phrase].map(|text| one(&mut encoder, text));
        let bare = encoder.encode_bare(&[phrase]).unwrap().remove(0);
        for (c, form) in [(cosine(&name, &templated), "templated"), (cosine(&name, &bare), "bare")] {
            if c < 0.9 {
                complaints.push((-c, format!("{concept} / {phrase} ({form}): {c:.3}")));
            }
        }
    }
    report("synonyms differ", complaints);
}

#[test]
fn different_concepts_are_apart_and_groups_are_closer() {
    let (lexicon, mut encoder) = (lexicon(), encoder());
    let embeddings = concepts(&mut encoder, &lexicon);
    let group =
        |name: &str| lexicon.concepts.iter().find(|(_, members)| members.contains_key(name)).unwrap().0;
    let is_family = |a: &str, b: &str| {
        let (near_a, near_b) =
            (lexicon.near.get(a).map(String::as_str), lexicon.near.get(b).map(String::as_str));
        near_a == Some(b) || near_b == Some(a) || (near_a.is_some() && near_a == near_b)
    };
    let (mut complaints, mut within, mut across) = (Vec::new(), (0.0, 0), (0.0, 0));
    for (a, embedding_a) in &embeddings {
        for (b, embedding_b) in
            embeddings.range::<String, _>((std::ops::Bound::Excluded(a), std::ops::Bound::Unbounded))
        {
            let c = cosine(embedding_a, embedding_b);
            let (limit, sum) = match (is_family(a, b), group(a) == group(b)) {
                (true, _) => (0.75, &mut within),
                (_, true) if group(a) == a || group(b) == b => (0.7, &mut within),
                (_, true) => (0.47, &mut within),
                (_, false) => (0.45, &mut across),
            };
            *sum = (sum.0 + c, sum.1 + 1);
            if c > limit {
                complaints.push((c, format!("{a} / {b}: {c:.3}")));
            }
        }
    }
    report("different concepts are close", complaints);
    let (within, across) = (within.0 / within.1 as f32, across.0 / across.1 as f32);
    assert!(within > across + 0.05, "within groups {within}, across {across}");
}

#[test]
fn canonical_phrases_lie_between_right_and_wrong() {
    let (lexicon, mut encoder) = (lexicon(), encoder());
    let embeddings = concepts(&mut encoder, &lexicon);
    let phrases = encoder.encode_bare(&PHRASES).unwrap();
    let mut complaints = Vec::new();
    for (concept, embedding) in &embeddings {
        for (phrase, canonical) in PHRASES.iter().zip(&phrases) {
            let c = cosine(embedding, canonical);
            if !(0.43..=0.62).contains(&c) {
                complaints.push(((c - 0.53).abs(), format!("{phrase} / {concept}: {c:.3}")));
            }
        }
    }
    report("canonical phrases are out of their place", complaints);
}

/// Complaints about words that come nearer to a concept than a tenth below the nearest canonical phrase.
fn strangers_too_near(words: &[&str]) -> Vec<(f32, String)> {
    let (lexicon, mut encoder) = (lexicon(), encoder());
    let embeddings = concepts(&mut encoder, &lexicon);
    let phrases = encoder.encode_bare(&PHRASES).unwrap();
    let floor = |e: &Vec<f32>| phrases.iter().map(|p| cosine(e, p)).fold(f32::MIN, f32::max);
    let floors: BTreeMap<_, _> = embeddings.iter().map(|(name, e)| (name.clone(), floor(e))).collect();
    let mut complaints = Vec::new();
    for word in words {
        let stranger = one(&mut encoder, word);
        let excess =
            |(name, e): (&String, &Vec<f32>)| (cosine(e, &stranger) - floors[name] + 0.1, name.clone());
        let worst = embeddings.iter().map(excess).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        if worst.0 > 0.0 {
            complaints.push((worst.0, format!("{word} / {}: {:.3} too near", worst.1, worst.0)));
        }
    }
    complaints
}

#[test]
fn trained_strangers_stay_away_from_every_concept() {
    let lexicon = lexicon();
    let words: Vec<&str> = lexicon.other.words.split_whitespace().collect();
    assert!(words.len() > 900);
    report("a listed word comes near a concept", strangers_too_near(&words));
}

#[test]
fn strangers_never_seen_stay_away_too() {
    let lexicon = lexicon();
    let mut words: Vec<&str> = lexicon.other.held_out.split_whitespace().collect();
    assert!(words.len() > 120);
    words.extend([
        "xqzt",
        "bvnmw",
        "qwertyuiop",
        "zzz",
        "12345",
        "???",
        "f",
        "lorem ipsum",
        "привет",
        "肝臓",
    ]);
    let complaints = strangers_too_near(&words);
    let share = complaints.len() as f32 / words.len() as f32;
    eprintln!("{} of {} unseen words come near a concept: {complaints:?}", complaints.len(), words.len());
    // A lexicon this small cannot exclude all chance likenesses in spelling.
    assert!(share <= 0.05, "{complaints:?}");
}

#[test]
fn held_out_spellings_are_found() {
    let (lexicon, mut encoder) = (lexicon(), encoder());
    let phrases = encoder.encode_bare(&PHRASES).unwrap();
    let (mut complaints, mut count) = (Vec::new(), 0);
    for (concept, spellings) in &lexicon.held_out {
        let pixel = one(&mut encoder, concept);
        let negative = phrases.iter().map(|n| cosine(&pixel, n)).fold(f32::MIN, f32::max);
        for spelling in spellings {
            let c = cosine(&pixel, &one(&mut encoder, spelling));
            count += 1;
            if c - negative < 0.1 {
                complaints.push((-c, format!("{concept} / {spelling}: {c:.3}, canonical {negative:.3}")));
            }
        }
    }
    eprintln!("{} of {count} unseen spellings are missed: {complaints:?}", complaints.len());
    assert!(complaints.len() * 20 <= count, "{complaints:#?}");
}

/// Classes of a scene that a prompt finds; pixels have the embedding of their class (method §9.2).
fn found<'a>(encoder: &mut TextEncoder, prompt: &str, classes: &[&'a str]) -> Vec<&'a str> {
    let embeddings: Vec<_> = classes.iter().map(|class| one(encoder, class)).collect();
    let prompt = one(encoder, prompt);
    let nearest = (0..classes.len())
        .max_by(|a, b| cosine(&embeddings[*a], &prompt).total_cmp(&cosine(&embeddings[*b], &prompt)));
    let mut negatives = encoder.encode_bare(&PHRASES).unwrap();
    negatives
        .extend(embeddings.iter().enumerate().filter(|(i, _)| Some(*i) != nearest).map(|(_, e)| e.clone()));
    let margin = |pixel: &Vec<f32>| {
        cosine(pixel, &prompt) - negatives.iter().map(|n| cosine(pixel, n)).fold(f32::MIN, f32::max)
    };
    classes.iter().zip(&embeddings).filter(|(_, e)| margin(e) > FOUND).map(|(class, _)| *class).collect()
}

#[test]
fn prompts_find_their_class_and_nothing_else() {
    let mut encoder = encoder();
    let cholec = ["abdominal wall", "liver", "gallbladder", "fat", "grasper"];
    let endovis = [
        "background-tissue",
        "instrument-shaft",
        "instrument-clasper",
        "instrument-wrist",
        "kidney-parenchyma",
        "covered-kidney",
        "thread",
        "clamps",
        "suturing-needle",
        "suction-instrument",
        "small-intestine",
        "ultrasound-probe",
    ];
    for (prompt, classes, expected) in [
        ("bile sac", &cholec[..], "gallbladder"),
        ("Gall Bladder", &cholec, "gallbladder"),
        ("forceps", &cholec, "grasper"),
        ("belly wall", &cholec, "abdominal wall"),
        ("omentum", &cholec, "fat"),
        ("surgical tool", &cholec, "grasper"),
        ("Tumor", &["tumour", "liver"], "tumour"),
        ("suction", &endovis, "suction-instrument"),
        ("needle", &endovis, "suturing-needle"),
        ("small bowel", &endovis, "small-intestine"),
        ("shaft", &endovis, "instrument-shaft"),
    ] {
        assert_eq!(found(&mut encoder, prompt, classes), [expected], "{prompt}");
    }
    for prompt in ["spaceship", "banana", "car", "xkcdq", "uterus"] {
        assert!(found(&mut encoder, prompt, &cholec).is_empty(), "{prompt}");
    }
    for class in endovis {
        assert_eq!(found(&mut encoder, class, &endovis), [class]);
    }
}

#[test]
fn names_outside_of_the_lexicon_can_still_be_told_apart() {
    let mut encoder = encoder();
    let names = ["frobnicator", "zygote", "quux widget", "hyperlink"].map(|name| one(&mut encoder, name));
    for (i, a) in names.iter().enumerate() {
        for b in &names[..i] {
            assert!(cosine(a, b) < 0.9, "{}", cosine(a, b));
        }
    }
}

#[test]
fn the_shipped_files_are_small_and_of_this_trainer() {
    assert!(MODEL.len() < 1 << 20, "{} bytes", MODEL.len());
    assert_eq!(TOKENIZER, text::tokenizer_json());
}

#[test]
fn training_again_gives_the_same_bytes_and_another_seed_does_not() {
    let run = |seed| {
        let plan = train::Plan { steps: 24, batch: 8, seed, ..Default::default() };
        export::onnx(&train::train(&lexicon(), &plan, &mut |_, _| {}).unwrap())
    };
    let first = run(1);
    assert!(first == run(1), "not reproducible");
    assert!(first != run(2), "the seed does nothing");
}

#[test]
fn the_trainer_lists_its_worst_phrases_first() {
    let plan = train::Plan { steps: 4, batch: 4, ..Default::default() };
    let (lexicon, trained) = (lexicon(), train::train(&lexicon(), &plan, &mut |_, _| {}).unwrap());
    let misses = train::misses(&lexicon, &trained);
    assert_eq!(misses.len(), lexicon.phrases().count());
    assert!(misses.windows(2).all(|pair| pair[0].0 <= pair[1].0));
}

#[test]
fn the_file_gives_what_the_trainer_computes() {
    let plan = train::Plan { steps: 40, batch: 8, ..Default::default() };
    let trained = train::train(&lexicon(), &plan, &mut |_, _| {}).unwrap();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("model.onnx"), export::onnx(&trained)).unwrap();
    std::fs::write(folder.path().join("tokenizer.json"), TOKENIZER).unwrap();
    let mut encoder = TextEncoder::open(folder.path()).unwrap();
    for text in ["gallbladder", "L-hook electrocautery", "Ünknown 4 things!", "a"] {
        let expected = model::embed(&trained.weights, &trained.rows.of(&text.replace('Ü', "u")));
        let c = cosine(&expected, &encoder.encode_bare(&[text]).unwrap()[0]);
        assert!(c > 0.99999, "{text}: {c}");
    }
}
