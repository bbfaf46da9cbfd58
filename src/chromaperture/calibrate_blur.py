"""The last step of a calibration: the lens's blur over the frame, and the depth curve that matching with it reads."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from chromaperture.calibration import Calibration
from chromaperture.color.unmixing import ideal_unmixing
from chromaperture.config import PhaseConfig
from chromaperture.depth.blur_fit import BlurFit, fit_blur, measured_layers
from chromaperture.depth.conversion import DepthModel
from chromaperture.depth.field import DepthField, fit_depth_field
from chromaperture.errors import InputError
from chromaperture.optics.aperture import centroids
from chromaperture.optics.blur import BlurModel, FieldBlur, sample_pupil
from chromaperture.session import Session

Progress = Callable[[str, int, int], None]
MIN_BOARDS = 4
_MEASURED_BOARDS = 16  # that fix the depth curve of the layers; the blur itself is fitted to all
_CELLS = 12  # along the width, in which a board's layer is measured
_DEGREES = (4, 2, 0)  # of the curve's fields; lower where few boards are there
_START_RIM = {"front_rim_radius": 1.08, "front_rim_shift": 0.33, "rear_rim_radius": 1.08, "rear_rim_shift": 0.33}


def add_blur(
    calibration: Calibration,
    session: Session,
    notes: list[str],
    *,
    progress: Progress = lambda what, done, total: None,
) -> tuple[Calibration, BlurFit | None]:
    """Fit the blur and give the camera with it; the camera as it was, and a note, where the boards do not suffice.

    Parameters
    ----------
    calibration : Calibration
        Film and depth curves of the shifted views.
    session : Session
    notes : list of str
        Extended by what the user should know.
    progress : callable, optional

    Returns
    -------
    calibration : Calibration
        With ``blur`` and a new ``depth["accurate"]``.
    fit : BlurFit or None
    """
    if len(session.boards) < MIN_BOARDS:
        notes.append(f"{len(session.boards)} boards do not fix the lens's blur: quality accurate matches shifted views")
        return calibration, None
    axis = calibration.on_axis("paper")
    delta = float(axis.sensor_to_pupil_mm)
    boards = {path: 1 / (ruler - delta) for path, ruler in session.boards.items()}

    def photographs() -> Iterator[tuple[np.ndarray, float]]:
        for path, inverse_mm in boards.items():
            yield session.read(path), inverse_mm

    fit = fit_blur(photographs(), _start(calibration, axis), board_count=len(boards), progress=progress)
    field = _measure_curve(session, boards, fit.blur, delta, progress)
    if field is None:
        notes.append("the boards do not agree on the lens's blur: quality accurate matches shifted views")
        return calibration, None
    depth = {**calibration.depth, "accurate": field}
    return replace(calibration, blur=fit.blur.model, depth=depth), fit


def _start(calibration: Calibration, axis: DepthModel) -> FieldBlur:
    """Give a thin lens of the measured focus and scale: centroids sit at a known share of the pupil's radius."""
    reach = float(np.linalg.norm(centroids(calibration.aperture, ideal_unmixing(calibration.aperture)), axis=1).mean())
    model = BlurModel(float(axis.infinity_disparity_px) / reach, float(axis.scale_px_mm) / reach, **_START_RIM)
    pupil = sample_pupil(calibration.aperture.with_film(calibration.film.transmissions()))
    return FieldBlur(model, pupil, calibration.sensor.width_px, calibration.sensor.height_px)


def _measure_curve(
    session: Session, boards: dict[Path, float], blur: FieldBlur, delta: float, progress: Progress
) -> DepthField | None:
    """Fields of the depth curve of the blur's layers: where they are not A0 - B0 / z, the model is not quite right."""
    paths = list(boards)
    chosen = [paths[i] for i in np.unique(np.linspace(0, len(paths) - 1, _MEASURED_BOARDS).round().astype(int))]
    places = []
    for number, path in enumerate(chosen):
        progress("depth of the layers", number, len(chosen))
        x, y, layer = measured_layers(
            session.read(path), boards[path], blur, cell_px=max(16, blur.width_px // _CELLS), config=PhaseConfig()
        )
        places.append(np.stack([x, y, np.full(len(x), boards[path]), layer]))
    progress("depth of the layers", len(chosen), len(chosen))
    x, y, inverse_mm, layer = np.concatenate(places, axis=1)
    for degree in _DEGREES:
        try:
            field, residual = fit_depth_field(
                x, y, inverse_mm, layer, np.ones(len(x)), size_px=(blur.width_px, blur.height_px), degree=degree,
                sensor_to_pupil_mm=delta, covariance=np.zeros((3, 3)),
            )  # fmt: skip
        except InputError:
            continue
        spread = 1.4826 * float(np.nanmedian(np.abs(residual)))
        # Cells of one board err together: what is left after the fit is what one more board would be off by.
        return replace(field, covariance=np.diag([spread**2, 0.0, 0.0]))
    return None
