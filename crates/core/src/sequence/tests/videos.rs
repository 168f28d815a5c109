//! Tests of videos, which are made here with the encoder and a small muxer.

use super::{dicom::of_mp4, *};
use crate::{progress::unobserved, reading::Pieces, sequence::mp4::Mp4};
use openh264::{
    OpenH264API,
    encoder::{BitRate, Encoder, EncoderConfig, FrameType, IntraFramePeriod, RateControlMode},
    formats::{RgbSliceU8, YUVBuffer},
};
use shiguredo_mp4::{
    Decode, Encode, FixedPointNumber,
    boxes::{CttsBox, CttsEntry, EdtsBox, ElstBox, ElstEntry, MoovBox},
};

const SIZE: (usize, usize) = (64, 48);
const FRAMES: usize = 25;

/// Draws a soft blob that wanders, so that every frame differs from its neighbours.
pub(super) fn blob(frame: usize) -> RgbImage {
    RgbImage::from_fn(SIZE.0 as u32, SIZE.1 as u32, |x, y| {
        let (dx, dy) = (x as f32 - 2.5 * frame as f32, y as f32 - 20.0);
        let glow = (180.0 * (-(dx * dx + dy * dy) / 200.0).exp()) as u8;
        Rgb([60 + glow, 40 + glow / 2, 50 + y as u8])
    })
}

/// Writes an H.264 mp4 at 10 frames per second that can be entered at every tenth frame.
pub(super) fn write_video(path: &Path) {
    let config = EncoderConfig::new()
        .bitrate(BitRate::from_bps(4_000_000))
        .rate_control_mode(RateControlMode::Quality)
        .intra_frame_period(IntraFramePeriod::from_num_frames(10));
    let mut encoder = Encoder::with_api_config(OpenH264API::from_source(), config).unwrap();
    let file = std::fs::File::create(path).unwrap();
    let mut muxer = muxide::api::MuxerBuilder::new(file)
        .video(muxide::api::VideoCodec::H264, SIZE.0 as u32, SIZE.1 as u32, 10.0)
        .build()
        .unwrap();
    for i in 0..FRAMES {
        let yuv = YUVBuffer::from_rgb8_source(RgbSliceU8::new(blob(i).as_raw(), SIZE));
        let stream = encoder.encode(&yuv).unwrap();
        let key = matches!(stream.frame_type(), FrameType::IDR | FrameType::I);
        muxer.write_video(i as f64 / 10.0, &stream.to_vec(), key).unwrap();
    }
    muxer.finish().unwrap();
}

/// Gives the track of a file an edit list of parts that begin at a time, or show nothing if that is negative,
/// and last for some time, seconds.
fn add_edit_list(path: &Path, parts: &[(f64, f64)]) {
    change_tables(path, |movie| {
        let ticks = |seconds: f64, clock: u32| (seconds * f64::from(clock)).round();
        let movie_clock = movie.mvhd_box.timescale.get();
        let track = &mut movie.trak_boxes[0];
        let clock = track.mdia_box.mdhd_box.timescale.get();
        let entry = |&(from, lasts): &(f64, f64)| ElstEntry {
            edit_duration: ticks(lasts, movie_clock) as u64,
            media_time: if from < 0.0 { -1 } else { ticks(from, clock) as i64 },
            media_rate: FixedPointNumber::new(1, 0),
        };
        let list = ElstBox { entries: parts.iter().map(entry).collect() };
        track.edts_box = Some(EdtsBox { elst_box: Some(list), unknown_boxes: Vec::new() });
    });
}

/// Changes the tables of a file.
fn change_tables(path: &Path, change: impl FnOnce(&mut MoovBox)) {
    let mut bytes = std::fs::read(path).unwrap();
    let kind = bytes.windows(4).position(|word| word == b"moov").unwrap();
    let (mut movie, _) = MoovBox::decode(&bytes[kind - 4..]).unwrap();
    change(&mut movie);
    // The pictures stay where they are.
    bytes[kind..kind + 4].copy_from_slice(b"free");
    bytes.extend(movie.encode_to_vec().unwrap());
    std::fs::write(path, bytes).unwrap();
}

pub(super) fn psnr(a: &RgbImage, b: &RgbImage) -> f64 {
    let square = |(&x, &y): (&u8, &u8)| (f64::from(x) - f64::from(y)).powi(2);
    let error = a.as_raw().iter().zip(b.as_raw()).map(square).sum::<f64>() / a.as_raw().len() as f64;
    10.0 * (255.0 * 255.0 / error.max(1e-9)).log10()
}

#[test]
fn notes_on_a_video_name_the_settings_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.mp4");
    write_video(&path);
    let report = check(&Sequence::open(&path).unwrap(), &mut unobserved).unwrap();
    let notes = report.warnings.join(" ");
    assert!(notes.contains("[camera] in clip.mp4.toml beside it"), "{notes}");
    assert!(!notes.contains("sequence.toml") && !notes.contains("depth/"), "{notes}");
}

#[test]
fn any_order_gives_the_same_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("anything.bin");
    write_video(&path);
    let sequence = Sequence::open(&path).unwrap();
    assert_eq!((sequence.layout(), sequence.num_frames()), (Layout::Video, FRAMES));
    assert_eq!((sequence.width(), sequence.height()), SIZE);
    assert!((sequence.frames_per_second().unwrap() - 10.0).abs() < 0.5, "{:?}", sequence.frames_per_second());
    let forward: Vec<_> = (0..FRAMES).map(|i| sequence.frame(i).unwrap()).collect();
    for (i, frame) in forward.iter().enumerate() {
        let own = psnr(frame, &blob(i));
        assert!(own > 30.0 && own > psnr(frame, &blob(i + 1)) + 3.0, "frame {i}: {own} dB");
    }
    let other = Sequence::open(&path).unwrap();
    for i in [24, 3, 11, 10, 19, 0, 20] {
        assert_eq!(other.frame(i).unwrap(), forward[i], "frame {i}");
    }
}

#[test]
fn settings_beside_a_video_choose_its_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.mp4");
    write_video(&path);
    let toml = "[frames]\nfirst = 4\nlast = 20\n[time]\nevery = 5\n";
    std::fs::write(folder.path().join("clip.mp4.toml"), toml).unwrap();
    let sequence = Sequence::open(&path).unwrap();
    let names: Vec<_> = (0..sequence.num_frames()).map(|i| sequence.frame_name(i)).collect();
    assert_eq!(names, ["000004", "000009", "000014", "000019"]);
    assert!(psnr(&sequence.frame(1).unwrap(), &blob(9)) > 30.0);
    // Malformed settings are an error, for a folder of only this video too.
    std::fs::write(folder.path().join("clip.mp4.toml"), "[frames\n").unwrap();
    for place in [&*path, folder.path()] {
        assert!(message(Sequence::open(place)).contains("clip.mp4.toml"));
    }
}

#[test]
fn a_folder_of_one_video_is_that_video_with_its_settings() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.mp4");
    write_video(&path);
    let rectangle = HiddenRectangle { x: 2, y: 1, width: 9, height: 5 };
    let toml = "[camera]\nfx = 50.0\n[time]\nevery = 5\n[frames]\nfirst = 4\nlast = 20\n\
                [[hidden]]\nx = 2\ny = 1\nwidth = 9\nheight = 5\n";
    std::fs::write(folder.path().join("clip.mp4.toml"), toml).unwrap();
    let [alone, within] = [&*path, folder.path()].map(|path| Sequence::open(path).unwrap());
    assert_eq!((within.num_frames(), within.camera(0).fx, within.hidden()), (4, 50.0, &[rectangle][..]));
    assert_eq!(within.identity().unwrap().difference(&alone.identity().unwrap()), None);
    assert_eq!(within.path(), folder.path());
    assert_eq!(settings_files(folder.path())[0], folder.path().join("clip.mp4.toml"));
    // Settings in the folder leave to those beside the video what belongs to it.
    std::fs::write(folder.path().join("sequence.toml"), "[frames]\nfirst = 1\n").unwrap();
    let both = Sequence::open(folder.path()).unwrap();
    assert_eq!(
        (both.num_frames(), both.frame_name(0), both.hidden()),
        (16, "000005".to_owned(), &[rectangle][..])
    );
    assert_ne!(both.camera(0).fx, 50.0);
    let notes = check(&both, &mut unobserved).unwrap().warnings.join(" ");
    assert!(notes.contains("Of clip.mp4.toml, [frames] and [[hidden]] alone count here"), "{notes}");
}

#[test]
fn what_settings_of_one_part_hide_is_hidden_in_all_parts() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.mp4", "b.mp4"] {
        write_video(&folder.path().join(name));
    }
    let toml = "[[hidden]]\nx = 2\ny = 1\nwidth = 9\nheight = 5\n";
    std::fs::write(folder.path().join("a.mp4.toml"), toml).unwrap();
    std::fs::write(folder.path().join("b.mp4.toml"), toml.replace("x = 2", "x = 20")).unwrap();
    let sequence = Sequence::open(folder.path()).unwrap();
    let hidden = [2, 20].map(|x| HiddenRectangle { x, y: 1, width: 9, height: 5 });
    assert_eq!(sequence.hidden(), hidden);
    for i in [0, FRAMES] {
        let frame = sequence.frame(i).unwrap();
        assert!([2, 20].iter().all(|x| frame.get_pixel(*x, 1).0 == [0; 3]), "frame {i}");
    }
    let notes = check(&sequence, &mut unobserved).unwrap().warnings.join(" ");
    assert!(notes.contains("What a.mp4.toml hides is black in every frame"), "{notes}");
    assert!(!notes.contains("alone count"), "{notes}");
}

#[test]
fn a_video_that_is_cut_off_is_refused_unless_what_is_there_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.mp4");
    write_video(&path);
    let whole = std::fs::read(&path).unwrap();
    let forward: Vec<_> = (0..FRAMES).map(|i| Sequence::open(&path).unwrap().frame(i).unwrap()).collect();
    std::fs::write(&path, &whole[..whole.len() - 600]).unwrap();
    let text = message(Sequence::open(&path));
    let there: usize = text.split(" and holds ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!(text.contains("cut off") && text.contains("it lists 25 frames"), "{text}");
    assert!(text.contains(&format!("`last = {}` under `[frames]` in clip.mp4.toml", there - 1)), "{text}");
    assert!((10..FRAMES).contains(&there), "{text}");
    let choose = |last: usize| {
        std::fs::write(folder.path().join("clip.mp4.toml"), format!("[frames]\nlast = {last}\n")).unwrap();
        Sequence::open(&path)
    };
    let part = choose(there - 1).unwrap();
    assert_eq!(part.num_frames(), there);
    for i in (0..there).rev() {
        assert_eq!(part.frame(i).unwrap(), forward[i], "frame {i}");
    }
    assert!(message(choose(there)).contains("cut off"));
}

#[test]
fn what_an_edit_list_hides_is_no_part_of_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.mp4");
    write_video(&path);
    let bytes = std::fs::read(&path).unwrap();
    let plain = Sequence::open(&path).unwrap();
    let identity = plain.identity().unwrap();
    let frames: Vec<_> = (0..FRAMES).map(|i| plain.frame(i).unwrap()).collect();
    let opened = |parts: &[(f64, f64)]| {
        std::fs::write(&path, &bytes).unwrap();
        add_edit_list(&path, parts);
        Sequence::open(&path).unwrap()
    };
    let notes = |sequence: &Sequence| check(sequence, &mut unobserved).unwrap().warnings.join(" ");
    let cut = opened(&[(0.7, 1.3)]);
    assert_eq!((cut.num_frames(), cut.frame_name(0)), (13, "000000".to_owned()));
    for i in [12, 0, 5] {
        assert_eq!(cut.frame(i).unwrap(), frames[7 + i], "frame {i}");
    }
    let said = notes(&cut);
    assert!(said.contains("hides the first 7 frames and the last 5 frames: they are left out"), "{said}");
    let settings = folder.path().join("clip.mp4.toml");
    std::fs::write(&settings, "[frames]\nfirst = 2\nlast = 4\n").unwrap();
    let part = Sequence::open(&path).unwrap();
    assert_eq!((part.num_frames(), part.frame_name(0)), (3, "000002".to_owned()));
    assert_eq!(part.frame(0).unwrap(), frames[9]);
    std::fs::remove_file(&settings).unwrap();
    // A list that delays all frames changes nothing.
    let late = opened(&[(-1.0, 3.0), (0.0, 2.5)]);
    assert_eq!(late.identity().unwrap().digest(), identity.digest());
    assert!(!notes(&late).contains("edit list") && !notes(&plain).contains("edit list"));
    // One of several parts is not followed, which is said as long as it matters.
    let several = opened(&[(0.0, 0.5), (1.0, 1.5)]);
    assert_eq!(several.num_frames(), FRAMES);
    let said = notes(&several);
    assert!(said.contains("Players do not show frames 5 to 9: an edit list"), "{said}");
    std::fs::write(&settings, "[frames]\nfirst = 10\n").unwrap();
    assert!(!notes(&Sequence::open(&path).unwrap()).contains("edit list"));
}

#[test]
fn pictures_that_a_dicom_file_counts_are_not_hidden() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.mp4");
    write_video(&path);
    add_edit_list(&path, &[(0.7, 1.3)]);
    let (mp4, shown) = (std::fs::read(&path).unwrap(), Sequence::open(&path).unwrap());
    let opened = |frames: usize| of_mp4(&mp4, frames).open(&folder.path().join("clip.dcm"));
    let warnings = |sequence: &Sequence| check(sequence, &mut unobserved).unwrap().warnings.join(" ");
    let cut = opened(13).unwrap();
    assert_eq!((cut.num_frames(), cut.cautions().len()), (13, 1));
    assert_eq!(cut.frame(0).unwrap(), shown.frame(0).unwrap());
    let whole = opened(FRAMES).unwrap();
    assert_eq!((whole.num_frames(), whole.cautions().len()), (FRAMES, 0));
    assert_eq!(whole.frame(7).unwrap(), shown.frame(0).unwrap());
    // Times of a list are rounded, so that both may count another frame.
    for frames in [12, 14] {
        let other = opened(frames).unwrap();
        assert_eq!(other.num_frames(), 13);
        let said = warnings(&other);
        assert!(said.contains(&format!("The file lists {frames} frames; its video has 13")), "{said}");
    }
}

#[test]
fn offsets_below_zero_are_read_in_tables_that_have_none() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.mp4");
    write_video(&path);
    let times = || {
        let mp4 = Mp4::read(&Pieces::whole(&path).unwrap()).unwrap();
        mp4.pictures.iter().map(|picture| picture.shown_at).collect::<Vec<_>>()
    };
    let offset = |version: u8, sample_offset: i64| {
        let entries = vec![CttsEntry { sample_count: FRAMES as u32, sample_offset }];
        change_tables(&path, |movie| {
            let table = &mut movie.trak_boxes[0].mdia_box.minf_box.stbl_box;
            table.ctts_box = Some(CttsBox { version, entries });
        });
        times()
    };
    let plain = offset(0, 0);
    let expected: Vec<i64> = plain.iter().map(|time| time - 3).collect();
    assert_eq!(offset(1, -3), expected);
    assert_eq!(offset(0, i64::from(u32::MAX) - 2), expected);
}

#[test]
fn damaged_and_foreign_files_are_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.mp4");
    write_video(&path);
    let whole = std::fs::read(&path).unwrap();
    // Either ffmpeg is installed and refuses it too, or it is named as missing.
    std::fs::write(&path, &whole[..whole.len() / 8]).unwrap();
    assert!(message(Sequence::open(&path)).contains("ffmpeg"));
    std::fs::write(&path, "some text").unwrap();
    assert!(message(Sequence::open(&path)).contains("not a video"));
    picture(8, 6, 0).save(folder.path().join("a.png")).unwrap();
    assert!(message(Sequence::open(&folder.path().join("a.png"))).contains("not a video"));
}

#[test]
fn a_missing_picture_is_an_error_and_shifts_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.mp4");
    write_video(&path);
    let whole = Sequence::open(&path).unwrap();
    let (after, before) = (whole.frame(12).unwrap(), whole.identity().unwrap());
    let lost = Mp4::read(&Pieces::whole(&path).unwrap()).unwrap().pictures.swap_remove(5);
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[lost.offset as usize..][..lost.size].fill(0);
    std::fs::write(&path, bytes).unwrap();
    let sequence = Sequence::open(&path).unwrap();
    for frame in 5..10 {
        let message = sequence.frame(frame).unwrap_err().to_string();
        assert!(message.contains("frame 5") && message.contains("no picture"), "{message}");
    }
    assert!(sequence.frame(4).is_ok() && sequence.frame(12).unwrap() == after);
    let difference = sequence.identity().unwrap().difference(&before).unwrap();
    assert!(difference.to_string().contains("frame 5"), "{difference}");
}

#[test]
fn videos_of_one_folder_follow_each_other_in_natural_order() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["part 10.mp4", "part 2.mp4", "part 1.mp4"] {
        write_video(&folder.path().join(name));
    }
    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.num_frames()), (Layout::Video, 3 * FRAMES));
    let name = |i: usize| sequence.frame_name(i);
    assert_eq!(
        [name(0), name(FRAMES), name(2 * FRAMES + 3)],
        ["part 1_000000", "part 2_000000", "part 10_000003"]
    );
    // One decoder goes from file to file.
    for i in [FRAMES + 7, 7, 2 * FRAMES + 20, FRAMES - 1, FRAMES] {
        assert!(psnr(&sequence.frame(i).unwrap(), &blob(i % FRAMES)) > 30.0, "frame {i}");
    }
    assert!(sequence.identity().is_ok());
    std::fs::write(folder.path().join("sequence.toml"), "[frames]\nfirst = 20\nlast = 30\n").unwrap();
    let some = Sequence::open(folder.path()).unwrap();
    assert_eq!((some.num_frames(), some.frame_name(10)), (11, "part 2_000005".to_owned()));
    // A part that is cut off is opened as its message says.
    std::fs::remove_file(folder.path().join("sequence.toml")).unwrap();
    let cut = folder.path().join("part 2.mp4");
    let whole = std::fs::read(&cut).unwrap();
    std::fs::write(&cut, &whole[..whole.len() - 600]).unwrap();
    assert!(message(Sequence::open(folder.path())).contains("in part 2.mp4.toml"));
    std::fs::write(folder.path().join("part 2.mp4.toml"), "[frames]\nlast = 8\n").unwrap();
    let some = Sequence::open(folder.path()).unwrap();
    assert_eq!(
        (some.num_frames(), some.frame_name(FRAMES + 9)),
        (2 * FRAMES + 9, "part 10_000000".to_owned())
    );
    // Pictures beside videos hide these, and it is said.
    for i in 0..2 {
        blob(i).save(folder.path().join(format!("snapshot{i}.png"))).unwrap();
    }
    let pictures = Sequence::open(folder.path()).unwrap();
    assert_eq!(pictures.layout(), Layout::Images);
    let notes = check(&pictures, &mut unobserved).unwrap().warnings.join(" ");
    assert!(notes.contains("part 1.mp4") && notes.contains("open a video by itself"), "{notes}");
}
