//! `surgtpgs render`: images of a scene, and `render.json` that tells the meaning of the numbers in them.

use super::{
    args::{FrameArgs, SceneArgs},
    console::{ProgressView, print},
    verb::{Exit, Run},
};
use crate::{
    engine::{Engine, SceneView},
    memory::{Work, require_for},
    outputs,
    pictures::png,
};
use clap::{Args, ValueEnum};
use image::{GrayImage, ImageBuffer, Luma};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use surgtpgs_core::{
    Error, Result,
    camera::check_image_size,
    files::{npy, write_whole},
    grid::Grid,
    num::{percentile, spread},
    raster::{ALPHA_PLANE, FEATURE_PLANE, Images},
};

const WIDTH_HINT: &str = "Choose another `--width`.";

/// Render colour, depth, opacity and feature images of a scene
#[derive(Debug, Args)]
pub(super) struct RenderArgs {
    /// The scene
    #[command(flatten)]
    scene: SceneArgs,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Frames to work on
    #[command(flatten)]
    frames: FrameArgs,
    /// Images to write
    #[arg(long, value_enum, value_delimiter = ',', default_value = "colour")]
    kind: Vec<ImageKind>,
    /// Image columns, if not those of the recording (rows follow)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=8192))]
    width: Option<u32>,
    /// Replace an earlier result of this kind, once the new one is whole
    #[arg(long)]
    force: bool,
}

/// Images that `render` writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
enum ImageKind {
    /// 8-bit RGB PNG
    Colour,
    /// Depth in scene units, 0 in holes: .npy (f32, rows × columns) and a 16-bit PNG to look at
    Depth,
    /// Accumulated opacity: 8-bit grey PNG
    Alpha,
    /// Latent features: .npy (f32, rows × columns × latent numbers)
    Feature,
}

impl Run for RenderArgs {
    fn run(&self) -> Result<Exit> {
        let mut engine = self.scene.open_to_render()?;
        let frames = self.frames.of(engine.scene().num_frames())?;
        let kinds = kinds(&self.kind, &engine)?;
        let camera = sized(engine.view(frames[0])?, self.width).camera;
        check_image_size(camera.width as usize, camera.height as usize)
            .map_err(|what| Error::input(what, "Choose a smaller `--width`."))?;
        require_for(&Work::Pictures(camera.width, camera.height))?;
        let inputs = engine.inputs(&self.scene.scene);
        let output = outputs::folder(&self.output, outputs::RENDERING, &inputs, self.force)?;
        let has_features = kinds.contains(&ImageKind::Feature);
        let mut view = ProgressView::default();
        let has_depth = kinds.contains(&ImageKind::Depth);
        let depth_range = if has_depth { depth_range(&mut engine, &frames, self.width)? } else { None };
        // Without a range there is no depth to draw.
        let range = depth_range.unwrap_or_default();
        for (done, &frame) in frames.iter().enumerate() {
            let images = engine.render(&sized(engine.view(frame)?, self.width), has_features)?;
            kinds.par_iter().try_for_each(|&kind| write(output.path(), kind, frame, &images, range))?;
            view.count("rendering", done + 1, frames.len())?;
        }
        drop(view);
        write_notes(output.path(), &engine, &kinds, depth_range)?;
        output.finish()?;
        let (count, folder) = (frames.len(), self.output.display());
        print(&format!("{count} frames in {folder} ({})\n", engine.renderer_name()))?;
        Ok(Exit::Done)
    }

    fn output(&self) -> Option<&Path> {
        Some(&self.output)
    }
}

fn kinds(asked: &[ImageKind], engine: &Engine) -> Result<Vec<ImageKind>> {
    let mut kinds = asked.to_vec();
    kinds.sort_unstable();
    kinds.dedup();
    if kinds.contains(&ImageKind::Feature) && engine.scene().gaussians.latent_dim == 0 {
        return Err(Error::input(
            "this scene was trained without features",
            "Leave `feature` out of `--kind`, or train on a prepared folder.",
        ));
    }
    Ok(kinds)
}

fn sized(view: SceneView, width: Option<u32>) -> SceneView {
    let Some(width) = width else { return view };
    let rows = f64::from(view.camera.height) * f64::from(width) / f64::from(view.camera.width.max(1));
    view.resized(width, (rows.round() as u32).max(1))
}

fn write(folder: &Path, kind: ImageKind, frame: usize, images: &Images, range: (f32, f32)) -> Result<()> {
    let save = |kind: &str, extension: &str, bytes: Vec<u8>| {
        write_whole(&folder.join(kind).join(format!("frame_{frame:06}.{extension}")), &bytes)
    };
    match kind {
        ImageKind::Colour => save("colour", "png", png(images.to_rgb())?),
        ImageKind::Alpha => save("alpha", "png", png(alpha(images))?),
        ImageKind::Depth => {
            let depth = images.normalised_depth();
            save("depth", "npy", npy(&[images.height, images.width], &depth.data, WIDTH_HINT)?)?;
            save("depth", "png", png(depth_picture(&depth, range))?)
        }
        ImageKind::Feature => {
            let (dim, pixels) = (images.latent_dim(), images.width * images.height);
            let at = |i: usize| images.planes[(FEATURE_PLANE + i % dim) * pixels + i / dim];
            let values: Vec<f32> = (0..pixels * dim).map(at).collect();
            save("feature", "npy", npy(&[images.height, images.width, dim], &values, WIDTH_HINT)?)
        }
    }
}

fn alpha(images: &Images) -> GrayImage {
    let values = images.plane(ALPHA_PLANE);
    GrayImage::from_fn(images.width as u32, images.height as u32, |x, y| {
        Luma([(values[y as usize * images.width + x as usize].clamp(0.0, 1.0) * 255.0 + 0.5) as u8])
    })
}

/// Draws depth to look at: the near end of `range` white, the far end nearly black, holes black.
fn depth_picture(depth: &Grid<f32>, (near, far): (f32, f32)) -> ImageBuffer<Luma<u16>, Vec<u16>> {
    ImageBuffer::from_fn(depth.width as u32, depth.height as u32, |x, y| {
        let z = depth.at(x as usize, y as usize);
        let nearness = 1.0 - ((z - near) / (far - near).max(1e-12)).clamp(0.0, 1.0);
        Luma([if z > 0.0 { (1.0 + nearness * 65534.0) as u16 } else { 0 }])
    })
}

/// Returns the range of depths on up to [`RANGE_FRAMES`] of the frames, evenly spread; `None` if none is
/// known. One range serves for all frames, so that the pictures do not flicker.
fn depth_range(engine: &mut Engine, frames: &[usize], width: Option<u32>) -> Result<Option<(f32, f32)>> {
    let mut range: Option<(f32, f32)> = None;
    for frame in spread(frames.len(), RANGE_FRAMES).map(|k| frames[k]) {
        let images = engine.render(&sized(engine.view(frame)?, width), false)?;
        let own = typical_range(&images.normalised_depth());
        range = range.zip(own).map(|(a, b)| (a.0.min(b.0), a.1.max(b.1))).or(range).or(own);
    }
    Ok(range)
}

/// Returns the range of the middle 98 % of known depths; `None` if none is known.
fn typical_range(depth: &Grid<f32>) -> Option<(f32, f32)> {
    let mut known: Vec<f32> = depth.data.iter().copied().filter(|z| *z > 0.0 && z.is_finite()).collect();
    percentile(&mut known, 1.0).zip(percentile(&mut known, 99.0))
}

/// Meaning of the numbers in the pictures that [`depth_picture`] draws.
const DEPTH_PNG: &str = "inverted, to look at: 65535 is near, 1 is far, 0 is unknown. depth_png_range holds the depths of \
     65535 and of 1, by the middle 98 % of up to eight frames. What is nearer or further is drawn like these.";
/// Number of frames that the range of depths is taken from.
const RANGE_FRAMES: usize = 8;

fn write_notes(folder: &Path, engine: &Engine, kinds: &[ImageKind], range: Option<(f32, f32)>) -> Result<()> {
    let provenance = &engine.scene().provenance;
    let range = range.filter(|_| kinds.contains(&ImageKind::Depth));
    let notes = serde_json::json!({
        "tool": format!("SurgTPGS {}", env!("CARGO_PKG_VERSION")),
        "intended_use": surgtpgs_core::about::intended_use(),
        "sequence_name": provenance.sequence_name,
        "rendered_by": engine.renderer_name(),
        "depth_unit": engine.depth_origin().is_measured().then_some("scene units"),
        "depth_origin": engine.depth_origin(),
        "depth_png": range.map(|_| DEPTH_PNG),
        "depth_png_range": range,
        "frames_not_shown": engine.scene().frames_not_shown(),
    });
    let text = serde_json::to_string_pretty(&notes).unwrap_or_default() + "\n";
    write_whole(&folder.join("render.json"), text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_is_white_and_holes_are_black() {
        let depth = Grid::from_vec(4, 1, vec![0.0, 1.0, 2.0, 9.0]);
        let picture = depth_picture(&depth, (1.0, 2.0));
        assert_eq!(picture.into_raw(), [0, 65535, 1, 1]);
    }

    #[test]
    fn a_frame_without_depth_gives_no_range() {
        assert_eq!(typical_range(&Grid::filled(4, 1, 0.0)), None);
        assert_eq!(typical_range(&Grid::from_vec(3, 1, vec![0.0, 7.0, f32::INFINITY])), Some((7.0, 7.0)));
    }
}
