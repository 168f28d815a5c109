//! Tests of interpretation with an encoder that is made up: it gives words of one concept vectors near to
//! each other, and every other word a direction of its own.

use super::*;
use crate::Result;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// CholecSeg8K's classes; those from `SEEN` on have no pixel.
const NAMES: [&str; 13] = [
    "black background",
    "abdominal wall",
    "liver",
    "gastrointestinal tract",
    "fat",
    "grasper",
    "gallbladder",
    "connective tissue",
    "blood",
    "cystic duct",
    "L-hook electrocautery",
    "hepatic vein",
    "liver ligament",
];
const SEEN: usize = 7;

fn direction(text: &str) -> Vec<f32> {
    let seed = text.bytes().fold(7_u64, |seed, b| seed.wrapping_mul(131).wrapping_add(u64::from(b)));
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    num::normalised(&(0..48).map(|_| crate::codec::normal(&mut rng)).collect::<Vec<_>>()).unwrap()
}

fn mixed(parts: &[(f32, &str)]) -> Vec<f32> {
    let mut sum = vec![0.0; 48];
    for (weight, text) in parts {
        sum.iter_mut().zip(direction(text)).for_each(|(sum, x)| *sum += weight * x);
    }
    num::normalised(&sum).unwrap()
}

fn embedding(text: &str) -> Vec<f32> {
    let vocabulary = Vocabulary::standard();
    let concept = vocabulary.concept_of(text).map_or(text, |i| &vocabulary.concepts()[i].name);
    mixed(&[(2.0, "what all texts share"), (1.0, concept), (0.5, text)])
}

fn space() -> Space<'static> {
    let mut encode = |texts: &[&str]| -> Result<_> { Ok(texts.iter().map(|text| embedding(text)).collect()) };
    Space::new(Vocabulary::standard(), "made up", &mut encode).unwrap()
}

fn class(name: &str, is_seen: bool) -> ClassWords {
    ClassWords { name: name.to_owned(), embedding: embedding(name), is_seen }
}

fn cholec() -> Vec<ClassWords> {
    NAMES.iter().enumerate().map(|(i, name)| class(name, i < SEEN)).collect()
}

fn found<'a>(meaning: &Meaning, names: &[&'a str]) -> Vec<&'a str> {
    if meaning.is_found() { meaning.classes.iter().map(|&i| names[i]).collect() } else { Vec::new() }
}

#[test]
fn names_and_other_words_for_them_are_found() {
    let interpreter = Interpreter::new(Vocabulary::standard(), &cholec(), None);
    let cases = [
        ("the Livers", "liver"),
        ("gall bladder", "gallbladder"),
        ("gall-bladder's", "gallbladder"),
        ("gallblader", "gallbladder"),
        ("gal bladder", "gallbladder"),
        ("fatt", "fat"),
        ("hepatic tissue", "liver"),
        ("hepattic tissue", "liver"),
        ("surface of the liver", "liver"),
        ("left liver edge", "liver"),
        ("forceps", "grasper"),
        ("tool", "grasper"),
        ("bowel", "gastrointestinal tract"),
    ];
    for (prompt, expected) in cases {
        let meaning = interpreter.by_words(prompt).unwrap_or_else(|| panic!("{prompt} is in no list"));
        assert_eq!(found(&meaning, &NAMES), [expected], "{prompt}: {meaning:?}");
    }
    for (i, name) in NAMES.iter().enumerate() {
        let meaning = interpreter.by_words(name).unwrap();
        if i < SEEN {
            assert_eq!((meaning.classes, meaning.probability), (vec![i], 1.0), "{name}");
        } else {
            assert_eq!((meaning.is_found(), meaning.reason), (false, Reason::UnseenClass(i)), "{name}");
        }
    }
}

#[test]
fn what_means_something_else_is_not_found_whatever_the_encoder_says() {
    let (space, classes) = (space(), cholec());
    let calibration = Calibration::measure(&space, &classes);
    assert!(calibration.fit.tells_apart, "{:?}", calibration.fit);
    let interpreter = Interpreter::new(Vocabulary::standard(), &classes, Some(&calibration));
    let cases = [
        ("cystic duct", "gallbladder"),
        ("common bile duct", "gallbladder"),
        ("hepatic vein", "liver"),
        ("spleen", "liver"),
        ("scissors", "grasper"),
        ("gallbladder cancer", "gallbladder"),
        ("black cat", "black background"),
        ("bowel obstruction", "gastrointestinal tract"),
    ];
    for (prompt, like) in cases {
        let meaning = interpreter.by_encoder(prompt, &embedding(like), &space);
        assert_eq!(found(&meaning, &NAMES), [""; 0], "{prompt}: {meaning:?}");
        assert_eq!(meaning.nearest.map(|i| NAMES[i]), Some(like), "{prompt}: {meaning:?}");
    }
    // A part of a class looks like it, whatever the encoder says.
    let part = interpreter.by_encoder("fundus of the gallbladder", &embedding("zxqv"), &space);
    assert_eq!((found(&part, &NAMES), part.nearest.map(|i| NAMES[i])), (vec![], Some("gallbladder")));
    for prompt in ["sunflower", "lever", "zxqv"] {
        let meaning = interpreter.by_encoder(prompt, &embedding(prompt), &space);
        assert_eq!((found(&meaning, &NAMES), meaning.nearest), (vec![], None), "{prompt}: {meaning:?}");
    }
}

#[test]
fn a_place_beside_a_thing_is_not_the_thing() {
    let (space, classes) = (space(), cholec());
    let calibration = Calibration::measure(&space, &classes);
    let interpreter = Interpreter::new(Vocabulary::standard(), &classes, Some(&calibration));
    let places = ["under the liver", "left of the liver", "touching liver", "Behind the liver edge"];
    for prompt in places {
        let meaning = interpreter.by_encoder(prompt, &embedding("liver"), &space);
        assert_eq!(found(&meaning, &NAMES), [""; 0], "{prompt}: {meaning:?}");
        assert_eq!(meaning.nearest.map(|i| NAMES[i]), Some("liver"), "{prompt}: {meaning:?}");
        assert_eq!(meaning.reason, Reason::Beside, "{prompt}");
    }
    let between = interpreter.by_words("between liver and gallbladder").unwrap();
    assert!(!between.is_found() && between.nearest.is_some(), "{between:?}");
    // It is of what stands before, whatever the encoder says.
    let relations = [
        "fat around gallbladder",
        "grasper holding the gallbladder",
        "grasper on the gallbladder",
        "liver above the gallbladder",
    ];
    for prompt in relations {
        let meaning = interpreter.by_encoder(prompt, &embedding("gallbladder"), &space);
        assert!(!found(&meaning, &NAMES).contains(&"gallbladder"), "{prompt}: {meaning:?}");
    }
    // Sides of a thing are parts of it, and a number is no typing mistake.
    for prompt in ["left side of the liver", "liver, left", "all of the liver"] {
        assert_eq!(found(&interpreter.by_words(prompt).unwrap(), &NAMES), ["liver"], "{prompt}");
    }
    assert_eq!(interpreter.by_words("segment 4 of the liver"), None);
}

#[test]
fn words_in_no_list_are_left_to_the_encoder() {
    let (space, classes) = (space(), cholec());
    let calibration = Calibration::measure(&space, &classes);
    let interpreter = Interpreter::new(Vocabulary::standard(), &classes, Some(&calibration));
    assert_eq!(interpreter.by_words("zumblefrix"), None);
    let meaning = interpreter.by_encoder("zumblefrix", &embedding("liver"), &space);
    assert_eq!((found(&meaning, &NAMES), &meaning.reason), (vec!["liver"], &Reason::Encoder));
    let untrusted = Interpreter::new(Vocabulary::standard(), &classes, None);
    assert!(!untrusted.by_encoder("zumblefrix", &embedding("liver"), &space).is_found());
    let concepts = |numbers: Vec<usize>| -> Vec<_> {
        numbers.into_iter().map(|i| &*Vocabulary::standard().concepts()[i].name).collect()
    };
    let fit = &calibration.fit;
    let near_liver = concepts(space.same_as(fit, "hepatic tissue", &[]));
    assert!(near_liver[0] == "liver" && near_liver.contains(&"caudate lobe"), "{near_liver:?}");
    assert_eq!(concepts(space.same_as(fit, "zumblefrix", &embedding("liver"))), near_liver);
    assert_eq!(concepts(space.same_as(fit, "banana", &embedding("banana"))), ["fruit"]);
    assert_eq!(concepts(space.same_as(fit, "zxqv", &embedding("zxqv"))), [""; 0]);
}

#[test]
fn what_nobody_understands_is_not_taken_for_something_else() {
    let (space, classes) = (space(), cholec());
    let calibration = Calibration::measure(&space, &classes);
    let reason = |prompt: &str, calibration: Option<&Calibration>| {
        let interpreter = Interpreter::new(Vocabulary::standard(), &classes, calibration);
        let meaning = interpreter.by_encoder(prompt, &embedding(prompt), &space);
        assert!(!meaning.is_found(), "{prompt}: {meaning:?}");
        meaning.reason
    };
    for prompt in ["Leber", "Gallenblase", "Vesicula biliar", "foie", "asdfgh"] {
        assert_eq!(reason(prompt, Some(&calibration)), Reason::Encoder, "{prompt}");
        assert_eq!(reason(prompt, None), Reason::Unknown, "{prompt}: no encoder was measured");
    }
    for calibration in [Some(&calibration), None] {
        // No encoder was measured with words like these.
        for prompt in ["печень", "肝", "Leber 肝", "!!!"] {
            assert_eq!(reason(prompt, calibration), Reason::Unknown, "{prompt}");
        }
        assert_eq!(reason("gallbladder cancer", calibration), Reason::SomethingElse);
        assert!(matches!(reason("spleen", calibration), Reason::Listed { .. }));
    }
}

#[test]
fn the_order_of_classes_does_not_matter() {
    let (space, classes) = (space(), cholec());
    let reversed: Vec<_> = classes.iter().rev().cloned().collect();
    let answers = |classes: &[ClassWords], prompt: &str| {
        let calibration = Calibration::measure(&space, classes);
        let interpreter = Interpreter::new(Vocabulary::standard(), classes, Some(&calibration));
        let meaning = interpreter.by_encoder(prompt, &embedding(prompt), &space);
        let name = |i: usize| classes[i].name.clone();
        let names: Vec<_> = meaning.classes.iter().map(|&i| name(i)).collect();
        (names, meaning.probability, meaning.nearest.map(name))
    };
    for prompt in
        ["liver", "gal bladder", "spleen", "zumblefrix", "fenestrated grasper", "liver biopsy needle"]
    {
        assert_eq!(answers(&classes, prompt), answers(&reversed, prompt), "{prompt}");
    }
}

#[test]
fn classes_of_one_name_are_found_together() {
    let classes = [class("Liver", true), class("obj 1", true), class("livers", true), class("liver", false)];
    let interpreter = Interpreter::new(Vocabulary::standard(), &classes, None);
    assert_eq!(interpreter.by_words("liver").unwrap().classes, [0, 2]);
    assert_eq!(interpreter.by_words("hepatic tissue").unwrap().classes, [0, 2]);
    assert_eq!(interpreter.by_words("obj 1").unwrap().classes, [1]);
    assert_eq!(interpreter.by_words("spleen"), None, "\"obj 1\" may be a spleen");
    let empty = Vocabulary::parse("", "").unwrap();
    let other = Space::new(&empty, "", &mut |_| Ok(vec![])).unwrap();
    assert_eq!(interpreter.by_encoder("liver", &[], &other).classes, [0, 2]);
    assert!(!interpreter.by_encoder("spleen", &[], &other).is_found());
    let spleen = interpreter.by_encoder("spleen", &embedding("spleen"), &space());
    assert!(matches!(&spleen.reason, Reason::Listed { concept, .. } if concept == "spleen"), "{spleen:?}");
}

#[test]
fn degenerate_prompts_and_scenes_find_nothing() {
    let space = space();
    let long = "edge of the liver and spleen ".repeat(350);
    let letters = "a".repeat(10_000);
    for classes in [vec![], vec![class("", true)], vec![class("liver", true)], cholec()] {
        let calibration = Calibration::measure(&space, &classes);
        let interpreter = Interpreter::new(Vocabulary::standard(), &classes, Some(&calibration));
        for prompt in ["", " ", "!!!", "of the", "'s", "胆嚢", "ё", "\u{301}", &long, &letters] {
            for vector in [vec![], vec![f32::NAN; 48], vec![0.0; 48], vec![1e30; 7], embedding("x y z")] {
                let meaning = interpreter.by_encoder(prompt, &vector, &space);
                assert!(!meaning.is_found() && meaning.nearest.is_none(), "{prompt}: {meaning:?}");
            }
        }
    }
}

#[test]
fn encoders_that_tell_nothing_apart_are_not_trusted() {
    let vocabulary = Vocabulary::standard();
    let vectors: [fn(&str) -> Vec<f32>; 4] =
        [|_| vec![0.6, 0.8], |_| vec![f32::NAN; 3], |_| vec![], |text| direction(text)];
    for vector in vectors {
        let mut encode =
            |texts: &[&str]| -> Result<_> { Ok(texts.iter().map(|text| vector(text)).collect()) };
        let space = Space::new(vocabulary, "", &mut encode).unwrap();
        assert!(!Fit::of(&space).tells_apart, "{:?}", Fit::of(&space));
        let classes = ["liver", "fat"].map(|name| ClassWords {
            name: name.to_owned(),
            embedding: vector(name),
            is_seen: true,
        });
        let calibration = Calibration::measure(&space, &classes);
        let interpreter = Interpreter::new(vocabulary, &classes, Some(&calibration));
        assert_eq!(interpreter.by_encoder("hepatic tissue", &vector("x"), &space).classes, [0]);
        for prompt in ["spleen", "banana", "asdf"] {
            let meaning = interpreter.by_encoder(prompt, &vector("liver"), &space);
            assert!(!meaning.is_found() && meaning.nearest.is_none(), "{prompt}: {meaning:?}");
        }
    }
    assert!(Space::new(vocabulary, "", &mut |_| Ok(vec![])).is_err());
    let mut uneven =
        |texts: &[&str]| -> Result<_> { Ok((0..texts.len()).map(|i| vec![1.0; i % 2]).collect()) };
    assert!(Space::new(vocabulary, "", &mut uneven).is_err());
}

#[test]
fn an_empty_vocabulary_knows_the_names_of_classes() {
    let vocabulary = Vocabulary::parse("", "").unwrap();
    assert_ne!(vocabulary.sha256(), Vocabulary::standard().sha256());
    let classes = [class("liver", true), class("fat", true)];
    let space = Space::new(&vocabulary, "", &mut |_| Ok(vec![])).unwrap();
    let calibration = Calibration::measure(&space, &classes);
    let interpreter = Interpreter::new(&vocabulary, &classes, Some(&calibration));
    assert_eq!(interpreter.by_words("Livers").unwrap().classes, [0]);
    assert_eq!(interpreter.by_words("livver").unwrap().classes, [0]);
    assert_eq!(interpreter.by_words("spleen"), None);
    assert!(!interpreter.by_encoder("spleen", &embedding("liver"), &space).is_found());
    assert!(Vocabulary::parse("nonsense", "").is_err());
}

#[test]
fn what_is_not_meant_is_not_found_and_several_things_are() {
    let vocabulary = Vocabulary::standard();
    let row = [1.0, 0.0];
    let names = ["liver", "fat", "gallbladder", "grasper"];
    let classes: Vec<ClassWords> = names.iter().map(|name| ClassWords::seen(name, &row)).collect();
    let interpreter = Interpreter::new(vocabulary, &classes, None);
    let says = |prompt: &str| interpreter.by_words(prompt);
    for prompt in [
        "not liver",
        "no liver",
        "non-liver",
        "without gallbladder",
        "fat but not liver",
        "liver except gallbladder",
        "neither liver nor fat",
        "tool not grasper",
        "absent gallbladder",
    ] {
        let meaning = says(prompt).unwrap_or_else(|| panic!("{prompt} is judged by the encoder"));
        assert_eq!((meaning.classes.len(), &meaning.reason), (0, &Reason::Negated), "{prompt}");
        assert_eq!(meaning.or_nearest(|| Some(0)).nearest, None, "{prompt}");
    }
    for (prompt, expected) in [
        ("liver and gallbladder", vec![0, 2]),
        ("Fat, liver", vec![0, 1]),
        ("liver/gallbladder", vec![0, 2]),
        ("gall bladder & hepatic tissue", vec![0, 2]),
        ("liver or fat or grasper", vec![0, 1, 3]),
    ] {
        let meaning = says(prompt).unwrap_or_else(|| panic!("{prompt} is judged by the encoder"));
        assert!(meaning.is_found() && meaning.reason == Reason::Several { missing: Vec::new() }, "{prompt}");
        assert_eq!(meaning.classes, expected, "{prompt}");
    }
    let some = says("liver, fat and spaceship").unwrap();
    assert_eq!(
        (some.classes, some.reason),
        (vec![0, 1], Reason::Several { missing: vec!["spaceship".into()] })
    );
    let one = says("gallbladder without stones");
    assert!(one.is_none_or(|meaning| meaning.reason != Reason::Negated));
    let named = [ClassWords::seen("no tissue", &row)];
    let interpreter = Interpreter::new(vocabulary, &named, None);
    assert!(interpreter.by_words("no tissue").unwrap().is_found(), "a class may be called so");
}
