"""The parameters of one camera, in one file.

The file is ASDF: YAML text that any editor opens, and binary arrays for large maps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

import asdf
import numpy as np
from pydantic import AliasPath, Field

from chromaperture.color.unmixing import mixing_matrix, own_film_unmixing, unmixing_rows
from chromaperture.depth.conversion import DepthModel, PaperParameters, depth_to_disparity, model_to_paper
from chromaperture.depth.field import DepthField, field_from_tree, field_to_tree, plain
from chromaperture.model.asdf_input import read_tree
from chromaperture.model.camera_parts import Board, CameraPart, CameraSensor, Film, Lens, stored_as
from chromaperture.model.file_kind import camera_file_at
from chromaperture.optics.aperture import Aperture, design_named
from chromaperture.optics.lens_blur import BlurModel, LensBlur, sample_pupil
from chromaperture.optics.pinhole import centered_pinhole
from chromaperture.settings.methods import QUALITIES, Quality
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged
from chromaperture.system.validation import (
    MOST_PIXELS,
    Finite,
    Name,
    NotNegative,
    Positive,
    checked,
    checked_value,
    quoted,
)

FORMAT_VERSION = 2  # of a dual-pixel camera, whose left picture version 1 would take for a photograph; others are 1
# A focus from here on is called infinity: that far away the disparity of a 50 mm lens at f/2 is 0.04 px of 62 um less
# than at infinity.
INFINITY_MM = 1e5
_ROOT = "chromaperture_camera"
_CHECKED_WHOLE, _PLACES = 2**20, 129  # px of a sensor whose curves are checked everywhere; else places along a side
_ABOUT = (
    "One camera with a colour-coded aperture, at one focus setting. Lengths are in mm, disparities are signed half "
    "disparities in px (0 in focus, + beyond). Depth from the sensor plane is sensor_to_pupil_mm + scale_px_mm / "
    "(infinity_disparity_px - disparity). The two fields are polynomials over the frame: coefficients of Chebyshev "
    "products in x and y over [-1, 1] by rising degree in x, then in y; a single number holds for the whole frame. "
    "covariance is that of A, B and sensor_to_pupil_mm, or of all coefficients in that order, then those of the "
    "nonlinearity. nonlinearity is what the matcher measures beyond that disparity: Chebyshev coefficients of T2, T3, "
    "... over low_px..high_px. local is to be added to the fields: maps on a grid over the frame, or null. "
    "channel_moves_px is the displacement (x, y) of R, G, B by the lens at every disparity alike, px, in rows and "
    "columns of places evenly spaced over the frame; real-time takes it off before it matches three channels."
)
_Length = Field(min_length=2, max_length=100)  # of a table's side
_Moved = Annotated[Finite, Field(ge=-100, le=100)]
_Pair = tuple[_Moved, _Moved]
_Moves = Annotated[tuple[Annotated[tuple[tuple[_Pair, _Pair, _Pair], ...], _Length], ...], _Length]


def _curves(tree: Mapping[str, Mapping[str, Any]]) -> dict[Quality, DepthField]:
    """Rebuild the depth curves; raises KeyError, TypeError or ValueError where the tree holds none."""
    try:
        return {quality: field_from_tree(tree[quality]) for quality in QUALITIES if quality in tree}
    except ValueError as error:
        raise ValueError(f"the curves are damaged ({error}); calibrate again") from None


def _blur(values: Mapping[str, float]) -> BlurModel:
    """Rebuild the blur; files of versions without ``contrast_fall`` are of film, which has none."""
    complete = {"contrast_fall": 0.0} | dict(values)
    return BlurModel(**{f.name: complete[f.name] for f in fields(BlurModel)})


@dataclass(frozen=True, repr=False)
class Calibration(CameraPart):
    """The parameters of a `chromaperture.camera.camera.CodedApertureCamera`.

    Attributes
    ----------
    design : str
        Name of the aperture design.
    sensor : CameraSensor
    lens : Lens
    film : Film
    depth : dict of str to DepthField
        Depth curves over the frame for each quality, because each matcher has a bias of its own. Empty in an
        uncalibrated camera, which measures disparity only.
    near_mm, far_mm : float
        Working range of depth, from the sensor plane, in which disparities are searched.
    provenance : dict
        Origin of the file: command, date, versions, options, hashes of the photographs, fit residuals.
    blur : BlurModel or None
        Blur of the lens over the frame, for PSF-aware matching; ``depth["accurate"]`` is then the curve of its layers.
    board : Board or None
        The chessboard of the session, for `chromaperture check`; None in files of older versions.
    channel_moves_px : (rows, columns, 3, 2) float64 or None
        Displacement (x, y) of R, G, B by the lens at every disparity alike, px, at places evenly spaced over the frame,
        which quality ``real-time`` takes off before it matches three channels; its depth curve was measured so. None
        where the blur is not known, in files of older versions, and for designs that match two channels.
    """

    design: Name
    sensor: CameraSensor
    lens: Lens
    film: Film
    depth: Annotated[Mapping[Quality, DepthField], stored_as(dict[str, dict[str, Any]], _curves)]
    near_mm: Annotated[NotNegative, Field(validation_alias=AliasPath("working_range", "near_mm"))]
    far_mm: Annotated[Positive, Field(validation_alias=AliasPath("working_range", "far_mm"))]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    blur: Annotated[BlurModel, stored_as(dict[str, Finite], _blur)] | None = None
    board: Board | None = None
    channel_moves_px: Annotated[np.ndarray, stored_as(_Moves)] | None = None

    @property
    def aperture(self) -> Aperture:
        """The aperture in the pupil."""
        return design_named(self.design)

    @property
    def title(self) -> str:
        """Design, size of the picture and working range, in one line."""
        design = self.design if self.sensor.dual_pixel is None else "dual pixel"
        size = f"{design}, {self.sensor.width_px}x{self.sensor.height_px} px"
        return f"{size}, {self.near_mm:.0f} to {self.far_mm:.0f} mm" if self.is_calibrated else f"{size}, uncalibrated"

    @property
    def pupil_title(self) -> str:
        """What divides the pupil."""
        return self.aperture.title if self.sensor.dual_pixel is None else "halves of a dual-pixel sensor"

    def __repr__(self) -> str:
        curves = f", curves for {', '.join(self.depth)}" if self.depth else ""
        return f"Calibration({self.title}{curves})"

    @property
    def unmixing(self) -> np.ndarray:
        """Rows of M^-1, Eq. (1); (K, 3) float64."""
        names = self.aperture.views
        return unmixing_rows(mixing_matrix(np.array([self.film.filters[n] for n in names])), len(names))

    @property
    def image_distance_mm(self) -> float:
        """Distance F from the pinhole's centre to its sensor: fx times the pixel pitch."""
        return float(self.lens.camera_matrix[0, 0]) * self.sensor.pixel_pitch_mm

    def field_blur(self) -> LensBlur | None:
        """Return the blur of lens and film; None where it was not fitted."""
        if self.blur is None:
            return None
        pupil = sample_pupil(self.aperture.with_film(self.film.transmissions()))
        return LensBlur(self.blur, pupil, self.sensor.width_px, self.sensor.height_px)

    @property
    def is_calibrated(self) -> bool:
        """Whether the camera measures depth in mm."""
        return bool(self.depth)

    def depth_model(self, quality: Quality = "real-time") -> DepthModel:
        """Return the depth curve of a quality over the frame, (H, W) maps where it varies.

        Parameters
        ----------
        quality : {"paper", "real-time", "accurate"}

        Raises
        ------
        InputError
            The camera has no curve for that quality.
        """
        return self._curve(quality).model(self.sensor.width_px, self.sensor.height_px)

    def _curve(self, quality: Quality) -> DepthField:
        if quality not in self.depth:
            known = f"it has {', '.join(self.depth)}" if self.depth else "it was never calibrated"
            raise InputError(f"this camera has no depth curve for quality {quality}: {known}; run 'calibrate' again")
        return self.depth[quality]

    @property
    def in_focus_mm(self) -> float:
        """Distance of the focus surface from the sensor plane, on the axis: z~_of = B / A + delta."""
        return float(self.on_axis("real-time").in_focus_mm)

    @property
    def in_focus_text(self) -> str:
        """Distance in focus for people; negative where the lens is focused a little beyond infinity."""
        return f"{self.in_focus_mm:.0f} mm" if 0 < self.in_focus_mm < INFINITY_MM else "infinity"

    @property
    def baseline_mm(self) -> float:
        """Baseline b of the unmixed views on the axis; that of the channels is shorter, because film leaks."""
        return float(self.paper_parameters(self.on_axis("paper")).baseline_mm)

    def paper_parameters(self, model: DepthModel) -> PaperParameters:
        """Return a depth curve as the paper's z~_of, b, delta and f, mm (section 3.4, Figure 7).

        Parameters
        ----------
        model : DepthModel
            Of this camera: `depth_model`, `on_axis`.
        """
        return model_to_paper(
            model, image_distance_mm=self.image_distance_mm, pixel_pitch_mm=self.sensor.pixel_pitch_mm
        )

    def on_axis(self, quality: Quality) -> DepthModel:
        """Return the depth curve of a quality in the middle of the frame, as numbers; raises as `depth_model`."""
        return self._curve(quality).on_axis(self.sensor.width_px, self.sensor.height_px)

    def disparity_range_px(self, quality: Quality = "real-time") -> tuple[float, float]:
        """Return the smallest and the largest disparity of the working range over the frame, px; as `depth_model`."""
        model = self.depth_model(quality)
        near, far = (depth_to_disparity(z, model) for z in (self.near_mm, self.far_mm))
        return float(np.min(near)), float(np.max(far))

    def summary(self) -> dict[str, Any]:
        """Return the figures that ``chromaperture info`` prints, units in the names; None where uncalibrated.

        Raises InputError where there are curves, but none of quality real-time.
        """
        on_axis = self.on_axis("real-time") if self.depth else None
        figures = {
            "design": self.design,
            "title": self.pupil_title,
            "width_px": self.sensor.width_px,
            "height_px": self.sensor.height_px,
            "pixel_pitch_mm": self.sensor.pixel_pitch_mm,
            "focal_length_mm": self.lens.focal_length_mm,
            "f_number": self.lens.f_number,
            "sensor_to_pupil_mm": on_axis.sensor_to_pupil_mm if on_axis else None,
            "in_focus_mm": self.in_focus_mm if on_axis else None,
            "baseline_mm": self.baseline_mm if on_axis else None,
            "infinity_disparity_px": on_axis.infinity_disparity_px if on_axis else None,
            "scale_px_mm": on_axis.scale_px_mm if on_axis else None,
            "near_mm": self.near_mm,
            "far_mm": self.far_mm,
            "black_level": self.sensor.black_level,
            "white_level": self.sensor.white_level,
            "curve": self.sensor.curve if self.sensor.response is None else f"{self.sensor.curve}, then a tone curve",
            "provenance": dict(self.provenance),
        }
        known = {"design", "title", "width_px", "height_px", "provenance"}  # the others are placeholders
        return figures if on_axis else {name: v if name in known else None for name, v in figures.items()}

    @classmethod
    def uncalibrated(cls, design: str, *, width_px: int, height_px: int) -> Calibration:
        """Return a camera of which only the aperture is known; it measures disparity, not depth.

        Parameters
        ----------
        design : str
            Such as ``"cy_halves"``, see `design_named`.
        width_px, height_px : int
            Of the photographs.

        Raises
        ------
        InputError
            There is no such design, or it has no parallax.
        """
        aperture = design_named(design)
        own_film_unmixing(aperture)  # refuses designs without parallax
        colors = {name: np.array(aperture.filter_named(name).transmission) for name in aperture.views}
        focal_px = 1.2 * max(width_px, height_px)  # a normal lens; a placeholder, no point cloud is made
        matrix = centered_pinhole(focal_px, (width_px, height_px))
        return cls(
            design=design,
            sensor=CameraSensor(width_px, height_px, 36.0 / width_px, black_level=0.0, white_level=65535.0),
            lens=Lens(50.0, camera_matrix=matrix, distortion=np.zeros(5)),
            film=Film(colors, np.ones(3), np.ones(3)),
            depth={},
            near_mm=0.0,
            far_mm=math.inf,
            provenance={"note": "not calibrated; sensor and lens figures are placeholders"},
        )

    def save(self, path: str | Path) -> None:
        """Write the camera file; whole or not at all.

        Parameters
        ----------
        path : str or Path
            ``NAME.asdf``.
        """
        path = Path(path)
        values = plain(dataclasses.asdict(replace(self, depth={}, provenance=dict(self.provenance))))
        values["working_range"] = {name: values.pop(name) for name in ("near_mm", "far_mm")}
        values["depth"] = {quality: field_to_tree(field) for quality, field in self.depth.items()}
        values["film"]["unit"] = "white light as R, G, B, 1 = white level"
        version = 1 if self.sensor.dual_pixel is None else FORMAT_VERSION
        tree = {_ROOT: {"about": _ABOUT, "format_version": version, **values}}
        with staged(path.parent) as stage, asdf.AsdfFile(tree) as file:
            file.write_to(stage.path(path.name))

    @classmethod
    def load(cls, path: str | Path) -> Calibration:
        """Read a camera file.

        Parameters
        ----------
        path : str or Path

        Raises
        ------
        InputError
            The file is missing, damaged, not a camera file, or of a newer format.
        """
        path = camera_file_at(Path(path))
        try:
            tree = read_tree(path)[_ROOT]
            version = tree["format_version"]
            if isinstance(version, int) and version > FORMAT_VERSION:
                raise InputError(
                    f"{path.name} has format version {version}, newer than this program's {FORMAT_VERSION}; "
                    "upgrade chromaperture"
                )
            checked_value(Annotated[int, Field(ge=1)], version, where=f"{quoted(path.name)}: format_version ")
            # As it is in the file: what is checked has tuples for lists.
            calibration = replace(checked(cls, tree, where=quoted(path.name)), provenance=dict(tree["provenance"]))
            _check(calibration)
        except InputError:
            raise
        except Exception as error:  # YAML, ASDF and NumPy raise many kinds on a damaged file
            reason = f"{type(error).__name__}: {error}".splitlines()[0][:120]
            raise InputError(f"{path.name} is damaged or not a camera file ({reason}); calibrate again") from None
        return calibration


def _check(calibration: Calibration) -> None:
    """Raise ValueError for parameters that no camera has together."""
    sensor, lens, film = calibration.sensor, calibration.lens, calibration.film
    # The maps of a large sensor take gigabytes: it is checked at some places.
    small = sensor.width_px * sensor.height_px <= _CHECKED_WHOLE
    places = np.meshgrid(*(np.linspace(0, side - 1, _PLACES) for side in (sensor.width_px, sensor.height_px)))
    positive = {
        "sensor.white_level - black_level": sensor.white_level - sensor.black_level,
        "lens.camera_matrix fx": float(lens.camera_matrix[0, 0]),
        "lens.camera_matrix fy": float(lens.camera_matrix[1, 1]),
        "working range": calibration.far_mm - calibration.near_mm,
    }
    for quality, curve in calibration.depth.items():
        at = (sensor.width_px, sensor.height_px)
        model = calibration.depth_model(quality) if small else curve.at(places[0], places[1], *at)
        positive[f"depth.{quality}.scale_px_mm"] = float(np.min(model.scale_px_mm))
        positive[f"near_mm - depth.{quality}.sensor_to_pupil_mm"] = calibration.near_mm - float(
            np.max(model.sensor_to_pupil_mm)
        )
    for name, value in positive.items():
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive and finite, is {value}")
    if not calibration.depth:
        raise ValueError("no depth curve")
    if sensor.width_px * sensor.height_px > MOST_PIXELS:
        raise ValueError(f"the sensor has more than {MOST_PIXELS} pixels")
    if not np.array_equal(lens.camera_matrix[2], (0, 0, 1)) or lens.camera_matrix[1, 0] != 0:
        raise ValueError("lens.camera_matrix is not that of a pinhole")
    missing = set(calibration.aperture.views) - set(film.filters)
    if missing:
        raise ValueError(f"film.filters lacks {', '.join(sorted(missing))}")
    calibration.unmixing  # noqa: B018 - raises when the filter colours cannot be told apart
