//! Motion of the scene: breathing, a fold that is pulled and released, the instrument, the endoscope. All
//! motion is smooth in time and repeats after [`CYCLE`] frames, so that the clip can be played in a loop,
//! unless it is asked to wander.

use super::noise::{cosine, sine, smoothstep};
use super::shape::{HINGE_MM, ScenePart};
use crate::camera::Camera;
use glam::{Affine3A, Mat3, Vec3};

/// Number of frames after which everything repeats.
pub(super) const CYCLE: f32 = 48.0;
/// Number of frames of one breath.
const BREATH: f32 = 24.0;
/// Point that the grasper holds, at rest, in millimetres.
const GRIP: Vec3 = Vec3::new(10.0, 10.6, 88.6);
/// Displacement of the pulled fold, in millimetres.
const PULL: Vec3 = Vec3::new(6.0, -4.5, -4.5);
/// Number of frames of one turn of each slow motion that goes on without ever coming back to where it was,
/// and the displacement at its turning points, in millimetres.
const WANDERING: [(f32, Vec3); 3] = [
    (173.2, Vec3::new(2.2, 0.6, 0.8)),
    (311.8, Vec3::new(-1.0, 1.8, -1.2)),
    (97.4, Vec3::new(0.5, -0.7, 0.9)),
];
/// Number of frames of one turn of the depth of breathing and of the strength of the pull, where they wander.
const CHANGES: [f32; 2] = [223.6, 141.4];
/// Point at which the instrument passes through the abdominal wall, in millimetres.
const TROCAR: Vec3 = Vec3::new(88.0, -8.0, 46.0);

/// The state of everything that moves at one time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    frame: f32,
    /// Displacement of all tissue, in millimetres.
    drift: Vec3,
    /// Depth of breathing as a share of the usual one.
    breath: f32,
    /// Displacement of the gripped fold, in millimetres.
    pull: Vec3,
    /// The instrument's axes (columns) and tip, in scene axes.
    axes: Mat3,
    tip: Vec3,
    /// Half the angle between the jaws, in turns.
    opening: f32,
}

impl Moment {
    /// Returns the state at frame `frame` (fractions are times between frames).
    pub(super) fn at(frame: f32, wanders: bool) -> Self {
        let f = frame - CYCLE * (frame / CYCLE).floor();
        let during = |start, full, fade, end| smoothstep(start, full, f) - smoothstep(fade, end, f);
        let strength = |period: f32| if wanders { 0.85 + 0.3 * sine(frame / period) } else { 1.0 };
        let [breath, pull] = CHANGES.map(strength);
        let pull = pull * PULL * during(13.0, 25.0, 26.0, 37.0);
        let drift = if wanders { wandering(frame) } else { Vec3::ZERO };
        let mut moment =
            Self { frame: f, drift, breath, pull, axes: Mat3::IDENTITY, tip: GRIP, opening: 0.0 };
        let away = 1.0 - during(-0.5, 11.5, 37.0, 47.5);
        // While it holds the tissue, the tip moves with it; before and after that it comes from the side
        // and returns there.
        let bite = Vec3::new(-2.0, 0.6, 1.6);
        moment.tip = moment.place(ScenePart::Gallbladder, GRIP) + bite + away * Vec3::new(8.0, -5.5, -4.0);
        moment.opening = 0.012 + 0.036 * (1.0 - during(9.0, 14.0, 34.0, 39.0));
        let z = (moment.tip - TROCAR).normalize();
        let x = (Vec3::new(0.0, 0.25, 1.0) - z * z.dot(Vec3::new(0.0, 0.25, 1.0))).normalize();
        moment.axes = Mat3::from_cols(x, z.cross(x), z);
        moment
    }

    /// Returns the position of the point `rest` of `part` at this moment, in scene axes.
    pub(super) fn place(&self, part: ScenePart, rest: Vec3) -> Vec3 {
        match part {
            ScenePart::Shaft => self.axes * rest + self.tip,
            ScenePart::UpperJaw => self.axes * self.open_jaw(rest, 1.0) + self.tip,
            ScenePart::LowerJaw => self.axes * self.open_jaw(rest, -1.0) + self.tip,
            _ => {
                let breathing = self.breath * self.breathing(part, rest);
                rest + self.drift + breathing + self.pull * give(part) * hold(rest)
            }
        }
    }

    /// Turns a jaw about its hinge.
    fn open_jaw(&self, p: Vec3, side: f32) -> Vec3 {
        let (s, c) = (side * sine(self.opening), cosine(self.opening));
        let z = p.z + HINGE_MM;
        Vec3::new(p.x, c * p.y + s * z, c * z - s * p.y - HINGE_MM)
    }

    /// Returns the displacement by breathing: the diaphragm pushes the liver down and forwards, the rest
    /// follows later and less.
    fn breathing(&self, part: ScenePart, p: Vec3) -> Vec3 {
        let inspired = |delay: f32| 0.5 - 0.5 * cosine((self.frame - delay) / BREATH);
        match part {
            ScenePart::Liver | ScenePart::Gallbladder => {
                let depth = 0.75 + 0.25 * (p.x / 45.0).clamp(-1.0, 1.0);
                inspired(0.03 * (40.0 - p.x)) * depth * Vec3::new(-1.0, 3.4, -2.4)
            }
            ScenePart::Ligament => inspired(1.5) * Vec3::new(-1.2, 2.0 + 0.05 * p.y, -0.8),
            ScenePart::Wall => {
                let mobile = smoothstep(150.0, 80.0, p.z);
                inspired(1.0) * mobile * Vec3::new(-0.6, -1.6, -1.6)
            }
            _ => {
                let ripple = sine((self.frame - 0.13 * p.x - 0.2 * p.z) / BREATH);
                inspired(2.5) * Vec3::new(-0.3, 1.7, -0.9) + ripple * Vec3::new(0.3, -0.5, -0.5)
            }
        }
    }
}

/// Returns a displacement that never repeats, 0 at frame 0, in millimetres.
fn wandering(frame: f32) -> Vec3 {
    WANDERING.iter().map(|(period, way)| *way * sine(frame / period)).sum()
}

/// Returns the share of the pull that a part follows.
fn give(part: ScenePart) -> f32 {
    match part {
        ScenePart::Gallbladder => 1.0,
        ScenePart::Liver => 0.65,
        ScenePart::Omentum => 0.4,
        _ => 0.0,
    }
}

/// Returns 1 at the grip, falling smoothly to 0: a tent on a wide foot.
fn hold(rest: Vec3) -> f32 {
    let kernel = |radius: f32| {
        let k = (1.0 - rest.distance_squared(GRIP) / (radius * radius)).max(0.0);
        k * k * k
    };
    0.75 * kernel(27.0) + 0.25 * kernel(10.0)
}

/// Returns the camera of frame `frame`: still, or on a gentle loop around the middle of the scene
/// that starts at rest, or one that goes on and on.
pub(super) fn camera(size: [u32; 2], moving: bool, wanders: bool, frame: f32) -> Camera {
    let [width, height] = size;
    // The focal length of a 60° wide picture of 4:3, so that other shapes show the same round field.
    let focal = 0.866_025_4 * width.min(height * 4 / 3) as f32;
    let mut camera = Camera {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: 0.5 * width as f32,
        cy: 0.5 * height as f32,
        camera_from_world: Affine3A::IDENTITY,
    };
    if moving {
        let turn = frame / CYCLE;
        let eye = Vec3::new(5.0 * sine(turn), 1.5 * sine(2.0 * turn), 3.0 * (1.0 - cosine(turn)));
        let eye = if wanders { eye + 2.0 * wandering(frame) } else { eye };
        let z = (Vec3::new(0.0, 0.0, 100.0) - eye).normalize();
        let x = Vec3::Y.cross(z).normalize();
        let world_from_camera = Mat3::from_cols(x, z.cross(x), z);
        camera.camera_from_world = Affine3A::from_mat3_translation(
            world_from_camera.transpose(),
            -(world_from_camera.transpose() * eye),
        );
    }
    camera
}
