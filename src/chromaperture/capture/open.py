"""Making a source from a short text, and listing the connected cameras."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from chromaperture.capture.aravis import AravisCamera, aravis_cameras
from chromaperture.capture.folder import FolderSource
from chromaperture.capture.gphoto import TetheredCamera, tethered_cameras
from chromaperture.capture.playback import played
from chromaperture.capture.recording import ReplaySource
from chromaperture.capture.simulated import SimulatedSource
from chromaperture.capture.source import FileSource, Listener, Source
from chromaperture.capture.threaded_source import LiveSource
from chromaperture.capture.video import VIDEOS, VideoSource
from chromaperture.capture.webcam import Webcam, webcams
from chromaperture.errors import InputError, MissingDependencyError

_DEVICES: dict[str, Callable[..., Any]] = {"webcam": Webcam, "aravis": AravisCamera}
_FILES: dict[str, Callable[..., FileSource]] = {
    "gphoto2": TetheredCamera,
    "replay": ReplaySource,
    "simulate": SimulatedSource,
}
_PLAYED = {"replay", "simulate"}


def open_source(
    spec: str, *, listener: Listener | None = None, camera_levels: tuple[float, float] | None = None, **settings: Any
) -> Source:
    """Make a source from a text; entering it opens it.

    Parameters
    ----------
    spec : str
        ``webcam:0``, ``aravis:SERIAL``, ``gphoto2``, ``simulate:FOLDER``, ``replay:FOLDER``, or the path of a folder,
        a glob, a picture or a video. Settings may follow: ``webcam:0?exposure_us=5000&gain=2``. ``simulate`` and
        ``replay`` deliver frame by frame, or like a live camera with ``speed=1`` (and ``loop=1``).
    listener : callable, optional
        Called with every `Event`, possibly from another thread; default: Python's logging.
    camera_levels : (float, float), optional
        Black and white level of the camera file, for pictures without levels of their own.
    **settings
        The same settings as arguments.

    Returns
    -------
    Source

    Raises
    ------
    InputError
        Unknown kind or setting, or a value that is not a number.
    """
    kind, found, rest = spec.partition(":")
    if kind == "gphoto2" or (found and kind in _DEVICES | _FILES) or kind in _DEVICES:
        where, _, query = rest.partition("?")
        if not found:
            kind, _, query = spec.partition("?")
        settings = dict(parse_qsl(query, keep_blank_values=True)) | settings
        return _opened(kind, where, settings, listener)
    if found and "/" not in kind and not Path(spec).exists() and kind.isidentifier() and "*" not in kind:
        known = ", ".join(sorted(_DEVICES | _FILES))
        raise InputError(f"unknown kind of source {kind!r}: choose {known}, or give a path")
    if Path(spec).suffix.lower() in VIDEOS:
        settings = {name: value for name, value in settings.items() if value is not None}
        return VideoSource(spec, listener=listener, **_checked("video", VideoSource, settings))
    chosen = _checked("folder", FolderSource, settings)
    return FolderSource(spec, listener=listener, camera_levels=camera_levels, **chosen)


def _opened(kind: str, where: str, settings: dict[str, Any], listener: Listener | None) -> Source:
    if kind in _DEVICES:
        device = _DEVICES[kind]
        chosen = _checked(kind, device, settings)
        place = where or ("0" if kind == "webcam" else "")
        name = f"{kind}:{place}" if place else kind
        return LiveSource(name, lambda: device(place, **chosen), listener=listener)
    if kind != "gphoto2" and not where:
        raise InputError(f"{kind} needs a folder: {kind}:FOLDER")
    speed = settings.pop("speed", None) if kind in _PLAYED else None
    loop = settings.pop("loop", None) if kind in _PLAYED else None
    source = _FILES[kind](where, listener=listener, **_checked(kind, _FILES[kind], settings))
    if speed is None and loop is None:
        return source
    return played(
        source,
        speed=_number("speed", 1.0 if speed is None else speed),
        loop=str(loop).lower() in ("1", "true", "yes"),
        listener=listener,
    )


def _checked(kind: str, maker: Callable[..., Any], settings: dict[str, Any]) -> dict[str, Any]:
    """Check the names of settings and convert texts to the types of the source's parameters."""
    known = {n: p for n, p in inspect.signature(maker).parameters.items() if p.kind is p.KEYWORD_ONLY}
    known.pop("listener", None)
    known.pop("retry_s", None)
    chosen = {}
    for name, value in settings.items():
        if name not in known:
            raise InputError(f"{kind} has no setting {name!r}: choose {', '.join(known) or 'none'}")
        if isinstance(value, str) and "str" not in str(known[name].annotation):
            number = _number(name, value)
            value = int(number) if str(known[name].annotation).startswith("int") else number
        chosen[name] = value
    return chosen


def _number(name: str, value: Any) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"{name} must be a number, got {value!r}") from None


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
    }
    kinds = []
    for kind, cameras in ways.items():
        try:
            specs = [f"{kind}:{place}" for place in cameras()]
        except MissingDependencyError as missing:
            kinds.append(Connected(kind, [], str(missing)))
        else:
            kinds.append(Connected(kind, specs, "" if specs else "none connected"))
    return kinds
