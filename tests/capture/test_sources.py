"""Sources: whatever the camera, frames come in order, on one grid, the newest first where they are live."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.capture.bayer import PATTERNS, superpixels
from chromaperture.capture.files import read_image
from chromaperture.capture.open import connected_sources, open_source
from chromaperture.capture.pixel_formats import best_format, unpack
from chromaperture.capture.source import FileSource, Frame
from chromaperture.capture.threaded_source import Arrival, DeviceLostError, LiveSource, StreamEndedError, played
from chromaperture.color.encoding import Encoding
from chromaperture.system.errors import CaptureWarning, InputError, MissingDependencyError

# Older PyGObject has an importer of the old kind.
pytestmark = pytest.mark.filterwarnings("ignore:DynamicImporter:ImportWarning")
LINEAR = Encoding(0, 1000)


def picture(seed=0, size=(24, 32)):
    return np.random.default_rng(seed).integers(100, 900, (*size, 3)).astype(np.uint16)


def write(path, counts):
    assert cv2.imwrite(str(path), counts[..., ::-1])
    return path


# Bayer: a smooth world seen by each channel where its photosites lie must come back the same in all of them.


def waves(x, y):
    return 500 + 300 * np.sin(2 * np.pi * (x + 0.6 * y) / 24)  # period 12 superpixels


@pytest.mark.parametrize("pattern", PATTERNS)
def test_channels_of_a_mosaic_come_back_on_one_grid(pattern):
    y, x = np.mgrid[:64, :96]
    grey = np.rint(waves(x, y)).astype(np.uint16)
    counts, encoding = superpixels(grey, pattern, black_level=0, white_level=1000)
    image = Frame(counts, encoding, 0.0, 0).image[4:-4, 4:-4]
    centres = waves(*np.meshgrid(np.arange(48) * 2 + 0.5, np.arange(32) * 2 + 0.5))[4:-4, 4:-4] / 1000
    # Rounding to counts is 0.0005; cubic interpolation of this wave errs by less than 0.001. Half a superpixel
    # between R and B, left as it is, would be 0.3 * 2 pi / 12 * 0.25 = 0.04.
    assert np.abs(image[..., [0, 2]] - centres[..., None]).max() < 2e-3
    # G is the mean of two photosites, which is their middle but for the curvature of the wave: (0.3/2)(2 pi/24)^2.
    assert np.abs(image[..., 1] - centres).max() < 0.012
    raw = counts[4:-4, 4:-4] / 2000
    assert np.abs(raw[..., 0] - raw[..., 2]).max() > 0.03  # the 0.04 named above


@given(
    pattern=st.sampled_from(PATTERNS), rows=st.integers(2, 9), columns=st.integers(2, 9), seed=st.integers(0, 99),
    white=st.sampled_from([255, 1023, 4095, 65535]),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_no_photosite_is_lost_or_lent_to_another_colour(pattern, rows, columns, seed, white):
    cells = np.random.default_rng(seed).integers(0, white + 1, (rows, columns)).astype(np.uint16)
    counts, encoding = superpixels(cells, pattern, black_level=0, white_level=white)
    assert encoding.white_level == 2 * white
    for i in range(rows // 2):
        for j in range(columns // 2):
            by_colour = {"R": [], "G": [], "B": []}
            for colour, value in zip(pattern, cells[2 * i : 2 * i + 2, 2 * j : 2 * j + 2].ravel(), strict=True):
                by_colour[colour].append(int(value))
            expected = [sum(v) * 2 // len(v) for v in by_colour.values()]
            assert counts[i, j].tolist() == expected


def test_bytes_of_a_machine_vision_camera():
    cells = np.arange(24, dtype="<u2").reshape(4, 6) * 100
    counts, encoding = unpack(cells.tobytes(), 6, 4, "BayerGB12")
    assert counts[0, 0].tolist() == [2 * cells[1, 0], cells[0, 0] + cells[1, 1], 2 * cells[0, 1]]
    assert encoding.white_level == 2 * 4095
    assert best_format(["Mono8", "BayerRG8", "BayerRG12", "RGB8"]) == "BayerRG12"
    assert best_format(["BayerGR8", "BayerGR12p", "BayerGR12Packed"]) == "BayerGR12p"
    with pytest.raises(InputError, match=r"Mono8.*monochrome"):
        best_format(["Mono8"])
    with pytest.raises(InputError, match="YUV"):
        unpack(b"", 2, 2, "YUV422Packed")
    with pytest.raises(InputError, match="half a picture: 40 bytes of 48"):
        unpack(cells.tobytes()[:40], 6, 4, "BayerGB12")


def packed(values, kind, bits):
    """Bytes of the standard's two ways to pack, bit by bit."""
    if kind == "p":  # one number of all bits, the first pixel lowest
        number = sum(int(v) << (bits * i) for i, v in enumerate(values))
        return number.to_bytes(-(-bits * len(values) // 8), "little")
    pairs = [(int(a), int(b)) for a, b in zip(values[::2], values[1::2], strict=True)]
    low = bits - 8
    return bytes(
        byte for a, b in pairs for byte in (a >> low, (a % 2**low) | (b % 2**low) << 4, b >> low)
    )


@pytest.mark.parametrize("kind", ["p", "Packed"])
@pytest.mark.parametrize("bits", [10, 12])
def test_packed_pixels_are_those_that_were_packed(kind, bits, rng):
    cells = rng.integers(0, 2**bits, (4, 6)).astype("<u2")
    found, encoding = unpack(packed(cells.ravel(), kind, bits), 6, 4, f"BayerRG{bits}{kind}")
    expected, _ = unpack(cells.tobytes(), 6, 4, f"BayerRG{bits}")
    np.testing.assert_array_equal(found, expected)
    assert encoding.white_level == 2 * (2**bits - 1)


def test_frames_that_do_not_arrive_are_counted_and_told_of():
    class Lossy:
        """Sends frames 0, 1, one that is broken, two that are lost, 5."""

        def __init__(self):
            picture_ = Frame(np.full((8, 8, 3), 500, np.uint16), LINEAR, 0.0, 0)
            self.sent = [Arrival(picture_), picture_, Arrival(incomplete=1, advice="use a shorter cable")]
            self.sent += [Arrival(picture_, lost=2)]

        def read(self, index):
            time.sleep(0.02)
            if not self.sent:
                raise StreamEndedError
            return self.sent.pop(0)

        def close(self):
            pass

    events = []
    with LiveSource("test", Lossy, listener=events.append) as source:
        indices = [frame.index for frame in source]
    assert indices == [0, 1, 5]
    assert vars(source.counts) == {"delivered": 3, "skipped": 0, "incomplete": 1, "lost": 2}
    assert source.counts.sent == 6
    assert [e.kind for e in events] == ["missing"]  # at once; the next only after a while
    assert "1 arrived incomplete, 0 not at all; use a shorter cable" in events[0].message


def test_what_helps_is_told_also_by_a_later_event(monkeypatch):
    class Lossy:
        """Sends whole frames until the second loss is told of."""

        def __init__(self):
            self.sent = [Arrival(incomplete=1, advice="a shorter cable"), Arrival(lost=1, advice="a slower camera")]

        def read(self, index):
            if len(events) == 2:
                raise StreamEndedError
            return self.sent.pop(0) if self.sent else Frame(np.full((8, 8, 3), 500, np.uint16), LINEAR, 0.0, 0)

        def close(self):
            pass

    monkeypatch.setattr("chromaperture.capture.threaded_source._REPORT_S", 0.05)
    events = []
    with LiveSource("test", Lossy, listener=events.append) as source:
        assert list(source)
    assert events[1].message.endswith("0 arrived incomplete, 1 not at all; a slower camera")


# Files


def test_a_folder_is_read_in_the_order_of_its_numbers(tmp_path):
    pictures = {n: picture(n) for n in (1, 2, 10)}
    for n, counts in pictures.items():
        write(tmp_path / f"frame{n}.png", counts)
    with open_source(str(tmp_path / "*.png"), white_level=1000, fps=10) as source:
        frames = list(source)
    assert [f.metadata["file"] for f in frames] == ["frame1.png", "frame2.png", "frame10.png"]
    assert [f.time_s for f in frames] == [0.0, 0.1, 0.2]
    for frame, (n, counts) in zip(frames, pictures.items(), strict=True):
        np.testing.assert_array_equal(frame.counts, counts)
        expected = read_image(tmp_path / f"frame{n}.png", white_level=1000)
        np.testing.assert_array_equal(frame.image, expected)


@pytest.mark.parametrize("where", ["", "/*.png", "/?.png"])
def test_settings_follow_the_path_of_pictures(tmp_path, where):
    for n in range(3):
        write(tmp_path / f"{n}.png", picture(n))
    spec = f"{tmp_path}{where}?fps=5&white_level=1000&black_level=8"
    with open_source(spec) as source:
        frames = list(source)
    assert not source.live
    assert [f.time_s for f in frames] == [0.0, 0.2, 0.4]
    assert frames[0].encoding == Encoding(8, 1000)
    with open_source(f"{tmp_path}{where}?fps=5&loop=0", white_level=1000) as source:
        assert len(list(source)) == 3  # loop=0 is what comes without it


def test_a_file_whose_name_looks_like_settings_is_read(tmp_path):
    path = write(tmp_path / "a?fps=5.png", picture())
    with open_source(str(path), white_level=1000) as source:
        assert len(list(source)) == 1


def test_odd_files_in_a_folder_are_said_and_skipped(tmp_path):
    write(tmp_path / "0.png", picture())
    write(tmp_path / "1.png", picture(size=(20, 20)))
    (tmp_path / "2.png").write_bytes(b"no picture")
    write(tmp_path / "3.png", np.full((24, 32, 3), [0, 1, 0], np.uint16))
    write(tmp_path / "4.png", picture(4))
    events = []
    with open_source(str(tmp_path), listener=events.append, white_level=1000) as source:
        assert [f.index for f in source] == [0, 3, 4]
    assert [e.kind for e in events] == ["size", "skipped", "dark"]


@pytest.mark.parametrize(
    ("spec", "word"),
    [
        ("webcam:77", "video77"),
        ("webcam:0?focus=3", "no setting 'focus'"),
        ("webcam:0?gain=high", "must be a number"),
        ("firewire:0", "unknown kind"),
        ("nowhere/", "no picture"),
        ("nowhere/*.png", "no picture"),
        ("nowhere.mkv", "no video"),
        ("replay:nowhere", "no recording"),
        ("replay:", "needs a folder"),
        ("simulate:nowhere", "no RGB-D sequence"),
        ("simulate:nowhere.toml", "no scene file"),
        ("simulate:.?speed=-1", "speed"),
        ("simulate:.?fps=0", "fps must be positive"),
        ("simulate:.?count=2.5", "whole number"),
        (".?fps=0", "fps must be positive"),
        (".?fps=fast", "must be a number"),
        (".?speed=0", "speed"),
        (".?loop=maybe", "loop must be 1 or 0"),
        (".?focus=3", "choose black_level, white_level, fps, mosaic, siting, primaries, speed, loop"),
        (".?camera_encoding=3", "no setting"),
        ("clip.mkv?fps=-1", "fps must be positive"),
        ("webcam?width=nan", "whole number"),
        ("aravis?focus=3", "no setting 'focus'"),
        ("gphoto2?focus=3", "no setting 'focus'"),
        ("pylon?focus=3", "no setting 'focus'"),
        ("gentl?focus=3", "no setting 'focus'"),
    ],
)
def test_a_source_that_is_not_there_says_so(spec, word):
    with pytest.raises(InputError, match=word), open_source(spec):
        pass


def test_every_kind_of_camera_is_listed_or_says_why_not():
    kinds = {c.kind: c for c in connected_sources()}
    assert set(kinds) == {"webcam", "aravis", "gphoto2", "picamera2", "pylon", "gentl"}
    assert all(c.specs or c.note for c in kinds.values())


# Live


class Camera:
    """Counts up at ``rate_hz``; unplugged after ``lasts`` frames."""

    def __init__(self, rate_hz=1000.0, lasts=None, error=DeviceLostError):
        self.pause, self.lasts, self.error, self.made, self.closed = 1 / rate_hz, lasts, error, 0, False

    def read(self, index):
        time.sleep(self.pause)
        if self.made == self.lasts:
            raise self.error("gone")
        self.made += 1
        return Frame(np.full((8, 8, 3), 500, np.uint16), LINEAR, time.time(), index)

    def close(self):
        self.closed = True


def test_a_slow_reader_gets_the_newest_frame_and_the_rest_is_counted():
    camera = Camera(rate_hz=200)
    with LiveSource("test", lambda: camera) as source:
        taken, behind = [], []
        for frame in source:
            taken.append(frame.index)
            behind.append(camera.made - 1 - frame.index)
            if len(taken) == 8:
                break
            time.sleep(0.05)
        dropped = source.dropped
        made = camera.made
    # One frame may arrive while the counters are read, and one may wait to be read.
    assert max(behind) <= 1
    assert -1 <= made - (len(taken) + dropped) <= 2
    assert dropped > 8
    assert taken == sorted(set(taken))
    assert camera.closed


def test_a_silent_camera_counts_as_lost():
    class Silent(Camera):
        def read(self, index):
            time.sleep(0.005)

    events, cameras = [], [Silent(), Camera()]
    with LiveSource("test", lambda: cameras.pop(0), listener=events.append, silence_s=0.05, retry_s=0.01) as source:
        assert next(iter(source)).counts.any()  # of the second camera: the first sends none
    assert [e.kind for e in events] == ["lost", "reconnected"]


def test_leaving_a_lost_camera_ends_the_thread():
    lost = threading.Event()
    cameras = [Camera(lasts=0)]

    def connect():
        if not cameras:
            raise InputError("not there")
        return cameras.pop()

    before = threading.active_count()
    with LiveSource("test", connect, listener=lambda event: lost.set(), retry_s=0.01):
        assert lost.wait(10)
    assert threading.active_count() == before


def test_errors_of_the_camera_reach_the_reader():
    broken = LiveSource("test", lambda: Camera(lasts=2, error=ZeroDivisionError))
    with pytest.raises(ZeroDivisionError), broken as source:
        for _ in source:
            pass

    def absent():
        raise InputError("camera in use")

    with pytest.raises(InputError, match="in use"), LiveSource("test", absent):
        pass


def test_a_stream_that_ends_delivers_its_last_frame():
    with LiveSource("test", lambda: Camera(lasts=5, error=StreamEndedError)) as source:
        assert [f.index for f in source][-1] == 4


class Three(FileSource):
    made = 0

    def frames(self):
        for index in range(3):
            self.made += 1
            yield Frame(np.full((8, 8, 3), 100 + index, np.uint16), LINEAR, index / 50, index)


def test_files_played_in_a_loop_are_read_once_and_keep_their_pace():
    source = Three("three")
    began, seen = time.monotonic(), {}
    with played(source, loop=True) as live:
        for frame in live:
            seen.setdefault(frame.index, int(frame.counts[0, 0, 0]))
            if frame.index >= 6:
                break
    assert source.made == 3
    assert all(value == 100 + index % 3 for index, value in seen.items())
    assert time.monotonic() - began >= 6 / 50  # six intervals; sleeping is never shorter


def test_one_picture_in_a_loop_keeps_the_usual_pace(tmp_path):
    write(tmp_path / "0.png", picture())
    began = time.monotonic()
    with open_source(f"{tmp_path / '0.png'}?loop=1", white_level=1000) as source:
        index = next(frame.index for frame in source if frame.index >= 4)
    assert index <= 30 * (time.monotonic() - began)  # frames a second; sleeping is never shorter


def test_a_scene_moves_past_the_simulated_camera(tmp_path):
    scene = tmp_path / "wall.toml"
    scene.write_text('[[plane]]\ncenter_mm = [0, 0, 2000]\nwidth_mm = 3000\ntexture = "speckle"\ntexel_mm = 6\n')
    spec = f"simulate:{scene}?width=128&height=96&count=13&design=open&focal_px=156&orbit_mm=125"
    with open_source(spec) as source:
        frames = list(source)
    first, quarter = (frames[i].image[..., 1].astype(np.float64) for i in (0, 12))
    moved, response = cv2.phaseCorrelate(first, quarter, cv2.createHanningWindow((128, 96), cv2.CV_64F))
    # Rounding.
    np.testing.assert_allclose(np.array(frames[12].metadata["camera_to_world_mm"])[:3, 3], [125, 125, 0], atol=1e-9)
    # 125 mm at 1950 mm from the pupil through 156 px: 10 px, against the camera's motion. Phase correlation of
    # aliased speckle is good to 0.2 px.
    assert moved == pytest.approx((-10, -10), abs=0.2)
    assert response > 0.1


# What needs an extra


TETHERED = """
import sys
from chromaperture.capture.open import connected_sources, open_source
from chromaperture.capture.pixel_formats import best_format, unpack
specs = connected_sources()[2].specs
assert specs, "no virtual camera"
with open_source(specs[0] + "?count=2") as source:
    for frame in source:
        print(frame.index, *frame.counts.shape)
"""


@pytest.mark.extra("cameras", "gphoto2")
def test_photographs_of_a_tethered_camera(tmp_path):
    import gphoto2

    drivers = Path(gphoto2.__file__).parent / "libgphoto2" / "vusb"
    if not drivers.is_dir():
        pytest.skip("this gphoto2 has no virtual USB camera")
    folder = tmp_path / "DCIM" / "100CANON"
    folder.mkdir(parents=True)
    write(folder / "IMG_0001.JPG", (picture() // 4).astype(np.uint8))
    environment = os.environ | {"IOLIBS": str(drivers), "VCAMERADIR": f"{tmp_path}/"}  # read when it is loaded
    made = subprocess.run(
        [sys.executable, "-c", TETHERED], capture_output=True, text=True, env=environment, timeout=60, check=False
    )
    assert made.returncode == 0, made.stderr
    assert made.stdout.splitlines() == ["0 12 16 3", "1 12 16 3"]  # of 4:2:0


def test_the_cameras_levels_serve_where_a_file_can_hold_them(tmp_path):
    write(tmp_path / "deep.png", picture())
    write(tmp_path / "flat.png", (picture() // 4).astype(np.uint8))
    with (
        open_source(str(tmp_path), camera_encoding=Encoding(16, 1016)) as source,
        pytest.warns(CaptureWarning, match="curve srgb"),
    ):
        deep, flat = (f.encoding for f in source)
    assert deep == Encoding(16, 1016)
    assert flat == Encoding(0, 255, "srgb")
    with open_source(str(tmp_path / "deep.png"), camera_encoding=Encoding(16, 1016), white_level=900) as source:
        assert next(iter(source)).encoding == Encoding(16, 900)


@pytest.mark.parametrize(
    ("module", "spec", "extra"),
    [("rawpy", "photo.cr2", "raw"), ("gi", "aravis:any", "cameras"), ("gphoto2", "gphoto2", "cameras"),
     ("pypylon", "pylon:any", "pylon"), ("harvesters", "gentl:any", "gentl")],
)
def test_a_missing_extra_is_named(tmp_path, monkeypatch, module, spec, extra):
    monkeypatch.setitem(sys.modules, module, None)  # importing it fails
    (tmp_path / "photo.cr2").write_bytes(b"RAW")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MissingDependencyError, match=rf"chromaperture\[{extra}\]"), open_source(spec) as source:
        next(iter(source))


@pytest.mark.parametrize(
    "spec", ["{}", "{}.png", "{}/*.png", "replay:{}", "simulate:{}", "simulate:{}.toml", "{}.mp4", "{}?fps=5"]
)
@pytest.mark.parametrize("name", ["n" * 5000, "/" + "n" * 300, "zero\0byte", "\udcff"])
def test_names_that_no_file_can_have_are_refused(spec, name):
    with pytest.raises(InputError), open_source(spec.format(name)) as source:
        list(source)


def test_digits_of_every_alphabet_may_stand_in_a_name(tmp_path):
    for name in ("a10", "a2", "a\u00b2", "a\u0663", "\u2460"):  # a superscript, an Arabic 3, a 1 in a circle
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.random.default_rng(0).integers(0, 255, (4, 4, 3), np.uint8))
    with open_source(str(tmp_path)) as source:
        files = [frame.metadata["file"] for frame in source]
    assert len(files) == 5
    assert files.index("a2.png") < files.index("a10.png")
