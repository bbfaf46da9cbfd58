"""A comparison as one page: sentences, maps with their values under the cursor, histograms, tables."""

from __future__ import annotations

from typing import Any

import numpy as np

from chromaperture.color.color_maps import DIFFERENCE, DISTANCE, ERROR
from chromaperture.evaluation.compare import SHARES_PERCENT, CameraComparison, DepthComparison
from chromaperture.files.map_page import Bars, Page, Panel, Picture, TextTable

_BARS = 81  # of a histogram; odd, so that one is at 0
_WIDE = 480  # px of the map of a grid over the frame; chosen by hand
_SIGMAS = 5.0  # ends of the histogram of differences in error bars


def depth_page(found: DepthComparison, *, picture: np.ndarray | None = None) -> Page:
    """Return the page of two depth maps; ``picture`` (H, W, 3) uint8 sRGB of the same view is shown beside them."""
    a, b, figures = found.a, found.b, found.figures
    low, high = _ends(np.concatenate([_known(a.depth_mm), _known(b.depth_mm)]))
    most = _round_up(np.nanpercentile(np.abs(found.difference_percent), 95))
    panels: list[Panel | Picture] = [
        Panel(f"A: {a.name}", a.depth_mm, "mm", low, high, DISTANCE, 1),
        Panel(f"B: {b.name}", b.depth_mm, "mm", low, high, DISTANCE, 1),
        Panel("B − A", found.difference_percent, "%", -most, most, DIFFERENCE, 2,
              "Red: B is farther. 95 % of the pixels are within the colours."),
    ]  # fmt: skip
    if found.in_sigmas is not None:
        panels.append(Panel("B − A in error bars", found.in_sigmas, "σ", -4, 4, DIFFERENCE, 2))
    for name, stored in (("A", a), ("B", b)):
        if stored.sigma_mm is not None:
            top = _round_up(float(np.nanpercentile(stored.sigma_mm, 90)))
            panels.append(Panel(f"error bar of {name}", stored.sigma_mm, "mm", 0, top, ERROR, 1))
    if picture is not None and picture.shape[:2] == a.depth_mm.shape:
        panels.append(Picture("colour", picture))
    size = f"{figures['width_px']}x{figures['height_px']} px"
    return Page(
        title=f"{b.name} against {a.name}",
        subtitle=f"Depth maps, {size}. A is the reference of all shares and percentages.",
        sentences=_depth_sentences(figures),
        panels=panels,
        bars=_histograms(found),
        tables=_depth_tables(figures),
        notes=_notes(figures["error_bars"]),
    )


def _known(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values) & (values > 0)]


def _ends(values: np.ndarray) -> tuple[float, float]:
    low, high = (float(v) for v in np.percentile(values, (2, 98)))
    return (low, high) if high - low > 1e-3 * high else (low * 0.99, high * 1.01)


def _round_up(value: float) -> float:
    """Return the next of 1, 2, 5, 10, 20 ... that is not smaller; at least 0.01."""
    power = 10.0 ** np.floor(np.log10(max(float(value), 1e-2)))
    return float(next(m * power for m in (1, 2, 5, 10) if m * power >= value * 0.999 or m == 10))


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _depth_sentences(figures: dict[str, Any]) -> list[str]:
    known, within, spread = figures["known_share"], figures["within"], figures["difference_percent"]
    shares = ", ".join(f"{_percent(within[f'{n}_percent']['of_known_in_a'])} within {n} %" for n in SHARES_PERCENT)
    sentences = [
        f"Of the pixels that A knows, B has {shares}; those that B does not know count as wrong.",
        f"B is {abs(spread['median']):.2f} % {'farther' if spread['median'] > 0 else 'nearer'} in the median; half of "
        f"the pixels differ by less than {spread['median_absolute']:.2f} % "
        f"({figures['difference_mm']['median_absolute']:.1f} mm).",
        f"Known: {_percent(known['a'])} of the frame in A, {_percent(known['b'])} in B, "
        f"{_percent(known['both'])} in both.",
    ]
    return sentences + _honesty_sentence(figures["error_bars"])


def _honesty_sentence(bars: dict[str, Any] | None) -> list[str]:
    if bars is None:
        return ["Neither has an error bar beside it (NAME.sigma.tiff): what they promise cannot be judged."]
    whose = {"both": "of both together", "a": "of A", "b": "of B"}[bars["of"]]
    ratio = bars["spread_in_sigmas"]
    word = "about as wide as the differences" if 0.8 <= ratio <= 1.25 else (
        "too narrow for the differences" if ratio > 1 else "wider than the differences"
    )  # fmt: skip
    one, two = bars["within_1_sigma"], bars["within_2_sigma"]
    return [
        f"The error bars {whose} are {word}: {_percent(one['share'])} of the differences are within one (normal: "
        f"{_percent(one['normal'])}), {_percent(two['share'])} within two ({_percent(two['normal'])})."
    ]


def _notes(bars: dict[str, Any] | None) -> list[str]:
    if bars is None:
        return []
    notes = ["Error bars are combined as if independent; two measurements of one photograph share its noise."]
    if bars["of"] != "both":
        notes.append(f"Only {bars['of'].upper()} has an error bar: the other is taken as exact.")
    return notes


def _histograms(found: DepthComparison) -> list[Bars]:
    values = found.difference_percent[np.isfinite(found.difference_percent)]
    most = _round_up(float(np.percentile(np.abs(values), 95)))
    counts, _ = np.histogram(np.clip(values, -most, most), _BARS, (-most, most))
    made = [Bars(f"B − A, % of A; {len(values):,} pixels, the outermost bars hold the rest", counts, -most, most, "%")]
    if found.in_sigmas is not None:
        made.append(_sigma_bars(found.in_sigmas[np.isfinite(found.in_sigmas)]))
    return made


def _sigma_bars(values: np.ndarray) -> Bars:
    counts, edges = np.histogram(np.clip(values, -_SIGMAS, _SIGMAS), _BARS, (-_SIGMAS, _SIGMAS))
    at = (edges[1:] + edges[:-1]) / 2
    normal = len(values) * (edges[1] - edges[0]) * np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi)
    caption = "B − A in error bars; the line is a normal distribution, as honest error bars give it"
    return Bars(caption, counts, -_SIGMAS, _SIGMAS, "σ", normal)


def _depth_tables(figures: dict[str, Any]) -> list[TextTable]:
    within = figures["within"]
    shares = [
        (f"within {n} %", *(_percent(within[f"{n}_percent"][of]) for of in ("of_known_in_a", "of_known_in_both")))
        for n in SHARES_PERCENT
    ]
    rows = []
    for row in figures["by_distance"]:
        median = "-" if row["median_percent"] is None else f"{row['median_percent']:+.2f} %"
        spread = row.get("spread_in_sigmas")
        rows.append((
            f"{row['from_mm']:.0f} to {row['to_mm']:.0f} mm", f"{row['pixels']:,}", median,
            *(_percent(row[f"within_{n}_percent_of_known_in_a"]) for n in SHARES_PERCENT),
            "-" if spread is None else f"{spread:.2f}",
        ))  # fmt: skip
    head = ("distance in A", "pixels", "median", *(f"within {n} %" for n in SHARES_PERCENT), "spread, σ")
    return [
        TextTable("Shares", ("B − A", "of pixels known in A", "of pixels known in both"), shares),
        TextTable("By distance, a quarter of A's pixels each; a spread of 1 σ is an honest error bar", head, rows),
    ]


def camera_page(found: CameraComparison) -> Page:
    """Return the page of two cameras."""
    figures, a, b = found.figures, *found.names
    most = _round_up(float(np.nanpercentile(np.abs(found.difference_percent), 99)))
    chosen = sorted({0, len(found.distances_mm) // 2, len(found.distances_mm) - 1})
    panels: list[Panel | Picture] = [
        Panel(f"B − A at {found.distances_mm[i]:.0f} mm", _enlarged(found.difference_percent[i], found.aspect), "%",
              -most, most, DIFFERENCE, 2, "Over the frame.")
        for i in chosen
    ]  # fmt: skip
    within, spread = figures["within"], figures["difference_percent"]
    shares = ", ".join(f"{_percent(within[f'{n}_percent']['of_frame_and_distances'])} within {n} %"
                       for n in SHARES_PERCENT)  # fmt: skip
    sentences = [
        f"B reads A's disparities as A does: {shares}, of the frame and of the distances from "
        f"{figures['from_mm']:.0f} to {figures['to_mm']:.0f} mm.",
        f"In the median B is {abs(spread['median']):.2f} % {'farther' if spread['median'] > 0 else 'nearer'}; nine "
        f"tenths are between {spread['percentile_5']:+.2f} and {spread['percentile_95']:+.2f} %.",
        *(_honesty_sentence(figures["error_bars"]) if figures["error_bars"] else
          ["The camera files hold no error bars of their curves: whether they agree within them cannot be said."]),
    ]  # fmt: skip
    parameters = [(name, _text(v["a"]), _text(v["b"])) for name, v in figures["parameters"].items()]
    rows = [
        (f"{row['distance_mm']:.0f} mm", _signed(row["median_percent"]), _signed(row["largest_percent"], sign=False),
         _signed(row["calibration_sigma_percent"], sign=False))
        for row in figures["by_distance"]
    ]  # fmt: skip
    return Page(
        title=f"Camera {b} against {a}",
        subtitle=f"Design {figures['parameters']['design']['a']}, quality {found.quality}.",
        sentences=sentences,
        panels=panels,
        tables=(
            TextTable("Parameters", ("figure", "A", "B"), parameters),
            TextTable("By distance", ("distance in A", "median", "largest", "error bar of the calibrations"), rows),
        ),
        notes=("The error bars are those of the calibrations alone, and one calibration's errors go together over the "
               "frame: a share of 0 or 100 % within one error bar is no surprise.",),
    )  # fmt: skip


def _enlarged(values: np.ndarray, aspect: float) -> np.ndarray:
    """Return a small grid over the frame with every value a rectangle, so that the page draws no blur between them."""
    rows, columns = values.shape
    down = np.linspace(0, rows - 1e-6, round(_WIDE / aspect)).astype(int)
    right = np.linspace(0, columns - 1e-6, _WIDE).astype(int)
    return values[down[:, None], right].astype(np.float32)


def _signed(value: float | None, *, sign: bool = True) -> str:
    return "-" if value is None else f"{value:{'+' if sign else ''}.2f} %"


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.5g}" if isinstance(value, float) else str(value)
