//! Bundle adjustment: poses and points that explain where points are seen (Triggs et al. 2000, "Bundle
//! adjustment, a modern synthesis"). Levenberg–Marquardt steps on the poses alone, from which the points are
//! eliminated (Schur complement). Residuals are weighed by Cauchy's function, so that tissue that moves by
//! itself tells little of the camera.

use crate::linear::{Symmetric, inverse3};
use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};

/// Observation of a point in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Observation {
    /// Number of the frame.
    pub frame: usize,
    /// Position on the plane at depth 1 of the frame's camera: (x/z, y/z).
    pub at: DVec2,
    /// Depth there if it was measured, in units of the typical depth.
    pub depth: Option<f64>,
}

/// A point and its observations.
#[derive(Clone, Debug)]
pub(super) struct Landmark {
    /// Position in the world, in units of the typical depth; `None` if it is not known yet.
    pub position: Option<DVec3>,
    /// Observations in the order of the frames.
    pub observations: Vec<Observation>,
    /// Depth at which it is expected where it was seen first, in units of the typical depth.
    pub expected_depth: f64,
}

impl Landmark {
    /// Returns the observations in frames before `end`.
    pub(super) fn before(&self, end: usize) -> &[Observation] {
        &self.observations[..self.observations.partition_point(|s| s.frame < end)]
    }
}

/// Measure of residuals, the differences between observations and points. It is robust: large ones are
/// weighed by Cauchy's function.
#[derive(Clone, Copy, Debug)]
pub(super) struct RobustResidual {
    /// Focal length, px: residuals are in these pixels.
    pub focal_px: f64,
    /// Residual from which on an observation counts less and less, px.
    pub cauchy_px: f64,
}

/// Weight of the wish that a point is at its expected depth where it was seen first, px per relative
/// difference: enough to hold what has no parallax, less than a pixel of parallax.
const DEPTH_PRIOR_PX: f64 = 0.3;
/// Weight of a measured depth, px per relative difference: an error of 5 % is as bad as a pixel.
const DEPTH_PX: f64 = 20.0;
/// Nearest depth of a point, in units of the typical depth.
const NEAREST: f64 = 0.02;
/// Residual that stands for a point behind the camera, px.
const BEHIND_PX: f64 = 1e3;

impl RobustResidual {
    /// Returns the cost of a squared residual, px².
    fn cost(self, squared_px: f64) -> f64 {
        let c = self.cauchy_px * self.cauchy_px;
        c * (1.0 + squared_px / c).ln()
    }

    /// Returns the weight of a squared residual, px².
    fn weight(self, squared_px: f64) -> f64 {
        1.0 / (1.0 + squared_px / (self.cauchy_px * self.cauchy_px))
    }

    /// Returns the residual in the picture of an observation of a point at `in_camera`, px.
    pub(super) fn in_picture(self, observation: &Observation, in_camera: DVec3) -> DVec2 {
        if in_camera.z < NEAREST {
            return DVec2::splat(BEHIND_PX);
        }
        (in_camera.truncate() / in_camera.z - observation.at) * self.focal_px
    }

    /// Returns that residual, and the one in depth where it was measured, in the same unit.
    fn difference(self, observation: &Observation, in_camera: DVec3) -> DVec3 {
        let depth = observation.depth.map_or(0.0, |depth| DEPTH_PX * (in_camera.z / depth - 1.0));
        self.in_picture(observation, in_camera).extend(depth)
    }

    /// Returns the cost of one landmark at `position`, in the frames before `end`, px².
    fn landmark_cost(self, poses: &[DAffine3], landmark: &Landmark, end: usize, position: DVec3) -> f64 {
        let observations = landmark.before(end);
        let seen = observations.iter().map(|s| {
            self.cost(self.difference(s, poses[s.frame].transform_point3(position)).length_squared())
        });
        let first = unmeasured(observations).map_or(0.0, |s| {
            DEPTH_PRIOR_PX * (poses[s.frame].transform_point3(position).z / landmark.expected_depth - 1.0)
        });
        seen.sum::<f64>() + first * first
    }
}

/// Returns the first of a point's observations if its depth was not measured.
fn unmeasured(observations: &[Observation]) -> Option<&Observation> {
    observations.first().filter(|observation| observation.depth.is_none())
}

/// Derivatives of an observation's residual: by the pose (turn, then shift, both in the camera's axes), and
/// by the point. Rows are u, v and depth, px.
struct Slopes {
    pose: [[f64; 6]; 3],
    point: [[f64; 3]; 3],
}

fn slopes(focal_px: f64, pose: &DAffine3, observation: &Observation, p: DVec3) -> Slopes {
    let scale = focal_px / p.z;
    let deeper = observation.depth.map_or(0.0, |depth| DEPTH_PX / depth);
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
    /// For every observation in a free frame: its column, and the mixed derivative [pose][point].
    mixed: Vec<(usize, [[f64; 3]; 6])>,
}

/// Levenberg–Marquardt damping: the share by which the diagonal of the normal equations is enlarged.
#[derive(Clone, Copy)]
struct Damping(f64);

impl Damping {
    /// Damping of the first step.
    const START: f64 = 1e-3;
    /// Factor after a step that lowered the cost, and the smallest damping.
    const EASE: f64 = 0.3;
    const MIN: f64 = 1e-9;
    /// Factor after a step that did not.
    const RAISE: f64 = 8.0;
    /// Damping above which further steps are hopeless.
    const MAX: f64 = 1e6;
    /// Share of the cost that a step leaves, above which no further one pays.
    const CONVERGED: f64 = 0.9999;

    /// Eases the damping after a step that lowered the cost.
    fn ease(&mut self) {
        self.0 = (self.0 * Self::EASE).max(Self::MIN);
    }

    /// Raises the damping after a step that did not lower the cost.
    fn raise(&mut self) {
        self.0 *= Self::RAISE;
    }

    fn is_hopeless(self) -> bool {
        self.0 > Self::MAX
    }

    /// Returns `true` if a step lowered the cost so little that it was the last.
    fn has_converged(before: f64, after: f64) -> bool {
        after > Self::CONVERGED * before
    }
}

/// Poses and points under adjustment.
pub(super) struct Adjustment<'a> {
    /// `camera_from_world` of all frames, in units of the typical depth.
    pub poses: &'a mut [DAffine3],
    /// The landmarks; those without a position are left out.
    pub landmarks: Vec<&'a mut Landmark>,
    /// Frames whose poses may change; later ones are not looked at.
    pub free: std::ops::Range<usize>,
    /// Measure of residuals.
    pub residual: RobustResidual,
}

impl Adjustment<'_> {
    /// Takes at most `steps` steps; ends earlier when they bring less than 0.01 %. Returns the cost, px².
    pub(super) fn solve(&mut self, steps: usize) -> f64 {
        self.landmarks.retain(|mark| mark.position.is_some());
        let mut damping = Damping(Damping::START);
        let mut cost = self.cost();
        for _ in 0..steps {
            let before: (Vec<DAffine3>, Vec<Option<DVec3>>) =
                (self.poses[self.free.clone()].to_vec(), self.landmarks.iter().map(|m| m.position).collect());
            let done = self.step(damping.0);
            let after = self.cost();
            if done && after < cost {
                damping.ease();
                if Damping::has_converged(cost, after) {
                    return after;
                }
                cost = after;
            } else {
                self.poses[self.free.clone()].copy_from_slice(&before.0);
                self.landmarks.iter_mut().zip(before.1).for_each(|(mark, position)| mark.position = position);
                damping.raise();
                if damping.is_hopeless() {
                    break;
                }
            }
        }
        cost
    }

    fn cost(&self) -> f64 {
        let of = |mark: &&mut Landmark| {
            mark.position.map_or(0.0, |position| {
                self.residual.landmark_cost(self.poses, mark, self.free.end, position)
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
            mark.position = mark.position.map(|position| position - *inverse * right);
        }
        true
    }

    /// Adds what a landmark tells of the poses alone, and returns the rest.
    fn block(&self, mark: &Landmark, matrix: &mut Symmetric, gradient: &mut [f64]) -> Block {
        let position = mark.position.unwrap_or_default();
        let mut block = Block { point: DMat3::ZERO, gradient: DVec3::ZERO, mixed: Vec::new() };
        let observations = mark.before(self.free.end);
        for observation in observations {
            let pose = &self.poses[observation.frame];
            let p = pose.transform_point3(position);
            if p.z < NEAREST {
                continue;
            }
            let difference = self.residual.difference(observation, p);
            let weight = self.residual.weight(difference.length_squared());
            let slopes = slopes(self.residual.focal_px, pose, observation, p);
            for (row, d) in slopes.point.iter().zip(difference.to_array()) {
                let row = DVec3::from(*row);
                block.gradient += weight * d * row;
                block.point += weight * DMat3::from_cols(row * row.x, row * row.y, row * row.z);
            }
            if self.free.contains(&observation.frame) {
                let column = 6 * (observation.frame - self.free.start);
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
        if let Some(first) = unmeasured(observations) {
            let pose = &self.poses[first.frame];
            let row = pose.matrix3.transpose().z_axis * (DEPTH_PRIOR_PX / mark.expected_depth);
            let relative = pose.transform_point3(position).z / mark.expected_depth - 1.0;
            block.gradient += row * DEPTH_PRIOR_PX * relative;
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

/// Finds the pose of a frame from landmarks with positions alone.
pub(super) fn pose_of(
    frame: usize,
    start: DAffine3,
    landmarks: &[Landmark],
    residual: RobustResidual,
    steps: usize,
) -> DAffine3 {
    let seen = landmarks.iter().filter_map(|mark| {
        let observation = mark.observations.iter().find(|s| s.frame == frame)?;
        Some((mark.position?, *observation))
    });
    let seen: Vec<(DVec3, Observation)> = seen.collect();
    let cost = |pose: &DAffine3| -> f64 {
        seen.iter()
            .map(|(position, s)| {
                residual.cost(residual.difference(s, pose.transform_point3(*position)).length_squared())
            })
            .sum()
    };
    let (mut pose, mut damping) = (start, Damping(Damping::START));
    let mut best = cost(&pose);
    for _ in 0..steps {
        let mut matrix = Symmetric::zero(6);
        let mut gradient = vec![0.0; 6];
        for (position, observation) in &seen {
            let p = pose.transform_point3(*position);
            if p.z < NEAREST {
                continue;
            }
            let difference = residual.difference(observation, p);
            let weight = residual.weight(difference.length_squared());
            let by_pose = slopes(residual.focal_px, &pose, observation, p).pose;
            matrix.add_outer(0, &by_pose, weight);
            for (row, d) in by_pose.iter().zip(difference.to_array()) {
                (0..6).for_each(|a| gradient[a] -= weight * d * row[a]);
            }
        }
        matrix.damp(damping.0);
        if !matrix.solve(&mut gradient) {
            break;
        }
        let next = nudged(&pose, &gradient);
        let after = cost(&next);
        if after < best {
            pose = next;
            damping.ease();
            if Damping::has_converged(best, after) {
                break;
            }
            best = after;
        } else {
            damping.raise();
        }
    }
    pose
}
