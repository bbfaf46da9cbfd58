"""Quality "accurate" as a whole on a GPU: the same depth as on the CPU."""


import numpy as np
import pytest

from chromaperture.matching.device.accurate_chain import AccurateOnDevice
from chromaperture.matching.estimate import method_for
from chromaperture.matching.labels import IDENTITY
from chromaperture.settings.methods import AccurateConfig
from chromaperture.system.errors import InputError
from devices import any_device, camera_on, small_sample
from worlds import wavy_capture

pytestmark = pytest.mark.extra("gpu", "wgpu")


def share_within(camera, found, expected, *, relative):
    """Share of the pixels whose depths differ by less, and that are known in both or in neither."""
    a, b = (camera.millimetres(disparity)[0] for disparity in (found, expected))
    known = np.isfinite(b)
    return (np.where(known, np.abs(a - b) <= relative * np.abs(b), np.isnan(a))).mean()


@pytest.mark.parametrize("name", ["still_life_cy_halves", "still_life_cy_open"])
def test_the_depth_is_that_of_the_cpu(name):
    camera, image = small_sample(name, 120, 80, quality="accurate")
    image = image.copy()
    if name.endswith("halves"):
        image[10:16, 20:26] = 1.0  # clipped: filled from around, and no evidence
        image[40:43, 70:74] = np.nan
    on_gpu = AccurateOnDevice(camera.method, any_device())
    expected, found = camera.method.match(image), on_gpu.match(image)
    assert on_gpu._chain.windows is not None
    assert np.isfinite(expected.value_px).mean() > 0.9
    assert share_within(camera, found, expected, relative=1e-3) > 0.995
    np.testing.assert_array_equal(np.isfinite(found.sigma_px), np.isfinite(found.value_px))
    known = np.isfinite(expected.sigma_px) & np.isfinite(found.sigma_px)
    assert (np.abs(found.sigma_px / expected.sigma_px - 1) < 0.01)[known].mean() > 0.99
    assert np.quantile(np.abs(found.confidence - expected.confidence), 0.99) < 0.01
    # Nothing is left of the last photograph, nor of one that is sent up before this comes down.
    begun = [on_gpu.start(picture) for picture in (image, np.ascontiguousarray(image[::-1]))]
    again, other = (each.result().disparity.value_px for each in begun)
    np.testing.assert_array_equal(again, found.value_px)
    assert not np.array_equal(again, other, equal_nan=True)


def test_a_picture_of_another_size_is_refused():
    camera, image = small_sample("still_life_cy_halves", 60, 40, quality="accurate")
    with pytest.raises(InputError, match="60 x 40"):
        AccurateOnDevice(camera.method, any_device()).match(image[:30])


@pytest.mark.parametrize("shape", [(5, 61), (1, 40), (9, 30)])
def test_narrow_pictures_with_unknown_pixels_are_measured_alike(shape):
    """Of less than two blocks, of less than one, and of two: whose surface is that of the paths, and of blocks."""
    height, width = shape
    image = wavy_capture("cy_halves", saturated=False)[:height, :width].copy()
    image[height // 2, 10:13] = np.nan
    method = method_for(
        AccurateConfig().with_range(-2.0, 2.0), aperture="cy_halves", label_maps=[IDENTITY, IDENTITY], execution="numpy"
    )
    expected, found = method.match(image), AccurateOnDevice(method, any_device()).match(image)
    np.testing.assert_allclose(found.value_px, expected.value_px, atol=1e-3)
    np.testing.assert_allclose(found.sigma_px, expected.sigma_px, rtol=0.01)


def test_the_camera_measures_on_the_device():
    camera, image = small_sample("still_life_cy_halves", 60, 40, quality="accurate")
    on_gpu = camera_on("gpu", camera.calibration, camera.config)
    expected, found = camera.measure(image), on_gpu.measure(image)
    known = np.isfinite(expected.depth_mm) & np.isfinite(found.depth_mm)
    assert known.mean() > 0.9
    assert (np.isnan(expected.depth_mm) == np.isnan(found.depth_mm)).mean() > 0.995
    assert (np.abs(found.depth_mm / expected.depth_mm - 1) < 1e-3)[known].mean() > 0.995
    assert np.quantile(np.abs(found.color - expected.color), 0.99) < 1e-3
