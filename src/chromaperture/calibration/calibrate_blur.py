"""Last step of a calibration: the blur of the lens over the frame, and the depth curve of the matcher that uses it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import cast

import numpy as np

from chromaperture.calibration.curves import Evidence
from chromaperture.calibration.fit_blur import fit_blur
from chromaperture.calibration.fit_fields import check_scale, fit_depth_field, ranked_curves
from chromaperture.calibration.options import DEFAULT, Cache, CalibrationConfig, Progress, reported, silent
from chromaperture.calibration.place_boards import BoardDistances
from chromaperture.calibration.session import Session
from chromaperture.camera.method import sensor_noise
from chromaperture.color.lens_shift import LensShift, least_fringes
from chromaperture.color.unmixing import view_reach
from chromaperture.depth.field import DepthField
from chromaperture.matching.evidence.blur import SPACING_PX, BlurEvidence
from chromaperture.matching.execution import ExecutionName, execution_named
from chromaperture.matching.labels import IDENTITY
from chromaperture.matching.result import ESTIMATED_NOISE, NoiseModel
from chromaperture.matching.views import channel_space, clipped_filled, mixed, view_spaces
from chromaperture.model.camera_file import Calibration
from chromaperture.optics.aperture import Aperture
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil, traced
from chromaperture.settings.methods import AccurateConfig
from chromaperture.settings.stages import CrossFilterConfig
from chromaperture.system.errors import InputError

MIN_BOARDS = 4  # fewer leave the blur undetermined; chosen by hand
_CELLS = 12  # along the width, in which the disparity of a board is measured; chosen by hand
_LEAST_CELL_PX = 16
_DEGREES = (4, 2, 0)  # of the curve's fields; the lower ones where boards are few
# Rims of the start, pupil radii: vignetting of a common double Gauss. Chosen by hand; the fit moves them.
_START_RIM = {"front_rim_radius": 1.08, "front_rim_shift": 0.33, "rear_rim_radius": 1.08, "rear_rim_shift": 0.33}
# Chosen by hand, not tuned.
_SEARCHED = (6, 15)  # layers searched to either side of the expected one; the second where cells remained unknown
_KNOWN_CELLS = 0.9  # fraction of cells that ends the search
_LEAST_USABLE = 0.5  # fraction of a cell's pixels that are not clipped
_PLACES = (9, 7)  # along width and height; vignetting and lateral colour bend less in between
# Of the blur radius at the far end of the range, where pairs of squares disagree more than in focus
_REFERENCE = 1 / 3


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
    cache: Cache | None = None,
    progress: Progress = silent,
) -> BlurredCamera:
    """Fit the blur, then the depth curve of the matcher that uses it, to the boards that ``evidence`` uses.

    ``camera`` has film and the depth curves of shifted views. ``lens`` is the start of the fit: the same lens,
    calibrated with another film, which needs fewer boards.
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
            cells.append((cache or Cache()).get(paths[i], what, measure))
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

    Raises InputError where the boards do not determine even one curve.
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


def measured_layers(
    image: np.ndarray,
    inverse_mm: float,
    blur: LensBlur,
    *,
    aperture: Aperture,
    cell_px: int,
    unmixing: np.ndarray | None = None,
    noise_variance: np.ndarray | None = None,
    full_well_electrons: float | None = None,
    execution: ExecutionName = "numba",
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measure the disparity of a flat board, in cells over the frame, by the evidence of quality ``accurate``.

    A cell is read where the log-likelihood of all its pixels together is largest. The surface that ``accurate`` makes
    of the evidence explains a flat board by one plane, which would hide how its reading changes over the frame. Pairs
    of channels alone: the boards' speckle has no power law, which would mislead the likelihood of all channels.
    ``inverse_mm`` is 1 / z of the board, around which disparities are searched; ``unmixing`` has rows of M^-1, (K, 3);
    ``noise_variance`` is the image's, (H, W, 3).

    Returns the centres x and y of the cells and their disparities, (N,) float64 each, px; NaN where half of a cell is
    clipped, or what it shows does not tell its layer to within one.
    """
    height, width = image.shape[:2]
    config = AccurateConfig.for_blur(blur.reach, full_well_electrons=full_well_electrons)
    usable = mixed(image, view_spaces(aperture, unmixing, "unmixed")[0])[2]
    image, usable = clipped_filled(image, usable.astype(np.float32))
    noise = ESTIMATED_NOISE if noise_variance is None else NoiseModel(lambda _: noise_variance, is_known=True)
    cross_filter = cast(CrossFilterConfig, config.evidence)  # a camera whose blur is known has no other
    evidence = BlurEvidence(cross_filter, blur, IDENTITY, noise, execution_named(execution))
    at_infinity, scale = blur.reference
    expected, step = at_infinity - scale * inverse_mm, config.layers.step_px
    windows = SPACING_PX**2 / (4 * math.pi * cross_filter.window_sigma_px**2)  # that a sample of the evidence counts
    rows, columns = (np.linspace(0, n, max(1, n // cell_px) + 1).astype(int) for n in (height, width))
    y, x = np.meshgrid((rows[:-1] + rows[1:] - 1) / 2, (columns[:-1] + columns[1:] - 1) / 2, indexing="ij")
    cells = [
        np.s_[-(-y0 // SPACING_PX) : -(-y1 // SPACING_PX), -(-x0 // SPACING_PX) : -(-x1 // SPACING_PX)]
        for y0, y1 in pairwise(rows)
        for x0, x1 in pairwise(columns)
    ]
    usable = usable[::SPACING_PX, ::SPACING_PX]
    for searched in _SEARCHED:
        layers_px = expected + step * np.arange(-searched, searched + 1)
        likelihood = evidence.likelihood(image, layers_px) * usable[..., None]
        found = np.array([
            _most_likely(windows * likelihood[cell].sum(axis=(0, 1)), layers_px)
            if usable[cell].mean() >= _LEAST_USABLE else math.nan
            for cell in cells
        ])  # fmt: skip
        if np.isfinite(found).mean() >= _KNOWN_CELLS:
            break
    return x.ravel(), y.ravel(), found


def _most_likely(log_likelihood: np.ndarray, layers_px: np.ndarray) -> float:
    """Return the vertex of the parabola through the best layer and its neighbours; NaN where that is unknown."""
    best, step = int(log_likelihood.argmax()), float(layers_px[1] - layers_px[0])
    if best in (0, len(layers_px) - 1):
        return math.nan
    before, here, after = log_likelihood[best - 1 : best + 2].astype(float)
    bend = 2 * here - before - after  # 1 / variance, in layers
    return float(layers_px[best] + step * (after - before) / (2 * bend)) if bend >= 1 else math.nan


def lens_moves(camera: Calibration) -> np.ndarray | None:
    """Return `Calibration.channel_moves_px`, (rows, columns, 3, 2) float64, px, x before y: by the fitted blur.

    What the lens does to a channel is the displacement after which channels differ least (`color.lens_shift`). Of that,
    all channels share a translation and a disparity, which moves each along its direction in the pupil; the rest is
    returned. None without a blur, and for designs that match two channels.
    """
    blur = camera.field_blur()
    if blur is None or len(camera.unmixing) < 3:
        return None
    pupil_mm = float(camera.on_axis("accurate").sensor_to_pupil_mm)
    shift = LensShift(blur, near_mm=camera.near_mm - pupil_mm, far_mm=camera.far_mm - pupil_mm)
    inverse_mm = float(shift.inverse_mm(_REFERENCE * float(shift.radii_px[-1])))
    directions = channel_space(camera.aperture, camera.unmixing).directions
    places = [np.linspace(0, side - 1, n) for side, n in zip((blur.width_px, blur.height_px), _PLACES, strict=True)]
    table = [[least_fringes(traced(blur, (x, y), inverse_mm)) for x in places[0]] for y in places[1]]
    return beyond_disparity(np.array(table), directions)


def beyond_disparity(moves_px: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Take the common translation and the disparity that explain the most off displacements, (..., K, 2), px.

    ``directions``, (K, 2), are the displacements per px of disparity.
    """
    apart = moves_px - moves_px.mean(axis=-2, keepdims=True)
    along = directions - directions.mean(axis=0)
    disparity = np.sum(apart * along, axis=(-2, -1), keepdims=True) / np.sum(along**2)
    return np.asarray(apart - disparity * along, float)
