//! A synthetic laparoscopic clip with complete ground truth. It is rendered here and has the same
//! bytes every time.
//!
//! `shape` lays out the anatomy at rest, `motion` moves it, `material` colours it by its position at
//! rest, `draw` makes the picture and `write` the sequence folder. Lengths are in millimetres.

mod draw;
mod material;
mod motion;
mod noise;
mod shape;
mod write;

#[cfg(test)]
mod tests;

use crate::{
    Error, Result,
    camera::Camera,
    grid::{Grid, Mask},
    sequence::{Class, LabelMap, NO_LABEL},
};
use glam::{Vec2, Vec3};
use image::{Rgb, RgbImage};
use motion::Moment;
use shape::Anatomy;

pub use write::{is_written, write};

/// Settings of the clip to render.
#[derive(Clone, Debug)]
pub struct DemoSettings {
    /// Image columns.
    pub width: usize,
    /// Image rows.
    pub height: usize,
    /// Number of frames.
    pub frames: usize,
    /// `true` if the endoscope moves (then the cameras are in `transforms.json`).
    pub moving_camera: bool,
    /// `true` if tissue and instrument stand still.
    pub rigid: bool,
    /// `true` if every fifth frame, from the fourth on, is blurred as by a quick motion of the endoscope.
    pub blurred: bool,
    /// `true` if motion never repeats, that of the endoscope too.
    pub wanders: bool,
    /// Seed of textures and noise.
    pub seed: u64,
}

impl Default for DemoSettings {
    fn default() -> Self {
        Self {
            width: 320,
            height: 240,
            frames: 48,
            moving_camera: false,
            rigid: false,
            blurred: false,
            wanders: false,
            seed: 11,
        }
    }
}

impl DemoSettings {
    /// Returns the settings of a clip of this size and length, all else as by default.
    pub fn of_size(width: usize, height: usize, frames: usize) -> Self {
        Self { width, height, frames, ..Self::default() }
    }
}

/// Playing speed of the clip; the breathing and the instrument repeat after 48 frames unless they wander.
pub const FRAMES_PER_SECOND: f32 = 25.0;

/// Class names and display colours; a class's id is its index here.
pub const CLASSES: [(&str, [u8; 3]); 5] = [
    ("abdominal wall", [210, 140, 140]),
    ("liver", [255, 114, 114]),
    ("gallbladder", [120, 200, 90]),
    ("fat", [240, 220, 70]),
    ("grasper", [170, 110, 255]),
];

/// Returns the classes of the clip.
pub fn classes() -> Vec<Class> {
    let class = |(id, (name, colour)): (usize, &(&str, [u8; 3]))| Class {
        id: id as u8,
        name: (*name).to_owned(),
        colour: *colour,
    };
    CLASSES.iter().enumerate().map(class).collect()
}

/// One frame with its ground truth, all of the settings' size.
#[derive(Clone, Debug)]
pub struct DemoFrame {
    /// The picture (sRGB), black outside the round field of view.
    pub colour: RgbImage,
    /// Depth z at pixel centres in millimetres; 0 outside the field of view.
    pub depth: Grid<f32>,
    /// Class at pixel centres; [`NO_LABEL`] outside the field of view.
    pub labels: LabelMap,
    /// Motion of the point at the pixel centre until the next frame, in pixels (right, down), even if it
    /// leaves the view; 0 outside the field of view. Includes the camera's own motion.
    pub motion: Grid<[f32; 2]>,
    /// The camera; the world is the still camera's axes.
    pub camera: Camera,
}

/// A clip ready to be rendered frame by frame.
#[derive(Clone, Debug)]
pub struct Demo {
    settings: DemoSettings,
    anatomy: Anatomy,
    /// The seed, folded to 32 bits.
    seed: u32,
}

/// Number of colour samples per pixel along each axis; odd, so that one is the pixel's centre.
const SAMPLES: usize = 3;
/// Width of the soft border of the field of view, in pixels.
const BORDER_PX: f32 = 2.0;

impl Demo {
    /// Prepares the scene. Needs sizes from 16 to 4096 pixels and at least one frame.
    pub fn new(settings: &DemoSettings) -> Result<Self> {
        let size = 16..=4096;
        if !size.contains(&settings.width) || !size.contains(&settings.height) || settings.frames == 0 {
            return Err(Error::input(
                format!(
                    "the demo cannot be rendered with {} frames of {}×{} pixels",
                    settings.frames, settings.width, settings.height
                ),
                "Choose at least one frame, and a width and height from 16 to 4096.",
            ));
        }
        let seed = ((settings.seed ^ settings.seed >> 32) as u32).wrapping_mul(0x9e37_79b1) >> 1;
        Ok(Self { settings: settings.clone(), anatomy: Anatomy::new(seed), seed })
    }

    /// Returns the settings of the clip.
    pub fn settings(&self) -> &DemoSettings {
        &self.settings
    }

    /// Returns the camera of frame `i`.
    pub fn camera(&self, i: usize) -> Camera {
        let s = &self.settings;
        motion::camera([s.width as u32, s.height as u32], s.moving_camera, s.wanders, i as f32)
    }

    /// Returns the round field of view, the same in every frame; `true` = inside.
    pub fn field_of_view(&self) -> Mask {
        let (width, height) = (self.settings.width, self.settings.height);
        let inside = |k: usize| self.inside(k % width, k / width) >= 1.0;
        Grid::from_vec(width, height, (0..width * height).map(inside).collect())
    }

    /// Returns the share of light that the round stop lets through to a pixel.
    fn inside(&self, x: usize, y: usize) -> f32 {
        let (width, height) = (self.settings.width as f32, self.settings.height as f32);
        let radius = (0.6 * height).min(0.49 * width);
        let from_centre = Vec2::new(x as f32 + 0.5 - 0.5 * width, y as f32 + 0.5 - 0.5 * height);
        ((radius - from_centre.length()) / BORDER_PX).clamp(0.0, 1.0)
    }

    /// Renders frame `i`; any index is possible, the clip continues beyond its last frame.
    pub fn frame(&self, i: usize) -> DemoFrame {
        let (width, height) = (self.settings.width, self.settings.height);
        let (camera, points) = self.points(i);
        let (next_camera, next_points) = self.points(i + 1);
        let scale = SAMPLES as f32;
        let view = draw::EyeView::new(
            &self.anatomy,
            &points,
            (width * SAMPLES, height * SAMPLES),
            camera.fx * scale,
            Vec2::new(camera.cx, camera.cy) * scale,
        );
        let artist = Artist {
            demo: self,
            normals: draw::normals(&self.anatomy, &points),
            shadows: draw::shadows(&self.anatomy, &points),
            points: &points,
            next_points: &next_points,
            next_camera: &next_camera,
            view: &view,
            frame: i,
        };
        let pixels = view.map_rows(SAMPLES, |row, hits| artist.pixels(row / SAMPLES, hits));
        let mut colour = RgbImage::new(width as u32, height as u32);
        colour.pixels_mut().zip(&pixels).for_each(|(to, p)| *to = Rgb(p.colour));
        if self.settings.blurred && i % 5 == 3 {
            colour = draw::blurred(&colour);
        }
        let grid = Grid::from_vec(width, height, pixels);
        DemoFrame {
            colour,
            depth: grid.map(|p| p.depth),
            labels: grid.map(|p| p.label),
            motion: grid.map(|p| p.motion),
            camera,
        }
    }

    fn moment(&self, i: usize) -> Moment {
        if self.settings.rigid { Moment::at(0.0, false) } else { Moment::at(i as f32, self.settings.wanders) }
    }

    /// Returns the camera of frame `i`, and all vertices at that time, in its axes.
    fn points(&self, i: usize) -> (Camera, Vec<Vec3>) {
        let (camera, moment) = (self.camera(i), self.moment(i));
        let vertices = self.anatomy.rest.iter().zip(&self.anatomy.part);
        let place = |(&rest, &part)| camera.camera_from_world.transform_point3(moment.place(part, rest));
        (camera, vertices.map(place).collect())
    }
}

/// Renders frame `i` of the clip in memory; for many frames prepare a [`Demo`] once.
pub fn render_frame(settings: &DemoSettings, i: usize) -> Result<DemoFrame> {
    Ok(Demo::new(settings)?.frame(i))
}

/// One finished pixel.
struct Pixel {
    colour: [u8; 3],
    depth: f32,
    label: u8,
    motion: [f32; 2],
}

/// Everything needed to finish the pixels of one frame.
struct Artist<'a> {
    demo: &'a Demo,
    view: &'a draw::EyeView<'a>,
    points: &'a [Vec3],
    next_points: &'a [Vec3],
    next_camera: &'a Camera,
    normals: Vec<Vec3>,
    shadows: Vec<f32>,
    frame: usize,
}

impl Artist<'_> {
    /// Returns row `y` of pixels from its rows of samples.
    fn pixels(&self, y: usize, hits: &[draw::Hit]) -> Vec<Pixel> {
        let columns = self.demo.settings.width * SAMPLES;
        let pixel = |x: usize| {
            let inside = self.demo.inside(x, y);
            let mut pixel = Pixel { colour: [0; 3], depth: 0.0, label: NO_LABEL, motion: [0.0; 2] };
            if inside > 0.0 {
                let sample = |k: usize| (x * SAMPLES + k % SAMPLES, k / SAMPLES);
                let light = (0..SAMPLES * SAMPLES).map(|k| {
                    let (column, row) = sample(k);
                    self.light(hits[row * columns + column], column, y * SAMPLES + row)
                });
                let light = light.sum::<Vec3>() / (SAMPLES * SAMPLES) as f32;
                pixel.colour = self.develop(light * inside, x, y);
            }
            let hit = hits[SAMPLES / 2 * columns + x * SAMPLES + SAMPLES / 2];
            if inside >= 1.0 && hit.inverse_z > 0.0 {
                self.tell_truth(hit, x, y, &mut pixel);
            }
            pixel
        };
        (0..self.demo.settings.width).map(pixel).collect()
    }

    /// Returns the linear light at one sample.
    fn light(&self, hit: draw::Hit, column: usize, row: usize) -> Vec3 {
        if hit.inverse_z <= 0.0 {
            return Vec3::ZERO;
        }
        let anatomy = &self.demo.anatomy;
        let (corners, share) =
            self.view.shares(hit.triangle, Vec2::new(column as f32 + 0.5, row as f32 + 0.5));
        let position = draw::blend(self.points, corners, share);
        let [a, b, c] = corners.map(|k| self.points[k]);
        let towards_eye = (b - a).cross(c - a).dot(position) < 0.0;
        let normal = draw::blend(&self.normals, corners, share).normalize_or(Vec3::NEG_Z);
        let spot = draw::Spot {
            part: anatomy.part[corners[0]],
            position,
            normal: if towards_eye { normal } else { -normal },
            rest: draw::blend(&anatomy.rest, corners, share),
            open: share.dot(Vec3::from(corners.map(|k| anatomy.open[k]))),
            shadow: share.dot(Vec3::from(corners.map(|k| self.shadows[k]))),
        };
        draw::shade(&spot, self.demo.seed)
    }

    /// Applies the light fall-off to the rim, the display's curve (taken as a square root), and a
    /// little sensor noise.
    fn develop(&self, light: Vec3, x: usize, y: usize) -> [u8; 3] {
        let (width, height) = (self.demo.settings.width as f32, self.demo.settings.height as f32);
        let radius = Vec2::new(x as f32 - 0.5 * width, y as f32 - 0.5 * height) / (0.6 * height);
        let fall_off = 1.0 - 0.45 * radius.length_squared().min(1.0);
        let grain = noise::hash(x as i32, y as i32, self.frame as i32, self.demo.seed);
        std::array::from_fn(|c| {
            // The sum of two uniform numbers in 0..1: mean 1, σ 0.41.
            let noise = (grain >> (10 * c) & 31) as f32 / 32.0 + (grain >> (10 * c + 5) & 31) as f32 / 32.0;
            (255.0 * (light[c] * fall_off).max(0.0).sqrt() + noise - 0.5).clamp(0.0, 255.0) as u8
        })
    }

    /// Fills in the ground truth of the pixel's centre.
    fn tell_truth(&self, hit: draw::Hit, x: usize, y: usize, pixel: &mut Pixel) {
        let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        let (corners, share) = self.view.shares(hit.triangle, centre * SAMPLES as f32);
        pixel.depth = draw::blend(self.points, corners, share).z;
        pixel.label = self.demo.anatomy.part[corners[0]].class();
        let next = draw::blend(self.next_points, corners, share);
        let camera = self.next_camera;
        let arrival =
            Vec2::new(camera.fx * next.x / next.z + camera.cx, camera.fy * next.y / next.z + camera.cy);
        pixel.motion = (arrival - centre).to_array();
    }
}
