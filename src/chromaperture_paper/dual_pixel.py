"""Photographs of a dual-pixel sensor with measured depth, through the same method: needs ``--data``.

The set is that of He et al. (ICCV 2025): a Canon RF 50 mm at f/4, focused at 1 m. Depth is scored against structured
light (boxes), a telephone and time of flight (casual). The learned networks were trained for this lens.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from matplotlib.figure import Figure

from chromaperture.color.color_maps import DIFFERENCE, DISTANCE
from chromaperture.evaluation.figures import new_figure, show_image
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError
from chromaperture_paper.context import Context
from chromaperture_paper.dual_pixel_camera import (
    Corrections,
    calibrated_by_boards,
    calibrated_by_prescription,
    camera_for,
    capture,
    lens_of_json,
)
from chromaperture_paper.registry import Chart, Content, CsvTable

FOLDER = Path("real") / "rf50_dual_pixel"  # below --data
BOARDS_MM = (600.0, 1500.0)
# Depths below are mixtures with the zeros of unknown pixels, made when the truth was resized: no lens focuses there.
LEAST_TRUTH_MM = 200.0
_STEP_MM = 10_000 / 255  # of 8-bit truth; its error is even over a step
_STEPPED = ("box", "iphone")  # scenes whose truth is stored so
_SHOWN = ("box_002", "iphone_003")
# AbsRel and share with ratio below 1.25 of networks, published by He et al. for the whole set, of which this is a part.
PUBLISHED: dict[str, dict[str, tuple[str, str]]] = {
    "network for this lens": {"boxes": (".091", ".947"), "casual": (".463", ".824")},
    "older network": {"boxes": (".298", ""), "casual": (".575", "")},
}
_SCORES = ("fill", "abs_rel", "ratio_below_1.25", "within_2_percent", "within_5_percent", "within_10_percent",
           "within_1_sigma", "within_2_sigma", "abs_rel_of_plausible")  # fmt: skip
Spoil = Callable[[np.ndarray], np.ndarray]


class Scene(NamedTuple):
    """A scene's scores by one line and quality, and what was measured."""

    line: str
    quality: Quality
    name: str
    scores: dict[str, float]
    frame: DepthFrame
    truth: np.ndarray

    @property
    def kind(self) -> str:
        """Boxes or casual, as published."""
        return "boxes" if self.name.startswith("box") else "casual"


def dual_pixel(context: Context) -> Content:
    """Measure all scenes by both lines."""
    if context.data is None:
        raise InputError("dual-pixel needs photographs: give their folder with --data")
    folder = context.data / FOLDER
    qualities: tuple[Quality, ...] = ("real-time",) if context.quick else ("paper", "real-time", "accurate")
    found: list[Scene] = []
    boards = {mm: capture(folder, f"flat_{mm:04.0f}_f4") for mm in BOARDS_MM}
    for number, quality in enumerate(qualities):
        context.progress(f"dual-pixel: {quality}", number, len(qualities) + 1)
        found += measured("two boards", calibrated_by_boards(boards, quality), quality, folder)
    corrections = None
    if not context.quick:
        context.progress("dual-pixel: prescription", len(qualities), len(qualities) + 1)
        camera, corrections = calibrated_by_prescription(lens_of_json(folder / "rf50mm_prescription.json"), boards)
        found += measured("prescription", camera, "accurate", folder)
    return _content(found, corrections, folder)


def scene_names(folder: Path) -> list[str]:
    """List the scenes that have a truth."""
    return sorted(path.name.removesuffix("_depth_mm.png") for path in folder.glob("*_depth_mm.png"))


def measured(
    line: str, calibration: Calibration, quality: Quality, folder: Path, *, spoil: Spoil = lambda image: image
) -> list[Scene]:
    """Measure and score every scene with a camera; ``spoil`` changes the photographs."""
    scenes = []
    for name in scene_names(folder):
        image = spoil(capture(folder, name))
        frame = camera_for(image, calibration, quality).measure(image)
        stored = cv2.imread(str(folder / f"{name}_depth_mm.png"), cv2.IMREAD_UNCHANGED)
        if stored is None:
            raise InputError(f"cannot read the depth of {name} in {folder}")
        truth = stored.astype(float)
        step = _STEP_MM if name.startswith(_STEPPED) else 0.0
        scores = score(np.asarray(frame.depth_mm, float), frame.sigma_mm, truth, truth_step_mm=step)
        scenes.append(Scene(line, quality, name, scores, frame, truth))
    return scenes


def score(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray, *, truth_step_mm: float = 0.0) -> dict[str, float]:
    """Compute the published scores and ours.

    ``depth``, ``sigma`` (H, W) float, mm, NaN unknown; ``truth`` (H, W) float, mm, 0 unknown; ``truth_step_mm``: by
    which the truth was rounded: an error of its own beside sigma. Returns shares of ALL pixels with known truth; the
    means ``abs_rel`` and the shares of sigma, of those answered. ``abs_rel_of_plausible`` leaves out truth below
    `LEAST_TRUTH_MM`.
    """
    known = truth > 0
    answered = known & np.isfinite(depth)
    safe = np.where(known, truth, 1.0)
    relative = np.where(answered, np.abs(depth - truth) / safe, np.inf)
    ratio = np.where(answered, np.maximum(depth / safe, safe / np.where(answered, depth, 1.0)), np.inf)
    standard = np.abs(depth - truth)[answered] / np.hypot(sigma, truth_step_mm / np.sqrt(12))[answered]
    plausible = answered & (truth >= LEAST_TRUTH_MM)
    return {
        "fill": float(answered.sum() / known.sum()),
        "abs_rel": float(relative[answered].mean()),
        "ratio_below_1.25": float((ratio[known] < 1.25).mean()),
        **{f"within_{p}_percent": float((relative[known] < p / 100).mean()) for p in (2, 5, 10)},
        "within_1_sigma": float((standard < 1).mean()),
        "within_2_sigma": float((standard < 2).mean()),
        "abs_rel_of_plausible": float(relative[plausible].mean()),
    }


def means(scenes: Sequence[Scene]) -> dict[tuple[str, str, str], dict[str, float]]:
    """Average the scores of boxes and of casual scenes; by line, quality and kind."""
    groups: dict[tuple[str, str, str], list[dict[str, float]]] = {}
    for scene in scenes:
        groups.setdefault((scene.line, scene.quality, scene.kind), []).append(scene.scores)
    return {key: {name: float(np.mean([s[name] for s in found])) for name in _SCORES} for key, found in groups.items()}


def _content(scenes: Sequence[Scene], corrections: Corrections | None, folder: Path) -> Content:
    table = [(*key, *(f"{values[name]:.3f}" for name in _SCORES)) for key, values in means(scenes).items()]
    for name, figures in PUBLISHED.items():
        for kind, (relative, share) in figures.items():
            empty = [""] * (len(_SCORES) - 3)
            table.append((name, "as published", kind, "", relative, share, *empty))
    every = [(s.line, s.quality, s.name, *(f"{s.scores[name]:.3f}" for name in _SCORES)) for s in scenes]
    head = ("calibrated by", "quality", "scenes", *(name.replace("_", " ") for name in _SCORES))
    shown = [s for s in scenes if s.name in _SHOWN and (s.line, s.quality) == (scenes[-1].line, scenes[-1].quality)]
    lines = [
        "Shares are of all pixels with known truth. AbsRel of all includes pixels of the time-of-flight truth below "
        f"{LEAST_TRUTH_MM:.0f} mm, half a percent, which are mixtures of depth and zero: they alone raise it twofold."
    ]
    if corrections:
        lines.append(correction_sentence(corrections))
    return Content(
        source=f"{len(scene_names(folder))} scenes of {folder.name}; two flat boards.",
        charts=[Chart("scenes", figure(shown, folder), f"Quality {scenes[-1].quality}, calibrated by the "
                      f"{scenes[-1].line}: photograph, depth, its truth, and the difference of inverse depths (red: "
                      "too near).")] if shown else [],
        tables=[CsvTable("means", "Means of boxes and casual scenes", head, table),
                CsvTable("scenes", "Every scene", head, every)],
        lines=lines,
    )  # fmt: skip


def correction_sentence(found: Corrections) -> str:
    """Say what was taken from the boards."""
    return (
        f"From the two boards: the sensor's crosstalk (slope {found.halves.slope:.3f}, halved "
        f"{found.halves.half_slope_px:.0f} px off the middle), the focus {found.focus_mm:.0f} mm from the pupil, by "
        f"the prescription {found.designed_focus_mm:.0f} mm, and the scale, {100 * (found.scale_ratio - 1):+.1f} %. "
        f"The boards scatter about the curve by {' and '.join(f'{s:.3f}' for s in found.scatter)} 1/m."
    )


def figure(scenes: Sequence[Scene], folder: Path) -> Figure:
    """Draw photograph, depth, truth and the difference of inverse depths of scenes."""
    drawn = new_figure(width=10, height=1.9 * len(scenes))
    for line, scene in zip(drawn.subplots(len(scenes), 4, squeeze=False), scenes, strict=True):
        truth = np.where(scene.truth >= LEAST_TRUTH_MM, scene.truth, np.nan) / 1000
        depth = np.asarray(scene.frame.depth_mm, float) / 1000
        photograph = capture(folder, scene.name, linear=lambda stored: stored)[..., 1]
        low, high = (float(v) for v in np.nanpercentile(truth, (1, 99)))
        show_image(line[0], photograph, scene.name, colors="gray")
        show_image(line[1], depth, "measured, m", bar="", colors=DISTANCE, vmin=low, vmax=high)
        show_image(line[2], truth, "truth, m", bar="", colors=DISTANCE, vmin=low, vmax=high)
        difference = 1 / depth - 1 / truth
        show_image(line[3], difference, "difference, 1/m", bar="", colors=DIFFERENCE, vmin=-0.3, vmax=0.3)
    return drawn
