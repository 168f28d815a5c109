//! Tests of the answers to prompts, on a scene whose Gaussians each show one class.

use super::*;
use crate::jobs::{self, ExportQuestion, ExportRequest};
use surgtpgs_clip::TextEncoder;
use surgtpgs_core::{
    codec::{Codec, CodecKind, CodecSettings},
    export::{ExportOptions, Format, PictureSource},
    gaussian::Gaussians,
    marks::{Mark, Marks, Shape},
    meaning::{Meaning, Reason},
    progress::unobserved,
    scene::Chapter,
    sequence::Class,
    stress,
};
use surgtpgs_render::{AdapterChoice, Gpu};

/// Opens an engine on a scene with these classes, as the built-in encoder knows them.
fn engine(names: &[&str], unseen: &[&str]) -> Engine {
    engine_on(BackendChoice::Cpu, names, unseen)
}

/// Opens a graphics adapter; `None` if there is none, which tests in CI must not go without.
pub(crate) fn adapter() -> Option<Gpu> {
    let gpu = Gpu::open(AdapterChoice::Any).ok();
    assert!(gpu.is_some() || std::env::var("CI").as_deref() != Ok("true"), "CI needs a graphics adapter");
    gpu
}

/// Opens an engine on a machine.
pub(crate) fn engine_on(backend: BackendChoice, names: &[&str], unseen: &[&str]) -> Engine {
    let mut encoder = TextEncoder::builtin().unwrap();
    let rows = encoder.encode_prompts(names).unwrap();
    let table = ndarray::Array2::from_shape_fn((rows.len(), rows[0].len()), |(i, k)| rows[i][k]);
    let settings = CodecSettings { kind: CodecKind::Codebook, ..CodecSettings::default() };
    let codec = Codec::train(table.view(), &vec![1.0; names.len()], &settings, &mut unobserved).unwrap();
    let latents = codec.encode(table.view());
    let ordinary = stress::ordinary(200);
    let gaussians = Gaussians {
        latent_dim: codec.latent_dim(),
        features: (0..200).flat_map(|i| latents.row(i % names.len()).to_vec()).collect(),
        opacity_logits: vec![4.0; 200],
        ..Gaussians::clone(&ordinary.gaussians)
    };
    let class = |(id, name): (usize, &&str)| Class { id: id as u8, name: (*name).into(), colour: [0; 3] };
    let mut scene = Scene::of_still(gaussians, ordinary.cameras[0]);
    scene.classes = names.iter().enumerate().map(class).zip(rows).collect();
    scene.encoder = Some(encoder.identity().clone());
    scene.words.unseen = unseen.iter().map(|name| (*name).to_owned()).collect();
    scene.codec = Some(codec);
    Engine::new(Arc::new(scene), None, EngineOptions { backend, ..Default::default() }).unwrap()
}

/// Opens an engine on a scene with the features of these classes, but without a list of classes. Its frames
/// all look the same.
pub(crate) fn unlabelled_engine(names: &[&str], frames: usize) -> Engine {
    let mut scene = Scene::clone(engine(names, &[]).scene());
    scene.classes.clear();
    scene.cameras = vec![scene.cameras[0]; frames];
    let options = EngineOptions { backend: BackendChoice::Cpu, ..Default::default() };
    Engine::new(Arc::new(scene), None, options).unwrap()
}

/// Opens an engine on a scene of liver and fat. The training reached the first two of its four frames.
pub(crate) fn unfinished_engine() -> Engine {
    let whole = engine(&["liver", "fat"], &[]);
    let mut scene = Scene::clone(whole.scene());
    scene.cameras = vec![scene.cameras[0]; 4];
    let chapter = Chapter { index: 0, count: 2, shown: 0..2, learned: 0..3 };
    scene.provenance.settings = serde_json::json!({ "chapter": chapter });
    let options = EngineOptions { backend: BackendChoice::Cpu, ..Default::default() };
    Engine::new(Arc::new(scene.as_chapter()), None, options).unwrap()
}

/// Asks one prompt; returns its answer and its mask.
fn ask(engine: &mut Engine, words: &str) -> (Answer, Mask) {
    engine.set_prompts(&[words.to_owned()]).unwrap();
    let view = engine.view(0).unwrap();
    let images = engine.render(&view, true).unwrap();
    let scores = engine.scores(&images, &view).unwrap();
    (engine.answers()[0].clone(), engine.masks(&scores).swap_remove(0))
}

const NAMES: [&str; 6] =
    ["abdominal wall", "liver", "gastrointestinal tract", "fat", "grasper", "gallbladder"];

#[test]
fn other_words_for_a_class_find_what_its_name_finds() {
    let mut engine = engine(&NAMES, &["hepatic vein"]);
    for (words, name) in [
        ("gall bladder", "gallbladder"),
        ("hepatic tissue", "liver"),
        ("forceps", "grasper"),
        ("livre", "liver"),
    ] {
        let (answer, mask) = ask(&mut engine, words);
        assert!(answer.may_be_found(0.5) && answer.nearest.is_none(), "{words}: {answer:?}");
        let (_, by_name) = ask(&mut engine, name);
        assert!(mask.count() > 20 && mask == by_name, "{words}");
    }
    let (_, tools) = ask(&mut engine, "surgical instrument");
    assert_eq!(tools, ask(&mut engine, "grasper").1);
}

#[test]
fn features_without_classes_answer_words_that_no_mark_has() {
    let mut engine = unlabelled_engine(&NAMES, 1);
    let before = ask(&mut engine, "gallbladder").0;
    let asked = engine.queries().to_vec();
    assert!(before.may_be_found(0.5) && !asked[0].meant.is_empty(), "{before:?}");
    let Engine { asking, scene, settings, .. } = &mut engine;
    asking.know(scene, settings, &["liver".into()]).unwrap();
    assert_eq!((ask(&mut engine, "gallbladder").0, engine.queries()), (before, &asked[..]));
    let (marked, _) = ask(&mut engine, "hepar");
    assert!(marked.may_be_found(0.5) && engine.asking.meant == [["liver"]], "{marked:?}");
}

#[test]
fn words_that_mean_no_mark_are_answered_as_without_it() {
    let mut engine = unlabelled_engine(&NAMES, 1);
    let others = ["hepatic vein", "banana", "spaceship", "asdfgh"];
    let said = |engine: &mut Engine, words: &str| (ask(engine, words).0, engine.queries().to_vec());
    let before = others.map(|words| said(&mut engine, words));
    let Engine { asking, scene, settings, .. } = &mut engine;
    asking.know(scene, settings, &["liver".into()]).unwrap();
    for (words, before) in others.into_iter().zip(before) {
        assert_eq!(said(&mut engine, words), before, "{words}");
        assert!(engine.asking.meant[0].is_empty(), "{words}: {:?}", engine.asking.meant);
    }
}

/// Returns the number of pixels that are found on a view that was not recorded.
fn found_beside(engine: &mut Engine) -> usize {
    let recorded = engine.view(0).unwrap();
    let view = SceneView::free(recorded.time, recorded.camera);
    let images = engine.render(&view, true).unwrap();
    let scores = engine.scores(&images, &view).unwrap();
    engine.masks(&scores)[0].count()
}

/// Denies the liver, by another word for it, on the only frame of a scene.
fn deny_liver(engine: &mut Engine) {
    let canvas = engine.canvas();
    let corners_px = [[0.0; 2], [canvas.width as f32, canvas.height as f32]];
    let mark = Mark::new(0, "hepar", false, Shape::Box { corners_px });
    engine.set_marks(Marks::new(vec![mark], &canvas).unwrap()).unwrap();
}

#[test]
fn marks_of_a_class_by_another_word_correct_it() {
    let mut engine = engine(&["liver", "fat"], &[]);
    let (_, before) = ask(&mut engine, "liver");
    deny_liver(&mut engine);
    assert_eq!(engine.marks().map(Marks::names), Some(vec!["liver".to_owned()]));
    let (_, after) = ask(&mut engine, "liver");
    assert!(before.count() > 20 && after.count() == 0, "{} {}", before.count(), after.count());
    assert!(found_beside(&mut engine) * 4 < before.count());
}

#[test]
fn a_correction_takes_gaussians_away_as_it_does_pixels() {
    for mut engine in [engine(&["liver", "fat"], &[]), unlabelled_engine(&["liver", "fat"], 1)] {
        let found = |engine: &mut Engine| {
            engine.set_prompts(&["liver".to_owned(), "fat".to_owned()]).unwrap();
            engine.gaussians_found(0.0).unwrap()
        };
        let before = found(&mut engine);
        deny_liver(&mut engine);
        let after = found(&mut engine);
        let (all, left) = (before[0].len(), after[0].len());
        assert!(all > 50 && left + 5 < all, "{left} of {all} are left");
        assert!(after[0].iter().all(|i| before[0].contains(i)) && after[1] == before[1]);
    }
}

#[test]
fn marks_count_where_words_do_not_compete_with_classes() {
    let mut engine = engine(&["liver", "fat"], &[]);
    engine.change_settings(|usual| RelevancySettings { class_negatives: false, ..usual });
    let (_, before) = ask(&mut engine, "liver");
    deny_liver(&mut engine);
    let (_, after) = ask(&mut engine, "liver");
    assert!(before.count() > 20 && after.count() == 0, "{} {}", before.count(), after.count());
    assert!(found_beside(&mut engine) * 4 < before.count());
}

#[test]
fn words_for_what_is_absent_find_nothing_and_say_why() {
    let mut engine = engine(&NAMES, &["hepatic vein"]);
    let absent = [
        "spleen",
        "cystic duct",
        "common bile duct",
        "hepatic vein",
        "scissors",
        "banana",
        "yellow tissue",
        "gallbladder cancer",
        "duct tape",
        "asdf",
        "!!!",
    ];
    for words in absent {
        let (answer, mask) = ask(&mut engine, words);
        assert_eq!(mask.count(), 0, "{words}: {answer:?}");
        assert!(!answer.may_be_found(0.5) && !answer.why.is_empty(), "{words}: {answer:?}");
    }
    assert!(ask(&mut engine, "hepatic vein").0.why.contains("training frames hardly show"));
    engine.change_settings(|usual| RelevancySettings { knows_unseen: false, ..usual });
    let (answer, mask) = ask(&mut engine, "hepatic vein");
    assert!(mask.count() == 0 && !answer.why.contains("training frames hardly show"), "{answer:?}");
}

#[test]
fn words_that_nobody_understands_are_not_said_to_be_absent() {
    let mut engine = engine(&NAMES, &["hepatic vein"]);
    for words in ["Leber", "Gallenblase", "Vesicula biliar", "печень", "肝", "asdfgh", "!!!"] {
        let (answer, mask) = ask(&mut engine, words);
        assert!(answer.absence == Absence::NotUnderstood && !answer.may_be_found(0.5), "{words}: {answer:?}");
        assert!(answer.absence.words().starts_with("these words are not known here"), "{words}");
        assert_eq!((answer.why.as_str(), mask.count()), ("it is in no list of English and Latin words", 0));
    }
    for words in ["spleen", "hepatic vein", "banana", "gallbladder cancer", "spaceship", "not liver"] {
        let (answer, _) = ask(&mut engine, words);
        assert_eq!(answer.absence, Absence::NotThere, "{words}: {answer:?}");
        assert_eq!(answer.absence.words(), "not in this recording");
    }
    assert_eq!(ask(&mut engine, "liver").0.absence, Absence::NotThere);
}

#[test]
fn a_scene_from_marks_does_not_say_that_what_nobody_marked_is_absent() {
    let mut scene = Scene::clone(engine(&["abdominal wall", "fat"], &[]).scene());
    scene.words.from_marks = true;
    let options = EngineOptions { backend: BackendChoice::Cpu, ..Default::default() };
    let mut engine = Engine::new(Arc::new(scene), None, options).unwrap();
    for words in ["liver", "spaceship", "Leber"] {
        let (answer, mask) = ask(&mut engine, words);
        assert!(answer.absence == Absence::NeedsMark && mask.count() == 0, "{words}: {answer:?}");
        assert_eq!(answer.absence.words(), "cannot be looked for: mark it by hand");
    }
    let (answer, mask) = ask(&mut engine, "abdominal wall");
    assert!(answer.absence == Absence::NotThere && answer.may_be_found(0.5), "{answer:?}");
    assert!(mask.count() > 20, "{}", mask.count());
    assert_eq!(ask(&mut engine, "not liver").0.absence, Absence::NotThere, "no mark would help");
}

#[test]
fn what_another_encoder_judges_is_an_answer() {
    let meaning = |reason| Meaning { classes: Vec::new(), probability: 0.1, nearest: None, reason };
    let answer = |reason, are_marked| Answer::new(&meaning(reason), &[], are_marked);
    assert_eq!(answer(Reason::Encoder, false).absence, Absence::NotThere);
    assert_eq!(answer(Reason::Unknown, false).absence, Absence::NotUnderstood);
    assert_eq!(answer(Reason::Unknown, true).absence, Absence::NeedsMark, "words tell nothing there");
}

#[test]
fn what_words_look_like_is_shown_on_request_alone() {
    let mut engine = engine(&NAMES, &[]);
    let words = "gallbladder fundus";
    let (answer, mask) = ask(&mut engine, words);
    let nearest = answer.nearest.expect("a part of a class looks like it");
    assert_eq!((nearest.as_str(), mask.count()), ("gallbladder", 0));
    let negatives = Negatives::of(engine.settings());
    let shown = Question { shows_nearest: true, ..Question::words(words, negatives) };
    engine.set_questions(&[shown]).unwrap();
    let view = engine.view(0).unwrap();
    let images = engine.render(&view, true).unwrap();
    let scores = engine.scores(&images, &view).unwrap();
    let mask = engine.masks(&scores).swap_remove(0);
    assert_eq!(mask, ask(&mut engine, &nearest).1);
    assert_eq!(engine.answers()[0].verdict(false, true), Verdict::Absent, "a found class is not the nearest");
}

#[test]
fn strange_lists_of_classes_never_find_by_accident() {
    let mut one = engine(&["liver"], &[]);
    assert!(ask(&mut one, "liver").1.count() > 20);
    for words in ["spleen", "banana", "cystic duct"] {
        assert_eq!(ask(&mut one, words).1.count(), 0, "{words}");
    }
    let mut equal = engine(&["liver", "Liver", "fat"], &[]);
    assert!(ask(&mut equal, "liver").1.count() > 20);
    // Names that the encoder cannot tell apart find nothing rather than each other.
    let mut nameless = engine(&["obj1", "obj2"], &[]);
    assert_eq!(ask(&mut nameless, "liver").1.count(), 0);
    assert!(one.set_prompts(&["  ".to_owned()]).is_err());
}

#[test]
fn the_paper_asks_by_the_words_themselves() {
    let mut engine = engine(&NAMES, &[]);
    engine.change_settings(|_| RelevancySettings::paper());
    let (answer, mask) = ask(&mut engine, "gallbladder");
    assert!(answer.may_be_found(0.99) && mask.count() > 20);
    assert_eq!(engine.queries()[0].compared_with().collect::<Vec<_>>(), RelevancySettings::CANONICAL);
}

#[test]
fn a_sample_alone_is_exported() {
    let mut engine = engine(&NAMES, &[]);
    let (class, row) = engine.scene().classes[1].clone();
    assert_eq!(class.name, "liver");
    let sha256 = engine.scene().encoder.as_ref().unwrap().sha256.clone();
    let sample = Sample { embedding: row, encoder_sha256: sha256.clone() };
    let words = Question::words("like frame 1", Negatives::of(engine.settings()));
    let question = Question { like: Some(sample), ..words };
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.safetensors");
    std::fs::write(&scene, "its hash is recorded").unwrap();
    let mut request = ExportRequest {
        scene,
        folder: folder.path().join("out"),
        frames: vec![0],
        questions: ExportQuestion::with_standard_look(vec![question], 0.5),
        marks: Vec::new(),
        options: ExportOptions {
            formats: vec![Format::Binary],
            source: PictureSource::Reconstruction,
            ..ExportOptions::default()
        },
        replace: false,
        completes_same: false,
    };
    assert!(jobs::export(&mut engine, &request, &mut unobserved).unwrap().complete);
    let record = std::fs::read_to_string(request.folder.join("provenance.json")).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    assert_eq!(
        (&record["encoder_sha256"], &record["prompts"][0]["text"]),
        (&sha256.into(), &"like frame 1".into())
    );
    request.questions.clear();
    let why = jobs::export(&mut engine, &request, &mut unobserved).unwrap_err().to_string();
    assert!(why.contains("no prompt to export"), "{why}");
}

/// Returns still Gaussians as a `.ply` with LangSplat's columns of features, which are `times` as long.
fn langsplat_ply(gaussians: &Gaussians, times: f32) -> Vec<u8> {
    let plain = gaussians.to_ply(None);
    let end = plain.windows(11).position(|part| part == b"end_header\n").unwrap();
    let header = String::from_utf8(plain[..end].to_vec()).unwrap();
    let columns: String =
        (0..gaussians.latent_dim).map(|k| format!("property float language_feature_{k}\n")).collect();
    let row_bytes = 4 * header.matches("property float").count();
    let mut ply = format!("{header}{columns}end_header\n").into_bytes();
    let features = gaussians.features.chunks(gaussians.latent_dim);
    for (row, feature) in plain[end + 11..].chunks(row_bytes).zip(features) {
        ply.extend(row);
        ply.extend(feature.iter().flat_map(|v| (times * v).to_le_bytes()));
    }
    ply
}

/// Returns a codec as the safetensors that PyTorch would make of it.
fn autoencoder(codec: &Codec) -> Vec<u8> {
    let (mut about, mut data) = (serde_json::Map::new(), Vec::new());
    for (name, values) in codec.tensors() {
        let start = data.len();
        data.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        let offsets = [start, data.len()];
        let of = serde_json::json!({"dtype": "F32", "shape": values.shape(), "data_offsets": offsets});
        about.insert(name, of);
    }
    let about = serde_json::Value::from(about).to_string();
    [&(about.len() as u64).to_le_bytes()[..], about.as_bytes(), &data].concat()
}

#[test]
fn a_ply_with_features_and_their_autoencoder_is_asked_by_words() {
    let mut scene = Scene::clone(engine(&NAMES, &[]).scene());
    // A .ply names no classes.
    scene.classes.clear();
    let codec = scene.codec.as_ref().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("point_cloud.ply");
    std::fs::write(&path, langsplat_ply(&scene.gaussians, 7.0)).unwrap();
    let options = || EngineOptions { backend: BackendChoice::Cpu, ..Default::default() };
    let mut without = Engine::open(&path, options()).unwrap();
    let why = without.set_prompts(&["liver".into()]).unwrap_err().to_string();
    assert!(why.contains("autoencoder.safetensors"), "{why}");

    let beside = folder.path().join(surgtpgs_core::codec::AUTOENCODER_FILE);
    std::fs::write(&beside, autoencoder(codec)).unwrap();
    let mut read = Scene::load(&path).unwrap();
    assert_eq!(read.gaussians.latent_dim, codec.latent_dim());
    read.cameras.clone_from(&scene.cameras);
    read.field_of_view.clone_from(&scene.field_of_view);
    let mut asked = Engine::new(Arc::new(read), None, options()).unwrap();
    let mut own = Engine::new(Arc::new(scene.clone()), None, options()).unwrap();
    for words in ["liver", "fat", "grasper"] {
        let (answer, mask) = ask(&mut asked, words);
        let (_, expected) = ask(&mut own, words);
        let differing = mask.data.iter().zip(&expected.data).filter(|(a, b)| a != b).count();
        assert!(answer.may_be_found(0.5) && expected.count() > 20, "{words}: {answer:?}");
        assert!(differing < 5, "{words}: {differing} of {}", expected.count());
    }
    std::fs::write(&beside, b"PK").unwrap();
    assert!(Scene::load(&path).unwrap_err().to_string().contains("best_ckpt.pth"));
}
