//! `surgtpgs` without a verb: the viewer, the first time on the built-in demo. With no display, the demo's
//! job runs into a folder, with a report.

mod report;

use super::{
    answers::{Answers, ask},
    console::{self, ProgressView, print, say},
    verb::Exit,
    view,
};
use crate::{
    engine::{Engine, EngineOptions, Negatives, Question},
    evaluation::{Extras, evaluate},
    jobs::{self, DemoOptions, DemoPaths, ExportQuestion, ExportRequest},
    outputs,
    viewer::{self, ViewerInput},
};
use report::Findings;
use std::path::Path;
use surgtpgs_core::{
    Error, Result,
    export::{ExportOptions, Format},
    files::{Inputs, claim_collection},
    mask::CleanUp,
};

/// Folder that the headless job writes, in the current folder.
const FOLDER: &str = "surgtpgs-demo";

/// Prompts of the headless job: classes of the demo, another word for one of them, and absent things.
const PROMPTS: [&str; 8] =
    ["gallbladder", "liver", "fat", "grasper", "bile sac", "forceps", "spaceship", "traffic light"];

pub(super) fn run() -> Result<Exit> {
    if view::has_display() {
        viewer::run(ViewerInput::Start, Some(view::demo_folder()?))?;
    } else {
        headless(Path::new(FOLDER), &DemoOptions::default())?;
    }
    Ok(Exit::Done)
}

/// Builds the demo, evaluates it, asks it, exports masked frames and writes a report, all under `folder`.
fn headless(folder: &Path, options: &DemoOptions) -> Result<()> {
    say(&format!(
        "no display: running the demo into {}/ (`surgtpgs --help` lists the verbs)",
        folder.display()
    ));
    let folder = &claim_collection(folder, outputs::DEMO, &Inputs::none())?;
    console::watch_interrupts();
    let mut view = ProgressView::default();
    let trained = jobs::build_demo(folder, options, &mut |p| view.show(p))?;

    let scene = DemoPaths::under(folder).scene;
    let mut engine = Engine::open(&scene, EngineOptions::default())?;
    let evaluation = evaluate(&mut engine, Extras::default(), &mut |p| view.show(p))?.report;
    let negatives = Negatives::of(engine.settings());
    let questions = PROMPTS.map(|text| Question::words(text, negatives.clone()));
    let frames: Vec<usize> = (0..engine.scene().num_frames()).collect();
    let answers = ask(&mut engine, &questions, &frames, &mut |p| view.show(p))?;
    drop(view);
    let found = export_found(&mut engine, &answers, &scene, &folder.join("masked-frames"), frames)?;

    let findings =
        Findings { trained: &trained, evaluation: &evaluation, answers: &answers, exported: found };
    // The export has left only the prompts that were found.
    engine.set_questions(&questions)?;
    report::write(folder, &mut engine, &findings)?;
    print(&report::summary(folder, &findings))?;
    Ok(())
}

/// Exports the prompts that were found somewhere. Returns the number of files written.
fn export_found(
    engine: &mut Engine,
    answers: &Answers,
    scene: &Path,
    folder: &Path,
    frames: Vec<usize>,
) -> Result<usize> {
    let found: Vec<&String> =
        answers.prompts.iter().filter(|p| p.frames_found() > 0).map(|p| &p.text).collect();
    if found.is_empty() {
        return Ok(0);
    }
    let negatives = Negatives::of(engine.settings());
    let questions = found.iter().map(|text| Question::words(text.as_str(), negatives.clone())).collect();
    let formats = vec![Format::Cutout, Format::Overlay, Format::Index];
    let camera = engine.view(0)?.camera;
    let clean_up = CleanUp::usual(camera.width as usize, camera.height as usize);
    let request = ExportRequest {
        scene: scene.to_owned(),
        folder: folder.to_owned(),
        frames,
        questions: ExportQuestion::with_standard_look(questions, engine.settings().threshold),
        marks: Vec::new(),
        options: ExportOptions { formats, captions: true, clean_up, ..Default::default() },
        replace: true,
        completes_same: false,
    };
    let mut view = ProgressView::default();
    let summary = jobs::export(engine, &request, &mut |p| view.show(p))?;
    if summary.complete { Ok(summary.files) } else { Err(Error::Cancelled) }
}
