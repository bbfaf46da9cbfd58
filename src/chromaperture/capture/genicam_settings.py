"""Settings of machine-vision cameras by the names of GenICam's standard (SFNC), whichever driver they come through."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any, Protocol

from chromaperture.capture.pixel_formats import bits_of, chosen_format
from chromaperture.system.errors import InputError

_SLOW_S = 2.0  # frames further apart are awaited for as long as the camera is there; chosen by hand, not tuned
_NS_PER_S = 1e9
_ROUNDING = 0.01  # of a number: cameras count exposures in rows, gains in steps

# Counts proportional to light, all colours by one factor, and the picture as the lens casts it: mirrored, near is far.
# What is automatic comes first, because it locks the values. "Bsl" are Basler's own.
_NEUTRAL: dict[str, str | bool | float] = {
    "ExposureAuto": "Off",
    "GainAuto": "Off",
    "AcquisitionFrameRateAuto": "Off",
    "BalanceWhiteAuto": "Off",
    "LightSourceSelector": "Off",
    "LightSourcePreset": "Off",
    "BslLightSourcePreset": "Off",
    "BslColorSpace": "Off",
    "ColorTransformationEnable": False,
    "ColorAdjustmentEnable": False,
    "BslColorAdjustmentEnable": False,
    "LUTEnable": False,
    "GammaEnable": False,
    "Gamma": 1.0,
    "BslContrast": 0.0,
    "BslBrightness": 0.0,
    "DigitalShift": 0,
    "ReverseX": False,
    "ReverseY": False,
}
_NEUTRAL_OF_EACH: dict[str, dict[str, str | float]] = {
    "TriggerSelector": {"TriggerMode": "Off"},
    "BalanceRatioSelector": {"BalanceRatio": 1.0, "BalanceRatioAbs": 1.0},
}


class Node(Protocol):
    """One setting of a camera."""

    value: Any  # raises the driver's error where it cannot be read or set
    is_readable: bool
    is_writable: bool

    def limits(self) -> tuple[float, float, float]:
        """Return the least and the largest number, and the step, 0 for any."""

    def choices(self) -> list[str]:
        """Return the names that can be chosen now."""


class Nodes(Protocol):
    """The settings of an opened camera."""

    camera: str  # for messages
    error: type[Exception]  # of the driver

    def find(self, name: str) -> Node | None:
        """Return a setting that the camera has now."""


@dataclass(frozen=True)
class Settings:
    """What a camera was set to."""

    pixel_format: str
    levels: tuple[float, float]  # black and white
    facts: dict[str, Any]  # for the metadata of frames: values in force
    is_slow: bool  # or waits for a trigger: no frame for a while does not mean that the camera is gone
    ticks_per_s: float  # of its clock


def apply_settings(
    nodes: Nodes,
    *,
    exposure_us: float | None,
    gain: float | None,
    fps: float | None,
    width: int | None,
    height: int | None,
    pixel_format: str | None,
    trigger: str | None,
    black_level: float | None,
    white_level: float | None,
    states_white_level: bool = True,
) -> Settings:
    """Make a camera deliver light in proportion; raises InputError with the limits of what it cannot do.

    A part of the sensor lies about its centre, so that the same size is the same part. ``states_white_level``: the
    camera says how many of a format's 16 bits it uses.
    """
    kept = _make_neutral(nodes)
    form = _find(nodes, "PixelFormat")
    form.value = chosen = chosen_format(pixel_format, form.choices())
    if form.value != chosen:
        raise InputError(f"{nodes.camera} did not take pixel_format {chosen} but {form.value}")
    for size, offset, pixels in (("Width", "OffsetX", width), ("Height", "OffsetY", height)):
        _centre(nodes, size, offset, pixels)
    for name in ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled") if fps is not None else ():
        _set(nodes, name, True)
    _set_number(nodes, "exposure_us", exposure_us, "ExposureTime", "ExposureTimeAbs")
    _set_number(nodes, "gain", gain, "Gain", "GainRaw")
    _set_number(nodes, "fps", fps, "AcquisitionFrameRate", "AcquisitionFrameRateAbs")
    if trigger is not None:
        _trigger_by(nodes, trigger)
    if black_level is None:
        black_level = float(_value(nodes, "BlackLevel") or 0.0)
    if white_level is None:
        white_level = 2 ** bits_of(chosen) - 1
        if white_level == 65535 and states_white_level:  # 16 bits may hold fewer
            white_level = _value(nodes, "PixelDynamicRangeMax") or white_level
    facts = {
        "camera": nodes.camera,
        "pixel_format": chosen,
        "exposure_us": _value(nodes, "ExposureTime", "ExposureTimeAbs"),
        "gain": _value(nodes, "Gain", "GainRaw"),
        "fps": _value(nodes, "ResultingFrameRate", "ResultingFrameRateAbs", "AcquisitionFrameRate"),
    } | ({"not_neutral": kept} if kept else {})
    interval_s = max((facts["exposure_us"] or 0.0) / 1e6, 1 / facts["fps"] if facts["fps"] else 0.0)
    is_slow = trigger is not None or interval_s > _SLOW_S
    ticks_per_s = _value(nodes, "GevTimestampTickFrequency") or _NS_PER_S
    return Settings(chosen, (black_level, white_level), facts, is_slow, ticks_per_s)


def _find(nodes: Nodes, *names: str) -> Node:
    """Return the first of the settings that the camera has; raises InputError."""
    for name in names:
        if (node := nodes.find(name)) is not None:
            return node
    raise InputError(f"{nodes.camera} has no setting {names[0]}: it is no GenICam camera, or of another kind")


def _value(nodes: Nodes, *names: str) -> Any:
    """Return the value of the first of the settings that can be read, else None."""
    for name in names:
        if (node := nodes.find(name)) is not None and node.is_readable:
            return node.value
    return None


def _set(nodes: Nodes, name: str, value: Any) -> bool:
    """Set what the camera has and lets be set; returns whether it has no other value now."""
    node = nodes.find(name)
    if node is None or not node.is_readable or node.value == value:
        return True
    if node.is_writable:
        with contextlib.suppress(nodes.error, TypeError):  # or it is of another type
            node.value = value
    taken = node.value
    return bool(abs(taken - value) <= 1e-3 if isinstance(taken, float) else taken == value)


def _set_number(nodes: Nodes, setting: str, value: float | None, *names: str) -> None:
    """Set the first of the settings that the camera has; raises InputError with the limits or the rounding."""
    if value is None:
        return
    node = next((found for name in names if (found := nodes.find(name)) is not None), None)
    if node is None or not node.is_writable:
        raise InputError(f"{nodes.camera} does not let {setting} be set")
    least, most, step = node.limits()
    is_between = bool(step) and (value - least) % step > 0
    if not least <= value <= most or is_between:
        steps = f" in steps of {step:g}" if step > 1 or is_between else ""
        raise InputError(f"{setting} of {nodes.camera} must be {least:g} to {most:g}{steps}, got {value:g}")
    node.value = int(value) if step else float(value)
    if abs((taken := node.value) - value) > _ROUNDING * abs(value):
        raise InputError(f"{setting}={value:g} is not possible: {nodes.camera} makes it {taken:g}")


def _make_neutral(nodes: Nodes) -> list[str]:
    """Switch off what the camera does to pictures; returns the names of what it did not let go."""
    kept = [name for name, value in _NEUTRAL.items() if not _set(nodes, name, value)]
    if mirrored := [name for name in kept if name.startswith("Reverse")]:
        raise InputError(f"{nodes.camera} keeps {mirrored[0]} on: it mirrors the picture, and nearer becomes farther")
    for name, wanted in _NEUTRAL_OF_EACH.items():
        selector = nodes.find(name)
        for choice in selector.choices() if selector is not None else ():
            _set(nodes, name, choice)
            kept += [f"{each} {choice}" for each, value in wanted.items() if not _set(nodes, each, value)]
    return kept


def _centre(nodes: Nodes, size: str, offset: str, pixels: int | None) -> None:
    """Set one side of the part of the sensor; an odd offset would exchange the colours of the mosaic."""
    _set(nodes, offset, 0)
    most = _find(nodes, size).limits()[1]
    _set_number(nodes, size.lower(), pixels, size) if pixels is not None else _set(nodes, size, int(most))
    start = nodes.find(offset)
    if start is not None and start.is_writable:
        step = 2 * max(int(start.limits()[2]), 1)
        start.value = int(most - _value(nodes, size)) // 2 // step * step


def _trigger_by(nodes: Nodes, line: str) -> None:
    """Let a line start each frame; raises InputError."""
    source = nodes.find("TriggerSource")
    lines = source.choices() if source is not None else []
    if source is None or line not in lines:
        raise InputError(f"{nodes.camera} has no trigger {line!r}: choose {', '.join(lines) or 'none'}")
    _set(nodes, "TriggerSelector", "FrameStart")
    if not _set(nodes, "TriggerMode", "On"):
        raise InputError(f"{nodes.camera} does not let a trigger start its frames")
    source.value = line
