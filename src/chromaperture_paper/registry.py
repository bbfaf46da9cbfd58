"""All exhibits by name, in the paper's order; an exhibit's module is imported when it is made."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from chromaperture.system.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from chromaperture_paper.context import Context


@dataclass(frozen=True)
class Comparison:
    """A quantity, the paper's value and ours with their units, and a sentence on the difference."""

    what: str
    paper: str
    ours: str
    why: str


@dataclass(frozen=True)
class Chart:
    """A figure, the stem of its file, and its caption."""

    stem: str
    figure: Figure
    caption: str


@dataclass(frozen=True)
class CsvTable:
    """A table of text and the stem of its CSV file; ``on_page`` is false for tables too long for the page."""

    stem: str
    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    on_page: bool = True


@dataclass(frozen=True)
class Content:
    """Content of one exhibit; ``source`` states what the input was."""

    source: str
    charts: Sequence[Chart] = ()
    tables: Sequence[CsvTable] = ()
    comparisons: Sequence[Comparison] = ()
    lines: Sequence[str] = ()


@dataclass(frozen=True)
class Exhibit:
    """A figure or table of the paper, or a comparison that belongs to it."""

    name: str  # on the command line, and of its folder
    title: str
    make: Callable[[Context], Content]
    files: tuple[str, ...] = ()  # that it reads below --data where such a folder is given
    only_data: bool = False  # whether it has no simulated input
    reads_all: bool = False  # whether it reads more of the data folder than these files, and camera files


_SESSION = ("cy_halves/session.toml", "cy_halves/distances.csv")
_WHITE = tuple(f"white/{name}.png" for name in ("open", "rgb_squares", "cy_halves", "cy_open"))
BENCH_DESIGNS = ("rgb_squares", "cmy_circles", "cy_halves", "magenta_annulus", "cy_open")
BENCH_SCENES = ("steps", "room", "desk")
_BENCH = (
    *(f"{design}/session.toml" for design in BENCH_DESIGNS),
    *(f"{design}/scene/{scene}.png" for design in BENCH_DESIGNS for scene in BENCH_SCENES),
    *(f"truth/{scene}.depth_0.1mm.png" for scene in BENCH_SCENES),
)
_DUAL_PIXEL = tuple(
    f"real/rf50_dual_pixel/{name}"
    for name in (
        *(f"flat_{mm}_f4_{side}.png" for mm in ("0600", "1500") for side in ("left", "right")),
        "rf50mm_prescription.json",
    )
)


def _make(where: str, function: str, context: Context) -> Content:
    content: Content = getattr(importlib.import_module(f"chromaperture_paper.{where}"), function)(context)
    return content


def _exhibit(
    where: str, name: str, title: str, files: tuple[str, ...] = (), *, only_data: bool = False, reads_all: bool = False
) -> Exhibit:
    """``where``: the module that has a function of the exhibit's name."""
    return Exhibit(name, title, partial(_make, where, name.replace("-", "_")), files, only_data, reads_all)


EXHIBITS: dict[str, Exhibit] = {
    exhibit.name: exhibit
    for exhibit in (
        _exhibit("figures", "figure-4a", "Figure 4(a): the CYX colour space"),
        _exhibit("figures", "figure-6", "Figure 6: calibration on the axis, by design and colour space"),
        _exhibit("figures", "figure-7", "Figure 7: baseline and in-focus surface over the frame", _SESSION),
        _exhibit("figures", "figure-8", "Figure 8: a flat floor before and after the fields"),
        _exhibit("figures", "figure-9", "Figure 9: layers against sub-pixel estimation", _SESSION),
        _exhibit("figures", "figure-10", "Figure 10: eight designs: capture, raw disparity, regularised"),
        _exhibit("figures", "figure-11", "Figure 11: light efficiency of the designs", _WHITE),
        _exhibit("figures", "figure-12", "Figure 12: what two cameras see"),
        _exhibit("figures", "figure-14", "Figure 14: effects by depth"),
        _exhibit("figure_15", "figure-15", "Figure 15: a 3D model from a moving camera"),
        _exhibit("tables", "table-1", "Table 1: transparency of designs VII, V and II", _WHITE),
        _exhibit("tables", "table-2", "Table 2: loss of signal-to-noise ratio", _WHITE),
        _exhibit("tables", "table-3", "Table 3: time for one image"),
        _exhibit("accuracy", "equal-light", "Depth error against light: is the ranking the paper's?"),
        _exhibit("prior_art", "prior-art", "Prior art on the same captures"),
        _exhibit("accuracy", "accuracy", "Depth error by distance, light, colour, and the Cramer-Rao bound"),
        _exhibit("quality", "quality", "Depth quality of a camera: flat walls by distance and by position",
                 reads_all=True),
        _exhibit("bench", "bench", "Methods and designs on ray-traced captures", _BENCH, only_data=True,
                 reads_all=True),
        _exhibit("dual_pixel", "dual-pixel", "Real photographs of a dual-pixel sensor", _DUAL_PIXEL, only_data=True,
                 reads_all=True),
    )
}  # fmt: skip


def chosen(names: Sequence[str]) -> list[Exhibit]:
    """Return exhibits by name, all for ``all`` or nothing; InputError suggests the nearest to an unknown name."""
    if not names or "all" in names:
        return list(EXHIBITS.values())
    for name in names:
        if name not in EXHIBITS:
            near = difflib.get_close_matches(name, EXHIBITS, n=1, cutoff=0.4)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise InputError(f"no figure {name!r}: {hint}Choose from {', '.join(EXHIBITS)}, or all")
    return [exhibit for exhibit in EXHIBITS.values() if exhibit.name in names]
