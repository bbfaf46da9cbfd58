"""Recordings: what was acknowledged is there, whatever happens; and comes back bit by bit."""

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import textwrap
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from chromaperture.capture import recording
from chromaperture.capture.open import open_source
from chromaperture.capture.recording import Recorder
from chromaperture.capture.source import Frame
from chromaperture.color.encoding import Encoding
from chromaperture.products.posed_sequence import write_tum
from chromaperture.products.rectified import View
from chromaperture.products.samples import sample_camera, sample_image
from chromaperture.system.errors import CaptureWarning, InputError

SHIFTED = Encoding(64, 1023, "linear", ((-0.25, -0.25), (0.0, 0.0), (0.25, 0.25)))


def frame(index, dtype=np.uint16, encoding=SHIFTED):
    counts = (np.random.default_rng(index).random((12, 16, 3)) * 250).astype(dtype)
    return Frame(counts, encoding, 1.75e9 + index / 30, 2 * index, {"gain": 1.5, "file": "a"})


def replayed(folder, events=None):
    with open_source(f"replay:{folder}", listener=None if events is None else events.append) as source:
        return list(source)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_frames_come_back_as_they_were(tmp_path, dtype):
    made = [frame(i, dtype) for i in range(3)]
    with Recorder(tmp_path / "walk") as recorder:
        for f in made:
            recorder.write(f)
    for new, old in zip(replayed(tmp_path / "walk"), made, strict=True):
        assert new.counts.dtype == dtype
        np.testing.assert_array_equal(new.counts, old.counts)
        np.testing.assert_array_equal(new.image, old.image)
        assert (new.encoding, new.time_s, new.index, new.metadata) == (
            old.encoding, old.time_s, old.index, old.metadata)  # fmt: skip


def test_what_was_acknowledged_survives_kill(tmp_path):
    script = textwrap.dedent("""
        import sys
        import numpy as np
        from chromaperture.capture.recording import Recorder
        from chromaperture.capture.source import Frame
        from chromaperture.color.encoding import Encoding
        with Recorder(sys.argv[1]) as recorder:
            for i in range(100000):
                recorder.write(Frame(np.full((64, 64, 3), i % 60000, np.uint16), Encoding(), float(i), i))
                print(i, flush=True)
    """)
    folder = tmp_path / "walk"
    process = subprocess.Popen([sys.executable, "-c", script, str(folder)], stdout=subprocess.PIPE, text=True)
    for line in process.stdout:
        if int(line) == 5:
            os.kill(process.pid, signal.SIGKILL)
            break
    acknowledged = [5, *map(int, process.stdout.read().split())][-1]
    process.stdout.close()
    assert process.wait() == -signal.SIGKILL
    events = []
    frames = replayed(folder, events)
    assert [e.kind for e in events] == ["dark"]  # frame 0 holds zeros
    assert len(frames) >= acknowledged + 1
    assert all((f.counts == f.index).all() for f in frames)


@pytest.mark.parametrize("cut", [1, 40, 10**6])
def test_a_torn_last_line_is_no_frame(tmp_path, cut):
    with Recorder(tmp_path) as recorder:
        for i in range(3):
            recorder.write(frame(i))
    index = tmp_path / "index.jsonl"
    lines = index.read_bytes().splitlines(keepends=True)
    index.write_bytes(b"".join(lines[:2]) + lines[2][:-1][:cut])  # its newline was never written
    assert [f.index for f in replayed(tmp_path)] == [0, 2]


def test_a_damaged_picture_is_said_and_left_out(tmp_path):
    with Recorder(tmp_path) as recorder:
        for i in range(3):
            recorder.write(frame(i))
    picture = tmp_path / "frames" / "00000001.tiff"
    data = bytearray(picture.read_bytes())
    data[-10] ^= 1
    picture.write_bytes(data)
    (tmp_path / "frames" / "00000002.tiff").unlink()
    events = []
    assert [f.index for f in replayed(tmp_path, events)] == [0]
    assert [e.kind for e in events] == ["skipped", "skipped"]


class FullDisk:
    """Stands in for ``os.write``: takes so many bytes, then none."""

    def __init__(self, room):
        self.room, self.write = room, os.write

    def __call__(self, file, data):
        if self.room <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = self.write(file, bytes(data[: self.room]))
        self.room -= written
        return written


@pytest.mark.parametrize("room", [30, 200, 1000, 3000, 4000, *range(4190, 4320, 16)])
def test_a_full_disk_loses_nothing_acknowledged(tmp_path, monkeypatch, room):
    disk = FullDisk(10**9)
    monkeypatch.setattr(recording.os, "write", disk)
    folder, acknowledged = tmp_path / "walk", 0
    with Recorder(folder) as recorder:
        disk.room = room
        with pytest.raises(InputError, match="disk is full"):
            for i in range(100):
                recorder.write(frame(i))
                acknowledged = i + 1
        disk.room = 10**9
        assert len(list((folder / "frames").iterdir())) == acknowledged
        recorder.write(frame(50))  # room was made
    frames = replayed(folder)
    assert len(frames) == acknowledged + 1
    for new, old in zip(frames, [*map(frame, range(acknowledged)), frame(50)], strict=True):
        np.testing.assert_array_equal(new.counts, old.counts)


def test_a_recording_is_never_written_over(tmp_path):
    with Recorder(tmp_path) as recorder:
        recorder.write(frame(0))
    with pytest.raises(InputError, match="already"), Recorder(tmp_path):
        pass
    assert len(replayed(tmp_path)) == 1


def test_record_and_replay_from_the_command_line(run, tmp_path):
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.png"), frame(i).counts[..., ::-1])
    walk = tmp_path / "walk"
    code, said, _ = run("record", tmp_path / "*.png", "--out", walk, "--json",
                        "--black-level", 64, "--white-level", 1023)  # fmt: skip
    assert code == 0
    assert json.loads(said)["frames"] == 3
    for i, f in enumerate(replayed(walk)):
        np.testing.assert_array_equal(f.counts, frame(i).counts)
        assert f.encoding == Encoding(64, 1023)
    code, *_ = run("record", "webcam:77", "--out", tmp_path / "new")
    assert (code, (tmp_path / "new").exists()) == (2, False)


def recorded(folder, counts, header=None, **encoding):
    """Write a recording of one frame; with a header, as the first format wrote it."""
    with Recorder(folder) as recorder:
        recorder.write(Frame(counts, Encoding(**encoding), 0.0, 0))
    if header:
        (folder / "recording.json").write_text(json.dumps({"format": header}))
        index = folder / "index.jsonl"
        index.write_text(re.sub(r', "line_crc32": "\w{8}"', "", index.read_text()))
    return f"replay:{folder}"


def encoding_of(spec, **settings):
    with open_source(spec, **settings) as source:
        return next(iter(source)).encoding


def test_levels_that_nobody_gave_are_recorded_as_null_and_the_cameras_win(run, tmp_path):
    cv2.imwrite(str(tmp_path / "0.png"), frame(0).counts[..., ::-1])
    walk = tmp_path / "walk"
    assert run("record", tmp_path / "0.png", "--out", walk, "-q")[0] == 0
    entry = json.loads((walk / "index.jsonl").read_text())["encoding"]
    assert (entry["black_level"], entry["white_level"]) == (None, None)
    with pytest.warns(CaptureWarning, match="white-level"):
        assert encoding_of(f"replay:{walk}") == Encoding(0, 65535)
    assert encoding_of(f"replay:{walk}", camera_encoding=Encoding(16, 1016)) == Encoding(16, 1016)
    assert encoding_of(f"replay:{walk}", camera_encoding=Encoding(16, 1016), white_level=900) == Encoding(16, 900)
    assert encoding_of(f"replay:{walk}?black_level=8&white_level=700") == Encoding(8, 700)
    camera = sample_camera("still_life_cy_halves")  # with it, its levels are given
    assert run("record", tmp_path / "0.png", "--out", tmp_path / "given", "-q", "--camera", camera)[0] == 0
    assert encoding_of(f"replay:{tmp_path / 'given'}", camera_encoding=Encoding(0, 4095)) == Encoding(16, 1016)


OFFSETS = SHIFTED.channel_offsets_px
SUPERPIXELS = {"black_level": 100, "white_level": 2046, "channel_offsets_px": OFFSETS, "given": False}


@pytest.mark.parametrize(
    ("stored", "settings", "expected"),
    [
        # Levels that were given are replaced by the reader's only.
        ({"black_level": 64, "white_level": 1023}, {"camera_encoding": Encoding(16, 1016)}, Encoding(64, 1023)),
        ({"black_level": 64, "white_level": 1023}, {"white_level": 900}, Encoding(64, 900)),
        # Levels of superpixels are those of the mosaic.
        (SUPERPIXELS, {}, Encoding(100, 2046, "linear", OFFSETS)),
        (SUPERPIXELS, {"camera_encoding": Encoding(16, 1016)}, Encoding(32, 2032, "linear", OFFSETS)),
        (SUPERPIXELS, {"black_level": 60}, Encoding(120, 2046, "linear", OFFSETS)),
    ],
)
def test_levels_that_count(tmp_path, stored, settings, expected):
    assert encoding_of(recorded(tmp_path, frame(0).counts, **stored), **settings) == expected


def test_recordings_of_the_first_format_are_read(tmp_path):
    first = "chromaperture recording 1"
    guessed = recorded(tmp_path / "a", frame(0).counts, header=first)  # 0 and 65535: nobody gave them
    given = recorded(tmp_path / "b", frame(0).counts, header=first, black_level=64, white_level=1023)
    assert encoding_of(guessed, camera_encoding=Encoding(16, 1016)) == Encoding(16, 1016)
    assert encoding_of(given, camera_encoding=Encoding(16, 1016)) == Encoding(64, 1023)


DATA = Path(__file__).parents[1] / "data" / "recordings"


@pytest.mark.filterwarnings("ignore::chromaperture.system.errors.CaptureWarning")
@pytest.mark.parametrize("version", [1, 2])
def test_recordings_of_every_past_format_replay_as_they_were_made(version):
    """Each was made by the release whose format it has, from these numbers."""
    rng, events = np.random.default_rng(5), []
    settings = {"listener": events.append, "camera_encoding": Encoding(16, 1016)}
    with open_source(f"replay:{DATA / f'format_{version}'}", **settings) as source:
        frames = list(source)
    assert events == []
    assert [f.index for f in frames] == [0, 2, 4, 7, 8]
    for i, f in enumerate(frames):
        low, high, kind = ((20, 1000, np.uint16), (0, 1000, np.uint16), (0, 250, np.uint8))[max(0, i - 2)]
        np.testing.assert_array_equal(f.counts, rng.integers(low, high, (6, 8, 3)).astype(kind))
        assert f.encoding == (Encoding(0, 255, "srgb") if i == 4 else Encoding(16, 1016))
        assert f.metadata == ({"gain": 1.5} if i < 3 else {})
        assert f.time_s == 1.75e9 + (i / 30 if i < 3 else i - 2)


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line.replace(b'"white_level": 1023', b'"white_level": 102'),
        lambda line: line.replace(b'"index": 2', b'"index": 3'),
        lambda line: b"[1, 2]",
        lambda line: b"null",
        lambda line: b"",
        lambda line: line[:-20],
        lambda line: line.replace(b"file", b"fil\xff"),
        lambda line: b"[" * 100_000,
        lambda line: b"1" * 10_000,
    ],
)
def test_a_damaged_line_costs_its_own_frame_and_says_so(tmp_path, damage):
    with Recorder(tmp_path) as recorder:
        for i in range(3):
            recorder.write(frame(i))
    index = tmp_path / "index.jsonl"
    lines = index.read_bytes().split(b"\n")
    assert damage(lines[1]) != lines[1]
    index.write_bytes(b"\n".join([lines[0], damage(lines[1]), *lines[2:]]))
    events = []
    assert [f.index for f in replayed(tmp_path, events)] == [0, 4]
    assert [event.kind for event in events] == ["skipped"]
    assert "line 2 of" in events[0].message
    assert "\n" not in events[0].message


@pytest.mark.filterwarnings("ignore::chromaperture.system.errors.CaptureWarning")
@pytest.mark.parametrize(
    "change",
    [
        {"file": "../../secret.tiff"},
        {"file": "/etc/passwd"},
        {"file": "00000000.tiff\n"},
        {"file": "link.tiff"},
        {"file": 0},
        {"index": "0"},
        {"index": -1},
        {"time_s": None},
        {"time_s": float("nan")},
        {"crc32": "x"},
        {"encoding": None},
        {"encoding": {"black_level": 0}},
        {"metadata": [1]},
        {"more": 1},
    ],
)
def test_lines_of_the_second_format_are_checked_value_by_value(tmp_path, change):
    folder = tmp_path / "walk"
    shutil.copytree(DATA / "format_2", folder)
    shutil.copy(folder / "frames" / "00000000.tiff", tmp_path / "secret.tiff")
    lines = (folder / "index.jsonl").read_text().splitlines()
    lines[0] = json.dumps(json.loads(lines[0]) | change)
    (folder / "index.jsonl").write_text("\n".join(lines) + "\n")
    events = []
    assert [f.index for f in replayed(folder, events)] == [2, 4, 7, 8]
    assert [event.kind for event in events] == ["skipped"]


@pytest.mark.filterwarnings("ignore::chromaperture.system.errors.CaptureWarning")
@pytest.mark.parametrize("kind", ["fifo", "link", "folder"])
def test_only_regular_files_are_read(tmp_path, kind):
    folder = tmp_path / "walk"
    shutil.copytree(DATA / "format_2", folder)
    picture = folder / "frames" / "00000000.tiff"
    shutil.move(picture, tmp_path / "elsewhere.tiff")
    if kind == "fifo":
        os.mkfifo(picture)  # nobody writes into it
    elif kind == "link":
        picture.symlink_to(tmp_path / "elsewhere.tiff")
    else:
        picture.mkdir()
    events = []
    assert [f.index for f in replayed(folder, events)] == [2, 4, 7, 8]
    assert [event.kind for event in events] == ["skipped"]
    (folder / "index.jsonl").unlink()
    os.mkfifo(folder / "index.jsonl")
    with pytest.raises(InputError, match="no recording"):
        replayed(folder)


def test_a_line_says_what_it_always_said(tmp_path):
    """Other programs read the index as JSON lines."""
    with Recorder(tmp_path) as recorder:
        recorder.write(frame(1))
    entry = json.loads((tmp_path / "index.jsonl").read_text())
    body = (tmp_path / "index.jsonl").read_bytes().split(b', "line_crc32"')[0]
    assert int(entry.pop("line_crc32"), 16) == zlib.crc32(body)
    assert entry["crc32"] == zlib.crc32(frame(1).counts.tobytes())
    assert set(entry) == {"file", "index", "time_s", "crc32", "encoding", "metadata"}
    assert json.loads((tmp_path / "recording.json").read_text())["format"] == "chromaperture recording 3"


def test_a_black_frame_in_the_midst_is_left_out_of_an_export(run, tmp_path):
    camera = sample_camera("still_life_cy_halves")
    (tmp_path / "frames").mkdir()
    picture = cv2.imread(str(sample_image("still_life_cy_halves")), cv2.IMREAD_UNCHANGED)
    for i, light in enumerate((1, 0, 1)):
        cv2.imwrite(str(tmp_path / "frames" / f"{i}.png"), light * picture)
    code, _, complaint = run("export", tmp_path / "frames", tmp_path / "tum", "--camera", camera, "-q")
    assert code == 0, complaint
    assert "frame 1 is left out: the image is all black" in complaint
    assert len(list((tmp_path / "tum" / "rgb").iterdir())) == 2
    code, _, complaint = run("export", tmp_path / "frames" / "1.png", tmp_path / "none", "--camera", camera, "-q")
    assert code == 2
    assert "all black" in complaint
    assert not (tmp_path / "none").exists()


def test_the_folder_of_a_recording_is_known_as_one(run, tmp_path):
    with Recorder(tmp_path / "walk") as recorder:
        recorder.write(frame(1))
    code, _, complaint = run("export", tmp_path / "walk", tmp_path / "out", "--camera",
                             sample_camera("still_life_cy_halves"))  # fmt: skip
    assert code == 2
    assert f"give replay:{tmp_path / 'walk'}" in complaint


# Export: a wall that other readers must find where it is.


def walls():
    z = np.full((6, 8), 1234.4, np.float32)
    z[0, 0], z[0, 1], z[0, 2] = np.nan, 70_000, 0
    sigma = 0.01 * z
    sigma[0, 3:5] = 0.11 * z[0, 3:5]  # more than the tenth that is exported
    confidence = np.linspace(0, 1, z.size, dtype=np.float32).reshape(z.shape)
    color = np.random.default_rng(0).integers(0, 256, (6, 8, 3)).astype(np.uint8)
    return [View(color, z, sigma, 1.75e9 + i / 8, i, confidence) for i in range(2)]


MATRIX = np.array([[500.0, 0, 4], [0, 501, 3], [0, 0, 1]])


def test_tum_folder_as_its_readers_expect(tmp_path):
    folder = tmp_path / "tum"
    assert write_tum(folder, walls(), camera_matrix=MATRIX) == 2
    rows = [line.split() for line in (folder / "associations.txt").read_text().splitlines()]
    for (stamp, rgb, same, depth), expected in zip(rows, walls(), strict=True):
        assert float(stamp) == float(same) == pytest.approx(expected.time_s, abs=1e-6)  # six decimals are written
        np.testing.assert_array_equal(cv2.imread(str(folder / rgb))[..., ::-1], expected.color)
        metres = cv2.imread(str(folder / depth), cv2.IMREAD_UNCHANGED) / 5000
        assert metres[0, :5].tolist() == [0, 0, 0, 0, 0]
        sigma = cv2.imread(str(folder / depth.replace("depth/", "sigma/")), cv2.IMREAD_UNCHANGED) / 5
        assert (sigma[0, 0], sigma[0, 2]) == (0, 0.2)  # unknown, and none: the least that is not unknown
        np.testing.assert_allclose(sigma[0, 3:], expected.sigma_mm[0, 3:], atol=0.1)  # half a count; whole, not cut
        confidence = cv2.imread(str(folder / depth.replace("depth/", "confidence/")), cv2.IMREAD_UNCHANGED) / 255
        np.testing.assert_allclose(confidence, expected.confidence, atol=0.5 / 255)  # half a count
        assert np.abs(metres[1:] - 1.2344).max() <= 0.0001  # half a count
    write_tum(tmp_path / "all", walls(), camera_matrix=MATRIX, max_relative_sigma=0.2)
    assert (cv2.imread(str(tmp_path / "all" / depth), cv2.IMREAD_UNCHANGED)[0, 3:5] > 0).all()
    with pytest.raises(InputError, match="exists"):
        write_tum(folder, walls(), camera_matrix=MATRIX)
    with pytest.raises(InputError, match="no frame"):
        write_tum(tmp_path / "none", [], camera_matrix=MATRIX)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["all", "tum"]


def test_export_measures_the_sample_and_takes_the_pupil_as_origin(run, tmp_path):
    walk = tmp_path / "tum"
    code, said, complaint = run("export", sample_image("still_life_cy_halves"), walk, "--camera",
                                sample_camera("still_life_cy_halves"), "-q")  # fmt: skip
    assert (code, said) == (0, ""), complaint
    (picture,) = (walk / "depth").iterdir()
    z_mm = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED) / 5.0
    options = ("--camera", sample_camera("still_life_cy_halves"), "--out", tmp_path / "depth", "--quality=real-time")
    code, *_ = run("depth", sample_image("still_life_cy_halves"), *options, "-q")
    depth_mm = cv2.imread(str(tmp_path / "depth" / "still_life_cy_halves.depth.png"), cv2.IMREAD_UNCHANGED)
    camera_info = run("info", sample_camera("still_life_cy_halves"), "--json").stdout
    delta = json.loads(camera_info)["sensor_to_pupil_mm"]
    both = (z_mm > 0) & (depth_mm > 0)
    assert both.mean() > 0.2  # 0.96 is found
    assert np.median(depth_mm[both] - z_mm[both]) == pytest.approx(delta, abs=0.6)  # whole mm and fifths
