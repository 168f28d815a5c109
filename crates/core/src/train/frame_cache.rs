//! The frames that training compares with, decoded or guessed once.

use super::{frames::TrainFrame, guess::Guess};
use crate::{Result, prepare::Prepared, sequence::Sequence};
use std::{collections::BTreeMap, sync::Arc};

/// Decoded frames within a memory budget; frames that do not fit are decoded again each time. Guesses take
/// longer than decoding, and are always kept.
#[derive(Debug)]
pub struct FrameCache {
    sequence: Sequence,
    guesses: Vec<Guess>,
    frames: BTreeMap<(usize, bool), Arc<TrainFrame>>,
    used_bytes: usize,
    budget_bytes: usize,
}

impl FrameCache {
    /// Makes an empty cache of at most `budget_bytes`. Of `guesses` as many are used as fit into half of it.
    pub fn new(sequence: &Sequence, mut guesses: Vec<Guess>, budget_bytes: usize) -> Self {
        // Colours and mask, at full and at half size.
        let guess_bytes = sequence.width() * sequence.height() * 5;
        guesses.truncate(budget_bytes / 2 / guess_bytes.max(1));
        let budget_bytes = budget_bytes - guesses.len() * guess_bytes;
        Self { sequence: sequence.clone(), guesses, frames: BTreeMap::new(), used_bytes: 0, budget_bytes }
    }

    /// Numbers of the frames that are guessed.
    pub fn guessed(&self) -> impl Iterator<Item = usize> {
        self.guesses.iter().map(|guess| guess.place.0)
    }

    /// Memory in use, bytes.
    #[cfg(test)]
    pub fn used_bytes(&self) -> usize {
        self.used_bytes
    }

    /// Returns `true` if frame `i` has been decoded.
    #[cfg(test)]
    pub fn holds(&self, i: usize) -> bool {
        [false, true].iter().any(|half| self.frames.contains_key(&(i, *half)))
    }

    /// Returns frame `i`, halved if asked for.
    pub fn get(&mut self, prepared: Option<&Prepared>, i: usize, half: bool) -> Result<Arc<TrainFrame>> {
        if let Some(frame) = self.frames.get(&(i, half)) {
            return Ok(frame.clone());
        }
        let guess = self.guesses.iter().find(|guess| guess.place.0 == i).copied();
        let frame = match guess {
            _ if half => self.get(prepared, i, false)?.halved(),
            Some(guess) => guess.load(&self.sequence)?,
            None => TrainFrame::load(&self.sequence, prepared, i)?,
        };
        let frame = Arc::new(frame);
        if guess.is_some() {
            self.frames.insert((i, half), frame.clone());
        } else if self.used_bytes + frame.bytes() <= self.budget_bytes {
            self.used_bytes += frame.bytes();
            self.frames.insert((i, half), frame.clone());
        }
        Ok(frame)
    }
}
