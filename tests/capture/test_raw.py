"""RAW files, from the photosites to millimetres. The tests write their own DNG, which LibRaw reads."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import chromaperture as cap
from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.calibration.session import read_session
from chromaperture.calibration.white_sheets import measure_white_sheets
from chromaperture.capture import raw as raw_files
from chromaperture.capture.exif import read_model, read_noise_profile
from chromaperture.capture.files import decode, format_of
from chromaperture.capture.raw import check_complete
from chromaperture.model.camera_file import Calibration
from chromaperture.products.samples import SAMPLES, sample_camera, sample_image
from chromaperture.system.errors import InputError
from worlds import INFINITY_PX, PUPIL_MM, SCALE_PX_MM, mosaic_of, session_of, write_dng

needs_rawpy = pytest.mark.extra("raw", "rawpy")
LIGHT = {"R": 1000, "G": 2000, "B": 3000}


def even_light(pattern, shape=(64, 96), start=(0, 0)):
    """A mosaic of one colour whose pattern begins at ``start``."""
    y, x = np.indices(shape)
    place = (y - start[0]) % 2 * 2 + (x - start[1]) % 2
    return np.array([LIGHT[colour] for colour in pattern], np.uint16)[place]


@needs_rawpy
@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("area", [None, (2, 4, 60, 90), (1, 3, 61, 91), (0, 1, 64, 96)])
def test_colours_stay_what_they_are_behind_a_masked_border(tmp_path, pattern, area):
    write_dng(tmp_path / "a.dng", even_light(pattern, start=(area or (0, 0))[:2]), pattern=pattern, active_area=area)
    counts = decode(tmp_path / "a.dng").array
    assert (counts == 2 * np.array(list(LIGHT.values()))).all()


def test_a_border_of_odd_size_moves_the_pattern(tmp_path, monkeypatch):
    """LibRaw gives DNG even borders; other makes have odd ones."""
    full = even_light("RGGB")
    raw = SimpleNamespace(
        sizes=SimpleNamespace(width=91, height=62, top_margin=1, left_margin=5),
        raw_pattern=np.array([[0, 1], [3, 2]], np.uint8), raw_image_visible=full[1:63, 5:], color_desc=b"RGBG",
        black_level_per_channel=[0, 0, 0, 0], white_level=4095,
    )  # fmt: skip
    monkeypatch.setattr(raw_files, "_opened", lambda path, shot=0: contextlib.nullcontext(raw))
    counts, _ = raw_files.read_raw(tmp_path / "a.cr2")
    assert counts.shape == (31, 45, 3)
    assert (counts == 2 * np.array(list(LIGHT.values()))).all()


@pytest.mark.parametrize(("stated", "white"), [([15360] * 4, 15360), ([0] * 4, 16383), (None, 16383)])
def test_the_white_level_is_where_the_camera_says_light_ends_to_be_linear(tmp_path, monkeypatch, stated, white):
    raw = SimpleNamespace(
        sizes=SimpleNamespace(width=96, height=64, top_margin=0, left_margin=0),
        raw_pattern=np.array([[0, 1], [3, 2]], np.uint8), raw_image_visible=even_light("RGGB"), color_desc=b"RGBG",
        black_level_per_channel=[512] * 4, white_level=16383, camera_white_level_per_channel=stated,
    )  # fmt: skip
    monkeypatch.setattr(raw_files, "_opened", lambda path, shot=0: contextlib.nullcontext(raw))
    _, encoding = raw_files.read_raw(tmp_path / "a.arw")
    assert encoding.white_level == 2 * white


@needs_rawpy
@pytest.mark.parametrize("share", [0.3, 0.9, 0.999])
def test_a_raw_file_that_ends_too_early_is_refused(run, tmp_path, share):
    """LibRaw reads what is missing as black."""
    mosaic = np.random.default_rng(1).integers(100, 4000, (256, 384)).astype(np.uint16)
    write_dng(tmp_path / "a.dng", mosaic)
    whole = (tmp_path / "a.dng").read_bytes()
    (tmp_path / "a.dng").write_bytes(whole[: int(share * len(whole))])
    result = run("depth", tmp_path / "a.dng", "--design", "cy_halves", "-o", tmp_path / "out")
    assert result.returncode == 2
    assert "copy the file again" in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not list((tmp_path / "out").glob("*"))


def boxes(*lengths):
    """An ISO base media file of boxes of so many bytes, the last with a length of 64 bits."""
    *short, long = lengths
    head = b"".join(n.to_bytes(4, "big") + (b"moov" if i else b"ftyp") + bytes(n - 8) for i, n in enumerate(short))
    return head + (1).to_bytes(4, "big") + b"mdat" + long.to_bytes(8, "big") + bytes(long - 16)


def test_a_file_of_boxes_is_as_long_as_these(tmp_path):
    path, whole = tmp_path / "a.cr3", boxes(24, 100, 3000)
    path.write_bytes(whole)
    check_complete(path)
    for length in (len(whole) - 1, 130 + 16, 60):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"a\.cr3 ends too early"):
            check_complete(path)


@given(st.binary(max_size=64))
def test_whatever_a_file_begins_with_its_length_is_checked_without_a_traceback(tmp_path_factory, rest):
    path = tmp_path_factory.mktemp("raw") / "a.raw"
    for start in (b"", b"II*\0", b"MM\0*", b"\0\0\0\x18ftyp"):
        path.write_bytes(start + rest)
        with contextlib.suppress(InputError):
            check_complete(path)


@needs_rawpy
@pytest.mark.parametrize(("orientation", "turn"), [(1, 0), (3, 180), (6, 90), (8, 270)])
def test_the_pixels_stay_and_the_turn_is_known(tmp_path, orientation, turn):
    mosaic = np.random.default_rng(1).integers(100, 4000, (64, 96)).astype(np.uint16)
    write_dng(tmp_path / "upright.dng", mosaic)
    write_dng(tmp_path / "a.dng", mosaic, orientation=orientation)
    np.testing.assert_array_equal(decode(tmp_path / "a.dng").array, decode(tmp_path / "upright.dng").array)
    assert format_of(tmp_path / "a.dng").turn_degrees == turn


@pytest.mark.parametrize(("orientation", "turn"), [(1, 0), (3, 180), (6, 90), (8, 270)])
@pytest.mark.parametrize("suffix", ["jpg", "tif"])
def test_the_turn_of_a_developed_photograph(tmp_path, orientation, turn, suffix):
    exif = Image.Exif()
    exif[0x0112], exif[0x0110] = orientation, "Test 5"
    Image.new("RGB", (8, 6), (90, 120, 60)).save(tmp_path / f"a.{suffix}", exif=exif)
    assert format_of(tmp_path / f"a.{suffix}").turn_degrees == turn
    assert read_model(tmp_path / f"a.{suffix}") == "Test 5"


def test_a_file_without_such_data_is_upright_and_of_no_model(tmp_path):
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8\xff")
    (tmp_path / "broken.tif").write_bytes(b"II*\0")
    for name in ("broken.jpg", "broken.tif", "missing.png"):
        assert read_model(tmp_path / name) is None
    assert format_of(sample_image(SAMPLES[0])).turn_degrees == 0


@needs_rawpy
def test_a_portrait_says_how_to_turn_its_results(run, tmp_path):
    rng = np.random.default_rng(2)
    picture = cv2.GaussianBlur(rng.uniform(500, 3500, (64, 96, 3)).astype(np.float32), (0, 0), 1.5)
    write_dng(tmp_path / "a.dng", mosaic_of(picture), orientation=8)
    result = run("depth", tmp_path / "a.dng", "--design", "cy_halves", "-o", tmp_path / "out", "--json")
    assert result.returncode == 0, result.stderr
    assert "stay as the sensor delivers them" in result.stderr
    assert json.loads((tmp_path / "out" / "a.json").read_text())["turn_degrees"] == 270
    assert cv2.imread(str(tmp_path / "out" / "a.color.png")).shape == (64, 96, 3)


@needs_rawpy
def test_a_file_of_another_camera_is_named(tmp_path):
    calibration = Calibration.load(sample_camera(SAMPLES[0]))
    known = replace(calibration, provenance=dict(calibration.provenance) | {"camera_model": "Test 5"})
    camera = cap.CodedApertureCamera(known)
    counts = cv2.imread(str(sample_image(SAMPLES[0])), cv2.IMREAD_UNCHANGED)[..., ::-1]
    write_dng(tmp_path / "a.dng", mosaic_of(counts), model="Test 7", black=(16,), white=1016)
    with pytest.warns(cap.CaptureWarning, match=r"taken with a Test 7, but .* made with a Test 5: .* calibrate it"):
        cap.measure_file(tmp_path / "a.dng", camera, out=tmp_path, write="depth")
    write_dng(tmp_path / "a.dng", mosaic_of(counts), model="Test 5", black=(16,), white=1016)
    cap.measure_file(tmp_path / "a.dng", camera, out=tmp_path, write="depth")  # without a warning, which is an error


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ((2e-4, 3e-7), (2e-4, 3e-7)),
        ((1e-4, 1e-7, 2e-4, 3e-7, 3e-4, 5e-7), (2e-4, 3e-7)),  # of each colour
        ((), None),
        ((0.0, 1e-7), None),
        ((2e-4, float("nan")), None),
        ((2e-4, 3e-7, 1e-4), None),
    ],
)
def test_the_noise_of_a_file_is_read(tmp_path, values, expected):
    write_dng(tmp_path / "a.dng", even_light("RGGB"), noise_profile=values)
    found = read_noise_profile(tmp_path / "a.dng")
    assert found == (None if expected is None else pytest.approx(expected))
    assert read_noise_profile(tmp_path / "missing.dng") is None


def test_another_program_reads_the_noise_that_the_tests_write(tmp_path):
    exiftool = shutil.which("exiftool") or pytest.skip("exiftool is not installed: this is NOT tested")
    write_dng(tmp_path / "a.dng", even_light("RGGB"), noise_profile=(2e-4, 3e-7))
    text = subprocess.run([exiftool, "-s3", "-NoiseProfile", tmp_path / "a.dng"], capture_output=True, text=True)
    assert [float(number) for number in text.stdout.split()] == pytest.approx([2e-4, 3e-7])


@needs_rawpy
def test_without_sheets_the_noise_is_that_of_the_file(session, tmp_path):
    """The variance is S light + O: a full well of 1 / S electrons, and a read noise of the root of O times that."""
    noise = (1 / 5000, (4 / 5000) ** 2)
    folder = session_of(session, tmp_path / "session", ".dng", lambda path, counts: write_dng(
        path, mosaic_of(counts), black=(100,), white=60100, noise_profile=noise))  # fmt: skip
    text = (folder / "session.toml").read_text()
    kept = [line for line in text.splitlines() if not line.startswith(("full_well", "read_noise"))]
    (folder / "session.toml").write_text("\n".join(kept) + "\n")
    shutil.rmtree(folder / "white")
    found = measure_white_sheets(read_session(folder))
    assert found.sensor.full_well_electrons == pytest.approx(5000.0)
    assert found.sensor.read_noise_electrons == pytest.approx(4.0)
    assert "noise of the DNG's NoiseProfile: full well 5000 electrons, read noise 4.0" in found.notes


@pytest.mark.slow
@needs_rawpy
def test_a_session_of_raw_files_gives_the_cameras_curve_and_its_model(session, tmp_path):
    folder = session_of(session, tmp_path / "session", ".dng", lambda path, counts: write_dng(
        path, mosaic_of(counts), black=(100,), white=60100, model="Test 5"))  # fmt: skip
    result = calibrate_session(folder, CalibrationConfig(lens_blur=False))
    assert result.calibration.provenance["camera_model"] == "Test 5"
    for fit in result.fits.values():
        model = fit.model
        for z in (1200.0, 2000.0, 2800.0):
            true = INFINITY_PX - SCALE_PX_MM / (z - PUPIL_MM)
            found = model.infinity_disparity_px - model.scale_px_mm / (z - model.sensor_to_pupil_mm)
            assert found == pytest.approx(true, abs=0.06)  # 0.051 is found; 0.03 without a mosaic
