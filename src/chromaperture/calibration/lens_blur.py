"""The last step of a calibration: the lens's blur over the frame, and the depth curve that matching with it reads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from chromaperture.calibration.board_distances import BoardDistances
from chromaperture.calibration.choose_curve import ranked_curves
from chromaperture.calibration.fit_blur import Progress, fit_blur, measured_layers
from chromaperture.calibration.fit_fields import fit_depth_field
from chromaperture.calibration.measurement_cache import Store
from chromaperture.calibration.session import Session
from chromaperture.camera_file import Calibration
from chromaperture.camera_matching import sensor_noise
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.field import DepthField
from chromaperture.errors import InputError
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil

MIN_BOARDS = 4
_MEASURED_BOARDS = 40  # that fix the depth curve of the layers; the blur itself is fitted to all
_CELLS = 12  # along the width, in which a board's layer is measured
_DEGREES = (4, 2, 0)  # of the curve's fields; lower where few boards are there
_START_RIM = {"front_rim_radius": 1.08, "front_rim_shift": 0.33, "rear_rim_radius": 1.08, "rear_rim_shift": 0.33}


@dataclass(frozen=True)
class LayerEvidence:
    """Which layers of a fitted blur matched the boards best, in cells over the frame.

    Attributes
    ----------
    size_px : (width, height)
    x_px, y_px : (P,) float64
        Middles of the cells.
    layer_px : (N, P) float64
        On each of N boards; NaN where it was not measured.
    disagreement, start_disagreement : float
        Share of the power of cross-filtered channels that disagrees, with the fitted blur and before the fit.
    """

    size_px: tuple[int, int]
    x_px: np.ndarray
    y_px: np.ndarray
    layer_px: np.ndarray
    disagreement: float
    start_disagreement: float


def add_blur(
    calibration: Calibration,
    session: Session,
    distances: BoardDistances,
    believed: np.ndarray,
    notes: list[str],
    *,
    lens: BlurModel | None = None,
    store: Store | None = None,
    progress: Progress = lambda what, done, total: None,
) -> tuple[Calibration, LayerEvidence | None]:
    """Fit the blur and give the camera with it; the camera as it was, and a note, where the boards do not suffice.

    Parameters
    ----------
    calibration : Calibration
        Film and depth curves of the shifted views.
    session : Session
    distances : BoardDistances
        Of the session's N boards.
    believed : (N,) bool
        Which of them to use.
    notes : list of str
        Extended by what the user should know.
    lens : BlurModel, optional
        The same lens as another session saw it, with other film: a fit that starts there needs fewer boards.
    store : Store, optional
        Keeps what was measured on each board.
    progress : callable, optional

    Returns
    -------
    calibration : Calibration
        With ``blur`` and a new ``depth["accurate"]``.
    layers : LayerEvidence or None
    """
    used = np.flatnonzero(believed)
    if len(used) < MIN_BOARDS:
        notes.append(f"{len(used)} boards do not fix the lens's blur: quality accurate matches shifted views")
        return calibration, None
    paths, inverse_mm = list(session.boards), 1 / distances.from_pupil_mm

    def photographs() -> Iterator[tuple[np.ndarray, float]]:
        for i in used:
            yield session.read(paths[i]), float(inverse_mm[i])

    try:
        start = _start(calibration, lens)
        fit = fit_blur(photographs(), start, board_count=len(used), progress=progress)
        chosen = used[np.unique(np.linspace(0, len(used) - 1, _MEASURED_BOARDS).round().astype(int))]
        cells = []
        for number, i in enumerate(chosen):
            progress("depth of the layers", number, len(chosen))
            measure = partial(_measure, session, i, float(inverse_mm[i]), fit.blur, calibration)
            what = ("layers", fit.blur.model, float(inverse_mm[i]), calibration.sensor)
            cells.append((store or Store()).arrays(paths[i], what, measure))
        progress("depth of the layers", len(chosen), len(chosen))
        layer = np.full((len(paths), len(cells[0]["x"])), np.nan)
        layer[chosen] = [cell["layer"] for cell in cells]
        size = (calibration.sensor.width_px, calibration.sensor.height_px)
        layers = LayerEvidence(size, cells[0]["x"], cells[0]["y"], layer, fit.disagreement, fit.start_disagreement)
        depth = {**calibration.depth, "accurate": fit_layers(layers, distances, believed)}
    except InputError as error:
        notes.append(f"the lens's blur could not be fitted ({error}): quality accurate matches shifted views")
        return calibration, None
    return replace(calibration, blur=fit.blur.model, depth=depth), layers


def fit_layers(layers: LayerEvidence, distances: BoardDistances, believed: np.ndarray) -> DepthField:
    """Fit the depth curve of the layers: where it is not A0 - B0 / z of the blur, the model is not quite right.

    What the blur's few numbers do not follow is left to a nonlinearity.

    Raises
    ------
    InputError
        The boards do not fix even one curve.
    """
    measured = believed & np.isfinite(layers.layer_px).any(axis=1)
    where = (layers.x_px, layers.y_px, layers.layer_px, distances)
    curves = ranked_curves(*where, size_px=layers.size_px, degree=_DEGREES[0], boards=measured)
    trials = [*((_DEGREES[0], curve) for curve in curves), *((degree, 0) for degree in _DEGREES[1:])]
    for trial, (degree, curve) in enumerate(trials):
        try:
            return fit_depth_field(
                *where, size_px=layers.size_px, degree=degree, nonlinearity=curve, boards=measured
            )[0]
        except InputError:
            if trial == len(trials) - 1:
                raise
    raise AssertionError("unreachable")


def _measure(
    session: Session, board: int, inverse_mm: float, blur: LensBlur, calibration: Calibration
) -> dict[str, np.ndarray]:
    image = session.read(list(session.boards)[board])
    cell_px, noise = max(16, blur.width_px // _CELLS), sensor_noise(image, calibration)
    x, y, layer = measured_layers(
        image, inverse_mm, blur, aperture=calibration.aperture, cell_px=cell_px, unmixing=calibration.unmixing,
        noise_variance=noise,
    )  # fmt: skip
    return {"x": x, "y": y, "layer": layer}


def _start(calibration: Calibration, lens: BlurModel | None) -> LensBlur:
    """Give a lens that is known, or a thin one of the measured focus and scale, to start the fit from.

    A thin lens's scale is known since centroids sit at a known share of the pupil's radius.
    """
    if lens is None:
        axis, reach = calibration.on_axis("paper"), view_reach(calibration.aperture)
        lens = BlurModel(float(axis.infinity_disparity_px) / reach, float(axis.scale_px_mm) / reach, **_START_RIM)
    pupil = sample_pupil(calibration.aperture.with_film(calibration.film.transmissions()))
    return LensBlur(lens, pupil, calibration.sensor.width_px, calibration.sensor.height_px)
