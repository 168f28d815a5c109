//! A deforming scene as one web page, which plays in a browser without a server or a network.
//!
//! The page is `assets/web/page.html` with its parts filled in. The numbers of the scene are rounded and
//! deflated as in the compact form of scene files; the page's own code unpacks, moves, sorts and draws them.

use super::{
    GENERATOR, Scene,
    camera_row::camera_row,
    file::{
        compact::{Steps, cosines, deflated, mix, pack},
        pack_bits,
    },
    fit::{fit_motion, sample_times},
};
use crate::{
    about::intended_use,
    camera::{MAX_MOVING_DEGREES, MAX_STILL_DEGREES},
    deform::{BasisShape, COLOUR_CHANNEL, Deformation},
    raster_limits::{DILATION, FRUSTUM_GUARD, MAX_ALPHA, MIN_ALPHA, MIN_DEPTH_ALPHA, NEAR},
    sequence::{USUAL_SPEED, shown_for},
};
use base64::{Engine as _, engine::general_purpose::STANDARD as BASE64};
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};
use std::borrow::Cow;

/// First bytes of every page.
const START: &[u8] = b"<!doctype html>";
/// Channels of motion that a picture shows: all but the gates of features.
const CHANNELS: usize = COLOUR_CHANNEL + 3;
/// Largest number of bases that motion of another kind is fitted with.
const MOST_FITTED: usize = 64;

/// Template of the page; names in double braces are its parts.
const PAGE: &str = include_str!("../../../../assets/web/page.html");
const STYLE: &str = include_str!("../../../../assets/web/style.css");
/// Code of the page, in this order.
const SCRIPT: &str = concat!(
    include_str!("../../../../assets/web/scene.js"),
    include_str!("../../../../assets/web/camera.js"),
    include_str!("../../../../assets/web/painter.js"),
    include_str!("../../../../assets/web/player.js"),
);
/// Shaders of the page, by their places in the template.
const SHADERS: [(&str, &str); 5] = [
    ("splats.vert", include_str!("../../../../assets/web/splats.vert")),
    ("splats.frag", include_str!("../../../../assets/web/splats.frag")),
    ("screen.vert", include_str!("../../../../assets/web/screen.vert")),
    ("picture.frag", include_str!("../../../../assets/web/picture.frag")),
    ("found.frag", include_str!("../../../../assets/web/found.frag")),
];

/// A prompt and its answers, for a page to show.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PagePrompt {
    /// The words.
    pub text: String,
    /// Colour of what was found.
    pub colour: [u8; 3],
    /// `found`, `nearest` or `absent` for each frame.
    pub frames: Vec<&'static str>,
    /// Class that is most like the words, if they mean none.
    pub nearest: Option<String>,
    /// Statement about a prompt that no frame shows; empty for others.
    pub note: String,
    /// For each Gaussian, the share of frames on which the prompt finds it, 0–1.
    #[serde(skip)]
    pub shares: Vec<f32>,
}

/// Deflated arrays one after the other, with a table of their places.
#[derive(Default)]
struct Arrays {
    bytes: Vec<u8>,
    table: Map<String, Value>,
}

impl Arrays {
    fn add(&mut self, name: &str, packed: &[u8], steps: &[f32], offsets: &[f32]) {
        let (start, bytes) = (self.bytes.len(), packed.len());
        let place = json!({ "start": start, "bytes": bytes, "steps": steps, "offsets": offsets });
        self.table.insert(name.to_owned(), place);
        self.bytes.extend_from_slice(packed);
    }

    /// Adds rows of numbers, rounded to the steps of their columns; nothing if there are none.
    fn numbers(&mut self, name: &str, values: &[f32], steps: Option<&[f32]>) {
        if let Some(steps) = steps.filter(|_| !values.is_empty()) {
            let packed = pack(values, steps);
            self.add(name, &packed.bytes, steps, &packed.offsets);
        }
    }
}

impl Scene {
    /// Returns the scene as one HTML file that plays in a browser. It asks for nothing outside of itself, and
    /// holds no path of this machine. Bases that are not shared by all Gaussians are replaced by such ones.
    pub fn to_page(&self, prompts: &[PagePrompt]) -> Vec<u8> {
        let motion = self.shared_motion();
        let arrays = self.arrays(&motion, prompts);
        let header = self.header(&motion, prompts, &arrays.table).to_string().replace('<', "\\u003c");
        let policy = format!(
            "default-src 'none'; script-src '{}'; style-src '{}'; img-src data:; base-uri 'none'; form-action 'none'",
            sha256_of(SCRIPT),
            sha256_of(STYLE)
        );
        let (name, data) = (escaped(&self.provenance.sequence_name), BASE64.encode(&arrays.bytes));
        let generator = format!("{GENERATOR} {}", env!("CARGO_PKG_VERSION"));
        let parts = [
            ("name", name.as_str()),
            ("generator", &generator),
            ("policy", &policy),
            ("use", intended_use()),
            ("style", STYLE),
            ("script", SCRIPT),
            ("scene", &header),
            ("data", &data),
        ];
        filled(PAGE, &[&parts[..], &SHADERS].concat()).into_bytes()
    }

    /// Returns the motion with bases that all Gaussians share.
    fn shared_motion(&self) -> Cow<'_, Deformation> {
        let (d, n) = (&*self.deformation, self.gaussians.len());
        if d.is_shared() {
            return Cow::Borrowed(d);
        }
        let bases = self.num_frames().clamp(4, MOST_FITTED);
        let mut fitted = Deformation::at_rest(n, self.gaussians.latent_dim, bases, 1.0, d.gate_slope);
        fitted.shape = BasisShape::Spline;
        fitted.widths.fill(1.0 / (bases - 1) as f32);
        let channels = 0..fitted.stride.min(d.stride);
        fit_motion(&mut fitted, d, n, &sample_times(self.num_frames().max(2 * bases)), channels);
        Cow::Owned(fitted)
    }

    fn arrays(&self, motion: &Deformation, prompts: &[PagePrompt]) -> Arrays {
        let (g, steps, mut arrays) = (&self.gaussians, Steps::for_scene(self), Arrays::default());
        arrays.numbers("means", g.means.as_flattened(), steps.of("means"));
        arrays.numbers("rotations", g.rotations.as_flattened(), steps.of("rotations"));
        arrays.numbers("log_scales", g.log_scales.as_flattened(), steps.of("log_scales"));
        arrays.numbers("opacity_logits", &g.opacity_logits, steps.of("opacity_logits"));
        arrays.numbers("colours", g.colours.as_flattened(), steps.of("colours"));
        arrays.numbers("sh_rest", &g.sh_rest, steps.of("sh_rest"));
        let rows = motion.weights.chunks_exact(motion.stride);
        let mut weights: Vec<f32> = rows.flat_map(|row| &row[..CHANNELS]).copied().collect();
        mix(&cosines(motion.num_bases), motion.num_bases, &mut weights);
        arrays.numbers("basis_weights", &weights, steps.of("basis_weights").map(|s| &s[..CHANNELS]));
        arrays.add("field_of_view", &deflated(&pack_bits(&self.field_of_view)), &[], &[]);
        for (k, prompt) in prompts.iter().enumerate() {
            let bytes: Vec<u8> = prompt.shares.iter().map(|s| (255.0 * s).round() as u8).collect();
            arrays.add(&format!("shares.{k}"), &deflated(&bytes), &[], &[]);
        }
        arrays
    }

    fn header(&self, motion: &Deformation, prompts: &[PagePrompt], arrays: &Map<String, Value>) -> Value {
        let frame = |i: usize| {
            let (values, live) = motion.basis_values(self.time(i));
            let bases = json!({ "first": live.start, "values": values[live] });
            json!({ "camera": camera_row(&self.cameras[i]), "bases": bases })
        };
        let moves = self.cameras.iter().any(|c| c.camera_from_world != self.cameras[0].camera_from_world);
        let most_degrees = if moves { MAX_MOVING_DEGREES } else { MAX_STILL_DEGREES };
        // Frames are named and timed as in the recording, also those of a chapter alone.
        let (first, made) = (self.chapters.first_frame(), &self.provenance);
        let frames = first..first + self.num_frames();
        let usual = 1.0 / f64::from(made.speed().unwrap_or(USUAL_SPEED));
        let lasts = |i: usize| shown_for(i, &made.frame_seconds).unwrap_or(usual);
        json!({
            "first": first,
            "seconds": frames.clone().map(|i| made.seconds(i)).collect::<Option<Vec<f64>>>(),
            "lasts": frames.map(lasts).collect::<Vec<_>>(),
            "bases": motion.num_bases,
            "bands": self.gaussians.sh_bands(),
            "frames": (0..self.num_frames()).map(frame).collect::<Vec<_>>(),
            "field": [self.field_of_view.width, self.field_of_view.height],
            "pivot_depth": self.typical_depth(),
            "most_turn": most_degrees.to_radians(),
            "limits": {
                "NEAR": NEAR, "DILATION": DILATION, "MIN_ALPHA": MIN_ALPHA, "MAX_ALPHA": MAX_ALPHA,
                "MIN_SEEN": MIN_DEPTH_ALPHA, "FRUSTUM_GUARD": FRUSTUM_GUARD,
            },
            "prompts": prompts,
            "tensors": arrays,
        })
    }

    /// Returns the median depth of what is before the first camera; views are turned around it.
    fn typical_depth(&self) -> f32 {
        let camera = self.cameras.first();
        camera.and_then(|camera| camera.depth_percentile(&self.gaussians.means, 50.0)).unwrap_or(1.0)
    }
}

/// Returns a template with its parts filled in. What is filled in is not looked at again.
fn filled(template: &str, parts: &[(&str, &str)]) -> String {
    let mut pieces = template.split("{{");
    let mut text = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let (name, rest) = piece.split_once("}}").unwrap_or((piece, ""));
        let part = parts.iter().find(|(part, _)| *part == name).map_or("", |(_, value)| value);
        text += part;
        text += rest;
    }
    text
}

/// Returns the name of inline text in a content security policy.
fn sha256_of(text: &str) -> String {
    format!("sha256-{}", BASE64.encode(Sha256::digest(text.as_bytes())))
}

/// Returns text as HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Tells if the first bytes of a file are those of a page that names this program as its generator.
pub(super) fn is_own(start: &[u8]) -> bool {
    let mark = format!("<meta name=\"generator\" content=\"{GENERATOR} ");
    start.starts_with(START) && start.windows(mark.len()).any(|bytes| bytes == mark.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{scene::Chapter, stress};

    fn page(scene: &Scene, prompts: &[PagePrompt]) -> String {
        String::from_utf8(scene.to_page(prompts)).unwrap()
    }

    fn header(page: &str) -> Value {
        let (_, rest) = page.split_once(r#"id="scene">"#).unwrap();
        serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
    }

    #[test]
    fn all_parts_of_the_page_are_filled_in() {
        let mut scene = stress::ordinary(30);
        scene.provenance.sequence_name = "a <b> & {{data}}".into();
        let prompt = PagePrompt {
            text: "</script><b>".into(),
            colour: [1, 2, 3],
            frames: vec!["found"],
            nearest: None,
            note: String::new(),
            shares: vec![0.5; 30],
        };
        let page = page(&scene, &[prompt]);
        assert!(
            is_own(page.as_bytes()) && page.contains("<title>a &lt;b&gt; &amp; {{data}} · SurgTPGS</title>")
        );
        for part in [STYLE, SCRIPT, SHADERS[0].1, intended_use()] {
            assert!(page.contains(part));
        }
        let header = header(&page);
        assert_eq!(header["prompts"][0]["text"], "</script><b>");
        assert_eq!(header["frames"].as_array().unwrap().len(), 1);
        let shares = &header["tensors"]["shares.0"];
        let data = page.split_once(r#"id="data">"#).unwrap().1.split_once("</script>").unwrap().0;
        let end = shares["start"].as_u64().unwrap() + shares["bytes"].as_u64().unwrap();
        assert_eq!(BASE64.decode(data).unwrap().len() as u64, end, "the last array ends where the data do");
    }

    #[test]
    fn text_is_never_taken_for_the_end_of_a_script() {
        for part in [STYLE, SCRIPT].into_iter().chain(SHADERS.map(|s| s.1)) {
            assert!(!part.contains("</") && !part.contains("://"));
        }
    }

    #[test]
    fn motion_with_own_bases_is_fitted() {
        let mut scene = stress::ordinary(20);
        scene.cameras = vec![scene.cameras[0]; 12];
        let own = Deformation::clone(&scene.deformation).with_own_bases();
        let mut other = scene.clone();
        other.deformation = own.into();
        let fitted = other.shared_motion();
        assert!(fitted.is_shared());
        for time in [0.0, 0.4, 0.9] {
            let (a, b) = (fitted.psi(20, time), scene.deformation.psi(20, time));
            let worst = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < 2e-3, "{worst} at {time}");
        }
    }

    #[test]
    fn frames_of_a_chapter_keep_their_numbers_and_times() {
        let mut scene = stress::ordinary(20);
        scene.cameras = vec![scene.cameras[0]; 9];
        let chapter = Chapter { index: 1, count: 2, shown: 5..9, learned: 4..9 };
        scene.provenance.settings = json!({ "chapter": chapter });
        scene.provenance.frames_per_second = Some(5.0);
        let alone = |scene: &Scene| {
            let scene = scene.clone().as_chapter().chapter_alone(1).unwrap();
            let header = header(&page(&scene, &[]));
            [&header["first"], &header["seconds"], &header["lasts"]].map(Value::clone)
        };
        assert_eq!(alone(&scene), [json!(5), json!([1.0, 1.2, 1.4, 1.6]), json!([0.2, 0.2, 0.2, 0.2])]);
        scene.provenance.frame_seconds = vec![0.0, 0.25, 0.5, 0.75, 1.0, 2.0, 2.25, 9.0, 9.5];
        assert_eq!(alone(&scene), [json!(5), json!([2.0, 2.25, 9.0, 9.5]), json!([0.25, 2.0, 0.5, 0.2])]);
        (scene.provenance.frame_seconds, scene.provenance.frames_per_second) = (Vec::new(), None);
        assert_eq!(alone(&scene)[1..], [Value::Null, json!([0.04, 0.04, 0.04, 0.04])]);
    }

    #[test]
    fn a_page_of_a_damaged_scene_is_a_page() {
        let mut scene = stress::ordinary(3);
        scene.gaussians.means[1] = [f32::INFINITY, f32::NAN, -f32::INFINITY];
        assert!(header(&page(&scene, &[]))["tensors"]["means"].is_object());
        assert!(header(&page(&stress::ordinary(0), &[]))["tensors"]["field_of_view"].is_object());
    }
}
