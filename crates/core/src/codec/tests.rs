//! Tests of the codec on made and, if present, real embeddings.

use super::*;
use crate::progress::unobserved;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

const QUICK: CodecSettings = CodecSettings { kind: CodecKind::Network, latent_dim: 3, steps: 300, seed: 0 };

#[test]
fn a_codebook_keeps_rows_exactly_and_never_blends_two_into_a_third() {
    let rows = alike_rows(12, 64, 0.85, 5);
    let settings = CodecSettings { kind: CodecKind::Codebook, ..QUICK };
    let codec = Codec::train(rows.view(), &[1.0; 12], &settings, &mut unobserved).unwrap();
    codec.validate().unwrap();
    let latents = codec.encode(rows.view());
    assert_eq!(codec.latent_dim(), 12);
    let decoded = codec.decode(latents.view());
    for (k, row) in rows.outer_iter().enumerate() {
        assert!(latents[[k, k]] > 0.999 && decoded.row(k).dot(&row) > 0.9999, "{k}");
    }
    for (a, b) in [(0, 1), (3, 7), (10, 11)] {
        for share in [0.1, 0.3, 0.45, 0.55, 0.9_f32] {
            let blend = (&latents.row(a) * share + &latents.row(b) * (1.0 - share)).insert_axis(Axis(0));
            let cosines = rows.dot(&codec.decode(blend.view()).row(0));
            let nearest = (0..12).max_by(|&i, &j| cosines[i].total_cmp(&cosines[j])).unwrap();
            assert_eq!(nearest, if share > 0.5 { a } else { b });
        }
    }
    let many = alike_rows(17, 64, 0.5, 6);
    let refused = Codec::train(many.view(), &[1.0; 17], &settings, &mut unobserved).unwrap_err();
    assert!(refused.to_string().contains("17"));
    // Rows that are alike, or the same, are one entry.
    let same = rows.select(Axis(0), &[0, 0, 1]);
    let codec = Codec::train(same.view(), &[1.0; 3], &settings, &mut unobserved).unwrap();
    assert_eq!(codec.latent_dim(), 2);
}

/// `n` unit rows with a shared part, so that their cosines are near `cosine`.
fn alike_rows(n: usize, dim: usize, cosine: f32, seed: u64) -> Array2<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let unit =
        |rng: &mut ChaCha8Rng, n| normalise_rows(Array2::from_shape_simple_fn((n, dim), || mlp::normal(rng)));
    let shared = unit(&mut rng, 1);
    normalise_rows(unit(&mut rng, n) * (1.0 - cosine).sqrt() + shared * cosine.sqrt())
}

/// Decodes noisy latents of each row. Returns the share that decodes nearest to its row, and the smallest
/// margin.
fn snapping(codec: &Codec, rows: &Array2<f32>, noise: f32, copies: usize) -> (f64, f32) {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let latents = codec.encode(rows.view());
    let (mut right, mut smallest) = (0, f32::INFINITY);
    for (k, latent) in latents.outer_iter().enumerate() {
        let noisy = Array2::from_shape_fn((copies, codec.latent_dim()), |(_, c)| {
            latent[c] + noise * mlp::normal(&mut rng)
        });
        let lengths = Array2::from_shape_simple_fn((copies, 1), || rng.random_range(0.7..1.2));
        for cosines in codec.decode((noisy * lengths).view()).dot(&rows.t()).outer_iter() {
            let other = (0..rows.nrows()).filter(|&j| j != k).map(|j| cosines[j]).fold(-1.0, f32::max);
            right += usize::from(cosines[k] > other);
            smallest = smallest.min(cosines[k] - other);
        }
    }
    (right as f64 / (copies * rows.nrows()) as f64, smallest)
}

#[test]
fn few_rows_snap_to_their_class_under_noise_and_length() {
    let rows = alike_rows(9, 96, 0.88, 1);
    let codec = Codec::train(rows.view(), &[1.0; 9], &QUICK, &mut unobserved).unwrap();
    codec.validate().unwrap();
    let (right, _) = snapping(&codec, &rows, 0.1, 200);
    assert!(right > 0.995, "{right}");
    let exact = codec.decode(codec.encode(rows.view()).view());
    let cosines = (&exact * &rows).sum_axis(Axis(1));
    assert!(cosines.iter().all(|&c| c > 0.995), "{cosines}");
}

#[test]
fn a_blend_of_two_classes_decodes_to_the_larger_share() {
    let rows = alike_rows(6, 64, 0.8, 2);
    let codec = Codec::train(rows.view(), &[1.0; 6], &QUICK, &mut unobserved).unwrap();
    let latents = codec.encode(rows.view());
    for (a, b) in (0..6).flat_map(|a| (0..6).map(move |b| (a, b))).filter(|(a, b)| a != b) {
        let blend = &latents.row(a) * 0.8 + &latents.row(b) * 0.2;
        let cosines = codec.decode(blend.insert_axis(Axis(0)).view()).dot(&rows.t());
        let best = (0..6).max_by(|&i, &j| cosines[[0, i]].total_cmp(&cosines[[0, j]])).unwrap();
        assert_eq!(best, a, "blend of {a} and {b}: {cosines}");
    }
}

#[test]
fn many_rows_are_reconstructed_better_than_by_their_mean() {
    let rows = alike_rows(80, 48, 0.5, 3);
    let codec = Codec::train(rows.view(), &[1.0; 80], &QUICK, &mut unobserved).unwrap();
    let decoded = codec.decode(codec.encode(rows.view()).view());
    let mean_cosine = |a: &Array2<f32>| (a * &rows).sum() / 80.0;
    let mean = normalise_rows(rows.mean_axis(Axis(0)).unwrap().insert_axis(Axis(0)));
    let baseline = mean_cosine(&mean.broadcast(rows.dim()).unwrap().to_owned());
    assert!(mean_cosine(&decoded) > baseline + 0.05, "{} {baseline}", mean_cosine(&decoded));
}

#[test]
fn training_is_deterministic_in_one_thread_and_in_many() {
    let rows = alike_rows(5, 32, 0.7, 4);
    let settings = CodecSettings { steps: 20, ..QUICK };
    let train = || Codec::train(rows.view(), &[1.0; 5], &settings, &mut unobserved).unwrap();
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    assert_eq!(pool(1).install(train), pool(3).install(train));
    let many = alike_rows(70, 32, 0.7, 4);
    let train = || Codec::train(many.view(), &[1.0; 70], &settings, &mut unobserved).unwrap();
    assert_eq!(pool(1).install(train), pool(3).install(train));
}

#[test]
fn one_row_repeated_rows_and_other_latent_sizes_work() {
    for (rows, latent_dim) in [(1, 3), (3, 1), (7, 2), (9, 16)] {
        let mut table = alike_rows(rows, 24, 0.6, 5);
        let again = table.row(0).to_owned();
        table.push_row(again.view()).unwrap();
        let settings = CodecSettings { kind: CodecKind::Network, latent_dim, steps: 40, seed: 1 };
        let codec = Codec::train(table.view(), &vec![1.0; rows + 1], &settings, &mut unobserved).unwrap();
        let latents = codec.encode(table.view());
        assert_eq!(latents.dim(), (rows + 1, latent_dim));
        assert_eq!(latents.row(0), latents.row(rows));
        assert!(latents.outer_iter().all(|r| (r.dot(&r) - 1.0).abs() < 1e-4));
        assert_eq!(codec.decode(latents.view()).dim(), (rows + 1, 24));
    }
}

#[test]
fn bad_training_input_is_named() {
    let rows = alike_rows(3, 8, 0.5, 6);
    let train = |rows: &Array2<f32>, weights: &[f32], settings: &CodecSettings| {
        Codec::train(rows.view(), weights, settings, &mut unobserved).unwrap_err().to_string()
    };
    assert!(train(&rows, &[1.0; 2], &QUICK).contains("2 weights"));
    assert!(train(&Array2::zeros((0, 8)), &[], &QUICK).contains("0 rows"));
    assert!(train(&rows, &[1.0; 3], &CodecSettings { latent_dim: 17, ..QUICK }).contains("17"));
    assert!(train(&rows, &[1.0, f32::NAN, 1.0], &QUICK).contains("row 1"));
    let mut bad = rows.clone();
    bad[[2, 4]] = f32::NAN;
    assert!(train(&bad, &[1.0; 3], &QUICK).contains("row 2"));
    bad.row_mut(2).fill(0.0);
    assert!(train(&bad, &[1.0; 3], &QUICK).contains("row 2"));
}

#[test]
fn tensors_come_back_and_broken_ones_are_refused() {
    let rows = alike_rows(3, 8, 0.5, 7);
    let codec =
        Codec::train(rows.view(), &[1.0; 3], &CodecSettings { steps: 2, ..QUICK }, &mut unobserved).unwrap();
    let tensors: Vec<_> = codec.tensors().into_iter().map(|(n, t)| (n, t.to_owned())).collect();
    let get =
        |skip: &str, name: &str| tensors.iter().find(|(n, _)| n == name && n != skip).map(|(_, t)| t.clone());
    assert_eq!(Codec::from_tensors(|name| get("", name)).unwrap(), codec);
    for missing in ["decoder.6.weight", "decoder.0.weight", "encoder.2.bias", "encoder.4.weight"] {
        assert!(Codec::from_tensors(|name| get(missing, name)).is_err(), "{missing}");
    }
    let mut poisoned = codec.clone();
    poisoned.decoder[3].bias[5] = f32::INFINITY;
    assert!(poisoned.validate().unwrap_err().to_string().contains("layer 3 of its decoder"));
}

#[test]
fn latents_that_are_not_finite_decode_to_zeros() {
    let rows = alike_rows(3, 8, 0.5, 8);
    let codec =
        Codec::train(rows.view(), &[1.0; 3], &CodecSettings { steps: 2, ..QUICK }, &mut unobserved).unwrap();
    let decoded = codec.decode(ndarray::arr2(&[[f32::NAN, 0.0, 0.0], [f32::INFINITY, 1.0, 0.0]]).view());
    assert!(decoded.iter().all(|&v| v == 0.0));
}

/// CLIP table of 1203 names, if the research data is present.
fn clip_table() -> Option<(Array2<f32>, Vec<String>)> {
    let folder =
        std::env::var_os("SURGTPGS_DATA").map(|root| Path::new(&root).join("models/clip_text_tables"));
    let table =
        folder.as_ref().and_then(|folder| std::fs::read(folder.join("lvis_v1_clip_a+cname.npy")).ok());
    let (Some(folder), Some(bytes)) = (folder, table) else {
        eprintln!("the CLIP table is absent (set SURGTPGS_DATA); nothing was tested");
        return None;
    };
    let values = bytes[bytes.len() - 1203 * 512 * 2..].chunks_exact(2);
    let values = values.map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32()).collect();
    let names = std::fs::read_to_string(folder.join("lvis_v1_names.json")).unwrap();
    let table = Array2::from_shape_vec((1203, 512), values).unwrap();
    Some((normalise_rows(table), serde_json::from_str(&names).unwrap()))
}

#[test]
fn real_class_names_snap_although_their_cosines_are_high() {
    let Some((table, names)) = clip_table() else { return };
    let picked = [
        "knife",
        "fork",
        "spoon",
        "scissors",
        "pliers",
        "towel",
        "sponge",
        "handle",
        "rubber_band",
        "thread",
        "glove",
        "pipe",
        "heart",
    ];
    let rows: Vec<usize> = picked.iter().filter_map(|p| names.iter().position(|n| n == p)).collect();
    let rows = table.select(Axis(0), &rows);
    assert!(rows.nrows() >= 10, "{} names found", rows.nrows());
    let weights = vec![1.0; rows.nrows()];
    let codec = Codec::train(rows.view(), &weights, &CodecSettings::default(), &mut unobserved).unwrap();
    let (right, margin) = snapping(&codec, &rows, 0.1, 500);
    let (right_little, margin_little) = snapping(&codec, &rows, 0.05, 500);
    let gram = rows.dot(&rows.t());
    eprintln!(
        "{} classes; σ 0.1: {right:.4} right, smallest margin {margin:.3}; \
        σ 0.05: {right_little:.4}, {margin_little:.3}",
        rows.nrows()
    );
    for k in 0..rows.nrows() {
        let nearest = (0..rows.nrows()).filter(|&j| j != k).map(|j| gram[[k, j]]).fold(-1.0, f32::max);
        eprintln!("row {k}: nearest cosine {nearest:.3}");
    }
    assert!(right > 0.99 && right_little > 0.999);
}
