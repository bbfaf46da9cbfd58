"""All exhibits by name, in the paper's order; an exhibit's module is imported when it is made."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

from chromaperture.system.errors import InputError
from chromaperture_paper.exhibit import Content, Exhibit

if TYPE_CHECKING:
    from chromaperture_paper.context import Context

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


def _exhibit(
    name: str, title: str, files: tuple[str, ...] = (), *, only_data: bool = False, reads_all: bool = False
) -> Exhibit:
    module = f"chromaperture_paper.{name.replace('-', '_')}"

    def make(context: Context) -> Content:
        content: Content = importlib.import_module(module).make(context)
        return content

    return Exhibit(name, title, make, files, only_data, reads_all)


EXHIBITS: dict[str, Exhibit] = {
    exhibit.name: exhibit
    for exhibit in (
        _exhibit("figure-4a", "Figure 4(a): the CYX colour space"),
        _exhibit("figure-6", "Figure 6: calibration on the axis, by design and colour space"),
        _exhibit("figure-7", "Figure 7: baseline and in-focus surface over the frame", _SESSION),
        _exhibit("figure-8", "Figure 8: a flat floor before and after the fields"),
        _exhibit("figure-9", "Figure 9: layers against sub-pixel estimation", _SESSION),
        _exhibit("figure-10", "Figure 10: eight designs: capture, raw disparity, regularised"),
        _exhibit("figure-11", "Figure 11: light efficiency of the designs", _WHITE),
        _exhibit("figure-12", "Figure 12: what two cameras see"),
        _exhibit("figure-14", "Figure 14: effects by depth"),
        _exhibit("figure-15", "Figure 15: a 3D model from a moving camera"),
        _exhibit("table-1", "Table 1: transparency of designs VII, V and II", _WHITE),
        _exhibit("table-2", "Table 2: loss of signal-to-noise ratio", _WHITE),
        _exhibit("table-3", "Table 3: time for one image"),
        _exhibit("equal-light", "Depth error against light: is the ranking the paper's?"),
        _exhibit("prior-art", "Prior art on the same captures"),
        _exhibit("accuracy", "Depth error by distance, light, colour, and the Cramer-Rao bound"),
        _exhibit("quality", "Depth quality of a camera: flat walls by distance and by position", reads_all=True),
        _exhibit("bench", "Methods and designs on ray-traced captures", _BENCH, only_data=True, reads_all=True),
        _exhibit("dual-pixel", "Real photographs of a dual-pixel sensor", _DUAL_PIXEL, only_data=True, reads_all=True),
    )
}


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
