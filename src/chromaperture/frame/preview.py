"""Draw a preview: capture, depth with a colour bar in mm, error bar, restored colour.

Drawn with Pillow, which takes a tenth of the time of Matplotlib's figure (0.1 s of one core against 1.0 s, where a
measurement in real time takes 0.1 s), and at a bounded size, whatever the photograph's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from chromaperture.color.color_maps import DISTANCE, ERROR, draw_levels
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.storage import write_png

_DARK, _LIGHT = (20, 22, 26), (232, 230, 227)

# Layout, px, chosen by hand.
_WIDTH, _MARGIN, _HEADING, _TITLE = 1408, 16, 28, 44
_BAR_WIDTH, _BAR_SPACE = 14, 92  # the colour bar, and it with its labels
_LARGEST = ((_WIDTH - 4 * _MARGIN - _BAR_SPACE) // 2, 900)  # width and height of one picture
_TEXT_SIZE, _TITLE_SIZE = 15, 19
_TICKS = 7  # at most, on a colour bar


@dataclass(frozen=True)
class ColorScale:
    """Colours of a map.

    Attributes
    ----------
    low, high : float
        Values of the first and the last colour.
    colors : str
        Of `color_maps`.
    unit : str
    open_below : bool
        Whether values below ``low`` exist; those above ``high`` always may.
    """

    low: float
    high: float
    colors: str
    unit: str
    open_below: bool = True

    def picture(self, values: np.ndarray) -> np.ndarray:
        """Colour a map (H, W), NaN unknown; (H, W, 3) uint8 sRGB."""
        return draw_levels((values - self.low) / (self.high - self.low), self.colors)

    def ticks(self) -> list[float]:
        """Return round values between the ends."""
        raw = (self.high - self.low) / _TICKS
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(m * power for m in (1, 2, 5, 10) if m * power >= raw * 0.999)
        return [i * step for i in range(math.ceil(self.low / step), math.floor(self.high / step) + 1)]


def depth_scale(frame: DepthFrame) -> tuple[np.ndarray, ColorScale, str]:
    """Return the map to show, its colours (near is red) and its title: depth, or disparity where depth is unknown."""
    if frame.valid.any():
        low, high = _percentiles(frame.depth_mm, (2, 98))
        return frame.depth_mm, ColorScale(low, high, DISTANCE, "mm"), "depth from the sensor plane"
    low, high = _percentiles(frame.disparity_px, (1, 99))
    title = "disparity (0 in focus, + beyond); depth needs a calibration"
    return frame.disparity_px, ColorScale(low, high, DISTANCE, "px"), title


def error_scale(frame: DepthFrame) -> tuple[np.ndarray, ColorScale, str]:
    """Return the error bar of what `depth_scale` returns."""
    values, unit = (frame.sigma_mm, "mm") if frame.valid.any() else (frame.disparity_sigma_px, "px")
    high = _percentiles(values, (0, 90))[1]
    scale = ColorScale(0.0, max(high, 1e-6), ERROR, unit, open_below=False)
    return values, scale, "error bar (one standard deviation)"


def reduced(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Sample a map at (width, height) pixels by the nearest: the mean of two depths belongs to no surface."""
    width, height = size
    rows = ((np.arange(height) + 0.5) * values.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * values.shape[1] / width).astype(int)
    return values[rows[:, None], columns]


def exposed(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Scale a linear picture to (width, height) pixels and to a bright exposure; (height, width, 3) uint8 sRGB."""
    smaller = size[0] < picture.shape[1]
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_NEAREST)
    white = max(float(np.nanpercentile(small, 99.5)), 1e-6)
    return linear_to_srgb_bytes(small / white)


def fitted_size(shape: tuple[int, ...], largest: tuple[int, int]) -> tuple[int, int]:
    """Return the width and height of a picture scaled to fit into the largest."""
    scale = min(largest[0] / shape[1], largest[1] / shape[0])
    return max(1, round(shape[1] * scale)), max(1, round(shape[0] * scale))


def write_preview(path: Path, frame: DepthFrame, *, title: str) -> None:
    """Draw the preview of a frame as PNG, 1408 px wide.

    It shows disparity instead of depth where the camera is not calibrated, and no capture where the frame has none.
    """
    size = fitted_size(frame.color.shape, _LARGEST)
    width, height = size
    page = Image.new("RGB", (_WIDTH, _TITLE + 2 * (_HEADING + height) + 2 * _MARGIN), _DARK)
    draw = ImageDraw.Draw(page)
    draw.text((_WIDTH // 2, _TITLE // 2), title, _LIGHT, _font(_TITLE_SIZE), anchor="mm")
    left, right = _MARGIN, 2 * _MARGIN + _LARGEST[0]
    top, below = _TITLE, _TITLE + _HEADING + height + _MARGIN
    if frame.image is not None:
        place = (left, top)
        _panel(page, place, exposed(frame.image, size), "capture through the colour-coded aperture")
    _panel(page, (left, below), exposed(frame.color, size), "restored colour, channels aligned")
    for place, (values, scale, name) in (((right, top), depth_scale(frame)), ((right, below), error_scale(frame))):
        small = reduced(values, size)
        note = "; grey is unknown" if np.isnan(small).any() else ""
        _panel(page, place, scale.picture(small), name + note)
        _bar(draw, (place[0] + width + 10, place[1] + _HEADING), height, scale)
    write_png(path, np.asarray(page))


def _panel(page: Image.Image, place: tuple[int, int], picture: np.ndarray, heading: str) -> None:
    x, y = place
    ImageDraw.Draw(page).text((x, y + _HEADING // 2), heading, _LIGHT, _font(_TEXT_SIZE), anchor="lm")
    page.paste(Image.fromarray(picture), (x, y + _HEADING))


def _bar(draw: ImageDraw.ImageDraw, place: tuple[int, int], height: int, scale: ColorScale) -> None:
    """Draw a colour bar, high values above, with a point at each end beyond which values go on."""
    x, y = place
    right, middle, font = x + _BAR_WIDTH, x + _BAR_WIDTH / 2, _font(_TEXT_SIZE - 1)
    top, bottom = y + _BAR_WIDTH, y + height - (_BAR_WIDTH if scale.open_below else 1)
    levels = np.linspace(1, 0, bottom - top + 1)[:, None]
    colors = [tuple(int(c) for c in color) for color in draw_levels(levels, scale.colors)[:, 0]]
    for row, color in enumerate(colors, start=top):
        draw.line([(x, row), (right, row)], color)
    draw.polygon([(x, top), (right, top), (middle, y)], colors[0])
    if scale.open_below:
        draw.polygon([(x, bottom), (right, bottom), (middle, y + height - 1)], colors[-1])
    for value in scale.ticks():
        tick = bottom - (value - scale.low) / (scale.high - scale.low) * (bottom - top)
        draw.line([(right, tick), (right + 5, tick)], _LIGHT)
        draw.text((right + 9, tick), f"{value:.6g}", _LIGHT, font, anchor="lm")
    draw.text((right + 9, y - _HEADING / 2), scale.unit, _LIGHT, font, anchor="lm")


def _percentiles(values: np.ndarray, percentiles: tuple[float, float]) -> tuple[float, float]:
    """Return two percentiles of what is known, of every n-th pixel where there are very many; never twice the same."""
    step = math.isqrt(values.size >> 20) + 1  # a million pixels are plenty
    sample = values[::step, ::step]
    known = sample[np.isfinite(sample)]
    low, high = (float(v) for v in np.percentile(known, percentiles)) if known.size else (0.0, 1.0)
    return low, max(high, low + 1e-6 * max(1.0, abs(low)))


def _font(size: int) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)
