"""A result or a camera as one page: maps with their values under the cursor, picture, points, figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

import numpy as np

from chromaperture.color.color_maps import DISTANCE, ERROR, OTHER
from chromaperture.files.map_page import Page, Panel, Picture, TextTable
from chromaperture.model.camera_file import Calibration
from chromaperture.products.result_files import StoredResult
from chromaperture.settings.methods import Quality

_MOST_SUMMARY_BYTES = 10_000_000  # of STEM.json; ours have 12 KB
_SHOWN_COLUMNS = 480  # of the maps of a camera, which are smooth; chosen by hand


def result_page(result: StoredResult) -> Page:
    """Return the page of a stored result."""
    panels: list[Panel | Picture] = []
    maps = result.maps
    for name, title, unit, colors, digits in (
        ("depth", "depth from the sensor plane", "mm", DISTANCE, 1),
        ("sigma", "error bar (one standard deviation)", "mm", ERROR, 1),
        ("disparity", "disparity (0 in focus, + beyond)", "px", DISTANCE, 3),
        ("confidence", "confidence", "", OTHER, 3),
        ("map", "values", "", OTHER, 3),
    ):
        if name in maps:
            low, high = _ends(maps[name], from_zero=name == "sigma")
            panels.append(Panel(title, maps[name], unit, low, high, colors, digits, _facts(maps[name], unit, digits)))
    if result.picture is not None:
        panels.insert(min(1, len(panels)), Picture("restored colour", result.picture))
    height, width = _size(result)
    return Page(
        title=result.name,
        subtitle=f"{width}x{height} px" if width else "",
        panels=panels,
        cloud=result.cloud,
        tables=_summary_tables(result.summary),
    )


def _size(result: StoredResult) -> tuple[int, int]:
    for values in (*result.maps.values(), *(() if result.picture is None else (result.picture,))):
        return values.shape[0], values.shape[1]
    return 0, 0


def _ends(values: np.ndarray, *, from_zero: bool = False) -> tuple[float, float]:
    """Return the values of the first and the last colour: the middle 96 % of the pixels."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(known, (2, 98)))
    low = 0.0 if from_zero else low
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _facts(values: np.ndarray, unit: str, digits: int) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return "No pixel is known."
    low, middle, high = np.percentile(known, (5, 50, 95))
    unit = f" {unit}" if unit else ""
    return (
        f"{known.size / values.size:.1%} of the pixels known; median {middle:.{digits}f}{unit}, nine tenths between "
        f"{low:.{digits}f} and {high:.{digits}f}{unit}."
    )


def _summary_tables(path: Path | None) -> list[TextTable]:
    """Return what ``STEM.json`` says, as far as it can be read; it is an addition, not the result."""
    if path is None or path.stat().st_size > _MOST_SUMMARY_BYTES:
        return []
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    if not isinstance(summary, dict):
        return []
    rows = [(name, _text(summary[name])) for name in ("image", "fill_rate", "sigma_median_mm", "max_relative_sigma")
            if summary.get(name) is not None]  # fmt: skip
    for group, prefix in (("seconds", "time, "), ("camera", "camera, ")):
        if isinstance(entries := summary.get(group), dict):
            rows += [(prefix + str(name), _text(value) + (" s" if group == "seconds" else ""))
                     for name, value in entries.items() if isinstance(value, int | float | str)]  # fmt: skip
    return [TextTable(f"From {path.name}", ("figure", "value"), rows)] if rows else []


def _text(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def camera_page(calibration: Calibration, name: str, *, quality: str = "real-time") -> Page:
    """Return the page of a camera file: its figures, and its curve over the frame where it is calibrated."""
    facts = calibration.summary()
    rows = [(key, _text(value)) for key, value in facts.items() if isinstance(value, int | float | str)]
    panels: list[Panel | Picture] = []
    width, height = calibration.sensor.width_px, calibration.sensor.height_px
    if calibration.is_calibrated and quality in calibration.depth:
        columns = min(width, _SHOWN_COLUMNS)
        rows_shown = round(columns * height / width)
        x, y = np.meshgrid(np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows_shown))
        model = calibration.depth[cast(Quality, quality)].at(x, y, width, height)
        shape = np.ones(x.shape)
        for title, values, unit, digits in (
            ("distance in focus", model.in_focus_mm * shape, "mm", 1),
            ("disparity at infinity, A", model.infinity_disparity_px * shape, "px", 3),
            ("scale, B", model.scale_px_mm * shape, "px mm", 1),
        ):
            values = np.where(np.isfinite(values), values, np.nan)
            panels.append(Panel(title, values, unit, *_ends(values), OTHER, digits, _facts(values, unit, digits)))
    return Page(
        title=name,
        subtitle=f"{calibration.pupil_title}, {width}x{height} px" + (f", quality {quality}" if panels else ""),
        panels=panels,
        tables=(TextTable("Camera", ("figure", "value"), rows),),
        notes=() if panels else (f"No depth curve of quality {quality}: this camera gives disparity in px.",),
    )
