"""Last step of a calibration: the blur of the lens over the frame, and the depth curve of the matcher that uses it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from chromaperture.calibration.board_distances import BoardDistances
from chromaperture.calibration.board_layers import measured_layers
from chromaperture.calibration.calibration_config import DEFAULT, CalibrationConfig
from chromaperture.calibration.choose_curve import ranked_curves
from chromaperture.calibration.curves import Evidence
from chromaperture.calibration.fit_blur import fit_blur
from chromaperture.calibration.fit_fields import check_scale, fit_depth_field
from chromaperture.calibration.measurement_cache import Store
from chromaperture.calibration.progress import Progress, reported, silent
from chromaperture.calibration.session import Session
from chromaperture.camera.method import sensor_noise
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.field import DepthField
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil
from chromaperture.system.errors import InputError

MIN_BOARDS = 4  # fewer leave the blur undetermined; chosen by hand
_CELLS = 12  # along the width, in which the disparity of a board is measured; chosen by hand
_LEAST_CELL_PX = 16
_DEGREES = (4, 2, 0)  # of the curve's fields; the lower ones where boards are few
# Rims of the start, pupil radii: vignetting of a common double Gauss. Chosen by hand; the fit moves them.
_START_RIM = {"front_rim_radius": 1.08, "front_rim_shift": 0.33, "rear_rim_radius": 1.08, "rear_rim_shift": 0.33}


@dataclass(frozen=True)
class LayerEvidence:
    """Disparity of the boards by matching with the fitted blur, in cells over the frame."""

    size_px: tuple[int, int]  # (width, height)
    # x_px, y_px: (P,) float64; centres of the cells
    x_px: np.ndarray
    y_px: np.ndarray
    layer_px: np.ndarray  # (N, P) float64; disparity of each of N boards; NaN not measured
    disagreement: float  # fraction of the power of cross-filtered channels that disagrees
    start_disagreement: float  # the same before the fit


@dataclass(frozen=True)
class BlurredCamera:
    """A camera with ``blur`` and a new ``depth["accurate"]``, and its evidence; or unchanged, None, and a note why."""

    camera: Calibration
    layers: LayerEvidence | None
    notes: tuple[str, ...] = ()


def calibrate_blur(
    camera: Calibration,
    session: Session,
    evidence: Evidence,
    config: CalibrationConfig = DEFAULT,
    *,
    lens: BlurModel | None = None,
    store: Store | None = None,
    progress: Progress = silent,
) -> BlurredCamera:
    """Fit the blur, then the depth curve of the matcher that uses it.

    Parameters
    ----------
    camera : Calibration
        With film and the depth curves of shifted views.
    session : Session
    evidence : Evidence
        Distances of the session's N boards, and which to use.
    config : CalibrationConfig
    lens : BlurModel, optional
        Start of the fit: the same lens, calibrated with another film. The fit then needs fewer boards.
    store : Store, optional
        Cache of what is measured on each board.
    progress : callable, optional
    """
    numbers, distances = np.flatnonzero(evidence.used), evidence.distances
    if not config.lens_blur:
        return BlurredCamera(camera, None)
    if len(numbers) < MIN_BOARDS:
        note = f"{len(numbers)} boards do not determine the lens's blur: quality accurate matches shifted views"
        return BlurredCamera(camera, None, (note,))
    paths, inverse_mm = list(session.boards), 1 / distances.from_pupil_mm

    def photographs() -> Iterator[tuple[np.ndarray, float]]:
        for i in numbers:
            yield session.read(paths[i]), float(inverse_mm[i])

    size = (camera.sensor.width_px, camera.sensor.height_px)
    try:
        fit = fit_blur(
            photographs(), _start(camera, lens), board_count=len(numbers), tile_count=config.blur_tiles,
            progress=progress,
        )  # fmt: skip
        chosen = numbers[np.unique(np.linspace(0, len(numbers) - 1, config.layer_boards).round().astype(int))]
        cells = []
        for i in reported(list(chosen), "depth of the layers", progress):
            measure = partial(_measure, session, i, float(inverse_mm[i]), fit.blur, camera)
            what = ("layers", fit.blur.model, float(inverse_mm[i]), camera.sensor)
            cells.append((store or Store()).arrays(paths[i], what, measure))
        layer = np.full((len(paths), len(cells[0]["x"])), np.nan)
        layer[chosen] = [cell["layer"] for cell in cells]
        layers = LayerEvidence(size, cells[0]["x"], cells[0]["y"], layer, fit.disagreement, fit.start_disagreement)
        depth = {**camera.depth, "accurate": fit_layers(layers, distances, evidence.used)}
    except InputError as error:
        note = f"the lens's blur could not be fitted ({error}): quality accurate matches shifted views"
        return BlurredCamera(camera, None, (note,))
    return BlurredCamera(replace(camera, blur=fit.blur.model, depth=depth), layers)


def fit_layers(layers: LayerEvidence, distances: BoardDistances, used: np.ndarray) -> DepthField:
    """Fit the depth curve to the layers; fields and nonlinearity take what the blur's few numbers do not follow.

    Raises
    ------
    InputError
        The boards do not determine even one curve.
    """
    measured = used & np.isfinite(layers.layer_px).any(axis=1)
    samples = (layers.x_px, layers.y_px, layers.layer_px, distances)
    curves = ranked_curves(*samples, size_px=layers.size_px, degree=_DEGREES[0], boards=measured)
    trials = [*((_DEGREES[0], curve) for curve in curves), *((degree, 0) for degree in _DEGREES[1:])]
    for trial, (degree, curve) in enumerate(trials):
        try:
            field, _ = fit_depth_field(
                *samples, size_px=layers.size_px, degree=degree, nonlinearity=curve, boards=measured
            )
            check_scale(field, layers.size_px)
            return field
        except InputError:
            if trial == len(trials) - 1:
                raise
    raise AssertionError("unreachable")


def _measure(
    session: Session, board: int, inverse_mm: float, blur: LensBlur, camera: Calibration
) -> dict[str, np.ndarray]:
    image = session.read(list(session.boards)[board])
    x, y, layer = measured_layers(
        image, inverse_mm, blur, aperture=camera.aperture, cell_px=max(_LEAST_CELL_PX, blur.width_px // _CELLS),
        unmixing=camera.unmixing, noise_variance=sensor_noise(image, camera),
        full_well_electrons=camera.sensor.full_well_electrons,
    )  # fmt: skip
    return {"x": x, "y": y, "layer": layer}


def _start(camera: Calibration, lens: BlurModel | None) -> LensBlur:
    """Return the start of the fit: a known lens, or a thin one with the focus and scale of the shifted views.

    Half disparity over blur radius is the distance of the centroids from the pupil's centre, in its radii.
    """
    if lens is None:
        axis, reach = camera.on_axis("paper"), view_reach(camera.aperture)
        lens = BlurModel(float(axis.infinity_disparity_px) / reach, float(axis.scale_px_mm) / reach, **_START_RIM)
    pupil = sample_pupil(camera.aperture.with_film(camera.film.transmissions()))
    return LensBlur(lens, pupil, camera.sensor.width_px, camera.sensor.height_px)
