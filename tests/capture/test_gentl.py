"""Cameras of a GenTL producer: the simulated ones of the genicam package show how frames come, not what is in them."""

import sys
import time
from pathlib import Path

import numpy as np
import pytest

from chromaperture.capture.gentl import GenTLCamera
from chromaperture.capture.open import connected_sources, open_source
from chromaperture.system.errors import InputError

pytestmark = pytest.mark.extra("gentl", "harvesters")


@pytest.fixture(autouse=True)
def folder(monkeypatch):
    """The folder of the simulated producer."""
    import genicam

    folder = Path(genicam.__file__).parent
    if not list(folder.glob("*.cti")):
        pytest.skip("this genicam has no simulated producer")
    monkeypatch.setenv("GENICAM_GENTL64_PATH", f"/nowhere:{folder}")
    return folder


def test_frames_of_a_producer(folder):
    (producer,) = folder.glob("*.cti")
    events = []
    with open_source(f"gentl:1?producer={producer}&width=200&height=100", listener=events.append) as source:
        frames = [frame for frame, _ in zip(source, range(5), strict=False)]
        counts = source.counts
    assert all(frame.counts.shape == (100, 200, 3) and frame.counts.any() for frame in frames)
    assert (np.diff([frame.index for frame in frames]) > 0).all()
    assert np.all(np.diff([frame.time_s for frame in frames]) > 0)
    facts = frames[-1].metadata
    assert facts["pixel_format"] == "RGBa8"
    assert facts["timed_by"] == "arrival"  # this producer has no clock
    assert counts.incomplete == 0
    assert not any(event.kind == "lost" for event in events)


def test_old_frames_are_left_out_and_counted():
    device = GenTLCamera()
    try:
        while device.read(0).frame is None:  # a busy machine is late at once
            pass
        time.sleep(1.0)  # 20 frames, of which the 8 buffers hold the oldest
        arrivals = [device.read(0)]
        while arrivals[-1].frame is None:
            arrivals.append(device.read(0))
    finally:
        device.close()
    assert arrivals[0].frame is None
    assert arrivals[0].skipped == 8
    assert arrivals[-1].lost > 0


def test_cameras_are_listed(monkeypatch):
    def listed():
        return {c.kind: c for c in connected_sources()}["gentl"].specs

    assert listed() == ["gentl:0", "gentl:1", "gentl:2"]
    monkeypatch.delenv("GENICAM_GENTL64_PATH")
    assert listed() == []


@pytest.mark.parametrize(
    ("spec", "word"),
    [
        ("gentl:?pixel_format=Mono8", "Mono8 is not read"),
        ("gentl:?pixel_format=BayerRG12", "no pixel format BayerRG12: choose RGBa8, Mono8"),
        ("gentl:?width=801", "width of .* must be 100 to 800, got 801"),
        ("gentl:?exposure_us=5000", "does not let exposure_us be set"),
        ("gentl:?trigger=Line1", "no trigger 'Line1': choose none"),
        ("gentl:99", "none among the 3"),
        ("gentl:?producer=/nowhere/a.cti", "no GenTL producer /nowhere/a.cti"),
        (f"gentl:?producer={sys.executable}", "none among the 0"),
    ],
)
def test_what_the_camera_cannot_do_is_refused(spec, word):
    with pytest.raises(InputError, match=word), open_source(spec) as source:
        next(iter(source))


def test_without_a_producer_it_is_said_where_to_name_one(monkeypatch):
    monkeypatch.delenv("GENICAM_GENTL64_PATH")
    with pytest.raises(InputError, match="GENICAM_GENTL64_PATH"), open_source("gentl:"):
        pass


def test_a_camera_in_use_is_refused():
    device = GenTLCamera("0")
    try:
        with pytest.raises(InputError, match="cannot be opened"):
            GenTLCamera("0")
    finally:
        device.close()
    GenTLCamera("0").close()
