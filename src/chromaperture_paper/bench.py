"""Methods x designs on ray-traced or real captures with known depth: needs ``--data``.

Every prior method reads the boards too, and the code that fits the project's own curve and fields fits its readings, so
that the results differ by the matching only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

from chromaperture.calibration.calibrate_session import CalibrationResult, calibrate_session
from chromaperture.calibration.curves import Evidence, fit_curve
from chromaperture.calibration.options import Cache, CalibrationConfig
from chromaperture.calibration.place_boards import fit_distances
from chromaperture.calibration.read_boards import BoardMeasurement, grid
from chromaperture.calibration.session import Session, read_session
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.color.color_maps import DISTANCE, color_map
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.evaluation.figures import new_figure
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError
from chromaperture_paper import methods
from chromaperture_paper.context import Context
from chromaperture_paper.registry import BENCH_DESIGNS as DESIGNS
from chromaperture_paper.registry import BENCH_SCENES as SCENES
from chromaperture_paper.registry import Chart, Content, CsvTable
from chromaperture_paper.world import full_name

_FIRST = "cy_halves"  # has tilted boards, which determine the lens of all designs
_SHOWN = "steps"
_SCORES = ("fill", "within_2", "within_5", "within_10", "median_error")
Row = tuple[str, str, str, dict[str, float], float]  # method, design, scene, scores, seconds


def bench(context: Context) -> Content:
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
            found = measured_by_annulus(data / design, first, truths, keep_in=_kept(context, design))
        else:
            result = first if design == _FIRST else _calibrated(context, data, design, first.calibration)
            calibration = given.get(design, result.calibration)
            found = _measured(data / design, calibration, qualities)
            if not context.quick:
                found = chain(found, measured_by_prior(result, SCENES, keep_in=_kept(context, design)))
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


_BOARDS = 8  # at most, for each method, to limit the time
_SPAN = (1.2, 0.75)  # of the searched range over the camera's own: factor, and px added; chosen by hand
_LARGER_BLUR = 1.1  # of the searched blur over that of the camera's range; chosen by hand
_SIGMA_PX = 0.05  # of a board's median; small beside the error of the boards; chosen by hand
Measured = tuple[str, str, np.ndarray, float]  # method, scene, depth in mm, seconds
Read = Callable[[np.ndarray], np.ndarray]


def measured_by_prior(result: CalibrationResult, scenes: Sequence[str], *, keep_in: Path) -> Iterator[Measured]:
    """Measure scenes by every prior method that can read the design; ``keep_in`` holds the readings of boards."""
    calibration, session = result.calibration, result.session
    low, high = calibration.disparity_range_px("real-time")
    factor, more = _SPAN
    span = (factor * low - more, factor * high + more)
    setting = methods.Setting(session.design, calibration.unmixing, span, max(np.abs(span)) / methods.HALVES_BETA)
    for name, method in methods.METHODS.items():
        if name.startswith("ours") or not methods.applies(name, session.design):
            continue

        def read(image: np.ndarray, method: methods.Method = method) -> np.ndarray:
            return method(image, setting)

        try:
            model = fitted(result.evidence, session, name, read, keep_in=keep_in)
        except InputError:  # no curve fits its readings of the boards
            nothing = np.full((session.sensor.height_px, session.sensor.width_px), np.nan)
            yield from ((name, scene, nothing, float("nan")) for scene in scenes)
            continue
        for scene in scenes:
            image = session.read(session.folder / "scene" / f"{scene}.png")
            depth, seconds = methods.timed(lambda image, model: disparity_to_depth(read(image), model)[0], image, model)
            yield name, scene, depth.astype(float), seconds


def measured_by_annulus(
    folder: Path, lens: CalibrationResult, truths: Mapping[str, np.ndarray], *, keep_in: Path
) -> Iterator[Measured]:
    """Measure scenes through the magenta annulus, which measures the size of the blur; see `measured_by_prior`.

    Distances of boards are by ruler, the pupil's position by another session of the same lens. The side of the focus
    is known for boards, so that all can be used. Scenes are taken to be beyond the focus, and a second time on the side
    of the truth (mm, by scene), which shows the cost of the ambiguity.
    """
    session = read_session(folder)
    rulers = np.array([*session.boards.values()])
    unknown = np.full(len(rulers), np.nan)
    distances = fit_distances(
        rulers,
        unknown,
        ruler_sigma_mm=max(session.ruler_error_mm / np.sqrt(3), 0.1),
        pose_sigma_mm=np.full(len(rulers), np.inf),
        sensor_to_pupil_mm=lens.evidence.distances.sensor_to_pupil_mm,
        sensor_to_pupil_sigma_mm=lens.evidence.distances.sigma_mm,
    )
    boards = [BoardMeasurement(p.name, r, {}, {}, {}) for p, r in session.boards.items()]
    evidence = Evidence(session.sensor, boards, distances, session.ruler_error_mm, np.ones(len(boards), bool))
    reach = np.abs(lens.calibration.disparity_range_px("paper")).max() / methods.HALVES_BETA
    setting = methods.Setting(session.design, np.zeros((0, 3)), (0.0, 0.0), float(_LARGER_BLUR * reach))

    def read(image: np.ndarray) -> np.ndarray:
        return methods.METHODS["annulus"](image, setting)

    focus = lens.calibration.in_focus_mm
    model = fitted(evidence, session, "annulus", read, keep_in=keep_in, sided=focus)
    for scene, truth in truths.items():
        image = session.read(session.folder / "scene" / f"{scene}.png")
        size, seconds = methods.timed(read, image)
        sign = np.where(truth < model.in_focus_mm, -1.0, 1.0)
        for name, value in (("annulus", size), ("annulus, told the side", sign * size)):
            yield name, scene, disparity_to_depth(value, model)[0].astype(float), seconds


def fitted(
    evidence: Evidence, session: Session, name: str, read: Read, *, keep_in: Path, sided: float | None = None
) -> DepthModel:
    """Read boards and fit the curve and its fields; ``sided`` is the focus, mm, if readings have no sign."""
    cache = Cache(keep_in)
    paths = list(session.boards)
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(_BOARDS, len(paths))).round().astype(int))
    used = np.zeros(len(paths), bool)
    used[chosen] = True
    used &= evidence.used
    width, height = session.sensor.width_px, session.sensor.height_px
    rows, columns = (grid(n, width).astype(int) for n in (height, width))
    middle = np.s_[height // 3 : -height // 3, width // 3 : -width // 3]
    boards = []
    for board, path, use in zip(evidence.boards, paths, used, strict=True):
        if not use:
            boards.append(_read_as(board, np.nan, np.full((len(rows), len(columns)), np.nan, np.float32)))
            continue

        def look(path: Path = path) -> dict[str, np.ndarray]:
            value = read(session.read(path))
            return {"middle": np.array(np.nanmedian(value[middle])), "grid": value[np.ix_(rows, columns)]}

        found = cache.get(path, ("prior", name, session.design), look)
        sign = -1.0 if sided is not None and board.ruler_mm < sided else 1.0
        boards.append(_read_as(board, sign * float(found["middle"]), sign * found["grid"].astype(np.float32)))
    curve = fit_curve(replace(evidence, boards=boards, used=used), "real-time")
    return curve.field.model(width, height)


def _read_as(board: BoardMeasurement, middle_px: float, grid_px: np.ndarray) -> BoardMeasurement:
    return replace(
        board, disparity_px={"real-time": middle_px}, sigma_px={"real-time": _SIGMA_PX}, grid_px={"real-time": grid_px}
    )
