"""What does not fit into memory is refused before it is read."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import chromaperture as cap
from chromaperture.camera import memory as camera_memory
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.memory import check_camera_memory, needed_bytes
from chromaperture.camera.method import default_config
from chromaperture.products.samples import SAMPLES, sample_camera, sample_image
from chromaperture.system import memory
from chromaperture.system.errors import InputError, OutOfMemoryError

GIGA = 1e9


@pytest.fixture(scope="module")
def calibration():
    return cap.Calibration.load(sample_camera(SAMPLES[0]))


@pytest.mark.parametrize("free", [1.1, 0.9])
def test_a_photograph_without_enough_memory_is_refused(calibration, monkeypatch, free):
    config = default_config(calibration, "accurate", scale=1)
    needed = needed_bytes(calibration, config)
    monkeypatch.setattr(camera_memory, "_SMALL_BYTES", 0)
    for module in (memory, camera_memory):
        monkeypatch.setattr(module, "available_bytes", lambda: free * needed)
    if free > 1:
        check_camera_memory("photo.png", calibration, config)
        return
    with pytest.raises(OutOfMemoryError, match=r"photo.png, 0.346 megapixels at scale 1/1: not enough memory"):
        check_camera_memory("photo.png", calibration, config)


def test_a_limit_refuses_every_photograph(calibration, monkeypatch):
    config = default_config(calibration, "real-time")
    monkeypatch.setenv(memory.LIMIT, "0.01")
    image = np.full((480, 720, 3), 0.5, np.float32)
    with pytest.raises(OutOfMemoryError, match=r"0\.0 GB free"):
        CodedApertureCamera(calibration, config).measure(image)


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
