"""Scatter of matched disparities over the Cramer-Rao bound: python benchmarks/expected_depth_error.py [--design D]

Planes of 1/f texture are drawn by the layered renderer with noise; the bound is that of ``chromaperture apertures`` for
the pixels of a window of `accurate`. "window" is that matcher's best layer without its neighbours' help; whole matchers
aggregate more and may fall below the bound.
"""

from __future__ import annotations

import argparse

import numpy as np

from chromaperture.color.unmixing import mixing_matrix, unmixing_rows
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.evidence.blur import SPACING_PX, BlurEvidence
from chromaperture.matching.execution import execution_named
from chromaperture.matching.labels import IDENTITY, parabola_winner
from chromaperture.matching.result import ESTIMATED_NOISE
from chromaperture.optics.aperture import DESIGNS, aperture_figures, film_unmixing, made_of
from chromaperture.optics.depth_error_bound import Texture, expected_accuracy
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil
from chromaperture.optics.pinhole import focused_at, pupil_camera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.simulator.layer_renderer import render_layers
from chromaperture.optics.simulator.sensor import SensorModel, develop, expose
from chromaperture.optics.simulator.textures import noise
from chromaperture.settings.methods import AccurateConfig, RealTimeConfig
from chromaperture.settings.stages import CrossFilterConfig
from chromaperture.system.robust import MAD_TO_SIGMA

SIZE, BORDER, PITCH_MM = 256, 40, 0.0309722
LAYERS = 8  # to each side of the plane
WIDE_RIM = 1.5  # pupil radii: nothing is vignetted


def thin_lens(camera, design):
    """Blur of the lens that the renderer has: A - B / z through its own blur radii."""
    near, far = 1000.0, 4000.0
    radius = camera.blur_radius_px(np.array([near, far]))
    inverse = 1 / (np.array([near, far]) - camera.sensor_to_pupil_mm)
    scale = (radius[1] - radius[0]) / (inverse[0] - inverse[1])
    model = BlurModel(radius[0] + scale * inverse[0], scale, front_rim_radius=WIDE_RIM, rear_rim_radius=WIDE_RIM)
    return LensBlur(model, sample_pupil(design), SIZE, SIZE)


def photograph(design, camera, distance_mm, sensor, seed):
    texture = noise((SIZE, SIZE), exponent=1.0, seed=seed)
    radius = abs(float(camera.blur_radius_px(distance_mm)))
    picture = render_layers(
        np.repeat(texture[..., None], 3, axis=2), np.full((SIZE, SIZE), distance_mm), camera=camera, aperture=design,
        pitch_px=radius if radius > 0.1 else 0.5,  # a layer exactly at the plane
    )  # fmt: skip
    return develop(expose(picture.image, sensor, seed=seed), sensor).astype(np.float32)


def found_radii(image, design, blur, true_px):
    """Blur radius at every pixel by each matcher; dict of (H, W)."""
    config = AccurateConfig.for_blur(blur.reach)
    step_px = config.layers.step_px
    middle = step_px * np.round(true_px * blur.reach / step_px)
    config = config.with_range(middle - LAYERS * step_px, middle + LAYERS * step_px)
    layers_px = config.layers.values_px
    widest_pair = BlurEvidence(
        CrossFilterConfig(fallback_weight=0.0), blur, IDENTITY, ESTIMATED_NOISE, execution_named("numba")
    )
    colours = np.array([design.filter_named(name).transmission for name in design.views])
    common = {"aperture": design, "unmixing": unmixing_rows(mixing_matrix(colours), len(design.views))}
    window = parabola_winner(widest_pair.likelihood(image, layers_px), layers_px).disparity_px
    accurate = estimate_disparity(image, **common, config=config, blur=blur, label_maps=[IDENTITY])
    quick = estimate_disparity(image, **common, config=RealTimeConfig())
    return {
        "window": np.repeat(np.repeat(window, SPACING_PX, axis=0), SPACING_PX, axis=1)[:SIZE, :SIZE] / blur.reach,
        "accurate": accurate.value_px / blur.reach,
        "real-time": quick.value_px / reach_of(design),
    }


def reach_of(design):
    """Half disparity of the unmixed views for a px of blur radius."""
    return aperture_figures(design, film_unmixing(design)).beta


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--design", default="cy_halves")
    parser.add_argument("--distances", type=float, nargs="+", default=[1200, 1500, 1800, 2000, 2300, 2800, 3500])
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    design = made_of(DESIGNS[args.design], "real")
    lens = focused_at(load_lens("double_gauss_50"), 2000.0)
    camera = pupil_camera(lens, width_px=SIZE, height_px=SIZE, pixel_pitch_mm=PITCH_MM)
    blur, sensor = thin_lens(camera, design), SensorModel()
    texture = Texture(patch_px=SIZE, window_px2=4 * np.pi * CrossFilterConfig().window_sigma_px ** 2)
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    for distance in args.distances:
        bound = expected_accuracy(design, camera, [distance], sensor=sensor, texture=texture)
        true, per_px = float(bound.blur_px[0]), float(bound.sigma_px[0]) / reach_of(design)
        errors = {}
        for seed in range(args.seeds):
            image = photograph(design, camera, distance, sensor, seed)
            for name, radius in found_radii(image, design, blur, true).items():
                errors.setdefault(name, []).append(radius[inner] - true)
        row = {"distance_mm": distance, "blur_radius_px": round(true, 2), "bound_px": round(per_px, 4)}
        for name, parts in errors.items():
            middles = [float(np.nanmedian(part)) for part in parts]
            pairs = zip(parts, middles, strict=True)
            scatter = float(np.mean([MAD_TO_SIGMA * np.nanmedian(np.abs(p - m)) for p, m in pairs]))
            row |= {f"{name}_bias_px": round(float(np.mean(middles)), 4), f"{name}_ratio": round(scatter / per_px, 2)}
        print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
