"""One photograph in, millimetres out: `CodedApertureCamera.measure` and the steps that it takes."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

import numpy as np

from chromaperture.camera.alignment import ChannelAlignment
from chromaperture.camera.memory import check_camera_memory
from chromaperture.camera.method import default_config, photograph_quality, repaired, scaled_method
from chromaperture.capture.checks import check_capture, check_form
from chromaperture.capture.dual_pixel import refuse_half
from chromaperture.capture.files import Photograph, read_light
from chromaperture.capture.picture_header import same_frame
from chromaperture.color.image import checked_image
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.depth.field import field_to_depth
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.matching.result import NO_EXTRAS, Conversion, Disparity, Extras, Measured, Pending
from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import SAME_SCALE, resized
from chromaperture.settings.methods import Config, ExecutionName, Quality
from chromaperture.system.errors import CaptureWarning, InputError

_WHOLE_PX = 4_000_000  # pictures up to this size keep the curves of every pixel, 100 bytes each, from frame to frame
StageTimer = Callable[[str], AbstractContextManager[None]]


class Checked(NamedTuple):
    """A photograph that can be measured."""

    # ``known``, ``image``: (H, W, 3) float32: the whole frame. Outside of what the photograph shows, ``known`` is NaN,
    # and ``image`` repeats its border.
    known: np.ndarray
    image: np.ndarray
    size_px: tuple[int, int]  # (int, int): width and height of the photograph


class PendingFrame(NamedTuple):
    """A photograph that is being measured: see `CodedApertureCamera.submit`."""

    camera: CodedApertureCamera  # that measures it
    checked: Checked
    pending: Pending[Measured]

    def result(self, *, on_device_free: Callable[[], None] = lambda: None) -> DepthFrame:
        """Return the measurement; raises as `CodedApertureCamera.measure`.

        Parameters
        ----------
        on_device_free : callable, optional
            Called once the device is free, before the CPU finishes the photograph: the time to submit another.
        """
        measured = self.camera._matched(self)
        on_device_free()
        return self.camera._completed(self.checked, measured, lambda name: nullcontext())


class CodedApertureCamera:
    """A camera with a colour-coded aperture, at the focus setting it was calibrated for.

    Parameters
    ----------
    calibration : Calibration
    config : Config, optional
        Searches the calibration's working range at real-time quality when absent.
    execution : {"numba", "numpy"}
        Of the matcher: compiled, or readable and slow.
    device : str
        ``cpu``; ``gpu`` or ``gpu:NAME``, see `chromaperture info --devices`; ``auto``: a GPU where there is one.
    """

    def __init__(
        self,
        calibration: Calibration,
        config: Config | None = None,
        *,
        execution: ExecutionName = "numba",
        device: str = "cpu",
    ) -> None:
        self.calibration = calibration
        self.config = config or default_config(calibration)
        self.execution: ExecutionName = execution
        self.device = device
        self.method = scaled_method(calibration, self.config, execution, device)
        self.alignment = ChannelAlignment(calibration, self.config)
        self._at_sizes: dict[tuple[int, int], CodedApertureCamera] = {}
        self._of_qualities: dict[Quality, CodedApertureCamera] = {}

    @property
    def depth_model(self) -> DepthModel | None:
        """The curve from disparity to depth over the frame; None for a camera that was never calibrated."""
        return self.alignment.depth_model

    def measure(
        self,
        image: np.ndarray | str | Path,
        *,
        quality: Quality | None = None,
        stage: StageTimer = lambda name: nullcontext(),
    ) -> DepthFrame:
        """Measure depth in millimetres for every pixel of one photograph.

        Parameters
        ----------
        image : (H, W, 3) float, linear RGB, 1.0 = white level; or str or Path
            From `chromaperture.read_image`; or a file, which is read with the levels of this camera, see `read`.
        quality : {"paper", "real-time", "accurate"}, optional
            In place of the camera's own, with its default settings.
        stage : callable, optional
            ``with stage(name):`` is entered around each stage, for timing and progress.

        Returns
        -------
        DepthFrame

        Raises
        ------
        InputError
            The image cannot be used, or is not of this camera's size or aspect.
        OutOfMemoryError
            It would need more memory than there is.

        Warns
        -----
        CaptureWarning
            The image is of another size than this camera's, see `at_size`.

        Notes
        -----
        With ``config.crop_origin_px`` the image is a part of the frame, of any size; so is the result.

        That the photograph was taken through this camera's film, unturned and with its channels in the order R, G, B,
        is not checked: of others every distance is wrong. ``chromaperture depth`` and ``check`` compare its colours
        with the film's.
        """
        if quality is not None and quality != self.config.quality:
            return self._of_quality(quality).measure(image, stage=stage)
        if isinstance(image, str | Path):
            with stage("read"):
                image = self.read(image)
        image = checked_image(image)
        if self._is_of_another_size(image):
            return self._resized_to(image).measure(image, stage=stage)
        with stage("check"):
            checked = self._checked(image)
        with stage("disparity"):  # Eq. (1) and section 3.1
            measured = self._matched(self._submitted(checked))
        return self._completed(checked, measured, stage)

    @property
    def can_pipeline(self) -> bool:
        """Whether a photograph can be computed while the one before is read back: see `submit`."""
        return self.method.can_pipeline

    def submit(self, image: np.ndarray) -> PendingFrame:
        """Send a photograph of a stream to the device, and return at once; as `measure` otherwise.

        At most two are under way; take their results in turn. On the CPU nothing happens before that.

        Parameters
        ----------
        image : (H, W, 3) float, linear RGB, 1.0 = white level
        """
        image = checked_image(image)
        if self._is_of_another_size(image):
            return self._resized_to(image).submit(image)
        return self._submitted(self._checked(image))

    def _of_quality(self, quality: Quality) -> CodedApertureCamera:
        """Return this camera at another quality; kept, because preparing one takes a second."""
        if quality not in self._of_qualities:
            config = replace(default_config(self.calibration, quality), crop_origin_px=self.config.crop_origin_px)
            self._of_qualities[quality] = CodedApertureCamera(
                self.calibration, config, execution=self.execution, device=self.device
            )
        return self._of_qualities[quality]

    def _is_of_another_size(self, image: np.ndarray) -> bool:
        """Return whether the image shows the whole frame in other pixels."""
        size_px = image.shape[1::-1]
        if size_px == self._frame_px or self.config.crop_origin_px is not None:
            return False
        return self.shows_frame_at(size_px)

    def _resized_to(self, image: np.ndarray) -> CodedApertureCamera:
        """Return the camera for the pixels of an image of the whole frame, with a warning that says so."""
        size_px = image.shape[1::-1]
        warnings.warn(self.scaled_note(size_px), CaptureWarning, stacklevel=3)
        return self.at_size(*size_px)

    def _checked(self, image: np.ndarray) -> Checked:
        frame_px, size_px, origin_px = self._frame_px, image.shape[1::-1], self.config.crop_origin_px
        image = check_capture(image, *(frame_px if origin_px is None else size_px))
        if self.config.quality == "accurate":  # the others' windows outweigh a pixel
            image = repaired(image, self.calibration)
        check_camera_memory("the photograph", self.calibration, self.config)
        known, whole = (image, image) if origin_px is None else in_whole_frame(image, origin_px, frame_px)
        return Checked(known, whole, (size_px[0], size_px[1]))

    def _completed(self, checked: Checked, measured: Measured, stage: StageTimer) -> DepthFrame:
        """Return the measurement of a photograph whose disparity is known; what the method left is made here."""
        image, origin_px, disparity = checked.image, self.config.crop_origin_px, measured.disparity
        with stage("depth"):  # Eq. (10)
            depth_mm, sigma_mm = measured.depth_mm, measured.sigma_mm
            if depth_mm is None or sigma_mm is None:
                depth_mm, sigma_mm = self.millimetres(disparity)
        with stage("color"):  # section 5.1
            color = measured.color
            maps = (depth_mm, sigma_mm, disparity.value_px, disparity.sigma_px, disparity.confidence)
            made_by = self.calibration, self.config
            if color is None and disparity.value_px.size > _WHOLE_PX:
                align = partial(self.alignment.align_bands, image, disparity.value_px)
                frame = DepthFrame.with_lazy_color(align, maps, image, made_by)
            else:
                color = self.alignment.align(image, disparity.value_px) if color is None else color
                frame = DepthFrame(*maps, color, image, *made_by)
        return frame if origin_px is None else cut_out(frame, origin_px, checked.size_px)

    @property
    def _frame_px(self) -> tuple[int, int]:
        return self.calibration.sensor.width_px, self.calibration.sensor.height_px

    def read(
        self,
        path: str | Path,
        *,
        black_level: float | None = None,
        white_level: float | None = None,
        right: str | Path | None = None,
    ) -> np.ndarray:
        """Read a photograph with the given levels, else this camera's where the file can hold its counts.

        Parameters
        ----------
        path : str or Path
        black_level, white_level : float, optional
            Counts of the file for no light, and for the most that it can tell.
        right : str or Path, optional
            Of a dual-pixel camera, where the files of the halves are not called NAME_left and NAME_right.

        Returns
        -------
        (H, W, 3) float32, linear RGB

        Raises
        ------
        InputError
            As `chromaperture.read_image`.
        """
        return self.photograph(path, right=right, black_level=black_level, white_level=white_level).image

    def photograph(self, path: str | Path, *, right: str | Path | None = None, **levels: float | None) -> Photograph:
        """Read a photograph as `read` does, and say what its file is."""
        check_camera_memory(Path(path).name, self.calibration, self.config)
        known = self.calibration if self.calibration.is_calibrated else None
        size_px = self._frame_px if self.config.crop_origin_px is None else None
        encoding, stated = self.calibration.sensor.encoding, self.calibration.sensor.encoding.stated
        if right is not None and stated.dual_pixel is None:
            raise InputError(
                "this camera has film: a left and a right picture are of a dual-pixel camera; give one picture"
            )
        found = read_light(
            path, size_px=size_px, any_scale=known is not None, camera_encoding=None if known is None else encoding,
            stated=stated, right=right, **levels,
        )  # fmt: skip
        if known is not None and stated.dual_pixel is None:
            refuse_half(
                Path(path), found.image, lambda other: read_light(other, camera_encoding=encoding, stated=stated).image
            )
        if known is not None and found.form is not None:
            check_form(found.form, Path(path).name, known.provenance, encoding, is_cropped=size_px is None)
        return found

    def shows_frame_at(self, size_px: tuple[int, int]) -> bool:
        """Whether photographs of a size, width and height in px, have the aspect of this calibrated camera's."""
        return self.calibration.is_calibrated and same_frame(self._frame_px, size_px)

    def at_size(self, width_px: int, height_px: int) -> CodedApertureCamera:
        """Return this camera for photographs of another size, which show the whole frame in other pixels.

        It matches at the same working scale where that is a whole fraction of the size. Elsewhere its settings are
        those of `default_config`: settings in px would not fit.

        Parameters
        ----------
        width_px, height_px : int
            Of the photographs.

        Raises
        ------
        InputError
            The size has another aspect.
        """
        size = (width_px, height_px)
        if size == self._frame_px:
            return self
        if size not in self._at_sizes:
            calibration = resized(self.calibration, width_px, height_px)
            scale = self.config.scale * width_px / self.calibration.sensor.width_px
            if abs(scale / max(1, round(scale)) - 1) < SAME_SCALE:
                config = replace(self.config, scale=max(1, round(scale)))
            else:
                config = default_config(calibration, self.config.quality)
            self._at_sizes = {
                size: CodedApertureCamera(calibration, config, execution=self.execution, device=self.device)
            }
        return self._at_sizes[size]

    def scaled_note(self, size_px: tuple[int, int]) -> str:
        """Return what to say of a photograph of another size."""
        sensor = self.calibration.sensor
        return (
            f"a photograph of {size_px[0]}x{size_px[1]} px by a camera calibrated at {sensor.width_px}x"
            f"{sensor.height_px}: taken for the whole frame in other pixels; of a part of it every distance is wrong "
            "without --crop-origin"
        )

    def millimetres(self, disparity: Disparity) -> tuple[np.ndarray, np.ndarray]:
        """Return depth and its standard deviation in mm, Eq. (10); NaN for a camera never calibrated.

        Parameters
        ----------
        disparity : Disparity
            Of the whole frame, px.

        Returns
        -------
        depth_mm, sigma_mm : (H, W) float32
            From the sensor plane.
        """
        pixels, most_mm = disparity.value_px, self.config.depth.max_depth_mm
        if not self.calibration.is_calibrated:
            unknown = np.full(pixels.shape, np.nan, np.float32)
            return unknown, unknown.copy()
        if pixels.size > _WHOLE_PX:
            field = self.calibration.depth[self.config.quality]
            return field_to_depth(pixels, disparity.sigma_px, field, max_depth_mm=most_mm)
        model = cast(DepthModel, self.depth_model)
        return disparity_to_depth(pixels, model, sigma_px=disparity.sigma_px, max_depth_mm=most_mm)

    def _submitted(self, checked: Checked) -> PendingFrame:
        return PendingFrame(self, checked, self.method.start(checked.known, self._extras))

    def _matched(self, frame: PendingFrame) -> Measured:
        return frame.pending.result()

    @property
    def _extras(self) -> Extras:
        """What is asked of the method besides the disparity."""
        if not self.method.makes_extras:
            return NO_EXTRAS
        is_whole = self.config.crop_origin_px is None  # of a part of the frame other pixels are matched than aligned
        return Extras(self.conversion, self.alignment.numbers if is_whole else None)

    @cached_property
    def conversion(self) -> Conversion | None:
        """The curves of all pixels, in numbers; None where there are none."""
        if not self.calibration.is_calibrated:
            return None
        width_px, height_px = self._frame_px
        field = self.calibration.depth.get(self.config.quality)
        if field is not None and width_px * height_px > _WHOLE_PX and len(field.scale_px_mm) > 1:
            return Conversion(*field.in_numbers(width_px, height_px), self.config.depth.max_depth_mm)
        fields, curve = cast(DepthModel, self.depth_model).tables
        parts = (fields.infinity_px, fields.scale_px_mm, fields.pupil_mm, *fields.covariance)
        return Conversion(parts, curve, self.config.depth.max_depth_mm)

    def __repr__(self) -> str:
        return f"CodedApertureCamera({self.calibration.title}, quality {self.config.quality})"

    def _repr_html_(self) -> str:
        from chromaperture.frame.notebook import camera_html

        return camera_html(self.calibration, self.config.quality)


def load_camera(
    path: str | Path,
    *,
    quality: Quality | None = None,
    scale: float | Literal["auto"] = "auto",
    execution: ExecutionName = "numba",
    device: str = "auto",
) -> CodedApertureCamera:
    """Open a camera file; raises InputError when it is missing, damaged or of a newer format.

    Parameters
    ----------
    path : str or Path
    quality : {"paper", "real-time", "accurate"}, optional
        For photographs ``accurate``, which is the default where the camera was calibrated for it: seconds a photograph.
        For streams ``real-time``.
    scale : float or "auto"
        Match pictures reduced to 1 / scale; ``auto`` takes what the blur allows, see `camera_scale.working_scale`.
    execution : {"numba", "numpy"}
    device : str
        ``auto``: a GPU where there is one, never software, and the CPU from where it fails on; ``cpu``; ``gpu`` or
        ``gpu:NAME``, whose failures are errors.

    Raises
    ------
    MissingDependencyError
        A GPU was asked for and the extra ``gpu`` is not installed.
    """
    calibration = Calibration.load(path)
    config = default_config(calibration, quality or photograph_quality(calibration), scale=scale)
    return CodedApertureCamera(calibration, config, execution=execution, device=device)


_MAPS = ("depth_mm", "sigma_mm", "disparity_px", "disparity_sigma_px", "confidence", "color", "image")


def in_whole_frame(
    image: np.ndarray, origin_px: tuple[int, int], size_px: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Put a part (h, w, 3) into the frame: NaN outside of it, and with its border going on outside."""
    (height, width), (left, top) = image.shape[:2], origin_px
    right, below = size_px[0] - left - width, size_px[1] - top - height
    if min(right, below) < 0:
        raise InputError(
            f"a part of {width}x{height} px from {left},{top} does not lie in the camera's {size_px[0]}x{size_px[1]} "
            "px; --crop-origin is the column and row of its first pixel"
        )
    continued = np.pad(image, ((top, below), (left, right), (0, 0)), mode="edge")
    known = np.full_like(continued, np.nan)
    known[top : top + height, left : left + width] = image
    return known, continued


def cut_out(frame: DepthFrame, origin_px: tuple[int, int], size_px: tuple[int, int]) -> DepthFrame:
    """Return a part of a frame, of width and height ``size_px``; its camera has the pinhole of that part."""
    (left, top), (width, height) = origin_px, size_px
    part = np.s_[top : top + height, left : left + width]
    maps: dict[str, Any] = {name: values[part].copy() for name in _MAPS if (values := getattr(frame, name)) is not None}
    camera = None if frame.calibration is None else _part_of(frame.calibration, origin_px, size_px)
    return replace(frame, **maps, calibration=camera)


def _part_of(calibration: Calibration, origin_px: tuple[int, int], size_px: tuple[int, int]) -> Calibration:
    """Return a camera of a part of the sensor, for its size and its rays; its other properties are the frame's."""
    matrix = np.array(calibration.lens.camera_matrix, float)
    matrix[:2, 2] -= origin_px
    sensor = replace(calibration.sensor, width_px=size_px[0], height_px=size_px[1])
    return replace(calibration, sensor=sensor, lens=replace(calibration.lens, camera_matrix=matrix))
