"""Camera files of strangers: nothing they name is opened, nothing they declare is allocated, every value is checked."""

import os
import re
import struct
import subprocess
import sys
import threading
import zlib

import pytest

from chromaperture.model.camera_file import Calibration
from chromaperture.system.errors import InputError
from test_camera_file import make_calibration


@pytest.fixture
def good(tmp_path):
    """A camera file with arrays in blocks."""
    path = tmp_path / "camera.asdf"
    make_calibration("free").save(path)
    return path


def with_text(path, old, new):
    data = path.read_bytes()
    changed = re.sub(old.encode(), lambda match: new.encode(), data, count=1)
    assert changed != data
    path.write_bytes(changed)
    return path


WATCHED = {"open", "socket.connect", "socket.getaddrinfo", "os.open", "subprocess.Popen", "urllib.Request"}
SEEN: list[tuple[str, str]] = []
WATCHING = threading.Event()


def watch(event, arguments):
    if WATCHING.is_set() and event in WATCHED:
        SEEN.append((event, str(arguments[0])))


sys.addaudithook(watch)  # for the rest of the process: Python has no way back


def opened_while_loading(path):
    """What the reader opens or connects to, besides the file itself."""
    SEEN.clear()
    WATCHING.set()
    try:
        with pytest.raises(InputError) as error:
            Calibration.load(path)
    finally:
        WATCHING.clear()
    assert "\n" not in str(error.value)
    return [(event, what) for event, what in SEEN if what != str(path) and not what.isdigit()]  # not its descriptor


@pytest.mark.parametrize(
    "source",
    ["/etc/passwd", "file:///etc/passwd", "other.asdf", "ftp://127.0.0.1/x.asdf", "http://127.0.0.1:9/x", "/dev/zero",
     "fifo", "-1", "99", "true", "1e0", "0x0", "!core/integer-1.0.0 0"],
)  # fmt: skip
def test_an_array_from_elsewhere_is_refused_unopened(good, source):
    Calibration.load(good)  # asdf opens its own schemas, once
    make_calibration("free").save(good.parent / "other.asdf")
    os.mkfifo(good.parent / "fifo")
    with_text(good, "source: 0", f"source: {source}")
    assert opened_while_loading(good) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r"design: cy_halves", "design: {$ref: 'file:///etc/passwd'}"),
        (r"design: cy_halves", "design: {$ref: 'http://127.0.0.1:9/x#/a'}"),
        (r"design: cy_halves", "design: !!python/object/apply:os.system ['true']"),
        (r"design: cy_halves", "design: !core/externalarray-1.0.0 {fileuri: /etc/passwd}"),
        (r"design: cy_halves", "design: !<tag:example.org,2026:own-1.0.0> {}"),
        (r"shape: \[2, 3\]", "shape: [20000, 30000]"),
        (r"shape: \[2, 3\]", "shape: ['*', 3]"),
        (r"shape: \[2, 3\]", "shape: [2, 3]\n          strides: [0, 0]"),
        (r"shape: \[2, 3\]", "shape: [2, 3]\n          mask: 0"),
        (r"shape: \[2, 3\]", "shape: [-2, -3]"),
        (r"datatype: float32", "datatype: [{name: a, datatype: float32}]"),
        (r"datatype: float32", "datatype: [ascii, 4]"),
        (r"datatype: float32", "datatype: float64"),
        (r"&id001 !core/ndarray-1.1.0", "&id001 !core/ndarray-1.1.0 [1, 2] #"),
        (r"design: cy_halves", "design: &a [*a, *a]"),
        (r"design: cy_halves", "design: " + 100 * "[" + 100 * "]"),
        (r"design: cy_halves", "design: " + ":".join(30_000 * ["1"])),
        (r"design: cy_halves", "design: [" + 300_000 * "1," + "]"),
        (r"design: cy_halves", "&a [1,1,1,1,1,1,1,1,1,1]: 1\n  design: cy_halves"),
    ],
)
def test_what_a_camera_file_has_no_use_for_is_refused_unopened(good, old, new):
    Calibration.load(good)
    with_text(good, old, new)
    assert opened_while_loading(good) == []


def test_aliases_that_multiply_are_counted(good):
    levels = "".join(f"\n  a{i + 1}: &a{i + 1} [{', '.join(10 * [f'*a{i}'])}]" for i in range(8))
    with_text(good, "  design: cy_halves", "  a0: &a0 [1, 1]" + levels + "\n  design: cy_halves")
    with pytest.raises(InputError, match="too large"):
        Calibration.load(good)


def blocks_of(data):
    """Where the blocks of a file begin."""
    starts, at = [], data.index(b"\xd3BLK")
    while data[at : at + 4] == b"\xd3BLK":
        starts.append(at)
        at += 54 + struct.unpack_from(">Q", data, at + 6 + 8)[0]
    return starts


def with_block(path, *, compression=b"\0\0\0\0", body=None, unpacked=None, flags=0, allocated=None, length=48):
    """Replace the first block."""
    data = path.read_bytes()
    start, following = blocks_of(data)[:2]
    body = data[start + 54 : following] if body is None else body
    sizes = (len(body) if allocated is None else allocated, len(body), len(body) if unpacked is None else unpacked)
    header = b"\xd3BLK" + struct.pack(">HI4sQQQ16s", length, flags, compression, *sizes, bytes(16))
    path.write_bytes(data[:start] + header + body + data[following:])
    return path


@pytest.mark.parametrize(
    "block",
    [
        {"compression": b"zlib", "body": zlib.compress(bytes(24)), "unpacked": 24},
        {"compression": b"bzp2"},
        {"compression": b"none"},
        {"unpacked": 2**40},
        {"allocated": 2**63},
        {"flags": 1},
        {"length": 20},
        {"body": bytes(20)},
    ],
)
def test_blocks_that_need_unpacking_or_lie_about_their_size_are_refused(good, block):
    Calibration.load(good)
    with_block(good, **block)
    with pytest.raises(InputError, match="block"):
        Calibration.load(good)


def test_a_changed_bit_of_a_map_is_found(good):
    data = bytearray(good.read_bytes())
    data[blocks_of(data)[0] + 54] ^= 1
    good.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        Calibration.load(good)


def test_two_megabytes_that_unpack_to_two_gigabytes_take_no_memory(good):
    packed = zlib.compress(bytes(10_000_000), 9) * 50  # as many bytes as 500 MB of zeros take
    with_block(good, compression=b"zlib", body=packed, unpacked=500_000_000)
    with_text(good, r"shape: \[2, 3\]", "shape: [12500, 10000]")
    program = (
        "import resource, sys\n"
        "from chromaperture.model.camera_file import Calibration\n"
        "from chromaperture.system.errors import InputError\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try: Calibration.load(sys.argv[1])\n"
        "except InputError: print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, good], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 50_000  # kB; the file itself has 0.5 MB


NUMBERS = ["width_px", "pixel_pitch_mm", "black_level", "white_level", "full_well_electrons", "read_noise_electrons",
           "focal_length_mm", "f_number", "near_mm", "far_mm", "format_version"]  # fmt: skip


@pytest.mark.parametrize("value", ["x", "'5'", "true", ".nan", ".inf", "[1]", "{a: 1}", "-1", "2026-11-22"])
@pytest.mark.parametrize("name", NUMBERS)
def test_every_number_is_checked(tmp_path, name, value):
    path = tmp_path / "camera.asdf"
    make_calibration().save(path)
    if (name, value) == ("black_level", "-1"):
        return  # sensors without an offset scatter below zero
    with_text(path, rf"\b{name}: [^\n,}}]+", f"{name}: {value}")
    with pytest.raises(InputError, match=f"{name}|damaged"):
        Calibration.load(path)


@pytest.mark.parametrize("array", ["camera_matrix", "distortion", "clear", "cyan", "covariance", "scale_px_mm"])
@pytest.mark.parametrize(
    "value", ["x", "['1', '2', '3']", "[true, true, true]", "[.nan, 1, 1]", "5", "[[1], [2, 3]]", "{}"]
)
def test_every_array_is_checked(tmp_path, array, value):
    path = tmp_path / "camera.asdf"
    make_calibration().save(path)
    if (array, value) == ("scale_px_mm", "5"):
        return  # one number holds for the whole frame
    with_text(path, rf"\b{array}:[ \n-]*\[(?:[^\[\]]|\[[^\[\]]*\])*\](?:\n *- \[[^\[\]]*\])*", f"{array}: {value}")
    with pytest.raises(InputError, match=f"{array}|damaged"):
        Calibration.load(path)


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "camera.asdf")  # nobody writes into it
    for path, word in ((tmp_path / "camera.asdf", "regular"), ("/dev/zero", "regular"), (tmp_path, "directory")):
        with pytest.raises(InputError, match=word):
            Calibration.load(path)
    with pytest.raises(InputError, match="no camera file"):
        Calibration.load(tmp_path / ("n" * 5000))
