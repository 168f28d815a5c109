//! Tests of how ffmpeg's messages are interpreted; a stand-in program says and writes what a test wants.

use super::*;
use crate::sequence::{
    ffmpeg::{Container, Shared, open},
    recording::Recording,
    settings::Settings,
};
use std::path::Path;

const WHOLE: &str = "\
[avi @ 0x5] [info] Input #0, avi, from 'clip.avi':
[info]   Duration: 00:00:02.00, start: 0.000000, bitrate: 300 kb/s
[info]   Stream #0:0: Video: mpeg4 (Simple Profile), yuv420p, 64x48 [SAR 1:1 DAR 4:3], 25 fps, 25 tbr, 25 tbn
";

/// Writes the line about a frame as `showinfo` would.
fn shown(n: usize, seconds: f64, size: (usize, usize)) -> String {
    format!(
        "[Parsed_showinfo_0 @ 0x55] [info] n:{n:4} pts: 3600 pts_time:{seconds} pos: 64 fmt:yuv420p sar:1/1 \
         s:{}x{} i:P iskey:0 type:P checksum:0\n",
        size.0, size.1
    )
}

fn frames(n: usize) -> String {
    (0..n).map(|i| shown(i, i as f64 / 25.0, (64, 48))).collect()
}

const ALL: Selection = Selection { first: 0, last: None, every: 1 };

fn clip(program: &Path) -> Unread {
    Unread {
        program: program.to_owned(),
        path: "clip.avi".into(),
        input: "clip.avi".into(),
        form: None,
        kind: Container::Other,
        promised: None,
        follows_edits: false,
        why_not_here: "why".into(),
    }
}

fn said(text: &str, promised: Option<usize>, selection: &Selection) -> Result<Vec<String>> {
    let told = Told::listen(text.as_bytes());
    let video = Unread { promised, ..clip(Path::new("ffmpeg")) };
    let asked = selection.last.map_or(usize::MAX, |last| last - selection.first + 1);
    compare(&video, selection, &told, told.frames.min(asked))
}

#[test]
fn a_whole_video_has_its_speed_and_nothing_to_be_told() {
    let told = Told::listen((WHOLE.to_owned() + &frames(50)).as_bytes());
    assert_eq!((told.frames, told.frames_per_second, told.duration), (50, Some(25.0), Some(2.0)));
    assert_eq!((told.size, told.has_audio), (Some((64, 48)), false));
    assert!(said(&(WHOLE.to_owned() + &frames(50)), None, &ALL).unwrap().is_empty());
    assert!(said(&(WHOLE.to_owned() + &frames(50)), Some(50), &ALL).unwrap().is_empty());
    assert_eq!(announced_speed("Video: h264, 64x48, 10k fps, 10k tbr"), Some(10_000.0));
}

#[test]
fn fewer_frames_than_the_index_or_the_duration_promises_are_refused() {
    let short = WHOLE.to_owned() + &frames(30);
    let message = said(&short, Some(50), &ALL).unwrap_err().to_string();
    assert!(message.contains("it lists 50 frames, 30 could be decoded"), "{message}");
    assert!(message.contains("`last = 29` under `[frames]` in clip.avi.toml"), "{message}");
    let message = said(&short, None, &ALL).unwrap_err().to_string();
    assert!(message.contains("30 of about 50 could be decoded"), "{message}");
    let damaged = WHOLE.to_owned() + "[mpeg4 @ 0x1] [error] ac-tex damaged at 5 4\n" + &frames(48);
    let message = said(&damaged, Some(50), &ALL).unwrap_err().to_string();
    assert!(message.contains("ffmpeg says: ac-tex damaged"), "{message}");
    // A selection that ends before the missing frames is complete.
    let part = Selection { last: Some(29), ..ALL };
    assert!(said(&short, Some(50), &part).unwrap().is_empty());
    assert!(said(&short, None, &Selection { last: Some(30), ..ALL }).is_err());
}

#[test]
fn what_may_be_whole_is_not_refused() {
    // Without a duration, nobody knows if frames are missing.
    let streamed = WHOLE.replace("00:00:02.00", "N/A") + &frames(30);
    assert!(said(&streamed, None, &ALL).unwrap()[0].contains("does not say how long"));
    // The sound may be longer than the pictures.
    let sound = WHOLE.to_owned() + "[info]   Stream #0:1: Audio: aac (LC), 48000 Hz\n" + &frames(40);
    assert!(said(&sound, None, &ALL).unwrap()[0].contains("may be cut off"));
    // 25 frames per second at first, one frame per second at the end.
    let mut varying = frames(20);
    (0..2).for_each(|i| varying += &shown(20 + i, 0.8 + f64::from(i as u32), (64, 48)));
    let varying = WHOLE.replace("02.00", "03.00") + &varying;
    assert!(said(&varying, None, &ALL).unwrap().is_empty());
    // A single frame that is shown for a second.
    let slide = WHOLE.replace("02.00", "01.00").replace("25 fps", "1 fps") + &frames(1);
    assert!(said(&slide, None, &ALL).unwrap().is_empty());
    let slide =
        WHOLE.replace("02.00", "09.00") + &shown(0, 0.0, (64, 48)).replace(" pos:", " duration_time:9 pos:");
    assert!(said(&slide, None, &ALL).unwrap().is_empty());
    // Frames before the first that needs no other may be missing.
    assert!(said(&(WHOLE.to_owned() + &frames(47)), Some(50), &ALL).unwrap()[0].contains("shows 47"));
    // Damage within the video is reported.
    let damaged = WHOLE.to_owned() + &frames(50) + "[h264 @ 0x2] [error] error while decoding MB 7 4\n";
    assert!(said(&damaged, Some(50), &ALL).unwrap()[0].contains("error while decoding MB 7 4"));
}

#[test]
fn edit_lists_are_followed_only_where_they_are_known() {
    let ignores = |kind: Container, follows_edits: bool| {
        let video = Unread { kind, follows_edits, ..clip(Path::new("ffmpeg")) };
        video.reading(None).get_args().any(|argument| argument == "-ignore_editlist")
    };
    assert!(ignores(Container::Mp4, false) && !ignores(Container::Mp4, true));
    assert!(!ignores(Container::Other, false), "other files have no such option");
    // What delays frames counts in the duration of a file, and is ignored with the list.
    let delayed = Told::listen((WHOLE.replace("02.00", "03.00") + &frames(50)).as_bytes());
    let compared = |kind| compare(&Unread { kind, ..clip(Path::new("ffmpeg")) }, &ALL, &delayed, 50);
    assert!(compared(Container::Other).is_err());
    assert!(compared(Container::Mp4).unwrap()[0].contains("or an edit list makes it longer"));
}

#[test]
fn a_change_of_size_names_its_frame() {
    let changes = WHOLE.to_owned() + &frames(30) + &shown(0, 1.2, (32, 24)) + &shown(1, 2.0, (32, 24));
    let message = said(&changes, None, &ALL).unwrap_err().to_string();
    assert!(message.contains("frame 30 of the video is 32×24, the first is 64×48"), "{message}");
    assert!(said(&changes, None, &Selection { last: Some(29), ..ALL }).unwrap().is_empty());
}

#[cfg(unix)]
fn opened(script: &str, selection: &Selection) -> Result<Recording> {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (program, picture) = (folder.path().join("ffmpeg"), folder.path().join("frame.png"));
    image::RgbImage::new(64, 48).save(&picture).unwrap();
    // It lists no packets, so that frames are unpacked.
    let listing = "[ \"${@: -1}\" = - ] && exit 1";
    let text = format!(
        "#!/bin/bash\n{listing}\nout=$(dirname \"${{@: -1}}\"); frame={}\n{script}\n",
        picture.display()
    );
    std::fs::write(&program, text).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    open(clip(&program), selection, Shared::default())
}

#[cfg(unix)]
#[test]
fn a_full_temporary_folder_is_called_that() {
    let error =
        opened("echo '[error] av_interleaved_write_frame(): No space left on device' >&2; exit 1", &ALL);
    let error = error.unwrap_err();
    assert!(matches!(error, Error::Missing { .. }));
    let message = error.to_string();
    assert!(message.contains("temporary folder") && message.contains("TMPDIR"), "{message}");
    assert!(message.contains(&std::env::temp_dir().display().to_string()), "{message}");
}

#[cfg(unix)]
#[test]
fn a_file_without_a_video_track_is_called_that() {
    let refused =
        |said: &str| opened(&format!("cat >&2 <<'END'\n{said}END\nexit 1"), &ALL).unwrap_err().to_string();
    let sound = "[info]   Stream #0:0(und): Audio: aac (LC), 44100 Hz, mono, fltp (default)\n";
    let unmatched =
        "[fatal] Stream map '0:v:0' matches no streams.\nTo ignore this, add a trailing '?' to the map.\n";
    let message = refused(&(sound.to_owned() + unmatched));
    let says =
        "there is no video track in this file, only sound. Open the file that holds the pictures. (clip.avi)";
    assert_eq!(message, says);
    let later = unmatched.to_owned() + "[fatal] Error opening output files: Invalid argument\n";
    assert_eq!(refused(&later), says.replace(", only sound", ""));
    // Others are told as ffmpeg tells them, with one full stop.
    let damaged = "[error] clip.avi: Invalid data found when processing input.\n";
    let message = refused(&(damaged.to_owned() + "To ignore this, add a trailing '?' to the map.\n"));
    assert!(message.contains("(why), nor by ffmpeg: clip.avi: Invalid data found"), "{message}");
    assert!(message.contains("processing input. The file may be damaged"), "{message}");
}

#[cfg(unix)]
#[test]
fn frames_that_come_beyond_those_asked_for_are_left_out() {
    let five = "for i in 0 1 2 3 4; do cp $frame $out/0000000$i.png; done";
    let selection = Selection { first: 4, last: Some(8), every: 2 };
    let recording = opened(five, &selection).unwrap();
    let names: Vec<_> = recording.frames.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names, ["000004", "000006", "000008"]);
    assert!(opened(five, &Selection { first: 5, last: Some(4), every: 1 }).is_err());
}

#[cfg(unix)]
#[test]
fn cameras_have_the_shape_of_the_videos_pixels() {
    let said = WHOLE.replace("SAR 1:1", "SAR 16:12");
    let one = |said: &str| {
        opened(&format!("cp $frame $out/00000000.png; cat >&2 <<'END'\n{said}END"), &ALL).unwrap()
    };
    let mut wide = one(&said);
    assert_eq!(wide.cameras[0].fy, wide.cameras[0].fx * (4.0 / 3.0));
    assert!(wide.notes[0].contains("1.333 times as wide as high"), "{:?}", wide.notes);
    // Settings follow them, too, unless they say more.
    for (given, fy) in [("fx = 30.0", 40.0), ("fx = 30.0\nfy = 31.0", 31.0)] {
        let settings: Settings = toml::from_str(&format!("[camera]\n{given}\n")).unwrap();
        settings.apply(&mut wide, Path::new("")).unwrap();
        assert_eq!(wide.cameras[0].fy, fy);
    }
    for square in [WHOLE, &said.replace("16:12", "0:1"), &said.replace("SAR 16:12 ", "")] {
        let square = one(square);
        assert_eq!((square.cameras[0].fy, square.notes.len()), (square.cameras[0].fx, 0));
    }
}
