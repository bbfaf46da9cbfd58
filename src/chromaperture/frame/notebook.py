"""A frame and a camera as notebooks and scripts show them, and as objects of other libraries."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from chromaperture.color.color_maps import color_map
from chromaperture.depth.conversion import depth_to_disparity, disparity_to_depth
from chromaperture.depth.pointcloud import PointCloud
from chromaperture.files.map_page import Page, render
from chromaperture.frame.depth_frame import DepthFrame, one_line
from chromaperture.frame.preview import ColorScale, depth_scale, error_scale, exposed, fitted_size, reduced
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Quality
from chromaperture.system.errors import InputError, needed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    """Return the film in the pupil and a table of what the camera is, with a quality's depth curve, as HTML."""
    lens, sensor = calibration.lens, calibration.sensor
    rows = [
        ("film", calibration.pupil_title),
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
    picture = _image(_pupil(calibration), f"the pupil: {escape(calibration.pupil_title)}")
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


@dataclass(frozen=True, repr=False)
class PointsView:
    """A page that shows points, and needs nothing else.

    Attributes
    ----------
    page : str
        HTML with the data inside; ``Path("points.html").write_text(view.page, encoding="utf-8")`` keeps it.
    count : int
        Points shown.
    height_px : int
        Height within a notebook.
    """

    page: str
    count: int
    height_px: int

    def __repr__(self) -> str:
        return f"PointsView({self.count} points)"

    def _repr_html_(self) -> str:
        style = "border: 1px solid #ddd; width: 100%"
        return f'<iframe srcdoc="{escape(self.page)}" height="{self.height_px}" style="{style}"></iframe>'


def points_view(cloud: PointCloud, *, most_points: int, height_px: int) -> PointsView:
    """Make the page; of more than ``most_points`` points, evenly chosen ones. Raises InputError for no point."""
    if not len(cloud.points_mm) or most_points < 1:
        raise InputError("there is no point to show: raise max_relative_sigma or most_points")
    chosen = slice(None, None, -(-len(cloud.points_mm) // most_points))
    shown = PointCloud(cloud.points_mm[chosen], cloud.colors[chosen])
    return PointsView(render(Page(title="Points", cloud=shown)), len(shown.points_mm), height_px)


def to_open3d(cloud: PointCloud) -> Any:
    """Convert points to ``open3d.geometry.PointCloud``: metres, colours 0 to 1; x right, y down, z forward."""
    open3d = needed("open3d", "Open3D needs the extra: pip install 'chromaperture[reconstruct]'")
    made = open3d.geometry.PointCloud()
    made.points = open3d.utility.Vector3dVector(cloud.points_mm.astype(np.float64) / 1000)
    made.colors = open3d.utility.Vector3dVector(cloud.colors.astype(np.float64) / 255)
    return made


def to_xarray(frame: DepthFrame) -> Any:
    """Return the maps of a frame as ``xarray.Dataset``, which holds the arrays themselves, not copies."""
    xarray = needed("xarray", "datasets need the extra: pip install 'chromaperture[xarray]'")
    height, width = frame.disparity_px.shape
    maps = {
        "depth_mm": (frame.depth_mm, "mm", "distance from the sensor plane along the optical axis"),
        "sigma_mm": (frame.sigma_mm, "mm", "standard deviation of the depth"),
        "disparity_px": (frame.disparity_px, "px", "half disparity, 0 in focus, + beyond the focus surface"),
        "disparity_sigma_px": (frame.disparity_sigma_px, "px", "standard deviation of the half disparity"),
        "confidence": (frame.confidence, "1", "confidence, 0 to 1"),
    }
    data = {
        name: (("y", "x"), values, {"units": unit, "long_name": meaning})
        for name, (values, unit, meaning) in maps.items()
    }
    picture = {"units": "1", "long_name": "linear RGB, channels aligned, white balanced"}
    pixels = {
        "y": ("y", np.arange(height), {"units": "px", "long_name": "row, 0 is the centre of the topmost pixel"}),
        "x": ("x", np.arange(width), {"units": "px", "long_name": "column, 0 is the centre of the leftmost pixel"}),
    }
    about = {}
    if frame.calibration is not None and frame.config is not None:
        about = {"design": frame.calibration.design, "quality": frame.config.quality}
    return xarray.Dataset(
        data | {"color": (("y", "x", "channel"), frame.color, picture)},
        coords=pixels | {"channel": ["R", "G", "B"]},
        attrs=about,
    )


_FIGURE_PX = (1200, 1200)  # px: finer than a figure on a screen


def show(frame: DepthFrame) -> Figure:
    """Draw photograph, depth and error bar in one row, see `DepthFrame.show`."""
    from matplotlib import pyplot

    size = fitted_size(frame.color.shape, _FIGURE_PX)
    if size[0] > frame.color.shape[1]:
        size = (frame.color.shape[1], frame.color.shape[0])
    height, width = frame.color.shape[:2]
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)  # pixels of the photograph, also where fewer are drawn
    figure, (photograph, depth, error) = pyplot.subplots(
        1, 3, figsize=(15, 0.8 + 4.4 * height / width), layout="constrained", sharex=True, sharey=True
    )
    figure.suptitle(one_line(frame))
    taken = frame.image is not None
    photograph.imshow(exposed(frame.color if frame.image is None else frame.image, size), extent=extent)
    photograph.set_title("photograph" if taken else "restored colour")

    def draw(axes: Axes, values: np.ndarray, scale: ColorScale, title: str) -> None:
        shown = axes.imshow(
            reduced(values, size),
            cmap=color_map(scale.colors),
            vmin=scale.low,
            vmax=scale.high,
            extent=extent,
            interpolation="nearest",
        )
        extend = "both" if scale.open_below else "max"
        figure.colorbar(shown, ax=axes, label=scale.unit, extend=extend, shrink=0.9)
        axes.set_title(title)

    draw(depth, *depth_scale(frame))
    draw(error, *error_scale(frame))
    if "inline" in pyplot.get_backend():
        pyplot.close(figure)  # else the notebook would draw it twice: as the cell's value and at its end
    elif figure.canvas.required_interactive_framework:
        pyplot.show()
    return figure
