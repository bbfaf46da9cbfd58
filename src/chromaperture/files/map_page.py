"""One page in one file: facts, tables, maps whose values stand under the cursor, and a cloud of points."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from chromaperture.depth.pointcloud import PointCloud
from chromaperture.files.map_data import every, packed_map, packed_points, palette

_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 90)  # of pictures; chosen by hand


@dataclass(frozen=True)
class Panel:
    """A map on a page."""

    title: str
    values: np.ndarray  # (H, W) float, NaN unknown
    unit: str
    # ``low``, ``high``: Values of the first and the last colour.
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
