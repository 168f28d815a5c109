//! Tests with the real recordings, if they are available.

use super::*;
use crate::progress::unobserved;

/// Returns a folder of real recordings; `None` (with a printed note) if it is absent.
fn real(name: &str) -> Option<PathBuf> {
    let path = std::env::var_os("SURGTPGS_DATA").map(|root| Path::new(&root).join(name));
    let path = path.filter(|path| path.exists());
    if path.is_none() {
        eprintln!("skipped: no {name} here (set SURGTPGS_DATA)");
    }
    path
}

#[test]
fn real_cholecseg8k_has_its_round_field_of_view() {
    let Some(path) = real("cholecseg8k_raw") else { return };
    let sequence = Sequence::open(&path).unwrap();
    assert_eq!((sequence.num_frames(), sequence.width(), sequence.height()), (48, 854, 480));
    let mut inside_by_label = 0;
    let mut both = 0;
    let mut union = 0;
    for i in (0..48).step_by(6) {
        let labels = sequence.labels(i).unwrap().unwrap();
        for (&label, &inside) in labels.data.iter().zip(&sequence.field_of_view().data) {
            if label != NO_LABEL {
                inside_by_label += usize::from(label != 0);
                both += usize::from(label != 0 && inside);
                union += usize::from(label != 0 || inside);
            }
        }
    }
    let iou = both as f64 / union as f64;
    eprintln!("field of view against labels: IoU {iou:.4}, {inside_by_label} pixels");
    assert!(iou > 0.97, "{iou}");
}

#[test]
fn real_endonerf_opens_whole() {
    let Some(path) = real("endonerf_pulling") else { return };
    let sequence = Sequence::open(&path).unwrap();
    assert_eq!((sequence.layout(), sequence.num_frames()), (Layout::EndoNerf, 63));
    assert!((sequence.camera(0).fx - 569.468).abs() < 1e-2 && !sequence.camera_moves());
    assert_eq!(sequence.field_of_view().count(), 640 * 512);
    let kept = sequence.mask(0).unwrap().count() as f64 / (640.0 * 512.0);
    assert!((0.5..0.99).contains(&kept), "{kept}");
}

#[test]
fn real_video_equals_its_pictures() {
    let (Some(video), Some(folder)) = (real("pulling.mp4"), real("endonerf_pulling")) else { return };
    let (video, folder) = (Sequence::open(&video).unwrap(), Sequence::open(&folder).unwrap());
    assert_eq!(video.num_frames(), folder.num_frames());
    let all: Vec<_> = (0..video.num_frames()).map(|i| video.frame(i).unwrap()).collect();
    let psnr = |i: usize| videos::psnr(&all[i], &folder.frame(i).unwrap());
    let worst = (0..all.len()).map(psnr).fold(f64::INFINITY, f64::min);
    eprintln!("video against pictures: worst frame {worst:.1} dB, {:?} fps", video.frames_per_second());
    assert!(worst > 30.0, "{worst}");
    let again = Sequence::open(video.path()).unwrap();
    assert!([62, 5, 31].iter().all(|&i| again.frame(i).unwrap() == all[i]));
}

#[test]
fn real_recordings_pass_the_check() {
    for name in ["cholecseg8k_raw", "endonerf_pulling"] {
        let Some(path) = real(name) else { return };
        let report = check(&Sequence::open(&path).unwrap(), &mut unobserved).unwrap();
        eprintln!("{report:#?}");
        assert!(report.ok, "{report:?}");
    }
}
