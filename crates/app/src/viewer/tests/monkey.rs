//! Monkey test of the window: seeded random input to the real engine, and conditions that must hold whatever
//! it does.
//!
//! `cargo test` runs a few hundred acts. For a long run:
//! `MONKEY_MINUTES=30 MONKEY_SEED=1 cargo test --release -p surgtpgs monkey_for_long -- --ignored --nocapture`
//! (with `--release`: otherwise egui keeps the names of all ids for its messages, and memory grows).

use super::*;
use crate::{
    jobs::{self, DemoOptions},
    viewer::{
        backend::engine::EngineBackend,
        command::{COMMANDS, Command, Entry, Scope, entry, keys},
        state::{content::Content, marking::Tool, marks::canvas},
    },
};
use egui::{Event, MouseWheelUnit, PointerButton, Pos2, Vec2, pos2, vec2};
use rand::{Rng, SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;
use std::{
    collections::{BTreeSet, VecDeque},
    time::{Duration, Instant},
};
use surgtpgs_core::{demo::DemoSettings, progress::unobserved};

/// Texts to type: words, nothing, signs of other scripts, text that a shell or a web page would obey, and a
/// control character.
const WORDS: [&str; 12] = [
    "gallbladder",
    "liver",
    "grasper",
    "g",
    " ",
    "фиброз",
    "胆嚢",
    "👩‍⚕️",
    "e\u{301}",
    "$(rm -rf *)",
    "<b>fat</b>",
    "a\u{7}b",
];
/// Commands that open the system's file dialogs, which nobody answers here.
pub(super) const DIALOGS: [Command; 7] = [
    Command::OpenFile,
    Command::OpenFolder,
    Command::OpenPath,
    Command::SaveSession,
    Command::SaveSessionAs,
    Command::OpenMarks,
    Command::SaveMarks,
];
/// Labels of further buttons that open such dialogs.
const DIALOG_BUTTONS: [&str; 4] =
    ["Folder…", "Save as…", "Open a video or a file…", "Open a folder of frames…"];
/// Number of acts after which the monkey tidies up, and checks that the window still answers.
const ACTS_PER_ROUND: usize = 250;
/// Number of the last acts that are reported when something breaks.
const REMEMBERED: usize = 25;

/// Renderer that draws nothing. Without a renderer, the harness keeps every change of a texture for the first
/// time that it draws.
struct NoPictures;

impl egui_kittest::TestRenderer for NoPictures {
    fn handle_delta(&mut self, changes: &mut egui::TexturesDelta) {
        changes.clear();
    }
}

struct Monkey {
    harness: Harness<'static, Shell>,
    rng: ChaCha8Rng,
    seed: u64,
    folder: tempfile::TempDir,
    size: Vec2,
    acts: VecDeque<String>,
}

impl Monkey {
    fn new(seed: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let recording = DemoSettings { width: 64, height: 48, frames: 10, ..DemoSettings::default() };
        let options = DemoOptions { recording, iterations: 60 };
        jobs::build_demo(folder.path(), &options, &mut unobserved).unwrap();
        std::fs::write(folder.path().join("broken.safetensors"), b"not a scene").unwrap();
        let size = vec2(1280.0, 800.0);
        let builder = Harness::builder().with_size(size).with_step_dt(1.0 / 60.0).renderer(NoPictures);
        let harness = builder.build_eframe(|cc| {
            let mut preferences = Preferences::load(None);
            preferences.is_acknowledged = true;
            Shell::new(&cc.egui_ctx, Arc::<EngineBackend>::default(), preferences, Autosave::default())
        });
        // The same policy as in the real window, where the system's fonts may lack a sign, too.
        harness.ctx.set_missing_glyph_policy(egui::MissingGlyphPolicy::Tofu);
        let rng = ChaCha8Rng::seed_from_u64(seed);
        let mut monkey = Self { harness, rng, seed, folder, size, acts: VecDeque::new() };
        monkey.open("scene.safetensors");
        monkey
    }

    fn open(&mut self, name: &str) {
        let ctx = self.harness.ctx.clone();
        self.harness.state_mut().shared.open_path(&self.folder.path().join(name), &ctx);
    }

    fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        *choices.choose(&mut self.rng).expect("there is a choice")
    }

    fn note(&mut self, act: String) {
        if self.acts.len() == REMEMBERED {
            self.acts.pop_front();
        }
        self.acts.push_back(act);
    }

    fn act(&mut self) {
        match self.rng.random_range(0..100) {
            0..30 => self.press_some_key(),
            30..50 => self.click_something(),
            50..62 => self.type_something(),
            62..75 => self.drag_somewhere(),
            75..78 => self.mark_something(),
            78..82 => self.scroll(),
            82..86 => self.resize(),
            86..92 => self.undo_and_redo(),
            92..95 => {
                let names = ["scene.safetensors", "prepared", "recording", "broken.safetensors", "nothing"];
                let name = self.one_of(&names);
                self.note(format!("open {name}"));
                self.open(name);
            }
            95..97 => self.reconstruct(),
            97..99 => self.export(),
            _ => {
                self.note("wait".into());
                std::thread::sleep(Duration::from_millis(30));
            }
        }
        for _ in 0..self.rng.random_range(1..4) {
            self.harness.step();
        }
    }

    fn press_some_key(&mut self) {
        let has_key =
            |e: &&Entry| !DIALOGS.contains(&e.command) && e.scope != Scope::Hold && !e.keys.is_empty();
        let entries: Vec<_> = COMMANDS.iter().filter(has_key).collect();
        let entry = self.one_of(&entries);
        let keys = keys::keys(entry, &self.harness.state().shared.preferences.keys);
        let Some(key) = keys.choose(&mut self.rng) else { return };
        self.note(format!("{} ({key:?})", entry.label));
        self.harness.key_press_modifiers(key.modifiers, key.logical_key);
    }

    fn click_something(&mut self) {
        let dialogs = DIALOGS.map(|c| entry(c).label);
        let roles =
            [Role::Button, Role::CheckBox, Role::RadioButton, Role::Slider, Role::Image, Role::TextInput];
        let clicked = {
            let label_of = |node: &egui_kittest::Node<'_>| node.accesskit_node().label().unwrap_or_default();
            let nodes: Vec<_> = roles
                .into_iter()
                .flat_map(|role| self.harness.query_all_by_role(role))
                .filter(|node| {
                    let label = label_of(node);
                    let opens_dialog =
                        dialogs.iter().chain(&DIALOG_BUTTONS).any(|dialog| label.starts_with(dialog));
                    !node.accesskit_node().is_disabled() && !opens_dialog
                })
                .collect();
            nodes.choose(&mut self.rng).map(|node| {
                node.click();
                label_of(node)
            })
        };
        self.note(format!("click {clicked:?}"));
    }

    fn type_something(&mut self) {
        let (words, ends) = (self.one_of(&WORDS), self.rng.random_bool(0.6));
        self.note(format!("type {words:?}{}", if ends { ", Enter" } else { "" }));
        if let Some(field) = self.harness.query_by_label("Prompt") {
            field.focus();
        }
        self.harness.step();
        self.harness.event(Event::Text(words.into()));
        self.harness.step();
        if ends {
            self.harness.key_press(Key::Enter);
        }
    }

    fn somewhere(&mut self) -> Pos2 {
        pos2(self.rng.random_range(0.0..self.size.x), self.rng.random_range(0.0..self.size.y))
    }

    fn drag_somewhere(&mut self) {
        let (from, to) = (self.somewhere(), self.somewhere());
        let button = self.one_of(&[PointerButton::Primary, PointerButton::Secondary, PointerButton::Middle]);
        let modifiers = self.one_of(&[Modifiers::NONE, Modifiers::SHIFT, Modifiers::ALT, Modifiers::COMMAND]);
        self.note(format!("drag {button:?} from {from} to {to} with {modifiers:?}"));
        let press = |pos, pressed| Event::PointerButton { pos, button, pressed, modifiers };
        self.harness.event(Event::PointerMoved(from));
        self.harness.event(press(from, true));
        self.harness.step();
        for k in 1..=3 {
            self.harness.event(Event::PointerMoved(from.lerp(to, k as f32 / 3.0)));
            self.harness.step();
        }
        self.harness.event(press(to, false));
    }

    /// Takes the tool for marking in hand, with some name, and draws with it.
    fn mark_something(&mut self) {
        let (name, tool, adds) = (self.one_of(&WORDS), self.one_of(&Tool::ALL), self.rng.random_bool(0.8));
        self.note(format!("mark {name:?} by {tool:?}"));
        let marking = &mut self.harness.state_mut().shared.viewport.marking;
        (marking.is_on, marking.tool, marking.adds, marking.name) = (true, tool, adds, name.into());
        self.harness.step();
        self.drag_somewhere();
    }

    fn scroll(&mut self) {
        let at = self.somewhere();
        let delta = vec2(self.rng.random_range(-60.0..60.0), self.rng.random_range(-200.0..200.0));
        let modifiers = self.one_of(&[Modifiers::NONE, Modifiers::COMMAND]);
        self.note(format!("scroll by {delta} at {at}"));
        self.harness.event(Event::PointerMoved(at));
        self.harness.event(Event::MouseWheel {
            unit: MouseWheelUnit::Point,
            delta,
            phase: egui::TouchPhase::Move,
            source: egui::MouseWheelSource::Wheel,
            modifiers,
        });
    }

    fn resize(&mut self) {
        self.size = vec2(self.rng.random_range(120.0..2000.0), self.rng.random_range(120.0..1400.0));
        self.note(format!("resize to {}", self.size));
        self.harness.set_size(self.size);
    }

    /// Undoes and redoes edits; afterwards the content must be as before.
    fn undo_and_redo(&mut self) {
        let steps = self.rng.random_range(1..6);
        self.note(format!("undo and redo {steps}"));
        let document = &mut self.harness.state_mut().shared.document;
        document.end_gesture();
        let before = document.content().clone();
        let mut undone = 0;
        while undone < steps && document.undo_name().is_some() {
            document.undo();
            undone += 1;
        }
        (0..undone).for_each(|_| document.redo());
        assert_eq!(*document.content(), before, "after {undone} steps back and forth");
        if self.rng.random_bool(0.5) {
            self.harness.state_mut().shared.document.undo();
        }
    }

    fn reconstruct(&mut self) {
        self.note("reconstruct".into());
        self.harness.key_press_modifiers(Modifiers::COMMAND, Key::R);
        self.harness.step();
        self.harness.step();
        for label in ["Quick look", "Start"] {
            if let Some(button) = self.harness.query_all_by_label_contains(label).next() {
                button.click();
            }
            self.harness.step();
        }
    }

    fn export(&mut self) {
        self.note("export".into());
        self.harness.key_press_modifiers(Modifiers::COMMAND, Key::E);
        self.harness.step();
        self.harness.step();
        if let Some(button) = self.harness.query_by_label("Start export") {
            button.click();
        }
        self.harness.step();
    }

    /// Checks the conditions that must hold after every act.
    fn check(&self) {
        let app = &self.harness.state().shared;
        let ids: BTreeSet<u64> = app.document.prompts().iter().map(|p| p.id).collect();
        assert_eq!(ids.len(), app.document.prompts().len(), "ids of prompts are unique");
        assert!(app.document.selected.is_none_or(|id| ids.contains(&id)), "what is selected is there");
        for prompt in app.document.prompts() {
            assert!((0.0..=1.0).contains(&prompt.threshold), "threshold {}", prompt.threshold);
            assert!(!prompt.text.trim().is_empty());
        }
        let Some(info) = app.info() else { return };
        assert!(app.playback.frame() < info.num_frames.max(1), "frame {}", app.playback.frame());
        let canvas = canvas(info);
        assert!(app.document.marks().all().iter().all(|mark| mark.fits(&canvas)), "all marks are possible");
        let Some(picture) = app.picture() else { return };
        assert!(picture.findings.len() <= picture.request.prompts.len());
        for pane in [&picture.original, &picture.reconstruction].into_iter().flatten() {
            let marked = pane.marked.as_ref().map(|m| m.size);
            let fits = |size| size == pane.bare.size || picture.original.is_some();
            assert!(marked.is_none_or(fits), "what was found is of the picture it lies on");
        }
        for found in picture.findings.iter().filter_map(|f| f.outcome.as_ref().ok()) {
            assert!((0.0..=1.0).contains(&found.area_fraction));
            assert!(!found.max_score.is_nan());
        }
    }

    /// Makes egui start its glyph atlas anew. By itself, egui does so only when 17 MB are four fifths full.
    fn forget_letters(&mut self) {
        let side = self.harness.ctx.input(|i| i.max_texture_side);
        self.harness.input_mut().max_texture_side = Some(if side == 2048 { 2047 } else { 2048 });
    }

    /// Ends all work in progress, clears the prompts, opens the scene again, waits for its picture, and
    /// removes the files that were written.
    fn tidy_up(&mut self) {
        self.size = vec2(1280.0, 800.0);
        self.harness.set_size(self.size);
        self.forget_letters();
        let state = &mut self.harness.state_mut().shared;
        (state.reconstruction.training, state.dialog, state.problem) = (None, None, None);
        state.document.load(Content::default(), 0);
        state.prompt_box.text.clear();
        self.open("scene.safetensors");
        let began = Instant::now();
        let is_there = |app: &Shared| {
            let scene = app.info().is_some_and(|i| i.has_features && i.path.ends_with("scene.safetensors"));
            scene && app.opening.underway.is_none() && app.picture().is_some_and(|p| p.took_ms > 0.0)
        };
        self.harness.step();
        while self.harness.state().shared.opening.underway.is_some()
            || !is_there(&self.harness.state().shared)
        {
            self.harness.step();
            std::thread::sleep(Duration::from_millis(1));
            assert!(began.elapsed() < Duration::from_secs(60), "the window does not answer any more");
        }
        for entry in std::fs::read_dir(self.folder.path()).unwrap().map(|e| e.unwrap()) {
            let name = entry.file_name().to_string_lossy().into_owned();
            let is_made =
                name.contains("-export") || name.contains("-quality") || name.starts_with("recording");
            if is_made && name != "recording" {
                let path = entry.path();
                let removed =
                    if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
                // Files that an unfinished job still writes are removed the next time.
                drop(removed);
            }
        }
    }

    /// Performs some hundred acts, each followed by the checks.
    fn round(&mut self) {
        for _ in 0..ACTS_PER_ROUND {
            let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                self.act();
                self.check();
            }));
            if let Err(panic) = outcome {
                eprintln!("seed {}, its last acts:", self.seed);
                self.acts.iter().for_each(|act| eprintln!("  {act}"));
                std::panic::resume_unwind(panic);
            }
        }
        self.tidy_up();
    }
}

#[test]
fn a_monkey_does_no_harm() {
    let mut monkey = Monkey::new(7);
    monkey.round();
}

/// Returns a value of Linux's status of this process.
fn status(name: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with(name))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Waits until all stopped jobs have ended, which is when there are at most `usual` threads.
fn wait_for_threads(usual: Option<f64>) {
    let began = Instant::now();
    while usual.zip(status("Threads:")).is_some_and(|(usual, now)| now > usual) {
        assert!(began.elapsed() < Duration::from_secs(60), "a job that was stopped does not end");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Checks that memory in use does not grow: the lower quartile of the last third of the rounds is at most 5 %
/// above that of the second third. (Lower, because everything that a round leaves behind is there after every
/// later round, but work in progress at the end of a round is not.)
#[test]
#[ignore = "takes as long as MONKEY_MINUTES says"]
fn a_monkey_for_long() {
    const MB: f64 = (1 << 20) as f64;
    let number = |name: &str| std::env::var(name).ok().and_then(|v| v.parse::<u64>().ok());
    let (minutes, seed) = (number("MONKEY_MINUTES").unwrap_or(30), number("MONKEY_SEED").unwrap_or(1));
    let (mut monkey, began) = (Monkey::new(seed), Instant::now());
    monkey.tidy_up();
    let usual = status("Threads:");
    let mut in_use = Vec::new();
    while began.elapsed() < Duration::from_secs(60 * minutes) {
        monkey.round();
        wait_for_threads(usual);
        in_use.push(crate::ALLOCATOR.allocated() as f64 / MB);
        let resident = status("VmRSS:").unwrap_or(0.0) / 1024.0;
        let [seconds, used] = [began.elapsed().as_secs_f64(), in_use[in_use.len() - 1]];
        eprintln!("{seconds:5.0} s, {} rounds, {used:.1} MB in use, {resident:.0} MB resident", in_use.len());
    }
    let third = in_use.len() / 3;
    let quartile = |part: &[f64]| {
        let mut sorted = part.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 4]
    };
    let (before, after) = (quartile(&in_use[third..2 * third]), quartile(&in_use[2 * third..]));
    eprintln!("{} acts; {before:.1}, then {after:.1} MB in use", in_use.len() * ACTS_PER_ROUND);
    assert!(after < 1.05 * before, "memory grows from {before} to {after} MB");
}
