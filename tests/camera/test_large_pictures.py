"""Photographs of other sizes than the calibration's, turned ones, and ones that are too large."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from chromaperture.camera import memory as camera_memory
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.memory import fitting_jobs, needed_bytes
from chromaperture.camera.method import default_config
from chromaperture.capture.files import read_image
from chromaperture.cli.depth import jobs_in_memory
from chromaperture.cli.options import working_scale as option
from chromaperture.cli.setup import camera_for
from chromaperture.depth.conversion import DepthModel, depth_to_disparity
from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import accurate_scale, at_scale, working_scale
from chromaperture.optics.lens_blur import BlurModel
from chromaperture.products.rectified import undistorter
from chromaperture.system import memory
from chromaperture.system.errors import CaptureWarning, InputError, OutOfMemoryError
from worlds import capture, halves_camera, texture

WIDTH, HEIGHT, SCALE = 768, 512, 4
CURVE = DepthModel(16.0, 32000.0, 50.0, np.diag([1e-4, 1.0, 1.0]))
DEPTH_MM = 1500.0


@pytest.fixture(scope="module")
def full() -> Calibration:
    return halves_camera(CURVE, WIDTH, HEIGHT, near_mm=1200.0, far_mm=4000.0)


@pytest.fixture(scope="module")
def photograph() -> np.ndarray:
    """A wall whose texture is as coarse as a camera of so many pixels would blur it."""
    pattern = texture(np.random.default_rng(8), HEIGHT, WIDTH, blur_px=6.0)
    return capture(pattern, "cy_halves", float(depth_to_disparity(DEPTH_MM, CURVE))).astype(np.float32)


def reduced_by_hand(image: np.ndarray, scale: int) -> np.ndarray:
    height, width = (n // scale for n in image.shape[:2])
    return image.reshape(height, scale, width, scale, 3).mean(axis=(1, 3))


@pytest.mark.parametrize("quality", ["paper", "real-time"])
def test_at_a_working_scale_the_answer_is_that_of_the_small_camera(full, photograph, quality):
    """Against the camera of reduced pictures, which measures a picture that was reduced without OpenCV."""
    config = default_config(full, quality, scale=SCALE)
    assert config.scale == SCALE
    frame = CodedApertureCamera(full, config).measure(photograph)
    small = at_scale(full, SCALE)
    there = CodedApertureCamera(small, replace(config, scale=1)).measure(reduced_by_hand(photograph, SCALE))
    assert frame.depth_mm.shape == (HEIGHT, WIDTH)
    assert frame.config.scale == SCALE
    # Full pixels about the middle of a working one; flat areas, for the upsampling is linear there.
    middle = frame.depth_mm.reshape(HEIGHT // SCALE, SCALE, WIDTH // SCALE, SCALE)[:, 1:3, :, 1:3].mean(axis=(1, 3))
    both = np.isfinite(middle) & np.isfinite(there.depth_mm)
    assert both.mean() > 0.9
    assert np.median(np.abs(middle - there.depth_mm)[both]) < 0.001 * DEPTH_MM
    assert np.nanmedian(frame.sigma_mm) == pytest.approx(np.nanmedian(there.sigma_mm), rel=0.02)
    assert np.nanmedian(frame.disparity_px) == pytest.approx(SCALE * np.nanmedian(there.disparity_px), rel=0.01)


def test_depth_at_a_working_scale_is_true_and_colour_is_aligned_at_every_pixel(full, photograph):
    frame = CodedApertureCamera(full, default_config(full, "real-time", scale=SCALE)).measure(photograph)
    # The matcher places flat boards of ideal texture to 0.02 working px, here 2 mm; 1 % allows the texture's own.
    assert np.nanmedian(frame.depth_mm) == pytest.approx(DEPTH_MM, rel=0.01)
    inside = np.s_[64:-64, 64:-64]
    before, after = (np.abs(p[..., 0] - p[..., 2])[inside].mean() for p in (photograph, frame.color))
    assert after < 0.1 * before  # the wall is grey


def test_the_same_camera_at_another_size_is_measured_and_said(full, photograph):
    half = reduced_by_hand(photograph, 2).astype(np.float32)
    camera = CodedApertureCamera(full, default_config(full, "real-time", scale=SCALE))
    with pytest.warns(CaptureWarning, match="384x256 px by a camera calibrated at 768x512") as said:
        frame = camera.measure(half)
    assert len(said) == 1
    assert "of a part of it every distance is wrong" in str(said[0].message)
    assert frame.depth_mm.shape == half.shape[:2]
    assert frame.config.scale == SCALE // 2  # the same working picture
    assert np.nanmedian(frame.depth_mm) == pytest.approx(DEPTH_MM, rel=0.01)
    assert frame.calibration.lens.camera_matrix[0, 0] == pytest.approx(full.lens.camera_matrix[0, 0] / 2)


def test_a_file_at_another_size_is_read_and_one_of_another_aspect_refused(full, photograph, tmp_path):
    camera = CodedApertureCamera(full, default_config(full, "real-time", scale=SCALE))
    counts = np.rint(reduced_by_hand(photograph, 2) * 65535).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "half.png"), counts[..., ::-1])
    assert camera.read(tmp_path / "half.png").shape == (256, 384, 3)
    cv2.imwrite(str(tmp_path / "crop.png"), counts[:200, :, ::-1])
    with pytest.raises(InputError, match=r"384x200 px .* 768x512; give an original of that size or of its aspect"):
        camera.read(tmp_path / "crop.png")
    cv2.imwrite(str(tmp_path / "turned.png"), counts.transpose(1, 0, 2)[..., ::-1])
    with pytest.raises(InputError, match="256x384 px"):
        camera.read(tmp_path / "turned.png")
    with pytest.raises(InputError, match="looks rotated: turn it back"):
        camera.measure(photograph.transpose(1, 0, 2))


def test_pictures_for_other_programs_are_of_the_size_that_was_calibrated(full, photograph):
    camera = CodedApertureCamera(full, default_config(full, "real-time", scale=SCALE))
    with pytest.warns(CaptureWarning):
        frame = camera.measure(reduced_by_hand(photograph, 2).astype(np.float32))
    with pytest.raises(InputError, match="384x256"):
        undistorter(camera)(frame, 0.0, 0)


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_a_portrait_by_exif_is_read_as_the_sensor_recorded_it(tmp_path, orientation):
    """Films do not turn with the picture: what counts is where left and right were on the sensor."""
    pixels = np.random.default_rng(1).integers(0, 255, (32, 48, 3), dtype=np.uint8)
    exif = Image.Exif()
    exif[0x0112] = orientation
    for suffix in ("png", "tif", "jpg"):
        options = {"quality": 95, "subsampling": 0} if suffix == "jpg" else {}
        Image.fromarray(pixels).save(tmp_path / f"plain.{suffix}", **options)
        Image.fromarray(pixels).save(tmp_path / f"portrait.{suffix}", exif=exif, **options)
        found, plain = (read_image(tmp_path / f"{name}.{suffix}") for name in ("portrait", "plain"))
        np.testing.assert_array_equal(found, plain)


def test_a_picture_beyond_the_memory_is_refused_before_it_is_read(full, tmp_path, monkeypatch):
    large = replace(full, sensor=replace(full.sensor, width_px=3072, height_px=2048))
    config = default_config(large, "real-time", scale=1)
    assert needed_bytes(large, config) > 1.2e9 > needed_bytes(large, config, scale=2)
    for module in (memory, camera_memory):
        monkeypatch.setattr(module, "available_bytes", lambda: 1.2e9)
    camera = CodedApertureCamera(large, config)
    with pytest.raises(
        OutOfMemoryError,
        match=r"photo.png, 6.29 megapixels at scale 1/1: not enough memory: .* 1.2 GB free; match at .*\(--scale 1/2\)",
    ):
        camera.read(tmp_path / "photo.png")  # there is no such file: nothing was opened


@pytest.mark.parametrize(("free", "expected"), [(0.1, 1), (1.5, 1), (2.5, 2), (100, 4), (float("inf"), 4)])
def test_no_more_photographs_at_a_time_than_there_is_memory_for(full, monkeypatch, free, expected):
    config = default_config(full, "real-time", scale=1)
    monkeypatch.setattr(camera_memory, "available_bytes", lambda: free * needed_bytes(full, config))
    assert fitting_jobs(full, config, 4) == expected
    camera = CodedApertureCamera(full, config)
    if expected == 4:
        assert jobs_in_memory(camera, 4) == 4
    else:
        with pytest.warns(CaptureWarning, match=f"--jobs 4: there is memory for {expected} at a time"):
            assert jobs_in_memory(camera, 4) == expected


def test_memory_is_asked_of_every_limit(monkeypatch, tmp_path):
    (tmp_path / "meminfo").write_text("MemTotal: 9000000 kB\nMemAvailable:    5000000 kB\n")
    (tmp_path / "max").write_text("3000000000\n")
    (tmp_path / "current").write_text("1000000000\n")
    monkeypatch.setattr(memory, "_MEMINFO", str(tmp_path / "meminfo"))
    monkeypatch.setattr(memory, "_CGROUPS", ())
    assert memory.available_bytes() == 5000000 * 1024
    monkeypatch.setattr(memory, "_CGROUPS", ((str(tmp_path / "max"), str(tmp_path / "current")),))
    assert memory.available_bytes() == 2.5e9
    (tmp_path / "max").write_text("max\n")
    assert memory.available_bytes() == 5000000 * 1024


def test_scales_of_real_sensors(full):
    """A blur of 12 px needs every pixel of a small picture; 8 times as many pixels are too many."""
    blur = BlurModel(10.0, 20000.0, spherical_px=4.0, spherical5_px=-5.0)
    small = replace(halves_camera(CURVE, 720, 480), blur=blur)
    assert working_scale(small) == 1
    factor = 8
    large = replace(
        small,
        sensor=replace(small.sensor, width_px=720 * factor, height_px=480 * factor),
        blur=BlurModel(10.0 * factor, 20000.0 * factor, spherical_px=4.0 * factor, spherical5_px=-5.0 * factor),
    )
    assert working_scale(large) == factor
    assert working_scale(replace(large, blur=None)) == 1  # nothing to choose by
    assert working_scale(full) == 1


@pytest.mark.parametrize("width_px", [720, 960, 1440, 6000])
def test_accurate_matches_as_many_pixels_of_blur_at_every_size(width_px):
    """The same lens and sensor with other pixels; the widest blur of 720 px is 14 px."""
    factor = width_px / 720
    camera = replace(
        halves_camera(CURVE, width_px, round(480 * factor)),
        blur=BlurModel(10.0 * factor, 20000.0 * factor), near_mm=900.0, far_mm=4000.0,
    )  # fmt: skip
    scale = accurate_scale(camera)
    assert scale == working_scale(camera) or not float(scale).is_integer()
    pupil_mm = camera.on_axis("accurate").sensor_to_pupil_mm
    blur_px = (20000 / (900 - pupil_mm) - 10) * factor / scale
    assert 11 < blur_px < 13.5 * 1.126  # time grows with the third power: by 2.5 at most
    assert default_config(camera, "accurate").scale == scale
    assert default_config(camera, "real-time").scale == working_scale(camera)


@pytest.mark.parametrize(
    ("text", "scale"), [("auto", "auto"), ("1", 1), ("1/4", 4), (" 1 / 12 ", 12), ("1/1.25", 1.25)]
)
def test_the_option_is_a_fraction(text, scale):
    assert option(text) == scale


@pytest.mark.parametrize("text", ["4", "1/0", "0.5", "2/3", "", "1/1000", "half"])
def test_other_options_are_refused(text):
    with pytest.raises(InputError, match="auto, 1, or a fraction such as 1/4"):
        option(text)


def test_the_command_line_passes_the_scale(full, tmp_path):
    full.save(tmp_path / "camera.asdf")
    camera = camera_for(tmp_path / "none.png", tmp_path / "camera.asdf", None, quality="paper", config=None, scale=2)
    assert camera.config.scale == 2
