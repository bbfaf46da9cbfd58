"""Draw a preview: capture, depth with a colour bar in mm, error bar, restored colour; Pillow, ten times Matplotlib."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from chromaperture.color.color_maps import DISTANCE, ERROR, draw_levels
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.files.pictures import write_png
from chromaperture.frame.depth_frame import DepthFrame

_DARK, _LIGHT = (20, 22, 26), (232, 230, 227)

# Layout, px, chosen by hand.
_WIDTH, _MARGIN, _HEADING, _TITLE = 1408, 16, 28, 44
_BAR_WIDTH, _BAR_SPACE = 14, 92  # the colour bar, and it with its labels
_LARGEST = ((_WIDTH - 4 * _MARGIN - _BAR_SPACE) // 2, 900)  # width and height of one picture
_TEXT_SIZE, _TITLE_SIZE = 14, 18
_ENDS = "near", "far"
_TICKS = 7  # at most, on a colour bar


@dataclass(frozen=True)
class ColorScale:
    """Colours of a map."""

    # ``low``, ``high``: values of the first and the last colour.
    low: float
    high: float
    colors: str  # of `color_maps`
    unit: str
    open_below: bool = True  # whether values below ``low`` exist; those above ``high`` always may
    ends: tuple[str, str] = ("", "")  # what the first and the last colour mean

    def picture(self, values: np.ndarray) -> np.ndarray:
        """Colour a map (H, W), NaN unknown; (H, W, 3) uint8 sRGB."""
        return draw_levels((values - self.low) / (self.high - self.low), self.colors)

    def ticks(self) -> list[float]:
        """Return round values between the ends."""
        raw = (self.high - self.low) / _TICKS
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(m * power for m in (1, 2, 5, 10) if m * power >= raw * 0.999)
        return [i * step for i in range(math.ceil(self.low / step), math.floor(self.high / step) + 1)]


def depth_scale(
    frame: DepthFrame, depth_range_mm: tuple[float, float] | None = None
) -> tuple[np.ndarray, ColorScale, str]:
    """Return the map to show, its colours and title: depth over a range, or disparity where depth is unknown."""
    if frame.valid.any():
        low, high = _apart(*(depth_range_mm or middle_range(frame.depth_mm, 2)))
        return frame.depth_mm, ColorScale(low, high, DISTANCE, "mm", ends=_ENDS), "depth from the sensor plane"
    low, high = _apart(*middle_range(frame.disparity_px, 1))
    title = "disparity (0 in focus, + beyond); depth needs a calibration"
    return frame.disparity_px, ColorScale(low, high, DISTANCE, "px", ends=_ENDS), title


def error_scale(
    frame: DepthFrame, depth_range_mm: tuple[float, float] | None = None
) -> tuple[np.ndarray, ColorScale, str]:
    """Return the error bar of what `depth_scale` returns; frames of one range of depth have the same colours."""
    title = "error bar (one standard deviation)"
    if not frame.valid.any():
        highest = middle_range(frame.disparity_sigma_px, 10)[1]
        return frame.disparity_sigma_px, ColorScale(*_apart(0.0, highest), ERROR, "px", open_below=False), title
    farthest = depth_scale(frame, depth_range_mm)[1].high
    return frame.sigma_mm, ColorScale(0.0, MAX_RELATIVE_SIGMA * farthest, ERROR, "mm", open_below=False), title


def reduced(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Sample a map at (width, height) pixels by the nearest: the mean of two depths belongs to no surface."""
    width, height = size
    rows = ((np.arange(height) + 0.5) * values.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * values.shape[1] / width).astype(int)
    return values[rows[:, None], columns]


def exposed(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Scale a linear picture to (width, height) pixels and to a bright exposure; (height, width, 3) uint8 sRGB."""
    picture = reduced_by_whole(picture, whole_factor(picture.shape, size))
    smaller = size[0] < picture.shape[1]
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_NEAREST)
    white = max(float(np.nanpercentile(small, 99.5)), 1e-6)
    return linear_to_srgb_bytes(small / white)


def whole_factor(shape: tuple[int, ...], size: tuple[int, int]) -> int:
    """Return by how many whole pixels a picture is averaged before it becomes a size: parts take longer."""
    return max(1, min(shape[1] // size[0], shape[0] // size[1]))


def reduced_by_whole(picture: np.ndarray, factor: int) -> np.ndarray:
    """Average so many pixels a side; at most ``factor - 1`` of the last rows and columns are left out."""
    if factor == 1:
        return picture
    height, width = picture.shape[0] // factor, picture.shape[1] // factor
    inner = picture[: height * factor, : width * factor]
    return np.asarray(cv2.resize(inner, (width, height), interpolation=cv2.INTER_AREA))


def fitted_size(shape: tuple[int, ...], largest: tuple[int, int]) -> tuple[int, int]:
    """Return the width and height of a picture scaled to fit into the largest."""
    scale = min(largest[0] / shape[1], largest[1] / shape[0])
    return max(1, round(shape[1] * scale)), max(1, round(shape[0] * scale))


def preview_size(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return width and height of each of the preview's pictures of a frame (H, W)."""
    return fitted_size(shape, _LARGEST)


def write_preview(
    path: Path,
    image: np.ndarray | None,
    frame: DepthFrame,
    *,
    title: str,
    caption: str = "",
    depth_range_mm: tuple[float, float] | None = None,
    color: np.ndarray | None = None,
) -> None:
    """Draw the preview of a capture as PNG, 1408 px wide, a caption below its title.

    It shows disparity instead of depth where the camera is not calibrated.

    ``image`` (H, W, 3) float or None: the capture, linear RGB, channels not aligned; ``depth_range_mm`` (float, float):
    ends of the colour bar, to compare previews; ``color`` (h, w, 3) float32: the frame's colours, reduced as
    `color_pictures` does it.
    """
    size = preview_size((frame.color if color is None else frame.disparity_px).shape)
    width, height = size
    heading = _TITLE + (_HEADING if caption else 0)
    page = Image.new("RGB", (_WIDTH, heading + 2 * (_HEADING + height) + 2 * _MARGIN), _DARK)
    draw = ImageDraw.Draw(page)
    draw.text((_WIDTH // 2, _TITLE // 2), title, _LIGHT, _font(_TITLE_SIZE), anchor="mm")
    draw.text((_WIDTH // 2, _TITLE + _HEADING // 4), caption, _LIGHT, _font(_TITLE_SIZE), anchor="mm")
    left, right = _MARGIN, 2 * _MARGIN + _LARGEST[0]
    top, below = heading, heading + _HEADING + height + _MARGIN
    if image is not None:
        _panel(page, (left, top), exposed(image, size), "capture")
    _panel(
        page, (left, below), exposed(frame.color if color is None else color, size), "restored colour, channels aligned"
    )
    for place, (values, scale, name) in (
        ((right, top), depth_scale(frame, depth_range_mm)),
        ((right, below), error_scale(frame, depth_range_mm)),
    ):
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
    near, far = scale.ends
    draw.text((right + 9, y - _HEADING / 2), ", ".join(filter(None, (far, scale.unit))), _LIGHT, font, anchor="lm")
    draw.text((right + 9, y + height + _MARGIN / 2), near, _LIGHT, font, anchor="lm")


def middle_range(values: np.ndarray, percent: float) -> tuple[float, float]:
    """Return the ends of what is known without so many percent at either end, from a million pixels."""
    step = math.isqrt(values.size >> 20) + 1
    sample = values[::step, ::step]
    known = sample[np.isfinite(sample)]
    low, high = np.percentile(known, (percent, 100 - percent)) if known.size else (0.0, 1.0)
    return float(low), float(high)


def _apart(low: float, high: float) -> tuple[float, float]:
    """Return the ends of a scale, which a map of one value does not have."""
    return low, max(high, low + 1e-3 * max(1.0, abs(low)))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Open the font that comes with Matplotlib, which has Greek and Cyrillic letters; Pillow's own has not."""
    # Found without importing Matplotlib, which takes 0.15 s.
    places = find_spec("matplotlib")
    assert places is not None  # it belongs to the base installation
    assert places.origin is not None
    font = Path(places.origin).parent / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf"
    return ImageFont.truetype(str(font), size)


class ColorPictures(NamedTuple):
    """What files have of a frame's colours."""

    srgb: np.ndarray  # (H, W, 3) uint8
    small: np.ndarray  # (h, w, 3) float32, linear RGB: averages of whole pixels, not smaller than the preview


def color_pictures(frame: DepthFrame) -> ColorPictures:
    """Return the colours of a frame as sRGB, and reduced for the preview."""
    height, width = frame.disparity_px.shape
    factor = whole_factor((height, width), preview_size((height, width)))
    srgb = np.empty((height, width, 3), np.uint8)
    small = np.empty((height // factor, width // factor, 3), np.float32)

    def take(rows: slice, color: np.ndarray) -> None:
        linear_to_srgb_bytes(color, out=srgb[rows])
        if len(color) >= factor:  # the last band may have rows for no average
            means = reduced_by_whole(color, factor)
            small[rows.start // factor :][: len(means)] = means

    frame.color_bands(take, multiple=factor)
    return ColorPictures(srgb, small)
