"""A frame and a camera as a notebook shows them."""

from __future__ import annotations

import base64
from html import escape

import cv2
import numpy as np

from chromaperture.depth.conversion import depth_to_disparity, disparity_to_depth
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.frame.preview import depth_scale, exposed, fitted_size, reduced
from chromaperture.frame.summary import one_line
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality

_LARGEST = (280, 280)  # px of each of the two pictures; chosen by hand
_PUPIL_PX = 120  # side of the picture of the pupil; chosen by hand
_SMALL_PX = 0.1  # whose worth is shown, as in the calibration's report


def html(frame: DepthFrame) -> str:
    """Return one line of figures, and colour and depth side by side as an inline PNG."""
    size = fitted_size(frame.color.shape, _LARGEST)
    values, scale, title = depth_scale(frame)
    pictures = np.hstack([exposed(frame.color, size), scale.picture(reduced(values, size))])
    colors = f"{title}: red {scale.low:.5g} to blue {scale.high:.5g} {scale.unit}"
    alt = f"colour and {title}"
    return f"<div>{one_line(frame)}<br>{_image(pictures, alt)}<br>{colors}</div>"


def camera_html(calibration: Calibration, quality: Quality) -> str:
    """Return the film in the pupil and a table of what the camera is, as HTML.

    ``quality`` {"paper", "real-time", "accurate"}: whose depth curve is shown.
    """
    lens, sensor = calibration.lens, calibration.sensor
    rows = [
        ("film", calibration.aperture.title),
        ("photographs", f"{sensor.width_px} x {sensor.height_px} px"),
        ("quality", quality),
    ]
    if not calibration.is_calibrated:
        rows.append(("depth", "not calibrated: it measures disparity in px"))
    else:
        number = f", f/{lens.f_number:.3g}" if lens.f_number else ""
        curve = calibration.on_axis(quality)
        near, far = calibration.near_mm, calibration.far_mm
        z = np.array([near, 2 / (1 / near + 1 / far), far])  # the middle one lies midway in disparity
        d = depth_to_disparity(z, curve)
        beyond, before = (disparity_to_depth(d + sign * _SMALL_PX / 2, curve)[0] for sign in (1, -1))
        rows += [
            ("lens", f"{lens.focal_length_mm:.1f} mm{number}"),
            ("in focus", f"{calibration.in_focus_text} from the sensor"),
            ("range", f"{near:.0f} to {far:.0f} mm"),
            (
                f"{_SMALL_PX} px is worth",
                ", ".join(f"{w:.0f} mm at {at:.0f} mm" for w, at in zip(beyond - before, z, strict=True)),
            ),
        ]
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    picture = _image(_pupil(calibration), f"the pupil: {escape(calibration.aperture.title)}")
    return f'<div style="display: flex; gap: 1em; align-items: center">{picture}<table>{cells}</table></div>'


def _pupil(calibration: Calibration) -> np.ndarray:
    """Draw the film of a camera, seen from behind it; (H, W, 3) uint8."""
    axis = (np.arange(_PUPIL_PX) + 0.5) / _PUPIL_PX * 2 - 1
    x, y = np.meshgrid(axis, axis)
    film = calibration.aperture.with_film(calibration.film.transmissions()).transmission_map(x, y)
    film[np.hypot(x, y) >= 1] = 1
    return np.rint(255 * np.clip(film, 0, 1)).astype(np.uint8)


def _image(picture: np.ndarray, alt: str) -> str:
    """Return a picture, (H, W, 3) uint8 RGB, as an inline PNG."""
    encoded = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))[1]
    data = base64.b64encode(encoded.data).decode("ascii")
    return f'<img src="data:image/png;base64,{data}" alt="{alt}">'
