//! Phases of an operation: named parts of the recording, none of which overlap, and their files.

use crate::viewer::state::document::{Document, Joint};
use serde_json::{Map, Value};
use std::fmt::Write;

/// A named part of the recording.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Phase {
    pub(crate) name: String,
    /// First frame, from 0.
    pub(crate) first: usize,
    /// Last frame, which belongs to it.
    pub(crate) last: usize,
    /// Fields that a newer program wrote.
    #[serde(flatten)]
    pub(crate) unknown: Map<String, Value>,
}

/// Names of the phases of a cholecystectomy in Cholec80, to choose from.
pub(crate) const CHOLEC80: [&str; 7] = [
    "Preparation",
    "CalotTriangleDissection",
    "ClippingCutting",
    "GallbladderDissection",
    "GallbladderPackaging",
    "CleaningCoagulation",
    "GallbladderRetraction",
];

/// First line of Cholec80's files of phases.
const CHOLEC80_HEAD: &str = "Frame\tPhase";
/// Names of the columns of CSV.
const COLUMNS: [&str; 5] = ["phase", "first_frame_from_1", "last_frame_from_1", "start_s", "end_s"];

impl Phase {
    pub(crate) fn new(name: &str, first: usize, last: usize) -> Self {
        Self { name: name.trim().to_owned(), first, last, unknown: Map::new() }
    }
}

impl Document {
    pub(crate) fn phases(&self) -> &[Phase] {
        &self.content().phases
    }

    /// Adds a phase; others make way. A phase without a name is none.
    pub(crate) fn add_phase(&mut self, phase: Phase) {
        if !phase.name.is_empty() && phase.first <= phase.last {
            let is_gone = |p: &&Phase| phase.first <= p.first && p.last <= phase.last;
            let gone = self.phases().iter().filter(is_gone).map(|p| format!("\"{}\"", p.name));
            let gone = gone.collect::<Vec<_>>().join(", ");
            let place = if gone.is_empty() { gone } else { format!(" in place of {gone}") };
            let name = format!("the phase \"{}\"{place}", phase.name);
            self.edit(name, None, |content| content.phases = with(&content.phases, phase));
        }
    }

    /// Changes name, first or last frame of a phase; others make way.
    pub(crate) fn change_phase(&mut self, index: usize, phase: Phase) {
        let Some(before) = self.phases().get(index).filter(|p| **p != phase) else { return };
        if phase.first > phase.last || phase.name.trim().is_empty() {
            return;
        }
        let name = format!("the phase \"{}\"", before.name);
        self.edit(name, Some(Joint::Phase(index)), |content| {
            content.phases.remove(index);
            content.phases = with(&content.phases, phase);
        });
    }

    pub(crate) fn remove_phase(&mut self, index: usize) {
        let Some(phase) = self.phases().get(index) else { return };
        let name = format!("deleting the phase \"{}\"", phase.name);
        self.edit(name, None, |content| drop(content.phases.remove(index)));
    }

    /// Returns `true` if one of the phases that there were `before` is gone. Other words or frames do not count.
    pub(crate) fn lacks_phase_of(&self, before: &[Phase]) -> bool {
        let is_there = |p: &Phase| {
            let is_same = |q: &Phase| q.name == p.name || (q.first, q.last) == (p.first, p.last);
            self.phases().iter().any(is_same)
        };
        self.phases().len() < before.len() || !before.iter().all(is_there)
    }

    /// Replaces all phases by those of a file.
    pub(crate) fn set_phases(&mut self, phases: Vec<Phase>) {
        self.edit("reading phases".into(), None, |content| content.phases = phases);
    }

    /// Returns the phase of a frame.
    pub(crate) fn phase_at(&self, frame: usize) -> Option<&Phase> {
        self.phases().iter().find(|p| (p.first..=p.last).contains(&frame))
    }
}

/// Lays a phase over others: what it covers of them is cut away.
fn with(phases: &[Phase], new: Phase) -> Vec<Phase> {
    let mut all: Vec<Phase> = phases.iter().flat_map(|p| parts_beside(p, &new)).collect();
    let at = all.partition_point(|p| p.first < new.first);
    all.insert(at, new);
    all
}

/// Returns the parts of a phase before and behind another one.
fn parts_beside(phase: &Phase, new: &Phase) -> Vec<Phase> {
    let before = new.first.checked_sub(1).map(|end| (phase.first, phase.last.min(end)));
    let after = Some((phase.first.max(new.last.saturating_add(1)), phase.last));
    let parts = [before, after].into_iter().flatten().filter(|(first, last)| first <= last);
    parts.map(|(first, last)| Phase { first, last, ..phase.clone() }).collect()
}

/// Limits phases to what is possible for `num_frames` frames, because files may hold any values.
pub(crate) fn mended(phases: Vec<Phase>, num_frames: usize) -> Vec<Phase> {
    let is_possible = |p: &Phase| p.first <= p.last && p.last < num_frames && !p.name.trim().is_empty();
    phases.into_iter().filter(is_possible).fold(Vec::new(), |all, phase| with(&all, phase))
}

/// Formats phases as a table; frames count from 1, as in the window.
pub(crate) fn csv(phases: &[Phase], seconds: impl Fn(usize) -> f64) -> String {
    let mut text = COLUMNS.join(",") + "\n";
    for phase in phases {
        let (name, start, end) =
            (phase.name.replace('"', "\"\""), seconds(phase.first), seconds(phase.last + 1));
        // Writing into a text never fails.
        let _ = writeln!(text, "\"{name}\",{},{},{start:.3},{end:.3}", phase.first + 1, phase.last + 1);
    }
    text
}

/// Formats phases as Cholec80 does: a line per frame, counted from 0. Frames without a phase have no line.
pub(crate) fn cholec80(phases: &[Phase]) -> String {
    let mut text = CHOLEC80_HEAD.to_owned() + "\n";
    for phase in phases {
        let name = phase.name.replace(['\t', '\n', '\r'], " ");
        (phase.first..=phase.last).for_each(|frame| text += &format!("{frame}\t{name}\n"));
    }
    text
}

/// Reads phases of either format; frames that the recording lacks are left out. The error says in a sentence
/// what is wrong.
pub(crate) fn read(text: &str, num_frames: usize) -> Result<Vec<Phase>, String> {
    let text = text.trim_start_matches('\u{feff}');
    let head = text.lines().next().unwrap_or_default().trim_end();
    let phases = if head == CHOLEC80_HEAD {
        read_cholec80(text)?
    } else if head.split(',').next() == Some(COLUMNS[0]) {
        read_csv(text)?
    } else {
        return Err(format!(
            "The first line is neither \"Frame, tab, Phase\" nor \"{}\": this is no file of phases.",
            COLUMNS.join(",")
        ));
    };
    let last = num_frames.saturating_sub(1);
    let inside = phases.into_iter().filter(|p| p.first <= last);
    let phases = mended(inside.map(|p| Phase { last: p.last.min(last), ..p }).collect(), num_frames);
    if phases.is_empty() { Err("It holds no phase of this recording's frames.".into()) } else { Ok(phases) }
}

fn read_cholec80(text: &str) -> Result<Vec<Phase>, String> {
    let mut phases: Vec<Phase> = Vec::new();
    for (k, line) in text.lines().enumerate().skip(1).filter(|(_, line)| !line.trim().is_empty()) {
        let row =
            line.split_once('\t').and_then(|(frame, name)| Some((frame.trim().parse().ok()?, name.trim())));
        let Some((frame, name)) = row.filter(|(_, name): &(usize, &str)| !name.is_empty()) else {
            return Err(format!("Line {} is no frame number, a tab and a phase.", k + 1));
        };
        match phases.last_mut().filter(|p| p.name == name && p.last + 1 == frame) {
            Some(phase) => phase.last = frame,
            None => phases.push(Phase::new(name, frame, frame)),
        }
    }
    Ok(phases)
}

fn read_csv(text: &str) -> Result<Vec<Phase>, String> {
    let mut phases = Vec::new();
    for (k, row) in csv::Reader::from_reader(text.as_bytes()).records().enumerate() {
        let number =
            |row: &csv::StringRecord, column| row.get(column)?.trim().parse::<usize>().ok()?.checked_sub(1);
        let phase =
            row.ok().and_then(|row| Some(Phase::new(row.get(0)?, number(&row, 1)?, number(&row, 2)?)));
        let Some(phase) = phase else {
            return Err(format!("Line {} is no phase with its first and last frame.", k + 2));
        };
        phases.push(phase);
    }
    Ok(phases)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use surgtpgs_core::overlay::OverlayLook;

    fn spans(phases: &[Phase]) -> Vec<(&str, usize, usize)> {
        phases.iter().map(|p| (p.name.as_str(), p.first, p.last)).collect()
    }

    fn three() -> Vec<Phase> {
        vec![
            Phase::new("Preparation", 0, 9),
            Phase::new("Clipping, \"cutting\"", 10, 19),
            Phase::new("End", 30, 39),
        ]
    }

    #[test]
    fn phases_do_not_overlap_and_every_change_can_be_undone() {
        let mut document = Document::new(OverlayLook::default(), 0.5);
        for phase in three() {
            document.add_phase(phase);
        }
        document.add_phase(Phase::new("Bleeding", 5, 12));
        let expected =
            [("Preparation", 0, 4), ("Bleeding", 5, 12), ("Clipping, \"cutting\"", 13, 19), ("End", 30, 39)];
        assert_eq!(spans(document.phases()), expected);
        assert_eq!(document.phase_at(12).unwrap().name, "Bleeding");
        assert!(document.phase_at(25).is_none());
        document.change_phase(1, Phase::new("Bleeding", 2, 3));
        assert_eq!(
            spans(document.phases()),
            [
                ("Preparation", 0, 1),
                ("Bleeding", 2, 3),
                ("Preparation", 4, 4),
                ("Clipping, \"cutting\"", 13, 19),
                ("End", 30, 39)
            ]
        );
        document.undo();
        assert_eq!(spans(document.phases()), expected);
        let before = document.phases().to_vec();
        for changed in [Phase::new("Blood", 5, 12), Phase::new("Bleeding", 6, 11)] {
            document.change_phase(1, changed);
            assert!(!document.lacks_phase_of(&before), "changed, not gone");
            document.undo();
        }
        document.add_phase(Phase::new("Cleaning", 5, 13));
        assert!(document.lacks_phase_of(&before) && document.phases().len() == before.len());
        assert_eq!(document.undo_name(), Some("the phase \"Cleaning\" in place of \"Bleeding\""));
        document.undo();
        document.remove_phase(0);
        assert!(document.lacks_phase_of(&before));
        document.add_phase(Phase::new("  ", 0, 4));
        document.add_phase(Phase::new("backwards", 4, 0));
        assert_eq!(document.phases().len(), 3);
        document.undo();
        assert_eq!(document.phases().len(), 4);
    }

    #[test]
    fn tables_are_read_as_they_are_written() {
        let table = csv(&three(), |frame| frame as f64 / 25.0);
        assert!(table.starts_with("phase,first_frame_from_1,last_frame_from_1,start_s,end_s\n"));
        assert!(table.contains("\"Preparation\",1,10,0.000,0.400\n"));
        assert_eq!(read(&table, 40).unwrap(), three());
        let lines = cholec80(&three());
        assert!(lines.starts_with("Frame\tPhase\n0\tPreparation\n1\tPreparation\n"));
        assert_eq!(lines.lines().count(), 31);
        assert_eq!(read(&lines, 40).unwrap(), three());
        assert_eq!(read(&lines.replace('\n', "\r\n"), 15).unwrap()[1].last, 14, "frames that are not there");
    }

    #[test]
    fn what_is_no_file_of_phases_says_why() {
        for (text, why) in [
            ("", "no file of phases"),
            ("Frame\tPhase\n1 Preparation\n", "Line 2"),
            ("Frame\tPhase\n0\tA\nx\tA\n", "Line 3"),
            ("phase,first_frame_from_1,last_frame_from_1\nA,0,3\n", "Line 2"),
            ("phase,first_frame_from_1,last_frame_from_1\nA,90,93\n", "no phase of this recording"),
        ] {
            let error = read(text, 40).unwrap_err();
            assert!(error.contains(why), "{error}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "(Frame\tPhase\n|phase,first\n)?[0-9a-z\t,\n\"]{0,60}", n in 0_usize..50) {
            if let Ok(phases) = read(&text, n) {
                prop_assert!(phases.windows(2).all(|pair| pair[0].last < pair[1].first));
                prop_assert!(phases.iter().all(|p| p.last < n));
            }
        }
    }
}
