//! Tests with changed and unchanged recordings.

use super::{videos::write_video, *};
use crate::reading::Pieces;
use std::fs;

const NAMES: [&str; 4] = ["a_1.png", "a_2.png", "a_3.png", "a_4.png"];

struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        write_pictures(&place.at("clip"), &NAMES);
        place
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

fn identity(path: &Path) -> Arc<Identity> {
    Sequence::open(path).unwrap().identity().unwrap()
}

/// Applies `change` to the clip and returns the differences found: by names and sizes, and by everything.
fn changes(change: impl FnOnce(&Place)) -> [Option<String>; 2] {
    let place = Place::new();
    let before = identity(&place.at("clip"));
    change(&place);
    let sequence = Sequence::open(&place.at("clip")).unwrap();
    let now = [sequence.outline().clone(), sequence.identity().unwrap()];
    now.map(|now| now.difference(&before).map(|d| d.to_string()))
}

#[test]
fn what_has_changed_is_said_with_the_frame() {
    let rename = |from: &'static str, to: &'static str| {
        move |place: &Place| fs::rename(place.at("clip").join(from), place.at("clip").join(to)).unwrap()
    };
    let both = |what: &str| [Some(what.to_owned()), Some(what.to_owned())];
    assert_eq!(changes(|_| {}), [None, None]);
    assert_eq!(changes(rename("a_2.png", "a_20.png")), both("frame 1 \"a_2.png\" is missing"));
    assert_eq!(
        changes(rename("a_4.png", "a_9.png")),
        both("frame 3 is called \"a_9.png\" but was \"a_4.png\"")
    );
    let remove = |place: &Place| fs::remove_file(place.at("clip/a_2.png")).unwrap();
    assert_eq!(changes(remove), both("it has 3 frames instead of 4, frame 1 \"a_2.png\" is missing"));
    let add = |place: &Place| assert!(fs::copy(place.at("clip/a_2.png"), place.at("clip/a_5.png")).is_ok());
    assert_eq!(changes(add), both("it has 5 frames instead of 4, frame 4 \"a_5.png\" is new"));
    let longer = |place: &Place| {
        let file = place.at("clip/a_3.png");
        fs::write(&file, [&fs::read(&file).unwrap()[..], b"more"].concat()).unwrap();
    };
    assert_eq!(changes(longer), both("frame 2 \"a_3.png\" has another size"));
    // If the size stays the same, only reading the frame shows the change.
    let turn = |place: &Place| {
        let file = place.at("clip/a_3.png");
        let mut bytes = fs::read(&file).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(&file, bytes).unwrap();
    };
    assert_eq!(changes(turn), [None, Some("frame 2 \"a_3.png\" has another content".into())]);
    let replace = |place: &Place| {
        for (i, name) in NAMES.iter().enumerate() {
            picture(8, 7, 10 + i as u8).save(place.at("clip").join(name)).unwrap();
        }
    };
    assert_eq!(changes(replace)[1].as_deref(), Some("it is another one, no frame is the same"));
}

#[test]
fn settings_that_were_lost_are_named_where_they_may_be_the_reason() {
    let place = Place::new();
    let clip = place.at("clip");
    let required =
        |then: &Identity| identity(&clip).require(then, &clip, "was used").unwrap_err().to_string();
    let hint = "`[[hidden]]` in sequence.toml) were lost or changed, put them back";
    for lost in ["[frames]\nlast = 1\n", "[[hidden]]\nx = 0\ny = 0\nwidth = 2\nheight = 2\n"] {
        fs::write(clip.join("sequence.toml"), lost).unwrap();
        let then = identity(&clip);
        fs::remove_file(clip.join("sequence.toml")).unwrap();
        assert!(required(&then).contains(hint), "{}", required(&then));
    }
    let then = identity(&clip);
    fs::rename(clip.join("a_2.png"), clip.join("a_20.png")).unwrap();
    assert!(!required(&then).contains("settings"), "{}", required(&then));
}

#[test]
fn it_is_the_same_wherever_it_lies_and_whatever_is_beside_it() {
    let place = Place::new();
    let before = identity(&place.at("clip"));
    fs::rename(place.at("clip"), place.at("moved")).unwrap();
    for name in NAMES {
        write_grey(&place.at("moved/masks").join(name), 3, 255);
    }
    let after = identity(&place.at("moved"));
    assert_eq!((after.difference(&before), after.digest()), (None, before.digest()));
    assert_eq!(after.frames_in_common(&before), 4);
    assert_eq!(
        after.outline_digest(),
        Sequence::open(&place.at("moved")).unwrap().outline().outline_digest()
    );
}

#[test]
fn chosen_frames_keep_their_names() {
    let place = Place::new();
    fs::write(place.at("clip/sequence.toml"), "[time]\nevery = 2\n").unwrap();
    assert_eq!(identity(&place.at("clip")).names().collect::<Vec<_>>(), ["a_1.png", "a_3.png"]);
    let path = place.at("clip.mp4");
    write_video(&path);
    fs::write(place.at("clip.mp4.toml"), "[frames]\nfirst = 4\n[time]\nevery = 5\n").unwrap();
    let before = identity(&path);
    assert_eq!(before.names().collect::<Vec<_>>(), ["000004", "000009", "000014", "000019", "000024"]);
    // A skipped frame counts for the next chosen one, which is decoded from it.
    damage_frame(&path, 12);
    let what = identity(&path).difference(&before).unwrap().to_string();
    assert_eq!(what, "frame 2 \"000014\" has another content");
}

/// Changes a byte of a coded frame.
fn damage_frame(path: &Path, frame: usize) {
    let sample = &crate::sequence::mp4::Mp4::read(&Pieces::whole(path).unwrap()).unwrap().pictures[frame];
    let at = sample.offset as usize + sample.size - 1;
    let mut bytes = fs::read(path).unwrap();
    bytes[at] ^= 1;
    fs::write(path, bytes).unwrap();
}

#[test]
fn a_changed_frame_of_a_video_is_named() {
    let place = Place::new();
    let path = place.at("clip.mp4");
    write_video(&path);
    let before = identity(&path);
    damage_frame(&path, 13);
    let sequence = Sequence::open(&path).unwrap();
    let changed = Some("frame 13 \"000013\" has another content".to_owned());
    // With so few frames, opening the video reads them all.
    for now in [sequence.outline(), &sequence.identity().unwrap()] {
        assert_eq!(now.difference(&before).map(|d| d.to_string()), changed);
    }
    assert_eq!(sequence.identity().unwrap().frames_in_common(&before), before.num_frames() - 1);
}

#[test]
fn it_is_written_in_few_bytes_and_comes_back() {
    let lines: Vec<String> =
        (0..5000).map(|i| format!("{} 1234567 frame_{i:06}.png", "0123456789abcdef".repeat(4))).collect();
    let text = serde_json::json!({ "frames": lines }).to_string();
    let read: Identity = serde_json::from_str(&text).unwrap();
    let pretty = serde_json::to_string_pretty(&read).unwrap();
    assert!(pretty.len() < 600_000, "{} bytes", pretty.len());
    assert_eq!(serde_json::from_str::<Identity>(&pretty).unwrap(), read);
    assert_eq!(postcard::from_bytes::<Identity>(&postcard::to_stdvec(&read).unwrap()).unwrap(), read);
    for wrong in ["", "- 1", "- x a", "00 1 a", "zz 1 a", "é 1 a"] {
        let text = serde_json::json!({ "frames": [wrong] }).to_string();
        assert!(serde_json::from_str::<Identity>(&text).is_err(), "{wrong}");
    }
    let place = Place::new();
    let whole = identity(&place.at("clip"));
    let text = serde_json::to_string(&*whole).unwrap();
    assert_eq!(serde_json::from_str::<Identity>(&text).unwrap(), *whole);
}

#[test]
fn what_ffmpeg_unpacked_is_known_by_its_file() {
    let place = Place::new();
    let (_, mut recording) =
        crate::sequence::layouts::open(&place.at("clip"), &Settings::default().selection()).unwrap();
    let file = place.at("clip.avi");
    fs::write(&file, "some video").unwrap();
    recording.read_by_ffmpeg = vec![file.clone()];
    let before = Identity::complete(&recording).unwrap();
    assert_eq!(Identity::opened(&recording).unwrap().difference(&before), None);
    for other in ["same video", "a longer video"] {
        fs::write(&file, other).unwrap();
        let now = Identity::opened(&recording).unwrap();
        assert!(now.difference(&before).unwrap().to_string().contains("another one"));
    }
}

/// Makes an identity of frames of equal sizes, whose content is known by a digit each.
fn identity_of(content: &[Option<char>], bytes: u64) -> Identity {
    let hash = |digit: char| digit.to_string().repeat(64);
    let line =
        |(i, digit): (usize, &Option<char>)| format!("{} {bytes} {i:06}", digit.map_or("-".to_owned(), hash));
    let lines: Vec<String> = content.iter().enumerate().map(line).collect();
    serde_json::from_value(serde_json::json!({ "frames": lines })).unwrap()
}

#[test]
fn content_tells_recordings_of_equal_sizes_apart() {
    let [one, two] = ['1', '2'].map(|digit| identity_of(&[Some(digit); 3], 9));
    assert_eq!(one.outline_digest(), two.outline_digest());
    assert!(one.spots_digest().is_some() && one.spots_digest() != two.spots_digest());
    assert_eq!(identity_of(&[None; 3], 9).spots_digest(), None);
}

#[test]
fn what_opening_reads_is_the_same_of_a_complete_identity() {
    let read = |is_complete: bool| {
        let content: Vec<_> = (0..100).map(|i| (is_complete || i % 3 == 1).then_some('7')).collect();
        // Two of the 32 frames that are evenly spread, which are 1 and 4, fit into 64 MiB.
        identity_of(&content, 30 << 20).spots_digest()
    };
    assert!(read(true).is_some());
    assert_eq!(read(false), read(true));
    assert_eq!(identity_of(&[Some('7'); 3], 65 << 20).spots_digest(), None, "nothing is read");
}
