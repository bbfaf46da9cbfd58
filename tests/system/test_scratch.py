"""Volumes that do not fit into memory: kept on disk, with the same results to the last bit."""

from __future__ import annotations

import errno
import math
import os
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import chromaperture as cap
from chromaperture.camera import memory as camera_memory
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.memory import check_camera_memory, needed_bytes, volume_bytes
from chromaperture.camera.method import default_config
from chromaperture.capture.files import read_image
from chromaperture.matching.compiled import workspace
from chromaperture.matching.working_scale import reduced
from chromaperture.model.scale import resized
from chromaperture.products.samples import SAMPLES, sample_camera, sample_image
from chromaperture.system import memory
from chromaperture.system.errors import CaptureWarning, InputError, OutOfMemoryError

GIGA = 1e9


@pytest.fixture(scope="module")
def calibration():
    return cap.Calibration.load(sample_camera(SAMPLES[0]))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)  # where Python keeps the folder that it found before
    return tmp_path


def test_an_array_on_disk_is_one_like_others_and_leaves_no_file(folder):
    made = memory.scratch_array((3, 4, 5))
    assert type(made) is np.ndarray
    assert made.dtype == np.float32
    assert (made == 0).all()
    made[1] = 7
    assert made.sum() == 140
    assert not list(folder.iterdir())


def test_only_the_block_and_its_thread_have_volumes_on_disk(folder, monkeypatch):
    made = []
    monkeypatch.setattr(workspace, "scratch_array", lambda shape: made.append(shape) or np.empty(shape, np.float32))
    with memory.volumes_on_disk(True):
        with memory.volumes_on_disk(False):
            workspace.volume((2, 3, 4))
        assert made == []
        workspace.volume((2, 3, 4))
    workspace.volume((2, 3, 4))
    assert made == [(2, 3, 4)]


@pytest.fixture
def small(calibration, monkeypatch):
    """The sample at half its size, and a camera that has no memory for its volumes."""
    half = resized(calibration, 360, 240)
    config = default_config(half, "accurate", scale=1)
    free = needed_bytes(half, config) - volume_bytes(half, config) / 2
    image = read_image(sample_image(SAMPLES[0]), black_level=16, white_level=1016)
    monkeypatch.setattr(camera_memory, "_SMALL_BYTES", 0)
    for module in (memory, camera_memory):
        monkeypatch.setattr(module, "available_bytes", lambda: free)
    return CodedApertureCamera(half, config), reduced(image, (360, 240))


@pytest.mark.slow
def test_results_are_the_same_to_the_bit(small, folder, monkeypatch):
    camera, image = small
    on_disk, array = [], memory.scratch_array
    monkeypatch.setattr(workspace, "scratch_array", lambda shape: on_disk.append(shape) or array(shape))
    with pytest.warns(CaptureWarning, match=f"kept in {re.escape(str(folder))}"):
        found = camera.measure(image)
    assert len(on_disk) == 2  # evidence, and the sum of the paths' costs
    monkeypatch.undo()
    expected = camera.measure(image)
    assert np.isfinite(expected.depth_mm).mean() > 0.5
    np.testing.assert_array_equal(found.depth_mm, expected.depth_mm)
    np.testing.assert_array_equal(found.sigma_mm, expected.sigma_mm)
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    ("free", "room", "mapped", "goes_to_disk"),
    [(1.1, 2, 9, False), (0.7, 2, 9, True), (0.7, 0.9, 9, None), (0.7, 2, 0.9, None), (0.1, 2, 9, None)],
)
def test_volumes_go_to_disk_where_that_is_what_is_missing(calibration, monkeypatch, free, room, mapped, goes_to_disk):
    """Of memory and address space in shares of what is needed, of the disk in shares of the volumes."""
    config = default_config(calibration, "accurate", scale=1)
    needed, volumes = needed_bytes(calibration, config), volume_bytes(calibration, config)
    assert 0.3 < 1 - volumes / needed < 0.7
    monkeypatch.setattr(camera_memory, "_SMALL_BYTES", 0)
    monkeypatch.setattr(camera_memory, "address_space_bytes", lambda: mapped * needed)
    monkeypatch.setattr(camera_memory, "free_scratch_bytes", lambda: room * volumes)
    for module in (memory, camera_memory):
        monkeypatch.setattr(module, "available_bytes", lambda: free * needed)
    if goes_to_disk is None:
        with pytest.raises(OutOfMemoryError, match=r"photo.png, 0.346 megapixels at scale 1/1: not enough memory"):
            check_camera_memory("photo.png", calibration, config)
    else:
        assert check_camera_memory("photo.png", calibration, config) == goes_to_disk


def test_a_method_without_such_volumes_is_refused(calibration, monkeypatch):
    config = default_config(calibration, "real-time")
    assert volume_bytes(calibration, config) == 0
    monkeypatch.setenv(memory.LIMIT, "0.01")
    image = np.full((480, 720, 3), 0.5, np.float32)
    with pytest.raises(OutOfMemoryError, match=r"0\.0 GB free"):
        CodedApertureCamera(calibration, config).measure(image)


def test_a_disk_that_fills_up_is_one_line_and_leaves_no_file(small, folder, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    camera, image = small
    with (
        pytest.warns(CaptureWarning, match="kept in"),
        pytest.raises(OutOfMemoryError, match=r"no room for 0.0 GB in .* \(No space left on device\); set TMPDIR"),
    ):
        camera.measure(image)
    assert not list(folder.iterdir())


@given(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12))
def test_a_limit_is_a_number_of_gigabytes_or_refused(text):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(memory.LIMIT, text)
        try:
            found = memory.limit_bytes()
        except InputError as error:
            assert memory.LIMIT in str(error)
            return
        assert found == (float("inf") if not text.strip() else GIGA * float(text))
        assert found > 0
        assert not math.isnan(found)


def test_a_wrong_limit_is_one_line(run, monkeypatch, tmp_path):
    monkeypatch.setenv(memory.LIMIT, "2 GB")
    result = run("depth", sample_image(SAMPLES[0]), "--camera", sample_camera(SAMPLES[0]), "--out", tmp_path / "out")
    assert result.returncode == 2
    assert "CHROMAPERTURE_MEMORY_GB=2 GB is no amount of memory" in result.stderr
    assert not (tmp_path / "out").exists()
