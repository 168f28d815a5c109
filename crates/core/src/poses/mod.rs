//! The endoscope's path, estimated from pictures, and from depth where that was measured.
//!
//! Points are followed through the frames ([`tracks`]); poses and points that together explain their paths
//! are found by bundle adjustment ([`adjust`], [`build`]). A scope that stands still is recognised: then most
//! points come back to where they were, and nothing is estimated.

mod adjust;
mod again;
mod breath;
mod build;
mod judge;
mod lens;
mod measured;
mod patch;
mod surface;
#[cfg(test)]
mod tests;
mod tracks;
mod verdict;

pub use verdict::ScopeVerdict;

use crate::{
    Result,
    camera::Camera,
    flow::luma,
    grid::Grid,
    mask::bounding_box,
    num::median,
    progress::{Observer, Progress},
    sequence::{CameraSource, Sequence},
};
use adjust::{Landmark, Observation};
use build::Builder;
use glam::{Affine3A, DAffine3, DQuat, DVec3, Quat, Vec3};
use image::RgbImage;
use judge::{MIN_INLIER_GAIN, is_explained};
use lens::{Lens, likely_zoom};
use patch::View;
use std::ops::{Range, RangeInclusive};
use tracks::{Follower, Track};
use verdict::MOST_FRAMES;

/// Longest side of what is in view in the pictures that are looked at, px; larger ones are halved.
const LONGEST_SIDE: usize = 720;
/// Fewest frames of a track.
const SHORTEST_TRACK: usize = 4;
/// Number of points that the depth of a pixel is taken from.
const NEAREST_POINTS: usize = 12;
/// Residual up to which an observation is an inlier, which the path explains, px of the pictures that are
/// looked at.
const INLIER_PX: f64 = 1.5;
/// Smallest share of inliers among the observations with which a path is believed.
const MIN_INLIER_RATIO: f64 = 0.45;
/// Angle between two views of a point, its parallax, radians: above the first it is triangulated, and above
/// the second its depth counts for the range of depths.
const MIN_PARALLAX_TO_TRIANGULATE: f64 = 0.01;
const MIN_PARALLAX_FOR_DEPTH: f64 = 0.02;
/// Longest side of the pictures that typical depths are taken from, px.
const DEPTHS_SIDE: u32 = 160;
/// Sharpness, as a share of the usual one around, below which a frame is passed over as blurred.
const BLURRED: f32 = 0.65;
/// Most frames in a row that are passed over because they show nothing that those around them show.
const MOST_PASSED_OVER: usize = 2;
/// Share of the last step of a path that the frames right beyond its ends go on by. Where paths are smooth,
/// half of it halves the error, and where they jitter, it costs little.
const GOES_ON: f64 = 0.5;
/// Number of steps beyond the ends of a path that it goes on for.
const MOST_STEPS_BEYOND: f64 = 1.5;
/// Number of frames around that the usual sharpness is taken from.
const AROUND: usize = 12;

/// Judgement on a recording's camera, and its path if it moves.
#[derive(Clone, Debug, Default)]
pub struct ScopePath {
    /// The judgement.
    pub verdict: ScopeVerdict,
    /// Share of the points' observations within 1.5 px of where a still camera would see them.
    still_share: f64,
    /// The same with the path.
    moving_share: f64,
    /// Factor from the assumed focal length to the one that explains what is seen; `None` where the lens is
    /// known, or nothing tells.
    pub zoom: Option<f32>,
    /// Frames that were passed over: they are blurred, or show nothing that those around them show.
    pub blurred: Vec<usize>,
    /// `camera_from_world` of every frame; empty unless the camera moves. The unit is that of the recording's
    /// depth, or such that the median depth of all observations is `typical_depth`. The first frame's camera
    /// is the world.
    pub poses: Vec<Affine3A>,
    /// The path as it was found, if part of it was the motion of tissue that comes again and again: then
    /// `poses` are without that. If all of it was, the scope stands still.
    pub swaying: Vec<Affine3A>,
    /// Median depth of what is seen, in units of known poses; `None` where it was not looked for, or nothing
    /// tells.
    pub typical_depth: Option<f32>,
    /// Points of the surface in the world, each with the stretches of frames that saw it. To a camera of
    /// `swaying`, if there is one, they stand still.
    pub points: Vec<(Vec3, Vec<RangeInclusive<usize>>)>,
}

impl ScopePath {
    /// A judgement, without a path.
    pub(crate) fn judged(verdict: ScopeVerdict) -> Self {
        Self { verdict, ..Self::default() }
    }

    /// Returns the pose, `camera_from_world`, to which tissue at rest is what frame `i` shows; `recorded`
    /// without a path.
    pub(crate) fn pose_to_tissue(&self, i: usize, recorded: Affine3A) -> Affine3A {
        self.swaying.get(i).or(self.poses.get(i)).copied().unwrap_or(recorded)
    }

    /// Returns how the tissue has moved by frame `i`, as far as the path first took that for its own;
    /// `recorded` is the pose of a camera that stands still.
    pub(crate) fn sway(&self, i: usize, recorded: Affine3A) -> Option<Affine3A> {
        let pose = self.poses.get(i).copied().unwrap_or(recorded);
        Some(pose.inverse() * *self.swaying.get(i)?)
    }

    /// Returns the points that `camera` sees in frame `i`: their places in the picture, px, and their depths.
    pub(crate) fn seen(&self, camera: &Camera, i: usize) -> impl Iterator<Item = [f32; 3]> {
        let seen = self.points.iter().filter(move |(_, frames)| frames.iter().any(|of| of.contains(&i)));
        seen.filter_map(|(p, _)| camera.project(*p).map(<[f32; 3]>::from))
    }

    /// Returns the depth of every pixel of frame `i`, seen by `camera`: a smooth surface through the points
    /// that are seen there. `None` if there are too few.
    pub(crate) fn depth(&self, camera: &Camera, i: usize) -> Option<Grid<f32>> {
        let seen: Vec<[f32; 3]> = self.seen(camera, i).collect();
        (seen.len() >= NEAREST_POINTS)
            .then(|| surface::through(&seen, camera.width as usize, camera.height as usize))
    }

    /// Returns the median depth that the path shows on each of `frames`, in scene units; 0 where nothing tells.
    /// None at all without a path. `sequence` has the path's lens.
    pub(crate) fn typical_depths(&self, sequence: &Sequence, frames: Range<usize>) -> Vec<f32> {
        let depth = |i: usize| {
            let recorded = sequence.camera(i);
            let camera_from_world = self.pose_to_tissue(i, recorded.camera_from_world);
            let camera = Camera { camera_from_world, ..recorded }.shrunk(DEPTHS_SIDE);
            let depth = self.depth(&camera, i)?;
            let in_view = sequence.field_of_view().sampled(depth.width, depth.height);
            let seen = depth.data.iter().zip(&in_view.data).filter(|(_, in_view)| **in_view);
            median(&mut seen.map(|(z, _)| f64::from(*z)).collect::<Vec<_>>())
        };
        let frames = if self.poses.is_empty() { 0..0 } else { frames };
        frames.map(|i| depth(i).unwrap_or(0.0) as f32).collect()
    }
}

/// Returns `true` if nothing is known of where a recording's camera was, so that its path may be estimated.
pub fn are_wanted(sequence: &Sequence) -> bool {
    sequence.camera_source() != CameraSource::Given && !sequence.camera_moves()
}

/// Returns the judgement on a recording of which too many frames are learned together for what would be
/// looked for; `None` if it can be, or nothing would.
pub(crate) fn too_long(sequence: &Sequence, frames: usize) -> Option<ScopeVerdict> {
    let has_poses = can_triangulate(sequence);
    let is_too_long = frames > MOST_FRAMES && (has_poses || are_wanted(sequence));
    is_too_long.then_some(ScopeVerdict::TooLong { frames, has_poses })
}

/// Returns `true` if nothing is known of a recording's lens.
pub(crate) fn has_unknown_lens(sequence: &Sequence) -> bool {
    matches!(sequence.camera_source(), CameraSource::Assumed(_))
}

/// Returns `true` if points may be triangulated: a recording's camera is known to move, and depth is not.
pub(crate) fn can_triangulate(sequence: &Sequence) -> bool {
    sequence.camera_moves() && !sequence.has_depth()
}

/// Frames to be used and their times.
#[derive(Clone, Copy, Debug)]
pub struct Timeline<'a> {
    /// Frames that may be read, in ascending order.
    pub frames: &'a [usize],
    /// Time of every frame of the recording; equal for frames that show the same.
    pub times: &'a [f32],
}

/// Typical depth for an estimate of which only what does not depend on its scale is used.
pub const ANY_DEPTH: f32 = 100.0;

/// Estimates the path of a recording's camera. Only `timeline.frames` are read; the poses of others lie
/// between those of their neighbours in time.
///
/// # Errors
/// A frame that cannot be read, or the observer's wish to stop.
pub fn estimate(
    sequence: &Sequence,
    timeline: Timeline<'_>,
    typical_depth: f32,
    observer: &mut Observer<'_>,
) -> Result<ScopePath> {
    let mut followed = Followed::new(sequence, timeline, observer)?;
    let still_share = judge::still_share(&followed.tracks);
    let mut path = ScopePath {
        still_share,
        moving_share: still_share,
        // Where a shot has one lens, a part that stands still has it, too.
        zoom: sequence.estimated_zoom().filter(|zoom| *zoom != 1.0),
        blurred: std::mem::take(&mut followed.blurred),
        ..ScopePath::default()
    };
    if followed.used.len() < SHORTEST_TRACK || 1.0 - still_share < MIN_INLIER_GAIN {
        return Ok(path);
    }
    let zoom = match sequence.estimated_zoom() {
        None if has_unknown_lens(sequence) => followed.likely_zoom(sequence, observer)?,
        _ => path.zoom.map(f64::from),
    };
    Progress::new("finding the scope's path", 0, 1).tell(observer)?;
    let num_used = followed.used.len();
    let (mut builder, known_depth) = match followed.build(sequence)? {
        Ok(built) => built,
        Err(first_break) => {
            path.verdict = ScopeVerdict::Lost(first_break);
            return Ok(path);
        }
    };
    let Followed { tracks, lens, used, views, .. } = followed;
    path.still_share = judge::still_share(&tracks);
    path.moving_share = judge::moving_share(&builder, &lens);
    path.verdict = judge::verdict(&path, &tracks, &builder, &lens);
    if !matches!(path.verdict, ScopeVerdict::Moves { .. }) {
        return Ok(path);
    }
    Progress::new("looking for points again", 0, 1).tell(observer)?;
    again::find(&mut builder, &lens, &views);
    // With measured depth, the unit is the typical one already.
    let unit = if sequence.depth_origin().is_measured() { 1.0 } else { median_depth(&builder) };
    let scale = known_depth.unwrap_or(f64::from(typical_depth)) / unit;
    path.zoom = zoom.map(|zoom| zoom as f32);
    let known_frames = (used.len() < num_used).then(|| [used[0], used[used.len() - 1]]);
    let found = FoundPath { builder: &builder, lens: &lens, used: &used, times: timeline.times, scale };
    found.tell(&mut path, sequence.camera(0).camera_from_world, known_frames);
    Ok(path)
}

/// A path that explains what is seen, in units of its own.
struct FoundPath<'a> {
    builder: &'a Builder,
    lens: &'a Lens,
    /// Frames of the path.
    used: &'a [usize],
    /// Time of every frame of the recording.
    times: &'a [f32],
    /// Factor from the path's units to those of the scene.
    scale: f64,
}

impl FoundPath<'_> {
    /// Puts poses and points of all frames into `path`, without the motion of tissue that comes again and again.
    /// `still` is the pose of a camera that stands still; `known` are the first and the last frame of a path
    /// that breaks off.
    fn tell(&self, path: &mut ScopePath, still: Affine3A, known: Option<[usize; 2]>) {
        let times: Vec<f32> = self.used.iter().map(|&frame| self.times[frame]).collect();
        let poses = self.of_all_frames(&self.builder.poses, &times);
        let steadied = breath::steady(self.builder, self.lens.focal_px(), &times);
        if steadied.as_ref().is_some_and(|steadied| steadied.is_still) {
            path.verdict = ScopeVerdict::Still;
            path.swaying = poses.into_iter().map(|pose| pose * still).collect();
            return;
        }
        let num_frames = self.times.len() as f64;
        path.verdict = ScopeVerdict::Moves {
            fov_x_degrees: path.zoom.map(|_| self.lens.camera.field_of_view_degrees()[0]),
            period_frames: steadied.as_ref().map(|steadied| (steadied.period * num_frames) as f32),
            known,
        };
        path.points = points(self.builder, self.lens, self.scale, self.used);
        (path.poses, path.swaying) = match steadied {
            Some(steadied) => (self.of_all_frames(&steadied.poses, &times), poses),
            None => (poses, Vec::new()),
        };
    }

    /// Returns the poses of all frames from those of the path's frames, which are at `times`.
    fn of_all_frames(&self, poses: &[DAffine3], times: &[f32]) -> Vec<Affine3A> {
        let poses = poses.iter().map(|pose| scaled(pose, self.scale));
        let known: Vec<(f32, DAffine3)> = times.iter().copied().zip(poses).collect();
        self.times.iter().map(|t| single(&pose_at(&known, *t))).collect()
    }
}

/// Returns the factor from the focal length that is assumed of a recording to the one that best explains what
/// several parts of it show, each a list of its frames; `None` if nothing tells. `times` are those of all
/// frames. A path through each part alone tells the lens less well, and chapters that differ in their lens do
/// not fit together.
///
/// # Errors
/// As [`estimate`].
pub(crate) fn shared_zoom(
    sequence: &Sequence,
    parts: &[Vec<usize>],
    times: &[f32],
    observer: &mut Observer<'_>,
) -> Result<Option<f32>> {
    let mut moving = Vec::new();
    for frames in parts {
        let frames = &frames[..frames.len().min(lens::FRAMES)];
        let followed = Followed::new(sequence, Timeline { frames, times }, observer)?;
        if 1.0 - judge::still_share(&followed.tracks) >= MIN_INLIER_GAIN {
            moving.push(followed);
        }
    }
    let Some(first) = moving.first() else { return Ok(None) };
    let tracks: Vec<&[Track]> = moving.iter().map(|followed| &followed.tracks[..]).collect();
    Ok(likely_zoom(sequence, &tracks, &first.lens, observer)?.map(|zoom| zoom as f32))
}

/// Triangulates points of the surface that a camera with known poses sees move, in the units of the poses. It
/// has no points if there are too few for a typical depth.
///
/// # Errors
/// As [`estimate`].
pub(crate) fn triangulate_with_known_poses(
    sequence: &Sequence,
    timeline: Timeline<'_>,
    observer: &mut Observer<'_>,
) -> Result<ScopePath> {
    let Followed { tracks, lens, used, .. } = Followed::new(sequence, timeline, observer)?;
    let pose = |&frame: &usize| double(&sequence.camera(frame).camera_from_world);
    // Known intrinsics may change, as those of a scope that zooms.
    let landmarks = lens::landmarks(&tracks, |slot| Lens { camera: sequence.camera(used[slot]), ..lens });
    let mut builder = Builder::new(used.len(), landmarks, lens.focal_px());
    let scale = builder.triangulate_all(used.iter().map(pose).collect());
    let explains_much = judge::moving_share(&builder, &lens) >= MIN_INLIER_RATIO;
    let points = scale.filter(|_| explains_much).map(|scale| points(&builder, &lens, scale, &used));
    Ok(ScopePath {
        verdict: if explains_much { ScopeVerdict::Still } else { ScopeVerdict::Unexplained },
        points: points.unwrap_or_default(),
        typical_depth: scale.map(|scale| scale as f32),
        ..ScopePath::default()
    })
}

/// Points that were followed through a recording.
struct Followed {
    /// Tracks by slots, which number the frames that were used.
    tracks: Vec<Track>,
    lens: Lens,
    /// Frames that were used, and those that were passed over: they are blurred, or show nothing that those
    /// around them show.
    used: Vec<usize>,
    blurred: Vec<usize>,
    /// The frames that were used, of half the size; none if there are too many.
    views: Vec<View>,
}

impl Followed {
    fn new(sequence: &Sequence, timeline: Timeline<'_>, observer: &mut Observer<'_>) -> Result<Self> {
        let mut distinct = timeline.frames.to_vec();
        distinct.dedup_by(|later, earlier| timeline.times[*later] <= timeline.times[*earlier]);
        let halvings = halvings(sequence);
        let (mut blurred, sharp) = sharp_frames(sequence, &distinct, halvings)?;
        let view = |frame: usize| view(sequence, frame, &sequence.frame(frame)?, halvings);
        let mut follower = Follower::default();
        let (mut used, mut views) = (Vec::new(), Vec::new());
        let mut next = 0;
        while next < sharp.len() {
            Progress::new("following points", next, sharp.len()).tell(observer)?;
            let mut found = follower.found_in(view(sharp[next])?);
            // A flash, or a picture that is damaged, hides for a moment what is seen again right after it.
            let beyond = next + 1..(next + 1 + MOST_PASSED_OVER).min(sharp.len());
            for later in beyond.filter(|_| found.is_lost()) {
                let again = follower.found_in(view(sharp[later])?);
                if !again.is_lost() {
                    blurred.extend(&sharp[next..later]);
                    (found, next) = (again, later);
                    break;
                }
            }
            if sharp.len() <= again::MOST_VIEWS {
                views.push(found.halved_view());
            }
            follower.take(used.len(), found);
            used.push(sharp[next]);
            next += 1;
        }
        blurred.sort_unstable();
        let lens = Lens { camera: sequence.camera(0), shrink: f64::from(1 << halvings) };
        Ok(Self { tracks: follower.finish(SHORTEST_TRACK), lens, used, blurred, views })
    }

    /// Takes the lens that explains the tracks best, and returns its zoom; `None` if nothing tells.
    fn likely_zoom(&mut self, sequence: &Sequence, observer: &mut Observer<'_>) -> Result<Option<f64>> {
        let zoom = likely_zoom(sequence, &[&self.tracks], &self.lens, observer)?;
        self.lens = zoom.map_or(self.lens, |zoom| self.lens.zoomed(zoom));
        Ok(zoom)
    }

    /// Finds the path, and the typical depth if depth is known. Where the path breaks off, only the longest
    /// part is kept; if that is less than half of the frames, the error is the frame of the first break.
    fn build(&mut self, sequence: &Sequence) -> Result<std::result::Result<(Builder, Option<f64>), usize>> {
        let fewest = self.used.len().div_ceil(2);
        let mut first_break = None;
        loop {
            let mut landmarks = self.lens.landmarks(&self.tracks);
            let known_depth = measured::take(&mut landmarks, &self.tracks, &self.lens, sequence, &self.used)?;
            let mut builder = Builder::new(self.used.len(), landmarks, self.lens.focal_px());
            let Some(slot) = builder.build() else { return Ok(Ok((builder, known_depth))) };
            let first_break = *first_break.get_or_insert(self.used[slot]);
            let longer = if 2 * slot >= self.used.len() { 0..slot } else { slot..self.used.len() };
            if longer.len() < fewest {
                return Ok(Err(first_break));
            }
            self.tracks = within(std::mem::take(&mut self.tracks), &longer);
            self.views = kept(std::mem::take(&mut self.views), &longer);
            self.used = kept(std::mem::take(&mut self.used), &longer);
        }
    }
}

/// Returns the parts of tracks inside a range of slots, which are numbered from its start then.
fn within(tracks: Vec<Track>, slots: &Range<usize>) -> Vec<Track> {
    let inside = |track: Track| -> Track {
        let observations = track.into_iter().filter(|(slot, _)| slots.contains(slot));
        observations.map(|(slot, at)| (slot - slots.start, at)).collect()
    };
    tracks.into_iter().map(inside).filter(|track| track.len() >= SHORTEST_TRACK).collect()
}

/// Returns the items in a range of places, as far as there are any.
fn kept<T>(items: Vec<T>, places: &Range<usize>) -> Vec<T> {
    items.into_iter().skip(places.start).take(places.len()).collect()
}

/// Returns how often pictures are halved before they are looked at. A black border does not count: half of a
/// wide picture may be that.
fn halvings(sequence: &Sequence) -> u32 {
    let seen = bounding_box(sequence.field_of_view()).map_or(0, |rect| rect.width.max(rect.height));
    seen.div_ceil(LONGEST_SIDE).next_power_of_two().trailing_zeros()
}

/// Returns the picture of a frame as points are followed in it.
fn view(sequence: &Sequence, frame: usize, picture: &RgbImage, halvings: u32) -> Result<View> {
    let mut view = View { luma: luma(picture), mask: sequence.mask(frame)? };
    for _ in 0..halvings {
        view = view.halved();
    }
    Ok(view)
}

/// Separates frames that are much less sharp than those around them: (blurred, the others).
fn sharp_frames(sequence: &Sequence, frames: &[usize], halvings: u32) -> Result<(Vec<usize>, Vec<usize>)> {
    let sharpness = |i: usize, frame: Result<RgbImage>| Ok(sharpness(&view(sequence, i, &frame?, halvings)?));
    let sharpness: Vec<f32> = sequence.map_frames(frames, sharpness).into_iter().collect::<Result<_>>()?;
    let usual = |k: usize| {
        let mut around: Vec<f64> = sharpness[k.saturating_sub(AROUND)..(k + AROUND + 1).min(frames.len())]
            .iter()
            .map(|v| f64::from(*v))
            .collect();
        median(&mut around).unwrap_or(0.0) as f32
    };
    let is_blurred = |k: usize| sharpness[k] < BLURRED * usual(k);
    let (blurred, sharp): (Vec<usize>, Vec<usize>) = (0..frames.len()).partition(|&k| is_blurred(k));
    let numbers = |slots: Vec<usize>| slots.into_iter().map(|k| frames[k]).collect::<Vec<_>>();
    Ok((numbers(blurred), numbers(sharp)))
}

/// Returns how sharp a frame is: the strength of its slopes as a share of those of a picture of a quarter of
/// the size, which blur leaves as they are. What is in view, glare above all, changes both alike.
fn sharpness(view: &View) -> f32 {
    let quarter = view.halved().halved();
    slopes(view) / slopes(&quarter).max(f32::MIN_POSITIVE)
}

/// Mean squared difference between neighbouring pixels inside the mask, levels².
fn slopes(view: &View) -> f32 {
    let (width, height) = (view.luma.width, view.luma.height);
    let (mut sum, mut count) = (0.0f64, 0usize);
    for y in 0..height.saturating_sub(1) {
        for x in 0..width.saturating_sub(1) {
            if view.mask.at(x, y) && view.mask.at(x + 1, y) && view.mask.at(x, y + 1) {
                let here = view.luma.at(x, y);
                let [across, down] = [view.luma.at(x + 1, y) - here, view.luma.at(x, y + 1) - here];
                sum += f64::from(across * across + down * down);
                count += 1;
            }
        }
    }
    (sum / count.max(1) as f64) as f32
}

/// Median depth of all observations.
fn median_depth(builder: &Builder) -> f64 {
    let marks = builder.landmarks.iter().filter_map(|mark| Some((mark.position?, mark)));
    let depths = marks.flat_map(|(position, mark)| {
        mark.observations.iter().map(move |s| builder.poses[s.frame].transform_point3(position).z)
    });
    median(&mut depths.collect::<Vec<_>>()).filter(|z| *z > 0.0).unwrap_or(1.0)
}

/// Points that the path explains.
fn points(
    builder: &Builder,
    lens: &Lens,
    scale: f64,
    used: &[usize],
) -> Vec<(Vec3, Vec<RangeInclusive<usize>>)> {
    let point = |mark: &Landmark| {
        let position = mark.position.filter(|_| is_explained(mark, builder, lens))?;
        let runs = mark.observations.chunk_by(|a, b| b.frame <= a.frame + 1);
        let stretch = |run: &[Observation]| Some(used[run.first()?.frame]..=used[run.last()?.frame]);
        Some(((position * scale).as_vec3(), runs.filter_map(stretch).collect()))
    };
    builder.landmarks.iter().filter_map(point).collect()
}

fn scaled(pose: &DAffine3, scale: f64) -> DAffine3 {
    DAffine3 { translation: pose.translation * scale, ..*pose }
}

fn double(pose: &Affine3A) -> DAffine3 {
    let turn = Quat::from_mat3a(&pose.matrix3).as_dquat().normalize();
    DAffine3::from_rotation_translation(turn, Vec3::from(pose.translation).as_dvec3())
}

fn single(pose: &DAffine3) -> Affine3A {
    let turn = DQuat::from_mat3(&pose.matrix3).normalize();
    let turn = Quat::from_xyzw(turn.x as f32, turn.y as f32, turn.z as f32, turn.w as f32).normalize();
    Affine3A::from_rotation_translation(turn, pose.translation.as_vec3())
}

/// Pose at `time` on the cubic through the four known poses around it, or [`beyond`] the ends.
fn pose_at(known: &[(f32, DAffine3)], time: f32) -> DAffine3 {
    let after = known.partition_point(|(t, _)| *t < time);
    if let Some((_, pose)) = known.get(after).filter(|(t, _)| *t == time) {
        return *pose;
    }
    let last = known.len() - 1;
    if after == 0 {
        return beyond(known[1.min(last)], known[0], time);
    }
    if after == known.len() {
        return beyond(known[last.saturating_sub(1)], known[last], time);
    }
    let around = &known[after.saturating_sub(2)..(after + 2).min(known.len())];
    let base = known[after - 1].1;
    let mut turn = DVec3::ZERO;
    let mut position = DVec3::ZERO;
    for (k, (t, pose)) in around.iter().enumerate() {
        let others = around.iter().enumerate().filter(|(j, _)| *j != k);
        let weight: f64 = others.map(|(_, (o, _))| f64::from(time - o) / f64::from(t - o)).product();
        let relative = DQuat::from_mat3(&(pose.matrix3 * base.matrix3.transpose()));
        turn += weight * relative.to_scaled_axis();
        position += weight * pose.inverse().translation;
    }
    let matrix3 = glam::DMat3::from_quat(DQuat::from_scaled_axis(turn) * DQuat::from_mat3(&base.matrix3));
    DAffine3 { matrix3, translation: -(matrix3 * position) }
}

/// Pose at `time` beyond the end of a path, whose last two poses are `inner` and `end`. Right after the end
/// it is farther on by a part of the step between them, and then it is the end itself.
fn beyond(inner: (f32, DAffine3), end: (f32, DAffine3), time: f32) -> DAffine3 {
    let ahead = f64::from(time - end.0) / f64::from(end.0 - inner.0);
    let (inner, end) = (inner.1, end.1);
    if !(0.0..=MOST_STEPS_BEYOND).contains(&ahead) {
        return end;
    }
    let share = GOES_ON * ahead;
    let turn = DQuat::from_mat3(&(end.matrix3 * inner.matrix3.transpose())).to_scaled_axis();
    let [before, position] = [inner, end].map(|pose| pose.inverse().translation);
    let matrix3 = glam::DMat3::from_quat(DQuat::from_scaled_axis(share * turn)) * end.matrix3;
    DAffine3 { matrix3, translation: -(matrix3 * (position + share * (position - before))) }
}
