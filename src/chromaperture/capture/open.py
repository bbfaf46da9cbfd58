"""Making a source from a short text, and listing the connected cameras."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from chromaperture.capture.aravis import AravisCamera, aravis_cameras
from chromaperture.capture.folder import FolderSource
from chromaperture.capture.gentl import GenTLCamera, gentl_cameras
from chromaperture.capture.gphoto import TetheredCamera, tethered_cameras
from chromaperture.capture.picamera import PiCamera, pi_cameras
from chromaperture.capture.pylon import PylonCamera, pylon_cameras
from chromaperture.capture.recording import ReplaySource
from chromaperture.capture.shots import VIDEOS
from chromaperture.capture.simulated import SimulatedSource
from chromaperture.capture.source import FileSource, Listener, Source
from chromaperture.capture.threaded_source import LiveSource, played
from chromaperture.capture.video import VideoSource
from chromaperture.capture.webcam import Webcam, webcams
from chromaperture.color.encoding import Encoding
from chromaperture.system.errors import InputError, MissingDependencyError

_DEVICES: dict[str, Callable[..., Any]] = {
    "webcam": Webcam,
    "aravis": AravisCamera,
    "pylon": PylonCamera,
    "gentl": GenTLCamera,
    "picamera2": PiCamera,
}
_FILES: dict[str, Callable[..., FileSource]] = {
    "gphoto2": TetheredCamera,
    "replay": ReplaySource,
    "simulate": SimulatedSource,
}
_PLAYABLE, _PLAYING = {"replay", "simulate", "folder", "video"}, {"speed": None, "loop": False}
_QUERY = re.compile(r"\w+=[^&]*(&\w+=[^&]*)*")  # a lone ? may be the wildcard of a glob
_SWITCH = {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}


def open_source(
    spec: str,
    *,
    listener: Listener | None = None,
    camera_encoding: Encoding | None = None,
    camera_size_px: tuple[int, int] | None = None,
    **settings: Any,
) -> Source:
    """Make a source from a text; entering it opens it.

    Parameters
    ----------
    spec : str
        ``webcam:0``, ``aravis:SERIAL``, ``pylon:SERIAL``, ``gentl:SERIAL``, ``picamera2:0``, ``gphoto2``,
        ``simulate:FOLDER``, ``replay:FOLDER``, or the path of a folder, a glob, a picture or a video. Settings may
        follow: ``webcam:0?exposure_us=5000&gain=2``, ``folder?fps=5``. All but cameras deliver frame by frame, or like
        a live camera with ``speed=1`` or ``loop=1``.
    listener : callable, optional
        Called with every `Event`, possibly from another thread; default: Python's logging.
    camera_encoding : Encoding, optional
        `CameraSensor.encoding` of the camera file, for pictures whose levels nobody gave.
    camera_size_px : (int, int), optional
        Width and height of the camera file's frame: reading another part of the sensor raises InputError.
    **settings
        The same settings as arguments; None is not given.

    Returns
    -------
    Source

    Raises
    ------
    InputError
        Unknown kind or setting, or a value that is not a number.
    """
    if camera_encoding is not None and camera_encoding.stated.dual_pixel is not None:
        raise InputError(
            "a stream has one picture a frame, and this is a dual-pixel camera, which takes two: measure its files "
            "with chromaperture depth"
        )
    source = _made(spec, listener, camera_encoding, {n: value for n, value in settings.items() if value is not None})
    source.camera_size_px = camera_size_px
    return source


def _made(
    spec: str, listener: Listener | None, camera_encoding: Encoding | None, settings: dict[str, Any]
) -> LiveSource | FileSource:
    """Make the source; settings replace those of the text."""
    kind, place, given = _parsed(spec)
    settings = given | settings
    if kind in _DEVICES:
        device, chosen = _DEVICES[kind], _checked(kind, _DEVICES[kind], settings, camera_encoding)
        name = f"{kind}:{place}" if place else kind
        return LiveSource(name, lambda: device(place, **chosen), listener=listener)
    playing = {n: settings.pop(n, default) for n, default in _PLAYING.items()} if kind in _PLAYABLE else {}
    speed, loop = playing.get("speed"), _switch("loop", playing.get("loop", False))
    maker = {"folder": FolderSource, "video": VideoSource}.get(kind) or _FILES[kind]
    source = maker(place, listener=listener, **_checked(kind, maker, settings, camera_encoding, others=playing))
    if speed is None and not loop:
        return source
    return played(source, speed=1.0 if speed is None else _number("speed", speed), loop=loop, listener=listener)


def _parsed(spec: str) -> tuple[str, str, dict[str, Any]]:
    """Return the kind of a source, the place of its files or device, and the settings that follow."""
    text, _, query = spec.partition("?")
    kind, found, place = text.partition(":")
    if kind in _DEVICES or kind == "gphoto2" or (found and kind in _FILES):
        if not place and kind in ("replay", "simulate"):
            raise InputError(f"{kind} needs a folder: {kind}:FOLDER")
        place = "0" if not place and kind in ("webcam", "picamera2") else place
        return kind, place, dict(parse_qsl(query, keep_blank_values=True))
    if found and "/" not in kind and not os.path.exists(spec) and kind.isidentifier() and "*" not in kind:
        known = ", ".join(sorted(_DEVICES | _FILES))
        raise InputError(f"unknown kind of source {kind!r}: choose {known}, or give a path")
    path, mark, query = spec.rpartition("?")
    if not mark or not _QUERY.fullmatch(query) or os.path.exists(spec):
        path, query = spec, ""
    kind = "video" if Path(path).suffix.lower() in VIDEOS and not os.path.isdir(path) else "folder"
    return kind, path, dict(parse_qsl(query, keep_blank_values=True))


def _checked(
    kind: str,
    maker: Callable[..., Any],
    settings: dict[str, Any],
    camera_encoding: Encoding | None,
    *,
    others: Iterable[str] = (),
) -> dict[str, Any]:
    """Check the names of settings and convert texts to the types of the source's parameters."""
    known = {n: p for n, p in inspect.signature(maker).parameters.items() if p.kind is p.KEYWORD_ONLY}
    chosen: dict[str, Any] = {"camera_encoding": camera_encoding} if "camera_encoding" in known else {}
    for own in ("listener", "retry_s", "camera_encoding"):
        known.pop(own, None)
    for name, value in settings.items():
        if name not in known:
            raise InputError(f"{kind} has no setting {name!r}: choose {', '.join([*known, *others])}")
        if isinstance(value, str) and str(known[name].annotation).startswith(("int", "float")):
            value = _number(name, value)
            if str(known[name].annotation).startswith("int"):
                if not value.is_integer():
                    raise InputError(f"{name} must be a whole number, got {value:g}")
                value = int(value)
        chosen[name] = value
    return chosen


def _number(name: str, value: Any) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"{name} must be a number, got {value!r}") from None


def _switch(name: str, value: Any) -> bool:
    on = _SWITCH.get(str(value).lower())
    if on is None:
        raise InputError(f"{name} must be 1 or 0, got {value!r}")
    return on


@dataclass(frozen=True)
class Connected:
    """Cameras of one kind on this machine: specs for `open_source`, or the reason why there are none."""

    kind: str
    specs: list[str]
    note: str = ""


def connected_sources() -> list[Connected]:
    """List the cameras of each kind, with missing extras."""
    ways: dict[str, Callable[[], list[str]]] = {
        "webcam": webcams,
        "aravis": aravis_cameras,
        "gphoto2": tethered_cameras,
        "picamera2": pi_cameras,
        "pylon": pylon_cameras,
        "gentl": gentl_cameras,
    }
    kinds = []
    for kind, cameras in ways.items():
        try:
            specs, note = [f"{kind}:{place}" for place in cameras()], "none connected"
        except MissingDependencyError as missing:
            specs, note = [], str(missing)
        kinds.append(Connected(kind, specs, "" if specs else note))
    return kinds
