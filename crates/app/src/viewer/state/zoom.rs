//! Magnification of the picture; the panes of a comparison share it.

use egui::{Pos2, Rect, Vec2, vec2};

/// Magnification of the picture, and the part of it that is seen.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Zoom {
    factor: f32,
    /// Point of the picture in the middle of the pane, as share of its width and height.
    centre: [f32; 2],
}

impl Default for Zoom {
    fn default() -> Self {
        Self { factor: 1.0, centre: [0.5; 2] }
    }
}

const MAX_ZOOM: f32 = 12.0;

impl Zoom {
    pub(crate) fn is_home(&self) -> bool {
        self.factor == 1.0
    }

    /// Returns the rectangle of the picture: as large as fits the pane, then magnified. Proportions are kept.
    pub(crate) fn picture_rect(&self, pane: Rect, size: Vec2) -> Rect {
        let fit = (pane.width() / size.x.max(1.0)).min(pane.height() / size.y.max(1.0));
        let shown = size * fit * self.factor;
        Rect::from_min_size(pane.center() - Vec2::from(self.centre) * shown, shown)
    }

    /// Magnifies around a screen position; the point of the picture there stays in place.
    pub(crate) fn magnify(&mut self, by: f32, at: Pos2, panes: &Panes) {
        let Some((pane, picture)) = panes.0.iter().find(|(pane, _)| pane.contains(at)).copied() else {
            return;
        };
        let factor = (self.factor * by).clamp(1.0, MAX_ZOOM);
        let share = (at - picture.min) / picture.size();
        let size = picture.size() * factor / self.factor;
        self.factor = factor;
        self.centre = (share - (at - pane.center()) / size).into();
        self.keep_inside();
    }

    /// Moves the magnified picture.
    pub(crate) fn pan(&mut self, delta: Vec2, panes: &Panes) {
        let Some((_, picture)) = panes.0.first().copied() else { return };
        self.centre = (Vec2::from(self.centre) - delta / picture.size()).into();
        self.keep_inside();
    }

    /// Limits the zoom to what is possible, because files may hold any values.
    pub(crate) fn mended(mut self) -> Self {
        if !self.factor.is_finite() || !self.centre.iter().all(|c| c.is_finite()) {
            return Self::default();
        }
        self.factor = self.factor.clamp(1.0, MAX_ZOOM);
        self.keep_inside();
        self
    }

    fn keep_inside(&mut self) {
        let margin = 0.5 / self.factor;
        self.centre = self.centre.map(|c| c.clamp(margin, 1.0 - margin));
    }
}

/// Rectangles of the panes and their pictures, as last painted.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Panes(pub(crate) Vec<(Rect, Rect)>);

impl Panes {
    /// Returns the point of the picture under a screen position, as share of width and height; `None` outside
    /// the picture.
    pub(crate) fn picture_position(&self, at: Pos2) -> Option<[f32; 2]> {
        let (_, picture) = self.0.iter().find(|(pane, picture)| pane.contains(at) && picture.contains(at))?;
        let share = (at - picture.min) / picture.size();
        Some([share.x, share.y])
    }

    /// Returns the point of a picture of `size` pixels under a screen position, in the pane that shows
    /// `within`. Positions beside the picture give a point of its border.
    pub(crate) fn pixel(&self, at: Pos2, within: Pos2, size: [usize; 2]) -> Option<[f32; 2]> {
        let is_there = |(pane, picture): &&(Rect, Rect)| pane.contains(within) && picture.contains(within);
        let (_, picture) = self.0.iter().find(is_there)?;
        let share = ((at - picture.min) / picture.size()).clamp(Vec2::ZERO, Vec2::splat(1.0));
        Some([share.x * size[0] as f32, share.y * size[1] as f32])
    }

    /// Returns the screen position of a point of the picture in every pane.
    pub(crate) fn screen_positions(&self, [u, v]: [f32; 2]) -> impl Iterator<Item = (Rect, Pos2)> {
        self.0.iter().map(move |(pane, picture)| (*pane, picture.min + vec2(u, v) * picture.size()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::pos2;

    #[test]
    fn zooming_keeps_the_point_under_the_pointer() {
        let pane = Rect::from_min_size(pos2(10.0, 20.0), vec2(800.0, 600.0));
        let size = vec2(640.0, 512.0);
        let mut zoom = Zoom::default();
        let at = pos2(500.0, 300.0);
        for by in [1.5, 2.0, 0.7] {
            let panes = Panes(vec![(pane, zoom.picture_rect(pane, size))]);
            let before = panes.picture_position(at).unwrap();
            zoom.magnify(by, at, &panes);
            let after = Panes(vec![(pane, zoom.picture_rect(pane, size))]).picture_position(at).unwrap();
            assert!((before[0] - after[0]).abs() < 1e-4 && (before[1] - after[1]).abs() < 1e-4);
        }
    }

    #[test]
    fn a_point_of_the_picture_is_found_again_on_the_screen() {
        let pane = Rect::from_min_size(pos2(10.0, 20.0), vec2(800.0, 600.0));
        let panes = Panes(vec![(pane, Zoom::default().picture_rect(pane, vec2(640.0, 512.0)))]);
        let at = pos2(500.0, 300.0);
        let back = panes.screen_positions(panes.picture_position(at).unwrap()).next().unwrap().1;
        assert!(back.distance(at) < 1e-3);
    }

    #[test]
    fn proportions_are_kept_and_the_whole_picture_fits() {
        let pane = Rect::from_min_size(Pos2::ZERO, vec2(1000.0, 300.0));
        let picture = Zoom::default().picture_rect(pane, vec2(640.0, 512.0));
        assert!((picture.aspect_ratio() - 1.25).abs() < 1e-4);
        assert!(pane.expand(0.01).contains_rect(picture));
    }

    #[test]
    fn no_zoom_loses_the_picture() {
        let panes = Panes(vec![(Rect::EVERYTHING, Rect::from_min_size(Pos2::ZERO, vec2(640.0, 512.0)))]);
        let mut zoom = Zoom::default();
        zoom.pan(vec2(1e6, -1e6), &panes);
        assert_eq!(zoom.centre, [0.5, 0.5]);
        zoom.magnify(1e9, pos2(1.0, 1.0), &panes);
        assert_eq!(zoom.factor, MAX_ZOOM);
        let nonsense = Zoom { factor: f32::NAN, centre: [1e30, 0.0] };
        assert_eq!(nonsense.mended(), Zoom::default());
        assert_eq!(Zoom { factor: 2.0, centre: [9.0, 0.5] }.mended().centre, [0.75, 0.5]);
    }
}
