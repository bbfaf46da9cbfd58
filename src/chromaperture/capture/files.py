"""Image files to linear light.

Pixels stay as recorded: an EXIF orientation is not applied, because the filters in the pupil do not turn with it, and
no white balance, because superposition of the views needs the sensor's own scale.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, JpegImagePlugin

from chromaperture.capture.bayer import check_not_quad, superpixels
from chromaperture.capture.picture_header import (
    PNG_MARK,
    TIFF_MARKS,
    check_png_sums,
    check_size,
    open_picture,
    same_frame,
)
from chromaperture.capture.raw_container import holds_raw
from chromaperture.capture.source import choose_encoding
from chromaperture.capture.tiff import decode_tiff, tiff_bits, tiff_size
from chromaperture.color.encoding import Encoding, develop_counts, format_encoding
from chromaperture.errors import CaptureWarning, InputError
from chromaperture.shots import is_raw
from chromaperture.validation import MOST_FILE_BYTES, read_bytes

_MOST_SATURATED = 0.98  # fraction of the pixels at one largest count; as in `check_capture`
_SPARSE = 61  # rows and columns: a colour picture is hardly ever grey at all of their crossings
_SUBSAMPLED = {1: "4:2:2", 2: "4:2:0"}  # Pillow's codes of JPEG chroma subsampling


@dataclass(frozen=True)
class Decoded:
    """Content of a photograph's file.

    Attributes
    ----------
    array : (H, W, 3) uint8, uint16, float32 or float64
        R, G, B as stored; for RAW files twice the mosaic's counts, see `superpixels`.
    own : Encoding or None
        Of a RAW file, which states its levels.
    """

    array: np.ndarray
    own: Encoding | None = None


def read_light(
    path: str | Path,
    *,
    size_px: tuple[int, int] | None = None,
    any_scale: bool = False,
    black_level: float | None = None,
    white_level: float | None = None,
    camera_encoding: Encoding | None = None,
    mosaic: str | None = None,
) -> np.ndarray:
    """`decode`, then `linearise`; counts of large files of 16 bit are not kept where their levels are known before."""
    path, levels = Path(path), {"black_level": black_level, "white_level": white_level}
    light: list[np.ndarray] = []

    def deep_png(data: bytes) -> np.ndarray | None:
        deep = np.dtype(np.uint16)
        try:
            found = choose_encoding(format_encoding(deep), np.empty(0, deep), **levels, camera_encoding=camera_encoding)
        except InputError:  # levels that make no sense, which `linearise` says
            return _deep_png(data)
        if not found.given or found.curve != "linear" or found.response is not None:
            return _deep_png(data)
        image = _deep_png(data, (found.black_level, found.white_level))
        light.extend([] if image is None else [image])
        return image

    mosaic = mosaic or (camera_encoding.mosaic if camera_encoding else None)
    if camera_encoding is None or mosaic is not None or opens_as_raw(path):
        # The counts may say that a white level is wrong which nobody gave.
        decoded = decode(path, size_px=size_px, any_scale=any_scale, mosaic=mosaic)
    else:
        decoded = Decoded(_colour(_decode(path, size_px, any_scale, deep_png), path))
    return light[0] if light else linearise(decoded, **levels, camera_encoding=camera_encoding)


def read_image(
    path: str | Path,
    *,
    black_level: float | None = None,
    white_level: float | None = None,
    size_px: tuple[int, int] | None = None,
    mosaic: str | None = None,
) -> np.ndarray:
    """Read a photograph as linear light: `decode`, then `linearise`.

    Files of 16 bit (PNG, TIFF, PPM) hold linear counts; without levels, black is 0 and white 65535. Files of 8 bit
    (JPEG, PNG, TIFF, PPM, BMP, WebP) are decoded from the sRGB curve; when levels are given, they are taken for linear
    counts too. TIFF files of floats hold linear light; without levels, black is 0 and white 1. RAW files (extra
    ``raw``) give one pixel for every 2 x 2 cell of the mosaic; levels are those of the mosaic.

    Parameters
    ----------
    path : str or Path
    black_level, white_level : float, optional
        Counts of no light and of a full well.
    size_px : (int, int), optional
        Width and height of the camera: a file of another size is refused before it is decoded. Without it, files of
        more than `validation.MOST_PIXELS` are.
    mosaic : {"RGGB", "BGGR", "GRBG", "GBRG"}, optional
        Grey files are such a mosaic of a Bayer sensor and read like RAW; levels are those of the mosaic.

    Returns
    -------
    (H, W, 3) float32, linear RGB; 0 is black, 1.0 the white level

    Raises
    ------
    InputError
        The file is missing, damaged, grey, of another size, or the levels make no sense.

    Warns
    -----
    CaptureWarning
        Chroma subsampling has halved the resolution of the measured signal, or the levels look wrong.
    """
    decoded = decode(path, size_px=size_px, mosaic=mosaic)
    return linearise(decoded, black_level=black_level, white_level=white_level)


def linearise(
    decoded: Decoded,
    *,
    black_level: float | None = None,
    white_level: float | None = None,
    camera_encoding: Encoding | None = None,
) -> np.ndarray:
    """Convert the content of a file to linear light; see `read_image` and, for the levels, `choose_encoding`."""
    levels = {"black_level": black_level, "white_level": white_level}
    return develop_counts(decoded.array, encoding_of(decoded, **levels, camera_encoding=camera_encoding))


def read_counts(
    path: str | Path,
    *,
    black_level: float | None = None,
    white_level: float | None = None,
    camera_encoding: Encoding | None = None,
    mosaic: str | None = None,
) -> tuple[np.ndarray, Encoding]:
    """Read a photograph as stored, (H, W, 3), and how to convert it to linear light; see `choose_encoding`."""
    decoded = decode(path, mosaic=mosaic or (camera_encoding.mosaic if camera_encoding else None))
    levels = {"black_level": black_level, "white_level": white_level}
    return decoded.array, encoding_of(decoded, **levels, camera_encoding=camera_encoding)


def encoding_of(
    decoded: Decoded,
    *,
    black_level: float | None = None,
    white_level: float | None = None,
    camera_encoding: Encoding | None = None,
) -> Encoding:
    """Choose how to convert the content of a file to linear light; see `choose_encoding`."""
    own = decoded.own or format_encoding(decoded.array.dtype)
    levels = {"black_level": black_level, "white_level": white_level}
    return choose_encoding(own, decoded.array, **levels, camera_encoding=camera_encoding)


def opens_as_raw(path: Path) -> bool:
    """Recognise a camera's RAW file by its name, or its content."""
    return is_raw(path) or holds_raw(path)


def image_size(path: str | Path, *, mosaic: str | None = None) -> tuple[int, int]:
    """Return width and height of an image file, px, from its header; raises InputError like `read_image`."""
    path = Path(path)
    if (sites := _sites_px(path, mosaic)) is not None:
        return sites[0] // 2, sites[1] // 2
    if opens_as_raw(path):
        from chromaperture.capture.raw import raw_size

        return raw_size(path)
    data = _read(path)
    if data.startswith(TIFF_MARKS):
        return tiff_size(data, path.name)
    try:
        width, height = open_picture(data).size
    except Exception:
        raise InputError(_damaged(path)) from None
    check_size(width, height, path.name, None)
    return width, height


def has_8_bits(path: Path) -> bool:
    """Recognise a picture whose samples have 8 bits by its header; False where there is none, as reading will say."""
    if opens_as_raw(path):
        return False
    try:
        data = _read(path)
        return tiff_bits(data) == 8 if data.startswith(TIFF_MARKS) else bool(open_picture(data)) and not _is_deep(data)
    except Exception:  # whatever a damaged file makes libraries raise
        return False


def decode(
    path: str | Path, *, size_px: tuple[int, int] | None = None, any_scale: bool = False, mosaic: str | None = None
) -> Decoded:
    """Read a photograph's file once; raises InputError like `read_image`, but for levels.

    With ``any_scale`` other sizes of the aspect of ``size_px`` are read, too.
    """
    path = Path(path)
    sites_px, is_raw_file = _sites_px(path, mosaic), opens_as_raw(path)
    if sites_px is None and not is_raw_file:
        return Decoded(_colour(_decode(path, size_px, any_scale), path))
    found = image_size(path, mosaic=mosaic)
    if any_scale and size_px is not None and same_frame(size_px, found):
        size_px = found
    if is_raw_file:
        from chromaperture.capture.raw import read_raw

        return Decoded(*read_raw(path, size_px=size_px))
    check_size(*found, path.name, size_px)
    sites = _decode(path, sites_px, False)
    sites = sites if sites.ndim == 2 else sites[..., 0]
    check_not_quad(sites, path.name, black_level=0.0)
    white = format_encoding(sites.dtype).white_level
    counts, own = superpixels(sites, str(mosaic), black_level=0.0, white_level=white)
    return Decoded(counts, replace(own, given=False))


def read_samples(path: str | Path) -> np.ndarray:
    """Read a PNG, TIFF, PPM or JPEG file as it is stored, whatever it shows: a map, a mask, a picture.

    Returns
    -------
    (H, W) or (H, W, S) array
        Channels in the order R, G, B.

    Raises
    ------
    InputError
        The file is missing, damaged or too large.
    """
    return _decode(Path(path), None, False)


def _sites_px(path: Path, mosaic: str | None) -> tuple[int, int] | None:
    """Return width and height of a file of one channel, where these are mosaics; None for others."""
    if mosaic is None or opens_as_raw(path):
        return None
    data = _read(path)
    try:
        picture = open_picture(data)
    except Exception:  # which reading it says
        return None
    is_grey = picture.mode.startswith(("L", "I", "F"))
    return None if not is_grey else tiff_size(data, path.name) if data.startswith(TIFF_MARKS) else picture.size


def _read(path: Path) -> bytes:
    data = read_bytes(path, most_bytes=MOST_FILE_BYTES)
    if not data:
        raise InputError(f"{path.name} is empty; copy the file again")
    return data


def _damaged(path: Path) -> str:
    return f"{path.name} is damaged or not an image (PNG, TIFF, PPM, JPEG, BMP or WebP); copy or export the file again"


def _deep_png(data: bytes, levels: tuple[float, float] | None = None) -> np.ndarray | None:
    from chromaperture.capture.deep_png import decode_rgb16  # compiling starts here, not at import

    return decode_rgb16(data, levels)


def _decode(
    path: Path,
    size_px: tuple[int, int] | None,
    any_scale: bool,
    deep_png: Callable[[bytes], np.ndarray | None] = _deep_png,
) -> np.ndarray:
    """Decode to an array of counts in the file's own depth, or what ``deep_png`` makes, channels in R, G, B order."""
    data = _read(path)

    def check(width: int, height: int, file_bytes: int | None = None) -> None:
        is_scaled = any_scale and size_px is not None and same_frame(size_px, (width, height))
        check_size(width, height, path.name, None if is_scaled else size_px, file_bytes=file_bytes)

    if data.startswith(TIFF_MARKS):
        return decode_tiff(data, path.name, check=check)
    try:
        picture = open_picture(data)
        check(*picture.size, file_bytes=len(data))
        if data.startswith(PNG_MARK):
            check_png_sums(data)
        else:
            picture.verify()
        if _is_deep(data):
            if data.startswith(b"P"):
                return _deep_pnm(data, picture)
            if data.startswith(PNG_MARK):
                found = deep_png(data)
                if found is not None:
                    return found
            counts = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
            if counts is None:
                raise InputError(_damaged(path))
            # OpenCV stores B, G, R; alpha goes. An index list would leave one plane a channel, which later is copied.
            if counts.ndim == 3 and counts.shape[2] in (3, 4):
                return cv2.cvtColor(counts, cv2.COLOR_BGR2RGB if counts.shape[2] == 3 else cv2.COLOR_BGRA2RGB)
            return counts
        picture = open_picture(data)
        _warn_of_subsampling(picture, data)
        coded = picture.mode in ("P", "RGBA", "CMYK", "YCbCr")
        return np.asarray(picture.convert("RGB") if coded else picture)
    except InputError as error:
        raise InputError(str(error) if path.name in str(error) else _damaged(path)) from None
    except (CaptureWarning, MemoryError):  # the first where warnings are errors
        raise
    except Exception:  # decoders raise anything on a damaged file
        raise InputError(_damaged(path)) from None


def _is_deep(data: bytes) -> bool:
    """Recognise PNG and PNM files of more than 8 bits, which Pillow would reduce to 8."""
    if data.startswith(PNG_MARK):
        return len(data) > 24 and data[24] == 16
    if data[:2] in (b"P5", b"P6"):
        fields = [f for line in data[:512].split(b"\n") for f in line.split(b"#")[0].split()]
        return len(fields) > 3 and int(fields[3]) > 255
    return False


def _deep_pnm(data: bytes, picture: Image.Image) -> np.ndarray:
    """Return the samples behind the header; raises ValueError where there are too few."""
    channels = 3 if data.startswith(b"P6") else 1
    (width, height), start = picture.size, picture.tile[0].offset  # type: ignore[attr-defined]
    counts = np.frombuffer(data, ">u2", width * height * channels, start)
    return counts.astype(np.uint16).reshape(height, width, channels)


def _colour(counts: np.ndarray, path: Path) -> np.ndarray:
    """Check that the counts are a colour image of a usable type."""
    if counts.ndim == 3 and counts.shape[2] == 4:
        counts = counts[..., :3]
    grey = counts.ndim == 2 or (counts.ndim == 3 and counts.shape[2] in (1, 2))
    if not grey and (counts.ndim != 3 or counts.shape[2] != 3):
        raise InputError(f"{path.name} holds an array of shape {counts.shape}; one RGB picture is needed")
    if not grey and _are_alike(counts[::_SPARSE, ::_SPARSE]) and _are_alike(counts):
        # A picture of one count is black or saturated: which, the check of its exposure finds out from the levels.
        grey = float((counts[..., 0] == counts.max()).mean()) <= _MOST_SATURATED
    if grey:
        hint = "" if counts.shape[2:] == (3,) else "; if it is the mosaic of a Bayer sensor, give --mosaic RGGB"
        raise InputError(
            f"{path.name} is a grey picture; the depth is in the colours, so give the colour original{hint}"
        )
    if counts.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise InputError(f"{path.name} holds {counts.dtype} samples; give 8 or 16 bit or float")
    return counts


def _are_alike(counts: np.ndarray) -> bool:
    """Whether all three channels are the same."""
    return np.array_equal(counts[..., 0], counts[..., 1]) and np.array_equal(counts[..., 1], counts[..., 2])


def _warn_of_subsampling(picture: Image.Image, data: bytes) -> None:
    kind = None
    if isinstance(picture, JpegImagePlugin.JpegImageFile):
        kind = _SUBSAMPLED.get(JpegImagePlugin.get_sampling(picture))
    elif picture.format == "WEBP" and b"VP8L" not in data[:64]:  # lossless, maybe after a header
        kind = "4:2:0"
    if kind:
        warnings.warn(
            f"a {picture.format} file with {kind} chroma, which halves the resolution of the colours the depth is read "
            "from; use RAW, PNG or TIFF, or JPEG at best quality (4:4:4)",  # names no file: Python shows it once
            CaptureWarning,
            stacklevel=5,
        )
