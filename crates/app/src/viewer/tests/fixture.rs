//! A fake that answers in place of the engine, and a window on it.

use super::*;
use crate::{jobs::TRAINING, viewer::backend::PREPARING};

pub(super) const SIZE: (u32, u32) = (32, 24);
pub(super) const FRAMES: usize = 48;

pub(super) struct Fake {
    pub(super) info: Info,
    /// Gate that gives out scores one permission at a time, if there is one.
    pub(super) gate: Option<mpsc::Receiver<()>>,
    /// Marks, which are carried as if nothing moved.
    pub(super) marks: Vec<Mark>,
}

impl Fake {
    /// Returns the scores of what is marked: high on marked pixels; `None` for words that no mark names.
    fn marked(&self, words: &str) -> Option<Grid<f32>> {
        let name = plain_words(words);
        self.marks.iter().find(|mark| mark.name == name)?;
        let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
        let mut votes = vec![0; width * height];
        for mark in self.marks.iter().filter(|mark| mark.name == name) {
            let pixels = mark.shape.pixels(width, height).data;
            votes
                .iter_mut()
                .zip(pixels)
                .filter(|(_, p)| *p)
                .for_each(|(v, _)| *v += if mark.add { 1 } else { -1 });
        }
        Some(Grid::from_vec(
            width,
            height,
            votes.into_iter().map(|v| if v > 0 { 0.9 } else { 0.1 }).collect(),
        ))
    }
}

impl FrameSource for Fake {
    fn info(&self) -> &Info {
        &self.info
    }
    fn original(&mut self, frame: usize) -> Result<RgbImage> {
        Ok(RgbImage::from_pixel(SIZE.0, SIZE.1, Rgb([frame as u8, 0, 0])))
    }
    fn instruments(&mut self, _: usize) -> Result<Option<Mask>> {
        let is_upper = |i: u32| i / SIZE.0 < SIZE.1 / 2;
        let mask =
            || Grid::from_vec(SIZE.0 as usize, SIZE.1 as usize, (0..SIZE.0 * SIZE.1).map(is_upper).collect());
        Ok((self.info.name == "with tools").then(mask))
    }
    fn renderer(&self) -> String {
        "fake".into()
    }
    fn render(&mut self, view: &FrameView, _: Parts) -> Result<Rendering> {
        Ok(Rendering {
            colour: Some(RgbImage::from_pixel(SIZE.0, SIZE.1, Rgb([view.frame as u8; 3]))),
            depth: Some(Grid::filled(SIZE.0 as usize, SIZE.1 as usize, 50.0)),
            // In a turned view, the part to the right of the middle is unseen.
            unseen: (!view.orbit.is_home()).then(|| {
                let is_right = (0..SIZE.0 * SIZE.1).map(|i| i % SIZE.0 >= SIZE.0 / 2).collect();
                Grid::from_vec(SIZE.0 as usize, SIZE.1 as usize, is_right)
            }),
        })
    }
    fn sample(&mut self, view: &FrameView, point: [f32; 2]) -> Result<Option<Sample>> {
        let sample = serde_json::json!({ "embedding": [point[0], view.frame], "encoder_sha256": "" });
        Ok(serde_json::from_value(sample).ok().filter(|_| point[1] < 0.9))
    }
    fn prepares_ahead(&self) -> bool {
        self.gate.is_none()
    }
    fn set_marks(&mut self, marks: &[Mark]) -> Result<()> {
        self.marks = marks.to_vec();
        Ok(())
    }
    fn look_here(&mut self, frame: usize) -> Result<Option<LookHere>> {
        let is_marked = self.marks.iter().any(|mark| mark.frame == frame);
        let is_known = |mark: &Mark| self.info.has_features && self.info.example_prompts.contains(&mark.name);
        let is_asked = !is_marked && !self.marks.iter().all(is_known);
        let doubt = if frame == 17 { 0.5 } else { 0.1 };
        Ok(is_asked.then_some(LookHere { frame, point_px: [8.0, 6.0], doubt }))
    }
    fn motion(&mut self, view: &FrameView) -> Result<(Grid<f32>, String)> {
        let travel = (0..SIZE.0 * SIZE.1).map(|i| (i % SIZE.0) as f32 + view.frame as f32).collect();
        Ok((Grid::from_vec(SIZE.0 as usize, SIZE.1 as usize, travel), "3 of 5 Gaussians move".into()))
    }
    fn opacity(&mut self, _: &FrameView) -> Result<Grid<f32>> {
        Ok(Grid::filled(SIZE.0 as usize, SIZE.1 as usize, 1.0))
    }
    fn scores(&mut self, view: &FrameView, questions: &[Question]) -> Vec<Result<Grid<f32>>> {
        if let Some(gate) = &self.gate {
            let _ = gate.recv();
        }
        let score = |question: &Question| match question.text.as_str() {
            _ if self.info.is_unlearned(view.frame) => {
                Ok(Grid::filled(SIZE.0 as usize, SIZE.1 as usize, 0.0))
            }
            words if self.marked(words).is_some() => Ok(self.marked(words).unwrap_or_default()),
            _ if !self.info.has_features => Ok(Grid::filled(SIZE.0 as usize, SIZE.1 as usize, 0.0)),
            "broken" => Err(Error::input("the encoder cannot read this", "Use other words.")),
            "spleen" | "banana" | "Leber" if !question.shows_nearest => {
                Ok(Grid::filled(SIZE.0 as usize, SIZE.1 as usize, 0.0))
            }
            "nothing" => Ok(Grid::filled(SIZE.0 as usize, SIZE.1 as usize, 0.2)),
            "polyp" => {
                let width = 2 * (6 - view.frame.abs_diff(15).min(6) as u32);
                let left = |i| if i % SIZE.0 < width { 0.8 } else { 0.3 };
                let data = (0..SIZE.0 * SIZE.1).map(left).collect();
                Ok(Grid::from_vec(SIZE.0 as usize, SIZE.1 as usize, data))
            }
            _ => {
                let left = |i| if i % SIZE.0 < SIZE.0 / 4 { 0.8 } else { 0.3 };
                let data = (0..SIZE.0 * SIZE.1).map(left).collect();
                Ok(Grid::from_vec(SIZE.0 as usize, SIZE.1 as usize, data))
            }
        };
        questions.iter().map(score).collect()
    }
    fn answers(&mut self, questions: &[Question]) -> Vec<Option<Answer>> {
        let answer = |question: &Question| {
            let needs_mark = !self.info.has_features && self.marked(&question.text).is_none();
            let (certainty, nearest) = match question.text.as_str() {
                _ if needs_mark => (0.0, None),
                "spleen" => (0.0, Some("liver".to_owned())),
                "banana" | "Leber" => (0.0, None),
                _ => (1.0, None),
            };
            let absence = match question.text.as_str() {
                _ if needs_mark => Absence::NeedsMark,
                "Leber" => Absence::NotUnderstood,
                _ => Absence::NotThere,
            };
            Some(Answer { certainty, nearest, why: "it was made up".into(), absence })
        };
        questions.iter().map(answer).collect()
    }
}

#[derive(Default)]
pub(super) struct FakeBackend {
    pub(super) info: Info,
    pub(super) gate: Mutex<Option<mpsc::Receiver<()>>>,
    pub(super) exported: Mutex<Vec<(ExportRequest, Negatives)>>,
    /// Number of measurements of quality that were begun.
    pub(super) num_measured: AtomicUsize,
    /// Ranges of frames that were not to be measured.
    pub(super) unmeasured: Mutex<Vec<(usize, usize)>>,
    pub(super) faults: Mutex<ModelFaults>,
    /// Folder of what networks found before.
    pub(super) found: Mutex<Option<PathBuf>>,
    pub(super) folders_shown: Mutex<Vec<PathBuf>>,
    pub(super) trained: Mutex<Vec<TrainRequest>>,
    pub(super) available_bytes: Mutex<Option<u64>>,
    pub(super) checked: Mutex<Checked>,
    pub(super) is_disk_full: AtomicBool,
    /// `true` to keep a training from learning anything yet.
    pub(super) is_preparing: AtomicBool,
    /// `true` to end a training by itself.
    pub(super) is_trained: AtomicBool,
    pub(super) is_export_slow: AtomicBool,
    pub(super) is_flip_slow: AtomicBool,
    pub(super) is_network_slow: AtomicBool,
    /// Hash and number of the frames, once the recording has other ones.
    pub(super) changed: Mutex<Option<(String, usize)>>,
    /// Answer of the system's file dialog; without it, there is none.
    pub(super) picked: Mutex<Option<Picked>>,
}

impl Backend for FakeBackend {
    fn open(&self, path: &Path) -> Result<Box<dyn FrameSource>> {
        if path == Path::new("/no/such") {
            return Err(Error::input_at(path, "there is no such file", "Choose another one."));
        }
        let trained = !self.trained.lock().unwrap().is_empty();
        let is_other = path.starts_with("/elsewhere");
        let known = self.info.frames_sha256.clone().map(|sum| if is_other { "others".into() } else { sum });
        let changed = self.changed.lock().unwrap().clone();
        let (frames_sha256, num_frames) =
            changed.map_or((known, self.info.num_frames), |(sum, count)| (Some(sum), count));
        let info = Info {
            name: if is_other { "other".into() } else { self.info.name.clone() },
            path: path.to_owned(),
            frames_sha256,
            num_frames,
            recording: self.info.recording.clone().or(self.info.has_original.then(|| path.to_owned())),
            has_reconstruction: self.info.has_reconstruction || trained,
            has_features: self.info.has_features || trained,
            ..self.info.clone()
        };
        Ok(Box::new(Fake { info, gate: self.gate.lock().unwrap().take(), marks: Vec::new() }))
    }
    fn pick(&self, _: &PathAsk) -> Picked {
        self.picked.lock().unwrap().clone().unwrap_or(Picked::Unavailable)
    }
    fn check(&self, _: &Path, task: &TaskContext) -> Result<Checked> {
        task.progress("checking", 48, 48, String::new());
        Ok(self.checked.lock().unwrap().clone())
    }
    fn flip_masks(&self, path: &Path) -> Result<PathBuf> {
        while self.is_flip_slow.load(Ordering::Relaxed) {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let mut checked = self.checked.lock().unwrap();
        *checked = Checked { report: CheckReport { ok: true, ..CheckReport::default() }, can_flip: true };
        Ok(path.join("sequence.toml"))
    }
    fn demo(&self, folder: &Path, _: &TaskContext<Box<dyn FrameSource>>) -> Result<Demo> {
        let request = TrainRequest {
            recording: folder.to_owned(),
            scene: folder.join("scene"),
            replaces: false,
            quality: Quality::Quick,
            excluded: Vec::new(),
            words: Words::Labels,
            features: None,
        };
        Ok(Demo { path: folder.to_owned(), train: Some(request) })
    }
    fn export(
        &self,
        request: &ExportRequest,
        negatives: &Negatives,
        task: &TaskContext,
    ) -> Result<ExportSummary> {
        task.progress("Exporting", 1, 1, String::new());
        while self.is_export_slow.load(Ordering::Relaxed) && !task.is_cancelled() {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        self.exported.lock().unwrap().push((request.clone(), negatives.clone()));
        let (frames, prompts) = (request.frames.len(), request.questions.len());
        let files = num_files(&request.options.formats, frames, prompts);
        Ok(ExportSummary { complete: !task.is_cancelled(), frames, files, ..Default::default() })
    }
    fn show_folder(&self, folder: &Path) -> Result<()> {
        self.folders_shown.lock().unwrap().push(folder.to_owned());
        Ok(())
    }
    fn evaluate(&self, scene: &Path, left_out: &[(usize, usize)], task: &TaskContext) -> Result<Evaluation> {
        task.progress("evaluating", 2, 2, String::new());
        self.num_measured.fetch_add(1, Ordering::Relaxed);
        self.unmeasured.lock().unwrap().extend(left_out);
        if scene.ends_with("gone") {
            return Err(Error::input("the recording is not at hand", "Put it back."));
        }
        let mut evaluation = Evaluation::example();
        evaluation.report.held_out &= !scene.ends_with("all-learned");
        Ok(evaluation)
    }
    fn check_models(&self, _: &Models, task: &TaskContext) -> Result<ModelFaults> {
        task.progress("trying", 1, 1, String::new());
        Ok(self.faults.lock().unwrap().clone())
    }
    fn found_before(
        &self,
        _: &Models,
        _: &Path,
        folders: &[PathBuf],
        task: &TaskContext,
    ) -> Result<Option<PathBuf>> {
        task.progress("looking", 1, 1, String::new());
        Ok(self.found.lock().unwrap().clone().filter(|found| folders.contains(found)))
    }
    fn with_mask(&self, model: &Path, _: &Path, mark: &Mark) -> Result<Mark> {
        while self.is_network_slow.load(Ordering::Relaxed) {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        match model.to_str() {
            Some("/broken") => Err(Error::input("the network is damaged", "Choose another one.")),
            Some("/blind") => Ok(mark.clone()),
            // The object takes the left half of the picture.
            _ => {
                let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
                let is_left = (0..width * height).map(|i| i % width < width / 2).collect();
                let shape = surgtpgs_core::marks::Shape::from(&Grid::from_vec(width, height, is_left));
                Ok(Mark { shape, ..mark.clone() })
            }
        }
    }
    fn available_bytes(&self) -> Option<u64> {
        *self.available_bytes.lock().unwrap()
    }
    fn reconstruct(&self, request: &TrainRequest, task: &TaskContext<TrainNews>) -> Result<PathBuf> {
        while self.is_preparing.load(Ordering::Relaxed) {
            task.check()?;
            task.progress(PREPARING, 1, 2, String::new());
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        if request.recording.ends_with("broken") {
            return Err(Error::input("there is nothing to learn from", "Record something."));
        }
        task.progress(TRAINING, 10, request.quality.steps(), "100 Gaussians".into());
        let (path, recording) = (request.recording.clone(), Some(request.recording.clone()));
        let info = Info { path, recording, has_reconstruction: true, ..self.info.clone() };
        task.update(TrainNews::Preview(Box::new(Fake { info, gate: None, marks: Vec::new() })));
        let mut step = 10;
        while !task.is_cancelled() && !self.is_trained.load(Ordering::Relaxed) {
            task.rest_while_paused();
            step += 1;
            let terms = LossTerms { colour: 1.0 / step as f32, depth: 0.01, ..Default::default() };
            task.update(TrainNews::Step(step, terms));
            let steps = request.quality.steps();
            task.progress(TRAINING, step.min(steps - 1), steps, String::new());
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        while self.is_disk_full.load(Ordering::Relaxed) {
            if task.is_given_up() {
                return Err(Error::input("the disk is full", "Make room."));
            }
            task.progress(NOT_SAVED, step, step, "The disk is full.".into());
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        self.trained.lock().unwrap().push(request.clone());
        Ok(request.scene.clone())
    }
}

pub(super) fn scene() -> Info {
    Info {
        name: "clip".into(),
        num_frames: FRAMES,
        width: SIZE.0 as usize,
        height: SIZE.1 as usize,
        frames_per_second: Some(25.0),
        has_original: true,
        has_reconstruction: true,
        learned: 1.0,
        unlearned: Vec::new(),
        has_measured_depth: true,
        has_features: true,
        example_prompts: vec!["liver".into(), "fat".into()],
        output_folder: "/data".into(),
        ..Info::default()
    }
}

/// A recording that was never reconstructed, with labels.
pub(super) fn bare() -> Info {
    Info { has_reconstruction: false, has_features: false, has_labels: true, ..scene() }
}

pub(super) struct Window {
    pub(super) harness: Harness<'static, Shell>,
    pub(super) backend: Arc<FakeBackend>,
}

impl Window {
    /// Opens a window on a scene, with the notice read and the first picture of its reconstruction shown.
    pub(super) fn on(info: Info) -> Self {
        let mut window = Self::gated(info, None);
        window.until(|app| app.picture().is_some());
        if window.harness.state().shared.info().is_some_and(|i| i.has_reconstruction) {
            window.harness.state_mut().shared.document.mode = ViewMode::Reconstruction;
            window.until_picture(|p| p.reconstruction.is_some() && !p.request.needs_original);
        }
        window
    }

    pub(super) fn gated(info: Info, gate: Option<mpsc::Receiver<()>>) -> Self {
        // A recording does not lie where its reconstruction will.
        let name = if info.has_reconstruction { "clip.safetensors" } else { "clip.mp4" };
        let sound = Checked { report: CheckReport { ok: true, ..CheckReport::default() }, can_flip: false };
        let checked = Mutex::new(sound);
        let backend = Arc::new(FakeBackend { info, gate: Mutex::new(gate), checked, ..Default::default() });
        let mut window = Self::with(backend);
        window.harness.state_mut().shared.preferences.is_acknowledged = true;
        let ctx = window.harness.ctx.clone();
        window.harness.state_mut().shared.open_path(&Path::new("/data").join(name), &ctx);
        window.until(|app| app.open.is_some());
        window
    }

    pub(super) fn with(backend: Arc<FakeBackend>) -> Self {
        let theirs = backend.clone();
        let harness =
            Harness::builder().with_size(egui::vec2(1280.0, 800.0)).with_step_dt(1.0 / 60.0).build_eframe(
                |cc| Shell::new(&cc.egui_ctx, theirs, Preferences::load(None), Autosave::default()),
            );
        Self { harness, backend }
    }

    /// Steps until `is_so`, however long the threads take; panics after far too long.
    pub(super) fn until(&mut self, is_so: impl Fn(&Shared) -> bool) {
        for _ in 0..20_000 {
            self.harness.step();
            if is_so(&self.harness.state().shared) {
                // One more step, so that the screen shows the awaited state.
                self.harness.step();
                return;
            }
            std::thread::sleep(std::time::Duration::from_micros(500));
        }
        panic!("it never happened: {:?}", self.harness.state().shared.problem);
    }

    pub(super) fn until_shown(&mut self, text: &str) {
        for _ in 0..20_000 {
            self.harness.step();
            if self.shows(text) {
                return;
            }
            std::thread::sleep(std::time::Duration::from_micros(500));
        }
        panic!("\"{text}\" is never shown: {:?}", self.harness.state().shared.problem);
    }

    pub(super) fn until_picture(&mut self, is_so: impl Fn(&Picture) -> bool) {
        self.until(|app| app.picture().is_some_and(&is_so));
    }

    /// Steps until the added prompts have their answers. Before, there may be answers to words half typed.
    pub(super) fn until_found(&mut self) {
        self.until(|app| {
            let visible = app.document.prompts().iter().filter(|p| p.is_visible).map(|p| p.id);
            app.picture().is_some_and(|p| p.findings.iter().map(|f| f.id).eq(visible))
        });
    }

    pub(super) fn press(&mut self, key: Key) {
        self.harness.key_press(key);
        self.harness.step();
    }

    pub(super) fn press_with(&mut self, modifiers: Modifiers, key: Key) {
        self.harness.key_press_modifiers(modifiers, key);
        self.harness.step();
    }

    pub(super) fn frame(&self) -> usize {
        self.harness.state().shared.playback.frame()
    }

    pub(super) fn type_prompt(&mut self, text: &str) {
        self.type_into("Prompt", text);
    }

    /// Gives the keyboard to the field with this label, and types.
    pub(super) fn type_into(&mut self, label: &str, text: &str) {
        self.harness.get_by_label(label).focus();
        self.harness.step();
        self.harness.get_by_label(label).type_text(text);
        self.harness.step();
    }

    /// Adds a prompt and leaves the prompt box, so that keys are commands again.
    pub(super) fn add_prompt(&mut self, text: &str) {
        self.type_prompt(text);
        self.press(Key::Enter);
        self.press(Key::Escape);
    }

    /// Sends the events of words in one batch, as a fast typist or a slow machine makes them.
    pub(super) fn type_at_once(&mut self, text: &str) {
        for letter in text.chars() {
            let name = letter.to_uppercase().to_string();
            let key = match letter {
                '\n' => Key::Enter,
                '/' => Key::Slash,
                ' ' => Key::Space,
                _ => Key::from_name(&name).unwrap(),
            };
            let event = |pressed| egui::Event::Key {
                key,
                physical_key: None,
                pressed,
                repeat: false,
                modifiers: Modifiers::NONE,
            };
            let events = &mut self.harness.input_mut().events;
            events.push(event(true));
            if letter != '\n' {
                events.push(egui::Event::Text(letter.into()));
            }
            events.push(event(false));
        }
        (0..6).for_each(|_| self.harness.step());
    }

    pub(super) fn click(&mut self, label: &str) {
        self.harness.get_by_label(label).click();
        // The click; what it asks for; what that shows.
        (0..3).for_each(|_| self.harness.step());
    }

    /// Stops the training. Its button moves as progress comes in, so that a click on its place may miss it.
    pub(super) fn stop_training(&mut self) {
        self.harness.get_by_label("Stop and keep what was learned").click_accesskit();
        (0..3).for_each(|_| self.harness.step());
    }

    /// Starts the training that is offered, and stops it; returns what was to be trained.
    pub(super) fn train_briefly(&mut self) -> TrainRequest {
        self.click("Start");
        self.until_shown("Reconstructing: training");
        self.stop_training();
        self.until(|app| app.reconstruction.training.is_none());
        self.backend.trained.lock().unwrap().last().unwrap().clone()
    }

    /// Scrolls to a widget, as one does whose panel is long, and clicks it.
    pub(super) fn scroll_and_click(&mut self, label: &str) {
        self.harness.get_by_label(label).scroll_to_me();
        // Scrolling takes a moment.
        (0..60).for_each(|_| self.harness.step());
        self.click(label);
    }

    pub(super) fn shows(&self, text: &str) -> bool {
        self.harness.query_all_by_label_contains(text).next().is_some()
    }
}

/// Returns the lines around what was found that are painted in a colour, with their widths. Curves are
/// thinner.
pub(super) fn painted_lines(window: &Window, colour: [u8; 3]) -> Vec<(Vec<egui::Pos2>, f32)> {
    let colour = egui::epaint::ColorMode::Solid(crate::viewer::theme::colour32(colour));
    let line = |clipped: &egui::epaint::ClippedShape| match &clipped.shape {
        egui::Shape::Path(path) if path.stroke.color == colour && path.stroke.width > 2.2 => {
            Some((path.points.clone(), path.stroke.width))
        }
        _ => None,
    };
    window.harness.output().shapes.iter().filter_map(line).collect()
}

/// Returns the texts that are painted, whoever paints them.
pub(super) fn painted(window: &Window) -> Vec<String> {
    fn texts(shape: &egui::Shape, into: &mut Vec<String>) {
        match shape {
            egui::Shape::Text(text) => into.push(text.galley.text().to_owned()),
            egui::Shape::Vec(shapes) => shapes.iter().for_each(|shape| texts(shape, into)),
            _ => {}
        }
    }
    let mut found = Vec::new();
    window.harness.output().shapes.iter().for_each(|clipped| texts(&clipped.shape, &mut found));
    found
}
