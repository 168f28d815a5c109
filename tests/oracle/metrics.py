"""Measures of pictures, masks and depth without a pattern, by scikit-image and scikit-learn.

Prints metrics.json, which the test of crates/core/src/metrics/oracle_tests.rs compares with. The test makes
the same inputs.
"""

import json
import sys
from importlib.metadata import version

import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from sklearn.metrics import (
    confusion_matrix,
    f1_score,
    jaccard_score,
    mean_absolute_percentage_error,
    precision_score,
    recall_score,
    root_mean_squared_error,
)


def bytes_without_pattern(count, seed):
    x = (np.arange(count, dtype=np.uint64) + seed * 1000003) * 2654435761 & 0xFFFFFFFF
    x ^= x >> 15
    x = x * 2246822519 & 0xFFFFFFFF
    x ^= x >> 13
    return (x & 0xFF).astype(np.uint8)


def case(width, height, seed):
    pixels = width * height
    truth = bytes_without_pattern(3 * pixels, seed).reshape(height, width, 3)
    noise = bytes_without_pattern(3 * pixels, seed + 1).reshape(height, width, 3)
    image = ((3 * truth.astype(int) + noise) // 4).astype(np.uint8)
    labelled = bytes_without_pattern(pixels, seed + 2) < 100
    predicted = labelled ^ (bytes_without_pattern(pixels, seed + 3) < 40)
    # Depths of 1 to 18, and other depths near them.
    depth = 1 + bytes_without_pattern(pixels, seed + 4).astype(np.float32) / 15
    other = depth * (0.75 + bytes_without_pattern(pixels, seed + 5).astype(np.float32) / 512)
    classes = bytes_without_pattern(pixels, seed + 6) % 3
    guesses = np.where(bytes_without_pattern(pixels, seed + 7) < 180, classes, (classes + 1) % 3)
    return {
        "width": width,
        "height": height,
        "seed": seed,
        "psnr_db": peak_signal_noise_ratio(truth, image, data_range=255),
        "psnr_per_channel_db": np.mean(
            [peak_signal_noise_ratio(truth[..., c], image[..., c], data_range=255) for c in range(3)]
        ),
        "ssim_inside": structural_similarity(
            truth / 255,
            image / 255,
            data_range=1,
            channel_axis=2,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        ),
        "iou": jaccard_score(labelled, predicted),
        "dice": f1_score(labelled, predicted),
        "precision": precision_score(labelled, predicted),
        "recall": recall_score(labelled, predicted),
        "depth_rmse": float(root_mean_squared_error(depth.astype(float), other.astype(float))),
        "depth_abs_rel": float(mean_absolute_percentage_error(depth.astype(float), other.astype(float))),
        "confusion": confusion_matrix(classes, guesses, labels=[0, 1, 2]).tolist(),
    }


if __name__ == "__main__":
    names = ["numpy", "scikit-image", "scikit-learn"]
    cases = [case(*size, seed) for seed, size in enumerate([(64, 48), (37, 53), (11, 11), (160, 90)], start=5)]
    json.dump({"made_with": {n: version(n) for n in names}, "cases": cases}, sys.stdout, indent=1)
    print()
