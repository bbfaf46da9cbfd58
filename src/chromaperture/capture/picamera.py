"""Cameras of a Raspberry Pi through picamera2, exposure and gain locked; tested with a stand-in, not on one."""

from __future__ import annotations

import contextlib
import re
import time
from typing import Any

import numpy as np

from chromaperture.capture.bayer import PATTERNS, superpixels
from chromaperture.capture.source import Frame
from chromaperture.capture.threaded_source import DeviceLostError, not_there
from chromaperture.system.errors import InputError, needed

_WAIT_S = 2.0  # for a frame; the longest exposures of a moving camera are far shorter. Chosen by hand
# Frames after which automatic exposure has settled and controls that were set are in force; the manual's examples
# wait one or two seconds, 40 frames of a second and a third at 30 a second. Chosen by hand.
_SETTLE_FRAMES = 40
# Before which a control that was set may not be in force; sensors take three, and the queue holds some. Chosen by hand
_ACT_FRAMES = 10
_LOCKED = 0.02  # relative: exposures are whole lines of the sensor, and so not exactly those asked for. Chosen by hand
_FORMAT = re.compile(r"S?(RGGB|BGGR|GRBG|GBRG)(8|10|12|14|16)")
_WORD_BITS = 16  # of `SensorBlackLevels`: "relative to a 16-bit pixel range" (libcamera's controls)
_RED_CARD_RATIO = 1.5  # of the red pixel's light to each other's; paper of a pure red has 5 and more. Chosen by hand
_CLOCK_SLACK_S = 5.0  # between a sensor's time stamp and now, beyond which it is of another clock; chosen by hand


def load_picamera2() -> Any:
    """Import picamera2; raises MissingDependencyError."""
    hint = (
        "cameras of a Raspberry Pi need picamera2: sudo apt install python3-picamera2, in an environment made with "
        "python3 -m venv --system-site-packages"
    )
    return needed("picamera2", hint).Picamera2


class PiCamera:
    """An opened camera, running; one frame at a time by `read`."""

    def __init__(
        self,
        number: str = "0",  # as ``rpicam-hello --list-cameras`` counts
        *,
        width: int | None = None,  # of a mode of the sensor; default the fastest that sees the whole field, most bits
        height: int | None = None,
        exposure_us: float | None = None,  # without it automatic exposure runs until it has settled, and is kept
        gain: float | None = None,
        fps: float | None = None,
        lens_position: float | None = None,  # of a lens with a motor, 1/m; a calibration is for one, where it stays
        pattern: str | None = None,  # order of the colours, such as BGGR, instead of what the driver says
        red_card: int = 0,  # 1: the first frame shows a red card; opening fails unless the order makes it red
        black_level: float | None = None,  # counts of the mosaic; default what the driver says, and the highest count
        white_level: float | None = None,
    ) -> None:
        if pattern is not None and pattern.upper() not in PATTERNS:
            raise InputError(f"unknown Bayer pattern {pattern!r}: choose {', '.join(PATTERNS)}")
        kind = load_picamera2()
        name = number or "0"
        known = [str(entry["Num"]) for entry in kind.global_camera_info()]
        if name not in known:
            there = f"there is {', '.join(known)}" if known else "none is connected"
            raise not_there(f"Raspberry Pi camera {name}", there)
        try:
            self._camera = kind(int(name))
        except Exception as error:  # libcamera's errors are RuntimeError, IndexError ...
            raise not_there(f"Raspberry Pi camera {name}", " ".join(str(error).split()) or "it is in use") from None
        try:
            self._levels = (black_level, white_level)
            mode = chosen_mode(self._camera.sensor_modes, width, height)
            self._configure(mode, fps)
            self._order = pattern.upper() if pattern is not None else self._driver_order
            self._camera.start()
            self._lock(exposure_us, gain, lens_position)
            if red_card:
                self._check_red_card()
        except BaseException as error:
            self.close()
            if isinstance(error, DeviceLostError):
                raise not_there(f"Raspberry Pi camera {name}", str(error)) from None
            raise

    def _configure(self, mode: dict[str, Any], fps: float | None) -> None:
        """Ask for the mode unpacked, and read from the configuration what is delivered."""
        camera = self._camera
        raw = {"size": tuple(mode["size"]), "format": str(mode["unpacked"])}
        controls = {"FrameRate": float(fps)} if fps is not None else {}
        # The processed picture is not used; small, it costs little.
        camera.configure(camera.create_video_configuration(main={"size": (320, 240)}, raw=raw, controls=controls))
        # Only after `configure` is the order that of the rotated sensor (picamera2 issues 368, 405, 797).
        delivered = camera.camera_configuration()["raw"]
        found = _FORMAT.fullmatch(str(delivered["format"]))
        if found is None:
            raise InputError(
                f"the camera delivers {delivered['format']}, which is not read; an unpacked Bayer format is needed, so "
                "choose another mode with width and height"
            )
        self._driver_order, self._word_bits = found[1], int(found[2])
        self._bits = min(int(mode["bit_depth"]), self._word_bits)
        self._size = (int(delivered["size"][0]), int(delivered["size"][1]))

    def _lock(self, exposure_us: float | None, gain: float | None, lens_position: float | None) -> None:
        """Fix exposure, gain and focus, and see that the sensor obeys; raises InputError where it does not."""
        controls: dict[str, Any] = {"AwbEnable": False}
        if "AfMode" in self._camera.camera_controls:
            controls["AfMode"] = 0  # manual
            if lens_position is not None:
                controls["LensPosition"] = float(lens_position)
        elif lens_position is not None:
            raise InputError("this camera has no motor for its lens: leave lens_position out, and focus by hand")
        self._camera.set_controls(controls)
        if exposure_us is None or gain is None:
            metadata: dict[str, Any] = {}
            for _ in range(_SETTLE_FRAMES):
                _, metadata = self._capture()
            exposure_us = float(metadata["ExposureTime"]) if exposure_us is None else exposure_us
            gain = float(metadata["AnalogueGain"]) if gain is None else gain
        wanted = {"ExposureTime": round(exposure_us), "AnalogueGain": float(gain)}
        self._camera.set_controls({"AeEnable": False, **wanted})
        for number in range(_SETTLE_FRAMES):
            _, metadata = self._capture()
            if number >= _ACT_FRAMES and all(abs(metadata[n] - v) <= max(_LOCKED * v, 1e-9) for n, v in wanted.items()):
                return
        raise InputError(
            f"the camera does not keep an exposure of {wanted['ExposureTime']} µs and a gain of {gain:g} (it has "
            f"{metadata['ExposureTime']} µs and {metadata['AnalogueGain']:.3g}); give values within its limits"
        )

    def _capture(self) -> tuple[np.ndarray, dict[str, Any]]:
        """Wait for a frame; returns the mosaic, (H, W) uint16, and the metadata."""
        try:
            request = self._camera.capture_request(wait=_WAIT_S)
        except TimeoutError:
            raise DeviceLostError(f"no frame for {_WAIT_S:g} s") from None
        except RuntimeError as error:
            raise DeviceLostError(" ".join(str(error).split())) from None
        try:
            data, metadata = request.make_array("raw"), request.get_metadata()
            return mosaic_of(data, self._size, self._word_bits, self._bits), metadata
        finally:
            request.release()

    def _check_red_card(self) -> None:
        mosaic, metadata = self._capture()
        found = order_of_red_card(mosaic, black_level=self._black(metadata))
        if found != self._order:
            raise InputError(
                f"the red card is not red with the colours in the order {self._order}; it is with pattern={found}. "
                "Give that, or a card that is red"
            )

    def _black(self, metadata: dict[str, Any]) -> float:
        """Return the counts of no light: what was given, or what the driver says."""
        if self._levels[0] is not None:
            return self._levels[0]
        levels = metadata.get("SensorBlackLevels")
        return float(np.mean(levels)) / 2 ** (_WORD_BITS - self._bits) if levels else 0.0

    def read(self, index: int) -> Frame:
        """Wait for the next frame."""
        mosaic, metadata = self._capture()
        white = self._levels[1] if self._levels[1] is not None else 2**self._bits - 1
        counts, encoding = superpixels(mosaic, self._order, black_level=self._black(metadata), white_level=white)
        facts = {
            "exposure_us": float(metadata["ExposureTime"]),
            "gain": float(metadata["AnalogueGain"]),
            "pattern": self._order,
        }
        if "LensPosition" in metadata:
            facts["lens_position"] = float(metadata["LensPosition"])
        return Frame(counts, encoding, time_of(metadata), index, facts)

    def close(self) -> None:
        """Stop and release the camera."""
        for end in (self._camera.stop, self._camera.close):
            with contextlib.suppress(Exception):
                end()


def chosen_mode(modes: list[dict[str, Any]], width: int | None, height: int | None) -> dict[str, Any]:
    """Choose of picamera2's modes that fit the largest field of view, then the most bits, then the fastest."""
    fitting = [m for m in modes if width in (None, m["size"][0]) and height in (None, m["size"][1])]
    if not fitting:
        sizes = ", ".join(f"{m['size'][0]}x{m['size'][1]} ({m['bit_depth']} bit, {m['fps']:.0f}/s)" for m in modes)
        raise InputError(f"the sensor has no mode of {width or 'any'} x {height or 'any'} px: choose from {sizes}")
    return max(fitting, key=lambda m: (m["crop_limits"][2] * m["crop_limits"][3], m["bit_depth"], m["fps"]))


def mosaic_of(data: np.ndarray, size: tuple[int, int], word_bits: int, bits: int) -> np.ndarray:
    """Return the counts of a raw array of picamera2, whose rows may be longer than the picture; (H, W) uint16.

    ``word_bits`` are those of the format's name: 16 where the sensor's ``bits`` stand at the upper end of a word, as on
    a Raspberry Pi 5. Raises InputError where the array is smaller than the picture: packed, or compressed.
    """
    wide = data if word_bits == 8 or data.dtype != np.uint8 else np.ascontiguousarray(data).view("<u2")
    if wide.ndim != 2 or wide.shape[0] < size[1] or wide.shape[1] < size[0]:
        raise InputError(
            f"the camera delivers an array of {data.shape} {data.dtype} for {size[0]}x{size[1]} px; an unpacked format "
            "is needed, so choose another mode with width and height"
        )
    return wide[: size[1], : size[0]].astype(np.uint16) >> np.uint16(max(0, word_bits - bits))


def order_of_red_card(mosaic: np.ndarray, *, black_level: float) -> str:
    """Return the order in which a red card in the middle is red; raises InputError where none is seen."""
    height, width = (n // 4 * 2 for n in mosaic.shape)  # half of each side, in whole cells
    top, left = ((n - m) // 4 * 2 for n, m in zip(mosaic.shape, (height, width), strict=True))
    middle = mosaic[top : top + height, left : left + width].astype(np.float64) - black_level
    sites = np.array([middle[row::2, column::2].mean() for row in (0, 1) for column in (0, 1)])
    red = int(np.argmax(sites))
    others = np.delete(sites, red)
    if sites[red] <= 0 or sites[red] < _RED_CARD_RATIO * others.max():
        raise InputError(
            "no red card was seen in the middle of the frame: fill it with red paper, well lit and not overexposed"
        )
    return next(order for order in PATTERNS if order[red] == "R")


def time_of(metadata: dict[str, Any]) -> float:
    """Return when the frame began, in seconds since 1970; now, where the time stamp is of another clock."""
    now = time.time()
    stamp, boot = metadata.get("SensorTimestamp"), getattr(time, "CLOCK_BOOTTIME", None)
    if stamp is None or boot is None:
        return now
    age_s = (time.clock_gettime_ns(boot) - int(stamp)) / 1e9
    return now - age_s if 0 <= age_s < _CLOCK_SLACK_S else now


def pi_cameras() -> list[str]:
    """List the numbers of the cameras of this Raspberry Pi."""
    return [str(entry["Num"]) for entry in load_picamera2().global_camera_info()]
