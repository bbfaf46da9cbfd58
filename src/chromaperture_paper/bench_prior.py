"""Prior methods on photographs, calibrated on the same boards and with the same fields as the project's own method.

A method reads every board; the curve d = A - B / z with its fields and its nonlinearity is fitted to the readings by
the code that fits the project's own, so that the results differ by the matching only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.calibration.curves import Evidence, fit_curve
from chromaperture.calibration.options import Cache
from chromaperture.calibration.place_boards import fit_distances
from chromaperture.calibration.read_boards import BoardMeasurement, grid
from chromaperture.calibration.session import Session, read_session
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.system.errors import InputError
from chromaperture_paper import methods

_BOARDS = 8  # at most, for each method, to limit the time
_SPAN = (1.2, 0.75)  # of the searched range over the camera's own: factor, and px added; chosen by hand
_LARGER_BLUR = 1.1  # of the searched blur over that of the camera's range; chosen by hand
_SIGMA_PX = 0.05  # of a board's median; small beside the error of the boards; chosen by hand
Measurement = tuple[str, str, np.ndarray, float]  # method, scene, depth in mm, seconds
Read = Callable[[np.ndarray], np.ndarray]


def measured(result: CalibrationResult, scenes: Sequence[str], *, keep_in: Path) -> Iterator[Measurement]:
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
) -> Iterator[Measurement]:
    """Measure scenes through the magenta annulus, which measures the size of the blur; see `measured`.

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
