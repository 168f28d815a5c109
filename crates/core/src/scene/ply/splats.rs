//! Still Gaussians in the `.ply` format of 3-D Gaussian splatting programs.

use super::table::{PlyTable, numbered};
use crate::{
    camera::Camera,
    codec::MAX_LATENT_DIM,
    gaussian::{Gaussians, MAX_SH_BANDS},
    num,
    scene::{
        MADE_BY, Problem, Scene,
        camera_row::{CAMERA_WIDTH, camera_row, read_camera},
        still::camera_before,
    },
};

/// Number of channels of a colour.
pub(super) const CHANNELS: usize = 3;
/// Largest logit of opacity that is kept; files may have an infinite one.
const MAX_LOGIT: f32 = 40.0;
/// Name of the columns of features, without their numbers, in files of the released code.
pub(super) const RELEASED: &str = "lang";
/// The same in files of LangSplat.
const LANGSPLAT: &str = "language_feature";
/// Beginning of the comment that holds the camera, as 18 numbers in the scene file's order.
const CAMERA_COMMENT: &str = "surgtpgs camera";

impl Gaussians {
    /// Returns the Gaussians as `.ply`: centre, normal (0), colour coefficients (higher bands channel by
    /// channel), logit of opacity, log-scales and quaternion (w, x, y, z), all 32-bit floats, little
    /// endian. The camera is a comment. Features are left out.
    pub fn to_ply(&self, camera: Option<&Camera>) -> Vec<u8> {
        let bands = self.sh_bands();
        let camera = camera.map(|c| {
            let numbers: Vec<String> = camera_row(c).iter().map(f32::to_string).collect();
            format!("{CAMERA_COMMENT} {}", numbers.join(" "))
        });
        PlyTable {
            names: names(bands),
            comments: std::iter::once(MADE_BY.to_owned()).chain(camera).collect(),
            values: (0..self.len()).flat_map(|i| row(self, i, bands)).collect(),
        }
        .to_bytes()
    }
}

/// Returns the values of one Gaussian in the order of [`names`]; bands that it does not have are 0.
pub(super) fn row(gaussians: &Gaussians, i: usize, bands: usize) -> Vec<f32> {
    let own = gaussians.sh_bands();
    let mut values = gaussians.means[i].to_vec();
    values.extend([0.0; 3]);
    values.extend(gaussians.colours[i]);
    let rest = &gaussians.sh_rest[i * own * CHANNELS..(i + 1) * own * CHANNELS];
    for channel in 0..CHANNELS {
        values.extend(rest.iter().skip(channel).step_by(CHANNELS));
        values.resize(values.len() + bands - own, 0.0);
    }
    values.push(gaussians.opacity_logits[i]);
    values.extend(gaussians.log_scales[i]);
    values.extend(gaussians.rotations[i]);
    values
}

/// Returns the columns of an ordinary file, in the order of the released 3DGS code.
pub(super) fn names(bands: usize) -> Vec<String> {
    let plain = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    [
        plain(&["x", "y", "z", "nx", "ny", "nz"]),
        numbered("f_dc", CHANNELS),
        numbered("f_rest", CHANNELS * bands),
        plain(&["opacity"]),
        numbered("scale", 3),
        numbered("rot", 4),
    ]
    .concat()
}

/// Reads a still scene; Gaussians with a number that is not finite are left out and counted
/// in the provenance.
pub(super) fn from_table(table: &PlyTable) -> Result<Scene, Problem> {
    let features = if table.count_numbered(RELEASED) > 0 { RELEASED } else { LANGSPLAT };
    let (gaussians, rows) = gaussians(table, features, &[])?;
    let camera = camera(table).unwrap_or_else(|| camera_before(&gaussians.means));
    let mut scene = Scene::of_still(gaussians, camera);
    scene.provenance.settings = serde_json::json!({
        "imported_from": "3DGS .ply",
        "gaussians_left_out": table.num_rows() - rows.len(),
    });
    Ok(scene)
}

/// Reads the Gaussians with features of the name, and returns the rows they are in: those in which the
/// ordinary columns, those of features and those in `also` are finite.
pub(super) fn gaussians(
    table: &PlyTable,
    features: &str,
    also: &[usize],
) -> Result<(Gaussians, Vec<usize>), Problem> {
    let latent_dim = table.count_numbered(features);
    if latent_dim > MAX_LATENT_DIM {
        return Err(format!(
            "the vertices have {latent_dim} properties `{features}_…`, expected at most {MAX_LATENT_DIM}: \
             embeddings are read compressed only"
        ));
    }
    let feature_columns = table.columns(&numbered(features, latent_dim))?;
    let bands = match table.count_numbered("f_rest") {
        n if [0, 9, 24, 45].contains(&n) => n / CHANNELS,
        n => return Err(format!("the vertices have {n} properties `f_rest_…`, expected 0, 9, 24 or 45")),
    };
    let normals = ["nx", "ny", "nz"];
    let names: Vec<String> = names(bands).into_iter().filter(|n| !normals.contains(&n.as_str())).collect();
    let columns = table.columns(&names)?;
    let (mut gaussians, mut rows) = (Gaussians::default(), Vec::new());
    for k in 0..table.num_rows() {
        let row = table.row(k);
        let mut values: Vec<f32> = columns.iter().map(|&c| row[c]).collect();
        let (head, shape) = values.split_at_mut(6 + bands * CHANNELS);
        if shape[0].is_infinite() {
            shape[0] = MAX_LOGIT.copysign(shape[0]);
        }
        let all_finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
        let mut others = also.iter().chain(&feature_columns);
        if !(all_finite(head) && all_finite(shape) && others.all(|&c| row[c].is_finite())) {
            continue;
        }
        rows.push(k);
        gaussians.features.extend(feature(feature_columns.iter().map(|&c| row[c]).collect(), features));
        gaussians.means.push([head[0], head[1], head[2]]);
        gaussians.colours.push([head[3], head[4], head[5]]);
        let rest = &head[6..];
        gaussians.sh_rest.extend((0..bands).flat_map(|b| (0..CHANNELS).map(move |c| rest[c * bands + b])));
        gaussians.opacity_logits.push(shape[0]);
        gaussians.log_scales.push([shape[1], shape[2], shape[3]]);
        gaussians.rotations.push([shape[4], shape[5], shape[6], shape[7]]);
    }
    gaussians.latent_dim = latent_dim;
    gaussians.sh_degree = degree_of(bands);
    drop_empty_bands(&mut gaussians);
    Ok((gaussians, rows))
}

/// Returns the feature of a Gaussian. LangSplat's count by their direction alone.
fn feature(values: Vec<f32>, name: &str) -> Vec<f32> {
    match num::normalised(&values) {
        Some(direction) if name == LANGSPLAT => direction,
        _ => values,
    }
}

fn degree_of(bands: usize) -> usize {
    (0..=3).find(|d| (d + 1) * (d + 1) > bands).unwrap_or(3)
}

/// Removes bands that are 0 everywhere: files often hold degree 3 but use only degree 0.
pub(in crate::scene) fn drop_empty_bands(gaussians: &mut Gaussians) {
    let bands = gaussians.sh_bands();
    let used = |row: &[f32]| row.iter().rposition(|v| *v != 0.0).map_or(0, |last| last / CHANNELS + 1);
    let most = gaussians.sh_rest.chunks_exact((bands * CHANNELS).max(1)).map(used).max().unwrap_or(0);
    gaussians.sh_degree = degree_of(most);
    let kept = gaussians.sh_bands() * CHANNELS;
    debug_assert!(kept <= MAX_SH_BANDS * CHANNELS);
    if bands > 0 {
        let rows = gaussians.sh_rest.chunks_exact(bands * CHANNELS);
        gaussians.sh_rest = rows.flat_map(|row| row[..kept].to_vec()).collect();
    }
}

/// Reads the camera that this program notes in files that it writes.
fn camera(table: &PlyTable) -> Option<Camera> {
    let numbers = table.comments.iter().find_map(|c| c.trim().strip_prefix(CAMERA_COMMENT))?;
    let row: Vec<f32> = numbers.split_whitespace().map(|n| n.parse().ok()).collect::<Option<_>>()?;
    let is_good = row.len() == CAMERA_WIDTH && row.iter().all(|v| v.is_finite());
    is_good.then(|| read_camera(&row)).filter(Camera::is_usable)
}

#[cfg(test)]
mod tests {
    use super::{
        super::{ReferenceWeights, from_bytes},
        *,
    };
    use crate::stress;

    fn no_weights() -> Result<Option<ReferenceWeights>, Problem> {
        Err("these files do not deform".into())
    }

    fn still() -> Gaussians {
        let mut scene = stress::ordinary(9);
        scene.gaussians.sh_degree = 1;
        scene.gaussians.sh_rest = (0..9 * 9).map(|i| i as f32).collect();
        scene.still(0.4, &[2, 7])
    }

    #[test]
    fn gaussians_read_back_are_the_same() {
        let camera = stress::ordinary(1).cameras[0];
        let scene = from_bytes(&still().to_ply(Some(&camera)), no_weights).unwrap();
        assert_eq!(*scene.gaussians, still());
        assert_eq!(scene.cameras, [camera], "the camera is noted");
        assert_eq!(scene.provenance.settings["gaussians_left_out"], 0);
        let empty = Gaussians::default().to_ply(None);
        assert!(from_bytes(&empty, no_weights).unwrap().gaussians.is_empty());
    }

    #[test]
    fn columns_are_those_of_3dgs() {
        let table = PlyTable::from_bytes(&still().to_ply(None)).unwrap();
        let column = |name: &str| table.columns(&[name]).unwrap()[0];
        assert_eq!(table.row(1)[column("rot_0")], still().rotations[1][0]);
        assert_eq!(table.row(1)[column("scale_2")], still().log_scales[1][2]);
        // Gaussian 7, green, band 1 of [bands][channels].
        assert_eq!(table.row(1)[column("f_rest_4")], (7 * 9 + 3 + 1) as f32);
        assert_eq!(table.names.len(), 6 + 3 + 9 + 1 + 3 + 4);
    }

    #[test]
    fn bands_that_are_empty_are_not_kept() {
        let mut gaussians = still();
        (gaussians.sh_degree, gaussians.sh_rest) = (3, vec![0.0; 2 * 45]);
        gaussians.sh_rest[45 + 3] = 0.5;
        let read = from_bytes(&gaussians.to_ply(None), no_weights).unwrap().gaussians;
        assert_eq!((read.sh_degree, read.sh_rest.len()), (1, 2 * 9));
        assert_eq!(read.sh_rest[9 + 3], 0.5);
    }

    #[test]
    fn what_is_not_a_number_is_left_out_and_infinite_opacity_is_not() {
        let mut gaussians = still();
        gaussians.means[0][1] = f32::NAN;
        gaussians.opacity_logits[1] = f32::INFINITY;
        let scene = from_bytes(&gaussians.to_ply(None), no_weights).unwrap();
        assert_eq!(scene.gaussians.opacity_logits, [MAX_LOGIT]);
        assert_eq!(scene.provenance.settings["gaussians_left_out"], 1);
    }

    /// The file of [`still`] with columns of features of this name, as many as there are values.
    fn with_features(name: &str, values: &[f32]) -> Vec<u8> {
        let plain = PlyTable::from_bytes(&still().to_ply(None)).unwrap();
        let names = [plain.names.clone(), numbered(name, values.len())].concat();
        let rows = (0..plain.num_rows()).flat_map(|k| [plain.row(k), values].concat()).collect();
        PlyTable { names, comments: Vec::new(), values: rows }.to_bytes()
    }

    #[test]
    fn features_of_the_released_code_are_kept_and_those_of_langsplat_are_directions() {
        let read = |name: &str, values: &[f32]| from_bytes(&with_features(name, values), no_weights);
        let kept = read("lang", &[0.0, 3.0, 4.0]).unwrap().gaussians;
        assert_eq!((kept.latent_dim, &kept.features[3..]), (3, &[0.0, 3.0, 4.0][..]));
        let directions = read("language_feature", &[0.0, 3.0, 4.0]).unwrap().gaussians;
        assert_eq!((directions.latent_dim, &directions.features[3..]), (3, &[0.0, 0.6, 0.8][..]));
        let nothing = read("language_feature", &[0.0; 3]).unwrap().gaussians;
        assert_eq!(nothing.features, [0.0; 6]);
        assert!(read("lang", &[0.0, f32::NAN]).unwrap().gaussians.is_empty());
        assert!(read("language_feature", &[0.1; 17]).unwrap_err().contains("17"));
    }

    #[test]
    fn a_point_cloud_is_refused_in_words() {
        let cloud = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n";
        let message = from_bytes(cloud.as_bytes(), no_weights).unwrap_err();
        assert!(message.contains("`f_dc_0`"), "{message}");
    }
}
