"""One page in one file: facts, tables, maps whose values stand under the cursor, and a cloud of points.

Arrays stand in it as text: bytes of equal weight together, deflated, in base64; `maps.js` unpacks them.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from chromaperture.color.color_maps import draw_levels
from chromaperture.depth.pointcloud import PointCloud

# Pixels of a map, and points of a cloud, in one page; chosen by hand: five maps are 15 MB of page, and a phone turns
# the points without a jerk.
MOST_PIXELS = 1_000_000
MOST_POINTS = 400_000
_LEVEL = 6  # of zlib; 9 takes four times as long for 1 % less, as measured on depth of 720x480 px


def packed(values: np.ndarray) -> str:
    """Encode an array for a page, base64 of zlib: byte plane after byte plane, so that deflate finds exponents."""
    values = np.ascontiguousarray(values)
    raw = values.astype(values.dtype.newbyteorder("<"), copy=False).reshape(-1).view(np.uint8)
    planes = np.ascontiguousarray(raw.reshape(-1, values.dtype.itemsize).T)
    return base64.b64encode(zlib.compress(planes.tobytes(), _LEVEL)).decode("ascii")


def every(shape: tuple[int, ...], most: int = MOST_PIXELS) -> int:
    """Return of how many columns and rows a page shows one, so that it holds at most ``most`` pixels."""
    step = 1
    while -(-shape[0] // step) * -(-shape[1] // step) > most:
        step += 1
    return step


def packed_map(values: np.ndarray) -> dict[str, Any]:
    """Return a map (H, W), NaN unknown, as `maps.js` reads it; every n-th pixel of a large one."""
    step = every(values.shape)
    shown = np.asarray(values[::step, ::step], np.float32)
    return {
        "width": values.shape[1],
        "height": values.shape[0],
        "step": step,
        "columns": shown.shape[1],
        "rows": shown.shape[0],
        "values": packed(shown),
    }


def packed_points(points_mm: np.ndarray, colors: np.ndarray) -> dict[str, Any]:
    """Return points (N, 3) float, mm, and their colours (N, 3) uint8, sRGB, as `cloud.js` reads them."""
    step = max(1, -(-len(points_mm) // MOST_POINTS))
    shown = np.asarray(points_mm[::step], np.float32)
    return {
        "count": len(points_mm),
        "shown": len(shown),
        "points": packed(shown),
        "colors": packed(np.asarray(colors[::step], np.uint8)),
    }


def palette(name: str) -> str:
    """Return the 256 colours of a map and that of unknown pixels, base64 of (257, 3) bytes."""
    levels = np.append(np.arange(256) / 255.999, np.nan)[None]
    return base64.b64encode(draw_levels(levels, name)[0].tobytes()).decode("ascii")


_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 90)  # of pictures; chosen by hand


@dataclass(frozen=True)
class Panel:
    """A map on a page."""

    title: str
    values: np.ndarray  # (H, W) float, NaN unknown
    unit: str
    # ``low``, ``high``: values of the first and the last colour.
    low: float
    high: float
    colors: str  # name of a colour map, see `color_maps`
    digits: int = 0  # of values, after the point
    note: str = ""  # a sentence below the map


@dataclass(frozen=True)
class Picture:
    """A picture on a page; (H, W, 3) uint8, sRGB."""

    title: str
    pixels: np.ndarray


@dataclass(frozen=True)
class TextTable:
    """Rows of text below a heading."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Bars:
    """A histogram: heights of bars of equal width between ``low`` and ``high``, and a curve to compare with."""

    caption: str
    heights: np.ndarray
    low: float
    high: float
    unit: str
    curve: np.ndarray | None = None  # of the same length as heights


@dataclass(frozen=True)
class Page:
    """What a page shows, from its top to its end."""

    title: str
    subtitle: str = ""
    sentences: Sequence[str] = ()
    panels: Sequence[Panel | Picture] = ()
    cloud: PointCloud | None = None
    bars: Sequence[Bars] = ()
    tables: Sequence[TextTable] = ()
    notes: Sequence[str] = ()


def render(page: Page) -> str:
    """Return a page as HTML that loads nothing: maps, pictures, points, styles and scripts are inside."""
    loader = PackageLoader("chromaperture.files")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    data: dict[str, Any] = {"panels": [_panel(panel) for panel in page.panels], "cloud": None}
    if page.cloud is not None and len(page.cloud.points_mm):
        data["cloud"] = packed_points(page.cloud.points_mm, page.cloud.colors)
    steps = {every(_shape(panel)) for panel in page.panels} - {1}
    text = json.dumps(data, allow_nan=False).replace("<", "\\u003c")  # no "</script>" in a title ends the data
    return environment.get_template("maps.html").render(
        page=page, data=text, bars=[_drawn(bars) for bars in page.bars], step=max(steps, default=1),
        cloud=data["cloud"],
    )  # fmt: skip


def _shape(panel: Panel | Picture) -> tuple[int, ...]:
    return (panel.pixels if isinstance(panel, Picture) else panel.values).shape


def _panel(panel: Panel | Picture) -> dict[str, Any]:
    if isinstance(panel, Picture):
        height, width = panel.pixels.shape[:2]
        step = every(panel.pixels.shape)
        size = (-(-width // step), -(-height // step))
        small = panel.pixels if step == 1 else cv2.resize(panel.pixels, size, interpolation=cv2.INTER_AREA)
        data = cv2.imencode(".jpg", small[..., ::-1], _JPEG)[1].tobytes()
        source = "data:image/jpeg;base64," + base64.b64encode(data).decode("ascii")
        return {"title": panel.title, "width": width, "height": height, "picture": source}
    return packed_map(panel.values) | {
        "title": panel.title,
        "unit": panel.unit,
        "low": float(panel.low),
        "high": float(panel.high),
        "digits": panel.digits,
        "palette": palette(panel.colors),
        "note": panel.note,
    }


def _drawn(bars: Bars) -> dict[str, Any]:
    """Return the rectangles and the line of a histogram in a box of 1000 x 240."""
    heights = np.asarray(bars.heights, float)
    most = max(heights.max(initial=0), 0 if bars.curve is None else float(np.max(bars.curve)), 1e-12)
    width = 1000 / max(len(heights), 1)
    rectangles = [(i * width, 240 * (1 - h / most), width * 0.92, 240 * h / most) for i, h in enumerate(heights)]
    line = ""
    if bars.curve is not None:
        line = " ".join(f"{(i + 0.5) * width:.1f},{240 * (1 - v / most):.1f}" for i, v in enumerate(bars.curve))
    middle = (bars.low + bars.high) / 2
    ticks = [f"{v:g} {bars.unit}" for v in (bars.low, middle, bars.high)]
    return {"caption": bars.caption, "rectangles": rectangles, "line": line, "ticks": ticks}
