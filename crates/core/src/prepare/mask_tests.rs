//! Tests of preparing from regions with embeddings, and of reusing masks and embeddings that
//! took long to make.

use super::*;
use crate::{
    codec::{CodecKind, CodecSettings},
    grid::Grid,
    progress::{Progress, unobserved},
    segment::{BitMask, Level, MaskSettings, tests::ByColour},
    stress::made_up_encoder,
};
use image::{Rgb, RgbImage};
use std::{fs, ops::ControlFlow};

const FRAMES: usize = 10;
const QUICK: CodecSettings = CodecSettings { kind: CodecKind::Network, latent_dim: 3, steps: 40, seed: 0 };

/// Writes frames with two halves of different colours; frame 4 has only one colour.
fn write_clip(folder: &Path) -> Sequence {
    fs::create_dir_all(folder).unwrap();
    for i in 0..FRAMES {
        let shade =
            |x: u32, _| if x < 16 || i == 4 { Rgb([200, 60, 60]) } else { Rgb([60, 60, 200 + i as u8]) };
        RgbImage::from_fn(32, 24, shade).save(folder.join(format!("frame_{i}.png"))).unwrap();
    }
    fs::write(folder.join("sequence.toml"), "[masks]\nfield_of_view = \"whole\"\n").unwrap();
    Sequence::open(folder).unwrap()
}

/// Embeds a mask as the mean colour of its pixels.
fn embed(image: &RgbImage, masks: &[&BitMask]) -> Result<Vec<Vec<f32>>> {
    let mean = |mask: &&BitMask| {
        let mut sum = vec![0.0; 3];
        for (x, y) in mask.pixels() {
            let pixel = image.get_pixel(x as u32, y as u32);
            (0..3).for_each(|c| sum[c] += f32::from(pixel[c]));
        }
        sum
    };
    Ok(masks.iter().map(mean).collect())
}

fn settings() -> MaskSettings {
    MaskSettings { min_region_px: 4, ..MaskSettings::of_grid(4) }
}

struct Place {
    folder: tempfile::TempDir,
    sequence: Sequence,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let sequence = write_clip(&folder.path().join("clip"));
        Self { folder, sequence }
    }

    fn prep(&self) -> PathBuf {
        self.folder.path().join("prep")
    }

    fn store<'a>(&'a self, prep: &'a Path, settings: &'a MaskSettings, model: &'a str) -> MaskStore<'a> {
        MaskStore { sequence: &self.sequence, folder: prep, settings, model }
    }

    /// Makes masks; returns the number of pictures the network had to look at.
    fn make(&self, model: &str, settings: &MaskSettings, eval: bool) -> usize {
        let mut segmenter = ByColour::new(|_, _| 0.95);
        let prep = self.prep();
        self.store(&prep, settings, model).make_masks(&mut segmenter, eval, &mut unobserved).unwrap();
        segmenter.images_seen
    }

    fn prepare(&self, eval: bool, dim: usize) -> Result<Prepared> {
        let (prep, settings) = (self.prep(), settings());
        let store = self.store(&prep, &settings, "model");
        let mut features = |i: usize| store.features(i, Level::Default, "encoder", &mut embed);
        let origin = Origin::Masks {
            mask_model: "model".into(),
            settings: settings.clone(),
            level: Level::Default,
            image_encoder: "encoder".into(),
        };
        let sequence = self.sequence.clone();
        prepare_from_features(
            sequence,
            made_up_encoder(dim),
            origin,
            &mut features,
            eval,
            &QUICK,
            &prep,
            &mut unobserved,
        )
    }
}

#[test]
fn every_mask_becomes_a_region_with_its_embedding() {
    let place = Place::new();
    place.make("model", &settings(), true);
    let prepared = place.prepare(true, 3).unwrap();
    assert!(prepared.classes.is_empty() && prepared.eval);
    assert!(matches!(&prepared.origin, Origin::Masks { level: Level::Default, .. }));
    assert_eq!(
        prepared.num_rows(),
        2 * 8 - 1,
        "two regions on each of the eight training frames, one on frame 4"
    );
    for i in 0..FRAMES {
        let regions = prepared.regions(i).unwrap();
        assert_eq!(regions.is_none(), Sequence::is_test_frame(i), "frame {i}");
        let Some(regions) = regions else { continue };
        assert_eq!(regions.at(3, 3) == regions.at(28, 20), i == 4, "frame {i}");
    }
    let first = prepared.regions(0).unwrap().unwrap();
    let later = prepared.regions(2).unwrap().unwrap();
    assert!(later.data.iter().min() > first.data.iter().max(), "rows are numbered through the recording");
    assert_eq!(Prepared::open(&place.prep()).unwrap().origin, prepared.origin);
}

#[test]
fn masks_are_made_once() {
    let place = Place::new();
    assert_eq!(place.make("model", &settings(), true), 8);
    assert_eq!(place.make("model", &settings(), true), 0);
    assert_eq!(place.make("model", &settings(), false), 2, "only the frames that were held out");
    assert_eq!(place.make("other model", &settings(), false), FRAMES);
    assert_eq!(place.make("other model", &MaskSettings { alike_prompts: 0, ..settings() }, false), FRAMES);
    RgbImage::from_pixel(32, 24, Rgb([9, 9, 9])).save(place.folder.path().join("clip/frame_3.png")).unwrap();
    assert_eq!(place.make("other model", &MaskSettings { alike_prompts: 0, ..settings() }, false), 1);
    place.prepare(false, 3).unwrap_err();
    place.make("model", &settings(), false);
    place.prepare(false, 3).unwrap();
    assert_eq!(place.make("model", &settings(), false), 0, "a finished folder keeps its masks");
}

#[test]
fn an_interrupted_preparation_goes_on_where_it_was() {
    let place = Place::new();
    let (prep, settings) = (place.prep(), settings());
    let mut segmenter = ByColour::new(|_, _| 0.95);
    let mut stop_at_third = |p: &Progress<'_>| {
        if p.done == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let stopped =
        place.store(&prep, &settings, "model").make_masks(&mut segmenter, false, &mut stop_at_third);
    assert!(matches!(stopped, Err(Error::Cancelled)));
    assert!(Prepared::is_unfinished(&prep));
    assert_eq!(place.make("model", &settings, false), FRAMES - 2);
}

#[test]
fn embeddings_are_made_once() {
    let place = Place::new();
    place.make("model", &settings(), false);
    let (prep, settings) = (place.prep(), settings());
    let store = place.store(&prep, &settings, "model");
    let mut asked = 0;
    let mut count = |encoder: &str| {
        let embed = &mut |image: &RgbImage, masks: &[&BitMask]| {
            asked += 1;
            embed(image, masks)
        };
        let features = store.features(0, Level::Default, encoder, embed).unwrap();
        (asked, features)
    };
    let (first, features) = count("encoder");
    assert_eq!((first, count("encoder")), (1, (1, features)), "the same from the file");
    assert_eq!(count("another").0, 2);
    fs::write(prep.join("embeddings/frame_000000_default.safetensors"), "rubbish").unwrap();
    assert_eq!(count("another").0, 3);
}

#[test]
fn features_that_do_not_fit_are_named() {
    let place = Place::new();
    place.make("model", &settings(), false);
    let error = place.prepare(false, 4).unwrap_err().to_string();
    assert!(
        error.contains("embedding 0 has 3 numbers or no direction; the text encoder's have 4"),
        "{error}"
    );
    let fail = |features: FrameFeatures| {
        let sequence = place.sequence.clone();
        let prep = place.prep();
        let mut give = |_: usize| Ok(Some(features.clone()));
        let done = prepare_from_features(
            sequence,
            made_up_encoder(2),
            Origin::Labels,
            &mut give,
            false,
            &QUICK,
            &prep,
            &mut unobserved,
        );
        done.unwrap_err().to_string()
    };
    let all = |region: u16| Grid::filled(32, 24, region);
    let small = FrameFeatures { regions: Grid::filled(16, 12, 0), rows: vec![vec![1.0, 0.0]] };
    assert!(fail(small).contains("frame frame_0: its regions are 16×12, the picture is 32×24"));
    assert!(fail(FrameFeatures { regions: all(1), rows: vec![vec![1.0, 0.0]] }).contains("embedding 1 of 1"));
    assert!(fail(FrameFeatures { regions: all(0), rows: vec![vec![0.0, 0.0]] }).contains("no direction"));
    assert!(fail(FrameFeatures { regions: all(NO_REGION), rows: vec![] }).contains("no region"));
}

#[test]
fn regions_beyond_the_share_of_a_frame_are_merged_with_those_like_them() {
    let place = Place::new();
    // Eight stripes, in pairs of nearly the same embedding; nothing of a ninth region is seen.
    let regions = RegionMap::from_vec(32, 24, (0..32 * 24).map(|i| (i % 32 / 4) as u16).collect());
    let row = |k: usize| vec![1.0, [0.0, 4.0, -4.0, 1.0, 9.0][k / 2], 0.02 * (k % 2) as f32];
    let features = FrameFeatures { regions, rows: (0..9).map(row).collect() };
    let numbered = |numbers| masks::numbered(&place.sequence, 0, features.clone(), numbers, 3).unwrap();
    let all = numbered(100..108);
    assert_eq!((all.pixels.len(), all.map.at(31, 5), all.is_merged), (8, 107, false));
    let merged = numbered(100..104);
    assert!(merged.is_merged);
    assert_eq!(merged.pixels, [8 * 24; 4], "pairs are merged");
    for stripe in 0..8 {
        assert_eq!(usize::from(merged.map.at(4 * stripe + 1, 5)), 100 + stripe / 2, "{stripe}");
    }
    assert!(merged.table.chunks(3).all(|row| (crate::num::norm(row) - 1.0).abs() < 1e-5));
    // However many regions frames have, all of them get some.
    let (mut rows, mut fewest) = (0, usize::MAX);
    for left in (1..=1500).rev() {
        let own = masks::share(rows, left).min(if left > 700 { 83 } else { 40 });
        (rows, fewest) = (rows + own, fewest.min(own));
    }
    assert!(rows < 65_535 && fewest >= 40, "{rows} {fewest}");
}

#[test]
fn langsplat_files_are_written_and_read_back() {
    let place = Place::new();
    place.make("model", &settings(), false);
    let prepared = place.prepare(false, 3).unwrap();
    let out = place.folder.path().join("out");
    write_langsplat(&prepared, &out, &mut unobserved).unwrap();

    // As the authors' loaders expect them: float32, one plane per level, -1 for no mask, unit rows.
    let read = |name: &str| crate::reading::npy(&out.join(name)).unwrap();
    let (shape, maps) = read("language_features/frame_4_s.npy");
    assert_eq!(shape, [4, 24, 32]);
    assert!(maps.iter().all(|v| *v == 0.0), "frame 4 is one region");
    assert_eq!(read("language_features/frame_0_f.npy").0, [2, 3]);
    let (shape, latents) = read("language_features_dim3/frame_0_f.npy");
    assert_eq!(shape, [2, 3]);
    assert!((latents[..3].iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-4);

    let folder = out.join("language_features");
    assert!(holds_langsplat(&folder, &place.sequence) && !holds_langsplat(&out, &place.sequence));
    for level in Level::ALL {
        let features = read_langsplat(&folder, &place.sequence, 0, level).unwrap().unwrap();
        let map = prepared.regions(0).unwrap().unwrap();
        for (region, row) in features.regions.data.iter().zip(&map.data) {
            assert_eq!(*region == NO_REGION, *row == NO_REGION);
        }
        assert_ne!(features.regions.at(3, 3), features.regions.at(28, 20));
        assert!(features.rows.iter().all(|row| (crate::num::norm(row) - 1.0).abs() < 1e-5));
    }
}

#[test]
fn langsplat_files_that_are_none_are_named() {
    let place = Place::new();
    let folder = place.folder.path().join("features");
    fs::create_dir_all(&folder).unwrap();
    let read = || read_langsplat(&folder, &place.sequence, 0, Level::Medium);
    assert_eq!(read().unwrap(), None);
    let write =
        |name: &str, array: ndarray::ArrayD<f32>| ndarray_npy::write_npy(folder.join(name), &array).unwrap();
    let array = |shape: &[usize], value: f32| ndarray::ArrayD::from_elem(shape.to_vec(), value);
    write("frame_0_f.npy", array(&[2, 5], 0.5));
    assert!(read().unwrap_err().to_string().contains("frame_0_s.npy"), "the other half is missing");
    write("frame_0_s.npy", array(&[3, 24, 32], 0.0));
    assert!(read().unwrap_err().to_string().contains("expected maps [4, h, w], found the shape [3, 24, 32]"));
    for wrong in [2.0, 0.5, -2.0, f32::NAN] {
        write("frame_0_s.npy", array(&[4, 24, 32], wrong));
        assert!(read().unwrap_err().to_string().contains("one of the 2 embeddings"), "{wrong}");
    }
    // Half the size of the pictures, as the authors' scripts make them of large ones.
    write("frame_0_s.npy", array(&[4, 12, 16], 1.0));
    let features = read().unwrap().unwrap();
    assert_eq!((features.regions.width, features.regions.height, features.regions.at(31, 23)), (32, 24, 1));
    assert_eq!(features.rows, vec![vec![0.5; 5]; 2]);
    write("frame_0_f.npy", array(&[5], 0.5));
    assert!(read().unwrap_err().to_string().contains("expected embeddings [n, dim]"));
}

#[test]
fn dense_maps_of_the_authors_are_read() {
    let place = Place::new();
    let folder = place.folder.path().join("features");
    fs::create_dir_all(&folder).unwrap();
    let write = |array: ndarray::ArrayD<f32>| {
        ndarray_npy::write_npy(folder.join("frame_0_agg.npy"), &array).unwrap();
    };
    let map = |dim: usize| {
        ndarray::Array4::from_shape_fn((1, 3, 4, dim), |(_, _, x, c)| f32::from(c == usize::from(x >= 2)))
            .into_dyn()
    };
    write(map(20));
    assert!(holds_langsplat(&folder, &place.sequence));
    let features = read_langsplat(&folder, &place.sequence, 0, Level::Default).unwrap().unwrap();
    assert_eq!((features.regions.width, features.regions.height), (32, 24));
    let row = |x, y| &features.rows[usize::from(features.regions.at(x, y))];
    assert_eq!((row(15, 20)[..2].to_vec(), row(16, 20)[..2].to_vec()), (vec![1.0, 0.0], vec![0.0, 1.0]));
    assert_eq!(read_langsplat(&folder, &place.sequence, 1, Level::Default).unwrap(), None);

    let fail = || read_langsplat(&folder, &place.sequence, 0, Level::Default).unwrap_err().to_string();
    write(map(3));
    assert!(fail().contains("the map has 3 numbers a place: it was compressed"));
    write(ndarray::ArrayD::from_elem(vec![2, 3, 4, 20], 1.0));
    assert!(fail().contains("expected a dense map [1, h, w, dim], found the shape [2, 3, 4, 20]"));
}
