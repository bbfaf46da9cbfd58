"""PNG files: what is encoded is decoded by other libraries, and what these encode by us."""

from __future__ import annotations

import io
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image

from chromaperture import read_image
from chromaperture.capture.files import decode, linearise, read_light
from chromaperture.color.encoding import Encoding
from chromaperture.files.pictures import encode_png
from chromaperture.system.errors import InputError
from chromaperture.system.memory import RowsOnDemand
from worlds import png_of

SHAPES = [(1, 1, 3), (7, 5), (7, 5, 3), (300, 2000, 3), (700, 1300), (1, 900_000), (1000, 1, 3)]  # of 1 to 8 strips


def walk(rng, shape):
    """Counts that overflow now and then, but are mostly like their neighbours."""
    return np.cumsum(rng.integers(-900, 900, shape), axis=1).astype(np.uint16)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_other_libraries_read_what_is_encoded(rng, shape, kind):
    picture = rng.integers(0, np.iinfo(kind).max, shape, endpoint=True).astype(kind)
    picture[: shape[0] // 2] = 3  # even rows: runs
    data = encode_png(picture)
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(found if picture.ndim == 2 else found[..., ::-1], picture)
    Image.open(io.BytesIO(data)).verify()  # all checksums of the chunks
    if kind is np.uint8:
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(data))), picture)


def test_a_cameras_levels_give_the_same_light_with_and_without_counts(rng, tmp_path):
    path, levels = tmp_path / "a.png", (512.0, 60_000.0)
    path.write_bytes(encode_png(walk(rng, (70, 50, 3))))
    for own in ({}, {"black_level": 100.0}, {"white_level": 50_000.0}):
        expected = linearise(decode(path), **own, camera_encoding=Encoding(*levels))
        np.testing.assert_array_equal(read_light(path, **own, camera_encoding=Encoding(*levels)).image, expected)
    with pytest.raises(InputError, match="white level 100 must be above"):
        read_light(path, white_level=100.0, camera_encoding=Encoding(*levels))


def test_rows_that_are_made_on_demand_are_encoded_as_their_picture(rng):
    picture = walk(rng, (700, 1300))  # of four strips
    rows = RowsOnDemand(picture.shape, picture.dtype, lambda part: picture[part].copy())
    assert len(rows) == 700
    assert encode_png(rows) == encode_png(picture)


@pytest.mark.parametrize(
    "rows",
    [
        zlib.compress(bytes(25 * 3)),  # a row too few
        zlib.compress(b"\x05" + bytes(24) + bytes(25 * 3)),  # no such filter
        b"\x78\x01" + b"\xff" * 40,  # no deflate stream
        zlib.compress(bytes(25 * 4))[:-8],  # cut off
    ],
)
def test_damaged_rows_are_one_line(tmp_path, rows):
    (tmp_path / "a.png").write_bytes(png_of(4, 4, rows, bits=16))
    with pytest.raises(InputError, match=r"^a\.png is damaged"):
        read_image(tmp_path / "a.png")
