"""The printed board: true size, corners that OpenCV finds where they were put, speckle at several scales."""

import base64
import re
import zlib
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from chromaperture.calibration.chessboard import find_corners
from chromaperture.cli.board import millimetres
from chromaperture.errors import InputError
from chromaperture.optics.board_pattern import BoardPage, board_page, speckle, write_board

DPI = 150


def rasterised(svg_text):
    """Paint the page's rectangles and picture at 150 dpi, exact coverage left out: edges are good to half a pixel."""
    root = ElementTree.fromstring(svg_text)
    width, height = (float(v) for v in root.attrib["viewBox"].split()[2:])
    assert root.attrib["width"] == f"{width:g}mm"  # one user unit is one millimetre
    per_mm = DPI / 25.4
    page = np.full((round(height * per_mm), round(width * per_mm)), 255, np.uint8)
    for element in root:
        tag, a = element.tag.rsplit("}", 1)[-1], element.attrib
        if tag not in ("rect", "image"):
            continue
        x, y, w, h = (float(a[k]) * per_mm for k in ("x", "y", "width", "height"))
        rows, columns = slice(round(y), round(y + h)), slice(round(x), round(x + w))
        if tag == "rect":
            page[rows, columns] = {"white": 255, "black": 0}.get(a["fill"], 187)
        else:
            data = base64.b64decode(a["href"].split(",")[1])
            picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
            page[rows, columns] = cv2.resize(picture, page[rows, columns].shape[::-1])
    return page


@pytest.mark.parametrize(
    ("paper", "square", "corners"), [("a4", 22.0, (9, 6)), ("a3", 30.0, (9, 6)), ("letter", 25.0, (8, 5))]
)
def test_corners_of_the_printed_page_are_found_at_their_millimetres(tmp_path, paper, square, corners):
    page = board_page(columns=corners[0], rows=corners[1], square_mm=square, paper=paper)
    write_board(tmp_path / "board.svg", page)
    picture = rasterised((tmp_path / "board.svg").read_text())
    found = find_corners(picture.astype(np.float32) / 255, corners)
    assert found is not None
    found_mm = (np.sort(found.reshape(corners[1], corners[0], 2), axis=1) + 0.5) / DPI * 25.4
    steps = np.diff(found_mm[..., 0], axis=1)
    # A rectangle's edge is rounded to a pixel of 0.17 mm; the corner lies within one of it.
    np.testing.assert_allclose(steps, square, atol=0.2)
    np.testing.assert_allclose(found_mm[..., 0].min(), page.origin_mm[0] + square, atol=0.2)


def test_the_pdf_has_the_size_of_the_paper_and_of_the_squares(tmp_path):
    page = board_page(square_mm=22, paper="a4")
    write_board(tmp_path / "board.pdf", page, wall_pages=1)
    data = (tmp_path / "board.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)", data)
    assert len(boxes) == 2  # the board and one page for the wall
    np.testing.assert_allclose(np.array(boxes, float) * 25.4 / 72, [[297, 210]] * 2, atol=0.01)
    drawn = b"".join(_streams(data)).decode("latin1")
    # Black squares are paths of four corners: "x y m x y l x y l ...", in points.
    starts = re.findall(r"([\d.]+) ([\d.]+) m\s+([\d.]+) ([\d.]+) l", drawn)
    widths = [abs(float(x1) - float(x0)) * 25.4 / 72 for x0, _, x1, _ in starts]
    assert sum(abs(w - 22) < 0.01 for w in widths) == 35  # half of 10 x 7


def _streams(data):
    for match in re.finditer(rb"stream\r?\n(.*?)\r?\nendstream", data, flags=re.DOTALL):
        try:
            yield zlib.decompress(match[1])
        except zlib.error:
            continue


def test_every_scale_of_the_speckle_has_contrast():
    picture = speckle((150.0, 100.0)).astype(np.float32)
    per_mm = 100 / 25.4
    for scale_mm in (1.0, 2.5, 5.0, 10.0):
        fine = cv2.GaussianBlur(picture, (0, 0), scale_mm * per_mm / 2)
        coarse = cv2.GaussianBlur(picture, (0, 0), scale_mm * per_mm)
        assert (fine - coarse).std() > 3, scale_mm  # of 255: white paper alone gives 0


def test_the_speckle_of_two_pages_differs():
    assert (speckle((50.0, 40.0), seed=1) != speckle((50.0, 40.0), seed=2)).mean() > 0.5  # 0.93 is found


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"paper": "a5"}, "a4, a3, letter"),
        ({"columns": 8, "rows": 6}, "upside down"),
        ({"square_mm": 40.0}, "larger paper"),
        ({"square_mm": 0.5}, "do not fit"),
    ],
)
def test_boards_that_cannot_be_printed_say_why(arguments, word):
    with pytest.raises(InputError, match=word):
        board_page(**arguments)


def test_the_suffix_decides_the_format(tmp_path):
    page: BoardPage = board_page()
    with pytest.raises(InputError, match=r"\.pdf or \.svg"):
        write_board(tmp_path / "board.png", page)
    with pytest.raises(InputError, match="one page"):
        write_board(tmp_path / "board.svg", page, wall_pages=2)


@pytest.mark.parametrize(("text", "value"), [("30mm", 30), ("3cm", 30), ("22.5", 22.5), (" 3 cm ", 30)])
def test_lengths_are_read_with_their_unit(text, value):
    assert millimetres(text) == value


def test_a_length_without_sense_is_refused():
    with pytest.raises(InputError, match="30mm"):
        millimetres("thirty")
