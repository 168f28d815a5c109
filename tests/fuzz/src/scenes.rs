//! Scene files and files of Gaussians.

use crate::{Target, expect_words};
use flate2::{Compression, read::GzDecoder, write::GzEncoder};
use std::{
    io::{Read, Write},
    path::Path,
};
use surgtpgs_core::{
    Result,
    codec::{Codec, CodecSettings},
    marks::{Canvas, Evidence, Marks},
    progress::unobserved,
    raster::{CpuRenderer, Renderer},
    relevancy::{Query, Relevancy, RelevancySettings, Rivals, best},
    scene::{Chapter, Scene},
    sequence::Class,
    stress,
};

pub(crate) const TARGETS: [Target; 4] = [
    Target { name: "marks", run: marks, seeds: marks_seeds },
    Target { name: "scene", run: |bytes| load("scene.safetensors", bytes), seeds: scenes },
    Target { name: "ply", run: |bytes| load("scene.ply", bytes), seeds: plys },
    Target { name: "spz", run: spz, seeds: spzs },
];

/// Reads marks, and the pixels and the evidence of those that are accepted.
fn marks(bytes: &[u8]) {
    let canvas = Canvas { width: 24, height: 20, frame_names: vec!["a.png".into(); 3], num_frames: 3 };
    let Some(marks) = expect_words(Marks::parse(bytes, Path::new("/nowhere"), &canvas)) else { return };
    let names = marks.names();
    assert!(names.iter().all(|name| !name.is_empty()));
    for frame in marks.frames() {
        Evidence::of(&marks, frame, &names, [canvas.width, canvas.height]);
    }
}

fn marks_seeds() -> Vec<Vec<u8>> {
    let texts = [
        r#"{"marks": [{"frame": 1, "name": "liver", "kind": "stroke", "points_px": [[1, 2], [9.5, 3]], "radius_px": 2},
            {"frame": 0, "name": "fat", "kind": "polygon", "add": false, "points_px": [[1, 1], [9, 1], [5, 9]]},
            {"frame": 2, "name": "fat", "kind": "box", "points_px": [[0, 0], [24, 20]]},
            {"frame": 2, "name": "x", "kind": "click", "points_px": [[NaN, 3]]}]}"#,
        r#"{"categories": [{"id": 1, "name": "liver"}], "images": [{"id": 2, "frame": 1}, {"id": 3, "file_name": "a.jpg"}],
            "annotations": [{"image_id": 2, "category_id": 1, "segmentation": {"size": [20, 24], "counts": [100, 80, 300]}},
            {"image_id": 3, "category_id": 1, "segmentation": [[1, 1, 9, 1, 9, 9]]}]}"#,
        r#"<annotations><track label="liver"><mask frame="1" outside="0" rle="1, 2, 3" left="4" top="5" width="3" height="2"/></track>
            <image name="a.png" width="24" height="20"><polygon label="fat" points="1,1;9,1;9,9"/><box label="a &amp; b" xtl="1" ytl="1"
            xbr="9" ybr="9" rotation="10"/></image></annotations>"#,
        r#"[{"data": {"frame": 1}, "annotations": [{"result": [{"type": "polygonlabels", "original_width": 24, "original_height": 20,
            "value": {"points": [[10, 10], [90, 10], [50, 90]], "polygonlabels": ["liver"]}}, {"type": "brushlabels", "value":
            {"rle": [0, 0, 7, 128, 57, 31, 127, 255, 56, 0, 192, 7, 127, 248, 0], "brushlabels": ["fat"]}}]}]}]"#,
        "NRRD0004\ntype: unsigned char\nsizes: 3 2 1\nencoding: raw\nSegmentation_ReferenceImageExtentOffset:=4 5 1\n\
         Segment0_Name:=liver\nSegment0_LabelValue:=1\n\n\x01\x00\x01\x01\x00\x00",
    ];
    texts.map(|text| text.as_bytes().to_vec()).into()
}

/// Number of chapters that are looked at.
const MOST_CHAPTERS: usize = 3;
/// Largest scene that is rendered, in pixels times Gaussians. Of larger ones it is enough that they load.
const SMALL: usize = 100_000;

pub(crate) fn load(name: &str, bytes: &[u8]) {
    let folder = crate::recordings::scratch();
    let path = folder.path().join(name);
    assert!(std::fs::write(&path, bytes).is_ok());
    if let Some(scene) = expect_words(Scene::load(&path)) {
        look_at(&scene);
        // Each chapter is another file.
        for chapter in scene.chapters.iter().take(MOST_CHAPTERS) {
            expect_words(scene.of_chapter(chapter.index)).iter().for_each(look_at);
        }
    }
}

/// Checks that an accepted scene can be written, read, rendered and asked.
fn look_at(scene: &Scene) {
    let bytes = scene.to_bytes();
    assert!(bytes.is_ok(), "an accepted scene cannot be written: {bytes:?}");
    let camera = scene.cameras[0];
    if camera.width as usize * camera.height as usize * scene.gaussians.len().max(1) > SMALL {
        return;
    }
    let Some(images) = expect_words(CpuRenderer::default().render(scene, &camera, 0.5, true)) else { return };
    assert!(images.planes.iter().all(|v| v.is_finite()), "a scene renders to values that are not finite");
    if let (Some(codec), Some((class, embedding))) = (&scene.codec, scene.classes.first()) {
        let settings = RelevancySettings::default();
        let rivals = Rivals::new(scene.classes.iter().map(|(class, e)| (class.name.as_str(), e.as_slice())));
        let query = Query::new(&class.name, embedding.clone()).among(&rivals, vec![0]);
        if query.check(codec).is_ok() {
            let scores = best(codec.clone()).score(&images, &[query], &settings);
            assert!(scores[0].data.iter().all(|s| (0.0..=1.0).contains(s)), "a score beyond 0 to 1");
        }
    }
}

/// Creates a scene with a codec and classes.
fn scene(n: usize) -> Scene {
    const DIM: usize = 6;
    let mut scene = stress::ordinary(n);
    let embedding = |k: usize| (0..DIM).map(|j| 0.5 * ((k * 5 + j * 3) as f32).sin()).collect::<Vec<f32>>();
    let names = ["liver", "grasper", "fat"].map(String::from);
    scene.classes = (1..)
        .zip(names)
        .map(|(id, name)| (Class { id, name, colour: [1, 2, 3] }, embedding(usize::from(id))))
        .collect();
    let rows: Vec<f32> = scene.classes.iter().flat_map(|c| c.1.clone()).collect();
    let settings = CodecSettings { steps: 5, ..CodecSettings::default() };
    let rows = ndarray::Array2::from_shape_vec((3, DIM), rows);
    scene.codec =
        rows.ok().and_then(|rows| Codec::train(rows.view(), &[1.0; 3], &settings, &mut unobserved).ok());
    scene
}

fn scenes() -> Vec<Vec<u8>> {
    let scene = scene(5);
    [scene.to_bytes(), scene.to_quantized_bytes(), stress::ordinary(1).to_bytes(), in_chapters(scene)]
        .into_iter()
        .flatten()
        .collect()
}

/// Returns the bytes of a scene in two chapters.
fn in_chapters(mut scene: Scene) -> Result<Vec<u8>> {
    scene.cameras = vec![scene.cameras[0]; 3];
    let part = |index: usize| {
        let shown = 2 * index..index + 2;
        let chapter = Chapter { index, count: 2, shown: shown.clone(), learned: shown };
        let mut part = scene.clone();
        part.provenance.settings = serde_json::json!({ "chapter": chapter });
        part.as_chapter()
    };
    let joined = Scene::joined(Some(Scene::joined(None, part(0))), part(1));
    let mut bytes = std::io::Cursor::new(Vec::new());
    joined.write(&mut bytes, false).map(|()| bytes.into_inner())
}

/// Returns the bytes of a quantised scene.
pub(crate) fn quantised() -> &'static [u8] {
    static SCENE: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    SCENE.get_or_init(|| scene(5).to_quantized_bytes().unwrap_or_default())
}

fn plys() -> Vec<Vec<u8>> {
    let scene = scene(3);
    let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                property float opacity\nend_header\n0 0 1 2\n";
    vec![scene.all_still(0.5).to_ply(Some(&scene.cameras[0])), scene.to_reference_ply(), text.into()]
}

/// Reads an `.spz` as it is, and what the bytes are behind a gzip header that is whole.
fn spz(bytes: &[u8]) {
    load("scene.spz", bytes);
    let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
    if let Ok(packed) = gzip.write_all(bytes).and_then(|()| gzip.finish()) {
        load("packed.spz", &packed);
    }
}

fn spzs() -> Vec<Vec<u8>> {
    let still = scene(3).all_still(0.5).to_spz();
    let mut unpacked = Vec::new();
    let read = GzDecoder::new(&still[..]).read_to_end(&mut unpacked);
    debug_assert!(read.is_ok(), "it was just packed");
    vec![still, unpacked]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_seeds_are_good() {
        let spz = spzs()[..1].to_vec();
        for (target, seeds) in [("scene.safetensors", scenes()), ("scene.ply", plys()), ("scene.spz", spz)] {
            assert!(!seeds.is_empty());
            let folder = tempfile::tempdir().unwrap();
            let path: &Path = &folder.path().join(target);
            for (i, seed) in seeds.iter().enumerate().take(2) {
                std::fs::write(path, seed).unwrap();
                let scene = Scene::load(path);
                assert!(scene.is_ok(), "seed {i} of {target}: {:?}", scene.err());
            }
        }
    }
}
