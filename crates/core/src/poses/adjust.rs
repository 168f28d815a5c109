//! Bundle adjustment: poses and points that explain where points are seen (Triggs et al. 2000, "Bundle
//! adjustment, a modern synthesis"). Levenberg–Marquardt steps on the poses alone, from which the points are
//! eliminated (Schur complement). Differences are weighed by Cauchy's function, so that tissue that moves by
//! itself tells little of the camera.

use crate::linear::{Symmetric, inverse3};
use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};

/// A point as one frame sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sight {
    /// Number of the frame.
    pub frame: usize,
    /// Position on the plane at depth 1 of the frame's camera: (x/z, y/z).
    pub at: DVec2,
    /// Depth there if it was measured, in units of the typical depth.
    pub depth: Option<f64>,
}

/// A point and where it was seen.
#[derive(Clone, Debug, Default)]
pub(super) struct Landmark {
    /// Position in the world, in units of the typical depth; `None` if it is not known yet.
    pub place: Option<DVec3>,
    /// Sights in the order of the frames.
    pub sights: Vec<Sight>,
}

impl Landmark {
    /// Returns the sights in frames before `end`.
    pub(super) fn before(&self, end: usize) -> &[Sight] {
        &self.sights[..self.sights.partition_point(|s| s.frame < end)]
    }
}

/// Measure of differences between sights and points.
#[derive(Clone, Copy, Debug)]
pub(super) struct Comparison {
    /// Focal length, px: differences are in these pixels.
    pub focal_px: f64,
    /// Difference from which on a sight counts less and less, px.
    pub cauchy_px: f64,
}

/// Weight of the wish that a point is at the typical depth where it was seen first, px per relative
/// difference: enough to hold what has no parallax, less than a pixel of parallax.
const DEPTH_PRIOR_PX: f64 = 0.3;
/// Weight of a measured depth, px per relative difference: an error of 5 % is as bad as a pixel.
const DEPTH_PX: f64 = 20.0;
/// Nearest depth of a point, in units of the typical depth.
const NEAREST: f64 = 0.02;
/// Difference that stands for a point behind the camera, px.
const BEHIND_PX: f64 = 1e3;

impl Comparison {
    /// Returns the cost of a squared difference, px².
    fn cost(self, squared_px: f64) -> f64 {
        let c = self.cauchy_px * self.cauchy_px;
        c * (1.0 + squared_px / c).ln()
    }

    /// Returns the weight of a squared difference, px².
    fn weight(self, squared_px: f64) -> f64 {
        1.0 / (1.0 + squared_px / (self.cauchy_px * self.cauchy_px))
    }

    /// Returns the difference between a sight and a point at `in_camera` in the picture, px.
    pub(super) fn in_picture(self, sight: &Sight, in_camera: DVec3) -> DVec2 {
        if in_camera.z < NEAREST {
            return DVec2::splat(BEHIND_PX);
        }
        (in_camera.truncate() / in_camera.z - sight.at) * self.focal_px
    }

    /// Returns that difference, and the one in depth where it was measured, in the same unit.
    fn difference(self, sight: &Sight, in_camera: DVec3) -> DVec3 {
        let depth = sight.depth.map_or(0.0, |depth| DEPTH_PX * (in_camera.z / depth - 1.0));
        self.in_picture(sight, in_camera).extend(depth)
    }

    /// Returns the cost of one landmark at `place`, px².
    fn landmark_cost(self, poses: &[DAffine3], sights: &[Sight], place: DVec3) -> f64 {
        let seen = sights
            .iter()
            .map(|s| self.cost(self.difference(s, poses[s.frame].transform_point3(place)).length_squared()));
        let first = unmeasured(sights)
            .map_or(0.0, |s| DEPTH_PRIOR_PX * (poses[s.frame].transform_point3(place).z - 1.0));
        seen.sum::<f64>() + first * first
    }
}

/// Returns the first of a point's sights if its depth was not measured.
fn unmeasured(sights: &[Sight]) -> Option<&Sight> {
    sights.first().filter(|sight| sight.depth.is_none())
}

/// Derivatives of a sight's difference: by the pose (turn, then shift, both in the camera's axes), and by the
/// point. Rows are u, v and depth, px.
struct Slopes {
    pose: [[f64; 6]; 3],
    point: [[f64; 3]; 3],
}

fn slopes(focal_px: f64, pose: &DAffine3, sight: &Sight, p: DVec3) -> Slopes {
    let scale = focal_px / p.z;
    let deeper = sight.depth.map_or(0.0, |depth| DEPTH_PX / depth);
    let rows = [
        DVec3::new(scale, 0.0, -scale * p.x / p.z),
        DVec3::new(0.0, scale, -scale * p.y / p.z),
        DVec3::new(0.0, 0.0, deeper),
    ];
    // A turn ω moves p by ω × p: row · (ω × p) = ω · (p × row).
    let by_pose = rows.map(|row| {
        let turn = p.cross(row);
        [turn.x, turn.y, turn.z, row.x, row.y, row.z]
    });
    let turned = pose.matrix3.transpose();
    Slopes { pose: by_pose, point: rows.map(|row| (turned * row).to_array()) }
}

/// Returns the pose after a small turn and shift in the camera's axes.
pub(super) fn nudged(pose: &DAffine3, by: &[f64]) -> DAffine3 {
    let turn = DQuat::from_scaled_axis(DVec3::new(by[0], by[1], by[2]));
    let turned = DMat3::from_quat((turn * DQuat::from_mat3(&pose.matrix3)).normalize());
    DAffine3 { matrix3: turned, translation: turn * pose.translation + DVec3::new(by[3], by[4], by[5]) }
}

/// Normal equations of one landmark.
struct Block {
    /// Second derivative by the point, and gradient.
    point: DMat3,
    gradient: DVec3,
    /// For every sight in a free frame: its column, and the mixed derivative [pose][point].
    mixed: Vec<(usize, [[f64; 3]; 6])>,
}

/// Poses and points under adjustment.
pub(super) struct Adjustment<'a> {
    /// `camera_from_world` of all frames, in units of the typical depth.
    pub poses: &'a mut [DAffine3],
    /// The landmarks; those without a place are left out.
    pub landmarks: Vec<&'a mut Landmark>,
    /// Frames whose poses may change; later ones are not looked at.
    pub free: std::ops::Range<usize>,
    /// Measure of differences.
    pub compare: Comparison,
}

impl Adjustment<'_> {
    /// Takes at most `steps` steps; ends earlier when they bring less than 0.01 %. Returns the final cost, px².
    pub(super) fn solve(&mut self, steps: usize) -> f64 {
        self.landmarks.retain(|mark| mark.place.is_some());
        let mut damping = 1e-3;
        let mut cost = self.cost();
        for _ in 0..steps {
            let before: (Vec<DAffine3>, Vec<Option<DVec3>>) =
                (self.poses[self.free.clone()].to_vec(), self.landmarks.iter().map(|m| m.place).collect());
            let done = self.step(damping);
            let after = self.cost();
            if done && after < cost {
                damping = (damping * 0.3).max(1e-9);
                if after > 0.9999 * cost {
                    return after;
                }
                cost = after;
            } else {
                self.poses[self.free.clone()].copy_from_slice(&before.0);
                self.landmarks.iter_mut().zip(before.1).for_each(|(mark, place)| mark.place = place);
                damping *= 8.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        cost
    }

    fn cost(&self) -> f64 {
        let of = |mark: &&mut Landmark| {
            mark.place.map_or(0.0, |place| {
                self.compare.landmark_cost(self.poses, mark.before(self.free.end), place)
            })
        };
        self.landmarks.iter().map(of).sum()
    }

    /// Takes one step; returns `false` if the equations have no solution.
    fn step(&mut self, damping: f64) -> bool {
        let n = 6 * self.free.len();
        let mut matrix = Symmetric::zero(n);
        let mut gradient = vec![0.0; n];
        let blocks: Vec<Block> =
            self.landmarks.iter().map(|m| self.block(m, &mut matrix, &mut gradient)).collect();
        matrix.damp(damping);
        let mut inverses = Vec::with_capacity(blocks.len());
        for block in &blocks {
            let Some(inverse) = inverse3(&damped(&block.point, damping)) else { return false };
            eliminate(block, &inverse, &mut matrix, &mut gradient);
            inverses.push(inverse);
        }
        if n > 0 && !matrix.solve(&mut gradient) {
            return false;
        }
        let moved = gradient;
        for (k, pose) in self.poses[self.free.clone()].iter_mut().enumerate() {
            let by: Vec<f64> = moved[6 * k..6 * k + 6].iter().map(|v| -v).collect();
            *pose = nudged(pose, &by);
        }
        for ((mark, block), inverse) in self.landmarks.iter_mut().zip(&blocks).zip(&inverses) {
            let mut right = block.gradient;
            for (column, mixed) in &block.mixed {
                for (a, row) in mixed.iter().enumerate() {
                    right -= DVec3::from(*row) * moved[column + a];
                }
            }
            mark.place = mark.place.map(|place| place - *inverse * right);
        }
        true
    }

    /// Adds what a landmark tells of the poses alone, and returns the rest.
    fn block(&self, mark: &Landmark, matrix: &mut Symmetric, gradient: &mut [f64]) -> Block {
        let place = mark.place.unwrap_or_default();
        let mut block = Block { point: DMat3::ZERO, gradient: DVec3::ZERO, mixed: Vec::new() };
        let sights = mark.before(self.free.end);
        for sight in sights {
            let pose = &self.poses[sight.frame];
            let p = pose.transform_point3(place);
            if p.z < NEAREST {
                continue;
            }
            let difference = self.compare.difference(sight, p);
            let weight = self.compare.weight(difference.length_squared());
            let slopes = slopes(self.compare.focal_px, pose, sight, p);
            for (row, d) in slopes.point.iter().zip(difference.to_array()) {
                let row = DVec3::from(*row);
                block.gradient += weight * d * row;
                block.point += weight * DMat3::from_cols(row * row.x, row * row.y, row * row.z);
            }
            if self.free.contains(&sight.frame) {
                let column = 6 * (sight.frame - self.free.start);
                matrix.add_outer(column, &slopes.pose, weight);
                for (row, d) in slopes.pose.iter().zip(difference.to_array()) {
                    (0..6).for_each(|a| gradient[column + a] += weight * d * row[a]);
                }
                let mixed = std::array::from_fn(|a| {
                    std::array::from_fn(|b| {
                        weight * (0..3).map(|k| slopes.pose[k][a] * slopes.point[k][b]).sum::<f64>()
                    })
                });
                block.mixed.push((column, mixed));
            }
        }
        if let Some(first) = unmeasured(sights) {
            let pose = &self.poses[first.frame];
            let row = pose.matrix3.transpose().z_axis * DEPTH_PRIOR_PX;
            block.gradient += row * DEPTH_PRIOR_PX * (pose.transform_point3(place).z - 1.0);
            block.point += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
        }
        block
    }
}

/// Enlarges the diagonal.
fn damped(matrix: &DMat3, damping: f64) -> DMat3 {
    let mut damped = *matrix;
    for k in 0..3 {
        damped.col_mut(k)[k] += damping * matrix.col(k)[k] + 1e-12;
    }
    damped
}

/// Takes a landmark out of the equations of the poses.
fn eliminate(block: &Block, inverse: &DMat3, matrix: &mut Symmetric, gradient: &mut [f64]) {
    for (column, mixed) in &block.mixed {
        let through: [DVec3; 6] = mixed.map(|row| *inverse * DVec3::from(row));
        (0..6).for_each(|a| gradient[column + a] -= through[a].dot(block.gradient));
        for (other, other_mixed) in block.mixed.iter().filter(|(other, _)| other <= column) {
            matrix.subtract(*column, *other, |a, b| through[a].dot(DVec3::from(other_mixed[b])));
        }
    }
}

/// Finds the pose of a frame from landmarks with places alone.
pub(super) fn pose_of(
    frame: usize,
    start: DAffine3,
    landmarks: &[Landmark],
    compare: Comparison,
    steps: usize,
) -> DAffine3 {
    let seen = landmarks.iter().filter_map(|mark| {
        let sight = mark.sights.iter().find(|s| s.frame == frame)?;
        Some((mark.place?, *sight))
    });
    let seen: Vec<(DVec3, Sight)> = seen.collect();
    let cost = |pose: &DAffine3| -> f64 {
        seen.iter()
            .map(|(place, s)| {
                compare.cost(compare.difference(s, pose.transform_point3(*place)).length_squared())
            })
            .sum()
    };
    let (mut pose, mut damping) = (start, 1e-3);
    let mut best = cost(&pose);
    for _ in 0..steps {
        let mut matrix = Symmetric::zero(6);
        let mut gradient = vec![0.0; 6];
        for (place, sight) in &seen {
            let p = pose.transform_point3(*place);
            if p.z < NEAREST {
                continue;
            }
            let difference = compare.difference(sight, p);
            let weight = compare.weight(difference.length_squared());
            let by_pose = slopes(compare.focal_px, &pose, sight, p).pose;
            matrix.add_outer(0, &by_pose, weight);
            for (row, d) in by_pose.iter().zip(difference.to_array()) {
                (0..6).for_each(|a| gradient[a] -= weight * d * row[a]);
            }
        }
        matrix.damp(damping);
        if !matrix.solve(&mut gradient) {
            break;
        }
        let next = nudged(&pose, &gradient);
        let after = cost(&next);
        if after < best {
            (pose, damping) = (next, (damping * 0.3).max(1e-9));
            if after > 0.9999 * best {
                break;
            }
            best = after;
        } else {
            damping *= 8.0;
        }
    }
    pose
}
