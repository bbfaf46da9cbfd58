"""Whole tasks as one call each, for Python; the command line has the same."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np

from chromaperture.calibration.calibrate_session import calibrate_session
from chromaperture.calibration.flat_boards import calibrate_flat_boards
from chromaperture.calibration.options import CalibrationConfig, Progress, silent
from chromaperture.calibration.session import read_session
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.effects.refocusing import Focus
from chromaperture.effects.refocusing import refocus as blur_anew
from chromaperture.effects.restore import Sharpness, SharpPicture, focus_radius, restore
from chromaperture.evaluation.verdict import unusable
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.model.camera_file import Calibration
from chromaperture.system.errors import CaptureWarning, InputError


def calibrate(
    session: str | Path,
    *,
    lens_from: Calibration | None = None,
    lens_blur: bool = True,
    per_pixel: bool = False,
    progress: Progress = silent,
    keep_in: str | Path | None = None,
) -> Calibration:
    """Calibrate a camera from a session folder; minutes, most of them for the lens's blur.

    Parameters
    ----------
    session : str or Path
        Laid out as ``docs/calibration-session.md`` shows.
    lens_from : Calibration, optional
        The same lens at the same focus, where tilted boards are few.
    lens_blur : bool
        Fit the lens's blur, which quality ``accurate`` matches with.
    per_pixel : bool
        Curves free at every image position, for a dozen boards or more.
    progress : callable, optional
        Called with the name of the step, the number done, and the total.
    keep_in : str or Path, optional
        Folder for measurements of single photographs, from which an interrupted run resumes.

    Returns
    -------
    Calibration
        ``save`` writes it; `CodedApertureCamera` measures with it.

    Raises
    ------
    InputError
        Something is missing or invalid; the message names it.

    Warns
    -----
    CaptureWarning
        The calibration cannot be used; the message says why.
    """
    config = CalibrationConfig(lens_blur=lens_blur, per_pixel=per_pixel)
    known = read_session(session)
    if not known.square_mm:
        if lens_from is not None or per_pixel or not lens_blur:
            raise InputError("flat boards take no lens_from, lens_blur or per_pixel: leave these out")
        return calibrate_flat_boards(known, config, progress=progress).camera
    result = calibrate_session(session, config, lens_from=lens_from, progress=progress, keep_in=keep_in)
    faults = unusable(result)
    if faults:
        warnings.warn(f"this calibration cannot be used: {'; '.join(faults)}", CaptureWarning, stacklevel=2)
    return result.camera


def all_in_focus(frame: DepthFrame, *, sharpness: Sharpness = "full") -> SharpPicture:
    """Restore the picture with everything in focus.

    Parameters
    ----------
    frame : DepthFrame
        As `CodedApertureCamera.measure` returns it.
    sharpness : "aligned", "fast" or "full"
        Keep the blur; a Wiener filter for each layer; a joint solution of all layers and channels.

    Returns
    -------
    SharpPicture
        ``color`` (H, W, 3), linear RGB, and the blur radius of the capture, ``radius_px`` (H, W).

    Raises
    ------
    InputError
        The frame was put together without its camera or its photograph.
    """
    image, camera = _origin(frame)
    return restore(image, frame.disparity_px, camera, sigma_px=frame.disparity_sigma_px, sharpness=sharpness)


def refocus(
    frame: DepthFrame,
    focus_mm: float | None = None,
    *,
    f_number: float | None = None,
    bokeh: str = "disc",
    sharp: SharpPicture | None = None,
) -> np.ndarray:
    """Compute the photograph with another focus or f-number.

    Parameters
    ----------
    frame : DepthFrame
        As `CodedApertureCamera.measure` returns it.
    focus_mm : float, optional
        Distance from the sensor plane to focus on; the camera's own focus when absent.
    f_number : float, optional
        Of the new lens; the camera's own when absent.
    bokeh : str
        ``disc``, ``hex`` or the path of a picture of the pupil.
    sharp : SharpPicture, optional
        What `all_in_focus` returned for this frame, so that several pictures need one restoration.

    Returns
    -------
    (H, W, 3) float32, linear RGB

    Raises
    ------
    InputError
        The frame was put together without its camera, it was never calibrated, or the new blur is too large.
    """
    _, camera = _origin(frame)
    lens = Focus(0.0 if focus_mm is None else focus_radius(camera, focus_mm), _pupil(camera, f_number), bokeh)
    picture = all_in_focus(frame) if sharp is None else sharp
    return blur_anew(picture.color, picture.radius_px, lens)


def _origin(frame: DepthFrame) -> tuple[np.ndarray, CodedApertureCamera]:
    if frame.image is None or frame.calibration is None or frame.config is None:
        raise InputError("restoration needs a frame as camera.measure returns it, with its photograph and its camera")
    return frame.image, CodedApertureCamera(frame.calibration, frame.config)


def _pupil(camera: CodedApertureCamera, f_number: float | None) -> float:
    """Return the size of the new pupil in units of the camera's."""
    own = camera.calibration.lens.f_number
    if f_number is None:
        return 1.0
    if not (math.isfinite(f_number) and f_number > 0):
        raise InputError(f"f_number must be positive, got {f_number:g}")
    if not own:
        raise InputError("the camera file lacks the lens's f-number; calibrate with nominal_f_number in session.toml")
    return own / f_number
