//! Scores of marked names on every frame.

use super::{
    Evidence, Graph, Marks,
    cells::spread_over,
    guided::Guide,
    seeds::Seeds,
    seen::Seen,
    spread::{Hints, PULL, spread},
    trail::Trail,
};
use crate::{
    Result,
    camera::Camera,
    flow::{Vector, around, halved, luma},
    grid::{Grid, Mask},
    scene::Scene,
};
use image::RgbImage;
use rayon::prelude::*;
use std::{
    collections::BTreeMap,
    sync::{Arc, OnceLock},
};

/// Names whose shares are blended in one pass.
const NAMES_AT_ONCE: usize = 16;
/// Weight of the Gaussians' shares beside those of a marked frame that is seen well.
const GAUSSIANS: f32 = 0.01;
/// Difference between a pixel and the marked one at which it weighs half, 8-bit levels.
const DIFFERENCE: f32 = 8.0;
/// Half the side of the squares in which pictures are compared, px of half size.
const COMPARED_PX: usize = 2;
/// Weight of pixels of a marked frame that are not marked themselves.
const UNMARKED: f32 = 0.3;
/// Shortest side of pictures that are looked at, px; smaller ones are left to the Gaussians.
const SMALLEST: usize = 4;
/// Marked frames that are kept at most.
const MOST_KNOWN: usize = 8;
/// Frames that a marked frame is looked up from at most, on either side.
const REACH: usize = 100;

/// Parts of the method, each of which can be left out to measure it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CarrySettings {
    /// `true` to look marked frames up along the optical flow, `false` for the Gaussians' shares alone.
    pub looks_up: bool,
    /// `true` to compare each frame with the marked one itself, so that errors of the flow do not add up.
    pub mends: bool,
    /// `true` to move borders to those of the picture.
    pub refines: bool,
}

impl Default for CarrySettings {
    fn default() -> Self {
        Self { looks_up: true, mends: true, refines: true }
    }
}

/// Scores of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameScores {
    /// One image per name, 0–1: above one half where the name is likelier than any other and than none.
    pub scores: Vec<Grid<f32>>,
    /// Closeness of the two likeliest answers, 0 (sure) to 1.
    pub doubt: Grid<f32>,
}

/// The place where one more mark would help most.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LookHere {
    /// The frame.
    pub frame: usize,
    /// The middle of the most doubtful area on it, px.
    pub point_px: [f32; 2],
    /// Mean doubt inside the field of view, 0–1.
    pub doubt: f32,
}

/// Marks carried to a whole recording.
pub struct Carried {
    names: Vec<String>,
    settings: CarrySettings,
    /// Marks by frame: those frames on which marks say something.
    evidence: BTreeMap<usize, Evidence>,
    /// The same of the marks that grow.
    growing: BTreeMap<usize, Evidence>,
    /// Graph of the Gaussians that the marks are carried over.
    graph: Arc<Graph>,
    /// Share of each name in each Gaussian, [names][Gaussians], once something needs it: a marked frame does not.
    shares: OnceLock<Vec<Vec<f32>>>,
    /// Marked frames that were needed last.
    known: BTreeMap<usize, MarkedFrame>,
    /// Displacements to marked frames that are not known yet, found for earlier marks.
    trails: BTreeMap<usize, Trail>,
}

/// A marked frame at half size, with a share for every pixel.
struct MarkedFrame {
    luma: Grid<f32>,
    trail: Trail,
    /// Shares as its own marks tell, [names][pixels].
    own: Vec<Vec<f32>>,
    /// The same at full size, on the frame that became known last.
    whole: Option<Vec<Vec<f32>>>,
    /// `own` with what the marks of the frames beside it tell, once that was asked; `None` if there are none.
    told: Option<Vec<Vec<f32>>>,
    /// Weight of each pixel: 1 if it is marked.
    weights: Vec<f32>,
}

impl MarkedFrame {
    fn own(&self) -> &[Vec<f32>] {
        &self.own
    }

    /// Shares with what the frames beside it tell, if that was asked.
    fn told(&self) -> &[Vec<f32>] {
        self.told.as_ref().unwrap_or(&self.own)
    }

    /// Weight of this frame at each pixel of another one, from where `way` leads here; `of` is that of a pixel
    /// here if both look the same.
    fn weights_along(
        &self,
        way: &Grid<Vector>,
        luma: &Grid<f32>,
        field_of_view: &Mask,
        of: impl Fn(f32) -> f32 + Sync,
    ) -> Grid<f32> {
        let mut weights = likeness(luma, &self.luma, way, field_of_view);
        weights.data.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, weight)| {
            *weight *= place(way, i).map_or(0.0, |at| of(self.weights[at]));
        });
        weights
    }

    /// Mixes the shares of unmarked pixels with those of marked pixels of another frame, looked up along
    /// `way`.
    fn hear(&self, shares: &mut [Vec<f32>], other: &Self, way: &Grid<Vector>, field_of_view: &Mask) {
        let marked = |weight: f32| if weight > UNMARKED { weight } else { 0.0 };
        let mut weights = other.weights_along(way, &self.luma, field_of_view, marked);
        weights.data.iter_mut().zip(&self.weights).for_each(|(w, own)| {
            *w = if *own > UNMARKED { 0.0 } else { *w / (UNMARKED + *w) };
        });
        shares.par_iter_mut().zip(&other.own).for_each(|(plane, other)| {
            plane.iter_mut().zip(&weights.data).for_each(|(v, w)| *v *= 1.0 - w);
            add_seen(plane, other, way, &weights);
        });
    }
}

/// Returns the picture of a frame: the recorded one, or the reconstruction of it.
pub type Pictures<'a> = dyn FnMut(usize) -> Result<RgbImage> + 'a;

impl Carried {
    /// Takes marks on the recording of a scene that `graph` is of.
    pub fn new(scene: &Scene, graph: Arc<Graph>, marks: &Marks, settings: CarrySettings) -> Self {
        let names = marks.names();
        let evidence = Evidence::of_all(marks, &names, scene);
        let growing = Evidence::of_growing(marks, &evidence, &names, scene);
        let (known, trails) = (BTreeMap::new(), BTreeMap::new());
        Self { names, settings, evidence, growing, graph, shares: OnceLock::new(), known, trails }
    }

    /// Takes over the displacements that were found for earlier marks on the same recording. The scores stay
    /// the same and take less time.
    pub fn with_displacements_of(mut self, earlier: Self) -> Self {
        let found = earlier.known.into_iter().map(|(frame, known)| (frame, known.trail));
        let found = found.chain(earlier.trails).filter(|(frame, trail)| {
            self.evidence.contains_key(frame) && trail.mends() == self.settings.mends
        });
        self.trails = found.take(MOST_KNOWN).collect();
        self
    }

    /// Returns the names, in the order of the scores.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Returns the frames with marks that say something, ascending.
    pub fn frames(&self) -> impl Iterator<Item = usize> {
        self.evidence.keys().copied()
    }

    /// Returns the share of each name in each Gaussian, [names][Gaussians], 0–1.
    pub fn shares(&self, scene: &Scene) -> &[Vec<f32>] {
        self.shares.get_or_init(|| {
            let seeds = Seeds::of(scene, self.names.len(), self.evidence.values());
            let hints = Hints::of(&self.graph.links, &seeds, &[]);
            let mut shares = spread(&self.graph.links, &seeds, None, PULL, Some(&hints));
            // The solver stops a little beside the solution.
            shares.iter_mut().flatten().for_each(|share| *share = share.max(0.0));
            shares
        })
    }

    /// Returns the scores on a frame.
    pub fn on_frame(
        &mut self,
        scene: &Scene,
        frame: usize,
        pictures: &mut Pictures<'_>,
    ) -> Result<FrameScores> {
        let camera = scene.cameras[frame];
        let (width, height) = (camera.width as usize, camera.height as usize);
        if width.min(height) < SMALLEST {
            let scores = self.on_view(scene, camera, scene.time(frame));
            return Ok(FrameScores { scores, doubt: Grid::filled(width, height, 0.0) });
        }
        let picture = pictures(frame)?;
        let shares = if !self.settings.looks_up {
            self.blended(scene, &Seen::at_half(scene, frame))
        } else if self.evidence.contains_key(&frame) {
            self.tell(scene, frame, pictures)?;
            let known = self.known.get(&frame);
            if let Some(whole) = known.filter(|k| k.told.is_none()).and_then(|k| k.whole.as_ref()) {
                return Ok(scores(whole, width, height));
            }
            known.map(|known| known.told().to_vec()).unwrap_or_default()
        } else {
            let marked = beside(frame, &self.evidence);
            marked.iter().try_for_each(|marked| self.tell(scene, *marked, pictures))?;
            let mut shares = self.blended(scene, &Seen::at_half(scene, frame));
            let here = (frame, &luma_of(&picture));
            self.look_up(scene, here, &marked, MarkedFrame::told, &mut shares, pictures)?;
            shares
        };
        self.forget_far(frame);
        let mut shares = self.refined(picture, shares);
        if let Some(evidence) = self.evidence.get(&frame) {
            keep_marked(evidence, &mut shares);
        }
        Ok(scores(&shares, width, height))
    }

    /// Returns shares at full size, with borders where the picture has some.
    fn refined(&self, picture: RgbImage, shares: Vec<Vec<f32>>) -> Vec<Vec<f32>> {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        if self.settings.refines {
            let guide = Guide::new(picture);
            return shares.par_iter().map(|plane| guide.filter(plane)).collect();
        }
        let whole =
            |plane: Vec<f32>| Grid::from_vec(width / 2, height / 2, plane).sampled(width, height).data;
        shares.into_par_iter().map(whole).collect()
    }

    /// Returns the scores on any view, of the Gaussians alone.
    pub fn on_view(&self, scene: &Scene, camera: Camera, time: f32) -> Vec<Grid<f32>> {
        let shares = self.blended(scene, &Seen::of(scene, camera, time));
        scores(&shares, camera.width as usize, camera.height as usize).scores
    }

    /// Returns the Gaussians' shares of every pixel.
    fn blended(&self, scene: &Scene, seen: &Seen) -> Vec<Vec<f32>> {
        let shares = self.shares(scene);
        let mut planes = Vec::with_capacity(shares.len());
        for part in shares.chunks(NAMES_AT_ONCE) {
            let values: Vec<f32> =
                (0..part[0].len()).flat_map(|i| part.iter().map(move |share| share[i])).collect();
            let blended = seen.blend(&values, part.len());
            planes.extend((0..part.len()).map(|k| blended.value(k).to_vec()));
        }
        planes
    }

    /// Mixes the shares of a frame with those of marked frames (`shares_of` them), looked up from it.
    fn look_up(
        &mut self,
        scene: &Scene,
        (frame, luma_here): (usize, &Grid<f32>),
        marked: &[usize],
        shares_of: fn(&MarkedFrame) -> &[Vec<f32>],
        shares: &mut [Vec<f32>],
        pictures: &mut Pictures<'_>,
    ) -> Result<()> {
        marked.iter().try_for_each(|marked| self.know(scene, *marked, pictures))?;
        let mut total = vec![GAUSSIANS; luma_here.data.len()];
        shares.iter_mut().flatten().for_each(|v| *v *= GAUSSIANS);
        // The nearer of two weighs more.
        let far: usize = marked.iter().map(|f| f.abs_diff(frame)).sum();
        for &marked_frame in marked {
            let away = marked_frame.abs_diff(frame) as f32 / far.max(1) as f32;
            let near = if marked.len() < 2 { 1.0 } else { 1.0 - away };
            let Some(known) = self.known.get_mut(&marked_frame) else { continue };
            let way = known.trail.way(frame, &mut |i| Ok(luma_of(&pictures(i)?)))?;
            let weights = known.weights_along(&way, luma_here, &scene.field_of_view, |weight| near * weight);
            shares.par_iter_mut().zip(shares_of(known)).for_each(|(plane, marked)| {
                add_seen(plane, marked, &way, &weights);
            });
            total.iter_mut().zip(&weights.data).for_each(|(t, w)| *t += w);
        }
        shares.par_iter_mut().for_each(|plane| plane.iter_mut().zip(&total).for_each(|(v, t)| *v /= t));
        Ok(())
    }

    /// Carries the marked pixels of the frames beside a marked one to it.
    fn tell(&mut self, scene: &Scene, frame: usize, pictures: &mut Pictures<'_>) -> Result<()> {
        self.know(scene, frame, pictures)?;
        let Some(known) = self.known.get(&frame).filter(|known| known.told.is_none()) else { return Ok(()) };
        let others = beside(frame, &self.evidence);
        if others.is_empty() {
            return Ok(());
        }
        let mut told = known.own.clone();
        for other in others {
            self.know(scene, other, pictures)?;
            let Some(teller) = self.known.get_mut(&other) else { continue };
            let way = teller.trail.way(frame, &mut |i| Ok(luma_of(&pictures(i)?)))?;
            if let (Some(known), Some(teller)) = (self.known.get(&frame), self.known.get(&other)) {
                known.hear(&mut told, teller, &way, &scene.field_of_view);
            }
        }
        self.known.entry(frame).and_modify(|known| known.told = Some(told));
        Ok(())
    }

    /// Makes a marked frame known: spreads the marks over it that grow, or looks up what other frames tell of
    /// it if there are none, and sets what is marked.
    fn know(&mut self, scene: &Scene, frame: usize, pictures: &mut Pictures<'_>) -> Result<()> {
        if self.known.contains_key(&frame) {
            return Ok(());
        }
        let picture = pictures(frame)?;
        let luma = luma_of(&picture);
        let spread = if let Some(growing) = self.growing.get(&frame) {
            spread_over(&picture, &scene.field_of_view, growing, self.names.len())
        } else {
            let mut shares = self.blended(scene, &Seen::at_half(scene, frame));
            let growing = beside(frame, &self.growing);
            self.look_up(scene, (frame, &luma), &growing, MarkedFrame::own, &mut shares, pictures)?;
            shares
        };
        let evidence = &self.evidence[&frame];
        let [whole_width, whole_height] = [picture.width(), picture.height()].map(|side| side as usize);
        let mut shares = self.refined(picture, spread);
        keep_marked(evidence, &mut shares);
        let half = |plane: &Vec<f32>| halved(&Grid::from_vec(whole_width, whole_height, plane.clone())).data;
        let own = shares.par_iter().map(half).collect();
        let mut weights = vec![UNMARKED; luma.data.len()];
        for i in evidence.pixels() {
            let (x, y) = (i % whole_width / 2, i / whole_width / 2);
            weights[y.min(luma.height - 1) * luma.width + x.min(luma.width - 1)] = 1.0;
        }
        let earlier = self.trails.remove(&frame);
        let trail = earlier.unwrap_or_else(|| Trail::new(frame, luma.clone(), self.settings.mends));
        // At full size they take much memory, and are wanted of the shown frame alone.
        self.known.values_mut().for_each(|known| known.whole = None);
        self.known.insert(frame, MarkedFrame { luma, trail, own, whole: Some(shares), told: None, weights });
        Ok(())
    }

    /// Forgets marked frames that are far away, so that memory does not grow with the recording.
    fn forget_far(&mut self, frame: usize) {
        while self.known.len() > MOST_KNOWN {
            let farthest = self.known.keys().copied().max_by_key(|f| (f.abs_diff(frame), *f));
            farthest.and_then(|farthest| self.known.remove(&farthest));
        }
    }

    /// Returns the place where one more mark would help most: on the frame with most pixels in doubt, without
    /// those that are marked, and without those of other chapters. `None` if every frame is marked.
    pub fn look_here(&mut self, scene: &Scene, pictures: &mut Pictures<'_>) -> Result<Option<LookHere>> {
        let mut best: Option<LookHere> = None;
        for frame in scene.frames_here().filter(|f| !self.evidence.contains_key(f)).collect::<Vec<_>>() {
            let here = self.on_frame(scene, frame, pictures)?.look_here(frame, &scene.field_of_view);
            if best.as_ref().is_none_or(|best| here.doubt > best.doubt) {
                best = Some(here);
            }
        }
        Ok(best)
    }
}

/// Sets marked pixels to what the marks say. Shares that are denied go to the other names and to none.
pub(super) fn keep_marked(evidence: &Evidence, shares: &mut [Vec<f32>]) {
    for i in evidence.pixels() {
        let denied: f32 =
            (0..shares.len()).filter(|k| evidence.at(i, *k) == (1.0, 0.0)).map(|k| shares[k][i]).sum();
        for (k, plane) in shares.iter_mut().enumerate() {
            plane[i] = match evidence.at(i, k) {
                (1.0, marked) => marked,
                _ => (plane[i] / (1.0 - denied).max(f32::EPSILON)).clamp(0.0, 1.0),
            };
        }
    }
}

/// Returns the luminance of a picture at half size, 0–255.
fn luma_of(picture: &RgbImage) -> Grid<f32> {
    halved(&luma(picture))
}

/// Returns the nearest of `frames` on either side of a frame, as far as it is looked.
fn beside(frame: usize, frames: &BTreeMap<usize, Evidence>) -> Vec<usize> {
    let before = frames.range(..frame).next_back();
    let after = frames.range(frame + 1..).next();
    let both = before.into_iter().chain(after).map(|(marked, _)| *marked);
    both.filter(|marked| marked.abs_diff(frame) <= REACH).collect()
}

/// Returns the pixel that the way of pixel `i` leads to, if that is in the picture.
fn place(way: &Grid<Vector>, i: usize) -> Option<usize> {
    let (width, height) = (way.width, way.height);
    let [x, y] = [(i % width) as f32 + way.data[i][0], (i / width) as f32 + way.data[i][1]];
    let is_inside = x >= -0.5 && y >= -0.5 && x < width as f32 - 0.5 && y < height as f32 - 0.5;
    is_inside.then(|| (y + 0.5) as usize * width + (x + 0.5) as usize)
}

/// Likeness of a frame and another one, seen along `way`, around each pixel, 0–1; 0 where the way leads out
/// of the field of view.
fn likeness(luma: &Grid<f32>, other: &Grid<f32>, way: &Grid<Vector>, field_of_view: &Mask) -> Grid<f32> {
    let (width, height) = (way.width, way.height);
    let field_of_view = field_of_view.sampled(width, height);
    let seen = |i: usize| place(way, i).filter(|at| field_of_view.data.get(*at).is_none_or(|v| *v));
    let mut differences = vec![0.0; width * height];
    differences.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, d)| {
        *d = seen(i).map_or(255.0, |at| (luma.data[i] - other.data[at]).abs());
    });
    let mut likeness = box_means(&differences, width, height);
    likeness.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, v)| {
        *v = if seen(i).is_some() { 1.0 / (1.0 + (*v / DIFFERENCE).powi(2)) } else { 0.0 };
    });
    Grid::from_vec(width, height, likeness)
}

/// Means over squares of 2 [`COMPARED_PX`] + 1 pixels, cut at the border.
fn box_means(values: &[f32], width: usize, height: usize) -> Vec<f32> {
    let mut rows = vec![0.0; values.len()];
    rows.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
        let line = &values[y * width..(y + 1) * width];
        for (x, v) in row.iter_mut().enumerate() {
            let window = &line[x.saturating_sub(COMPARED_PX)..(x + COMPARED_PX + 1).min(width)];
            *v = window.iter().sum::<f32>() / window.len() as f32;
        }
    });
    let mut out = vec![0.0; values.len()];
    out.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
        let window = y.saturating_sub(COMPARED_PX)..(y + COMPARED_PX + 1).min(height);
        let lines = window.len() as f32;
        for other in window {
            row.iter_mut().zip(&rows[other * width..(other + 1) * width]).for_each(|(o, v)| *o += v / lines);
        }
    });
    out
}

/// Adds weight · marked(x + way) to every pixel x.
fn add_seen(plane: &mut [f32], marked: &[f32], way: &Grid<Vector>, weights: &Grid<f32>) {
    let width = way.width;
    for (i, value) in plane.iter_mut().enumerate() {
        let [u, v] = way.data[i];
        let place = [(i % width) as f32 + u, (i / width) as f32 + v];
        let (offsets, parts) = around(width, way.height, place);
        let seen: f32 = offsets.iter().zip(parts).map(|(offset, part)| part * marked[*offset]).sum();
        *value += weights.data[i] * seen;
    }
}

/// Turns shares into scores: p / (p + the largest of the others), nothing being one of them.
fn scores(shares: &[Vec<f32>], width: usize, height: usize) -> FrameScores {
    let pixels = width * height;
    let mut planes = vec![vec![0.0; pixels]; shares.len()];
    let mut doubt = vec![0.0; pixels];
    for i in 0..pixels {
        let none = (1.0 - shares.iter().map(|plane| plane[i]).sum::<f32>()).max(0.0);
        // The two largest, and the place of the largest.
        let (mut first, mut second, mut place) = (none, 0.0, usize::MAX);
        for (k, plane) in shares.iter().enumerate() {
            if plane[i] > first {
                (second, first, place) = (first, plane[i], k);
            } else if plane[i] > second {
                second = plane[i];
            }
        }
        for (k, plane) in planes.iter_mut().enumerate() {
            let (own, other) = (shares[k][i], if k == place { second } else { first });
            plane[i] = if own > 0.0 { own / (own + other) } else { 0.0 };
        }
        doubt[i] = 1.0 - (first - second);
    }
    let grid = |data| Grid::from_vec(width, height, data);
    FrameScores { scores: planes.into_iter().map(grid).collect(), doubt: grid(doubt) }
}

/// Side of the squares whose mean doubt is compared, px.
const LOOKED_AT_PX: usize = 32;

impl FrameScores {
    /// Returns the place on a frame with these scores where one more mark would help most. Pixels outside
    /// the field of view, which `keep` is, do not count.
    pub fn look_here(&self, frame: usize, keep: &Mask) -> LookHere {
        let doubt = &self.doubt;
        let (width, height) = (doubt.width, doubt.height);
        let columns = width.div_ceil(LOOKED_AT_PX);
        let mut sums = vec![0.0_f32; columns * height.div_ceil(LOOKED_AT_PX)];
        for (i, doubt) in doubt.data.iter().enumerate().filter(|(i, _)| keep.data.get(*i).is_none_or(|v| *v))
        {
            sums[i / width / LOOKED_AT_PX * columns + i % width / LOOKED_AT_PX] += doubt;
        }
        let total: f32 = sums.iter().sum();
        let best = (0..sums.len()).max_by(|a, b| sums[*a].total_cmp(&sums[*b])).unwrap_or(0);
        let middle =
            |cell: usize, size: usize| ((cell * LOOKED_AT_PX + LOOKED_AT_PX / 2).min(size - 1)) as f32 + 0.5;
        LookHere {
            frame,
            point_px: [middle(best % columns, width), middle(best / columns, height)],
            doubt: total / keep.count().max(1) as f32,
        }
    }
}
