//! Marks by hand: what the user says frames show, and what they do not.

use crate::settings::prompt_colour;
use crate::viewer::{
    backend::Info,
    state::{content::Prompt, document::Document},
    text::{counted, thousands},
};
use serde::Deserialize;
use serde_json::Value;
use std::{
    collections::{BTreeSet, HashMap},
    sync::Arc,
};
use surgtpgs_core::{
    marks::{Canvas, Mark, join_names},
    sequence::{is_same_name, plain_words},
};

/// Marks in the order in which they were made; copies share them.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
#[serde(from = "Vec<Value>", into = "Vec<Written>")]
pub(crate) struct MarkList {
    marks: Arc<Vec<Mark>>,
    set_aside: Arc<SetAside>,
}

/// Marks of a session that are not used. They are saved with the others.
#[derive(Debug, Default)]
struct SetAside {
    /// Marks on frames or places that the recording does not have.
    misfits: Vec<Mark>,
    /// Values that cannot be read as marks, and why.
    unread: Vec<(Value, String)>,
}

/// A mark as a session holds it.
#[derive(serde::Serialize)]
#[serde(untagged)]
enum Written {
    Read(Mark),
    Unread(Value),
}

/// Largest number of letters of a name that is told.
const MOST_TOLD: usize = 40;

/// Compares all marks, so that it is the same session before and after some are set aside.
impl PartialEq for MarkList {
    fn eq(&self, other: &Self) -> bool {
        let is_shared =
            Arc::ptr_eq(&self.marks, &other.marks) && Arc::ptr_eq(&self.set_aside, &other.set_aside);
        let is_alike = || self.set_aside.unread == other.set_aside.unread && self.read().eq(other.read());
        is_shared || is_alike()
    }
}

/// Reads marks from a session. Those that cannot be read are set aside, because files may hold any values.
impl From<Vec<Value>> for MarkList {
    fn from(values: Vec<Value>) -> Self {
        let (mut marks, mut unread) = (Vec::new(), Vec::new());
        for value in values {
            match Mark::deserialize(&value) {
                Ok(mark) => marks.push(mark),
                Err(e) => unread.push((value, e.to_string())),
            }
        }
        let set_aside = Arc::new(SetAside { misfits: Vec::new(), unread });
        Self { set_aside, ..Self::of(marks) }
    }
}

impl From<MarkList> for Vec<Written> {
    fn from(list: MarkList) -> Self {
        let unread = list.set_aside.unread.iter().map(|(value, _)| Written::Unread(value.clone()));
        list.read().cloned().map(Written::Read).chain(unread).collect()
    }
}

impl MarkList {
    pub(crate) fn of(marks: Vec<Mark>) -> Self {
        Self { marks: Arc::new(marks), set_aside: Arc::default() }
    }

    /// Returns other marks, with the same ones set aside.
    fn replaced_by(&self, marks: Vec<Mark>) -> Self {
        Self { set_aside: Arc::clone(&self.set_aside), ..Self::of(marks) }
    }

    /// Returns all marks that could be read, also those that are not used.
    fn read(&self) -> impl Iterator<Item = &Mark> {
        self.marks.iter().chain(&self.set_aside.misfits)
    }

    /// Returns the same marks with those set aside that cannot be on `canvas`.
    pub(crate) fn fitting(&self, canvas: &Canvas) -> Self {
        let (marks, misfits): (Vec<Mark>, Vec<Mark>) =
            self.read().cloned().partition(|mark| mark.fits(canvas));
        if misfits == self.set_aside.misfits {
            return self.clone();
        }
        let unread = self.set_aside.unread.clone();
        Self { set_aside: Arc::new(SetAside { misfits, unread }), ..Self::of(marks) }
    }

    /// Says which marks of a session are not used, and why; `None` if all are.
    pub(crate) fn left_out(&self) -> Option<String> {
        let SetAside { misfits, unread } = &*self.set_aside;
        let first = |count: usize| if count > 1 { "the first: " } else { "" };
        let unread_part = unread.first().map(|(_, why)| {
            format!("{} cannot be read ({}{why})", thousands(unread.len()), first(unread.len()))
        });
        let misfit_part = misfits.first().map(|mark| {
            let count = counted(misfits.len(), "does not fit", "do not fit");
            let name: String = mark.name.chars().take(MOST_TOLD).collect();
            let on = mark.frame.saturating_add(1);
            format!("{count} the recording ({}\"{name}\" on frame {on})", first(misfits.len()))
        });
        let parts: Vec<String> = unread_part.into_iter().chain(misfit_part).collect();
        let all = parts.join(", ");
        (!parts.is_empty()).then(|| {
            format!("Marks of this session that are left out: {all}. The session keeps them as they are.")
        })
    }

    /// Returns `true` if there is nothing to save: no marks, and none that are not used.
    pub(crate) fn holds_nothing(&self) -> bool {
        self.set_aside.unread.is_empty() && self.read().next().is_none()
    }

    pub(crate) fn all(&self) -> &[Mark] {
        &self.marks
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.marks.is_empty()
    }

    /// Returns these marks and more.
    pub(crate) fn with(&self, more: impl IntoIterator<Item = Mark>) -> Self {
        self.replaced_by(self.marks.iter().cloned().chain(more).collect())
    }

    /// Returns the marks that are to stay; the same list if all are.
    pub(crate) fn kept(&self, stays: impl Fn(&Mark) -> bool) -> Self {
        if self.marks.iter().all(&stays) {
            return self.clone();
        }
        self.replaced_by(self.marks.iter().filter(|mark| stays(mark)).cloned().collect())
    }

    /// Returns these marks, those of one name with another one; the same list if there are none.
    pub(crate) fn renamed(&self, name: &str, new: &str) -> Self {
        if new.is_empty() || !self.marks.iter().any(|mark| is_same_name(&mark.name, name)) {
            return self.clone();
        }
        let renamed = |mark: &Mark| match is_same_name(&mark.name, name) {
            true => Mark { name: new.to_owned(), ..mark.clone() },
            false => mark.clone(),
        };
        self.replaced_by(self.marks.iter().map(renamed).collect())
    }

    /// Returns the names, sorted, each once.
    pub(crate) fn names(&self) -> BTreeSet<&str> {
        self.marks.iter().map(|mark| mark.name.as_str()).collect()
    }

    /// Returns the marked frames.
    pub(crate) fn frames(&self) -> BTreeSet<usize> {
        self.marks.iter().map(|mark| mark.frame).collect()
    }

    pub(crate) fn on(&self, frame: usize) -> impl Iterator<Item = &Mark> {
        self.marks.iter().filter(move |mark| mark.frame == frame)
    }
}

/// Returns the recording that marks are made on.
pub(crate) fn canvas(info: &Info) -> Canvas {
    Canvas {
        width: info.width,
        height: info.height,
        frame_names: info.frame_names.to_vec(),
        num_frames: info.num_frames,
    }
}

impl Prompt {
    /// Returns `true` if marks of this name belong to the prompt.
    pub(crate) fn is_marked_as(&self, name: &str) -> bool {
        self.like.is_none() && is_same_name(&self.text, name)
    }
}

impl Document {
    pub(crate) fn marks(&self) -> &MarkList {
        &self.content().marks
    }

    /// Returns the colour of a structure that is marked: that of its prompt, or the one that its prompt will
    /// get.
    pub(crate) fn colour_of(&self, name: &str) -> [u8; 3] {
        let own = self.prompts().iter().find(|p| p.is_marked_as(name)).map(|p| p.colour);
        let place = self.marks().names().iter().position(|known| *known == name);
        let nameless = || place.map(prompt_colour);
        own.or_else(nameless).unwrap_or_else(|| self.next_colour())
    }

    /// Adds a mark. A structure that has no prompt yet gets one, by the same edit.
    pub(crate) fn add_mark(&mut self, mark: Mark) {
        let verb = if mark.add { "marking" } else { "marking what is not" };
        let name = format!("{verb} \"{}\" on frame {}", mark.name, mark.frame + 1);
        self.add_marks(|_| name, vec![mark]);
    }

    /// Returns the name, in plain words, under which the same is marked or looked for already; the name itself
    /// if there is none.
    pub(crate) fn joined_name(&self, name: &str) -> String {
        self.known_name(name).unwrap_or_else(|| name.to_owned())
    }

    /// Returns the name, in plain words, under which the same is marked or looked for already, if any.
    fn known_name(&self, name: &str) -> Option<String> {
        let marked = self.marks().names().into_iter().find(|known| is_same_name(known, name));
        let asked = || self.prompts().iter().find(|p| p.is_marked_as(name)).map(|p| plain_words(&p.text));
        marked.map(str::to_owned).or_else(asked)
    }

    /// Adds marks without those that are there already, by one edit, which `name` names by their number. Marks
    /// of the same structure have one name. New names get prompts in alphabetical order; prompts that are there
    /// stay as they are. Returns the number of marks that were added.
    pub(crate) fn add_marks(&mut self, name: impl FnOnce(usize) -> String, mut marks: Vec<Mark>) -> usize {
        join_names(&mut marks, |name| self.known_name(name));
        let mut on: HashMap<usize, Vec<&Mark>> = HashMap::new();
        for mark in self.marks().all() {
            on.entry(mark.frame).or_default().push(mark);
        }
        marks.retain(|mark| !on.get(&mark.frame).is_some_and(|there| there.contains(&mark)));
        let count = marks.len();
        if count == 0 {
            return 0;
        }
        let list = self.marks().with(marks);
        let mut new: Vec<Prompt> = Vec::new();
        for words in list.names() {
            let is_there = |p: &Prompt| p.is_marked_as(words);
            if !self.prompts().iter().chain(&new).any(is_there) {
                let colour = self.free_colour(&new);
                new.push(Prompt { colour, ..self.new_prompt(words, None) });
            }
        }
        self.selected = new.last().map(|p| p.id).or(self.selected);
        self.edit(name(count), None, |content| {
            content.marks = list;
            content.prompts.extend(new);
        });
        count
    }

    /// Takes all marks of a frame away.
    pub(crate) fn clear_marks(&mut self, frame: usize) {
        let rest = self.marks().kept(|mark| mark.frame != frame);
        if rest != *self.marks() {
            let name = format!("taking the marks of frame {} away", frame + 1);
            self.edit(name, None, |content| content.marks = rest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use surgtpgs_core::{marks::Shape, overlay::OverlayLook};

    fn click(frame: usize, name: &str, add: bool) -> Mark {
        Mark::new(frame, name, add, Shape::Click { point_px: [3.5, 4.0], radius_px: 2.0 })
    }

    #[test]
    fn marks_keep_to_a_prompt_whose_words_change() {
        let mut document = Document::new(OverlayLook::default(), 0.5);
        document.add_mark(click(2, "grasper", true));
        document.rename(document.prompts()[0].id, "Left Grasper");
        assert_eq!(document.marks().names(), BTreeSet::from(["left grasper"]));
        assert!(document.prompts()[0].is_marked_as("left grasper"));
        document.undo();
        assert_eq!(document.marks().names(), BTreeSet::from(["grasper"]));
    }

    #[test]
    fn a_mark_brings_its_prompt_and_both_go_by_one_undo() {
        let mut document = Document::new(OverlayLook::default(), 0.5);
        document.add("Bile Duct");
        document.add_mark(click(2, "grasper", true));
        assert_eq!(document.undo_name(), Some("marking \"grasper\" on frame 3"));
        let texts = |d: &Document| d.prompts().iter().map(|p| p.text.clone()).collect::<Vec<_>>();
        assert_eq!(texts(&document), ["Bile Duct", "grasper"]);
        assert!(document.prompts()[1].is_instrument && document.selected == Some(document.prompts()[1].id));
        document.add_mark(click(4, "bile duct", false));
        assert_eq!(texts(&document), ["Bile Duct", "grasper"], "the prompt was there");
        assert_eq!(document.colour_of("bile duct"), document.prompts()[0].colour);
        document.add_mark(click(4, "bile duct", false));
        assert_eq!(document.marks().all().len(), 2, "the same mark again says nothing new");
        document.undo();
        document.undo();
        assert_eq!((texts(&document), document.marks().is_empty()), (vec!["Bile Duct".to_owned()], true));
        document.redo();
        assert_eq!(document.marks().frames(), BTreeSet::from([2]));
    }

    #[test]
    fn names_that_capitals_and_spaces_tell_apart_are_one() {
        let mut document = Document::new(OverlayLook::default(), 0.5);
        document.add("gallbladder");
        document.add_mark(click(2, "Gall Bladder", true));
        document.add_mark(click(3, "gall-bladder", false));
        assert_eq!(
            (document.prompts().len(), document.marks().names()),
            (1, BTreeSet::from(["gallbladder"]))
        );
        document.add("GALL_BLADDER");
        assert_eq!(document.prompts().len(), 1);
        let marks = vec![click(0, "Cystic Duct", true), click(1, "cysticduct", true)];
        assert_eq!(document.add_marks(|_| "opening marks".into(), marks), 2);
        assert_eq!(document.marks().names(), BTreeSet::from(["cystic duct", "gallbladder"]));
        document.rename(document.prompts()[0].id, "Fundus");
        assert_eq!(document.marks().names(), BTreeSet::from(["cystic duct", "fundus"]));
    }

    #[test]
    fn the_spelling_of_a_new_name_does_not_depend_on_the_order_of_its_marks() {
        let mut marks = vec![click(0, "cysticduct", true), click(1, "Cystic-Duct", true)];
        for _ in 0..2 {
            let mut document = Document::new(OverlayLook::default(), 0.5);
            assert_eq!(document.add_marks(|_| "opening marks".into(), marks.clone()), 2);
            assert_eq!(document.marks().names(), BTreeSet::from(["cystic duct"]));
            marks.reverse();
        }
    }

    #[test]
    fn new_names_come_in_alphabetical_order_and_those_that_are_there_stay() {
        let mut document = Document::new(OverlayLook::default(), 0.5);
        document.add_mark(click(0, "liver", true));
        let before = document.prompts()[0].clone();
        let marks = ["vein", "fat", "liver"].map(|name| click(1, name, true));
        document.add_marks(|_| "opening marks".into(), marks.to_vec());
        let texts: Vec<&str> = document.prompts().iter().map(|p| p.text.as_str()).collect();
        assert_eq!((texts, &document.prompts()[0]), (vec!["liver", "fat", "vein"], &before));
    }

    #[test]
    fn deleting_a_marked_prompt_takes_its_marks_away() {
        let mut document = Document::new(OverlayLook::default(), 0.5);
        document.add_marks(|_| "opening marks".into(), vec![click(0, "fat", true), click(1, "liver", true)]);
        let colours: BTreeSet<[u8; 3]> = document.prompts().iter().map(|p| p.colour).collect();
        assert_eq!((document.prompts().len(), colours.len()), (2, 2), "each has a colour of its own");
        document.remove(document.prompts()[0].id);
        assert_eq!(document.undo_name(), Some("deleting \"fat\" and its marks"));
        assert_eq!(document.marks().names(), BTreeSet::from(["liver"]));
        document.undo();
        document.clear_marks(1);
        assert_eq!(document.marks().frames(), BTreeSet::from([0]));
    }

    #[test]
    fn what_cannot_be_read_or_does_not_fit_is_told_and_saved_as_it_was() {
        let list = MarkList::of(vec![click(0, "fat", true), click(30, "liver", false)]);
        let mut told = serde_json::to_value(&list).unwrap();
        let read = |told: &Value| MarkList::deserialize(told).unwrap();
        assert_eq!((read(&told), read(&told).left_out()), (list, None));
        let odd = serde_json::json!({"frame": 3, "name": "fat", "kind": "spray", "drops": [1, 2]});
        let entries = told.as_array_mut().unwrap();
        entries.insert(0, odd.clone());
        entries.insert(1, Value::from(7));
        let canvas = Canvas { width: 32, height: 24, frame_names: Vec::new(), num_frames: 9 };
        let list = read(&told);
        let fitting = list.fitting(&canvas);
        assert_eq!(fitting.names(), BTreeSet::from(["fat"]));
        let left_out = fitting.left_out().unwrap();
        assert!(left_out.contains("2 cannot be read (the first: it has a part \"drops\""), "{left_out}");
        assert!(left_out.contains("1 does not fit the recording (\"liver\" on frame 31)"), "{left_out}");
        assert!(fitting == list && fitting != read(&Value::Array(Vec::new())));
        let edited = fitting.with([click(1, "vein", true)]).kept(|mark| mark.name != "fat");
        let saved = serde_json::to_value(edited.renamed("vein", "cystic vein")).unwrap();
        let entries = saved.as_array().unwrap();
        let names: Vec<&str> = entries[..2].iter().filter_map(|entry| entry["name"].as_str()).collect();
        assert_eq!(names, ["cystic vein", "liver"]);
        assert_eq!(entries[2..], [odd, Value::from(7)]);
        assert!(edited.kept(|_| false).is_empty() && !edited.kept(|_| false).holds_nothing());
        let more = Canvas { num_frames: 31, ..canvas };
        assert_eq!(read(&saved).fitting(&more).all().len(), 2, "it fits a longer recording");
    }
}
