"""What the app's server does with pictures: cameras by name, measuring, refocusing, files to save.

Everything here is called by one thread at a time: the matcher uses all cores already.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import math
import re
import secrets
import tempfile
import zipfile
from collections import OrderedDict
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import numpy as np

from chromaperture.app.device_plan import MOST_PX, make_plan, make_points
from chromaperture.app.free_space import RESERVE_BYTES, require_space
from chromaperture.app.gate import save_body
from chromaperture.app.messages import collect_warnings
from chromaperture.app.session_folder import Holding
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import default_config
from chromaperture.capture.dual_pixel import half_of
from chromaperture.capture.files import Decoded, linearise
from chromaperture.color.srgb import linear_to_srgb_bytes
from chromaperture.effects.edge_aware import filter_disparity
from chromaperture.effects.layered_model import radius_per_disparity
from chromaperture.effects.refocusing import BACKGROUND_EFFECTS, Focus, apply_background
from chromaperture.effects.restore import SharpPicture, brightened, radius_at, restore
from chromaperture.frame.depth_frame import DepthFrame
from chromaperture.frame.frame_files import OUTPUTS, write_format
from chromaperture.model.camera_file import Calibration
from chromaperture.model.scale import reduced_size, resized
from chromaperture.products.measure_file import MeasuredFile, measure_only
from chromaperture.settings.methods import QUALITIES, Quality
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged
from chromaperture.system.validation import checked

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")  # of cameras and sessions: nothing that a path could be made of
_MOST_CAMERAS = 200  # files that the page may add; chosen by hand
_MOST_CAMERA_BYTES = 64 * 2**20  # of a camera file; that of 24 megapixels has 0.1 MB
DEPTH_INSIDE = ("gdepth", "dynamic-depth")  # outputs that are photographs with depth inside
_KEPT_PHOTOS = 3  # measured photographs for tap-to-focus; 24 megapixels take 1 GB each
_KEPT_EYES = 4  # cameras at a quality and a size, with their curves
_KEPT_PLANS = 4  # of 2.4 MB for 720x480


@dataclass
class Photo:
    """A measured photograph, for its files and for other focuses."""

    measured: MeasuredFile
    camera: CodedApertureCamera
    notes: list[str]
    originals: dict[str, bytes]  # the files as they were sent, by name
    sharp: dict[str, SharpPicture] = field(default_factory=dict)


class AppState:
    """Cameras and photographs of one app.

    The folder keeps ``cameras/``, ``sessions/`` and ``photos/``; the page begins with ``camera``, a file; so many bytes
    of the disk stay free. Raises InputError where the folder cannot be written, or the camera file cannot be read.
    """

    def __init__(self, folder: Path, camera: Path | None = None, *, reserve_bytes: int = RESERVE_BYTES) -> None:
        self.folder, self.reserve_bytes = folder, reserve_bytes
        self.given = camera
        if camera is not None:
            Calibration.load(camera)  # fails before folders are made
        for name in ("cameras", "sessions", "photos"):
            with staged(folder / name):
                pass
        self._photos: OrderedDict[str, Photo] = OrderedDict()
        self._about: dict[tuple[Path, int], dict[str, Any]] = {}
        self._open = lru_cache(_KEPT_EYES)(_open)
        self._made_plan = lru_cache(_KEPT_PLANS)(self._make_plan)

    @contextlib.asynccontextmanager
    async def upload(self, request: Any, name: str, *, is_sent: bool = True) -> AsyncIterator[Path]:
        """Keep the body of a request in a private file, which goes afterwards; only its place, where none is sent."""
        require_space(self.folder, int(request.headers.get("content-length", "0")), self.reserve_bytes)
        with tempfile.TemporaryDirectory(dir=self.folder, prefix=".upload-") as private:
            path = Path(private) / safe_name(name)
            if is_sent:
                await save_body(request, path)
            yield path

    # ---- cameras

    def camera_paths(self) -> dict[str, Path]:
        """Return the camera files by the names that the page shows; the one given at the start first."""
        given = {} if self.given is None else {self.given.stem: self.given}
        kept = sorted((self.folder / "cameras").glob("*.asdf"))
        return given | {path.stem: path for path in kept if NAME.fullmatch(path.stem) and path.stem not in given}

    def camera_path(self, name: str) -> Path:
        """Return a camera file; raises InputError for an unknown name."""
        try:
            return self.camera_paths()[name]
        except KeyError:
            raise InputError("there is no camera of that name; choose one of the list") from None

    def add_camera(self, name: str, source: Path) -> str:
        """Keep a camera file of the page; returns its name, which no other camera may have."""
        stem = re.sub(r"[^A-Za-z0-9_-]+", "-", Path(name).stem).strip("-_")[:60] or "camera"
        data = source.read_bytes()
        if len(data) > _MOST_CAMERA_BYTES:
            raise InputError("this is too large for a camera file; choose the .asdf of 'chromaperture calibrate'")
        Calibration.load(source)
        paths = self.camera_paths()
        for number in itertools.count(1):
            unused = stem if number == 1 else f"{stem[:56]}-{number}"
            if unused in paths and paths[unused].read_bytes() == data:
                return unused
            if unused not in paths:
                break
        if len(paths) >= _MOST_CAMERAS:
            raise InputError(f"there are {_MOST_CAMERAS} cameras already; remove some from {self.folder / 'cameras'}")
        require_space(self.folder, len(data), self.reserve_bytes)
        with staged(self.folder / "cameras") as stage:
            stage.path(f"{unused}.asdf").write_bytes(data)
        return unused

    def describe_cameras(self) -> list[dict[str, Any]]:
        """Return for each camera what the page shows; a damaged file has ``error`` instead."""
        paths = self.camera_paths()
        keys = {name: (path, path.stat().st_mtime_ns) for name, path in paths.items()}
        self._about = {key: self._about.get(key) or _described(key[0]) for key in keys.values()}
        return [{"name": name, **self._about[key]} for name, key in keys.items()]

    def eye(self, name: str, quality: str) -> CodedApertureCamera:
        """Return a camera at a quality, opened once for all frames; raises InputError."""
        if quality not in QUALITIES:
            raise InputError(f"unknown quality {quality!r}: choose {', '.join(QUALITIES)}")
        path = self.camera_path(name)
        return self._open(path, path.stat().st_mtime_ns, quality)

    def video_eye(self, name: str, quality: str) -> CodedApertureCamera:
        """Return `eye` for pictures of a browser; raises InputError for a dual-pixel camera, which takes two."""
        eye = self.eye(name, quality)
        if eye.calibration.sensor.dual_pixel is not None:
            raise InputError("this is a dual-pixel camera, which video does not show: open its left and right picture")
        return eye

    def plan(self, name: str, size_px: tuple[int, int], exchange: str) -> bytes:
        """Return the plan by which a browser measures frames of a size, see `make_plan`; raises InputError."""
        path = self.camera_path(name)
        return self._made_plan(name, path, path.stat().st_mtime_ns, size_px, exchange)

    def _make_plan(self, name: str, path: Path, changed_ns: int, size_px: tuple[int, int], exchange: str) -> bytes:
        if min(size_px) < 1 or math.prod(size_px) > MOST_PX:
            raise InputError("a browser measures frames of up to 4 megapixels; the computer measures this one")
        eye = self.video_eye(name, "real-time")
        sensor = eye.calibration.sensor
        frame_px = sensor.width_px, sensor.height_px
        if size_px != frame_px and not eye.calibration.is_calibrated:
            raise InputError("a camera that was never calibrated measures frames of its own size only")
        is_other = size_px != reduced_size(frame_px, round(frame_px[0] / size_px[0]) or 1)
        said = [eye.scaled_note(size_px)] if is_other else []
        about = {"name": name, **_described(path)}
        facts = {"camera": about, "version": version("chromaperture"), "notes": said}
        return make_plan(eye.at_size(*size_px), exchange, facts)

    def points(self, name: str, size_px: tuple[int, int], quality: str) -> bytes:
        """Return what makes points of maps of a size, see `make_points`; raises InputError."""
        eye = self.eye(name, quality)
        if min(size_px) < 1 or math.prod(size_px) > MOST_PX or not eye.calibration.is_calibrated:
            raise InputError("points are made of the maps of a calibrated camera, of up to 4 megapixels")
        return make_points(resized(eye.calibration, *size_px), eye.config.quality)

    # ---- measuring

    def measure_pixels(
        self, data: bytes, size_px: tuple[int, int], *, camera: str, quality: str
    ) -> tuple[DepthFrame, list[str]]:
        """Measure R, G, B bytes of a browser's video, taken for sRGB; returns the frame and sentences about it."""
        width, height = size_px
        if min(size_px) < 1 or len(data) != 3 * width * height:
            raise InputError("a frame is not as large as it says; reload the page")
        eye = self.video_eye(camera, quality)
        counts = np.frombuffer(data, np.uint8).reshape(height, width, 3)
        encoding = eye.calibration.sensor.encoding if eye.calibration.is_calibrated else None
        with collect_warnings() as notes:
            frame = eye.measure(linearise(Decoded(counts), camera_encoding=encoding))
        return frame, notes()

    def measure_photo(self, path: Path, *, camera: str, quality: str, right: Path | None = None) -> tuple[str, Photo]:
        """Measure a photograph's file, of a dual-pixel camera perhaps two, and keep the result for a while.

        Returns its key; raises InputError.
        """
        eye = self.eye(camera, quality)
        if right is not None and (half := half_of(path)) is not None and half[1]:
            path, right = right, path  # two files come in any order
        with collect_warnings() as notes:
            measured = measure_only(path, eye, out=self.folder / "photos", right=right)
        files = {file.name: file.read_bytes() for file in (path, right) if file is not None}
        photo = Photo(measured, eye.at_size(*measured.frame.disparity_px.shape[::-1]), notes(), files)
        key = secrets.token_urlsafe(9)
        self._photos[key] = photo
        while len(self._photos) > _KEPT_PHOTOS:
            self._photos.popitem(last=False)
        return key, photo

    def photo(self, key: str) -> Photo:
        """Return a measured photograph; raises InputError for one that is no longer kept."""
        if key not in self._photos:
            raise InputError("this photograph is no longer kept; open it again")
        self._photos.move_to_end(key)
        return self._photos[key]

    def refocused(
        self, key: str, *, at: tuple[float, float] | None, f_number: float | None, background: str, sharpness: str
    ) -> np.ndarray:
        """Return the photograph ``key``, of `measure_photo`, by another lens; (H, W, 3) uint8 sRGB; raises InputError.

        ``at`` is the place to focus on, fractions of width and height; focus and f-number are the camera's own by
        default. The background is kept, desaturated or blurred. ``sharpness`` is ``preview``, at once, with colours and
        blur of the measured frame; or aligned, fast or full, which are restored first, see `restore`.
        """
        if background not in BACKGROUND_EFFECTS:
            raise InputError(f"unknown background effect {background!r}: choose {', '.join(BACKGROUND_EFFECTS)}")
        photo = self.photo(key)
        frame, own = photo.measured.frame, photo.camera.calibration.lens.f_number
        if f_number is not None and not (own and math.isfinite(f_number) and f_number > 0):
            raise InputError("the f-number must be positive, and the camera file must state the lens's own")
        if frame.image is None:
            raise InputError("this photograph is no longer kept; open it again")
        if sharpness not in photo.sharp:
            sharp = _at_once(photo) if sharpness == "preview" else restore(
                frame.image, frame.disparity_px, photo.camera, sigma_px=frame.disparity_sigma_px,
                sharpness=cast(Any, sharpness),
            )  # fmt: skip
            photo.sharp = {sharpness: brightened(sharp)}
        picture = photo.sharp[sharpness]
        strength = 1.0 if f_number is None or not own else own / f_number
        focus = Focus(_radius_at(picture, at), strength)
        return linear_to_srgb_bytes(apply_background(picture.color, picture.radius_px, focus, background))

    def with_depth_inside(self, key: str, output: str = DEPTH_INSIDE[0]) -> bytes:
        """Return a photograph with its depth inside, as ``chromaperture depth --write gdepth`` writes it."""
        photo = self.photo(key)
        if output not in DEPTH_INSIDE:
            raise InputError(f"a photograph with depth inside is {' or '.join(DEPTH_INSIDE)}, not {output!r}")
        with tempfile.TemporaryDirectory(dir=self.folder) as private:
            path = Path(private) / "photo.jpg"
            write_format(output, path, photo.measured.frame, max_relative_sigma=photo.measured.max_relative_sigma)
            return path.read_bytes()

    def photo_files(self, key: str) -> bytes:
        """Return a photograph and its files, as ``chromaperture depth`` writes them, in one ZIP archive."""
        photo = self.photo(key)
        require_space(self.folder, 100 * photo.measured.frame.disparity_px.size, self.reserve_bytes)
        packed = io.BytesIO()
        with tempfile.TemporaryDirectory(dir=self.folder) as private:
            MeasuredFile(**{**vars(photo.measured), "folder": Path(private)}).write()
            names = sorted(Path(private).iterdir())
            with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
                for path in names:
                    if path.is_file():
                        archive.write(path, path.name)
                for output in DEPTH_INSIDE:
                    with contextlib.suppress(InputError):
                        content = self.with_depth_inside(key, output)
                        archive.writestr(photo.measured.stem + OUTPUTS[output].suffix, content)
                for name, original in photo.originals.items():
                    archive.writestr(name, original)
        return packed.getvalue()


def safe_name(name: str) -> str:
    """Return a file's name without anything that leads to another folder; at most 100 characters."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    plain = "".join(c if c.isalnum() or c in "._-" else "_" for c in last).lstrip(".")
    stem, dot, suffix = plain.rpartition(".")
    return f"{(stem if dot else plain)[:90] or 'photo'}{f'.{suffix[:8]}' if dot else ''}"


def split_file(path: Path, name: str, first_bytes: float) -> Path:
    """Cut a file in two; what follows so many bytes goes to a file beside it, whose path is returned."""
    content, second = path.read_bytes(), path.with_name(safe_name(name))
    if second == path or not 0 < first_bytes < len(content):
        raise InputError("two files of different names are needed, the left and the right picture of one exposure")
    path.write_bytes(content[: int(first_bytes)])
    second.write_bytes(content[int(first_bytes) :])
    return second


def _open(path: Path, changed_ns: int, quality: Quality) -> CodedApertureCamera:
    """Open a camera file as it is since a time, at a quality."""
    calibration = Calibration.load(path)
    return CodedApertureCamera(calibration, default_config(calibration, quality))


def _described(path: Path) -> dict[str, Any]:
    try:
        calibration = Calibration.load(path)
    except InputError as error:
        return {"error": str(error)}
    sensor = calibration.sensor
    return {
        "title": calibration.title,
        "width": sensor.width_px,
        "height": sensor.height_px,
        "working_px": reduced_size((sensor.width_px, sensor.height_px), default_config(calibration).scale),
        "near_mm": calibration.near_mm,
        "far_mm": calibration.far_mm,
        "f_number": calibration.lens.f_number,
        "in_focus": calibration.in_focus_text if calibration.is_calibrated else None,
        "calibrated": calibration.is_calibrated,
        "dual_pixel": sensor.dual_pixel is not None,
        "siting": calibration.sensor.siting or "left",
        "holding": _holding(calibration),
    }


def _holding(calibration: Calibration) -> dict[str, Any] | None:
    """Return how the device was held for a calibration, where its file tells."""
    try:
        return checked(Holding, dict(calibration.provenance["holding"]), where="holding").model_dump()
    except (InputError, KeyError, TypeError, ValueError):
        return None


def _at_once(photo: Photo) -> SharpPicture:
    """Return a frame's picture and its blur without restoration, as the live page has them; 0.1 s instead of 7."""
    frame, camera = photo.measured.frame, photo.camera
    disparity, _ = filter_disparity(frame.disparity_px, frame.disparity_sigma_px, frame.color)
    per_disparity = np.float32(radius_per_disparity(camera.calibration, camera.config.quality))
    return SharpPicture(frame.color, disparity * per_disparity)


def _radius_at(picture: SharpPicture, at: tuple[float, float] | None) -> float:
    """Return the capture's blur radius at a place of the picture: of the window that `refocus --point` takes."""
    if at is None:
        return 0.0
    if not all(math.isfinite(v) and 0 <= v <= 1 for v in at):
        raise InputError("the place to focus on lies outside the picture")
    x, y = (min(int(v * n), n - 1) for v, n in zip(at, picture.radius_px.shape[::-1], strict=True))
    return radius_at(picture, x, y)
