//! `surgtpgs train`: from a prepared folder or a recording to a scene file.

use super::{
    args::{HideArgs, require_scene_name},
    console::{self, ProgressView, print_report, say},
    remedy::scope_note,
    verb::{Exit, Run},
};
use crate::{
    engine::BackendChoice,
    jobs::{self, Course, Material, Trained, Watched},
    memory::{Work, peak_rss_bytes, require_for},
    outputs,
};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Error, Kept, Result,
    files::OutputFile,
    prepare::Prepared,
    scene::Scene,
    train::{FeatureMode, Plan, Profile, Quality, StepReport, TrainSettings, Trainer},
};

/// Reconstruct a scene from a prepared folder, or from a bare recording (then without features)
#[derive(Debug, Args)]
pub(super) struct TrainArgs {
    /// A prepared folder, or a recording (then without features)
    sequence: PathBuf,
    /// Scene file to write, e.g. scene.safetensors
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    /// Parts of the frames to hide
    #[command(flatten)]
    hide: HideArgs,
    /// Hold every eighth frame out (a folder prepared with --eval does so anyway)
    #[arg(long)]
    eval: bool,
    /// Compromise between time and quality: 600, 4000 or 10,000 steps [default: standard, or 3000 steps of the
    /// profile paper]
    #[arg(long, value_enum)]
    quality: Option<TrainQuality>,
    /// Optimiser steps, instead of those of the quality
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    iterations: Option<u32>,
    /// Most Gaussians, instead of those of the quality: 40000, or 150000 for best
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4_000_000))]
    gaussians: Option<u32>,
    /// Train this chapter of a long recording alone, from 0; `join` makes a scene of all of them
    #[arg(long, value_name = "K")]
    chapter: Option<usize>,
    /// Most frames of a chapter; 0 to reconstruct a recording of any length as a whole [default: 96]
    #[arg(long, value_name = "N")]
    chapter_frames: Option<usize>,
    /// Also correct poses that the recording has; those estimated from its pictures always are
    #[arg(long)]
    refine_poses: bool,
    /// Seed of everything random
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Device to train on
    #[arg(long, value_enum, default_value_t = BackendChoice::Auto)]
    backend: BackendChoice,
    /// Settings to start from: our own, or those that the paper's authors released, for comparison
    #[arg(long, value_enum, default_value_t = TrainProfile::Default)]
    profile: TrainProfile,
    /// Compute features in closed form after training, not by learning: faster, but constant over time
    #[arg(long)]
    fast_features: bool,
    /// Go on with the unfinished training beside the scene file
    #[arg(long, conflicts_with_all = FIXED_AT_START)]
    pub(super) resume: bool,
    /// Replace an earlier scene once the new one is whole, and begin an unfinished training anew
    // A batch sets it with `resume`: what is kept is begun anew if it is damaged.
    #[arg(long)]
    pub(super) force: bool,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// Arguments that an unfinished training keeps.
const FIXED_AT_START: [&str; 10] = [
    "eval",
    "quality",
    "iterations",
    "gaussians",
    "chapter_frames",
    "refine_poses",
    "seed",
    "profile",
    "fast_features",
    "force",
];

/// Compromise between time and quality.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum TrainQuality {
    /// A first look, in seconds
    Quick,
    /// Good enough to work with, in minutes
    Standard,
    /// More detail, in ten times the time on a CPU
    Best,
}

/// Settings that training starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum TrainProfile {
    /// The paper's formulas, changed where another way measured better
    Default,
    /// The released code with its quirks
    Paper,
}

impl TrainArgs {
    /// Trains a chapter alone, and goes on with it, if that can be, or replaces it; it lies beside the file
    /// `scene`.
    pub(super) fn take_chapter(&mut self, index: usize, scene: &Path) {
        self.chapter = Some(index);
        self.output = jobs::chapter_path(scene, index);
        self.resume = jobs::checkpoint_path(&self.output).exists();
        self.force = true;
    }

    /// Returns the settings of a training from the beginning.
    fn settings(&self) -> TrainSettings {
        let mut settings = TrainSettings::of(match self.profile {
            TrainProfile::Default => Profile::Default,
            TrainProfile::Paper => Profile::Paper,
        });
        match self.quality {
            Some(TrainQuality::Quick) => settings = settings.with_quality(Quality::Quick),
            Some(TrainQuality::Standard) => settings = settings.with_quality(Quality::Standard),
            Some(TrainQuality::Best) => settings = settings.with_quality(Quality::Best),
            None => {}
        }
        if let Some(steps) = self.iterations {
            settings.iterations = steps as usize;
        }
        if let Some(gaussians) = self.gaussians {
            settings.densify.max_gaussians = gaussians as usize;
        }
        settings.chapter_frames = self.chapter_frames.unwrap_or(settings.chapter_frames);
        if self.refine_poses {
            settings = settings.refining_poses();
        }
        settings.seed = self.seed;
        settings.eval = self.eval;
        if self.fast_features {
            settings.feature_mode = FeatureMode::Lifted;
            settings.feature_motion = false;
        }
        settings
    }
}

/// The JSON report; its keys are a contract.
#[derive(serde::Serialize)]
pub(super) struct TrainReport {
    backend: String,
    seconds: f64,
    steps: usize,
    /// Of the steps of this training; those of chapters that lay there already do not count.
    steps_per_second: f64,
    gaussians: usize,
    chapters: usize,
    peak_rss_bytes: Option<u64>,
    psnr_db: Option<f64>,
    held_out: bool,
    dropped_steps: usize,
    /// Reasons why the scene is worse than it could be, and what to know of the recording.
    warnings: Vec<String>,
    pub(super) finished: bool,
}

impl Run for TrainArgs {
    fn run(&self) -> Result<Exit> {
        let report = train(self)?;
        print_report(&report, &as_text(&report, &self.output), self.json)?;
        if report.finished { Ok(Exit::Done) } else { Err(Error::Cancelled) }
    }

    fn output(&self) -> Option<&Path> {
        Some(&self.output)
    }
}

/// Trains and saves the scene. A scene that is not finished was stopped by the user.
pub(super) fn train(args: &TrainArgs) -> Result<TrainReport> {
    require_scene_name(&args.output)?;
    let material = Material::open_hiding(&args.sequence, &args.hide.hide)?;
    let inputs = material.inputs(&args.sequence);
    let checkpoint = jobs::checkpoint_path(&args.output);
    if checkpoint == args.output {
        let what = "this is the name of the file that keeps the unfinished training";
        return Err(Error::input_at(&args.output, what, "Give a name that ends in .safetensors."));
    }
    require_choice(args, &args.output, &checkpoint)?;
    let output = outputs::scene_file(&args.output, &inputs, args.force || args.resume)?;
    let checkpoint = jobs::checkpoint_path(output.path());
    let _checkpoint = outputs::checkpoint_file(&checkpoint, &inputs)?;
    if material.prepared().is_none() {
        say("training without features: prompts will find nothing in this scene (see `surgtpgs prepare`)");
    }
    let mut length_warning = None;
    if !args.resume {
        let settings = args.settings();
        require_for(&Work::Training(material.sequence(), &settings))?;
        length_warning = settings.length_warning(material.sequence().num_frames());
    }
    let of_classes = material.prepared().map(Prepared::cautions).unwrap_or_default();
    let warnings =
        [material.sequence().cautions(), of_classes.as_slice(), length_warning.as_slice()].concat();
    warnings.iter().for_each(|warning| say(&format!("note: {warning}")));
    let place = Place { scene: output.path(), checkpoint: &checkpoint };
    let mut report = match begin(args, &material, &place)? {
        Begun::Whole(trainer) => train_whole(args, *trainer, &place, &output)?,
        Begun::InChapters(settings, plan) => {
            train_chapters(args, &material, *settings, plan, &place, &output)?
        }
    };
    report.warnings.extend(warnings);
    if report.finished {
        jobs::remove_file(&checkpoint)?;
        jobs::remove_chapters(output.path())?;
    } else {
        let then = if place.unfinished().is_some() { ", and --resume goes on from what is kept" } else { "" };
        let scene = if place.has_whole() { "the earlier scene stays" } else { "the scene is saved" };
        say(&format!("stopped after {} steps; {scene}{then}", report.steps));
    }
    if report.dropped_steps > 0 {
        say(&format!("{} steps were dropped because they were not finite", report.dropped_steps));
    }
    Ok(report)
}

/// Returns the number of chapters that the recording is trained in; 0 if it is trained as a whole.
pub(super) fn count_chapters(args: &TrainArgs) -> Result<usize> {
    let material = Material::open_hiding(&args.sequence, &args.hide.hide)?;
    let mut view = ProgressView::default();
    let (sequence, prepared) = (material.sequence(), material.prepared());
    Ok(Plan::of(sequence, prepared, &args.settings(), &mut |p| view.show(p))?.chapters.len())
}

/// Returns `true` if the chapter to be trained is there, whole, and of these settings.
pub(super) fn is_finished(args: &TrainArgs) -> Result<bool> {
    if jobs::checkpoint_path(&args.output).exists() || !args.output.exists() {
        return Ok(false);
    }
    let material = Material::open_hiding(&args.sequence, &args.hide.hide)?;
    match jobs::is_finished_chapter(&args.output, &material, &args.settings())? {
        Kept::Usable(is_finished) => Ok(is_finished),
        Kept::Damaged(_) => {
            say(&format!("note: {}: {}", args.output.display(), jobs::DAMAGED));
            Ok(false)
        }
    }
}

/// Files of a training.
struct Place<'a> {
    scene: &'a Path,
    checkpoint: &'a Path,
}

impl Place<'_> {
    /// Returns a file to go on from; `None` if there is none.
    fn unfinished(&self) -> Option<PathBuf> {
        let alone = self.checkpoint.is_file().then(|| self.checkpoint.to_owned());
        alone.or_else(|| jobs::begun_chapters(self.scene).into_iter().next())
    }

    /// Returns `true` if there is a scene that was trained to the end.
    fn has_whole(&self) -> bool {
        jobs::is_whole_scene(self.scene)
    }

    /// Writes the scene; one whose training was stopped does not replace a whole one.
    fn write(&self, output: &OutputFile, scene: &Scene, is_finished: bool) -> Result<()> {
        if !is_finished && self.has_whole() {
            return Ok(());
        }
        output.write_with(|file| scene.write(file, false)).inspect_err(|_| self.say_kept())
    }

    /// Says that work is kept, after an error.
    fn say_kept(&self) {
        if self.unfinished().is_some() {
            say("what was learned so far is kept, and --resume goes on from there");
        }
    }
}

/// A training that has begun, or goes on.
enum Begun {
    /// All frames, or one chapter, together.
    Whole(Box<Trainer>),
    /// Chapter by chapter, by a plan if it was made already.
    InChapters(Box<TrainSettings>, Option<Plan>),
}

fn begin(args: &TrainArgs, material: &Material, place: &Place<'_>) -> Result<Begun> {
    if args.resume
        && let Some(begun) = go_on(args, material, place)?
    {
        return Ok(begun);
    }
    let (sequence, prepared) = (material.sequence(), material.prepared());
    let settings = args.settings();
    let mut view = ProgressView::default();
    let mut plan = Plan::of(sequence, prepared, &settings, &mut |p| view.show(p))?;
    let chapter = match args.chapter {
        Some(index) => {
            let chapter = plan.chapters.get(index).cloned();
            Some(chapter.ok_or_else(|| no_chapter(index, plan.chapters.len()))?)
        }
        None if !plan.chapters.is_empty() => {
            jobs::remove_chapters(place.scene)?;
            jobs::remove_file(place.checkpoint)?;
            return Ok(Begun::InChapters(Box::new(settings), Some(plan)));
        }
        None => None,
    };
    let (chapter, observer) = (chapter.as_ref(), &mut |p: &jobs::Progress<'_>| view.show(p));
    let mut trainer = Trainer::planned(sequence, prepared, settings, &mut plan, chapter, observer)?;
    // An earlier training must not be gone on with once another one has begun.
    jobs::remove_chapters(place.scene)?;
    if place.checkpoint.exists() {
        trainer.save_checkpoint(place.checkpoint)?;
    }
    Ok(Begun::Whole(Box::new(trainer)))
}

/// Goes on with an unfinished training; `None` if it is damaged and may be begun anew.
fn go_on(args: &TrainArgs, material: &Material, place: &Place<'_>) -> Result<Option<Begun>> {
    let is_alone = args.chapter.is_some() || place.checkpoint.is_file();
    if !is_alone && let Some(settings) = jobs::settings_of_chapters(place.scene, material)? {
        return Ok(Some(Begun::InChapters(Box::new(settings), None)));
    }
    let (sequence, prepared) = (material.sequence(), material.prepared());
    let trainer = match Trainer::resume_if_usable(sequence, prepared, place.checkpoint)? {
        Kept::Usable(trainer) => trainer,
        Kept::Damaged(_) if args.force => {
            say(&format!("note: {}: {}", place.checkpoint.display(), jobs::DAMAGED));
            return Ok(None);
        }
        Kept::Damaged(error) => return Err(error),
    };
    let begun = trainer.settings().chapter.as_ref().map(|chapter| chapter.index);
    if args.chapter.is_some() && args.chapter != begun {
        let of = begun.map_or("the whole recording".into(), |index| format!("chapter {index}"));
        let what = format!("the unfinished training is of {of}");
        return Err(Error::input_at(place.checkpoint, what, "Leave --chapter out to go on with it."));
    }
    require_for(&Work::Training(sequence, trainer.settings()))?;
    Ok(Some(Begun::Whole(Box::new(trainer))))
}

fn no_chapter(index: usize, count: usize) -> Error {
    let what = match count {
        0 => "the recording is one short shot: it is reconstructed as a whole, not in chapters".to_owned(),
        _ => format!("there is no chapter {index}; the recording has {count}, from 0"),
    };
    Error::input(what, "Give another --chapter, or leave it out.")
}

fn train_whole(
    args: &TrainArgs,
    mut trainer: Trainer,
    place: &Place<'_>,
    output: &OutputFile,
) -> Result<TrainReport> {
    let backend = jobs::backend::choose(&mut trainer, args.backend)?;
    let scope = scope_note(trainer.scope());
    scope.iter().for_each(|note| say(note));
    say(&format!("training on {backend}"));
    let asked = trainer.settings().iterations;
    console::watch_interrupts();
    let mut view = ProgressView::default();
    let trained = jobs::go_on(&mut trainer, Some(place.checkpoint), &mut |p| view.show(p), &mut |_, _| {});
    drop(view);
    let trained = trained.inspect_err(|_| place.say_kept())?;
    trained.notes.iter().for_each(|note| say(note));
    let is_finished = trained.steps >= asked;
    place.write(output, &trained.scene, is_finished)?;
    let mut report = TrainReport::of(&trained, is_finished, trainer.backend_name());
    report.warnings.extend(scope.into_iter().chain(trained.notes));
    Ok(report)
}

fn train_chapters(
    args: &TrainArgs,
    material: &Material,
    settings: TrainSettings,
    plan: Option<Plan>,
    place: &Place<'_>,
    output: &OutputFile,
) -> Result<TrainReport> {
    say("the recording is long or has several shots, and is reconstructed in chapters");
    console::watch_interrupts();
    let course = Course {
        material,
        settings,
        backend: args.backend,
        scene: place.scene,
        keeps_unfinished: true,
        replaces: false,
        look_at: None,
    };
    let mut backend = String::new();
    let mut view = ProgressView::default();
    let observer = &mut |p: &jobs::Progress<'_>| view.show(p);
    let watch = &mut |watched: &mut Watched<'_>, _: &StepReport| {
        if backend.is_empty() {
            backend = watched.trainer.backend_name();
        }
    };
    let trained = match plan {
        Some(plan) => course.train_planned(plan, observer, watch),
        None => course.train(observer, watch),
    };
    drop(view);
    let trained = trained.inspect_err(|_| place.say_kept())?;
    trained.notes.iter().for_each(|note| say(note));
    let is_finished = course.is_whole(&trained);
    place.write(output, &trained.scene, is_finished)?;
    let mut report = TrainReport::of(&trained, is_finished, backend);
    report.warnings.extend(trained.notes);
    Ok(report)
}

/// Fails if it is not clear whether to go on with an unfinished training: it is never lost by accident.
fn require_choice(args: &TrainArgs, scene: &Path, checkpoint: &Path) -> Result<()> {
    match (args.resume, Place { scene, checkpoint }.unfinished()) {
        (true, None) => Err(Error::input_at(
            checkpoint,
            "there is no unfinished training to go on with",
            "Train without --resume.",
        )),
        (false, Some(unfinished)) if !args.force => Err(Error::input_at(
            unfinished,
            "an earlier training of this scene is unfinished",
            "Go on with --resume, which keeps the settings it began with, or begin again with --force.",
        )),
        _ => Ok(()),
    }
}

impl TrainReport {
    fn of(trained: &Trained, finished: bool, backend: String) -> Self {
        Self {
            backend,
            seconds: trained.seconds,
            steps: trained.steps,
            steps_per_second: (trained.steps - trained.steps_kept) as f64 / trained.seconds.max(1e-9),
            gaussians: trained.gaussians,
            chapters: trained.scene.chapters.iter().len().max(1),
            peak_rss_bytes: peak_rss_bytes(),
            psnr_db: trained.psnr_db,
            held_out: trained.scene.provenance.held_out,
            dropped_steps: trained.dropped,
            warnings: Vec::new(),
            finished,
        }
    }
}

fn as_text(report: &TrainReport, output: &Path) -> String {
    let frames = if report.held_out { "held-out frames" } else { "training frames, none was held out" };
    let psnr = report.psnr_db.map_or("unknown".into(), |db| format!("{db:.2} dB"));
    let memory = report.peak_rss_bytes.map_or(String::new(), |b| format!(", {} MB at most", b / 1_000_000));
    format!(
        "{} steps in {:.1} s ({:.0} a second{memory}), {} Gaussians, PSNR {psnr} ({frames})\n{}\n",
        report.steps,
        report.seconds,
        report.steps_per_second,
        report.gaussians,
        output.display()
    )
}
