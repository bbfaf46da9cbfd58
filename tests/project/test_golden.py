"""Known distances: the shipped captures must not be measured worse than when their figures were kept.

``python tests/project/test_golden.py`` measures the figures anew and writes them, with their scatter over
fresh sensor noise.
"""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.products.samples import SAMPLES, sample_camera, sample_image

DATA = Path(__file__).parents[1] / "data"
KEPT = DATA / "golden.json"
QUALITIES = ("paper", "real-time")  # `accurate` takes a quarter of a minute a capture: benchmarks/bench50.py
FULL_WELL_ELECTRONS = 10_000  # of the noise added for the scatter; chosen by hand, a small sensor has as many
SEEDS = 8
ALLOWED = 4  # standard deviations: one false alarm in 30,000 figures


def figures(camera: CodedApertureCamera, image: np.ndarray) -> dict[str, float]:
    """Fractions of all pixels of known truth that are near it, and of those measured that are within their bars."""
    truth = cv2.imread(str(DATA / "still_life.depth_0.1mm.png"), cv2.IMREAD_UNCHANGED) / 10.0
    frame = camera.measure(image)
    error_mm = np.abs(frame.depth_mm - truth)[truth > 0]
    relative = np.nan_to_num(error_mm / truth[truth > 0], nan=np.inf)
    z = (error_mm / frame.sigma_mm[truth > 0])[np.isfinite(error_mm)]
    near = {f"within_{p}_percent": float((relative < p / 100).mean()) for p in (2, 5, 10)}
    return {**near, "within_1_sigma": float((z < 1).mean()), "within_2_sigma": float((z < 2).mean())}


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("sample", SAMPLES)
def test_known_distances_are_measured_as_well_as_ever(sample, quality):
    camera = load_camera(sample_camera(sample), quality=quality)
    found = figures(camera, camera.read(sample_image(sample)))
    for name, (kept, scatter) in json.loads(KEPT.read_text())[sample][quality].items():
        worse = abs(found[name] - kept) if name.endswith("sigma") else kept - found[name]
        assert worse <= ALLOWED * scatter, f"{name}: {found[name]:.4f}, kept {kept:.4f}, scatter {scatter:.4f}"


def main() -> None:
    table: dict[str, dict[str, dict[str, tuple[float, float]]]] = {}
    for sample in SAMPLES:
        for quality in QUALITIES:
            camera = load_camera(sample_camera(sample), quality=quality)
            image = camera.read(sample_image(sample))
            noise = np.sqrt(np.maximum(image, 0) / FULL_WELL_ELECTRONS)
            noisy = []
            for seed in range(SEEDS):
                added = noise * np.random.default_rng(seed).normal(size=image.shape)
                noisy.append(figures(camera, (image + added).astype(np.float32)))
            table.setdefault(sample, {})[quality] = {
                name: (round(value, 4), round(float(np.std([f[name] for f in noisy], ddof=1)), 4))
                for name, value in figures(camera, image).items()
            }
    KEPT.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
