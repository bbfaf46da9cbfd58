"""Reading image files: right values, and one clear line for everything that cannot be used."""

import io
import os
import struct
import subprocess
import sys
import textwrap
import tracemalloc
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from chromaperture.capture.checks import check_capture
from chromaperture.capture.exif import Exif, read_exif
from chromaperture.capture.files import image_size, read_image
from chromaperture.products.samples import sample_camera
from chromaperture.system.errors import CaptureWarning, InputError, MissingDependencyError
from worlds import png_of


@pytest.fixture
def counts(rng):
    return rng.integers(20, 1000, (24, 32, 3)).astype(np.uint16)


def write_png(path, counts):
    assert cv2.imwrite(str(path), np.ascontiguousarray(counts[..., ::-1]))
    return path


def test_sixteen_bit_png_keeps_every_count(tmp_path, counts):
    path = write_png(tmp_path / "a.png", counts)
    image = read_image(path, black_level=16, white_level=1016)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image * 1000 + 16, counts, atol=1e-3)  # float32 at 1000 is good to 6e-5


@pytest.mark.parametrize("suffix", [".tif", ".ppm"])
def test_every_deep_format_gives_the_same_image(tmp_path, counts, suffix):
    png = read_image(write_png(tmp_path / "a.png", counts), black_level=0, white_level=1023)
    other = tmp_path / f"b{suffix}"
    if suffix == ".tif":
        tifffile.imwrite(other, counts, photometric="rgb")
    else:
        header = b"P6\n# a comment\n32 24\n65535\n"
        other.write_bytes(header + counts.astype(">u2").tobytes())
    np.testing.assert_array_equal(read_image(other, black_level=0, white_level=1023), png)


def test_eight_bit_photographs_are_decoded_from_srgb(tmp_path):
    # Values tabulated in IEC 61966-2-1 implementations: sRGB 128 is 21.586 % of white.
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[..., 0], picture[..., 1] = 128, 255
    Image.fromarray(picture).save(tmp_path / "a.png")
    image = read_image(tmp_path / "a.png")
    np.testing.assert_allclose(image[0, 0], [0.2158605, 1.0, 0.0], atol=1e-6)  # float32
    # Levels say that the file holds linear counts after all.
    np.testing.assert_allclose(read_image(tmp_path / "a.png", white_level=255)[0, 0, 0], 128 / 255, rtol=1e-6)


def test_float_tiff_is_linear_light(tmp_path, rng):
    light = rng.random((16, 16, 3), dtype=np.float32)
    tifffile.imwrite(tmp_path / "a.tif", light, photometric="rgb")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), light)


def test_small_counts_in_a_deep_file_are_warned_of(tmp_path, counts):
    with pytest.warns(CaptureWarning, match="white-level"):
        read_image(write_png(tmp_path / "a.png", counts))


def test_grey_pictures_are_refused(tmp_path, rng):
    grey = rng.integers(0, 255, (16, 16)).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "one.png")
    Image.fromarray(np.repeat(grey[..., None], 3, axis=2)).save(tmp_path / "three.png")
    for name in ("one.png", "three.png"):
        with pytest.raises(InputError, match="grey"):
            read_image(tmp_path / name)


@pytest.mark.parametrize("dark", [0, 5])
def test_saturated_pictures_are_not_called_grey(tmp_path, dark):
    picture = np.full((24, 32, 3), 1023, np.uint16)
    picture.reshape(-1, 3)[:dark] = 16  # of 768 pixels: a black corner is no colour either
    image = read_image(write_png(tmp_path / "a.png", picture), black_level=16, white_level=1023)
    with pytest.raises(InputError, match="saturated") as error:
        check_capture(image, 32, 24)
    assert "grey" not in str(error.value)


@pytest.mark.parametrize("keep", [0.0, 0.01, 0.5, 0.98, 0.999])
def test_truncated_png_is_refused(tmp_path, counts, keep):
    data = write_png(tmp_path / "a.png", counts).read_bytes()
    (tmp_path / "b.png").write_bytes(data[: int(keep * len(data))])
    with pytest.raises(InputError, match=r"b\.png"):
        read_image(tmp_path / "b.png")


def test_flipped_bit_in_a_png_is_refused(tmp_path, counts):
    data = bytearray(write_png(tmp_path / "a.png", counts).read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "b.png").write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        read_image(tmp_path / "b.png")


@pytest.mark.parametrize("levels", [(100, 100), (200, 100), (float("nan"), 1000), (0, float("inf"))])
def test_levels_that_make_no_sense_are_refused(tmp_path, counts, levels):
    path = write_png(tmp_path / "a.png", counts)
    with pytest.raises(InputError, match="level"):
        read_image(path, black_level=levels[0], white_level=levels[1])


def test_missing_folder_and_raw_files_say_so(tmp_path):
    for name in ("none.png", "photo.CR2", "photo.dng"):
        with pytest.raises(InputError, match="cannot read"):
            read_image(tmp_path / name)
    with pytest.raises(InputError, match="cannot read"):
        read_image(tmp_path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=400))
def test_any_bytes_are_refused_in_one_line(tmp_path, data):
    path = tmp_path / "noise.png"
    path.write_bytes(data)
    with pytest.raises((InputError, MissingDependencyError)) as error:  # bytes that begin as RAW files do
        read_image(path)
    assert "\n" not in str(error.value)


def declared(kind, width, height):
    """A file of each format that declares a size, and holds less."""
    if kind == "tiff":
        memory = io.BytesIO()
        tifffile.imwrite(memory, np.ones((8, 16, 3), np.uint16), photometric="rgb")
        data = memory.getvalue()
        for tag, old, new in ((256, 16, width), (257, 8, height), (278, 8, height)):
            for code in ("HHIH", "HHII"):
                short = struct.pack("<" + code, tag, 3 if code[-1] == "H" else 4, 1, old)
                data = data.replace(short[:8] + short[8:].ljust(4, b"\0"), struct.pack("<HHII", tag, 4, 1, new))
        return data
    if kind == "ppm":
        return b"P6\n%d %d\n65535\n" % (width, height) + bytes(99)
    if kind == "bmp":
        header = struct.pack("<IHHIIiiHHIIiiII", 200, 0, 0, 54, 40, width, height, 1, 24, 0, 0, 1, 1, 0, 0)
        return b"BM" + header + bytes(99)
    if kind == "jpeg":
        memory = io.BytesIO()
        Image.new("RGB", (16, 8), (9, 80, 200)).save(memory, "JPEG", subsampling=0)
        return memory.getvalue().replace(b"\x00\x08\x00\x10\x03", struct.pack(">HH", height, width) + b"\x03")
    return png_of(width, height)


@pytest.mark.parametrize("kind", ["png", "tiff", "ppm", "bmp", "jpeg"])
def test_the_size_is_read_from_the_header_before_anything_is_decoded(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    path.write_bytes(declared(kind, 13_000, 12_000))
    assert image_size(path) == (13_000, 12_000)  # of a file that cannot be decoded
    with pytest.raises(InputError, match=r"13000x12000 px but the camera was calibrated at 720x480"):
        read_image(path, size_px=(720, 480))
    with pytest.raises(InputError, match=r"damaged|not a TIFF|cut off"):
        read_image(path)
    path.write_bytes(declared(kind, 40_000, 40_000))
    for read in (read_image, image_size):
        with pytest.raises(InputError, match=r"40000"):
            read(path)


def test_a_photograph_of_another_size_than_the_cameras_is_refused_by_its_header(run, tmp_path):
    (tmp_path / "photo.png").write_bytes(png_of(13_000, 13_000))
    code, _, complaint = run("depth", tmp_path / "photo.png", "--camera", sample_camera("still_life_cy_halves"))
    assert (code, complaint.count("\n")) == (2, 1)
    assert "13000x13000" in complaint


@pytest.mark.parametrize("size", [(0, 8), (8, 0)])
def test_pictures_without_pixels_are_refused(tmp_path, size):
    for kind in ("tiff", "ppm", "bmp"):
        (tmp_path / "a").write_bytes(declared(kind, *size))
        for read in (read_image, image_size):
            with pytest.raises(InputError, match=r"pixel|damaged"):
                read(tmp_path / "a")


def tiff_chain(pages):
    """A TIFF file of many tiny pages."""
    body = struct.pack("<2sHI", b"II", 42, 8)
    for i in range(pages):
        tags = ((256, 8), (257, 8), (258, 8), (259, 1), (262, 1), (273, 8), (277, 1), (278, 8), (279, 64))
        body += struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", t, 4, 1, v) for t, v in tags)
        body += struct.pack("<I", len(body) + 4 if i < pages - 1 else 0)
    return body


def test_only_the_first_pages_of_a_tiff_are_looked_at(tmp_path, monkeypatch):
    """Finding the pages of a hostile file, and the series they form, takes minutes."""
    (tmp_path / "a.tif").write_bytes(tiff_chain(160))  # 18 KB
    pages, seek = [], tifffile.TiffPages._seek
    monkeypatch.setattr(tifffile.TiffPages, "_seek", lambda self, index: pages.append(index) or seek(self, index))
    with (
        pytest.raises(InputError, match="grey"),
        pytest.warns(CaptureWarning, match="more than one picture of this size"),
    ):
        read_image(tmp_path / "a.tif")
    assert set(pages) <= set(range(33))


def test_a_strip_that_unpacks_to_more_than_it_holds_is_refused(tmp_path):
    memory = io.BytesIO()
    tifffile.imwrite(memory, np.zeros((8, 16, 3), np.uint16), photometric="rgb", compression="zlib", rowsperstrip=8)
    data = memory.getvalue()
    packed = zlib.compress(bytes(50_000_000), 9)
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        offset, count = file.pages.first.dataoffsets[0], file.pages.first.databytecounts[0]
    for old, new in ((offset, len(data)), (count, len(packed))):
        data = data.replace(struct.pack("<II", 1, old), struct.pack("<II", 1, new)).replace(
            struct.pack("<HIHH", 4, 1, old, 0), struct.pack("<HII", 4, 1, new)
        )
    path = tmp_path / "a.tif"
    path.write_bytes(data + packed)
    tracemalloc.start()
    with pytest.raises(InputError, match="damaged"):
        read_image(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5_000_000  # bytes; the strip unpacks to 50 MB


@pytest.mark.parametrize("cut", [0.3, 0.7, 0.999])
def test_a_cut_tiff_is_no_picture_with_a_black_end(tmp_path, counts, cut):
    tifffile.imwrite(tmp_path / "a.tif", counts, photometric="rgb")
    data = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(data[: int(cut * len(data))])
    with pytest.raises(InputError, match=r"a\.tif"):
        read_image(tmp_path / "a.tif", white_level=1000)


def test_libraries_log_nothing_before_the_one_line(tmp_path):
    """In a process of its own, without handlers: Python prints warnings of libraries then."""
    files = {"a.png": png_of(50_000, 50_000), "b.tif": tiff_chain(3)[:-40], "c.tif": b"II*\0" + bytes(range(200)),
             "d.jpg": declared("jpeg", 13_000, 12_000), "e.ppm": b"P6\n30 20\n65535\nshort"}  # fmt: skip
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    program = """
        import sys
        from chromaperture.capture.exif import read_exif
        from chromaperture.capture.files import read_image
        from chromaperture.system.errors import InputError
        for path in sys.argv[1:]:
            read_exif(path)
            try: read_image(path)
            except InputError: print("refused")
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program), *(tmp_path / name for name in files)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stderr == ""
    assert done.stdout.split() == ["refused"] * len(files)


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "a.png")  # nobody writes into it
    for path in (tmp_path / "a.png", "/dev/zero"):
        for read in (read_image, image_size):
            with pytest.raises(InputError, match="regular"):
                read(path)
        assert read_exif(path) == Exif()
    with pytest.raises(InputError, match="cannot read"):
        read_image("n" * 5000 + ".png")
