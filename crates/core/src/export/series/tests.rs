//! Tests that read back the files about all frames.

use crate::{
    annotations::{self, Canvas},
    dicom::Segmentation,
    export::{
        Export, ExportOptions, ExportSummary, Format, PROVENANCE_FILE, Provenance, SegType, VideoFault,
        num_files,
        tests::{picture, provenance},
    },
    grid::{Grid, Mask},
    mask::{column_runs, compressed, threshold},
    sequence::{Sequence, SourceFrame, SourceInstance, SourceReferences},
};
use serde_json::Value;
use std::{
    collections::{BTreeMap, BTreeSet},
    io::Read,
    path::{Path, PathBuf},
};

const FRAMES: usize = 4;

/// Returns scores of two prompts on 40 × 24 pixels: a lopsided block that moves by (3, 1) px a frame, and
/// one that is gone on frame 1.
fn scores(frame: usize) -> Vec<Grid<f32>> {
    let image = |f: &dyn Fn(usize, usize) -> f32| {
        Grid::from_vec(40, 24, (0..40 * 24).map(|i| f(i % 40, i / 40)).collect())
    };
    let block = move |x: usize, y: usize| {
        let (x, y) = (x.wrapping_sub(3 * frame), y.wrapping_sub(frame));
        if x < 10 && y < 7 && !(x > 6 && y < 2) { 0.75 } else { 0.25 }
    };
    let rest = move |x: usize, y: usize| if frame != 1 && x + y > 40 { 0.9 } else { 0.1 };
    vec![image(&block), image(&rest)]
}

fn export(folder: &Path, how: &Provenance, stop_after: usize) -> ExportSummary {
    let mut export = Export::begin(folder, (0..FRAMES).collect(), how.clone()).unwrap();
    for _ in 0..stop_after {
        let Some(frame) = export.next_frame() else { break };
        export.write(&picture(), &scores(frame), None).unwrap();
    }
    export.finish().unwrap()
}

fn export_one(format: Format, exclusive: bool) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    assert!(export(folder.path(), &provenance(&[format], exclusive), FRAMES).complete);
    let file = folder.path().join(super::name(format, &[0, 1, 2, 3]));
    (folder, file)
}

fn masks(frame: usize) -> Vec<Mask> {
    scores(frame).iter().map(|s| threshold(s, 0.5)).collect()
}

#[test]
fn coco_has_an_annotation_per_prompt_and_frame_where_it_was_found() {
    let (_folder, file) = export_one(Format::Coco, false);
    let coco: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    assert_eq!(coco["images"].as_array().unwrap().len(), FRAMES);
    assert_eq!((&coco["images"][2]["id"], &coco["images"][2]["height"]), (&2.into(), &24.into()));
    assert_eq!(coco["categories"][1]["name"], "liver");
    assert_eq!(coco["images"][1]["source"], "shot 1.png");
    let annotations = coco["annotations"].as_array().unwrap();
    let places: Vec<(u64, u64)> = annotations
        .iter()
        .map(|a| (a["image_id"].as_u64().unwrap(), a["category_id"].as_u64().unwrap()))
        .collect();
    assert_eq!(places, [(0, 1), (0, 2), (1, 1), (2, 1), (2, 2), (3, 1), (3, 2)]);
    for (i, annotation) in annotations.iter().enumerate() {
        assert_eq!(annotation["id"], i + 1);
        let mask = &masks(places[i].0 as usize)[places[i].1 as usize - 1];
        assert_eq!(annotation["area"], mask.count());
        assert_eq!(annotation["segmentation"]["size"], serde_json::json!([24, 40]));
        assert_eq!(annotation["segmentation"]["counts"], compressed(&column_runs(mask)));
    }
    assert_eq!(annotations[2]["bbox"], serde_json::json!([3, 1, 10, 7]));
}

#[test]
fn the_tables_tell_area_place_and_motion() {
    let (_folder, file) = export_one(Format::Csv, false);
    let csv = std::fs::read_to_string(file).unwrap();
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(
        lines[..4],
        [
            "frame_from_1,time_s,prompt,area_px,area_fraction,mean_score,max_score,centroid_x_px,centroid_y_px,moved_px,source,answer",
            "1,0.0,Bile sac,64,0.06666666666666667,0.75,0.75,4.671875,3.734375,,shot 0.png,found",
            "1,0.0,liver,253,0.2635416666666667,0.8999999761581421,0.9,32.5,16.5,,shot 0.png,found",
            "2,0.04,Bile sac,64,0.06666666666666667,0.75,0.75,7.671875,4.734375,3.1622776601683795,shot 1.png,found",
        ]
    );
    assert_eq!(lines[4], "2,0.04,liver,0,0.0,,0.1,,,,shot 1.png,absent", "what is not there has no place");
    assert_eq!(lines[6].rsplit(',').nth(2), Some("0.0"), "the way is from where it was seen last");
    assert_eq!(lines.len(), 1 + 2 * FRAMES);

    let (_folder, file) = export_one(Format::Json, false);
    let json: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    assert_eq!((&json["frames_per_second"], &json["frames"]), (&25.0.into(), &FRAMES.into()));
    let rows = json["measurements"].as_array().unwrap();
    let names: Vec<&str> = lines[0].split(',').collect();
    for (row, line) in rows.iter().zip(&lines[1..]) {
        assert_eq!(row.as_object().unwrap().len(), names.len());
        let number: u64 = line.split(',').next().unwrap().parse().unwrap();
        assert_eq!(row["frame"], number - 1, "JSON counts from 0");
        for (name, field) in names.iter().zip(line.split(',')).skip(1) {
            let same = match &row[*name] {
                Value::Null => field.is_empty(),
                Value::String(text) => text == field,
                number => number.as_f64() == field.parse().ok(),
            };
            assert!(same, "{name}: {row} and {line}");
        }
    }
    assert_eq!(rows.len(), lines.len() - 1);
}

#[test]
fn times_by_an_assumed_speed_are_said_to_be() {
    let folder = tempfile::tempdir().unwrap();
    let how = Provenance { frames_per_second: None, ..provenance(&[Format::Csv], false) };
    assert!(export(folder.path(), &how, FRAMES).complete);
    let csv = std::fs::read_to_string(folder.path().join(super::name(Format::Csv, &[0, 1, 2, 3]))).unwrap();
    assert!(csv.starts_with("frame_from_1,time_s_if_25_fps,prompt,"), "{csv}");
    assert!(csv.lines().nth(3).unwrap().starts_with("2,0.04,Bile sac"), "{csv}");
}

#[test]
fn uneven_frames_keep_their_times_in_tables_and_videos() {
    let folder = tempfile::tempdir().unwrap();
    let frame_seconds = vec![0.0, 0.1, 0.5, 0.6];
    let how = Provenance {
        frame_seconds: frame_seconds.clone(),
        ..provenance(&[Format::Csv, Format::Video], false)
    };
    assert!(export(folder.path(), &how, FRAMES).complete);
    let file = |format| folder.path().join(super::name(format, &[0, 1, 2, 3]));
    let csv = std::fs::read_to_string(file(Format::Csv)).unwrap();
    assert!(csv.lines().nth(5).unwrap().starts_with("3,0.5,Bile sac"), "{csv}");
    let video = Sequence::open(&file(Format::Video)).unwrap();
    assert_eq!(video.frame_seconds(), frame_seconds);
    assert!((video.time(2) - 5.0 / 7.0).abs() < 1e-6, "{}", video.time(2));
}

/// Reads header and voxels.
fn read_nrrd(file: &Path) -> (String, Vec<u8>) {
    let bytes = std::fs::read(file).unwrap();
    let end = bytes.windows(2).position(|pair| pair == b"\n\n").unwrap();
    let mut voxels = Vec::new();
    flate2::read::GzDecoder::new(&bytes[end + 2..]).read_to_end(&mut voxels).unwrap();
    (String::from_utf8(bytes[..end].to_vec()).unwrap(), voxels)
}

#[test]
fn slicer_volumes_have_three_axes_and_named_segments() {
    let (_folder, file) = export_one(Format::Nrrd, true);
    assert!(file.to_str().unwrap().ends_with("nrrd/frames_000000-000003.seg.nrrd"));
    let (header, voxels) = read_nrrd(&file);
    for line in [
        "dimension: 3",
        "sizes: 40 24 4",
        "kinds: domain domain domain",
        "Segment1_Name:=liver",
        "Segment1_LabelValue:=2",
        "Segment0_Color:=0.000000 0.784314 1.000000",
    ] {
        assert!(header.lines().any(|l| l == line), "{line} is missing in\n{header}");
    }
    assert!(header.contains("none is in millimetres"));
    for (frame, slice) in voxels.chunks_exact(40 * 24).enumerate() {
        let [a, b] = &masks(frame)[..] else { panic!("two prompts") };
        // On pixels that both prompts found, the second has the higher score.
        let label = |(a, b): (&bool, &bool)| if *b { 2 } else { u8::from(*a) };
        assert_eq!(slice, a.data.iter().zip(&b.data).map(label).collect::<Vec<_>>());
    }
}

#[test]
fn names_of_any_letters_come_back_from_slicer_volumes() {
    let names = ["Gallenblase ü, \"links\": 胆囊 🫀", " a:=b\\new\nline\\"];
    let folder = tempfile::tempdir().unwrap();
    let mut how = provenance(&[Format::Nrrd], false);
    how.prompts.iter_mut().zip(names).for_each(|(prompt, name)| prompt.text = name.into());
    assert!(export(folder.path(), &how, FRAMES).complete);
    let file = folder.path().join(super::name(Format::Nrrd, &[0, 1, 2, 3]));
    let (header, _) = read_nrrd(&file);
    let line = header.lines().find_map(|line| line.strip_prefix("segment_names:=")).unwrap();
    let read: Vec<String> = serde_json::from_str(line).unwrap();
    assert_eq!(read, names);
    // Neither of the two escapes of NRRD, which some readers undo and others do not.
    assert!(line.is_ascii() && !line.contains(r"\n") && !line.contains(r"\\"), "{line}");
    let canvas = Canvas { width: 40, height: 24, frame_names: Vec::new(), num_frames: FRAMES };
    let found = annotations::read(&file, &canvas).unwrap();
    let found: BTreeSet<&str> = found.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(found, names.map(str::trim).into());
    // As pynrrd reads the file and writes it again.
    let bytes = std::fs::read(&file).unwrap();
    let end = bytes.windows(2).position(|pair| pair == b"\n\n").unwrap();
    let header: Vec<u8> = bytes[..end].iter().copied().filter(u8::is_ascii).collect();
    std::fs::write(&file, [&header, &bytes[end..]].concat()).unwrap();
    let found = annotations::read(&file, &canvas).unwrap();
    let found: BTreeSet<&str> = found.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(found, names.map(str::trim).into());
}

#[test]
fn prompts_that_share_pixels_are_layers() {
    let (_folder, file) = export_one(Format::Nrrd, false);
    let (header, voxels) = read_nrrd(&file);
    assert!(header.contains("dimension: 4\n") && header.contains("sizes: 2 40 24 4\n"));
    assert!(header.contains("Segment1_LabelValue:=1\nSegment1_Layer:=1\n"));
    let wanted = (0..FRAMES).flat_map(|frame| {
        let [a, b] = <[Mask; 2]>::try_from(masks(frame)).unwrap();
        a.data.into_iter().zip(b.data).flat_map(|(a, b)| [u8::from(a), u8::from(b)]).collect::<Vec<_>>()
    });
    assert_eq!(voxels, wanted.collect::<Vec<_>>());
}

#[test]
fn videos_of_any_speed_can_be_written() {
    // Scenes may hold frame rates that no recording is believed to have.
    for speed in [1e-6, 0.5, 9_999.0, 100_000.0, 1e30] {
        let folder = tempfile::tempdir().unwrap();
        let mut how = provenance(&[Format::Video, Format::Gif], false);
        how.frames_per_second = Some(speed);
        export(folder.path(), &how, FRAMES);
        let video = Sequence::open(&folder.path().join("video/frames_000000-000003.mp4")).unwrap();
        assert_eq!(video.num_frames(), FRAMES, "{speed}");
    }
}

#[test]
fn the_video_shows_the_overlays_at_the_recordings_speed() {
    let folder = tempfile::tempdir().unwrap();
    let how = provenance(&[Format::Video, Format::Overlay], false);
    export(folder.path(), &how, FRAMES);
    let video = Sequence::open(&folder.path().join("video/frames_000000-000003.mp4")).unwrap();
    assert_eq!((video.num_frames(), video.width(), video.height()), (FRAMES, 40, 24));
    assert!((video.frames_per_second().unwrap() - 25.0).abs() < 0.01);
    let mut worst = 0.0_f64;
    for frame in 0..FRAMES {
        let drawn =
            image::open(folder.path().join(format!("overlay/frame_{frame:06}.png"))).unwrap().to_rgb8();
        let seen = video.frame(frame).unwrap();
        // Colours are stored at half size and bleed at lines, so only the brightness is compared.
        let light = |p: &image::Rgb<u8>| {
            let [r, g, b] = p.0.map(f64::from);
            0.299 * r + 0.587 * g + 0.114 * b
        };
        let square = |(a, b): (&image::Rgb<u8>, &image::Rgb<u8>)| (light(a) - light(b)).powi(2);
        let error: f64 = drawn.pixels().zip(seen.pixels()).map(square).sum();
        worst = worst.max((error / f64::from(drawn.width() * drawn.height())).sqrt());
    }
    assert!(worst < 6.0, "brightness is wrong by {worst} of 255, root mean square");
}

#[test]
fn odd_sizes_are_filled_up_in_videos() {
    let folder = tempfile::tempdir().unwrap();
    let how = provenance(&[Format::Video], false);
    let mut export = Export::begin(folder.path(), vec![0], how).unwrap();
    let odd = Grid::filled(33, 21, 0.2);
    let grey = image::RgbImage::from_pixel(33, 21, image::Rgb([120; 3]));
    export.write(&grey, &[odd.clone(), odd], None).unwrap();
    export.finish().unwrap();
    let video = Sequence::open(&folder.path().join("video/frames_000000-000000.mp4")).unwrap();
    assert_eq!((video.width(), video.height()), (34, 22));
    let corner = video.frame(0).unwrap().get_pixel(33, 5).0;
    assert!(corner.iter().all(|v| v.abs_diff(120) < 6), "{corner:?}");
}

#[test]
fn sizes_that_no_video_has_are_told_with_a_width_that_fits() {
    let fault = |size: (usize, usize), width_px: Option<u32>| {
        let options = ExportOptions { formats: vec![Format::Video], width_px, ..Default::default() };
        VideoFault::of(&options, size)
    };
    for (size, width) in [
        ((3840, 2160), None),
        ((2160, 3840), None),
        ((960, 540), Some(3840)),
        ((15, 15), None),
        ((9, 9), Some(64)),
    ] {
        assert_eq!(fault(size, width), None, "{size:?} {width:?}");
    }
    for (size, width, says, fitting) in [
        ((1920, 1080), Some(7680), "at most 3840×2160 pixels, and this one would have 7680×4320", Some(3840)),
        ((4096, 2160), None, "at most 3840×2160", Some(3840)),
        ((3000, 2900), None, "at most 3840×2160", Some(2234)),
        ((1080, 1920), Some(2200), "at most 2160×3840", Some(2160)),
        ((12, 12), None, "at least 16×16", Some(64)),
        ((4000, 10), None, "at least 16×16", None),
    ] {
        let fault = fault(size, width).unwrap();
        assert!(fault.to_string().contains(says), "{size:?}: {fault}");
        assert_eq!(fault.fitting, fitting, "{size:?}");
    }
    let masks = ExportOptions { formats: vec![Format::Binary], width_px: Some(7680), ..Default::default() };
    assert_eq!(VideoFault::of(&masks, (1920, 1080)), None, "there is no video");
}

#[test]
fn a_video_of_a_size_that_the_encoder_refuses_is_not_begun() {
    let write = |side: u32| {
        let folder = tempfile::tempdir().unwrap();
        let how = provenance(&[Format::Csv, Format::Video], false);
        let mut export = Export::begin(folder.path(), vec![0], how).unwrap();
        let scores = Grid::filled(side as usize, side as usize, 0.2);
        let grey = image::RgbImage::from_pixel(side, side, image::Rgb([120; 3]));
        export.write(&grey, &[scores.clone(), scores], None)
    };
    write(15).unwrap();
    let error = write(14).unwrap_err().to_string();
    assert!(error.contains("at least 16×16 pixels") && !error.contains("OpenH264"), "{error}");
}

#[test]
fn gifs_last_as_long_as_the_recording() {
    let (_folder, file) = export_one(Format::Gif, false);
    let mut reader = gif::DecodeOptions::new().read_info(std::fs::File::open(file).unwrap()).unwrap();
    assert_eq!((reader.width(), reader.height()), (40, 24));
    let mut delays = Vec::new();
    while let Some(frame) = reader.read_next_frame().unwrap() {
        delays.push(frame.delay);
    }
    assert_eq!(delays, [4; FRAMES]);
}

#[test]
fn fast_and_long_gifs_leave_frames_out_and_keep_the_time() {
    let folder = tempfile::tempdir().unwrap();
    let mut how = provenance(&[Format::Gif], false);
    how.frames_per_second = Some(120.0);
    let mut export = Export::begin(folder.path(), (0..10).collect(), how).unwrap();
    while let Some(frame) = export.next_frame() {
        export.write(&picture(), &scores(frame), None).unwrap();
    }
    export.finish().unwrap();
    let file = std::fs::File::open(folder.path().join("gif/frames_000000-000009.gif")).unwrap();
    let mut reader = gif::DecodeOptions::new().read_info(file).unwrap();
    let mut delays = Vec::new();
    while let Some(frame) = reader.read_next_frame().unwrap() {
        delays.push(frame.delay);
    }
    // Every third frame, at 0, 2.5, 5 and 7.5 hundredths of a second; none is shorter than viewers can show.
    assert_eq!(delays, [3, 2, 3, 2]);
}

#[test]
fn sheets_show_frames_side_by_side() {
    let (_folder, file) = export_one(Format::Sheet, false);
    let sheet = image::open(file).unwrap().to_rgb8();
    let (tile, gap, line) = (40, 4, 20);
    assert_eq!(sheet.dimensions(), (4 * (tile + gap) + gap, 24 + line + gap + line));
    // A pixel of the frame that no prompt touches, on each tile.
    for column in 0..4 {
        assert_eq!(sheet.get_pixel(gap + column * (tile + gap) + 1, gap + 20), picture().get_pixel(1, 20));
    }
    let ink = |rows: std::ops::Range<u32>| {
        rows.flat_map(|y| (0..sheet.width()).map(move |x| (x, y)))
            .filter(|&(x, y)| sheet.get_pixel(x, y).0.iter().all(|v| *v > 180))
            .count()
    };
    assert!(ink(28..48) > 50, "frame numbers stand below the tiles");
    assert!(ink(sheet.height() - line..sheet.height()) > 50, "the stamp stands at the bottom");
}

#[test]
fn sheets_say_which_colour_is_which_prompt_where_names_are_wanted() {
    let folder = tempfile::tempdir().unwrap();
    let mut how = provenance(&[Format::Sheet], false);
    how.options.captions = true;
    assert!(export(folder.path(), &how, FRAMES).complete);
    let file = folder.path().join(super::name(Format::Sheet, &[0, 1, 2, 3]));
    let sheet = image::open(file).unwrap().to_rgb8();
    // Between the tiles with their words and the stamp.
    let legend = 48..sheet.height() - 20;
    let count = |is_so: &dyn Fn([u8; 3]) -> bool| {
        let pixels = sheet.enumerate_pixels();
        pixels.filter(|(_, y, pixel)| legend.contains(y) && is_so(pixel.0)).count()
    };
    assert!(how.prompts.iter().all(|prompt| count(&|pixel| pixel == prompt.colour) > 50));
    assert!(count(&|pixel| pixel.iter().all(|v| *v > 180)) > 20, "the names");
    how.prompts[1].text = "the second long instrument".into();
    let other = tempfile::tempdir().unwrap();
    assert!(export(other.path(), &how, FRAMES).complete);
    let file = other.path().join(super::name(Format::Sheet, &[0, 1, 2, 3]));
    assert_eq!(image::open(file).unwrap().height(), sheet.height() + 20, "a row of its own");
}

/// Returns names and bytes of everything in a folder except the record.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for format in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).filter(|p| p.is_dir()) {
        for file in std::fs::read_dir(format).unwrap().map(|e| e.unwrap().path()) {
            found.insert(file.strip_prefix(folder).unwrap().to_owned(), std::fs::read(file).unwrap());
        }
    }
    found
}

#[test]
fn every_format_stopped_and_begun_again_is_the_same_bytes() {
    let how = provenance(&Format::ALL, false);
    let whole = tempfile::tempdir().unwrap();
    let done = export(whole.path(), &how, FRAMES);
    assert_eq!((done.complete, done.files), (true, num_files(&Format::ALL, FRAMES, 2)));

    let stopped = tempfile::tempdir().unwrap();
    let partly = export(stopped.path(), &how, 2);
    assert_eq!((partly.complete, partly.files), (false, 2 * (4 * 2 + 4)));
    assert!(
        contents(stopped.path()).keys().all(|name| !name.starts_with("coco")),
        "no part of a file is left"
    );
    let again = export(stopped.path(), &how, FRAMES);
    assert_eq!((again.complete, again.skipped_frames), (true, 0));
    assert_eq!(contents(stopped.path()), contents(whole.path()));
    let record = |folder: &Path| std::fs::read(folder.join(PROVENANCE_FILE)).unwrap();
    assert_eq!(record(stopped.path()), record(whole.path()));
    assert_eq!(export(stopped.path(), &how, FRAMES).skipped_frames, FRAMES);
}

#[test]
fn files_about_all_frames_are_made_anew_only_where_they_are_missing() {
    let folder = tempfile::tempdir().unwrap();
    let how = provenance(&[Format::Csv, Format::Coco, Format::Binary], false);
    export(folder.path(), &how, FRAMES);
    let before = contents(folder.path());
    std::fs::remove_file(folder.path().join("csv/frames_000000-000003.csv")).unwrap();
    assert_eq!(export(folder.path(), &how, FRAMES).skipped_frames, 0);
    std::fs::remove_file(folder.path().join("binary/frame_000002_liver.png")).unwrap();
    assert_eq!(export(folder.path(), &how, FRAMES).skipped_frames, FRAMES - 1);
    assert_eq!(contents(folder.path()), before);

    let mine = folder.path().join("csv/frames_000000-000003.csv");
    std::fs::write(&mine, "edited").unwrap();
    let refused = Export::begin(folder.path(), (0..FRAMES).collect(), how.clone()).err().unwrap();
    assert!(refused.to_string().contains("changed"), "{refused}");
    let other_frames = Export::begin(folder.path(), vec![0, 1], how.clone()).unwrap();
    other_frames.finish().unwrap();
    assert_eq!(std::fs::read_to_string(&mine).unwrap(), "edited", "another range has files of its own");

    let foreign = tempfile::tempdir().unwrap();
    std::fs::create_dir(foreign.path().join("coco")).unwrap();
    std::fs::write(foreign.path().join("coco/frames_000000-000003.json"), "mine").unwrap();
    assert!(Export::begin(foreign.path(), (0..FRAMES).collect(), how).is_err());
}

#[test]
fn gaps_and_changing_sizes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let how = provenance(&[Format::Csv], false);
    assert!(Export::begin(folder.path(), vec![0, 2], how.clone()).is_err());
    let mut export = Export::begin(folder.path(), vec![0, 1], how).unwrap();
    export.write(&picture(), &scores(0), None).unwrap();
    let small = Grid::filled(4, 4, 0.2);
    let error = export.write(&image::RgbImage::new(4, 4), &[small.clone(), small], None).unwrap_err();
    assert!(error.to_string().contains("those before it were 40×24"), "{error}");
    assert!(!export.finish().unwrap().complete);
}

/// Exports a DICOM segmentation of a kind and reads it back.
fn segmentation(seg_type: SegType, exclusive: bool) -> (tempfile::TempDir, PathBuf, Segmentation) {
    let folder = tempfile::tempdir().unwrap();
    let mut how = provenance(&[Format::DicomSeg], exclusive);
    how.options.seg_type = seg_type;
    assert!(export(folder.path(), &how, FRAMES).complete);
    let file = folder.path().join(super::name(Format::DicomSeg, &[0, 1, 2, 3]));
    let read = Segmentation::open(&file).unwrap();
    (folder, file, read)
}

#[test]
fn dicom_segmentations_hold_the_masks_of_every_frame() {
    for (seg_type, exclusive) in [
        (SegType::Binary, false),
        (SegType::Binary, true),
        (SegType::Fractional, false),
        (SegType::Labelmap, true),
    ] {
        let (_folder, file, read) = segmentation(seg_type, exclusive);
        let mut shown = 0;
        for (i, frame) in read.frames.iter().enumerate() {
            let recorded = frame.position.unwrap() as usize - 1;
            for number in (1..=2_u16).filter(|n| frame.segment.is_none_or(|own| own == *n)) {
                let mask = read.mask(i, number).unwrap();
                let expected = match (seg_type, exclusive) {
                    (SegType::Fractional, _) | (_, false) => masks(recorded)[usize::from(number) - 1].clone(),
                    _ => exclusive_masks(recorded)[usize::from(number) - 1].clone(),
                };
                assert_eq!(mask, expected, "{seg_type:?}, frame {recorded}, segment {number}");
                shown += mask.count();
            }
        }
        let all = (0..FRAMES).map(|i| if exclusive { exclusive_masks(i) } else { masks(i) });
        assert_eq!(shown, all.flatten().map(|mask| mask.count()).sum::<usize>(), "{seg_type:?}");
        let labels: Vec<_> =
            read.segments.iter().filter(|s| s.number > 0).map(|s| s.label.as_str()).collect();
        assert_eq!(labels, ["Bile sac", "liver"]);
        let bytes = std::fs::read(&file).unwrap();
        let holds = |text: &str| bytes.windows(text.len()).any(|window| window == text.as_bytes());
        assert!(holds("Research use only") && holds("10200004") && !holds("shot 1"), "{seg_type:?}");
        assert_eq!(std::fs::read(segmentation(seg_type, exclusive).1).unwrap(), bytes, "{seg_type:?} again");
    }
}

fn exclusive_masks(frame: usize) -> Vec<Mask> {
    let scores = scores(frame);
    crate::mask::exclusive(&scores.iter().collect::<Vec<_>>(), &[0.5, 0.5])
}

#[test]
fn a_dicom_segmentation_of_nothing_has_one_empty_frame() {
    let folder = tempfile::tempdir().unwrap();
    let how = Provenance { frames_not_shown: vec![[0, 1]], ..provenance(&[Format::DicomSeg], false) };
    let mut export = Export::begin(folder.path(), vec![1, 2, 3], how).unwrap();
    for _ in 0..3 {
        let scores = [Grid::filled(40, 24, 0.1), Grid::filled(40, 24, f32::NAN)];
        export.write(&picture(), &scores, None).unwrap();
    }
    export.finish().unwrap();
    let read = Segmentation::open(&folder.path().join(super::name(Format::DicomSeg, &[1, 2, 3]))).unwrap();
    assert_eq!((read.frames.len(), read.mask(0, 1).unwrap().count()), (1, 0));
    assert_eq!(read.frames[0].position, Some(3), "the first of the frames that are shown");
}

#[test]
fn dicom_segmentations_refer_to_their_sources() {
    let folder = tempfile::tempdir().unwrap();
    let how = provenance(&[Format::DicomSeg], false);
    let instance = SourceInstance { class_uid: "1.2.3".into(), instance_uid: "1.2.3.77".into() };
    let sources = SourceReferences {
        study_uid: Some("1.2.3.4".into()),
        series_uid: "1.2.3.5".into(),
        instances: vec![instance],
        frames: (0..FRAMES).map(|i| SourceFrame { instance: 0, number: Some(10 + i as u32) }).collect(),
        spacing_mm: Some([0.1, 0.2]),
        lossy: Some(("12.5".into(), "ISO_14496_10".into())),
    };
    let mut export =
        Export::begin(folder.path(), (0..FRAMES).collect(), how).unwrap().with_sources(Some(sources));
    for frame in 0..FRAMES {
        export.write(&picture(), &scores(frame), None).unwrap();
    }
    export.finish().unwrap();
    let read = Segmentation::open(&folder.path().join(super::name(Format::DicomSeg, &[0, 1, 2, 3]))).unwrap();
    for frame in &read.frames {
        assert_eq!(frame.instance.as_deref(), Some("1.2.3.77"));
        assert_eq!(frame.number.unwrap(), frame.position.unwrap() + 9);
    }
    let record = std::fs::read_to_string(folder.path().join(PROVENANCE_FILE)).unwrap();
    assert!(!record.contains("1.2.3."), "{record}");
}
