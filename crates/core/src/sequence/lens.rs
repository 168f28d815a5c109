//! Lenses that no recording has, and lenses that hardly one has.

use crate::camera::Camera;
use std::ops::RangeInclusive;

/// Fields of view that a lens can have, degrees.
const POSSIBLE: RangeInclusive<f32> = 1.0..=179.0;
/// Fields of view that are to be expected, degrees.
const LIKELY: RangeInclusive<f32> = 10.0..=150.0;

/// Says why `camera` cannot be that of a recording; `None` if it can.
pub(super) fn impossible(camera: &Camera) -> Option<String> {
    let Camera { width, height, fx, fy, .. } = camera;
    let angles = angles(camera);
    if let Some(angle) = angles.into_iter().find(|angle| !POSSIBLE.contains(angle)) {
        let size = format!("pictures of {width}×{height}");
        return Some(format!("with fx = {fx:?} and fy = {fy:?}, the field of view of {size} is {angle:.2}°"));
    }
    let is_far = outside(camera).into_iter().any(|share| share > 1.0 || share.is_nan());
    is_far.then(|| format!("{} is far outside of pictures of {width}×{height}", principal_point(camera)))
}

/// Says what is strange about `camera`, in a sentence without a full stop; `None` if nothing is.
pub(super) fn unlikely(camera: &Camera) -> Option<String> {
    if angles(camera).iter().any(|angle| !LIKELY.contains(angle)) {
        let [across, down] = camera.field_of_view_degrees();
        return Some(format!("A field of view of {across:.1}° × {down:.1}° is unlikely"));
    }
    let is_outside = outside(camera).into_iter().any(|share| share > 0.0);
    is_outside.then(|| format!("{} is outside of the pictures", principal_point(camera)))
}

/// Returns the angles, degrees, that the longer side of the pictures would have by either focal length.
fn angles(camera: &Camera) -> [f32; 2] {
    let side = camera.width.max(camera.height);
    Camera { width: side, height: side, ..*camera }.field_of_view_degrees()
}

/// Returns how far the principal point is outside of the pictures, as shares of their width and height.
fn outside(camera: &Camera) -> [f32; 2] {
    [(camera.cx, camera.width), (camera.cy, camera.height)].map(|(at, size)| {
        let size = size as f32;
        (-at).max(at - size) / size
    })
}

fn principal_point(camera: &Camera) -> String {
    format!("The principal point at {:?}, {:?}", camera.cx, camera.cy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lenses_are_possible_likely_or_neither() {
        let usual = Camera::with_field_of_view(64, 48, 60.0);
        assert_eq!((impossible(&usual), unlikely(&usual)), (None, None));
        // A strip of a picture has a lens like any other.
        assert_eq!(impossible(&Camera { height: 1, cy: 0.5, ..usual }), None);
        for wrong in [
            Camera { fx: 1e30, ..usual },
            Camera { fy: 1e-30, ..usual },
            Camera { cx: -1e9, ..usual },
            Camera { cy: f32::NAN, ..usual },
            Camera::with_field_of_view(64, 48, 0.0001),
        ] {
            assert!(impossible(&wrong).is_some(), "{wrong:?}");
        }
        for strange in [
            Camera { cx: -3.0, ..usual },
            Camera { cy: 50.0, ..usual },
            Camera::with_field_of_view(64, 48, 8.0),
            Camera::with_field_of_view(64, 48, 160.0),
        ] {
            assert!(impossible(&strange).is_none() && unlikely(&strange).is_some(), "{strange:?}");
        }
    }
}
