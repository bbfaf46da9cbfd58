"""Reading image files: right values, and one clear line for everything that cannot be used."""

import io
import warnings

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from chromaperture.capture.files import decode, image_size, linearise, read_image
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.errors import CaptureWarning, InputError


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


def test_a_file_decoded_once_gives_depth_size_and_image(tmp_path, counts):
    path = write_png(tmp_path / "a.png", counts)
    decoded = decode(path)
    assert decoded.array.dtype == np.uint16
    np.testing.assert_array_equal(decoded.array, counts)
    assert image_size(path) == (32, 24)
    levels = {"black_level": 16, "white_level": 1016}
    np.testing.assert_array_equal(linearise(decoded, **levels), read_image(path, **levels))
    Image.fromarray((counts // 4).astype(np.uint8)).save(tmp_path / "b.png")
    assert decode(tmp_path / "b.png").array.dtype == np.uint8


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


def test_srgb_round_trip():
    codes = np.arange(256, dtype=np.float32) / 255
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(codes)), codes, atol=2e-6)  # float32 powers


def test_float_tiff_is_linear_light(tmp_path, rng):
    light = rng.random((16, 16, 3), dtype=np.float32)
    tifffile.imwrite(tmp_path / "a.tif", light, photometric="rgb")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), light)


def test_orientation_tag_is_not_applied(tmp_path, rng):
    picture = rng.integers(0, 255, (16, 24, 3)).astype(np.uint8)
    exif = Image.Exif()
    exif[0x0112] = 6  # "turn by 90 degrees"
    Image.fromarray(picture).save(tmp_path / "a.jpg", exif=exif, quality=95, subsampling=0)
    assert read_image(tmp_path / "a.jpg").shape == (16, 24, 3)


@pytest.mark.parametrize(("subsampling", "name"), [(1, "4:2:2"), (2, "4:2:0")])
def test_chroma_subsampling_is_warned_of(tmp_path, rng, subsampling, name):
    picture = rng.integers(0, 255, (16, 16, 3)).astype(np.uint8)
    Image.fromarray(picture).save(tmp_path / "a.jpg", subsampling=subsampling)
    with pytest.warns(CaptureWarning, match=name):
        read_image(tmp_path / "a.jpg")


def test_full_chroma_is_not_warned_of(tmp_path, rng):
    picture = rng.integers(0, 255, (16, 16, 3)).astype(np.uint8)
    Image.fromarray(picture).save(tmp_path / "a.jpg", subsampling=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_image(tmp_path / "a.jpg")


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
    with pytest.raises(InputError, match="saturated") as error:
        read_image(write_png(tmp_path / "a.png", picture))
    assert "grey" not in str(error.value)


@pytest.mark.parametrize("keep", [0.0, 0.01, 0.5, 0.98])
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
@given(
    kind=st.sampled_from(["PNG", "JPEG", "PPM", "TIFF", "BMP"]),
    cut=st.floats(0, 1),
    flips=st.lists(st.tuples(st.floats(0, 0.999), st.integers(0, 255)), max_size=4),
)
def test_damaged_files_give_an_image_or_one_clear_error(tmp_path, kind, cut, flips):
    buffer = io.BytesIO()
    picture = (np.arange(20 * 30 * 3) * 7 % 251).astype(np.uint8).reshape(20, 30, 3)
    Image.fromarray(picture).save(buffer, kind)
    data = bytearray(buffer.getvalue())
    for place, value in flips:
        data[int(place * len(data))] = value
    path = tmp_path / f"damaged.{kind.lower()}"
    path.write_bytes(data[: int(cut * len(data))])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            image = read_image(path)
        except InputError as error:
            assert "\n" not in str(error)
        else:
            assert image.dtype == np.float32
            assert image.ndim == 3
            assert image.shape[2] == 3
            assert np.isfinite(image).all()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=400))
def test_any_bytes_are_refused_in_one_line(tmp_path, data):
    path = tmp_path / "noise.png"
    path.write_bytes(data)
    with pytest.raises(InputError) as error:
        read_image(path)
    assert "\n" not in str(error.value)
