"""Photographs of dual-pixel sensors: which files make one, how they are read, and which are refused."""

import cv2
import numpy as np
import pytest
import tifffile

import chromaperture as cap
from chromaperture.capture import files as reader
from chromaperture.capture.dual_pixel import files_of, half_of, pairs, shot_stem
from chromaperture.capture.files import decode, format_of, image_size, read_light
from chromaperture.color.encoding import Encoding, StatedFacts
from chromaperture.color.srgb import srgb_to_linear
from chromaperture.system.errors import InputError
from worlds import texture, write_dng, write_halves

PAIRED = StatedFacts(dual_pixel="left-right")
BLACK, WHITE = 100, 40000


@pytest.fixture
def scene(rng):
    """Counts of 15 bits of the left and the right half, (64, 96) each."""
    seen = 4000 + 20000 * texture(rng, 64, 98)
    return seen[:, :-2].astype(np.uint16), seen[:, 2:].astype(np.uint16)


def light(counts, white=65535.0, black=0.0):
    return (counts.astype(float) - black) / (white - black)


def green(mosaic):
    """Mean of the two green photosites of an RGGB cell, as light."""
    return light((mosaic[::2, 1::2].astype(float) + mosaic[1::2, ::2]) / 2, WHITE, BLACK)


@pytest.mark.parametrize("names", [("_left", "_right"), (".left", ".right"), ("-left", "-right"), ("_L", "_R")])
def test_halves_are_found_by_their_names(tmp_path, scene, names):
    for counts, name in zip(scene, names, strict=True):
        cv2.imwrite(str(tmp_path / f"a{name}.png"), counts)
    left = tmp_path / f"a{names[0]}.png"
    seen = read_light(left, stated=PAIRED).image
    np.testing.assert_allclose(seen[..., 2], light(scene[0]), atol=1e-6)  # float32
    np.testing.assert_allclose(seen[..., 0], light(scene[1]), atol=1e-6)
    np.testing.assert_allclose(seen[..., 1], (light(scene[0]) + light(scene[1])) / 2, atol=1e-6)
    assert shot_stem(left, "left-right") == "a"
    assert shot_stem(left, None) == left.stem  # of a camera with film it is an ordinary photograph
    assert image_size(left, PAIRED) == (96, 64)


def test_exchanged_halves_are_read_so(tmp_path, scene):
    write_halves(tmp_path / "a.png", np.dstack([scene[1], scene[1], scene[0]]))
    seen, turned = (
        read_light(tmp_path / "a_left.png", stated=StatedFacts(dual_pixel=order)).image
        for order in ("left-right", "right-left")
    )
    np.testing.assert_array_equal(seen, turned[..., ::-1])


def test_the_mean_is_that_of_light_and_only_green_counts(tmp_path, rng):
    halves = [rng.integers(20, 235, (64, 96, 3)).astype(np.uint8) for _ in range(2)]
    halves[1][..., 1] = np.roll(halves[0][..., 1], 1, axis=1)  # of one scene
    for side, counts in zip(("left", "right"), halves, strict=True):
        cv2.imwrite(str(tmp_path / f"{side}.png"), counts)
    seen = cap.read_image(tmp_path / "left.png", right=tmp_path / "right.png")
    left, right = (srgb_to_linear(counts[..., 1] / 255) for counts in halves)
    np.testing.assert_allclose(seen, np.dstack([right, (left + right) / 2, left]), atol=1e-6)


def test_a_list_of_files_has_each_photograph_once(tmp_path):
    names = ["b.png", "a_left.png", "a_right.png", "c_left.png", "d_right.png"]
    left_out = {}
    assert pairs(names, left_out) == ["a_left.png", "c_left.png", "d_right.png"]  # the last two are refused later
    assert [path.name for path in left_out] == ["b.png"]
    assert pairs(["b.png"], {}) == ["b.png"]
    assert half_of(tmp_path / "upright.png") is None


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda left, right: (left, None), "a_right.png, is missing"),
        (lambda left, right: (left, left), "the same picture"),
        (lambda left, right: (left, right // 2), "the left half has 2.*times the light"),
        (lambda left, right: (left, np.ascontiguousarray(right[:40])), "96x40 px, unlike the left"),
        (lambda left, right: (left, (right >> 8).astype(np.uint8)), "8 bits"),
        (lambda left, right: (left, np.dstack([right] * 3)), "grey and the other in colours"),
    ],
)
def test_halves_that_are_not_of_one_exposure_are_refused(tmp_path, scene, spoil, says):
    for side, counts in zip(("left", "right"), spoil(*scene), strict=True):
        if counts is not None:
            cv2.imwrite(str(tmp_path / f"a_{side}.png"), counts)
    with pytest.raises(InputError, match=says):
        read_light(tmp_path / "a_left.png", stated=PAIRED)


def test_halves_of_different_scenes_are_refused(tmp_path, rng):
    light = [rng.uniform(4000, 40000, (8, 12)).astype(np.uint16) for _ in range(2)]
    halves = [cv2.resize(part, (96, 64), interpolation=cv2.INTER_NEAREST) for part in light]
    write_halves(tmp_path / "a.png", np.dstack([halves[0], halves[0], halves[1]]))
    with pytest.raises(InputError, match="same scene"):
        read_light(tmp_path / "a_left.png", stated=PAIRED)


def test_names_that_contradict_are_refused(tmp_path, scene):
    write_halves(tmp_path / "a.png", np.dstack([scene[1], scene[1], scene[0]]))
    left, right = tmp_path / "a_left.png", tmp_path / "a_right.png"
    with pytest.raises(InputError, match="exchange the two"):
        files_of(right, left)
    with pytest.raises(InputError, match=r"give the left one, a_left\.png"):
        read_light(right, stated=PAIRED)
    single = tmp_path / "photo.png"
    cv2.imwrite(str(single), np.dstack([scene[0], scene[1], scene[0]]))
    with pytest.raises(InputError, match=r"photo\.png is one picture, but this camera is a dual-pixel one"):
        read_light(single, stated=PAIRED)


def test_two_samples_of_a_pixel_are_its_halves(tmp_path, scene):
    path = tmp_path / "both.tif"
    tifffile.imwrite(path, np.dstack(scene), photometric="minisblack", planarconfig="contig", metadata=None)
    seen = read_light(path, stated=PAIRED).image
    np.testing.assert_allclose(seen[..., 2], light(scene[0]), atol=1e-6)
    np.testing.assert_allclose(seen[..., 0], light(scene[1]), atol=1e-6)


def test_two_samples_of_a_mosaic_are_its_halves(tmp_path, scene):
    path = tmp_path / "both.dng"
    tags = [
        (33421, "H", 2, (2, 2), False), (33422, "B", 4, bytes([0, 1, 1, 2]), False),
        (50706, "B", 4, bytes([1, 4, 0, 0]), False), (50714, "H", 1, BLACK, False), (50717, "I", 1, WHITE, False),
    ]  # fmt: skip
    tifffile.imwrite(path, np.dstack(scene), photometric="minisblack", planarconfig="contig", extratags=tags,
                     metadata=None)  # fmt: skip
    with tifffile.TiffFile(path, mode="r+b") as file:
        file.pages[0].tags[262].overwrite(32803)  # tifffile writes no mosaic of two samples
    seen = read_light(path, stated=PAIRED).image
    np.testing.assert_allclose(seen[..., 2], green(scene[0]), atol=1e-6)
    np.testing.assert_allclose(seen[..., 0], green(scene[1]), atol=1e-6)
    assert format_of(path, PAIRED).read_size_px == (48, 32)


@pytest.mark.extra("raw", "rawpy")
def test_of_a_raw_file_of_two_shots_the_first_is_the_sum(tmp_path, scene, monkeypatch):
    """LibRaw makes two shots of makers' files only, so its reader is replaced here."""
    counts = {0: scene[0].astype(np.uint16) + scene[1] - BLACK, 1: scene[0]}

    def shots(path, *, size_px=None, shot=0):
        cells = counts[shot].astype(np.float32)[..., None].repeat(3, axis=2) * 2
        return cells, Encoding(2 * BLACK, 2 * WHITE, given=False)

    path = tmp_path / "one.dng"
    write_dng(path, np.full((128, 192), 500, np.uint16))
    monkeypatch.setattr(reader, "read_raw", shots)
    seen = reader.linearise(decode(path, stated=PAIRED))
    np.testing.assert_allclose(seen[..., 2], light(scene[0], WHITE, BLACK), atol=1e-6)
    np.testing.assert_allclose(seen[..., 0], light(scene[1], WHITE, BLACK), atol=1e-6)


@pytest.mark.extra("raw", "rawpy")
def test_a_raw_file_of_one_shot_is_refused(tmp_path, scene):
    write_dng(tmp_path / "one.dng", scene[0])
    with pytest.raises(InputError, match="holds one picture, not the two shots"):
        decode(tmp_path / "one.dng", stated=PAIRED)
