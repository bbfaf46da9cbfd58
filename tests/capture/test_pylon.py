"""Basler cameras through the emulator of their driver: every count as sent, and every fault said."""

import time

import cv2
import numpy as np
import pytest

from chromaperture.capture import pylon as source_module
from chromaperture.capture.bayer import superpixels
from chromaperture.capture.open import connected_sources, open_source
from chromaperture.capture.pixel_formats import unpack
from chromaperture.capture.pylon import PylonCamera
from chromaperture.capture.recording import Recorder
from chromaperture.capture.source import Frame
from chromaperture.capture.threaded_source import LiveSource
from chromaperture.products.samples import open_sample, sample_image
from chromaperture.system.errors import InputError

pytestmark = pytest.mark.extra("pylon", "pypylon")
SITES = {"R": 0, "G": 1, "B": 2}


class Emulator:
    """Two cameras of pylon's emulator that see a picture, which fills their sensor."""

    def __init__(self, folder):
        self.path, self.opened = folder / "seen.png", []

    def show(self, rgb):
        """Let the cameras see a picture, (H, W, 3) uint16."""
        assert cv2.imwrite(str(self.path), rgb[..., ::-1])
        self.size_px = rgb.shape[1::-1]

    def attach(self, nodes):
        width, height = self.size_px
        for name, value in {
            "Width": width, "WidthMax": width, "Height": height, "HeightMax": height, "TestImageSelector": "Off",
            "ImageFilename": str(self.path), "ImageFileMode": "On",
        }.items():  # fmt: skip
            nodes.find(name).value = value
        self.opened.append(nodes)

    def command(self, name):
        self.opened[-1]._nodes.GetNode(name).Execute()


@pytest.fixture
def emulator(tmp_path, monkeypatch, rng):
    monkeypatch.setenv("PYLON_CAMEMU", "2")
    made, settings = Emulator(tmp_path), source_module.apply_settings
    made.show(rng.integers(0, 65536, (96, 128, 3)).astype(np.uint16))

    def attach_first(nodes, **wanted):
        made.attach(nodes)
        return settings(nodes, **wanted)

    monkeypatch.setattr(source_module, "apply_settings", attach_first)
    return made


def mosaic_of(rgb, order):
    """Photosites of a sensor that sees a picture."""
    mosaic = np.empty(rgb.shape[:2], rgb.dtype)
    for i, colour in enumerate(order):
        cell = np.s_[i // 2 :: 2, i % 2 :: 2]
        mosaic[cell] = rgb[(*cell, SITES[colour])]
    return mosaic


def seen_by(emulator):
    return cv2.imread(str(emulator.path), cv2.IMREAD_UNCHANGED)[..., ::-1]


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("order", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_every_bit_of_every_photosite_arrives(emulator, order, bits):
    with open_source(f"pylon:?pixel_format=Bayer{order[:2]}{bits}") as source:
        frame = next(iter(source))
    sites = mosaic_of(seen_by(emulator) >> (16 - bits), order).astype(int)
    corners = [sites[i // 2 :: 2, i % 2 :: 2] for i in range(4)]
    by_colour = {c: sum(s for s, of in zip(corners, order, strict=True) if of == c) for c in "RGB"}
    expected = np.stack([2 * by_colour["R"], by_colour["G"], 2 * by_colour["B"]], axis=-1)
    np.testing.assert_array_equal(frame.counts, expected)
    assert (frame.encoding.black_level, frame.encoding.white_level) == (0, 2 * (2**bits - 1))


@pytest.mark.parametrize(("name", "bits"), [("BayerGB10p", 10), ("BayerRG12p", 12), ("BayerGR12Packed", 12)])
def test_packed_photosites_are_those_that_the_driver_unpacks(rng, name, bits):
    from pypylon import pylon

    data = rng.integers(0, 256, 8 * 6 * bits // 8, dtype=np.uint8).tobytes()
    picture = pylon.PylonImage()
    picture.AttachBytesObject(data, getattr(pylon, f"PixelType_{name}"), 8, 6, 0)
    expected, _ = unpack(picture.Array.astype("<u2").tobytes(), 8, 6, f"{name[:7]}{bits}")
    found, _ = unpack(data, 8, 6, name)
    np.testing.assert_array_equal(found, expected)


def test_settings_are_in_force_and_in_the_metadata(emulator):
    with open_source("pylon:0815-0001?exposure_us=5000&gain=6&fps=50&pixel_format=BayerRG12") as source:
        frame = next(iter(source))
    facts = dict(frame.metadata)
    assert facts.pop("gain") == pytest.approx(6, abs=1e-4)  # the emulator's gain has 16 bits
    assert facts == {
        "camera": "Basler Emulation 0815-0001", "pixel_format": "BayerRG12", "exposure_us": 5000, "fps": 50,
        "region_px": [0, 0, 128, 96], "timed_by": "arrival",
    }  # fmt: skip
    nodes = {"Gamma": 2.0, "ExposureAuto": "Continuous", "ReverseX": True}
    attach = emulator.attach

    def misset(camera):
        attach(camera)
        for name, value in nodes.items():
            camera.find(name).value = value

    emulator.attach = misset
    with open_source("pylon:") as source:
        assert "not_neutral" not in next(iter(source)).metadata
        assert [emulator.opened[-1].find(name).value for name in nodes] == [1.0, "Off", False]


@pytest.mark.parametrize(
    ("spec", "word"),
    [
        ("pylon:4711", "none among the 2"),
        ("pylon:?pixel_format=Mono8", "Mono8 is not read"),
        ("pylon:?pixel_format=BayerRG12p", "no pixel format BayerRG12p: choose Mono8"),
        ("pylon:?exposure_us=1e9", r"exposure_us of Basler Emulation 0815-0000 must be 1 to 1e\+07, got 1e\+09"),
        ("pylon:?gain=-1", "gain of Basler Emulation 0815-0000 must be 0 to 48, got -1"),
        ("pylon:?fps=0", "fps of Basler Emulation 0815-0000 must be"),
        ("pylon:?width=129", "width of Basler Emulation 0815-0000 must be 1 to 128, got 129"),
        ("pylon:?trigger=Line9", "no trigger 'Line9': choose Software, Line1"),
        ("pylon:?focus=3", "no setting 'focus'"),
    ],
)
def test_what_the_camera_cannot_do_is_refused(emulator, spec, word):
    with pytest.raises(InputError, match=word) as refused, open_source(spec) as source:
        next(iter(source))
    assert "\n" not in str(refused.value)
    with open_source("pylon:") as source:  # and the camera is free again
        next(iter(source))


def test_a_camera_in_use_is_named(emulator, monkeypatch):
    from pypylon import genicam, pylon

    def taken(camera):  # the driver's words for a GigE camera; two programs may open an emulated one
        raise genicam.RuntimeException(
            "Failed to open device '0815-0000'. The device is controlled by another application. Err: 0xE1018006 : "
            "RuntimeException thrown (file 'GxDevice.cpp', line 1)"
        )

    monkeypatch.setattr(pylon.InstantCamera, "Open", taken)
    with pytest.raises(InputError, match="controlled by another application"), open_source("pylon:"):
        pass


def test_cameras_are_listed(emulator):
    assert {c.kind: c for c in connected_sources()}["pylon"].specs == ["pylon:0815-0000", "pylon:0815-0001"]


# What happens on the way


def test_only_the_newest_frame_is_kept(emulator):
    device = PylonCamera(fps=50)
    try:
        arrivals = [device.read(0)]
        time.sleep(0.5)
        arrivals += [device.read(0), device.read(0)]
    finally:
        device.close()
    assert all(arrival.frame is not None and arrival.lost == 0 for arrival in arrivals)
    assert arrivals[1].skipped > 5  # of 25
    assert arrivals[2].skipped < arrivals[1].skipped  # no queue of old ones


def test_frames_that_failed_are_counted_and_left_out(emulator):
    events, indices = [], []
    with open_source("pylon:?fps=50", listener=events.append) as source:
        for frame in source:
            if not indices:
                emulator.opened[0].find("ForceFailedBufferCount").value = 3
                emulator.command("ForceFailedBuffer")
            indices.append(frame.index)
            assert frame.counts.shape == (48, 64, 3)
            if source.counts.incomplete and len(indices) > 9:
                break
        counts = source.counts
    assert counts.incomplete == 3
    assert counts.lost == 0
    assert counts.delivered == len(indices)
    assert [e.kind for e in events] == ["missing"]
    assert "1 arrived incomplete, 0 not at all; the driver says: The buffer was inc" in events[0].message


def test_a_camera_that_is_unplugged_is_found_again(emulator):
    events, after = [], 0
    with open_source("pylon:?fps=50", listener=events.append) as source:
        source._retry_s = 0.01
        for taken, _ in enumerate(source):
            if taken == 3:
                emulator.command("FirePnPCallback")
            after += any(e.kind == "reconnected" for e in events)
            assert taken < 3000, "it was not missed"  # a minute
            if after == 3:
                break
    assert [e.kind for e in events] == ["lost", "reconnected"]
    assert len(emulator.opened) == 2


def test_a_camera_that_waits_for_its_trigger_is_not_lost(emulator, monkeypatch):
    monkeypatch.setattr(source_module, "_WAIT_MS", 20)
    events, reads, read = [], [], PylonCamera.read
    monkeypatch.setattr(PylonCamera, "read", lambda camera, index: reads.append(index) or read(camera, index))
    camera = LiveSource("test", lambda: PylonCamera(trigger="Software"), listener=events.append, silence_s=0.001)
    with camera as source:
        while len(reads) < 5:
            time.sleep(0.01)
        emulator.command("TriggerSoftware")
        frame = next(iter(source))
    assert frame.index == 0
    assert not events
    device = PylonCamera(fps=0.4)  # as one that is slow
    try:
        assert all(device.read(0) is not None for _ in range(4))
    finally:
        device.close()


def test_a_clock_that_jumps_is_said(emulator, monkeypatch):
    from pypylon import pylon

    began_ns, seen = time.monotonic_ns(), []

    def ticks(result):
        seen.append(result.GetBlockID())
        return time.monotonic_ns() - began_ns + 10**9 + (0 if len(seen) < 5 else 10**13)

    monkeypatch.setattr(pylon.GrabResult, "GetTimeStamp", ticks)
    events, times = [], []
    with open_source("pylon:?fps=50", listener=events.append) as source:
        for frame in source:
            times.append(frame.time_s)
            assert frame.metadata["timed_by"] == "camera"
            if len(times) == 10:
                break
    assert [e.kind for e in events] == ["clock"]
    assert "moved apart by 1e+04 s" in events[0].message
    assert np.all(np.diff(times) > 0)
    assert abs(times[-1] - time.time()) < 60  # not the 10,000 s of the jump, on a busy machine


# Parts of the sensor


def test_a_part_of_the_sensor_is_its_middle_with_the_colours_in_order(emulator, tmp_path):
    with open_source("pylon:?width=42&height=30&pixel_format=BayerRG16") as source:
        frame = next(iter(source))
    assert frame.metadata["region_px"] == [42, 32, 42, 30]  # even offsets, of (128 - 42) / 2 and (96 - 30) / 2
    sites = mosaic_of(seen_by(emulator), "RGGB")[32:62, 42:84]
    np.testing.assert_array_equal(frame.counts, superpixels(sites, "RGGB", black_level=0, white_level=65535)[0])
    with Recorder(tmp_path / "walk") as recorder:
        recorder.write(frame)
    for spec in ("pylon:?width=64&height=48", f"replay:{tmp_path / 'walk'}"):
        with pytest.raises(InputError, match="64x48: set width"), open_source(spec, camera_size_px=(64, 48)) as source:
            next(iter(source))
    with open_source("pylon:?width=64&height=48", camera_size_px=(32, 24)) as source:
        next(iter(source))


# From the driver to millimetres


def test_depth_through_the_camera_agrees_with_the_direct_reading(emulator):
    """A sensor of twice the sample's pixels each way: what one pixel of the sample is, is a cell of its mosaic."""
    camera, image = open_sample("still_life_cy_halves", quality="real-time", device="cpu")
    counts = cv2.imread(str(sample_image("still_life_cy_halves")), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert counts.max() < 1024  # 10 bits
    larger = cv2.resize(counts.astype(np.float32) * 64, None, fx=2, fy=2, interpolation=cv2.INTER_LANCZOS4)
    seen = np.rint(larger).clip(0, 65535).astype(np.uint16)
    emulator.show(seen)
    sensor = camera.calibration.sensor
    levels = {"black_level": sensor.black_level * 4, "white_level": sensor.white_level * 4}
    size_px = sensor.width_px, sensor.height_px
    with open_source("pylon:?pixel_format=BayerRG12", camera_size_px=size_px, **levels) as source:
        frame = next(iter(source))
    sites, encoding = superpixels(mosaic_of(seen >> 4, "RGGB"), "RGGB", **levels)
    np.testing.assert_array_equal(frame.image, Frame(sites, encoding, 0.0, 0).image)  # the driver loses nothing
    direct, depth = camera.measure(image).depth_mm, camera.measure(frame.image).depth_mm
    both = np.isfinite(depth) & np.isfinite(direct)
    assert both.mean() > 0.95
    # All of it is the mosaic's: R and B are sampled beside the middle of the cell, and interpolated there.
    assert np.median(np.abs(depth / direct - 1)[both]) < 0.01
