//! Seeded damage to good files.

use rand::{Rng, SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

/// Numbers that readers get wrong, as bytes.
const NUMBERS: [&[u8]; 10] = [
    &[0; 4],
    &[0xff; 4],
    &[0xff, 0xff, 0xff, 0x7f],
    &[0, 0, 0, 0x80],
    &[0; 8],
    &[0xff; 8],
    b"99999999999999999999",
    b"-1",
    b"1e999",
    b"NaN",
];

/// Makes bad files of good ones, the same each time.
#[derive(Debug)]
pub struct Mutator(ChaCha8Rng);

impl Mutator {
    /// Starts a series.
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Returns a copy of `seed` with one to four kinds of damage.
    pub fn mutate(&mut self, seed: &[u8]) -> Vec<u8> {
        let mut bytes = seed.to_vec();
        for _ in 0..self.0.random_range(1..=4) {
            self.damage(&mut bytes);
        }
        bytes
    }

    fn damage(&mut self, bytes: &mut Vec<u8>) {
        if bytes.is_empty() {
            bytes.push(self.0.random());
            return;
        }
        let at = self.place(bytes.len());
        let end = (at + self.0.random_range(1..=16)).min(bytes.len());
        match self.0.random_range(0..7) {
            0 => bytes[at] ^= 1 << self.0.random_range(0..8),
            1 => bytes[at] = self.0.random(),
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(at..end)),
            4 => {
                let part = bytes[at..end].to_vec();
                let to = self.place(bytes.len());
                bytes.splice(to..to, part);
            }
            5 => {
                let number = *NUMBERS.choose(&mut self.0).unwrap_or(&NUMBERS[0]);
                let end = (at + number.len()).min(bytes.len());
                bytes.splice(at..end, number.iter().copied());
            }
            _ => {
                // A digit: the headers of most formats are text.
                let digits: Vec<usize> =
                    (0..bytes.len().min(4096)).filter(|&i| bytes[i].is_ascii_digit()).collect();
                let digit = b'0' + self.0.random_range(0..10_u8);
                let at = digits.choose(&mut self.0).copied().unwrap_or(at);
                bytes[at] = digit;
            }
        }
    }

    /// Returns a position, half of the time near the start: that is where headers are.
    fn place(&mut self, len: usize) -> usize {
        let end = if self.0.random() { len } else { len.min(256) };
        self.0.random_range(0..end)
    }
}
