"""Whole methods in every execution: compiled and on a device, against the readable one."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from chromaperture.matching.device.gpu_method import on_device
from chromaperture.matching.estimate import estimate_disparity, method_for
from chromaperture.matching.integer_light import in_whole_units
from chromaperture.matching.labels import IDENTITY, LabelMap, labels_between
from chromaperture.matching.readable.correlation import SCORE_PARTS
from chromaperture.matching.readable.four_paths import log_likelihood, scores_at_labels, summed_costs
from chromaperture.matching.real_time import RealTimeMethod
from chromaperture.matching.result import NoiseModel
from chromaperture.matching.views import Views, filtered_views, halved_views
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.settings.methods import AccurateConfig, PaperConfig, RealTimeConfig, preset
from chromaperture.settings.stages import FourPathsConfig, LayersConfig
from chromaperture.system.errors import InputError
from chromaperture.system.threads import limited_threads
from devices import needs_device
from executions import COMPILED, READABLE
from worlds import ALL_DESIGNS, hostile_images, lens_blur, space_of, wavy_capture

REAL_TIME = RealTimeConfig().with_range(-4.0, 4.0)
DISPARITY_TOLERANCE_PX = 0.02  # of a vertex between layers half a px apart
# Two layers whose costs differ by rounding may change places: log-likelihoods are kept to 1/5000 nat, path costs to
# 1/700, and the place between the layers by their ratio to a bend of some hundredths of a nat in weak texture.
OTHER_WINNERS = 0.01
TIE_NATS = 0.05  # four path costs to 1/700 nat, and scores to 1/32000, at a correlation of 0.99 worth 0.002 nats


def likelihoods(views, layers_px, labels_px, label_map, config):
    score = READABLE.correlate(views, layers_px, config=config.correlation)
    score = scores_at_labels(score, layers_px, labels_px, label_map)
    cell_px = config.correlation.cell_px
    return log_likelihood(score, view_count=views.pictures.shape[2]) * views.mask[::cell_px, ::cell_px, None]


def assert_path_winners_agree(views, layers_px, label_map, config):
    cell_px = config.correlation.cell_px
    labels_px, label_map = labels_between(layers_px, views.directions, most_px=0.25), label_map.of_cells(cell_px)
    settings_ = {"correlation": config.correlation, "paths": config.paths, "labels_px": labels_px}
    found, expected = (run.four_path_winner(views, layers_px, label_map, **settings_) for run in (COMPILED, READABLE))
    guide = views.guide[::cell_px, ::cell_px]
    cost = summed_costs(-likelihoods(views, layers_px, labels_px, label_map, config), guide, config.paths)
    chosen = np.take_along_axis(cost, found.layer.astype(int)[..., None], axis=2)[..., 0]
    size = chosen.size
    assert (chosen - cost.min(axis=2) > TIE_NATS).sum() <= 2 + OTHER_WINNERS * size
    same = found.layer == expected.layer
    for name in ("before", "at", "after"):
        fast, slow = getattr(found, name), getattr(expected, name)
        # Explained fractions: near 0 the log-likelihood's own rounding, 2e-4, is large for its root, the correlation.
        apart = np.abs(np.exp(-2 * fast) - np.exp(-2 * slow))
        assert np.sum((apart > 1e-3) & same) <= 2 + OTHER_WINNERS * size  # five times that rounding
    # Rounding of four path costs, 1/700 nat each, over a temperature of 1.5 nats, of a few px.
    assert np.sum((np.abs(found.sigma_px - expected.sigma_px) > 0.05) & same) <= 2 + OTHER_WINNERS * size
    assert all(maps.shape == guide.shape for maps in found)


def assert_real_time_agrees(image, design, config=REAL_TIME, label_map=IDENTITY):
    views, _ = halved_views(image, space_of(design), config=config.views)
    assert_path_winners_agree(views, config.layers.values_px / 2, label_map.halved(), config)
    fast, slow = (RealTimeMethod(config, space_of(design), label_map, run).match(image) for run in (COMPILED, READABLE))
    assert fast.value_px.shape == slow.value_px.shape == image.shape[:2]
    apart = np.abs(fast.value_px - slow.value_px)
    same = (apart < DISPARITY_TOLERANCE_PX) | (np.isnan(fast.value_px) & np.isnan(slow.value_px))
    # Without noise, labels between two layers reach the correlation 1 together: ties, which the rounding of scores to
    # 1 / 32000 decides. It is the scatter of the posterior that changes with them most. One tie moves the 4 x 4 px of
    # its cell and those between it and its neighbours.
    assert np.sum(~same) <= 36 + 3 * OTHER_WINNERS * same.size
    assert np.mean(np.abs(fast.sigma_px - slow.sigma_px)[same] > 0.05) <= 10 * OTHER_WINNERS


@pytest.mark.parametrize("shape", [(41, 57), (3, 5), (97, 20), (120, 8)])  # odd, small, and more than one band
@pytest.mark.parametrize("design", ["cy_halves", "cmy_circles"])
def test_cells_have_the_same_scores(rng, shape, design):
    directions = space_of(design).directions
    common = rng.normal(size=shape)
    pictures = np.stack([common + 0.5 * rng.normal(size=shape) for _ in directions], axis=-1).astype(np.float32)
    pictures[:, shape[1] // 2 :, -1] *= -1  # of two hues: cells of another sign
    even = np.ones(shape, np.float32)
    unit = 2.0**-11  # of pictures of 0.1
    views = Views(in_whole_units(0.1 * pictures, unit), directions, 0 * even, even, unit=unit)
    layers_px, config = 0.25 * np.arange(-5, 6), replace(REAL_TIME.correlation, sampling="b-spline")
    fast, slow = (np.rint(SCORE_PARTS * run.correlate(views, layers_px, config=config)) for run in (COMPILED, READABLE))
    # Sums are whole numbers and exact; only the last steps of three views depend on how they are fused.
    assert (fast != slow).mean() <= (0 if design == "cy_halves" else 1e-3)
    assert np.abs(fast - slow).max() <= 1


SIZES = [(8, 8), (8, 65), (33, 9), (50, 64), (47, 101)]
PATHS = [{"jump_penalty": 3.0}, {"edge_floor": 1.0}, {"row_share": 0.0}, {"row_share": 1.0}, {"temperature": 0.5}]


@pytest.mark.parametrize(
    ("design", "shape", "paths", "labelled"),
    [
        *((design, (61, 83), {}, False) for design in ALL_DESIGNS),
        *(("cy_halves", shape, {}, False) for shape in SIZES),
        *(("cy_halves", (61, 83), change, False) for change in PATHS),
        ("cy_halves", (61, 83), {}, True),
    ],
    ids=str,
)
def test_real_time_agrees(design, shape, paths, labelled):
    image = wavy_capture(design, shape=shape, saturated=shape not in SIZES)
    if shape in SIZES:  # too small for its even area
        image += np.random.default_rng(1).normal(0, 0.02, shape).astype(np.float32)[..., None]
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    labels = LabelMap(0.02 * (x - 40) + 0.01 * y, 0.8 + 0.003 * x) if labelled else IDENTITY
    assert_real_time_agrees(image, design, replace(REAL_TIME, paths=FourPathsConfig(**paths)), labels)


@settings(max_examples=30, deadline=None)
@given(hostile_images(), st.sampled_from(["cy_halves", "cmy_circles"]), st.booleans())
def test_hostile_pictures_have_the_same_path_winners(image, design, labelled):
    try:
        views = filtered_views(image, space_of(design), config=REAL_TIME.views)
        halved_views(image, space_of(design), config=REAL_TIME.views)
    except InputError:
        assume(False)  # nothing to match
    shape = views.mask.shape
    labels = LabelMap(np.full(shape, 0.1, np.float32), np.full(shape, 0.9, np.float32)) if labelled else IDENTITY
    assert_path_winners_agree(views, np.arange(-2.0, 2.1, 0.5), labels, REAL_TIME)
    found = RealTimeMethod(REAL_TIME, space_of(design), labels, COMPILED).match(image)
    known = np.isfinite(found.value_px)
    assert found.value_px.shape == shape
    assert (found.sigma_px[known] >= REAL_TIME.floor_px * 0.999).all()  # float32
    assert (found.confidence[~known] == 0).all()


# ---- whole measurements


@pytest.mark.parametrize("quality", ["paper", "real-time", "accurate"])
def test_the_number_of_threads_changes_no_bit(quality):
    # High enough for more than one run of bands; another number of threads once began other rows with another halo.
    config = preset(quality).with_range(-3.0, 3.0)
    image = wavy_capture("cmy_squares", shape=(1100 if quality == "real-time" else 521, 40))  # two and a half runs
    found = []
    for threads in (1, 2, 5):
        with limited_threads(threads):
            found.append(estimate_disparity(image, aperture="cmy_squares", config=config))
    for other in found[1:]:
        for name in ("value_px", "sigma_px", "confidence"):
            np.testing.assert_array_equal(getattr(other, name), getattr(found[0], name))


SHAPE = (40, 56)


NUMPY_METHODS = {
    "paper": PaperConfig(layers=LayersConfig(-3.0, 3.0)),
    "real-time": RealTimeConfig(layers=LayersConfig(-3.0, 3.0)),
    "accurate": AccurateConfig(layers=LayersConfig(-2.0, 2.0)),
}


def measured(name, design, execution):
    image = wavy_capture(design, shape=(80, 96), saturated=False)[: SHAPE[0], : SHAPE[1]]
    image[5:9, 20:26] = 1.0
    config, more = NUMPY_METHODS.get(name), {"label_maps": [IDENTITY, IDENTITY]}
    if config is None:
        blur = lens_blur(BlurModel(6.0, 12000.0), SHAPE[1], SHAPE[0], design)
        noise = NoiseModel(lambda image: np.full_like(image, 0.006**2), is_known=True)
        more |= {"blur": blur, "noise": noise}
        config = AccurateConfig.for_blur(blur.reach).with_range(-3 * blur.reach, 3 * blur.reach)
    # Shaders against NumPy: Numba keeps scores in 16 bits, and planes are chosen otherwise by that much.
    of_cpu = "numpy" if execution == "shaders" else execution
    method = method_for(config, aperture=design, execution=of_cpu, **more)
    return (on_device(method, "gpu", print) if execution == "shaders" else method).match(image)


@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares"])
@pytest.mark.parametrize(
    ("name", "execution"),
    [
        *((name, "numba") for name in (*NUMPY_METHODS, "accurate with blur")),
        # That with the blur takes minutes on a device in software: test_gpu_accurate.py has it for two samples.
        *(
            pytest.param(name, "shaders", marks=[pytest.mark.extra("gpu", "wgpu"), needs_device])
            for name in NUMPY_METHODS
        ),
    ],
)
def test_whole_measurements_agree(name, design, execution):
    fast, slow = (measured(name, design, each) for each in (execution, "numpy"))
    known = np.isfinite(slow.value_px)
    assert known.mean() > 0.5  # else the comparison below means little
    # 0.002 px is found, of scores kept to 1 / 32000; a layer that differs shows as 0.5 px or NaN.
    apart = np.abs(fast.value_px - slow.value_px)
    other = (apart > 0.005) | (np.isfinite(fast.value_px) != known)
    assert other.mean() <= OTHER_WINNERS
    same = known & ~other
    # Of the same rounding: error bars divide by what a correlation lacks to 1, by a curvature or by a sum of costs.
    assert np.quantile(np.abs(fast.sigma_px / slow.sigma_px - 1)[same], 0.98) < 2e-3
    assert np.quantile(np.abs(fast.confidence - slow.confidence)[same], 0.98) < 2e-3


WITHOUT_NUMBA = """
import sys, types
from pathlib import Path
sys.modules["numba"] = None  # importing it raises ImportError
package = types.ModuleType("chromaperture")  # without __init__.py, whose camera converts depth by compiled code
package.__path__ = [{package!r}]
sys.modules["chromaperture"] = package

import numpy as np
from chromaperture.settings.methods import AccurateConfig, PaperConfig, RealTimeConfig, preset
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.labels import IDENTITY
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil

image = np.random.default_rng(0).uniform(0, 0.9, (12, 16, 3)).astype(np.float32)
blur = LensBlur(BlurModel(6.0, 12000.0), sample_pupil(DESIGNS["cy_halves"]), 16, 12)
with_blur = AccurateConfig.for_blur(blur.reach).with_range(-blur.reach, blur.reach)
for config in (PaperConfig(), RealTimeConfig(), AccurateConfig(), with_blur):
    found = estimate_disparity(image, aperture="cy_halves", config=config.with_range(-1.0, 1.0), execution="numpy",
                               blur=blur, label_maps=[IDENTITY])
    assert found.value_px.shape == (12, 16)
assert not [name for name in sys.modules if name.startswith(("numba.", "llvmlite"))]
print("measured")
"""


def test_the_readable_execution_needs_no_compiled_code():
    package = str(__import__("chromaperture").__path__[0])
    script = WITHOUT_NUMBA.format(package=package)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "measured", done.stderr
