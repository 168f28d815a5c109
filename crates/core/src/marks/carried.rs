//! Scores of marked names on every frame.

use super::{
    Evidence, FrameScores, Graph, LookHere, Marks,
    cells::{Squares, spread_over},
    guided::Guide,
    hints::{Hints, Told},
    known::{MarkedFrame, add_seen, at_half, at_whole, likeness, place, weights},
    plan::{Plan, beside},
    scores::scores,
    seeds::Seeds,
    seen::Seen,
    spread::{Before, PULL, spread},
    trail::Trail,
};
use crate::{
    Result,
    camera::Camera,
    flow::{halved, luma},
    grid::Grid,
    scene::Scene,
};
use image::RgbImage;
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

/// Names whose shares are blended in one pass.
const NAMES_AT_ONCE: usize = 16;
/// Weight of the Gaussians' shares beside those of a marked frame that is seen well.
const GAUSSIANS: f32 = 0.01;
/// Weight of what other frames tell a frame that shows all names itself, beside that of any other.
const TOLD_BESIDE_ALL: f32 = 0.2;
/// Likeness from which on a marked pixel is carried to a frame that knows nothing of its name: instruments
/// shine otherwise on each.
const LENT: f32 = 0.05;
/// Likeness of looks from which on the place that it is carried to looks the same.
const SAME_LOOKS: f32 = 0.78;
/// Part of the marked pixels of a name that lead to what looks the same, where it is still there.
const MOSTLY: f32 = 0.3;
/// Shortest side of pictures that are looked at, px; smaller ones are left to the Gaussians.
const SMALLEST: usize = 4;
/// Marked frames that are kept at most.
const MOST_KNOWN: usize = 8;

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
    /// Marked frames that were needed last.
    known: BTreeMap<usize, MarkedFrame>,
    /// Displacements to marked frames that are not known yet, found for earlier marks.
    trails: BTreeMap<usize, Trail>,
}

/// Returns the picture of a frame: the recorded one, or the reconstruction of it.
pub type Pictures<'a> = dyn FnMut(usize) -> Result<RgbImage> + 'a;

impl Carried {
    /// Takes marks on the recording of a scene that `graph` is of.
    pub fn new(scene: &Scene, graph: Arc<Graph>, marks: &Marks, settings: CarrySettings) -> Self {
        let names = marks.names();
        let evidence = Evidence::of_all(marks, &names, scene);
        let (growing, pointed) = Evidence::of_growing(marks, &evidence, &names, scene);
        let plan = Plan::of(&growing, &pointed, names.len());
        let (known, trails, shares) = (BTreeMap::new(), BTreeMap::new(), None);
        let outlined = marks.outlined(scene);
        Self { names, settings, evidence, growing, plan, outlined, graph, shares, known, trails }
    }

    /// Takes over what was found for earlier marks on the same recording and still holds: frames whose marks
    /// and tellers are the same, and displacements. The scores stay the same and take less time.
    pub fn after(mut self, earlier: Self) -> Self {
        let is_same = self.names == earlier.names
            && self.settings == earlier.settings
            && Arc::ptr_eq(&self.graph, &earlier.graph);
        let is_marked_so = |frame: &usize| {
            self.evidence.get(frame) == earlier.evidence.get(frame)
                && self.growing.get(frame).is_some_and(|own| Some(own) == earlier.growing.get(frame))
                && self.plan.is_as_in(&earlier.plan, *frame)
        };
        let holds = |frame: usize| self.plan.with_tellers(frame).iter().all(is_marked_so);
        let mut trails = earlier.trails;
        for (frame, known) in earlier.known {
            if is_same && holds(frame) {
                let is_whole = self.plan.is_whole(frame, &known.lent);
                self.known.insert(frame, MarkedFrame { told: None, is_whole, ..known });
            } else {
                trails.insert(frame, known.trail);
            }
        }
        trails
            .retain(|frame, trail| self.evidence.contains_key(frame) && trail.mends() == self.settings.mends);
        self.trails = trails.into_iter().take(MOST_KNOWN).collect();
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
        if self.shares.is_none() {
            let mut seeds = Seeds::none(scene, self.names.len());
            for frame in self.evidence.keys().copied().collect::<Vec<_>>() {
                if self.growing.contains_key(&frame) && is_looked_at(scene) {
                    self.know(scene, frame, pictures)?;
                    self.known[&frame].seed(&mut seeds, scene, frame);
                    self.forget_far(frame);
                } else {
                    seeds.add(scene, &self.evidence[&frame]);
                }
            }
            let hints = Hints::of(&self.graph.looks, &self.graph.links, &seeds, &[]);
            let mut shares = spread(&self.graph.links, &seeds, Before::Nothing, PULL, Some(&hints));
            // The solver stops a little beside the solution.
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
        let mut found = self.found_on(scene, frame, pictures)?;
        if let Some(evidence) = self.evidence.get(&frame) {
            let is_outlined = |k: &usize| self.outlined.contains(&(self.names[*k].clone(), frame));
            for k in (0..self.names.len()).filter(is_outlined) {
                let scores = found.scores[k].data.iter_mut().enumerate();
                scores.filter(|(i, _)| evidence.at(*i, k).1 == 0.0).for_each(|(_, score)| *score = 0.0);
            }
        }
        Ok(found)
    }

    fn found_on(&mut self, scene: &Scene, frame: usize, pictures: &mut Pictures<'_>) -> Result<FrameScores> {
        let camera = scene.cameras[frame];
        let (width, height) = (camera.width as usize, camera.height as usize);
        if !is_looked_at(scene) {
            let scores = self.on_view(scene, camera, scene.time(frame), pictures)?;
            return Ok(FrameScores { scores, doubt: Grid::filled(width, height, 0.0) });
        }
        // Before frames are told of each other: spreading over many of them forgets some.
        if !self.growing.contains_key(&frame) || self.growing.len() < self.evidence.len() {
            self.shares(scene, pictures)?;
        }
        let picture = pictures(frame)?;
        let shares = if !self.settings.looks_up {
            self.blended(scene, &Seen::at_half(scene, frame), pictures)?
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
            let mut shares = self.blended(scene, &Seen::at_half(scene, frame), pictures)?;
            let luma = luma_of(&picture);
            let total = vec![GAUSSIANS; luma.data.len()];
            self.look_up(scene, (frame, &luma), (&marked, true), total, &mut shares, pictures)?;
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
    pub fn on_view(
        &mut self,
        scene: &Scene,
        camera: Camera,
        time: f32,
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<Grid<f32>>> {
        let shares = self.blended(scene, &Seen::of(scene, camera, time), pictures)?;
        Ok(scores(&shares, camera.width as usize, camera.height as usize).scores)
    }

    /// Returns the Gaussians' shares of every pixel.
    fn blended(&mut self, scene: &Scene, seen: &Seen, pictures: &mut Pictures<'_>) -> Result<Vec<Vec<f32>>> {
        let shares = self.shares(scene, pictures)?;
        let mut planes = Vec::with_capacity(shares.len());
        for part in shares.chunks(NAMES_AT_ONCE) {
            let values: Vec<f32> =
                (0..part[0].len()).flat_map(|i| part.iter().map(move |share| share[i])).collect();
            let blended = seen.blend(&values, part.len());
            planes.extend((0..part.len()).map(|k| blended.value(k).to_vec()));
        }
        Ok(planes)
    }

    /// Mixes the shares of a frame, of weight `total`, with those of marked frames, looked up from it. Marked
    /// frames answer with what they were told, too, or with their own shares alone. Returns the new weight.
    fn look_up(
        &mut self,
        scene: &Scene,
        (frame, luma_here): (usize, &Grid<f32>),
        (marked, with_told): (&[usize], bool),
        mut total: Vec<f32>,
        shares: &mut [Vec<f32>],
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<f32>> {
        marked.iter().try_for_each(|marked| self.know(scene, *marked, pictures))?;
        shares.par_iter_mut().for_each(|plane| plane.iter_mut().zip(&total).for_each(|(v, t)| *v *= t));
        // The nearer of two weighs more.
        let far: usize = marked.iter().map(|f| f.abs_diff(frame)).sum();
        for &marked_frame in marked {
            let away = marked_frame.abs_diff(frame) as f32 / far.max(1) as f32;
            let near = if marked.len() < 2 { 1.0 } else { 1.0 - away };
            let Some(known) = self.known.get_mut(&marked_frame) else { continue };
            let way = known.trail.way(frame, &mut |i| Ok(luma_of(&pictures(i)?)))?;
            let weights = known.weights_along(&way, luma_here, &scene.field_of_view, |weight| near * weight);
            let answer = known.told.as_ref().filter(|_| with_told);
            shares.par_iter_mut().zip(answer.unwrap_or(&known.own)).for_each(|(plane, marked)| {
                add_seen(plane, marked, &way, &weights);
            });
            if known.is_whole || answer.is_some() {
                total.iter_mut().zip(&weights.data).for_each(|(t, w)| *t += w);
            } else {
                add_seen(&mut total, &known.sure(), &way, &weights);
            }
        }
        let share = |(v, t): (&mut f32, &f32)| *v /= t.max(f32::MIN_POSITIVE);
        shares.par_iter_mut().for_each(|plane| plane.iter_mut().zip(&total).for_each(share));
        Ok(total)
    }

    /// Returns what other frames tell a frame with growing marks; `None` if there is none.
    fn told(
        &mut self,
        scene: &Scene,
        here: (usize, &Grid<f32>),
        pictures: &mut Pictures<'_>,
    ) -> Result<Option<Told>> {
        let tellers = self.plan.tellers(here.0).to_vec();
        if tellers.is_empty() || !self.settings.looks_up {
            return Ok(None);
        }
        let nothing = vec![0.0; here.1.data.len()];
        let mut shares = vec![nothing.clone(); self.names.len()];
        let mut weights = self.look_up(scene, here, (&tellers, false), nothing, &mut shares, pictures)?;
        if self.plan.shows_all(here.0) {
            weights.iter_mut().for_each(|weight| *weight *= TOLD_BESIDE_ALL);
        }
        Ok(Some(Told { shares, weights }))
    }

    /// Carries marks of names that a frame knows nothing of to it. Returns pixels of its picture, each with the
    /// name that it shows. Names whose marks mostly lead to what looks otherwise are not there yet, or no more.
    fn lent(
        &mut self,
        scene: &Scene,
        (frame, picture, luma): (usize, &RgbImage, &Grid<f32>),
        pictures: &mut Pictures<'_>,
    ) -> Result<Vec<(usize, usize)>> {
        let (mut lent, mends) = (Vec::new(), self.settings.mends);
        let lenders = if self.settings.looks_up { self.plan.lenders(frame) } else { BTreeMap::new() };
        if lenders.is_empty() {
            return Ok(lent);
        }
        let here = Squares::of(picture);
        let width = picture.width() as usize;
        for (lender, names) in lenders {
            let (evidence, picture) = (&self.growing[&lender], pictures(lender)?);
            let trail = self.trails.entry(frame).or_insert_with(|| Trail::new(frame, luma.clone(), mends));
            let way = trail.way(lender, &mut |i| Ok(luma_of(&pictures(i)?)))?;
            let alike = likeness(&luma_of(&picture), luma, &way, &scene.field_of_view);
            let there = Squares::of(&picture);
            // Number of marked pixels, and the places of those that look the same, of each name.
            let mut found: BTreeMap<usize, (usize, Vec<usize>)> = BTreeMap::new();
            for i in evidence.pixels() {
                let Some(name) = evidence.shown_at(i).filter(|name| names.contains(name)) else { continue };
                let (count, places) = found.entry(name).or_default();
                *count += 1;
                let from = at_half(i, width, luma);
                let to = place(&way, from).filter(|_| alike.data[from] > LENT);
                let to = to.map(|to| at_whole(to, width, luma));
                places.extend(to.filter(|to| there.likeness(i, &here, *to) > SAME_LOOKS));
            }
            for (name, (count, places)) in found {
                if places.len() as f32 > MOSTLY * count as f32 {
                    lent.extend(places.into_iter().map(|place| (place, name)));
                }
            }
        }
        Ok(lent)
    }

    /// Carries the marked pixels of the frames beside a marked one to it.
    fn tell(&mut self, scene: &Scene, frame: usize, pictures: &mut Pictures<'_>) -> Result<()> {
        self.know(scene, frame, pictures)?;
        let Some(known) = self.known.get(&frame).filter(|known| known.told.is_none()) else { return Ok(()) };
        let others = beside(frame, &self.evidence);
        if others.is_empty() {
            // Alone, it is shown as it was found at full size.
            return if known.whole.is_none() { self.know_anew(scene, frame, pictures) } else { Ok(()) };
        }
        let mut told = known.own.clone();
        if !known.is_whole {
            let (luma, sure) = (known.luma.clone(), known.sure());
            let growing = beside(frame, &self.growing);
            self.look_up(scene, (frame, &luma), (&growing, false), sure, &mut told, pictures)?;
        }
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
        let told = self.told(scene, (frame, &luma), pictures)?;
        let lent = self.lent(scene, (frame, &picture, &luma), pictures)?;
        let spread = if let Some(growing) = self.growing.get(&frame) {
            spread_over(&picture, &scene.field_of_view, (growing, &lent), self.names.len(), told)
        } else {
            let mut shares = self.blended(scene, &Seen::at_half(scene, frame), pictures)?;
            let growing = beside(frame, &self.growing);
            let total = vec![GAUSSIANS; luma.data.len()];
            self.look_up(scene, (frame, &luma), (&growing, false), total, &mut shares, pictures)?;
            shares
        };
        let evidence = &self.evidence[&frame];
        let [whole_width, whole_height] = [picture.width(), picture.height()].map(|side| side as usize);
        let mut shares = self.refined(picture, spread);
        keep_marked(evidence, &mut shares);
        let half = |plane: &Vec<f32>| halved(&Grid::from_vec(whole_width, whole_height, plane.clone())).data;
        let own = shares.par_iter().map(half).collect();
        let weights = weights(evidence, &luma, whole_width);
        let earlier = self.trails.remove(&frame);
        let trail = earlier.unwrap_or_else(|| Trail::new(frame, luma.clone(), self.settings.mends));
        // At full size they take much memory, and are wanted of the shown frame alone.
        self.known.values_mut().for_each(|known| known.whole = None);
        let lent = lent.into_iter().map(|(_, name)| name).collect();
        let is_whole = self.plan.is_whole(frame, &lent);
        let (whole, told) = (Some(shares), None);
        self.known.insert(frame, MarkedFrame { luma, trail, own, whole, told, weights, lent, is_whole });
        Ok(())
    }

    /// Makes a frame known again that lost its shares at full size.
    fn know_anew(&mut self, scene: &Scene, frame: usize, pictures: &mut Pictures<'_>) -> Result<()> {
        if let Some(known) = self.known.remove(&frame) {
            self.trails.insert(frame, known.trail);
        }
        self.know(scene, frame, pictures)
    }

    /// Forgets marked frames that are far away, so that memory does not grow with the recording.
    fn forget_far(&mut self, frame: usize) {
        while self.known.len() > MOST_KNOWN {
            let farthest = self.known.keys().copied().max_by_key(|f| (f.abs_diff(frame), *f));
            farthest.and_then(|farthest| self.known.remove(&farthest));
        }
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

/// Returns `true` if pictures are large enough to be looked at.
fn is_looked_at(scene: &Scene) -> bool {
    scene.cameras.first().is_some_and(|c| c.width.min(c.height) as usize >= SMALLEST)
}

/// Returns the luminance of a picture at half size, 0–255.
fn luma_of(picture: &RgbImage) -> Grid<f32> {
    halved(&luma(picture))
}
