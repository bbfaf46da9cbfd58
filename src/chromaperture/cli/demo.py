"""``chromaperture demo``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from chromaperture.cli.console import announce_duration, compile_kernels, print_json, print_reports, progress
from chromaperture.cli.console import out as console
from chromaperture.cli.options import Json, Quiet, Verbose

if TYPE_CHECKING:
    from chromaperture.camera.camera import DepthFrame
    from chromaperture.products.measure_file import Report

_CAPTIONS = {
    "still_life_cy_halves": "much parallax: near things stand before the wall, edges have a long error bar",
    "still_life_cy_open": "more light, little parallax: the wall at the top right should be as dark as with the halves",
}
# Where the sample's far wall, blurred and of two colours, fills the picture: rows and columns, in parts of the sides.
_WALL = (0.02, 0.30), (0.70, 0.98)
_TOO_SHORT = 2.0  # error bars; errors are as long in one pixel of twenty where the error bar is right


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")] = Path("chromaperture-demo"),
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Measure the captures that come with the package and write their depth maps."""
    from chromaperture.camera.camera import load_camera
    from chromaperture.frame.preview import middle_range
    from chromaperture.products.measure_file import measure_file
    from chromaperture.products.samples import SAMPLES, sample_camera, sample_image

    compile_kernels("accurate", quiet=quiet)
    reports: list[Report] = []
    depth_range_mm: tuple[float, float] | None = None
    with progress(quiet=quiet) as update:
        for i, name in enumerate(SAMPLES):

            def show(stage: str, i: int = i, name: str = name) -> None:
                update(f"{name}: {stage}", i, len(SAMPLES))

            camera = load_camera(sample_camera(name), quality="accurate")
            announce_duration(camera, len(SAMPLES), quiet=quiet or i > 0)
            options: dict[str, Any] = {"caption": _CAPTIONS[name], "depth_range_mm": depth_range_mm}
            reports.append(measure_file(sample_image(name), camera, out=out, listener=show, **options))
            depth_range_mm = depth_range_mm or middle_range(reports[0].frame.depth_mm, 2)  # both in the same colours
    if json:
        print_json([report.summary | {"files": [str(path) for path in report.files]} for report in reports])
    elif not quiet:
        print_reports(reports, verbose=verbose)
        for report, line in zip(reports, explain_walls(*(report.frame for report in reports)), strict=True):
            preview = next(f for f in report.files if f.name.endswith(".preview.png"))
            console.print(f"Look at [bold]{escape(str(preview))}[/]: {escape(line)}", soft_wrap=True)
        photo, camera_file = sample_image(SAMPLES[0]), sample_camera(SAMPLES[0])
        command = f"chromaperture refocus {photo} --camera {camera_file} --point 360,240 --out {out}/refocused.png"
        console.print(
            f"The photographs and their camera files lie in {photo.parent}. Next, focus one anew: {command}",
            soft_wrap=True, markup=False, highlight=False,
        )  # fmt: skip


def explain_walls(halves: DepthFrame, opened: DepthFrame) -> tuple[str, str]:
    """Say what the samples through halves and through the open band, one scene, show of its far wall."""
    (distance, sigma), (other, other_sigma) = wall_distance(halves), wall_distance(opened)
    first = f"cyan and yellow halves; the far wall at the top right is {distance:.0f} ± {sigma:.0f} mm away."
    second = "the same scene through the open band, which lets more light through and has little parallax; the wall "
    if math.isnan(other) or math.isnan(distance):
        return first, f"{second}cannot be compared."
    second += f"reads {other:.0f} ± {other_sigma:.0f} mm"
    off = other - distance
    if not abs(off) > _TOO_SHORT * other_sigma:
        return first, f"{second}, in agreement with the halves."
    side = "near" if off < 0 else "far"
    return first, (
        f"{second}, {abs(off):.0f} mm too {side}: its blur hides the little parallax that is left, and the error bar, "
        f"{abs(off) / other_sigma:.0f} times shorter than the error, does not show it. Take the halves for such walls."
    )


def wall_distance(frame: DepthFrame) -> tuple[float, float]:
    """Return the median distance and error bar of the wall at the top right, mm; NaN where nothing is known."""
    import numpy as np

    shape = frame.depth_mm.shape
    rows, columns = (slice(int(a * n), int(b * n)) for (a, b), n in zip(_WALL, shape, strict=True))
    depth, sigma = frame.depth_mm[rows, columns], frame.sigma_mm[rows, columns]
    known = np.isfinite(depth)
    if not known.any():
        return float("nan"), float("nan")
    return float(np.median(depth[known])), float(np.median(sigma[known]))
