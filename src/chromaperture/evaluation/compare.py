"""Two depth maps, or two cameras, side by side: how far apart they are, and whether their error bars say so."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.special import erf

from chromaperture.color.color_maps import DIFFERENCE, DISTANCE, ERROR
from chromaperture.depth.conversion import depth_and_sigma, depth_to_disparity
from chromaperture.files.map_page import Bars, Page, Panel, Picture, TextTable
from chromaperture.model.camera_file import Calibration
from chromaperture.products.result_files import StoredDepth
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError

SHARES_PERCENT = (1, 2, 5)
# Maps of one view that are so many times as far are in different units: cm, 0.1 mm or m, TUM's and 7-Scenes' counts.
_UNIT_RATIOS, _NEAR_RATIO = (4.0, 5.0, 10.0, 100.0, 1000.0), 0.1  # the last: relative; both chosen by hand
_MAD = 0.6745  # median of |x| of a normal distribution of standard deviation 1
_GRID, _DISTANCES = 33, 24  # a side, of positions in the frame, and distances; chosen by hand, 0.1 s


@dataclass(frozen=True)
class DepthComparison:
    """Two maps of one size, B against A."""

    a: StoredDepth
    b: StoredDepth
    difference_percent: np.ndarray  # (H, W) float32: B - A, of A; NaN where either is unknown
    in_sigmas: np.ndarray | None  # (H, W) float32: B - A in units of the error bars that there are, independent
    figures: dict[str, Any]  # of `chromaperture compare --json`


def compare_depth(a: StoredDepth, b: StoredDepth) -> DepthComparison:
    """Compare two depth maps of the same view; A is what shares and percentages refer to."""
    if a.depth_mm.shape != b.depth_mm.shape:
        sizes = " and ".join(f"{m.depth_mm.shape[1]}x{m.depth_mm.shape[0]}" for m in (a, b))
        raise InputError(f"the maps have different sizes, {sizes} px; compare maps of one view at one size")
    in_a, in_b = (np.isfinite(m.depth_mm) & (m.depth_mm > 0) for m in (a, b))
    both = in_a & in_b
    if not both.any():
        raise InputError("no pixel has a depth in both maps; compare maps of the same view")
    with np.errstate(invalid="ignore", divide="ignore"):
        difference = np.where(both, b.depth_mm - a.depth_mm, np.float32(np.nan)).astype(np.float32)
        percent = (100 * difference / a.depth_mm).astype(np.float32)
    sigmas = [(name, m.sigma_mm) for name, m in (("a", a), ("b", b)) if m.sigma_mm is not None]
    in_sigmas = None
    if sigmas:
        variance = np.sum([np.square(s, dtype=np.float64) for _, s in sigmas], axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            in_sigmas = np.where(variance > 0, difference / np.sqrt(variance), np.nan).astype(np.float32)
    figures = {
        "kind": "depth",
        "a": a.name,
        "b": b.name,
        "width_px": a.depth_mm.shape[1],
        "height_px": a.depth_mm.shape[0],
        "known_share": {"a": float(in_a.mean()), "b": float(in_b.mean()), "both": float(both.mean())},
        "difference_mm": _spread(difference[both]),
        "difference_percent": _spread(percent[both]),
        "unit_ratio": _unit_ratio(float(np.median(b.depth_mm[both] / a.depth_mm[both]))),
        "within": _shares(percent, in_a, both),
        "error_bars": _honesty(in_sigmas, "".join(name for name, _ in sigmas)),
        "by_distance": _by_distance(a.depth_mm, percent, in_sigmas, in_a, both),
    }
    return DepthComparison(a, b, percent, in_sigmas, figures)


def _unit_ratio(ratio: float) -> float | None:
    """Return by how much the units of the maps seem to differ, B over A; None where they seem the same."""
    for factor in _UNIT_RATIOS:
        for expected in (factor, 1 / factor):
            if abs(ratio / expected - 1) < _NEAR_RATIO:
                return expected
    return None


def _spread(values: np.ndarray) -> dict[str, float]:
    low, middle, high = np.percentile(values, (5, 50, 95))
    return {
        "percentile_5": float(low),
        "median": float(middle),
        "percentile_95": float(high),
        "median_absolute": float(np.median(np.abs(values))),
    }


def _shares(percent: np.ndarray, in_a: np.ndarray, both: np.ndarray) -> dict[str, Any]:
    """Shares of all pixels known in A (those unknown in B are not within anything), and of those known in both."""
    with np.errstate(invalid="ignore"):
        near = {limit: np.abs(percent) <= limit for limit in SHARES_PERCENT}
    return {
        f"{limit}_percent": {
            "of_known_in_a": float(inside[in_a].mean()),
            "of_known_in_both": float(inside[both].mean()),
        }
        for limit, inside in near.items()
    }


def _honesty(in_sigmas: np.ndarray | None, of: str) -> dict[str, Any] | None:
    """Shares of differences within 1, 2 and 3 error bars, and of a normal distribution; None without error bars."""
    if in_sigmas is None:
        return None
    known = np.abs(in_sigmas[np.isfinite(in_sigmas)].astype(np.float64))
    if not known.size:
        return None
    shares = {
        f"within_{k}_sigma": {"share": float((known <= k).mean()), "normal": float(erf(k / np.sqrt(2)))}
        for k in (1, 2, 3)
    }
    ratio = float(np.median(known) / _MAD)
    return {"of": {"ab": "both", "a": "a", "b": "b"}[of], "pixels": int(known.size), "spread_in_sigmas": ratio} | shares


def _by_distance(
    depth_mm: np.ndarray, percent: np.ndarray, in_sigmas: np.ndarray | None, in_a: np.ndarray, both: np.ndarray
) -> list[dict[str, Any]]:
    """Return the same figures for the nearest to the farthest quarter of the pixels of A."""
    edges = np.unique(np.percentile(depth_mm[in_a], (0, 25, 50, 75, 100)))
    rows = []
    for low, high in itertools.pairwise(edges):
        last = high == edges[-1]
        with np.errstate(invalid="ignore"):
            here = in_a & (depth_mm >= low) & ((depth_mm <= high) if last else (depth_mm < high))
        matched = here & both
        if not here.any():
            continue
        row: dict[str, Any] = {"from_mm": float(low), "to_mm": float(high), "pixels": int(here.sum())}
        row["median_percent"] = float(np.median(percent[matched])) if matched.any() else None
        row |= {f"within_{n}_percent_of_known_in_a": float((np.abs(percent[matched]) <= n).sum() / here.sum())
                for n in SHARES_PERCENT}  # fmt: skip
        if in_sigmas is not None:
            known = np.abs(in_sigmas[matched])
            known = known[np.isfinite(known)]
            row["spread_in_sigmas"] = float(np.median(known) / _MAD) if known.size else None
        rows.append(row)
    return rows


@dataclass(frozen=True)
class CameraComparison:
    """Two cameras of one design: which depth B reads where A reads another."""

    names: tuple[str, str]  # (str, str)
    quality: str
    distances_mm: np.ndarray  # (D,) float: as camera A has them, evenly in 1 / distance over the range of both
    # (D, G, G) float: what B makes of A's disparity, less A's depth, % of it; over a grid of positions, to the corners
    difference_percent: np.ndarray
    aspect: float  # width of the frame over its height
    figures: dict[str, Any]


_COMPARED = ("design", "width_px", "height_px", "focal_length_mm", "f_number", "pixel_pitch_mm", "sensor_to_pupil_mm",
             "in_focus_mm", "baseline_mm", "infinity_disparity_px", "scale_px_mm", "near_mm", "far_mm")  # fmt: skip


def compare_cameras(
    a: Calibration, b: Calibration, *, names: tuple[str, str] = ("A", "B"), quality: str = "real-time"
) -> CameraComparison:
    """Compare what two camera files of one design and aspect make of a disparity, over frame and range."""
    for name, camera in zip(names, (a, b), strict=True):
        if not camera.is_calibrated or quality not in camera.depth:
            raise InputError(f"{name} has no depth curve of quality {quality}; calibrate it, or choose --quality")
    if a.design != b.design:
        raise InputError(
            f"the cameras have different designs, {a.design} and {b.design}, whose disparities are not the same "
            "quantity; compare depth maps that they measured"
        )
    ratio = b.sensor.width_px / a.sensor.width_px
    if abs(b.sensor.height_px / a.sensor.height_px / ratio - 1) > 0.01:  # 1 %: sizes are rounded to whole pixels
        raise InputError("the frames of the cameras have different aspects; compare cameras of one sensor")
    near, far = max(a.near_mm, b.near_mm), min(a.far_mm, b.far_mm)
    if not near < far:
        raise InputError("the ranges of the cameras have no distance in common; calibrate one of them again")
    distances = 1 / np.linspace(1 / near, 1 / min(far, 1e6), _DISTANCES)
    curves = []
    for camera in (a, b):
        width, height = camera.sensor.width_px, camera.sensor.height_px
        x, y = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
        curves.append(camera.depth[cast(Quality, quality)].at(x, y, width, height))
    found = np.empty((3, _DISTANCES, _GRID, _GRID))
    for i, distance in enumerate(distances):
        disparity = depth_to_disparity(np.full((_GRID, _GRID), distance), curves[0])
        exact = np.zeros_like(disparity)
        _, sigma_a = depth_and_sigma(disparity, exact, curves[0], max_depth_mm=1e7)
        depth_b, sigma_b = depth_and_sigma(disparity * ratio, exact, curves[1], max_depth_mm=1e7)
        found[:, i] = depth_b, sigma_a, sigma_b
    depth_b, sigma_a, sigma_b = found
    percent = 100 * (depth_b / distances[:, None, None] - 1)
    sigma = 100 * np.hypot(sigma_a, sigma_b) / distances[:, None, None]
    known = np.isfinite(percent)
    if not known.any():
        raise InputError("camera B gives no depth for the disparities of camera A; they focus at other distances")
    with np.errstate(invalid="ignore", divide="ignore"):
        in_sigmas = np.where(sigma > 0, percent / sigma, np.nan)
    tables = [camera.summary() for camera in (a, b)]
    figures = {
        "kind": "camera",
        "a": names[0],
        "b": names[1],
        "quality": quality,
        "parameters": {name: {"a": tables[0][name], "b": tables[1][name]} for name in _COMPARED},
        "from_mm": near,
        "to_mm": float(distances[-1]),
        "difference_percent": _spread(percent[known]),
        "within": {f"{n}_percent": {"of_frame_and_distances": float((np.abs(percent) <= n).mean())}
                   for n in SHARES_PERCENT},
        "error_bars": _honesty(in_sigmas, "ab"),
        "by_distance": [
            {
                "distance_mm": float(distance),
                "median_percent": float(np.nanmedian(row)) if np.isfinite(row).any() else None,
                "largest_percent": float(np.nanmax(np.abs(row))) if np.isfinite(row).any() else None,
                "calibration_sigma_percent": float(np.nanmedian(bar)) if np.isfinite(bar).any() else None,
            }
            for distance, row, bar in zip(distances, percent, sigma, strict=True)
        ],
    }  # fmt: skip
    return CameraComparison(names, quality, distances, percent, a.sensor.width_px / a.sensor.height_px, figures)


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
    ratio = figures["unit_ratio"]
    sentences = [] if ratio is None else [
        f"B's distances are {ratio:g} times those of A: one of them seems not to be in mm. State its unit in the name "
        "of its file, such as NAME.depth_0.1mm.png or NAME.depth_m.tiff, and compare again."
    ]  # fmt: skip
    sentences += [
        f"Of the pixels that A knows, B has {shares}; those that B does not know count as wrong.",
        f"B is {abs(spread['median']):.2f} % {'farther' if spread['median'] > 0 else 'nearer'} in the median; half of "
        f"the pixels differ by less than {spread['median_absolute']:.2f} % "
        f"({figures['difference_mm']['median_absolute']:.1f} mm).",
        f"Known: {_percent(known['a'])} of the frame in A, {_percent(known['b'])} in B, "
        f"{_percent(known['both'])} in both.",
    ]
    return sentences + _honesty_sentence(figures["error_bars"])


_OUTSIDE = 0.05  # of the pixels: so many more outside two error bars than normal are said; chosen by hand


def _honesty_sentence(bars: dict[str, Any] | None) -> list[str]:
    if bars is None:
        return ["Neither has an error bar beside it (NAME.sigma.tiff): what they promise cannot be judged."]
    whose = {"both": "of both together", "a": "of A", "b": "of B"}[bars["of"]]
    ratio = bars["spread_in_sigmas"]
    word = "about as wide as the differences" if 0.8 <= ratio <= 1.25 else (
        "too narrow for the differences" if ratio > 1 else "wider than the differences"
    )  # fmt: skip
    one, two = bars["within_1_sigma"], bars["within_2_sigma"]
    if ratio <= 1.25 and two["share"] < two["normal"] - _OUTSIDE:
        word += " of most pixels, but too narrow for the largest"
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
