"""Photographs that a colour matrix was applied to, known by their tags and by what the matrix cut off."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

import chromaperture as cap
from chromaperture.calibration.session import read_session
from chromaperture.calibration.white_sheets import measure_white_sheets
from chromaperture.capture.exif import is_developed, other_colours
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.model.camera_file import Calibration
from chromaperture.products.samples import SAMPLES, sample_camera, sample_image
from profiles import SRGB, icc, parametric
from worlds import session_of, write_dng

# Camera colours to sRGB, white to white: that of a Canon EOS 5D Mark II by its DNG matrix (Adobe, D65).
MATRIX = np.array([[2.07, -1.32, 0.25], [-0.04, 1.37, -0.33], [0.04, -0.38, 1.34]])
OVERLAP = np.array([[0.9, 0.1, 0], [0, 1, 0], [0, 0.1, 0.9]])  # of a sensor's colours: the tests' film has no leak
PROFILE = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def test_tags_tell_a_matrix(tmp_path):
    picture, exif = Image.new("RGB", (8, 6), (90, 120, 60)), Image.Exif()
    exif[0x0110] = "Test 5"
    counts = np.full((6, 8, 3), 9000, np.uint16)
    picture.save(tmp_path / "camera.jpg", exif=exif)
    picture.save(tmp_path / "profile.jpg", icc_profile=PROFILE)
    picture.save(tmp_path / "profile.png", icc_profile=PROFILE)
    picture.save(tmp_path / "plain.jpg")
    picture.save(tmp_path / "plain.png")
    tifffile.imwrite(tmp_path / "profile.tif", counts, photometric="rgb", iccprofile=PROFILE)
    # As dcraw -o 0 writes it: a camera and a developer, but no profile.
    names = [(271, "s", 0, "Test\0", True), (272, "s", 0, "Test 5\0", True)]
    tifffile.imwrite(tmp_path / "dcraw.tif", counts, photometric="rgb", software="dcraw v9.28", extratags=names)
    write_dng(tmp_path / "a.dng", counts[..., 0])
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8\xff")
    (tmp_path / "broken.tif").write_bytes(b"II*\0")
    found = {path.name: is_developed(path) for path in [*tmp_path.iterdir(), tmp_path / "missing.png"]}
    yes = {"camera.jpg", "profile.jpg", "profile.png", "profile.tif"}
    assert {name for name, value in found.items() if value} == yes
    assert [name for name, value in found.items() if value is False] == ["a.dng"]


def test_photographs_of_the_other_kind_are_named(run, tmp_path):
    calibration = Calibration.load(sample_camera(SAMPLES[0]))
    counts = cv2.imread(str(sample_image(SAMPLES[0])), cv2.IMREAD_UNCHANGED)[..., ::-1]
    path = tmp_path / "a.tif"
    linear = icc(SRGB, parametric(0, 1.0))  # a developer's linear output
    tifffile.imwrite(path, counts, photometric="rgb", iccprofile=linear)
    for developed, says in ((False, True), (True, False), (None, False)):
        known = {} if developed is None else {"developed": developed}
        provenance = dict(calibration.provenance) | known
        assert bool(other_colours(path, provenance)) == says
    camera = replace(calibration, provenance=dict(calibration.provenance) | {"developed": False})
    with pytest.warns(cap.CaptureWarning, match="through a colour matrix .* calibrate with files like this"):
        cap.measure_file(path, cap.CodedApertureCamera(camera), out=tmp_path, write="depth")
    camera.save(tmp_path / "c.asdf")
    result = run("check", path, "--camera", tmp_path / "c.asdf", "--json")
    assert '"colours"' in result.stdout
    raw = tmp_path / "a.dng"
    write_dng(raw, counts[..., 1])
    assert "hold camera colours" in (other_colours(raw, {"developed": True}) or "")


@pytest.mark.parametrize("matrix", [np.eye(3), MATRIX])
def test_white_sheets_show_what_a_matrix_cut_off(session, tmp_path, matrix):
    """Red behind cyan film, which the matrix makes negative, ends at zero in every file without signs."""
    folder = tmp_path / "session"
    shutil.copytree(session, folder)
    text = (folder / "session.toml").read_text()
    (folder / "session.toml").write_text(re.sub(r"(black|white)_level = \d+\n", "", text))
    for sheet in (folder / "white").glob("*.png"):
        light = np.maximum(cv2.imread(str(sheet), cv2.IMREAD_UNCHANGED)[..., ::-1] / 60000 - 100 / 60000, 0)
        cv2.imwrite(
            str(sheet), np.rint(40000 * np.clip(light @ (matrix @ OVERLAP).T, 0, 1)).astype(np.uint16)[..., ::-1]
        )
    found = measure_white_sheets(read_session(folder))
    expected = True if matrix is MATRIX else None
    assert found.developed is expected
    assert sum("colour matrix" in note for note in found.notes) == bool(expected)


def test_a_cameras_jpeg_files_are_named_once(session, tmp_path):
    exif = Image.Exif()
    exif[0x0110] = "Test 5"

    def write(path, counts):
        codes = np.rint(255 * linear_to_srgb(counts / 65535)).astype(np.uint8)
        Image.fromarray(codes).save(path, quality=95, subsampling=0, exif=exif)

    folder = session_of(session, tmp_path / "session", ".jpg", write)
    found = measure_white_sheets(read_session(folder))
    assert found.developed is True
    assert sum("colour matrix" in note for note in found.notes) == 1


def test_film_that_seems_to_pass_more_than_all_light_can_be_measured():
    """As a matrix makes it: calibration allows 1.15, uneven light, and a camera that it wrote must measure."""
    aperture = cap.CodedApertureCamera(Calibration.load(sample_camera(SAMPLES[0]))).calibration.aperture
    filmed = aperture.with_film({"yellow": np.array([0.8, 1.09, -0.01])})
    assert filmed.filter_named("yellow").transmission == (0.8, 1.0, 0.0)
