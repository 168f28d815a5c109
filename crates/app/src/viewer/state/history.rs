//! Undo and redo of named edits, for anything whose state can be exchanged.

/// Number of edits that are kept.
const MAX_EDITS: usize = 200;

/// Named states before and after the present one.
#[derive(Clone, Debug)]
pub(crate) struct History<State, Joint> {
    past: Vec<Edit<State, Joint>>,
    future: Vec<Edit<State, Joint>>,
}

#[derive(Clone, Debug)]
struct Edit<State, Joint> {
    name: String,
    /// State on the other side of the edit.
    state: State,
    joins: Option<Joint>,
}

impl<State, Joint> Default for History<State, Joint> {
    fn default() -> Self {
        Self { past: Vec::new(), future: Vec::new() }
    }
}

impl<State, Joint: PartialEq> History<State, Joint> {
    /// Remembers the state before a change. Successive changes with the same joint, such as dragging a
    /// slider, are one edit.
    pub(crate) fn record(&mut self, name: String, joins: Option<Joint>, before: impl FnOnce() -> State) {
        let is_joined = joins.is_some() && self.past.last().is_some_and(|e| e.joins == joins);
        if !is_joined {
            self.past.push(Edit { name, state: before(), joins });
            let excess = self.past.len().saturating_sub(MAX_EDITS);
            self.past.drain(..excess);
        }
        self.future.clear();
    }

    /// Takes the last edit back: `exchange` swaps the present state with the given one.
    pub(crate) fn undo(&mut self, exchange: impl FnOnce(&mut State)) {
        step(&mut self.past, &mut self.future, exchange);
    }

    /// Repeats the edit that was taken back last.
    pub(crate) fn redo(&mut self, exchange: impl FnOnce(&mut State)) {
        step(&mut self.future, &mut self.past, exchange);
    }

    /// Returns the name of the edit that undo would take back.
    pub(crate) fn undo_name(&self) -> Option<&str> {
        self.past.last().map(|e| e.name.as_str())
    }

    /// Returns the name of the edit that redo would repeat.
    pub(crate) fn redo_name(&self) -> Option<&str> {
        self.future.last().map(|e| e.name.as_str())
    }

    /// Ends a series of joined changes: the next one is an edit of its own.
    pub(crate) fn end_gesture(&mut self) {
        if let Some(edit) = self.past.last_mut() {
            edit.joins = None;
        }
    }
}

fn step<State, Joint>(
    from: &mut Vec<Edit<State, Joint>>,
    to: &mut Vec<Edit<State, Joint>>,
    exchange: impl FnOnce(&mut State),
) {
    if let Some(mut edit) = from.pop() {
        exchange(&mut edit.state);
        to.push(Edit { joins: None, ..edit });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_edits_are_forgotten_and_the_newest_kept() {
        let mut history: History<usize, ()> = History::default();
        let mut now = 0;
        for i in 0..MAX_EDITS + 50 {
            history.record(format!("edit {i}"), None, || now);
            now = i + 1;
        }
        let mut steps = 0;
        while history.undo_name().is_some() {
            history.undo(|state| std::mem::swap(state, &mut now));
            steps += 1;
        }
        assert_eq!((steps, now), (MAX_EDITS, 50));
        assert_eq!(history.redo_name(), Some("edit 50"));
    }

    #[test]
    fn a_new_edit_ends_what_could_be_redone() {
        let mut history: History<usize, ()> = History::default();
        let mut now = 0;
        history.record("one".into(), None, || now);
        now = 1;
        history.undo(|state| std::mem::swap(state, &mut now));
        assert_eq!((now, history.redo_name()), (0, Some("one")));
        history.record("two".into(), None, || now);
        assert_eq!(history.redo_name(), None);
    }
}
