"""The source of a Raspberry Pi's camera against a stand-in of picamera2's documented interface: no Pi was at hand."""

from __future__ import annotations

import sys
import time
import types

import numpy as np
import pytest

from chromaperture.capture import picamera
from chromaperture.capture.bayer import PATTERNS
from chromaperture.capture.open import connected_sources, open_source
from chromaperture.capture.picamera import mosaic_of, order_of_red_card
from chromaperture.system.errors import InputError, MissingDependencyError

BLACK = 256  # of 12 bits, as imx477 has it: 4096 of 16
LIGHT = {"R": 2400, "G": 700, "B": 500}  # counts of 12 bits above black, at 1000 µs and gain 1: a red card
# Modes of the High Quality Camera as picamera2 lists them (issue 405): named for the sensor as it is, before rotation.
MODES = [
    {"size": (1332, 990), "bit_depth": 10, "fps": 120.05, "crop_limits": (696, 528, 2664, 1980), "unpacked": "SRGGB10"},
    {"size": (2028, 1080), "bit_depth": 12, "fps": 50.03, "crop_limits": (0, 440, 4056, 2160), "unpacked": "SRGGB12"},
    {"size": (2028, 1520), "bit_depth": 12, "fps": 40.01, "crop_limits": (0, 0, 4056, 3040), "unpacked": "SRGGB12"},
    {"size": (4056, 3040), "bit_depth": 12, "fps": 10.0, "crop_limits": (0, 0, 4056, 3040), "unpacked": "SRGGB12"},
]
# The same smaller, so that a frame takes no time.
SMALL = [m | {"size": tuple(n // 20 // 2 * 2 for n in m["size"])} for m in MODES]


class Request:
    def __init__(self, camera, metadata):
        self.camera, self.metadata, self.released = camera, metadata, False

    def make_array(self, name):
        assert name == "raw"
        return self.camera.raw_array(self.metadata)

    def get_metadata(self):
        return self.metadata

    def release(self):
        self.released = True


class StandIn:
    """What the manual says of `Picamera2`: the calls that are used, and how late and how exactly controls act."""

    delivered = "SBGGR12"  # the board turns the sensor by half a turn
    true_order = "BGGR"
    stride_bytes = 64  # rows are padded to a multiple
    delay = 3  # frames until a control acts
    obeys = True
    stops_after = None
    camera_controls: dict = {"ExposureTime": (60, 10**8, 0), "AnalogueGain": (1.0, 22.0, 1.0)}  # noqa: RUF012
    sensor_modes = SMALL
    made: list = []  # noqa: RUF012

    @staticmethod
    def global_camera_info():
        return [{"Num": 0, "Model": "imx477", "Id": "/base/soc/i2c0mux/i2c@1/imx477@1a"}]

    def __init__(self, number):
        self.running = self.closed = False
        self.frames, self.pending, self.requests = 0, [], []
        self.state = {"AeEnable": True, "ExposureTime": 20000, "AnalogueGain": 8.0}
        StandIn.made.append(self)

    def create_video_configuration(self, main, raw, controls):
        return {"main": main, "raw": dict(raw), "controls": controls}

    def configure(self, configuration):
        self.configuration = configuration
        self.asked = configuration["raw"]["format"]
        configuration["raw"]["format"] = self.delivered

    def camera_configuration(self):
        return self.configuration

    def set_controls(self, controls):
        assert not set(controls) - {"AeEnable", "AwbEnable", "ExposureTime", "AnalogueGain", "AfMode", "LensPosition"}
        self.pending.append((self.frames + self.delay, controls))

    def start(self):
        self.running = True

    def stop(self):
        self.running = False

    def close(self):
        self.closed = True

    def capture_request(self, wait=True):
        assert self.running
        if self.stops_after is not None and self.frames >= self.stops_after:
            raise TimeoutError
        self.frames += 1
        for due, controls in list(self.pending):
            if self.frames >= due:
                self.state |= controls
                self.pending.remove((due, controls))
        if self.state["AeEnable"] or not self.obeys:  # automatic exposure goes towards 1000 µs and gain 1
            self.state["ExposureTime"] = 1000 + 0.7 * (self.state["ExposureTime"] - 1000)
            self.state["AnalogueGain"] = 1 + 0.7 * (self.state["AnalogueGain"] - 1)
        metadata = {
            "ExposureTime": int(self.state["ExposureTime"] // 9 * 9),  # whole lines
            "AnalogueGain": self.state["AnalogueGain"],
            "SensorBlackLevels": (4096,) * 4,
            "SensorTimestamp": time.clock_gettime_ns(time.CLOCK_BOOTTIME) - 50_000_000,
        }
        self.requests.append(Request(self, metadata))
        return self.requests[-1]

    def raw_array(self, metadata):
        width, height = self.configuration["raw"]["size"]
        scale = metadata["ExposureTime"] * metadata["AnalogueGain"] / 1000
        mosaic = np.empty((height, width), np.uint16)
        for i, colour in enumerate(self.true_order):
            mosaic[i // 2 :: 2, i % 2 :: 2] = min(4095, BLACK + round(LIGHT[colour] * scale))
        if self.delivered.endswith("16"):
            mosaic <<= 4
        row = -(-2 * width // self.stride_bytes) * self.stride_bytes
        padded = np.full((height, row // 2), 0xFFFF, np.uint16)
        padded[:, :width] = mosaic
        return padded.view(np.uint8)


@pytest.fixture
def pi(monkeypatch):
    """A picamera2 to import; its class can be changed."""
    module = types.ModuleType("picamera2")
    module.Picamera2 = type("Picamera2", (StandIn,), {})
    monkeypatch.setitem(sys.modules, "picamera2", module)
    StandIn.made.clear()
    return module.Picamera2


def first_frame(spec):
    with open_source(spec) as source:
        return next(iter(source))


@pytest.mark.parametrize("delivered", ["SBGGR12", "SBGGR16", "BGGR16"])  # the last two as on a Raspberry Pi 5
def test_counts_levels_and_order_are_those_of_the_sensor(pi, delivered):
    pi.delivered = delivered
    frame = first_frame("picamera2:0?exposure_us=1000&gain=1&red_card=1")
    assert frame.counts.shape == (38, 50, 3)  # half of 100x76, the whole field at 40 frames a second
    # Twice the mosaic's counts; 1000 µs are 999 in whole lines.
    expected = [2 * (BLACK + round(LIGHT[c] * 0.999)) for c in "RGB"]
    np.testing.assert_array_equal(frame.counts, np.broadcast_to(expected, frame.counts.shape))
    assert (frame.encoding.black_level, frame.encoding.white_level) == (2 * BLACK, 2 * 4095)
    assert frame.metadata == {"exposure_us": 999.0, "gain": 1.0, "pattern": "BGGR"}
    assert frame.time_s == pytest.approx(time.time() - 0.05, abs=2)  # s; a busy machine
    (camera,) = StandIn.made
    assert camera.asked == "SRGGB12"
    assert camera.state["AeEnable"] is camera.state["AwbEnable"] is False
    assert camera.closed
    assert all(request.released for request in camera.requests)


def test_exposure_that_nobody_gave_is_found_and_kept(pi):
    with open_source("picamera2") as source:
        metadata = [next(iter(source)).metadata for _ in range(3)]
    assert metadata[0]["exposure_us"] == pytest.approx(1000, rel=0.02)
    assert metadata[0] == metadata[1] == metadata[2]
    assert StandIn.made[0].state["AeEnable"] is False


def test_a_wrong_order_is_found_by_the_red_card(pi):
    pi.true_order = "GRBG"
    with pytest.raises(InputError, match="pattern=GRBG"):
        first_frame("picamera2:0?exposure_us=1000&gain=1&red_card=1")
    assert StandIn.made[0].closed
    frame = first_frame("picamera2:0?exposure_us=1000&gain=1&red_card=1&pattern=GRBG")
    assert frame.counts[0, 0].argmax() == 0
    assert frame.metadata["pattern"] == "GRBG"


@pytest.mark.parametrize("order", PATTERNS)
def test_the_order_of_a_red_card(order):
    mosaic = np.empty((38, 50), np.uint16)
    for i, colour in enumerate(order):
        mosaic[i // 2 :: 2, i % 2 :: 2] = 64 + LIGHT[colour]
    mosaic[:4] = mosaic[:, :6] = 4000  # what surrounds the card
    assert order_of_red_card(mosaic, black_level=64) == order
    for wrong in (np.full((38, 50), 4095, np.uint16), np.full((38, 50), 64, np.uint16)):
        with pytest.raises(InputError, match="no red card"):
            order_of_red_card(wrong, black_level=64)


def test_modes_are_chosen_by_field_bits_and_speed():
    assert picamera.chosen_mode(MODES, None, None)["size"] == (2028, 1520)
    assert picamera.chosen_mode(MODES, 4056, None)["size"] == (4056, 3040)
    assert picamera.chosen_mode(MODES, None, 1080)["size"] == (2028, 1080)
    with pytest.raises(InputError, match=r"1332x990 \(10 bit, 120/s\)"):
        picamera.chosen_mode(MODES, 640, 480)


@pytest.mark.parametrize(
    ("spec", "change", "word"),
    [
        ("picamera2:3", {}, "there is 0"),
        ("picamera2:0", {"global_camera_info": staticmethod(lambda: [])}, "none is connected"),
        ("picamera2:0?width=640", {}, "choose from"),
        ("picamera2:0?pattern=RGBG", {}, "choose RGGB"),
        ("picamera2:0?lens_position=2", {}, "no motor"),
        ("picamera2:0?focus=2", {}, "no setting 'focus'"),
        ("picamera2:0?exposure_us=1000&gain=1", {"delivered": "BGGR_PISP_COMP1"}, "BGGR_PISP_COMP1, which is not read"),
        ("picamera2:0?exposure_us=1000&gain=1", {"delivered": "SBGGR12_CSI2P"}, "which is not read"),
        ("picamera2:0?exposure_us=90000&gain=1", {"obeys": False}, "does not keep"),
        ("picamera2:0?exposure_us=1000&gain=1", {"stops_after": 0}, "no frame"),
        ("picamera2:0", {"stops_after": 5}, "no frame"),
    ],
)
def test_what_cannot_be_used_is_one_line(pi, spec, change, word):
    for name, value in change.items():
        setattr(pi, name, value)
    with pytest.raises(InputError, match=word) as error:
        first_frame(spec)
    assert "\n" not in str(error.value)
    assert all(camera.closed for camera in StandIn.made)


def test_a_motor_is_held_where_it_was_told(pi):
    pi.camera_controls = StandIn.camera_controls | {"AfMode": (0, 2, 0), "LensPosition": (0.0, 15.0, 1.0)}
    first_frame("picamera2:0?exposure_us=1000&gain=1&lens_position=2.5")
    assert (StandIn.made[0].state["AfMode"], StandIn.made[0].state["LensPosition"]) == (0, 2.5)


def test_arrays_that_are_too_small_are_refused():
    with pytest.raises(InputError, match="unpacked"):
        mosaic_of(np.zeros((76, 150), np.uint8), (100, 76), 12, 12)  # 12 bits packed: 1.5 bytes a pixel
    eight = np.arange(24, dtype=np.uint8).reshape(4, 6)
    np.testing.assert_array_equal(mosaic_of(eight, (5, 4), 8, 8), eight[:, :5])


def test_the_camera_is_listed_and_its_absence_explained(pi, monkeypatch):
    assert {c.kind: c.specs for c in connected_sources()}["picamera2"] == ["picamera2:0"]
    monkeypatch.setitem(sys.modules, "picamera2", None)
    assert "apt install python3-picamera2" in {c.kind: c.note for c in connected_sources()}["picamera2"]
    with pytest.raises(MissingDependencyError, match="picamera2"):
        first_frame("picamera2:0")
