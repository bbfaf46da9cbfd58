"""Photographs of a dual-pixel sensor with measured depth, through the same method: needs ``--data``.

The set is that of He et al. (ICCV 2025): a Canon RF 50 mm at f/4, focused at 1 m. Depth is scored against structured
light (boxes), a telephone and time of flight (casual). The learned networks were trained for this lens.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from matplotlib.figure import Figure

from chromaperture.calibration.flat_boards import Corrections, FlatCalibration, calibrate_flat_boards
from chromaperture.calibration.session import read_session
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.capture.files import read_image
from chromaperture.color.color_maps import DIFFERENCE, DISTANCE
from chromaperture.color.srgb import linear_to_srgb
from chromaperture.evaluation.figures import new_figure, show_image
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError
from chromaperture_paper.context import Context
from chromaperture_paper.registry import Chart, Content, CsvTable

FOLDER = Path("real") / "rf50_dual_pixel"  # below --data
BOARDS_MM = (600.0, 1500.0)
PRESCRIPTION = "rf50mm_prescription.json"
FOCUS_MM = 1000.0  # from the sensor, as the set states
# By which the focus of a photograph differs from that of the boards: of the casual scenes' medians, whose root mean
# square is .04 with the error of their truth; boxes took no part.
FOCUS_ERROR_PER_M = 0.03
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
    truth: np.ndarray
    frame: DepthFrame | None = None

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
    for number, quality in enumerate(qualities):
        context.progress(f"dual-pixel: {quality}", number, len(qualities) + 1)
        found += measured("two boards", calibrated(folder, quality).camera, quality, folder)
    corrections = None
    if not context.quick:
        context.progress("dual-pixel: prescription", len(qualities), len(qualities) + 1)
        known = calibrated(folder, "accurate", PRESCRIPTION)
        corrections = known.corrections
        found += measured("prescription", known.camera, "accurate", folder)
    return _content(found, corrections, folder)


_SESSION = """
[sensor]
width_px = 768
height_px = 512
pixel_pitch_mm = 0.046875  # full frame
dual_pixel = "left-right"

[lens]
nominal_focal_length_mm = 50
nominal_f_number = 4
focused_at_about_mm = {focus}
focus_error_per_m = {focus_error}
{prescription}

[board]
flat = true
measured_from = "pupil"  # then the focus that the boards show is the prescription's to 1 %; from the sensor 5 % nearer

[depth]
near_mm = 390  # the lens's closest focus
far_mm = 12000  # beyond the set's rooms
"""


def write_session(to: Path, folder: Path, prescription: str | None = PRESCRIPTION) -> None:
    """Write the session of the set's boards, which has none, into a folder beside it."""
    lens = f"prescription = '{folder.absolute() / prescription}'" if prescription else ""
    text = _SESSION.format(prescription=lens, focus=FOCUS_MM, focus_error=FOCUS_ERROR_PER_M)
    (to / "session.toml").write_text(text, encoding="utf-8")
    boards = "".join(f"{folder.absolute()}/flat_{mm:04.0f}_f4_left.png,{mm:.0f}\n" for mm in BOARDS_MM)
    (to / "distances.csv").write_text(f"file,ruler_mm\n{boards}", encoding="utf-8")


def calibrated(
    folder: Path, quality: Quality, prescription: str | None = None, *, corrected: bool = True
) -> FlatCalibration:
    """Calibrate the set's camera by its boards at one quality."""
    with tempfile.TemporaryDirectory() as session:
        write_session(Path(session), folder, prescription)
        return calibrate_flat_boards(read_session(session), corrected=corrected, qualities=(quality,))


def photograph(folder: Path, name: str) -> np.ndarray:
    """Read a scene as linear light; (H, W, 3) float32."""
    return read_image(folder / f"{name}_left.png", right=folder / f"{name}_right.png")


def scene_names(folder: Path) -> list[str]:
    """List the scenes that have a truth."""
    return sorted(path.name.removesuffix("_depth_mm.png") for path in folder.glob("*_depth_mm.png"))


def measured(
    line: str, calibration: Calibration, quality: Quality, folder: Path, *, spoil: Spoil = lambda image: image
) -> list[Scene]:
    """Measure and score every scene with a camera; ``spoil`` changes the photographs."""
    scenes, camera = [], CodedApertureCamera(calibration, default_config(calibration, quality))
    pupil_mm = calibration.depth[quality].sensor_to_pupil_mm  # the truth counts from there
    for name in scene_names(folder):
        frame = camera.measure(spoil(photograph(folder, name)))
        depth = np.asarray(frame.depth_mm, float) - pupil_mm
        scenes.append(scored(line, quality, name, folder, depth, frame.sigma_mm)._replace(frame=frame))
    return scenes


def scored(line: str, quality: Quality, name: str, folder: Path, depth: np.ndarray, sigma: np.ndarray) -> Scene:
    """Score a scene's depth from the entrance pupil, mm."""
    stored = cv2.imread(str(folder / f"{name}_depth_mm.png"), cv2.IMREAD_UNCHANGED)
    if stored is None:
        raise InputError(f"cannot read the depth of {name} in {folder}")
    truth = stored.astype(float)
    step = _STEP_MM if name.startswith(_STEPPED) else 0.0
    return Scene(line, quality, name, score(depth, sigma, truth, truth_step_mm=step), truth)


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
        lines.append(f"Told {corrections}.")
    return Content(
        source=f"{len(scene_names(folder))} scenes of {folder.name}; two flat boards.",
        charts=[Chart("scenes", figure(shown, folder), f"Quality {scenes[-1].quality}, calibrated by the "
                      f"{scenes[-1].line}: photograph, depth, its truth, and the difference of inverse depths (red: "
                      "too near).")] if shown else [],
        tables=[CsvTable("means", "Means of boxes and casual scenes", head, table),
                CsvTable("scenes", "Every scene", head, every)],
        lines=lines,
    )  # fmt: skip


def figure(scenes: Sequence[Scene], folder: Path) -> Figure:
    """Draw photograph, depth, truth and the difference of inverse depths of scenes."""
    drawn = new_figure(width=10, height=1.9 * len(scenes))
    for line, scene in zip(drawn.subplots(len(scenes), 4, squeeze=False), scenes, strict=True):
        truth = np.where(scene.truth >= LEAST_TRUTH_MM, scene.truth, np.nan) / 1000
        depth = np.full(truth.shape, np.nan) if scene.frame is None else np.asarray(scene.frame.depth_mm, float) / 1000
        seen = linear_to_srgb(photograph(folder, scene.name)[..., 1])
        low, high = (float(v) for v in np.nanpercentile(truth, (1, 99)))
        show_image(line[0], seen, scene.name, colors="gray")
        show_image(line[1], depth, "measured, m", bar="", colors=DISTANCE, vmin=low, vmax=high)
        show_image(line[2], truth, "truth, m", bar="", colors=DISTANCE, vmin=low, vmax=high)
        difference = 1 / depth - 1 / truth
        show_image(line[3], difference, "difference, 1/m", bar="", colors=DIFFERENCE, vmin=-0.3, vmax=0.3)
    return drawn
