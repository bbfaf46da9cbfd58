"""The printed board: true size, corners that OpenCV finds where they were put, speckle at several scales."""

import base64
import re
import zlib
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from chromaperture.calibration.chessboard import find_corners
from chromaperture.optics.printing.board_pattern import BoardPage, board_page, speckle, write_board
from chromaperture.system.errors import InputError

DPI = 150


def numbers(text):
    return [float(v) for v in re.findall(r"-?[0-9.]+", text)]


def rasterised(svg_text):
    """Paint the page's rectangles and picture at 150 dpi, exact coverage left out: edges are good to half a pixel."""
    root = ElementTree.fromstring(svg_text)
    width, height = numbers(root.attrib["viewBox"])[2:]
    assert float(root.attrib["width"].removesuffix("pt")) == width  # one user unit is one point
    per_point = DPI / 72
    page = np.full((round(height * per_point), round(width * per_point)), 255, np.uint8)
    groups = (group for group in root.iter() if "clip-path" in group.attrib or group.get("id", "").startswith("patch_"))
    for shape in (shape for group in groups for shape in group):  # in painting order
        if shape.tag.endswith("image"):
            sx, _, _, sy, x, y = numbers(shape.get("transform"))
            x1, y1 = x + sx * float(shape.get("width")), y + sy * float(shape.get("height"))
        else:
            corners = np.array(numbers(shape.get("d"))).reshape(-1, 2)
            (x, y), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
        rows, columns = (slice(round(a * per_point), round(b * per_point)) for a, b in ((y, y1), (x, x1)))
        if shape.tag.endswith("image"):
            data = base64.b64decode(shape.get("{http://www.w3.org/1999/xlink}href").split(",")[1])
            picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
            page[rows, columns] = cv2.resize(picture, page[rows, columns].shape[::-1])
        else:
            fill = re.search(r"fill: #(..)", shape.get("style", ""))
            page[rows, columns] = int(fill[1], 16) if fill else 0  # black is not written
    return page


@pytest.mark.slow
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


def test_the_command_prints_squares_that_fit_the_paper(run, tmp_path):
    result = run("board", "--out", tmp_path / "board.pdf")
    assert (result.returncode, "9 x 6 inner corners, 30 mm squares" in result.stdout) == (0, True), result.stderr
    assert "22 mm squares" in run("board", "--out", tmp_path / "a4.pdf", "--paper", "a4").stdout
    result = run("board", "--out", tmp_path / "b.svg", "--board", "8x5", "--square-mm", 25, "--paper", "letter")
    assert "8 x 5 inner corners, 25 mm squares" in result.stdout
    result = run("board", "--out", tmp_path / "c.svg", "--board", "nine")
    assert (result.returncode, "such as 9x6" in result.stderr) == (2, True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a4.pdf", "b.svg", "board.pdf"]
