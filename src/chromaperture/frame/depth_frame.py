"""The result of a measurement, and its figures."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA, within_error
from chromaperture.depth.pointcloud import PointCloud, depth_to_points
from chromaperture.model.camera_file import Calibration
from chromaperture.settings.methods import Config
from chromaperture.system.errors import InputError
from chromaperture.system.threads import BAND_ROWS, each_band, parallel_map

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from chromaperture.frame.notebook import PointsView

# From a function of the rows of a band and its colours; it is called for all bands.
ColorBands = Callable[..., None]
_NO_COLOR = np.empty((0, 0, 3), np.float32)
MOST_POINTS = 50_000  # that a notebook shows: 1.5 MB in its file, and smooth on a telephone


@dataclass(frozen=True, repr=False)
class DepthFrame:
    """What is measured from one photograph, every map in the view of the pupil's centre; (H, W) arrays.

    Attributes
    ----------
    depth_mm, sigma_mm : float32, mm
        Distance from the sensor plane along the axis and its standard deviation; NaN unknown.
    disparity_px, disparity_sigma_px : float32, px
        Signed half disparity, 0 in focus, + beyond, and its standard deviation; NaN unknown.
    confidence : float32 in [0, 1]
    color : (H, W, 3) float32
        Linear RGB with the channels aligned and white balanced. Of pictures of more than 4 megapixels they are made
        when they are asked for.
    image : (H, W, 3) float32, optional
        The photograph, linear RGB, channels not aligned.
    calibration, config : Calibration and Config, optional
        Of the camera that measured; None in a frame that was put together from arrays.
    """

    depth_mm: np.ndarray
    sigma_mm: np.ndarray
    disparity_px: np.ndarray
    disparity_sigma_px: np.ndarray
    confidence: np.ndarray
    color: np.ndarray
    image: np.ndarray | None = None
    calibration: Calibration | None = None
    config: Config | None = None

    @classmethod
    def with_lazy_color(
        cls,
        color_bands: ColorBands,
        maps: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
        image: np.ndarray,
        camera: tuple[Calibration, Config],
    ) -> DepthFrame:
        """Return a frame whose colours are made when somebody asks for them: of many megapixels they take much memory.

        Parameters
        ----------
        color_bands : callable
            See `color_bands`.
        maps : five (H, W) arrays
            Depth and its error, disparity and its error, confidence.
        image : (H, W, 3) float32
        camera : Calibration and Config
        """
        frame = cls(*maps, _NO_COLOR, image, *camera)
        object.__delattr__(frame, "color")
        object.__setattr__(frame, "_color_bands", color_bands)
        return frame

    def __getattr__(self, name: str) -> Any:
        """Make the colours where `with_lazy_color` has left them out; Python asks only for what is not there."""
        if name != "color" or "_color_bands" not in self.__dict__:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        color = np.empty((*self.disparity_px.shape, 3), np.float32)
        self.__dict__["_color_bands"](color.__setitem__)
        object.__setattr__(self, "color", color)
        return color

    def __getstate__(self) -> dict[str, Any]:
        """Return what is copied and sent to other processes, with the colours."""
        state = self.__dict__ | {"color": self.color}
        state.pop("_color_bands", None)
        return state

    def color_bands(self, take: Callable[[slice, np.ndarray], None], *, multiple: int = 1) -> None:
        """Hand on the colours in bands of rows, which are made for it where nobody has asked for all of them.

        Parameters
        ----------
        take : callable
            Gets the rows of every band and its colours, (rows, W, 3) float32; on any thread, in any order.
        multiple : int
            Of which every band's first row is one.
        """
        if "color" not in self.__dict__:
            self.__dict__["_color_bands"](take, multiple=multiple)
            return
        color = self.color
        each_band(lambda rows: take(rows, color[rows]), len(color), rows_a_band=-(-BAND_ROWS // multiple) * multiple)

    @property
    def valid(self) -> np.ndarray:
        """(H, W) bool: where the depth is known."""
        return np.isfinite(self.depth_mm)

    @property
    def is_calibrated(self) -> bool:
        """Whether the camera that measured this frame is known and gives depth in mm."""
        return self.calibration is not None and self.config is not None and self.calibration.is_calibrated

    def points(self, *, max_relative_sigma: float = MAX_RELATIVE_SIGMA) -> PointCloud:
        """Return the coloured points, in mm: origin at the entrance pupil, x right, y down, z forward.

        Parameters
        ----------
        max_relative_sigma : float
            Largest sigma / depth; points carry no error bar. See `within_error`.

        Raises
        ------
        InputError
            The frame has no depth in mm, or was put together without its camera.
        """
        certain = within_error(self.depth_mm, self.sigma_mm, max_relative_sigma)
        return depth_to_points(certain, self.color, **self.rays())

    def rays(self) -> dict[str, Any]:
        """Return the parameters of `depth_to_points` that say where the rays of the pixels run; raises InputError."""
        if self.calibration is None or self.config is None or not self.calibration.is_calibrated:
            raise InputError("points need a frame of a calibrated camera; make one with 'chromaperture calibrate'")
        lens, depth = self.calibration.lens, self.calibration.depth[self.config.quality]
        return {
            "camera_matrix": lens.camera_matrix,
            "distortion": lens.distortion,
            "sensor_to_pupil_mm": depth.sensor_to_pupil_mm,
        }

    def save(
        self,
        target: str | Path,
        *,
        write: str | Iterable[str] | None = None,
        max_relative_sigma: float = MAX_RELATIVE_SIGMA,
    ) -> list[Path]:
        """Write the files that ``chromaperture depth`` writes, all or none.

        Parameters
        ----------
        target : str or Path
            ``results/photo`` writes ``results/photo.depth.tiff`` and so on; a folder that exists gets ``frame.*``.
        write : str or iterable of str, optional
            Which, such as ``"depth,sigma"``; see `OUTPUTS`. When absent, all that the camera can give, but the formats
            of other programs (``gdepth``, ``dynamic-depth``, ``exr``, ``exr-layers``, ``glb``, ``usdz``).
        max_relative_sigma : float
            Largest sigma / depth in what carries no error bar, such as ``depth-png`` and ``ply``.

        Returns
        -------
        list of Path
            The files.

        Raises
        ------
        InputError
            An unknown name, depth in mm of a camera without calibration, or a folder that cannot be written.
        MissingDependencyError
            ``exr`` or ``usdz`` without its extra.
        """
        from chromaperture.frame.frame_files import save

        return save(self, Path(target), write=write, max_relative_sigma=max_relative_sigma)

    def show(self) -> Figure:
        """Draw photograph, depth with a colour bar in mm, and error bar, in a window or a notebook."""
        from chromaperture.frame.notebook import show

        return show(self)

    def show_points(
        self, *, max_relative_sigma: float = MAX_RELATIVE_SIGMA, most_points: int = MOST_POINTS, height_px: int = 400
    ) -> PointsView:
        """Return the points as a notebook shows them: turned with the mouse, without a server.

        Parameters
        ----------
        max_relative_sigma : float
            Largest sigma / depth, see `within_error`.
        most_points : int
            Of more points, evenly chosen ones are shown; 15 bytes each stay in the notebook.
        height_px : int
            Height of the view.

        Raises
        ------
        InputError
            As `points`.
        """
        from chromaperture.frame.notebook import points_view

        cloud = self.points(max_relative_sigma=max_relative_sigma)
        return points_view(cloud, most_points=most_points, height_px=height_px)

    def to_open3d(self, *, max_relative_sigma: float = MAX_RELATIVE_SIGMA) -> Any:
        """Return the points as ``open3d.geometry.PointCloud``, in metres; needs the extra ``reconstruct``."""
        from chromaperture.frame.notebook import to_open3d

        return to_open3d(self.points(max_relative_sigma=max_relative_sigma))

    def to_xarray(self) -> Any:
        """Return all maps as ``xarray.Dataset`` with the dimensions y, x, units in the attributes; needs xarray."""
        from chromaperture.frame.notebook import to_xarray

        return to_xarray(self)

    def __repr__(self) -> str:
        return f"DepthFrame({one_line(self)})"

    def _repr_html_(self) -> str:
        from chromaperture.frame.notebook import html

        return html(self)


_PERCENTILES = (5, 25, 50, 75, 95)  # of disparity and depth
# Of a map of many megapixels every n-th row and column is used: the median of a million samples is off by a thousandth
# of the spread.
_SAMPLES = 1 << 20
_LEAST_SAMPLES = 10_000  # known ones; below, all pixels count


def summarise(frame: DepthFrame, seconds: dict[str, float]) -> dict[str, Any]:
    """Collect the figures of one frame, units in the names; ``seconds`` is the time of each stage."""
    known = frame.valid if frame.is_calibrated else np.isfinite(frame.disparity_px)
    disparity, depth, sigma = parallel_map(_percentiles, (frame.disparity_px, frame.depth_mm, frame.sigma_mm))
    return {
        "fill_rate": float(known.mean()),
        "disparity_percentiles_px": disparity,
        "depth_percentiles_mm": depth,
        "sigma_median_mm": None if sigma is None else sigma["50"],
        "seconds": {name: round(value, 4) for name, value in seconds.items()},
        "config": None if frame.config is None else dataclasses.asdict(frame.config),
        "camera": None if frame.calibration is None else frame.calibration.summary(),
    }


def one_line(frame: DepthFrame) -> str:
    """Describe a frame: size, fill rate, median depth and error bar; disparity where there is no depth."""
    height, width = frame.disparity_px.shape
    values, sigma, name, unit, form = frame.depth_mm, frame.sigma_mm, "depth", "mm", ".0f"
    if not frame.valid.any():
        values, sigma, name, unit, form = frame.disparity_px, frame.disparity_sigma_px, "disparity", "px", ".2f"
    known = np.isfinite(values)
    text = f"{width}x{height} px, {known.mean():.1%} filled"
    if not known.any():
        return text
    text += f", median {name} {np.median(values[known]):{form}} {unit}"
    sigma = sigma[np.isfinite(sigma)]
    return text + (f", median sigma {np.median(sigma):{form}} {unit}" if sigma.size else "")


def _percentiles(values: np.ndarray) -> dict[str, float] | None:
    step = math.isqrt(values.size // _SAMPLES) or 1
    sample = values[::step, ::step]
    known = sample[np.isfinite(sample)]
    if known.size < _LEAST_SAMPLES:
        known = values[np.isfinite(values)]
    if known.size == 0:
        return None
    return {str(p): float(v) for p, v in zip(_PERCENTILES, np.percentile(known, _PERCENTILES), strict=True)}
