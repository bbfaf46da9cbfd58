"""Depth error promised by ``chromaperture apertures`` against that of the matcher on simulated planes.

python benchmarks/expected_depth_error.py [--backend numba] [--json]
"""

import argparse
import json

import numpy as np

from chromaperture.color.noise import photon_noise_variance
from chromaperture.color.unmixing import mixing_matrix, unmixing_rows
from chromaperture.config import MatcherConfig
from chromaperture.disparity.estimate import estimate_disparity
from chromaperture.optics.accuracy import Texture, expected_accuracy
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.layers import render_layers
from chromaperture.optics.paraxial import focused_at
from chromaperture.optics.pinhole import pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.sensor import Sensor, develop, expose
from chromaperture.optics.textures import noise

SIZE = 256


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", default="reference")
    parser.add_argument("--design", default="cy_halves")
    parser.add_argument(
        "--distances", type=float, nargs="+", default=[1200, 1500, 1800, 2000, 2300, 2800, 3500]
    )
    parser.add_argument(
        "--regularised", action="store_true", help="keep the bilateral filter over the cost volume"
    )
    parser.add_argument(
        "--unknown-noise", action="store_true", help="let the matcher estimate the noise itself"
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    design = made_of(DESIGNS[args.design], "real")
    lens = focused_at(load_lens("double_gauss_50"), 2000.0)
    camera = pupil_camera(lens, width_px=SIZE, height_px=SIZE, pixel_pitch_mm=0.0309722)
    colours = np.array([design.filter_named(name).transmission for name in design.views])
    rows = unmixing_rows(mixing_matrix(colours), len(design.views))
    config = MatcherConfig(step_px=0.25, bilateral_sigma_px=14.0 if args.regularised else 0.0)
    sensor, report = Sensor(), []
    for number, distance in enumerate(args.distances):
        expected = expected_accuracy(
            design, camera, [distance], sensor=sensor, texture=Texture(patch_px=SIZE)
        )
        grey = noise((SIZE, SIZE), exponent=1.0, seed=number)
        sharp = np.repeat(grey[..., None], 3, axis=2)
        radius = abs(float(camera.blur_radius_px(distance)))
        pitch = radius if radius > 0.1 else 0.5  # a layer exactly at the plane
        picture = render_layers(
            sharp, np.full((SIZE, SIZE), distance), camera=camera, aperture=design, pitch_px=pitch
        )
        image = develop(expose(picture.image, sensor, seed=number), sensor)
        known = photon_noise_variance(
            image,
            full_well_electrons=sensor.full_well_electrons,
            read_noise_electrons=sensor.read_noise_electrons,
        )
        found = estimate_disparity(
            image,
            aperture=design,
            unmixing=rows,
            config=config,
            noise_variance=None if args.unknown_noise else known,
            backend=args.backend,
        )
        inner = found.value_px[40:-40, 40:-40]
        error = inner - expected.disparity_px[0]
        spread = 1.4826 * np.nanmedian(np.abs(error - np.nanmedian(error)))
        report.append(
            {
                "distance_mm": distance,
                "blur_radius_px": round(float(expected.blur_px[0]), 2),
                "disparity_px": round(float(expected.disparity_px[0]), 3),
                "bias_px": round(float(np.nanmedian(error)), 4),
                "expected_sigma_px": round(float(expected.sigma_px[0]), 4),
                "measured_sigma_px": round(float(spread), 4),
                "expected_sigma_mm": round(float(expected.sigma_mm[0]), 2),
                "measured_sigma_mm": round(float(spread / expected.disparity_per_mm[0]), 2),
                "ratio": round(float(spread / expected.sigma_px[0]), 2),
            }
        )
    if args.json:
        print(json.dumps(report))
        return
    for row in report:
        print("  ".join(f"{key} {value}" for key, value in row.items()))


if __name__ == "__main__":
    main()
