//! Writes the clip as an ordinary sequence folder.

use super::{Demo, DemoFrame, DemoSettings, FRAMES_PER_SECOND, classes};
use crate::{
    Error, Result,
    camera::Camera,
    files::{is_free_folder, npy, png, write_whole},
    grid::Mask,
    progress::{Observer, Progress},
};
use image::{DynamicImage, GrayImage, ImageBuffer, Luma};
use rayon::prelude::*;
use serde_json::json;
use std::path::Path;

/// Size of one count in the depth pictures, in millimetres.
const DEPTH_SCALE: f32 = 0.005;
const SIZE_HINT: &str = "Choose another size.";

/// Writes the clip into `folder` as an ordinary sequence folder, creating it. The folder must be
/// new, empty, or hold the same clip (which is then written again).
pub fn write(settings: &DemoSettings, folder: &Path, observer: &mut Observer<'_>) -> Result<()> {
    let demo = Demo::new(settings)?;
    let readme = readme(settings);
    claim(settings, folder)?;
    write_missing(&folder.join("README.txt"), readme.as_bytes())?;
    write_missing(&folder.join("labels.json"), &to_json(&json!(classes()), folder)?)?;
    write_missing(&folder.join("sequence.toml"), sequence_toml(&demo).as_bytes())?;
    if settings.moving_camera {
        write_missing(&folder.join("transforms.json"), &to_json(&transforms(&demo), folder)?)?;
    }
    let mask = white_where(&demo.field_of_view())?;
    let mut tell = |done| Progress::new("recording the demo", done, settings.frames).tell(observer);
    tell(0)?;
    for i in 0..settings.frames {
        write_frame(&demo.frame(i), &mask, folder, &format!("frame_{i:06}"))?;
        tell(i + 1)?;
    }
    Ok(())
}

/// Returns `true` if `folder` holds the clip of this very description, complete or in part.
pub fn is_written(settings: &DemoSettings, folder: &Path) -> bool {
    std::fs::read(folder.join("README.txt")).is_ok_and(|found| found == readme(settings).as_bytes())
}

/// Refuses a folder that holds anything else than the clip of this very description.
fn claim(settings: &DemoSettings, folder: &Path) -> Result<()> {
    if is_written(settings, folder) || is_free_folder(folder)? {
        return Ok(());
    }
    Err(Error::input_at(
        folder,
        "the folder is not empty and does not hold this demo",
        "Name a folder that is new or empty.",
    ))
}

/// Writes a file unless it is there: it may have been changed since.
fn write_missing(path: &Path, bytes: &[u8]) -> Result<()> {
    if path.exists() { Ok(()) } else { write_whole(path, bytes) }
}

/// Writes all files of one frame.
fn write_frame(frame: &DemoFrame, mask: &[u8], folder: &Path, name: &str) -> Result<()> {
    let (width, height) = frame.colour.dimensions();
    let counts = frame.depth.data.iter().map(|z| (z / DEPTH_SCALE + 0.5).min(65535.0) as u16).collect();
    let depth: Option<ImageBuffer<Luma<u16>, Vec<u16>>> = ImageBuffer::from_raw(width, height, counts);
    let labels = GrayImage::from_raw(width, height, frame.labels.data.clone());
    let pictures = [
        ("images", Some(DynamicImage::from(frame.colour.clone()))),
        ("depth", depth.map(DynamicImage::from)),
        ("labels", labels.map(DynamicImage::from)),
    ];
    pictures.into_par_iter().try_for_each(|(kind, picture)| {
        let path = folder.join(kind).join(format!("{name}.png"));
        // A grid always has width × height values.
        picture.map_or(Ok(()), |picture| write_missing(&path, &png(picture, SIZE_HINT)?))
    })?;
    write_missing(&folder.join("masks").join(format!("{name}.png")), mask)?;
    let path = folder.join("motion").join(format!("{name}.npy"));
    let shape = [height as usize, width as usize, 2];
    write_missing(&path, &npy(&shape, frame.motion.data.as_flattened(), SIZE_HINT)?)
}

/// Encodes a picture that is white where `mask` is true.
fn white_where(mask: &Mask) -> Result<Vec<u8>> {
    let picture = GrayImage::from_fn(mask.width as u32, mask.height as u32, |x, y| {
        Luma([if mask.at(x as usize, y as usize) { 255 } else { 0 }])
    });
    png(picture, SIZE_HINT)
}

fn to_json(value: &serde_json::Value, folder: &Path) -> Result<Vec<u8>> {
    serde_json::to_vec_pretty(value).map_err(|e| Error::io("encode JSON", folder, std::io::Error::other(e)))
}

/// Returns the facts that pictures alone do not contain: units, speed, polarity and, for a still
/// endoscope, the camera.
fn sequence_toml(demo: &Demo) -> String {
    let Camera { fx, fy, cx, cy, .. } = demo.camera(0);
    let camera = match demo.settings().moving_camera {
        true => String::new(), // in transforms.json
        false => format!("[camera]\nfx = {fx:?}\nfy = {fy:?}\ncx = {cx:?}\ncy = {cy:?}\n\n"),
    };
    format!(
        "{camera}[depth]\nkind = \"depth\"\nscale = {DEPTH_SCALE:?}\n\n[masks]\nkeep = \"white\"\n\n\
         [time]\nframes_per_second = {FRAMES_PER_SECOND:?}\n"
    )
}

/// Returns nerfstudio's description of the cameras: OpenGL axes (y up, looking along −z), camera to world.
fn transforms(demo: &Demo) -> serde_json::Value {
    let settings = demo.settings();
    let frames = (0..settings.frames).map(|i| {
        let pose = demo.camera(i).camera_from_world.inverse();
        let row = |r: usize| {
            let axes = pose.matrix3;
            [axes.x_axis[r], -axes.y_axis[r], -axes.z_axis[r], pose.translation[r]]
        };
        json!({
            "file_path": format!("images/frame_{i:06}.png"),
            "depth_file_path": format!("depth/frame_{i:06}.png"),
            "mask_path": format!("masks/frame_{i:06}.png"),
            "label_path": format!("labels/frame_{i:06}.png"),
            "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
        })
    });
    let camera = demo.camera(0);
    json!({
        "camera_model": "OPENCV",
        "w": camera.width, "h": camera.height,
        "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy,
        "classes": classes(),
        "frames": frames.collect::<Vec<_>>(),
    })
}

fn readme(settings: &DemoSettings) -> String {
    let DemoSettings { width, height, frames, moving_camera, rigid, blurred, wanders, seed } = settings;
    let camera = if *moving_camera { "moving" } else { "still" };
    let tissue = if *rigid { ", nothing else moves" } else { "" };
    let wander = if *wanders { ", motion that never repeats" } else { "" };
    let blur = if *blurred { ", every fifth frame blurred" } else { "" };
    format!(
        "A synthetic laparoscopic clip, written by SurgTPGS. No patient data.\n\
         {frames} frames of {width}x{height} pixels, {camera} camera{tissue}{wander}{blur}, seed {seed}. Lengths are millimetres.\n\n\
         images/         colour\n\
         depth/          distance along the camera's axis, 16 bit; one count is {DEPTH_SCALE} mm, 0 is unknown\n\
         labels/         class of each pixel (see labels.json), 255 is none\n\
         masks/          white is the round field of view\n\
         motion/         pixels (right, down) that the tissue in each pixel moves until the next frame,\n\
         \u{20}               float32 [rows, columns, 2]; 0 outside the field of view\n\
         sequence.toml   units, speed{}\n{}",
        if *moving_camera { "" } else { ", camera" },
        if *moving_camera { "transforms.json cameras, in nerfstudio's form\n" } else { "" },
    )
}
