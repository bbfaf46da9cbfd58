"""Files as cameras and people leave them: RAW by other names, mosaics that are no Bayer ones, pairs, kinds of TIFF."""

from __future__ import annotations

import json
import re
import shutil
import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

import chromaperture as cap
from chromaperture.calibration.session import read_session
from chromaperture.capture.bayer import PATTERNS
from chromaperture.capture.exif import read_model
from chromaperture.capture.files import decode, format_of, image_size, is_encoded, opens_as_raw, read_image
from chromaperture.capture.open import open_source
from chromaperture.capture.shots import one_of_each
from chromaperture.color.encoding import StatedFacts
from chromaperture.model.camera_file import Calibration
from chromaperture.system.errors import CaptureWarning, InputError
from worlds import mosaic_of, write_dng

needs_rawpy = pytest.mark.extra("raw", "rawpy")
SAMPLE = "still_life_cy_halves"
CAMERA = cap.sample_camera(SAMPLE)


@pytest.fixture(scope="module")
def sites():
    """The sample capture as the mosaic of a sensor of twice its pixels: counts 16 to 1016."""
    return mosaic_of(cv2.imread(str(cap.sample_image(SAMPLE)), cv2.IMREAD_UNCHANGED)[..., ::-1])


def write_behind_preview(path, sites):
    """A DNG as makers build it: a small picture first, the mosaic in a sub-picture."""
    identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    head = [(274, "H", 1, 8, True), (272, "s", 0, "Test 5\0", False), (50706, "B", 4, bytes([1, 4, 0, 0]), False),
            (50708, "s", 0, "Test 5\0", False), (50721, "2i", 9, identity, False)]  # fmt: skip
    below = [(33421, "H", 2, (2, 2), False), (33422, "B", 4, bytes([0, 1, 1, 2]), False),
             (50714, "H", 1, 16, False), (50717, "I", 1, 1016, False)]  # fmt: skip
    preview = np.full((sites.shape[0] // 8, sites.shape[1] // 8, 3), 90, np.uint8)
    with tifffile.TiffWriter(path) as file:
        file.write(preview, photometric="rgb", subfiletype=1, subifds=1, extratags=head, metadata=None)
        file.write(sites, photometric=32803, subfiletype=0, extratags=below, metadata=None)


def patched(path, code, value):
    """Put another value of 16 bits into the first tag of a little-endian TIFF file."""
    data = bytearray(path.read_bytes())
    at = struct.unpack_from("<I", data, 4)[0]
    for i in range(struct.unpack_from("<H", data, at)[0]):
        if struct.unpack_from("<H", data, at + 2 + 12 * i)[0] == code:
            struct.pack_into("<HHII", data, at + 2 + 12 * i, code, 3, 1, value)
    path.write_bytes(data)
    return path


def refused(run, *command):
    """The one line with which a command ends, of exit code 2."""
    result = run(*command)
    assert result.returncode == 2, result.stderr
    (line,) = (each for each in result.stderr.splitlines() if not each.startswith("["))  # progress, after 10 s
    return line


# ---- RAW by content


@needs_rawpy
@pytest.mark.parametrize("name", ["a.pef", "a.nrw", "a.tif", "A.IIQ"])
def test_a_raw_file_is_known_by_what_it_holds(tmp_path, sites, name):
    write_behind_preview(tmp_path / "a.dng", sites)
    (tmp_path / "other").mkdir()
    path = shutil.copy(tmp_path / "a.dng", tmp_path / "other" / name)
    assert opens_as_raw(path)
    assert not is_encoded(path)
    assert image_size(path) == (sites.shape[1] // 2, sites.shape[0] // 2)
    np.testing.assert_array_equal(decode(path).array, decode(tmp_path / "a.dng").array)
    assert (format_of(path).turn_degrees, read_model(path)) == (270, "Test 5")


@pytest.mark.parametrize(
    ("start", "is_raw"),
    [(b"\0\0\0\x18ftypcrx ", True), (b"FUJIFILMCCD-RAW 0201", True), (b"IIU\0\x18\0\0\0", True), (b"IIRO\x08", True),
     (b"FOVb", True), (b"II*\0\x10\0\0\0CR\2\0", True), (b"\0\0\0\x18ftypheic", False), (b"\x89PNG", False),
     (b"II*\0", False), (b"", False)],
)  # fmt: skip
def test_marks_of_makers(tmp_path, start, is_raw):
    (tmp_path / "a.bin").write_bytes(start)
    assert opens_as_raw(tmp_path / "a.bin") == is_raw


def test_a_chain_of_pictures_without_end_is_looked_at_for_a_moment(tmp_path):
    entry = struct.pack("<HHHII", 1, 256, 4, 1, 1)
    chain = b"".join(entry + struct.pack("<I", 8 + (len(entry) + 4) * (i + 1)) for i in range(200_000))
    (tmp_path / "a.tif").write_bytes(b"II*\0\x08\0\0\0" + chain)
    assert not opens_as_raw(tmp_path / "a.tif")
    with pytest.raises(InputError):
        decode(tmp_path / "a.tif")


@needs_rawpy
def test_a_new_session_of_a_raw_file_by_another_name(run, tmp_path, sites):
    write_behind_preview(tmp_path / "a.srw", sites)
    assert run("session", "new", tmp_path / "s", "--photo", tmp_path / "a.srw").returncode == 0
    text = (tmp_path / "s" / "session.toml").read_text()
    assert all(line in text for line in ("width_px = 720", "height_px = 480", "black_level = 16", "white_level = 1016"))


# ---- levels of the photosites


@needs_rawpy
@pytest.mark.parametrize("dim", [2, 4])
@pytest.mark.parametrize("area", [(0, 0, 64, 96), (1, 3, 61, 91), (1, 4, 62, 92), (2, 4, 60, 90)])
def test_the_black_level_of_every_photosite_is_subtracted(tmp_path, dim, area):
    """The pattern and the levels begin at the active area, where LibRaw's begin at an even photosite."""
    y, x = np.indices((64, 96))
    y, x = y - area[0], x - area[1]
    black = 100 + 7 * np.arange(dim * dim).reshape(dim, dim)
    light = np.array([[1000, 2000], [2000, 3000]])[y % 2, x % 2]
    mosaic = (light + black[y % dim, x % dim]).astype(np.uint16)
    write_dng(tmp_path / "a.dng", mosaic, black=tuple(black.ravel().tolist()), black_dim=dim, white=4000,
              active_area=area)  # fmt: skip
    found = read_image(tmp_path / "a.dng")
    expected = np.array([1000, 2000, 3000]) / (4000 - black.mean())
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=1e-5)  # float32


# ---- mosaics that are no Bayer ones


def quad_of(sites):
    """The mosaic of a sensor with 2 x 2 photosites a colour, of the colours of an RGGB mosaic."""
    cells = [sites[::2, ::2], sites[::2, 1::2], sites[1::2, 1::2]]
    y, x = np.indices(sites.shape) // 2
    colour = y % 2 + x % 2
    return np.choose(colour, [np.repeat(np.repeat(cell, 2, 0), 2, 1) for cell in cells]).astype(np.uint16)


@needs_rawpy
@pytest.mark.parametrize("pattern", ["RGGB", "RRGGRRGGGGBBGGBB"])
def test_a_quad_bayer_mosaic_is_named(run, tmp_path, sites, pattern):
    write_dng(tmp_path / "a.dng", quad_of(sites), pattern=pattern, black=(16,), white=1016)
    line = refused(run, "depth", tmp_path / "a.dng", "--camera", CAMERA, "-o", tmp_path / "out")
    assert re.search("a.dng is a Quad-Bayer mosaic.*binned RAW", line)
    assert not (tmp_path / "out").exists()


@needs_rawpy
@pytest.mark.parametrize("levels", [(300, 300, 300), (301, 300, 299), (100, 400, 250)])
def test_grey_and_coloured_bayer_mosaics_are_not_taken_for_quad(tmp_path, rng, levels):
    """A picture in grey with steep shading and texture of one photosite, seen alike in all colours, is a Bayer one."""
    y, x = np.indices((128, 192))
    colour = y % 2 + x % 2
    texture = rng.uniform(0.2, 1.8, (128, 192)) * np.linspace(0.2, 1.8, 192)
    write_dng(tmp_path / "a.dng", (np.array(levels)[colour] * texture).astype(np.uint16))
    assert decode(tmp_path / "a.dng").array.shape == (64, 96, 3)


X_TRANS = "GRBGBR" "BGGRGG" "RGGBGG" "GBRGRB" "RGGBGG" "BGGRGG"  # fmt: skip


@needs_rawpy
@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("x-trans", "X-Trans mosaic.*dcraw -v -4 -q 0 -o 0 -r 1 1 1 1 -T a.dng"),
        ("foveon", "Foveon.*dcraw -v -4 -q 0 -o 0"),
        ("linear", "a linear DNG: demosaiced already"),
        ("lossy", "a DNG of lossy JPEG"),
        ("jpeg xl", "a DNG of JPEG XL"),
    ],
)
def test_other_kinds_of_raw_are_named_with_what_to_do(run, tmp_path, sites, kind, said):
    path = tmp_path / "a.dng"
    write_dng(path, sites, pattern=X_TRANS if kind == "x-trans" else "RGGB")
    if kind == "foveon":
        path.write_bytes(b"FOVb" + bytes(999))
    elif kind == "linear":
        tags = [(50706, "B", 4, bytes([1, 4, 0, 0]), False)]
        tifffile.imwrite(path, sites[:96, :96].reshape(96, 32, 3), photometric=34892, extratags=tags, metadata=None)
    elif kind in ("lossy", "jpeg xl"):
        patched(path, 259, 34892 if kind == "lossy" else 52546)
    line = refused(run, "depth", path, "--design", "cy_halves", "-o", tmp_path / "out")
    assert re.search(said, line), line
    assert "linear 16-bit TIFF without sharpening" not in line


# ---- grey files that are a mosaic


@needs_rawpy
@pytest.mark.parametrize("suffix", ["png", "tiff", "pgm"])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_grey_mosaic_is_read_like_raw(tmp_path, sites, suffix, pattern):
    write_dng(tmp_path / "a.dng", sites, pattern=pattern, black=(16,), white=1016)
    path = tmp_path / f"a.{suffix}"
    tifffile.imwrite(path, sites) if suffix == "tiff" else cv2.imwrite(str(path), sites)
    assert image_size(path, StatedFacts(mosaic=pattern)) == (720, 480)
    raw = read_image(tmp_path / "a.dng", black_level=16, white_level=1016)
    found = read_image(path, black_level=16, white_level=1016, mosaic=pattern)
    np.testing.assert_allclose(found, raw, atol=1e-6)


def test_a_mosaic_without_the_option_and_with_a_wrong_one(run, tmp_path, sites):
    cv2.imwrite(str(tmp_path / "a.png"), sites)
    line = refused(run, "depth", tmp_path / "a.png", "--camera", CAMERA)
    assert line.endswith("if it is the mosaic of a Bayer sensor, give --mosaic RGGB")
    assert "choose RGGB, BGGR, GRBG, GBRG" in refused(run, "depth", tmp_path / "a.png", "-c", CAMERA, "--mosaic", "RG")
    cv2.imwrite(str(tmp_path / "q.png"), quad_of(sites))
    assert "Quad-Bayer" in refused(run, "depth", tmp_path / "q.png", "-c", CAMERA, "--mosaic", "RGGB")


def test_depth_and_check_of_a_mosaic_and_of_a_camera_that_remembers_it(run, tmp_path, sites):
    cv2.imwrite(str(tmp_path / "a.png"), sites)
    wide = ("--write", "depth,json", "-o", tmp_path / "out", "--quality=real-time")
    assert run("depth", tmp_path / "a.png", "-c", CAMERA, "--mosaic", "RGGB", *wide).returncode == 0
    first = tifffile.imread(tmp_path / "out" / "a.depth.tiff")
    assert first.shape == (480, 720)
    options = ("-c", CAMERA, "--write", "depth", "--quality=real-time", "-o", tmp_path)
    assert run("depth", cap.sample_image(SAMPLE), *options).returncode == 0
    whole = tifffile.imread(next(tmp_path.glob("*.depth.tiff")))
    assert np.nanmedian(np.abs(first / whole - 1)) < 0.02  # the mosaic has been interpolated from the same picture
    known = Calibration.load(CAMERA)
    replace(known, sensor=replace(known.sensor, mosaic="RGGB")).save(tmp_path / "camera.asdf")
    assert Calibration.load(tmp_path / "camera.asdf").sensor.mosaic == "RGGB"
    assert run("depth", tmp_path / "a.png", "-c", tmp_path / "camera.asdf", *wide).returncode == 0
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out" / "a.depth.tiff"), first)
    found = run("check", tmp_path / "a.png", "-c", CAMERA, "--mosaic", "RGGB", "--json")
    assert json.loads(found.stdout)["photo"] == "a.png"
    encoding = known.sensor.encoding
    remembered = replace(encoding, stated=StatedFacts(mosaic="RGGB"))
    for source, settings in ((f"{tmp_path / 'a.png'}?mosaic=RGGB", encoding), (str(tmp_path / "a.png"), remembered)):
        with open_source(source, camera_encoding=settings) as frames:
            np.testing.assert_allclose(next(iter(frames)).image, read_image(
                tmp_path / "a.png", mosaic="RGGB", black_level=known.sensor.black_level,
                white_level=known.sensor.white_level), atol=1e-6)  # fmt: skip


def test_a_session_of_mosaics(run, tmp_path, sites):
    cv2.imwrite(str(tmp_path / "a.png"), sites)
    folder = tmp_path / "s"
    command = ("session", "new", folder, "--photo", tmp_path / "a.png", "--mosaic", "BGGR", "--sensor-width-mm", "22")
    assert run(*command).returncode == 0
    text = (folder / "session.toml").read_text()
    assert {'mosaic = "BGGR"', "width_px = 720"} <= set(text.splitlines())
    (folder / "session.toml").write_text(text.replace('"?"', "50"))
    (folder / "distances.csv").write_text("file,ruler_mm\nboard/a.png,1800\nboard/b.png,2200\n")
    for name in "ab":
        cv2.imwrite(str(folder / "board" / f"{name}.png"), sites)
    read = read_session(folder)
    assert read.sensor.mosaic == "BGGR"
    assert read.read(folder / "board" / "a.png").shape == (read.sensor.height_px, read.sensor.width_px, 3)
    cv2.imwrite(str(folder / "board" / "a.png"), (sites >> 2).astype(np.uint8))  # 8 bits, linear
    assert (read_session(folder).sensor.white_level, read_session(folder).sensor.curve) == (255, "linear")


# ---- what lies in a folder


@pytest.mark.parametrize(
    ("kind", "taken"),
    [("", "a.DNG B.cr2 c.png"), (".dng", "a.DNG B.cr2 c.png"), (".jpg", "A.jpg b.JPG c.png"),
     (".jpeg", "A.jpg b.JPG c.png"), (".png", "a.DNG B.cr2 c.png")],
)  # fmt: skip
def test_of_raw_and_jpeg_of_a_shot_one_is_taken(tmp_path, kind, taken):
    names = ["a.DNG", "A.jpg", "B.cr2", "b.JPG", "c.png", "._c.png", "d.psd", "d.xmp", "e.mov", "._e.mov"]
    found, left_out = one_of_each([tmp_path / name for name in names], lambda: kind)
    assert [path.name for path in found] == taken.split()
    assert len(left_out) == 4


def test_a_folder_says_what_it_left_out(run, tmp_path, sites):
    folder = tmp_path / "in"
    folder.mkdir()
    shutil.copy(cap.sample_image(SAMPLE), folder / "a.png")
    for name in ("._a.png", "b.gif", "c.GIF", "d.mp4", "notes.txt", "a.xmp"):
        (folder / name).write_bytes(b"\0\5\x16\7")
    command = ("depth", folder, "-c", CAMERA, "-o", tmp_path / "out", "--write", "depth", "--quality=real-time")
    result = run(*command)
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines()[-1] == (
        "Left out: 2 .gif (b.gif, c.GIF), not read as a photograph; 1 .mp4 (d.mp4), not read as a photograph"
    )
    rows = json.loads(run(*command, "--json").stdout)
    assert [row["image"] for row in rows if "left_out" in row] == ["b.gif", "c.GIF", "d.mp4"]
    (folder / "a.png").unlink()
    assert "left out: 2 .gif" in refused(run, *command)


@needs_rawpy
def test_the_kind_that_a_camera_was_calibrated_on_is_measured(run, tmp_path, sites):
    """The sample's camera was made from PNG: of RAW and JPEG it measures the JPEG; one made from RAW, the RAW."""
    folder = tmp_path / "in"
    folder.mkdir()
    write_dng(folder / "IMG_1.DNG", sites, black=(16,), white=1016)
    shutil.copy(cap.sample_image(SAMPLE), folder / "img_1.PNG")
    known = Calibration.load(CAMERA)
    for kind, measured, other in ((".dng", "IMG_1", ".png"), (".png", "img_1", ".dng")):
        made = dict(known.provenance) | {"files": {"session.toml": "", f"board/1{kind}": ""}}
        replace(known, provenance=made).save(tmp_path / "camera.asdf")
        out = tmp_path / kind
        options = ("-o", out, "--quality=real-time", "--write", "depth")
        result = run("depth", folder, "-c", tmp_path / "camera.asdf", *options)
        assert result.returncode == 0, result.stderr
        assert [path.name for path in out.iterdir()] == [f"{measured}.depth.tiff"]
        assert f"Left out: 1 {other}" in result.stdout


def test_a_video_is_told_where_to_go(run, tmp_path):
    (tmp_path / "walk.mp4").write_bytes(b"")
    line = refused(run, "depth", tmp_path / "walk.mp4", "-c", CAMERA)
    assert f"chromaperture export {tmp_path / 'walk.mp4'} OUT --camera {CAMERA}" in line


def test_a_session_takes_photographs_of_the_kind_of_its_boards(session, tmp_path):
    folder = tmp_path / "s"
    shutil.copytree(session, folder)
    expected = [path.name for path in read_session(folder).tilts]  # without a warning, which is an error
    for picture in (*folder.glob("tilt/*.png"), *folder.glob("white/*.png")):
        Image.new("RGB", (8, 6)).save(picture.with_suffix(".jpg"))
        picture.with_name("._" + picture.name).write_bytes(b"\0\5\x16\7")
    with pytest.warns(CaptureWarning, match=r"left out of tilt/ and white/, .*\.png files: \d+ \.jpg .* beside"):
        found = read_session(folder)
    assert [path.name for path in found.tilts] == expected
    assert {path.suffix for path in found.sheets.values()} == {".png"}


# ---- kinds of TIFF


def test_planes_of_a_planar_tiff_are_its_colours(tmp_path, rng):
    counts = rng.integers(0, 60000, (24, 32, 3)).astype(np.uint16)
    for name, compression in (("a.tif", None), ("b.tif", "zlib")):
        tifffile.imwrite(tmp_path / name, np.moveaxis(counts, 2, 0), photometric="rgb", planarconfig="separate",
                         compression=compression, metadata=None)  # fmt: skip
        np.testing.assert_array_equal(decode(tmp_path / name).array, counts)
        assert image_size(tmp_path / name) == (32, 24)


@pytest.mark.parametrize(("mode", "said"), [("CMYK", "CMYK"), ("LAB", r"L\*a\*b\*"), ("YCbCr", "YCbCr")])
def test_other_colours_than_rgb_are_named(tmp_path, mode, said):
    Image.new(mode, (32, 24), (90, 120, 60, 5)[: 4 if mode == "CMYK" else 3]).save(tmp_path / "a.tif")
    with pytest.raises(InputError, match=f"a.tif holds {said} colours, not RGB"):
        decode(tmp_path / "a.tif")


@pytest.mark.parametrize("flag", [0, 1])
def test_a_small_first_page_is_not_the_picture(tmp_path, rng, flag):
    counts = rng.integers(0, 60000, (24, 32, 3)).astype(np.uint16)
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(counts[::4, ::4].copy(), photometric="rgb", subfiletype=flag, metadata=None)
        file.write(counts, photometric="rgb", metadata=None)
    np.testing.assert_array_equal(decode(tmp_path / "a.tif").array, counts)
    assert image_size(tmp_path / "a.tif") == (32, 24)


def test_of_several_pages_alike_the_first_is_read_and_it_is_said(tmp_path, rng):
    pages = rng.integers(0, 60000, (3, 24, 32, 3)).astype(np.uint16)
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for page in pages:
            file.write(page, photometric="rgb", metadata=None)
    with pytest.warns(CaptureWarning, match=r"a\.tif holds more than one picture of this size: the first is read"):
        np.testing.assert_array_equal(decode(tmp_path / "a.tif").array, pages[0])
