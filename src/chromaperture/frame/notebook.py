"""A frame as a notebook shows it."""

from __future__ import annotations

import base64

import cv2
import numpy as np

from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.frame.preview import depth_scale, exposed, fitted_size, reduced
from chromaperture.frame.summary import one_line

_LARGEST = (280, 280)  # px of each of the two pictures; chosen by hand


def html(frame: DepthFrame) -> str:
    """Return one line of figures, and colour and depth side by side as an inline PNG."""
    size = fitted_size(frame.color.shape, _LARGEST)
    values, scale, title = depth_scale(frame)
    pictures = np.hstack([exposed(frame.color, size), scale.picture(reduced(values, size))])
    encoded = cv2.imencode(".png", cv2.cvtColor(pictures, cv2.COLOR_RGB2BGR))[1]
    data = base64.b64encode(encoded.data).decode("ascii")
    colors = f"{title}: red {scale.low:.5g} to blue {scale.high:.5g} {scale.unit}"
    alt = f"colour and {title}"
    return f'<div>{one_line(frame)}<br><img src="data:image/png;base64,{data}" alt="{alt}"><br>{colors}</div>'
