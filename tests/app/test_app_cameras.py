"""Cameras that the computer holds, for the assistant: folders, videos, live cameras that come and go."""

from __future__ import annotations

import threading
import time

import cv2
import numpy as np
import pytest

from apps import FACTS, call, served
from chromaperture.app.camera_feed import CameraFeed, preview_jpeg, write_frame
from chromaperture.app.session_folder import SessionFolder
from chromaperture.capture.files import read_image
from chromaperture.capture.source import Frame
from chromaperture.capture.threaded_source import DeviceLostError, LiveSource
from chromaperture.color.encoding import Encoding
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.system.errors import InputError
from waiting import until

pytestmark = pytest.mark.extra("serve", "starlette")


@pytest.fixture
def folder(pictures):
    """The source of `pictures`, in the order of their names."""
    return f"{pictures}?black_level=16&white_level=1016"


@pytest.fixture
def feeds():
    """A function that makes feeds, which are released at the end."""
    made = []

    def make(spec, **options):
        made.append(CameraFeed(str(spec), **options))
        return made[-1]

    yield make
    for feed in made:
        feed.close()
    until(lambda: not [t for t in threading.enumerate() if t.name.startswith(("feed ", "idle ", "capture "))])


class Camera:
    """A live camera that can be taken away; every frame's counts are its number."""

    def __init__(self):
        self.index, self.is_there, self.opened, self.closed = 0, True, 0, 0

    def connect(self):
        if not self.is_there:
            raise InputError("webcam:0 cannot be opened: another program uses it")
        self.opened += 1
        return self

    def read(self, index):
        time.sleep(0.005)
        if not self.is_there:
            raise DeviceLostError("unplugged")
        self.index += 1
        counts = np.full((8, 12, 3), self.index % 60000 + 100, np.uint16)
        return Frame(counts, Encoding(64, 60000), time.time(), index, {"exposure_us": 4000})

    def close(self):
        self.closed += 1


@pytest.fixture
def camera(monkeypatch):
    camera = Camera()
    monkeypatch.setattr(
        "chromaperture.app.camera_feed.open_source",
        lambda spec, listener=None: LiveSource(spec, camera.connect, listener=listener, silence_s=0.2, retry_s=0.02),
    )
    return camera


# ---- frames


def test_a_folder_gives_one_picture_when_asked_and_no_other(folder, feeds):
    feed = feeds(folder)
    assert (feed.live, feed.name) == (False, "bench camera")
    first = feed.next_frame()
    np.testing.assert_array_equal(feed.shown_frame().counts, first.counts)  # asked for again, it stays the same
    assert [feed.next_frame().index, feed.next_frame().index] == [1, 2]
    with pytest.raises(InputError, match="bench camera has no more pictures"):
        feed.next_frame()
    assert feed.next_frame().index == 0  # anew


def test_a_live_camera_gives_its_newest_picture(camera, feeds):
    feed = feeds("webcam:0")
    feed.next_frame()
    before = camera.index
    until(lambda: camera.index > before + 10)
    assert feed.next_frame().counts[0, 0, 0] - 100 >= before + 10
    assert camera.opened == 1


def test_a_camera_that_is_taken_away_is_one_sentence_and_comes_back(camera, feeds):
    feed = feeds("webcam:0", wait_s=0.5)
    feed.next_frame()
    camera.is_there = False
    until(lambda: camera.closed)
    with pytest.raises(InputError, match=r"webcam:0 gives no picture \(webcam:0 is gone \(unplugged\)"):
        feed.next_frame()
    camera.is_there = True
    until(lambda: camera.opened == 2)
    feed.next_frame()


def test_a_camera_that_another_program_uses_is_one_sentence(camera, feeds):
    camera.is_there = False
    feed = feeds("webcam:0")
    with pytest.raises(InputError, match="another program uses it"):
        feed.next_frame()
    camera.is_there = True
    feed.next_frame()


def test_a_camera_that_nobody_looks_at_is_released(camera, feeds):
    feed = feeds("webcam:0", idle_s=0.2)
    feed.next_frame()
    until(lambda: camera.closed == 1)
    feed.next_frame()  # and opened again
    assert camera.opened == 2


def test_a_driver_that_fails_is_one_sentence(monkeypatch, feeds):
    class Broken:
        live = True

        def __enter__(self):
            raise RuntimeError("driver")

        def __exit__(self, *error):
            pass

    monkeypatch.setattr("chromaperture.app.camera_feed.open_source", lambda spec, listener=None: Broken())
    with pytest.raises(InputError, match=r"webcam:0 failed \(RuntimeError: driver\)"):
        feeds("webcam:0").next_frame()


def test_names_do_not_tell_folders(tmp_path):
    for spec in (f"replay:{tmp_path}/walk", f"{tmp_path}/walk", f"{tmp_path}/walk?loop=1"):
        assert CameraFeed(spec).name in ("replay:walk", "walk")
    with pytest.raises(InputError, match="unknown kind"):
        CameraFeed("camera:0")


# ---- photographs of them


UNSTATED = {name: value for name, value in FACTS.items() if "level" not in name}
OFFSETS = ((0.25, 0.25), (0, 0), (-0.25, -0.25))


def frame_of(light, encoding, dtype=np.uint16):
    counts = encoding.black_level + light * (encoding.white_level - encoding.black_level)
    return Frame(counts.astype(dtype) if dtype is np.float32 else np.rint(counts).astype(dtype), encoding, 0.0, 0)


@pytest.mark.parametrize(
    ("encoding", "dtype", "facts", "levels", "tolerance"),
    [
        (Encoding(64, 1023), np.uint16, UNSTATED, (64, 1023), 1e-6),  # counts stay as they are
        (Encoding(0.0, 1.0), np.float32, UNSTATED, (2048, 63488), 1e-5),  # of floats, wide levels: a step is 1.6e-5
        (Encoding(128, 2046, channel_offsets_px=OFFSETS), np.uint16, UNSTATED, (64, 1023), 6e-4),
        (Encoding(0, 65535), np.uint16, FACTS, (16, 1016), 6e-4),  # half a count
    ],
    ids=["counts", "float", "superpixels", "stated"],
)
def test_a_linear_frame_is_kept_with_its_levels_or_those_of_the_session(
    tmp_path, rng, encoding, dtype, facts, levels, tolerance
):
    session = SessionFolder.create(tmp_path / "bench", facts)
    light = cv2.GaussianBlur(rng.uniform(0.1, 0.9, (20, 30, 3)).astype(np.float32), (0, 0), 3)
    frame, path = frame_of(light, encoding, dtype), tmp_path / "shot.png"
    write_frame(frame, path, session)
    assert (session.facts.black_level, session.facts.white_level) == levels
    found = read_image(path, black_level=levels[0], white_level=levels[1])
    np.testing.assert_allclose(found, frame.image, atol=tolerance)


def test_a_frame_of_a_webcam_stays_of_8_bits(tmp_path, rng):
    session = SessionFolder.create(tmp_path / "bench", UNSTATED)
    counts = rng.integers(0, 255, (20, 30, 3), np.uint8)
    path = tmp_path / "shot.png"
    write_frame(Frame(counts, Encoding(0, 255, "srgb", given=False), 0.0, 0), path, session)
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1], counts)
    assert session.facts.white_level is None


def test_the_preview_is_as_exposed_and_small():
    light = np.full((1000, 2400, 3), 0.25, np.float32)
    picture = cv2.imdecode(np.frombuffer(preview_jpeg(frame_of(light, Encoding(64, 1023))), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (334, 800, 3)
    expected = int(linear_to_srgb_bytes(np.array([0.25], np.float32))[0])
    np.testing.assert_allclose(picture, expected, atol=1)


# ---- the server


@pytest.mark.parametrize("number", ["1", "-1", "00000", "x", "%2e%2e", "0%20", "webcam:0"])
def test_no_other_camera_can_be_named(tmp_path, folder, number):
    with served(tmp_path / "app", feeds=[CameraFeed(folder)]) as app:
        for method, path in (("GET", f"/api/sources/{number}/picture"), ("DELETE", f"/api/sources/{number}")):
            status, text, _ = call(app, method, path)
            assert status in (400, 404, 405), text
        where = f"/api/sessions/none/shots?kind=tilt&source={number}"
        status, text, _ = call(app, "POST", where)
        assert (status, b"no such camera" in text) == (400, True)
        assert call(app, "GET", "/api/sources", token="wrong")[0] == 403
