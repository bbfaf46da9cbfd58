"""Calibrate a dual-pixel sensor by flat textured boards at known distances, alone or with the lens's prescription.

Alone they tell the curve of quality "paper", "real-time" and "accurate" without its blur. With a prescription quality
"accurate" knows the blur: the two halves of every pixel see the pupil through opposite ramps
(``optics/dual_pixel_rays.py``). What the prescription cannot know is the sensor's crosstalk, two numbers, and how far
the lens's focus is off its mark: both are taken from the boards.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy.optimize

from chromaperture.calibration.assemble_camera import assemble_camera, origin
from chromaperture.calibration.fit_response import disparity_error
from chromaperture.calibration.options import DEFAULT, CalibrationConfig, Progress, reported, silent
from chromaperture.calibration.session import Session, nominal_depth_model
from chromaperture.calibration.white_sheets import WhiteSheets, film_of_halves
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config, sensor_noise
from chromaperture.depth.field import DepthField, polynomials, with_scale_error
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.matching.labels import IDENTITY
from chromaperture.model.camera_file import Calibration
from chromaperture.model.camera_parts import CameraSensor
from chromaperture.model.scale import MATCHED_SIZE, resized
from chromaperture.optics.aperture import DESIGNS
from chromaperture.optics.dual_pixel_rays import PURE, HalfPixels, fit_to_rays
from chromaperture.optics.lens_blur import BlurModel, LensBlur
from chromaperture.optics.pinhole import centered_pinhole, focused_at, paraxial, pupil_camera
from chromaperture.optics.prescription import Prescription, load_lens
from chromaperture.optics.ray_table import lens_rays
from chromaperture.settings.methods import QUALITIES, AccurateConfig, Quality
from chromaperture.system.errors import InputError
from chromaperture.system.robust import huber_weights, robust_sigma

# Of the fields by boards alone, and of the field that they bend a prescription by: a sensor or a lens that is tilted.
# Of two published boards degree 0 leaves a scatter of .025 and .015 1/m, 1 leaves .012 and .012, 2 .009 and .010.
_DEGREE, _TILT_DEGREE = 2, 1
_SEARCH = (1.5, 0.5)  # times the largest nominal disparity of the boards, px beyond; chosen by hand
_START = HalfPixels(slope=0.4, half_slope_px=320.0)  # of the fit, which moves it; chosen by hand
_ROUNDS = 2  # of the fit: the second changes the slope by less than 1 %
_REACH_PX = 0.9  # layers searched around those expected of a board
_LEAST_SIGMA_PX = 0.02  # so that no single pixel of a board decides; chosen by hand
_REWEIGHTINGS = 20
_LEAST_APART_PX = 0.1  # between the nearest and the farthest board; chosen by hand: five times the least sigma
# Noise of sensors of which nothing is stated, less than any has: each photograph shows how many times it is greater. In
# 8-bit files of the sRGB curve steps of 1 / 255 are noise of variance (dL / dv / 255)^2 / 12, which grows as light does
# (dL / dv = 2.2 L^0.55), as if white were 12 (255 / 2.2)^2 photons; on the toe dL / dv is 1 / 12.92.
_FULL_WELL_ELECTRONS = 12 * (255 / 2.2) ** 2
_READ_NOISE_ELECTRONS = _FULL_WELL_ELECTRONS / (12.92 * 255 * np.sqrt(12))


class Seen(NamedTuple):
    """A board: its distance from the entrance pupil, and what was measured."""

    distance_mm: float
    value_px: np.ndarray  # (H, W): half disparity, or layers of blur
    sigma_px: np.ndarray


@dataclass(frozen=True)
class Corrections:
    """What a prescription could not tell, and boards did."""

    halves: HalfPixels
    # The focus surface on the axis, from the entrance pupil, and the scale B, from the prescription and by the boards
    designed_focus_mm: float
    focus_mm: float
    scale_ratio: float
    scatter: tuple[float, ...]  # of each board about the curve, 1/m: robust standard deviation over the frame

    def __str__(self) -> str:
        """Say what it is."""
        return (
            f"by the boards: the sensor's crosstalk (slope {self.halves.slope:.3f}, halved "
            f"{self.halves.half_slope_px:.0f} px off the middle), the focus {self.focus_mm:.0f} mm from the entrance "
            f"pupil, by the prescription {self.designed_focus_mm:.0f} mm, and the scale, "
            f"{100 * (self.scale_ratio - 1):+.1f} %; they scatter about the curve by "
            f"{', '.join(f'{s:.3f}' for s in self.scatter)} 1/m"
        )


@dataclass(frozen=True)
class FlatCalibration:
    """A camera, and a sentence for everything that was found or is weak."""

    camera: Calibration
    notes: tuple[str, ...]
    corrections: Corrections | None = None  # of a prescription


def calibrate_flat_boards(
    session: Session,
    config: CalibrationConfig = DEFAULT,
    *,
    corrected: bool = True,
    qualities: Sequence[Quality] = QUALITIES,
    command: str | None = None,
    progress: Progress = silent,
) -> FlatCalibration:
    """Calibrate a dual-pixel camera by a session of flat boards; raises InputError where they do not tell the curve.

    ``corrected``: take focus and scale from the boards where there is a prescription; ``qualities``: whose curves are
    measured; the others get the last of these; ``command``: see `calibrate_session`.
    """
    distances = sorted({*session.boards.values()})
    if len(distances) < 2:
        raise InputError("flat boards at two distances are needed at least; photograph one nearer, one farther")
    session, notes = with_order_found(session)
    lens = _lens(session)
    sensor = _with_noise(session.sensor)
    pupil_mm = float(nominal_depth_model(session).sensor_to_pupil_mm)
    if lens is not None:
        pupil_mm = pupil_camera(lens, **_size(sensor)).sensor_to_pupil_mm
    beyond_mm = 0.0 if session.from_pupil else pupil_mm
    if distances[0] <= beyond_mm:
        raise InputError(f"a board at {distances[0]:g} mm from the sensor stands inside the lens; give mm")
    boards = [(ruler_mm - beyond_mm, session.read(path)) for path, ruler_mm in session.boards.items()]
    wanted = [quality for quality in qualities if lens is None or quality != "accurate"]
    depth: dict[Quality, DepthField] = {}
    for quality in reported(wanted, "flat boards", progress):
        eye = _eye(session, sensor, quality)
        frames = [(mm, eye.measure(image)) for mm, image in boards]
        seen = [Seen(mm, f.disparity_px, f.disparity_sigma_px) for mm, f in frames]
        depth[quality] = _curve(seen, _DEGREE)
    camera = _uncalibrated(sensor)
    corrections = None
    if lens is not None:
        camera, depth["accurate"], corrections = _by_prescription(lens, sensor, boards, corrected, progress)
        notes = (*notes, str(corrections))
    sigma_mm = 0.0 if lens is not None else config.pupil_sigma_mm
    last = [*depth.values()][-1]
    curves = {q: _from_sensor(depth.get(q, last), session, pupil_mm, sigma_mm) for q in QUALITIES}
    sheets = WhiteSheets(camera.film, sensor, (), ())
    made = assemble_camera(session, sheets, None, curves, config, blur=camera.blur)
    if lens is not None:
        made = replace(made, lens=replace(made.lens, **_pinhole(lens, sensor)))
    made = _with_range(made, session, pupil_mm)
    origins = origin(session, sheets, config, command=command, lens_from=None)
    more = {MATCHED_SIZE: [sensor.width_px, sensor.height_px], "notes": [*notes], "prescription": session.prescription}
    made = replace(made, provenance=origins | more)
    return FlatCalibration(resized(made, *session.photograph_size_px), notes, corrections)


def with_order_found(session: Session) -> tuple[Session, tuple[str, ...]]:
    """Return a session with its halves in the order that the nearest and the farthest board show, and a sentence of it.

    Raises InputError where these do not differ.
    """
    ordered = sorted(session.boards, key=lambda path: session.boards[path])
    eye = _eye(session, _with_noise(session.sensor), "real-time")
    ends = [(session.boards[path], eye.measure(session.read(path))) for path in (ordered[0], ordered[-1])]
    near, far = (float(np.nanmedian(frame.disparity_px)) for _, frame in ends)
    apart = ", ".join(f"{px:+.2f} px at {mm:.0f} mm" for (mm, _), px in zip(ends, (near, far), strict=True))
    if not abs(far - near) > _LEAST_APART_PX:
        raise InputError(
            f"near and far boards show the same parallax between the halves ({apart}): are left and right the halves "
            "of one exposure, and the boards textured and at different distances?"
        )
    if far > near:
        return session, (f"the boards show that left and right are what they are called ({apart})",)
    given = session.sensor.dual_pixel
    session = session.with_halves("left-right" if given == "right-left" else "right-left")
    says = "the boards show that left and right are exchanged: so will the camera read photographs"
    return session, (f"{says} ({apart})",)


def _eye(session: Session, sensor: CameraSensor, quality: Quality) -> CodedApertureCamera:
    """Return a camera that is not calibrated, and searches the disparities of the boards with either sign."""
    camera = _uncalibrated(sensor)
    nominal = nominal_depth_model(session)
    beyond_mm = 0.0 if session.from_pupil else nominal.sensor_to_pupil_mm
    inverse = 1 / np.maximum(np.array([*session.boards.values()]) - beyond_mm, 1.0)
    disparity = nominal.infinity_disparity_px - nominal.scale_px_mm * inverse
    farthest = _SEARCH[0] * float(np.max(np.abs(disparity))) + _SEARCH[1]
    config = default_config(camera, quality)
    return CodedApertureCamera(camera, replace(config, matcher=config.matcher.with_range(-farthest, farthest)))


def _with_noise(sensor: CameraSensor) -> CameraSensor:
    if sensor.full_well_electrons is not None and sensor.read_noise_electrons is not None:
        return sensor
    return replace(sensor, full_well_electrons=_FULL_WELL_ELECTRONS, read_noise_electrons=_READ_NOISE_ELECTRONS)


def _uncalibrated(sensor: CameraSensor, film: Mapping[str, Sequence[float]] = PURE) -> Calibration:
    """Return a camera of which only sensor and aperture are known."""
    camera = Calibration.uncalibrated("cy_halves", width_px=sensor.width_px, height_px=sensor.height_px)
    return replace(camera, sensor=sensor, film=film_of_halves(film))


def _size(sensor: CameraSensor) -> dict[str, Any]:
    return {"width_px": sensor.width_px, "height_px": sensor.height_px, "pixel_pitch_mm": sensor.pixel_pitch_mm}


def _lens(session: Session) -> Prescription | None:
    """Return the lens at the focus of the session; all light is that of the green pixels."""
    if session.prescription is None:
        return None
    beside = session.folder / session.prescription
    lens = load_lens(beside if os.path.isfile(beside) else session.prescription)
    return focused_at(replace(lens, wavelengths_um=(lens.wavelengths_um[1],) * 3), session.focused_at_about_mm)


def _pinhole(lens: Prescription, sensor: CameraSensor) -> dict[str, Any]:
    pupil = pupil_camera(lens, **_size(sensor))
    matrix = centered_pinhole(pupil.focal_px, (sensor.width_px, sensor.height_px))
    return {"focal_length_mm": paraxial(lens).focal_length_mm, "camera_matrix": matrix}


def _with_range(camera: Calibration, session: Session, pupil_mm: float) -> Calibration:
    """Set the working range, from the sensor plane, to what the session states, else to about that of the boards."""
    near, far = session.range_mm or (camera.near_mm, camera.far_mm)
    if session.range_mm is None and session.from_pupil:
        near, far = near + pupil_mm, far + pupil_mm
    return replace(camera, near_mm=near, far_mm=far)


def _from_sensor(field: DepthField, session: Session, pupil_mm: float, sigma_mm: float) -> DepthField:
    """Count distances from the sensor plane, with the errors of the pupil's place, of focus and of tones."""
    covariance = field.covariance.copy()
    covariance[0, 0] += (session.focus_error_per_m / 1000 * float(field.scale_px_mm[0])) ** 2
    covariance[2, 2] += sigma_mm**2
    field = replace(field, sensor_to_pupil_mm=pupil_mm, covariance=covariance)
    return with_scale_error(field, disparity_error(session.design, session.tone_error))


def _by_prescription(
    lens: Prescription,
    sensor: CameraSensor,
    boards: Sequence[tuple[float, np.ndarray]],
    corrected: bool,
    progress: Progress,
) -> tuple[Calibration, DepthField, Corrections]:
    """Return a camera with the lens's blur, its curve of layers, from the pupil, and what the boards told."""
    pupil = pupil_camera(lens, **_size(sensor))
    table = lens_rays(lens, DESIGNS["open"], **_size(sensor), cells=16)
    model, _ = fit_to_rays(table, pupil_radius_mm=pupil.pupil_radius_mm)

    halves = _START
    for number in range(_ROUNDS + 1):
        progress("half pixels", number, _ROUNDS + 1)
        camera = _with_halves(_uncalibrated(sensor, halves.film()), model, halves)
        layers = [_layers(image, camera, mm) for mm, image in boards]
        if number < _ROUNDS:
            halves = _refitted(halves, layers, _blur(camera).reference[1])
    designed = _blur(camera).reference
    field = _curve(layers, _TILT_DEGREE)
    infinity, scale = float(field.infinity_disparity_px[0]), float(field.scale_px_mm[0])  # in the middle
    if not corrected:
        infinity, scale = designed
        field = DepthField(np.array([infinity]), np.array([scale]), 0.0, np.zeros((3, 3)))
        field = replace(field, covariance=_covariance(layers, _scatter(field, layers)))
    relative = tuple(float(1000 * s / scale) for s in _scatter(field, layers))
    found = Corrections(halves, designed[1] / designed[0], scale / infinity, scale / designed[1], relative)
    return camera, field, found


def _with_halves(camera: Calibration, model: BlurModel, halves: HalfPixels) -> Calibration:
    fall = camera.sensor.width_px / 2 / halves.half_slope_px
    return replace(camera, blur=replace(model, contrast_fall=fall))


def _blur(camera: Calibration) -> LensBlur:
    blur = camera.field_blur()
    assert blur is not None  # `_with_halves` gave one
    return blur


def _layers(image: np.ndarray, camera: Calibration, distance_mm: float) -> Seen:
    """Measure a board with the blur, in layers, that is half disparities in the middle of the frame."""
    blur = _blur(camera)
    infinity, scale = blur.reference
    expected = infinity - scale / distance_mm
    config = AccurateConfig.for_blur(blur.reach, full_well_electrons=camera.sensor.full_well_electrons)
    found = estimate_disparity(
        image,
        aperture=camera.aperture,
        unmixing=camera.unmixing,
        config=config.with_range(expected - _REACH_PX, expected + _REACH_PX),
        noise_variance=sensor_noise(image, camera),
        label_maps=[IDENTITY],
        blur=blur,
    )
    return Seen(distance_mm, found.value_px, found.sigma_px)


def _refitted(halves: HalfPixels, layers: Sequence[Seen], scale: float) -> HalfPixels:
    """Fit the crosstalk to how far the nearest and the farthest board seem apart in every column."""
    near, far = (pick(layers, key=lambda board: board.distance_mm) for pick in (min, max))
    apart = np.nanmedian(far.value_px - near.value_px, axis=0) / (scale * (1 / near.distance_mm - 1 / far.distance_mm))
    x = np.arange(len(apart)) - (len(apart) - 1) / 2
    known = np.isfinite(apart)
    target = (apart * halves.slope_at(x))[known]

    def misfit(numbers: np.ndarray) -> np.ndarray:
        slope, inverse = numbers
        return np.asarray(slope / (1 + (x[known] * inverse) ** 2) / target - 1)

    start = (halves.slope, 1 / halves.half_slope_px)
    slope, inverse = scipy.optimize.least_squares(misfit, start, loss="soft_l1", f_scale=0.05, x_scale=start).x
    return HalfPixels(float(slope), float(1 / abs(inverse)))


def _curve(seen: Sequence[Seen], degree: int) -> DepthField:
    """Curve through boards, of which smooth disparities are fitted robustly; distances are from the pupil."""
    infinity, scale = _to_curve(seen) @ np.stack([_smooth(board, degree) for board in seen])
    field = DepthField(infinity, scale, 0.0, np.zeros((3, 3)))
    height, width = seen[0].value_px.shape
    if not np.min(field.model(width, height).scale_px_mm) > 0:
        raise InputError(
            "parallax does not grow with the inverse distance all over the frame: are the boards flat, square to the "
            "axis, and their distances in mm?"
        )
    return replace(field, covariance=_covariance(seen, _scatter(field, seen)))


def _to_curve(seen: Sequence[Seen]) -> np.ndarray:
    """Least squares of A and B in d = A - B / z, of the boards' disparities; (2, boards)."""
    return np.linalg.pinv(np.array([(1.0, -1 / board.distance_mm) for board in seen]))


def _scatter(field: DepthField, seen: Sequence[Seen]) -> list[float]:
    """Robust standard deviation of every board about a curve, px."""
    height, width = seen[0].value_px.shape
    model = field.model(width, height)
    curves = [model.infinity_disparity_px - model.scale_px_mm / board.distance_mm for board in seen]
    return [robust_sigma(board.value_px - curve) for board, curve in zip(seen, curves, strict=True)]


def _covariance(seen: Sequence[Seen], scatter_px: Sequence[float]) -> np.ndarray:
    """Covariance of A, B and delta if each board may be off by its scatter anywhere in the frame; (3, 3)."""
    jacobian = np.vstack([_to_curve(seen), np.zeros(len(seen))])
    return np.asarray(jacobian @ np.diag(np.square(scatter_px)) @ jacobian.T)


def _smooth(board: Seen, degree: int) -> np.ndarray:
    """Coefficients of a polynomial over the frame, fitted robustly to a map with holes."""
    height, width = board.value_px.shape
    y, x = np.mgrid[0:height:4, 0:width:4]
    values = board.value_px[::4, ::4]
    known = np.isfinite(values)
    design, target = polynomials(x[known], y[known], width, height, degree), values[known].astype(float)
    if len(target) < 20 * design.shape[1]:
        raise InputError("a flat board could not be measured: is it in focus range, and textured?")
    weight = 1 / np.maximum(board.sigma_px[::4, ::4][known], _LEAST_SIGMA_PX)
    gain = np.ones_like(target)
    for _ in range(_REWEIGHTINGS):
        root = np.sqrt(gain) * weight
        fit = np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0]
        gain = huber_weights((target - design @ fit) * weight)
    return np.asarray(fit)
