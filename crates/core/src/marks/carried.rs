//! Scores of marked names on every frame.

use super::{
    Evidence, FrameScores, Graph, LookHere, Marks,
    cells::{CellFeatures, MarkedPicture, spread_over},
    flow_to_marked::FlowToMarked,
    frame_cache::FrameCache,
    frame_splats::FrameSplats,
    guided::GuidedFilter,
    hints::{GuideShares, Hints},
    looks::{Looks, MAX_NAMES},
    marked_frame::{HalfFrame, MarkedFrame, at_full_size, at_half, flow_target, likeness, luma_of, weights},
    mix::{Known, Mix},
    plan::{Plan, beside},
    scores::scores,
    seeds::Seeds,
    spread::{Before, PULL, spread},
};
use crate::{Result, camera::Camera, flow::halved, grid::Grid, scene::Scene};
use image::RgbImage;
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

/// Names whose shares are blended in one pass.
const NAMES_AT_ONCE: usize = 16;
/// Weight of the Gaussians' shares, beside 1 for a marked frame that looks the same.
const GAUSSIAN_WEIGHT: f32 = 0.01;
/// Weight of shares that are told by looks, where these are certain; and where depth is part of the looks.
const LOOKS_WEIGHT: f32 = 0.07;
const LOOKS_WEIGHT_WITH_DEPTH: f32 = 0.2;
/// Weight of guides where a frame shows all names itself, relative to any other frame.
const GUIDE_WEIGHT_BESIDE_ALL_NAMES: f32 = 0.2;
/// Likeness of two frames around a pixel above which a mark is propagated; small, because instruments shine
/// differently on each frame.
const MIN_PROPAGATION_WEIGHT: f32 = 0.05;
/// Likeness of appearance above which a marked pixel and the pixel it is propagated to look the same.
const MIN_APPEARANCE_LIKENESS: f32 = 0.78;
/// Part of the marked pixels of a name that have to be found on a frame; with fewer, the name is not there.
const MIN_FOUND_PART: f32 = 0.3;
/// Shortest side of pictures that are segmented, px; smaller ones are left to the Gaussians.
const MIN_SIDE_PX: usize = 4;

/// Parts of the method, each of which can be left out to measure it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CarrySettings {
    /// `true` to look up marked frames along the optical flow, `false` for the Gaussians' shares alone.
    pub uses_flow: bool,
    /// `true` to compare each frame with the marked one itself, so that errors of the flow do not add up.
    pub corrects_drift: bool,
    /// `true` to move borders to those of the picture.
    pub refines_borders: bool,
}

impl Default for CarrySettings {
    fn default() -> Self {
        Self { uses_flow: true, corrects_drift: true, refines_borders: true }
    }
}

/// Marks carried to a whole recording.
pub struct Carried {
    names: Vec<String>,
    settings: CarrySettings,
    /// Marks by frame: those frames on which marks say something.
    evidence: BTreeMap<usize, Evidence>,
    /// The same of the marks that grow.
    growing: BTreeMap<usize, Evidence>,
    plan: Plan,
    /// Names that outlines show all of, with the frame.
    outlined: BTreeSet<(String, usize)>,
    /// Graph of the Gaussians that the marks are carried over.
    graph: Arc<Graph>,
    /// Share of each name in each Gaussian, [names][Gaussians], once something needs it: a marked frame does not.
    shares: Option<Vec<Vec<f32>>>,
    cache: FrameCache,
}

/// A frame that marked frames are looked up from.
#[derive(Clone, Copy)]
struct Lookup<'a> {
    frame: usize,
    /// The frame at half size.
    half: &'a HalfFrame,
    /// The marked frames, at most one on each side.
    marked: &'a [usize],
    /// `true` to take their shares with those of their neighbours, `false` to take their own alone.
    with_neighbours: bool,
}

/// Returns the picture of a frame: the recorded one, or the reconstruction of it.
pub type Pictures<'a> = dyn FnMut(usize) -> Result<RgbImage> + 'a;

impl Carried {
    /// Takes marks on the recording of a scene that `graph` is of. Names that no mark shows do not count.
    pub fn new(scene: &Scene, graph: Arc<Graph>, marks: &Marks, settings: CarrySettings) -> Self {
        let names = marks.shown_names();
        let evidence = Evidence::of_all(marks, &names, scene);
        let (growing, pointed) = Evidence::of_growing(marks, &evidence, &names, scene);
        let plan = Plan::of(&growing, &pointed, names.len());
        let outlined = marks.outlined(scene);
        let cache = FrameCache::default();
        Self { names, settings, evidence, growing, plan, outlined, graph, shares: None, cache }
    }

    /// Takes over what was found for earlier marks on the same recording and still holds: frames whose marks
    /// and guides are the same, and flows. The scores are the same and take less time.
    pub fn after(mut self, earlier: Self) -> Self {
        let is_same = self.names == earlier.names
            && self.settings == earlier.settings
            && Arc::ptr_eq(&self.graph, &earlier.graph);
        let is_marked_so = |frame: &usize| {
            self.evidence.get(frame) == earlier.evidence.get(frame)
                && self.growing.get(frame).is_some_and(|own| Some(own) == earlier.growing.get(frame))
                && self.plan.has_same_place_as(&earlier.plan, *frame)
        };
        let holds = |frame: usize| is_same && self.plan.with_sources(frame).iter().all(is_marked_so);
        let is_wanted = |frame: usize, flow: &FlowToMarked| {
            let corrects_drift = self.settings.corrects_drift;
            self.evidence.contains_key(&frame) && flow.corrects_drift() == corrects_drift
        };
        self.cache.take_over(earlier.cache, holds, is_wanted);
        for (frame, marked) in self.cache.frames_mut() {
            marked.shares_with_neighbours = None;
            marked.known_names = self.plan.known_names(frame, &marked.propagated_names);
        }
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

    /// Returns the share of each name in each Gaussian, [names][Gaussians], 0–1. Marks that grow are spread over
    /// their frames first.
    pub fn shares(&mut self, scene: &Scene, pictures: &mut Pictures<'_>) -> Result<&[Vec<f32>]> {
        if self.names.is_empty() {
            return Ok(&[]);
        }
        if self.shares.is_none() {
            let mut seeds = Seeds::none(scene, self.names.len());
            for frame in self.evidence.keys().copied().collect::<Vec<_>>() {
                if self.growing.contains_key(&frame) && is_large_enough(scene) {
                    self.segment_frame(scene, frame, pictures)?;
                    if let Some(marked) = self.cache.get(frame) {
                        marked.seed(&mut seeds, scene, frame);
                    }
                    self.cache.evict_far(frame);
                } else {
                    seeds.add(scene, &self.evidence[&frame]);
                }
            }
            let hints = Hints::of(&self.graph.appearance, &self.graph.links, &seeds, &[]);
            let mut shares = spread(&self.graph.links, &seeds, Before::Nothing, PULL, Some(&hints));
            // The solver stops close to the solution, which can be a little below 0.
            shares.iter_mut().flatten().for_each(|share| *share = share.max(0.0));
            self.shares = Some(shares);
        }
        Ok(self.shares.as_deref().unwrap_or_default())
    }

    /// Returns the scores on a frame. A name that outlines show all of there ends where they end.
    pub fn on_frame(
        &mut self,
        scene: &Scene,
        frame: usize,
        pictures: &mut Pictures<'_>,
    ) -> Result<FrameScores> {
        let mut found = self.scores_before_outlines(scene, frame, pictures)?;
        if let Some(evidence) = self.evidence.get(&frame) {
            let is_outlined = |k: &usize| self.outlined.contains(&(self.names[*k].clone(), frame));
            for k in (0..self.names.len()).filter(is_outlined) {
                for (pixels, _) in evidence.runs().filter(|(_, verdicts)| verdicts.of(k).1 == 0.0) {
                    found.scores[k].data[pixels].fill(0.0);
                }
            }
        }
        Ok(found)
    }

    fn scores_before_outlines(
        &mut self,
        scene: &Scene,
        frame: usize,
        pictures: &mut Pictures<'_>,
    ) -> Result<FrameScores> {
        let camera = scene.cameras[frame];
        let (width, height) = (camera.width as usize, camera.height as usize);
        if self.names.is_empty() {
            return Ok(scores(&[], width, height));
        }
        if !is_large_enough(scene) {
            let scores = self.on_view(scene, camera, scene.time(frame), pictures)?;
            return Ok(FrameScores { scores, doubt: Grid::filled(width, height, 0.0) });
        }
        // First of all: it segments all marked frames, and the cache may evict those that are needed here.
        if !self.growing.contains_key(&frame) || self.growing.len() < self.evidence.len() {
            self.shares(scene, pictures)?;
        }
        let picture = pictures(frame)?;
        let shares = if !self.settings.uses_flow {
            self.blended(scene, &FrameSplats::at_half(scene, frame), pictures)?
        } else if self.evidence.contains_key(&frame) {
            self.blend_neighbours(scene, frame, pictures)?;
            let here = self.cache.get(frame);
            let alone = here.filter(|here| here.shares_with_neighbours.is_none());
            if let Some(shares) = alone.and_then(|here| here.full_size_shares.as_ref()) {
                return Ok(scores(shares, width, height));
            }
            here.map(|here| here.shares().to_vec()).unwrap_or_default()
        } else {
            let marked = beside(frame, &self.evidence);
            marked.iter().try_for_each(|marked| self.blend_neighbours(scene, *marked, pictures))?;
            let half = HalfFrame::of(scene, frame, &picture);
            let lookup = Lookup { frame, half: &half, marked: &marked, with_neighbours: true };
            let mut mix = self.gaussians_and_flow(scene, lookup, pictures)?;
            self.tell_by_looks(scene, &picture, lookup, &mut mix, pictures)?;
            mix.finish().0
        };
        self.cache.evict_far(frame);
        let mut shares = self.refined(picture, shares);
        if let Some(evidence) = self.evidence.get(&frame) {
            keep_marked(evidence, &mut shares);
        }
        Ok(scores(&shares, width, height))
    }

    /// Returns shares at full size, with borders where the picture has some.
    fn refined(&self, picture: RgbImage, shares: Vec<Vec<f32>>) -> Vec<Vec<f32>> {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        if self.settings.refines_borders {
            let filter = GuidedFilter::new(picture);
            return shares.par_iter().map(|plane| filter.filter(plane)).collect();
        }
        let full_size =
            |plane: Vec<f32>| Grid::from_vec(width / 2, height / 2, plane).sampled(width, height).data;
        shares.into_par_iter().map(full_size).collect()
    }

    /// Returns the scores on any view, of the Gaussians alone.
    pub fn on_view(
        &mut self,
        scene: &Scene,
        camera: Camera,
        time: f32,
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<Grid<f32>>> {
        let shares = self.blended(scene, &FrameSplats::of(scene, camera, time), pictures)?;
        Ok(scores(&shares, camera.width as usize, camera.height as usize).scores)
    }

    /// Returns the Gaussians' shares of every pixel.
    fn blended(
        &mut self,
        scene: &Scene,
        splats: &FrameSplats,
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<Vec<f32>>> {
        let shares = self.shares(scene, pictures)?;
        let mut planes = Vec::with_capacity(shares.len());
        for part in shares.chunks(NAMES_AT_ONCE) {
            let values: Vec<f32> =
                (0..part[0].len()).flat_map(|i| part.iter().map(move |share| share[i])).collect();
            let blended = splats.blend(&values, part.len());
            planes.extend((0..part.len()).map(|k| blended.value(k).to_vec()));
        }
        Ok(planes)
    }

    /// Mixes the Gaussians' shares of a frame with those that are looked up in marked frames.
    fn gaussians_and_flow(
        &mut self,
        scene: &Scene,
        lookup: Lookup<'_>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Mix> {
        let shares = self.blended(scene, &FrameSplats::at_half(scene, lookup.frame), pictures)?;
        let mut mix = Mix::of(&shares, |_, _| GAUSSIAN_WEIGHT);
        self.look_up(scene, lookup, &mut mix, pictures)?;
        Ok(mix)
    }

    /// Adds the shares that are looked up in marked frames to those of a frame.
    fn look_up(
        &mut self,
        scene: &Scene,
        lookup: Lookup<'_>,
        mix: &mut Mix,
        pictures: &mut Pictures<'_>,
    ) -> Result<()> {
        let Lookup { frame, half, marked, with_neighbours } = lookup;
        marked.iter().try_for_each(|marked| self.segment_frame(scene, *marked, pictures))?;
        for &marked_frame in marked {
            let Some(other) = self.cache.get_mut(marked_frame) else { continue };
            let flow = other.flows.flow(frame, &mut |i| Ok(luma_of(&pictures(i)?)))?;
            let near = nearness(frame, marked_frame, marked);
            let weights = other.lookup_weights(&flow, half, &scene.field_of_view, |weight| near * weight);
            let source = match &other.shares_with_neighbours {
                Some(blended) if with_neighbours => (blended.as_slice(), &Known::all(blended.len())),
                _ => (other.own_shares.as_slice(), &other.known()),
            };
            mix.add_along(source, &flow, &weights);
        }
        Ok(())
    }

    /// Adds the shares that the looks of marked frames tell to those of a frame.
    fn tell_by_looks(
        &mut self,
        scene: &Scene,
        picture: &RgbImage,
        lookup: Lookup<'_>,
        mix: &mut Mix,
        pictures: &mut Pictures<'_>,
    ) -> Result<()> {
        if self.names.len() > MAX_NAMES {
            return Ok(());
        }
        let Lookup { frame, half, marked, .. } = lookup;
        let cells = CellFeatures::of(picture, half.log_depths.as_deref());
        let weight = if half.log_depths.is_some() { LOOKS_WEIGHT_WITH_DEPTH } else { LOOKS_WEIGHT };
        for &marked_frame in marked {
            let Some(other) = self.cache.get_mut(marked_frame) else { continue };
            if other.looks.is_none() {
                let cells = CellFeatures::of(&pictures(marked_frame)?, other.half.log_depths.as_deref());
                other.looks = Some(Looks::of(&cells, &scene.field_of_view, &other.own_shares));
            }
            let Some(told) = other.looks.as_ref().map(|looks| looks.tell(&cells)) else { continue };
            let known = Known { names: other.known_names.clone(), others: told.sums() };
            let weight = weight * nearness(frame, marked_frame, marked);
            mix.add(&told.shares, |name, i| weight * told.certainty[i] * known.of(name, i));
        }
        Ok(())
    }

    /// Returns the shares that the guides of a frame give it: along the flow and by looks; `None` if it has no
    /// guides.
    fn guide_shares(
        &mut self,
        scene: &Scene,
        (frame, picture, half): (usize, &RgbImage, &HalfFrame),
        pictures: &mut Pictures<'_>,
    ) -> Result<Option<GuideShares>> {
        let guides = self.plan.guides(frame).to_vec();
        if guides.is_empty() || !self.settings.uses_flow {
            return Ok(None);
        }
        let mut mix = Mix::nothing(self.names.len(), half.luma.data.len());
        let lookup = Lookup { frame, half, marked: &guides, with_neighbours: false };
        self.look_up(scene, lookup, &mut mix, pictures)?;
        self.tell_by_looks(scene, picture, lookup, &mut mix, pictures)?;
        let (shares, mut weights) = mix.finish();
        if self.plan.shows_all(frame) {
            weights.iter_mut().flatten().for_each(|weight| *weight *= GUIDE_WEIGHT_BESIDE_ALL_NAMES);
        }
        Ok(Some(GuideShares { shares, weights }))
    }

    /// Returns the names that were propagated to the guides of a frame.
    fn propagated_to_guides(&self, frame: usize) -> BTreeSet<usize> {
        let guides = self.plan.guides(frame).iter().filter_map(|guide| self.cache.get(*guide));
        guides.flat_map(|guide| guide.propagated_names.iter().copied()).collect()
    }

    /// Propagates marks of names that neither a frame nor its guides know to the frame; `propagated_names` are
    /// those that were propagated to the guides. Returns pixels of its picture, each with the name that it
    /// shows. A name of which too few marked pixels lead to pixels that look the same is taken to be not in
    /// view.
    fn propagate(
        &mut self,
        scene: &Scene,
        (frame, picture, luma): (usize, &RgbImage, &Grid<f32>),
        propagated_names: &BTreeSet<usize>,
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<(usize, usize)>> {
        let (mut propagated, settings) = (Vec::new(), self.settings);
        let mut sources =
            if settings.uses_flow { self.plan.propagation_sources(frame) } else { BTreeMap::new() };
        sources.values_mut().for_each(|names| names.retain(|name| !propagated_names.contains(name)));
        sources.retain(|_, names| !names.is_empty());
        if sources.is_empty() {
            return Ok(propagated);
        }
        let here = CellFeatures::of(picture, None);
        let width = picture.width() as usize;
        for (source, names) in sources {
            let (evidence, picture) = (&self.growing[&source], pictures(source)?);
            let flows = self.cache.flow_to(frame, luma, settings.corrects_drift);
            let flow = flows.flow(source, &mut |i| Ok(luma_of(&pictures(i)?)))?;
            let weights = likeness(&luma_of(&picture), luma, &flow, &scene.field_of_view);
            let there = CellFeatures::of(&picture, None);
            // Number of marked pixels of each name, and the pixels here that look the same.
            let mut found: BTreeMap<usize, (usize, Vec<usize>)> = BTreeMap::new();
            let shown = evidence.shown().filter(|(_, name)| names.contains(name));
            for (i, name) in shown.flat_map(|(pixels, name)| pixels.map(move |i| (i, name))) {
                let (count, pixels) = found.entry(name).or_default();
                *count += 1;
                let from = at_half(i, width, [luma.width, luma.height]);
                let to = flow_target(&flow, from).filter(|_| weights.data[from] > MIN_PROPAGATION_WEIGHT);
                let to = to.map(|to| at_full_size(to, width, luma.width));
                pixels.extend(to.filter(|to| there.likeness(i, &here, *to) > MIN_APPEARANCE_LIKENESS));
            }
            for (name, (count, pixels)) in found {
                if pixels.len() as f32 > MIN_FOUND_PART * count as f32 {
                    propagated.extend(pixels.into_iter().map(|pixel| (pixel, name)));
                }
            }
        }
        Ok(propagated)
    }

    /// Mixes the shares of a marked frame with those of the nearest marked frame on each side.
    fn blend_neighbours(&mut self, scene: &Scene, frame: usize, pictures: &mut Pictures<'_>) -> Result<()> {
        self.segment_frame(scene, frame, pictures)?;
        let here = self.cache.get(frame).filter(|here| here.shares_with_neighbours.is_none());
        let Some(here) = here else { return Ok(()) };
        let neighbours = beside(frame, &self.evidence);
        if neighbours.is_empty() {
            // Without neighbours, the frame is shown as it was segmented at full size.
            let has_shares = here.full_size_shares.is_some();
            return if has_shares { Ok(()) } else { self.segment_again(scene, frame, pictures) };
        }
        let mut shares = here.own_shares.clone();
        if !here.knows_all_names() {
            let (half, known) = (here.half.clone(), here.known());
            let growing = beside(frame, &self.growing);
            let lookup = Lookup { frame, half: &half, marked: &growing, with_neighbours: false };
            let mut mix = Mix::of(&shares, |name, i| known.of(name, i));
            self.look_up(scene, lookup, &mut mix, pictures)?;
            shares = mix.finish().0;
        }
        for other in neighbours {
            self.segment_frame(scene, other, pictures)?;
            let Some(neighbour) = self.cache.get_mut(other) else { continue };
            let flow = neighbour.flows.flow(frame, &mut |i| Ok(luma_of(&pictures(i)?)))?;
            if let (Some(here), Some(neighbour)) = (self.cache.get(frame), self.cache.get(other)) {
                here.blend_neighbour(&mut shares, neighbour, &flow, &scene.field_of_view);
            }
        }
        if let Some(here) = self.cache.get_mut(frame) {
            here.shares_with_neighbours = Some(shares);
        }
        Ok(())
    }

    /// Segments a marked frame, unless that is done: spreads the marks over it that grow or, if there are
    /// none, looks up its shares in other frames. Then sets what is marked.
    fn segment_frame(&mut self, scene: &Scene, frame: usize, pictures: &mut Pictures<'_>) -> Result<()> {
        if self.cache.contains(frame) {
            return Ok(());
        }
        let picture = pictures(frame)?;
        let half = HalfFrame::of(scene, frame, &picture);
        let guides = self.guide_shares(scene, (frame, &picture, &half), pictures)?;
        let mut propagated_names = self.propagated_to_guides(frame);
        let propagated = self.propagate(scene, (frame, &picture, &half.luma), &propagated_names, pictures)?;
        propagated_names.extend(propagated.iter().map(|(_, name)| *name));
        let segmented = if let Some(growing) = self.growing.get(&frame) {
            let marked = MarkedPicture {
                picture: &picture,
                field_of_view: &scene.field_of_view,
                log_depths: half.log_depths.as_deref(),
            };
            spread_over(&marked, growing, &propagated, self.names.len(), guides)
        } else {
            let growing = beside(frame, &self.growing);
            let lookup = Lookup { frame, half: &half, marked: &growing, with_neighbours: false };
            self.gaussians_and_flow(scene, lookup, pictures)?.finish().0
        };
        let evidence = &self.evidence[&frame];
        let [width, height] = [picture.width(), picture.height()].map(|side| side as usize);
        let mut shares = self.refined(picture, segmented);
        keep_marked(evidence, &mut shares);
        let shrunk = |plane: &Vec<f32>| halved(&Grid::from_vec(width, height, plane.clone())).data;
        let own_shares = shares.par_iter().map(shrunk).collect();
        let weights = weights(evidence, &half.luma, width);
        let flows = self.cache.take_flow(frame, &half.luma, self.settings.corrects_drift);
        let known_names = self.plan.known_names(frame, &propagated_names);
        let marked = MarkedFrame {
            half,
            flows,
            own_shares,
            full_size_shares: Some(shares),
            shares_with_neighbours: None,
            weights,
            propagated_names,
            known_names,
            looks: None,
        };
        self.cache.insert(frame, marked);
        Ok(())
    }

    /// Segments a frame again that lost its shares at full size.
    fn segment_again(&mut self, scene: &Scene, frame: usize, pictures: &mut Pictures<'_>) -> Result<()> {
        self.cache.keep_flow_alone(frame);
        self.segment_frame(scene, frame, pictures)
    }

    /// Returns the most doubtful place of each frame that is not marked, in the order of frames;
    /// [`LookHere::best`] is where one more mark would help most. Frames of other chapters do not count.
    pub fn in_doubt(&mut self, scene: &Scene, pictures: &mut Pictures<'_>) -> Result<Vec<LookHere>> {
        let frames: Vec<usize> = scene.frames_here().filter(|f| !self.evidence.contains_key(f)).collect();
        let on_frame = |frame: usize| -> Result<LookHere> {
            Ok(self.on_frame(scene, frame, pictures)?.look_here(frame, &scene.field_of_view))
        };
        frames.into_iter().map(on_frame).collect()
    }
}

/// Sets marked pixels to what the marks say. Other names keep their lead over what is denied.
pub(super) fn keep_marked(evidence: &Evidence, shares: &mut [Vec<f32>]) {
    for (pixels, verdicts) in evidence.said() {
        let said: Vec<(f32, f32)> = (0..shares.len()).map(|k| verdicts.of(k)).collect();
        for i in pixels {
            let sum = |is_denied: bool| -> f32 {
                let each = shares.iter().zip(&said).filter(|(_, said)| (**said == (1.0, 0.0)) == is_denied);
                each.map(|(plane, _)| plane[i]).sum()
            };
            let scale = scale_beside_denied(sum(false), sum(true));
            for (plane, said) in shares.iter_mut().zip(&said) {
                plane[i] = match *said {
                    (1.0, marked) => marked,
                    _ => (plane[i] * scale).clamp(0.0, 1.0),
                };
            }
        }
    }
}

/// Returns the factor of the shares of names, `kept` together, beside names that lost `denied` to marks that
/// say "not this". What is lost and what no name has do not add up: the larger of both is what no name has
/// from now on. So the other names lead over it as they led over the denied names.
pub(super) fn scale_beside_denied(kept: f32, denied: f32) -> f32 {
    let none = (1.0 - kept - denied).max(denied);
    1.0 / (kept + none).max(f32::EPSILON)
}

/// Returns the weight of a marked frame beside the others that a frame is looked up in: the nearer of two
/// weighs more.
fn nearness(frame: usize, marked_frame: usize, all: &[usize]) -> f32 {
    let far: usize = all.iter().map(|marked| marked.abs_diff(frame)).sum();
    if all.len() < 2 { 1.0 } else { 1.0 - marked_frame.abs_diff(frame) as f32 / far.max(1) as f32 }
}

/// Returns `true` if pictures are large enough to be segmented.
fn is_large_enough(scene: &Scene) -> bool {
    scene.cameras.first().is_some_and(|c| c.width.min(c.height) as usize >= MIN_SIDE_PX)
}
