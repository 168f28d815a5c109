//! Promises of the trainer, tested on the synthetic clip at a small size.

use super::*;
use crate::{
    demo::{self, DemoSettings},
    progress::unobserved,
    stress::small_clip,
};
use tempfile::TempDir;

fn demo_settings(frames: usize) -> DemoSettings {
    DemoSettings::of_size(64, 48, frames)
}

/// A recording with made-up embeddings of its classes.
struct Clip {
    _folder: TempDir,
    prepared: Prepared,
}

impl Clip {
    fn new(frames: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let prepared = small_clip(folder.path(), frames).unwrap();
        Self { _folder: folder, prepared }
    }

    fn trainer(&self, settings: TrainSettings) -> Trainer {
        Trainer::new(&self.prepared.sequence, Some(&self.prepared), settings).unwrap()
    }
}

/// Settings with sampled pixels and everything else as for a large recording.
fn short(iterations: usize) -> TrainSettings {
    TrainSettings { iterations, min_pixels: 100, ..TrainSettings::default() }
}

fn run(trainer: &mut Trainer, steps: usize) -> StepReport {
    (0..steps).map(|_| trainer.step().unwrap()).last().unwrap()
}

/// Bytes of the scene's file.
fn scene_bytes(trainer: &mut Trainer) -> Vec<u8> {
    let scene = trainer.scene().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    scene.save(&path).unwrap();
    std::fs::read(path).unwrap()
}

fn is_finite(trainer: &Trainer) -> bool {
    let (g, d) = (&trainer.state.model.gaussians, &trainer.state.model.deformation);
    let all = [
        g.means.as_flattened(),
        g.rotations.as_flattened(),
        g.log_scales.as_flattened(),
        &g.opacity_logits,
        g.colours.as_flattened(),
        &g.features,
        &d.weights,
    ];
    all.into_iter().flatten().all(|v| v.is_finite())
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let clip = Clip::new(10);
    let on = |threads| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut trainer = clip.trainer(TrainSettings {
                densify: DensifySettings { every: 10, ..TrainSettings::default().densify },
                ..short(60)
            });
            run(&mut trainer, 60);
            scene_bytes(&mut trainer)
        })
    };
    let one = on(1);
    assert!(one == on(2) && one == on(5));
}

#[test]
fn a_seed_decides_everything() {
    let clip = Clip::new(10);
    let of = |seed| {
        let mut trainer = clip.trainer(TrainSettings { seed, ..short(20) });
        run(&mut trainer, 20);
        scene_bytes(&mut trainer)
    };
    assert!(of(1) == of(1));
    assert!(of(1) != of(2));
}

#[test]
fn going_on_gives_the_same_bytes_as_never_stopping() {
    let clip = Clip::new(10);
    for profile in [Profile::Default, Profile::Paper] {
        let settings = TrainSettings {
            iterations: 60,
            refines_poses: true,
            densify: DensifySettings { every: 10, ..TrainSettings::of(profile).densify },
            ..TrainSettings::of(profile)
        };
        let mut whole = clip.trainer(settings.clone());
        run(&mut whole, 60);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.unfinished");
        let mut first = clip.trainer(settings);
        run(&mut first, 37);
        first.save_checkpoint(&path).unwrap();
        let mut second = Trainer::resume(&clip.prepared.sequence, Some(&clip.prepared), &path).unwrap();
        assert_eq!(second.steps_done(), 37);
        run(&mut second, 23);
        assert!(scene_bytes(&mut whole) == scene_bytes(&mut second), "{profile:?}");
    }
}

#[test]
fn a_checkpoint_of_something_else_is_refused() {
    let (clip, other) = (Clip::new(10), Clip::new(3));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.unfinished");
    clip.trainer(short(5)).save_checkpoint(&path).unwrap();
    let resume = |clip: &Clip| Trainer::resume(&clip.prepared.sequence, Some(&clip.prepared), &path).err();
    assert!(resume(&clip).is_none());
    let message = resume(&other).unwrap().to_string();
    assert!(message.contains("not the recording that the unfinished training was begun on"), "{message}");
    let bytes = std::fs::read(&path).unwrap();
    for at in [20, 60, bytes.len() / 2, bytes.len() - 1] {
        let mut flipped = bytes.clone();
        flipped[at] ^= 1;
        std::fs::write(&path, flipped).unwrap();
        assert!(resume(&clip).unwrap().to_string().contains("checksum"), "byte {at}");
    }
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(resume(&clip).unwrap().to_string().contains("damaged"));
    std::fs::write(&path, b"something else entirely").unwrap();
    assert!(resume(&clip).unwrap().to_string().contains("no unfinished training"));
}

#[test]
fn a_checkpoint_of_other_depth_masks_or_cameras_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [recording, path] = ["recording", "x.unfinished"].map(|name| folder.path().join(name));
    demo::write(&demo_settings(3), &recording, &mut unobserved).unwrap();
    let toml = recording.join("sequence.toml");
    let text = std::fs::read_to_string(&toml).unwrap();
    let resume = || Trainer::resume(&Sequence::open(&recording).unwrap(), None, &path);
    let mut trainer = Trainer::new(&Sequence::open(&recording).unwrap(), None, short(5)).unwrap();
    trainer.save_checkpoint(&path).unwrap();
    for (from, to) in [("scale = 0.005", "scale = 0.01"), ("\"white\"", "\"black\""), ("fx = ", "fx = 1")] {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text);
        std::fs::write(&toml, changed).unwrap();
        let message = resume().err().unwrap().to_string();
        assert!(message.contains("begun with other cameras, depth, masks"), "{to}: {message}");
    }
    std::fs::write(&toml, text).unwrap();
    let supervision = |trainer: &mut Trainer| trainer.scene().unwrap().provenance.supervision.unwrap();
    assert_eq!(supervision(&mut resume().unwrap()), supervision(&mut trainer));
}

#[cfg(unix)]
#[test]
fn a_scene_of_a_link_finds_its_recording_by_the_link() {
    let folder = tempfile::tempdir().unwrap();
    let [recording, link] = ["recording", "link"].map(|name| folder.path().join(name));
    demo::write(&demo_settings(3), &recording, &mut unobserved).unwrap();
    std::os::unix::fs::symlink(&recording, &link).unwrap();
    let mut trainer = Trainer::new(&Sequence::open(&link).unwrap(), None, short(5)).unwrap();
    assert_eq!(trainer.scene().unwrap().provenance.sequence_path, link);
}

#[test]
fn training_learns_the_clip_without_its_test_frames() {
    let clip = Clip::new(10);
    let mut trainer = clip.trainer(TrainSettings { guesses_held_out: false, ..short(300) });
    let before = trainer.psnr_db().unwrap().unwrap();
    run(&mut trainer, 300);
    let after = trainer.psnr_db().unwrap().unwrap();
    assert!(trainer.settings().eval && after > before + 4.0 && after > 22.0, "{before} dB to {after} dB");
    // Frames 1 and 9 are held out, so that nothing ever decoded them.
    assert!(!trainer.cache.holds(1) && !trainer.cache.holds(9) && trainer.cache.holds(0));
}

#[test]
fn the_paper_profile_learns_too() {
    let clip = Clip::new(10);
    let mut trainer = clip.trainer(TrainSettings { iterations: 200, ..TrainSettings::of(Profile::Paper) });
    let before = trainer.psnr_db().unwrap().unwrap();
    let report = run(&mut trainer, 200);
    let after = trainer.psnr_db().unwrap().unwrap();
    assert!(after > before + 2.0 && report.dropped == 0 && is_finite(&trainer), "{before} dB to {after} dB");
    assert!(!trainer.state.model.deformation.is_shared() && trainer.state.model.gaussians.sh_degree == 3);
}

#[test]
fn lifted_features_are_what_the_pixels_show() {
    let clip = Clip::new(10);
    let settings = TrainSettings { feature_mode: FeatureMode::Lifted, feature_motion: false, ..short(200) };
    let mut trainer = clip.trainer(settings);
    run(&mut trainer, 200);
    let frame = trainer.cache.get(Some(&clip.prepared), 0, false).unwrap();
    let truth = frame.truth(&clip.prepared.latents, 1.0);
    let images = trainer.render(0).unwrap();
    let rows = truth.latents.len() / 3;
    let nearest = |i: usize| {
        let distance = |r: &usize| -> f32 {
            let feature = |d| images.plane(crate::raster::FEATURE_PLANE + d)[i];
            (0..3).map(|d| (feature(d) - truth.latents[3 * r + d]).powi(2)).sum()
        };
        (0..rows).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
    };
    let seen: Vec<usize> = (0..truth.width * truth.height)
        .filter(|&i| truth.mask[i] && usize::from(truth.regions[i]) < rows)
        .collect();
    let right = seen.iter().filter(|&&i| nearest(i) == usize::from(truth.regions[i])).count();
    // Pixels across a border are mixed.
    assert!(right as f32 > 0.85 * seen.len() as f32, "{right} of {} pixels are right", seen.len());
}

#[test]
fn a_chapter_without_features_has_none_although_other_frames_have_some() {
    let clip = Clip::new(20);
    let manifest = clip.prepared.folder.join("prepared.json");
    let mut json: serde_json::Value = serde_json::from_slice(&std::fs::read(&manifest).unwrap()).unwrap();
    json["region_frames"] = serde_json::json!([0, 2, 3]);
    std::fs::write(&manifest, json.to_string()).unwrap();
    let prepared = Prepared::open(&clip.prepared.folder).unwrap();
    let longest_latent = |index: usize| {
        let range = 10 * index..10 * index + 10;
        let chapter = Chapter { index, count: 2, shown: range.clone(), learned: range };
        let sequence = &prepared.sequence;
        let (prepared, chapter, mut plan) = (Some(&prepared), Some(&chapter), Plan::default());
        let trainer = Trainer::planned(sequence, prepared, short(30), &mut plan, chapter, &mut unobserved);
        let mut trainer = trainer.unwrap();
        run(&mut trainer, 30);
        let images = trainer.render(10 * index + 5).unwrap();
        let planes = (0..images.latent_dim()).map(|k| images.plane(crate::raster::FEATURE_PLANE + k));
        planes.flatten().fold(0.0_f32, |longest, v| longest.max(v.abs()))
    };
    assert!(longest_latent(0) > 0.05);
    assert_eq!(longest_latent(1), 0.0);
}

#[test]
fn one_frame_and_one_gaussian_train() {
    let clip = Clip::new(1);
    let mut trainer = clip.trainer(short(40));
    let report = run(&mut trainer, 40);
    assert!(report.dropped == 0 && is_finite(&trainer));
    let mut trainer = clip.trainer(TrainSettings { px_per_gaussian: 1e6, ..short(40) });
    assert!(trainer.state.model.gaussians.len() <= 2);
    let report = run(&mut trainer, 40);
    assert!(report.dropped == 0 && is_finite(&trainer));
}

#[test]
fn extreme_gaussians_do_no_harm() {
    let clip = Clip::new(4);
    let mut trainer = clip.trainer(short(60));
    let g = &mut trainer.state.model.gaussians;
    // Duplicates, opacity at both ends, a needle, a pancake, a speck, a giant, no direction, behind the
    // camera, and far away.
    g.means[1] = g.means[0];
    (g.opacity_logits[2], g.opacity_logits[3]) = (80.0, -80.0);
    g.log_scales[4] = [5.0, -14.0, -14.0];
    g.log_scales[5] = [3.0, 3.0, -14.0];
    g.log_scales[6] = [-80.0; 3];
    g.log_scales[7] = [80.0; 3];
    g.rotations[8] = [0.0; 4];
    g.means[9][2] = -5.0;
    g.means[10][2] = 1e9;
    g.means[11][2] = 0.2 + 1e-6;
    let report = run(&mut trainer, 60);
    assert_eq!(report.dropped, 0);
    assert!(is_finite(&trainer) && trainer.psnr_db().unwrap().unwrap() > 14.0);
}

#[test]
fn a_long_run_stays_within_its_budget() {
    let clip = Clip::new(3);
    let mut trainer = clip.trainer(TrainSettings {
        densify: DensifySettings { every: 1, until: 1.0, ..TrainSettings::default().densify },
        ..short(150)
    });
    let first = trainer.state.model.gaussians.len();
    let report = run(&mut trainer, 150);
    assert!(
        report.gaussians > first && report.gaussians <= first * 30 / 2,
        "{first} to {}",
        report.gaussians
    );
    assert!(report.dropped == 0 && is_finite(&trainer));
}

#[test]
fn the_size_of_the_scene_does_not_matter() {
    let clip = Clip::new(6);
    let psnr_at = |scale: f32| {
        let mut trainer = clip.trainer(TrainSettings {
            // The recorded depth is not scaled.
            loss: LossWeights { depth: 0.0, ..LossWeights::default() },
            ..short(80)
        });
        let g = &mut trainer.state.model.gaussians;
        g.means.as_flattened_mut().iter_mut().for_each(|v| *v *= scale);
        g.log_scales.as_flattened_mut().iter_mut().for_each(|v| *v += scale.ln());
        trainer.state.typical_depth *= scale;
        let report = run(&mut trainer, 80);
        assert!(report.dropped == 0 && is_finite(&trainer));
        trainer.psnr_db().unwrap().unwrap()
    };
    let usual = psnr_at(1.0);
    for scale in [0.05, 100.0, 1e4] {
        let other = psnr_at(scale);
        assert!((other - usual).abs() < 0.7, "{other} dB at scale {scale}, {usual} dB as recorded");
    }
}

#[test]
fn a_step_that_is_not_finite_is_dropped_and_counted() {
    let clip = Clip::new(4);
    let mut trainer = clip.trainer(short(10));
    run(&mut trainer, 2);
    let before = trainer.state.model.gaussians.clone();
    let depth = std::mem::replace(&mut trainer.state.typical_depth, f32::NAN);
    let report = run(&mut trainer, 1);
    assert_eq!(report.dropped, 1);
    assert_eq!(trainer.state.model.gaussians, before);
    trainer.state.typical_depth = depth;
    assert_eq!(run(&mut trainer, 1).dropped, 1);
}

#[test]
fn depth_nearer_than_the_near_plane_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    demo::write(&demo_settings(2), folder.path(), &mut unobserved).unwrap();
    let toml = folder.path().join("sequence.toml");
    let text = std::fs::read_to_string(&toml).unwrap().replace("scale = 0.005", "scale = 0.00000001");
    std::fs::write(&toml, text).unwrap();
    let sequence = Sequence::open(folder.path()).unwrap();
    let error = Trainer::new(&sequence, None, short(2)).err().unwrap().to_string();
    assert!(error.contains("near plane") && error.contains("scale"), "{error}");
}

#[test]
fn black_frames_in_the_middle_leave_the_others_to_be_learned() {
    let folder = tempfile::tempdir().unwrap();
    demo::write(&demo_settings(8), folder.path(), &mut unobserved).unwrap();
    for i in [3, 4] {
        let path = folder.path().join(format!("images/frame_{i:06}.png"));
        image::RgbImage::new(64, 48).save(path).unwrap();
    }
    let sequence = Sequence::open(folder.path()).unwrap();
    let mut trainer = Trainer::new(&sequence, None, short(60)).unwrap();
    run(&mut trainer, 60);
    let mean = |picture: image::RgbImage| {
        picture.as_raw().iter().map(|v| f64::from(*v)).sum::<f64>() / picture.as_raw().len() as f64
    };
    for i in [0, 7] {
        let (shown, truth) = (mean(trainer.render(i).unwrap().to_rgb()), mean(sequence.frame(i).unwrap()));
        assert!(shown > 0.4 * truth, "frame {i} has the mean level {shown} instead of {truth}");
    }
}

#[test]
fn changing_light_is_followed_where_colour_may_change() {
    let folder = tempfile::tempdir().unwrap();
    demo::write(&demo_settings(9), folder.path(), &mut unobserved).unwrap();
    for i in 0..9u32 {
        let path = folder.path().join(format!("images/frame_{i:06}.png"));
        let mut picture = image::open(&path).unwrap().to_rgb8();
        let gain = 0.6 + 0.1 * i as f32;
        picture.pixels_mut().for_each(|p| p.0 = p.0.map(|v| (f32::from(v) * gain).min(255.0) as u8));
        picture.save(&path).unwrap();
    }
    let sequence = Sequence::open(folder.path()).unwrap();
    let psnr = |colour_over_time| {
        let mut trainer =
            Trainer::new(&sequence, None, TrainSettings { colour_over_time, ..short(300) }).unwrap();
        run(&mut trainer, 300);
        trainer.psnr_db().unwrap().unwrap()
    };
    let (still, changing) = (psnr(false), psnr(true));
    assert!(changing > still + 0.4, "{changing} dB against {still} dB");
}

#[test]
fn depth_changes_only_where_something_tells_of_it() {
    let folder = tempfile::tempdir().unwrap();
    demo::write(&demo_settings(9), folder.path(), &mut unobserved).unwrap();
    let moves = |path: &Path| {
        let settings = TrainSettings { finds_path: false, ..short(60) };
        let mut trainer = Trainer::new(&Sequence::open(path).unwrap(), None, settings).unwrap();
        run(&mut trainer, 60);
        let d = &trainer.state.model.deformation;
        let is_moved = |axis: usize| d.weights.iter().skip(axis).step_by(d.stride).any(|w| *w != 0.0);
        [0, 1, 2].map(is_moved)
    };
    assert_eq!(moves(folder.path()), [true; 3]);
    assert_eq!(moves(&folder.path().join("images")), [true, true, false], "pictures alone");
}

#[test]
fn held_out_frames_are_guessed_and_never_read() {
    let folder = tempfile::tempdir().unwrap();
    demo::write(&demo_settings(24), folder.path(), &mut unobserved).unwrap();
    let trained = |guesses_held_out| {
        let sequence = Sequence::open(folder.path()).unwrap();
        let settings = TrainSettings { eval: true, guesses_held_out, ..short(60) };
        let mut trainer = Trainer::new(&sequence, None, settings).unwrap();
        run(&mut trainer, 60);
        trainer
    };
    let [guessing, blind] = [trained(true), trained(false)];
    assert_eq!((guessing.cache.guessed().collect(), blind.cache.guessed().count()), (vec![1, 9, 17], 0));
    assert!(guessing.state.model.gaussians != blind.state.model.gaussians);
    // Now the held-out frames are upside down, which changes nothing.
    for i in [1, 9, 17] {
        let path = folder.path().join(format!("images/frame_{i:06}.png"));
        image::imageops::flip_vertical(&image::open(&path).unwrap().to_rgb8()).save(&path).unwrap();
    }
    let again = trained(true);
    assert!(again.state.model.gaussians == guessing.state.model.gaussians);
    assert!(again.state.model.deformation == guessing.state.model.deformation);
}

#[test]
fn a_guess_is_nearer_than_the_mean_of_the_frames_around() {
    let folder = tempfile::tempdir().unwrap();
    let settings = DemoSettings::of_size(160, 120, 12);
    demo::write(&settings, folder.path(), &mut unobserved).unwrap();
    let sequence = Sequence::open(folder.path()).unwrap();
    let mut trainer = Trainer::new(&sequence, None, TrainSettings { eval: true, ..short(1) }).unwrap();
    let [before, guess, after] = [8, 9, 10].map(|i| trainer.cache.get(None, i, false).unwrap());
    let truth = TrainFrame::load(&sequence, None, 9).unwrap();
    let error = |level: &dyn Fn(usize) -> f32| {
        let known = (0..truth.colour.len()).filter(|i| guess.mask[i % guess.mask.len()]);
        known.map(|i| (level(i) - f32::from(truth.colour[i])).powi(2)).sum::<f32>()
    };
    let blend = error(&|i| (f32::from(before.colour[i]) + f32::from(after.colour[i])) / 2.0);
    let guessed = error(&|i| f32::from(guess.colour[i]));
    assert!(guessed < 0.7 * blend, "the guess misses by {guessed}, the mean of the frames around by {blend}");
}

#[test]
fn repeated_frames_get_one_time_and_held_out_ones_are_not_read() {
    let folder = tempfile::tempdir().unwrap();
    demo::write(&demo_settings(24), folder.path(), &mut unobserved).unwrap();
    let picture = |i: usize| folder.path().join(format!("images/frame_{i:06}.png"));
    for i in [5, 13, 21] {
        std::fs::copy(picture(i - 1), picture(i)).unwrap();
    }
    // Frames 1, 9 and 17 would be repeated, too, but are held out.
    image::RgbImage::new(64, 48).save(picture(9)).unwrap();
    let sequence = Sequence::open(folder.path()).unwrap();
    let times = |finds_repeats| {
        let settings = TrainSettings { eval: true, finds_repeats, ..short(1) };
        let scene = Trainer::new(&sequence, None, settings).unwrap().scene().unwrap();
        let path = folder.path().join("scene.safetensors");
        scene.save(&path).unwrap();
        let read = Scene::load(&path).unwrap();
        assert_eq!(read.times, scene.times);
        (0..24).map(|i| read.time(i)).collect::<Vec<f32>>()
    };
    let found = times(true);
    let repeated: Vec<usize> = (1..24).filter(|&i| found[i] == found[i - 1]).collect();
    assert_eq!(repeated, [1, 5, 9, 13, 17, 21]);
    assert!(found.is_sorted() && found[23] == 17.0 / 18.0, "{found:?}");
    assert_eq!(times(false)[9], 9.0 / 24.0);
}

#[test]
fn long_recordings_cost_no_more_per_step_and_keep_to_their_memory() {
    let bases = |frames| short(1).num_bases(frames);
    assert_eq!((bases(1), bases(48), bases(80), bases(10_000)), (5, 17, 27, 64));
    // Only live bases are touched in a step.
    for frames in [80, 10_000] {
        let b = bases(frames);
        let d = crate::deform::Deformation {
            shape: crate::deform::BasisShape::Spline,
            ..crate::deform::Deformation::at_rest(1, 0, b, 1.0 / (b - 1) as f32, 1.0)
        };
        assert!((0..100).all(|t| d.basis_values(t as f32 / 100.0).1.len() <= 5));
    }
    let clip = Clip::new(10);
    let mut trainer = clip.trainer(TrainSettings { frame_cache_bytes: 100_000, ..short(40) });
    run(&mut trainer, 40);
    assert!(trainer.cache.used_bytes() <= 100_000);
}

/// A backend that does nothing but note which pixels of which frame each step takes.
#[derive(Default)]
struct Noting(std::sync::Arc<std::sync::Mutex<Vec<(usize, StepView)>>>);

impl TrainBackend for Noting {
    fn name(&self) -> String {
        "noting".into()
    }

    fn step(
        &mut self,
        _: &mut Model,
        plan: StepPlan,
        _: &Context<'_>,
        _: &mut PassClock<Pass>,
    ) -> Result<StepOutcome> {
        self.0.lock().unwrap().push((plan.index, plan.view));
        Ok(StepOutcome::default())
    }

    fn densify(&mut self, _: &mut Model, _: &Densify, _: &Context<'_>) -> Result<StepOutcome> {
        Ok(StepOutcome::default())
    }
}

#[test]
fn a_backend_is_tried_on_what_takes_longest_with_everything_at_hand() {
    let clip = Clip::new(6);
    let mut trainer = clip.trainer(short(400));
    let noting = Noting::default();
    let views = noting.0.clone();
    trainer.try_out(Box::new(noting), 8).unwrap();
    let views = views.lock().unwrap();
    assert_eq!(views.len(), 16);
    let pixels = |(frame, view): &(usize, StepView)| (*frame, view.half, view.sampling.first);
    let (first, timed) = views.split_at(8);
    assert!(first.iter().map(pixels).eq(timed.iter().map(pixels)), "{views:?}");
    assert!(timed.iter().all(|(_, view)| !view.half && view.progress >= 0.75), "{views:?}");
    assert_eq!(trainer.state.step, 0);
}
