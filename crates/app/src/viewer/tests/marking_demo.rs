//! Tests of marking by hand with the real engine, on the demo.

use super::{
    marking::{marks, share, take_tool},
    pointing::drag,
    *,
};
use crate::viewer::backend::engine::EngineBackend;

/// Makes the demo's recording and a scene without features of it, and opens a window on the scene.
fn real(folder: &Path) -> Window {
    for line in [
        &["demo", "-o", "@recording", "--width", "64", "--height", "48", "--frames", "6"][..],
        &["train", "@recording", "-o", "@scene.safetensors", "--iterations", "200"],
    ] {
        super::exports::program(folder, line);
    }
    let harness =
        Harness::builder().with_size(egui::vec2(1280.0, 800.0)).with_step_dt(1.0 / 60.0).build_eframe(|cc| {
            let mut preferences = Preferences::load(None);
            preferences.is_acknowledged = true;
            Shell::new(&cc.egui_ctx, Arc::<EngineBackend>::default(), preferences, Autosave::default())
        });
    let mut window = Window { harness, backend: Arc::default() };
    let ctx = window.harness.ctx.clone();
    window.harness.state_mut().shared.open_path(&folder.join("scene.safetensors"), &ctx);
    window.until(|app| app.picture().is_some());
    window
}

/// Returns a stroke through a class of the demo, along the row where it is widest.
fn stroke_on(folder: &Path, class: &str, frame: usize) -> Vec<[f32; 2]> {
    let sequence = surgtpgs_core::sequence::Sequence::open(&folder.join("recording")).unwrap();
    let id = sequence.classes().iter().find(|c| c.name == class).unwrap().id;
    let labels = sequence.labels(frame).unwrap().unwrap();
    let width = |y: usize| labels.row(y).iter().filter(|label| **label == id).count();
    let y = (0..labels.height).max_by_key(|y| width(*y)).unwrap();
    let columns: Vec<usize> = (0..labels.width).filter(|x| labels.at(*x, y) == id).collect();
    let inner = &columns[columns.len() / 5..columns.len() - columns.len() / 5];
    let share = |x: usize| [(x as f32 + 0.5) / labels.width as f32, (y as f32 + 0.5) / labels.height as f32];
    vec![share(inner[0]), share(inner[inner.len() - 1])]
}

#[test]
fn strokes_on_the_demo_find_their_structures_on_all_frames_and_words_find_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = real(folder.path());
    let sequence = surgtpgs_core::sequence::Sequence::open(&folder.path().join("recording")).unwrap();
    let classes: Vec<String> = sequence.classes().iter().map(|c| c.name.clone()).collect();
    for class in &classes {
        take_tool(&mut window, class);
        let line = stroke_on(folder.path(), class, 0);
        drag(&mut window, line[0], line[1]);
    }
    assert_eq!(marks(&window).len(), classes.len());
    let shares: Vec<f32> = classes.iter().map(|class| share(&mut window, class)).collect();
    let labels = sequence.labels(0).unwrap().unwrap();
    for (class, share) in sequence.classes().iter().zip(&shares) {
        let own = labels.data.iter().filter(|l| **l == class.id).count() as f32 / labels.data.len() as f32;
        assert!(
            share / own > 0.5 && share / own < 2.0,
            "{}: {share} of the picture, labelled {own}",
            class.name
        );
    }
    window.harness.state_mut().shared.playback.seek(5, 0.0);
    window.until_picture(|p| p.request.view.frame == 5 && p.findings.iter().all(|f| f.outcome.is_ok()));
    assert!(share(&mut window, &classes[0]) > 0.0);
    // The order of marks does not matter.
    let document = &mut window.harness.state_mut().shared.document;
    let mut turned = document.marks().all().to_vec();
    turned.reverse();
    let mut content = document.content().clone();
    content.marks = crate::viewer::state::marks::MarkList::of(turned);
    document.load(content, 6);
    window.harness.state_mut().shared.playback.seek(0, 0.0);
    window.until_picture(|p| p.request.view.frame == 0);
    assert_eq!(classes.iter().map(|class| share(&mut window, class)).collect::<Vec<_>>(), shares);
    window.press(Key::Escape);
    for (words, is_found) in [("hepatic tissue", true), ("banana", false)] {
        window.add_prompt(words);
        assert_eq!(share(&mut window, words) > 0.0, is_found, "{words}");
    }
    window.until_found();
    assert!(window.shows("Cannot be looked for: mark it by hand") && !window.shows("Not in this recording"));
}
