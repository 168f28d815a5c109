//! Tests of videos whose frames ffmpeg decodes as they are asked for. They need the program itself; without
//! it they say so and pass, but with `CI` in the environment they fail.

use crate::{
    Result,
    sequence::{
        ffmpeg::{Container, PROGRAM, Shared, Unread, open_within},
        recording::{Recording, Selection},
        video,
    },
};
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// Makes a video of moving test pictures, 64×48; `false` if this ffmpeg cannot encode it so.
fn make(path: &Path, how: &str) -> bool {
    let source = "testsrc2=size=64x48:rate=25:duration=4";
    let mut command = Command::new(PROGRAM);
    command.args(["-loglevel", "error", "-nostdin", "-y", "-f", "lavfi", "-i", source]);
    command.args(how.split_whitespace()).arg(path);
    command.output().is_ok_and(|output| output.status.success())
}

fn is_ffmpeg_there() -> bool {
    let is_there = Command::new(PROGRAM).arg("-version").output().is_ok();
    assert!(is_there || std::env::var_os("CI").is_none(), "ffmpeg is not installed");
    if !is_there {
        eprintln!("skipped: ffmpeg is not installed");
    }
    is_there
}

fn unread(path: &Path) -> Unread {
    let kind = if path.extension().is_some_and(|e| e == "mp4") { Container::Mp4 } else { Container::Other };
    let (program, why_not_here) = (PathBuf::from(PROGRAM), String::new());
    let (path, input) = (path.to_owned(), path.to_owned());
    Unread { program, path, input, form: None, kind, promised: None, follows_edits: false, why_not_here }
}

/// Opens a video whose frames are unpacked, or decoded as they are asked for.
fn opened(path: &Path, is_unpacked: bool, selection: &Selection) -> Recording {
    opened_as(unread(path), is_unpacked, selection).unwrap()
}

fn opened_as(video: Unread, is_unpacked: bool, selection: &Selection) -> Result<Recording> {
    let most = if is_unpacked { u64::MAX } else { 0 };
    open_within(video, selection, Shared::default(), most)
}

#[test]
fn frames_are_those_that_unpacking_gives_in_any_order() {
    if !is_ffmpeg_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut tried = 0;
    for (name, how) in [
        ("plain.avi", "-c:v mpeg4 -g 12"),
        ("reordered.avi", "-c:v mpeg4 -g 12 -bf 2"),
        ("open.mpg", "-c:v mpeg2video -g 15 -bf 2"),
        ("fields.ts", "-c:v mpeg2video -g 15 -bf 2 -flags +ilme+ildct -vf fps=50,tinterlace=interleave_top"),
        ("uneven.mkv", "-c:v mpeg4 -bf 2 -vf select='not(mod(n,3))+gt(mod(n,7),3)' -fps_mode vfr"),
        ("intra.mov", "-c:v mjpeg"),
        ("later.ts", "-c:v mpeg2video -g 15 -output_ts_offset 4000"),
        ("wide.mkv", "-c:v libx264 -x264-params open-gop=1:keyint=20:bframes=3 -pix_fmt yuv420p"),
        ("camera.mts", "-c:v libx264 -x264-params open-gop=1:keyint=20:bframes=3 -pix_fmt yuv420p"),
        ("hevc.mp4", "-c:v libx265 -x265-params log-level=none:keyint=20 -pix_fmt yuv420p"),
        ("turned.mp4", "-c:v mpeg4 -metadata:s:v:0 rotate=90"),
    ] {
        let path = folder.path().join(name);
        if !make(&path, how) {
            eprintln!("skipped: {name} cannot be encoded here");
            continue;
        }
        tried += 1;
        let [whole, stream] = [true, false].map(|is_unpacked| opened(&path, is_unpacked, &Selection::ALL));
        assert!(stream.scratch.is_empty() && !whole.scratch.is_empty(), "{name}");
        assert_eq!(stream.frames.len(), whole.frames.len(), "{name}");
        assert_eq!((stream.width, stream.height), (whole.width, whole.height), "{name}");
        assert_eq!(stream.frames_per_second, whole.frames_per_second, "{name}");
        assert_eq!(stream.notes, whole.notes, "{name}");
        let last = whole.frames.len() - 1;
        let order = [last, 0, 33, 34, 35, 20, 19, 41, 59, 1, 2, 58].into_iter().chain(0..=last);
        for i in order {
            assert_eq!(stream.frames[i].name, whole.frames[i].name, "{name}");
            let is_same = stream.frame(i).unwrap() == whole.frame(i).unwrap();
            assert!(is_same, "frame {i} of {name}");
        }
    }
    assert!(tried > 5, "{tried} kinds of video could be made");
}

#[test]
fn selected_frames_are_decoded_too() {
    if !is_ffmpeg_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.avi");
    assert!(make(&path, "-c:v mpeg4 -g 12"));
    let selection = Selection { first: 30, last: Some(80), every: 7 };
    let [whole, stream] = [true, false].map(|is_unpacked| opened(&path, is_unpacked, &selection));
    let names = |r: &Recording| r.frames.iter().map(|f| f.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&stream), names(&whole));
    assert!((0..whole.frames.len()).all(|i| stream.frame(i).unwrap() == whole.frame(i).unwrap()));
}

/// Copies a video of four seconds without its first second, and hides the last one, too: the movie lasts for
/// two seconds, and so does its edit list, as far as its clock tells. The pictures are still there.
fn cut(whole: &Path, to: &Path) {
    let mut command = Command::new(PROGRAM);
    command.args(["-loglevel", "error", "-nostdin", "-y", "-ss", "1", "-i"]).arg(whole);
    assert!(command.args(["-c", "copy"]).arg(to).status().unwrap().success());
    let mut bytes = std::fs::read(to).unwrap();
    for (kind, place, milliseconds) in [(b"mvhd", 20, 2000_u32), (b"elst", 12, 2001)] {
        let at = bytes.windows(4).position(|word| word == kind).unwrap() + place;
        assert_eq!(bytes[at..at + 4], 3000_u32.to_be_bytes());
        bytes[at..at + 4].copy_from_slice(&milliseconds.to_be_bytes());
    }
    std::fs::write(to, bytes).unwrap();
}

/// Makes a video in `folder`, and another one that is [`cut`] from it.
fn whole_and_cut(folder: &Path) -> [PathBuf; 2] {
    let [whole, part] = ["whole.mp4", "cut.mp4"].map(|name| folder.join(name));
    assert!(make(&whole, "-c:v mpeg4 -g 40"));
    cut(&whole, &part);
    [whole, part]
}

#[test]
fn what_an_edit_list_hides_does_not_come() {
    if !is_ffmpeg_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let [whole, part] = whole_and_cut(folder.path());
    let whole = opened(&whole, true, &Selection::ALL);
    let following =
        |promised: usize| Unread { promised: Some(promised), follows_edits: true, ..unread(&part) };
    let [unpacked, stream] =
        [true, false].map(|is_unpacked| opened_as(following(50), is_unpacked, &Selection::ALL).unwrap());
    let usual = video::open(&part, &Selection::ALL).unwrap();
    for part in [&unpacked, &stream, &usual] {
        assert_eq!((part.frames.len(), part.frames[0].name.as_str()), (50, "000000"));
        assert!([49, 0, 20].iter().all(|i| part.frame(*i).unwrap() == whole.frame(25 + i).unwrap()));
    }
    let said = usual.cautions.join(" ");
    assert!(said.contains("hides the first 25 frames and the last 25 frames"), "{said}");
    for is_unpacked in [true, false] {
        let refused = opened_as(following(80), is_unpacked, &Selection::ALL).unwrap_err().to_string();
        assert!(refused.contains("it lists 80 frames, 51 could be decoded"), "{refused}");
    }
}

#[test]
fn an_edit_list_that_is_not_known_hides_nothing() {
    if !is_ffmpeg_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let [whole, part] = whole_and_cut(folder.path());
    // Without its first box, ffmpeg alone reads the file.
    let mut bytes = std::fs::read(&part).unwrap();
    bytes[4..8].copy_from_slice(b"free");
    std::fs::write(&part, bytes).unwrap();
    let whole = opened(&whole, true, &Selection::ALL);
    let unknown = video::open(&part, &Selection::ALL).unwrap();
    assert_eq!((unknown.frames.len(), unknown.cautions.len()), (100, 1));
    assert!([99, 0, 25].iter().all(|i| unknown.frame(*i).unwrap() == whole.frame(*i).unwrap()));
}

#[test]
fn a_video_that_is_cut_off_is_refused_unless_what_is_there_is_asked_for() {
    if !is_ffmpeg_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let [whole, cut] = ["whole.avi", "cut.avi"].map(|name| folder.path().join(name));
    assert!(make(&whole, "-c:v mpeg4 -g 12"));
    let bytes = std::fs::read(&whole).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let open = |selection| open_within(unread(&cut), &selection, Shared::default(), 0);
    let message = open(Selection::ALL).unwrap_err().to_string();
    assert!(message.contains("cut off") && message.contains("`last = "), "{message}");
    let some = open(Selection { last: Some(20), ..Selection::ALL }).unwrap();
    assert_eq!(some.frame(20).unwrap(), opened(&whole, true, &Selection::ALL).frame(20).unwrap());
}

#[test]
fn a_frame_that_changed_since_is_an_error_and_no_other_frame() {
    if !is_ffmpeg_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.avi");
    assert!(make(&path, "-c:v mpeg4 -g 12"));
    let stream = opened(&path, false, &Selection::ALL);
    assert!(make(&path, "-c:v mpeg4 -g 12 -t 1"));
    let message = stream.frame(60).unwrap_err().to_string();
    assert!(message.contains("frame") && message.contains("cannot be decoded"), "{message}");
    assert!(stream.frame(3).is_ok());
}

#[test]
fn pixels_have_the_shape_that_the_file_tells() {
    if !is_ffmpeg_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let is_wide = |recording: &Recording| (recording.pixel_aspect - 4.0 / 3.0).abs() < 1e-3;
    let path = folder.path().join("wide.mkv");
    assert!(make(&path, "-c:v mpeg4 -vf setsar=4/3"));
    assert!([true, false].iter().all(|is_unpacked| is_wide(&opened(&path, *is_unpacked, &Selection::ALL))));
    let path = folder.path().join("wide.mp4");
    if make(&path, "-c:v libx264 -vf setsar=4/3 -pix_fmt yuv420p") {
        let decoded_here = video::open(&path, &Selection::ALL).unwrap();
        assert!(decoded_here.read_by_ffmpeg.is_empty() && is_wide(&decoded_here));
    }
}

#[test]
fn colours_are_those_that_the_file_tells() {
    if !is_ffmpeg_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (name, matrix, range) in [
        ("usual.mp4", "bt601", "tv"),
        ("hd.mp4", "bt709", "tv"),
        ("full.mp4", "bt709", "pc"),
        ("phone.mp4", "bt601", "pc"),
    ] {
        let path = folder.path().join(name);
        let code = if matrix == "bt601" { "smpte170m" } else { matrix };
        let how = format!(
            "-vf scale=out_color_matrix={matrix}:out_range={range} -colorspace {code} -color_range {range} \
             -c:v libx264 -qp 4 -pix_fmt yuv420p"
        );
        if !make(&path, &how) {
            eprintln!("skipped: {name} cannot be encoded here");
            continue;
        }
        let [here, there] =
            [video::open(&path, &Selection::ALL).unwrap(), opened(&path, false, &Selection::ALL)];
        assert!(here.read_by_ffmpeg.is_empty(), "{name}");
        let [own, other] = [here, there].map(|recording| recording.frame(30).unwrap());
        let apart =
            own.as_raw().iter().zip(other.as_raw()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>();
        let apart = apart / own.as_raw().len() as f64;
        assert!(apart < 1.0, "{name}: {apart} levels");
    }
}
