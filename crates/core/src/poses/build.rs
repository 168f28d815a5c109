//! The path of a camera from tracks: a first stretch at once, then frame by frame, then all again.

use super::{
    MIN_PARALLAX_TO_TRIANGULATE,
    adjust::{Adjustment, Landmark, Observation, RobustResidual, pose_of},
};
use crate::num::median;
use glam::{DAffine3, DVec3};

/// Least median displacement of the points in the first stretch, as a share of the focal length; and its
/// least and largest number of frames.
const FIRST_DISPLACEMENT: f64 = 0.04;
const FIRST_FRAMES: std::ops::RangeInclusive<usize> = 5..=24;
/// Number of frames that are adjusted together while the path grows; and after how many new ones.
const RECENT: usize = 10;
const EVERY: usize = 3;
/// Number of frames that are adjusted together in the end.
const TOGETHER: usize = 96;
/// Fewest observations from which a pose is found.
const FEWEST_OBSERVATIONS: usize = 12;
/// Number of observations from which a point has a position.
const OBSERVATIONS_FOR_POSITION: usize = 3;
/// Number of neighbours that a new point takes its depth from.
const NEIGHBOURS: usize = 6;
/// Residuals, px, from which observations count less: at first, in the middle, in the end.
const CAUCHY_PX: [f64; 3] = [6.0, 2.0, 0.7];

/// A path under construction. Everything is in units of the typical depth.
pub(super) struct Builder {
    /// `camera_from_world` of each frame.
    pub poses: Vec<DAffine3>,
    /// The points.
    pub landmarks: Vec<Landmark>,
    focal_px: f64,
    /// Numbers of the landmarks that each frame sees.
    seen: Vec<Vec<usize>>,
}

impl Builder {
    /// Starts with all cameras at one position.
    pub(super) fn new(frames: usize, landmarks: Vec<Landmark>, focal_px: f64) -> Self {
        let mut seen = vec![Vec::new(); frames];
        for (k, mark) in landmarks.iter().enumerate() {
            mark.observations.iter().for_each(|s| seen[s.frame].push(k));
        }
        Self { poses: vec![DAffine3::IDENTITY; frames], landmarks, focal_px, seen }
    }

    fn residual(&self, stage: usize) -> RobustResidual {
        RobustResidual { focal_px: self.focal_px, cauchy_px: CAUCHY_PX[stage] }
    }

    /// Finds the path. Returns the first frame that could not be joined to the ones before, if there is one.
    pub(super) fn build(&mut self) -> Option<usize> {
        let frames = self.poses.len();
        let first = self.first_stretch();
        self.begin(first);
        for frame in first..frames {
            self.poses[frame] = self.expected(frame);
            let known = self.seen[frame].iter().filter(|&&k| self.landmarks[k].position.is_some()).count();
            if known < FEWEST_OBSERVATIONS {
                return Some(frame);
            }
            let marks: Vec<Landmark> = self.seen[frame].iter().map(|&k| self.landmarks[k].clone()).collect();
            for stage in 0..3 {
                self.poses[frame] = pose_of(frame, self.poses[frame], &marks, self.residual(stage), 10);
            }
            self.triangulate_new(frame);
            if (frame - first) % EVERY == EVERY - 1 || frame + 1 == frames {
                self.adjust(frame.saturating_sub(RECENT).max(1)..frame + 1, 1, 4);
            }
        }
        self.adjust_all();
        None
    }

    /// Adds observations to the points, for each point a list in the order of frames, and adjusts the path.
    pub(super) fn add(&mut self, new: Vec<Vec<Observation>>) {
        for (k, (mark, new)) in self.landmarks.iter_mut().zip(new).enumerate() {
            let earlier = new.first().filter(|first| mark.before(first.frame + 1).is_empty());
            if let Some((first, position)) = earlier.zip(mark.position) {
                mark.expected_depth = self.poses[first.frame].transform_point3(position).z;
            }
            new.iter().for_each(|observation| self.seen[observation.frame].push(k));
            mark.observations.extend(new);
            mark.observations.sort_by_key(|observation| observation.frame);
        }
        self.adjust_all();
    }

    fn adjust_all(&mut self) {
        let frames = self.poses.len();
        let mut start = 1;
        loop {
            let end = (start + TOGETHER).min(frames);
            for stage in [1, 2] {
                self.adjust(start..end, stage, 12);
            }
            if end == frames {
                return;
            }
            start += TOGETHER / 2;
        }
    }

    /// Triangulates all points that cameras with these poses, `camera_from_world`, see move. Returns the
    /// typical depth in their units, which becomes the unit; `None` if no point is seen to move.
    pub(super) fn triangulate_all(&mut self, poses: Vec<DAffine3>) -> Option<f64> {
        self.poses = poses;
        let mut depths = Vec::new();
        for mark in &mut self.landmarks {
            mark.position = triangulated(&self.poses, &mark.observations);
            depths
                .extend(mark.position.map(|p| self.poses[mark.observations[0].frame].transform_point3(p).z));
        }
        let typical = median(&mut depths)?;
        self.poses.iter_mut().for_each(|pose| pose.translation /= typical);
        self.landmarks
            .iter_mut()
            .filter_map(|mark| mark.position.as_mut())
            .for_each(|position| *position /= typical);
        let frames = self.poses.len();
        for stage in 0..CAUCHY_PX.len() {
            let (residual, landmarks) = (self.residual(stage), self.landmarks.iter_mut().collect());
            Adjustment { poses: &mut self.poses, landmarks, free: frames..frames, residual }.solve(20);
        }
        Some(typical)
    }

    /// Number of frames of the first stretch: until the points have moved enough, or too many are gone.
    fn first_stretch(&self) -> usize {
        let from_start = |end: usize| -> Vec<f64> {
            let marks = self.seen[0].iter().map(|&k| &self.landmarks[k]);
            marks
                .filter_map(|mark| {
                    let observation = mark.observations.iter().find(|s| s.frame == end)?;
                    Some((observation.at - mark.observations[0].at).length())
                })
                .collect()
        };
        let last = self.poses.len().min(*FIRST_FRAMES.end() + 1);
        let mut frames = self.poses.len().min(*FIRST_FRAMES.start());
        while frames < last {
            let mut displacements = from_start(frames - 1);
            if displacements.len() < self.seen[0].len() / 2
                || median(&mut displacements).is_some_and(|displacement| displacement > FIRST_DISPLACEMENT)
            {
                break;
            }
            frames += 1;
        }
        frames
    }

    /// Solves the first `frames` frames: every point starts at its depth, or at the typical one. Where no
    /// depth was measured, what is solved could also be the mirror image in depth; the better one is kept.
    fn begin(&mut self, frames: usize) {
        for mark in &mut self.landmarks {
            let is_seen = mark.before(frames).len() >= OBSERVATIONS_FOR_POSITION;
            // The first camera is the world.
            let depth = mark.observations[0].depth.unwrap_or(1.0);
            mark.position = is_seen.then(|| mark.observations[0].at.extend(1.0) * depth);
        }
        let cost = (0..3).map(|stage| self.adjust(1..frames, stage, 20)).last();
        if self
            .landmarks
            .iter()
            .any(|mark| mark.observations.iter().any(|observation| observation.depth.is_some()))
        {
            return;
        }
        let found = (self.poses.clone(), self.positions());
        let mut depths: Vec<f64> = self.landmarks.iter().filter_map(|m| m.position.map(|p| p.z)).collect();
        let middle = median(&mut depths).unwrap_or(1.0);
        for position in self.landmarks.iter_mut().filter_map(|m| m.position.as_mut()) {
            *position *= (2.0 * middle - position.z).clamp(0.3 * middle, 3.0 * middle) / position.z.max(1e-3);
        }
        for frame in 1..frames {
            let marks: Vec<Landmark> = self.seen[frame].iter().map(|&k| self.landmarks[k].clone()).collect();
            self.poses[frame] = pose_of(frame, self.poses[frame - 1], &marks, self.residual(0), 10);
        }
        let mirrored = (0..3).map(|stage| self.adjust(1..frames, stage, 20)).last();
        if mirrored >= cost {
            self.poses = found.0;
            self.landmarks.iter_mut().zip(found.1).for_each(|(mark, position)| mark.position = position);
        }
    }

    /// Cost of all frames, px².
    pub(super) fn cost(&mut self) -> f64 {
        self.adjust(0..self.poses.len(), 2, 0)
    }

    fn positions(&self) -> Vec<Option<DVec3>> {
        self.landmarks.iter().map(|m| m.position).collect()
    }

    /// Pose of a frame if the camera goes on as it did.
    fn expected(&self, frame: usize) -> DAffine3 {
        let [last, before] = [self.poses[frame - 1], self.poses[frame - 2]];
        let moved = last * before.inverse();
        moved * last
    }

    /// Gives a position to points seen often enough by frame `frame`: at the depth of points around.
    fn triangulate_new(&mut self, frame: usize) {
        let new = self.seen[frame].iter().copied().filter(|&k| {
            let mark = &self.landmarks[k];
            mark.position.is_none() && mark.before(frame + 1).len() >= OBSERVATIONS_FOR_POSITION
        });
        for k in new.collect::<Vec<_>>() {
            let observation = self.landmarks[k].observations[0];
            let pose = self.poses[observation.frame];
            let depths = self.seen[observation.frame].iter().filter_map(|&other| {
                let mark = &self.landmarks[other];
                let at = mark.observations.iter().find(|s| s.frame == observation.frame)?.at;
                Some(((at - observation.at).length_squared(), pose.transform_point3(mark.position?).z))
            });
            let mut near: Vec<(f64, f64)> = depths.filter(|(_, z)| *z > 0.05).collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            near.truncate(NEIGHBOURS);
            let mut depths: Vec<f64> = near.into_iter().map(|(_, z)| z).collect();
            if let Some(z) = observation.depth.or_else(|| median(&mut depths)) {
                self.landmarks[k].expected_depth = z;
                let position = pose.inverse().transform_point3(observation.at.extend(1.0) * z);
                self.landmarks[k].position = Some(position);
            }
        }
    }

    /// Adjusts the frames of `free` and the points that they see. Returns the cost, px².
    fn adjust(&mut self, free: std::ops::Range<usize>, stage: usize, steps: usize) -> f64 {
        let residual = self.residual(stage);
        let mut wanted = vec![false; self.landmarks.len()];
        self.seen[free.clone()].iter().flatten().for_each(|&k| wanted[k] = true);
        let chosen =
            self.landmarks.iter_mut().zip(wanted).filter(|(m, wanted)| *wanted && m.position.is_some());
        let landmarks = chosen.map(|(mark, _)| mark).collect();
        Adjustment { poses: &mut self.poses, landmarks, free, residual }.solve(steps)
    }
}

/// Triangulates a point: returns the point on the first observation's ray that is nearest to the ray of the
/// observation from farthest away.
/// `None` if they are almost parallel, or part in front of the camera.
fn triangulated(poses: &[DAffine3], observations: &[Observation]) -> Option<DVec3> {
    let ray = |observation: &Observation| {
        let world_from_camera = poses[observation.frame].inverse();
        (world_from_camera.translation, world_from_camera.transform_vector3(observation.at.extend(1.0)))
    };
    let (from, along) = ray(observations.first()?);
    let rays = observations[1..].iter().map(ray);
    let (other, other_along) =
        rays.max_by(|a, b| (a.0 - from).length_squared().total_cmp(&(b.0 - from).length_squared()))?;
    let normal = along.cross(other_along);
    let is_wide = normal.length() > MIN_PARALLAX_TO_TRIANGULATE * along.length() * other_along.length();
    let depth = (other - from).cross(other_along).dot(normal) / normal.length_squared();
    (is_wide && depth > 0.0).then(|| from + along * depth)
}
