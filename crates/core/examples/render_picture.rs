//! Renders one frame of a scene on the CPU and writes it as a picture. Arguments: SCENE FRAME OUT.png

use std::path::Path;
use surgtpgs_core::{
    Error, Result,
    raster::{CpuRenderer, Renderer},
    scene::Scene,
};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene_path, frame, picture_path] = arguments.as_slice() else {
        return Err(Error::input(
            "three arguments are expected",
            "Usage: render_picture SCENE FRAME OUT.png",
        ));
    };
    let scene = Scene::load(Path::new(scene_path))?;
    let frame = frame
        .parse::<usize>()
        .map_err(|e| Error::input(format!("\"{frame}\" is not a frame number: {e}"), "Count from 0."))?;
    let Some(camera) = scene.cameras.get(frame) else {
        let what = format!("there is no frame {frame}; the scene has {}, from 0", scene.num_frames());
        return Err(Error::input(what, "Give a smaller number."));
    };
    let images = CpuRenderer::default().render(&scene, camera, scene.time(frame), false)?;
    let picture = images.to_rgb();
    picture
        .save(picture_path)
        .map_err(|e| Error::io("write the picture", picture_path, std::io::Error::other(e)))
}
