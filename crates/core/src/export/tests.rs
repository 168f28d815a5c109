use super::*;
use crate::{
    Remedy,
    about::intended_use,
    mask::CleanUp,
    meaning::EncoderIdentity,
    overlay::{OverlayLook, OverlayStyle},
    relevancy::RelevancySettings,
    stress,
};
use std::sync::Arc;

/// Returns the identity of a text encoder.
fn encoder() -> EncoderIdentity {
    EncoderIdentity {
        name: "builtin".into(),
        sha256: "11".into(),
        dim: 3,
        template: "{}".into(),
        folder: None,
    }
}

/// Returns scores of two prompts on a 40 × 24 picture: the left half scores for one, the right three
/// quarters for the other.
fn scores() -> Vec<Grid<f32>> {
    let image = |f: &dyn Fn(usize) -> f32| Grid::from_vec(40, 24, (0..40 * 24).map(|i| f(i % 40)).collect());
    vec![image(&|x| if x < 20 { 0.9 } else { 0.1 }), image(&|x| if x >= 10 { 0.6 } else { 0.2 })]
}

pub(super) fn picture() -> RgbImage {
    RgbImage::from_fn(40, 24, |x, y| image::Rgb([x as u8 + 1, y as u8 + 1, 200]))
}

pub(super) fn provenance(formats: &[Format], exclusive: bool) -> Provenance {
    let prompt = |text: &str, colour| ExportPrompt {
        text: text.into(),
        threshold: 0.5,
        colour,
        negatives: vec!["object".into()],
        is_instrument: false,
        certainty: None,
        stands_for: None,
    };
    Provenance {
        schema: 3,
        tool: "SurgTPGS test".into(),
        intended_use: intended_use().into(),
        scene_sha256: "00".into(),
        sequence_name: "demo".into(),
        sequence_frames: 4,
        frames_not_shown: Vec::new(),
        hidden: Vec::new(),
        sequence_sha256: Some("22".into()),
        sequence_frame_names: (0..10).map(|i| format!("shot {i}.png")).collect(),
        frames_per_second: Some(25.0),
        frame_seconds: Vec::new(),
        held_out: false,
        training: serde_json::json!({ "steps": 3 }),
        encoder: "builtin".into(),
        encoder_sha256: "11".into(),
        template: "A photo of a {} in the scene".into(),
        relevancy: RelevancySettings::default(),
        relevancy_rung: "exact".into(),
        rendered_by: "CPU".into(),
        prompts: vec![prompt("Bile sac", [0, 200, 255]), prompt("liver", [230, 80, 230])],
        left_out: Vec::new(),
        marks_sha256: None,
        marks_model_sha256: None,
        dicom_sources_sha256: None,
        calibration: serde_json::Value::Null,
        options: ExportOptions { formats: formats.to_vec(), exclusive, ..Default::default() },
    }
}

/// Writes a DICOM segmentation of "liver" on one frame, and returns its path.
pub(crate) fn segmentation_of(folder: &Path, mask: &Mask, frame: usize) -> PathBuf {
    segmentation_from(folder, std::slice::from_ref(mask), frame, None)
}

/// Writes a DICOM segmentation of "liver" on the frames from `first` on, and returns its path.
pub(crate) fn segmentation_from(
    folder: &Path,
    masks: &[Mask],
    first: usize,
    sources: Option<SourceReferences>,
) -> PathBuf {
    let mut how = provenance(&[Format::DicomSeg], false);
    how.prompts.remove(0);
    let frames: Vec<usize> = (first..first + masks.len()).collect();
    let mut export = Export::begin(folder, frames.clone(), how).unwrap().with_sources(sources);
    for mask in masks {
        let picture = RgbImage::new(mask.width as u32, mask.height as u32);
        export.write(&picture, &[mask.map(|is_in| f32::from(u8::from(*is_in)))], None).unwrap();
    }
    export.finish().unwrap();
    folder.join(series::name(Format::DicomSeg, &frames))
}

/// Returns the provenance of an export without clean-up and formats.
pub(crate) fn plain_provenance() -> Provenance {
    provenance(&[], false)
}

fn run(folder: &Path, frames: &[usize], provenance: &Provenance) -> Result<ExportSummary> {
    let mut export = Export::begin(folder, frames.to_vec(), provenance.clone())?;
    while export.next_frame().is_some() {
        export.write(&picture(), &scores(), None)?;
    }
    export.finish()
}

#[test]
fn cutouts_are_straight_and_hold_nothing_of_what_they_hide() {
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), &[7], &provenance(&[Format::Cutout], false)).unwrap();
    let cut = image::open(folder.path().join("cutout/frame_000007_bile-sac.png")).unwrap();
    assert_eq!(cut.color(), image::ColorType::Rgba8);
    let cut = cut.to_rgba8();
    assert_eq!(cut.get_pixel(3, 2).0, [4, 3, 200, 255]);
    assert_eq!(cut.get_pixel(30, 2).0, [0; 4]);
}

#[test]
fn masks_are_0_or_255_and_overlap_only_if_allowed() {
    for (exclusive, shared) in [(false, 255), (true, 0)] {
        let folder = tempfile::tempdir().unwrap();
        run(folder.path(), &[0], &provenance(&[Format::Binary], exclusive)).unwrap();
        let at = |name: &str, x| {
            let mask = image::open(folder.path().join(name)).unwrap();
            assert_eq!(mask.color(), image::ColorType::L8);
            mask.to_luma8().get_pixel(x, 5).0[0]
        };
        assert_eq!([0, 15, 30].map(|x| at("binary/frame_000000_bile-sac.png", x)), [255, 255, 0]);
        assert_eq!([0, 15, 30].map(|x| at("binary/frame_000000_liver.png", x)), [0, shared, 255]);
    }
}

#[test]
fn label_images_carry_ids_that_labels_json_names() {
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), &[0], &provenance(&[Format::Index], false)).unwrap();
    let ids = image::open(folder.path().join("index/frame_000000.png")).unwrap().to_luma8();
    assert_eq!([0, 15, 30].map(|x| ids.get_pixel(x, 5).0[0]), [1, 1, 2]);
    let labels: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("index/labels.json")).unwrap()).unwrap();
    assert_eq!(labels["labels"][1]["prompt"], "liver");
    assert_eq!(labels["labels"][1]["id"], 2);
}

#[test]
fn overlays_are_stamped_unless_switched_off_and_the_record_says_so() {
    let drawn = |stamp: bool| {
        let folder = tempfile::tempdir().unwrap();
        let mut how = provenance(&[Format::Overlay], false);
        how.options.stamp = stamp;
        run(folder.path(), &[0], &how).unwrap();
        let text = std::fs::read_to_string(folder.path().join(PROVENANCE_FILE)).unwrap();
        let record: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(record["options"]["stamp"], stamp);
        assert!(record["intended_use"].as_str().unwrap().contains("Research use only"));
        image::open(folder.path().join("overlay/frame_000000.png")).unwrap().to_rgb8()
    };
    let ink = |image: &RgbImage| image.pixels().filter(|p| p.0 == [p.0[0]; 3] && p.0[0] > 180).count();
    assert_eq!(ink(&drawn(false)), 0);
    assert!(ink(&drawn(true)) > 50);
}

#[test]
fn masks_are_cleaned_up_as_the_record_says_and_scores_stay() {
    let folder = tempfile::tempdir().unwrap();
    let mut how = provenance(&[Format::Binary, Format::Npy], false);
    how.options.clean_up = CleanUp { grow_px: 2, ..Default::default() };
    run(folder.path(), &[0], &how).unwrap();
    let mask = image::open(folder.path().join("binary/frame_000000_bile-sac.png")).unwrap().to_luma8();
    assert_eq!([19, 21, 22].map(|x| mask.get_pixel(x, 5).0[0]), [255, 255, 0]);
    let bytes = std::fs::read(folder.path().join("npy/frame_000000_bile-sac.npy")).unwrap();
    assert_eq!(bytes[bytes.len() - 4 * 40 * 24..], *bytemuck::cast_slice::<f32, u8>(&scores()[0].data));
    let record = std::fs::read_to_string(folder.path().join(PROVENANCE_FILE)).unwrap();
    assert!(record.contains("\"grow_px\": 2"));
}

#[test]
fn overlays_lie_below_instruments_unless_said_otherwise() {
    let tools = Grid::from_vec(2, 1, vec![true, false]);
    let drawn = |below_instruments: bool| {
        let folder = tempfile::tempdir().unwrap();
        let mut how = provenance(&[Format::Overlay], false);
        how.options.stamp = false;
        how.options.look = OverlayLook { style: OverlayStyle::Fill, below_instruments, ..Default::default() };
        let mut export = Export::begin(folder.path(), vec![0], how).unwrap();
        export.write(&picture(), &scores(), Some(&tools)).unwrap();
        image::open(folder.path().join("overlay/frame_000000.png")).unwrap().to_rgb8()
    };
    let is_drawn = |image: &RgbImage, x| image.get_pixel(x, 5) != picture().get_pixel(x, 5);
    let (below, above) = (drawn(true), drawn(false));
    assert!(!is_drawn(&below, 5) && is_drawn(&above, 5), "the left half is instrument");
    assert!(is_drawn(&below, 30) && is_drawn(&above, 30));
}

#[test]
fn heatmaps_of_exclusive_prompts_leave_out_only_what_another_one_has_won() {
    // The first prompt wins the right half, and neither the left one.
    let first = Grid::from_vec(40, 24, (0..40 * 24).map(|i| if i % 40 < 20 { 0.2 } else { 0.6 }).collect());
    let scores = [first.clone(), Grid::filled(40, 24, 0.4)];
    let nothing = [first, Grid::filled(40, 24, 0.0)];
    let drawn = |exclusive: bool, scores: &[Grid<f32>]| {
        let mut how = provenance(&[], exclusive);
        how.options.look.style = OverlayStyle::Heatmap;
        FrameContent::new(&how, 0, &picture(), scores, None).small_overlay(40)
    };
    let exclusive = drawn(true, &scores);
    assert_eq!(exclusive, drawn(false, &scores), "the highest scores are the same");
    let left = |image: &RgbImage| *image.get_pixel(5, 5);
    assert_ne!(left(&exclusive), left(&drawn(true, &nothing)), "the second prompt is there");
}

#[test]
fn overlays_have_the_size_and_the_words_that_were_asked_for() {
    let drawn = |options: &dyn Fn(&mut ExportOptions)| {
        let folder = tempfile::tempdir().unwrap();
        let mut how = provenance(&[Format::Overlay, Format::Binary], false);
        how.options.stamp = false;
        options(&mut how.options);
        run(folder.path(), &[11], &how).unwrap();
        let mask = image::open(folder.path().join("binary/frame_000011_liver.png")).unwrap();
        assert_eq!((mask.width(), mask.height()), (40, 24), "masks keep the recording's size");
        image::open(folder.path().join("overlay/frame_000011.png")).unwrap().to_rgb8()
    };
    assert_eq!(drawn(&|_| {}).dimensions(), (40, 24));
    let large = drawn(&|o| o.width_px = Some(400));
    assert_eq!(large.dimensions(), (400, 240));
    let ink = |image: &RgbImage| image.pixels().filter(|p| p.0 == [p.0[0]; 3] && p.0[0] > 180).count();
    let captioned = drawn(&|o| (o.width_px, o.captions) = (Some(400), true));
    assert!(ink(&large) == 0 && ink(&captioned) > 50, "{}", ink(&captioned));
    let has = |colour: [u8; 3]| (2..8).any(|x| (10..30).any(|y| captioned.get_pixel(x, y).0 == colour));
    assert!(has([0, 200, 255]) && has([230, 80, 230]), "a swatch for each prompt");
    let heat = drawn(&|o| (o.width_px, o.look.style) = (Some(400), OverlayStyle::Heatmap));
    let palette = OverlayLook::default().palette;
    assert_eq!(heat.get_pixel(399, 225).0, palette.colour(1.0).map(|v| v as u8), "the scale");
}

#[test]
fn the_record_lists_every_file_with_its_hash() {
    let folder = tempfile::tempdir().unwrap();
    let how = provenance(&[Format::Cutout, Format::Binary, Format::Index], false);
    let summary = run(folder.path(), &[0, 2], &how).unwrap();
    assert_eq!(summary, ExportSummary { complete: true, frames: 2, files: 10, ..Default::default() });
    let record = Record::read(folder.path()).unwrap().unwrap();
    assert!(record.complete);
    for file in record.files.all() {
        let bytes = std::fs::read(folder.path().join(&file.name)).unwrap();
        assert_eq!(sha256(&bytes), file.sha256);
    }
}

#[test]
fn the_record_lists_files_by_frame_and_name_whatever_their_order() {
    let file = |frame: Option<usize>, name: &str| ExportedFile {
        name: name.into(),
        sha256: "0".into(),
        frame,
        prompt: None,
    };
    let mut record = Record::new(provenance(&[Format::Binary], false));
    record.add(10, vec![file(Some(10), "b"), file(Some(10), "a")]);
    record.add(9, vec![file(Some(9), "c"), file(Some(9), "old")]);
    record.add_series(file(None, "z"));
    record.add_series(ExportedFile { sha256: "1".into(), ..file(None, "z") });
    record.add(9, vec![file(Some(9), "c")]);
    let json = serde_json::to_value(&record).unwrap();
    let named = |file: &serde_json::Value| file["name"].as_str().unwrap().to_owned();
    let names: Vec<String> = json["files"].as_array().unwrap().iter().map(named).collect();
    assert_eq!(names, ["z", "c", "a", "b"]);
    assert_eq!(json["files"][0]["sha256"], "1");
    assert_eq!(serde_json::from_value::<Record>(json).unwrap(), record);
}

#[test]
fn records_of_long_exports_are_written_early_and_rarely() {
    let (mut unsaved, mut written, mut listed) = (0, 0, 0);
    for done in 1..=5000 {
        unsaved += 1;
        if is_record_due(unsaved, done) {
            (unsaved, written, listed) = (0, written + 1, listed + done);
        }
        assert!(unsaved < 32.max(done / 8 + 1), "{unsaved} of {done}");
        assert!(done != 32 || written == 1);
    }
    assert!(written < 50 && listed < 10 * 5000, "{written}, {listed}");
}

#[test]
fn an_export_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let how = provenance(&[Format::Binary], false);
    let mut first = Export::begin(folder.path(), vec![0, 1, 2], how.clone()).unwrap();
    assert_eq!(first.next_frame(), Some(0));
    first.write(&picture(), &scores(), None).unwrap();
    assert!(!first.finish().unwrap().complete);

    std::fs::remove_file(folder.path().join("binary/frame_000000_liver.png")).unwrap();
    let mut second = Export::begin(folder.path(), vec![0, 1, 2], how.clone()).unwrap();
    assert_eq!(second.next_frame(), Some(0), "a frame with a missing file is not finished");
    while second.next_frame().is_some() {
        second.write(&picture(), &scores(), None).unwrap();
    }
    assert!(second.finish().unwrap().complete);

    let third = run(folder.path(), &[0, 1, 2], &how).unwrap();
    assert_eq!((third.complete, third.skipped_frames), (true, 3));
}

#[test]
fn frames_that_the_scene_does_not_show_are_not_said_to_be_empty() {
    let folder = tempfile::tempdir().unwrap();
    let formats =
        [Format::Binary, Format::Yolo, Format::Csv, Format::Json, Format::Coco, Format::LabelStudio];
    let how = Provenance { frames_not_shown: vec![[1, 2]], ..provenance(&formats, false) };
    for skipped in [0, 2] {
        let summary = run(folder.path(), &[0, 1, 2, 3], &how).unwrap();
        assert_eq!((summary.complete, summary.skipped_frames, summary.frames_not_shown), (true, skipped, 2));
    }
    let read = |format: Format| {
        std::fs::read_to_string(folder.path().join(series::name(format, &[0, 1, 2, 3]))).unwrap()
    };
    for format in [Format::Binary, Format::Yolo] {
        let entries = std::fs::read_dir(folder.path().join(format.name())).unwrap();
        let names = entries.map(|e| e.unwrap().file_name().into_string().unwrap());
        let frames: std::collections::BTreeSet<_> = names
            .filter_map(|name| name.get(..12).map(str::to_owned))
            .filter(|n| n.starts_with("frame"))
            .collect();
        assert_eq!(Vec::from_iter(frames), ["frame_000000", "frame_000003"], "{}", format.name());
    }
    let csv = read(Format::Csv);
    let rows = csv.lines().filter(|line| line.starts_with("2,"));
    assert_eq!(
        Vec::from_iter(rows),
        ["2,0.04,Bile sac,,,,,,,,shot 1.png,not_shown", "2,0.04,liver,,,,,,,,shot 1.png,not_shown"]
    );
    let json = |format| serde_json::from_str::<serde_json::Value>(&read(format)).unwrap();
    let row = &json(Format::Json)["measurements"][2];
    assert!(row["area_px"].is_null() && row["max_score"].is_null() && row["answer"] == "not_shown", "{row}");
    assert_eq!(json(Format::Coco)["images"].as_array().unwrap().len(), 2);
    assert_eq!(json(Format::LabelStudio).as_array().unwrap().len(), 2);
}

#[test]
fn an_export_goes_on_with_another_number_of_threads() {
    let encoder = encoder();
    let by = |renderer: &str| {
        let plain = provenance(&[Format::Binary], false);
        let (names, scene) = ((renderer.to_owned(), "exact"), stress::ordinary(1));
        Provenance::new(&scene, "00".into(), &encoder, plain.relevancy, names, plain.prompts, plain.options)
    };
    let folder = tempfile::tempdir().unwrap();
    let mut stopped = Export::begin(folder.path(), vec![0, 1], by("CPU, 2 threads, Avx512")).unwrap();
    stopped.write(&picture(), &scores(), None).unwrap();
    assert!(!stopped.finish().unwrap().complete);
    assert!(Export::is_of(folder.path(), &by("CPU, 16 threads, Avx512")));
    assert!(!Export::is_of(folder.path(), &by("CPU, 2 threads, Avx2")), "which may round differently");
    let whole = run(folder.path(), &[0, 1], &by("CPU, 16 threads, Avx512")).unwrap();
    assert_eq!((whole.complete, whole.skipped_frames), (true, 1));
    // As older records have it.
    let older = Provenance { rendered_by: "CPU, 2 threads, Avx512".into(), ..by("") };
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), &[0], &older).unwrap();
    assert!(Export::is_of(folder.path(), &by("CPU, 3 threads, Avx512")));
}

#[test]
fn numbers_of_the_record_come_back_to_the_last_bit() {
    let folder = tempfile::tempdir().unwrap();
    let floors: Vec<f32> = (1..2000_u16).map(|i| f32::from(i).recip().sin()).collect();
    let how = Provenance { calibration: serde_json::json!(floors), ..provenance(&[Format::Binary], false) };
    run(folder.path(), &[0], &how).unwrap();
    assert!(Export::is_of(folder.path(), &how));
}

#[test]
fn the_record_says_what_is_hidden() {
    let plain = provenance(&[Format::Binary], false);
    let hidden = serde_json::json!([{ "x": 10, "y": 8, "width": 200, "height": 24 }]);
    let identity = serde_json::json!({ "frames": ["- 9 0001.png"], "hidden": hidden });
    let mut scene = stress::ordinary(1);
    scene.provenance.identity = Some(Arc::new(serde_json::from_value(identity).unwrap()));
    let (encoder, names) = (encoder(), ("CPU".to_owned(), "exact"));
    let how =
        Provenance::new(&scene, "00".into(), &encoder, plain.relevancy, names, plain.prompts, plain.options);
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), &[0], &how).unwrap();
    assert!(Export::is_of(folder.path(), &how));
    let text = std::fs::read_to_string(folder.path().join("provenance.json")).unwrap();
    assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap()["hidden"], hidden);
}

#[test]
fn words_without_meaning_are_recorded_and_nothing_else_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let spleen = LeftOut { text: "spleen".into(), nearest: None, why: "not in this recording".into() };
    let how = Provenance {
        prompts: Vec::new(),
        left_out: vec![spleen.clone()],
        ..provenance(&[Format::Binary, Format::Index, Format::Video], false)
    };
    let expected = ExportSummary { complete: true, left_out: vec![spleen], ..Default::default() };
    assert_eq!(run(folder.path(), &[0, 1], &how).unwrap(), expected);
    assert!(Record::read(folder.path()).unwrap().unwrap().complete);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the record is alone");
    assert_eq!(run(folder.path(), &[0, 1], &how).unwrap(), expected, "and stays as it is");
}

#[test]
fn nothing_foreign_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let mine = folder.path().join("binary/frame_000000_liver.png");
    std::fs::create_dir_all(mine.parent().unwrap()).unwrap();
    std::fs::write(&mine, b"mine").unwrap();
    let how = provenance(&[Format::Binary], false);
    assert!(run(folder.path(), &[0], &how).unwrap_err().remedy() == Some(Remedy::Replace));
    assert_eq!(std::fs::read(&mine).unwrap(), b"mine");

    std::fs::remove_file(&mine).unwrap();
    run(folder.path(), &[0], &how).unwrap();
    std::fs::write(&mine, b"edited").unwrap();
    assert!(run(folder.path(), &[0], &how).unwrap_err().to_string().contains("changed"));
    let other = provenance(&[Format::Binary], true);
    assert!(run(folder.path(), &[0], &other).unwrap_err().to_string().contains("another export"));
}

#[test]
fn empty_requests_and_wrong_sizes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let how = provenance(&[Format::Binary], false);
    assert!(run(folder.path(), &[], &how).is_err());
    assert!(run(folder.path(), &[0], &provenance(&[], false)).is_err());
    assert!(run(folder.path(), &[0], &Provenance { prompts: Vec::new(), ..how.clone() }).is_err());
    let mut export = Export::begin(folder.path(), vec![0], how).unwrap();
    assert!(export.write(&RgbImage::new(3, 3), &scores(), None).is_err());
    assert!(export.write(&picture(), &scores()[..1], None).is_err());
}

#[test]
fn scores_are_kept_to_half_a_step_as_pictures_and_exactly_as_arrays() {
    let folder = tempfile::tempdir().unwrap();
    let how = provenance(&[Format::Score, Format::Npy], false);
    let values = [0.0, 1e-6, 0.333_333_3, 0.5, 0.999_99, 1.0, f32::NAN];
    let ramp = Grid::from_vec(40, 24, (0..40 * 24).map(|i| values[i % 7]).collect());
    let mut export = Export::begin(folder.path(), vec![0], how).unwrap();
    export.write(&picture(), &[ramp.clone(), scores().remove(1)], None).unwrap();
    export.finish().unwrap();
    let seen = image::open(folder.path().join("score/frame_000000_bile-sac.png")).unwrap();
    assert_eq!(seen.color(), image::ColorType::L16);
    let array: ndarray::Array2<f32> =
        ndarray_npy::read_npy(folder.path().join("npy/frame_000000_bile-sac.npy")).unwrap();
    assert_eq!(array.dim(), (24, 40));
    for ((step, score), same) in seen.to_luma16().pixels().zip(&ramp.data).zip(&array) {
        assert_eq!(score.to_bits(), same.to_bits());
        let wanted = if score.is_nan() { 0.0 } else { f64::from(*score) };
        assert!((f64::from(step.0[0]) / 65535.0 - wanted).abs() <= 0.5001 / 65535.0);
    }
}

#[test]
fn outlines_are_lines_along_the_edges_of_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let mut how = provenance(&[Format::Outline], false);
    how.prompts[0].text = "bile & <sac>".into();
    run(folder.path(), &[3], &how).unwrap();
    let svg = std::fs::read_to_string(folder.path().join("outline/frame_000003.svg")).unwrap();
    assert!(svg.contains("viewBox=\"0 0 40 24\""));
    assert!(svg.contains("d=\"M0 0H20V24H0Z\"><title>bile &amp; &lt;sac&gt;</title>"), "{svg}");
    assert!(svg.contains("stroke=\"#e650e6\""));
    assert!(svg.contains("research use only"));
    how.options.stamp = false;
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), &[3], &how).unwrap();
    let svg = std::fs::read_to_string(folder.path().join("outline/frame_000003.svg")).unwrap();
    assert!(!svg.contains("research use only"));
}

#[test]
fn slugs_are_plain_and_distinct() {
    let texts = ["Bile sac!", "bile  SAC", "胆囊", "../x", "肝", "肝"];
    let names = slugs(texts);
    assert!(names[0].starts_with("bile-sac_") && names[2].starts_with("prompt_"), "{names:?}");
    assert_eq!((names[3].as_str(), &names[5]), ("x", &format!("{}_2", names[4])));
    assert!(names.iter().all(|name| name.is_ascii()));
    assert_eq!(names.iter().collect::<std::collections::BTreeSet<_>>().len(), 6);
    // The order of the prompts does not matter.
    let mut turned = slugs(texts.into_iter().rev());
    turned.reverse();
    assert_eq!((&turned[..4]), (&names[..4]));
}
