//! Target embeddings of the concepts.
//!
//! Every target is a sum of orthonormal directions, so that five numbers determine all cosines. Concepts
//! share [`SHARED`] of one common direction m, near which the canonical phrases lie. Members of a group
//! share [`GROUP`]. A concept that is near another one takes [`NEAR`] of that one's own direction. Words
//! outside of the lexicon get a direction of their own with hardly any m, so that they lose to the
//! canonical phrases everywhere.

use crate::{
    lexicon::{Examples, Lexicon},
    model::{DIM, Rows, dot},
};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

const SHARED: f32 = 0.55;
const GROUP: f32 = 0.32;
const NEAR: f32 = 0.22;
const CANONICAL_SHARED: f32 = 0.96;
const UNKNOWN_SHARED: f32 = 0.2;
const UNKNOWN_COMMON: f32 = 0.6;

/// Unit vectors to train towards.
pub struct Targets {
    /// [concepts][DIM], in the order of [`Examples::concepts`].
    pub concepts: Vec<f32>,
    shared: Vec<f32>,
    unknown: Vec<f32>,
    /// Directions that tell unknown words apart.
    spare: Vec<Vec<f32>>,
    /// [rows][spare] signs.
    signs: Vec<f32>,
}

impl Targets {
    /// Lays out the targets; fails if the lexicon has more concepts than there are directions.
    pub fn new(
        lexicon: &Lexicon,
        examples: &Examples,
        rows: &Rows,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self, String> {
        let mut directions = orthonormal(rng).into_iter();
        let groups = lexicon.concepts.keys().map(String::as_str);
        let named: Vec<&str> = groups.chain(examples.concepts.iter().map(String::as_str)).collect();
        let mut own = BTreeMap::new();
        for name in named {
            let direction =
                directions.next().ok_or("the lexicon has more concepts than an embedding has directions")?;
            own.entry(name).or_insert(direction);
        }
        let too_many = "the lexicon leaves no directions for other words";
        let (shared, unknown) = directions.next().zip(directions.next()).ok_or(too_many)?;
        let spare: Vec<_> = directions.collect();
        if spare.len() < 8 {
            return Err(too_many.into());
        }
        let mut concepts = Vec::new();
        for name in &examples.concepts {
            let group = lexicon
                .concepts
                .iter()
                .find(|(_, members)| members.contains_key(name))
                .map_or("", |(g, _)| g);
            let near = lexicon.near.get(name).map(|near| (NEAR, &own[near.as_str()]));
            concepts.extend(match group {
                "canonical" => complete(&[(CANONICAL_SHARED, &shared)], &own[name.as_str()]),
                group if group == name => complete(&[(SHARED, &shared)], &own[group]),
                group => {
                    let mut parts = vec![(SHARED, &shared), (GROUP, &own[group])];
                    parts.extend(near);
                    complete(&parts, &own[name.as_str()])
                }
            });
        }
        let signs =
            (0..rows.count * spare.len()).map(|_| if rng.random_bool(0.5) { 1.0 } else { -1.0 }).collect();
        Ok(Self { concepts, shared, unknown, spare, signs })
    }

    /// Target of one concept.
    pub fn concept(&self, index: usize) -> &[f32] {
        &self.concepts[index * DIM..][..DIM]
    }

    /// Target of a text outside of the lexicon, from the table rows of its own trigrams.
    pub fn unknown(&self, rows: &[usize]) -> Vec<f32> {
        let mut own = vec![0.0; DIM];
        for (i, direction) in self.spare.iter().enumerate() {
            let amount: f32 = rows.iter().map(|row| self.signs[row * self.spare.len() + i]).sum();
            own.iter_mut().zip(direction).for_each(|(o, d)| *o += amount * d);
        }
        let norm = dot(&own, &own).sqrt();
        if norm > 0.0 {
            own.iter_mut().for_each(|o| *o /= norm);
        }
        complete(&[(UNKNOWN_SHARED, &self.shared), (UNKNOWN_COMMON, &self.unknown)], &own)
    }
}

/// Sum of the parts, filled up to length 1 along `own`.
fn complete(parts: &[(f32, &Vec<f32>)], own: &[f32]) -> Vec<f32> {
    let rest = (1.0 - parts.iter().map(|(amount, _)| amount * amount).sum::<f32>()).sqrt();
    let mut sum: Vec<f32> = own.iter().map(|v| rest * v).collect();
    for (amount, direction) in parts {
        sum.iter_mut().zip(direction.iter()).for_each(|(s, d)| *s += amount * d);
    }
    sum
}

/// A random orthonormal basis (Gram-Schmidt).
fn orthonormal(rng: &mut ChaCha8Rng) -> Vec<Vec<f32>> {
    let mut basis: Vec<Vec<f32>> = Vec::with_capacity(DIM);
    while basis.len() < DIM {
        let mut v: Vec<f32> = (0..DIM).map(|_| rng.random_range(-1.0..1.0)).collect();
        // A second pass removes the rounding errors of the first.
        for known in basis.iter().chain(&basis) {
            let along = dot(&v, known);
            v.iter_mut().zip(known).for_each(|(v, k)| *v -= along * k);
        }
        let norm = dot(&v, &v).sqrt();
        if norm > 1e-3 {
            v.iter_mut().for_each(|v| *v /= norm);
            basis.push(v);
        }
    }
    basis
}
