//! The anatomy at rest: each part is a grid of points, in millimetres, in the axes of the still camera (x
//! right, y down, z forward). Most parts are laid out in view coordinates (x/z, y/z, z), in which the
//! picture is easily composed.

use super::noise::{cells, cosine, curve, noise, sine, smoothstep};
use glam::Vec3;

/// The part of the scene that a surface belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ScenePart {
    Wall,
    Liver,
    Gallbladder,
    /// The fat in the foreground.
    Omentum,
    /// The fatty fold that hangs into view on the right.
    Ligament,
    Shaft,
    UpperJaw,
    LowerJaw,
}

impl ScenePart {
    /// Returns the class id of the part: its row in [`super::CLASSES`].
    pub(super) fn class(self) -> u8 {
        match self {
            Self::Wall => 0,
            Self::Liver => 1,
            Self::Gallbladder => 2,
            Self::Omentum | Self::Ligament => 3,
            Self::Shaft | Self::UpperJaw | Self::LowerJaw => 4,
        }
    }
}

/// All parts as one triangle mesh at rest.
#[derive(Clone, Debug, Default)]
pub(super) struct Anatomy {
    /// Vertex positions; those of the instrument are in its own axes: +z towards the tip, the
    /// tip at the origin.
    pub(super) rest: Vec<Vec3>,
    /// Per vertex: share of light that reaches it past the part's own folds, 0–1.
    pub(super) open: Vec<f32>,
    /// Per vertex: the part it belongs to.
    pub(super) part: Vec<ScenePart>,
    /// Vertices of each triangle; all three belong to one part.
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Anatomy {
    /// Lays out everything in the scene, its folds shaped by `seed`.
    pub(super) fn new(seed: u32) -> Self {
        let mut all = Self::default();
        all.add_wall(seed);
        all.add_liver(seed);
        all.add_gallbladder(seed);
        all.add_omentum(seed);
        all.add_ligament(seed);
        all.add_shaft();
        all.add_jaw(ScenePart::UpperJaw, 1.0);
        all.add_jaw(ScenePart::LowerJaw, -1.0);
        all
    }

    /// Adds the grid of `point`(u, v) → (position, openness) over the unit square, edges included.
    fn add(&mut self, part: ScenePart, (columns, rows): (u32, u32), point: impl Fn(f32, f32) -> (Vec3, f32)) {
        let start = self.rest.len() as u32;
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let (u, v) = (column as f32 / (columns - 1) as f32, row as f32 / (rows - 1) as f32);
            let (position, open) = point(u, v);
            self.rest.push(position);
            self.open.push(open);
            self.part.push(part);
            if row > 0 && column > 0 {
                let last = start + row * columns + column;
                let (left, above) = (last - 1, last - columns);
                self.triangles.extend([[above - 1, above, left], [above, last, left]]);
            }
        }
    }

    /// Adds the vault: near at the upper left, receding into the dark at the right.
    fn add_wall(&mut self, seed: u32) {
        self.add(ScenePart::Wall, (130, 100), |u, v| {
            let (a, b) = (mix(-1.1, 1.1, u), mix(-0.95, 0.6, v));
            let near = smoothstep(-0.15, 0.95, -0.75 * a - 0.6 * b);
            let p = seen_at(a, b, 142.0 - 80.0 * near);
            let swell = 5.0 * noise(p * Vec3::new(1.0, 0.6, 0.6), 26.0, seed + 1).value
                + 1.0 * noise(p, 11.0, seed + 2).value;
            (p * (1.0 + swell / 100.0), 1.0)
        });
    }

    /// Adds the liver: a wedge from the dark behind to a rounded, lobed edge in front, curling under.
    fn add_liver(&mut self, seed: u32) {
        self.add(ScenePart::Liver, (190, 110), |u, v| {
            let a = mix(-0.43, 0.85, u);
            let lobes = 0.022 * noise(Vec3::new(a, 0.0, 0.0), 0.11, seed + 3).value;
            let top = curve(&[0.065, -0.045, -0.19, -0.29, -0.35, -0.38, -0.39], u);
            let edge = curve(&[0.068, 0.095, 0.035, 0.035, 0.10, 0.135, 0.15], u) + lobes;
            let behind = curve(&[107.0, 126.0, 133.0, 135.0, 135.0, 135.0, 135.0], u);
            let lip = curve(&[106.0, 97.0, 90.0, 88.0, 86.0, 86.0, 86.0], u);
            // The thin left end closes to a point.
            let thick = smoothstep(0.0, 0.25, u);
            let share = |s| mix(top, edge, s);
            let depth = |s| mix(behind, lip, s);
            let b = [
                top + 0.06 * thick,
                top,
                share(0.35),
                share(0.68),
                share(0.92),
                edge,
                edge - 0.016 * thick,
                edge - 0.06 * thick,
            ];
            let z = [
                behind + 10.0 * thick,
                behind,
                depth(0.50) - 3.0,
                depth(0.84) - 3.5,
                depth(0.99) - 1.0,
                lip + 1.2,
                lip + 1.2 + 6.0 * thick,
                lip + 1.2 + 22.0 * thick,
            ];
            let p = seen_at(a, curve(&b, v), curve(&z, v));
            let swell = 3.5 * noise(p, 24.0, seed + 4).value + 0.8 * noise(p, 8.0, seed + 5).value;
            (p + swell * Vec3::new(0.0, -0.5, -0.8), 1.0 - 0.75 * smoothstep(0.68, 0.92, v))
        });
    }

    /// Adds the gallbladder: a pear-shaped sac half under the liver's edge.
    fn add_gallbladder(&mut self, seed: u32) {
        let along = Vec3::new(22.0, 5.5, -13.0).normalize();
        let across = along.cross(Vec3::Z).normalize();
        let front = along.cross(across);
        self.add(ScenePart::Gallbladder, (110, 80), |u, v| {
            let (x, r) = (-cosine(0.5 * v), sine(0.5 * v));
            let r = 14.0 * r * (1.0 + 0.2 * x);
            let spine = Vec3::new(1.0, 10.0, 103.0) + along * (20.5 * x) - across * (2.5 * x * x);
            let p = spine + across * (r * cosine(u)) + front * (r * sine(u));
            let swell = 2.2 * noise(p, 13.0, seed + 6).value;
            (p + swell * (p - spine).normalize_or_zero(), 0.35 + 0.65 * smoothstep(-5.0, 5.0, p.y))
        });
    }

    /// Adds lobular yellow fat in the foreground, its crest in front of the gallbladder.
    fn add_omentum(&mut self, seed: u32) {
        self.add(ScenePart::Omentum, (230, 130), |u, v| {
            let a = mix(-0.95, 0.95, u);
            let crest = curve(&[0.02, 0.06, 0.105, 0.165, 0.15, 0.10, 0.07], u);
            let depth = curve(&[99.0, 97.0, 95.0, 92.0, 91.0, 92.0, 95.0], u);
            let b = [0.75, 0.52, 0.37, crest + 0.09, crest + 0.03, crest, crest + 0.03, crest + 0.12];
            let z = [54.0, 60.0, 69.0, depth - 13.0, depth - 5.0, depth + 1.0, depth + 8.0, depth + 14.0];
            let p = seen_at(a, curve(&b, v), curve(&z, v));
            let swell = 3.2 * noise(p, 24.0, seed + 7).value;
            lobules(p + swell * Vec3::new(0.1, -0.6, -0.7), Vec3::new(0.1, -0.7, -0.7), 9.0, seed + 8)
        });
    }

    /// Adds a fatty fold hanging into the picture from the upper right.
    fn add_ligament(&mut self, seed: u32) {
        let centre = seen_at(0.53, -0.2, 86.0);
        self.add(ScenePart::Ligament, (110, 80), |u, v| {
            let (x, r) = (-cosine(0.5 * v), sine(0.5 * v));
            let out = Vec3::new(r * cosine(u), x, r * sine(u));
            let p = centre + out * Vec3::new(17.0, 15.0 + 3.0 * out.x, 12.0);
            let swell = 3.0 * noise(p, 17.0, seed + 9).value;
            lobules(p + swell * out, out, 7.5, seed + 10)
        });
    }

    /// Adds the instrument's tube, with a collar, and tapering towards the hinge.
    fn add_shaft(&mut self) {
        const ALONG: [(f32, f32); 9] = [
            (-130.0, 3.4),
            (-60.0, 3.4),
            (-28.0, 3.4),
            (-27.7, 3.8),
            (-24.0, 3.8),
            (-23.6, 3.3),
            (-17.0, 3.0),
            (-14.0, 2.2),
            (-13.0, 0.0),
        ];
        self.add(ScenePart::Shaft, (41, ALONG.len() as u32), |u, v| {
            let (z, r) = ALONG[(v * (ALONG.len() - 1) as f32 + 0.5) as usize];
            (Vec3::new(r * cosine(u), r * sine(u), z), 1.0)
        });
    }

    /// Adds one closed jaw from hinge to rounded tip; `side` is +1 above the bite, −1 below.
    fn add_jaw(&mut self, part: ScenePart, side: f32) {
        self.add(part, (33, 48), |u, v| {
            let width = curve(&[2.0, 2.3, 2.4, 2.3, 2.0, 1.5], v) * smoothstep(0.0, 0.12, 1.0 - v).sqrt();
            let thick = curve(&[2.1, 2.3, 2.1, 1.8, 1.5, 1.1], v) * smoothstep(0.0, 0.12, 1.0 - v).sqrt();
            // Flat at the bite, with the teeth's fine waves.
            let teeth = 0.16 * sine(v * 12.0) * smoothstep(0.2, 0.3, v);
            let y = (thick * sine(u)).max(0.05 + teeth);
            (Vec3::new(width * cosine(u), side * y, -HINGE_MM * (1.0 - v)), 1.0)
        });
    }
}

/// Returns the point seen at (a, b) = (x/z, y/z) at depth z.
fn seen_at(a: f32, b: f32, z: f32) -> Vec3 {
    Vec3::new(a * z, b * z, z)
}

fn mix(from: f32, to: f32, share: f32) -> f32 {
    from + (to - from) * share
}

/// Raises soft cushions of about `size` with furrows between them, along `outward`. Returns the point
/// and its openness.
fn lobules(p: Vec3, outward: Vec3, size: f32, seed: u32) -> (Vec3, f32) {
    let warped = p + 7.0 * Vec3::new(noise(p, 12.0, seed).value, noise(p, 12.0, seed + 100).value, 0.0);
    let stretched = warped * Vec3::new(0.6, 1.1, 1.0);
    let (first, second) = cells(stretched, size, seed);
    let (small_first, small_second) = cells(warped, 0.5 * size, seed + 1);
    // The depth of the furrows varies from place to place.
    let deep = smoothstep(-0.45, 0.35, noise(p, 15.0, seed + 2).value);
    let (large, small) =
        (smoothstep(0.0, 0.5, second - first), smoothstep(0.0, 0.6, small_second - small_first));
    let height = size * (0.10 * (large - 0.6) + 0.03 * (small - 0.6)) * (0.4 + deep);
    (p + outward * height, 1.0 - deep * (0.48 * (1.0 - large) + 0.18 * (1.0 - small)))
}

/// Distance of the jaws' hinge behind the tip, in millimetres.
pub(super) const HINGE_MM: f32 = 15.0;
