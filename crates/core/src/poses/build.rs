//! The path of a camera from tracks: a first stretch at once, then frame by frame, then all again.

use super::adjust::{Adjustment, Comparison, Landmark, Sight, pose_of};
use crate::num::median;
use glam::{DAffine3, DVec3};

/// Least median way of the points in the first stretch, as a share of the focal length; and its least and
/// largest number of frames.
const FIRST_WAY: f64 = 0.04;
const FIRST_FRAMES: std::ops::RangeInclusive<usize> = 5..=24;
/// Number of frames that are adjusted together while the path grows; and after how many new ones.
const RECENT: usize = 10;
const EVERY: usize = 3;
/// Number of frames that are adjusted together in the end.
const TOGETHER: usize = 96;
/// Fewest sights from which a pose is found.
const FEWEST_SIGHTS: usize = 12;
/// Number of sights from which a point has a place.
const SIGHTS_FOR_PLACE: usize = 3;
/// Number of neighbours that a new point takes its depth from.
const NEIGHBOURS: usize = 6;
/// Differences, px, from which sights count less: at first, in the middle, in the end.
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
    /// Starts with all cameras in one place.
    pub(super) fn new(frames: usize, landmarks: Vec<Landmark>, focal_px: f64) -> Self {
        let mut seen = vec![Vec::new(); frames];
        for (k, mark) in landmarks.iter().enumerate() {
            mark.sights.iter().for_each(|s| seen[s.frame].push(k));
        }
        Self { poses: vec![DAffine3::IDENTITY; frames], landmarks, focal_px, seen }
    }

    fn compare(&self, stage: usize) -> Comparison {
        Comparison { focal_px: self.focal_px, cauchy_px: CAUCHY_PX[stage] }
    }

    /// Finds the path. Returns the first frame that could not be joined to the ones before, if there is one.
    pub(super) fn build(&mut self) -> Option<usize> {
        let frames = self.poses.len();
        let first = self.first_stretch();
        self.begin(first);
        for frame in first..frames {
            self.poses[frame] = self.expected(frame);
            let known = self.seen[frame].iter().filter(|&&k| self.landmarks[k].place.is_some()).count();
            if known < FEWEST_SIGHTS {
                return Some(frame);
            }
            let marks: Vec<Landmark> = self.seen[frame].iter().map(|&k| self.landmarks[k].clone()).collect();
            for stage in 0..3 {
                self.poses[frame] = pose_of(frame, self.poses[frame], &marks, self.compare(stage), 10);
            }
            self.place_new(frame);
            if (frame - first) % EVERY == EVERY - 1 || frame + 1 == frames {
                self.adjust(frame.saturating_sub(RECENT).max(1)..frame + 1, 1, 4);
            }
        }
        let mut start = 1;
        loop {
            let end = (start + TOGETHER).min(frames);
            for stage in [1, 2] {
                self.adjust(start..end, stage, 12);
            }
            if end == frames {
                return None;
            }
            start += TOGETHER / 2;
        }
    }

    /// Finds the places of the points that cameras with these poses, `camera_from_world`, see move. Returns the
    /// typical depth in their units, which becomes the unit; `None` if no point is seen to move.
    pub(super) fn place_points(&mut self, poses: Vec<DAffine3>) -> Option<f64> {
        self.poses = poses;
        let mut depths = Vec::new();
        for mark in &mut self.landmarks {
            mark.place = crossing(&self.poses, &mark.sights);
            depths.extend(mark.place.map(|p| self.poses[mark.sights[0].frame].transform_point3(p).z));
        }
        let typical = median(&mut depths)?;
        self.poses.iter_mut().for_each(|pose| pose.translation /= typical);
        self.landmarks.iter_mut().filter_map(|mark| mark.place.as_mut()).for_each(|place| *place /= typical);
        let frames = self.poses.len();
        for stage in 0..CAUCHY_PX.len() {
            let (compare, landmarks) = (self.compare(stage), self.landmarks.iter_mut().collect());
            Adjustment { poses: &mut self.poses, landmarks, free: frames..frames, compare }.solve(20);
        }
        Some(typical)
    }

    /// Number of frames of the first stretch: until the points have moved enough, or too many are gone.
    fn first_stretch(&self) -> usize {
        let from_start = |end: usize| -> Vec<f64> {
            let marks = self.seen[0].iter().map(|&k| &self.landmarks[k]);
            marks
                .filter_map(|mark| {
                    let sight = mark.sights.iter().find(|s| s.frame == end)?;
                    Some((sight.at - mark.sights[0].at).length())
                })
                .collect()
        };
        let last = self.poses.len().min(*FIRST_FRAMES.end() + 1);
        let mut frames = self.poses.len().min(*FIRST_FRAMES.start());
        while frames < last {
            let mut ways = from_start(frames - 1);
            if ways.len() < self.seen[0].len() / 2 || median(&mut ways).is_some_and(|way| way > FIRST_WAY) {
                break;
            }
            frames += 1;
        }
        frames
    }

    /// Solves the first `frames` frames: every point starts at its depth, or at the typical one. Where no depth
    /// was measured, what is solved could also be the mirror image in depth; the better one is kept.
    fn begin(&mut self, frames: usize) {
        for mark in &mut self.landmarks {
            let is_seen = mark.before(frames).len() >= SIGHTS_FOR_PLACE;
            // The first camera is the world.
            let depth = mark.sights[0].depth.unwrap_or(1.0);
            mark.place = is_seen.then(|| mark.sights[0].at.extend(1.0) * depth);
        }
        let cost = (0..3).map(|stage| self.adjust(1..frames, stage, 20)).last();
        if self.landmarks.iter().any(|mark| mark.sights.iter().any(|sight| sight.depth.is_some())) {
            return;
        }
        let found = (self.poses.clone(), self.places());
        let mut depths: Vec<f64> = self.landmarks.iter().filter_map(|m| m.place.map(|p| p.z)).collect();
        let middle = median(&mut depths).unwrap_or(1.0);
        for place in self.landmarks.iter_mut().filter_map(|m| m.place.as_mut()) {
            *place *= (2.0 * middle - place.z).clamp(0.3 * middle, 3.0 * middle) / place.z.max(1e-3);
        }
        for frame in 1..frames {
            let marks: Vec<Landmark> = self.seen[frame].iter().map(|&k| self.landmarks[k].clone()).collect();
            self.poses[frame] = pose_of(frame, self.poses[frame - 1], &marks, self.compare(0), 10);
        }
        let mirrored = (0..3).map(|stage| self.adjust(1..frames, stage, 20)).last();
        if mirrored >= cost {
            self.poses = found.0;
            self.landmarks.iter_mut().zip(found.1).for_each(|(mark, place)| mark.place = place);
        }
    }

    /// Cost of all frames, px².
    pub(super) fn cost(&mut self) -> f64 {
        self.adjust(0..self.poses.len(), 2, 0)
    }

    fn places(&self) -> Vec<Option<DVec3>> {
        self.landmarks.iter().map(|m| m.place).collect()
    }

    /// Pose of a frame if the camera goes on as it did.
    fn expected(&self, frame: usize) -> DAffine3 {
        let [last, before] = [self.poses[frame - 1], self.poses[frame - 2]];
        let moved = last * before.inverse();
        moved * last
    }

    /// Gives a place to points that were seen often enough by frame `frame`: at the depth of points around.
    fn place_new(&mut self, frame: usize) {
        let new = self.seen[frame].iter().copied().filter(|&k| {
            let mark = &self.landmarks[k];
            mark.place.is_none() && mark.before(frame + 1).len() >= SIGHTS_FOR_PLACE
        });
        for k in new.collect::<Vec<_>>() {
            let sight = self.landmarks[k].sights[0];
            let pose = self.poses[sight.frame];
            let depths = self.seen[sight.frame].iter().filter_map(|&other| {
                let mark = &self.landmarks[other];
                let at = mark.sights.iter().find(|s| s.frame == sight.frame)?.at;
                Some(((at - sight.at).length_squared(), pose.transform_point3(mark.place?).z))
            });
            let mut near: Vec<(f64, f64)> = depths.filter(|(_, z)| *z > 0.05).collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            near.truncate(NEIGHBOURS);
            let mut depths: Vec<f64> = near.into_iter().map(|(_, z)| z).collect();
            if let Some(z) = sight.depth.or_else(|| median(&mut depths)) {
                let place = pose.inverse().transform_point3(sight.at.extend(1.0) * z);
                self.landmarks[k].place = Some(place);
            }
        }
    }

    /// Adjusts the frames of `free` and the points that they see. Returns the cost, px².
    fn adjust(&mut self, free: std::ops::Range<usize>, stage: usize, steps: usize) -> f64 {
        let compare = self.compare(stage);
        let mut wanted = vec![false; self.landmarks.len()];
        self.seen[free.clone()].iter().flatten().for_each(|&k| wanted[k] = true);
        let chosen = self.landmarks.iter_mut().zip(wanted).filter(|(m, wanted)| *wanted && m.place.is_some());
        let landmarks = chosen.map(|(mark, _)| mark).collect();
        Adjustment { poses: &mut self.poses, landmarks, free, compare }.solve(steps)
    }
}

/// Smallest angle between two sights of a point, radians, that tells how far it is.
const LEAST_ANGLE: f64 = 0.01;

/// Returns the point on the first sight's ray that is nearest to the ray of the sight from farthest away.
/// `None` if they are almost parallel, or part in front of the camera.
fn crossing(poses: &[DAffine3], sights: &[Sight]) -> Option<DVec3> {
    let ray = |sight: &Sight| {
        let world_from_camera = poses[sight.frame].inverse();
        (world_from_camera.translation, world_from_camera.transform_vector3(sight.at.extend(1.0)))
    };
    let (from, along) = ray(sights.first()?);
    let rays = sights[1..].iter().map(ray);
    let (other, other_along) =
        rays.max_by(|a, b| (a.0 - from).length_squared().total_cmp(&(b.0 - from).length_squared()))?;
    let normal = along.cross(other_along);
    let is_wide = normal.length() > LEAST_ANGLE * along.length() * other_along.length();
    let depth = (other - from).cross(other_along).dot(normal) / normal.length_squared();
    (is_wide && depth > 0.0).then(|| from + along * depth)
}
