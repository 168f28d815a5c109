//! Finds the parts of a view that the recorded camera did not see.

use crate::{
    camera::Camera,
    grid::{Grid, Mask},
};

/// Share of the recorded depth. A point that lies further than this behind the recorded surface
/// was hidden by it.
const BEHIND: f32 = 0.03;

/// Returns a mask that is `true` for pixels whose surface the recorded camera did not see: outside its
/// frame or field of view, or behind what `recorded_depth` shows there. `depth` is that of the view in
/// scene units, 0 where there is nothing. Masks and maps may have any size.
pub fn unseen(
    (camera, depth): (&Camera, &Grid<f32>),
    (recorded, recorded_depth): (&Camera, &Grid<f32>),
    field_of_view: &Mask,
) -> Mask {
    let at_size = camera.resized(depth.width as u32, depth.height as u32);
    let is_seen = |i: usize| {
        let z = depth.data[i];
        if !(z > 0.0) {
            return false;
        }
        let pixel = [i % depth.width, i / depth.width].map(|p| p as f32 + 0.5);
        let Some((u, v, z)) = recorded.project(at_size.unproject(pixel[0], pixel[1], z)) else {
            return false;
        };
        let share = [u / recorded.width as f32, v / recorded.height as f32];
        let inside = value_at(field_of_view, share);
        let surface = value_at(recorded_depth, share).unwrap_or(0.0);
        inside == Some(true) && surface > 0.0 && z <= surface * (1.0 + BEHIND)
    };
    let data = (0..depth.data.len()).map(|i| !is_seen(i)).collect();
    Grid::from_vec(depth.width, depth.height, data)
}

/// Returns the value at shares of width and height; `None` outside.
fn value_at<T: Copy>(grid: &Grid<T>, [x, y]: [f32; 2]) -> Option<T> {
    let is_inside = (0.0..1.0).contains(&x) && (0.0..1.0).contains(&y) && !grid.data.is_empty();
    is_inside.then(|| {
        let index = |share: f32, n: usize| ((share * n as f32) as usize).min(n - 1);
        grid.at(index(x, grid.width), index(y, grid.height))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Affine3A, Vec3};

    fn recorded() -> Camera {
        Camera::with_field_of_view(40, 40, 90.0)
    }

    #[test]
    fn the_recorded_view_saw_all_of_itself_but_holes_and_the_border() {
        let mut depth = Grid::filled(20, 20, 10.0);
        depth.set(3, 4, 0.0);
        let right = Grid::from_vec(2, 1, vec![false, true]);
        let mask = unseen((&recorded(), &depth), (&recorded(), &depth), &right);
        assert!(mask.at(0, 0) && mask.at(9, 10) && !mask.at(10, 10));
        let whole = unseen((&recorded(), &depth), (&recorded(), &depth), &Grid::filled(1, 1, true));
        assert_eq!(whole.count(), 1, "the hole");
    }

    #[test]
    fn what_was_hidden_or_outside_was_not_seen() {
        // A wall at depth 20, and an object at depth 10 in front of its right half.
        let recorded_depth =
            Grid::from_vec(40, 1, (0..40).map(|x| if x < 20 { 20.0 } else { 10.0 }).collect());
        // A camera further to the left sees a part of the wall behind the object.
        let camera =
            Camera { camera_from_world: Affine3A::from_translation(Vec3::new(10.0, 0.0, 0.0)), ..recorded() };
        let wall = Grid::filled(40, 40, 20.0);
        let everything = Grid::filled(1, 1, true);
        let mask = unseen((&camera, &wall), (&recorded(), &recorded_depth), &everything);
        // Pixel x shows the wall at 20 · (x − 20) / 20 − 10 to the right: behind the object from 0,
        // outside before −20.
        assert_eq!([5, 12, 28, 32].map(|x| mask.at(x, 20)), [true, false, false, true]);
        assert_eq!(unseen((&camera, &Grid::filled(0, 0, 0.0)), (&recorded(), &wall), &everything).count(), 0);
        assert_eq!(
            unseen((&camera, &wall), (&recorded(), &Grid::filled(0, 0, 0.0)), &everything).count(),
            1600
        );
    }
}
