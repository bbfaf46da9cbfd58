"""Quality "accurate" as a whole on a GPU: the same depth as on the CPU."""

import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

from chromaperture.camera import memory as camera_memory
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.matching.device.accurate_chain import AccurateOnDevice
from chromaperture.matching.device.device import DeviceError
from chromaperture.matching.device.gpu_method import DeviceMethod
from chromaperture.matching.estimate import method_for
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.result import Extras
from chromaperture.products.samples import open_sample
from chromaperture.settings.methods import AccurateConfig
from chromaperture.system.errors import CaptureWarning, InputError, OutOfMemoryError
from devices import any_device, device_of_its_own
from worlds import wavy_capture

pytestmark = pytest.mark.extra("gpu", "wgpu")


def small(name, width, height):
    """A bundled capture and its camera in fewer pixels, as software devices are slow."""
    camera, image = open_sample(name, quality="accurate", device="cpu")
    return camera.at_size(width, height), cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def share_within(camera, found, expected, *, relative):
    """Share of the pixels whose depths differ by less, and that are known in both or in neither."""
    a, b = (camera.millimetres(disparity)[0] for disparity in (found, expected))
    known = np.isfinite(b)
    return (np.where(known, np.abs(a - b) <= relative * np.abs(b), np.isnan(a))).mean()


@pytest.mark.parametrize("name", ["still_life_cy_halves", "still_life_cy_open"])
def test_the_depth_is_that_of_the_cpu(name):
    camera, image = small(name, 120, 80)
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
    again = on_gpu.match(image)
    np.testing.assert_array_equal(again.value_px, found.value_px)  # nothing is left of the last photograph


def test_a_picture_of_another_size_is_refused():
    camera, image = small("still_life_cy_halves", 60, 40)
    with pytest.raises(InputError, match="60 x 40"):
        AccurateOnDevice(camera.method, any_device()).match(image[:30])


def test_the_camera_measures_on_the_device():
    camera, image = small("still_life_cy_halves", 60, 40)
    if any_device().info.is_software:
        with pytest.warns(CaptureWarning, match="is software"):
            on_gpu = CodedApertureCamera(camera.calibration, camera.config, device="gpu")
    else:
        on_gpu = CodedApertureCamera(camera.calibration, camera.config, device="gpu")
    assert isinstance(on_gpu.method, DeviceMethod)
    found, expected = on_gpu.measure(image), camera.measure(image)
    known = np.isfinite(expected.depth_mm) & np.isfinite(found.depth_mm)
    assert known.mean() > 0.9
    assert (np.isnan(expected.depth_mm) == np.isnan(found.depth_mm)).mean() > 0.995
    assert (np.abs(found.depth_mm / expected.depth_mm - 1) < 1e-3)[known].mean() > 0.995
    assert np.quantile(np.abs(found.color - expected.color), 0.99) < 1e-3


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


def test_too_little_memory_is_one_clear_error_and_the_cpus_work_with_auto():
    camera, image = small("still_life_cy_halves", 60, 40)
    poor = replace(any_device(), largest_bytes=100_000)
    on_gpu = AccurateOnDevice(camera.method, poor)
    with pytest.raises(OutOfMemoryError, match="use --device cpu, or --scale 1/2"):
        on_gpu.match(image)
    with pytest.warns(CaptureWarning, match="measuring on the CPU"):
        found = DeviceMethod(on_gpu, camera.method, may_fall_back=True).match(image)
    np.testing.assert_array_equal(found.value_px, camera.method.match(image).value_px)


def test_a_device_lost_in_mid_stream_is_an_error_or_the_cpu_once():
    camera, image = small("still_life_cy_halves", 60, 40)
    expected = camera.method.match(image).value_px
    for may_fall_back in (False, True):
        device = device_of_its_own()
        on_both = DeviceMethod(AccurateOnDevice(camera.method, device), camera.method, may_fall_back)
        measured = on_both.start(image, Extras(camera.conversion, camera.alignment.numbers)).result()
        assert np.isfinite(measured.disparity.value_px).any()
        assert measured.depth_mm is None  # the CPU makes what is asked for besides
        assert measured.color is None
        device.handle.destroy()
        if not may_fall_back:
            with pytest.raises(DeviceError, match="use --device cpu"):
                on_both.match(image)
            continue
        with pytest.warns(CaptureWarning, match="on the CPU from here on") as said:
            found = [on_both.match(image).value_px for _ in range(2)]
        assert len(said) == 1
        np.testing.assert_array_equal(found, [expected, expected])


def test_a_photograph_is_sent_up_before_the_one_before_comes_down():
    """As a stream does it."""
    camera, image = small("still_life_cy_halves", 90, 60)
    pictures = [image, np.ascontiguousarray(image[::-1])]
    on_gpu = AccurateOnDevice(camera.method, any_device())
    alone = [on_gpu.match(picture).value_px for picture in pictures]
    begun = [on_gpu.start(picture) for picture in pictures]
    for one, expected in zip(begun, alone, strict=True):
        np.testing.assert_array_equal(one.result().disparity.value_px, expected)
    assert not np.array_equal(*alone, equal_nan=True)


def test_volumes_of_a_device_are_not_said_to_go_to_disk(monkeypatch):
    camera, image = small("still_life_cy_halves", 60, 40)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CaptureWarning)  # the device is software
        on_gpu = CodedApertureCamera(camera.calibration, camera.config, device="gpu")
    monkeypatch.setattr(camera_memory, "check_camera_memory", lambda *_: True)
    with pytest.warns(CaptureWarning, match="kept in"):
        camera.measure(image)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        on_gpu.measure(image)
