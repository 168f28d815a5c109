//! Motion that comes again and again, as that of tissue that breathes or beats.
//!
//! Where most tissue moves together, a path takes part of that motion for the scope's, and nothing in the
//! pictures tells them apart. But what a path leaves unexplained says how often the tissue comes back. A
//! scope is taken not to sway at just this rate: what of the path does is given to the tissue, unless it is
//! far more than the tissue could have caused.

use super::{
    adjust::{Landmark, Observation, RobustResidual},
    build::Builder,
};
use crate::{linear::Symmetric, num::median};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Shortest period, in steps between frames.
const SHORTEST_STEPS: f64 = 8.0;
/// Number of periods that a recording shows at least, that it shows of those that are tried, and that a track
/// shows of which they are told.
const FEWEST_PERIODS: f64 = 1.8;
const FEWEST_TRIED: f64 = 1.3;
const TRACK_PERIODS: f64 = 1.2;
/// Fewest observations of such a track: two for each of the functions that are fitted to it.
const FEWEST_OBSERVATIONS: usize = 8;
/// Ratio of one period that is tried to the one before.
const NEXT: f64 = 1.03;
/// Unexplained motion of a point, px, root mean square, from which it tells something.
const LEAST_PX: f64 = 0.35;
/// Share of a point's unexplained motion that the period explains, in the median, from which it is believed;
/// and the share of that which periods explain at most that are so many times longer or shorter.
const LEAST_GAIN: f64 = 0.45;
const LOWER: f64 = 0.6;
const BESIDE: f64 = 1.5;
/// Largest number of tracks that are looked at.
const MOST_TRACKS: usize = 4000;
/// Share of all tracks that are long enough, which move so; and the fewest that are long enough.
const LEAST_SHARE: f64 = 0.2;
const FEWEST_TRACKS: usize = 50;
/// Largest motion that is taken out of a path whole, as a multiple of what sways unexplained in the median,
/// root mean square: of more, the fourth power of the ratio is taken. A path that sways much farther than the
/// tissue does so by itself.
const MOST_TAKEN: f64 = 12.0;
/// Share of the sway from which it is taken out.
const LEAST_TAKEN: f64 = 0.05;
/// Motion that is left of the path, as a share of what is taken out, root mean square, below which the scope
/// stands still and all of it was the tissue's.
const LEAST_LEFT: f64 = 0.5;
/// Highest frequency that counts as slow, as a share of that of the period.
const SLOW: f64 = 0.75;
/// Number of periods in which strength and phase are the same.
const STEADY: f64 = 4.0;

/// A point, and where the path leaves its motion unexplained.
struct Unexplained {
    /// Times of its observations.
    times: Vec<f64>,
    /// Differences between where it was seen and where the path shows it, along x and y, px.
    differences: [Vec<f64>; 2],
    /// Length of a pixel at its depth.
    px: f64,
}

/// A path without what sways with the tissue.
pub(super) struct Steadied {
    /// Period of the tissue, in units of the times.
    pub period: f64,
    /// The path: `camera_from_world` of its frames.
    pub poses: Vec<DAffine3>,
    /// `true` if hardly anything is left of it.
    pub is_still: bool,
}

/// Takes out of a path what it has of motion that comes again and again; `None` if it has none. `times` are
/// those of the frames of the path.
pub(super) fn steady(builder: &Builder, focal_px: f64, times: &[f32]) -> Option<Steadied> {
    let times: Vec<f64> = times.iter().copied().map(f64::from).collect();
    let tracks = unexplained(builder, focal_px, &times);
    let period = period(&tracks, &times)?;
    let mut amplitudes: Vec<f64> =
        long(&tracks, period).filter_map(|track| track.amplitude(period)).collect();
    let of_tissue = median(&mut amplitudes)?;
    let without = |share: f64| without(&builder.poses, &times, period, share);
    let of_path =
        rms(builder.poses.iter().zip(&without(1.0)).map(|(a, b)| camera_position(a) - camera_position(b)));
    let share = (MOST_TAKEN * of_tissue / of_path).powi(4).min(1.0);
    if share < LEAST_TAKEN {
        return None;
    }
    let poses = without(share);
    let middle = poses.iter().map(camera_position).sum::<DVec3>() / poses.len() as f64;
    let left = rms(poses.iter().map(|pose| camera_position(pose) - middle));
    Some(Steadied { period, poses, is_still: left < LEAST_LEFT * share * of_path })
}

/// Position of a camera in the world.
fn camera_position(pose: &DAffine3) -> DVec3 {
    pose.inverse().translation
}

/// Root mean square length.
fn rms(displacements: impl ExactSizeIterator<Item = DVec3>) -> f64 {
    let n = displacements.len().max(1) as f64;
    (displacements.map(DVec3::length_squared).sum::<f64>() / n).sqrt()
}

/// Finds the period of what is left unexplained; `None` if there is none that most of it has.
fn period(tracks: &[Unexplained], times: &[f64]) -> Option<f64> {
    let span = Some(times.last()? - times.first()?).filter(|span| *span > 0.0)?;
    let shortest = SHORTEST_STEPS * span / (times.len() - 1).max(1) as f64;
    let gain_of = |period: f64| {
        let long: Vec<&Unexplained> = long(tracks, period).collect();
        let mut gains: Vec<f64> = long.par_iter().filter_map(|track| track.gain(period)).collect();
        let is_common = long.len() >= FEWEST_TRACKS && gains.len() as f64 >= LEAST_SHARE * long.len() as f64;
        median(&mut gains).filter(|_| is_common).unwrap_or(0.0)
    };
    let tried = (0..).map(|k| shortest * NEXT.powi(k)).take_while(|period| *period <= span / FEWEST_TRIED);
    let gains: Vec<(f64, f64)> = tried.map(|period| (period, gain_of(period))).collect();
    let highest = (0..gains.len()).max_by(|a, b| gains[*a].1.total_cmp(&gains[*b].1))?;
    let (period, gain) = gains[highest];
    // Slow motion, too, is explained to a part by many periods, and most by the longest.
    let shorter = gains[..highest].iter().rev().find(|(other, _)| *other * BESIDE <= period);
    let longer = gains[highest..].iter().find(|(other, _)| *other >= BESIDE * period).or(gains.last());
    let is_peak = [shorter, longer].iter().all(|g| g.is_some_and(|(_, other)| *other <= LOWER * gain));
    (is_peak && gain >= LEAST_GAIN && period <= span / FEWEST_PERIODS).then_some(period)
}

/// Tracks that show enough of a period.
fn long(tracks: &[Unexplained], period: f64) -> impl Iterator<Item = &Unexplained> {
    let lasts = |times: &[f64]| times[times.len() - 1] - times[0];
    tracks.iter().filter(move |track| {
        track.times.len() >= FEWEST_OBSERVATIONS && lasts(&track.times) >= TRACK_PERIODS * period
    })
}

fn unexplained(builder: &Builder, focal_px: f64, times: &[f64]) -> Vec<Unexplained> {
    let residual = RobustResidual { focal_px, cauchy_px: 1.0 };
    let of = |mark: &Landmark| {
        let position = mark.position?;
        let in_camera =
            |observation: &Observation| builder.poses[observation.frame].transform_point3(position);
        let difference = |observation: &Observation| residual.in_picture(observation, in_camera(observation));
        Some(Unexplained {
            times: mark.observations.iter().map(|observation| times[observation.frame]).collect(),
            differences: [
                mark.observations.iter().map(|observation| difference(observation).x).collect(),
                mark.observations.iter().map(|observation| difference(observation).y).collect(),
            ],
            px: in_camera(mark.observations.first()?).z / focal_px,
        })
    };
    let every = builder.landmarks.len().div_ceil(MOST_TRACKS).max(1);
    builder.landmarks.iter().step_by(every).filter_map(of).collect()
}

impl Unexplained {
    /// A steady motion, and with it what sways with a period.
    fn functions(&self, period: f64) -> [Vec<Vec<f64>>; 2] {
        let steady = vec![vec![1.0; self.times.len()], self.times.clone()];
        let swaying = steady.iter().cloned().chain(sways(&self.times, period)).collect();
        [steady, swaying]
    }

    /// Returns the share of the unexplained motion, but for a steady one, that a period explains; `None` if
    /// the point hardly moves.
    fn gain(&self, period: f64) -> Option<f64> {
        let [steady, swaying] = self.functions(period);
        let left =
            |functions: &[Vec<f64>]| self.differences.iter().map(|d| rest(functions, d)).sum::<Option<f64>>();
        let (all, left) = (left(&steady)?, left(&swaying)?);
        (all >= LEAST_PX * LEAST_PX * self.times.len() as f64).then(|| 1.0 - left / all)
    }

    /// Returns how far the point sways, root mean square, in units of the typical depth.
    fn amplitude(&self, period: f64) -> Option<f64> {
        let [_, swaying] = self.functions(period);
        let weights: Option<Vec<Vec<f64>>> = self.differences.iter().map(|d| fitted(&swaying, d)).collect();
        let squares = weights?.iter().flat_map(|w| &w[2..]).map(|w| 0.5 * w * w).sum::<f64>();
        Some(squares.sqrt() * self.px)
    }
}

/// Cosine and sine of a period.
fn sways(times: &[f64], period: f64) -> [Vec<f64>; 2] {
    let phase = |t: &f64| TAU * t / period;
    [times.iter().map(|t| phase(t).cos()).collect(), times.iter().map(|t| phase(t).sin()).collect()]
}

/// Fits the sum of some functions to values (least squares) and returns their weights.
fn fitted(functions: &[Vec<f64>], values: &[f64]) -> Option<Vec<f64>> {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut matrix = Symmetric::from_fn(functions.len(), |i, j| product(&functions[i], &functions[j]));
    matrix.damp(1e-9);
    let mut weights: Vec<f64> = functions.iter().map(|f| product(f, values)).collect();
    matrix.solve(&mut weights).then_some(weights)
}

/// Returns the sum of squares that such a fit leaves.
fn rest(functions: &[Vec<f64>], values: &[f64]) -> Option<f64> {
    let weights = fitted(functions, values)?;
    let fit = |k: usize| functions.iter().zip(&weights).map(|(f, w)| w * f[k]).sum::<f64>();
    Some(values.iter().enumerate().map(|(k, v)| (v - fit(k)).powi(2)).sum())
}

/// Returns a path without a share of what sways with a period. Slower motion stays.
fn without(poses: &[DAffine3], times: &[f64], period: f64, share: f64) -> Vec<DAffine3> {
    let Some(first) = poses.first() else { return Vec::new() };
    // Six curves: the camera's position, and its turn since the first frame.
    let turn =
        |pose: &DAffine3| DQuat::from_mat3(&(pose.matrix3 * first.matrix3.transpose())).to_scaled_axis();
    let mut curves = vec![vec![0.0; poses.len()]; 6];
    for (k, pose) in poses.iter().enumerate() {
        camera_position(pose)
            .to_array()
            .into_iter()
            .chain(turn(pose).to_array())
            .enumerate()
            .for_each(|(c, v)| curves[c][k] = v);
    }
    for curve in &mut curves {
        let sway = sway(curve, times, period);
        curve.iter_mut().zip(sway).for_each(|(v, sway)| *v -= share * sway);
    }
    let vector = |from: usize, k: usize| DVec3::from_array(std::array::from_fn(|c| curves[from + c][k]));
    let pose = |k: usize| {
        let matrix3 = DMat3::from_quat(DQuat::from_scaled_axis(vector(3, k))) * first.matrix3;
        DAffine3 { matrix3, translation: -(matrix3 * vector(0, k)) }
    };
    (0..poses.len()).map(pose).collect()
}

/// Returns what of a curve sways with a period, as far as that keeps its strength over a few periods.
fn sway(curve: &[f64], times: &[f64], period: f64) -> Vec<f64> {
    let (begin, end) = (times[0], times[times.len() - 1]);
    let (mut sum, mut weight) = (vec![0.0; curve.len()], vec![0.0; curve.len()]);
    // Stretches overlap by half; each counts most in its middle.
    let length = (STEADY * period).min(end - begin);
    let count = ((end - begin - length) / (0.5 * length)).ceil().max(0.0) as usize + 1;
    for stretch in 0..count {
        let from = begin + (end - begin - length) * stretch as f64 / (count - 1).max(1) as f64;
        let inside: Vec<usize> =
            (0..times.len()).filter(|k| (from - 1e-9..=from + length + 1e-9).contains(&times[*k])).collect();
        let at: Vec<f64> = inside.iter().map(|k| (times[*k] - from) / length).collect();
        let values: Vec<f64> = inside.iter().map(|k| curve[*k]).collect();
        let slow = (0..).take_while(|n| f64::from(*n) / 2.0 < SLOW * length / period);
        let mut functions: Vec<Vec<f64>> =
            slow.map(|n: i32| at.iter().map(|t| (PI * f64::from(n) * t).cos()).collect()).collect();
        functions.push(at.clone());
        let num_slow = functions.len();
        functions.extend(sways(&at, period / length));
        let Some(weights) = fitted(&functions, &values) else { continue };
        for (j, k) in inside.iter().enumerate() {
            let sway: f64 = (num_slow..functions.len()).map(|f| weights[f] * functions[f][j]).sum();
            let counts = 1.0 - (2.0 * at[j] - 1.0).abs() + 1e-3;
            sum[*k] += counts * sway;
            weight[*k] += counts;
        }
    }
    sum.iter().zip(&weight).map(|(sum, weight)| if *weight > 0.0 { sum / weight } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_long_tracks_tell_no_period() {
        let times: Vec<f64> = (0..120).map(f64::from).collect();
        let track = |k: usize| {
            let along = times.iter().map(|t| (TAU * t / 30.0 + k as f64).sin()).collect();
            Unexplained { times: times.clone(), differences: [along, vec![0.0; times.len()]], px: 0.01 }
        };
        let found = |n: usize| period(&(0..n).map(track).collect::<Vec<_>>(), &times);
        assert!(found(FEWEST_TRACKS).is_some_and(|period| (period - 30.0).abs() < 1.0));
        assert_eq!(found(FEWEST_TRACKS - 1), None);
    }

    #[test]
    fn slow_motion_stays_and_what_sways_goes() {
        let times: Vec<f64> = (0..150).map(f64::from).collect();
        let slow = |t: f64| 3.0 * (TAU * t / 140.0).sin() + 0.02 * t;
        let curve = |t: f64| slow(t) + (1.0 + 0.002 * t) * (TAU * t / 24.0 + 0.4).cos();
        let poses = times.iter().map(|t| {
            let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.0, 0.02 * slow(*t), 0.1)));
            DAffine3 { matrix3: turn, translation: -(turn * DVec3::new(curve(*t), slow(*t), 1.0)) }
        });
        let poses: Vec<DAffine3> = poses.collect();
        let steadied = without(&poses, &times, 24.0, 1.0);
        for (t, pose) in times.iter().zip(&steadied) {
            let position = camera_position(pose);
            assert!((position.x - slow(*t)).abs() < 0.15, "{t}: {} instead of {}", position.x, slow(*t));
            assert!(
                (position.y - slow(*t)).abs() < 0.1 && (position.z - 1.0).abs() < 1e-7,
                "{t}: {position}"
            );
        }
    }
}
