"""Methods x designs on ray-traced or real captures with known depth: needs ``--data``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import CalibrationResult, calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.color_maps import DISTANCE, color_map
from chromaperture.evaluation.figures import new_figure
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError
from chromaperture_paper import bench_prior, methods
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Chart, Content, CsvTable
from chromaperture_paper.registry import BENCH_DESIGNS as DESIGNS
from chromaperture_paper.registry import BENCH_SCENES as SCENES
from chromaperture_paper.world import full_name

_FIRST = "cy_halves"  # has tilted boards, which determine the lens of all designs
_SHOWN = "steps"
_SCORES = ("fill", "within_2", "within_5", "within_10", "median_error")
Row = tuple[str, str, str, dict[str, float], float]  # method, design, scene, scores, seconds


def make(context: Context) -> Content:
    """Calibrate each design's session for every method and measure its scenes."""
    data = context.data
    if data is None:
        raise InputError("bench needs photographs: give their folder with --data")
    qualities: tuple[Quality, ...] = ("real-time",) if context.quick else ("paper", "real-time", "accurate")
    given = {c.design: c for c in (Calibration.load(path) for path in context.cameras)}
    first = _calibrated(context, data, _FIRST, None)
    truths = {scene: truth_mm(data, scene) for scene in SCENES}
    rows: list[Row] = []
    found: Iterable[tuple[str, str, np.ndarray, float]]
    pictures: dict[tuple[str, str], np.ndarray] = {}
    for number, design in enumerate(DESIGNS):
        context.progress(f"bench: {design}", number, len(DESIGNS))
        if design == "magenta_annulus":
            found = bench_prior.measured_by_annulus(data / design, first, truths, keep_in=_kept(context, design))
        else:
            result = first if design == _FIRST else _calibrated(context, data, design, first.calibration)
            calibration = given.get(design, result.calibration)
            found = _measured(data / design, calibration, qualities)
            if not context.quick:
                found = chain(found, bench_prior.measured(result, SCENES, keep_in=_kept(context, design)))
        for method, scene, depth, seconds in found:
            rows.append((method, design, scene, methods.scores(depth, truths[scene]), seconds))
            if scene == _SHOWN:
                pictures[method, design] = depth
    return _content(rows, pictures, truths[_SHOWN], blurred=[d for d, c in given.items() if c.blur is not None])


def _kept(context: Context, design: str) -> Path:
    return context.work / f"calibrating-data-{design}"


def _calibrated(context: Context, data: Path, design: str, lens: Calibration | None) -> CalibrationResult:
    """Calibrate without the lens's blur, which takes long; camera files given with --camera may have it."""
    return calibrate_session(
        data / design, CalibrationConfig(lens_blur=False), lens_from=lens, keep_in=_kept(context, design),
        progress=context.progress,
    )  # fmt: skip


def _measured(
    folder: Path, calibration: Calibration, qualities: tuple[Quality, ...]
) -> Iterator[tuple[str, str, np.ndarray, float]]:
    """Measure the scenes with the project's own method; yields method, scene, depth in mm, seconds."""
    for quality in qualities:
        camera = CodedApertureCamera(calibration, default_config(calibration, quality))
        camera.measure(camera.read(folder / "scene" / f"{SCENES[0]}.png"))  # compiles, fills tables
        for scene in SCENES:
            image = camera.read(folder / "scene" / f"{scene}.png")
            frame, seconds = methods.timed(camera.measure, image)
            yield f"ours, {quality}", scene, np.asarray(frame.depth_mm, float), seconds


def _content(
    rows: list[Row], pictures: dict[tuple[str, str], np.ndarray], truth: np.ndarray, *, blurred: list[str]
) -> Content:
    designs = [d for d in DESIGNS if any(row[1] == d for row in rows)]
    names = list(dict.fromkeys(row[0] for row in rows))
    best = [
        (name, *(_cell([r[3] for r in rows if r[:2] == (name, d)]) for d in designs), "no disparity",
         f"{1000 * float(np.nanmean([r[4] for r in rows if r[0] == name])):.0f}")
        for name in names
    ]  # fmt: skip
    every = [
        (*names, *(f"{scores[k]:.4f}" for k in _SCORES), f"{1000 * seconds:.0f}") for *names, scores, seconds in rows
    ]
    head = ("method", *(full_name(d) for d in (*designs, "open")), "time, ms")
    listed = [
        CsvTable("bench", "Fractions of ALL pixels whose depth is right within 2 % / within 5 %, fill; mean of "
                 f"{', '.join(SCENES)}", head, best),
        CsvTable("scenes", "Every scene", ("method", "design", "scene", "fill", "within 2 %", "within 5 %",
                                           "within 10 %", "median error", "time, ms"), every),
    ]  # fmt: skip
    accurate = f"with the lens's blur for {', '.join(blurred)} and without for the others" if blurred else "without it"
    return Content(
        f"From {len(designs)} sessions in --data.",
        [
            Chart(
                "scenes",
                _figure(names, designs, pictures, truth),
                f"Depth of {_SHOWN}; red is near, blue far, grey unknown.",
            )
        ],
        listed,
        lines=[
            "Every method has the same calibration: curve and fields of d = A - B / z, fitted to its own readings of "
            "the design's boards (prior methods: at most eight). An empty cell is a design that the method cannot "
            "read: stereo pairs must be shifted along x, and the annulus has a method of its own. VIII, the open "
            "pupil, has no disparity and no method here can read it.",
            f"Quality accurate takes the lens's blur from the camera file only; here {accurate}.",
        ],
    )


def _figure(
    names: list[str], designs: list[str], pictures: dict[tuple[str, str], np.ndarray], truth: np.ndarray
) -> Figure:
    figure = new_figure(width=1.9 * len(designs) + 1.2, height=1.15 * len(names) + 0.5)
    low, high = (float(v) for v in np.nanpercentile(truth, (1, 99)))
    panels = figure.subplots(len(names), len(designs), squeeze=False)
    for line, name in zip(panels, names, strict=True):
        for axes, design in zip(line, designs, strict=True):
            axes.set_xticks([])
            axes.set_yticks([])
            if (name, design) in pictures:
                axes.imshow(pictures[name, design][::2, ::2], cmap=color_map(DISTANCE), vmin=low, vmax=high)
            else:
                axes.set_frame_on(False)
        line[0].set_ylabel(name.replace(", ", ",\n").replace(" cross-", "\ncross-"), fontsize=7)
    for axes, design in zip(panels[0], designs, strict=True):
        axes.set_title(full_name(design), fontsize=8)
    return figure


def _cell(scores: list[dict[str, float]]) -> str:
    if not scores:
        return ""
    if not any(s["fill"] for s in scores):
        return "boards not read"
    two, five, fill = (float(np.mean([s[k] for s in scores])) for k in ("within_2", "within_5", "fill"))
    return f"{two:.1%} / {five:.1%}, {fill:.0%}"


def truth_mm(data: Path, scene: str) -> np.ndarray:
    """Read a scene's true depth; (H, W) float64, mm, NaN unknown."""
    path = data / "truth" / f"{scene}.depth_0.1mm.png"
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if stored is None:
        raise InputError(f"cannot read {path}")
    return np.where(stored > 0, stored / 10.0, np.nan)
