//! Tests of preparing tiny CholecSeg8K folders, and of opening old and damaged ones.

use super::*;
use crate::{
    codec::{CodecKind, CodecSettings},
    demo::{self, DemoSettings},
    files::PREPARED_FILE,
    marks::{Mark, Marks, Shape},
    progress::{Progress, unobserved},
    sequence::HiddenRectangle,
    stress::{made_up_encoder, one_hot},
};
use image::{GrayImage, Luma, Rgb, RgbImage};
use std::{fs, ops::ControlFlow};

const WIDTH: u32 = 32;
const HEIGHT: u32 = 24;
const FRAMES: usize = 10;
const DIM: usize = 12;
const QUICK: CodecSettings = CodecSettings { kind: CodecKind::Network, latent_dim: 3, steps: 40, seed: 0 };
// Watershed codes.
const LIVER: u8 = 21;
const GRASPER: u8 = 31;
const GALLBLADDER: u8 = 22;
const BLACK: u8 = 50;
const IGNORE: u8 = 255;

/// Writes liver on the left, a grasper on the right, the gallbladder only in the test frame 1, and a
/// black column and an unknown row.
fn write_clip(folder: &Path) {
    fs::create_dir_all(folder).unwrap();
    for i in 0..FRAMES {
        let shade = |x: u32, y: u32| Rgb([120 + 4 * x as u8, 90 + 5 * y as u8, 100 + i as u8]);
        let stem = folder.join(format!("frame_{i}_endo"));
        RgbImage::from_fn(WIDTH, HEIGHT, shade).save(stem.with_extension("png")).unwrap();
        let code = |x: u32, y: u32| match (x, y) {
            (_, 0) => IGNORE,
            (0, _) => BLACK,
            (1..16, _) => LIVER,
            _ if i == 1 => GALLBLADDER,
            _ => GRASPER,
        };
        let labels = GrayImage::from_fn(WIDTH, HEIGHT, |x, y| Luma([code(x, y)]));
        labels.save(folder.join(format!("frame_{i}_endo_watershed_mask.png"))).unwrap();
    }
}

fn encoder() -> EncoderIdentity {
    let template = "a photo of a {} in the scene".into();
    EncoderIdentity { template, ..made_up_encoder(DIM) }
}

/// Returns one embedding per class, all different.
fn embeddings(sequence: &Sequence) -> Vec<Vec<f32>> {
    let row = |k: usize| (0..DIM).map(|j| 1.0 + ((k * 7 + j * 3) % 11) as f32).collect();
    (0..sequence.classes().len()).map(row).collect()
}

fn prepare(clip: &Path, folder: &Path, eval: bool) -> Result<Prepared> {
    let sequence = Sequence::open(clip)?;
    let embeddings = embeddings(&sequence);
    prepare_from_labels(sequence, encoder(), &embeddings, eval, &QUICK, folder, &mut unobserved)
}

/// Makes a temporary folder with a clip and its prepared folder.
fn prepared(eval: bool) -> (tempfile::TempDir, Prepared) {
    let place = tempfile::tempdir().unwrap();
    write_clip(&place.path().join("clip"));
    let prepared = prepare(&place.path().join("clip"), &place.path().join("out/prep"), eval).unwrap();
    (place, prepared)
}

fn names(prepared: &Prepared) -> Vec<&str> {
    prepared.classes.iter().map(|(c, _)| c.name.as_str()).collect()
}

#[test]
fn regions_follow_labels_inside_the_supervision_mask() {
    let (_place, prepared) = prepared(false);
    assert_eq!(names(&prepared), ["liver", "grasper", "gallbladder"]);
    let map = prepared.regions(0).unwrap().unwrap();
    let keep = prepared.sequence.mask(0).unwrap();
    let labels = prepared.sequence.labels(0).unwrap().unwrap();
    for i in 0..map.data.len() {
        let name = prepared.classes.get(usize::from(map.data[i])).map(|(c, _)| c.id);
        let expected =
            (keep.data[i] && labels.data[i] != crate::sequence::NO_LABEL).then_some(labels.data[i]);
        assert_eq!(name, expected, "pixel {i}");
    }
    assert!(map.data.contains(&NO_REGION) && map.data.contains(&0) && map.data.contains(&1));
    assert_eq!(prepared.regions(FRAMES).unwrap(), None);
    assert_eq!(prepared.latents.len(), 9);
    assert!(prepared.latents.chunks(3).all(|l| (crate::num::norm(l) - 1.0).abs() < 1e-4));
    assert!(prepared.classes.iter().all(|(_, e)| (crate::num::norm(e) - 1.0).abs() < 1e-6));
    assert_eq!(prepared.encoder, encoder());
}

#[test]
fn held_out_frames_leave_no_trace() {
    let (place, prepared) = prepared(true);
    assert!(prepared.eval);
    assert_eq!(names(&prepared), ["liver", "grasper"], "the gallbladder is only in frame 1");
    assert_eq!(prepared.num_rows(), 2);
    for i in 0..FRAMES {
        let file = place.path().join("out/prep").join(region_file(i));
        assert_eq!(prepared.regions(i).unwrap().is_none(), Sequence::is_test_frame(i), "frame {i}");
        assert_eq!(file.exists(), !Sequence::is_test_frame(i), "frame {i}");
    }
    // The contents of held-out frames do not change a single byte.
    for i in [1, 9] {
        let file = place.path().join(format!("clip/frame_{i}_endo_watershed_mask.png"));
        GrayImage::from_pixel(WIDTH, HEIGHT, Luma([LIVER])).save(file).unwrap();
    }
    prepare(&place.path().join("clip"), &place.path().join("out/again"), true).unwrap();
    for name in ["codec.safetensors", "features.safetensors", "regions/frame_000002.png"] {
        let read = |folder: &str| fs::read(place.path().join(folder).join(name)).unwrap();
        assert!(read("out/prep") == read("out/again"), "{name}");
    }
}

#[test]
fn marked_pixels_have_the_rows_of_their_names() {
    let place = tempfile::tempdir().unwrap();
    write_clip(&place.path().join("clip"));
    let sequence = Sequence::open(&place.path().join("clip")).unwrap();
    let shape = |x: f32| Shape::Box { corners_px: [[x, 4.0], [x + 4.0, 8.0]] };
    let marks = [(0, "liver", 4.0), (1, "gallbladder", 4.0), (4, "grasper", 20.0), (4, "liver", 4.0)]
        .map(|(frame, name, x)| Mark::new(frame, name, true, shape(x)));
    let marks = Marks::new(marks.to_vec(), &sequence.canvas()).unwrap();
    let embeddings = one_hot(marks.names().len(), DIM);
    let named = || MarkedNames { marks: &marks, encoder: encoder(), embeddings: &embeddings };
    let folder = place.path().join("prep");
    let mut stages = Vec::new();
    let mut observer = |p: &Progress<'_>| {
        stages.push((p.stage.to_owned(), p.done));
        ControlFlow::Continue(())
    };
    let prepared = prepare_from_marks(sequence, named(), true, &QUICK, &folder, &mut observer).unwrap();
    assert_eq!(prepared.classes.len(), 2, "the gallbladder is only in frame 1");
    assert!(prepared.words.from_marks, "they are no list of all that there is");
    let name_at = |frame: usize, x: usize| {
        let row = prepared.regions(frame).unwrap()?.at(x, 6);
        prepared.classes.get(usize::from(row)).map(|(class, _)| class.name.clone())
    };
    assert_eq!([name_at(0, 6), name_at(4, 6)], [(); 2].map(|()| Some("liver".to_owned())));
    assert_eq!(name_at(4, 22).as_deref(), Some("grasper"));
    assert_eq!([name_at(0, 22), name_at(1, 6), name_at(2, 6)], [const { None }; 3]);
    // Maps are made one by one when they are written.
    for stage in ["reading marks", "writing features"] {
        assert_eq!(stages.iter().filter(|(name, _)| name == stage).count(), 2, "{stages:?}");
    }
}

#[test]
fn marks_that_show_nothing_are_refused_with_the_reason() {
    let place = tempfile::tempdir().unwrap();
    let clip = place.path().join("clip");
    write_clip(&clip);
    let hidden = HiddenRectangle { x: 20, y: 0, width: 12, height: 24 };
    let sequence = Sequence::open_with(&clip, None, &[hidden]).unwrap();
    let mark = |frame: usize, x: f32, add: bool| {
        Mark::new(frame, "liver", add, Shape::Box { corners_px: [[x, 4.0], [x + 4.0, 8.0]] })
    };
    let refused = |marks: &[Mark], eval: bool| {
        let marks = Marks::new(marks.to_vec(), &sequence.canvas()).unwrap();
        require_marks(&sequence, &marks, eval, &mut unobserved).err().map(|e| e.to_string())
    };
    let says = |marks: &[Mark], eval: bool, why: &str| {
        let told = refused(marks, eval).unwrap();
        assert!(told.contains(&format!("marked: {why}")), "{told}");
    };
    says(&[mark(1, 6.0, true), mark(9, 6.0, true)], true, "all marked frames are held out");
    says(&[mark(1, 24.0, true)], false, "marks[0] (\"liver\" on frame 1) lies outside");
    says(&[mark(0, 6.0, true), mark(0, 6.0, false)], false, "the marks of \"liver\" cancel each other");
    says(&[mark(1, 6.0, true), mark(2, 24.0, true)], true, "marks[1] (\"liver\" on frame 2) lies outside");
    says(&[mark(0, 6.0, false)], false, "all marks say what is not there");
    assert_eq!(refused(&[mark(1, 6.0, true)], false), None);
}

#[test]
fn more_names_than_there_are_ids_are_refused_before_anything_is_written() {
    let place = tempfile::tempdir().unwrap();
    write_clip(&place.path().join("clip"));
    let sequence = Sequence::open(&place.path().join("clip")).unwrap();
    let mark = |k: u8| {
        let [x, y] = [k % 16, k / 16].map(|place| 4.0 + f32::from(place));
        let pixel = Shape::Box { corners_px: [[x, y], [x + 1.0, y + 1.0]] };
        Mark::new(0, &format!("vessel {k}"), true, pixel)
    };
    let marks = Marks::new((0..=u8::MAX).map(mark).collect(), &sequence.canvas()).unwrap();
    let named = MarkedNames { marks: &marks, encoder: encoder(), embeddings: &[] };
    let folder = place.path().join("prep");
    let refused = prepare_from_marks(sequence, named, false, &QUICK, &folder, &mut unobserved);
    let told = refused.err().map(|e| e.to_string()).unwrap();
    assert_eq!(told, "there are more than 255 names. At most 255 can be marked.");
    assert!(!folder.exists());
}

#[test]
fn names_that_the_encoder_cannot_tell_apart_are_told() {
    let (_place, mut prepared) = prepared(false);
    assert!(prepared.cautions().is_empty());
    prepared.classes[1].1 = prepared.classes[0].1.clone();
    let told = prepared.cautions();
    assert_eq!(told.len(), 1);
    assert!(told[0].starts_with("\"liver\" and \"grasper\" cannot be told apart"), "{told:?}");
}

#[test]
fn preparing_again_removes_what_was_there() {
    let (place, before) = prepared(false);
    assert!(before.regions(1).unwrap().is_some());
    let after = prepare(&place.path().join("clip"), &before.folder, true).unwrap();
    assert!(after.regions(1).unwrap().is_none());
    assert!(!before.folder.join("regions/frame_000001.png").exists());
}

#[test]
fn the_recording_is_found_after_both_moved_together() {
    let (place, _) = prepared(false);
    let moved = tempfile::tempdir().unwrap();
    fs::rename(place.path().join("clip"), moved.path().join("clip")).unwrap();
    fs::rename(place.path().join("out"), moved.path().join("out")).unwrap();
    let prepared = Prepared::open(&moved.path().join("out/prep")).unwrap();
    assert!(prepared.sequence.path().ends_with("clip") && prepared.regions(3).unwrap().is_some());
}

#[test]
fn folders_that_are_not_ours_are_left_alone() {
    let (place, before) = prepared(false);
    let clip = place.path().join("clip");
    let fail = |folder: &Path| prepare(&clip, folder, false).unwrap_err().to_string();
    assert!(fail(&clip).contains("recording itself"));
    let other = place.path().join("photos");
    fs::create_dir_all(other.join("regions")).unwrap();
    fs::write(other.join("regions/a.txt"), "mine").unwrap();
    assert!(fail(&other).contains("not empty"));
    assert_eq!(fs::read_to_string(other.join("regions/a.txt")).unwrap(), "mine");
    // An interrupted preparation may be started again.
    fs::remove_file(before.folder.join("prepared.json")).unwrap();
    assert!(Prepared::open(&before.folder).unwrap_err().to_string().contains("not a prepared folder"));
    prepare(&clip, &before.folder, false).unwrap();
}

#[test]
fn wrong_embeddings_are_named() {
    let (place, before) = prepared(false);
    let sequence = Sequence::open(&place.path().join("clip")).unwrap();
    let fail = |embeddings: &[Vec<f32>]| {
        let folder = place.path().join("new");
        let result = prepare_from_labels(
            sequence.clone(),
            encoder(),
            embeddings,
            false,
            &QUICK,
            &folder,
            &mut unobserved,
        );
        assert!(!folder.exists());
        result.unwrap_err().to_string()
    };
    let good = embeddings(&sequence);
    assert!(fail(&good[1..]).contains("found 12"));
    let mut short = good.clone();
    short[2].pop();
    assert!(fail(&short).contains("\"liver\" has 11 numbers"));
    let mut broken = good;
    broken[2][3] = f32::NAN;
    assert!(fail(&broken).contains("liver"));
    drop(before);
}

#[test]
fn a_recording_without_labels_is_refused() {
    let place = tempfile::tempdir().unwrap();
    let clip = place.path().join("clip");
    write_clip(&clip);
    let fail = |clip: &Path| prepare(clip, &place.path().join("prep"), true).unwrap_err().to_string();
    for i in (0..FRAMES).filter(|&i| !Sequence::is_test_frame(i)) {
        GrayImage::from_pixel(WIDTH, HEIGHT, Luma([IGNORE]))
            .save(clip.join(format!("frame_{i}_endo_watershed_mask.png")))
            .unwrap();
    }
    assert!(fail(&clip).contains("no pixel of the training frames has a label"));
    for i in 0..FRAMES {
        fs::remove_file(clip.join(format!("frame_{i}_endo_watershed_mask.png"))).unwrap();
    }
    assert!(fail(&clip).contains("no label masks"));
    assert!(!place.path().join("prep").exists());
}

/// Makes a prepared folder as the previous release wrote it: without the recording's identity and
/// checksums of maps.
fn prepared_before_checksums() -> (tempfile::TempDir, Prepared) {
    let (place, prepared) = prepared(false);
    let file = prepared.folder.join(PREPARED_FILE);
    let mut json: serde_json::Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    json.as_object_mut().unwrap().remove("identity").unwrap();
    json["sha256"].as_object_mut().unwrap().retain(|name, _| !name.starts_with("regions/"));
    fs::write(&file, json.to_string()).unwrap();
    let prepared = Prepared::open(&prepared.folder).unwrap();
    prepared.require_recording().unwrap();
    assert!(prepared.regions(2).unwrap().is_some());
    (place, prepared)
}

#[test]
fn a_recording_that_is_another_now_is_refused_with_the_frame_named() {
    let change = |change: &dyn Fn(&Path)| {
        let (place, prepared) = prepared(false);
        change(&place.path().join("clip"));
        Prepared::open(&prepared.folder).and_then(|p| p.require_recording()).unwrap_err().to_string()
    };
    let renamed = change(&|clip| {
        for kind in ["", "_watershed_mask"] {
            let name = |i: usize| clip.join(format!("frame_{i}_endo{kind}.png"));
            fs::rename(name(3), name(30)).unwrap();
        }
    });
    assert!(renamed.contains("frame 3 \"frame_3_endo.png\" is missing"), "{renamed}");
    let turned = change(&|clip| {
        let file = clip.join("frame_7_endo.png");
        let mut bytes = fs::read(&file).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(file, bytes).unwrap();
    });
    assert!(turned.contains("frame 7 \"frame_7_endo.png\" has another content"), "{turned}");
}

#[test]
fn damaged_folders_are_refused_with_the_file_named() {
    let damage = |name: &str, change: &dyn Fn(Vec<u8>) -> Vec<u8>| {
        let (place, prepared) = prepared(false);
        let file = place.path().join("out/prep").join(name);
        fs::write(&file, change(fs::read(&file).unwrap())).unwrap();
        let opened = Prepared::open(&prepared.folder).and_then(|p| p.regions(2));
        opened.unwrap_err().to_string()
    };
    let cut = |mut bytes: Vec<u8>| {
        bytes.truncate(bytes.len() / 2);
        bytes
    };
    let replace = |from: &'static str, to: &'static str| {
        move |bytes: Vec<u8>| String::from_utf8(bytes).unwrap().replacen(from, to, 1).into_bytes()
    };
    assert!(damage("codec.safetensors", &cut).contains("damaged"));
    assert!(damage("features.safetensors", &|_| Vec::new()).contains("features.safetensors"));
    assert!(damage("prepared.json", &cut).contains("cannot be understood"));
    assert!(damage("prepared.json", &replace("\"version\": 1", "\"version\": 7")).contains("version 7"));
    assert!(damage("prepared.json", &replace("\"frames\": 10", "\"frames\": 11")).contains("11 frames"));
    assert!(
        damage("prepared.json", &replace("\"name\": \"grasper\"", "\"nom\": \"x\""))
            .contains("cannot be understood")
    );
    assert!(damage("regions/frame_000002.png", &cut).contains("frame_000002.png"));
    let small = |value: u16, width| {
        move |_| {
            let place = tempfile::tempdir().unwrap();
            let file = place.path().join("a.png");
            files::write_region_map(&file, RegionMap::filled(width, HEIGHT as usize, value)).unwrap();
            fs::read(file).unwrap()
        }
    };
    assert!(damage("regions/frame_000002.png", &small(0, 32)).contains("checksum"));
    let (place, older) = prepared_before_checksums();
    for (map, says) in [(small(0, 7), "7×24"), (small(3, 32), "row 3")] {
        fs::write(place.path().join("out/prep/regions/frame_000002.png"), map(Vec::new())).unwrap();
        let message = older.regions(2).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
    let (place, prepared) = prepared(false);
    fs::remove_dir_all(place.path().join("clip")).unwrap();
    assert!(Prepared::open(&prepared.folder).unwrap_err().to_string().contains("not there any more"));
}

#[test]
fn region_maps_come_back_to_the_bit() {
    let place = tempfile::tempdir().unwrap();
    let map = RegionMap::from_vec(3, 2, vec![0, 1, 255, 256, 65_534, NO_REGION]);
    let file = place.path().join("a/map.png");
    files::write_region_map(&file, map.clone()).unwrap();
    assert_eq!(files::read_region_map(&file, None).unwrap(), map);
    RgbImage::new(3, 2).save(&file).unwrap();
    assert!(files::read_region_map(&file, None).unwrap_err().to_string().contains("16-bit grey"));
}

/// Prepares the real clip, if it is present: checks classes, coverage, and that prompts for classes differ.
#[test]
fn a_real_clip_is_prepared_in_full() {
    let clip = std::env::var_os("SURGTPGS_DATA").map(|root| Path::new(&root).join("cholecseg8k_raw"));
    let Some(clip) = clip.filter(|clip| clip.exists()) else {
        eprintln!("skipped: no cholecseg8k_raw here (set SURGTPGS_DATA)");
        return;
    };
    let place = tempfile::tempdir().unwrap();
    let prepared = prepare(&clip, &place.path().join("prep"), true).unwrap();
    eprintln!("{:?}", names(&prepared));
    assert!(prepared.classes.len() >= 5);
    let map = prepared.regions(0).unwrap().unwrap();
    let covered = map.data.iter().filter(|&&r| r != NO_REGION).count() as f64 / map.data.len() as f64;
    assert!((0.4..1.0).contains(&covered), "{covered}");
    let first = fs::read(place.path().join("prep/regions/frame_000000.png")).unwrap();
    eprintln!("{covered:.2} of frame 0 has features; its map is {} kB", first.len() / 1000);
}

#[test]
fn what_labels_leave_open_is_background() {
    let dir = tempfile::tempdir().unwrap();
    let [recording, folder] = ["recording", "prepared"].map(|name| dir.path().join(name));
    let small = DemoSettings::of_size(64, 48, 3);
    demo::write(&small, &recording, &mut unobserved).unwrap();
    for i in 0..3 {
        // Liver alone keeps its label.
        let path = recording.join(format!("labels/frame_{i:06}.png"));
        let mut labels = image::open(&path).unwrap().to_luma8();
        labels.pixels_mut().filter(|pixel| pixel.0[0] != 1).for_each(|pixel| pixel.0[0] = 255);
        labels.save(&path).unwrap();
    }
    let sequence = Sequence::open(&recording).unwrap();
    let prepared = |rows: &[Vec<f32>]| {
        prepare_from_labels(sequence.clone(), encoder(), rows, false, &QUICK, &folder, &mut unobserved)
            .unwrap()
    };
    let names = |prepared: &Prepared| -> Vec<String> {
        prepared.classes.iter().map(|(class, _)| class.name.clone()).collect()
    };
    let mut rows = embeddings(&sequence);
    let without = prepared(&rows);
    let liver = without.regions(0).unwrap().unwrap().map(|region| *region == 0);
    assert_eq!(names(&without), ["liver"]);
    rows.extend(one_hot(1, DIM));
    let with = prepared(&rows);
    assert_eq!(names(&with), ["liver", BACKGROUND]);
    let map = with.regions(0).unwrap().unwrap();
    let num_background = map.data.iter().filter(|region| **region == 1).count();
    assert_eq!(map.map(|region| *region == 0), liver);
    assert!(num_background > 1000, "{num_background} of {}", 64 * 48);
}
