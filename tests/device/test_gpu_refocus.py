"""Refocusing in WGSL against the CPU's, on whatever device there is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.effects.refocusing import DeviceCompositor, Focus, compositor_of, refocus
from chromaperture.matching.device.device import DeviceError, open_device
from chromaperture.matching.device.refocus_stages import RefocusChain
from chromaperture.products.samples import open_sample
from chromaperture.system.errors import CaptureWarning, OutOfMemoryError
from devices import camera_on, device_of_its_own, needs_device

pytestmark = [pytest.mark.extra("gpu", "wgpu"), needs_device]

# Sums of at most 961 products of order 1 in 32 bits, over a coverage that is small only where a layer ends.
TOLERANCE = 2e-5


@cache
def chain_of(shape: tuple[int, int]) -> RefocusChain:
    return RefocusChain(open_device("gpu"), shape)


@pytest.fixture(scope="module")
def pupil(tmp_path_factory):
    """A picture without any symmetry."""
    path = tmp_path_factory.mktemp("pupil") / "pupil.png"
    shape = np.zeros((64, 64), np.uint8)
    shape[8:50, 10:20] = 255
    shape[8:16, 20:44] = 160
    assert cv2.imwrite(str(path), shape)
    return str(path)


@st.composite
def scenes(draw):
    """Noise, near discs before a wave."""
    shape = draw(st.sampled_from([(64, 81), (47, 90), (40, 40)]))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    y, x = np.mgrid[: shape[0], : shape[1]]
    radius = rng.uniform(0.1, 3) * np.sin(x / 20 + rng.uniform(0, 6)) + rng.uniform(-1, 1) * y / 40
    for _ in range(draw(st.integers(0, 3))):
        middle = rng.uniform((0, 0), shape)
        radius = np.where(np.hypot(y - middle[0], x - middle[1]) < rng.uniform(3, 15), rng.uniform(-6, 1), radius)
    return rng.uniform(0, 2, (*shape, 3)).astype(np.float32), radius.astype(np.float32)


@settings(max_examples=30, deadline=None)
@given(scenes(), st.floats(-2, 2), st.sampled_from([0.0, 0.3, 1.0, 2.0]), st.sampled_from(["disc", "hex", "picture"]))
def test_it_is_the_picture_of_the_cpu(pupil, scene, focus_px, strength, bokeh):
    color, radius = scene
    focus = Focus(focus_px, strength, pupil if bokeh == "picture" else bokeh)
    expected = refocus(color, radius, focus)
    found = refocus(color, radius, focus, compositor=chain_of(radius.shape).composite)
    np.testing.assert_allclose(found, expected, atol=TOLERANCE)


@cache
def sample_on(device: str) -> CodedApertureCamera:
    camera, _ = open_sample("still_life_cy_halves", quality="real-time", device="cpu")
    return camera_on(device, camera.calibration, camera.config)


def test_a_camera_refocuses_where_it_measures():
    assert compositor_of(sample_on("cpu")) is None
    compositor = compositor_of(sample_on("gpu"))
    color, radius = np.ones((40, 40, 3), np.float32), np.linspace(-3, 3, 1600, dtype=np.float32).reshape(40, 40)
    np.testing.assert_allclose(refocus(color, radius, Focus(0.0), compositor=compositor), 1, atol=1e-5)  # no texture
    assert compositor._chain.size == (40, 40)


def test_a_device_that_is_lost_or_too_small_is_an_error_or_the_cpu():
    rng = np.random.default_rng(2)
    color = rng.uniform(0, 1, (40, 50, 3)).astype(np.float32)
    radius = np.where(np.arange(50) > 20, 2.5, -2.5).astype(np.float32) * np.ones((40, 1), np.float32)
    expected = refocus(color, radius, Focus(1.0))
    behind = sample_on("gpu").method
    small = replace(behind.on_gpu, device=replace(open_device("gpu"), largest_bytes=16 * radius.size - 1))
    compositor = DeviceCompositor(replace(behind, on_gpu=small))
    np.testing.assert_array_equal(refocus(color, radius, Focus(1.0), compositor=compositor), expected)
    for may_fall_back in (False, True):
        device = device_of_its_own()
        lost = replace(behind, on_gpu=replace(behind.on_gpu, device=device), may_fall_back=may_fall_back)
        compositor = DeviceCompositor(lost)
        refocus(color, radius, Focus(1.0), compositor=compositor)
        device.handle.destroy()
        if not may_fall_back:
            with pytest.raises((DeviceError, OutOfMemoryError), match="use --device cpu"):
                refocus(color, radius, Focus(1.0), compositor=compositor)
            continue
        with pytest.warns(CaptureWarning, match="on the CPU from here on"):
            found = refocus(color, radius, Focus(1.0), compositor=compositor)
        np.testing.assert_array_equal(found, expected)
        assert lost.has_failed
