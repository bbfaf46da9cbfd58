"""Measuring on a device: the same answer as the CPU, or one clear line, and the choice of the device."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import tifffile

from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.camera.method import default_config
from chromaperture.depth.conversion import DepthModel
from chromaperture.matching.accurate import AccurateMethod
from chromaperture.matching.device import device as device_file
from chromaperture.matching.device.accurate_chain import AccurateOnDevice
from chromaperture.matching.device.device import AdapterInfo, Device, DeviceError, adapters, open_device
from chromaperture.matching.device.gpu_method import DeviceMethod, GpuMethod, chosen_device, on_device
from chromaperture.matching.device.measured import OnDevice
from chromaperture.matching.estimate import method_for
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.result import Method
from chromaperture.settings.methods import AccurateConfig, PaperConfig, RealTimeConfig
from chromaperture.settings.stages import CorrelationConfig
from chromaperture.system.errors import (
    CaptureWarning,
    ChromapertureError,
    InputError,
    MissingDependencyError,
    OutOfMemoryError,
)
from devices import EXPECTED, camera_on, device_of_its_own, with_device
from worlds import INFINITY_PX, PUPIL_MM, SCALE_PX_MM, halves_camera, wavy_capture

SHAPE = (60, 84)
REAL_TIME = RealTimeConfig().with_range(-4.0, 4.0)
NO_GPU = AdapterInfo("rasteriser", "CPU", "Vulkan", "", 128, False)
extra = pytest.mark.extra("gpu", "wgpu")


def camera(device: str, quality: str = "real-time", **changes) -> CodedApertureCamera:
    model = DepthModel(INFINITY_PX, SCALE_PX_MM, PUPIL_MM, np.diag([1e-4, 25.0, 0.25]))
    calibration = halves_camera(model, SHAPE[1], SHAPE[0])
    return camera_on(device, calibration, replace(default_config(calibration, quality), **changes))


def silent(note: str) -> None:
    pass


def method_and_picture(quality: str = "real-time") -> tuple[Method, np.ndarray]:
    """A readable method, and a picture that software measures in seconds."""
    config, shape = (AccurateConfig().with_range(-2.0, 2.0), (24, 40)) if quality == "accurate" else (REAL_TIME, SHAPE)
    maps = [IDENTITY, IDENTITY] if quality == "accurate" else []
    method = method_for(config, aperture="cy_halves", label_maps=maps, execution="numpy")
    return method, wavy_capture("cy_halves", shape=shape, saturated=False)


def opened(method: Method, device: Device) -> OnDevice:
    return (AccurateOnDevice if isinstance(method, AccurateMethod) else GpuMethod)(method, device)


@extra
def test_a_driver_is_there_where_one_was_installed():
    if not os.environ.get(EXPECTED):
        pytest.skip(f"{EXPECTED} is not set: nobody promised a driver")
    assert adapters()


@with_device
@pytest.mark.parametrize("shape", [(8, 9), (9, 40), (33, 1), (1, 33), (1, 1)])
@pytest.mark.parametrize("config", [REAL_TIME, PaperConfig().with_range(-2.0, 2.0)], ids=["real-time", "paper"])
@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares"])
def test_small_odd_and_narrow_pictures(shape, config, design, rng):
    image = rng.uniform(0.1, 0.9, (*shape, 3)).astype(np.float32)
    method = method_for(config, aperture=design, execution="numpy")
    device_method = GpuMethod(method, open_device("gpu"))
    if shape == (1, 1):  # one pixel has no texture
        for each in (method, device_method):
            with pytest.raises(InputError, match="constant"):
                each.match(image)
        return
    expected, found = method.match(image), device_method.match(image)
    np.testing.assert_array_equal(np.isfinite(found.value_px), np.isfinite(expected.value_px))
    known = np.isfinite(found.value_px)
    if known.any():  # white noise has as many ties as peaks, and few pixels
        assert np.median(np.abs(found.value_px - expected.value_px)[known]) < 1e-3


@with_device
@pytest.mark.parametrize(
    ("fill", "words"), [(np.nan, "no usable pixel"), (1.0, "no usable pixel"), (0.4, "the image is constant")]
)
def test_a_picture_without_anything_to_match_is_refused_as_on_the_cpu(fill, words):
    method, _ = method_and_picture()
    image = np.full((*SHAPE, 3), fill, np.float32)
    for each in (method, on_device(method, "gpu", silent)):
        with pytest.raises(InputError, match=words):
            each.match(image)


@with_device
@pytest.mark.parametrize("device", ["cpu", "gpu"])
def test_photographs_begun_two_at_a_time_are_measured_as_one_by_one(device):
    whole, part = camera(device), camera(device, crop_origin_px=(6, 4))
    images = [wavy_capture("cy_halves", shape=SHAPE, seed=seed) for seed in (7, 8, 9)]
    for each, shown in ((whole, np.s_[:]), (part, np.s_[4:54, 6:80])):
        assert each.can_pipeline == (device == "gpu")
        expected = [each.measure(image[shown]) for image in images]
        under_way, found = [each.submit(images[0][shown])], []
        for image in images[1:]:
            under_way.append(each.submit(image[shown]))
            found.append(under_way.pop(0).result())
        found.append(under_way.pop().result())
        for one, other in zip(found, expected, strict=True):
            for name in ("depth_mm", "sigma_mm", "disparity_px", "confidence", "color"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert not np.array_equal(found[0].depth_mm, found[1].depth_mm, equal_nan=True)
        with pytest.raises(InputError, match="the image is constant"):
            each.submit(np.full_like(images[0][shown], 0.4)).result()


@with_device
@pytest.mark.parametrize("quality", ["real-time", "accurate"])
def test_a_device_lost_in_mid_stream_is_an_error_or_the_cpu_once(quality):
    method, image = method_and_picture(quality)
    pictures = [image, np.ascontiguousarray(image[::-1])]
    expected = [method.match(each).value_px for each in pictures]
    for may_fall_back in (False, True):
        device = device_of_its_own()
        on_both = DeviceMethod(opened(method, device), method, may_fall_back)
        assert np.isfinite(on_both.match(image).value_px).any()
        pending = [on_both.start(each) for each in pictures]
        device.handle.destroy()
        if not may_fall_back:
            with pytest.raises(DeviceError, match="was lost while it worked; use --device cpu"):
                pending[0].result()
            continue
        with pytest.warns(CaptureWarning, match="on the CPU from here on") as said:
            found = [each.result().disparity.value_px for each in pending]
        assert len(said) == 1
        np.testing.assert_array_equal([*found, on_both.match(image).value_px], [*expected, expected[0]])


@with_device
@pytest.mark.parametrize("quality", ["real-time", "accurate"])
def test_too_little_device_memory_is_an_error_or_the_cpu(quality):
    method, image = method_and_picture(quality)
    on_gpu = opened(method, replace(open_device("gpu"), largest_bytes=5_000))
    with pytest.raises(OutOfMemoryError, match="larger than the device's 0 MB; use --device cpu, or --scale"):
        DeviceMethod(on_gpu, method, may_fall_back=False).match(image)
    with pytest.warns(CaptureWarning, match="on the CPU from here on"):
        found = DeviceMethod(on_gpu, method, may_fall_back=True).match(image)
    np.testing.assert_array_equal(found.value_px, method.match(image).value_px)


@with_device
@pytest.mark.parametrize("design", ["cy_halves", "rgb_squares", "cmy_circles"])
def test_a_device_of_small_arrays_takes_fewer_layers_at_a_time(design):
    config = PaperConfig().with_range(-3.0, 3.0)
    image = wavy_capture(design, shape=SHAPE)
    method = method_for(config, aperture=design)
    large = GpuMethod(method, open_device("gpu"))
    expected = large.match(image).value_px
    most = 4 * max(array.size for array in large._chain.arrays.values())
    small = GpuMethod(method, replace(open_device("gpu"), largest_bytes=most - 1))
    found = small.match(image).value_px
    whole, chunks = (
        [d.constants["layer_count"] for d in each._chain.dispatches if d.stage == "running_winner"]
        for each in (large, small)
    )
    assert len(chunks) > len(whole)
    assert chunks[-1] % 4 != 0  # the last is not filled up with layers
    np.testing.assert_array_equal(found, expected)


@with_device
def test_two_processes_share_a_device(tmp_path):
    method, image = method_and_picture()
    np.save(tmp_path / "image.npy", image)
    program = (
        "import sys, numpy as np\n"
        "from chromaperture.settings.methods import RealTimeConfig\n"
        "from chromaperture.matching.estimate import method_for\n"
        "from chromaperture.matching.device.gpu_method import on_device\n"
        "method = method_for(RealTimeConfig().with_range(-4.0, 4.0), aperture='cy_halves', execution='numpy')\n"
        "found = on_device(method, 'gpu', lambda note: None).match(np.load(sys.argv[1] + '/image.npy'))\n"
        "np.save(sys.argv[1] + '/found.npy', found.value_px)\n"
    )
    other = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)])
    found = on_device(method, "gpu", silent).match(image)
    assert other.wait(300) == 0
    np.testing.assert_array_equal(np.load(tmp_path / "found.npy"), found.value_px)


@with_device
def test_info_lists_the_devices_and_depth_measures_on_one(run, tmp_path):
    found = json.loads(run("info", "--devices", "--json").stdout)
    assert [a["name"] for a in found["adapters"]] == [a.name for a in adapters()]
    if all(a.is_software for a in adapters()):
        assert found["auto"] == "cpu"
    tifffile.imwrite(tmp_path / "photo.tiff", wavy_capture("cy_halves", shape=SHAPE), photometric="rgb")
    name = adapters()[0].name.split()[0].upper()
    result = run("depth", tmp_path / "photo.tiff", "--design", "cy_halves", "--device", f"gpu:{name}", "--quiet")
    assert result.returncode == 0, result.stderr
    assert ("is software" in result.stderr) == adapters()[0].is_software
    assert np.isfinite(tifffile.imread(tmp_path / "photo.disparity.tiff")).mean() > 0.5
    refused = run("depth", tmp_path / "photo.tiff", "--design", "cy_halves", "--device", "gpu:nosuch")
    assert refused.returncode == 2
    assert "no GPU named 'nosuch': this machine has" in refused.stderr


@with_device
def test_what_the_device_cannot_run_runs_on_the_cpu_and_says_so():
    calibration = camera("cpu").calibration
    debiased = PaperConfig(correlation=CorrelationConfig(noise_debiasing=True))
    config = replace(default_config(calibration, "paper"), matcher=debiased)
    with pytest.warns(CaptureWarning, match="run on the CPU"):
        method = CodedApertureCamera(calibration, config, device="gpu").method
    assert not isinstance(method, DeviceMethod)


# ---- without a device


def test_auto_never_takes_software(monkeypatch):
    monkeypatch.setattr(device_file, "_found_adapters", lambda: [(NO_GPU, None)])
    assert chosen_device("auto") is None
    assert chosen_device("cpu") is None


def test_auto_takes_the_first_real_device(monkeypatch):
    asked = []
    real = NO_GPU._replace(name="Real", kind="IntegratedGPU")
    monkeypatch.setattr(device_file, "_found_adapters", lambda: [(real, None), (NO_GPU, None)])
    monkeypatch.setattr("chromaperture.matching.device.gpu_method.open_device", asked.append)
    chosen_device("auto")
    assert asked == ["gpu"]


@extra
def test_a_machine_without_a_driver(monkeypatch):
    monkeypatch.setattr(device_file, "_found_adapters", list)
    assert chosen_device("auto") is None
    open_device.cache_clear()
    with pytest.raises(DeviceError, match="no GPU found: install a Vulkan driver"):
        open_device("gpu")


def test_without_the_extra_only_auto_and_cpu_work(monkeypatch):
    monkeypatch.setitem(sys.modules, "wgpu", None)
    for cached in (device_file._wgpu, device_file._found_adapters, open_device):
        cached.cache_clear()
    assert adapters() == []
    assert chosen_device("auto") is None
    with pytest.raises(MissingDependencyError, match=r"pip install 'chromaperture\[gpu\]'"):
        open_device("gpu")
    device_file._found_adapters.cache_clear()  # found none


def test_an_unknown_device_is_refused(run, tmp_path):
    tifffile.imwrite(tmp_path / "photo.tiff", wavy_capture("cy_halves", shape=SHAPE), photometric="rgb")
    result = run("depth", tmp_path / "photo.tiff", "--design", "cy_halves", "--device", "tpu")
    assert result.returncode == 2
    assert "unknown device 'tpu': choose auto, cpu, gpu or gpu:NAME" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["photo.tiff"]
    assert run("info").returncode == 2
    with pytest.raises(ChromapertureError):
        load_camera(tmp_path / "none.asdf", device="gpu")
